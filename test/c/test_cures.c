/* Regulators from other papers: what each one bounds, over long runs with and without excitation. */
#include "reference.h"

enum { N = 3, M = 2, D = N + M, STEPS = TEST_SHARE > 1 ? 300 : 3000 };

static estimator e;

/* How a run is excited: not at all, along one direction, in a plane, in all directions, and each of them in turn. */
enum { NONE, ONE, PLANE, ALL, TURNS, EXCITATIONS };

static void excite(random_source *random, int excitation, int k, real *zeta) {
	const int now = excitation == TURNS ? k / (STEPS / 12) % TURNS : excitation;
	random_fill(random, zeta, D, -1, 1);
	for (int i = 0; i < D; i++) {
		if (now == NONE || (now == PLANE && i > 1)) { zeta[i] = 0; }
		if (now == ONE) { zeta[i] = (real)(0.1 * (i + 1)); }
	}
}

/* Eigenvalues of P, and how much |zeta|^2 has been at most, from the start on. */
typedef struct {
	double least, largest; /* of all samples */
	double now_least, now_largest, trace;
	double beta;
	int steps;
} seen;

static void look(seen *s) {
	learned now;
	learned_take(&now, &e);
	eigenvalue_range(now.covariance, D, &s->now_least, &s->now_largest);
	s->trace = (double)trace_of(now.covariance, D);
	s->least = fmin(s->least, s->now_least);
	s->largest = fmax(s->largest, s->now_largest);
}

/* Learns one sample of noise, and looks. */
static void step(random_source *random, int excitation, seen *s) {
	real zeta[D], psi_next[N];
	excite(random, excitation, s->steps++, zeta);
	random_fill(random, psi_next, N, -1, 1);
	s->beta = fmax(s->beta, pow((double)norm(zeta, D), 2));
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	look(s);
}

static seen start(const KOOP(regulator) *regulator, const KOOP(form) *form, double lambda, const double *own) {
	const seen nothing = {.least = 1e300};
	estimator_settings(&e, N, M, regulator, form);
	e.config.lambda = (real)lambda;
	for (size_t i = 0; i < regulator->n_settings && own; i++) { e.own[i] = (real)own[i]; }
	estimator_start(&e);
	return nothing;
}

/* Round-off, relative to a bound that holds in exact arithmetic. */
static const double slack = 1 + 1000 * (double)REAL_EPSILON;

#define FOR_ALL_RUNS(f, excitation)                                                                          \
	for (int f = 0; f < FORMS; f++)                                                                          \
		for (int excitation = 0; excitation < EXCITATIONS; excitation++)

/* ---- Covariance resetting ------------------------------------------------------------ */

static void test_reset_bounds_p_from_both_sides(void) {
	const double own[] = {40, 0.05}, p0 = 10;
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(91);
		seen s = start(&KOOP(reg_reset), all_forms[f], 0.5, own); /* lambda is ignored */
		for (int k = 0; k < STEPS; k++) {
			step(&random, excitation, &s);
			CHECK(s.now_largest <= p0 * slack, "%s: %g", estimator_name(&e), s.now_largest);
			CHECK(s.trace >= 0.05 * p0 * D / slack, "%s: %g", estimator_name(&e), s.trace);
			CHECK(s.now_least >= 1 / (1 / p0 + 40 * s.beta) / slack, "%s: %g", estimator_name(&e), s.now_least);
		}
		CHECK(excitation != NONE || s.least >= p0 / slack, "nothing is learned without excitation: %g", s.least);
	}
}

/* By the period alone, and by the trace alone. */
static void test_reset_is_due_by_either_setting(void) {
	static const double period[] = {5, 0}, trace[] = {0, 0.3}, never[] = {0, 0};
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(92);
		seen s = start(&KOOP(reg_reset), all_forms[f], 1, period);
		for (int k = 1; k <= 25; k++) {
			step(&random, ALL, &s);
			CHECK((s.now_least > 9.99) == (k % 5 == 0), "%s, sample %d: %g", estimator_name(&e), k, s.now_least);
		}
		int resets = 0;
		s = start(&KOOP(reg_reset), all_forms[f], 1, trace);
		for (int k = 0; k < 100; k++) {
			step(&random, ALL, &s);
			resets += s.now_least > 9.99;
		}
		CHECK(resets > 5 && resets < 50, "%s: %d", estimator_name(&e), resets);
		s = start(&KOOP(reg_reset), all_forms[f], 1, never);
		for (int k = 0; k < 100; k++) { step(&random, ALL, &s); }
		CHECK(s.now_largest < 0.1, "%s: %g", estimator_name(&e), s.now_largest);
	}
}

/* Goodwin and others: with resets, least squares follows a parameter that has changed; without, its gain is gone. */
static void test_reset_follows_a_change(void) {
	for (int f = 0; f < FORMS; f++) {
		double error[2];
		for (int resets = 0; resets < 2; resets++) {
			random_source random = random_seed(93);
			const double own[] = {100, 0};
			start(resets ? &KOOP(reg_reset) : &KOOP(reg_none), all_forms[f], 1, resets ? own : NULL);
			learned now;
			for (int k = 0; k < 2000; k++) {
				real zeta[D], psi_next[N] = {0};
				random_fill(&random, zeta, D, -1, 1);
				psi_next[0] = k < 1500 ? zeta[0] : -zeta[0];
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			}
			learned_take(&now, &e);
			error[resets] = fabs((double)now.theta[0] + 1);
		}
		CHECK(error[1] < 0.01 && error[0] > 1, "%g with resets, %g without", error[1], error[0]);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_reset_bounds_p_from_both_sides);
	RUN_TEST(test_reset_is_due_by_either_setting);
	RUN_TEST(test_reset_follows_a_change);
	return UNITY_END();
}
