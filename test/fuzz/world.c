#include "world.h"

#include <string.h>

/* ---- Values ---------------------------------------------------------------------- */

static real special(size_t which) {
	static const double values[] = {0,   1,        0.5,  1e-3, 1e3, 1e-6,     1e6,     10,
	                                NAN, INFINITY, 0.95, 1e-9, 1e9, REAL_MAX, REAL_MIN};
	const size_t count = sizeof values / sizeof *values;
	const real scales[] = {
	    1, -1, REAL_EPSILON, (real)sqrt((double)REAL_MAX), (real)sqrt((double)REAL_MIN), (real)0.499};
	return (real)values[which % count] * scales[which / count % (sizeof scales / sizeof *scales)];
}

/* xorshift32, -1 to 1 */
static real noise(uint32_t *state) {
	*state ^= *state << 13;
	*state ^= *state >> 17;
	*state ^= *state << 5;
	return (real)((double)*state / 2147483648.0 - 1);
}

enum { ZEROS, BITS, SMALL, SPECIALS, NOISE, SCALED_NOISE, NOISE_AND_BITS, NOISE_AND_SPECIAL, KINDS };

void take_reals(input *in, real *x, size_t count) {
	const size_t kind = take_below(in, KINDS);
	memset(x, 0, count * sizeof *x);
	if (count == 0 || kind == ZEROS) { return; }
	if (kind == BITS) {
		take(in, x, count * sizeof *x);
		return;
	}
	if (kind == SMALL || kind == SPECIALS) {
		for (size_t i = 0; i < count; i++) {
			const uint8_t byte = take_byte(in);
			x[i] = kind == SMALL ? (real)(((double)byte - 128) / 32) : special(byte);
		}
		return;
	}
	uint32_t state = take_byte(in) * 0x9E3779B9u + 1;
	const int exponent = kind == SCALED_NOISE ? (int8_t)take_byte(in) : 0;
	for (size_t i = 0; i < count; i++) { x[i] = (real)ldexp((double)noise(&state), exponent); }
	if (kind == NOISE_AND_BITS) { take(in, &x[take_byte(in) % count], sizeof *x); }
	if (kind == NOISE_AND_SPECIAL) {
		const real value = special(take_byte(in));
		x[take_byte(in) % count] = value;
	}
}

real take_real(input *in) {
	real x;
	take_reals(in, &x, 1);
	return x;
}

real *new_reals(input *in, size_t count) {
	real *x = allocate(count * sizeof *x);
	take_reals(in, x, count);
	return x;
}

size_t take_size(input *in) {
	static const size_t ends[] = {253, 254, 255, 256, 1000, 1001, (size_t)-1, (size_t)-1 / 2 + 1, (size_t)-3};
	const size_t byte = take_byte(in);
	size_t any;
	if (byte < 240) { return byte % 13; }
	if (byte < 249) { return ends[byte - 240]; }
	take(in, &any, sizeof any);
	return any;
}

/* ---- What calls have in common ------------------------------------------------------- */

static int is_null(const world *w, int which) {
	return w->nulls >> which & 1;
}

/* The pointer, or null where the call's bits say so. */
#define GIVEN(which, pointer) (is_null(w, which) ? NULL : (pointer))

static int all_finite(const real *x, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (!isfinite(x[i])) { return 0; }
	}
	return 1;
}

static void expect_known(int status) {
	EXPECT(status <= KOOP_OK && status >= KOOP_E_ARITHMETIC, "status %d", status);
}

/* A status, and KOOP_E_NULL where one of these pointers is null. */
static void expect_status(const world *w, int status, int pointers) {
	expect_known(status);
	const int required = (1 << pointers) - 1;
	EXPECT(!(w->nulls & required) || status != KOOP_OK, "accepted null pointers %d", w->nulls);
}

/* ---- What was learned ------------------------------------------------------------------ */

static size_t theta_reals(const KOOP(rls) *rls) {
	return rls->n_regressors * rls->n_lifted_padded;
}

/* P's part of the storage, without the scratch of the check behind it. */
static size_t covariance_reals(const KOOP(rls) *rls) {
	const int scratch = rls->config.form == &KOOP(form_plain) &&rls->config.check != KOOP_CHECK_DIAGONAL;
	return rls->config.form->reals(rls) - (scratch ? KOOP_TRIANGLE(rls->n_regressors) : 0);
}

static const real *copy_of(const real *x, size_t count) {
	real *copy = allocate(count * sizeof *x);
	memcpy(copy, x, count * sizeof *x);
	return copy;
}

learned learned_take(const KOOP(rls) *rls) {
	learned l = {*rls, NULL, NULL};
	if (!rls->theta) { return l; }
	l.theta = copy_of(rls->theta, theta_reals(rls));
	l.covariance = copy_of(rls->covariance, covariance_reals(rls));
	return l;
}

static int same_bits(const real *a, const real *b, size_t count) {
	return memcmp(a, b, count * sizeof *a) == 0;
}

void learned_expect(const learned *before, const KOOP(rls) *rls, const char *after) {
	const KOOP(rls) *old = &before->rls;
	EXPECT(rls->theta == old->theta && rls->covariance == old->covariance, "%s", after);
	EXPECT(rls->n_lifted == old->n_lifted && rls->n_regressors == old->n_regressors, "%s", after);
	EXPECT(memcmp(&rls->config, &old->config, sizeof rls->config) == 0, "%s: settings", after);
	EXPECT(rls->positive_definite == old->positive_definite, "%s", after);
	if (!rls->theta) { return; }
	EXPECT(same_bits(rls->theta, before->theta, theta_reals(rls)), "%s: Theta", after);
	EXPECT(same_bits(rls->covariance, before->covariance, covariance_reals(rls)), "%s: P", after);
	EXPECT(same_bits(&rls->theta_bound, &old->theta_bound, 1), "%s", after);
	EXPECT(same_bits(&rls->covariance_bound, &old->covariance_bound, 1), "%s", after);
	if (rls->config.form == &KOOP(form_plain)) {
		EXPECT(same_bits(&rls->covariance_scale, &old->covariance_scale, 1), "%s: scale of P", after);
	}
}

