/* The table of effects. Within a block they act in this order, whatever the
 * caller's: a command is cut by its sender, arrives late, and goes through the
 * drive to the wheels; there it becomes a speed over ground, and at last a
 * measured pose. */
#include "effects.h"

#include <string.h>

#include "message.h"

/* One line each. */
#define EFFECTS(EFFECT)                                                                                      \
	EFFECT(saturation)                                                                                       \
	EFFECT(transport_delay)                                                                                  \
	EFFECT(dead_band)                                                                                        \
	EFFECT(backlash)                                                                                         \
	EFFECT(actuator_lag)                                                                                     \
	EFFECT(speed_gain)                                                                                       \
	EFFECT(battery_sag)                                                                                      \
	EFFECT(yaw_gain)                                                                                         \
	EFFECT(wheel_asymmetry)                                                                                  \
	EFFECT(yaw_bias)                                                                                         \
	EFFECT(clock_scale)                                                                                      \
	EFFECT(pacejka_slip)                                                                                     \
	EFFECT(lateral_skid)                                                                                     \
	EFFECT(stribeck_friction)                                                                                \
	EFFECT(world_drift)                                                                                      \
	EFFECT(sensor_lever_arm)                                                                                 \
	EFFECT(heading_bias)                                                                                     \
	EFFECT(measurement_noise)

#define DECLARE(name) extern const tk_effect name;
#define ENTER(name) &name,

EFFECTS(DECLARE)

static const tk_effect *const table[] = {EFFECTS(ENTER)};

enum { COUNT = sizeof table / sizeof *table };

const tk_effect *effect_by_name(const char *name) {
	for (size_t i = 0; i < COUNT; i++) {
		if (name && strcmp(table[i]->name, name) == 0) { return table[i]; }
	}
	return NULL;
}

size_t tk_effect_count(void) {
	return COUNT;
}

const char *tk_effect_name(size_t effect) {
	return effect < COUNT ? table[effect]->name : NULL;
}

int tk_effect_block(size_t effect) {
	return effect < COUNT ? table[effect]->block : fail("there are only %d effects", COUNT);
}

size_t tk_effect_parameters(size_t effect) {
	return effect < COUNT ? table[effect]->n_parameters : 0;
}

int tk_effect_parameter(size_t effect, size_t parameter, const char **name, const char **unit, double *low,
                        double *high, double *usual) {
	if (parameter >= tk_effect_parameters(effect)) {
		return fail("there is no parameter %zu of effect %zu", parameter, effect);
	}
	const tk_parameter *p = &table[effect]->parameters[parameter];
	*name = p->name;
	*unit = p->unit;
	*low = p->low;
	*high = p->high;
	*usual = p->usual;
	return TK_OK;
}
