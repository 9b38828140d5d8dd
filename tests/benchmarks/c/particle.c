/* Particle with z' = y x' and springs along x and y, z left out: base (y, x), momenta of (y, x, z).

   Flights are explicit, x -> x + t p / m, with the kick t F where the potential is asked: at both
   ends of a step of Rattle (half each), at the impact in a projected stage (once before and once
   after it). Those that keep the energy are the midpoint rule, which a spring solves:
   v = (p - t k x / 2) / (m + t^2 k / 4), x -> x + t v, p -> 2 m v - p.
   The constraint (0, -y, 1) has C = (1 + y^2) / m.

   With -DCLOSED nu is not searched. No impulse of the constraint touches p_y, so y is known before
   nu is, and what closes a stage is affine in nu: its slope is followed through the stage.

   parameters: m, k_x, k_y.  state: y, x, momentum after the impact (3).
   All functions return the number of iterations, or FAILED. */
#include "iteration.h"

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const double speed = h / parameters[0];
    const double pull_x = 0.5 * h * parameters[1], pull_y = 0.5 * h * parameters[2];
    double y = state[0], x = state[1], py = state[2], px = state[3], pz = state[4];
    for (int64_t step = 0; step < steps; step++) {
        py -= pull_y * y;
        px -= pull_x * x;
        y += speed * py;
        x += speed * px;
        py -= pull_y * y;
        px -= pull_x * x;
        double impulse = 2.0 * (pz - y * px) / (1.0 + y * y);
        px += y * impulse;
        pz -= impulse;
    }
    store((vector){py, px, pz}, state + 2);
    state[0] = y;
    state[1] = x;
    return 0;
}

/* A flight, the impact at its end with a kick on either side, and a flight home: linear in x, p_x
   and p_z where y is known. y: at the impact, inverse = 1 / (1 + y^2). */
typedef struct {
    double x, px, pz;
} flown;

INLINE flown fly(double x, double px, double pz, double y, double inverse, double speed,
                 double pull)
{
    flown f;
    x += speed * px;
    px -= pull * x;
    double impulse = 2.0 * (pz - y * px) * inverse;
    f.px = px + y * impulse - pull * x;
    f.pz = pz - impulse;
    f.x = x + speed * f.px;
    return f;
}

/* f with the nu lent that closes the stage: <component, f + nu by_nu> = nu at the end. */
INLINE flown lent(flown f, double component, double y_end, flown by_nu)
{
    double nu = component * (f.pz - y_end * f.px)
              / (1.0 - component * (by_nu.pz - y_end * by_nu.px));
    return (flown){f.x + nu * by_nu.x, f.px + nu * by_nu.px, f.pz + nu * by_nu.pz};
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double m = parameters[0], over_m = 1.0 / m;
    double y = state[0], x = state[1], py = state[2], px = state[3], pz = state[4];
    double inverse = -0.5, u[1] = {0.0};
    int64_t iterations = 0;
    warm_start w;
    fill(&w, u, 1);
    /* N = normal (0, -y, 1) */
    double normal = sqrt(m / (1.0 + y * y));
    EACH_STAGE {
        const double part = size_of(stage), t = 0.5 * h * part;
        const double speed = t * over_m, pull_x = t * parameters[1], pull_y = t * parameters[2];
        /* y knows nothing of the constraint */
        double y_hit = y + speed * py, py_hit = py - 2.0 * pull_y * y_hit;
        double y_end = y_hit + speed * py_hit, over = 1.0 / (1.0 + y_hit * y_hit);
        double over_end = 1.0 / (1.0 + y_end * y_end);
        double normal_end = sqrt(m * over_end), component = normal_end * over_m;
        flown f;
#ifdef CLOSED
        (void)inverse;
        f = fly(x, px, pz, y_hit, over, speed, pull_x);
        flown by_nu = fly(0.0, -y * normal, normal, y_hit, over, speed, pull_x);
        f = lent(f, component, y_end, by_nu);
#else
        extrapolate(&w, stage, u, 1);
        inverse = regrown(inverse, stage);
        double nu = part * part * u[0], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        const double straight = py * py + py_hit * py_hit + TINY;
        for (int i = 0;; i++) {
            if (i == MAX_ITERATIONS)
                return FAILED;
            double lent_x = px - nu * normal * y, lent_z = pz + nu * normal;
            f = fly(x, lent_x, lent_z, y_hit, over, speed, pull_x);
            double energy = over_m * (straight + lent_x * lent_x + lent_z * lent_z
                                      + f.px * f.px + f.pz * f.pz);
            double closing = component * (f.pz - y_end * f.px) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            iterations++;
            double left = fabs(closing * moved), now = left / energy;
            if (finished(now, last, now, 0))
                break;
            last = now;
        }
        u[0] = nu / (part * part);
        remember(&w, u, 1);
#endif
        /* onto the constraint set, whatever is left of nu */
        double impulse = (f.pz - y_end * f.px) * over_end;
        px = f.px + y_end * impulse;
        pz = f.pz - impulse;
        py = py_hit;
        x = f.x;
        y = y_end;
        normal = normal_end;
    }
    store((vector){py, px, pz}, state + 2);
    state[0] = y;
    state[1] = x;
    return iterations;
}