void learned_check(const KOOP(rls) *rls) {
	if (!rls->theta) { return; }
	const size_t N = rls->n_lifted, d = rls->n_regressors;
	real *theta = allocate(N * d * sizeof *theta), *P = allocate(d * d * sizeof *P);
	EXPECT(KOOP(rls_get_theta)(rls, theta) == KOOP_OK, "Theta cannot be read");
	EXPECT(all_finite(theta, N * d), "Theta is not finite");
	/* the bound's own products may underflow, its test for overflow has room for that */
	const double bound = 2 * (double)rls->theta_bound + 1;
	for (size_t i = 0; i < N * d; i++) {
		EXPECT(fabs((double)theta[i]) <= bound, "%g beyond %g", (double)theta[i], bound);
	}

	const int status = KOOP(rls_get_covariance)(rls, P), is_root = rls->config.form == &KOOP(form_sqrt);
	EXPECT(status == KOOP_OK || (status == KOOP_E_OVERFLOW && is_root), "status %d", status);
	EXPECT((status == KOOP_OK) == all_finite(P, d * d), "status %d", status);
	for (size_t i = 0; i < d; i++) {
		const double element = (double)P[i * d + i];
		/* a square may underflow; P itself is as definite as its root */
		if (is_root) {
			EXPECT(element >= 0 && rls->config.form->get(rls, 0, i, i) > 0, "P[%zu] %g", i, element);
		}
		if (!is_root && rls->config.check != KOOP_CHECK_REPORT) {
			EXPECT(element > 0, "P[%zu] %g", i, element);
		}
		for (size_t j = 0; j < i; j++) {
			EXPECT(same_bits(P + i * d + j, P + j * d + i, 1), "P[%zu][%zu]", i, j);
		}
	}
}

/* ---- Dictionary --------------------------------------------------------------------------- */

/* Writes what the bytes say, finite or not. */
static void lift_bytes(const KOOP(dictionary) *self, const real *x, real *psi) {
	input in = *(const input *)self->context;
	take_reals(&in, psi, self->n_lifted);
	psi[0] += 0 * x[self->n_states - 1]; /* reads the last state */
}

static const KOOP(dictionary) *take_dictionary(world *w) {
	static const KOOP(dictionary) *const ready[] = {&KOOP(poly_ddr), &KOOP(rbf_ddr), &KOOP(poly_fwmav),
	                                                &KOOP(rbf_fwmav)};
	const size_t which = take_below(&w->in, 16);
	/* what is large costs time, and is no other code: in a long sequence only the smallest */
	if (which < 4 && (w->arbitrary || which == 0)) { return ready[which]; }
	if (w->arbitrary && which == 15) { return NULL; }
	KOOP(dictionary) *d = allocate(sizeof *d);
	d->name = w->arbitrary && which == 14 ? NULL : which == 13 ? "" : "bytes";
	d->lift = w->arbitrary && which == 12 ? NULL : lift_bytes;
	d->context = &w->in;
	d->n_lifted = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 12);
	d->n_states = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, d->n_lifted);
	return d;
}

static void call_lift(world *w) {
	const KOOP(dictionary) *d = take_dictionary(w);
	const int fits = d && d->n_states <= KOOP_MAX_DIM && d->n_lifted <= KOOP_MAX_DIM;
	const real *x = new_reals(&w->in, fits ? d->n_states : 0);
	real *psi = new_reals(&w->in, fits ? d->n_lifted : 0);
	const int status = KOOP(lift)(d, GIVEN(0, x), GIVEN(1, psi));
	expect_status(w, status, 2);
	if (status == KOOP_OK) { EXPECT(all_finite(psi, d->n_lifted), "psi is not finite"); }
}

/* ---- Estimator -------------------------------------------------------------------------------- */

static int undecided(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	(void)step;
	return KOOP_E_RANGE;
}

static const KOOP(regulator) *take_regulator(world *w) {
#define ENTER(name) &KOOP(reg_##name),
	static const KOOP(regulator) *const ready[] = {KOOP_REGULATORS(ENTER)};
	static const KOOP(regulator) odd[] = {{.name = "undecided", .decide = undecided, .forgets = 1},
	                                      {.name = "nothing", .forgets = 1}};
	enum { READY = sizeof ready / sizeof *ready };
	const size_t which = take_below(&w->in, w->arbitrary ? READY + 3 : READY);
	return which < READY ? ready[which] : which < READY + 2 ? &odd[which - READY] : NULL;
}

static real take_from(world *w, const double *values, size_t count) {
	const size_t which = take_byte(&w->in);
	return which < 200 && !w->arbitrary ? (real)values[which % count] : take_real(&w->in);
}

#define TAKE_FROM(...)                                                                                       \
	take_from(w, (const double[]){__VA_ARGS__}, sizeof((const double[]){__VA_ARGS__}) / sizeof(double))

/* The default, values near it and both ends; mostly what is accepted by itself. */
static real take_setting(world *w, const KOOP(setting) *limits, double usual) {
	const double low = (double)limits->low, high = (double)limits->high;
	const real value = TAKE_FROM(usual, usual, usual, usual / 10, usual * 10, low, high, 1, 1e6, 1e-6);
	const int any = w->arbitrary && take_below(&w->in, 4) == 3;
	return any ? value : (real)fmin(fmax((double)value, low), high);
}

