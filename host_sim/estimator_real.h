/* The estimator in one precision, as the host drives it. Included by
 * estimator.c twice, with REAL, KOOP and SIM defined. */

/* ---- The textbook's form of P ----------------------------------------------
 *
 * P = (P - K g') / lambda with g = P zeta, in full storage, as it is commonly
 * written in C++ and NumPy. K[i] g[j] and K[j] g[i] differ by round-off, nothing
 * in the recursion opposes that difference, and it grows as lambda^-k: the form
 * is here to show what comes of it, and nothing protects it. */

static size_t SIM(textbook_reals)(const KOOP(rls) *rls) {
	return (rls->config.regulator->needs_information ? 2 : 1) * rls->n_regressors * rls->n_regressors_padded;
}

static REAL *SIM(textbook_inverse)(const KOOP(rls) *rls) {
	return rls->covariance + rls->n_regressors * rls->n_regressors_padded;
}

static void SIM(textbook_reset)(KOOP(rls) *rls, REAL p0) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	for (size_t i = 0; i < SIM(textbook_reals)(rls); i++) { rls->covariance[i] = 0; }
	for (size_t i = 0; i < d; i++) {
		rls->covariance[i * rows + i] = p0;
		if (rls->config.regulator->needs_information) { SIM(textbook_inverse)(rls)[i * rows + i] = 1 / p0; }
	}
}

/* y = M zeta; returns zeta' y */
static REAL SIM(multiply)(const KOOP(rls) *rls, const REAL *M, REAL *y) {
	REAL form = 0;
	for (size_t i = 0; i < rls->n_regressors; i++) {
		y[i] = 0;
		for (size_t j = 0; j < rls->n_regressors; j++) {
			y[i] += M[i * rls->n_regressors_padded + j] * rls->zeta[j];
		}
		form += y[i] * rls->zeta[i];
	}
	return form;
}

/* M = (M + a x y') * scale */
static void SIM(outer)(const KOOP(rls) *rls, REAL *M, REAL a, const REAL *x, const REAL *y, REAL scale) {
	for (size_t i = 0; i < rls->n_regressors; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++) {
			REAL *element = &M[i * rls->n_regressors_padded + j];
			*element = (*element + a * x[i] * y[j]) * scale;
		}
	}
}

static REAL SIM(textbook_gain)(KOOP(rls) *rls) {
	return SIM(multiply)(rls, rls->covariance, rls->gain);
}

static REAL SIM(textbook_information)(KOOP(rls) *rls) {
	return SIM(multiply)(rls, SIM(textbook_inverse)(rls), rls->work);
}

static int SIM(textbook_apply)(KOOP(rls) *rls, const KOOP(step) *step, REAL denominator) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	REAL *P = rls->covariance, *g = rls->work + rows;

	if (rls->config.regulator->needs_information) {
		REAL *R = SIM(textbook_inverse)(rls);
		SIM(outer)(rls, R, -step->deflate, rls->work, rls->work, 1);
		SIM(outer)(rls, R, 1, rls->zeta, rls->zeta, 1);
		SIM(outer)(rls, P, step->inflate, rls->zeta, rls->zeta, 1);
	}
	SIM(multiply)(rls, P, g);
	if (denominator < 0) {
		SIM(outer)(rls, P, -denominator, rls->gain, rls->gain, step->scale);
	} else {
		SIM(outer)(rls, P, -1, rls->gain, g, step->scale);
	}

	REAL trace = 0, sum = 0;
	for (size_t i = 0; i < d; i++) { trace += P[i * rows + i]; }
	for (size_t i = 0; i < d * rows; i++) {
		if (step->trace > 0) { P[i] *= step->trace / trace; }
		sum += P[i] * 0;
	}
	return sum == 0 ? KOOP_OK : KOOP_E_OVERFLOW;
}

static REAL SIM(textbook_element)(const KOOP(rls) *rls, size_t i, size_t j) {
	return rls->covariance[i * rls->n_regressors_padded + j];
}

static void SIM(textbook_diagonal)(const KOOP(rls) *rls, REAL *diagonal) {
	for (size_t i = 0; i < rls->n_regressors; i++) { diagonal[i] = SIM(textbook_element)(rls, i, i); }
}

