/* TinyKoop's part of the benchmark, in the precision that `REAL`, `KOOP` and
 * `BENCH` stand for. Included by ours_f32.c and ours_f64.c. */
#include <math.h>
#include <stdlib.h>

#define N BENCH_LIFTED
#define M BENCH_INPUTS

/* One estimator per way of updating. */
typedef struct estimator {
	KOOP(rls) rls;
	KOOP(health) health;
} estimator;

static void start(estimator *e, const KOOP(form) *form, int check, REAL *storage, size_t reals) {
	KOOP(config) config = {0};
	config.dictionary = &KOOP(rbf_ddr);
	config.n_inputs = M;
	config.regulator = &KOOP(reg_ef);
	config.form = form;
	config.lambda = (REAL)BENCH_LAMBDA;
	config.p0 = (REAL)BENCH_P0;
	config.check = check;
	if (KOOP(rls_init)(&e->rls, &config, storage, reals) != KOOP_OK) { abort(); }
}

static void learn(estimator *e, KOOP(health) *health, size_t count) {
	int failed = 0;
	for (size_t k = 0; k < count; k++) {
		const BENCH(sample) *s = &BENCH(data)[k % BENCH_SAMPLES];
		failed |= KOOP(rls_update)(&e->rls, s->psi, s->u, s->psi_next, health);
	}
	if (failed) { abort(); }
}

static void read_theta(const estimator *e, double *theta) {
	REAL copy[N * (N + M)];
	if (KOOP(rls_get_theta)(&e->rls, copy) != KOOP_OK) { abort(); }
	for (size_t i = 0; i < N * (N + M); i++) { theta[i] = (double)copy[i]; }
}

#define ESTIMATOR(name, form, check, health_pointer)                                                         \
	static estimator name;                                                                                   \
	static REAL storage_##name[KOOP_RLS_REALS_PLAIN(N, M)];                                                  \
	static void reset_##name(void) {                                                                         \
		start(&name, &KOOP(form), check, storage_##name, KOOP_RLS_REALS_PLAIN(N, M));                        \
	}                                                                                                        \
	static void run_##name(size_t count) {                                                                   \
		learn(&name, health_pointer, count);                                                                 \
	}                                                                                                        \
	static void theta_##name(double *theta) {                                                                \
		read_theta(&name, theta);                                                                            \
	}

ESTIMATOR(plain, form_plain, KOOP_CHECK_DIAGONAL, NULL)
ESTIMATOR(health, form_plain, KOOP_CHECK_DIAGONAL, &health.health)
ESTIMATOR(checked, form_plain, KOOP_CHECK_REFUSE, NULL)
ESTIMATOR(square_root, form_sqrt, KOOP_CHECK_REFUSE, NULL)

/* The dictionaries, as one would write them down from the paper. */

static void libm_poly(const REAL *x, REAL *psi) {
	psi[0] = x[0];
	psi[1] = x[1];
	psi[2] = x[2];
	psi[3] = x[0] * x[0];
	psi[4] = x[1] * x[1];
	psi[5] = MATH(sin)(x[2]);
	psi[6] = MATH(cos)(x[2]);
}

static void libm_rbf(const REAL *x, REAL *psi) {
	static const REAL center[4] = {-3, -1, 1, 3};
	const REAL sigma = (REAL)1.5;
	psi[0] = x[0];
	psi[1] = x[1];
	psi[2] = x[2];
	for (size_t i = 0; i < 4; i++) {
		for (size_t j = 0; j < 4; j++) {
			const REAL dx = x[0] - center[i], dy = x[1] - center[j];
			psi[3 + 4 * i + j] = MATH(exp)(-(dx * dx + dy * dy) / (2 * sigma * sigma));
		}
	}
	psi[19] = MATH(sin)(x[2]);
	psi[20] = MATH(cos)(x[2]);
	psi[21] = MATH(atan2)(MATH(sin)(x[2]), MATH(cos)(x[2]));
}

static REAL lifted[N];

static void run_koop_lift(const KOOP(dictionary) *dictionary, size_t count) {
	int failed = 0;
	for (size_t k = 0; k < count; k++) {
		failed |= KOOP(lift)(dictionary, BENCH(data)[k % BENCH_SAMPLES].psi, lifted);
	}
	if (failed) { abort(); }
}

static void run_lift_poly(size_t count) {
	run_koop_lift(&KOOP(poly_ddr), count);
}

static void run_lift_rbf(size_t count) {
	run_koop_lift(&KOOP(rbf_ddr), count);
}

/* through a pointer, as a dictionary is called: nothing is hoisted or dropped */
static void run_libm(void (*volatile lift)(const REAL *, REAL *), size_t count) {
	for (size_t k = 0; k < count; k++) { lift(BENCH(data)[k % BENCH_SAMPLES].psi, lifted); }
}

static void run_libm_poly(size_t count) {
	run_libm(libm_poly, count);
}

static void run_libm_rbf(size_t count) {
	run_libm(libm_rbf, count);
}

const bench_case BENCH(ours)[] = {
    {"rls_update", PRECISION, "tinykoop", reset_plain, run_plain, theta_plain},
    {"rls_update_health", PRECISION, "tinykoop", reset_health, run_health, theta_health},
    {"rls_update_checked", PRECISION, "tinykoop", reset_checked, run_checked, theta_checked},
    {"rls_update_sqrt", PRECISION, "tinykoop", reset_square_root, run_square_root, theta_square_root},
    {"lift_poly_ddr", PRECISION, "tinykoop", NULL, run_lift_poly, NULL},
    {"lift_poly_ddr", PRECISION, "libm", NULL, run_libm_poly, NULL},
    {"lift_rbf_ddr", PRECISION, "tinykoop", NULL, run_lift_rbf, NULL},
    {"lift_rbf_ddr", PRECISION, "libm", NULL, run_libm_rbf, NULL},
};
const size_t BENCH(ours_count) = sizeof BENCH(ours) / sizeof *BENCH(ours);
