/* A supervisor for control with a model that is being learned. Optional: compile
 * lib/koopf_supervisor.c or lib/koopd_supervisor.c beside koopf.c or koopd.c.
 *
 * It compares the learned model with an offline model at every step, and lets the
 * controller plan on one of three models:
 *
 *     online     the learned model of this step
 *     last good  the last learned model that was trusted for many steps; it is used for a few steps
 *     offline    the model given to supervisor_init()
 *
 * The supervisor leaves the online model in the step in which a check fails, and returns to it
 * after a waiting time. It can be no better than the offline model, which must be able to track the
 * path alone: fit it over more headings and speeds than will be driven. The paper has no supervisor.
 *
 * Names, precisions and rules are those of tinykoop.h. */
#ifndef TINYKOOP_SUPERVISOR_H
#define TINYKOOP_SUPERVISOR_H

#include "tinykoop.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The model that the last input was planned on (supervisor.model). */
enum {
	KOOP_SUPERVISOR_ONLINE = 0,
	KOOP_SUPERVISOR_LAST_GOOD = 1,
	KOOP_SUPERVISOR_OFFLINE = 2,
	KOOP_SUPERVISOR_NONE = 3 /* no model gave a plan: the input is u_safe */
};

/* Number of reals of the supervisor's storage, for N lifted states of which n are
 * tracked, m inputs and a horizon of H steps. */
#define KOOP_SUPERVISOR_REALS(N, n, m, H)                                                                    \
	(2u * ((size_t)(N) + (m)) * KOOP_PAD(N) + ((size_t)(H) + 4u) * (n) * (m) + (n) + (m))

#define KOOP_REAL float
#define KOOP(name) koopf_##name
#include "tinykoop_supervisor_api.h"
#undef KOOP
#undef KOOP_REAL

#define KOOP_REAL double
#define KOOP(name) koopd_##name
#include "tinykoop_supervisor_api.h"
#undef KOOP
#undef KOOP_REAL

#ifdef __cplusplus
}
#endif

#endif
