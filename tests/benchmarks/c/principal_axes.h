/* Free rotation of a body in its principal axes, Cayley, what balls and Veselova's body share.

   With s = (flight time / 2) omega and momenta in the same unit,
   FL-(s) = I s + s x I s + s (s . I s), FL+ the same with -s x I s, and no step size is left. */
#ifndef PRINCIPAL_AXES_H
#define PRINCIPAL_AXES_H

#include "iteration.h"

typedef struct {
    vector inertia, inverse, twist; /* twist = (I3 - I2, I1 - I3, I2 - I1) */
} axes;

static axes make_axes(vector I)
{
    return (axes){I, {1.0 / I.x, 1.0 / I.y, 1.0 / I.z}, {I.z - I.y, I.x - I.z, I.y - I.x}};
}

INLINE vector by_entry(vector a, vector b)
{
    return (vector){a.x * b.x, a.y * b.y, a.z * b.z};
}

/* A row times cay, which is cay^T of it as a column. */
INLINE vector turned(vector row, vector s, double factor)
{
    vector once = cross(row, s);
    return add(row, factor, add(once, 1.0, cross(once, s)));
}

INLINE double cayley_factor(vector s)
{
    return 2.0 / (1.0 + dot(s, s));
}

/* One Newton update of FL-(s) = m; pi = I s is updated with s. Adds to work and energy, and returns
   the inverse of the Jacobian. */
INLINE inverted newton(const axes *g, vector m, vector *s, vector *pi, double *work,
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

INLINE vector legendre_plus(const axes *g, vector s, vector pi)
{
    vector twisted = {g->twist.x * s.y * s.z, g->twist.y * s.x * s.z, g->twist.z * s.x * s.y};
    return add(add(pi, -1.0, twisted), dot(s, pi), s);
}

#endif
