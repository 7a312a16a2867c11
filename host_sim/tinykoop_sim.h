/* The simulator and the replay, as the tools call them.
 *
 * One C interface for all host tools (Python calls it through ctypes). Arrays
 * are row by row and double, whatever precision the estimator works in; any
 * output array may be null. Calls return TK_OK or TK_ERROR; after an error
 * tk_message() says what is wrong, where, and how to mend it.
 */
#ifndef TINYKOOP_SIM_H
#define TINYKOOP_SIM_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#define TK_API __declspec(dllexport)
#elif defined(__GNUC__)
#define TK_API __attribute__((visibility("default")))
#else
#define TK_API
#endif

enum { TK_OK = 0, TK_ERROR = -1 };

/* The message of a status of lib/, KOOP_E_..., one line. */
TK_API const char *tk_status_message(int status);

/* What the last failed call in this thread had to say, one line. */
TK_API const char *tk_message(void);

/* ---- Plant: the differential-drive robot ----------------------------------
 *
 * State x = [px (m), py (m), theta (rad)], input u = [v (m/s), omega (rad/s)].
 * Nominal kinematics of the paper (section "Nominal Kinematics", Euler steps)
 * or the same with a finer step; unmodelled effects act on top, in the order of
 * the table in effects.c. Times of effects count from the first row.
 */

/* How the pose moves in a step of constant velocities: along the heading at its
 * beginning, along the one half-way, along the exact arc, or along the heading at
 * its end (semi-implicit Euler, as physics engines step). */
enum { TK_EULER = 0, TK_MIDPOINT = 1, TK_ARC = 2, TK_SEMI_IMPLICIT = 3 };

/* Where an effect acts, in the order in which a step passes through them. */
enum { TK_ACTUATOR = 0, TK_PLANT = 1, TK_SENSOR = 2, TK_BLOCKS };

enum { TK_MAX_PARAMETERS = 6 };

/* One effect acting on [t0, t1), s. The meaning of the parameters is told by
 * tk_effect_parameter(). */
typedef struct tk_active {
	const char *effect;
	size_t n_parameters;
	double parameters[TK_MAX_PARAMETERS];
	double t0, t1;
} tk_active;

/* The effects of a platform (ddr, fwmav, quadrotor) in the order of action; null when there are no more. */
TK_API const char *tk_effect_name(const char *platform, size_t effect);
TK_API const char *tk_effect_formula(const char *platform, size_t effect);
/* Effects of one family look alike in a log. Those that are reported as another one are forms of it. */
TK_API const char *tk_effect_family(const char *platform, size_t effect);
TK_API const char *tk_effect_reported_as(const char *platform, size_t effect);
TK_API int tk_effect_block(const char *platform, size_t effect);
/* Whether it has a state of its own, as a lag has. */
TK_API int tk_effect_remembers(const char *platform, size_t effect);
TK_API size_t tk_effect_parameters(const char *platform, size_t effect);
/* Name, unit, bounds (refused outside) and a usual value; zero for all parameters is no effect. */
TK_API int tk_effect_parameter(const char *platform, size_t effect, size_t parameter, const char **name,
                               const char **unit, double *low, double *high, double *usual);

/* The measured states x (steps + 1 rows of 3) under commands u (steps rows of
 * 2) from the true state x0. */
TK_API int tk_ddr_simulate(const tk_active *effects, size_t n_effects, int integrator, double dt,
                           size_t steps, const double *x0, const double *u, double *x);

/* A log of the robot as tk_log_get() gives it. */
typedef struct tk_recording {
	size_t rows;
	double dt;             /* s */
	const double *x, *u;   /* rows of 3 and 2; the last command is not used */
	const int32_t *usable; /* rows - 1, or null: all transitions */
	size_t warm_up;        /* rows before a window from which actuators are rolled; 0: from the first row */
} tk_recording;

