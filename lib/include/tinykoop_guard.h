/* A guard (supervisor) for control with a model that is being learned. Optional: compile
 * lib/koopf_guard.c or lib/koopd_guard.c beside koopf.c or koopd.c.
 *
 * It compares the learned model with an offline model at every step, and lets the
 * controller plan on one of three models:
 *
 *     online     the learned model of this step
 *     last good  the learned model when it had last been trusted for a while; for a few steps
 *     offline    the model given at the start
 *
 * The guard leaves the online model in the step in which a check fails, and returns
 * slowly. It can be no better than the offline model, which must track the path by
 * itself: fit it over more headings and speeds than will be driven. The paper has no guard.
 *
 * Names, precisions and rules are those of tinykoop.h. */
#ifndef TINYKOOP_GUARD_H
#define TINYKOOP_GUARD_H

#include "tinykoop.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The model that the last input was planned on (guard.model). */
enum {
	KOOP_GUARD_ONLINE = 0,
	KOOP_GUARD_LAST_GOOD = 1,
	KOOP_GUARD_OFFLINE = 2,
	KOOP_GUARD_NONE = 3 /* no model gave a plan: the input is u_safe */
};

/* Number of reals of the guard's storage, for N lifted states of which n are
 * tracked, m inputs and a horizon of H steps. */
#define KOOP_GUARD_REALS(N, n, m, H)                                                                         \
	(2u * ((size_t)(N) + (m)) * KOOP_PAD(N) + ((size_t)(H) + 4u) * (n) * (m) + (n) + (m))

#define KOOP_REAL float
#define KOOP(name) koopf_##name
#include "tinykoop_guard_api.h"
#undef KOOP
#undef KOOP_REAL

#define KOOP_REAL double
#define KOOP(name) koopd_##name
#include "tinykoop_guard_api.h"
#undef KOOP
#undef KOOP_REAL

#ifdef __cplusplus
}
#endif

#endif
