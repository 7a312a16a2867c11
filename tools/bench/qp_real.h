/* One pass over the recorded steps in the precision that `REAL`, `KOOP` and `QP`
 * stand for. Included by qp.c twice. */

typedef struct QP(solver) {
	KOOP(mpc) mpc;
	REAL Q[9], R[4], u_min[2], u_max[2], u_safe[2];
	REAL *storage, *theta, *psi, *reference, *plan;
} QP(solver);

static void QP(close)(QP(solver) * s) {
	free(s->storage);
	free(s->theta);
	free(s->psi);
	free(s->reference);
	free(s->plan);
}

static int QP(open)(QP(solver) * s, const recording *r, int method, double tolerance) {
	const size_t N = r->n_lifted, H = r->horizon;
	*s = (QP(solver)){0};
	for (size_t i = 0; i < 3; i++) { s->Q[4 * i] = (REAL)r->q[i]; }
	for (size_t j = 0; j < 2; j++) {
		s->R[3 * j] = (REAL)r->r[j];
		s->u_min[j] = (REAL)r->u_min[j];
		s->u_max[j] = (REAL)r->u_max[j];
	}
	const KOOP(mpc_config) config = {
	    .n_lifted = N,
	    .n_states = 3,
	    .n_inputs = 2,
	    .horizon = H,
	    .Q = s->Q,
	    .R = s->R,
	    .u_min = s->u_min,
	    .u_max = s->u_max,
	    .u_safe = s->u_safe,
	    .tolerance = (REAL)tolerance,
	    .method = method,
	};
	const size_t reals = KOOP_MPC_REALS_NEWTON(N, 3, 2, H);
	s->storage = calloc(reals, sizeof(REAL));
	s->theta = calloc((N + 2) * KOOP_PAD(N), sizeof(REAL));
	s->psi = calloc(N, sizeof(REAL));
	s->reference = calloc(3 * H, sizeof(REAL));
	s->plan = calloc(2 * H, sizeof(REAL));
	return s->storage && s->theta && s->psi && s->reference && s->plan &&
	       KOOP(mpc_init)(&s->mpc, &config, s->storage, reals) == KOOP_OK;
}

/* Theta row by row, psi, reference: as a firmware has them, in its layout and its precision. */
static void QP(load)(QP(solver) * s, const double *step) {
	const size_t N = s->mpc.config.n_lifted, H = s->mpc.config.horizon;
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < N + 2; j++) { s->theta[j * KOOP_PAD(N) + i] = (REAL)step[i * (N + 2) + j]; }
	}
	for (size_t i = 0; i < N; i++) { s->psi[i] = (REAL)step[N * (N + 2) + i]; }
	for (size_t i = 0; i < 3 * H; i++) { s->reference[i] = (REAL)step[N * (N + 3) + i]; }
}

/* us for condensing and solving; negative when there is no plan */
static double QP(solve)(QP(solver) * s, KOOP(mpc_result) *result) {
	REAL u[2];
	const double start = now_us();
	const int status = KOOP(mpc_solve)(&s->mpc, s->theta, s->psi, s->reference, NULL, u, result);
	const double took = now_us() - start;
	return status == KOOP_OK ? took : -1;
}

static int QP(print)(QP(solver) * s, const char *mode, double us, const KOOP(mpc_result) *result, int plans) {
	printf(", \"%s\": {\"us\": %.3f, \"iterations\": %zu", mode, us, result->iterations);
	if (plans) {
		if (KOOP(mpc_plan)(&s->mpc, s->plan) != KOOP_OK) { return 0; }
		for (size_t i = 0; i < 2 * s->mpc.config.horizon; i++) {
			printf("%s%.17g", i ? ", " : ", \"plan\": [", (double)s->plan[i]);
		}
		printf("]");
	}
	printf("}");
	return us >= 0;
}

/* Cold: from the safe input. Warm: from the plan of the step before. In both the step before is
 * solved first, untimed, so that both find the same caches. */
static int QP(pass)(const recording *r, const setting *what, size_t first, size_t count, int plans) {
	QP(solver) s;
	int fine = QP(open)(&s, r, what->method, what->tolerance);
	for (size_t i = first; fine && i < first + count; i++) {
		KOOP(mpc_result) result = {0};
		const double *before = r->steps + 2 * i * r->step_size, *now = before + r->step_size;
		printf("{\"setting\": \"%s\", \"instance\": %zu", what->text, i);
		for (int warm = 0; warm <= 1; warm++) {
			KOOP(mpc_reset)(&s.mpc);
			QP(load)(&s, before);
			fine = fine && QP(solve)(&s, &result) >= 0;
			if (!warm) { KOOP(mpc_reset)(&s.mpc); }
			QP(load)(&s, now);
			const double us = QP(solve)(&s, &result);
			fine = QP(print)(&s, warm ? "warm" : "cold", us, &result, plans) && fine;
		}
		printf("}\n");
	}
	QP(close)(&s);
	return fine;
}
