/* The functions of <math.h> that koopf_ calls, rounded to the nearest float: the same
 * values on every machine. libm differs from one to the next in the last bit, and a
 * closed loop makes more of that; linked with this, host and target are to agree in
 * every bit. sqrtf() is exact everywhere. */
#include <math.h>

float sinf(float x) {
	return (float)sin((double)x);
}

float cosf(float x) {
	return (float)cos((double)x);
}

float expf(float x) {
	return (float)exp((double)x);
}

float atan2f(float y, float x) {
	return (float)atan2((double)y, (double)x);
}
