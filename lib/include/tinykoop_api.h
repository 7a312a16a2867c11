/* The interface of TinyKoop in one precision. Included by tinykoop.h, once for
 * float (koopf_) and once for double (koopd_): include that, not this. */

/* Message for a status: static text, never null. */
const char *KOOP(status_message)(int status);

/* KOOP_E_ARITHMETIC where arithmetic is not that of IEEE 754 with NaN, to the nearest: because of how this was
 * compiled (the files ask for strict arithmetic themselves; a compiler may not know that), or because the
 * processor is set to another rounding. A few hundred instructions: call it once at boot, and do not fly
 * where it fails. It does not mind a * b + c in one operation where that is harmless, nor subnormal numbers that
 * are taken for 0. */
int KOOP(self_test)(void);

/* ---- Dictionary: how a state is lifted ---------------------------------- */

/* A dictionary lifts x (n values) to psi (N values). The first n values of psi
 * are x itself, so that the state can be read off a prediction.
 *
 * Your own: fill this struct. `lift` writes all N values and sees its own
 * dictionary, so `context` can carry its settings. It need not check for NaN.
 */
typedef struct KOOP(dictionary) {
	const char *name;
	size_t n_states; /* n >= 1 */
	size_t n_lifted; /* N >= n */
	void (*lift)(const struct KOOP(dictionary) *self, const KOOP_REAL *x, KOOP_REAL *psi);
	const void *context;
} KOOP(dictionary);

/* Differential-drive robot, x = [px (m), py (m), theta (rad)], paper section
 * "Dictionary selection":
 *   poly  N = 7   [px py theta  px^2 py^2  sin cos]
 *   rbf   N = 22  [px py theta  16 Gaussians of (px, py)  sin cos atan2(sin, cos)]
 * The Gaussians have sigma 1.5 m on a 4 x 4 grid over [-3, 3] m: the paper
 * leaves both open, these reproduce its figures. */
extern const KOOP(dictionary) KOOP(poly_ddr);
extern const KOOP(dictionary) KOOP(rbf_ddr);

/* Flapping-wing MAV, x = [gyro (3, rad/s), accelerometer (3, m/s^2), pitch,
 * roll, yaw (rad), yaw rate (rad/s)]. The paper does not define these; see the
 * two source files for what was chosen and why:
 *   poly  N = 20  [x  squares and products of the gyro rates  sin, cos of pitch and roll]
 *   rbf   N = 30  [x  16 Gaussians of (pitch, roll)  sin, cos of pitch and roll] */
extern const KOOP(dictionary) KOOP(poly_fwmav);
extern const KOOP(dictionary) KOOP(rbf_fwmav);

/* psi = Psi(x). Refuses a state or a result that is not finite; psi is then
 * not to be used. The four above take their sines, to less than one unit of the
 * last place, from the library itself, not from libm; an angle beyond 2^20 rad, in
 * double 2^30, has none (KOOP_E_OVERFLOW), and from 10^4 or 10^6 rad on its own
 * last place is the larger error. Wrap it. */
int KOOP(lift)(const KOOP(dictionary) *dictionary, const KOOP_REAL *x, KOOP_REAL *psi);

/* ---- Regulator: what a sample does to Theta and P ------------------------ */

struct KOOP(rls);

/* How one sample is to be used:
 *
 *     g = (P + inflate zeta zeta') zeta,   s = zeta' g
 *     Theta += error g' / (noise + s)                          if update_theta
 *     P = (P + inflate zeta zeta' - g g' / (noise + s)) scale  if update_covariance
 */
typedef struct KOOP(step) {
	KOOP_REAL noise;   /* lambda, or 1 where forgetting is done by `inflate` */
	KOOP_REAL scale;   /* 1 / lambda for exponential forgetting, else 1 */
	KOOP_REAL inflate; /* SIFt: what is forgotten along zeta, else 0 */
	KOOP_REAL trace;   /* P is scaled to this trace at the end; 0: it is not */
	int update_theta;
	int update_covariance;
} KOOP(step);

typedef struct KOOP(regulator) {
	const char *name;
	int needs_information; /* 1: P^-1 is kept too (plain form) */
	/* Decides from the norm of the innovation; `step` comes in as exponential
	 * forgetting. */
	int (*decide)(struct KOOP(rls) *rls, KOOP_REAL innovation, KOOP(step) *step);
	int forgets; /* 1: exponentially, in all directions: the memory is 1 / (1 - lambda) samples */
} KOOP(regulator);

