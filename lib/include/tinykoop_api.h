/* The interface of TinyKoop in one precision. tinykoop.h includes this file once for float (koopf_) and once for
 * double (koopd_). Include tinykoop.h instead. */

/* Returns the message of a status: a static text of one line, never null. An unknown status has a message too. */
const char *KOOP(status_message)(int status);

/* Checks at run time that arithmetic is that of IEEE 754, with NaN and rounding to nearest. Call it once at
 * boot: it takes a few hundred instructions. Do not fly unless it returns KOOP_OK.
 *
 * KOOP_E_ARITHMETIC: the compiler flags are unsafe (the sources request strict arithmetic themselves, but a
 * compiler may not understand the request), or the processor is set to another rounding mode. Harmless
 * contraction of a * b + c and subnormal numbers flushed to 0 are accepted. */
int KOOP(self_test)(void);

/* ---- Dictionary: how a state is lifted ---------------------------------- */

/* A dictionary lifts x (n values) to psi (N values): the observables of paper, section "Generalized Recursive
 * Koopman Learning". The first n values of psi must be x itself, so that the state can be read from a prediction.
 *
 * To define your own dictionary, fill this struct; examples/own_dictionary.c does. Scale the functions to
 * magnitudes within a factor of 100 of each other. */
typedef struct KOOP(dictionary) {
	const char *name; /* not null; a stored model holds its hash and is refused under another name */
	size_t n_states; /* n >= 1 */
	size_t n_lifted; /* N, n <= N <= KOOP_MAX_DIM */
	/* Writes all N values of psi for the n values of x. It need not check for NaN. `self` is this dictionary. */
	void (*lift)(const struct KOOP(dictionary) *self, const KOOP_REAL *x, KOOP_REAL *psi);
	const void *context; /* settings for `lift`, which finds them in self->context; may be null */
} KOOP(dictionary);

/* Differential-drive robot, x = [px (m), py (m), theta (rad)], paper section
 * "Dictionary selection":
 *   poly  N = 7   [px py theta  px^2 py^2  sin cos]
 *   rbf   N = 22  [px py theta  16 Gaussians of (px, py)  sin cos atan2(sin, cos)]
 * The Gaussians have sigma = 1.5 m and centres on a 4 x 4 grid over [-3, 3] m. The paper
 * specifies neither; these values reproduce its figures. */
extern const KOOP(dictionary) KOOP(poly_ddr);
extern const KOOP(dictionary) KOOP(rbf_ddr);

/* Flapping-wing MAV, x = [gyro (3, rad/s), accelerometer (3, m/s^2), pitch,
 * roll, yaw (rad), yaw rate (rad/s)]. The paper does not define these dictionaries;
 * lib/src/dictionary_fwmav.c gives the reasons for this choice:
 *   poly  N = 20  [x  squares and products of the gyro rates  sin, cos of pitch and roll]
 *   rbf   N = 30  [x  16 Gaussians of (pitch, roll)  sin, cos of pitch and roll] */
extern const KOOP(dictionary) KOOP(poly_fwmav);
extern const KOOP(dictionary) KOOP(rbf_fwmav);

/* Lifts a state: psi (N) = Psi(x (n)). Do not use psi unless the status is KOOP_OK.
 *
 * KOOP_E_SIZE: the dictionary's n or N is out of range. KOOP_E_INPUT: x is not finite. KOOP_E_OVERFLOW: psi is
 * not finite.
 *
 * The four dictionaries above use the library's own sine and cosine, not those of libm, with an error below one
 * unit in the last place. They refuse angles beyond 2^20 rad (2^30 rad in double) with KOOP_E_OVERFLOW. Beyond
 * 10^4 rad (10^6 rad in double) the resolution of the angle itself is the larger error: wrap angles. */
int KOOP(lift)(const KOOP(dictionary) *dictionary, const KOOP_REAL *x, KOOP_REAL *psi);

/* ---- Dictionaries of your own from parts ----------------------------------------------- */

/* A part of a combined dictionary: functions of the state. `kind` is one of the part_.. below, or your own; `context`
 * points to the settings of this kind. */
typedef struct KOOP(part_kind) {
	/* Number of functions of a state of n_states values; 0 if the settings are out of range. */
	size_t (*count)(const void *context, size_t n_states);
	/* Writes them for the state x; returns the place behind the last. */
	KOOP_REAL *(*write)(const void *context, const KOOP_REAL *x, KOOP_REAL *out);
} KOOP(part_kind);

typedef struct KOOP(part) {
	const KOOP(part_kind) *kind;
	const void *context;
} KOOP(part);

/* part_constant: the function 1, for what acts always, as gravity does. Its context may be null. */
extern const KOOP(part_kind) KOOP(part_constant);

/* part_angles: sine and cosine of each of n states (rad), and if `wrapped` the angle in [-pi, pi]. */
typedef struct KOOP(angles) {
	const unsigned char *states; /* n indices of states, n >= 1 */
	size_t n;
	int wrapped; /* 0 or 1 */
} KOOP(angles);
extern const KOOP(part_kind) KOOP(part_angles);

/* part_products: x[i] x[j] of n pairs. */
typedef struct KOOP(products) {
	const unsigned char *pairs; /* n times two indices of states, n >= 1 */
	size_t n;
} KOOP(products);
extern const KOOP(part_kind) KOOP(part_products);