/* Settings of the regulator, which live until the next are taken after this estimator; or its defaults. */
static const void *take_settings(world *w, const KOOP(regulator) *regulator) {
	const size_t count = regulator ? regulator->n_settings : 0;
	if (count == 0 || take_below(&w->in, 4) == 0) { return NULL; }
	const real *usual = (const real *)regulator->defaults;
	real *settings = allocate(count * sizeof *settings);
	for (size_t i = 0; i < count; i++) {
		settings[i] = take_setting(w, &regulator->settings[i], (double)usual[i]);
	}
	return settings;
}

static KOOP(config) take_config(world *w) {
	KOOP(config) c = {0};
	c.dictionary = take_dictionary(w);
	c.n_inputs = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 3);
	c.regulator = take_regulator(w);
	const uint8_t kind = take_byte(&w->in);
	const unsigned form = kind % (w->arbitrary ? 3u : 2u);
	c.checksum = kind >= 128;
	c.form = form == 0 ? &KOOP(form_plain) : form == 1 ? &KOOP(form_sqrt) : NULL;
	c.lambda = TAKE_FROM(0.98, 1, 0.95, 0.5, 1e-3, (double)REAL_MIN);
	c.p0 = TAKE_FROM(1e3, 1, 1e6, 1e-6, (double)REAL_MIN, (double)REAL_MAX / 9000);
	c.settings = take_settings(w, c.regulator);
	c.check = (int)take_below(&w->in, w->arbitrary ? 4 : 3);
	if (c.check == 3) { take(&w->in, &c.check, sizeof c.check); }
	return c;
}

static void call_init(world *w) {
	const learned before = learned_take(&w->rls);
	const KOOP(config) config = take_config(w);
	size_t reals = 0;
	const int sized = KOOP(rls_reals)(GIVEN(0, &config), GIVEN(1, &reals));
	expect_status(w, sized, 2);
	const size_t lacking = w->arbitrary && take_below(&w->in, 4) == 3 ? 1 : 0;
	real *storage = new_reals(&w->in, reals > lacking ? reals - lacking : 0);
	const int status = KOOP(rls_init)(GIVEN(2, &w->rls), GIVEN(0, &config), GIVEN(3, storage),
	                                  reals > lacking ? reals - lacking : 0);
	expect_known(status);
	EXPECT(status != KOOP_OK || !(w->nulls & 13 || lacking), "nulls %d, lacking %zu", w->nulls, lacking);
	if (sized == KOOP_OK && !(w->nulls & 13)) {
		EXPECT(status == (lacking ? KOOP_E_STORAGE : KOOP_OK), "status %d, which rls_reals() did not see",
		       status);
	}
	if (status != KOOP_OK) { learned_expect(&before, &w->rls, "refused rls_init()"); }
}

static int same_health(const KOOP(health) *health, const KOOP(health) *other) {
	return memcmp(health, other, sizeof *health) == 0;
}

static void check_health(const KOOP(rls) *rls, const KOOP(health) *h, int status) {
	const int is_root = rls->config.form == &KOOP(form_sqrt);
	EXPECT(h->finite == (status != KOOP_E_INPUT && status != KOOP_E_OVERFLOW), "status %d, finite %d", status,
	       h->finite);
	EXPECT(!isnan(h->trace), "trace %g", (double)h->trace);
	EXPECT(isfinite(h->min_diagonal), "least element %g", (double)h->min_diagonal);
	EXPECT(h->frozen == 0 || h->frozen == 1, "gated %d", h->frozen);
	if (status == KOOP_E_INDEFINITE) { EXPECT(!h->positive_definite, "status %d", status); }
	if (status != KOOP_OK) { return; }
	EXPECT(isfinite(h->innovation) && h->innovation >= 0, "innovation %g", (double)h->innovation);
	if (is_root || rls->config.check != KOOP_CHECK_REPORT) { EXPECT(h->positive_definite, "not said"); }
}

static void call_update(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted, m = rls->config.n_inputs;
	const real *psi = new_reals(&w->in, N), *u = new_reals(&w->in, m), *psi_next = new_reals(&w->in, N);
	const learned before = learned_take(rls);
	KOOP(health) health, untouched;
	memset(&health, 0xA5, sizeof health);
	untouched = health;
	const int status =
	    KOOP(rls_update)(GIVEN(0, rls), GIVEN(1, psi), GIVEN(2, u), GIVEN(3, psi_next), GIVEN(4, &health));
	expect_status(w, status, 4);
	if (status != KOOP_OK) { learned_expect(&before, rls, "refused rls_update()"); }
	if (status == KOOP_E_NULL || is_null(w, 4)) {
		EXPECT(same_health(&health, &untouched), "status %d", status);
	} else {
		check_health(rls, &health, status);
	}
}

static void call_predict(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted;
	real *psi = new_reals(&w->in, N), *u = new_reals(&w->in, rls->config.n_inputs);
	real *psi_next = take_below(&w->in, 2) ? psi : new_reals(&w->in, N);
	const real *untouched = copy_of(psi_next, N);
	const learned before = learned_take(rls);
	const int status = KOOP(rls_predict)(GIVEN(0, rls), GIVEN(1, psi), GIVEN(2, u), GIVEN(3, psi_next));
	expect_status(w, status, 4);
	learned_expect(&before, rls, "rls_predict()");
	if (status == KOOP_OK) {
		EXPECT(all_finite(psi_next, N), "not finite");
	} else {
		EXPECT(same_bits(psi_next, untouched, N), "status %d", status);
	}
}

