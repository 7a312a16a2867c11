/* Exponential and cyclic resetting. Lai and Bernstein, "Exponential resetting and cyclic resetting recursive least
 * squares", IEEE Control Systems Letters 7, 2023: without excitation P tends to p_inf I, not to infinity.
 *
 *     er   P^-1 = lambda P^-1 + (1 - lambda) / p_inf I + zeta zeta'
 *     cr   P^-1 = lambda P^-1 + (1 - lambda^d) / p_inf e e' + zeta zeta', e the next unit vector in each sample
 *
 * The P that is kept has forgotten already, and learns from the next sample with lambda = 1: the gain is the P of
 * the formula times zeta. The weight of cr is that with which a cycle of d samples ends where it began.
 * er takes d + 1 updates of P per sample, of d^2 operations each; cr takes two.
 *
 * Guaranteed after every sample, whatever the excitation, with p = max(p0, p_inf) and |zeta|^2 <= beta:
 *     er   P <= p I;                   P >= I / max(1 / p0, 1 / p_inf + lambda beta / (1 - lambda))
 *     cr   P <= p lambda^(1 - d) I;    P >= I / max(1 / p0, ((1 - lambda^d) / p_inf + lambda beta) / (1 - lambda))
 * and |K| <= sqrt(p) / 2, of cr sqrt(p lambda^(1 - d)) / 2. */

/* A unit vector, and for cr the direction that is next. */
static COLD size_t memory_er(const KOOP(rls) *rls) {
	return rls->n_regressors + 1;
}

static real er_p_inf(const KOOP(rls) *rls) {
	const KOOP(attractor) *own = (const KOOP(attractor) *)rls->config.settings;
	return own->p_inf > 0 ? own->p_inf : rls->config.p0;
}

/* What is added to P^-1 before it is scaled by lambda, for a share of it that is forgotten. */
static real er_information(const KOOP(rls) *rls, real forgotten) {
	return forgotten / rls->config.lambda / er_p_inf(rls);
}

static COLD int check_er(KOOP(rls) *rls) {
	const real forgotten = 1 - rls->config.lambda, least = er_information(rls, forgotten);
	const int possible = !(forgotten > 0) || is_within(least, 4 * REAL_MIN, REAL_MAX / 1024);
	const real largest = max_of(er_p_inf(rls), rls->config.p0) * (real)rls->n_regressors;
	rls->nominal_trace = largest;
	return possible && largest < REAL_MAX / 8 ? KOOP_OK : KOOP_E_RANGE;
}

static int er_restore(KOOP(rls) *rls, size_t direction, real information) {
	if (!(information > 0)) { return KOOP_OK; } /* lambda = 1 */
	rls->memory[direction] = 1;
	const int status = KOOP(rls_add_information)(rls, rls->memory, information);
	rls->memory[direction] = 0;
	return status;
}

static int reshape_er(KOOP(rls) *rls) {
	const real information = er_information(rls, 1 - rls->config.lambda);
	for (size_t i = 0; i < rls->n_regressors; i++) {
		const int status = er_restore(rls, i, information);
		if (status != KOOP_OK) { return status; }
	}
	return KOOP(rls_scale_covariance)(rls, 1 / rls->config.lambda);
}

static int reshape_cr(KOOP(rls) *rls) {
	real kept = 1, *next = &rls->memory[rls->n_regressors];
	for (size_t i = 0; i < rls->n_regressors; i++) { kept *= rls->config.lambda; }
	const size_t direction = (size_t)*next;
	*next = direction + 1 < rls->n_regressors ? (real)(direction + 1) : 0;
	const int status = er_restore(rls, direction, er_information(rls, 1 - kept));
	return status == KOOP_OK ? KOOP(rls_scale_covariance)(rls, 1 / rls->config.lambda) : status;
}

static const KOOP(attractor) KOOP(er_defaults) = {0};
static const KOOP(setting) KOOP(er_settings)[1] = {{"p_inf", 0, REAL_MAX / 8}};
static const KOOP(extension) KOOP(er_extension) = {&KOOP(reg_engine), memory_er, NULL, NULL, reshape_er};
static const KOOP(extension) KOOP(cr_extension) = {&KOOP(reg_engine), memory_er, NULL, NULL, reshape_cr};

const KOOP(regulator) KOOP(reg_er) = {KOOP(name_er), 0, decide_none, 1, KOOP(er_settings), 1, &KOOP(er_defaults), check_er,
                                      &KOOP(er_extension)};

const KOOP(regulator) KOOP(reg_cr) = {KOOP(name_cr), 0, decide_none, 1, KOOP(er_settings), 1, &KOOP(er_defaults), check_er,
                                      &KOOP(cr_extension)};
