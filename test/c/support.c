#include "support.h"

#include <stdarg.h>
#include <stdio.h>

/* Unity calls these around each test. */
void setUp(void) {
}
void tearDown(void) {
}

void fail_at(int line, const char *condition, const char *format, ...) {
	char text[400];
	const int used = snprintf(text, sizeof text, "%s: ", condition);
	if (used > 0 && (size_t)used < sizeof text) {
		va_list arguments;
		va_start(arguments, format);
		vsnprintf(text + used, sizeof text - (size_t)used, format, arguments);
		va_end(arguments);
	}
	UNITY_TEST_FAIL((UNITY_LINE_TYPE)line, text);
}

void check_status(int line, const char *call, int expected, int status) {
	if (status != expected) { fail_at(line, call, "status %d instead of %d", status, expected); }
}

/* ---- Random numbers ---------------------------------------------------------- */

random_source random_seed(uint64_t seed) {
	random_source source = {seed * 0x9E3779B97F4A7C15u + 1u};
	for (int i = 0; i < 8; i++) { random_bits(&source); }
	return source;
}

uint64_t random_bits(random_source *source) {
	source->state ^= source->state >> 12;
	source->state ^= source->state << 25;
	source->state ^= source->state >> 27;
	return source->state * 0x2545F4914F6CDD1Du;
}

real random_uniform(random_source *source, double low, double high) {
	const double unit = (double)(random_bits(source) >> 11) / 9007199254740992.0;
	return (real)(low + (high - low) * unit);
}

size_t random_below(random_source *source, size_t count) {
	return (size_t)((random_bits(source) >> 32) % count);
}

void random_fill(random_source *source, real *x, size_t count, double low, double high) {
	for (size_t i = 0; i < count; i++) { x[i] = random_uniform(source, low, high); }
}

/* ---- Estimators ---------------------------------------------------------------- */

#define ENTER(name) &KOOP(reg_##name),
const KOOP(regulator) *const all_regulators[REGULATORS] = {KOOP_REGULATORS(ENTER)};
const KOOP(form) *const all_forms[FORMS] = {&KOOP(form_plain), &KOOP(form_sqrt)};

static void lift_identity(const KOOP(dictionary) *self, const real *x, real *psi) {
	for (size_t i = 0; i < self->n_lifted; i++) { psi[i] = x[i]; }
}

/* The settings that the estimator's regulator has; null: its defaults. */
static const void *settings_of(const estimator *e) {
	const KOOP(regulator) *regulator = e->config.regulator;
	const char *first = regulator && regulator->n_settings > 0 ? regulator->settings[0].name : "";
	if (strcmp(first, "delta") == 0) { return &e->dead_zone; }
	if (strcmp(first, "tau0") == 0) { return &e->trace; }
	if (strcmp(first, "eps_sift") == 0) { return &e->floor; }
	return strlen(first) > 0 ? e->own : NULL;
}

void estimator_settings(estimator *e, size_t N, size_t m, const KOOP(regulator) *regulator,
                        const KOOP(form) *form) {
	memset(e, 0, sizeof *e);
	/* what storage holds before does not matter: NaN would show if it did */
	for (size_t i = 0; i < sizeof e->storage / sizeof e->storage[0]; i++) { e->storage[i] = (real)NAN; }
	e->dictionary.name = "identity";
	e->dictionary.n_states = N;
	e->dictionary.n_lifted = N;
	e->dictionary.lift = lift_identity;
	e->config.dictionary = &e->dictionary;
	e->config.n_inputs = m;
	e->config.regulator = regulator;
	e->config.form = form;
	e->config.lambda = (real)0.95;
	e->config.p0 = 10;
	e->dead_zone.delta = (real)0.1;
	e->floor.eps_sift = (real)1e-10;
	e->config.check = KOOP_CHECK_REFUSE;
	e->config.settings = settings_of(e);
	if (e->config.settings == e->own) {
		TEST_ASSERT_TRUE(regulator->n_settings <= MAX_SETTINGS);
		memcpy(e->own, regulator->defaults, regulator->n_settings * sizeof(real));
	}
}

void estimator_start(estimator *e) {
	e->config.settings = settings_of(e);
	CHECK_STATUS(KOOP_OK,
	             KOOP(rls_init)(&e->rls, &e->config, e->storage, sizeof e->storage / sizeof e->storage[0]));
}

void estimator_default(estimator *e, size_t N, size_t m, const KOOP(regulator) *regulator,
                       const KOOP(form) *form) {
	estimator_settings(e, N, m, regulator, form);
	estimator_start(e);
}

int estimator_update(estimator *e, const real *zeta, const real *psi_next, KOOP(health) *health) {
	return KOOP(rls_update)(&e->rls, zeta, zeta + e->dictionary.n_lifted, psi_next, health);
}

void estimator_teach(estimator *e, random_source *random, int samples) {
	for (int k = 0; k < samples; k++) {
		real zeta[MAX_D], psi_next[MAX_N];
		random_fill(random, zeta, e->rls.n_regressors, -1, 1);
		random_fill(random, psi_next, e->rls.n_lifted, -1, 1);
		CHECK_STATUS(KOOP_OK, estimator_update(e, zeta, psi_next, NULL));
	}
}

const char *estimator_name(const estimator *e) {
	static char text[60];
	snprintf(text, sizeof text, "%s %s check %d", e->config.regulator->name, e->config.form->name,
	         e->config.check);
	return text;
}

