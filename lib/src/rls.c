/* Recursive least squares on lifted snapshots. Paper, eq. (4). */

static COLD int choices_in_range(const KOOP(config) *c) {
	const int check = c->check >= KOOP_CHECK_REFUSE && c->check <= KOOP_CHECK_DIAGONAL;
	return check && (c->checksum == 0 || c->checksum == 1);
}

static COLD int numbers_in_range(const KOOP(config) *c) {
	const int forgetting = c->lambda > 0 && c->lambda <= 1;
	return forgetting && is_within(c->p0, REAL_MIN, REAL_MAX / 2) && choices_in_range(c);
}

/* ---- The regulator's settings and memory ----------------------------------------- */

static COLD int settings_in_range(const KOOP(regulator) *regulator, const real *value) {
	for (size_t i = 0; i < regulator->n_settings; i++) {
		const KOOP(setting) *s = &regulator->settings[i];
		if (!(value[i] >= s->low && value[i] <= s->high)) { return 0; } /* or NaN */
	}
	return 1;
}

static COLD int regulator_is_given(const KOOP(config) *c) {
	return c->regulator->decide && (c->settings || c->regulator->n_settings == 0);
}

static COLD int config_check(const KOOP(config) *c) {
	if (!regulator_is_given(c)) { return KOOP_E_NULL; }
	const int status = dictionary_check(c->dictionary);
	if (status != KOOP_OK) { return status; }
	/* an n_inputs of 0 wraps to the largest number */
	if (c->n_inputs - 1 >= KOOP_MAX_DIM - c->dictionary->n_lifted) { return KOOP_E_SIZE; }
	if (!numbers_in_range(c)) { return KOOP_E_RANGE; }
	return settings_in_range(c->regulator, (const real *)c->settings) ? KOOP_OK : KOOP_E_RANGE;
}

/* Finds the sizes, and the number of reals of storage. */
static COLD int configure_sizes(KOOP(rls) *rls, size_t *reals) {
	const KOOP(config) *c = &rls->config;
	rls->n_lifted = c->dictionary->n_lifted;
	rls->n_regressors = rls->n_lifted + c->n_inputs;
	rls->n_lifted_padded = KOOP_PAD(rls->n_lifted);
	rls->n_regressors_padded = KOOP_PAD(rls->n_regressors);
	rls->nominal_trace = c->p0 * (real)rls->n_regressors;
	rls->n_memory = 0;
	const size_t covariance = c->form->reals(rls);
	*reals = KOOP_RLS_REALS(rls->n_lifted, rls->n_regressors, covariance);
	if (c->regulator->extension) { *reals += c->regulator->extension->engine->size(rls, covariance); }
	if (!c->regulator->check) { return KOOP_OK; }
	return c->regulator->check(rls);
}

/* Checks the configuration, copies it, and finds the sizes. */
static COLD int configure(KOOP(rls) *rls, const KOOP(config) *c, size_t *reals) {
	if (!c || !c->regulator || !c->form) { return KOOP_E_NULL; }
	rls->config = *c;
	if (!c->settings) { rls->config.settings = c->regulator->defaults; }
	const int status = config_check(&rls->config);
	return status == KOOP_OK ? configure_sizes(rls, reals) : status;
}

COLD int KOOP(rls_reals)(const KOOP(config) *config, size_t *reals) {
	KOOP(rls) rls;
	size_t needed;
	const int status = configure(&rls, config, &needed);
	if (status != KOOP_OK) { return status; }
	if (!reals) { return KOOP_E_NULL; }
	*reals = needed;
	return KOOP_OK;
}

/* Returns 1 if the memory, 1 / (1 - lambda) samples, is shorter than the number of unknowns in a row of
 * Theta. */
static COLD int memory_is_short(const KOOP(rls) *rls) {
	const KOOP(config) *c = &rls->config;
	return c->regulator->forgets && (1 - c->lambda) * (real)rls->n_regressors > 1;
}

/* ---- Flipped bits in the learned model ------------------------------------------- */

