/* Inhomogeneous ball on a rotating table, on R^2 x SO(3) in the body frame, Cayley.

   The constraints x' - r (R omega)_2 + Theta y = 0, y' + r (R omega)_1 - Theta x = 0 involve the
   first two rows a, b of R only. Velocities, momenta and Theta are in units of 2 / flight time, so
   that the flight is x -> x + 2 v, R -> R cay with s = omega, and no step size is left.

   With -DTWO_ROWS the third row of R is not carried but completed when the run ends, which is the
   same scheme with less work; without it all of R is moved and restored in every step.

   parameters: m, r, I1, I2, I3, Theta.
   state: x, y, R row by row (9), momentum after the impact (5).
   Both functions return the number of Newton iterations, or FAILED. */
#include "iteration.h"

#ifdef TWO_ROWS
enum { CARRIED_ROWS = 2 };
#else
enum { CARRIED_ROWS = 3 };
#endif

typedef struct {
    vector inertia, inverse_inertia, twist; /* twist = (I3 - I2, I1 - I3, I2 - I1) */
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
    vector I = load(p + 2), over = {1.0 / I.x, 1.0 / I.y, 1.0 / I.z};
    vector twist = {I.z - I.y, I.x - I.z, I.y - I.x};
    return (ball){I, over, twist, 1.0 / p[0], p[1], unit * p[5]};
}

INLINE vector by_entry(vector a, vector b)
{
    return (vector){a.x * b.x, a.y * b.y, a.z * b.z};
}

INLINE vector turned(vector row, vector s, double factor)
{
    vector once = cross(row, s);
    return add(row, factor, add(once, 1.0, cross(once, s)));
}