/* Predictions over many windows of one log. Actuator states (lag, delay,
 * backlash) are rolled along the log, through gaps too; the pose starts
 * in row starts[i] at the measured one, which sensor effects are undone from.
 * Written for every start and each of `steps` (how many steps later), 3 each:
 * the pose predicted as measured, and the measured pose less that one, along,
 * across (m, in the axes of the pose measured at the start) and in heading (rad,
 * wrapped). NaN where an unusable transition, or the end of the log, lies between. */
TK_API int tk_windows(const tk_active *effects, size_t n_effects, int integrator, const tk_recording *log,
                      size_t n_starts, const int64_t *starts, size_t n_steps, const int64_t *steps,
                      double *predicted, double *residual);

/* One step from the pose measured in each of `rows` (ascending), whose directions (cos, sin) are `facing`
 * (log->rows, 2). Actuators are rolled as by tk_windows. Written for each into the row of `beside` that `places` says:
 * where the step ends beside the pose measured in the next row, along, across (m, in the axes of that pose) and in
 * heading (rad, wrapped). reached, or null: what tk_reaches() has of these effects. */
TK_API int tk_steps(const tk_active *effects, size_t n_effects, int integrator, const tk_recording *log,
                    const double *facing, size_t n_rows, const int64_t *rows, const int64_t *places,
                    const double *reached, double *beside);

/* The commands (2 each) of steps from these rows behind the last effect that remembers (tk_effect_remembers()). */
TK_API int tk_reaches(const tk_active *effects, size_t n_effects, const tk_recording *log, size_t n_rows,
                      const int64_t *rows, double *reached);

/* ---- Plant: the flapping-wing vehicle --------------------------------------------
 *
 * A tailless vehicle of 26 g with two wings, its flight controller in the loop
 * (docs/flapping-wing.md). Axes: x forward, y left, z up; angles turn about
 * these, so positive pitch tips it forward. The log's x is what the controller
 * measures and estimates [gyro (rad/s), accelerometer (m/s^2), pitch, roll, yaw
 * (rad), yaw rate (rad/s)]; its u is what the controller commands: dihedral
 * (rad) in hover and pitch flights, wing twist (rad) in yaw flights. */

enum { TK_FWMAV_STATES = 21, TK_FWMAV_HZ = 100 };

typedef struct tk_flight {
	const char *manoeuvre; /* hover, pitch (climbing, tipping to and fro), yaw (turning); of a quadrotor see there */
	uint64_t seed;         /* of schedule, turbulence, noise */
	double noise;          /* factor of turbulence, IMU noise and bias; 1: as it flies, 0: none */
} tk_flight;

/* Flies from hover: x (rows of 10) and u (rows) at TK_FWMAV_HZ, and the true
 * state (rows of TK_FWMAV_STATES): position, velocity (world), quaternion (w, x,
 * y, z; body to world), angular velocity (body), wing-beat frequency (Hz) and
 * phase, then angle and rate of dihedral, twist and roll share. */
TK_API int tk_fwmav_fly(const tk_active *effects, size_t n_effects, const tk_flight *flight, size_t rows,
                        double *x, double *u, double *states);

/* The vehicle without its controller, from `state`, in still air but for effects: commands (steps
 * rows of 4: wing-beat frequency with a full battery (Hz), dihedral, twist, roll share), each held
 * for dt. yaw = 1: effects on u act on the twist, else on the dihedral. states: steps + 1 rows. */
TK_API int tk_fwmav_roll(const tk_active *effects, size_t n_effects, int yaw, double dt, size_t steps,
                         const double *state, const double *commands, double *states);