/* Copies the three numbers that belong to Theta and P to an array, and back. */
#define LEARNED_NUMBERS 3
static void get_numbers(const KOOP(rls) *rls, real *numbers) {
	numbers[0] = rls->covariance_scale;
	numbers[1] = rls->theta_bound;
	numbers[2] = rls->covariance_bound;
}

static COLD void set_numbers(KOOP(rls) *rls, const real *numbers) {
	rls->covariance_scale = numbers[0];
	rls->theta_bound = numbers[1];
	rls->covariance_bound = numbers[2];
}

static koop_checksum sum_learned(const KOOP(rls) *rls) {
	koop_checksum sum = {0, 0};
	real numbers[LEARNED_NUMBERS];
	get_numbers(rls, numbers);
	checksum_add(&sum, rls->theta, WORDS(rls->kept));
	checksum_add(&sum, numbers, WORDS(LEARNED_NUMBERS));
	return sum;
}

static OUT_OF_LINE void seal_learned(KOOP(rls) *rls) {
	rls->sum = sum_learned(rls);
}

/* Call it after every change of the learned model. */
static void seal(KOOP(rls) *rls) {
	if (rls->config.checksum) { seal_learned(rls); }
}

/* Repairs the learned model; returns KOOP_E_MEMORY if that is impossible. */
static COLD int repair_learned(KOOP(rls) *rls, const koop_checksum *now) {
	const size_t words = WORDS(rls->kept), behind = WORDS(LEARNED_NUMBERS);
	real numbers[LEARNED_NUMBERS];
	get_numbers(rls, numbers);
	const int repaired = checksum_has_flipped(&rls->sum, now) ||
	                     checksum_repair(rls->theta, words, behind, &rls->sum, now) ||
	                     checksum_repair(numbers, behind, 0, &rls->sum, now);
	set_numbers(rls, numbers);
	if (repaired) { seal(rls); }
	rls->repaired += repaired ? 1 : 0;
	return repaired ? KOOP_OK : KOOP_E_MEMORY;
}

static OUT_OF_LINE int verify_learned(KOOP(rls) *rls) {
	const koop_checksum now = sum_learned(rls);
	return checksum_same(&now, &rls->sum) ? KOOP_OK : repair_learned(rls, &now);
}

static int verify(KOOP(rls) *rls) {
	return rls->config.checksum ? verify_learned(rls) : KOOP_OK;
}

COLD int KOOP(rls_check)(KOOP(rls) *rls) {
	if (!rls || !rls->theta) { return KOOP_E_NULL; }
	return rls->config.checksum ? verify(rls) : KOOP_E_RANGE;
}

/* ---- Start ---------------------------------------------------------------------- */

/* P = p0 I, and the regulator starts again. */
static INLINE void reset_covariance(KOOP(rls) *rls, real p0) {
	rls->config.form->reset(rls, p0);
	rls->positive_definite = 1;
	const KOOP(extension) *extension = rls->config.regulator->extension;
	if (extension) { extension->engine->restart(rls); }
}

COLD int KOOP(rls_init)(KOOP(rls) *rls, const KOOP(config) *config, real *storage, size_t reals) {
	KOOP(rls) fresh;
	size_t needed;
	(void)memset(&fresh, 0, sizeof fresh);
	const int status = configure(&fresh, config, &needed);
	if (status != KOOP_OK) { return status; }
	if (!rls || !storage) { return KOOP_E_NULL; }
	if (reals < needed) { return KOOP_E_STORAGE; }

	*rls = fresh;
	const size_t rows = rls->n_regressors_padded;

	for (size_t i = 0; i < needed; i++) { storage[i] = 0; }
	rls->theta = storage;
	rls->memory = rls->theta + KOOP_EVEN(rls->n_regressors) * rls->n_lifted_padded;
	rls->covariance = rls->memory + KOOP_PAD(rls->n_memory);
	rls->zeta = rls->covariance + rls->config.form->reals(rls);
	rls->kept = (size_t)(rls->zeta - rls->theta);
	if (rls->config.form->scratch) { rls->kept -= rls->config.form->scratch(rls); }
	rls->gain = rls->zeta + rows;
	rls->work = rls->gain + rows;
	rls->error = rls->work + 3 * rows;
	rls->theta_bound = 0;
	rls->covariance_scale = 1;
	reset_covariance(rls, rls->config.p0);
	rls->short_memory = memory_is_short(rls);
	rls->repaired = 0;
	seal(rls);
	return KOOP_OK;
}