/* part_polynomials: all monomials of n states with a total degree from `low` to `high`, by degree, and in a degree as
 * in x0 x0, x0 x1, .., x1 x1, ... The states themselves, of degree 1, are in every dictionary: begin with 2. */
typedef struct KOOP(polynomials) {
	const unsigned char *states; /* n indices of states, n >= 1 */
	size_t n;
	size_t low, high; /* low <= high <= KOOP_MAX_DEGREE */
} KOOP(polynomials);
extern const KOOP(part_kind) KOOP(part_polynomials);

/* A radial basis function of r: turns four squares r^2 >= 0 into four values. */
typedef struct KOOP(kernel) {
	void (*values)(KOOP_REAL *square);
} KOOP(kernel);

extern const KOOP(kernel) KOOP(gaussian);             /* exp(-r^2 / 2) */
extern const KOOP(kernel) KOOP(inverse_quadratic);    /* 1 / (1 + r^2) */
extern const KOOP(kernel) KOOP(inverse_multiquadric); /* 1 / sqrt(1 + r^2) */
extern const KOOP(kernel) KOOP(multiquadric);         /* sqrt(1 + r^2) */
extern const KOOP(kernel) KOOP(thin_plate);           /* r^2 ln r */

/* part_rbf: `count` radial basis functions kernel(|x - center| / width) of n states, Euclidean norm. */
typedef struct KOOP(rbf) {
	const unsigned char *states; /* n indices of states, n >= 1 */
	size_t n;
	size_t count;             /* >= 1 */
	const KOOP_REAL *centers; /* count rows of n, finite, units of the states */
	const KOOP_REAL *widths;  /* count, >= FLT_MIN or DBL_MIN, finite, units of the states; of Gaussians, sigma */
	const KOOP(kernel) *kernel; /* one of the above, or your own */
} KOOP(rbf);
extern const KOOP(part_kind) KOOP(part_rbf);

/* The parts of a dictionary, in order. All that it points to must outlive the dictionary. */
typedef struct KOOP(combination) {
	const KOOP(part) *parts;
	size_t n_parts; /* 0: the state alone */
} KOOP(combination);

/* Makes a dictionary: psi is the state (n_states), then the functions of each part. n_lifted is found. The settings
 * are checked here, and must not change later. Other fields of *dictionary need not be set before.
 *
 * KOOP_E_SIZE: N would exceed KOOP_MAX_DIM, or n_states is out of range. KOOP_E_RANGE: a setting of a part is out of
 * range, or a pointer in it is null. A refusal leaves *dictionary as it was. */
int KOOP(combine)(KOOP(dictionary) *dictionary, const char *name, size_t n_states,
                  const KOOP(combination) *combination);

/* ---- Regulator: how a sample changes Theta and P -------------------------- */

struct KOOP(rls);
struct KOOP(config);

/* How one sample changes Theta and P (paper, eq. (4), with the modifications of its section
 * "Robust Covariance-Regulated Modifications"):
 *
 *     g = (P + inflate zeta zeta') zeta,   s = zeta' g
 *     Theta += weight error g' / (noise + s)                   if update_theta
 *     P = (P + inflate zeta zeta' - g g' / (noise + s)) scale  if update_covariance
 *
 * A forgetting factor that changes with every sample is noise = lambda, scale = 1 / lambda. A negative noise
 * with noise + s < 0, and inflate = 0, adds to P along g, as directional forgetting does (Kulhavy and Karny,
 * 1984); Theta then takes |noise + s|, and `weight` makes up for what is another denominator of Theta. It takes an
 * extension, which knows s. */
typedef struct KOOP(step) {
	KOOP_REAL noise;   /* lambda, or 1 if `inflate` does the forgetting; not 0 */
	KOOP_REAL scale;   /* > 0: 1 / lambda for exponential forgetting, else 1 */
	KOOP_REAL inflate; /* >= 0; SIFt: (1 - lambda) / (lambda zeta' P^-1 zeta); else 0 */
	KOOP_REAL deflate; /* with needs_information: P^-1 loses deflate (P^-1 zeta)(P^-1 zeta)', and gains zeta zeta' */
	KOOP_REAL trace;   /* the trace to which P is scaled at the end; 0: P is not scaled */
	KOOP_REAL weight;  /* factor on the change of Theta, >= 0; 1 without an extension */
	int update_theta;      /* 0: Theta stays as it is */
	int update_covariance; /* 0: P stays as it is */
} KOOP(step);

/* A setting of a regulator. All fields of the struct of its settings are reals, in the order of its list. */
typedef struct KOOP(setting) {
	char name[12];       /* that of the field, at most 11 characters; in place, so that only what is used is linked */
	KOOP_REAL low, high; /* smallest and largest accepted value, finite */
} KOOP(setting);

/* The part of the library that serves extensions; it is not linked without one. The fields are private. */
typedef struct KOOP(engine) {
	size_t (*size)(struct KOOP(rls) *rls, size_t covariance);
	void (*restart)(struct KOOP(rls) *rls);
	int (*attend)(struct KOOP(rls) *rls, KOOP_REAL innovation, int *frozen);
} KOOP(engine);

extern const KOOP(engine) KOOP(reg_engine);

/* What a regulator may have besides `decide`: a memory, a decision that needs zeta' P zeta, and further changes of
 * P. All but `engine` may be null.
 *
 * rls->memory is the regulator's own part of the estimator's storage. It is kept from sample to sample, copied
 * with the learned model, saved with P, and covered by the checksum. `decide`, `adjust` and `reshape` may write to
 * it freely: if the sample is refused in the end, it is as it was before, bit for bit. A counter is exact up to
 * 2^24 in float. */
