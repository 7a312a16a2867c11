/* Both methods of the controller step by step, written a second time: on the dense quadratic program in wide
 * arithmetic, where every step solves its linear equations anew. Tolerances are wide, so that what a solve
 * ends with is the plan of some step on the way, and after how many. Limits, model and weights change between
 * solves as they do in use. */
#include "problem.h"

enum { FEW_N = 4, FEW_n = 3, FEW_m = 2, FEW_H = 6, LONG_H = 12, MOST = FEW_m * FEW_H };

static KOOP(mpc) mpc;
static real storage[KOOP_MPC_REALS_NEWTON(FEW_N, FEW_n, FEW_m, LONG_H) + KOOP_MPC_REALS_RATE(FEW_m, LONG_H)];

/* ---- The quadratic program ---------------------------------------------------------------------------- */

/* Half gradient of the cost: M u + b. Inputs in the order in which a step goes through them: forwards in
 * time, and of one time the last input first. */
typedef struct {
	size_t V;
	wide M[MOST][MOST], b[MOST], low[MOST], high[MOST];
	wide reach; /* of limits that are finite */
	int open;   /* a limit is not */
	wide tolerance;
} program;

/* Where input e of that order is in a plan of the header's order. */
static size_t place(const problem *p, size_t e) {
	return e / p->m * p->m + p->m - 1 - e % p->m;
}

static void write_limits(const problem *p, program *d) {
	d->reach = 0;
	d->open = 0;
	for (size_t e = 0; e < d->V; e++) {
		const wide low = p->low[place(p, e) % p->m], high = p->high[place(p, e) % p->m];
		const wide size = fmax(high - low, fmax(fabs(low), fabs(high)));
		d->low[e] = low;
		d->high[e] = high;
		d->open |= !(size <= REAL_MAX);
		if (size <= REAL_MAX && size > d->reach) { d->reach = size; }
	}
}

static void write_program(const problem *p, program *d) {
	real u[MOST] = {0};
	wide zero[MOST], unit[MOST];
	d->V = p->H * p->m;
	costate_gradient(p, u, zero);
	for (size_t e = 0; e < d->V; e++) {
		u[place(p, e)] = 1;
		costate_gradient(p, u, unit);
		u[place(p, e)] = 0;
		d->b[e] = zero[place(p, e)];
		for (size_t i = 0; i < d->V; i++) { d->M[i][e] = unit[place(p, i)] - zero[place(p, i)]; }
	}
	write_limits(p, d);
}

static wide clipped(const program *d, size_t e, wide v) {
	return v < d->low[e] ? d->low[e] : v > d->high[e] ? d->high[e] : v;
}

static void clip_plan(const program *d, wide *v) {
	for (size_t e = 0; e < d->V; e++) { v[e] = clipped(d, e, v[e]); }
}

static void multiply(const program *d, const wide *v, wide *out) {
	for (size_t i = 0; i < d->V; i++) {
		out[i] = 0;
		for (size_t e = 0; e < d->V; e++) { out[i] += d->M[i][e] * v[e]; }
	}
}

static void gradient_at(const program *d, const wide *v, wide *g) {
	multiply(d, v, g);
	for (size_t e = 0; e < d->V; e++) { g[e] += d->b[e]; }
}

static wide product(const program *d, const wide *a, const wide *b) {
	wide sum = 0;
	for (size_t e = 0; e < d->V; e++) { sum += a[e] * b[e]; }
	return sum;
}

/* What the header calls the residual. */
static wide residual_at(const program *d, const wide *v) {
	wide g[MOST], largest = 0;
	gradient_at(d, v, g);
	for (size_t e = 0; e < d->V; e++) {
		largest = fmax(largest, fabs(clipped(d, e, v[e] - g[e] / d->M[e][e]) - v[e]));
	}
	return largest;
}

/* Below it a residual can be all round-off. */
static wide noise_at(const program *d, const wide *v) {
	wide size = d->reach;
	for (size_t e = 0; d->open && e < d->V; e++) { size = fmax(size, fabs(v[e])); }
	return 128 * (wide)REAL_EPSILON * size;
}

