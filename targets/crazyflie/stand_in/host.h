/* Flying the example on a host: called by the tests. */
#pragma once
#include <stdint.h>

/* What happens to the flight; may be changed at any time. */
typedef struct {
	double wind[2];                                       /* as acceleration (m/s^2) */
	double drag;                                          /* times speed squared (1/m) */
	double period;                                        /* of the path (s); 0: a hover */
	double glitch;                                        /* of the measured position (m) */
	double fault;                                         /* of the measured velocity (m/s) */
	int broken_setpoint, held_up, on_ground, by_velocity; /* 1: it is so */
} circumstances;
extern circumstances around;

typedef struct {
	double error;           /* rms distance to the setpoint (m) */
	double planned;         /* milliseconds on the plan */
	double stock_untouched; /* milliseconds off it with the setpoint as it came */
	double finite;          /* milliseconds in which the stock controller was given numbers */
} flight;

void begin(uint64_t seed);
flight fly(unsigned milliseconds);

/* By kind ("log" or "param"), group and name; NaN, or 0, where there is none. */
double read_variable(const char *kind, const char *group, const char *name);
int set_parameter(const char *group, const char *name, double value);
