/* Veselova's body with <Omega, gamma> = c and V = <weight, gamma>, on S^2 x| SO(3), Cayley.

   gamma, the vertical seen from the body, is moved by gamma -> cay^T gamma and is the constraint as
   well: C = gamma . I^-1 gamma. The force on the spin is gamma x weight. Momenta, c and the force
   are in units of 2 / flight time of the stage, so that no step size is left.

   parameters: I1, I2, I3, c, weight (3).  state: gamma (3), momentum after the impact (3).
   Both functions return the number of Newton iterations, or FAILED. */
#include "principal_axes.h"

/* Where the constraint is evaluated: gamma, I^-1 gamma, 1 / C, c |gamma|^2. */
typedef struct {
    vector gamma, raised;
    double over, drift;
} node;

INLINE node node_at(const axes *g, vector gamma, double c)
{
    vector raised = by_entry(gamma, g->inverse);
    return (node){gamma, raised, 1.0 / dot(gamma, raised), c * dot(gamma, gamma)};
}

/* R(p) = p - 2 mu^T C^-1 (mu G^-1 p - c) */
INLINE vector struck(const node *n, vector p)
{
    return add(p, -2.0 * n->over * (dot(n->raised, p) - n->drift), n->gamma);
}

/* gamma moved back to the sphere, to round-off */
INLINE vector restored(vector gamma)
{
    return scaled(1.5 - 0.5 * dot(gamma, gamma), gamma);
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.5 * h, c = unit * parameters[3];
    const axes g = make_axes(load(parameters));
    /* half the kick of a step at either end */
    const vector weight = scaled(unit * unit, load(parameters + 4));
    vector gamma = load(state), p = scaled(unit, load(state + 3));
    int64_t iterations = 0;
    double u[3];
    warm_start w;
    store(by_entry(p, g.inverse), u);
    fill(&w, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&w, 0, u, 3);
        vector m = add(p, 1.0, cross(gamma, weight));
        vector s = load(u), pi = by_entry(g.inertia, s);
        double last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g, m, &s, &pi, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        store(s, u);
        remember(&w, u, 3);
        gamma = turned(gamma, s, cayley_factor(s));
        node n = node_at(&g, gamma, c);
        p = struck(&n, add(legendre_plus(&g, s, pi), 1.0, cross(gamma, weight)));
        gamma = restored(gamma);
    }
    store(gamma, state);
    store(scaled(1.0 / unit, p), state + 3);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    const axes g = make_axes(load(parameters));
    const vector pull = load(parameters + 4);
    vector gamma = load(state), p = scaled(last_unit, load(state + 3));
    node end = node_at(&g, gamma, 0.0);
    double inverse = -0.5, root = sqrt(end.over), u[7] = {0.0};
    int64_t iterations = 0;
    warm_start w;
    store(scaled(1.0 / size_of(STAGES - 1), by_entry(p, g.inverse)), u);
    store(load(u), u + 3);
    fill(&w, u, 7);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part, c = part * unit * parameters[3];
        const vector weight = scaled(2.0 * unit * unit * part * part, pull);
        /* the kick follows the impact's gamma, the normal that of the start */
        const vector normal = scaled(root, end.gamma);
        p = scaled(growth_of(stage), p);
        inverse = regrown(inverse, stage);
        extrapolate(&w, stage, u, 7);
        vector out = scaled(part, load(u)), home = scaled(part, load(u + 3)), arrived;
        double nu = part * part * part * u[6], last = BEFORE_FIRST, moved = 0.0, before = 0.0;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            vector pi_out = by_entry(g.inertia, out), pi_home = by_entry(g.inertia, home);
            inverted by_out = newton(&g, add(p, nu, normal), &out, &pi_out, &work, &energy);
            node middle = node_at(&g, turned(gamma, out, cayley_factor(out)), c);
            vector kick = cross(middle.gamma, weight);
            vector hit = struck(&middle, add(legendre_plus(&g, out, pi_out), 1.0, kick));
            hit = add(hit, 1.0, kick);
            inverted by_home = newton(&g, hit, &home, &pi_home, &work, &energy);
            arrived = legendre_plus(&g, home, pi_home);
            end = node_at(&g, turned(middle.gamma, home, cayley_factor(home)), c);
            root = sqrt(end.over);
            double closing = root * (dot(end.raised, arrived) - end.drift) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            /* both flights follow nu, the second one after the impact */
            out = add(out, moved, applied(&by_out, normal));
            vector turned_round = add(normal, -2.0 * middle.over * dot(middle.raised, normal),
                                      middle.gamma);
            home = add(home, moved, applied(&by_home, turned_round));
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
        p = add(arrived, -end.over * (dot(end.raised, arrived) - end.drift), end.gamma);
        gamma = restored(end.gamma);
    }
    store(gamma, state);
    store(scaled(1.0 / last_unit, p), state + 3);
    return iterations;
}
