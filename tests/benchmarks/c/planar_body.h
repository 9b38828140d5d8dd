/* Free motion of a rigid body in the plane, SE(2), Cayley, what sleigh and robot share.

   Body velocities (w, x, y), G = [[I, 0, c], [0, m, 0], [c, 0, m]]. With s = (flight time / 2) xi
   and momenta in the same unit, X = m x, Y = c w + m y and d = 1 + w^2,
     FL-(s) = (d (I w + c y) + w (x X + y Y) + c w x,  X - w Y,  Y + w X),
   FL+ the same with w -> -w inside the signs: (... - c w x, X + w Y, Y - w X). */
#ifndef PLANAR_BODY_H
#define PLANAR_BODY_H

#include "iteration.h"

typedef struct {
    double m, I, c;
} planar;

static vector velocity(const planar *g, vector p)
{
    double w = (g->m * p.x - g->c * p.z) / (g->m * g->I - g->c * g->c);
    return (vector){w, p.y / g->m, (p.z - g->c * w) / g->m};
}

/* Parts of the Legendre transforms at s that an update leaves for the next one. */
typedef struct {
    double turn, along, across; /* G s */
    double even, odd;           /* FL-, FL+ of w: even + odd, even - odd */
    double d, drag;             /* 1 + w^2, x X + y Y */
} parts;

INLINE parts at(const planar *g, vector s)
{
    parts q;
    q.turn = g->I * s.x + g->c * s.z;
    q.along = g->m * s.y;
    q.across = g->c * s.x + g->m * s.z;
    q.d = 1.0 + s.x * s.x;
    q.drag = s.y * q.along + s.z * q.across;
    q.even = q.d * q.turn + s.x * q.drag;
    q.odd = g->c * s.x * s.y;
    return q;
}

/* The Jacobian of FL- with its lower right block, m [[1, -w], [w, 1]], eliminated. */
typedef struct {
    double w, by_x, by_y, e1, e2; /* first row; [[1, w], [-w, 1]] times the first column */
    double md, inverse, over;     /* m d, 1 / (m d), 1 / pivot of w */
} eliminated;

INLINE vector solved(const eliminated *j, vector r)
{
    double t1 = r.y + j->w * r.z, t2 = r.z - j->w * r.y;
    double u0 = (j->md * r.x - j->by_x * t1 - j->by_y * t2) * j->over;
    return (vector){u0, (t1 - j->e1 * u0) * j->inverse, (t2 - j->e2 * u0) * j->inverse};
}

/* One Newton update of FL-(s) = p, q = at(s) is updated with s. Adds to work and energy, and
   returns the Jacobian. */
INLINE eliminated newton(const planar *g, vector p, vector *s, parts *q, double *work,
                         double *energy)
{
    const double m = g->m, c = g->c, w = s->x, x = s->y, y = s->z;
    vector r = {q->even + q->odd - p.x, q->along - w * q->across - p.y,
                q->across + w * q->along - p.z};
    double f1 = -(q->across + c * w), f2 = q->along + c;
    double by_w = 2.0 * w * q->turn + q->d * g->I + q->drag + c * (w * y + x);
    eliminated j = {.w = w, .by_x = w * (2.0 * q->along + c),
                    .by_y = q->d * c + w * (q->across + m * y), .e1 = f1 + w * f2,
                    .e2 = f2 - w * f1, .md = m * q->d};
    j.inverse = 1.0 / j.md;
    j.over = 1.0 / (j.md * by_w - j.by_x * j.e1 - j.by_y * j.e2);
    vector u = solved(&j, r);
    *work += size(r, u);
    *s = add(*s, -1.0, u);
    *q = at(g, *s);
    *energy += fabs(s->x * q->turn) + fabs(s->y * q->along) + fabs(s->z * q->across);
    return j;
}

INLINE vector legendre_plus(vector s, const parts *q)
{
    return (vector){q->even - q->odd, q->along + s.x * q->across, q->across - s.x * q->along};
}

#endif
