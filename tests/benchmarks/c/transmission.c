/* Variable transmission: oscillators x, z and a driver y that turns, unit masses, on R^2 x SO(2).

   Constraint (1, f, 0), f = c0 + c1 sin y + c2 cos y + c3 sin 2y, C = 1 + f^2. Momenta are in units
   of 2 / flight time of the stage: a flight is x -> x + 2 p_x and, Cayley, s + s^3 = p_y with
   s = tan(turn of y / 2); it keeps p_y. No impulse touches p_y, so y knows nothing of x, z and nu.

   Flights that keep the energy go by two half arrows, 2 s in all, s = p - kick * (discrete gradient
   of V between their ends), p -> 2 s - p.

   parameters: c0, c1, c2, c3, k, q, e.
   state: x, z, rotation of y row by row (4), momentum after the impact (3).
   All functions return the number of Newton iterations, or FAILED. */
#include "iteration.h"

typedef struct {
    double cosine, sine;
} turn;

static double ratio(const double *c, turn y)
{
    return c[0] + c[1] * y.sine + c[2] * y.cosine + 2.0 * c[3] * y.sine * y.cosine;
}

INLINE turn turned(turn y, double s)
{
    double factor = 1.0 / (1.0 + s * s), c = (1.0 - s * s) * factor, d = 2.0 * s * factor;
    return (turn){y.cosine * c - y.sine * d, y.sine * c + y.cosine * d};
}

INLINE turn restored(turn y)
{
    double factor = 1.5 - 0.5 * (y.cosine * y.cosine + y.sine * y.sine);
    return (turn){factor * y.cosine, factor * y.sine};
}

/* -dV/dy */
INLINE double torque(const double *p, turn y)
{
    return y.sine - p[6] * (y.cosine * y.cosine - y.sine * y.sine);
}

typedef struct {
    double x, z;
} plane;

/* -dV/d(x, z), V = (x^2 + k z^2)/2 + q (x^4/4 + x^2 z^2/2) + ... */
INLINE plane spring(const double *p, plane at)
{
    double q = p[5] * at.x;
    return (plane){-(at.x + q * (at.x * at.x + at.z * at.z)), -(p[4] * at.z + q * at.x * at.z)};
}

INLINE plane moved_by(plane a, double c, plane b)
{
    return (plane){a.x + c * b.x, a.z + c * b.z};
}

/* p - 2 mu^T C^-1 mu p */
INLINE plane struck(plane p, double f, double inverse)
{
    double impulse = -2.0 * (p.x + f * p.z) * inverse;
    return (plane){p.x + impulse, p.z + impulse * f};
}

/* One Newton update of s + s^3 = m. Adds to work and energy. */
INLINE void newton(double m, double *s, double *work, double *energy)
{
    double square = *s * *s, r = *s + square * *s - m, u = r / (1.0 + 3.0 * square);
    *work += fabs(r * u);
    *s -= u;
    *energy += *s * *s;
}

static void store_state(plane at, turn y, plane p, double py, double unit, double *state)
{
    state[0] = at.x;
    state[1] = at.z;
    state[2] = state[5] = y.cosine;
    state[3] = -y.sine;
    state[4] = y.sine;
    store((vector){p.x / unit, p.z / unit, py / unit}, state + 6);
}

int64_t rattle(const double *parameters, double h, double *state, int64_t steps)
{
    /* half the kick of a step at either end */
    const double unit = 0.5 * h, kick = unit * unit;
    plane at = {state[0], state[1]}, p = {unit * state[6], unit * state[7]};
    turn y = {state[2], state[4]};
    double py = unit * state[8], u[1] = {py};
    int64_t iterations = 0;
    warm_start w;
    fill(&w, u, 1);
    for (int64_t step = 0; step < steps; step++) {
        p = moved_by(p, kick, spring(parameters, at));
        py += kick * torque(parameters, y);
        const double straight = p.x * p.x + p.z * p.z + TINY;
        extrapolate(&w, 0, u, 1);
        double s = u[0], last = BEFORE_FIRST;
        for (int i = 0;; i++) {
            double work = 0.0, energy = straight;
            if (i == MAX_ITERATIONS)
                return FAILED;
            newton(py, &s, &work, &energy);
            iterations++;
            double now = work / energy;
            if (finished(now, last, 0.0, 1))
                break;
            last = now;
        }
        u[0] = s;
        remember(&w, u, 1);
        at = moved_by(at, 2.0, p);
        y = turned(y, s);
        p = moved_by(p, kick, spring(parameters, at));
        py += kick * torque(parameters, y);
        double f = ratio(parameters, y);
        p = struck(p, f, 1.0 / (1.0 + f * f));
        y = restored(y);
    }
    store_state(at, y, p, py, unit, state);
    return iterations;
}

