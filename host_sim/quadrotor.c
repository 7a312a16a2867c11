/* The quadrotor by itself: a rigid body, four rotors with lag, drag, what is fixed to it or hangs on it. */
#include "quadrotor.h"

#include <math.h>
#include <string.h>

#include "message.h"

/* ---- Parameters ------------------------------------------------------------------ */

#define QUADROTOR_ROW(name, unit, low, high, value) {#name, unit, low, high, value},
static const tk_parameter parameters[] = {QUADROTOR_PARAMETERS(QUADROTOR_ROW)};
enum { PARAMETERS = sizeof parameters / sizeof *parameters };

int tk_quadrotor_parameter(size_t parameter, const char **name, const char **unit, double *low, double *high,
                           double *value) {
	if (parameter >= PARAMETERS) { return fail("a quadrotor has only %d parameters", PARAMETERS); }
	const tk_parameter *p = &parameters[parameter];
	*name = p->name;
	*unit = p->unit;
	*low = p->low;
	*high = p->high;
	*value = p->usual;
	return TK_OK;
}

int quadrotor_from(const double *given, quadrotor *vehicle) {
	double values[PARAMETERS];
	for (size_t i = 0; i < PARAMETERS; i++) {
		const tk_parameter *p = &parameters[i];
		values[i] = given ? given[i] : p->usual;
		if (!(values[i] >= p->low && values[i] <= p->high)) {
			return fail("quadrotor: %s is %g %s, it must be between %g and %g", p->name, values[i], p->unit,
			            p->low, p->high);
		}
	}
	memcpy(vehicle, values, sizeof values);
	if (quadrotor_hover_request(vehicle) < 0.9) { return TK_OK; }
	return fail("quadrotor: four rotors of %g N do not carry %g kg with reserve; check thrust_full and mass",
	            vehicle->thrust_full, vehicle->mass);
}

double quadrotor_hover_request(const quadrotor *vehicle) {
	return vehicle->mass * QUADROTOR_GRAVITY / (ROTORS * vehicle->thrust_full);
}

void quadrotor_hover(const quadrotor *vehicle, double *state) {
	memset(state, 0, TK_QUADROTOR_STATES * sizeof *state);
	state[QUAD_POSITION + 2] = 1;
	state[QUAD_ATTITUDE] = 1;
	for (size_t i = 0; i < ROTORS; i++) { state[QUAD_ROTOR + i] = quadrotor_hover_request(vehicle); }
}

void quadrotor_place(const quadrotor *vehicle, size_t rotor, double *place) {
	static const double front[ROTORS] = {1, -1, -1, 1}, left[ROTORS] = {-1, -1, 1, 1};
	const double half = vehicle->arm * sqrt(0.5);
	place[0] = half * front[rotor];
	place[1] = half * left[rotor];
}

double quadrotor_turn(size_t rotor) {
	return rotor % 2 ? 1 : -1; /* M1 and M3 turn to the left and push the body to the right */
}

/* ---- Forces ------------------------------------------------------------------------ */

/* Mass, centre of mass (x, y) and inertia about it of the body and what is fixed to it. */
typedef struct body {
	double mass, centre[2];
	double xx, yy, zz, xy; /* kg m^2; xy as it stands in the tensor */
} body;

static body loaded(const quadrotor *vehicle, const double *payload) {
	const double mass = vehicle->mass + payload[0];
	body b = {mass, {payload[1] / mass, payload[2] / mass}, 0, 0, 0, 0};
	const double x2 = payload[3] - mass * b.centre[0] * b.centre[0];
	const double y2 = payload[4] - mass * b.centre[1] * b.centre[1];
	b.xx = vehicle->inertia_x + y2;
	b.yy = vehicle->inertia_y + x2;
	b.zz = vehicle->inertia_z + x2 + y2;
	b.xy = mass * b.centre[0] * b.centre[1] - payload[5];
	return b;
}

/* What turns a body by `turn`: inertia times it. */
static void times_inertia(const body *b, const double *turn, double *product) {
	product[0] = b->xx * turn[0] + b->xy * turn[1];
	product[1] = b->xy * turn[0] + b->yy * turn[1];
	product[2] = b->zz * turn[2];
}

static void over_inertia(const body *b, const double *moment, double *turn) {
	const double det = b->xx * b->yy - b->xy * b->xy;
	turn[0] = (b->yy * moment[0] - b->xy * moment[1]) / det;
	turn[1] = (b->xx * moment[1] - b->xy * moment[0]) / det;
	turn[2] = moment[2] / b->zz;
}