/* ---- Plant: the quadrotor ------------------------------------------------------
 *
 * Four rotors in an X, M1 front right, M2 rear right, M3 rear left, M4 front left, and a flight controller
 * (docs/quadrotor.md). Axes: x forward, y left, z up; angles turn about these, so positive pitch tips it forward. The
 * log's u is thrust asked for of each rotor (0 to 1) and the battery's voltage (V); its x is position (m), velocity
 * (m/s), acceleration without gravity (m/s^2), all in the world's axes, roll, pitch, yaw (rad) and angular velocity
 * (rad/s, body axes). A vehicle is an array of its parameters in the order of tk_quadrotor_parameter(); null is a
 * Crazyflie 2.1. */

enum {
	TK_QUADROTOR_STATES = 21,
	TK_QUADROTOR_SENSED = 15,
	TK_QUADROTOR_COMMANDS = 5,
	TK_QUADROTOR_HZ = 100,
};

/* Name, unit, bounds and the Crazyflie's value of a parameter of a vehicle; fails when there are no more. */
TK_API int tk_quadrotor_parameter(size_t parameter, const char **name, const char **unit, double *low,
                                  double *high, double *value);

/* Factor by which bounds and usual sizes of effects in this unit are larger for this vehicle than for a Crazyflie. */
TK_API int tk_quadrotor_scale(const double *vehicle, const char *unit, double *by);

/* Flies: hover, legs (take off, 2 m along x, land, and back) or mixed (steps of place, heading and height): x (rows of
 * TK_QUADROTOR_SENSED) and u (rows of TK_QUADROTOR_COMMANDS) at TK_QUADROTOR_HZ, and the true states. */
TK_API int tk_quadrotor_fly(const tk_active *effects, size_t n_effects, const double *vehicle,
                            const tk_flight *flight, size_t rows, double *x, double *u, double *states);

/* The vehicle without its controller and far from the ground, from `state`, in still air but for effects: commands
 * (steps rows of TK_QUADROTOR_COMMANDS: four requests, voltage, NaN where it is not known), each held for dt. states:
 * steps + 1 rows of TK_QUADROTOR_STATES: position, velocity (world), quaternion (w, x, y, z; body to world), angular
 * velocity (body), four shares of full thrust, and of a slung load the horizontal part (x, y, world) of the unit
 * vector along its string, and its rate. Position and velocity are those of the centre of mass. */
TK_API int tk_quadrotor_roll(const tk_active *effects, size_t n_effects, const double *vehicle, double dt,
                             size_t steps, const double *state, const double *commands, double *states);

/* A flight of a quadrotor as tk_log_get() gives it, NaN where the log has no number, and how to follow it. */
typedef struct tk_quadrotor_flown {
	size_t rows;
	double dt;             /* s */
	const double *x, *u;   /* rows of TK_QUADROTOR_SENSED and TK_QUADROTOR_COMMANDS */
	const int32_t *usable; /* rows - 1, or null: all transitions */
	const double *vehicle; /* or null */
	const double *gain;    /* TK_QUADROTOR_CORRECTED x TK_QUADROTOR_SENSED */
	const double *push;    /* rows of 6, or null: what else accelerates the body, m/s^2 and rad/s^2, body axes */
} tk_quadrotor_flown;

/* Predictions from each row starts[i], in rising order, each of the rising `steps` later: n_starts x n_steps x
 * TK_QUADROTOR_SENSED. */
typedef struct tk_ahead {
	size_t n_starts, n_steps;
	const int64_t *starts, *steps;
	double *predicted;
} tk_ahead;

/* What is corrected: position (m), velocity (m/s), both in axes that turn with the heading, tilt (rad, about body axes),
 * angular velocity (rad/s), shares of full thrust (4), accelerations by the turbulent air (m/s^2, rad/s^2). */
enum { TK_QUADROTOR_CORRECTED = 22 };

/* An observer follows a flight, far from the ground, with these effects: each row is predicted (rows of
 * TK_QUADROTOR_SENSED), then the state corrected by gain times what was missed; what the log lacks is predicted, too,
 * and corrects nothing. NaN in the first row and after an unusable transition, where the observer begins again with
 * what the row has. states: as corrected, rows of TK_QUADROTOR_STATES, or null. ahead, or null: it also runs on by
 * itself, NaN where an unusable transition or the end of the log lies between. */