typedef struct KOOP(extension) {
	const KOOP(engine) *engine; /* &koopf_reg_engine or &koopd_reg_engine */
	/* Number of reals of memory. Of `rls`, the configuration and the sizes are known. */
	size_t (*memory)(const struct KOOP(rls) *rls);
	/* P has become p0 I, at the start or by a reset: fills the memory, which comes in as 0. */
	void (*reset)(struct KOOP(rls) *rls);
	/* Changes `step` when s = zeta' P zeta is known and rls->gain is P zeta (d), unless `decide` has left both Theta
	 * and P as they are. Of the work vectors, only the third (work + 2 n_regressors_padded) may be overwritten. */
	int (*adjust)(struct KOOP(rls) *rls, KOOP_REAL s, KOOP(step) *step);
	/* Changes P further after `step`, by rls_add_information(), rls_add_covariance(), rls_scale_covariance() and
	 * form->reset(), as many times as needed; zeta is lost with the first. The storage holds a copy of P, in case
	 * the sample is refused. Not with needs_information: these calls do not maintain P^-1. */
	int (*reshape)(struct KOOP(rls) *rls);
} KOOP(extension);

/* A regulator decides how each sample changes Theta and P. To define your own, fill this struct by field names;
 * examples/own_regulator.c does. Only `name` and `decide` are required.
 *
 * During a sample, rls->config.settings points to the settings, rls->zeta is the regressor (d), and rls->error the
 * innovation psi_next - Theta zeta (N). Both are zero in the padding. */
typedef struct KOOP(regulator) {
	const char *name;      /* as on command lines */
	int needs_information; /* 1: the plain form stores P^-1 too, for form->information() */
	/* Sets `step` for this sample, before P zeta is known. `step` comes in as exponential forgetting; `innovation`
	 * is the norm |psi_next - Theta zeta|. The work vectors may be overwritten, as by form->diagonal(). A status
	 * other than KOOP_OK, of this call and of those below, refuses the sample. */
	int (*decide)(struct KOOP(rls) *rls, KOOP_REAL innovation, KOOP(step) *step);
	int forgets; /* 1: with its least settings it forgets at every sample, in all directions: the memory is
	              * 1 / (1 - lambda) samples. 0 if it may stop forgetting for long */
	const KOOP(setting) *settings; /* n_settings of them */
	size_t n_settings;
	const void *defaults; /* struct of settings for config.settings = null; required if there are settings */
	/* Checks what the ranges of the settings cannot, KOOP_OK or KOOP_E_RANGE, and may set rls->nominal_trace, which
	 * comes in as p0 d. Of `rls`, the configuration and the sizes are known. May be null. */
	int (*check)(struct KOOP(rls) *rls);
	const KOOP(extension) *extension; /* memory and further calls; null: none */
} KOOP(regulator);

/* The regulators are those of the list KOOP_REGULATORS in tinykoop.h, each as reg_ and its name. */
#define KOOP_DECLARE(name) extern const KOOP(regulator) KOOP(reg_##name);
KOOP_REGULATORS(KOOP_DECLARE)
#undef KOOP_DECLARE

/* Settings of dz_cs and dz_ks. */
typedef struct KOOP(dead_zone) {
	KOOP_REAL delta; /* threshold of the innovation's norm, >= 0, finite, in units of psi; by default 0.01 */
} KOOP(dead_zone);

/* Settings of ct. */
typedef struct KOOP(constant_trace) {
	KOOP_REAL tau0; /* the trace, > 0, below an eighth of the largest real; 0, the default: p0 d */
} KOOP(constant_trace);

/* Settings of sift. */
typedef struct KOOP(information_floor) {
	KOOP_REAL eps_sift; /* min zeta' zeta that carries information, finite, >= 0; by default 1e-10. 0: no min */
} KOOP(information_floor);

/* Settings of reset. */
typedef struct KOOP(resetting) {
	KOOP_REAL period;    /* samples from one reset of P to the next, 0 to 2^24; 0: never for this; by default 500 */
	KOOP_REAL min_trace; /* P is reset below this fraction of its initial trace p0 d, 0 to 1; by default 0.01 */
} KOOP(resetting);

/* Settings of vrf. */
typedef struct KOOP(variable_rate) {
	KOOP_REAL fast, slow; /* samples in the two means of the squared innovation, 1 <= fast < slow <= 2^24; 10 and 100 */
	KOOP_REAL eta;        /* how strongly their ratio makes it forget, 0 to 1000; by default 0.1 */
} KOOP(variable_rate);

/* Settings of er and cr. */
typedef struct KOOP(attractor) {
	KOOP_REAL p_inf; /* P tends to p_inf I without excitation, > 0, below an eighth of the largest real; 0, the default: p0 */
} KOOP(attractor);

/* Settings of kulhavy. */
typedef struct KOOP(direction) {
	KOOP_REAL min_square; /* min zeta' zeta that changes P, finite, >= 0; by default 1e-10. 0: no min */
} KOOP(direction);

/* Settings of bgf. */
typedef struct KOOP(bounded_gain) {
	KOOP_REAL k0; /* bound of the trace of P, from p0 d to an eighth of the largest real; 0, the default: p0 d */
} KOOP(bounded_gain);

/* ---- Form: how P is stored ------------------------------------------------- */