/* How far v can go along a way inside the limits. */
static wide room_of(const program *d, const wide *v, const wide *way) {
	wide room = INFINITY;
	for (size_t e = 0; e < d->V; e++) {
		if (way[e] > 0) { room = fmin(room, (d->high[e] - v[e]) / way[e]); }
		if (way[e] < 0) { room = fmin(room, (d->low[e] - v[e]) / way[e]); }
	}
	return room;
}

/* x with A x = y over the inputs of `list`, by Gauss-Jordan elimination; A is positive definite. */
static void solve_equations(wide A[MOST][MOST], const wide *y, const size_t *list, size_t count, wide *x) {
	static wide work[MOST][MOST + 1];
	for (size_t i = 0; i < count; i++) {
		for (size_t k = 0; k < count; k++) { work[i][k] = A[list[i]][list[k]]; }
		work[i][count] = y[i];
	}
	for (size_t k = 0; k < count; k++) {
		for (size_t i = 0; i < count; i++) {
			const wide part = work[i][k] / work[k][k];
			for (size_t e = k; i != k && e <= count; e++) { work[i][e] -= part * work[k][e]; }
		}
	}
	for (size_t i = 0; i < count; i++) { x[i] = work[i][count] / work[i][i]; }
}

/* ---- The second writing's controller ------------------------------------------------------------------ */

enum { LEFT_BOUND, CUT_SHORT, CONJUGATE, REUSED, ABANDONED, UPHILL, STALE, FEW_DROPPED, EIGHT_DROPPED };
enum { PATHS = 9 };

typedef struct {
	program now;
	wide v[MOST], residual, noise;
	size_t iterations;
	/* the gradient method */
	wide steepest;
	/* Newton's: which limit holds an input (-1, 0, 1), the matrix that steps are made with, and whose inputs
	 * were free when it was taken */
	int held[MOST], known[MOST];
	wide old[MOST][MOST];
	int have, fresh, planned, whole;
	size_t paths[PATHS]; /* how often each of the less usual ways was gone */
} second;

/* ---- Modified proportioning with reduced gradient projections ----------------------------------------- */

/* Each input's way down: INSIDE the limits, LEAVING the one it is at, or HELD there. */
enum { INSIDE, LEAVING, HELD };

static int kind_of(const program *d, const wide *v, const wide *g, size_t e) {
	const int low = v[e] <= d->low[e], high = v[e] >= d->high[e];
	if ((low && g[e] > 0) || (high && g[e] < 0)) { return HELD; }
	return low || high ? LEAVING : INSIDE;
}

/* What steepest descent of one kind of inputs promises, each as far as its limit. */
static wide promise(const second *s, const wide *g, int kind) {
	const program *d = &s->now;
	wide sum = 0;
	for (size_t e = 0; e < d->V; e++) {
		if (kind_of(d, s->v, g, e) != kind) { continue; }
		const wide to = clipped(d, e, s->v[e] - g[e] / d->M[e][e] / s->steepest);
		sum += fabs(g[e]) * fabs(to - s->v[e]);
	}
	return sum;
}

/* The same where no step is cut short. */
static wide slope(const second *s, const wide *g, int kind) {
	wide sum = 0;
	for (size_t e = 0; e < s->now.V; e++) {
		if (kind_of(&s->now, s->v, g, e) == kind) { sum += g[e] * g[e] / s->now.M[e][e]; }
	}
	return sum;
}

static void steepest_way(const second *s, const wide *g, int kind, wide *way) {
	for (size_t e = 0; e < s->now.V; e++) {
		way[e] = kind_of(&s->now, s->v, g, e) == kind ? -g[e] / s->now.M[e][e] : 0;
	}
}

/* The way on, conjugate to the last: way' M (new way) = 0. */
static void conjugate_way(const second *s, const wide *g, wide *way) {
	const program *d = &s->now;
	wide down[MOST], bent[MOST];
	steepest_way(s, g, INSIDE, down);
	multiply(d, way, bent);
	const wide part = product(d, down, bent) / product(d, way, bent);
	for (size_t e = 0; e < d->V; e++) {
		way[e] = kind_of(d, s->v, g, e) == INSIDE ? down[e] - part * way[e] : 0;
	}
}

