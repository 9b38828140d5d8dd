/* Two-wheeled robot with a detent k sin psi_1 on its first wheel, on R x R x SE(2), Cayley: base
   psi_1, velocities (psi_1', psi_2', omega, u, v).

   The constraints v = 0, u - c omega = R psi_1', u + c omega = R psi_2' are constant, and what they
   leave is spanned by turning (-c/R, c/R, 1, 0, 0) and driving (1/R, 1/R, 0, 1, 0), which are
   orthogonal in the metric; so are the normal directions below, and 3 x 3 matrices do not come up.
   Momenta are in units of 2 / flight time of the stage. Wheels fly explicitly, the body as in
   planar_body.h.

   parameters: m_0, J_0, l, m_1, J_2, R, c, k.
   state: psi_1, momentum after the impact (5): wheels, then body.
   Both functions return the number of Newton iterations, or FAILED. */
#include "planar_body.h"

typedef struct {
    double first, second; /* wheels */
    vector body;
} momentum;

typedef struct {
    planar body;
    double wheel, over_wheel;       /* J_2 and 1 / J_2 */
    double over_radius, arm;        /* 1 / R, c / R */
    double over_turning, over_driving;
    /* lengths of (-R, -R, 0, 2, 0), (0, 0, 0, 0, 1), (-R, R, -2c, 0, -2cK/I) in G^-1, inverted */
    double forward, sideways, twist;
    double radius, track;
} robot;

static robot make_robot(const double *p)
{
    double m = p[0] + 2.0 * p[3], K = p[0] * p[2], R = p[5], c = p[6];
    double I = p[1] + K * p[2] + 2.0 * p[3] * c * c + p[4];
    robot g = {.body = {m, I, K}, .wheel = p[4], .over_wheel = 1.0 / p[4], .over_radius = 1.0 / R,
               .arm = c / R, .radius = R, .track = c};
    g.over_turning = 1.0 / (I + 2.0 * p[4] * g.arm * g.arm);
    g.over_driving = 1.0 / (m + 2.0 * p[4] / (R * R));
    g.forward = 1.0 / sqrt(2.0 * R * R / p[4] + 4.0 / m);
    g.sideways = 1.0 / sqrt(I / (m * I - K * K));
    g.twist = 1.0 / sqrt(2.0 * R * R / p[4] + 4.0 * c * c / I);
    return g;
}

/* P* p: the momentum of what p turns and drives. */
INLINE momentum projection(const robot *g, momentum p)
{
    double omega = g->over_turning * (p.body.x + g->arm * (p.second - p.first));
    double u = g->over_driving * (p.body.y + g->over_radius * (p.first + p.second));
    double same = g->wheel * g->over_radius * u, opposite = g->wheel * g->arm * omega;
    return (momentum){same - opposite, same + opposite,
                      {g->body.I * omega, g->body.m * u, g->body.c * omega}};
}

/* (P* - Q*) p */
INLINE momentum struck(const robot *g, momentum p)
{
    momentum kept = projection(g, p);
    return (momentum){2.0 * kept.first - p.first, 2.0 * kept.second - p.second,
                      add(scaled(2.0, kept.body), -1.0, p.body)};
}

/* Components of p along the normal directions; nu.x forward, nu.y sideways, nu.z twist. */
INLINE vector components(const robot *g, momentum p)
{
    double arm = g->radius * g->over_wheel, K = g->body.c / g->body.I;
    double t = 2.0 * g->track / g->body.I;
    return (vector){g->forward * (2.0 / g->body.m * p.body.y - arm * (p.first + p.second)),
                    (p.body.z - K * p.body.x) / g->sideways,
                    g->twist * (arm * (p.second - p.first) - t * p.body.x)};
}

/* N nu */
INLINE momentum normal_vector(const robot *g, vector nu)
{
    double along = g->forward * nu.x, twist = g->twist * nu.z, turn = -2.0 * g->track * twist;
    return (momentum){-g->radius * (along + twist), -g->radius * (along - twist),
                      {turn, 2.0 * along, turn * g->body.c / g->body.I + g->sideways * nu.y}};
}

INLINE momentum plus(momentum a, momentum b)
{
    return (momentum){a.first + b.first, a.second + b.second, add(a.body, 1.0, b.body)};
}

static momentum load_momentum(const double *p, double unit)
{
    return (momentum){unit * p[0], unit * p[1], scaled(unit, load(p + 2))};
}

static void store_momentum(momentum p, double unit, double *to)
{
    to[0] = p.first / unit;
    to[1] = p.second / unit;
    store(scaled(1.0 / unit, p.body), to + 2);
}

