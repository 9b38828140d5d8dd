/* Equations of motion without multipliers, derived by hand, in the fewest or cheapest variables.
   One system per compilation: -DSLEIGH, -DSUSLOV, -DBALL or -DBALL_QUATERNION, -DDRIVEN with
   -DCONTACT, -DGEARBOX or -DQUARTIC.

   The constraints hold by construction: what they determine is computed from the rest. */
#include "real.h"

#ifdef SLEIGH
/* v' = a omega^2, omega' = -m a v omega / (J + m a^2).
   parameters: a, m a / (J + m a^2).  state: omega, v. */
enum { N = 2 };

typedef struct {
    real a, b;
} system;

static system make_system(const double *p)
{
    return (system){p[0], p[1]};
}

static inline void field(const system *s, const real *y, real *rates)
{
    rates[0] = -s->b * y[0] * y[1];
    rates[1] = s->a * y[0] * y[0];
}

/* over m: (v^2 + (a / b) omega^2) / 2 */
static real energy(const system *s, const real *y)
{
    return (y[1] * y[1] + s->a / s->b * (y[0] * y[0])) / 2;
}
#endif

#ifdef SUSLOV
/* Axis e3, so Omega_3 = 0 and J w' = (b . w) S w with J the upper 2 x 2 block of I, b = (I13, I23).
   parameters: the matrix J^-1 S (row by row), b, J11, J12, J22.  state: Omega_1, Omega_2. */
enum { N = 2 };

typedef struct {
    real a11, a12, a21, a22, b1, b2, j11, j12, j22;
} system;

static system make_system(const double *p)
{
    return (system){p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]};
}

static inline void field(const system *s, const real *y, real *rates)
{
    const real pull = s->b1 * y[0] + s->b2 * y[1];
    rates[0] = pull * (s->a11 * y[0] + s->a12 * y[1]);
    rates[1] = pull * (s->a21 * y[0] + s->a22 * y[1]);
}

static real energy(const system *s, const real *y)
{
    return (s->j11 * y[0] * y[0] + 2 * s->j12 * y[0] * y[1] + s->j22 * y[1] * y[1]) / 2;
}
#endif

#if defined(BALL) || defined(BALL_QUATERNION)
/* Ball on a rotating table. The friction acts at the contact point, so that in space axes
       L = R I Omega + m r e3 x (x', y', 0)
   is constant. With the rows a, b, c of R, rolling inserted, and k = R^T (L + m r Theta (x, y, 0)):
       (I + m r^2) Omega - m r^2 c (c . Omega) = k,
       x' = r b . Omega - Theta y,  y' = -r a . Omega + Theta x,  a' = a x Omega,  b' = b x Omega.
   Omega by the formula of Sherman and Morrison.
   parameters: r, Theta, L (3), m r^2, m r Theta, 1 / (I_i + m r^2) (3).
   state: a, b, x, y; with -DBALL_QUATERNION q = (w, x, y, z), x, y; R = R(q). */
typedef struct {
    real x, y, z;
} vector;

typedef struct {
    real r, theta;
    vector momentum;
    real heavy, dragged;
    vector over;
} system;

static system make_system(const double *p)
{
    return (system){p[0], p[1], {p[2], p[3], p[4]}, p[5], p[6], {p[7], p[8], p[9]}};
}