TK_API int tk_quadrotor_follow(const tk_active *effects, size_t n_effects, const tk_quadrotor_flown *log,
                               double *predicted, double *states, const tk_ahead *ahead);

/* The noise of a log, as the filter of tk_whiten() takes it. Sensor noise is white with a variance of its own
 * in each row, beside a coloured part, AR(1); so is random motion. */
typedef struct tk_noise {
	size_t n, r, c;                             /* states, axes of random motion, channels */
	const double *start;                        /* n: standard deviation of where a run of rows begins */
	const double *C;                            /* c x n: channels of states */
	const double *process, *process_rho;        /* r: standard deviation; correlation from row to row */
	const double *coloured, *coloured_rho;      /* c: the same */
} tk_noise;

/* The reference path, row by row, begun again in rows where `begins` is not 0: A (n x n) takes a deviation from it to
 * the next row, G (n x r) random motion; variance (c) is that of white sensor noise, infinite where nothing was
 * measured. */
typedef struct tk_path {
	const int32_t *begins;
	const double *A, *G, *variance;
} tk_path;

/* What the filter makes of the noise alone, for any columns: in each row and channel, gains (rows x c x N, with N =
 * n + r, and c more where sensor noise is coloured) and units (rows x c), one over the standard deviation of the
 * innovation, 0 where nothing was measured. log_det: the sum of the logarithms of the innovations' variances. */
TK_API int tk_gains(const tk_noise *noise, size_t rows, const tk_path *path, double *gains, double *units,
                    double *log_det);

/* Innovations, over their standard deviations, of `columns` columns by these gains: D (n x columns) in each row is what
 * a step adds to the deviation, E (c x columns, or c x 1 where `shared`) is what the channels show. */
TK_API int tk_whiten(const tk_noise *noise, size_t rows, size_t columns, int shared, const tk_path *path, const double *gains,
                     const double *units, const double *D, const double *E, double *out);

/* `count` noises at once: rows of r or c for each; white: variance of sensor noise; coloured may be null. */
typedef struct tk_noises {
	size_t count, n, r, c;
	const double *start, *C;
	const double *process, *process_rho;
	const double *white, *coloured, *coloured_rho;
} tk_noises;

/* Deviance, -2 log likelihood but for a constant, of one residual under each of the noises, into `out`; the variances of
 * `path` are multiples of the noises' own. */
TK_API int tk_deviances(const tk_noises *noises, size_t rows, const tk_path *path, const double *D, const double *E,
                        double *out);

/* Rows of a command u behind a gear with play of `half` to either side, which begins in its middle. */
TK_API void tk_play(size_t rows, double half, const double *u, double *out);

/* The mean over each row of what goes to the command u by `most` (> 0) per row at the most, and begins there. */
TK_API void tk_limited_rate(size_t rows, double most, const double *u, double *out);

/* y[k] = pole y[k - 1] + u[k], from zero; pole and y are complex: 2 numbers each, real part first. */
TK_API void tk_pole(size_t rows, const double *pole, const double *u, double *out);

/* A flight of the flapping-wing vehicle as tk_log_get() gives it, and how to follow it. */
typedef struct tk_flown {
	size_t rows;
	double dt;             /* s */
	const double *x, *u;   /* rows of 10 and 1 */
	const int32_t *usable; /* rows - 1, or null: all transitions */
	int yaw;               /* u is the twist, else the dihedral */
	double heading;        /* rad: what is held where u is not the twist */
	const double *gain;    /* TK_FWMAV_CORRECTED x TK_FWMAV_SENSED */
	const double *push;    /* rows of 6, or null: what else accelerates the body, m/s^2 and rad/s^2 */
} tk_flown;