static const KOOP(form) SIM(form_textbook) = {
    .name = "textbook",
    .reals = SIM(textbook_reals),
    .reset = SIM(textbook_reset),
    .gain = SIM(textbook_gain),
    .information = SIM(textbook_information),
    .apply = SIM(textbook_apply),
    .element = SIM(textbook_element),
    .diagonal = SIM(textbook_diagonal),
};

/* ---- One estimator --------------------------------------------------------- */

/* rbf_fwmav, and the squares and products of the four rates: of the size that replays are timed at. */
static void SIM(lift_wide_fwmav)(const KOOP(dictionary) *self, const REAL *x, REAL *psi) {
	const REAL rate[4] = {x[0], x[1], x[2], x[9]};
	REAL *product = psi + KOOP(rbf_fwmav).n_lifted;
	(void)self;
	KOOP(rbf_fwmav).lift(&KOOP(rbf_fwmav), x, psi);
	for (size_t i = 0; i < 4; i++) {
		for (size_t j = 0; j <= i; j++) { *product++ = rate[i] * rate[j]; }
	}
}

static const KOOP(dictionary) SIM(wide_fwmav) = {"wide", 10, 40, SIM(lift_wide_fwmav), NULL};

static const KOOP(dictionary) *SIM(dictionary)(const char *name) {
	static const struct {
		const char *name;
		const KOOP(dictionary) *dictionary;
	} table[] = {
	    {"poly_ddr", &KOOP(poly_ddr)},
	    {"rbf_ddr", &KOOP(rbf_ddr)},
	    {"poly_fwmav", &KOOP(poly_fwmav)},
	    {"rbf_fwmav", &KOOP(rbf_fwmav)},
	    {"wide_fwmav", &SIM(wide_fwmav)}, /* not in lib/ */
	};
	for (size_t i = 0; i < sizeof table / sizeof *table; i++) {
		if (strcmp(table[i].name, name) == 0) { return table[i].dictionary; }
	}
	return NULL;
}

#define ENTER(name) &KOOP(reg_##name),
static const KOOP(regulator) *SIM(regulator_at)(size_t regulator) {
	static const KOOP(regulator) *const table[] = {KOOP_REGULATORS(ENTER)};
	return regulator < sizeof table / sizeof *table ? table[regulator] : NULL;
}
#undef ENTER

static const KOOP(regulator) *SIM(regulator)(const char *name) {
	const KOOP(regulator) *regulator;
	for (size_t i = 0; (regulator = SIM(regulator_at)(i)); i++) {
		if (strcmp(regulator->name, name) == 0) { return regulator; }
	}
	return NULL;
}

static const KOOP(form) *SIM(form)(const char *name) {
	static const KOOP(form) *const table[] = {&KOOP(form_plain), &KOOP(form_sqrt), &SIM(form_textbook)};
	for (size_t i = 0; i < sizeof table / sizeof *table; i++) {
		if (strcmp(table[i]->name, name) == 0) { return table[i]; }
	}
	return NULL;
}

typedef struct SIM(estimator) {
	KOOP(rls) rls;
	KOOP(gate) gate;
	KOOP(gate_config) gate_config;
	int gated;
	REAL settings[TK_MAX_SETTINGS]; /* of the regulator */
	REAL *storage, *gate_storage;
	REAL *vectors;                    /* owns the following */
	REAL *psi, *psi_next, *predicted; /* N each */
	REAL *x, *u;                      /* n, m */
	double *P;                        /* d x d, for what is worked out at the moment */
} SIM(estimator);

static void SIM(free)(SIM(estimator) * e) {
	free(e->storage);
	free(e->gate_storage);
	free(e->vectors);
	free(e->P);
	free(e);
}

/* Of the model as it is now. */
static int SIM(start_gate)(SIM(estimator) * e) {
	size_t reals;
	KOOP(rls_reals)(&e->rls.config, &reals);
	return KOOP(gate_init)(&e->gate, &e->gate_config, &e->rls, e->gate_storage, reals + 3 * e->rls.n_lifted);
}