/* A form stores P and updates it. Two are provided; you need this struct only to write a third. */
typedef struct KOOP(form) {
	const char *name;
	/* Number of reals of storage for P. */
	size_t (*reals)(const struct KOOP(rls) *rls);
	/* P = p0 I */
	void (*reset)(struct KOOP(rls) *rls, KOOP_REAL p0);
	/* rls->gain = P zeta; returns zeta' P zeta. */
	KOOP_REAL (*gain)(struct KOOP(rls) *rls);
	/* Returns zeta' P^-1 zeta. */
	KOOP_REAL (*information)(struct KOOP(rls) *rls);
	/* Updates P according to `step`, or returns a status and leaves P as it was. On entry rls->gain is
	 * g / denominator, and denominator = noise + s. It is negative only if `noise` is, and P then grows. */
	int (*apply)(struct KOOP(rls) *rls, const KOOP(step) *step, KOOP_REAL denominator);
	/* Returns element (i, j) of P. */
	KOOP_REAL (*element)(const struct KOOP(rls) *rls, size_t i, size_t j);
	/* Writes the diagonal of P, KOOP_PAD(d) reals. `diagonal` may be rls->work. */
	void (*diagonal)(const struct KOOP(rls) *rls, KOOP_REAL *diagonal);
	/* For stored models: the number of lower triangles of d x d that represent P, and access to their elements,
	 * j <= i. All three are null if P cannot be stored. */
	size_t (*triangles)(const struct KOOP(rls) *rls);
	KOOP_REAL (*get)(const struct KOOP(rls) *rls, size_t triangle, size_t i, size_t j);
	void (*set)(struct KOOP(rls) *rls, size_t triangle, size_t i, size_t j, KOOP_REAL value);
	/* Number of reals at the end of its storage that do not represent P; null: none. */
	size_t (*scratch)(const struct KOOP(rls) *rls);
} KOOP(form);

/* form_plain: P as a scalar times a matrix that is symmetric by construction, bit for bit. It is the algebra of
 *     the paper's eq. (4), and the fastest. Round-off can cost P its positive definiteness.
 * form_sqrt: triangular S with P = S S', by the update of Carlson (1973). P is positive definite by
 *     construction, and its range is the square of the plain form's. Choose it in float. */
extern const KOOP(form) KOOP(form_plain);
extern const KOOP(form) KOOP(form_sqrt);

/* ---- Recursive least squares ---------------------------------------------- */

/* Configuration of an estimator. What it points to must outlive the estimator. */
typedef struct KOOP(config) {
	const KOOP(dictionary) *dictionary;
	size_t n_inputs; /* m >= 1, N + m <= KOOP_MAX_DIM */
	const KOOP(regulator) *regulator;
	const void *settings; /* of the regulator, in its own struct, as koopf_dead_zone for dz_cs; null: the defaults */
	const KOOP(form) *form;
	KOOP_REAL lambda;   /* forgetting factor, 0 < lambda <= 1; the regulators `none` and `reset` ignore it */
	KOOP_REAL p0;       /* initial covariance P = p0 I, p0 >= FLT_MIN or DBL_MIN; a large p0 trusts the samples */
	int check;          /* KOOP_CHECK_REFUSE, KOOP_CHECK_REPORT or KOOP_CHECK_DIAGONAL */
	int checksum;       /* 1: every update verifies and renews a checksum of Theta and P; 0: no checksum */
} KOOP(config);

/* What an update found. It is filled in whether the sample is accepted or refused. */
typedef struct KOOP(health) {
	KOOP_REAL innovation;   /* |psi_next - Theta zeta| before the update, in units of psi */
	KOOP_REAL trace;        /* trace of P; infinite if it does not fit this precision */
	KOOP_REAL min_diagonal; /* smallest diagonal element of P */
	int frozen;             /* 1: the regulator left P unchanged */
	int positive_definite;  /* 0: P is not positive definite, or the sample was refused because P would not be */
	int finite;             /* 0: the sample or the result was not finite, and the sample was refused */
	int short_memory;       /* 1: 1 / (1 - lambda) samples are fewer than the d unknowns of a row of Theta */
	int winding_up;         /* 1: the trace of P is more than 100 times its initial value (ct: tau0, bgf: k0; er, cr: p_inf d) */
} KOOP(health);

/* The estimator. The caller owns it and its storage. Treat the fields as private unless you write a
 * regulator or a form. `repaired` is to be read, and so is `theta`, for rls_copy_theta(), mpc_solve() and
 * supervisor_init(). */
typedef struct KOOP(rls) {
	KOOP(config) config;
	size_t n_lifted;            /* N */
	size_t n_regressors;        /* d = N + m */
	size_t n_lifted_padded;     /* rows of theta are this long */
	size_t n_regressors_padded; /* the vectors below are this long */
	size_t kept;                /* reals that represent the learned model, from theta on */
	KOOP_REAL *theta;           /* Theta', d rows of n_lifted_padded, zero in the padding */
	KOOP_REAL *memory;          /* the regulator's memory */
	KOOP_REAL *covariance;      /* the form's representation of P */
	KOOP_REAL *zeta;            /* scratch: regressor, d */
	KOOP_REAL *gain;            /* scratch: P zeta, then the gain K, d */
	KOOP_REAL *work;            /* scratch: three of d */
	KOOP_REAL *error;           /* scratch: innovation, N */
	size_t n_memory;            /* reals of memory */
	size_t n_undo;              /* reals from `memory` on that a sample may change before it is refused */
	KOOP_REAL gain_square;      /* scratch: K' K */
	KOOP_REAL covariance_scale; /* plain form: P is this times the stored matrix */
	KOOP_REAL theta_bound;      /* >= every |element| of theta */
	KOOP_REAL covariance_bound; /* >= every |element| of the stored representation of P */
	int positive_definite;      /* 0: P is known not to be positive definite */
	size_t mirrored;            /* plain form: the row that was made symmetric last */
	int short_memory;           /* as in the health: a warning, known after rls_init() */
	KOOP_REAL nominal_trace;    /* of P, for the health's winding_up: p0 d, or as the regulator has set it */
	koop_checksum sum;          /* of theta, memory, the stored P, covariance_scale and the two bounds */
	size_t repaired;            /* number of flipped bits that were found and repaired */
} KOOP(rls);

