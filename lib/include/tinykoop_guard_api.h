/* The interface of the guard in one precision. Included by tinykoop_guard.h, once
 * for float (koopf_) and once for double (koopd_): include that, not this. */

/* Zeros mean the defaults, in brackets: one setting for all dictionaries and
 * regulators. */
typedef struct KOOP(guard_config) {
	/* The tracked states' response to each input over the horizon, weighed by the
	 * diagonal of Q, against the offline model's: */
	KOOP_REAL min_cosine;         /* its direction (0.7); below 0 the sign is wrong */
	KOOP_REAL min_gain;           /* its size over the offline model's (0.2) */
	KOOP_REAL max_gain;           /* (3) */

	KOOP_REAL max_error_ratio;    /* one-step error over the offline model's, rms of about 20 steps (4) */
	KOOP_REAL max_residual;       /* KKT residual of the plan over the narrowest range of an input that has one (0.01) */
	KOOP_REAL max_tracking_ratio; /* tracking error over its own rms of about 100 steps (3) */
	size_t patience;              /* steps before a model that failed is tried again; doubles up to 16-fold (15) */
	size_t renewal;               /* steps without trust after which the learner is started again (100) */
	KOOP(gate) *gate;             /* through which guard_update() learns; null: none */
} KOOP(guard_config);

/* The guard. The caller owns it and its storage. To read: model, resets. */
typedef struct KOOP(guard) {
	KOOP(guard_config) config;
	size_t n_lifted, n_states, n_inputs, horizon;
	const KOOP_REAL *Q;              /* the controller's */
	KOOP_REAL *offline;              /* as rls.theta */
	KOOP_REAL *last_good;            /* as rls.theta */
	KOOP_REAL *response;             /* of the offline model: H times n rows of m */
	KOOP_REAL *judged;               /* n rows of m: its square, 0 where it is not judged */
	KOOP_REAL *now, *square, *along; /* scratch: n rows of m each */
	KOOP_REAL *size;                 /* m: square of the offline model's response of all states */
	KOOP_REAL *target;               /* n: where the robot should be at the next call */
	KOOP_REAL error[3];              /* mean square of the one-step error, by KOOP_GUARD_... */
	KOOP_REAL tracking;              /* mean square of the tracking error */
	int have_target, have_last_good;
	int model;         /* KOOP_GUARD_...: what the last input was planned on */
	size_t wait;       /* steps until the online model is tried */
	size_t delay;      /* of the next wait */
	size_t trusted;    /* steps in a row on the online model */
	size_t distrusted; /* steps in a row off it */
	size_t failed;     /* samples in a row that could not be learned */
	size_t resets;     /* how often the learner was started again */
	koop_checksum sum; /* of offline, last_good, response, judged and size */
} KOOP(guard);

/* `offline` is laid out as rls.theta is, so rls.theta itself after model_load()
 * will do; it is copied. `mpc` is the controller that will be used: it is
 * initialised, and forgets its plan. `config` may be null. Refuses an offline model
 * that the controller cannot plan on, and one that an input does not act on. */
int KOOP(guard_init)(KOOP(guard) *guard, const KOOP(guard_config) *config, KOOP(mpc) *mpc,
                     const KOOP_REAL *offline, KOOP_REAL *storage, size_t reals);

/* rls_update() in its place, or with config.gate gate_update(), with its arguments and status. Judges the
 * models by the sample, unless the gate refuses that. Starts the learner again where P is not positive
 * definite, where `patience` samples in a row could not be learned, or where it has not been trusted for
 * long: P then becomes a hundredth of p0 I, and Theta, unless it is in use and finite, the last good or the
 * offline model. */
int KOOP(guard_update)(KOOP(guard) *guard, KOOP(rls) *rls, const KOOP_REAL *psi, const KOOP_REAL *u,
                       const KOOP_REAL *psi_next, KOOP(health) *health);

/* mpc_solve() in its place, with its arguments and status, on the model that is to
 * be trusted; guard.model says which. A plan that is not to be trusted is made
 * again on the next model in the same step: one solve as a rule, two where the
 * online model fails, three at most. KOOP_E_MEMORY, and the safe input of the last solve, where more than one bit of the
 * guard's models has flipped: start the guard again. */
int KOOP(guard_control)(KOOP(guard) *guard, const KOOP(rls) *rls, KOOP(mpc) *mpc, const KOOP_REAL *psi,
                        const KOOP_REAL *reference, const KOOP_REAL *u_before, KOOP_REAL *u,
                        KOOP(mpc_result) *result);
