/* Stand-in for the firmware's header: only what the example needs, with its names and
 * units, and without its order or its other fields. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

typedef struct {
	float x, y, z;
} point_t;
typedef point_t velocity_t;

typedef struct {
	float x, y, z, w;
} quaternion_t;

typedef struct {
	quaternion_t attitudeQuaternion;
	point_t position;    /* m */
	velocity_t velocity; /* m/s */
} state_t;

typedef struct {
	uint64_t interruptTimestamp;
} sensorData_t;

typedef enum { modeDisable, modeAbs, modeVelocity } stab_mode_t;

typedef struct {
	point_t position;
	velocity_t velocity;
	struct {
		stab_mode_t x, y, z;
	} mode;
} setpoint_t;

typedef struct {
	float roll, pitch, thrust;
} control_t;

typedef uint32_t stabilizerStep_t; /* of 1 ms */

#define RATE_MAIN_LOOP 1000
#define RATE_100_HZ 100
#define RATE_DO_EXECUTE(RATE, STEP) ((STEP) % (RATE_MAIN_LOOP / (RATE)) == 0)
