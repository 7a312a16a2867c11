/* P stays symmetric, both forms agree, and round-off does not pile up. */
#include "support.h"

static estimator plain, root;

static void test_symmetric_bit_for_bit(void) {
	random_source random = random_seed(41);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			const size_t N = 1 + random_below(&random, 12), m = 1 + random_below(&random, 3), d = N + m;
			estimator_default(&plain, N, m, all_regulators[r], all_forms[f]);
			for (int k = 0; k < 300; k++) {
				real zeta[MAX_D], psi_next[MAX_N];
				learned now;
				random_fill(&random, zeta, d, -1, 1);
				random_fill(&random, psi_next, N, -1, 1);
				CHECK_STATUS(KOOP_OK, estimator_update(&plain, zeta, psi_next, NULL));
				learned_take(&now, &plain);
				for (size_t i = 0; i < d; i++) {
					for (size_t j = 0; j < i; j++) {
						CHECK(memcmp(&now.covariance[i * d + j], &now.covariance[j * d + i], sizeof(real)) ==
						          0,
						      "%s step %d, (%u, %u)", estimator_name(&plain), k, (unsigned)i, (unsigned)j);
					}
				}
				CHECK(is_positive_definite(now.covariance, d), "%s step %d", estimator_name(&plain), k);
			}
		}
	}
}

static void test_forms_agree(void) {
	random_source random = random_seed(42);
	for (int r = 0; r < REGULATORS; r++) {
		enum { N = 9, M = 2, D = N + M };
		estimator_default(&plain, N, M, all_regulators[r], &KOOP(form_plain));
		estimator_default(&root, N, M, all_regulators[r], &KOOP(form_sqrt));
		for (int k = 0; k < 1000; k++) {
			real zeta[D], psi_next[N];
			learned a, b;
			random_fill(&random, zeta, D, -1, 1);
			for (int i = 0; i < N; i++) { psi_next[i] = zeta[(i + 3) % D] - zeta[i] / 2; }
			CHECK_STATUS(KOOP_OK, estimator_update(&plain, zeta, psi_next, NULL));
			CHECK_STATUS(KOOP_OK, estimator_update(&root, zeta, psi_next, NULL));
			learned_take(&a, &plain);
			learned_take(&b, &root);
			const double theta = relative_difference_real(a.theta, b.theta, N * D);
			const double P = relative_difference_real(a.covariance, b.covariance, D * D);
			CHECK(theta <= 200 * (double)REAL_EPSILON, "%s step %d: Theta %.2g epsilon",
			      estimator_name(&plain), k, theta / (double)REAL_EPSILON);
			CHECK(P <= 200 * (double)REAL_EPSILON, "%s step %d: P %.2g epsilon", estimator_name(&plain), k,
			      P / (double)REAL_EPSILON);
		}
	}
}

/* P - K (zeta' P) in the textbook's order lets the antisymmetric part of P grow
 * by 1 / lambda at every step, and ends in NaN with perfect excitation. */
static void test_round_off_does_not_pile_up(void) {
	enum { N = 3, M = 1, D = N + M, STEPS = 100000 / TEST_SHARE };
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			const int forgets = all_regulators[r]->forgets || all_regulators[r]->needs_information;
			random_source random = random_seed(43);
			real theta_true[N * D];
			wide truth[N * D];
			learned now;
			random_fill(&random, theta_true, N * D, -1, 1);
			for (int i = 0; i < N * D; i++) { truth[i] = (wide)theta_true[i]; }
			estimator_settings(&plain, N, M, all_regulators[r], all_forms[f]);
			plain.dead_zone.delta = 0;
			estimator_start(&plain);
			double worst = 0;
			for (int k = 0; k < STEPS; k++) {
				real zeta[D], psi_next[N];
				random_fill(&random, zeta, D, -1, 1);
				for (int i = 0; i < N; i++) {
					wide sum = 0;
					for (int j = 0; j < D; j++) { sum += truth[i * D + j] * (wide)zeta[j]; }
					psi_next[i] = (real)sum;
				}
				CHECK_STATUS(KOOP_OK, estimator_update(&plain, zeta, psi_next, NULL));
				/* by then what P0 = p0 I held back is forgotten */
				if (k >= 5000 && k % 10 == 0 && forgets) {
					learned_take(&now, &plain);
					worst = fmax(worst, relative_difference(now.theta, truth, N * D));
				}
			}
			learned_take(&now, &plain);
			const double final = relative_difference(now.theta, truth, N * D);
			/* `none` keeps its ridge, 1 / (p0 STEPS / 3), and has next to no gain left to
			 * correct its rounding with */
			const double kept = 2 * 3 / ((double)plain.config.p0 * STEPS) + 2000 * (double)REAL_EPSILON;
			const double bound = forgets ? 50 * (double)REAL_EPSILON : kept;
			CHECK(worst <= 50 * (double)REAL_EPSILON && final <= bound, "%s: %.2g, %.2g epsilon",
			      estimator_name(&plain), worst / (double)REAL_EPSILON, final / (double)REAL_EPSILON);
			CHECK(is_positive_definite(now.covariance, D), "%s", estimator_name(&plain));
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_symmetric_bit_for_bit);
	RUN_TEST(test_forms_agree);
	RUN_TEST(test_round_off_does_not_pile_up);
	return UNITY_END();
}