/* Returns 1 if two estimators have the same layout of storage. */
static int same_kind(const KOOP(rls) *a, const KOOP(rls) *b) {
	const int sizes =
	    (a->n_lifted == b->n_lifted) & (a->n_regressors == b->n_regressors) & (a->kept == b->kept);
	const KOOP(config) *c = &a->config, *d = &b->config;
	const int forms = c->form == d->form && c->regulator == d->regulator && c->check == d->check;
	return sizes && (forms & (c->checksum == d->checksum));
}

/* Copies everything that `from`, an estimator of the same layout, has learned. */
static COLD void copy_learned(KOOP(rls) *rls, const KOOP(rls) *from) {
	copy(rls->theta, from->theta, rls->kept);
	rls->covariance_scale = from->covariance_scale;
	rls->theta_bound = from->theta_bound;
	rls->covariance_bound = from->covariance_bound;
	rls->positive_definite = from->positive_definite;
	rls->sum = from->sum;
}

COLD int KOOP(rls_reset_covariance)(KOOP(rls) *rls, real p0) {
	if (!rls || !rls->covariance) { return KOOP_E_NULL; }
	if (!is_within(p0, REAL_MIN, REAL_MAX / 2)) { return KOOP_E_RANGE; }
	reset_covariance(rls, p0);
	seal(rls);
	return KOOP_OK;
}

static void load_regressor(KOOP(rls) *rls, const real *psi, const real *u) {
	copy(rls->zeta, psi, rls->n_lifted);
	copy(rls->zeta + rls->n_lifted, u, rls->config.n_inputs);
}

GLUE int KOOP(rls_predict)(KOOP(rls) *rls, const real *psi, const real *u, real *psi_next) {
	if (!rls || !rls->theta || !psi || !u || !psi_next) { return KOOP_E_NULL; }
	if (!all_finite(psi, rls->n_lifted) || !all_finite(u, rls->config.n_inputs)) { return KOOP_E_INPUT; }
	load_regressor(rls, psi, u);
	weighted_rows(rls->error, rls->theta, rls->zeta, rls->n_regressors, rls->n_lifted_padded);
	if (!all_finite(rls->error, rls->n_lifted)) { return KOOP_E_OVERFLOW; }
	for (size_t i = 0; i < rls->n_lifted; i++) { psi_next[i] = rls->error[i]; }
	return KOOP_OK;
}

/* Writes the denominator noise + s to *denominator, and makes P zeta in rls->gain the gain K. */
static INLINE int finish_gain(KOOP(rls) *rls, const KOOP(step) *step, real s, real *denominator) {
	const size_t rows = rls->n_regressors_padded;
	if (step->inflate > 0) {
		const real square = dot(rls->zeta, rls->zeta, rows);
		for (size_t i = 0; i < rows; i += 4) {
			add_four(rls->gain + i, step->inflate * square, rls->zeta + i);
		}
		s += step->inflate * square * square;
	}
	*denominator = step->noise + s;
	if (!(MATH(fabs)(*denominator) < REAL_MAX / 4)) { return KOOP_E_OVERFLOW; }
	/* noise + s has the sign of the noise, unless P is or becomes indefinite; a product could underflow */
	if (!(*denominator / step->noise > 0) && rls->config.check != KOOP_CHECK_REPORT) {
		return KOOP_E_INDEFINITE;
	}

	const real inverse = 1 / *denominator;
	rls->gain_square = scaled_dot(rls->gain, inverse, rls->gain, rows);
	return KOOP_OK;
}