/* Share of thrust at this battery's voltage. */
static double power(const quadrotor *vehicle, double vbat) {
	return isnan(vbat) ? 1 : 1 + vehicle->voltage_slope * (vbat - vehicle->voltage);
}

/* Adds thrust and moment of the rotors about the centre of mass, body axes. */
static void add_rotors(const quadrotor *vehicle, const quadrotor_signal *signal, const double *rotor,
                       const double *centre, double *force, double *moment) {
	const double full = vehicle->thrust_full * power(vehicle, signal->vbat);
	for (size_t i = 0; i < ROTORS; i++) {
		const double thrust = full * rotor[i] * signal->thrust[i];
		double place[2];
		quadrotor_place(vehicle, i, place);
		force[2] += thrust;
		moment[0] += (place[1] - centre[1]) * thrust;
		moment[1] -= (place[0] - centre[0]) * thrust;
		moment[2] += quadrotor_turn(i) * vehicle->torque_per_thrust * thrust;
	}
}

/* Adds the drag of the rotors and the body, which goes with the velocity through the air. */
static void add_drag(const quadrotor *vehicle, const quadrotor_signal *signal, double R[3][3],
                     const double *velocity, double *force) {
	const double through[3] = {velocity[0] - signal->wind[0], velocity[1] - signal->wind[1], velocity[2]};
	const double drag[3] = {vehicle->drag_xy, vehicle->drag_xy, vehicle->drag_z};
	for (size_t i = 0; i < 3; i++) {
		const double air = R[0][i] * through[0] + R[1][i] * through[1] + R[2][i] * through[2];
		force[i] -= vehicle->mass * (drag[i] + signal->drag) * air;
	}
}

/* ---- A load on a string --------------------------------------------------------------- */

static const double SWING_DAMPING = 0.2; /* 1/s, of the load by the air; chosen */

