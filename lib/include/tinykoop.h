/* TinyKoop: recursive Koopman learning for microcontrollers, in C99 without a heap.
 *
 * The lifted state psi = Psi(x) of a robot is predicted by a linear model
 *
 *     psi[k+1] = Theta * zeta[k],    Theta = [A B],    zeta = [psi; u],
 *
 * and Theta is learned while the robot runs, by recursive least squares whose
 * covariance P a regulator keeps healthy ("Covariance-Regulated Recursive
 * Koopman Learning", below called the paper).
 *
 * Sizes:  n  states,  N  lifted states,  m  inputs,  d = N + m  regressors.
 *
 * Every name exists twice, from one source: koopf_ works in float, koopd_ in
 * double, and both can be linked into one program. Compile lib/koopf.c,
 * lib/koopd.c, or both. In tinykoop_api.h, KOOP(name) stands for koopf_name or
 * koopd_name and KOOP_REAL for float or double.
 *
 * Every call checks what it is given and returns a status. A call that refuses
 * leaves what was learned bit for bit as it was.
 *
 * Same input, same bits: with any C compiler and optimisation level where float and
 * double are those of IEEE 754 and a * b + c is not contracted. GCC contracts unless
 * it gets -std=c99 or -ffp-contract=off, Clang unless it gets the latter; what is
 * learned then differs in the last digits, from machine to machine.
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

/* Largest N, m and N + m that are accepted: it bounds every loop. */
#define KOOP_MAX_DIM 255

/* What a call returns. Errors are negative. */
enum {
	KOOP_OK = 0,
	KOOP_E_NULL = -1,       /* a pointer that must be given is null */
	KOOP_E_SIZE = -2,       /* a dimension is zero or too large, or sizes do not agree */
	KOOP_E_STORAGE = -3,    /* the caller's storage is too small */
	KOOP_E_RANGE = -4,      /* a setting is outside its range */
	KOOP_E_INPUT = -5,      /* an input is NaN or infinite */
	KOOP_E_OVERFLOW = -6,   /* the result would not be finite in this precision */
	KOOP_E_INDEFINITE = -7, /* the covariance, or the controller's Hessian, would not be positive definite */
	KOOP_E_MODEL = -8,      /* a stored model is damaged or is of another kind */
	KOOP_E_OUTLIER = -9,    /* the gate: the innovation is far beyond its standard deviation */
	KOOP_E_MEMORY = -10,    /* bits have flipped in what was learned, more than can be mended */
	KOOP_E_ARITHMETIC = -11 /* the compiler's arithmetic is not that of IEEE 754: see self_test() */
};

/* What an update does about the positive definiteness of P.
 *
 * The plain form can lose it to round-off: the gain then points the wrong way
 * and the model is ruined within a few samples. The square-root form cannot,
 * so there the check costs nothing and the three settings are the same. */
enum {
	KOOP_CHECK_REFUSE = 0,  /* factor P at every update, refuse the sample that breaks it */
	KOOP_CHECK_REPORT = 1,  /* factor P, say so in the health, go on as the paper's recursion does */
	KOOP_CHECK_DIAGONAL = 2 /* refuse only on a diagonal element that is not positive; no factoring */
};

/* What gate_trust() answers. */
enum { KOOP_TRUSTED = 0, KOOP_DOUBTFUL = 1, KOOP_REFUSE = 2 };

/* Sums over words in memory, by which a flipped bit is found and mended. */
typedef struct koop_checksum {
	uint64_t words;  /* of the words */
	uint64_t places; /* of each word times its distance from the end */
} koop_checksum;

/* Number of reals of the caller's storage, for static arrays:
 *
 *     static float storage[KOOP_RLS_REALS_SQRT(22, 2)];
 *
 * SQRT suits the square-root form with any regulator, PLAIN the plain form
 * with any regulator and any check. rls_reals() gives the exact number, which
 * is smaller in the plain form without SIFt or with KOOP_CHECK_DIAGONAL. What is
 * symmetric or triangular is kept by half, in tiles of 4 x 4, but for the plain
 * form's P where there are vector registers to fill. */
#define KOOP_PAD(k) (((size_t)(k) + 3u) / 4u * 4u)
#define KOOP_TRIANGLE(d) (KOOP_PAD(d) * (KOOP_PAD(d) + 4u) / 2u)
#define KOOP_TRIANGLE_AT(i, j) /* where element (i, j) is, j <= i */                                         \
	((i) / 4u * ((i) / 4u + 1u) * 8u + (size_t)(j) / 4u * 16u + (i) % 4u * 4u + (j) % 4u)
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

/* Number of reals of a gate's storage, for N lifted states and m inputs. */
#define KOOP_GATE_REALS_SQRT(N, m) (KOOP_RLS_REALS_SQRT(N, m) + 3u * (size_t)(N))
#define KOOP_GATE_REALS_PLAIN(N, m) (KOOP_RLS_REALS_PLAIN(N, m) + 3u * (size_t)(N))

/* Model predictive control: bounds that are fixed at compile time, and so the
 * worst case: up to MAX_NEWTON steps with KOOP_MPC_NEWTON, up to MAX_GRADIENT with
 * KOOP_MPC_GRADIENT. Define the latter smaller where time is shorter. */
#define KOOP_MPC_MAX_HORIZON 1000
#define KOOP_MPC_MAX_INPUTS 65535 /* H m: the size of the storage then fits 32 bits */
#define KOOP_MPC_MAX_NEWTON 100
#ifndef KOOP_MPC_MAX_GRADIENT
#define KOOP_MPC_MAX_GRADIENT 5000
#endif

enum {
	KOOP_MPC_NEWTON = 0,  /* Newton steps on the free inputs: fastest */
	KOOP_MPC_GRADIENT = 1 /* accelerated projected gradient without a matrix: least memory */
};

/* Number of reals of the controller's storage, for N lifted states of which n
 * are tracked, m inputs and a horizon of H steps. */
#define KOOP_MPC_WINDOW 8u         /* arrays are padded to this */
#define KOOP_MPC_GROUP ((size_t)4) /* rows of the factor at a time */
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
/* to be added to either with an input-rate penalty S */
#define KOOP_MPC_REALS_RATE(m, H) ((size_t)(m) * KOOP_MPC_PAD((H) * (m)))

/* Number of reals of a low-pass of n channels. */
#define KOOP_LOWPASS_REALS(n) (2u * (size_t)(n))

/* Number of bytes of a stored model with N lifted states and m inputs. */
#define KOOP_MODEL_HEADER_BYTES 24u
#define KOOPF_MODEL_BYTES(N, m) (KOOP_MODEL_HEADER_BYTES + 4u * (N) * ((N) + (m)))
#define KOOPD_MODEL_BYTES(N, m) (KOOP_MODEL_HEADER_BYTES + 8u * (N) * ((N) + (m)))

/* With P. In the plain form with a regulator that needs P^-1 (SIFt), KOOP_MODEL_TRIANGLE(d) reals more. */
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
