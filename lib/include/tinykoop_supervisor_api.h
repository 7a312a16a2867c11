/* The interface of the supervisor in one precision. tinykoop_supervisor.h includes this file once for float
 * (koopf_) and once for double (koopd_). Include tinykoop_supervisor.h instead. */

/* Configuration of a supervisor. Zero selects the default, which is in brackets. The defaults suit all
 * dictionaries and regulators. The ratios are dimensionless, >= 0 and finite. */
typedef struct KOOP(supervisor_config) {
	/* The response of the tracked states to each input over the horizon, weighted by the diagonal of Q, is
	 * compared with the response of the offline model: */
	KOOP_REAL min_cosine;         /* cosine of the angle between them (0.7); below 0 the sign is wrong */
	KOOP_REAL min_gain;           /* its norm over that of the offline model (0.2) */
	KOOP_REAL max_gain;           /* the same (3) */

	KOOP_REAL max_error_ratio;    /* one-step error over that of the offline model, RMS of about 20 steps (4) */
	KOOP_REAL max_residual;       /* KKT residual of the plan over the narrowest range of a limited input (0.01) */
	KOOP_REAL max_tracking_ratio; /* tracking error over its own RMS of about 100 steps (3) */
	size_t patience;              /* steps until a failed model is tried again; doubles up to 16-fold (15) */
	size_t renewal;               /* steps without trust until the learner is restarted (100) */
	KOOP(gate) *gate;             /* supervisor_update() learns through this gate; null: none */
} KOOP(supervisor_config);

/* The supervisor. The caller owns it and its storage. `model` and `resets` are to be read. The other fields are
 * private. */
typedef struct KOOP(supervisor) {
	KOOP(supervisor_config) config;
	size_t n_lifted, n_states, n_inputs, horizon;
	const KOOP_REAL *Q;              /* the controller's */
	KOOP_REAL *offline;              /* offline model, in the layout of rls.theta */
	KOOP_REAL *last_good;            /* last good model, in the layout of rls.theta */
	KOOP_REAL *response;             /* response of the offline model: H times n rows of m */
	KOOP_REAL *judged;               /* n rows of m: its square, 0 if the pair is not checked */
	KOOP_REAL *now, *square, *along; /* scratch: n rows of m each */
	KOOP_REAL *size;                 /* m: squared response of all states of the offline model */
	KOOP_REAL *target;               /* n: the reference at the next call */
	KOOP_REAL error[3];              /* mean square of the one-step error, by model */
	KOOP_REAL tracking;              /* mean square of the tracking error */
	int have_target, have_last_good;
	int model;         /* KOOP_SUPERVISOR_ONLINE, ..: the last input was planned on this model */
	size_t wait;       /* steps until the online model is tried again */
	size_t delay;      /* length of the next wait, steps */
	size_t trusted;    /* consecutive steps on the online model */
	size_t distrusted; /* consecutive steps on another model */
	size_t failed;     /* consecutive samples that could not be learned */
	size_t resets;     /* number of restarts of the learner */
	koop_checksum sum; /* of offline, last_good, response, judged and size */
} KOOP(supervisor);

/* Starts a supervisor. `offline` is copied. It has the layout of rls.theta, so that rls.theta itself can be passed
 * after model_load(). `mpc` is the initialised controller that supervisor_control() will use. Its plan is
 * discarded. `config` is copied; null selects all defaults. Storage: KOOP_SUPERVISOR_REALS(N, n, m, H).
 *
 * KOOP_E_RANGE: a setting is out of range. KOOP_E_STORAGE: `reals` is too small. KOOP_E_MODEL: an input has no
 * effect on the tracked states of the offline model. Any status of mpc_solve(): the controller cannot plan on the
 * offline model. */
int KOOP(supervisor_init)(KOOP(supervisor) *supervisor, const KOOP(supervisor_config) *config, KOOP(mpc) *mpc,
                     const KOOP_REAL *offline, KOOP_REAL *storage, size_t reals);

/* Replaces rls_update(), or with config.gate gate_update(), with the same arguments and statuses, and one more.
 * KOOP_E_SIZE: the learner has other sizes than the supervisor. The models are compared on the sample, unless the
 * gate refuses it.
 *
 * The learner is restarted if P is not positive definite, if `patience` consecutive samples could not be learned,
 * or if it has not been trusted for `renewal` steps. P is then p0 / 100 times I. Theta becomes the last good or
 * the offline model, unless the online model is in use and finite. */
int KOOP(supervisor_update)(KOOP(supervisor) *supervisor, KOOP(rls) *rls, const KOOP_REAL *psi,
                            const KOOP_REAL *u, const KOOP_REAL *psi_next, KOOP(health) *health);

/* Replaces mpc_solve(), with the same arguments and statuses, and two more. It plans on the model that can be
 * trusted, and sets supervisor.model to it. If a plan fails a check, the next model is planned on in the same
 * step. A step normally takes one solve, two if the online model fails, and three at most.
 *
 * KOOP_E_SIZE: `rls` or `mpc` has other sizes than the supervisor. KOOP_E_MEMORY: more than one bit of the
 * supervisor's models has flipped, and u is the safe input of the last solve. Start the supervisor again. */
int KOOP(supervisor_control)(KOOP(supervisor) *supervisor, const KOOP(rls) *rls, KOOP(mpc) *mpc,
                             const KOOP_REAL *psi, const KOOP_REAL *reference, const KOOP_REAL *u_before,
                             KOOP_REAL *u, KOOP(mpc_result) *result);
