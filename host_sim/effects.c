/* The tables of effects. Within a block they act in this order, whatever the
 * caller's: a command is cut by its sender, arrives late, and goes through the
 * drive to the wheels; there it becomes a speed over ground, and at last a
 * measured pose. Or it arrives late at the servos of the wings, which beat the
 * air, which moves, and at last it is seen by a gyro. A quadrotor's requests arrive late at its rotors, which carry
 * the body and what hangs on it through the air; then sensors see it. */
#include "effects.h"

#include <string.h>

#include "message.h"

/* One line each. */
#define DDR_EFFECTS(EFFECT)                                                                                  \
	EFFECT(saturation)                                                                                       \
	EFFECT(saturation_soft)                                                                                  \
	EFFECT(wheel_saturation)                                                                                 \
	EFFECT(transport_delay)                                                                                  \
	EFFECT(dead_band)                                                                                        \
	EFFECT(dead_zone_shifted)                                                                                \
	EFFECT(wheel_dead_band)                                                                                  \
	EFFECT(backlash)                                                                                         \
	EFFECT(backlash_angle)                                                                                   \
	EFFECT(acceleration_limit)                                                                               \
	EFFECT(actuator_lag)                                                                                     \
	EFFECT(speed_lag)                                                                                        \
	EFFECT(yaw_lag)                                                                                          \
	EFFECT(second_order_lag)                                                                                 \
	EFFECT(speed_gain)                                                                                       \
	EFFECT(battery_sag)                                                                                      \
	EFFECT(yaw_gain)                                                                                         \
	EFFECT(wheel_asymmetry)                                                                                  \
	EFFECT(yaw_bias)                                                                                         \
	EFFECT(clock_scale)                                                                                      \
	EFFECT(pacejka_slip)                                                                                     \
	EFFECT(slip_general)                                                                                     \
	EFFECT(slip_saturating)                                                                                  \
	EFFECT(lateral_skid)                                                                                     \
	EFFECT(stribeck_friction)                                                                                \
	EFFECT(friction_coulomb)                                                                                 \
	EFFECT(friction_general)                                                                                 \
	EFFECT(world_drift)                                                                                      \
	EFFECT(sensor_lever_arm)                                                                                 \
	EFFECT(heading_bias)                                                                                     \
	EFFECT(measurement_noise)

#define FWMAV_EFFECTS(EFFECT)                                                                                \
	EFFECT(fwmav_delay)                                                                                      \
	EFFECT(fwmav_lag)                                                                                        \
	EFFECT(fwmav_gain)                                                                                       \
	EFFECT(fwmav_trim_bias)                                                                                  \
	EFFECT(fwmav_battery_sag)                                                                                \
	EFFECT(fwmav_asymmetry)                                                                                  \
	EFFECT(fwmav_damping)                                                                                    \
	EFFECT(fwmav_vibration)                                                                                  \
	EFFECT(fwmav_gust)                                                                                       \
	EFFECT(fwmav_gyro_bias)

#define QUADROTOR_EFFECTS(EFFECT)                                                                            \
	EFFECT(quadrotor_transport_delay)                                                                        \
	EFFECT(quadrotor_motor_lag)                                                                              \
	EFFECT(quadrotor_rotor1_thrust)                                                                          \
	EFFECT(quadrotor_rotor2_thrust)                                                                          \
	EFFECT(quadrotor_rotor3_thrust)                                                                          \
	EFFECT(quadrotor_rotor4_thrust)                                                                          \
	EFFECT(quadrotor_thrust_gain)                                                                            \
	EFFECT(quadrotor_battery_sag)                                                                            \
	EFFECT(quadrotor_payload)                                                                                \
	EFFECT(quadrotor_slung_load)                                                                             \
	EFFECT(quadrotor_trim)                                                                                   \
	EFFECT(quadrotor_wind)                                                                                   \
	EFFECT(quadrotor_drag)                                                                                   \
	EFFECT(quadrotor_gyro_bias)                                                                              \
	EFFECT(quadrotor_accel_bias)                                                                             \
	EFFECT(quadrotor_vibration)

#define DECLARE(name) extern const tk_effect name;
#define ENTER(name) &name,

DDR_EFFECTS(DECLARE)
FWMAV_EFFECTS(DECLARE)
QUADROTOR_EFFECTS(DECLARE)

static const tk_effect *const ddr_list[] = {DDR_EFFECTS(ENTER)};
static const tk_effect *const fwmav_list[] = {FWMAV_EFFECTS(ENTER)};
static const tk_effect *const quadrotor_list[] = {QUADROTOR_EFFECTS(ENTER)};

const tk_effects ddr_effects = {"ddr", ddr_list, sizeof ddr_list / sizeof *ddr_list};
const tk_effects fwmav_effects = {"fwmav", fwmav_list, sizeof fwmav_list / sizeof *fwmav_list};
const tk_effects quadrotor_effects = {"quadrotor", quadrotor_list,
                                      sizeof quadrotor_list / sizeof *quadrotor_list};

const tk_effect *effect_by_name(const tk_effects *table, const char *name) {
	for (size_t i = 0; i < table->count; i++) {
		if (name && strcmp(table->effects[i]->name, name) == 0) { return table->effects[i]; }
	}
	return NULL;
}

/* Null after fail(). */
static const tk_effect *effect_at(const char *platform, size_t effect) {
	const tk_effects *tables[] = {&ddr_effects, &fwmav_effects, &quadrotor_effects};
	for (size_t i = 0; i < sizeof tables / sizeof *tables; i++) {
		if (!platform || strcmp(tables[i]->platform, platform) != 0) { continue; }
		if (effect < tables[i]->count) { return tables[i]->effects[effect]; }
		fail("%s has only %zu effects", platform, tables[i]->count);
		return NULL;
	}
	fail("there is no platform named '%s': use ddr, fwmav or quadrotor", platform ? platform : "");
	return NULL;
}

const char *tk_effect_name(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e ? e->name : NULL;
}

const char *tk_effect_formula(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e ? e->formula : NULL;
}

const char *tk_effect_family(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e && e->family ? e->family : tk_effect_name(platform, effect);
}

const char *tk_effect_reported_as(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e && e->reported_as ? e->reported_as : tk_effect_name(platform, effect);
}

int tk_effect_block(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e ? e->block : TK_ERROR;
}

int tk_effect_remembers(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e && (e->n_memory || e->history);
}

size_t tk_effect_parameters(const char *platform, size_t effect) {
	const tk_effect *e = effect_at(platform, effect);
	return e ? e->n_parameters : 0;
}

int tk_effect_parameter(const char *platform, size_t effect, size_t parameter, const char **name,
                        const char **unit, double *low, double *high, double *usual) {
	const tk_effect *e = effect_at(platform, effect);
	if (!e) { return TK_ERROR; }
	if (parameter >= e->n_parameters) { return fail("%s has no parameter %zu", e->name, parameter); }
	const tk_parameter *p = &e->parameters[parameter];
	*name = p->name;
	*unit = p->unit;
	*low = p->low;
	*high = p->high;
	*usual = p->usual;
	return TK_OK;
}