/* Between two predictions a sample is refused: they are the same. */
static void call_refused(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted, m = rls->config.n_inputs;
	real *psi = new_reals(&w->in, N), *u = new_reals(&w->in, m), *bad = new_reals(&w->in, N);
	real *first = new_reals(&w->in, N), *second = new_reals(&w->in, N);
	if (!rls->theta || KOOP(rls_predict)(rls, psi, u, first) != KOOP_OK) { return; }
	bad[0] = (real)NAN;
	const int status = KOOP(rls_update)(rls, psi, u, bad, NULL);
	EXPECT(status == KOOP_E_INPUT, "status %d", status);
	EXPECT(KOOP(rls_predict)(rls, psi, u, second) == KOOP_OK, "refused the second time");
	EXPECT(same_bits(first, second, N), "another prediction");
}

static void call_reset_covariance(world *w) {
	const learned before = learned_take(&w->rls);
	const int status = KOOP(rls_reset_covariance)(GIVEN(0, &w->rls), take_real(&w->in));
	expect_status(w, status, 1);
	if (status != KOOP_OK) { learned_expect(&before, &w->rls, "refused rls_reset_covariance()"); }
}

static void call_set_theta(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t count = rls->n_lifted * rls->n_regressors;
	const real *theta = new_reals(&w->in, count);
	real *again = new_reals(&w->in, count);
	const learned before = learned_take(rls);
	const int status = KOOP(rls_set_theta)(GIVEN(0, rls), GIVEN(1, theta));
	expect_status(w, status, 2);
	if (status != KOOP_OK) {
		learned_expect(&before, rls, "refused rls_set_theta()");
		return;
	}
	EXPECT(KOOP(rls_get_theta)(rls, again) == KOOP_OK && same_bits(theta, again, count), "other bits");
}

static void call_copy_theta(world *w) {
	const real *theta = new_reals(&w->in, theta_reals(&w->rls));
	const learned before = learned_take(&w->rls);
	const int status = KOOP(rls_copy_theta)(GIVEN(0, &w->rls), GIVEN(1, theta));
	expect_status(w, status, 2);
	if (status != KOOP_OK) { learned_expect(&before, &w->rls, "refused rls_copy_theta()"); }
}

static void call_get(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted, d = rls->n_regressors;
	expect_status(w, KOOP(rls_get_theta)(GIVEN(0, rls), GIVEN(1, new_reals(&w->in, N * d))), 2);
	expect_status(w, KOOP(rls_get_covariance)(GIVEN(0, rls), GIVEN(1, new_reals(&w->in, d * d))), 2);
}

/* ---- Stored model -------------------------------------------------------------------------------- */

static void call_model(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t exact = KOOP_MODEL_HEADER_BYTES + sizeof(real) * rls->n_lifted * rls->n_regressors;
	const size_t size = w->arbitrary && take_below(&w->in, 4) == 3 ? take_byte(&w->in) : exact;
	unsigned char *bytes = allocate(size);
	const learned before = learned_take(rls);
	const int saved = KOOP(model_save)(GIVEN(0, rls), GIVEN(1, bytes), size);
	expect_status(w, saved, 2);
	if (saved == KOOP_OK && size == exact) {
		EXPECT(KOOP(model_load)(rls, bytes, size) == KOOP_OK, "its own model is refused");
		EXPECT(same_bits(rls->theta, before.theta, theta_reals(rls)), "Theta came back with other bits");
		const unsigned char bit = (unsigned char)(1u << take_below(&w->in, 8));
		bytes[take_byte(&w->in) % size] ^= bit;
	}
	const learned now = learned_take(rls);
	const int loaded = KOOP(model_load)(GIVEN(0, rls), GIVEN(1, bytes), size);
	expect_status(w, loaded, 2);
	EXPECT(loaded != KOOP_OK, "a damaged model is accepted");
	learned_expect(&now, rls, "refused model_load()");
}

/* With P: what comes back is the same, bit for bit. */
static void call_model_covariance(world *w) {
	KOOP(rls) *rls = &w->rls;
	if (!rls->theta) { return; }
	const size_t triangles = rls->config.form->triangles(rls);
	const size_t covariance = triangles * KOOP_MODEL_TRIANGLE(rls->n_regressors) + rls->n_memory;
	const size_t size = KOOP_MODEL_HEADER_BYTES + sizeof(real) * (rls->n_lifted * rls->n_regressors + covariance);
	unsigned char *bytes = allocate(size), *again = allocate(size);
	EXPECT(KOOP(model_save_covariance)(rls, bytes, size - 1) == KOOP_E_STORAGE, "a byte less is enough");
	EXPECT(KOOP(model_save_covariance)(rls, bytes, size) == KOOP_OK, "not saved");
	const learned before = learned_take(rls);
	const int status = KOOP(model_load)(rls, bytes, size);
	if (status != KOOP_OK) { /* P has left the range: as a product of its scale, say */
		EXPECT(status == KOOP_E_MODEL, "status %d", status);
		learned_expect(&before, rls, "refused model_load()");
		return;
	}
	EXPECT(KOOP(model_save_covariance)(rls, again, size) == KOOP_OK, "not saved again");
	EXPECT(memcmp(bytes, again, size) == 0, "other bytes");
}

/* A bit flips: it is repaired. */
static void call_flip(world *w) {
	KOOP(rls) *rls = &w->rls;
	if (!rls->theta || !rls->config.checksum) { return; }
	const size_t bytes = rls->kept * sizeof(real);
	const learned before = learned_take(rls);
	const size_t at = (take_byte(&w->in) * 256u + take_byte(&w->in)) % bytes;
	((unsigned char *)rls->theta)[at] ^= (unsigned char)(1u << take_below(&w->in, 8));
	EXPECT(KOOP(rls_check)(rls) == KOOP_OK, "one bit");
	rls->repaired--;
	learned_expect(&before, rls, "a flipped bit");
}

