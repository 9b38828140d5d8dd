/* Inhomogeneous ball on a rotating table, on R^2 x SO(3) in the body frame, Cayley.

   The constraints x' - r (R omega)_2 + Theta y = 0, y' + r (R omega)_1 - Theta x = 0 involve the
   first two rows a, b of R only. Velocities, momenta and Theta are in units of 2 / flight time of
   the stage, so that the flight is x -> x + 2 v, R -> R cay with s = omega, and no step size is
   left.

   With -DTWO_ROWS the third row of R is not carried but completed when the run ends, which is the
   same scheme with less work; without it all of R is moved and restored in every step.

   The explicit flight turns about the principal axes one after the other, each by a Cayley
   rotation; the momentum turns with it.

   parameters: m, r, I1, I2, I3, Theta.
   state: x, y, R row by row (9), momentum after the impact (5).
   All functions return the number of Newton iterations, or FAILED. */
#include "principal_axes.h"

#ifdef TWO_ROWS
enum { CARRIED_ROWS = 2 };
#else
enum { CARRIED_ROWS = 3 };
#endif

typedef struct {
    axes body;
    double inverse_mass, r, theta;
} ball;

typedef struct {
    vector a, b, c; /* rows */
} rotation;

typedef struct {
    double x, y;
    vector spin;
} momentum;

/* Where the constraints are evaluated: r a, r b, the same over I, and C = mu G^-1 mu^T. */
typedef struct {
    double x, y;
    vector a, b, a_over, b_over;
    double c11, c12, c22, det;
} node;

/* Inverse of the Cholesky factor of C. */
typedef struct {
    double i11, i21, i22;
} lower;

typedef struct {
    double first, second;
} pair;

static ball make_ball(const double *p, double unit)
{
    return (ball){make_axes(load(p + 2)), 1.0 / p[0], p[1], unit * p[5]};
}

/* R - (R R^T - 1) R / 2, from the carried rows. */
INLINE rotation restored(rotation R)
{
    double aa = 0.5 - 0.5 * dot(R.a, R.a), bb = 0.5 - 0.5 * dot(R.b, R.b);
    double ab = -0.5 * dot(R.a, R.b);
    rotation S = {add(add(R.a, aa, R.a), ab, R.b), add(add(R.b, bb, R.b), ab, R.a), R.c};
    if (CARRIED_ROWS == 3) {
        double cc = 0.5 - 0.5 * dot(R.c, R.c);
        double ac = -0.5 * dot(R.a, R.c), bc = -0.5 * dot(R.b, R.c);
        S.a = add(S.a, ac, R.c);
        S.b = add(S.b, bc, R.c);
        S.c = add(add(add(R.c, cc, R.c), ac, R.a), bc, R.b);
    }
    return S;
}

INLINE node node_at(const ball *g, double x, double y, vector a, vector b)
{
    node n = {.x = x, .y = y, .a = scaled(g->r, a), .b = scaled(g->r, b)};
    n.a_over = by_entry(n.a, g->body.inverse);
    n.b_over = by_entry(n.b, g->body.inverse);
    n.c11 = g->inverse_mass + dot(n.b, n.b_over);
    n.c22 = g->inverse_mass + dot(n.a, n.a_over);
    n.c12 = -dot(n.a, n.b_over);
    n.det = n.c11 * n.c22 - n.c12 * n.c12;
    return n;
}

/* mu G^-1 p */
INLINE pair normal_velocity(const ball *g, const node *n, momentum p)
{
    return (pair){g->inverse_mass * p.x - dot(n->b_over, p.spin),
                  g->inverse_mass * p.y + dot(n->a_over, p.spin)};
}

/* mu G^-1 p - mu Y */
INLINE pair violation(const ball *g, const node *n, momentum p)
{
    pair v = normal_velocity(g, n, p);
    return (pair){v.first + g->theta * n->y, v.second - g->theta * n->x};
}

/* p + mu^T lambda */
INLINE momentum pushed(const node *n, momentum p, pair lambda)
{
    return (momentum){p.x + lambda.first, p.y + lambda.second,
                      add(add(p.spin, -lambda.first, n->b), lambda.second, n->a)};
}