int64_t projected(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    plane at = {state[0], state[1]}, p = {last_unit * state[6], last_unit * state[7]};
    turn y = {state[2], state[4]};
    double f = ratio(parameters, y), root = sqrt(1.0 / (1.0 + f * f));
    double py = last_unit * state[8], inverse = -0.5, u[3] = {unit * state[8], unit * state[8]};
    int64_t iterations = 0;
    warm_start w;
    fill(&w, u, 3);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part;
        const double kick = 2.0 * unit * unit * part * part;
        const plane normal = {root, f * root};
        p = (plane){growth_of(stage) * p.x, growth_of(stage) * p.z};
        py *= growth_of(stage);
        inverse = regrown(inverse, stage);
        extrapolate(&w, stage, u, 3);
        double out = part * u[0], home = part * u[1], nu = part * part * part * u[2];
        double last = BEFORE_FIRST, moved = 0.0, before = 0.0, py_hit;
        plane arrived, end;
        turn y_end;
        for (int i = 0;; i++) {
            double work = 0.0;
            if (i == MAX_ITERATIONS)
                return FAILED;
            plane lent = moved_by(p, nu, normal);
            double energy = lent.x * lent.x + lent.z * lent.z + TINY;
            newton(py, &out, &work, &energy);
            turn y_hit = turned(y, out);
            plane middle = moved_by(at, 2.0, lent), push = spring(parameters, middle);
            double f_hit = ratio(parameters, y_hit);
            plane hit = struck(moved_by(lent, kick, push), f_hit, 1.0 / (1.0 + f_hit * f_hit));
            arrived = moved_by(hit, kick, push);
            energy += arrived.x * arrived.x + arrived.z * arrived.z;
            py_hit = py + 2.0 * kick * torque(parameters, y_hit);
            newton(py_hit, &home, &work, &energy);
            y_end = turned(y_hit, home);
            end = moved_by(middle, 2.0, arrived);
            f = ratio(parameters, y_end);
            root = sqrt(1.0 / (1.0 + f * f));
            double closing = root * (arrived.x + f * arrived.z) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            double left = fabs(closing * moved);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        u[0] = over * out;
        u[1] = over * home;
        u[2] = over * over * over * nu;
        remember(&w, u, 3);
        double impulse = -root * root * (arrived.x + f * arrived.z);
        p = (plane){arrived.x + impulse, arrived.z + impulse * f};
        py = py_hit;
        at = end;
        y = restored(y_end);
    }
    store_state(at, y, p, py, last_unit, state);
    return iterations;
}

/* Inverse of a 2 x 2 matrix. */
typedef struct {
    double xx, xz, zx, zz;
} matrix;

INLINE plane solved(const matrix *a, plane r)
{
    return (plane){a->xx * r.x + a->xz * r.z, a->zx * r.x + a->zz * r.z};
}

/* One Newton update of s = p - kick g, g the discrete gradient of V between `from` and from + 2 s:
   with the mean m of both ends, g_x = m_x + q (m_x^2 + s_x^2) m_x + q (m_x m_z + s_x s_z) m_z and
   g_z = k m_z + q (m_x m_z + s_x s_z) m_x. Adds to work and energy, and returns the inverse of the
   Jacobian. */
INLINE matrix swing(const double *parameters, double kick, plane from, plane p, plane *s,
                    double *work, double *energy)
{
    const double k = parameters[4], q = parameters[5];
    plane m = moved_by(from, 1.0, *s), both = moved_by(m, 1.0, *s);
    double square = m.x * m.x + s->x * s->x, product = m.x * m.z + s->x * s->z;
    plane r = {s->x - p.x + kick * (m.x + q * (square * m.x + product * m.z)),
               s->z - p.z + kick * (k * m.z + q * product * m.x)};
    double xx = 1.0 + kick * (1.0 + q * (2.0 * both.x * m.x + square + both.z * m.z));
    double xz = kick * q * (both.x * m.z + product), zx = kick * q * (both.z * m.x + product);
    double zz = 1.0 + kick * (k + q * both.x * m.x), over = 1.0 / (xx * zz - xz * zx);
    matrix inverse = {over * zz, -over * xz, -over * zx, over * xx};
    plane u = solved(&inverse, r);
    *work += fabs(r.x * u.x) + fabs(r.z * u.z);
    *s = moved_by(*s, -1.0, u);
    /* the impulse is 2 (s - p) */
    plane impulse = moved_by(*s, -1.0, p);
    *energy += s->x * s->x + s->z * s->z + 4.0 * (impulse.x * impulse.x + impulse.z * impulse.z);
    return inverse;
}