/* ---- Threshold and low-pass ------------------------------------------------------------------------ */

static void call_threshold(world *w) {
	const size_t count = take_below(&w->in, 20);
	real *scores = new_reals(&w->in, count), delta = (real)NAN;
	const int status = KOOP(threshold)(GIVEN(0, scores), count, take_real(&w->in), GIVEN(1, &delta));
	expect_status(w, status, 2);
	if (status != KOOP_OK) {
		EXPECT(isnan(delta), "written by a call that refused");
		return;
	}
	for (size_t i = 1; i < count; i++) { EXPECT(scores[i - 1] <= scores[i], "not sorted"); }
	EXPECT(isfinite(delta), "%g", (double)delta);
}

static void call_lowpass_init(world *w) {
	const size_t n = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 4);
	const real rate = TAKE_FROM(200, 1, 1e-30, 1e30),
	           cutoff = w->arbitrary ? take_real(&w->in) : rate * TAKE_FROM(0.1, 0.45, 1e-3);
	const size_t reals = n <= KOOP_MAX_DIM ? KOOP_LOWPASS_REALS(n) : 0;
	const size_t lacking = w->arbitrary && reals > 0 ? take_below(&w->in, 4) / 3 : 0;
	real *storage = new_reals(&w->in, reals - lacking);
	const KOOP(lowpass) before = w->lowpass;
	const int status =
	    KOOP(lowpass_init)(GIVEN(0, &w->lowpass), n, cutoff, rate, GIVEN(1, storage), reals - lacking);
	expect_status(w, status, 2);
	EXPECT(status != KOOP_OK || !lacking, "%zu reals are enough", reals - lacking);
	if (status != KOOP_OK) { EXPECT(memcmp(&before, &w->lowpass, sizeof before) == 0, "status %d", status); }
	if (status == KOOP_OK) { EXPECT(w->lowpass.b > 0 && w->lowpass.b < 1, "b = %g", (double)w->lowpass.b); }
}

static void call_lowpass_step(world *w) {
	KOOP(lowpass) *f = &w->lowpass;
	if (take_below(&w->in, 8) == 7) { expect_status(w, KOOP(lowpass_reset)(GIVEN(0, f)), 1); }
	real *x = new_reals(&w->in, f->n), *y = take_below(&w->in, 2) ? x : new_reals(&w->in, f->n);
	const real *state = f->state ? copy_of(f->state, 2 * f->n) : NULL;
	const int settled = f->settled;
	const int status = KOOP(lowpass_step)(GIVEN(0, f), GIVEN(1, x), GIVEN(2, y));
	expect_status(w, status, 3);
	if (status == KOOP_OK) {
		EXPECT(all_finite(y, f->n) && all_finite(f->state, 2 * f->n), "not finite");
	} else if (state) {
		EXPECT(f->settled == settled && same_bits(f->state, state, 2 * f->n), "status %d", status);
	}
}

/* ---- Controller ---------------------------------------------------------------------------------------- */

/* Symmetric and diagonally dominant, or any values. */
static const real *take_weight(world *w, size_t n) {
	const size_t count = n <= KOOP_MAX_DIM ? n : 0;
	real *M = new_reals(&w->in, count * count);
	if (take_below(&w->in, 8) == 7) { return M; }
	for (size_t i = 0; i < count; i++) {
		real sum = 0;
		for (size_t j = 0; j < count; j++) {
			if (j < i) { M[i * count + j] = M[j * count + i]; }
			sum += (real)fabs((double)M[i * count + j]);
		}
		M[i * count + i] = sum;
	}
	return M;
}

static const real *take_bounds(world *w, size_t m, KOOP(mpc_config) *c) {
	real *low = new_reals(&w->in, m), *safe = new_reals(&w->in, m), *high = new_reals(&w->in, m);
	for (size_t j = 0; j < m && take_below(&w->in, 8) != 7; j++) {
		if (low[j] > 0) { low[j] = -low[j]; }
		if (high[j] < 0) { high[j] = -high[j]; }
		if (!(safe[j] >= low[j] && safe[j] <= high[j])) { safe[j] = 0; }
	}
	c->u_min = low;
	c->u_max = high;
	return safe;
}

static KOOP(mpc_config) take_mpc_config(world *w) {
	KOOP(mpc_config) c = {0};
	const size_t N = w->rls.n_lifted > 0 ? w->rls.n_lifted : 3;
	const int odd = w->arbitrary && take_below(&w->in, 4) == 3;
	c.n_lifted = odd ? take_size(&w->in) : N;
	c.n_states = odd ? take_size(&w->in) : 1 + take_below(&w->in, N < 4 ? N : 4);
	c.n_inputs = odd               ? take_size(&w->in)
	             : w->rls.n_lifted ? w->rls.config.n_inputs
	                               : 1 + take_below(&w->in, 3);
	c.horizon = odd ? take_size(&w->in) : 1 + take_below(&w->in, 12);
	const size_t m = c.n_inputs <= KOOP_MAX_DIM ? c.n_inputs : 0;
	c.Q = GIVEN(0, take_weight(w, c.n_states));
	c.R = GIVEN(1, take_weight(w, m));
	c.S = take_below(&w->in, 2) ? take_weight(w, m) : NULL;
	c.u_safe = take_bounds(w, m, &c);
	if (is_null(w, 2)) { c.u_safe = NULL; }
	if (is_null(w, 3)) { c.u_min = NULL; }
	if (is_null(w, 4)) { c.u_max = NULL; }
	c.tolerance = w->arbitrary ? take_real(&w->in) : 0;
	c.method = (int)take_below(&w->in, w->arbitrary ? 3 : 2);
	if (c.method == 2) { take(&w->in, &c.method, sizeof c.method); }
	return c;
}