/* p - 2 mu^T C^-1 v */
INLINE momentum struck(const node *n, momentum p, pair v)
{
    double factor = -2.0 / n->det;
    pair lambda = {factor * (n->c22 * v.first - n->c12 * v.second),
                   factor * (n->c11 * v.second - n->c12 * v.first)};
    return pushed(n, p, lambda);
}

INLINE lower inverse_cholesky(const node *n)
{
    double over = 1.0 / n->c11, i11 = sqrt(over), i22 = sqrt(n->c11 / n->det);
    return (lower){i11, -n->c12 * over * i22, i22};
}

INLINE pair times(lower l, pair v)
{
    return (pair){l.i11 * v.first, l.i21 * v.first + l.i22 * v.second};
}

INLINE pair transposed_times(lower l, pair v)
{
    return (pair){l.i11 * v.first + l.i21 * v.second, l.i22 * v.second};
}

INLINE momentum larger(momentum p, double factor)
{
    return (momentum){factor * p.x, factor * p.y, scaled(factor, p.spin)};
}

/* N v = mu^T L^-T v */
INLINE momentum normal_vector(const node *n, lower l, pair v)
{
    return pushed(n, (momentum){0}, transposed_times(l, v));
}

/* W^T v, W the orthogonal polar factor of the overlap L1^-1 (mu1 G^-1 mu0^T) L0^-T. */
INLINE pair matched(const ball *g, const node *n0, lower l0, const node *n1, lower l1,
                           pair v)
{
    double m11 = g->inverse_mass + dot(n1->b, n0->b_over), m12 = -dot(n1->b, n0->a_over);
    double m21 = -dot(n1->a, n0->b_over), m22 = g->inverse_mass + dot(n1->a, n0->a_over);
    double sign = m11 * m22 - m12 * m21 >= 0.0 ? 1.0 : -1.0;
    pair left = times(l1, (pair){m11, m21}), right = times(l1, (pair){m12, m22});
    double a11 = left.first * l0.i11, a21 = left.second * l0.i11;
    double a12 = left.first * l0.i21 + right.first * l0.i22;
    double a22 = left.second * l0.i21 + right.second * l0.i22;
    double c = a11 + sign * a22, s = a21 - sign * a12, length = 1.0 / sqrt(c * c + s * s);
    return (pair){length * (c * v.first + s * v.second),
                  length * sign * (c * v.second - s * v.first)};
}

/* Inverse Jacobian of the two closing equations. */
typedef struct {
    double j11, j12, j21, j22;
} slope;

/* Broyden's formula for the inverse, left alone where the last step was round-off. */
INLINE void learn(slope *j, pair moved, pair change, double energy)
{
    double e1 = j->j11 * change.first + j->j12 * change.second;
    double e2 = j->j21 * change.first + j->j22 * change.second;
    double along = moved.first * e1 + moved.second * e2;
    double square = moved.first * moved.first + moved.second * moved.second;
    if (square > LEAST_MOVE * energy && !believable(along, square)) {
        *j = (slope){-0.5, 0.0, 0.0, -0.5};
    } else if (square > LEAST_MOVE * energy) {
        double f = 1.0 / along, g1 = f * (moved.first - e1), g2 = f * (moved.second - e2);
        double row1 = moved.first * j->j11 + moved.second * j->j21;
        double row2 = moved.first * j->j12 + moved.second * j->j22;
        *j = (slope){j->j11 + g1 * row1, j->j12 + g1 * row2, j->j21 + g2 * row1,
                     j->j22 + g2 * row2};
    }
}

static rotation load_rotation(const double *a)
{
    return (rotation){load(a), load(a + 3), load(a + 6)};
}

static void store_state(double x, double y, rotation R, momentum p, double unit, double *state)
{
    state[0] = x;
    state[1] = y;
    store(R.a, state + 2);
    store(R.b, state + 5);
    store(CARRIED_ROWS == 3 ? R.c : cross(R.a, R.b), state + 8);
    state[11] = p.x / unit;
    state[12] = p.y / unit;
    store(scaled(1.0 / unit, p.spin), state + 13);
}