/* ", fast = 5, slow = 3" */
static const char *SIM(list_settings)(const KOOP(regulator) *regulator, const REAL *value, char *text, size_t size) {
	size_t used = 0;
	text[0] = 0;
	for (size_t i = 0; i < regulator->n_settings && used < size; i++) {
		used += (size_t)snprintf(text + used, size - used, ", %s = %g", regulator->settings[i].name, (double)value[i]);
	}
	return text;
}

/* Says why a configuration is refused, and names what is outside its range. */
static int SIM(refuse)(const KOOP(config) *c, int status) {
	const KOOP(regulator) *r = c->regulator;
	const REAL *value = c->settings ? c->settings : r->defaults;
	char text[400];
	if (status != KOOP_E_RANGE) { return fail("estimator: %s", KOOP(status_message)(status)); }
	for (size_t i = 0; i < r->n_settings; i++) {
		const KOOP(setting) *one = &r->settings[i];
		if (value[i] >= one->low && value[i] <= one->high) { continue; }
		return fail("estimator: setting %s of regulator %s is %g, outside its range %g to %g", one->name, r->name, (double)value[i],
		            (double)one->low, (double)one->high);
	}
	return fail("estimator: lambda, p0 or settings that depend on each other are outside their range: regulator %s, lambda = %g, p0 = %g%s",
	            r->name, (double)c->lambda, (double)c->p0, SIM(list_settings)(r, value, text, sizeof text));
}

static int SIM(new)(const tk_settings *s, SIM(estimator) * *out) {
	KOOP(config) config = {
	    .dictionary = s->own ? &s->own->SIM(own)->dictionary : SIM(dictionary)(s->dictionary),
	    .n_inputs = (size_t)s->n_inputs,
	    .regulator = SIM(regulator)(s->regulator),
	    .form = SIM(form)(s->form),
	    .lambda = (REAL)s->lambda,
	    .p0 = (REAL)s->p0,
	    .check = s->check,
	};
	if (!config.dictionary) { return fail("there is no dictionary named '%s'", s->dictionary); }
	if (!config.regulator) { return fail("there is no regulator named '%s'", s->regulator); }
	if (!config.form) { return fail("there is no covariance form named '%s'", s->form); }

	const size_t own = config.regulator->n_settings;
	REAL settings[TK_MAX_SETTINGS];
	if (own > TK_MAX_SETTINGS) { return fail("regulator '%s' has %zu settings; raise TK_MAX_SETTINGS", s->regulator, own); }
	if (s->n_settings > 0 && (s->n_settings != own || !s->settings)) {
		return fail("regulator '%s' has %zu settings, not %zu", s->regulator, own, s->n_settings);
	}
	for (size_t i = 0; i < s->n_settings; i++) { settings[i] = (REAL)s->settings[i]; }
	config.settings = s->n_settings > 0 ? settings : NULL;

	size_t reals;
	int status = KOOP(rls_reals)(&config, &reals);
	if (status != KOOP_OK) { return SIM(refuse)(&config, status); }
	SIM(estimator) *e = calloc(1, sizeof *e);
	if (!e) { return fail("out of memory"); }
	const size_t N = config.dictionary->n_lifted, n = config.dictionary->n_states, m = config.n_inputs;
	e->storage = calloc(reals, sizeof(REAL));
	e->gate_storage = calloc(reals + 3 * N, sizeof(REAL));
	e->vectors = calloc(3 * N + n + m, sizeof(REAL));
	e->P = calloc((N + m) * (N + m), sizeof(double));
	if (!e->storage || !e->gate_storage || !e->vectors || !e->P) {
		SIM(free)(e);
		return fail("out of memory");
	}
	e->psi = e->vectors;
	e->psi_next = e->psi + N;
	e->predicted = e->psi_next + N;
	e->x = e->predicted + N;
	e->u = e->x + n;
	if (config.settings) { config.settings = memcpy(e->settings, settings, sizeof settings); }
	status = KOOP(rls_init)(&e->rls, &config, e->storage, reals);
	if (status != KOOP_OK) {
		SIM(free)(e);
		return fail("estimator: %s", KOOP(status_message)(status));
	}
	e->gated = s->gate != NULL;
	if (s->gate) {
		e->gate_config = (KOOP(gate_config)){(REAL)s->gate->multiple, (REAL)s->gate->floor, s->gate->patience, s->gate->hold};
	}
	status = SIM(start_gate)(e);
	if (status != KOOP_OK) {
		SIM(free)(e);
		return fail("gate: %s", KOOP(status_message)(status));
	}
	*out = e;
	return TK_OK;
}

