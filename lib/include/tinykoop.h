/* TinyKoop: recursive Koopman learning for microcontrollers, in C99 without a heap.
 *
 * The lifted state psi = Psi(x) of a robot is predicted by a linear model
 *
 *     psi[k+1] = Theta * zeta[k],    Theta = [A B],    zeta = [psi; u],
 *
 * and Theta is learned online by recursive least squares. A regulator keeps the
 * covariance P of the least squares bounded. Source: "Covariance-Regulated Recursive
 * Koopman Learning for Nonlinear Systems with Uncertain Time-Varying Dynamics", below
 * called the paper.
 *
 * Sizes:  n  states,  N  lifted states,  m  inputs,  d = N + m  regressors.
 * Matrices are stored row by row. psi, x and u have the units of your robot. A "real" is a float
 * or a double.
 *
 * Every name exists twice, from one source: koopf_ works in float, koopd_ in
 * double, and both can be linked into one program. Compile lib/koopf.c,
 * lib/koopd.c, or both. In tinykoop_api.h, KOOP(name) stands for koopf_name or
 * koopd_name and KOOP_REAL for float or double.
 *
 * Every call checks its arguments and returns KOOP_OK or a negative status. A refused
 * call leaves the learned model as it was, bit for bit. Every call returns KOOP_E_NULL
 * for a null pointer, unless null is allowed, and for an object that has not been
 * initialised. The comment of a call lists its other statuses.
 *
 * Same input, same bits: results are identical on all compilers and optimisation levels
 * where float and double are those of IEEE 754 and a * b + c is not contracted into one
 * operation. GCC contracts unless it gets -std=c99 or -ffp-contract=off, Clang unless it
 * gets the latter. With contraction the learned model differs in the last digits between
 * machines.
 *
 * Thread safety: separate objects may be used from separate threads. There are
 * no writable globals.
 */
#ifndef TINYKOOP_H
#define TINYKOOP_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define KOOP_VERSION "0.1.0"
#define KOOP_VERSION_MAJOR 0
#define KOOP_VERSION_MINOR 1
#define KOOP_VERSION_PATCH 0

/* Largest accepted N, m and N + m: it bounds every loop. */
#define KOOP_MAX_DIM 255

/* Largest total degree of the polynomials of a combined dictionary. */
#define KOOP_MAX_DEGREE 8

/* Status of a call. Errors are negative. status_message() has a message for each. */
enum {
	KOOP_OK = 0,
	KOOP_E_NULL = -1,       /* a required pointer is null, or the object is not initialised */
	KOOP_E_SIZE = -2,       /* a dimension is zero or too large, or sizes do not agree */
	KOOP_E_STORAGE = -3,    /* the caller's storage is too small */
	KOOP_E_RANGE = -4,      /* a setting is outside its range */
	KOOP_E_INPUT = -5,      /* an input is NaN or infinite */
	KOOP_E_OVERFLOW = -6,   /* the result would not be finite in this precision */
	KOOP_E_INDEFINITE = -7, /* the covariance, or the controller's Hessian, would not be positive definite */
	KOOP_E_MODEL = -8,      /* a stored model is damaged, or of another size, precision or dictionary */
	KOOP_E_OUTLIER = -9,    /* the gate refused the sample: its innovation is far beyond the standard deviation */
	KOOP_E_MEMORY = -10,    /* more bits of the learned model have flipped than can be repaired */
	KOOP_E_ARITHMETIC = -11 /* the compiled arithmetic is not that of IEEE 754: see self_test() */
};

/* How an update checks that P stays positive definite (config.check).
 *
 * The plain form can lose positive definiteness to round-off. The gain then has the
 * wrong sign along some direction, and the model diverges within a few samples. The
 * square-root form cannot lose it: there the check costs nothing and the three settings
 * are the same. */
enum {
	KOOP_CHECK_REFUSE = 0,  /* factor P at every update; refuse a sample after which P is not positive definite */
	KOOP_CHECK_REPORT = 1,  /* factor P, report the loss in the health, and continue as the paper's recursion does */
	KOOP_CHECK_DIAGONAL = 2 /* refuse only if a diagonal element is not positive; no factoring */
};

/* Result of gate_trust(). */
enum { KOOP_TRUSTED = 0, KOOP_DOUBTFUL = 1, KOOP_REFUSE = 2 };

/* Checksum of words of memory that locates a flipped bit, so that it can be repaired. */
typedef struct koop_checksum {
	uint64_t words;    /* sum of the words */
	uint64_t weighted; /* sum of each word times its distance from the end */
} koop_checksum;

