/* Chaplygin sleigh on SE(2), body velocities (w, x, y), blade y = 0, Cayley.

   G = [[I, 0, c], [0, m, 0], [c, 0, m]] with I = J + m a^2, c = m a. With s = (flight time / 2) xi
   and momenta in the same unit, X = m x, Y = c w + m y and d = 1 + w^2,
     FL-(s) = (d (I w + c y) + w (x X + y Y) + c w x,  X - w Y,  Y + w X),
   FL+ the same with w -> -w inside the signs: (... - c w x, X + w Y, Y - w X).

   parameters: m, J, a.  state: momentum after the impact (3).
   Both functions return the number of Newton iterations, or FAILED. */
#include "iteration.h"

typedef struct {
    double m, I, c;
    double pull; /* m a / I: the blade makes p_y = pull p_w */
} sleigh;

static sleigh make_sleigh(const double *p)
{
    double c = p[0] * p[2], I = p[1] + c * p[2];
    return (sleigh){p[0], I, c, c / I};
}

static vector velocity(const sleigh *g, vector p)
{
    double w = (g->m * p.x - g->c * p.z) / (g->m * g->I - g->c * g->c);
    return (vector){w, p.y / g->m, (p.z - g->c * w) / g->m};
}

/* Parts of the Legendre transforms at s that an update leaves for the next one. */
typedef struct {
    double turn, along, across; /* G s */
    double even, odd;           /* FL-, FL+ of w: even + odd, even - odd */
    double d, drag;             /* 1 + w^2, x X + y Y */
} parts;

INLINE parts at(const sleigh *g, vector s)
{
    parts q;
    q.turn = g->I * s.x + g->c * s.z;
    q.along = g->m * s.y;
    q.across = g->c * s.x + g->m * s.z;
    q.d = 1.0 + s.x * s.x;
    q.drag = s.y * q.along + s.z * q.across;
    q.even = q.d * q.turn + s.x * q.drag;
    q.odd = g->c * s.x * s.y;
    return q;
}

/* One Newton update of FL-(s) = p, q = at(s) is updated with s. The lower right block of the
   Jacobian, m [[1, -w], [w, 1]], is eliminated first. Adds to work and energy, and returns the
   solution for the right-hand side (0, 0, 1), the change of s with p_y. */
INLINE vector newton(const sleigh *g, vector p, vector *s, parts *q, double *work,
                     double *energy)
{
    const double m = g->m, c = g->c, w = s->x, x = s->y, y = s->z;
    double r0 = q->even + q->odd - p.x;
    double r1 = q->along - w * q->across - p.y;
    double r2 = q->across + w * q->along - p.z;
    double by_w = 2.0 * w * q->turn + q->d * g->I + q->drag + c * (w * y + x);
    double by_x = w * (2.0 * q->along + c);
    double by_y = q->d * c + w * (q->across + m * y);
    double f1 = -(q->across + c * w), f2 = q->along + c;
    /* [[1, w], [-w, 1]] times the residual and times the first column */
    double t1 = r1 + w * r2, t2 = r2 - w * r1, e1 = f1 + w * f2, e2 = f2 - w * f1;
    double md = m * q->d, inverse = 1.0 / md;
    double over = 1.0 / (md * by_w - by_x * e1 - by_y * e2);
    double u0 = (md * r0 - by_x * t1 - by_y * t2) * over;
    double u1 = (t1 - e1 * u0) * inverse, u2 = (t2 - e2 * u0) * inverse;
    double v0 = -(by_x * w + by_y) * over;
    *work += fabs(r0 * u0) + fabs(r1 * u1) + fabs(r2 * u2);
    *s = (vector){w - u0, x - u1, y - u2};
    *q = at(g, *s);
    *energy += fabs(s->x * q->turn) + fabs(s->y * q->along) + fabs(s->z * q->across);
    return (vector){v0, (w - e1 * v0) * inverse, (1.0 - e2 * v0) * inverse};
}

INLINE vector legendre_plus(vector s, const parts *q)
{
    return (vector){q->even - q->odd, q->along + s.x * q->across, q->across - s.x * q->along};
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const sleigh g = make_sleigh(parameters);
    vector p = scaled(0.5 * h, load(state));
    int64_t iterations = 0;
    double u[3];
    warm_start history;
    store(velocity(&g, p), u);
    fill(&history, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&history, u, 3);
        vector s = load(u);
        parts q = at(&g, s);
        double last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g, p, &s, &q, &work, &energy);
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
    /* C = I / (m J) is the (y, y) entry of G^-1; the normal direction is the covector of y */
    const double root = sqrt(g.I / (g.m * g.I - g.c * g.c)), normal = 1.0 / root;
    vector p = scaled(0.25 * h, load(state));
    double inverse = -0.5, u[7] = {0.0};
    int64_t iterations = 0;
    warm_start history;
    store(velocity(&g, p), u);
    store(velocity(&g, p), u + 3);
    fill(&history, u, 7);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&history, u, 7);
        vector out = load(u), home = load(u + 3), arrived;
        double nu = u[6], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            parts q_out = at(&g, out), q_home = at(&g, home);
            vector lent = {p.x, p.y, p.z + nu * normal};
            vector by_out = newton(&g, lent, &out, &q_out, &work, &energy);
            vector hit = legendre_plus(out, &q_out);
            hit.z = 2.0 * g.pull * hit.x - hit.z;
            vector by_home = newton(&g, hit, &home, &q_home, &work, &energy);
            arrived = legendre_plus(home, &q_home);
            double closing = root * (arrived.z - g.pull * arrived.x) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            /* both flights follow nu; the impact turns the normal round */
            out = add(out, moved * normal, by_out);
            home = add(home, -moved * normal, by_home);
            double left = fabs(closing * moved);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        store(out, u);
        store(home, u + 3);
        u[6] = nu;
        remember(&history, u, 7);
        p = (vector){arrived.x, arrived.y, g.pull * arrived.x};
    }
    store(scaled(4.0 / h, p), state);
    return iterations;
}
