/* A motor that turns a load through an elastic shaft: an FMU for co-simulation, FMI 2.0. build.py makes drive.fmu of it.
 *
 * Value references are indices into Drive.value; the order is that of modelDescription.xml. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

#pragma GCC diagnostic ignored "-Wunused-parameter" /* FMI tells more than this drive has to know */

#define GUID "two-mass-drive-1"
#define LONGEST_STEP 5e-4 /* s, of the integration: the shaft swings with 14 Hz */

enum { MOTOR_PHI, LOAD_PHI, MOTOR_W, LOAD_W, STATES };
enum { TAU = STATES, MOTOR_J, LOAD_J, SHAFT_C, SHAFT_D, FRICTION, VALUES };

typedef struct {
	double value[VALUES];
} Drive;

static const Drive START = {{[MOTOR_J] = 0.01, [LOAD_J] = 0.03, [SHAFT_C] = 60.0, [SHAFT_D] = 0.1, [FRICTION] = 0.04}};

/* ---- motion ---- */

static void rate(const double *v, double *out)
{
	double shaft = v[SHAFT_C] * (v[MOTOR_PHI] - v[LOAD_PHI]) + v[SHAFT_D] * (v[MOTOR_W] - v[LOAD_W]);
	out[MOTOR_PHI] = v[MOTOR_W];
	out[LOAD_PHI] = v[LOAD_W];
	out[MOTOR_W] = (v[TAU] - shaft - v[FRICTION] * v[MOTOR_W]) / v[MOTOR_J];
	out[LOAD_W] = (shaft - v[FRICTION] * v[LOAD_W]) / v[LOAD_J];
}

/* The rate where `slope` has led after h seconds. */
static void rate_after(const double *v, const double *slope, double h, double *out)
{
	double moved[VALUES];
	memcpy(moved, v, sizeof moved);
	for (int i = 0; i < STATES; i++) moved[i] += h * slope[i];
	rate(moved, out);
}

/* Runge and Kutta's classical method. */
static void advance(double *v, double h)
{
	double k[4][STATES];
	rate(v, k[0]);
	rate_after(v, k[0], h / 2, k[1]);
	rate_after(v, k[1], h / 2, k[2]);
	rate_after(v, k[2], h, k[3]);
	for (int i = 0; i < STATES; i++) v[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real dt, fmi2Boolean keep)
{
	if (!(dt >= 0)) return fmi2Error;
	int steps = (int)ceil(dt / LONGEST_STEP);
	for (int i = 0; i < steps; i++) advance(((Drive *)c)->value, dt / steps);
	return fmi2OK;
}

/* ---- variables ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real out[])
{
	const double *v = ((Drive *)c)->value;
	double slope[STATES];
	rate(v, slope);
	for (size_t i = 0; i < n; i++) {
		if (vr[i] >= VALUES + STATES) return fmi2Error;
		out[i] = vr[i] < VALUES ? v[vr[i]] : slope[vr[i] - VALUES]; /* der(..) lies behind the others */
	}
	return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real in[])
{
	for (size_t i = 0; i < n; i++) {
		if (vr[i] >= VALUES) return fmi2Error;
		((Drive *)c)->value[vr[i]] = in[i];
	}
	return fmi2OK;
}

/* ---- life of an instance ---- */

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
	if (type != fmi2CoSimulation || strcmp(guid, GUID)) return NULL;
	Drive *drive = malloc(sizeof *drive);
	if (drive) *drive = START;
	return drive;
}

void fmi2FreeInstance(fmi2Component c)
{
	free(c);
}

fmi2Status fmi2Reset(fmi2Component c)
{
	*(Drive *)c = START;
	return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranced, fmi2Real tolerance, fmi2Real start, fmi2Boolean stops,
                               fmi2Real stop)
{
	return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
	return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
	return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
	return fmi2OK;
}

const char *fmi2GetTypesPlatform(void)
{
	return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
	return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
	return fmi2OK;
}

/* ---- snapshots ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
	if (!*state) *state = malloc(sizeof(Drive));
	if (!*state) return fmi2Error;
	memcpy(*state, c, sizeof(Drive));
	return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
	memcpy(c, state, sizeof(Drive));
	return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
	free(*state);
	*state = NULL;
	return fmi2OK;
}

/* ---- what this FMU does not have: modelDescription.xml says so ---- */

#define LACKS(name, ...)                                                                                               \
	fmi2Status name(fmi2Component c, __VA_ARGS__)                                                                      \
	{                                                                                                                  \
		return fmi2Error;                                                                                              \
	}

LACKS(fmi2GetInteger, const fmi2ValueReference vr[], size_t n, fmi2Integer out[])
LACKS(fmi2GetBoolean, const fmi2ValueReference vr[], size_t n, fmi2Boolean out[])
LACKS(fmi2GetString, const fmi2ValueReference vr[], size_t n, fmi2String out[])
LACKS(fmi2SetInteger, const fmi2ValueReference vr[], size_t n, const fmi2Integer in[])
LACKS(fmi2SetBoolean, const fmi2ValueReference vr[], size_t n, const fmi2Boolean in[])
LACKS(fmi2SetString, const fmi2ValueReference vr[], size_t n, const fmi2String in[])
LACKS(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
LACKS(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte out[], size_t size)
LACKS(fmi2DeSerializeFMUstate, const fmi2Byte in[], size_t size, fmi2FMUstate *state)
LACKS(fmi2GetDirectionalDerivative, const fmi2ValueReference of[], size_t n_of, const fmi2ValueReference to[], size_t n_to,
      const fmi2Real move[], fmi2Real out[])
LACKS(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real in[])
LACKS(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real out[])
LACKS(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *out)
LACKS(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *out)
LACKS(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *out)
LACKS(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *out)
LACKS(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *out)

fmi2Status fmi2CancelStep(fmi2Component c)
{
	return fmi2Error;
}