static double dot(const double *a, const double *b) {
	return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void to_body(double R[3][3], const double *world, double *own) {
	for (size_t i = 0; i < 3; i++) { own[i] = R[0][i] * world[0] + R[1][i] * world[1] + R[2][i] * world[2]; }
}

/* Where the string points, and how that changes: unit vector and its rate, world. */
static void string_of(const double *state, double *along, double *rate) {
	const double *s = state + QUAD_SWING, *r = state + QUAD_SWINGING;
	along[0] = s[0];
	along[1] = s[1];
	along[2] = -sqrt(fmax(1 - s[0] * s[0] - s[1] * s[1], 1e-4));
	rate[0] = r[0];
	rate[1] = r[1];
	rate[2] = -(s[0] * r[0] + s[1] * r[1]) / along[2];
}

/* Acceleration (body axes) of the point `at`, from the centre of mass, of a body that turns. */
static void at_point(const double *acceleration, const double *turning, const double *spin, const double *at,
                     double *out) {
	double around[3] = {0};
	memcpy(out, acceleration, 3 * sizeof *out);
	add_cross(turning, at, out);
	add_cross(spin, at, around);
	add_cross(spin, around, out);
}

/* The pull of a taut string: body and load keep their distance. Changes acceleration (body axes, gravity
 * left out) and angular acceleration; writes the derivative of the swing. */
static void pull(const body *b, const double *load, double R[3][3], const double *state, double *acceleration,
                 double *turning, double *derivative) {
	const double mass = load[0], length = load[1];
	const double at[3] = {load[2] - b->centre[0], load[3] - b->centre[1], 0};
	double along[3], rate[3], own[3], own_rate[3], free_point[3], moment[3] = {0}, turned[3], given[3] = {0};
	string_of(state, along, rate);
	to_body(R, along, own);
	to_body(R, rate, own_rate);
	at_point(acceleration, turning, state + QUAD_SPIN, at, free_point);
	add_cross(at, own, moment);
	over_inertia(b, moment, turned);
	add_cross(turned, at, given);
	for (size_t i = 0; i < 3; i++) { given[i] += own[i] / b->mass; } /* of the point, by a pull of 1 N */
	const double apart = length * dot(own_rate, own_rate) - dot(own, free_point);
	const double tension = fmax(apart / (1 / mass + dot(own, given)), 0);
	double left[3], swing[3];
	for (size_t i = 0; i < 3; i++) {
		acceleration[i] += tension * own[i] / b->mass;
		turning[i] += tension * turned[i];
		left[i] = (-tension * own[i] / mass - free_point[i] - tension * given[i]) / length;
	}
	for (size_t i = 0; i < 3; i++) { swing[i] = R[i][0] * left[0] + R[i][1] * left[1] + R[i][2] * left[2]; }
	for (size_t i = 0; i < 2; i++) {
		derivative[QUAD_SWING + i] = rate[i];
		derivative[QUAD_SWINGING + i] = swing[i] - SWING_DAMPING * rate[i];
	}
}

/* ---- Motion ------------------------------------------------------------------------------ */

static void rotor_derivative(const quadrotor *vehicle, const quadrotor_signal *signal, const double *state,
                             double *derivative) {
	for (size_t i = 0; i < ROTORS; i++) {
		derivative[QUAD_ROTOR + i] = (signal->asked[i] - state[QUAD_ROTOR + i]) / vehicle->motor_lag;
	}
}

/* Acceleration but for gravity and angular acceleration, body axes; the swing's derivative. */
static void accelerations(const quadrotor *vehicle, const quadrotor_signal *signal, double R[3][3],
                          const double *state, double *acceleration, double *turning, double *derivative) {
	const body b = loaded(vehicle, signal->payload);
	const double *spin = state + QUAD_SPIN;
	double force[3] = {0}, moment[3], momentum[3];
	memcpy(moment, signal->moment, sizeof moment);
	add_rotors(vehicle, signal, state + QUAD_ROTOR, b.centre, force, moment);
	add_drag(vehicle, signal, R, state + QUAD_VELOCITY, force);
	times_inertia(&b, spin, momentum);
	add_cross(momentum, spin, moment); /* Euler's equations */
	over_inertia(&b, moment, turning);
	for (size_t i = 0; i < 3; i++) {
		acceleration[i] = force[i] / b.mass + signal->turbulence[i];
		turning[i] += signal->turbulence[3 + i];
	}
	memset(derivative + QUAD_SWING, 0, 4 * sizeof *derivative);
	if (signal->load[0] > 0) { pull(&b, signal->load, R, state, acceleration, turning, derivative); }
}

void quadrotor_derivative(const quadrotor *vehicle, const quadrotor_signal *signal, const double *state,
                          double *derivative) {
	double R[3][3], acceleration[3];
	quaternion_to_matrix(state + QUAD_ATTITUDE, R);
	accelerations(vehicle, signal, R, state, acceleration, derivative + QUAD_SPIN, derivative);
	for (size_t i = 0; i < 3; i++) {
		derivative[QUAD_POSITION + i] = state[QUAD_VELOCITY + i];
		derivative[QUAD_VELOCITY + i] = dot(R[i], acceleration);
	}
	derivative[QUAD_VELOCITY + 2] -= QUADROTOR_GRAVITY;
	quaternion_derivative(state + QUAD_ATTITUDE, state + QUAD_SPIN, derivative + QUAD_ATTITUDE);
	rotor_derivative(vehicle, signal, state, derivative);
}

void quadrotor_step(const quadrotor *vehicle, const quadrotor_signal *signal, double dt, double *state) {
	static const double node[4] = {0, 0.5, 0.5, 1}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
	double slope[TK_QUADROTOR_STATES] = {0}, sum[TK_QUADROTOR_STATES] = {0}, at[TK_QUADROTOR_STATES];
	for (size_t stage = 0; stage < 4; stage++) {
		for (size_t i = 0; i < TK_QUADROTOR_STATES; i++) { at[i] = state[i] + node[stage] * dt * slope[i]; }
		quadrotor_derivative(vehicle, signal, at, slope);
		for (size_t i = 0; i < TK_QUADROTOR_STATES; i++) { sum[i] += weight[stage] * slope[i]; }
	}
	for (size_t i = 0; i < TK_QUADROTOR_STATES; i++) { state[i] += dt * sum[i]; }
	quaternion_normalise(state + QUAD_ATTITUDE);
}

int quadrotor_check(const double *state, double t) {
	double sum = 0;
	for (size_t i = 0; i < TK_QUADROTOR_STATES; i++) { sum += state[i]; }
	if (isfinite(sum)) { return TK_OK; }
	return fail(
	    "the simulated flight diverged (NaN or Inf) at t = %g s: check effect parameters and commands", t);
}

/* ---- Sensors -------------------------------------------------------------------------------- */

void quadrotor_sense(const quadrotor *vehicle, const quadrotor_signal *signal, const double *state,
                     double *x) {
	double derivative[TK_QUADROTOR_STATES], R[3][3];
	quadrotor_derivative(vehicle, signal, state, derivative);
	quaternion_to_matrix(state + QUAD_ATTITUDE, R);
	memcpy(x, state, 6 * sizeof *x); /* position and velocity */
	for (size_t i = 0; i < 3; i++) {
		x[6 + i] = derivative[QUAD_VELOCITY + i] + dot(R[i], signal->accelerometer);
		x[12 + i] = state[QUAD_SPIN + i] + signal->gyro[i];
	}
	quaternion_to_angles(state + QUAD_ATTITUDE, x + 9);
}

/* ---- Effects ---------------------------------------------------------------------------------- */

/* How much larger sizes in this unit are than on a Crazyflie. */
static double scale(const quadrotor *vehicle, const char *unit) {
	quadrotor small;
	quadrotor_from(NULL, &small);
	const double mass = vehicle->mass / small.mass, size = vehicle->arm / small.arm;
	if (strcmp(unit, "kg") == 0) { return mass; }
	if (strcmp(unit, "m") == 0) { return size; }
	return strcmp(unit, "N m") == 0 ? mass * size : 1;
}

void quadrotor_effects_for(const quadrotor *vehicle, quadrotor_store *store, tk_effects *table) {
	*table = (tk_effects){quadrotor_effects.platform, store->list, quadrotor_effects.count};
	for (size_t e = 0; e < table->count; e++) {
		tk_effect *effect = &store->effects[e];
		*effect = *quadrotor_effects.effects[e];
		store->list[e] = effect;
		for (size_t i = 0; i < effect->n_parameters; i++) {
			tk_parameter *p = &effect->parameters[i];
			const double by = scale(vehicle, p->unit);
			p->low *= by;
			p->high *= by;
			p->usual *= by;
		}
	}
}

int tk_quadrotor_scale(const double *vehicle, const char *unit, double *by) {
	quadrotor v;
	if (!unit || !by) { return fail("unit and by must be given"); }
	if (quadrotor_from(vehicle, &v) != TK_OK) { return TK_ERROR; }
	*by = scale(&v, unit);
	return TK_OK;
}

quadrotor_signal quadrotor_signal_at(const effect_chain *effects, double vbat, double t, double dt) {
	quadrotor_signal signal = {
	    .common = {.t = t, .dt = dt}, .vbat = vbat, .thrust = {1, 1, 1, 1}, .vibration = 1};
	effects_apply(effects, TK_PLANT, &signal.common);
	effects_apply(effects, TK_SENSOR, &signal.common);
	return signal;
}

void quadrotor_command(const effect_chain *effects, quadrotor_signal *signal) {
	effects_apply(effects, TK_ACTUATOR, &signal->common);
	for (size_t i = 0; i < ROTORS; i++) { signal->asked[i] = fmax(0, fmin(1, signal->asked[i])); }
}

/* ---- Without its controller ----------------------------------------------------------------- */

static const double FINE = 0.005; /* s, of a step at most */

static int roll(const quadrotor *vehicle, const effect_chain *effects, double dt, size_t steps,
                const double *commands, double *states) {
	const size_t parts = (size_t)ceil(dt / FINE - 1e-9);
	int status = TK_OK;
	for (size_t k = 0; k < steps && status == TK_OK; k++) {
		const double *command = commands + TK_QUADROTOR_COMMANDS * k;
		double *now = states + (k + 1) * TK_QUADROTOR_STATES;
		quadrotor_signal signal = quadrotor_signal_at(effects, command[ROTORS], (double)k * dt, dt);
		memcpy(signal.asked, command, sizeof signal.asked);
		quadrotor_command(effects, &signal);
		memcpy(now, now - TK_QUADROTOR_STATES, TK_QUADROTOR_STATES * sizeof *now);
		for (size_t i = 0; i < parts; i++) { quadrotor_step(vehicle, &signal, dt / (double)parts, now); }
		status = quadrotor_check(now, (double)(k + 1) * dt);
	}
	return status;
}

int tk_quadrotor_roll(const tk_active *effects, size_t n_effects, const double *vehicle, double dt,
                      size_t steps, const double *state, const double *commands, double *states) {
	if (!state || !commands || !states || (n_effects && !effects)) {
		return fail("state, commands, states and effects must be given");
	}
	if (!(dt > 0 && dt <= 1)) { return fail("dt is %g s, it must be positive and at most 1 s", dt); }
	quadrotor v;
	quadrotor_store store;
	tk_effects table;
	effect_chain chain;
	if (quadrotor_from(vehicle, &v) != TK_OK) { return TK_ERROR; }
	quadrotor_effects_for(&v, &store, &table);
	if (effects_open(&chain, &table, effects, n_effects, dt, (double)steps * dt) != TK_OK) {
		return TK_ERROR;
	}
	memcpy(states, state, TK_QUADROTOR_STATES * sizeof *state);
	const int status = roll(&v, &chain, dt, steps, commands, states);
	effects_free(&chain);
	return status;
}
