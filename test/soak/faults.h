/* What befalls a robot or its sensors for a stretch of samples. */
#ifndef FAULTS_H
#define FAULTS_H

#include "plant.h"

/* One stretch. `kind` and `channel` are drawn anew for each, and mean what the fault makes of them. */
typedef struct {
	const plant *robot;
	random_source random;
	size_t k; /* samples since it began */
	size_t kind, channel;
	sample first; /* the healthy sample that it began with */
} stretch;

typedef struct {
	const char *name;
	void (*spoil)(stretch *now, sample *s); /* makes of a healthy sample what is seen instead */
} fault;

enum { FAULTS = 12 };
extern const fault all_faults[FAULTS];

stretch stretch_begin(const plant *robot, random_source random, const sample *first);
void stretch_spoil(const fault *f, stretch *now, sample *s);

#endif