extern const KOOP(regulator) KOOP(reg_none);  /* lambda = 1: nothing is forgotten */
extern const KOOP(regulator) KOOP(reg_ef);    /* exponential forgetting, the paper's vanilla */
extern const KOOP(regulator) KOOP(reg_dz_cs); /* dead zone: a small innovation leaves P alone */
extern const KOOP(regulator) KOOP(reg_dz_ks); /* dead zone: a small innovation leaves P and Theta alone */
extern const KOOP(regulator) KOOP(reg_ct);    /* constant trace */
extern const KOOP(regulator) KOOP(reg_sift);  /* forgets only along the regressor */

/* ---- Form: how P is kept -------------------------------------------------- */

typedef struct KOOP(form) {
	const char *name;
	/* number of reals of storage that P takes */
	size_t (*reals)(const struct KOOP(rls) *rls);
	/* P = p0 I */
	void (*reset)(struct KOOP(rls) *rls, KOOP_REAL p0);
	/* rls->gain = P zeta; returns zeta' P zeta */
	KOOP_REAL (*gain)(struct KOOP(rls) *rls);
	/* zeta' P^-1 zeta */
	KOOP_REAL (*information)(struct KOOP(rls) *rls);
	/* P as `step` says, or a status and P as it was; rls->gain is
	 * g / denominator, and denominator = noise + s */
	int (*apply)(struct KOOP(rls) *rls, const KOOP(step) *step, KOOP_REAL denominator);
	/* element (i, j) of P */
	KOOP_REAL (*element)(const struct KOOP(rls) *rls, size_t i, size_t j);
	/* the diagonal of P, KOOP_PAD(d) reals; may be rls->work */
	void (*diagonal)(const struct KOOP(rls) *rls, KOOP_REAL *diagonal);
	/* for a stored model: how many lower triangles of d x d say all of P, and their elements, j <= i; null
	 * where P is not to be stored */
	size_t (*triangles)(const struct KOOP(rls) *rls);
	KOOP_REAL (*get)(const struct KOOP(rls) *rls, size_t triangle, size_t i, size_t j);
	void (*set)(struct KOOP(rls) *rls, size_t triangle, size_t i, size_t j, KOOP_REAL value);
	/* how many reals at the end of its storage say nothing of P; null: none */
	size_t (*scratch)(const struct KOOP(rls) *rls);
} KOOP(form);

/* plain: P as a number times a matrix, symmetric bit for bit by construction.
 *        The paper's algebra, and the fastest; P can lose positive definiteness.
 * sqrt:  triangular S with P = S S' (Carlson's update). P is positive definite
 *        by construction and reaches the square of the plain form's range. */
extern const KOOP(form) KOOP(form_plain);
extern const KOOP(form) KOOP(form_sqrt);

/* ---- Recursive least squares ---------------------------------------------- */

typedef struct KOOP(config) {
	const KOOP(dictionary) *dictionary;
	size_t n_inputs; /* m >= 1 */
	const KOOP(regulator) *regulator;
	const KOOP(form) *form;
	KOOP_REAL lambda;   /* forgetting factor, (0, 1]; the regulator `none` ignores it */
	KOOP_REAL p0;       /* P starts as p0 I, p0 >= FLT_MIN or DBL_MIN */
	KOOP_REAL delta;    /* dead zones: threshold of the innovation, >= 0 */
	KOOP_REAL tau0;     /* constant trace: the trace, > 0; 0 means p0 d */
	KOOP_REAL eps_sift; /* SIFt: least zeta' zeta that carries information, > 0; 0 means 1e-10 */
	int check;          /* KOOP_CHECK_... */
	int checksum;       /* 1: a checksum of Theta and P is verified and renewed at every update */
} KOOP(config);

/* What an update saw, filled in whether it took the sample or not. */
typedef struct KOOP(health) {
	KOOP_REAL innovation;   /* |psi_next - Theta zeta|, before the update */
	KOOP_REAL trace;        /* of P; infinite where it does not fit this precision */
	KOOP_REAL min_diagonal; /* smallest diagonal element of P */
	int gated;              /* 1: the regulator left P alone */
	int positive_definite;  /* 0: P is not, or would not have been */
	int finite;             /* 0: something was not, or would not have been */
	int short_memory;       /* 1: 1 / (1 - lambda) samples are fewer than the d unknowns of a row of Theta */
	int winding_up;         /* 1: the trace of P is over 100 times the one it began with (tau0) */
} KOOP(health);

