#include "quaternion.h"

#include <math.h>
#include <stddef.h>

void quaternion_to_matrix(const double *q, double R[3][3]) {
	const double w = q[0], x = q[1], y = q[2], z = q[3];
	R[0][0] = 1 - 2 * (y * y + z * z);
	R[0][1] = 2 * (x * y - w * z);
	R[0][2] = 2 * (x * z + w * y);
	R[1][0] = 2 * (x * y + w * z);
	R[1][1] = 1 - 2 * (x * x + z * z);
	R[1][2] = 2 * (y * z - w * x);
	R[2][0] = 2 * (x * z - w * y);
	R[2][1] = 2 * (y * z + w * x);
	R[2][2] = 1 - 2 * (x * x + y * y);
}

void quaternion_derivative(const double *q, const double *w, double *derivative) {
	derivative[0] = -0.5 * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]);
	derivative[1] = 0.5 * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]);
	derivative[2] = 0.5 * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]);
	derivative[3] = 0.5 * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]);
}

void quaternion_normalise(double *q) {
	const double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
	for (size_t i = 0; i < 4; i++) { q[i] /= norm; }
}

void quaternion_from_angles(double roll, double pitch, double yaw, double *q) {
	const double cp = cos(0.5 * pitch), sp = sin(0.5 * pitch), cr = cos(0.5 * roll), sr = sin(0.5 * roll);
	const double cy = cos(0.5 * yaw), sy = sin(0.5 * yaw);
	q[0] = cr * cp * cy + sr * sp * sy;
	q[1] = sr * cp * cy - cr * sp * sy;
	q[2] = cr * sp * cy + sr * cp * sy;
	q[3] = cr * cp * sy - sr * sp * cy;
}

void quaternion_to_angles(const double *q, double *angles) {
	double R[3][3];
	quaternion_to_matrix(q, R);
	angles[0] = atan2(R[2][1], R[2][2]);
	angles[1] = asin(fmax(-1, fmin(1, -R[2][0])));
	angles[2] = atan2(R[1][0], R[0][0]);
}
