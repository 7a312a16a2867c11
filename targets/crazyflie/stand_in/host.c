/* The firmware around the example, on a host: two tasks, queues, log and parameters by
 * name, and a vehicle to fly. The application task runs whenever it can, or not at all
 * while it is held up. */
#include "host.h"

#include "app.h"
#include "controller.h"
#include "controller_pid.h"
#include "queue.h"
#include "supervisor.h"
#include "task.h"
#include "usec_time.h"
#include "variable.h"

#include <math.h>
#include <string.h>
#include <ucontext.h>

static ucontext_t controller_task, application_task;
static uint32_t step;
circumstances around;

/* ---- Tasks and queues -------------------------------------------------------------- */

static void application(void) {
	appMain();
	while (1) { vTaskDelay(portMAX_DELAY); }
}

void vTaskDelay(TickType_t ticks) {
	(void)ticks;
	swapcontext(&application_task, &controller_task);
}

uint64_t usecTimestamp(void) {
	return (uint64_t)step * 1000;
}

xQueueHandle xQueueCreateStatic(size_t length, size_t size, uint8_t *items, StaticQueue_t *queue) {
	*queue = (StaticQueue_t){items, length, size, 0};
	return queue;
}

BaseType_t xQueueOverwrite(xQueueHandle queue, const void *item) {
	memcpy(queue->items, item, queue->size);
	queue->held = 1;
	return pdTRUE;
}

BaseType_t xQueueReceive(xQueueHandle queue, void *item, TickType_t patience) {
	if (!queue->held && patience > 0) { vTaskDelay(patience); }
	if (!queue->held) { return pdFALSE; }
	memcpy(item, queue->items, queue->size);
	queue->held = 0;
	return pdTRUE;
}

/* ---- Log and parameters --------------------------------------------------------------- */

extern const variable __start_variables[], __stop_variables[];

static const variable *find(const char *kind, const char *group, const char *name) {
	int here = 0;
	for (const variable *v = __start_variables; v < __stop_variables; v++) {
		if (!v->address) { here = !strcmp(v->kind ? v->kind : "", kind) && !strcmp(v->group, group); }
		if (here && v->address && !strcmp(v->name, name)) { return v; }
	}
	return NULL;
}

double read_variable(const char *kind, const char *group, const char *name) {
	const variable *v = find(kind, group, name);
	if (!v) { return NAN; }
	if (!strcmp(v->type, "u8")) { return *(uint8_t *)v->address; }
	if (!strcmp(v->type, "i8")) { return *(int8_t *)v->address; }
	if (!strcmp(v->type, "u16")) { return *(uint16_t *)v->address; }
	if (!strcmp(v->type, "u32")) { return *(uint32_t *)v->address; }
	return (double)*(float *)v->address;
}

int set_parameter(const char *group, const char *name, double value) {
	const variable *v = find("param", group, name);
	if (!v) { return 0; }
	if (!strcmp(v->type, "u8")) {
		*(uint8_t *)v->address = (uint8_t)value;
	} else {
		*(float *)v->address = (float)value;
	}
	return 1;
}

/* ---- Vehicle: tilts as told with a lag, slides with drag and wind ------------------------ */

#define DT 1e-3
#define GRAVITY 9.81
#define YAW 0.4 /* rad: nothing may depend on it */

static struct {
	double position[2], velocity[2], tilt[2], tilt_rate[2];
} vehicle;
static double wanted_tilt[2], integral[2];
static uint64_t noise_state;

static double noise(double deviation) {
	double sum = 0;
	for (int i = 0; i < 12; i++) {
		noise_state = noise_state * 6364136223846793005u + 1442695040888963407u;
		sum += (double)(noise_state >> 40) / (1 << 24) - 0.5;
	}
	return deviation * sum;
}

static double limit(double v, double most) {
	return fmin(fmax(v, -most), most);
}

static void move(void) {
	for (int i = 0; i < 2; i++) {
		const double speed = hypot(vehicle.velocity[0], vehicle.velocity[1]);
		vehicle.tilt_rate[i] += DT * (144 * (wanted_tilt[i] - vehicle.tilt[i]) - 17 * vehicle.tilt_rate[i]);
		vehicle.tilt[i] += DT * vehicle.tilt_rate[i];
		vehicle.velocity[i] += DT * (GRAVITY * tan(vehicle.tilt[i]) - 0.3 * vehicle.velocity[i] -
		                             around.drag * speed * vehicle.velocity[i] + around.wind[i]);
		vehicle.position[i] += DT * vehicle.velocity[i];
	}
}