/* Number of reals of storage that rls_init() needs for this configuration.
 * KOOP_E_SIZE: n, N or m is out of range. KOOP_E_RANGE: another setting is. */
int KOOP(rls_reals)(const KOOP(config) *config, size_t *reals);

/* Starts an estimator with Theta = 0 and P = p0 I. `storage` (`reals` reals; KOOP_RLS_REALS_SQRT or
 * KOOP_RLS_REALS_PLAIN suffice for a regulator without memory) must outlive `rls`; its content does not matter.
 * `config` is copied, but not what it points to.
 *
 * KOOP_E_SIZE, KOOP_E_RANGE: as rls_reals(). KOOP_E_STORAGE: `reals` is too small. */
int KOOP(rls_init)(KOOP(rls) *rls, const KOOP(config) *config, KOOP_REAL *storage, size_t reals);

/* Learns from one sample: psi (N) and the applied input u (m) led to psi_next (N), one control period later.
 * Paper, eq. (4) and section "Robust Covariance-Regulated Modifications". `health` may be null.
 *
 * A refused sample leaves Theta and P as they were. KOOP_E_INPUT: the sample is not finite. KOOP_E_OVERFLOW: the
 * result would not be finite. KOOP_E_INDEFINITE: P would lose positive definiteness. KOOP_E_MEMORY: see
 * rls_check().
 *
 * If KOOP_E_INDEFINITE or KOOP_E_OVERFLOW persists, call rls_reset_covariance(), which keeps Theta. If a huge but
 * finite sample has corrupted Theta, load a model as well. The gate below does both, and refuses outliers. */
int KOOP(rls_update)(KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u, const KOOP_REAL *psi_next,
                     KOOP(health) *health);

/* Verifies that Theta and P are, bit for bit, as the last call left them. Every update does this first. A single
 * flipped bit is repaired, and counted in rls.repaired.
 * KOOP_E_MEMORY: more bits have flipped; load a model and reset P. KOOP_E_RANGE: config.checksum is 0. */
int KOOP(rls_check)(KOOP(rls) *rls);

/* Predicts one step: psi_next (N) = Theta [psi (N); u (m)]. psi_next may be psi. Theta and P are not changed.
 * KOOP_E_INPUT: psi or u is not finite. KOOP_E_OVERFLOW: the prediction is not finite. */
int KOOP(rls_predict)(KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u, KOOP_REAL *psi_next);

/* Resets P to p0 I and the regulator's memory to its start, and keeps Theta. Do not call it while the model
 * controls the robot: with a large P a few samples change the model entirely. KOOP_E_RANGE: p0 is below FLT_MIN
 * or DBL_MIN, or above half of the largest real. */
int KOOP(rls_reset_covariance)(KOOP(rls) *rls, KOOP_REAL p0);

/* Copies Theta out, N rows of d. */
int KOOP(rls_get_theta)(const KOOP(rls) *rls, KOOP_REAL *theta);

/* Sets Theta from N rows of d, and keeps P. KOOP_E_INPUT: an element is not finite. */
int KOOP(rls_set_theta)(KOOP(rls) *rls, const KOOP_REAL *theta);

/* Sets Theta from that of another estimator of the same sizes, and keeps P. `theta` has the layout of rls.theta.
 * KOOP_E_INPUT: an element is not finite. */
int KOOP(rls_copy_theta)(KOOP(rls) *rls, const KOOP_REAL *theta);

/* For the `reshape` of a regulator only, since the checksum is not renewed: P^-1 += a v v' with a > 0 and d values
 * v, which may be in rls->memory but not in a work vector. It overwrites rls->zeta and rls->gain. A refusal leaves
 * P as it was.
 *
 * KOOP_E_RANGE: a is not > 0. KOOP_E_INPUT: v is not finite. KOOP_E_OVERFLOW, KOOP_E_INDEFINITE: as rls_update().
 * A term along one unit vector per sample is cyclic resetting (Lai and Bernstein, 2024). */
int KOOP(rls_add_information)(KOOP(rls) *rls, const KOOP_REAL *v, KOOP_REAL a);

/* The same for P += a v v'. P + p I takes it d times, with the unit vectors. */
int KOOP(rls_add_covariance)(KOOP(rls) *rls, const KOOP_REAL *v, KOOP_REAL a);

/* The same for P *= factor, 0 < factor < a quarter of the largest real. */
int KOOP(rls_scale_covariance)(KOOP(rls) *rls, KOOP_REAL factor);

/* Copies P out, d rows of d. KOOP_E_OVERFLOW: an element of P does not fit this precision, and is written as
 * infinity. This can occur in the square-root form, whose root still fits. */