/* The estimator. The caller owns it and its storage; treat the fields as
 * private unless you write a regulator or a form. */
typedef struct KOOP(rls) {
	KOOP(config) config;
	size_t n_lifted;            /* N */
	size_t n_regressors;        /* d = N + m */
	size_t n_lifted_padded;     /* rows of theta are this long */
	size_t n_regressors_padded; /* the vectors below are this long */
	size_t kept;                /* reals that say what was learned, from theta on */
	KOOP_REAL *theta;           /* Theta', d x N, zero in the padding */
	KOOP_REAL *covariance;      /* the form's: what it keeps of P */
	KOOP_REAL *zeta;            /* scratch: regressor, d */
	KOOP_REAL *gain;            /* scratch: P zeta, then the gain K, d */
	KOOP_REAL *work;            /* scratch: three of d */
	KOOP_REAL *error;           /* scratch: innovation, N */
	KOOP_REAL gain_square;      /* scratch: K' K */
	KOOP_REAL covariance_scale; /* plain form: P is this times what is kept */
	KOOP_REAL theta_bound;      /* >= every |element| of theta */
	KOOP_REAL covariance_bound; /* >= every |element| of what is kept of P */
	int positive_definite;      /* 0: P is known not to be */
	size_t mirrored;            /* plain form: the row that was made symmetric last */
	int short_memory;           /* as in the health: a warning, known after rls_init() */
	koop_checksum sum;          /* of theta, what is kept of P, and the three numbers above */
	size_t mended;              /* flipped bits found and mended */
} KOOP(rls);

/* Number of reals that rls_init() will need for this configuration. */
int KOOP(rls_reals)(const KOOP(config) *config, size_t *reals);

/* Theta = 0, P = p0 I. `storage` must outlive `rls`; what it holds does not matter. */
int KOOP(rls_init)(KOOP(rls) *rls, const KOOP(config) *config, KOOP_REAL *storage, size_t reals);

/* Learns from one step: psi (N) and u (m) led to psi_next (N). Paper, eq. (4)
 * and section "Robust Covariance-Regulated Modifications".
 *
 * `health` may be null. Policy: a sample that is not finite, whose result would
 * not be finite, or that would cost P its positive definiteness is refused,
 * and Theta and P stay as they were. When KOOP_E_INDEFINITE or
 * KOOP_E_OVERFLOW keeps coming back, rls_reset_covariance() is the way on; it
 * keeps Theta, so where a huge but finite sample has spoilt that, load a model
 * as well, or use the gate below, which does both and refuses outliers. */
int KOOP(rls_update)(KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u, const KOOP_REAL *psi_next,
                     KOOP(health) *health);

/* With config.checksum: whether Theta and P are, bit for bit, what the last call left. A single flipped bit
 * is mended, and counted in rls.mended; KOOP_E_MEMORY where more have flipped: load a model and start P
 * again. Every update does this by itself first. Without config.checksum: KOOP_E_RANGE. */
int KOOP(rls_check)(KOOP(rls) *rls);

/* psi_next = Theta [psi; u]. psi_next (N) may be psi. */
int KOOP(rls_predict)(KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u, KOOP_REAL *psi_next);

/* Starts P again as p0 I and keeps Theta. */
int KOOP(rls_reset_covariance)(KOOP(rls) *rls, KOOP_REAL p0);

/* Theta as N rows of d, row by row. */
int KOOP(rls_get_theta)(const KOOP(rls) *rls, KOOP_REAL *theta);
int KOOP(rls_set_theta)(KOOP(rls) *rls, const KOOP_REAL *theta);

/* Theta as another estimator of the same sizes holds it: `theta` is laid out as
 * rls.theta is. Refuses one that is not finite. */
int KOOP(rls_copy_theta)(KOOP(rls) *rls, const KOOP_REAL *theta);

/* P as d rows of d. KOOP_E_OVERFLOW where only its root fits this precision. */
int KOOP(rls_get_covariance)(const KOOP(rls) *rls, KOOP_REAL *covariance);

/* ---- Gate ------------------------------------------------------------------- */