/* Largest eigenvalue seen of M scaled by its diagonal. */
static void see_steepness(second *s, const wide *way, const wide *bent) {
	wide square = 0;
	for (size_t e = 0; e < s->now.V; e++) { square += way[e] * way[e] * s->now.M[e][e]; }
	s->steepest = fmax(s->steepest, product(&s->now, way, bent) / square);
}

/* A gradient step of the inputs inside the limits, truncated by these. */
static void projected_step(second *s) {
	wide g[MOST], way[MOST];
	gradient_at(&s->now, s->v, g);
	steepest_way(s, g, INSIDE, way);
	for (size_t e = 0; e < s->now.V; e++) { s->v[e] += way[e] / s->steepest; }
	clip_plan(&s->now, s->v);
}

/* v + length way; what meets its limit there is at it, whatever rounding does. */
static void move(second *s, wide length, const wide *way) {
	const program *d = &s->now;
	for (size_t e = 0; e < d->V; e++) {
		const wide to = s->v[e] + length * way[e], size = fabs(to) + fabs(s->v[e]);
		s->v[e] = to;
		if (way[e] < 0 && to - d->low[e] <= (wide)1e-14 * size) { s->v[e] = d->low[e]; }
		if (way[e] > 0 && d->high[e] - to <= (wide)1e-14 * size) { s->v[e] = d->high[e]; }
	}
}

/* To the lowest point along the way, or the first limit. Returns whether no limit came first. */
static int step_along(second *s, const wide *way, int leaving) {
	const program *d = &s->now;
	wide g[MOST], bent[MOST];
	gradient_at(d, s->v, g);
	multiply(d, way, bent);
	see_steepness(s, way, bent);
	const wide room = room_of(d, s->v, way), wanted = -product(d, way, g) / product(d, way, bent);
	move(s, fmin(room, wanted), way);
	if (wanted > room && !leaving) { projected_step(s); }
	s->paths[CUT_SHORT] += wanted > room;
	return wanted <= room;
}

static void second_gradient(second *s) {
	wide g[MOST], way[MOST];
	int goes_on = 0;
	while (s->residual > s->now.tolerance && s->iterations < 99) { /* beyond, round-off is looked for */
		s->noise = noise_at(&s->now, s->v);
		gradient_at(&s->now, s->v, g);
		const int leaving = !goes_on && promise(s, g, LEAVING) > promise(s, g, INSIDE);
		if (goes_on) {
			conjugate_way(s, g, way);
		} else {
			steepest_way(s, g, leaving ? LEAVING : INSIDE, way);
		}
		goes_on = step_along(s, way, leaving) && !leaving;
		gradient_at(&s->now, s->v, g);
		goes_on = goes_on && slope(s, g, INSIDE) >= slope(s, g, LEAVING);
		s->residual = residual_at(&s->now, s->v);
		s->iterations++;
		s->paths[LEFT_BOUND] += leaving ? 1 : 0;
		s->paths[CONJUGATE] += goes_on ? 1 : 0;
	}
}

/* ---- Bertsekas' projected Newton method --------------------------------------------------------------- */

/* Which limit holds an input against the way down, if any; both at once: the upper one, unless it is to go
 * down. */
static int holder(const program *d, const wide *v, const wide *slope_down, size_t e) {
	if (v[e] >= d->high[e] && slope_down[e] <= 0) { return 1; }
	return v[e] <= d->low[e] && slope_down[e] >= 0 ? -1 : 0;
}

/* Returns whether others are free than before. The matrix stays where no more than eight are no longer free,
 * and none is anew. */
static int choose_free(second *s, const wide *slope_down) {
	int dropped = 0, back = 0, held[MOST];
	for (size_t e = 0; e < s->now.V; e++) {
		held[e] = holder(&s->now, s->v, slope_down, e);
		dropped += !s->held[e] && held[e];
		back += s->held[e] && !held[e];
	}
	if (!dropped && !back) { return 0; }
	if (back || dropped > 8) {
		s->have = 0;
	} else {
		s->paths[FEW_DROPPED] += (size_t)s->have;
		s->paths[EIGHT_DROPPED] += s->have && dropped == 8;
	}
	memcpy(s->held, held, sizeof held);
	return 1;
}

