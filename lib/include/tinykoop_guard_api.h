/* The interface of the guard in one precision. Included by tinykoop_guard.h, once
 * for float (koopf_) and once for double (koopd_): include that, not this. */

/* Configuration of a guard. Zero selects the default, which is in brackets; the defaults suit all dictionaries
 * and regulators. The ratios are dimensionless, >= 0 and finite. */
typedef struct KOOP(guard_config) {
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
	KOOP(gate) *gate;             /* guard_update() learns through this gate; null: none */
} KOOP(guard_config);

/* The guard. The caller owns it and its storage. `model` and `resets` are to be read; the other fields are
 * private. */
typedef struct KOOP(guard) {
	KOOP(guard_config) config;
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
	int model;         /* KOOP_GUARD_ONLINE, .._LAST_GOOD, .._OFFLINE or .._NONE: the last input was planned on it */
	size_t wait;       /* steps until the online model is tried again */
	size_t delay;      /* length of the next wait, steps */
	size_t trusted;    /* consecutive steps on the online model */
	size_t distrusted; /* consecutive steps on another model */
	size_t failed;     /* consecutive samples that could not be learned */
	size_t resets;     /* number of restarts of the learner */
	koop_checksum sum; /* of offline, last_good, response, judged and size */
} KOOP(guard);

/* Starts a guard. `offline` has the layout of rls.theta, so rls.theta itself is valid after model_load(); it is
 * copied. `mpc` is the initialised controller that guard_control() will use; its plan is discarded. `config` may
 * be null: all defaults; it is copied. Storage: KOOP_GUARD_REALS(N, n, m, H).
 *
 * KOOP_E_RANGE: a setting is out of range. KOOP_E_STORAGE: `reals` is too small. KOOP_E_MODEL: an input has no
 * effect on the tracked states of the offline model. Any status of mpc_solve(): the controller cannot plan on the
 * offline model. */
int KOOP(guard_init)(KOOP(guard) *guard, const KOOP(guard_config) *config, KOOP(mpc) *mpc,
                     const KOOP_REAL *offline, KOOP_REAL *storage, size_t reals);

/* Replaces rls_update(), or with config.gate gate_update(), with the same arguments and statuses, and one more.
 * KOOP_E_SIZE: the learner has other sizes than the guard. The models are compared on the sample, unless the gate
 * refuses it.
 *
 * The learner is restarted if P is not positive definite, if `patience` consecutive samples could not be learned,
 * or if it has not been trusted for `renewal` steps. P is then p0 / 100 times I. Theta becomes the last good or
 * the offline model, unless the online model is in use and finite. */
int KOOP(guard_update)(KOOP(guard) *guard, KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u,
                       const KOOP_REAL *psi_next, KOOP(health) *health);

/* Replaces mpc_solve(), with the same arguments and statuses, and two more. It plans on the model that can be
 * trusted; guard.model tells which. If a plan fails a check, the next model is planned on in the same step: one
 * solve as a rule, two if the online model fails, three at most.
 *
 * KOOP_E_SIZE: `rls` or `mpc` has other sizes than the guard. KOOP_E_MEMORY: more than one bit of the guard's
 * models has flipped, and u is the safe input of the last solve; start the guard again. */
int KOOP(guard_control)(KOOP(guard) *guard, const KOOP(rls) *rls, KOOP(mpc) *mpc, const KOOP_REAL *psi,
                        const KOOP_REAL *reference, const KOOP_REAL *u_before, KOOP_REAL *u,
                        KOOP(mpc_result) *result);
