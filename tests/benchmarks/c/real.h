/* The number type of a run: double, or -DREAL="long double" for reference solutions. */
#ifndef REAL_H
#define REAL_H

#include <tgmath.h>

#ifndef REAL
#define REAL double
#endif
typedef REAL real;

#endif