static int SIM(get_theta)(const SIM(estimator) * e, double *theta) {
	const size_t N = e->rls.n_lifted, d = e->rls.n_regressors;
	REAL *row = calloc(N * d, sizeof(REAL));
	if (!row) { return fail("out of memory"); }
	KOOP(rls_get_theta)(&e->rls, row);
	for (size_t i = 0; i < N * d; i++) { theta[i] = row[i]; }
	free(row);
	return TK_OK;
}

static int SIM(set_theta)(SIM(estimator) * e, const double *theta) {
	const size_t count = e->rls.n_lifted * e->rls.n_regressors;
	REAL *row = calloc(count, sizeof(REAL));
	if (!row) { return fail("out of memory"); }
	for (size_t i = 0; i < count; i++) { row[i] = (REAL)theta[i]; }
	const int status = KOOP(rls_set_theta)(&e->rls, row);
	free(row);
	SIM(start_gate)(e);
	return status == KOOP_OK ? TK_OK : fail("theta: %s", KOOP(status_message)(status));
}

/* P in double. From S where P is kept as S S': P itself may not fit a float. */
static void SIM(get_covariance)(const SIM(estimator) * e, double *P) {
	const KOOP(form) *form = e->rls.config.form;
	const size_t d = e->rls.n_regressors;
	const int factored = form == &KOOP(form_sqrt), symmetric = form != &SIM(form_textbook);
	for (size_t i = 0; i < d * d; i++) { P[i] = 0; }
	for (size_t k = 0; factored && k < d; k++) {
		for (size_t i = 0; i <= k; i++) {
			const double a = form->get(&e->rls, 0, k, i);
			for (size_t j = 0; j <= i; j++) { P[i * d + j] += a * (double)form->get(&e->rls, 0, k, j); }
		}
	}
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			if (!factored) { P[i * d + j] = form->element(&e->rls, i, j); }
			P[j * d + i] = symmetric ? P[i * d + j] : (double)form->element(&e->rls, j, i);
		}
	}
}

static int SIM(reset_covariance)(SIM(estimator) * e, double p0) {
	const int status = KOOP(rls_reset_covariance)(&e->rls, (REAL)p0);
	return status == KOOP_OK ? TK_OK : fail("p0: %s", KOOP(status_message)(status));
}

/* Number of reals that a stored P takes. */
static size_t SIM(stored_covariance)(const KOOP(rls) *rls) {
	const KOOP(regulator) *regulator = rls->config.regulator;
	const KOOP(extension) *extension = regulator->extension;
	const size_t triangle = KOOP_MODEL_TRIANGLE(rls->n_regressors);
	const size_t inverse = regulator->needs_information && rls->config.form == &KOOP(form_plain) ? triangle : 0;
	return triangle + inverse + (extension && extension->memory ? extension->memory(rls) : 0);
}

static int SIM(model)(const SIM(estimator) * e, int covariance, void *bytes, size_t *size) {
	const size_t reals = e->rls.n_lifted * e->rls.n_regressors + (covariance ? SIM(stored_covariance)(&e->rls) : 0);
	const size_t needed = KOOP_MODEL_HEADER_BYTES + sizeof(REAL) * reals;
	if (bytes) {
		const int status = covariance ? KOOP(model_save_covariance)(&e->rls, bytes, *size)
		                              : KOOP(model_save)(&e->rls, bytes, *size);
		if (status != KOOP_OK) { return fail("model: %s", KOOP(status_message)(status)); }
	}
	*size = needed;
	return TK_OK;
}

static int SIM(load)(SIM(estimator) * e, const void *bytes, size_t size) {
	const int status = KOOP(model_load)(&e->rls, bytes, size);
	SIM(start_gate)(e);
	return status == KOOP_OK ? TK_OK : fail("model: %s", KOOP(status_message)(status));
}

