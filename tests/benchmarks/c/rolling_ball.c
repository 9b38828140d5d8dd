/* Homogeneous ball on a rotating table, on R^2 x SO(3) with space velocities, Cayley.

   Constraints x' - r omega_2 + Theta y = 0, y' + r omega_1 - Theta x = 0: constant rows, and
   C = (1/m + r^2/I) times the identity. Velocities, momenta and Theta are in units of
   2 / flight time of the stage. The inertia is a number, so FL-(s) = FL+(s) = I (1 + |s|^2) s: a
   flight keeps the spin momentum M, and s = sigma M with I (1 + sigma^2 |M|^2) sigma = 1, one
   unknown in place of three. It is the arrow; nothing else depends on it.

   With -DNO_ARROW sigma is left out, and what is left is affine in the state: Rattle is explicit,
   and the two closing equations of a projected stage are linear with a Jacobian a + b (quarter
   turn) that is known beforehand.

   parameters: m, r, I, Theta.  state: x, y, momentum after the impact (5).
   Both functions return the number of Newton iterations, or FAILED. */
#include "iteration.h"

/* r over I is the arm with which an impulse spins the ball. */
typedef struct {
    double over_m, r, inertia, over_i, theta, over_c;
} ball;

typedef struct {
    double x, y;
} pair;

typedef struct {
    pair p;
    vector spin;
} momentum;

static ball make_ball(const double *p, double unit)
{
    double c = 1.0 / p[0] + p[1] * p[1] / p[2];
    return (ball){1.0 / p[0], p[1], p[2], 1.0 / p[2], unit * p[3], 1.0 / c};
}

INLINE pair plus(pair a, double c, pair b)
{
    return (pair){a.x + c * b.x, a.y + c * b.y};
}

INLINE double length(pair a)
{
    return a.x * a.x + a.y * a.y;
}

/* mu G^-1 p */
INLINE pair normal_velocity(const ball *g, momentum m)
{
    double arm = g->r * g->over_i;
    return (pair){g->over_m * m.p.x - arm * m.spin.y, g->over_m * m.p.y + arm * m.spin.x};
}

/* mu G^-1 p - mu Y at the place q */
INLINE pair violation(const ball *g, pair q, momentum m)
{
    pair v = normal_velocity(g, m);
    return (pair){v.x + g->theta * q.y, v.y - g->theta * q.x};
}

/* p + mu^T lambda */
INLINE momentum pushed(const ball *g, momentum m, double c, pair lambda)
{
    return (momentum){plus(m.p, c, lambda), {m.spin.x + c * g->r * lambda.y,
                                             m.spin.y - c * g->r * lambda.x, m.spin.z}};
}

INLINE momentum struck(const ball *g, pair q, momentum m)
{
    return pushed(g, m, -2.0 * g->over_c, violation(g, q, m));
}

/* One Newton update of I (1 + sigma^2 |M|^2) sigma = 1. Adds to work and energy. */
INLINE void newton(const ball *g, double square, double *sigma, double *work, double *energy)
{
    double bent = square * *sigma * *sigma;
    double r = g->inertia * (1.0 + bent) * *sigma - 1.0;
    double u = r / (g->inertia * (1.0 + 3.0 * bent));
    *work += square * fabs(r * u);
    *sigma -= u;
    *energy += square * g->inertia * *sigma * *sigma;
}

static momentum load_momentum(const double *p, double unit)
{
    return (momentum){{unit * p[0], unit * p[1]}, scaled(unit, load(p + 2))};
}

static void store_state(pair q, momentum m, double unit, double *state)
{
    state[0] = q.x;
    state[1] = q.y;
    state[2] = m.p.x / unit;
    state[3] = m.p.y / unit;
    store(scaled(1.0 / unit, m.spin), state + 4);
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.5 * h;
    const ball g = make_ball(parameters, unit);
    pair q = {state[0], state[1]};
    momentum m = load_momentum(state + 2, unit);
    int64_t iterations = 0;
    double u[1] = {g.over_i};
    warm_start w;
    fill(&w, u, 1);
    for (int64_t step = 0; step < steps; step++) {
#ifndef NO_ARROW
        const double straight = g.over_m * length(m.p) + TINY, square = dot(m.spin, m.spin);
        extrapolate(&w, 0, u, 1);
        double sigma = u[0], last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = straight;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g, square, &sigma, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        u[0] = sigma;
        remember(&w, u, 1);
#endif
        q = plus(q, 2.0 * g.over_m, m.p);
        m = struck(&g, q, m);
    }
    store_state(q, m, unit, state);
    return iterations;
}