static size_t regressors(const estimator *e) {
	return e->dictionary.n_lifted + e->config.n_inputs;
}

void learned_take(learned *out, const estimator *e) {
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&e->rls, out->theta));
	const int status = KOOP(rls_get_covariance)(&e->rls, out->covariance);
	out->covariance_fits = status == KOOP_OK;
	if (!out->covariance_fits) {
		CHECK(status == KOOP_E_OVERFLOW && e->config.form == &KOOP(form_sqrt), "status %d", status);
	}
}

int learned_same_theta(const learned *a, const learned *b, const estimator *e) {
	return memcmp(a->theta, b->theta, e->dictionary.n_lifted * regressors(e) * sizeof(real)) == 0;
}

int learned_same_covariance(const learned *a, const learned *b, const estimator *e) {
	return memcmp(a->covariance, b->covariance, regressors(e) * regressors(e) * sizeof(real)) == 0;
}

int learned_is_finite(const learned *a, const estimator *e) {
	int finite = 1;
	for (size_t i = 0; i < e->dictionary.n_lifted * regressors(e); i++) {
		finite = finite && isfinite(a->theta[i]);
	}
	for (size_t i = 0; i < regressors(e) * regressors(e); i++) {
		finite = finite && isfinite(a->covariance[i]);
	}
	return finite;
}

/* ---- Linear algebra -------------------------------------------------------------- */

wide norm(const real *x, size_t count) {
	wide sum = 0;
	for (size_t i = 0; i < count; i++) { sum += (wide)x[i] * (wide)x[i]; }
	return sqrt(sum);
}

wide trace_of(const real *P, size_t d) {
	wide sum = 0;
	for (size_t i = 0; i < d; i++) { sum += (wide)P[i * d + i]; }
	return sum;
}

/* M = L L' in place, L in the lower triangle; 0 at a pivot that is not positive */
static int cholesky(wide *M, size_t d) {
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			wide sum = M[i * d + j];
			for (size_t k = 0; k < j; k++) { sum -= M[i * d + k] * M[j * d + k]; }
			if (i != j) {
				M[i * d + j] = sum / M[j * d + j];
			} else {
				if (!(sum > 0)) { return 0; }
				M[i * d + i] = sqrt(sum);
			}
		}
	}
	return 1;
}

int is_positive_definite(const real *P, size_t d) {
	wide M[MAX_D * MAX_D];
	for (size_t i = 0; i < d * d; i++) { M[i] = (wide)P[i]; }
	return cholesky(M, d);
}

void solve_positive_definite(wide *M, size_t d, wide *Y, size_t columns) {
	CHECK(cholesky(M, d), "the test's own matrix is singular");
	for (size_t c = 0; c < columns; c++) {
		for (size_t i = 0; i < d; i++) {
			for (size_t k = 0; k < i; k++) { Y[i * columns + c] -= M[i * d + k] * Y[k * columns + c]; }
			Y[i * columns + c] /= M[i * d + i];
		}
		for (size_t i = d; i-- > 0;) {
			for (size_t k = i + 1; k < d; k++) { Y[i * columns + c] -= M[k * d + i] * Y[k * columns + c]; }
			Y[i * columns + c] /= M[i * d + i];
		}
	}
}

/* Rotates rows and columns p and q of A so that A[p][q] becomes zero. */
static void jacobi_rotate(double *A, size_t d, size_t p, size_t q) {
	const double apq = A[p * d + q];
	if (!(fabs(apq) > 0)) { return; }
	const double tau = (A[q * d + q] - A[p * d + p]) / (2 * apq);
	const double t = (tau >= 0 ? 1 : -1) / (fabs(tau) + sqrt(1 + tau * tau));
	const double c = 1 / sqrt(1 + t * t), s = t * c;
	for (size_t k = 0; k < d; k++) {
		const double kp = A[k * d + p], kq = A[k * d + q];
		A[k * d + p] = c * kp - s * kq;
		A[k * d + q] = s * kp + c * kq;
	}
	for (size_t k = 0; k < d; k++) {
		const double pk = A[p * d + k], qk = A[q * d + k];
		A[p * d + k] = c * pk - s * qk;
		A[q * d + k] = s * pk + c * qk;
	}
}

void eigenvalue_range(const real *P, size_t d, double *least, double *largest) {
	double A[MAX_D * MAX_D];
	for (size_t i = 0; i < d * d; i++) { A[i] = (double)P[i]; }
	/* convergence is quadratic: at these sizes ten sweeps leave nothing */
	for (int sweep = 0; sweep < 10; sweep++) {
		for (size_t p = 0; p < d; p++) {
			for (size_t q = p + 1; q < d; q++) { jacobi_rotate(A, d, p, q); }
		}
	}
	*least = *largest = A[0];
	for (size_t i = 1; i < d; i++) {
		*least = fmin(*least, A[i * d + i]);
		*largest = fmax(*largest, A[i * d + i]);
	}
}

double relative_difference(const real *a, const wide *b, size_t count) {
	wide difference = 0, size = 0;
	for (size_t i = 0; i < count; i++) {
		difference = fmax(difference, fabs((wide)a[i] - b[i]));
		size = fmax(size, fabs(b[i]));
	}
	return (double)(size > 0 ? difference / size : difference);
}

double relative_difference_real(const real *a, const real *b, size_t count) {
	wide copy[MAX_D * MAX_D];
	for (size_t i = 0; i < count; i++) { copy[i] = (wide)b[i]; }
	return relative_difference(a, copy, count);
}