static void take_matrix(second *s) {
	if (s->have) { return; }
	memcpy(s->old, s->now.M, sizeof s->old);
	for (size_t e = 0; e < s->now.V; e++) { s->known[e] = s->held[e] == 0; }
	s->have = s->fresh = 1;
}

/* Of what the free inputs from `list` on would do together, what the first of them does, when those before
 * have moved by `moved`. */
static wide first_of_rest(second *s, const wide *g, const wide *moved, const size_t *list, size_t count) {
	wide y[MOST], x[MOST];
	for (size_t i = 0; i < count; i++) {
		y[i] = -g[list[i]];
		for (size_t e = 0; e < list[0]; e++) { y[i] -= s->old[list[i]][e] * moved[e]; }
	}
	solve_equations(s->old, y, list, count, x);
	return x[0];
}

/* Free inputs one after the other go to where they are best with all that follow; one that meets its limit
 * stays there, and those that follow make the best of it. Returns whether none did. */
static int newton_trial(second *s, int in_box, wide *trial) {
	wide g[MOST], moved[MOST] = {0};
	size_t list[MOST], count = 0;
	int inside = 1;
	gradient_at(&s->now, s->v, g);
	for (size_t e = 0; e < s->now.V; e++) {
		trial[e] = s->v[e];
		if (s->held[e] == 0) { list[count++] = e; }
	}
	for (size_t i = 0; i < count; i++) {
		const size_t e = list[i];
		const wide to = s->v[e] + first_of_rest(s, g, moved, list + i, count - i);
		trial[e] = in_box ? clipped(&s->now, e, to) : to;
		moved[e] = trial[e] - s->v[e];
		inside = inside && trial[e] >= to && trial[e] <= to;
	}
	return inside;
}

/* Cost of b less that of a. */
static wide rise(const second *s, const wide *a, const wide *b) {
	wide g[MOST], h[MOST], sum = 0;
	gradient_at(&s->now, a, g);
	gradient_at(&s->now, b, h);
	for (size_t e = 0; e < s->now.V; e++) { sum += (b[e] - a[e]) * (g[e] + h[e]); }
	return sum;
}

/* The largest scaled gradient of the free inputs. */
static wide free_gradient(const second *s, const wide *v) {
	wide g[MOST], largest = 0;
	gradient_at(&s->now, v, g);
	for (size_t e = 0; e < s->now.V; e++) {
		if (s->held[e] == 0) { largest = fmax(largest, fabs(g[e] / s->now.M[e][e])); }
	}
	return largest;
}

/* A way down for some length: Newton's, of inputs that it does not press against a limit. */
static void find_way(second *s, wide *way) {
	wide trial[MOST], back[MOST];
	do {
		take_matrix(s);
		(void)newton_trial(s, 0, trial);
		for (size_t e = 0; e < s->now.V; e++) {
			way[e] = trial[e] - s->v[e];
			back[e] = -way[e];
		}
	} while (choose_free(s, back));
}

/* Along the way, truncated by the limits: all of it, a quarter and so on, until that goes down; at last only to
 * the first limit. Returns whether it goes down. */
static int go_down(second *s, const wide *way) {
	const wide least = fmin(1, room_of(&s->now, s->v, way)) * (1 + 4 * (wide)REAL_EPSILON);
	wide trial[MOST] = {0};
	for (wide length = 1;; length = length > (wide)0.05 ? fmax(length / 4, least) : least) {
		for (size_t e = 0; e < s->now.V; e++) { trial[e] = s->v[e] + length * way[e]; }
		clip_plan(&s->now, trial);
		if (length <= least || rise(s, s->v, trial) < 0) { break; }
	}
	if (!(rise(s, s->v, trial) < 0)) { return 0; }
	memcpy(s->v, trial, sizeof trial);
	return 1;
}

/* A matrix of an earlier solve stays while two more steps as good as this one would do. */
static void review_matrix(second *s, const wide *trial, int down) {
	const wide before = free_gradient(s, s->v), after = free_gradient(s, trial), part = after / before;
	if (s->fresh) { return; }
	if (!(down && after * part * part <= s->now.tolerance)) { s->have = 0; }
	s->paths[s->have ? REUSED : ABANDONED]++;
}