/* Zeros mean the defaults, in brackets. */
typedef struct KOOP(gate_config) {
	/* A sample is an outlier where one of its N innovations is beyond this times its standard deviation, >= 1 (5). */
	KOOP_REAL multiple;
	/* Smallest standard deviation of an innovation (0). Set it where the robot comes to rest: the innovations
	 * shrink there, and the first samples that move it again would be refused. */
	KOOP_REAL floor;
	/* The gate reopens after this many net rejections, rejected minus accepted (5). */
	size_t patience;
	/* Samples until a change is accepted as permanent (1000): a fault that is over by then leaves no trace. */
	size_t hold;
} KOOP(gate_config);

/* Protects the learner from impossible samples: a spike, a stuck or lost sensor, rows that are mixed up.
 * Outliers are refused while they are few. When they are many the learner follows them, as it
 * must if the robot has changed; but the model from before is kept, and is restored when it
 * predicts better than what was learned since.
 *
 * Check the range of the sensors before, and lift nothing that is outside. The caller owns it
 * and its storage. To read: refused, restored. */
typedef struct KOOP(gate) {
	KOOP(gate_config) config;
	KOOP(rls) saved;              /* the learner before the outliers */
	KOOP_REAL *variance;          /* mean square of each innovation without faults, N */
	KOOP_REAL *recent_variance;   /* mean square of each recent innovation, N */
	KOOP_REAL *previous_variance; /* variance before a change was accepted, N */
	size_t warm_up;               /* samples until `variance` is learned */
	size_t n_variance;            /* samples that it is the mean of */
	size_t refused;               /* net rejections: outliers minus samples accepted since */
	size_t grace;                 /* samples still to be accepted without a test */
	size_t judged, failed;        /* samples compared; those of them that could not be learned */
	KOOP_REAL nis;                /* normalised innovation squared of the learner, summed */
	KOOP_REAL saved_nis;          /* the same, of the saved learner */
	KOOP_REAL previous_nis;       /* the same, of the learner by previous_variance */
	size_t suspect_for;           /* samples since the saved learner predicted within its variance */
	size_t restored;              /* how often it was restored */
	int restored_once;            /* it was, and nothing was saved since */
	int changed;                  /* 1: a change is accepted, previous_variance is kept */
	int trust;                    /* KOOP_TRUSTED, KOOP_DOUBTFUL or KOOP_REFUSE */
	int worst;                    /* likewise, of this window alone */
	koop_checksum sum;            /* of the variances, and of what stands from `warm_up` to here */
} KOOP(gate);

/* For an estimator that is initialised, after a model is loaded. `config` may be null.
 * Storage: KOOP_GATE_REALS_SQRT or KOOP_GATE_REALS_PLAIN, or 2 N more than rls_reals() says.
 * It accepts all of the first samples, from which it learns the variance. */
int KOOP(gate_init)(KOOP(gate) *gate, const KOOP(gate_config) *config, const KOOP(rls) *rls,
                    KOOP_REAL *storage, size_t reals);

/* rls_update() in its place, with its arguments and status, or KOOP_E_OUTLIER: Theta and P
 * stay as they were, but that any sample may be the one that brings back what was known before.
 * Where KOOP_E_INDEFINITE or KOOP_E_OVERFLOW keeps coming back, that is so too, and P is p0 I. */
int KOOP(gate_update)(KOOP(gate) *gate, KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u,
                      const KOOP_REAL *psi_next, KOOP(health) *health);

/* KOOP_TRUSTED, KOOP_DOUBTFUL or KOOP_REFUSE: whether to control with what the learner knows.
 * Refuse: samples cannot be learned, P is not positive definite, or over a window of 4 d samples the mean
 * square of the innovations is above 12 times their variance. Doubtful: that is above 5 times, there was an
 * outlier, samples are accepted without a test, or the variance is not known yet. KOOP_E_INPUT changes
 * nothing here.
 * It becomes worse at once, and better by one step at the end of each window in which nothing spoke against
 * it: from refuse to trusted within 12 d samples after the last alarm. */
int KOOP(gate_trust)(const KOOP(gate) *gate);

/* ---- Low-pass ---------------------------------------------------------------- */

/* What flapping wings, rotors or an engine do to a sensor, taken off before the
 * state is lifted: Butterworth, second order, for n channels at once. It falls
 * by 3 dB at the cut-off and delays what is slow by 0.225 / cutoff seconds. */
typedef struct KOOP(lowpass) {
	size_t n;
	KOOP_REAL b, a1, a2; /* y = b (x + 2 x' + x'') - a1 y' - a2 y'', ' a sample before */
	KOOP_REAL *state;    /* two for each channel */
	int settled;
} KOOP(lowpass);