/* What is corrected: velocity (m/s, body axes), tilt (rad, about body axes), angular velocity
 * (rad/s), accelerations by the turbulent air (m/s^2, rad/s^2), lift (weights). What is sensed: gyro (rad/s),
 * accelerometer (m/s^2), roll, pitch and yaw as estimated on board (rad; of the air's turbulence
 * only what lasts 0.1 s is foretold). */
enum { TK_FWMAV_CORRECTED = 16, TK_FWMAV_SENSED = 9 };

/* An observer follows a flight with these effects: each row is predicted (rows of
 * TK_FWMAV_SENSED), then the state corrected by gain times what was missed. Servos follow their
 * commands as the log has them: u, and for the other two what the simulated controller makes of the
 * logged attitude. NaN in the first row and after an unusable transition, where the observer begins
 * again, level with the logged attitude and at rest. From each row starts[i], in rising order, it
 * also runs on by itself: `ahead`, TK_FWMAV_SENSED for every start and each of the rising `steps`, NaN where
 * an unusable transition or the end of the log lies between; may be null. */
TK_API int tk_fwmav_follow(const tk_active *effects, size_t n_effects, const tk_flown *log, double *predicted,
                           size_t n_starts, const int64_t *starts, size_t n_steps, const int64_t *steps,
                           double *ahead);

/* ---- Estimator: lib/ in either precision ---------------------------------- */

enum { TK_MAX_SETTINGS = 8 };

/* The regulators of lib/, in the order of KOOP_REGULATORS; null when there are no more. */
TK_API const char *tk_regulator_name(size_t regulator);
TK_API size_t tk_regulator_settings(size_t regulator);
/* Name, bounds (refused outside) and default of a setting, in float64. */
TK_API int tk_regulator_setting(size_t regulator, size_t setting, const char **name, double *low, double *high,
                                double *usual);
/* A part of a dictionary: constant, angles, products, polynomials or rbf, as KOOP(part_kind) in tinykoop_api.h. */
typedef struct tk_part {
	const char *kind;
	size_t n;                       /* indices in `states`; of products pairs of them */
	const unsigned char *states;
	int wrapped;                    /* of angles */
	size_t low, high;               /* of polynomials */
	size_t count;                   /* of rbf: count centers (rows of n) and widths, and the kernel's name */
	const double *centers, *widths;
	const char *kernel;
} tk_part;

/* A dictionary of your own, in both precisions. It must outlive the estimators that are made with it. */
typedef struct tk_dictionary tk_dictionary;

/* Of parts, by koopf_combine() and koopd_combine(); all that is given is copied. */
TK_API int tk_dictionary_new(const char *name, size_t n_states, size_t n_parts, const tk_part *parts,
                             tk_dictionary **dictionary);
/* Whose states the caller lifts: calls take psi instead of x. */
TK_API int tk_dictionary_outside(const char *name, size_t n_states, size_t n_lifted, tk_dictionary **dictionary);
/* A koopf_dictionary and a koopd_dictionary of a compiled source, which must outlive it. One lift of each is tried. */
TK_API int tk_dictionary_given(const void *f32, const void *f64, tk_dictionary **dictionary);
TK_API void tk_dictionary_free(tk_dictionary *dictionary);

/* Settings of a gate; zeros mean the library's defaults. */
typedef struct tk_gate_settings {
	double multiple, floor;
	size_t patience, hold;
} tk_gate_settings;

typedef struct tk_settings {
	const tk_dictionary *own; /* or null: `dictionary` names one */
	const char *dictionary; /* poly_ddr, rbf_ddr, poly_fwmav, rbf_fwmav; wide_fwmav, N = 40, for timing */
	const char *regulator;  /* one of tk_regulator_name() */
	const char *form;       /* plain, sqrt, textbook */
	int precision;          /* 32 or 64 */
	int check;              /* KOOP_CHECK_... */
	int n_inputs;
	double lambda, p0;
	size_t n_settings; /* 0: the regulator's defaults; else all of its settings */
	const double *settings;
	const struct tk_gate_settings *gate; /* learns through a gate; null: without */
} tk_settings;