/* What the extension does once s is known. */
static int extension_tune(KOOP(rls) *rls, real s, KOOP(step) *step, int *frozen);

/* Computes the gain K and the denominator, for the step as the regulator has it in the end. */
static INLINE int compute_gain(KOOP(rls) *rls, int extended, KOOP(step) *step, int *frozen,
                               real *denominator) {
	const real s = rls->config.form->gain(rls);
	const int status = extended ? extension_tune(rls, s, step, frozen) : KOOP_OK;
	return status == KOOP_OK ? finish_gain(rls, step, s, denominator) : status;
}

/* Returns 1 if Theta + weight error K' is finite, and writes the new bound of its elements. */
static INLINE int theta_stays_finite(const KOOP(rls) *rls, const KOOP(step) *step, real innovation,
                                     real *bound) {
	const real size = innovation * MATH(sqrt)(rls->gain_square);
	const real growth = step->update_theta ? size * step->weight : 0;
	*bound = rls->theta_bound + growth;
	if (!(*bound < REAL_MAX / 2)) {
		*bound = max_abs(rls->theta, rls->n_regressors * rls->n_lifted_padded) + growth;
	}
	return *bound < REAL_MAX / 2;
}

/* Writes the innovation to rls->error, and its norm to *norm. */
static GLUE int innovate(KOOP(rls) *rls, const real *psi, const real *u, const real *psi_next, real *norm) {
	load_regressor(rls, psi, u);
	weighted_rows(rls->error, rls->theta, rls->zeta, rls->n_regressors, rls->n_lifted_padded);
	/* any NaN or Inf of the sample propagates to the norm */
	*norm = MATH(sqrt)(subtract_from(rls->error, psi_next, rls->n_lifted));
	if (is_finite(*norm)) { return KOOP_OK; }
	const int finite = all_finite(rls->zeta, rls->n_regressors) && all_finite(psi_next, rls->n_lifted);
	return finite ? KOOP_E_OVERFLOW : KOOP_E_INPUT;
}

static INLINE int changes_model(const KOOP(step) *step) {
	return step->update_theta || step->update_covariance;
}

/* Works out a step and changes P by it; *bound becomes the bound of the new Theta's elements. *frozen: 1 if P stays
 * unchanged. In line, with a constant `extended`: a program whose regulator has no extension links nothing of it. */
static INLINE int change_p(KOOP(rls) *rls, int extended, real innovation, KOOP(step) *step, int *frozen, real *bound) {
	const real lambda = rls->config.lambda;
	const KOOP(step) usual = {lambda, 1 / lambda, 0, 0, 0, 1, 1, 1};
	real denominator;
	*step = usual;
	*bound = rls->theta_bound;

	int status = rls->config.regulator->decide(rls, innovation, step);
	if (status != KOOP_OK) { return status; }
	*frozen = !step->update_covariance;
	if (!changes_model(step)) { return KOOP_OK; }

	status = compute_gain(rls, extended, step, frozen, &denominator);
	if (status != KOOP_OK) { return status; }
	if (!theta_stays_finite(rls, step, innovation, bound)) { return KOOP_E_OVERFLOW; }
	return step->update_covariance ? rls->config.form->apply(rls, step, denominator) : KOOP_OK;
}

/* Changes Theta, which cannot fail after change_p(). */
static INLINE void change_theta(KOOP(rls) *rls, int update, real weight, real bound) {
	if (update) {
		add_outer(rls->theta, weight, rls->gain, rls->error, rls->n_regressors, rls->n_lifted_padded);
	}
	rls->theta_bound = bound;
	seal(rls);
}

static GLUE int learn_plainly(KOOP(rls) *rls, real innovation, int *frozen) {
	KOOP(step) step;
	real bound;
	const int status = change_p(rls, 0, innovation, &step, frozen, &bound);
	if (status != KOOP_OK || !changes_model(&step)) { return status; }
	change_theta(rls, step.update_theta, step.weight, bound);
	return KOOP_OK;
}

