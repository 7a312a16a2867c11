/* Closed loop in one precision: lift, plan, move, learn. Included by estimator.c
 * twice, after estimator_real.h. The plant stays in double. */

typedef struct SIM(controller) {
	KOOP(mpc) mpc;
	REAL *weights;   /* owns Q, R, S, limits and the safe input */
	REAL *limits;    /* u_min, then u_max */
	REAL *storage;
	REAL *reference; /* horizon rows of n */
	REAL *theta;     /* as rls.theta */
	REAL *psi, *plan;
	REAL *u, *u_before; /* m each */
	double *wide; /* Theta, psi and the reference, for another solver */
} SIM(controller);

static void SIM(controller_close)(SIM(controller) * c) {
	free(c->weights);
	free(c->storage);
	free(c->reference);
	free(c->theta);
	free(c->psi);
	free(c->plan);
	free(c->wide);
}

/* Copies `count` reals, zeros where there are none, to *next, which it moves on; returns where they are. */
static const REAL *SIM(copied)(const double *values, size_t count, REAL **next) {
	REAL *first = *next;
	for (size_t i = 0; i < count; i++) { first[i] = values ? (REAL)values[i] : 0; }
	*next += count;
	return first;
}

static int SIM(controller_open)(SIM(controller) * c, const tk_mpc_settings *s, size_t N) {
	const size_t n = s->n_states, m = s->n_inputs, H = s->horizon;
	*c = (SIM(controller)){0};
	if (N > KOOP_MAX_DIM || n > KOOP_MAX_DIM || m > KOOP_MAX_DIM || H > KOOP_MPC_MAX_HORIZON) {
		return fail("controller: %s", KOOP(status_message)(KOOP_E_SIZE));
	}
	const size_t reals = KOOP_MPC_REALS_NEWTON(N, n, m, H) + KOOP_MPC_REALS_RATE(m, H);
	c->weights = calloc(n * n + 2 * m * m + 5 * m + 1, sizeof(REAL));
	c->storage = calloc(reals, sizeof(REAL));
	c->reference = calloc(n * H + 1, sizeof(REAL));
	c->theta = calloc((N + m) * KOOP_PAD(N) + 1, sizeof(REAL));
	c->psi = calloc(N + 1, sizeof(REAL));
	c->plan = calloc(m * H + 1, sizeof(REAL));
	c->wide = calloc(N * (N + m) + N + 1, sizeof(double));
	if (!c->weights || !c->storage || !c->reference || !c->theta || !c->psi || !c->plan || !c->wide) {
		SIM(controller_close)(c);
		return fail("out of memory");
	}
	REAL *next = c->weights;
	c->limits = next;
	const REAL *u_min = SIM(copied)(s->u_min, m, &next), *u_max = SIM(copied)(s->u_max, m, &next);
	const KOOP(mpc_config) config = {
	    .n_lifted = N,
	    .n_states = n,
	    .n_inputs = m,
	    .horizon = H,
	    .Q = SIM(copied)(s->Q, n * n, &next),
	    .R = SIM(copied)(s->R, m * m, &next),
	    .S = s->S ? SIM(copied)(s->S, m * m, &next) : NULL,
	    .u_min = u_min,
	    .u_max = u_max,
	    .u_safe = SIM(copied)(s->u_safe, m, &next),
	    .tolerance = (REAL)s->tolerance,
	    .method = s->method,
	};
	c->u = next;
	c->u_before = next + m;
	const int status = KOOP(mpc_init)(&c->mpc, &config, c->storage, reals);
	if (status != KOOP_OK) {
		SIM(controller_close)(c);
		return fail("controller: %s", KOOP(status_message)(status));
	}
	return TK_OK;
}

/* Of the next solve, which reads them again. */
static void SIM(controller_limits)(SIM(controller) * c, const double *u_min, const double *u_max) {
	REAL *next = c->limits;
	(void)SIM(copied)(u_min, c->mpc.config.n_inputs, &next);
	(void)SIM(copied)(u_max, c->mpc.config.n_inputs, &next);
}

/* Theta (N x d) as rls.theta has it, into c->theta */
static void SIM(load_theta)(SIM(controller) * c, const double *theta) {
	const size_t N = c->mpc.config.n_lifted, d = N + c->mpc.config.n_inputs;
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < d; j++) { c->theta[j * KOOP_PAD(N) + i] = (REAL)theta[i * d + j]; }
	}
}