/* 0 where the sizes are out of range, or larger than is worth the time. */
static size_t mpc_reals(const KOOP(mpc_config) *c) {
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs, H = c->horizon;
	if (N > KOOP_MAX_DIM || n > KOOP_MAX_DIM || m > KOOP_MAX_DIM || H > KOOP_MPC_MAX_HORIZON || H * m > 100) {
		return 0;
	}
	const size_t rate = c->S ? KOOP_MPC_REALS_RATE(m, H) : 0;
	return rate + (c->method == KOOP_MPC_NEWTON ? KOOP_MPC_REALS_NEWTON(N, n, m, H)
	                                            : KOOP_MPC_REALS_GRADIENT(N, n, m, H));
}

static void call_mpc_init(world *w) {
	const KOOP(mpc_config) config = take_mpc_config(w);
	const size_t needed = mpc_reals(&config);
	const size_t lacking = w->arbitrary && needed > 0 ? take_below(&w->in, 4) / 3 : 0;
	real *storage = new_reals(&w->in, needed - lacking);
	const KOOP(mpc) before = w->mpc;
	const int status = KOOP(mpc_init)(GIVEN(5, &w->mpc), is_null(w, 6) ? NULL : &config, GIVEN(7, storage),
	                                  needed - lacking);
	expect_status(w, status, 8);
	EXPECT(status != KOOP_OK || !(lacking || needed == 0), "%zu reals are enough", needed - lacking);
	if (status == KOOP_OK) { memset(&w->supervisor, 0, sizeof w->supervisor); } /* its Q may be another now */
	if (status != KOOP_OK && w->mpc.plan) {
		EXPECT(memcmp(&before, &w->mpc, sizeof before) == 0, "status %d changes the controller", status);
	}
}

/* Whether limits leave a number to every input, and the safe one is a number. */
static int limits_are_sound(const KOOP(mpc_config) *c) {
	int sound = all_finite(c->u_safe, c->n_inputs);
	for (size_t j = 0; j < c->n_inputs; j++) {
		sound &= c->u_min[j] <= c->u_max[j] && c->u_min[j] <= REAL_MAX && c->u_max[j] >= -REAL_MAX;
	}
	return sound;
}

/* What every plan promises, whatever it was made of: it is inside the limits of now, or of the last solve where
 * there are none now. */
static void check_input(const KOOP(mpc) *mpc, int status, const real *u, const KOOP(mpc_result) *result) {
	const KOOP(mpc_config) *c = &mpc->config;
	const int sound = limits_are_sound(c);
	const real *low = sound ? c->u_min : mpc->u_min, *high = sound ? c->u_max : mpc->u_max;
	EXPECT(sound || status == KOOP_E_INPUT || status == KOOP_E_RANGE, "status %d", status);
	for (size_t j = 0; j < c->n_inputs; j++) {
		EXPECT(u[j] >= low[j] && u[j] <= high[j], "u[%zu] = %g, status %d", j, (double)u[j], status);
		if (status != KOOP_OK) { EXPECT(same_bits(u + j, mpc->u_safe + j, 1), "status %d", status); }
	}
	real *plan = allocate(c->horizon * c->n_inputs * sizeof *plan);
	EXPECT(KOOP(mpc_plan)(mpc, plan) == KOOP_OK, "no plan");
	for (size_t q = 0; q < c->horizon * c->n_inputs; q++) {
		const size_t j = q % c->n_inputs;
		EXPECT(plan[q] >= low[j] && plan[q] <= high[j], "plan[%zu] = %g", q, (double)plan[q]);
		if (q < c->n_inputs && sound) {
			EXPECT(plan[q] == u[q], "%g is not the plan's %g", (double)u[q], (double)plan[q]);
		}
	}
	if (!result || status != KOOP_OK) { return; }
	const size_t most = c->method == KOOP_MPC_NEWTON ? KOOP_MPC_MAX_NEWTON : KOOP_MPC_MAX_GRADIENT;
	EXPECT(isfinite(result->residual) && result->residual >= 0, "residual %g", (double)result->residual);
	EXPECT(result->iterations <= most, "%zu iterations", result->iterations);
}

static void call_mpc_solve(world *w) {
	KOOP(mpc) *mpc = &w->mpc;
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t N = c->n_lifted, m = c->n_inputs;
	const int own =
	    w->rls.theta && w->rls.n_lifted == N && w->rls.config.n_inputs == m && take_below(&w->in, 2);
	const real *theta = own ? w->rls.theta : new_reals(&w->in, (N + m) * KOOP_PAD(N));
	const real *psi = new_reals(&w->in, N), *reference = new_reals(&w->in, c->horizon * c->n_states);
	const real *before = c->S || take_below(&w->in, 2) ? new_reals(&w->in, m) : NULL;
	real *u = new_reals(&w->in, m);
	const real *untouched = copy_of(u, m);
	KOOP(mpc_result) result;
	const int status = KOOP(mpc_solve)(GIVEN(0, mpc), GIVEN(1, theta), GIVEN(2, psi), GIVEN(3, reference),
	                                   GIVEN(5, before), GIVEN(4, u), GIVEN(6, &result));
	expect_status(w, status, 5);
	if (status == KOOP_E_NULL) {
		EXPECT(same_bits(u, untouched, m), "status %d", status);
	} else {
		check_input(mpc, status, u, GIVEN(6, &result));
	}
}