static inline vector cross(vector a, vector b)
{
    return (vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline real dot(vector a, vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* u a + v b + w c */
static inline vector combined(real u, vector a, real v, vector b, real w, vector c)
{
    return (vector){u * a.x + v * b.x + w * c.x, u * a.y + v * b.y + w * c.y,
                    u * a.z + v * b.z + w * c.z};
}

/* k = R^T (L + m r Theta (x, y, 0)) */
static inline vector turned_back(const system *s, vector a, vector b, vector c, real x, real y)
{
    return combined(s->momentum.x + s->dragged * x, a, s->momentum.y + s->dragged * y, b,
                    s->momentum.z, c);
}

static inline vector angular_velocity(const system *s, vector c, vector k)
{
    const vector ku = {s->over.x * k.x, s->over.y * k.y, s->over.z * k.z};
    const vector cu = {s->over.x * c.x, s->over.y * c.y, s->over.z * c.z};
    const real f = s->heavy * dot(c, ku) / (1 - s->heavy * dot(c, cu));
    return (vector){ku.x + f * cu.x, ku.y + f * cu.y, ku.z + f * cu.z};
}

/* (I Omega . Omega + m |r omega x e3 + Theta e3 x X|^2) / 2; (I + m r^2) Omega = k + m r^2 c ... */
static real energy_of(const system *s, vector a, vector b, vector c, real x, real y)
{
    const vector omega = angular_velocity(s, c, turned_back(s, a, b, c, x, y));
    const real u = s->r * dot(b, omega) - s->theta * y, v = s->theta * x - s->r * dot(a, omega);
    const real turning = omega.x * omega.x / s->over.x + omega.y * omega.y / s->over.y
                         + omega.z * omega.z / s->over.z - s->heavy * dot(omega, omega);
    return (turning + s->heavy / (s->r * s->r) * (u * u + v * v)) / 2;
}
#endif

#ifdef BALL
enum { N = 8 };
#define RESTORED

static inline void field(const system *s, const real *y, real *rates)
{
    const vector a = {y[0], y[1], y[2]}, b = {y[3], y[4], y[5]}, c = cross(a, b);
    const vector omega = angular_velocity(s, c, turned_back(s, a, b, c, y[6], y[7]));
    rates[0] = a.y * omega.z - a.z * omega.y;
    rates[1] = a.z * omega.x - a.x * omega.z;
    rates[2] = a.x * omega.y - a.y * omega.x;
    rates[3] = b.y * omega.z - b.z * omega.y;
    rates[4] = b.z * omega.x - b.x * omega.z;
    rates[5] = b.x * omega.y - b.y * omega.x;
    rates[6] = s->r * dot(b, omega) - s->theta * y[7];
    rates[7] = s->theta * y[6] - s->r * dot(a, omega);
}

static real energy(const system *s, const real *y)
{
    const vector a = {y[0], y[1], y[2]}, b = {y[3], y[4], y[5]};
    return energy_of(s, a, b, cross(a, b), y[6], y[7]);
}

/* R - (R R^T - 1) R / 2 on two rows: orthonormal to the square of what it was off. */
static inline void restore(real *y)
{
    const real aa = (real)0.5 - (y[0] * y[0] + y[1] * y[1] + y[2] * y[2]) / 2;
    const real bb = (real)0.5 - (y[3] * y[3] + y[4] * y[4] + y[5] * y[5]) / 2;
    const real ab = -(y[0] * y[3] + y[1] * y[4] + y[2] * y[5]) / 2;
    for (int i = 0; i < 3; i++) {
        const real ai = y[i], bi = y[i + 3];
        y[i] = ai + aa * ai + ab * bi;
        y[i + 3] = bi + bb * bi + ab * ai;
    }
}

static real violation(const real *y)
{
    const real aa = fabs(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] - 1);
    const real bb = fabs(y[3] * y[3] + y[4] * y[4] + y[5] * y[5] - 1);
    const real ab = fabs(y[0] * y[3] + y[1] * y[4] + y[2] * y[5]);
    return fmax(aa, fmax(bb, ab));
}
#endif

#ifdef BALL_QUATERNION
enum { N = 6 };
#define RESTORED

static inline void rows(const real *q, vector *a, vector *b, vector *c)
{
    const real xx = q[1] * q[1], yy = q[2] * q[2], zz = q[3] * q[3], xy = q[1] * q[2];
    const real xz = q[1] * q[3], yz = q[2] * q[3], wx = q[0] * q[1], wy = q[0] * q[2];
    const real wz = q[0] * q[3];
    *a = (vector){1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)};
    *b = (vector){2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)};
    *c = (vector){2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)};
}

static inline void field(const system *s, const real *y, real *rates)
{
    vector a, b, c;
    rows(y, &a, &b, &c);
    const vector omega = angular_velocity(s, c, turned_back(s, a, b, c, y[4], y[5]));
    const vector half = {omega.x / 2, omega.y / 2, omega.z / 2};
    rates[0] = -(y[1] * half.x + y[2] * half.y + y[3] * half.z);
    rates[1] = y[0] * half.x + y[2] * half.z - y[3] * half.y;
    rates[2] = y[0] * half.y + y[3] * half.x - y[1] * half.z;
    rates[3] = y[0] * half.z + y[1] * half.y - y[2] * half.x;
    rates[4] = s->r * dot(b, omega) - s->theta * y[5];
    rates[5] = s->theta * y[4] - s->r * dot(a, omega);
}

static real energy(const system *s, const real *y)
{
    vector a, b, c;
    rows(y, &a, &b, &c);
    return energy_of(s, a, b, c, y[4], y[5]);
}