static momentum load_momentum(const double *p, double unit)
{
    return (momentum){unit * p[0], unit * p[1], scaled(unit, load(p + 2))};
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.5 * h;
    const ball g = make_ball(parameters, unit);
    double x = state[0], y = state[1], u[3];
    rotation R = load_rotation(state + 2);
    momentum p = load_momentum(state + 11, unit);
    int64_t iterations = 0;
    warm_start w;
    store(by_entry(p.spin, g.body.inverse), u);
    fill(&w, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&w, 0, u, 3);
        vector s = load(u), pi = by_entry(g.body.inertia, s);
        double last = BEFORE_FIRST;
        const double straight = g.inverse_mass * (p.x * p.x + p.y * p.y) + TINY;
        for (int i = 0;; i++) {
            double work = 0.0, energy = straight;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g.body, p.spin, &s, &pi, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        store(s, u);
        remember(&w, u, 3);
        double factor = cayley_factor(s);
        R.a = turned(R.a, s, factor);
        R.b = turned(R.b, s, factor);
        if (CARRIED_ROWS == 3)
            R.c = turned(R.c, s, factor);
        x += 2.0 * g.inverse_mass * p.x;
        y += 2.0 * g.inverse_mass * p.y;
        node n = node_at(&g, x, y, R.a, R.b);
        p.spin = legendre_plus(&g.body, s, pi);
        p = struck(&n, p, violation(&g, &n, p));
        R = restored(R);
    }
    store_state(x, y, R, p, unit, state);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    ball g = make_ball(parameters, unit);
    rotation R = load_rotation(state + 2);
    momentum p = load_momentum(state + 11, last_unit);
    node start = node_at(&g, state[0], state[1], R.a, R.b);
    lower l0 = inverse_cholesky(&start);
    double u[8] = {0.0};
    slope j = {-0.5, 0.0, 0.0, -0.5};
    int64_t iterations = 0;
    warm_start w;
    store(scaled(1.0 / size_of(STAGES - 1), by_entry(p.spin, g.body.inverse)), u);
    store(load(u), u + 3);
    fill(&w, u, 8);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part;
        g.theta = part * unit * parameters[5];
        p = larger(p, growth_of(stage));
        j = (slope){regrown(j.j11, stage), growth_of(stage) * j.j12, growth_of(stage) * j.j21,
                    regrown(j.j22, stage)};
        extrapolate(&w, stage, u, 8);
        vector out = scaled(part, load(u)), home = scaled(part, load(u + 3));
        /* columns of N0 = mu^T L0^-T */
        const momentum first = normal_vector(&start, l0, (pair){1.0, 0.0});
        const momentum second = normal_vector(&start, l0, (pair){0.0, 1.0});
        double factor_out, factor_home, last = BEFORE_FIRST;
        pair nu = {part * part * part * u[6], part * part * part * u[7]};
        pair moved = {0.0, 0.0}, before = {0.0, 0.0}, returned;
        vector flown_out, flown_home; /* without the last change of nu */
        momentum arrived;
        node end;
        lower l1;
        for (int i = 0;; i++) {
            double work = 0.0;
            if (i == MAX_ITERATIONS)
                return FAILED;
            vector pi_out = by_entry(g.body.inertia, out), pi_home = by_entry(g.body.inertia, home);
            momentum q = pushed(&start, p, transposed_times(l0, nu));
            double energy = g.inverse_mass * (q.x * q.x + q.y * q.y) + TINY;
            inverted by_out = newton(&g.body, q.spin, &out, &pi_out, &work, &energy);
            q.spin = legendre_plus(&g.body, out, pi_out);
            factor_out = cayley_factor(out);
            vector a = turned(R.a, out, factor_out), b = turned(R.b, out, factor_out);
            node middle = node_at(&g, start.x + 2.0 * g.inverse_mass * q.x,
                                  start.y + 2.0 * g.inverse_mass * q.y, a, b);
            q = struck(&middle, q, violation(&g, &middle, q));
            energy += g.inverse_mass * (q.x * q.x + q.y * q.y);
            inverted by_home = newton(&g.body, q.spin, &home, &pi_home, &work, &energy);
            arrived = (momentum){q.x, q.y, legendre_plus(&g.body, home, pi_home)};
            factor_home = cayley_factor(home);
            end = node_at(&g, middle.x + 2.0 * g.inverse_mass * q.x,
                          middle.y + 2.0 * g.inverse_mass * q.y, turned(a, home, factor_home),
                          turned(b, home, factor_home));
            l1 = inverse_cholesky(&end);
            returned = times(l1, violation(&g, &end, arrived));
            pair closing = matched(&g, &start, l0, &end, l1, returned);
            closing = (pair){closing.first - nu.first, closing.second - nu.second};

            learn(&j, moved, (pair){closing.first - before.first, closing.second - before.second},
                  energy);
            moved.first = -(j.j11 * closing.first + j.j12 * closing.second);
            moved.second = -(j.j21 * closing.first + j.j22 * closing.second);
            before = closing;
            nu = (pair){nu.first + moved.first, nu.second + moved.second};
            flown_out = out;
            flown_home = home;
            /* both flights follow nu, the second one after the impact; by column, so that only
               the last product waits for nu */
            out = add(out, moved.first, applied(&by_out, first.spin));
            out = add(out, moved.second, applied(&by_out, second.spin));
            momentum hit = struck(&middle, first, normal_velocity(&g, &middle, first));
            home = add(home, moved.first, applied(&by_home, hit.spin));
            hit = struck(&middle, second, normal_velocity(&g, &middle, second));
            home = add(home, moved.second, applied(&by_home, hit.spin));
            double left = fabs(closing.first * moved.first) + fabs(closing.second * moved.second);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        store(scaled(over, out), u);
        store(scaled(over, home), u + 3);
        u[6] = over * over * over * nu.first;
        u[7] = over * over * over * nu.second;
        remember(&w, u, 8);
        pair lambda = transposed_times(l1, returned);
        p = pushed(&end, arrived, (pair){-lambda.first, -lambda.second});
        /* end holds the rows a, b times r */
        R.a = scaled(1.0 / g.r, end.a);
        R.b = scaled(1.0 / g.r, end.b);
        if (CARRIED_ROWS == 3)
            R.c = turned(turned(R.c, flown_out, factor_out), flown_home, factor_home);
        R = restored(R);
        start = end;
        l0 = l1;
    }
    store_state(start.x, start.y, R, p, last_unit, state);
    return iterations;
}