typedef struct tk_estimator tk_estimator;

TK_API int tk_estimator_new(const tk_settings *settings, tk_estimator **estimator);
TK_API void tk_estimator_free(tk_estimator *estimator);
/* n states, N lifted states, m inputs */
TK_API int tk_estimator_sizes(const tk_estimator *estimator, size_t *n, size_t *N, size_t *m);
TK_API int tk_estimator_get_theta(const tk_estimator *estimator, double *theta);  /* N x (N+m) */
TK_API int tk_estimator_set_theta(tk_estimator *estimator, const double *theta);  /* N x (N+m) */
TK_API int tk_estimator_get_covariance(const tk_estimator *estimator, double *P); /* (N+m)^2 */
TK_API int tk_estimator_reset_covariance(tk_estimator *estimator, double p0);
/* The bytes that koopf_model_load() or koopd_model_load() takes, with P if `covariance`; call with
 * bytes = null for the size. */
TK_API int tk_estimator_model(const tk_estimator *estimator, int covariance, void *bytes, size_t *size);
TK_API int tk_estimator_load(tk_estimator *estimator, const void *bytes, size_t size);

/* psi (rows of N) of x (rows of n), lifted in the estimator's precision. */
TK_API int tk_lift(const tk_estimator *estimator, size_t rows, const double *x, double *psi);

/* What a replay writes down, one row for each of the `steps` transitions. A
 * transition that is not usable or was refused has NaN in error and innovation
 * where there is none to give. What is null is not computed, and changes nothing else:
 * the norms of Theta and P take many times as long as the update. */
typedef struct tk_trace {
	double *error;                    /* |x_next - predicted|, first n lifted states, before the update */
	double *predicted;                /* n */
	double *innovation;               /* norm over all lifted states */
	int32_t *status;                  /* KOOP_OK or why the sample was refused; 1: not usable */
	int32_t *frozen;                  /* 1: the regulator left P unchanged */
	int32_t *positive_definite;       /* of P after the update, by a factorisation in double */
	int32_t *trust;                   /* gate_trust() after the update; -1 without a gate */
	double *trace, *min_diagonal;     /* of P, as the estimator reports them */
	double *norm_a, *norm_b, *norm_p; /* Frobenius */
	/* Theta and P before every transition k with k % every == 0, from k = 0 */
	size_t every;
	double *theta;      /* (steps + every - 1) / every times N x (N+m) */
	double *covariance; /* the same number of times (N+m)^2 */
} tk_trace;

/* Feeds x (steps + 1 rows of n) and u (steps rows of m) through the estimator. psi (steps + 1 rows of N): x as the
 * caller lifted it, or null.
 * usable (steps values, may be null: all) tells which transitions may be
 * learned from and scored. learn = 0 only predicts. */
TK_API int tk_replay(tk_estimator *estimator, size_t steps, const double *x, const double *psi,
                     const double *u, const int32_t *usable, int learn, const tk_trace *trace);

/* What an update says of the estimator, as KOOP(health); status: KOOP_OK or why the sample was refused. */
typedef struct tk_health {
	int32_t status, frozen, positive_definite, short_memory, winding_up, trust; /* trust: gate_trust(), or -1 */
	double innovation, trace, min_diagonal;
} tk_health;

/* Learns from one transition: from `now` by u (m) to `next`, which are states (n), or if `lifted` already lifted (N). */
TK_API int tk_update(tk_estimator *estimator, int lifted, const double *now, const double *u, const double *next,
                     tk_health *health);

/* psi one step later (rows of N) from `now` (rows of n, or if `lifted` of N) under u (rows of m). */
TK_API int tk_predict(tk_estimator *estimator, int lifted, size_t rows, const double *now, const double *u,
                      double *psi_next);

