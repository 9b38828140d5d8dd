/* Chaplygin sleigh on SE(2), body velocities (w, x, y), blade y = 0, Cayley.

   parameters: m, J, a.  state: momentum after the impact (3).
   Both functions return the number of Newton iterations, or FAILED. */
#include "planar_body.h"

typedef struct {
    planar body; /* I = J + m a^2, c = m a */
    double pull; /* m a / I: the blade makes p_y = pull p_w */
} sleigh;

static sleigh make_sleigh(const double *p)
{
    double c = p[0] * p[2], I = p[1] + c * p[2];
    return (sleigh){{p[0], I, c}, c / I};
}

/* The solution for the right-hand side (0, 0, 1): the change of s with p_y. */
INLINE vector by_across(const eliminated *j)
{
    double u0 = -(j->by_x * j->w + j->by_y) * j->over;
    return (vector){u0, (j->w - j->e1 * u0) * j->inverse, (1.0 - j->e2 * u0) * j->inverse};
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const sleigh g = make_sleigh(parameters);
    vector p = scaled(0.5 * h, load(state));
    int64_t iterations = 0;
    double u[3];
    warm_start history;
    store(velocity(&g.body, p), u);
    fill(&history, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&history, 0, u, 3);
        vector s = load(u);
        parts q = at(&g.body, s);
        double last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g.body, p, &s, &q, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        store(s, u);
        remember(&history, u, 3);
        p = legendre_plus(s, &q);
        p.z = 2.0 * g.pull * p.x - p.z;
    }
    store(scaled(2.0 / h, p), state);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const sleigh g = make_sleigh(parameters);
    const planar *body = &g.body;
    /* C = I / (m J) is the (y, y) entry of G^-1; the normal direction is the covector of y */
    const double root = sqrt(body->I / (body->m * body->I - body->c * body->c));
    const double normal = 1.0 / root, last_unit = 0.25 * h * size_of(STAGES - 1);
    vector p = scaled(last_unit, load(state));
    double inverse = -0.5, u[7] = {0.0};
    int64_t iterations = 0;
    warm_start history;
    store(scaled(1.0 / size_of(STAGES - 1), velocity(body, p)), u);
    store(load(u), u + 3);
    fill(&history, u, 7);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part;
        p = scaled(growth_of(stage), p);
        inverse = regrown(inverse, stage);
        extrapolate(&history, stage, u, 7);
        vector out = scaled(part, load(u)), home = scaled(part, load(u + 3)), arrived;
        double nu = part * part * part * u[6], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            parts q_out = at(body, out), q_home = at(body, home);
            vector lent = {p.x, p.y, p.z + nu * normal};
            eliminated j_out = newton(body, lent, &out, &q_out, &work, &energy);
            vector hit = legendre_plus(out, &q_out);
            hit.z = 2.0 * g.pull * hit.x - hit.z;
            eliminated j_home = newton(body, hit, &home, &q_home, &work, &energy);
            arrived = legendre_plus(home, &q_home);
            double closing = root * (arrived.z - g.pull * arrived.x) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            /* both flights follow nu; the impact turns the normal round */
            out = add(out, moved * normal, by_across(&j_out));
            home = add(home, -moved * normal, by_across(&j_home));
            double left = fabs(closing * moved);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        store(scaled(over, out), u);
        store(scaled(over, home), u + 3);
        u[6] = over * over * over * nu;
        remember(&history, u, 7);
        p = (vector){arrived.x, arrived.y, g.pull * arrived.x};
    }
    store(scaled(1.0 / last_unit, p), state);
    return iterations;
}