static int SIM(lift_one)(SIM(estimator) * e, const double *x, REAL *psi) {
	for (size_t i = 0; i < e->rls.config.dictionary->n_states; i++) { e->x[i] = (REAL)x[i]; }
	return KOOP(lift)(e->rls.config.dictionary, e->x, psi);
}

/* psi from a state, or from what the caller lifted: the estimator refuses what is not finite. */
static int SIM(take)(SIM(estimator) * e, int lifted, const double *values, REAL *psi) {
	if (!lifted) { return SIM(lift_one)(e, values, psi); }
	for (size_t i = 0; i < e->rls.n_lifted; i++) { psi[i] = (REAL)values[i]; }
	return KOOP_OK;
}

static int SIM(lift)(SIM(estimator) * e, size_t rows, const double *x, double *psi) {
	const size_t n = e->rls.config.dictionary->n_states, N = e->rls.n_lifted;
	for (size_t k = 0; k < rows; k++) {
		const int status = SIM(lift_one)(e, x + k * n, e->psi);
		if (status != KOOP_OK) { return fail("lift, row %zu: %s", k, KOOP(status_message)(status)); }
		for (size_t i = 0; i < N; i++) { psi[k * N + i] = e->psi[i]; }
	}
	return TK_OK;
}

/* By the factor's diagonal where P is kept as one, else independently of the library in double. */
static int SIM(positive_definite)(SIM(estimator) * e, int reported) {
	if (e->rls.config.form == &KOOP(form_sqrt)) { return reported; }
	SIM(get_covariance)(e, e->P);
	return cholesky_succeeds(e->P, e->rls.n_regressors);
}

/* Of Theta's columns from `first` up to `last`. */
static double SIM(norm_of_theta)(const SIM(estimator) * e, size_t first, size_t last) {
	double *next = e->P;
	for (size_t j = first; j < last; j++) {
		const REAL *column = e->rls.theta + j * e->rls.n_lifted_padded;
		for (size_t i = 0; i < e->rls.n_lifted; i++) { *next++ = column[i]; }
	}
	return norm_of(e->P, (size_t)(next - e->P));
}

static void SIM(record_norms)(const SIM(estimator) * e, size_t k, const tk_trace *trace) {
	const size_t N = e->rls.n_lifted, d = e->rls.n_regressors;
	if (trace->norm_a) { trace->norm_a[k] = SIM(norm_of_theta)(e, 0, N); }
	if (trace->norm_b) { trace->norm_b[k] = SIM(norm_of_theta)(e, N, d); }
	if (trace->norm_p) {
		SIM(get_covariance)(e, e->P);
		trace->norm_p[k] = norm_of(e->P, d * d);
	}
}

/* The prediction of step k, NaN where there is none, and what it misses. */
static void SIM(record_prediction)(const SIM(estimator) * e, size_t k, int made, const double *x_next,
                                   const tk_trace *trace) {
	const size_t n = e->rls.config.dictionary->n_states;
	for (size_t i = 0; i < n; i++) {
		const double predicted = made ? (double)e->predicted[i] : (double)NAN;
		if (trace->predicted) { trace->predicted[k * n + i] = predicted; }
		e->P[i] = x_next[i] - predicted;
	}
	if (trace->error) { trace->error[k] = norm_of(e->P, n); }
}

static int SIM(learn)(SIM(estimator) * e, KOOP(health) *health) {
	if (e->gated) { return KOOP(gate_update)(&e->gate, &e->rls, e->psi, e->u, e->psi_next, health); }
	return KOOP(rls_update)(&e->rls, e->psi, e->u, e->psi_next, health);
}

/* Takes a transition into psi, u and psi_next; returns the status. */
static int SIM(take_transition)(SIM(estimator) * e, int lifted, const double *now, const double *u, const double *next) {
	int status = SIM(take)(e, lifted, now, e->psi);
	if (status == KOOP_OK) { status = SIM(take)(e, lifted, next, e->psi_next); }
	for (size_t j = 0; j < e->rls.config.n_inputs; j++) { e->u[j] = (REAL)u[j]; }
	return status;
}