/* The limits move: to any values, or to sound ones. */
static void call_move_limits(world *w) {
	KOOP(mpc_config) *c = &w->mpc.config;
	if (!w->mpc.plan) { return; }
	c->u_safe = take_bounds(w, c->n_inputs, c);
}

static void call_mpc_read(world *w) {
	KOOP(mpc) *mpc = &w->mpc;
	const size_t n = mpc->config.n_states, m = mpc->config.n_inputs, H = mpc->config.horizon;
	real *plan = new_reals(&w->in, H * m), *G = new_reals(&w->in, n * m);
	if (take_below(&w->in, 4) == 3) { expect_status(w, KOOP(mpc_reset)(GIVEN(0, mpc)), 1); }
	expect_status(w, KOOP(mpc_plan)(GIVEN(0, mpc), GIVEN(1, plan)), 2);
	const size_t step = take_size(&w->in);
	const int status = KOOP(mpc_sensitivity)(GIVEN(0, mpc), step, GIVEN(1, G));
	expect_status(w, status, 2);
	if (status == KOOP_OK) { EXPECT(step < H, "step %zu of %zu", step, H); }
	if (status == KOOP_OK && mpc->planned) { EXPECT(all_finite(G, n * m), "not finite"); }
}

/* ---- Supervisor
 * ------------------------------------------------------------------------------------------------
 */

static KOOP(supervisor_config) take_supervisor_config(world *w) {
	KOOP(supervisor_config) c = {0};
	const uint8_t kind = take_byte(&w->in);
	c.gate = kind >= 128 && w->gate.variance ? &w->gate : NULL;
	if (kind % 2 == 0) { return c; }
	real *const values[] = {&c.min_cosine, &c.min_gain,    &c.max_gain,
	                        &c.max_error_ratio,   &c.max_residual, &c.max_tracking_ratio};
	for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
		*values[i] = w->arbitrary ? take_real(&w->in) : (real)(take_byte(&w->in) / 16.0);
	}
	c.patience = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 4);
	c.renewal = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 40);
	return c;
}

static void call_supervisor_init(world *w) {
	const KOOP(mpc_config) *c = &w->mpc.config;
	const size_t N = c->n_lifted, m = c->n_inputs;
	const KOOP(supervisor_config) config = take_supervisor_config(w);
	const int own =
	    w->rls.theta && w->rls.n_lifted == N && w->rls.config.n_inputs == m && take_below(&w->in, 2);
	const real *offline = own ? w->rls.theta : new_reals(&w->in, (N + m) * KOOP_PAD(N));
	const size_t needed = KOOP_SUPERVISOR_REALS(N, c->n_states, m, c->horizon);
	const size_t lacking = w->arbitrary && needed > 0 ? take_below(&w->in, 4) / 3 : 0;
	real *storage = new_reals(&w->in, needed - lacking);
	const int status = KOOP(supervisor_init)(GIVEN(0, &w->supervisor), GIVEN(4, &config), GIVEN(1, &w->mpc),
	                                         GIVEN(2, offline), GIVEN(3, storage), needed - lacking);
	expect_status(w, status, 4);
	EXPECT(status != KOOP_OK || !lacking, "%zu reals are enough", needed - lacking);
}

static void call_supervisor_update(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted, m = rls->config.n_inputs, resets = w->supervisor.resets;
	const KOOP(gate) *gate = w->supervisor.config.gate;
	const size_t restored = gate ? gate->restored : 0;
	const real *psi = new_reals(&w->in, N), *u = new_reals(&w->in, m), *psi_next = new_reals(&w->in, N);
	const learned before = learned_take(rls);
	KOOP(health) health;
	const int status = KOOP(supervisor_update)(GIVEN(0, &w->supervisor), GIVEN(1, rls), GIVEN(2, psi),
	                                           GIVEN(3, u), GIVEN(4, psi_next), GIVEN(5, &health));
	expect_status(w, status, 5);
	const int began_again = w->supervisor.resets != resets;
	EXPECT(!began_again || w->supervisor.resets == resets + 1, "%zu resets after %zu", w->supervisor.resets,
	       resets);
	const int came_back = gate && gate->restored != restored;
	if (status != KOOP_OK && !began_again && !came_back) {
		learned_expect(&before, rls, "refused supervisor_update()");
	}
	if (status != KOOP_E_NULL && status != KOOP_E_SIZE && !is_null(w, 5)) {
		check_health(rls, &health, status);
	}
	for (size_t i = 0; w->supervisor.offline && i < 3; i++) {
		EXPECT(!isnan(w->supervisor.error[i]), "error %zu is %g", i, (double)w->supervisor.error[i]);
	}
}

static void call_supervisor_control(world *w) {
	KOOP(mpc) *mpc = &w->mpc;
	const KOOP(mpc_config) *c = &mpc->config;
	const real *psi = new_reals(&w->in, c->n_lifted),
	           *reference = new_reals(&w->in, c->horizon * c->n_states);
	const real *u_before = c->S || take_below(&w->in, 2) ? new_reals(&w->in, c->n_inputs) : NULL;
	real *u = new_reals(&w->in, c->n_inputs);
	const learned before = learned_take(&w->rls);
	KOOP(mpc_result) result;
	const int status =
	    KOOP(supervisor_control)(GIVEN(0, &w->supervisor), GIVEN(1, &w->rls), GIVEN(2, mpc), GIVEN(3, psi),
	                             GIVEN(4, reference), GIVEN(6, u_before), GIVEN(5, u), GIVEN(7, &result));
	expect_status(w, status, 6);
	learned_expect(&before, &w->rls, "supervisor_control()");
	if (status == KOOP_E_NULL || status == KOOP_E_SIZE) { return; }
	check_input(mpc, status, u, GIVEN(7, &result));
	const int model = w->supervisor.model;
	EXPECT(model >= KOOP_SUPERVISOR_ONLINE && model <= KOOP_SUPERVISOR_NONE, "model %d", model);
	EXPECT((model == KOOP_SUPERVISOR_NONE) == (status != KOOP_OK), "model %d, status %d", model, status);
	EXPECT(!isnan(w->supervisor.tracking), "tracking error");
}

