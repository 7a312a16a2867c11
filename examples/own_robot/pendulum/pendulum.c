/* The simulator of pendulum.toml: a cart on a rail, from which a pole hangs.

   gcc -O2 -shared -fPIC pendulum.c -o libpendulum.so -lm
*/
#include <math.h>

/* The order of pendulum.toml: measured states, hidden ones; and parameters. */
enum { POSITION, ANGLE, VELOCITY, RATE, STATES };
enum { CART_MASS, POLE_MASS, POLE_LENGTH, FRICTION };

#define GRAVITY 9.81  /* m/s2 */
#define BEARING 0.004 /* N m s/rad: friction of the pole's bearing */
#define PARTS 5       /* short steps in one */

/* dx/dt under a force on the cart. All of the pole's mass is at its tip, and it hangs at angle 0. */
static void rate(const double *x, double force, const double *params, double *dx)
{
	const double mass = params[POLE_MASS], length = params[POLE_LENGTH], s = sin(x[ANGLE]), c = cos(x[ANGLE]);
	const double brake = BEARING * x[RATE] / length; /* N, at the tip */
	const double pull = mass * s * (length * x[RATE] * x[RATE] + GRAVITY * c) + brake * c;

	dx[POSITION] = x[VELOCITY];
	dx[ANGLE] = x[RATE];
	dx[VELOCITY] = (force - params[FRICTION] * x[VELOCITY] + pull) / (params[CART_MASS] + mass * s * s);
	dx[RATE] = -(dx[VELOCITY] * c + GRAVITY * s + brake / mass) / length;
}

/* States dt seconds after x under the force u[0], by the midpoint method. 0 says that all is well. */
int step(const double *x, const double *u, double dt, const double *params, double *x_next)
{
	const double h = dt / PARTS;
	double dx[STATES], middle[STATES];

	for (int i = 0; i < STATES; i++) x_next[i] = x[i];
	for (int part = 0; part < PARTS; part++) {
		rate(x_next, u[0], params, dx);
		for (int i = 0; i < STATES; i++) middle[i] = x_next[i] + h / 2 * dx[i];
		rate(middle, u[0], params, dx);
		for (int i = 0; i < STATES; i++) x_next[i] += h * dx[i];
	}
	return 0;
}