/* Number of reals of the caller's storage, for static arrays:
 *
 *     static float storage[KOOP_RLS_REALS_SQRT(22, 2)];
 *
 * SQRT is for the square-root form, PLAIN for the plain form and any check. Both are
 * for regulators without an extension. rls_reals() returns the exact number, which
 * is smaller in the plain form without SIFt or with KOOP_CHECK_DIAGONAL.
 *
 * An extension with k reals of memory takes 2 KOOP_PAD(k) more, and one that reshapes P as much again as P and
 * 2 KOOP_PAD(d) + 4 more. So does the gate's storage. KOOP_EXTENSION_REALS_SQRT and .._PLAIN, added to these, suffice
 * for each regulator that is provided; the list below says which of them need it.
 *
 * Only half of a symmetric or triangular matrix is stored, in tiles of 4 x 4. On processors
 * with vector registers, the P of the plain form is stored in full. */
#define KOOP_PAD(k) (((size_t)(k) + 3u) / 4u * 4u)
#define KOOP_TRIANGLE(d) (KOOP_PAD(d) * (KOOP_PAD(d) + 4u) / 2u)
#ifndef KOOP_VECTORS
#if defined(__SSE2__) || defined(__ARM_NEON) || defined(__ARM_FEATURE_MVE) || defined(__riscv_vector)
#define KOOP_VECTORS 1
#else
#define KOOP_VECTORS 0
#endif
#endif
#define KOOP_SYMMETRIC(d) (KOOP_VECTORS ? KOOP_PAD(d) * KOOP_PAD(d) : KOOP_TRIANGLE(d))
#define KOOP_EVEN(k) (((size_t)(k) + 1u) / 2u * 2u)
#define KOOP_RLS_REALS(N, d, covariance)                                                                     \
	(KOOP_EVEN(d) * KOOP_PAD(N) + 5u * KOOP_PAD(d) + KOOP_PAD(N) + (covariance))
#define KOOP_RLS_REALS_SQRT(N, m) KOOP_RLS_REALS(N, (size_t)(N) + (m), KOOP_TRIANGLE((size_t)(N) + (m)))
#define KOOP_RLS_REALS_PLAIN(N, m)                                                                           \
	KOOP_RLS_REALS(N, (size_t)(N) + (m),                                                                     \
	               2u * KOOP_SYMMETRIC((size_t)(N) + (m)) + KOOP_TRIANGLE((size_t)(N) + (m)))
#define KOOP_EXTENSION_REALS(d, covariance) ((covariance) + 2u * KOOP_PAD(d) + 4u + 2u * KOOP_PAD((d) + 1u))
#define KOOP_EXTENSION_REALS_SQRT(N, m)                                                                      \
	KOOP_EXTENSION_REALS((size_t)(N) + (m), KOOP_TRIANGLE((size_t)(N) + (m)))
#define KOOP_EXTENSION_REALS_PLAIN(N, m)                                                                     \
	KOOP_EXTENSION_REALS((size_t)(N) + (m),                                                                  \
	                     KOOP_SYMMETRIC((size_t)(N) + (m)) + KOOP_TRIANGLE((size_t)(N) + (m)))

/* The regulators, which tools and tests list: X(name) for each. To add one takes this line and the file
 * lib/src/regulator_NAME.c, included in lib/src/all.h.
 *   none   lambda = 1: ordinary recursive least squares
 *   ef     exponential forgetting: vanilla in the paper, eq. (4)
 *   dz_cs  P is frozen while the innovation is <= delta: paper, "Error Dead-Zone Gating"
 *   dz_ks  P and Theta are frozen then: the comparison method of the paper
 *   ct     P is scaled to the trace tau0: paper, "Constant-Trace Normalization"
 *   sift   forgets along zeta only: paper, "Subspace-of-Information Forgetting"
 * Those of other papers; + needs KOOP_EXTENSION_REALS_..:
 *   reset  + lambda = 1, and P starts again from p0 I: covariance resetting (Goodwin, Elliott and Teoh, 1983)
 *   vrf    + lambda varies with the innovation: variable-rate forgetting (Bruce, Goel and Bernstein, 2020)
 *   er     + P tends to p_inf I: exponential resetting (Lai and Bernstein, 2023)
 *   cr     + the same, one direction per sample: cyclic resetting (Lai and Bernstein, 2023)
 *   kulhavy  forgets along zeta only: directional forgetting (Kulhavy and Karny, 1984)
 *   bgf    lambda tends to 1 as the trace of P tends to k0: bounded-gain forgetting (Slotine and Li, 1991) */
#define KOOP_REGULATORS(X)                                                                                   \
	X(none) X(ef) X(dz_cs) X(dz_ks) X(ct) X(sift) X(reset) X(vrf) X(er) X(cr) X(kulhavy) X(bgf)

/* Number of reals of a gate's storage, for N lifted states and m inputs, by the form of P. */
#define KOOP_GATE_REALS_SQRT(N, m) (KOOP_RLS_REALS_SQRT(N, m) + 3u * (size_t)(N))
#define KOOP_GATE_REALS_PLAIN(N, m) (KOOP_RLS_REALS_PLAIN(N, m) + 3u * (size_t)(N))