static void SIM(tell)(const SIM(estimator) * e, int status, const KOOP(health) *health, tk_health *out) {
	*out = (tk_health){
	    .status = status,
	    .frozen = health->frozen,
	    .positive_definite = health->positive_definite,
	    .short_memory = health->short_memory,
	    .winding_up = health->winding_up,
	    .trust = e->gated ? KOOP(gate_trust)(&e->gate) : -1,
	    .innovation = status == KOOP_OK ? (double)health->innovation : (double)NAN,
	    .trace = health->trace,
	    .min_diagonal = health->min_diagonal,
	};
}

static int SIM(update)(SIM(estimator) * e, int lifted, const double *now, const double *u, const double *next,
                       tk_health *out) {
	KOOP(health) health = {0};
	int status = SIM(take_transition)(e, lifted, now, u, next);
	if (status == KOOP_OK) { status = SIM(learn)(e, &health); }
	SIM(tell)(e, status, &health, out);
	return TK_OK;
}

static int SIM(predict)(SIM(estimator) * e, int lifted, size_t rows, const double *now, const double *u,
                        double *psi_next) {
	const size_t N = e->rls.n_lifted, m = e->rls.config.n_inputs;
	const size_t width = lifted ? N : e->rls.config.dictionary->n_states;
	for (size_t k = 0; k < rows; k++) {
		int status = SIM(take)(e, lifted, now + k * width, e->psi);
		for (size_t j = 0; j < m; j++) { e->u[j] = (REAL)u[k * m + j]; }
		if (status == KOOP_OK) { status = KOOP(rls_predict)(&e->rls, e->psi, e->u, e->predicted); }
		if (status != KOOP_OK) { return fail("prediction, row %zu: %s", k, KOOP(status_message)(status)); }
		for (size_t i = 0; i < N; i++) { psi_next[k * N + i] = e->predicted[i]; }
	}
	return TK_OK;
}

static int SIM(rollout)(SIM(estimator) * e, int lifted, size_t steps, const double *start, const double *u,
                        double *psi) {
	const size_t N = e->rls.n_lifted, m = e->rls.config.n_inputs;
	int status = SIM(take)(e, lifted, start, e->psi);
	for (size_t k = 0;; k++) {
		if (status != KOOP_OK) { return fail("rollout, step %zu: %s", k, KOOP(status_message)(status)); }
		for (size_t i = 0; i < N; i++) { psi[k * N + i] = e->psi[i]; }
		if (k == steps) { return TK_OK; }
		for (size_t j = 0; j < m; j++) { e->u[j] = (REAL)u[k * m + j]; }
		status = KOOP(rls_predict)(&e->rls, e->psi, e->u, e->predicted);
		REAL *swap = e->psi;
		e->psi = e->predicted;
		e->predicted = swap;
	}
}

static int SIM(replay)(SIM(estimator) * e, size_t steps, const double *x, const double *psi, const double *u,
                       const int32_t *usable, int learn, const tk_trace *trace) {
	const size_t n = e->rls.config.dictionary->n_states, m = e->rls.config.n_inputs;
	const size_t N = e->rls.n_lifted, d = e->rls.n_regressors;
	/* the square-root form has to work out P's diagonal for it */
	const int asks_health = trace->innovation || trace->frozen || trace->trace || trace->min_diagonal;
	int lifted = KOOP_E_INPUT; /* status of psi for the row at hand */
	size_t snapshot = 0;

	for (size_t k = 0; k < steps; k++) {
		KOOP(health) health = {0};
		int status = 1, predicted = 0, learned = 0;

		if (trace->every && k % trace->every == 0) {
			if (trace->theta) { SIM(get_theta)(e, trace->theta + snapshot * N * d); }
			if (trace->covariance) { SIM(get_covariance)(e, trace->covariance + snapshot * d * d); }
			snapshot++;
		}
		if (!usable || usable[k]) {
			const double *from = psi ? psi : x;
			const size_t width = psi ? N : n;
			if (k == 0 || lifted != KOOP_OK) { lifted = SIM(take)(e, psi != NULL, from + k * width, e->psi); }
			const int next = SIM(take)(e, psi != NULL, from + (k + 1) * width, e->psi_next);
			for (size_t i = 0; i < m; i++) { e->u[i] = (REAL)u[k * m + i]; }
			status = lifted != KOOP_OK ? lifted : next;
			if (status == KOOP_OK) { status = KOOP(rls_predict)(&e->rls, e->psi, e->u, e->predicted); }
			predicted = status == KOOP_OK;
			learned = predicted && learn;
			if (learned) { status = SIM(learn)(e, asks_health ? &health : NULL); }
			REAL *swap = e->psi;
			e->psi = e->psi_next;
			e->psi_next = swap;
			lifted = next;
		} else {
			lifted = KOOP_E_INPUT;
		}

		SIM(record_prediction)(e, k, predicted, x + (k + 1) * n, trace);
		if (trace->innovation) { trace->innovation[k] = learned ? (double)health.innovation : (double)NAN; }
		if (trace->status) { trace->status[k] = status; }
		if (trace->frozen) { trace->frozen[k] = health.frozen; }
		if (trace->trace) { trace->trace[k] = health.trace; }
		if (trace->min_diagonal) { trace->min_diagonal[k] = health.min_diagonal; }
		if (trace->trust) { trace->trust[k] = e->gated ? KOOP(gate_trust)(&e->gate) : -1; }
		if (trace->positive_definite) {
			trace->positive_definite[k] = SIM(positive_definite)(e, e->rls.positive_definite);
		}
		SIM(record_norms)(e, k, trace);
	}
	return TK_OK;
}