static inline void restore(real *y)
{
    const real length = y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3];
    const real factor = (real)1.5 - length / 2;
    for (int i = 0; i < 4; i++)
        y[i] *= factor;
}

static real violation(const real *y)
{
    return fabs(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3] - 1);
}
#endif

#ifdef DRIVEN
/* Unit mass in R^3, x' + f(y) z' = 0, potential V(y) + U(x, z): with s = z'
       x' = -f s,  y' = w,  z' = s,  w' = -V'(y),
       (1 + f^2) s' = f U_x - U_z - f f' w s.
   state: x, y, z, w, s. */
enum { N = 5 };

typedef struct {
    real f, f_prime, v_prime, v;
} driver;

#ifdef CONTACT
/* f = y, V = y^2/2, U = (x^2 + z^2 + eps x^2 z^2)/2.  parameters: eps */
typedef struct {
    real eps;
} system;

static inline driver driven_by(const system *s, real y)
{
    (void)s;
    return (driver){y, 1, y, y * y / 2};
}

static inline void pull(const system *s, real x, real z, real *ux, real *uz)
{
    *ux = x + s->eps * x * (z * z);
    *uz = z + s->eps * z * (x * x);
}

static real potential(const system *s, real x, real z)
{
    return (x * x + z * z + s->eps * (x * x) * (z * z)) / 2;
}
#endif

#ifdef QUARTIC
/* f = -y, V = y^2/2 + k y^4/4, U = c z^4/4.  parameters: k, c */
typedef struct {
    real k, c;
} system;

static inline driver driven_by(const system *s, real y)
{
    const real square = y * y;
    return (driver){-y, -1, y + s->k * y * square, square / 2 + s->k * (square * square) / 4};
}

static inline void pull(const system *s, real x, real z, real *ux, real *uz)
{
    (void)x;
    *ux = 0;
    *uz = s->c * z * (z * z);
}

static real potential(const system *s, real x, real z)
{
    (void)x;
    return s->c * (z * z) * (z * z) / 4;
}
#endif

#ifdef GEARBOX
/* f = f0 + sin y + f2 cos y + f3 sin 2y, V = cos y + (e/2) sin 2y,
   U = (x^2 + w z^2)/2 + c (x^4/4 + x^2 z^2/2).  parameters: e, w, c, f0, f2, f3 */
typedef struct {
    real e, w, c, f0, f2, f3;
} system;

static inline driver driven_by(const system *s, real y)
{
    const real sine = sin(y), cosine = cos(y);
    const real twice_sine = 2 * sine * cosine, twice_cosine = 1 - 2 * (sine * sine);
    return (driver){s->f0 + sine + s->f2 * cosine + s->f3 * twice_sine,
                    cosine - s->f2 * sine + 2 * s->f3 * twice_cosine,
                    s->e * twice_cosine - sine, cosine + s->e / 2 * twice_sine};
}

static inline void pull(const system *s, real x, real z, real *ux, real *uz)
{
    const real coupled = s->c * (x * x);
    *ux = x + x * (coupled + s->c * (z * z));
    *uz = s->w * z + coupled * z;
}

static real potential(const system *s, real x, real z)
{
    const real square = x * x;
    return (square + s->w * (z * z)) / 2 + s->c * (square * square / 4 + square * (z * z) / 2);
}
#endif

static system make_system(const double *p)
{
    system s;
    real *member = (real *)&s;
    for (unsigned i = 0; i < sizeof(system) / sizeof(real); i++)
        member[i] = p[i];
    return s;
}

static inline void field(const system *s, const real *y, real *rates)
{
    real ux, uz;
    const driver d = driven_by(s, y[1]);
    pull(s, y[0], y[2], &ux, &uz);
    rates[0] = -d.f * y[4];
    rates[1] = y[3];
    rates[2] = y[4];
    rates[3] = -d.v_prime;
    rates[4] = (d.f * ux - uz - d.f * d.f_prime * y[3] * y[4]) / (1 + d.f * d.f);
}

static real energy(const system *s, const real *y)
{
    const driver d = driven_by(s, y[1]);
    return (y[3] * y[3] + (1 + d.f * d.f) * (y[4] * y[4])) / 2 + d.v + potential(s, y[0], y[2]);
}
#endif

#ifndef RESTORED
static inline void restore(real *y)
{
    (void)y;
}

static real violation(const real *y)
{
    (void)y;
    return 0;
}
#endif

#include "dop853.h"
