/* TinyKoop in float32. Fewer gradient steps than by default: they bound the time of a plan. */
#define KOOP_MPC_MAX_GRADIENT 100

#include "../../../lib/koopf.c"
