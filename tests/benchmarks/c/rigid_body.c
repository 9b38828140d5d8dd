/* Rigid body on SO(3) with one constraint mu . omega = 0 (Suslov), body velocities, Cayley.

   Everything is homogeneous in velocities times the step: with s = (flight time / 2) omega and
   momenta in the same unit, FL-(s) = J s + s x J s + s (s . J s), FL+ the same with -s x J s, and
   no step size is left.

   parameters: J11 J12 J13 J22 J23 J33, mu (3).  state: momentum after the impact (3).
   Both functions return the number of Newton iterations, or FAILED. */
#include "iteration.h"

typedef struct {
    vector first, second, third; /* rows of J */
    vector mu, raised;           /* mu, J^-1 mu */
    double gram;                 /* mu . J^-1 mu */
} body;

static vector velocity(const body *b, vector p)
{
    inverted J = inverse_of(b->first, b->second, b->third);
    return applied(&J, p);
}

static body make_body(const double *p)
{
    body b = {.first = {p[0], p[1], p[2]}, .second = {p[1], p[3], p[4]},
              .third = {p[2], p[4], p[5]}, .mu = {p[6], p[7], p[8]}};
    b.raised = velocity(&b, b.mu);
    b.gram = dot(b.mu, b.raised);
    return b;
}

INLINE vector times(const body *b, vector s)
{
    return (vector){dot(b->first, s), dot(b->second, s), dot(b->third, s)};
}

/* One Newton update of FL-(s) = m; pi = J s is updated with s. Adds to work and energy, and returns
   the inverse of the Jacobian. */
INLINE inverted newton(const body *b, vector m, vector *s, vector *pi, double *work,
                       double *energy)
{
    double k = dot(*s, *pi);
    vector r = add(add(cross(*s, *pi), k, *s), 1.0, add(*pi, -1.0, m));
    /* columns of J + s^ J - (J s)^ + s . J s + 2 s (J s)^T */
    vector a = add(add(b->first, 1.0, cross(*s, b->first)), 2.0 * pi->x, *s);
    vector c = add(add(b->second, 1.0, cross(*s, b->second)), 2.0 * pi->y, *s);
    vector d = add(add(b->third, 1.0, cross(*s, b->third)), 2.0 * pi->z, *s);
    a = (vector){a.x + k, a.y - pi->z, a.z + pi->y};
    c = (vector){c.x + pi->z, c.y + k, c.z - pi->x};
    d = (vector){d.x - pi->y, d.y + pi->x, d.z + k};
    inverted inverse = inverse_of(a, c, d);
    vector u = applied(&inverse, r);
    *work += size(r, u);
    *s = add(*s, -1.0, u);
    *pi = times(b, *s);
    *energy += size(*s, *pi);
    return inverse;
}

INLINE vector legendre_plus(vector s, vector pi)
{
    return add(add(pi, -1.0, cross(s, pi)), dot(s, pi), s);
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const body b = make_body(parameters);
    const vector twice = scaled(2.0 / b.gram, b.mu);
    vector m = scaled(0.5 * h, load(state));
    int64_t iterations = 0;
    double u[3];
    warm_start w;
    store(velocity(&b, m), u);
    fill(&w, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&w, 0, u, 3);
        vector s = load(u), pi = times(&b, s);
        double last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&b, m, &s, &pi, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        store(s, u);
        remember(&w, u, 3);
        m = legendre_plus(s, pi);
        m = add(m, -dot(b.raised, m), twice);
    }
    store(scaled(2.0 / h, m), state);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const body b = make_body(parameters);
    const vector once = scaled(1.0 / b.gram, b.mu), twice = scaled(2.0, once);
    const vector normal = scaled(1.0 / sqrt(b.gram), b.mu);
    const vector component = scaled(1.0 / sqrt(b.gram), b.raised);
    const double last_unit = 0.25 * h * size_of(STAGES - 1);
    vector m = scaled(last_unit, load(state));
    double inverse = -0.5, u[7] = {0.0};
    int64_t iterations = 0;
    warm_start w;
    store(scaled(1.0 / size_of(STAGES - 1), velocity(&b, m)), u);
    store(load(u), u + 3);
    fill(&w, u, 7);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part;
        m = scaled(growth_of(stage), m);
        inverse = regrown(inverse, stage);
        extrapolate(&w, stage, u, 7);
        vector out = scaled(part, load(u)), home = scaled(part, load(u + 3));
        vector arrived;
        double nu = part * part * part * u[6], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            vector pi_out = times(&b, out), pi_home = times(&b, home);
            inverted by_out = newton(&b, add(m, nu, normal), &out, &pi_out, &work, &energy);
            vector hit = legendre_plus(out, pi_out);
            hit = add(hit, -dot(b.raised, hit), twice);
            inverted by_home = newton(&b, hit, &home, &pi_home, &work, &energy);
            arrived = legendre_plus(home, pi_home);
            double closing = dot(component, arrived) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            /* both flights follow nu; the impact turns the normal round */
            out = add(out, moved, applied(&by_out, normal));
            home = add(home, -moved, applied(&by_home, normal));
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
        remember(&w, u, 7);
        m = add(arrived, -dot(b.raised, arrived), once);
    }
    store(scaled(1.0 / last_unit, m), state);
    return iterations;
}