/* What is left is round-off: one step more, which is not looked at unless it goes far. */
static void correct(second *s, const wide *trial) {
	wide farthest = 0;
	for (size_t e = 0; e < s->now.V; e++) { farthest = fmax(farthest, fabs(trial[e] - s->v[e])); }
	if (farthest < s->noise || residual_at(&s->now, trial) < s->residual) {
		memcpy(s->v, trial, sizeof s->v);
	}
}

/* Returns whether to go on. `again`: over the same free inputs as the step before, which no limit cut short,
 * so that what it has left is round-off. */
static int settle(second *s, const wide *trial, wide residual, int down, int again) {
	int goes_on = !again || residual < s->residual / 2;
	if (!goes_on && !(residual < s->residual)) { return 0; }
	if (down) {
		memcpy(s->v, trial, sizeof s->v);
	} else {
		wide way[MOST];
		s->paths[UPHILL]++;
		find_way(s, way);
		goes_on = go_down(s, way);
	}
	s->residual = residual_at(&s->now, s->v);
	return goes_on;
}

static int newton_once(second *s) {
	wide trial[MOST] = {0}, g[MOST];
	s->noise = noise_at(&s->now, s->v);
	const int guessed = s->planned; /* what held the last plan holds this one */
	gradient_at(&s->now, s->v, g);
	s->planned = 0;
	const int again = !guessed && !choose_free(s, g) && s->whole;
	take_matrix(s);
	s->whole = newton_trial(s, 1, trial) && s->fresh;
	if (again && s->residual < s->noise) {
		correct(s, trial);
		return 0;
	}
	const wide residual = residual_at(&s->now, trial);
	const int better = residual < s->residual && (again || residual < s->noise);
	const int down = rise(s, s->v, trial) < 0 || better;
	s->whole = s->whole && down;
	const int was_fresh = s->fresh;
	review_matrix(s, trial, down);
	s->paths[STALE] += !down && !guessed && !was_fresh;
	return !down && (guessed || !was_fresh) ? 1 : settle(s, trial, residual, down, again);
}

static void second_newton(second *s) {
	int goes_on = 1;
	s->whole = 0;
	while (goes_on && s->residual > s->now.tolerance && s->iterations < KOOP_MPC_MAX_NEWTON) {
		s->iterations++;
		goes_on = newton_once(s);
	}
}

/* ---- From one solve to the next ----------------------------------------------------------------------- */

/* An input that a limit holds goes along with it, or is free where there no longer is one. */
static void follow_limits(second *s, size_t e) {
	const wide limit = s->held[e] > 0 ? s->now.high[e] : s->now.low[e];
	if (s->held[e] && fabs(limit) <= REAL_MAX) {
		s->v[e] = limit;
	} else if (s->held[e]) {
		s->held[e] = 0;
		s->known[e] = 1;
	}
	s->v[e] = clipped(&s->now, e, s->v[e]);
}

/* The last plan a step later, its last step twice. */
static void shift(second *s, size_t m) {
	const second was = *s;
	for (size_t e = 0; e < s->now.V; e++) {
		const size_t from = e + m < s->now.V ? e + m : e;
		s->v[e] = was.v[from];
		s->held[e] = was.held[from];
		s->known[e] = was.known[from];
		follow_limits(s, e);
		if (s->held[e] != was.held[e] || s->known[e] != was.known[e]) { s->have = 0; }
	}
}

static void second_reset(second *s, const problem *p) {
	memset(s, 0, sizeof *s);
	s->steepest = 1;
	for (size_t e = 0; e < p->H * p->m; e++) {
		s->v[e] = p->safe[place(p, e) % p->m];
		s->known[e] = 1;
	}
}

static void second_solve(second *s, const problem *p, wide tolerance, int method) {
	write_program(p, &s->now);
	s->now.tolerance = tolerance;
	shift(s, p->m);
	s->fresh = 0;
	s->iterations = 0;
	s->residual = residual_at(&s->now, s->v);
	if (method == KOOP_MPC_NEWTON) {
		second_newton(s);
	} else {
		second_gradient(s);
	}
	s->planned = 1;
}

/* ---- Random problems ---------------------------------------------------------------------------------- */