/* cutoff and rate of sampling in Hz, 0.001 rate <= cutoff <= 0.45 rate. Storage: KOOP_LOWPASS_REALS(n). */
int KOOP(lowpass_init)(KOOP(lowpass) *filter, size_t n, KOOP_REAL cutoff, KOOP_REAL rate, KOOP_REAL *storage,
                       size_t reals);

/* Restarts the filter, settled on the next sample: for use after a gap. */
int KOOP(lowpass_reset)(KOOP(lowpass) *filter);

/* y (n) = x (n) filtered; y may be x. One step a sample, and only forwards in
 * time. A sample that is not finite, or too large, is refused and changes nothing. */
int KOOP(lowpass_step)(KOOP(lowpass) *filter, const KOOP_REAL *x, KOOP_REAL *y);

/* ---- Dead-zone threshold --------------------------------------------------- */

/* The linearly interpolated eta-quantile of calibration innovations (paper,
 * remark "Dead-Zone Threshold Selection"), 0 <= eta <= 1. Sorts `scores`. */
int KOOP(threshold)(KOOP_REAL *scores, size_t count, KOOP_REAL eta, KOOP_REAL *delta);

/* ---- Stored model ----------------------------------------------------------- */

/* Theta of an estimator as bytes with a checksum, for flash or a file: the same bytes on every machine. The
 * size is KOOPF_MODEL_BYTES or KOOPD_MODEL_BYTES. P is not stored: what an
 * offline fit leaves is too small to go on learning with. */
int KOOP(model_save)(const KOOP(rls) *rls, void *bytes, size_t size);

/* The same with P, to go on as if there had been no stop (paper, footnote on EDMD: an offline fit gives both).
 * The size is KOOPF_MODEL_BYTES_P or KOOPD_MODEL_BYTES_P. KOOP_E_MODEL for a form that stores none. */
int KOOP(model_save_covariance)(const KOOP(rls) *rls, void *bytes, size_t size);

/* Sets Theta, and P where the model carries it, of an initialised estimator. A model of another precision,
 * size or dictionary, one whose P is of another form, or one with a wrong checksum is refused with
 * KOOP_E_MODEL. So is a model of version 0.1.0, which does not tell its byte order, unless only one order
 * makes numbers of a usual size. */
int KOOP(model_load)(KOOP(rls) *rls, const void *bytes, size_t size);

/* ---- Model predictive control -------------------------------------------------
 *
 * minimise over u[0..H-1] in [u_min, u_max]
 *
 *     sum over i = 1..H of |x[i] - reference[i]|^2_Q
 *   + sum over i = 0..H-1 of |u[i]|^2_R + |u[i] - u[i-1]|^2_S
 *
 * subject to psi[i+1] = A psi[i] + B u[i] and x = the first n elements of psi
 * (paper, eq. of section "Koopman-MPC with Online Learning", with the input-rate
 * penalty S added). The model is condensed again at every call, since it is
 * learned at every step. */

typedef struct KOOP(mpc_config) {
	size_t n_lifted;         /* N */
	size_t n_states;         /* n, tracked */
	size_t n_inputs;         /* m */
	size_t horizon;          /* H */
	const KOOP_REAL *Q;      /* n x n, symmetric, positive semidefinite */
	const KOOP_REAL *R;      /* m x m, symmetric, positive definite */
	const KOOP_REAL *S;      /* m x m, symmetric, positive semidefinite; null: none */
	const KOOP_REAL *u_min;  /* m; -INFINITY: no limit; u_min = u_max fixes the input */
	const KOOP_REAL *u_max;  /* m; INFINITY: no limit */
	const KOOP_REAL *u_safe; /* m, finite: given out, inside the limits, when there is no plan */
	KOOP_REAL tolerance;     /* of the KKT residual, in units of the inputs; 0: 1e-9, in float 1e-5 */
	int method;              /* KOOP_MPC_NEWTON or KOOP_MPC_GRADIENT */
} KOOP(mpc_config);

typedef struct KOOP(mpc_result) {
	/* The largest step that a gradient step, scaled by the Hessian's diagonal, would
	 * still make inside the limits: 0 at the optimum; units of the inputs. Where it is
	 * above the tolerance, round-off or the bound on iterations came first; a last
	 * correction of what round-off has left is not in it. An input
	 * can be further from its optimum than this: measured, by a factor of 10 to 100. */
	KOOP_REAL residual;
	size_t iterations; /* Newton or gradient steps; of the latter not one that round-off has ended */
} KOOP(mpc_result);