static int SIM(soak)(SIM(estimator) * e, size_t steps, const double *zeta, const double *target,
                     size_t repeats, tk_soak *result) {
	const size_t N = e->rls.n_lifted, d = e->rls.n_regressors;
	REAL *z = calloc(steps * d, sizeof(REAL)), *y = calloc(steps * N, sizeof(REAL));
	if (!z || !y) {
		free(z);
		free(y);
		return fail("out of memory");
	}
	for (size_t i = 0; i < steps * d; i++) { z[i] = (REAL)zeta[i]; }
	for (size_t i = 0; i < steps * N; i++) { y[i] = (REAL)target[i]; }

	*result = (tk_soak){0, 0, -1, -1};
	for (uint64_t k = 0; k < (uint64_t)steps * repeats; k++) {
		const size_t row = (size_t)(k % steps);
		const int status = KOOP(rls_update)(&e->rls, z + row * d, z + row * d + N, y + row * N, NULL);
		result->updates += status == KOOP_OK;
		result->refused += status != KOOP_OK;
		if (result->non_finite_at < 0 && (status == KOOP_E_OVERFLOW || status == KOOP_E_INPUT)) {
			result->non_finite_at = (int64_t)k;
		}
		/* a factorisation at every update would take longer than the soak */
		if (result->lost_positive_definite_at < 0 && k % 101 == 0 &&
		    !SIM(positive_definite)(e, e->rls.positive_definite)) {
			result->lost_positive_definite_at = (int64_t)k;
		}
	}
	free(z);
	free(y);
	return TK_OK;
}

/* ---- Low-pass ----------------------------------------------------------------- */

static int SIM(lowpass)(double cutoff, double rate, size_t rows, size_t n, const double *x,
                        const int32_t *usable, double *y) {
	REAL storage[KOOP_LOWPASS_REALS(KOOP_MAX_DIM)], now[KOOP_MAX_DIM];
	KOOP(lowpass) filter;
	const size_t reals = sizeof storage / sizeof *storage;
	int status = KOOP(lowpass_init)(&filter, n, (REAL)cutoff, (REAL)rate, storage, reals);
	if (status != KOOP_OK) {
		return fail("low-pass of %g Hz at %g Hz, %zu channels: %s", cutoff, rate, n, KOOP(status_message)(status));
	}
	for (size_t k = 0; k < rows; k++) {
		if (k > 0 && usable && !usable[k - 1]) { KOOP(lowpass_reset)(&filter); }
		for (size_t i = 0; i < n; i++) { now[i] = (REAL)x[k * n + i]; }
		status = KOOP(lowpass_step)(&filter, now, now);
		for (size_t i = 0; i < n; i++) { y[k * n + i] = (double)(status == KOOP_OK ? now[i] : (REAL)NAN); }
	}
	return TK_OK;
}