/* The midpoint rule for one coordinate with a spring; `pull` is t k / 2, and `over`
   1 / (m + t^2 k / 4). Adds its part of the energy times m: the squares of velocity times m and of
   the impulse. */
INLINE void swing(double *x, double *p, double m, double t, double pull, double over,
                  double *energy)
{
    double along = m * over * (*p - pull * *x), after = 2.0 * along - *p, impulse = after - *p;
    *energy += along * along + impulse * impulse;
    *x += t / m * along;
    *p = after;
}

INLINE flown swung(double x, double px, double pz, double y, double inverse, double m, double t,
                   double pull, double over, double *energy)
{
    flown f = {x, px, pz};
    swing(&f.x, &f.px, m, t, pull, over, energy);
    double impulse = 2.0 * (f.pz - y * f.px) * inverse;
    f.px += y * impulse;
    f.pz -= impulse;
    swing(&f.x, &f.px, m, t, pull, over, energy);
    *energy += pz * pz + f.pz * f.pz;
    return f;
}

int64_t energy_preserving(const double *parameters, double h, double *state, int64_t steps)
{
    const double m = parameters[0], over_m = 1.0 / m;
    double y = state[0], x = state[1], py = state[2], px = state[3], pz = state[4];
    double inverse = -0.5, u[1] = {0.0}, normal = sqrt(m / (1.0 + y * y));
    int64_t iterations = 0;
    warm_start w;
    fill(&w, u, 1);
    EACH_STAGE {
        const double part = size_of(stage), t = 0.5 * h * part;
        const double pull_x = 0.5 * t * parameters[1], pull_y = 0.5 * t * parameters[2];
        const double over_x = 1.0 / (m + 0.5 * t * pull_x), over_y = 1.0 / (m + 0.5 * t * pull_y);
        /* y knows nothing of the constraint */
        double y_hit = y, straight = TINY;
        swing(&y_hit, &py, m, t, pull_y, over_y, &straight);
        double y_end = y_hit;
        swing(&y_end, &py, m, t, pull_y, over_y, &straight);
        double over = 1.0 / (1.0 + y_hit * y_hit), over_end = 1.0 / (1.0 + y_end * y_end);
        double normal_end = sqrt(m * over_end), component = normal_end * over_m;
        flown f;
#ifdef CLOSED
        (void)inverse;
        f = swung(x, px, pz, y_hit, over, m, t, pull_x, over_x, &straight);
        flown by_nu = swung(0.0, -y * normal, normal, y_hit, over, m, t, pull_x, over_x, &straight);
        f = lent(f, component, y_end, by_nu);
#else
        extrapolate(&w, stage, u, 1);
        inverse = regrown(inverse, stage);
        double nu = part * part * u[0], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        for (int i = 0;; i++) {
            if (i == MAX_ITERATIONS)
                return FAILED;
            double energy = straight;
            f = swung(x, px - nu * normal * y, pz + nu * normal, y_hit, over, m, t, pull_x, over_x,
                      &energy);
            energy *= over_m;
            double closing = component * (f.pz - y_end * f.px) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            iterations++;
            double now = fabs(closing * moved) / energy;
            if (finished(now, last, now, 0))
                break;
            last = now;
        }
        u[0] = nu / (part * part);
        remember(&w, u, 1);
#endif
        double impulse = (f.pz - y_end * f.px) * over_end;
        px = f.px + y_end * impulse;
        pz = f.pz - impulse;
        x = f.x;
        y = y_end;
        normal = normal_end;
    }
    store((vector){py, px, pz}, state + 2);
    state[0] = y;
    state[1] = x;
    return iterations;
}