/* The controller. The caller owns it, its storage, and what the configuration
 * points to. */
typedef struct KOOP(mpc) {
	KOOP(mpc_config) config;
	KOOP_REAL *markov;                                   /* a row for each state and input: element of C A^k B, k = 0..H-1 */
	KOOP_REAL *free_error;                               /* a row for each state, last step first: prediction without input less reference */
	KOOP_REAL *state;                                    /* scratch: likewise */
	KOOP_REAL *inverse;                                  /* of the diagonal of the Hessian, H m */
	KOOP_REAL *plan;                                     /* H m, last input first */
	signed char *set;                                    /* H m: 0 free, below 0 held by its lower bound, above by its upper */
	KOOP_REAL *u_before;                                 /* m */
	KOOP_REAL *u_min, *u_max, *u_safe;                   /* m each: limits and safe input of this solve */
	KOOP_REAL *roots;                                    /* lower Cholesky factors of R, S and Q */
	KOOP_REAL *gradient, *trial, *trial_gradient, *step; /* scratch: H m each */
	KOOP_REAL *direction, *hessian_direction;            /* scratch: the same as trial and trial_gradient */
	KOOP_REAL *work;                                     /* scratch */
	KOOP_REAL *square;                                   /* scratch: 4 x 4 of the factor, and 4 */
	KOOP_REAL *generator;                                /* of the Hessian: n + m rows of H m, or n + 2 m with S */
	KOOP_REAL *factor;                                   /* packed Cholesky factor over the free inputs */
	KOOP_REAL max_eigenvalue;                            /* largest eigenvalue seen of the scaled Hessian */
	KOOP_REAL reach;                                     /* size of the inputs inside their limits */
	KOOP_REAL noise;                                     /* a residual below this can be all round-off */
	size_t n_free;                                       /* rows of the factor */
	int unlimited;                                       /* 1: an input has no limit, and so no reach */
	int planned;                                         /* plan and set are those of the last solve */
	int factored;                                        /* factor is one over this choice of free inputs */
	int fresh;                                           /* and of this solve's Hessian */
} KOOP(mpc);

/* Storage: KOOP_MPC_REALS_NEWTON or KOOP_MPC_REALS_GRADIENT reals, and with S
 * KOOP_MPC_REALS_RATE more. Weights that are not symmetric and positive (semi)definite are refused, and so
 * is a u_safe that is outside the limits.
 *
 * u_min, u_max, u_safe, Q, R and S are read again at every solve and may change between two: limits of a
 * rate (u_min = u_before - 0.1), of a battery, of a failed actuator. */
int KOOP(mpc_init)(KOOP(mpc) *mpc, const KOOP(mpc_config) *config, KOOP_REAL *storage, size_t reals);

/* Forgets the plan: the next solve starts from u_safe. */
int KOOP(mpc_reset)(KOOP(mpc) *mpc);

/* u (m) = first input of the best plan from psi (N) along reference (H rows of
 * n: where x should be at the next steps). theta is laid out as rls.theta is;
 * u_before (m), the input applied last, is read only with S. Starts from the
 * last plan, shifted. `result` may be null.
 *
 * Limits are read once, at the start, and hold for u and every input of the plan. Where a pair of them is
 * crossed (KOOP_E_RANGE) or a limit or u_safe is NaN (KOOP_E_INPUT), the plan is kept, and u is the safe
 * input of the last solve.
 *
 * When there is no plan (any other status but KOOP_OK: a model that is not
 * finite or predicts beyond range, a Hessian that is not positive definite in
 * this precision), u is u_safe, brought inside the limits, and the plan is forgotten. u is never NaN and
 * never outside the limits, unless the status is KOOP_E_NULL. */
int KOOP(mpc_solve)(KOOP(mpc) *mpc, const KOOP_REAL *theta, const KOOP_REAL *psi, const KOOP_REAL *reference,
                    const KOOP_REAL *u_before, KOOP_REAL *u, KOOP(mpc_result) *result);

/* The whole plan, H rows of m, first input first. */
int KOOP(mpc_plan)(const KOOP(mpc) *mpc, KOOP_REAL *plan);

/* G (n x m) = C A^step B, 0 <= step < H: what an input does to the state step + 1
 * later, by the model of the last solve. */
int KOOP(mpc_sensitivity)(const KOOP(mpc) *mpc, size_t step, KOOP_REAL *G);