/* A supervisor with its storage, which is null where there is none. */
typedef struct SIM(supervised) {
	KOOP(supervisor) supervisor;
	REAL *storage;
} SIM(supervised);

/* Plans on Theta; or, with a supervisor g, on the model of the learner e or another that it trusts more. */
static int SIM(controller_solve)(SIM(controller) * c, SIM(supervised) * g, SIM(estimator) * e, const double *theta,
                                 const double *psi, const double *reference, const double *u_before, double *u,
                                 double *plan, tk_solution *solution) {
	const KOOP(mpc_config) *config = &c->mpc.config;
	const size_t m = config->n_inputs, H = config->horizon;
	KOOP(mpc_result) result = {0};
	if (theta) { SIM(load_theta)(c, theta); }
	for (size_t i = 0; i < config->n_lifted; i++) { c->psi[i] = (REAL)psi[i]; }
	for (size_t i = 0; i < config->n_states * H; i++) { c->reference[i] = (REAL)reference[i]; }
	for (size_t j = 0; u_before && j < m; j++) { c->u_before[j] = (REAL)u_before[j]; }
	const REAL *before = u_before ? c->u_before : NULL;
	const double start = microseconds();
	solution->status =
	    g ? KOOP(supervisor_control)(&g->supervisor, &e->rls, &c->mpc, c->psi, c->reference, before, c->u, &result)
	      : KOOP(mpc_solve)(&c->mpc, c->theta, c->psi, c->reference, before, c->u, &result);
	solution->microseconds = microseconds() - start;
	solution->iterations = result.iterations;
	solution->residual = result.residual;
	KOOP(mpc_plan)(&c->mpc, c->plan);
	for (size_t i = 0; i < m * H; i++) { plan[i] = c->plan[i]; }
	for (size_t j = 0; u && j < m; j++) { u[j] = c->u[j]; }
	return TK_OK;
}

static int SIM(supervisor_open)(SIM(supervised) * g, SIM(controller) * c, const tk_supervisor_settings *s,
                                KOOP(gate) *gate) {
	*g = (SIM(supervised)){0};
	if (!s) { return TK_OK; }
	const KOOP(mpc_config) *mpc = &c->mpc.config;
	const KOOP(supervisor_config) config = {
	    .min_cosine = (REAL)s->min_cosine,
	    .min_gain = (REAL)s->min_gain,
	    .max_gain = (REAL)s->max_gain,
	    .max_error_ratio = (REAL)s->max_error_ratio,
	    .max_residual = (REAL)s->max_residual,
	    .max_tracking_ratio = (REAL)s->max_tracking_ratio,
	    .patience = s->patience,
	    .renewal = s->renewal,
	    .gate = gate,
	};
	const size_t reals = KOOP_SUPERVISOR_REALS(mpc->n_lifted, mpc->n_states, mpc->n_inputs, mpc->horizon);
	g->storage = calloc(reals, sizeof(REAL));
	if (!g->storage) { return fail("out of memory"); }
	SIM(load_theta)(c, s->offline);
	const int status = KOOP(supervisor_init)(&g->supervisor, &config, &c->mpc, c->theta, g->storage, reals);
	if (status != KOOP_OK) {
		free(g->storage);
		return fail("supervisor: %s", KOOP(status_message)(status));
	}
	return TK_OK;
}

/* An update by supervisor_update(). */
static int SIM(supervised_update)(SIM(supervised) * g, SIM(estimator) * e, int lifted, const double *now, const double *u,
                                  const double *next, tk_health *out) {
	KOOP(health) health = {0};
	int status = SIM(take_transition)(e, lifted, now, u, next);
	if (status == KOOP_OK) {
		status = KOOP(supervisor_update)(&g->supervisor, &e->rls, e->psi, e->u, e->psi_next, &health);
	}
	SIM(tell)(e, status, &health, out);
	return TK_OK;
}