/* M = L L' + floor I */
static void random_weight(random_source *random, real *M, size_t n, double size, double floor) {
	real L[MOST_n * MOST_n];
	random_fill(random, L, n * n, -1, 1);
	for (size_t i = 0; i < n * n; i++) {
		wide sum = i % (n + 1) ? 0 : (wide)floor;
		for (size_t k = 0; k < n; k++) { sum += (wide)L[i / n * n + k] * L[i % n * n + k]; }
		M[i] = (real)((wide)size * sum);
	}
}

/* Limits about 0, or both on one side of it; one input may have none, or such as are far beyond what it
 * needs, so that all that is left is below what round-off could be: at the start only, as an input that is
 * held goes along with its limit. */
static void random_limits(random_source *random, problem *p, double box, int start) {
	for (size_t j = 0; j < p->m; j++) {
		p->low[j] = -(real)box * random_uniform(random, 0.05, 1);
		p->high[j] = (real)box * random_uniform(random, 0.05, 1);
	}
	const size_t j = random_below(random, p->m), kind = random_below(random, 8);
	const double size = start ? decades(random, -3, 0) / (128 * (double)REAL_EPSILON) : 4;
	const real far = (real)(box * size);
	if (kind < 2) { p->high[j] = kind ? (real)INFINITY : far; }
	if (kind > 0 && kind < 4) { p->low[j] = kind < 3 ? -(real)INFINITY : -far; }
	for (size_t i = 0; kind > 5 && i < p->m; i++) {
		const real aside = (real)(kind == 6 ? box : -box);
		p->low[i] += aside;
		p->high[i] += aside;
	}
}

/* `hard`: how much the states count against the inputs. */
static void few_inputs(random_source *random, problem *p, size_t m, size_t H, double hard) {
	memset(p, 0, sizeof *p);
	p->m = m;
	p->H = H;
	p->N = 1 + random_below(random, FEW_N);
	p->n = 1 + random_below(random, p->N < FEW_n ? p->N : FEW_n);
	p->rate = random_below(random, 2) == 0;
	const double size = 1.4 / sqrt((double)p->N);
	for (size_t j = 0; j < p->N + p->m; j++) {
		random_fill(random, p->theta + j * KOOP_PAD(p->N), p->N, j < p->N ? -size : -1, j < p->N ? size : 1);
	}
	random_weight(random, p->Q, p->n, hard, 0);
	random_weight(random, p->R, p->m, decades(random, -3, 0), 0.01);
	random_weight(random, p->S, p->m, decades(random, -1.5, 0), 0);
	random_limits(random, p, H > FEW_H ? 0.3 : decades(random, -1, 1), 1);
	for (size_t j = 0; j < p->m; j++) {
		const real safe = random_uniform(random, -1, 1);
		p->safe[j] = safe < p->low[j] ? p->low[j] : safe > p->high[j] ? p->high[j] : safe;
	}
	random_fill(random, p->psi, p->N, -2, 2);
	random_fill(random, p->reference, p->H * p->n, -2, 2);
	random_fill(random, p->before, p->m, -1, 1);
}

/* A little later: the model is learned, the state has moved; sometimes limits and weights are others. */
static void go_on_a_little(random_source *random, problem *p, double change) {
	for (size_t i = 0; i < (p->N + p->m) * KOOP_PAD(p->N); i++) {
		p->theta[i] *= (real)(1 + change * (double)random_uniform(random, -1, 1));
	}
	for (size_t i = 0; i < p->N; i++) {
		p->psi[i] *= (real)(1 + 10 * change * (double)random_uniform(random, -1, 1));
	}
	if (random_below(random, 4) == 0) { random_limits(random, p, 1, 0); }
	if (random_below(random, 8) == 0) { random_weight(random, p->R, p->m, 1, 0.3); }
	if (random_below(random, 8) == 0) { random_fill(random, p->reference, p->H * p->n, -2, 2); }
	if (random_below(random, 16) == 0) { random_fill(random, p->psi, p->N, -2, 2); }
}

/* ---- Side by side ------------------------------------------------------------------------------------- */

static int is_near(wide a, wide b, wide size) {
	return fabs(a - b) <= (TEST_DOUBLE ? (wide)1e-9 : (wide)2e-4) * (1 + size);
}