/* In line: a frame less on the stack of its callers. */
static INLINE int learn(KOOP(rls) *rls, real innovation, int *frozen) {
	const KOOP(extension) *extension = rls->config.regulator->extension;
	if (extension) { return extension->engine->attend(rls, innovation, frozen); }
	return learn_plainly(rls, innovation, frozen);
}

#define WINDUP_RATIO 100 /* trace over initial trace */

/* Reports the trace and the smallest diagonal element of P. */
static void report_diagonal(KOOP(rls) *rls, KOOP(health) *health) {
	real trace = 0, smallest = REAL_MAX;
	rls->config.form->diagonal(rls, rls->work);
	for (size_t i = 0; i < rls->n_regressors; i++) {
		trace += rls->work[i];
		smallest = rls->work[i] < smallest ? rls->work[i] : smallest;
	}
	health->trace = trace;
	health->winding_up = trace > WINDUP_RATIO * rls->nominal_trace;
	health->min_diagonal = smallest;
}

/* Fills in the health, unless the caller passes null. */
static OUT_OF_LINE void report(KOOP(rls) *rls, int status, real innovation, int frozen,
                               KOOP(health) *health) {
	if (!health) { return; }
	health->innovation = innovation;
	health->frozen = frozen;
	health->finite = status != KOOP_E_INPUT && status != KOOP_E_OVERFLOW;
	health->short_memory = rls->short_memory;
	health->positive_definite = rls->positive_definite && status != KOOP_E_INDEFINITE;
	report_diagonal(rls, health);
}

GLUE int KOOP(rls_update)(KOOP(rls) *rls, const real *psi, const real *u, const real *psi_next,
                          KOOP(health) *health) {
	real innovation = 0;
	int frozen = 0;
	if (!rls || !rls->theta || !psi || !u || !psi_next) { return KOOP_E_NULL; }

	int status = verify(rls);
	if (status == KOOP_OK) { status = innovate(rls, psi, u, psi_next, &innovation); }
	if (status == KOOP_OK) { status = learn(rls, innovation, &frozen); }
	report(rls, status, innovation, frozen, health);
	return status;
}

COLD int KOOP(rls_get_theta)(const KOOP(rls) *rls, real *theta) {
	if (!rls || !rls->theta || !theta) { return KOOP_E_NULL; }
	for (size_t i = 0; i < rls->n_lifted; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++) {
			*theta++ = rls->theta[j * rls->n_lifted_padded + i];
		}
	}
	return KOOP_OK;
}

COLD int KOOP(rls_set_theta)(KOOP(rls) *rls, const real *theta) {
	if (!rls || !rls->theta || !theta) { return KOOP_E_NULL; }
	const size_t N = rls->n_lifted, d = rls->n_regressors;
	if (!all_finite(theta, N * d)) { return KOOP_E_INPUT; }
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < d; j++) { rls->theta[j * rls->n_lifted_padded + i] = theta[i * d + j]; }
	}
	rls->theta_bound = max_abs(theta, N * d);
	seal(rls);
	return KOOP_OK;
}

COLD int KOOP(rls_copy_theta)(KOOP(rls) *rls, const real *theta) {
	if (!rls || !rls->theta || !theta) { return KOOP_E_NULL; }
	const size_t row = rls->n_lifted_padded, size = rls->n_regressors * row;
	if (!all_finite(theta, size)) { return KOOP_E_INPUT; }
	for (size_t i = 0; i < size; i++) { rls->theta[i] = i % row < rls->n_lifted ? theta[i] : 0; }
	rls->theta_bound = max_abs(rls->theta, size);
	seal(rls);
	return KOOP_OK;
}

COLD int KOOP(rls_get_covariance)(const KOOP(rls) *rls, real *covariance) {
	if (!rls || !rls->covariance || !covariance) { return KOOP_E_NULL; }
	int finite = 1;
	for (size_t i = 0; i < rls->n_regressors; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++) {
			*covariance = rls->config.form->element(rls, i, j);
			finite &= is_finite(*covariance++);
		}
	}
	return finite ? KOOP_OK : KOOP_E_OVERFLOW;
}