int KOOP(rls_get_covariance)(const KOOP(rls) *rls, KOOP_REAL *covariance);

/* ---- Gate ------------------------------------------------------------------- */

/* Configuration of a gate. Zero selects the default, which is in brackets. */
typedef struct KOOP(gate_config) {
	/* A sample is an outlier if one of its N innovations exceeds this many standard deviations, >= 1 (5). */
	KOOP_REAL multiple;
	/* Smallest standard deviation of an innovation, >= 0, in units of psi (0). Set it if the robot comes to rest:
	 * the innovations shrink at rest, and the first samples of the next motion would be refused. */
	KOOP_REAL floor;
	/* The gate reopens after this many net rejections, rejected minus accepted (5). */
	size_t patience;
	/* Number of samples until a change is accepted as permanent (1000). The effect of a shorter fault is undone. */
	size_t hold;
} KOOP(gate_config);

/* Protects the learner from impossible samples: a spike, a stuck or lost sensor, mixed-up rows. Outliers are
 * refused while they are few. If they persist, the learner follows them, since the robot may have changed. The
 * previous model is kept, and is restored if it predicts better than the new one.
 *
 * Check the range of the sensors first, and do not lift readings outside it. The caller owns the gate and its
 * storage. `refused` and `restored` are to be read; the other fields are private. The paper has no gate. */
typedef struct KOOP(gate) {
	KOOP(gate_config) config;
	KOOP(rls) saved;              /* copy of the learner before the outliers */
	KOOP_REAL *variance;          /* mean square of each innovation in the absence of faults, N */
	KOOP_REAL *recent_variance;   /* mean square of each recent innovation, N */
	KOOP_REAL *previous_variance; /* variance before a change was accepted, N */
	size_t warm_up;               /* samples until `variance` is known */
	size_t n_variance;            /* number of samples in the mean `variance` */
	size_t refused;               /* net rejections: outliers minus samples accepted since */
	size_t grace;                 /* number of samples that are still accepted without a test */
	size_t judged, failed;        /* samples compared in this window; those of them that could not be learned */
	KOOP_REAL nis;                /* normalised innovation squared of the learner, summed over the window */
	KOOP_REAL saved_nis;          /* the same, of the saved learner */
	KOOP_REAL previous_nis;       /* the same, of the learner, normalised by previous_variance */
	size_t suspect_for;           /* samples since the saved learner last predicted within its variance */
	size_t restored;              /* number of times that the saved learner was restored */
	int restored_once;            /* 1: it was restored, and nothing has been saved since */
	int changed;                  /* 1: a change was accepted, and previous_variance is kept */
	int trust;                    /* KOOP_TRUSTED, KOOP_DOUBTFUL or KOOP_REFUSE */
	int worst;                    /* the worst of these in this window */
	koop_checksum sum;            /* of the variances, and of the fields from `warm_up` to here */
} KOOP(gate);

/* Starts a gate for an initialised estimator. Call it after model_load(). `config` may be null: all defaults; it
 * is copied. Storage: KOOP_GATE_REALS_SQRT or KOOP_GATE_REALS_PLAIN, or 3 N more than rls_reals(). The first
 * samples are all accepted: the gate learns the variance from them.
 * KOOP_E_RANGE: a setting is out of range. KOOP_E_STORAGE: `reals` is too small. */
int KOOP(gate_init)(KOOP(gate) *gate, const KOOP(gate_config) *config, const KOOP(rls) *rls,
                    KOOP_REAL *storage, size_t reals);

/* Replaces rls_update(), with the same arguments and statuses, and two more. KOOP_E_OUTLIER: the gate refused the
 * sample, and Theta and P stay as they were. KOOP_E_SIZE: the gate was started for an estimator of another kind.
 *
 * Any sample, accepted or refused, can be the one at which the previous model is restored. If
 * KOOP_E_INDEFINITE or KOOP_E_OVERFLOW persists, it is restored too, with P = p0 I. */
int KOOP(gate_update)(KOOP(gate) *gate, KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u,
                      const KOOP_REAL *psi_next, KOOP(health) *health);

/* Returns whether to control with the learned model: KOOP_TRUSTED, KOOP_DOUBTFUL or KOOP_REFUSE.
 *
 * KOOP_REFUSE: samples cannot be learned, P is not positive definite, or the mean square of the innovations over
 * a window of 4 d samples exceeds 12 times their variance. KOOP_DOUBTFUL: it exceeds 5 times their variance,
 * there was an outlier, samples are accepted without a test, or the variance is not known yet. Samples refused
 * with KOOP_E_INPUT do not count.
 *
 * The result gets worse immediately. It improves by one level at the end of each window without an alarm: from
 * KOOP_REFUSE to KOOP_TRUSTED within 12 d samples after the last alarm. */
int KOOP(gate_trust)(const KOOP(gate) *gate);

/* ---- Low-pass ---------------------------------------------------------------- */

/* Butterworth low-pass filter of second order, for n channels: removes the vibration of flapping wings, rotors or
 * an engine from a sensor before the state is lifted. The gain is -3 dB at the cut-off frequency. Slow signals are
 * delayed by 0.225 / cutoff seconds. The caller owns it and its storage; the fields are private. */
typedef struct KOOP(lowpass) {
	size_t n;            /* channels */
	KOOP_REAL b, a1, a2; /* y = b (x + 2 x' + x'') - a1 y' - a2 y'', where ' is one sample earlier */
	KOOP_REAL *state;    /* two per channel */
	int settled;         /* 0: the next sample is the first one */
} KOOP(lowpass);