/* The same step by the solver that the settings name. */
static int SIM(solve_elsewhere)(SIM(estimator) * e, const SIM(controller) * c, const tk_mpc_settings *s,
                                const double *reference) {
	const size_t N = e->rls.n_lifted;
	double *theta = c->wide, *psi = theta + N * (N + 2), u[2] = {0, 0};
	SIM(get_theta)(e, theta);
	for (size_t i = 0; i < N; i++) { psi[i] = e->psi[i]; }
	const int status = s->solver(theta, psi, reference, u);
	for (size_t j = 0; j < 2; j++) { e->u[j] = status == 0 ? (REAL)u[j] : 0; }
	return status;
}

static int SIM(control)(SIM(estimator) * e, const tk_mpc_settings *settings, ddr *robot, size_t steps,
                        const double *reference, int learn, const tk_supervisor_settings *supervisor,
                        const tk_control_trace *trace) {
	const size_t N = e->rls.n_lifted, d = e->rls.n_regressors, H = settings->horizon;
	SIM(controller) c;
	SIM(supervised) g;
	double x[3];
	size_t snapshot = 0;
	if (e->rls.config.dictionary->n_states != 3 || d != N + 2 || settings->n_states != 3 || settings->n_inputs != 2) {
		return fail("control: the dictionary is not one of the differential-drive robot");
	}
	if (supervisor && settings->solver) {
		return fail("control: the supervisor works only with the library's own solver");
	}
	if (SIM(controller_open)(&c, settings, N) != TK_OK) { return TK_ERROR; }
	if (SIM(supervisor_open)(&g, &c, supervisor, NULL) != TK_OK) {
		SIM(controller_close)(&c);
		return TK_ERROR;
	}

	ddr_measure(robot, x);
	int lifted = SIM(lift_one)(e, x, e->psi);
	for (size_t k = 0; k < steps; k++) {
		KOOP(mpc_result) result = {0};
		if (trace->x) { memcpy(trace->x + 3 * k, x, sizeof x); }
		if (trace->every && k % trace->every == 0) {
			if (trace->theta) { SIM(get_theta)(e, trace->theta + snapshot * N * d); }
			if (trace->covariance) { SIM(get_covariance)(e, trace->covariance + snapshot * d * d); }
			snapshot++;
		}

		for (size_t i = 0; i < 3 * H; i++) { c.reference[i] = (REAL)reference[3 * (k + 1) + i]; }
		e->u[0] = e->u[1] = 0;
		const double start = microseconds();
		int status = lifted;
		if (lifted == KOOP_OK && settings->solver) {
			status = SIM(solve_elsewhere)(e, &c, settings, reference + 3 * (k + 1));
		} else if (lifted == KOOP_OK && supervisor) {
			status = KOOP(supervisor_control)(&g.supervisor, &e->rls, &c.mpc, e->psi, c.reference, NULL, e->u,
			                                  &result);
		} else if (lifted == KOOP_OK) {
			status = KOOP(mpc_solve)(&c.mpc, e->rls.theta, e->psi, c.reference, NULL, e->u, &result);
		}
		const double took = microseconds() - start;

		const double u[2] = {e->u[0], e->u[1]};
		ddr_step(robot, u);
		ddr_measure(robot, x);
		const int next = SIM(lift_one)(e, x, e->psi_next);
		KOOP(health) health = {.innovation = (REAL)NAN};
		if (learn && lifted == KOOP_OK && next == KOOP_OK) {
			if (supervisor) {
				KOOP(supervisor_update)(&g.supervisor, &e->rls, e->psi, e->u, e->psi_next, &health);
			} else {
				KOOP(rls_update)(&e->rls, e->psi, e->u, e->psi_next, &health);
			}
		}
		REAL *swap = e->psi;
		e->psi = e->psi_next;
		e->psi_next = swap;
		lifted = next;

		if (trace->u) { memcpy(trace->u + 2 * k, u, sizeof u); }
		if (trace->status) { trace->status[k] = status; }
		if (trace->residual) { trace->residual[k] = result.residual; }
		if (trace->iterations) { trace->iterations[k] = (int32_t)result.iterations; }
		if (trace->solve_us) { trace->solve_us[k] = took; }
		if (trace->innovation) { trace->innovation[k] = health.innovation; }
		if (trace->model) { trace->model[k] = g.supervisor.model; }
		if (trace->resets) { trace->resets[k] = (int32_t)g.supervisor.resets; }
	}
	if (trace->x) { memcpy(trace->x + 3 * steps, x, sizeof x); }
	free(g.storage);
	SIM(controller_close)(&c);
	return TK_OK;
}
