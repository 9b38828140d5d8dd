/* What the systems share: stopping rule, warm start, stages of a composition, vectors of R^3.

   The numbers of groupoid_gni.codegen.newton_rule come in as macros (-DAT_ROUND_OFF=...), so that
   both sides always iterate to the same tolerance. */
#ifndef ITERATION_H
#define ITERATION_H

#include <math.h>
#include <stdint.h>

/* -O2 alone calls the larger helpers, which sends their arguments through memory */
#define INLINE static inline __attribute__((always_inline))
#define FAILED (-1)
enum { MOST_UNKNOWNS = 9 };

/* t = e^2 of the last update and of the one before, and e^2 left in the next state. */
INLINE int finished(double now, double last, double left, int quadratic)
{
    int predicted = quadratic ? now * now * now <= PREDICTED * (last * last)
                              : now * now <= PREDICTED * last;
    predicted &= left <= LEFT;
    /* one branch, not one per condition */
    return (now <= AT_ROUND_OFF) | predicted
        | ((now >= STAGNATION * last) & (now <= STAGNATION_LEVEL));
}

/* A step is STAGES stages of the sizes `fraction`; `growth`: each over the one before it. */
static const double fraction[STAGES] = FRACTIONS, growth[STAGES] = GROWTH;

#define EACH_STAGE \
    for (int64_t step = 0; step < steps; step++) \
        for (int stage = 0; stage < STAGES; stage++)

/* A constant where a step is one stage, so that nothing is left of it. */
INLINE double size_of(int stage)
{
    return STAGES > 1 ? fraction[stage] : 1.0;
}

INLINE double growth_of(int stage)
{
    return STAGES > 1 ? growth[stage] : 1.0;
}

/* The inverse slope of what closes a stage is -1/2 + O(size of the stage). */
INLINE double regrown(double inverse, int stage)
{
    return STAGES > 1 ? growth[stage] * (inverse + 0.5) - 0.5 : inverse;
}

/* The unknowns of the last HISTORY stages, in a ring whose newest row is `newest`. They are kept
   over the size of their stage (nu: over its cube), which makes them smooth from stage to stage. */
typedef struct {
    double past[HISTORY][MOST_UNKNOWNS];
    int newest;
} warm_start;

INLINE void fill(warm_start *w, const double *values, int n)
{
    for (int k = 0; k < HISTORY; k++)
#pragma GCC unroll 9
        for (int i = 0; i < n; i++)
            w->past[k][i] = values[i];
    w->newest = 0;
}

/* The newest row last: it is the one that has just been computed. */
INLINE void extrapolate(const warm_start *w, int stage, double *restrict guess, int n)
{
    static const double weight[STAGES][HISTORY] = EXTRAPOLATION;
    int row = w->newest;
#pragma GCC unroll 9
    for (int i = 0; i < n; i++)
        guess[i] = 0.0;
#pragma GCC unroll 12
    for (int k = HISTORY - 1; k >= 0; k--) {
        row = row ? row - 1 : HISTORY - 1;
#pragma GCC unroll 9
        for (int i = 0; i < n; i++)
            guess[i] += weight[stage][k] * w->past[row][i];
    }
}

INLINE void remember(warm_start *w, const double *values, int n)
{
    w->newest = (w->newest ? w->newest : HISTORY) - 1;
#pragma GCC unroll 9
    for (int i = 0; i < n; i++)
        w->past[w->newest][i] = values[i];
}

typedef struct {
    double x, y, z;
} vector;

INLINE vector load(const double *a)
{
    return (vector){a[0], a[1], a[2]};
}

INLINE void store(vector a, double *to)
{
    to[0] = a.x;
    to[1] = a.y;
    to[2] = a.z;
}

INLINE double dot(vector a, vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE vector cross(vector a, vector b)
{
    return (vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* a + c b */
INLINE vector add(vector a, double c, vector b)
{
    return (vector){a.x + c * b.x, a.y + c * b.y, a.z + c * b.z};
}

INLINE vector scaled(double c, vector a)
{
    return (vector){c * a.x, c * a.y, c * a.z};
}

/* Sum of |a_i b_i|. */
INLINE double size(vector a, vector b)
{
    return fabs(a.x * b.x) + fabs(a.y * b.y) + fabs(a.z * b.z);
}

/* Inverse of a matrix: rows of its adjugate, and 1 / determinant. */
typedef struct {
    vector first, second, third;
    double scale;
} inverted;

/* Inverse of (a b c), for the columns a, b, c. */
INLINE inverted inverse_of(vector a, vector b, vector c)
{
    vector bc = cross(b, c);
    return (inverted){bc, cross(c, a), cross(a, b), 1.0 / dot(a, bc)};
}

INLINE vector applied(const inverted *m, vector r)
{
    return (vector){m->scale * dot(m->first, r), m->scale * dot(m->second, r),
                    m->scale * dot(m->third, r)};
}

/* Whether Broyden's formula may be believed: `along` is <moved, inverse change>, `square` |moved|^2;
   what is learnt while the flights are far off is given up for the slope -2. */
INLINE int believable(double along, double square)
{
    return (4.0 * along > square) & (along < 4.0 * square);
}

/* Broyden's update of the inverse of a scalar slope: the secant. `moved` is 0 at first. */
INLINE double secant(double inverse, double moved, double change, double energy)
{
    double square = moved * moved;
    int tells = square > LEAST_MOVE * energy;
    int good = tells & believable(moved * inverse * change, square);
    double learnt = (good ? moved : inverse) / (good ? change : 1.0);
    return tells & !good ? -0.5 : learnt;
}

#endif