/* The same for the driver: with t = s / 2, F = 1 / (1 + t^2), C = 2 F - 1 and the middle angle m,
   g_y = F (-sin m + e C cos 2m). Returns the end of the flight. */
INLINE turn turning(const double *parameters, double kick, turn from, double p, double *s,
                    double *work, double *energy)
{
    const double e = parameters[6];
    double t = 0.5 * *s, F = 1.0 / (1.0 + t * t), C = 2.0 * F - 1.0;
    turn m = turned(from, t);
    double twice = m.cosine * m.cosine - m.sine * m.sine, inner = e * C * twice - m.sine;
    double r = *s - p + kick * F * inner;
    double slope = -t * F * F * inner
                 + F * F * (-m.cosine - 4.0 * e * C * m.sine * m.cosine - 2.0 * t * F * e * twice);
    double u = r / (1.0 + kick * slope);
    *work += fabs(r * u);
    *s -= u;
    *energy += *s * *s + 4.0 * (*s - p) * (*s - p);
    t = 0.5 * *s;
    return turned(turned(from, t), t);
}

int64_t energy_preserving(const double *parameters, double h, double *state, int64_t steps)
{
    const double unit = 0.25 * h, last_unit = unit * size_of(STAGES - 1);
    plane at = {state[0], state[1]}, p = {last_unit * state[6], last_unit * state[7]};
    turn y = {state[2], state[4]};
    double f = ratio(parameters, y), root = sqrt(1.0 / (1.0 + f * f));
    double py = last_unit * state[8], inverse = -0.5, u[7] = {0.0};
    int64_t iterations = 0;
    warm_start w;
    for (int i = 0; i < 6; i++)
        u[i] = unit * state[6 + i % 3];
    fill(&w, u, 7);
    EACH_STAGE {
        const double part = size_of(stage), over = 1.0 / part;
        const double kick = unit * unit * part * part;
        const plane normal = {root, f * root};
        p = (plane){growth_of(stage) * p.x, growth_of(stage) * p.z};
        py *= growth_of(stage);
        inverse = regrown(inverse, stage);
        extrapolate(&w, stage, u, 7);
        plane out = {part * u[0], part * u[1]}, home = {part * u[3], part * u[4]}, arrived, end;
        double out_y = part * u[2], home_y = part * u[5], nu = part * part * part * u[6];
        double last = BEFORE_FIRST, moved = 0.0, before = 0.0, py_end;
        turn y_end;
        for (int i = 0;; i++) {
            double work = 0.0, energy = TINY;
            if (i == MAX_ITERATIONS)
                return FAILED;
            plane lent = moved_by(p, nu, normal);
            matrix by_out = swing(parameters, kick, at, lent, &out, &work, &energy);
            turn y_hit = turning(parameters, kick, y, py, &out_y, &work, &energy);
            double f_hit = ratio(parameters, y_hit), over_hit = 1.0 / (1.0 + f_hit * f_hit);
            plane middle = moved_by(at, 2.0, out);
            plane hit = struck((plane){2.0 * out.x - lent.x, 2.0 * out.z - lent.z}, f_hit,
                               over_hit);
            double py_hit = 2.0 * out_y - py;
            matrix by_home = swing(parameters, kick, middle, hit, &home, &work, &energy);
            y_end = turning(parameters, kick, y_hit, py_hit, &home_y, &work, &energy);
            arrived = (plane){2.0 * home.x - hit.x, 2.0 * home.z - hit.z};
            py_end = 2.0 * home_y - py_hit;
            end = moved_by(middle, 2.0, home);
            f = ratio(parameters, y_end);
            root = sqrt(1.0 / (1.0 + f * f));
            double closing = root * (arrived.x + f * arrived.z) - nu;
            inverse = secant(inverse, moved, closing - before, energy);
            moved = -inverse * closing;
            before = closing;
            nu += moved;
            /* both flights follow nu, the second one after the impact */
            out = moved_by(out, moved, solved(&by_out, normal));
            home = moved_by(home, moved, solved(&by_home, struck(normal, f_hit, over_hit)));
            double left = fabs(closing * moved);
            work += left;
            iterations++;
            double now = work / energy;
            if (finished(now, last, left / energy, 0))
                break;
            last = now;
        }
        double values[7] = {out.x, out.z, out_y, home.x, home.z, home_y, over * over * nu};
        for (int i = 0; i < 7; i++)
            u[i] = over * values[i];
        remember(&w, u, 7);
        double impulse = -root * root * (arrived.x + f * arrived.z);
        p = (plane){arrived.x + impulse, arrived.z + impulse * f};
        py = py_end;
        at = end;
        y = restored(y_end);
    }
    store_state(at, y, p, py, last_unit, state);
    return iterations;
}
