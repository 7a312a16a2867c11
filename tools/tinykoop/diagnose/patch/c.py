"""A C99 function that does to the commands of a drive what the effects do, step by step, for a simulator in C."""

from . import snippet

# In the order in which they act (host_sim/effects.c). What is remembered from step to step is in `past`.
LINES = {
    "saturation": "executed_limited(&u[0], {v_max!r}); executed_limited(&u[1], {w_max!r});",
    "transport_delay": "if (executed_delayed(&past->delay, u, {delay!r} / dt)) {{ return -1; }}",
    "dead_band": "executed_dead(&u[0], {v_db!r}); executed_dead(&u[1], {w_db!r});",
    "actuator_lag": "executed_lagged(&past->lag, u, dt / {tau!r});",
    "speed_gain": "u[0] *= 1 + {a!r};",
    "yaw_gain": "u[1] *= 1 + {b!r};",
    "wheel_asymmetry": "u[1] += {c!r} * u[0];",
    "yaw_bias": "u[1] += {d!r};",
}
HELPERS = {
    "executed_limited": """/* Limited to +-largest; 0: no limit. */
static void executed_limited(double *u, double largest) {
	if (largest > 0) { *u = fmax(-largest, fmin(largest, *u)); }
}
""",
    "executed_delayed": """/* The mean over the step of the commands as they were so many steps before; the first one was already held. */
static int executed_delayed(struct executed_delay *past, double u[2], double steps) {
	if (!(steps < EXECUTED_STEPS - 1)) { return -1; }
	const unsigned long whole = (unsigned long)steps, count = past->count++;
	const double part = steps - (double)whole;
	for (int i = 0; i < 2; i++) {
		past->ring[count % EXECUTED_STEPS][i] = u[i];
		const double newer = past->ring[(count > whole ? count - whole : 0) % EXECUTED_STEPS][i];
		const double older = past->ring[(count > whole ? count - whole - 1 : 0) % EXECUTED_STEPS][i];
		u[i] = (1 - part) * newer + part * older;
	}
	return 0;
}
""",
    "executed_dead": """/* Smaller commands do nothing. */
static void executed_dead(double *u, double band) {
	if (fabs(*u) < band) { *u = 0; }
}
""",
    "executed_lagged": """/* The mean over the step of the command behind a first-order lag, which begins at rest. */
static void executed_lagged(struct executed_lag *past, double u[2], double steps) {
	const double gone = -expm1(-steps);
	for (int i = 0; i < 2; i++) {
		if (!past->begun) { past->state[i] = u[i]; }
		const double behind = past->state[i] - u[i];
		u[i] += behind * gone / steps;
		past->state[i] -= behind * gone;
	}
	past->begun = 1;
}
""",
}
STATES = {
    "executed_delayed": """enum { EXECUTED_STEPS = 1024 }; /* of the delay at most */
struct executed_delay {
	unsigned long count;
	double ring[EXECUTED_STEPS][2];
};
""",
    "executed_lagged": """struct executed_lag {
	int begun;
	double state[2];
};
""",
}
MEMBERS = {"executed_delayed": "\tstruct executed_delay delay;", "executed_lagged": "\tstruct executed_lag lag;"}
FUNCTION = """/* Command of one step of dt seconds as this robot executes it. Found by tinykoop diagnose.
 * u: v (m/s) and omega (rad/s), changed in place. past: all zero before the first step. 0, or -1 where the delay has more steps than EXECUTED_STEPS. */
int executed(struct executed *past, double u[2], double dt) {{
{body}
	return 0;
}}
"""


def patched(text, report, path):
    lines = snippet.lines(LINES, report, path)
    members = snippet.needed(MEMBERS, lines) or ["\tint nothing; /* is remembered */"]
    state = "\n".join(["struct executed {", *members, "};", ""])
    unused = [f"(void){name};" for name in ("past", "dt") if not any(name in line for line in lines)]
    function = FUNCTION.format(body="\n".join(f"\t{line}" for line in (*unused, *lines)))
    parts = ["#include <math.h>\n", *snippet.needed(STATES, lines), state, *snippet.needed(HELPERS, lines), function]
    return text + ("\n" if text else "") + "\n".join(parts)