/* ---- Gate -------------------------------------------------------------------------------------------------
 */

static void call_gate_init(world *w) {
	const KOOP(rls) *rls = &w->rls;
	KOOP(gate_config) c = {0};
	if (take_below(&w->in, 2)) {
		c.multiple = w->arbitrary ? take_real(&w->in) : (real)(1 + take_byte(&w->in) / 16.0);
		c.floor = w->arbitrary ? take_real(&w->in) : (real)(take_byte(&w->in) / 256.0);
		c.patience = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 8);
		c.hold = w->arbitrary ? take_size(&w->in) : 1 + take_below(&w->in, 64);
	}
	size_t needed = 0;
	(void)KOOP(rls_reals)(&rls->config, &needed);
	needed += 3 * rls->n_lifted;
	const size_t lacking = w->arbitrary && needed > 0 ? take_below(&w->in, 4) / 3 : 0;
	real *storage = new_reals(&w->in, needed - lacking);
	const KOOP(gate) before = w->gate;
	const int status =
	    KOOP(gate_init)(GIVEN(0, &w->gate), GIVEN(3, &c), GIVEN(1, rls), GIVEN(2, storage), needed - lacking);
	expect_status(w, status, 3);
	EXPECT(status != KOOP_OK || !lacking, "%zu reals are enough", needed - lacking);
	if (status != KOOP_OK) {
		EXPECT(!memcmp(&before, &w->gate, sizeof before), "status %d changes it", status);
	}
}

static void call_gate_update(world *w) {
	KOOP(rls) *rls = &w->rls;
	const size_t N = rls->n_lifted, m = rls->config.n_inputs, restored = w->gate.restored;
	const real *psi = new_reals(&w->in, N), *u = new_reals(&w->in, m), *psi_next = new_reals(&w->in, N);
	const learned before = learned_take(rls);
	KOOP(health) health;
	const int status = KOOP(gate_update)(GIVEN(0, &w->gate), GIVEN(1, rls), GIVEN(2, psi), GIVEN(3, u),
	                                     GIVEN(4, psi_next), GIVEN(5, &health));
	expect_status(w, status, 5);
	const int came_back = w->gate.restored != restored;
	EXPECT(!came_back || w->gate.restored == restored + 1, "%zu after %zu", w->gate.restored, restored);
	if (status != KOOP_OK && !came_back) { learned_expect(&before, rls, "refused gate_update()"); }
	if (status == KOOP_E_NULL || status == KOOP_E_SIZE) { return; }
	if (!is_null(w, 5)) { EXPECT(isfinite(health.innovation) || status != KOOP_OK, "innovation"); }
	EXPECT(all_finite(w->gate.saved.theta, rls->n_regressors * rls->n_lifted_padded), "saved model");
	EXPECT(all_finite(w->gate.variance, N) && all_finite(w->gate.recent_variance, N), "usual innovations");
	EXPECT(isfinite(w->gate.nis) && isfinite(w->gate.saved_nis), "strain");
	EXPECT(KOOP(gate_trust)(&w->gate) >= KOOP_TRUSTED && KOOP(gate_trust)(&w->gate) <= KOOP_REFUSE, "trust");
}

/* ---- The rest
 * ------------------------------------------------------------------------------------------------ */

static void call_status_message(world *w) {
	int status;
	take(&w->in, &status, sizeof status);
	const char *message = KOOP(status_message)(status);
	EXPECT(message && strlen(message) > 1 && strlen(message) < 100, "status %d", status);
}

void begin_sound(world *w) {
	call_init(w);
	call_mpc_init(w);
	call_set_theta(w);
	call_supervisor_init(w);
	call_lowpass_init(w);
	call_gate_init(w);
	EXPECT(w->rls.theta || w->rls.config.form == NULL, "sound settings are refused");
}

void call(world *w) {
	static void (*const calls[])(world *) = {
	    call_update,
	    call_supervisor_update,
	    call_supervisor_control,
	    call_mpc_solve,
	    call_predict,
	    call_refused,
	    call_set_theta,
	    call_copy_theta,
	    call_get,
	    call_model,
	    call_threshold,
	    call_reset_covariance,
	    call_lowpass_step,
	    call_lowpass_init,
	    call_mpc_read,
	    call_init,
	    call_status_message,
	    call_lift,
	    call_mpc_init,
	    call_supervisor_init,
	    call_gate_init,
	    call_gate_update,
	    call_move_limits,
	    call_flip,
	    call_model_covariance,
	};
	/* what is called in every cycle of a robot more often than the rest, and now and then again with the same
	 * data */
	const size_t which = take_below(&w->in, 64), count = sizeof calls / sizeof *calls;
	const uint8_t again = take_byte(&w->in);
	w->nulls = w->arbitrary && take_below(&w->in, 8) == 7 ? take_byte(&w->in) : 0;
	const input from = w->in;
	for (int k = 240; k == 240 || k <= again; k++) {
		w->in = from;
		calls[which < count ? which : which % 5](w);
		learned_check(&w->rls);
	}
}