/* psi (steps + 1 rows of N) from `start` on, a state or if `lifted` already lifted, under u (steps rows of m): the
 * linear model alone, without lifting again. */
TK_API int tk_rollout(tk_estimator *estimator, int lifted, size_t steps, const double *start, const double *u,
                      double *psi);

/* The same recursion on your own regressors instead of a lifted log:
 * zeta (steps rows of N+m) and target (steps rows of N), `repeats` times over.
 * For soaks of millions of updates. */
typedef struct tk_soak {
	uint64_t updates; /* that were taken */
	uint64_t refused;
	int64_t lost_positive_definite_at; /* first update after which P is not; -1: never */
	int64_t non_finite_at;             /* first that gave or would have given Inf or NaN; -1: never */
} tk_soak;

TK_API int tk_estimator_soak(tk_estimator *estimator, size_t steps, const double *zeta, const double *target,
                             size_t repeats, tk_soak *result);

/* ---- Control: Koopman-MPC on the learned model --------------------------------- */

typedef struct tk_mpc_settings {
	size_t n_states, n_inputs, horizon; /* n tracked states, m inputs, H */
	const double *Q, *R, *S;            /* n x n; m x m; m x m or null */
	const double *u_min, *u_max;        /* m */
	const double *u_safe;               /* m, or null: 0 */
	double tolerance;                   /* of the KKT residual; 0: the library's */
	int method;                /* KOOP_MPC_... */
	/* Another solver in the library's place, or null: reads Theta (N x (N+2)), psi (N)
	 * and the reference (horizon rows of 3), writes the input; not 0: it has none. */
	int (*solver)(const double *theta, const double *psi, const double *reference, double *u);
} tk_mpc_settings;

/* What a closed-loop run writes down, one row for each step. */
typedef struct tk_control_trace {
	double *x;        /* steps + 1 rows of 3 */
	double *u;        /* 2 */
	int32_t *status;  /* of the solver: not KOOP_OK where the safe input (0, 0) was given */
	double *residual; /* KKT residual */
	int32_t *iterations;
	double *solve_us;   /* condensing and solving, microseconds of wall time */
	double *innovation; /* norm over all lifted states; NaN where nothing was learned */
	int32_t *model;     /* supervised: KOOP_SUPERVISOR_..., what the input was planned on */
	int32_t *resets;    /* supervised: how often the learner was started again so far */
	size_t every;       /* as in tk_trace */
	double *theta, *covariance;
} tk_control_trace;

/* The supervisor's settings; zeros mean the library's defaults. */
typedef struct tk_supervisor_settings {
	const double *offline; /* Theta, N x (N+2) */
	double min_cosine, min_gain, max_gain, max_error_ratio, max_residual, max_tracking_ratio;
	size_t patience, renewal;
} tk_supervisor_settings;

/* Drives the robot along `reference` (steps + horizon + 1 rows of 3) from x0,
 * learning at every step if `learn`; under the supervisor unless `supervisor` is null. */
TK_API int tk_control(tk_estimator *estimator, const tk_mpc_settings *mpc, const tk_active *effects,
                      size_t n_effects, double dt, size_t steps, const double *x0, const double *reference,
                      int learn, const tk_supervisor_settings *supervisor, const tk_control_trace *trace);

/* The controller by itself, for problems that were written down. */
typedef struct tk_controller tk_controller;

typedef struct tk_solution {
	int status; /* KOOP_OK, or why the safe input was given */
	size_t iterations;
	double residual, microseconds;
} tk_solution;

TK_API int tk_controller_new(const tk_mpc_settings *settings, int precision, size_t N,
                             tk_controller **controller);