/* cos, sin of the Cayley rotation with s = tan(half the angle). */
typedef struct {
    double cosine, sine;
} angle;

INLINE angle cayley(double s)
{
    double factor = 1.0 / (1.0 + s * s);
    return (angle){(1.0 - s * s) * factor, 2.0 * s * factor};
}

/* A row times the rotation, and a momentum moved along: both as R^T v. */
INLINE vector about_first(vector v, angle t)
{
    return (vector){v.x, t.cosine * v.y + t.sine * v.z, t.cosine * v.z - t.sine * v.y};
}

INLINE vector about_second(vector v, angle t)
{
    return (vector){t.cosine * v.x - t.sine * v.z, v.y, t.cosine * v.z + t.sine * v.x};
}

INLINE vector about_third(vector v, angle t)
{
    return (vector){t.cosine * v.x + t.sine * v.y, t.cosine * v.y - t.sine * v.x, v.z};
}

/* What a flight turned by, first to last or last to first. */
typedef struct {
    angle first, second, third;
} turns;

INLINE vector outward(vector v, const turns *t)
{
    return about_third(about_second(about_first(v, t->first), t->second), t->third);
}

INLINE vector homeward(vector v, const turns *t)
{
    return about_first(about_second(about_third(v, t->third), t->second), t->first);
}

/* The turn about one axis, whose energy is added. */
INLINE angle turned_by(double inverse, double momentum, double *energy)
{
    double spin = inverse * momentum;
    *energy += spin * momentum;
    return cayley(spin);
}

