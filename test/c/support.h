/* What several tests need: estimators, random numbers, linear algebra that
 * shares nothing with the library, and checks that print numbers. */
#ifndef SUPPORT_H
#define SUPPORT_H

#include "precision.h"
#include "unity.h"

#include <string.h>

/* ---- Checks ---------------------------------------------------------------- */

/* Fails with a formatted message. */
#define CHECK(condition, ...)                                                                                \
	do {                                                                                                     \
		if (!(condition)) { fail_at(__LINE__, #condition, __VA_ARGS__); }                                    \
	} while (0)
#define CHECK_STATUS(expected, call) check_status(__LINE__, #call, expected, call)

void fail_at(int line, const char *condition, const char *format, ...);
void check_status(int line, const char *call, int expected, int status);

/* ---- Random numbers: xorshift64*, the same on every machine ----------------- */

typedef struct {
	uint64_t state;
} random_source;

random_source random_seed(uint64_t seed);
uint64_t random_bits(random_source *source);
real random_uniform(random_source *source, double low, double high);
size_t random_below(random_source *source, size_t count);
void random_fill(random_source *source, real *x, size_t count, double low, double high);

/* ---- Estimators -------------------------------------------------------------- */

#define MAX_N 22
#define MAX_M 3
#define MAX_D (MAX_N + MAX_M)
#define MAX_SETTINGS 4

#define COUNT_REGULATOR(name) +1
enum { REGULATORS = 0 KOOP_REGULATORS(COUNT_REGULATOR), FORMS = 2 };
extern const KOOP(regulator) *const all_regulators[REGULATORS];
extern const KOOP(form) *const all_forms[FORMS];

/* An estimator with all that it points to. Its dictionary is the identity: the
 * recursion does not care where psi comes from. */
typedef struct {
	KOOP(dictionary) dictionary;
	KOOP(config) config;
	KOOP(dead_zone) dead_zone; /* settings of the regulators that have these */
	KOOP(constant_trace) trace;
	KOOP(information_floor) floor;
	real own[MAX_SETTINGS]; /* of a regulator with other settings, in its order; they start as its defaults */
	KOOP(rls) rls;
	real storage[KOOP_RLS_REALS_PLAIN(MAX_N, MAX_M) + KOOP_EXTENSION_REALS_PLAIN(MAX_N, MAX_M)];
} estimator;

/* lambda 0.95, p0 10, delta 0.1, the default trace and threshold, KOOP_CHECK_REFUSE */
void estimator_settings(estimator *e, size_t N, size_t m, const KOOP(regulator) *regulator,
                        const KOOP(form) *form);
/* rls_init() with what the settings have become; must succeed */
void estimator_start(estimator *e);
/* both of the above */
void estimator_default(estimator *e, size_t N, size_t m, const KOOP(regulator) *regulator,
                       const KOOP(form) *form);
/* zeta = [psi; u] in one array */
int estimator_update(estimator *e, const real *zeta, const real *psi_next, KOOP(health) *health);
/* samples of random numbers, each of which must be learned */
void estimator_teach(estimator *e, random_source *random, int samples);

/* "sift sqrt", for messages */
const char *estimator_name(const estimator *e);

/* What was learned, bit for bit. */
typedef struct {
	real theta[MAX_N * MAX_D];
	real covariance[MAX_D * MAX_D];
	int covariance_fits; /* 0: only its root fits this precision */
} learned;

void learned_take(learned *out, const estimator *e);
int learned_same_theta(const learned *a, const learned *b, const estimator *e);
int learned_same_covariance(const learned *a, const learned *b, const estimator *e);
int learned_is_finite(const learned *a, const estimator *e);

/* ---- Linear algebra in wide arithmetic --------------------------------------- */

wide norm(const real *x, size_t count);
wide trace_of(const real *P, size_t d);
/* 1 if the d x d matrix is positive definite */
int is_positive_definite(const real *P, size_t d);
/* X = M^-1 Y for a positive definite M (d x d) and Y (d x columns), both by rows; M is used up */
void solve_positive_definite(wide *M, size_t d, wide *Y, size_t columns);
/* least and largest eigenvalue of a symmetric matrix, by cyclic Jacobi */
void eigenvalue_range(const real *P, size_t d, double *least, double *largest);
/* largest |a - b| over largest |b| */
double relative_difference(const real *a, const wide *b, size_t count);
double relative_difference_real(const real *a, const real *b, size_t count);

#endif