/* Model predictive control. These limits are fixed at compile time, and bound the worst
 * case of a solve: MAX_NEWTON steps with KOOP_MPC_NEWTON, MAX_GRADIENT steps with
 * KOOP_MPC_GRADIENT. Define a smaller KOOP_MPC_MAX_GRADIENT if the control period is short. */
#define KOOP_MPC_MAX_HORIZON 1000 /* largest accepted H */
#define KOOP_MPC_MAX_INPUTS 65535 /* largest accepted H m: the size of the storage then fits 32 bits */
#define KOOP_MPC_MAX_NEWTON 100
#ifndef KOOP_MPC_MAX_GRADIENT
#define KOOP_MPC_MAX_GRADIENT 5000
#endif

/* Method of the controller (mpc_config.method). */
enum {
	KOOP_MPC_NEWTON = 0,  /* projected Newton (Bertsekas, 1982): fastest */
	KOOP_MPC_GRADIENT = 1 /* accelerated projected gradient, matrix-free: smallest memory */
};

/* Number of reals of the controller's storage, for N lifted states of which n
 * are tracked, m inputs and a horizon of H steps, by method. */
#define KOOP_MPC_WINDOW 8u         /* arrays are padded to this */
#define KOOP_MPC_GROUP ((size_t)4) /* rows of the factor that are computed together */
#define KOOP_MPC_PAD(k) (((size_t)(k) + KOOP_MPC_WINDOW - 1u) / KOOP_MPC_WINDOW * KOOP_MPC_WINDOW)
#define KOOP_MPC_MAX(a, b) ((a) > (b) ? (a) : (b))
#define KOOP_MPC_WORK(N, n, m, H)                                                                            \
	KOOP_MPC_MAX(KOOP_MPC_MAX((2u * (size_t)(m) + 3u) * KOOP_PAD(N), (size_t)(n) * ((H) + KOOP_MPC_WINDOW)), \
	             (size_t)(m) * (KOOP_MPC_PAD((H) * (m)) + KOOP_MPC_WINDOW) + (n) + 2u * (m))
#define KOOP_MPC_REALS(N, n, m, H)                                                                           \
	((n) * ((size_t)(H) * (m) + 2u * KOOP_MPC_PAD(H)) + 6u * KOOP_MPC_PAD((H) * (m)) +                       \
	 KOOP_MPC_PAD((H) * (m)) / 4u + 4u * (m) + 2u * (m) * (m) + (n) * (n) + KOOP_MPC_WORK(N, n, m, H))
#define KOOP_MPC_REALS_GRADIENT(N, n, m, H) KOOP_MPC_REALS(N, n, m, H)
#define KOOP_MPC_REALS_NEWTON(N, n, m, H)                                                                    \
	(KOOP_MPC_REALS(N, n, m, H) + ((n) + (m)) * KOOP_MPC_PAD((H) * (m)) + KOOP_MPC_WINDOW +                  \
	 (size_t)(H) * (m) * ((size_t)(H) * (m) + 1u) / 2u + KOOP_MPC_GROUP * (KOOP_MPC_GROUP + 2u))
/* to be added to either if there is an input-rate penalty S */
#define KOOP_MPC_REALS_RATE(m, H) ((size_t)(m) * KOOP_MPC_PAD((H) * (m)))

/* Number of reals of the storage of a low-pass filter of n channels. */
#define KOOP_LOWPASS_REALS(n) (2u * (size_t)(n))

/* Number of bytes of a model that model_save() writes, with N lifted states and m inputs. */
#define KOOP_MODEL_HEADER_BYTES 24u
#define KOOPF_MODEL_BYTES(N, m) (KOOP_MODEL_HEADER_BYTES + 4u * (N) * ((N) + (m)))
#define KOOPD_MODEL_BYTES(N, m) (KOOP_MODEL_HEADER_BYTES + 8u * (N) * ((N) + (m)))

/* Number of bytes of a model that model_save_covariance() writes. The plain form with a regulator that needs
 * P^-1 (SIFt) takes KOOP_MODEL_TRIANGLE(d) reals more, and a regulator with memory takes the reals of that. */
#define KOOP_MODEL_TRIANGLE(d) ((d) * ((d) + 1u) / 2u)
#define KOOPF_MODEL_BYTES_P(N, m) (KOOPF_MODEL_BYTES(N, m) + 4u * KOOP_MODEL_TRIANGLE((N) + (m)))
#define KOOPD_MODEL_BYTES_P(N, m) (KOOPD_MODEL_BYTES(N, m) + 8u * KOOP_MODEL_TRIANGLE((N) + (m)))

#define KOOP_REAL float
#define KOOP(name) koopf_##name
#include "tinykoop_api.h"
#undef KOOP
#undef KOOP_REAL

#define KOOP_REAL double
#define KOOP(name) koopd_##name
#include "tinykoop_api.h"
#undef KOOP
#undef KOOP_REAL

#ifdef __cplusplus
}
#endif

#endif