TK_API void tk_controller_free(tk_controller *controller);
/* Forgets the plan: the next solve is a cold one. */
TK_API int tk_controller_reset(tk_controller *controller);
/* Limits (m each) from the next solve on, which keeps its warm start. */
TK_API int tk_controller_limits(tk_controller *controller, const double *u_min, const double *u_max);
/* plan (horizon rows of m) for Theta (N x (N+m)), psi (N) and reference (horizon rows of n), and u (m), the input
 * to give: the first of the plan, or the safe input. u_before (m): the input applied last, null without S. */
TK_API int tk_controller_solve(tk_controller *controller, const double *theta, const double *psi,
                               const double *reference, const double *u_before, double *u, double *plan,
                               tk_solution *solution);

/* The supervisor of this learner, with its gate if it has one, and this controller, with the offline model that the
 * settings name. Later calls take the same two. */
typedef struct tk_guard tk_guard;

TK_API int tk_guard_new(const tk_supervisor_settings *settings, tk_estimator *estimator, tk_controller *controller,
                        tk_guard **guard);
TK_API void tk_guard_free(tk_guard *guard);
/* What the last input was planned on, KOOP_SUPERVISOR_..., and how often the learner was started again. */
TK_API int tk_guard_model(const tk_guard *guard, int *model, size_t *resets);
/* As tk_update() and tk_controller_solve(), by supervisor_update() and supervisor_control(). */
TK_API int tk_guard_update(tk_guard *guard, tk_estimator *estimator, int lifted, const double *now, const double *u,
                           const double *next, tk_health *health);
TK_API int tk_guard_solve(tk_guard *guard, tk_estimator *estimator, tk_controller *controller, const double *psi,
                          const double *reference, const double *u_before, double *u, double *plan,
                          tk_solution *solution);

/* The library's low-pass in this precision (32 or 64) over x (rows x n), sampled at `rate` (Hz), into y.
 * Begins again after a transition that may not be used (rows - 1 values, may be null); a refused row is NaN.
 */
TK_API int tk_lowpass(int precision, double cutoff, double rate, size_t rows, size_t n, const double *x,
                      const int32_t *usable, double *y);

/* The library's dead-zone threshold, in double: the eta-quantile of `scores`, which get sorted. */
TK_API int tk_threshold(double *scores, size_t count, double eta, double *delta);

/* ---- Logs: CSV, contract section 3 ------------------------------------------ */

typedef struct tk_log tk_log;

/* platform: ddr, fwmav or quadrotor. Refuses a bad file with file, line and column. A quadrotor's log may lack
 * vbat and columns of the state, which are NaN then. */
TK_API int tk_log_read(const char *path, const char *platform, tk_log **log);
TK_API void tk_log_free(tk_log *log);
TK_API size_t tk_log_rows(const tk_log *log);
TK_API double tk_log_dt(const tk_log *log); /* s */
/* rows x n, rows x m, rows, and for each transition k -> k + 1 whether it may be
 * used (rows - 1 values): not across a change of seg, not on masked rows */
TK_API int tk_log_get(const tk_log *log, double *t, double *x, double *u, int32_t *usable);
/* Writes the platform's columns; t = k dt. u has rows rows. What a quadrotor's log may lack is left out if it is NaN
 * throughout. */
TK_API int tk_log_write(const char *path, const char *platform, size_t rows, double dt, const double *x,
                        const double *u);

/* ---- Sizes of the library's storage ----------------------------------------- */

/* Numbers of reals, for N lifted states of which n are the state itself, m inputs
 * and a horizon of H steps: the macros of tinykoop.h and tinykoop_supervisor.h. */
typedef struct tk_storage {
	size_t learner_sqrt, learner_plain, gate_sqrt, gate_plain;
	size_t mpc_newton, mpc_gradient, mpc_rate; /* mpc_rate: on top, with an input-rate penalty */
	size_t supervisor;
	size_t model; /* Theta, as stored for firmware, without its header */
} tk_storage;

TK_API int tk_sizes(size_t n_lifted, size_t n_states, size_t n_inputs, size_t horizon, tk_storage *sizes);

#endif