/* Starts a filter of n channels, 1 <= n <= KOOP_MAX_DIM. `cutoff` and the sampling rate `rate` are in Hz,
 * 0.001 rate <= cutoff <= 0.45 rate. Storage: KOOP_LOWPASS_REALS(n).
 * KOOP_E_SIZE: n. KOOP_E_STORAGE: `reals` is too small. KOOP_E_RANGE: `cutoff` or `rate`. */
int KOOP(lowpass_init)(KOOP(lowpass) *filter, size_t n, KOOP_REAL cutoff, KOOP_REAL rate, KOOP_REAL *storage,
                       size_t reals);

/* Restarts the filter in the steady state of the next sample. Call it after a gap in the samples. */
int KOOP(lowpass_reset)(KOOP(lowpass) *filter);

/* Filters one sample: y (n) from x (n). y may be x. Call it once per sample, in the order of time.
 * A refused sample changes nothing. KOOP_E_INPUT: x is not finite. KOOP_E_OVERFLOW: |x| exceeds 1/64 of the
 * largest real. */
int KOOP(lowpass_step)(KOOP(lowpass) *filter, const KOOP_REAL *x, KOOP_REAL *y);

/* ---- Dead-zone threshold --------------------------------------------------- */

/* Dead-zone threshold delta from the norms of calibration innovations (health.innovation): their linearly
 * interpolated eta-quantile, 0 <= eta <= 1 (paper, remark "Dead-Zone Threshold Selection"). Sorts `scores`
 * (`count` >= 1 of them). A larger eta skips more updates.
 * KOOP_E_SIZE: `count` is 0. KOOP_E_RANGE: eta. KOOP_E_INPUT: a score is not finite. */
int KOOP(threshold)(KOOP_REAL *scores, size_t count, KOOP_REAL eta, KOOP_REAL *delta);

/* ---- Stored model ----------------------------------------------------------- */

/* Writes Theta as bytes with a checksum, for flash or a file: the same bytes on every machine. `size` must be at
 * least KOOPF_MODEL_BYTES or KOOPD_MODEL_BYTES. P is not stored: after a long offline fit P is too small for
 * further learning. KOOP_E_STORAGE: `size` is too small. */
int KOOP(model_save)(const KOOP(rls) *rls, void *bytes, size_t size);

/* Writes Theta and P, so that learning continues after a restart as if there had been none (paper, footnote on
 * EDMD: an offline fit gives both). `size` must be at least KOOPF_MODEL_BYTES_P or KOOPD_MODEL_BYTES_P.
 * KOOP_E_STORAGE: `size` is too small. KOOP_E_MODEL: the form cannot store P. */
int KOOP(model_save_covariance)(const KOOP(rls) *rls, void *bytes, size_t size);

/* Reads a stored model of `size` bytes: sets Theta, and P if the model has it, of an initialised estimator.
 * KOOP_E_MODEL: the model has another precision, size or dictionary, its P has another form, or its checksum is
 * wrong. A model of version 0.1.0 does not record its byte order. It is refused too, unless only one order yields
 * numbers of plausible size. */
int KOOP(model_load)(KOOP(rls) *rls, const void *bytes, size_t size);

/* ---- Model predictive control -------------------------------------------------
 *
 * Minimises over u[0..H-1] in [u_min, u_max]
 *
 *     sum over i = 1..H of |x[i] - reference[i]|^2_Q
 *   + sum over i = 0..H-1 of |u[i]|^2_R + |u[i] - u[i-1]|^2_S
 *
 * subject to psi[i+1] = A psi[i] + B u[i], where x is the first n elements of psi
 * (paper, section "Koopman-MPC with Online Learning for DDR"; the input-rate
 * penalty S is added). The quadratic program is condensed again at every call,
 * since the model changes with every sample. */

/* Configuration of a controller. The weights and limits that it points to must outlive the controller. */
typedef struct KOOP(mpc_config) {
	size_t n_lifted;         /* N */
	size_t n_states;         /* n, the tracked states, 1 <= n <= N */
	size_t n_inputs;         /* m >= 1, N + m <= KOOP_MAX_DIM */
	size_t horizon;          /* H, 1 <= H <= KOOP_MPC_MAX_HORIZON, H m <= KOOP_MPC_MAX_INPUTS */
	const KOOP_REAL *Q;      /* weight of the tracking error, n x n, symmetric, positive semidefinite */
	const KOOP_REAL *R;      /* weight of the inputs, m x m, symmetric, positive definite */
	const KOOP_REAL *S;      /* weight of the input rates, m x m, symmetric, positive semidefinite; null: none */
	const KOOP_REAL *u_min;  /* m, lower limits, units of the inputs; -INFINITY: no limit; = u_max: fixed input */
	const KOOP_REAL *u_max;  /* m, upper limits; INFINITY: no limit */
	const KOOP_REAL *u_safe; /* m, finite, inside the limits: the input if there is no plan */
	KOOP_REAL tolerance;     /* of the KKT residual, >= 0, units of the inputs; 0: 1e-9, in float 1e-5 */
	int method;              /* KOOP_MPC_NEWTON or KOOP_MPC_GRADIENT */
} KOOP(mpc_config);