static int sign_of(int x) {
	return (x > 0) - (x < 0);
}

/* Whether the controller has the same plan, held by the same limits. */
static int same_plan(const second *s) {
	for (size_t e = 0; e < s->now.V; e++) {
		const size_t q = s->now.V - 1 - e; /* kept last input first */
		if (!is_near(mpc.plan[q], s->v[e], fabs(s->v[e]))) { return 0; }
		if (mpc.config.method == KOOP_MPC_NEWTON && sign_of(mpc.set[q]) != s->held[e]) { return 0; }
	}
	return 1;
}

static int same_factor(const second *s) {
	size_t rows = 0;
	for (size_t e = 0; e < s->now.V; e++) { rows += s->known[e] != 0; }
	return mpc.factored == s->have && (!s->have || (mpc.n_free == rows && mpc.fresh == s->fresh));
}

static int same_sizes(const second *s) {
	const wide noise = s->noise / REAL_EPSILON;
	if (s->iterations > 0 && !is_near(mpc.noise / REAL_EPSILON, noise, noise)) { return 0; }
	return is_near(mpc.reach, s->now.reach, s->now.reach) && mpc.unlimited == s->now.open && mpc.planned == 1;
}

/* What was taken over for this solve is still that, bit for bit. */
static int same_limits(const problem *p) {
	const size_t size = p->m * sizeof(real);
	if (p->rate && memcmp(mpc.u_before, p->before, size) != 0) { return 0; }
	return memcmp(mpc.u_min, p->low, size) == 0 && memcmp(mpc.u_max, p->high, size) == 0;
}

static int same_solve(const second *s, const KOOP(mpc_result) *result) {
	const int newton = mpc.config.method == KOOP_MPC_NEWTON;
	if (result->iterations != s->iterations) { return 0; }
	if (!is_near(result->residual, s->residual, s->residual)) { return 0; }
	if (!same_plan(s) || !same_sizes(s)) { return 0; }
	return newton ? same_factor(s) : is_near(mpc.max_eigenvalue, s->steepest, s->steepest);
}

typedef struct {
	size_t solves, steps, others, paths[PATHS];
	size_t others_up;    /* other where Newton's step led up */
	size_t others_eight; /* where a factor lost eight rows at once */
	size_t others_stale; /* where one with the matrix of an earlier solve did */
} tally;

/* Warm solves of one problem, until the two part: at a tie, rounding decides. */
static void run_beside(random_source *random, problem *p, int method, tally *seen) {
	static second s;
	const real tolerance = (real)decades(random, TEST_DOUBLE ? -7 : -3, -0.5);
	const double change = decades(random, -5, -0.5);
	const KOOP(mpc_config) config = problem_settings(p, tolerance, method);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	second_reset(&s, p);
	for (int k = 0, same = 1; k < 12 && same; k++) {
		KOOP(mpc_result) result;
		real u[FEW_m];
		const size_t up = s.paths[UPHILL], stale = s.paths[STALE];
		const size_t eight = s.paths[EIGHT_DROPPED];
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, &result));
		second_solve(&s, p, tolerance, method);
		same = same_solve(&s, &result);
		TEST_ASSERT_TRUE(same_limits(p));
		seen->solves++;
		seen->steps += s.iterations;
		seen->others += !same;
		seen->others_up += !same && s.paths[UPHILL] > up;
		seen->others_eight += !same && s.paths[EIGHT_DROPPED] > eight;
		seen->others_stale += !same && s.paths[STALE] > stale;
		for (size_t e = 0; e < s.now.V; e++) { s.v[e] = mpc.plan[s.now.V - 1 - e]; } /* no rounding adds up */
		memcpy(p->before, u, p->m * sizeof *u);
		go_on_a_little(random, p, change);
	}
	for (size_t i = 0; i < PATHS; i++) { seen->paths[i] += s.paths[i]; }
}

/* A tie in a few of a thousand solves. */
static void check_tally(const tally *seen) {
	CHECK(seen->others <= 2 + seen->solves / 400, "%zu of %zu solves are others", seen->others, seen->solves);
}