INLINE double cayley_factor(vector s)
{
    return 2.0 / (1.0 + dot(s, s));
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
    n.a_over = by_entry(n.a, g->inverse_inertia);
    n.b_over = by_entry(n.b, g->inverse_inertia);
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

/* One Newton update of FL-(s) = m; pi = I s is updated with s. Adds to work and energy, and returns
   the inverse of the Jacobian. */
INLINE inverted newton(const ball *g, vector m, vector *s, vector *pi, double *work,
                       double *energy)
{
    const vector t = g->twist;
    double k = dot(*s, *pi), xy = s->x * s->y, xz = s->x * s->z, yz = s->y * s->z;
    vector r = {pi->x + t.x * yz + k * s->x - m.x, pi->y + t.y * xz + k * s->y - m.y,
                pi->z + t.z * xy + k * s->z - m.z};
    vector p2 = scaled(2.0, *pi);
    vector a = {g->inertia.x + k + s->x * p2.x, t.y * s->z + s->y * p2.x,
                t.z * s->y + s->z * p2.x};
    vector b = {t.x * s->z + s->x * p2.y, g->inertia.y + k + s->y * p2.y,
                t.z * s->x + s->z * p2.y};
    vector c = {t.x * s->y + s->x * p2.z, t.y * s->x + s->y * p2.z,
                g->inertia.z + k + s->z * p2.z};
    inverted inverse = inverse_of(a, b, c);
    vector u = applied(&inverse, r);
    *work += size(r, u);
    *s = add(*s, -1.0, u);
    *pi = by_entry(g->inertia, *s);
    *energy += dot(*s, *pi);
    return inverse;
}

INLINE vector legendre_plus(const ball *g, vector s, vector pi)
{
    vector twisted = {g->twist.x * s.y * s.z, g->twist.y * s.x * s.z, g->twist.z * s.x * s.y};
    return add(add(pi, -1.0, twisted), dot(s, pi), s);
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
    store(by_entry(p.spin, g.inverse_inertia), u);
    fill(&w, u, 3);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&w, u, 3);
        vector s = load(u), pi = by_entry(g.inertia, s);
        double last = BEFORE_FIRST;
        const double straight = g.inverse_mass * (p.x * p.x + p.y * p.y) + TINY;
        for (int i = 0;; i++) {
            double work = 0.0, energy = straight;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(&g, p.spin, &s, &pi, &work, &energy);
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
        p.spin = legendre_plus(&g, s, pi);
        p = struck(&n, p, violation(&g, &n, p));
        R = restored(R);
    }
    store_state(x, y, R, p, unit, state);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h;
    const ball g = make_ball(parameters, unit);
    rotation R = load_rotation(state + 2);
    momentum p = load_momentum(state + 11, unit);
    node start = node_at(&g, state[0], state[1], R.a, R.b);
    lower l0 = inverse_cholesky(&start);
    double u[8] = {0.0}, j11 = -0.5, j12 = 0.0, j21 = 0.0, j22 = -0.5;
    int64_t iterations = 0;
    warm_start w;
    store(by_entry(p.spin, g.inverse_inertia), u);
    store(load(u), u + 3);
    fill(&w, u, 8);
    for (int64_t step = 0; step < steps; step++) {
        extrapolate(&w, u, 8);
        vector out = load(u), home = load(u + 3);
        /* columns of N0 = mu^T L0^-T */
        const momentum first = normal_vector(&start, l0, (pair){1.0, 0.0});
        const momentum second = normal_vector(&start, l0, (pair){0.0, 1.0});
        double factor_out, factor_home, last = BEFORE_FIRST;
        pair nu = {u[6], u[7]}, moved = {0.0, 0.0}, before = {0.0, 0.0}, returned;
        vector flown_out, flown_home; /* without the last change of nu */
        momentum arrived;
        node end;
        lower l1;
        for (int i = 0;; i++) {
            double work = 0.0;
            if (i == MAX_ITERATIONS)
                return FAILED;
            vector pi_out = by_entry(g.inertia, out), pi_home = by_entry(g.inertia, home);
            momentum q = pushed(&start, p, transposed_times(l0, nu));
            double energy = g.inverse_mass * (q.x * q.x + q.y * q.y) + TINY;
            inverted by_out = newton(&g, q.spin, &out, &pi_out, &work, &energy);
            q.spin = legendre_plus(&g, out, pi_out);
            factor_out = cayley_factor(out);
            vector a = turned(R.a, out, factor_out), b = turned(R.b, out, factor_out);
            node middle = node_at(&g, start.x + 2.0 * g.inverse_mass * q.x,
                                  start.y + 2.0 * g.inverse_mass * q.y, a, b);
            q = struck(&middle, q, violation(&g, &middle, q));
            energy += g.inverse_mass * (q.x * q.x + q.y * q.y);
            inverted by_home = newton(&g, q.spin, &home, &pi_home, &work, &energy);
            arrived = (momentum){q.x, q.y, legendre_plus(&g, home, pi_home)};
            factor_home = cayley_factor(home);
            end = node_at(&g, middle.x + 2.0 * g.inverse_mass * q.x,
                          middle.y + 2.0 * g.inverse_mass * q.y, turned(a, home, factor_home),
                          turned(b, home, factor_home));
            l1 = inverse_cholesky(&end);
            returned = times(l1, violation(&g, &end, arrived));
            pair closing = matched(&g, &start, l0, &end, l1, returned);
            closing = (pair){closing.first - nu.first, closing.second - nu.second};

            /* Broyden's formula for the inverse, left alone where the last step was round-off */
            double d1 = closing.first - before.first, d2 = closing.second - before.second;
            double e1 = j11 * d1 + j12 * d2, e2 = j21 * d1 + j22 * d2;
            double along = moved.first * e1 + moved.second * e2;
            double square = moved.first * moved.first + moved.second * moved.second;
            if (square > LEAST_MOVE * energy && !believable(along, square)) {
                j11 = j22 = -0.5;
                j12 = j21 = 0.0;
            } else if (square > LEAST_MOVE * energy) {
                double f = 1.0 / along, g1 = f * (moved.first - e1), g2 = f * (moved.second - e2);
                double row1 = moved.first * j11 + moved.second * j21;
                double row2 = moved.first * j12 + moved.second * j22;
                j11 += g1 * row1;
                j12 += g1 * row2;
                j21 += g2 * row1;
                j22 += g2 * row2;
            }
            moved.first = -(j11 * closing.first + j12 * closing.second);
            moved.second = -(j21 * closing.first + j22 * closing.second);
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
        store(out, u);
        store(home, u + 3);
        u[6] = nu.first;
        u[7] = nu.second;
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
    store_state(start.x, start.y, R, p, unit, state);
    return iterations;
}
