/* What the caller of lib/ has to set aside, from the macros of its headers. */
#include "message.h"
#include "tinykoop_supervisor.h"
#include "tinykoop_sim.h"

int tk_sizes(size_t N, size_t n, size_t m, size_t H, tk_storage *sizes) {
	if (!sizes) { return fail("sizes must be given"); }
	if (n < 1 || m < 1 || n > N || N > KOOP_MAX_DIM || m > KOOP_MAX_DIM || N + m > KOOP_MAX_DIM) {
		return fail(
		    "%zu lifted states, %zu states and %zu inputs do not fit: at least one state and one input, "
		    "no more states than lifted states, and %d lifted states and inputs at most",
		    N, n, m, KOOP_MAX_DIM);
	}
	if (H < 1 || H > KOOP_MPC_MAX_HORIZON) {
		return fail("a horizon of %zu steps does not fit: 1 to %d", H, KOOP_MPC_MAX_HORIZON);
	}
	*sizes = (tk_storage){
	    .learner_sqrt = KOOP_RLS_REALS_SQRT(N, m),
	    .learner_plain = KOOP_RLS_REALS_PLAIN(N, m),
	    .gate_sqrt = KOOP_GATE_REALS_SQRT(N, m),
	    .gate_plain = KOOP_GATE_REALS_PLAIN(N, m),
	    .mpc_newton = KOOP_MPC_REALS_NEWTON(N, n, m, H),
	    .mpc_gradient = KOOP_MPC_REALS_GRADIENT(N, n, m, H),
	    .mpc_rate = KOOP_MPC_REALS_RATE(m, H),
	    .supervisor = KOOP_SUPERVISOR_REALS(N, n, m, H),
	    .model = N * (N + m),
	};
	return TK_OK;
}
