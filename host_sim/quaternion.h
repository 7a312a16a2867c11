/* Quaternions (w, x, y, z), body to world, and what turning bodies need of vectors. */
#ifndef QUATERNION_H
#define QUATERNION_H

void quaternion_to_matrix(const double *q, double R[3][3]);
/* dq/dt of a body that turns with w (rad/s, body axes) */
void quaternion_derivative(const double *q, const double *w, double *derivative);
void quaternion_normalise(double *q);
/* From angles (rad): yaw about z, then pitch about y, then roll about x. */
void quaternion_from_angles(double roll, double pitch, double yaw, double *q);
/* The same angles (roll, pitch, yaw) of a quaternion. */
void quaternion_to_angles(const double *q, double *angles);

/* Adds a x b. */
static inline void add_cross(const double *a, const double *b, double *sum) {
	sum[0] += a[1] * b[2] - a[2] * b[1];
	sum[1] += a[2] * b[0] - a[0] * b[2];
	sum[2] += a[0] * b[1] - a[1] * b[0];
}

#endif