/* Turns the spin momentum and adds its energy; outward and home. */
INLINE turns spin_out(const axes *g, vector *p, double *energy)
{
    turns t;
    t.first = turned_by(g->inverse.x, p->x, energy);
    *p = about_first(*p, t.first);
    t.second = turned_by(g->inverse.y, p->y, energy);
    *p = about_second(*p, t.second);
    t.third = turned_by(g->inverse.z, p->z, energy);
    *p = about_third(*p, t.third);
    return t;
}

INLINE turns spin_home(const axes *g, vector *p, double *energy)
{
    turns t;
    t.third = turned_by(g->inverse.z, p->z, energy);
    *p = about_third(*p, t.third);
    t.second = turned_by(g->inverse.y, p->y, energy);
    *p = about_second(*p, t.second);
    t.first = turned_by(g->inverse.x, p->x, energy);
    *p = about_first(*p, t.first);
    return t;
}

int64_t splitting(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    ball g = make_ball(parameters, unit);
    rotation R = load_rotation(state + 2);
    momentum p = load_momentum(state + 11, last_unit);
    node start = node_at(&g, state[0], state[1], R.a, R.b);
    lower l0 = inverse_cholesky(&start);
    double u[2] = {0.0};
    slope j = {-0.5, 0.0, 0.0, -0.5};
    int64_t iterations = 0;
    warm_start w;
    fill(&w, u, 2);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / (part * part * part);
        g.theta = part * unit * parameters[5];
        p = larger(p, growth_of(stage));
        j = (slope){regrown(j.j11, stage), growth_of(stage) * j.j12, growth_of(stage) * j.j21,
                    regrown(j.j22, stage)};
        extrapolate(&w, stage, u, 2);
        double last = BEFORE_FIRST;
        pair nu = {u[0] / over, u[1] / over}, moved = {0.0, 0.0}, before = {0.0, 0.0}, returned;
        momentum q;
        node end;
        lower l1;
        turns out, home;
        for (int i = 0;; i++) {
            if (i == MAX_ITERATIONS)
                return FAILED;
            q = pushed(&start, p, transposed_times(l0, nu));
            double energy = g.inverse_mass * (q.x * q.x + q.y * q.y) + TINY;
            out = spin_out(&g.body, &q.spin, &energy);
            vector a = outward(R.a, &out), b = outward(R.b, &out);
            node middle = node_at(&g, start.x + 2.0 * g.inverse_mass * q.x,
                                  start.y + 2.0 * g.inverse_mass * q.y, a, b);
            q = struck(&middle, q, violation(&g, &middle, q));
            energy += g.inverse_mass * (q.x * q.x + q.y * q.y);
            home = spin_home(&g.body, &q.spin, &energy);
            end = node_at(&g, middle.x + 2.0 * g.inverse_mass * q.x,
                          middle.y + 2.0 * g.inverse_mass * q.y, homeward(a, &home),
                          homeward(b, &home));
            l1 = inverse_cholesky(&end);
            returned = times(l1, violation(&g, &end, q));
            pair closing = matched(&g, &start, l0, &end, l1, returned);
            closing = (pair){closing.first - nu.first, closing.second - nu.second};
            learn(&j, moved, (pair){closing.first - before.first, closing.second - before.second},
                  energy);
            moved.first = -(j.j11 * closing.first + j.j12 * closing.second);
            moved.second = -(j.j21 * closing.first + j.j22 * closing.second);
            before = closing;
            nu = (pair){nu.first + moved.first, nu.second + moved.second};
            double left = fabs(closing.first * moved.first) + fabs(closing.second * moved.second);
            iterations++;
            double now = left / energy;
            if (finished(now, last, now, 0))
                break;
            last = now;
        }
        u[0] = over * nu.first;
        u[1] = over * nu.second;
        remember(&w, u, 2);
        pair lambda = transposed_times(l1, returned);
        p = pushed(&end, q, (pair){-lambda.first, -lambda.second});
        R.a = scaled(1.0 / g.r, end.a);
        R.b = scaled(1.0 / g.r, end.b);
        if (CARRIED_ROWS == 3)
            R.c = homeward(outward(R.c, &out), &home);
        R = restored(R);
        start = end;
        l0 = l1;
    }
    store_state(start.x, start.y, R, p, last_unit, state);
    return iterations;
}