static state_t measured(void) {
	const double tx = sin(vehicle.tilt[0]) + noise(0.003), ty = sin(vehicle.tilt[1]) + noise(0.003);
	const double w = sqrt((1 + sqrt(1 - tx * tx - ty * ty)) / 2); /* shortest turn of the z axis there */
	const double x = -ty / (2 * w), y = tx / (2 * w), c = cos(YAW / 2), s = sin(YAW / 2);
	state_t state = {.attitudeQuaternion = {(float)(x * c + y * s), (float)(y * c - x * s), (float)(w * s),
	                                        (float)(w * c)},
	                 .position = {(float)(vehicle.position[0] + noise(0.001)),
	                              (float)(vehicle.position[1] + noise(0.001)), 1},
	                 .velocity = {(float)(vehicle.velocity[0] + noise(0.01)),
	                              (float)(vehicle.velocity[1] + noise(0.01)), 0}};
	state.velocity.x += (float)around.fault;
	state.position.x += (float)around.glitch;
	return state;
}

/* ---- The stock controller: position, then velocity, then tilt ------------------------------ */

static double fed[2]; /* the last position setpoint it was given */

void controllerPidInit(void) {
	integral[0] = integral[1] = 0;
}

bool controllerPidTest(void) {
	return true;
}

void controllerPid(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                   const state_t *state, const stabilizerStep_t now) {
	const double wanted[2] = {(double)setpoint->position.x, (double)setpoint->position.y};
	const double position[2] = {(double)state->position.x, (double)state->position.y};
	const double velocity[2] = {(double)state->velocity.x, (double)state->velocity.y};
	const double degree = 3.14159265358979 / 180;
	(void)control;
	(void)sensors;
	if (!RATE_DO_EXECUTE(RATE_100_HZ, now)) { return; }
	for (int i = 0; i < 2; i++) {
		fed[i] = wanted[i];
		if (!isfinite(velocity[i])) { continue; } /* it keeps its tilt, for the test's sake */
		const double error = limit(2 * (wanted[i] - position[i]), 1.1) - velocity[i];
		integral[i] = limit(integral[i] + error / RATE_100_HZ, 20);
		wanted_tilt[i] = limit(25 * error + integral[i], 20) * degree;
	}
}

/* ---- Flying ---------------------------------------------------------------------------------- */

bool supervisorIsFlying(void) {
	return !around.on_ground;
}

void begin(uint64_t seed) {
	static char stack[1 << 16];
	memset(&vehicle, 0, sizeof vehicle);
	memset(&around, 0, sizeof around);
	noise_state = seed;
	step = 0;
	controllerOutOfTreeInit();
	getcontext(&application_task);
	application_task.uc_stack.ss_sp = stack;
	application_task.uc_stack.ss_size = sizeof stack;
	makecontext(&application_task, application, 0);
}

/* A figure of eight, 2 m long, once in `around.period` seconds; a hover where that is 0. */
static setpoint_t path(void) {
	setpoint_t setpoint = {.mode = {modeAbs, modeAbs, modeAbs}};
	if (around.period > 0) {
		const double w = 2 * 3.14159265358979 / around.period, t = DT * step;
		setpoint.position = (point_t){(float)sin(w * t), (float)(sin(2 * w * t) / 2), 1};
		setpoint.velocity = (velocity_t){(float)(w * cos(w * t)), (float)(w * cos(2 * w * t)), 0};
	}
	if (around.by_velocity) { setpoint.mode.x = setpoint.mode.y = modeVelocity; }
	if (around.broken_setpoint) { setpoint.position.x = NAN; }
	return setpoint;
}

flight fly(unsigned milliseconds) {
	flight sum = {0, 0, 0, 0};
	for (unsigned k = 0; k < milliseconds; k++) {
		const setpoint_t setpoint = path();
		const state_t state = measured();
		const sensorData_t sensors = {0};
		control_t control = {0};
		controllerOutOfTree(&control, &setpoint, &sensors, &state, ++step);
		if (!around.held_up) { swapcontext(&controller_task, &application_task); }
		move();

		const double ex = vehicle.position[0] - (double)setpoint.position.x;
		const double ey = vehicle.position[1] - (double)setpoint.position.y;
		sum.error += (ex * ex + ey * ey) / milliseconds;
		const int stock = fed[0] == (double)setpoint.position.x && fed[1] == (double)setpoint.position.y;
		const int planned = read_variable("log", "koopman", "mode") == 1;
		sum.planned += planned;
		sum.finite += isfinite(fed[0]) && isfinite(fed[1]);
		sum.stock_untouched += !planned && (stock || !RATE_DO_EXECUTE(RATE_100_HZ, step));
	}
	sum.error = sqrt(sum.error);
	return sum;
}