static void run_all_sizes(uint64_t seed, int method, tally *seen) {
	random_source random = random_seed(seed);
	for (int i = 0; i < 400 / TEST_SHARE; i++) {
		problem p;
		const size_t horizon = 1 + random_below(&random, FEW_H); /* draws in one call have no order */
		const size_t inputs = 1 + random_below(&random, FEW_m);
		few_inputs(&random, &p, inputs, horizon, method == KOOP_MPC_NEWTON ? 10 : 0.3);
		run_beside(&random, &p, method, seen);
	}
	check_tally(seen);
}

/* Long plans, of which many inputs meet a limit in one step: a factor loses up to eight of its rows. */
static void run_long_plans(uint64_t seed, tally *seen) {
	random_source random = random_seed(seed);
	for (int i = 0; i < 100 / TEST_SHARE; i++) {
		problem p;
		few_inputs(&random, &p, 1, LONG_H, 1);
		run_beside(&random, &p, KOOP_MPC_NEWTON, seen);
	}
	check_tally(seen);
}

/* Eight inputs, so that one array begins where the other ends. */
static void run_without_padding(uint64_t seed, int method) {
	random_source random = random_seed(seed);
	tally seen = {0, 0, 0, {0}, 0, 0, 0};
	for (int i = 0; i < 100 / TEST_SHARE; i++) {
		problem p;
		few_inputs(&random, &p, 2, 4, method == KOOP_MPC_NEWTON ? 10 : 0.3);
		run_beside(&random, &p, method, &seen);
	}
	check_tally(&seen);
}

static void test_gradient_steps_are_those_of_the_second_writing(void) {
	tally seen = {0, 0, 0, {0}, 0, 0, 0};
	run_all_sizes(61, KOOP_MPC_GRADIENT, &seen);
	run_without_padding(63, KOOP_MPC_GRADIENT);
	printf("%zu solves, %zu steps, %zu others; %zu ways left a limit, %zu met one, %zu were conjugate\n",
	       seen.solves, seen.steps, seen.others, seen.paths[LEFT_BOUND], seen.paths[CUT_SHORT],
	       seen.paths[CONJUGATE]);
	for (int i = LEFT_BOUND; i <= CONJUGATE; i++) { TEST_ASSERT_TRUE(seen.paths[i] > 100 / TEST_SHARE); }
}

static void test_newton_steps_are_those_of_the_second_writing(void) {
	tally seen = {0, 0, 0, {0}, 0, 0, 0};
	run_all_sizes(62, KOOP_MPC_NEWTON, &seen);
	run_without_padding(64, KOOP_MPC_NEWTON);
	run_long_plans(65, &seen);
	printf("%zu solves, %zu steps, %zu others; %zu ways up, %zu others\n", seen.solves, seen.steps,
	       seen.others, seen.paths[UPHILL], seen.others_up);
	printf("%zu factors used again, %zu given up, %zu lost rows, %zu eight, %zu stale\n", seen.paths[REUSED],
	       seen.paths[ABANDONED], seen.paths[FEW_DROPPED], seen.paths[EIGHT_DROPPED], seen.paths[STALE]);
	TEST_ASSERT_TRUE(seen.paths[REUSED] > 100 / TEST_SHARE && seen.paths[ABANDONED] > 100 / TEST_SHARE);
	TEST_ASSERT_TRUE(seen.paths[FEW_DROPPED] > 100 / TEST_SHARE && seen.paths[UPHILL] > 5 / TEST_SHARE);
	TEST_ASSERT_TRUE((int)seen.paths[EIGHT_DROPPED] >= 5 / TEST_SHARE);
	CHECK(seen.others_eight <= seen.paths[EIGHT_DROPPED] / 4, "%zu others", seen.others_eight);
	TEST_ASSERT_TRUE((int)seen.paths[STALE] >= 4 / TEST_SHARE);
	CHECK(seen.others_stale <= seen.paths[STALE] / 4, "%zu of %zu", seen.others_stale, seen.paths[STALE]);
	CHECK(seen.others_up <= 1 + seen.paths[UPHILL] / 40, "%zu others", seen.others_up);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_gradient_steps_are_those_of_the_second_writing);
	RUN_TEST(test_newton_steps_are_those_of_the_second_writing);
	return UNITY_END();
}