INLINE double energy_of_wheels(const robot *g, momentum p)
{
    return g->over_wheel * (p.first * p.first + p.second * p.second);
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    /* half the kick of a step at either end */
    const double unit = 0.5 * h, detent = unit * unit * parameters[7];
    const robot g = make_robot(parameters);
    double psi = state[0], u[3], push = detent * cos(psi);
    momentum p = load_momentum(state + 1, unit);
    int64_t iterations = 0;
    warm_start w;
    store(velocity(&g.body, p.body), u);
    fill(&w, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        p.first -= push;
        const double straight = energy_of_wheels(&g, p) + TINY;
        extrapolate(&w, 0, u, 3);
        vector s = load(u);
        parts q = at(&g.body, s);
        double last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = straight;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g.body, p.body, &s, &q, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        store(s, u);
        remember(&w, u, 3);
        psi += 2.0 * g.over_wheel * p.first;
        push = detent * cos(psi);
        p = struck(&g, (momentum){p.first - push, p.second, legendre_plus(s, &q)});
    }
    state[0] = psi;
    store_momentum(p, unit, state + 1);
    return iterations;
}

/* Broyden's update of the inverse of three closing equations, its columns a, b, c. */
typedef struct {
    vector a, b, c;
} square;

INLINE vector times(const square *j, vector v)
{
    return add(add(scaled(v.x, j->a), v.y, j->b), v.z, j->c);
}

INLINE void learn(square *j, vector moved, vector change, double energy)
{
    double length = dot(moved, moved);
    if (length <= LEAST_MOVE * energy)
        return;
    vector expected = times(j, change);
    double along = dot(moved, expected);
    if (!believable(along, length)) {
        *j = (square){{-0.5, 0.0, 0.0}, {0.0, -0.5, 0.0}, {0.0, 0.0, -0.5}};
        return;
    }
    vector rest = scaled(1.0 / along, add(moved, -1.0, expected));
    j->a = add(j->a, dot(moved, j->a), rest);
    j->b = add(j->b, dot(moved, j->b), rest);
    j->c = add(j->c, dot(moved, j->c), rest);
}

INLINE void regrow(square *j, int stage)
{
    const double f = growth_of(stage);
    if (STAGES == 1)
        return;
    j->a = (vector){regrown(j->a.x, stage), f * j->a.y, f * j->a.z};
    j->b = (vector){f * j->b.x, regrown(j->b.y, stage), f * j->b.z};
    j->c = (vector){f * j->c.x, f * j->c.y, regrown(j->c.z, stage)};
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    const robot g = make_robot(parameters);
    const planar *body = &g.body;
    double psi = state[0], u[9] = {0.0};
    momentum p = load_momentum(state + 1, last_unit);
    square inverse = {{-0.5, 0.0, 0.0}, {0.0, -0.5, 0.0}, {0.0, 0.0, -0.5}};
    int64_t iterations = 0;
    warm_start w;
    store(scaled(1.0 / size_of(STAGES - 1), velocity(body, p.body)), u);
    store(load(u), u + 3);
    fill(&w, u, 9);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part, cube = part * part * part;
        const double detent = 2.0 * unit * unit * part * part * parameters[7];
        p = (momentum){growth_of(stage) * p.first, growth_of(stage) * p.second,
                       scaled(growth_of(stage), p.body)};
        regrow(&inverse, stage);
        extrapolate(&w, stage, u, 9);
        vector out = scaled(part, load(u)), home = scaled(part, load(u + 3));
        vector nu = scaled(cube, load(u + 6)), moved = {0}, before = {0};
        double last = BEFORE_FIRST, end;
        momentum arrived;
        for (int i = 0;; i++) {
            double work = 0.0;
            if (i == MAX_ITERATIONS)
                return FAILED;
            momentum lent = plus(p, normal_vector(&g, nu));
            double energy = energy_of_wheels(&g, lent) + TINY;
            parts q_out = at(body, out), q_home = at(body, home);
            eliminated j_out = newton(body, lent.body, &out, &q_out, &work, &energy);
            double middle = psi + 2.0 * g.over_wheel * lent.first;
            /* the kick before the impact and after it */
            double push = detent * cos(middle);
            lent.first -= push;
            lent.body = legendre_plus(out, &q_out);
            momentum hit = struck(&g, lent);
            hit.first -= push;
            energy += energy_of_wheels(&g, hit);
            eliminated j_home = newton(body, hit.body, &home, &q_home, &work, &energy);
            end = middle + 2.0 * g.over_wheel * hit.first;
            arrived = (momentum){hit.first, hit.second, legendre_plus(home, &q_home)};
            vector closing = add(components(&g, arrived), -1.0, nu);
            learn(&inverse, moved, add(closing, -1.0, before), energy);
            moved = scaled(-1.0, times(&inverse, closing));
            before = closing;
            nu = add(nu, 1.0, moved);
            /* both flights follow nu; the impact turns normal directions round */
            vector push_body = normal_vector(&g, moved).body;
            out = add(out, 1.0, solved(&j_out, push_body));
            home = add(home, -1.0, solved(&j_home, push_body));
            double left = size(closing, moved);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        store(scaled(over, out), u);
        store(scaled(over, home), u + 3);
        store(scaled(over * over * over, nu), u + 6);
        remember(&w, u, 9);
        p = projection(&g, arrived);
        psi = end;
    }
    state[0] = psi;
    store_momentum(p, last_unit, state + 1);
    return iterations;
}