/* Result of a solve. */
typedef struct KOOP(mpc_result) {
	/* KKT residual: the largest step, in units of the inputs, that a gradient step scaled by the Hessian's
	 * diagonal would still take inside the limits. It is 0 at the optimum. If it exceeds the tolerance, round-off
	 * or the limit on iterations ended the solve. A final correction of round-off is not included. The error of an
	 * input can be larger than the residual: by a factor of 10 to 100, as measured. */
	KOOP_REAL residual;
	size_t iterations; /* Newton or gradient steps; without a last gradient step that round-off has ended */
} KOOP(mpc_result);

/* The controller. The caller owns it and its storage. The fields are private. */
typedef struct KOOP(mpc) {
	KOOP(mpc_config) config;
	KOOP_REAL *markov;                                   /* Markov parameters C A^k B, k = 0..H-1: a row per state and input */
	KOOP_REAL *free_error;                               /* free response minus reference: a row per state, last step first */
	KOOP_REAL *state;                                    /* scratch: the same layout */
	KOOP_REAL *inverse;                                  /* inverse of the Hessian's diagonal, H m */
	KOOP_REAL *plan;                                     /* H m, last input first */
	signed char *set;                                    /* H m, active set: 0 free, < 0 at its lower limit, > 0 at its upper limit */
	KOOP_REAL *u_before;                                 /* m */
	KOOP_REAL *u_min, *u_max, *u_safe;                   /* m each: limits and safe input of the last solve */
	KOOP_REAL *roots;                                    /* lower Cholesky factors of R, S and Q */
	KOOP_REAL *gradient, *trial, *trial_gradient, *step; /* scratch: H m each */
	KOOP_REAL *direction, *hessian_direction;            /* scratch: the memory of trial and trial_gradient */
	KOOP_REAL *work;                                     /* scratch */
	KOOP_REAL *square;                                   /* scratch: 4 x 4 block of the factor, and 4 reals */
	KOOP_REAL *generator;                                /* generator of the Hessian: n + m rows of H m, n + 2 m with S */
	KOOP_REAL *factor;                                   /* packed Cholesky factor of the Hessian of the free inputs */
	KOOP_REAL max_eigenvalue;                            /* largest eigenvalue of the scaled Hessian so far */
	KOOP_REAL reach;                                     /* largest magnitude or range of a limited input */
	KOOP_REAL noise;                                     /* a residual below this can be round-off alone */
	size_t n_free;                                       /* rows of the factor */
	int unlimited;                                       /* 1: an input has no limit */
	int planned;                                         /* 1: plan and set are those of the last solve */
	int factored;                                        /* 1: the factor belongs to this choice of free inputs */
	int fresh;                                           /* 1: and to the Hessian of this solve */
} KOOP(mpc);

/* Starts a controller. `config` is copied. Storage: KOOP_MPC_REALS_NEWTON or KOOP_MPC_REALS_GRADIENT reals, and
 * with S KOOP_MPC_REALS_RATE more.
 *
 * KOOP_E_SIZE: a size is out of range. KOOP_E_INPUT: a weight is not finite, a limit is NaN, or u_safe is not
 * finite. KOOP_E_RANGE: a weight is not symmetric and positive (semi)definite, limits are crossed, u_safe is
 * outside them, or another setting is out of range. KOOP_E_STORAGE: `reals` is too small.
 *
 * u_min, u_max, u_safe, Q, R and S are read again at every solve, and may change between two solves: rate limits
 * (u_min = u_before - 0.1), limits of a battery, a failed actuator. */
int KOOP(mpc_init)(KOOP(mpc) *mpc, const KOOP(mpc_config) *config, KOOP_REAL *storage, size_t reals);

/* Discards the plan: the next solve starts from u_safe. */
int KOOP(mpc_reset)(KOOP(mpc) *mpc);

/* Computes u (m), the first input of the optimal plan from psi (N) along `reference` (H rows of n: x at the next
 * H steps). `theta` has the layout of rls.theta. u_before (m), the input applied last, is read only with S, else
 * it may be null. `result` may be null. The solve starts from the last plan, shifted by one step (warm start).
 *
 * The limits are read once, at the start, and hold for u and every input of the plan. If a pair of them is
 * crossed (KOOP_E_RANGE), or a limit is NaN or u_safe not finite (KOOP_E_INPUT), the plan is kept, and u is the
 * safe input of the last solve.
 *
 * If there is no plan, u is u_safe clipped to the limits, and the last plan is discarded. KOOP_E_INPUT: psi,
 * `reference` or u_before is not finite. KOOP_E_OVERFLOW: the model is not finite, or its predictions exceed this
 * precision. KOOP_E_INDEFINITE: the Hessian is not positive definite in this precision. u is never NaN and never
 * outside the limits, unless the status is KOOP_E_NULL: then it is not written. */
int KOOP(mpc_solve)(KOOP(mpc) *mpc, const KOOP_REAL *theta, const KOOP_REAL *psi, const KOOP_REAL *reference,
                    const KOOP_REAL *u_before, KOOP_REAL *u, KOOP(mpc_result) *result);

/* Copies the plan of the last solve: H rows of m, first input first, units of the inputs. */
int KOOP(mpc_plan)(const KOOP(mpc) *mpc, KOOP_REAL *plan);

/* Sensitivity of the state to the input `step` + 1 steps earlier, in the model of the last solve:
 * G (n x m) = C A^step B, 0 <= step < H. KOOP_E_SIZE: `step` is not below H. */
int KOOP(mpc_sensitivity)(const KOOP(mpc) *mpc, size_t step, KOOP_REAL *G);
