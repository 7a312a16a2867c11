/* Angles. */
#ifndef ANGLE_H
#define ANGLE_H

#include <math.h>

/* Within half a turn either way, rad. Most angles are there already, and remainder() is slow. */
static inline double wrapped(double angle) {
	return fabs(angle) < 3.14 ? angle : remainder(angle, 6.283185307179586);
}

#endif