/* Flight, impact, flight: what comes home and where, and the momentum after the impact. */
INLINE momentum flown(const ball *g, pair *q, momentum m)
{
    *q = plus(*q, 2.0 * g->over_m, m.p);
    m = struck(g, *q, m);
    *q = plus(*q, 2.0 * g->over_m, m.p);
    return m;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    ball g = make_ball(parameters, unit);
    /* N = normal mu^T */
    const double normal = sqrt(g.over_c);
    pair q = {state[0], state[1]};
    momentum m = load_momentum(state + 2, last_unit);
    int64_t iterations = 0;
#ifdef NO_ARROW
    EACH_STAGE {
        g.theta = unit * size_of(stage) * parameters[3];
        m.p = (pair){growth_of(stage) * m.p.x, growth_of(stage) * m.p.y};
        m.spin = scaled(growth_of(stage), m.spin);
        /* what mu^T (1, 0) adds to the violation at the end; mu^T (0, 1) adds it turned */
        pair place = {0.0, 0.0};
        momentum unity = flown(&g, &place, pushed(&g, (momentum){0}, 1.0, (pair){1.0, 0.0}));
        pair slope = violation(&g, place, unity);
        double a = slope.x - 1.0 / g.over_c, b = slope.y, over = 1.0 / (a * a + b * b);
        pair end = q;
        momentum arrived = flown(&g, &end, m);
        pair v = violation(&g, end, arrived);
        pair lambda = {-over * (a * v.x + b * v.y), -over * (a * v.y - b * v.x)};
        arrived = flown(&g, &q, pushed(&g, m, 1.0, lambda));
        m = pushed(&g, arrived, -g.over_c, violation(&g, q, arrived));
    }
    (void)normal;
#else
    double by_x = -0.5, by_y = -0.5, u[4] = {g.over_i, g.over_i};
    warm_start w;
    fill(&w, u, 4);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / (part * part * part);
        g.theta = unit * part * parameters[3];
        m.p = (pair){growth_of(stage) * m.p.x, growth_of(stage) * m.p.y};
        m.spin = scaled(growth_of(stage), m.spin);
        by_x = regrown(by_x, stage);
        by_y = regrown(by_y, stage);
        extrapolate(&w, stage, u, 4);
        double out = u[0], home = u[1], last = BEFORE_FIRST;
        pair nu = {u[2] / over, u[3] / over}, moved = {0.0, 0.0}, before = {0.0, 0.0}, end;
        momentum arrived;
        for (int i = 0;; i++) {
            double work = 0.0;
            if (i == MAX_ITERATIONS)
                return FAILED;
            momentum lent = pushed(&g, m, normal, nu);
            double energy = g.over_m * length(lent.p) + TINY;
            double square = dot(lent.spin, lent.spin);
            newton(&g, square, &out, &work, &energy);
            end = q;
            arrived = flown(&g, &end, lent);
            energy += g.over_m * length(arrived.p);
            double square_home = dot(arrived.spin, arrived.spin);
            newton(&g, square_home, &home, &work, &energy);
            pair closing = violation(&g, end, arrived);
            closing = (pair){normal * closing.x - nu.x, normal * closing.y - nu.y};
            by_x = secant(by_x, moved.x, closing.x - before.x, energy);
            by_y = secant(by_y, moved.y, closing.y - before.y, energy);
            moved = (pair){-by_x * closing.x, -by_y * closing.y};
            before = closing;
            nu = plus(nu, 1.0, moved);
            double left = fabs(closing.x * moved.x) + fabs(closing.y * moved.y);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        u[0] = out;
        u[1] = home;
        u[2] = over * nu.x;
        u[3] = over * nu.y;
        remember(&w, u, 4);
        q = end;
        m = pushed(&g, arrived, -g.over_c, violation(&g, q, arrived));
    }
#endif
    store_state(q, m, last_unit, state);
    return iterations;
}
