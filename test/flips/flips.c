/* One flipped bit in what a learner, its gate, its supervisor and its controller keep, between two calls,
 * beside a twin of which none flips. A JSON line for each part of the storage.
 *
 *     flips_koopf USE REGULATOR FORM CHECK TRIALS SEED
 *
 * TRIALS of each part: word after word from any one on, any bit of it, at any time of a run.
 *
 * Each trial is one of:
 *     detected  within WATCHED samples a status, the health, gate_trust(), rls.repaired or the supervisor was
 * worse than the twin's at the same sample harmless  none was, and after WATCHED samples the model predicts
 * samples that it has not seen with at most AS_GOOD times the twin's mean square error; both hold the noise
 * of the sensors. In a closed loop the cost of these samples, too, is at most AS_GOOD times the twin's, and
 * no input was unsafe. Errors inside the dead zone count for none, as nothing is to be learned there. silent
 * neither Beside that: for_ever, where LASTING samples after the flip the sample or the plan was refused,
 * gate_trust() said so, or the online model was not planned on, and so it went on for as many more, but not
 * with the twin; unsafe, where an input was not finite or outside its limits, whatever was reported. */
#include "world.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

enum {
	WATCHED = 100,
	LASTING = 3000,
	LONGEST_RUN = 3000, /* samples from a start to the last flip */
	LONGEST_PAUSE = 300,
	LEARNING = 1000,
	AREAS = 32
};

static const double AS_GOOD = 1.1;

/* ---- Where bits flip ------------------------------------------------------------------------- */

enum { WORD = 4 }; /* bytes */

typedef struct {
	const char *what;
	unsigned char *at;
	size_t words, next; /* the word of the next trial */
	unsigned long trials, detected, harmless, silent, for_ever, unsafe;
	size_t word, bit, time; /* of the first trial that was silent, refused forever or unsafe */
} area;

typedef struct {
	area areas[AREAS];
	size_t count;
} list;

static void add_bytes(list *l, const char *what, void *at, size_t bytes) {
	if (bytes == 0) { return; }
	if (l->count == AREAS) { fatal("AREAS is too small"); }
	l->areas[l->count++] = (area){.what = what, .at = at, .words = bytes / WORD};
}

static void add(list *l, const char *what, real *from, const real *end) {
	add_bytes(l, what, from, (size_t)(end - from) * sizeof *from);
}

/* The fields of a structure from one to another, without the latter. */
static void add_fields(list *l, const char *what, void *of, size_t from, size_t to) {
	add_bytes(l, what, (unsigned char *)of + from, to - from);
}

static void list_learner(list *l, KOOP(rls) *rls, const real *end, const char *const names[6]) {
	add(l, names[0], rls->theta, rls->covariance);
	add(l, names[1], rls->covariance, rls->zeta);
	add(l, names[2], rls->zeta, end);
	add_fields(l, names[3], rls, offsetof(KOOP(rls), covariance_scale), offsetof(KOOP(rls), positive_definite));
	add_fields(l, names[4], rls, offsetof(KOOP(rls), sum), offsetof(KOOP(rls), repaired));
	add_fields(l, names[5], rls, offsetof(KOOP(rls), positive_definite), offsetof(KOOP(rls), short_memory));
}

static void list_control(list *l, world *w) {
	KOOP(supervisor) *supervisor = &w->supervisor;
	KOOP(mpc) *mpc = &w->mpc;
	real *end = w->mpc_storage + sizeof w->mpc_storage / sizeof *w->mpc_storage;
	add(l, "supervisor's models", supervisor->offline, supervisor->now);
	add(l, "supervisor's scratch", supervisor->now, supervisor->target);
	add(l, "supervisor's target", supervisor->target, supervisor->target + TRACKED);
	add_fields(l, "supervisor's checksum", supervisor, offsetof(KOOP(supervisor), sum), sizeof *supervisor);
	add_fields(l, "supervisor's state", supervisor, offsetof(KOOP(supervisor), error),
	           offsetof(KOOP(supervisor), sum));
	add(l, "controller's model", mpc->markov, mpc->plan);
	add(l, "controller's plan", mpc->plan, mpc->gradient);
	add(l, "controller's vectors", mpc->gradient, (real *)(void *)mpc->set);
	add(l, "controller's set", (real *)(void *)mpc->set, mpc->u_before);
	add(l, "controller's limits, roots", mpc->u_before, mpc->work);
	add(l, "controller's scratch, factor", mpc->work, end);
	add_fields(l, "controller's state", mpc, offsetof(KOOP(mpc), max_eigenvalue), sizeof *mpc);
}

static void list_all(list *l, world *w) {
	static const char *const own[] = {"Theta", "P", "scratch", "scale, bounds", "checksum", "flags"};
	static const char *const saved[] = {"gate's Theta", "gate's P", "gate's scratch", "gate's scale, bounds",
	                                    "gate's checksum of it", "gate's flags of it"};
	const real *end = w->storage + sizeof w->storage / sizeof *w->storage;
	memset(l, 0, sizeof *l);
	list_learner(l, &w->rls, end, own);
	if (w->use != ALONE && w->use != CHECKSUM) {
		list_learner(l, &w->gate.saved, w->gate.variance, saved);
		add(l, "gate's statistics", w->gate.variance, w->gate.previous_variance + w->rls.n_lifted);
		add_fields(l, "gate's checksum", &w->gate, offsetof(KOOP(gate), sum), sizeof w->gate);
		add_fields(l, "gate's state", &w->gate, offsetof(KOOP(gate), warm_up), offsetof(KOOP(gate), sum));
	}
	if (w->closed) { list_control(l, w); }
}

/* ---- One trial ------------------------------------------------------------------------------- */

/* What the samples after a flip showed. */
typedef struct {
	report seen[WATCHED];
	double cost, error;
	int unsafe;
} course;

static void watch(world *w, course *c) {
	c->cost = 0;
	c->unsafe = 0;
	for (size_t k = 0; k < WATCHED; k++) {
		c->seen[k] = world_step(w);
		c->cost += c->seen[k].cost;
		c->unsafe |= c->seen[k].unsafe;
	}
}

static int is_worse(const report *r, const report *twin) {
	const int statuses = (r->learned && !twin->learned) || (r->controlled && !twin->controlled);
	const int judged = r->trust > twin->trust || r->model > twin->model || r->unhealthy > twin->unhealthy;
	return statuses || judged || r->repaired > twin->repaired || r->resets > twin->resets;
}

static int is_detected(const course *c, const course *twin) {
	for (size_t k = 0; k < WATCHED; k++) {
		if (is_worse(&c->seen[k], &twin->seen[k])) { return 1; }
	}
	return 0;
}

static real delta_of(const KOOP(rls) *rls) {
	return ((const KOOP(dead_zone) *)rls->config.settings)->delta;
}

static double dead_zone(const world *w) {
	const KOOP(regulator) *regulator = w->rls.config.regulator;
	const int has_one = regulator == &KOOP(reg_dz_cs) || regulator == &KOOP(reg_dz_ks);
	return has_one ? (double)delta_of(&w->rls) * (double)delta_of(&w->rls) : 0;
}

static int is_harmless(const world *w, const course *c, const course *twin) {
	const double most = fmax(AS_GOOD * twin->error, dead_zone(w));
	return c->error <= most && c->cost <= AS_GOOD * twin->cost && !c->unsafe;
}

/* Which of learner, controller, gate and supervisor refuse, as bits. */
static int refusals(const report *r) {
	return (r->learned != KOOP_OK) + 2 * (r->controlled != KOOP_OK) + 4 * (r->trust >= KOOP_REFUSE) +
	       8 * (r->model != KOOP_SUPERVISOR_ONLINE);
}

/* Which of them refuse forever from LASTING samples on; or whether an input is unsafe before. */
static int lasting_refusals(world *w, int *unsafe) {
	int refused = 0;
	for (size_t k = 0; k < LASTING; k++) {
		const report r = world_step(w);
		*unsafe |= r.unsafe;
		refused = refusals(&r);
	}
	for (size_t k = 0; k < LASTING && refused; k++) {
		const report r = world_step(w);
		refused &= refusals(&r);
	}
	return refused;
}

/* But for what was counted. */
static int same_state(world *w, const world *twin) {
	w->rls.repaired = twin->rls.repaired;
	w->gate.saved.repaired = twin->gate.saved.repaired;
	return memcmp(w, twin, sizeof *w) == 0;
}

/* Whether the flip has made it refuse forever; w and twin are WATCHED samples on. */
static int is_refused_for_ever(world *w, const world *twin, int *unsafe) {
	if (same_state(w, twin)) { return 0; }
	const int refused = lasting_refusals(w, unsafe);
	if (!refused) { return 0; }
	*w = *twin;
	int twins_unsafe = 0;
	return (refused & ~lasting_refusals(w, &twins_unsafe)) != 0;
}

static void count_trial(area *a, int detected, int harmless, int for_ever, int unsafe) {
	a->trials++;
	a->detected += (unsigned long)detected;
	a->harmless += (unsigned long)(harmless && !detected);
	a->silent += (unsigned long)(!harmless && !detected);
	a->for_ever += (unsigned long)for_ever;
	a->unsafe += (unsigned long)unsafe;
}

/* Flips a bit and leaves the world as it was. */
static void try_bit(world *w, area *a, size_t word, size_t bit) {
	static world before, after;
	static course c, twin;
	before = *w;
	watch(w, &twin);
	after = *w;
	twin.error = world_error(w);
	*w = before;

	a->at[word * WORD + bit / 8] ^= (unsigned char)(1u << bit % 8);
	watch(w, &c);
	static world then;
	then = *w;
	c.error = world_error(w);
	*w = then;
	const int detected = is_detected(&c, &twin), harmless = is_harmless(w, &c, &twin);
	const int for_ever = is_refused_for_ever(w, &after, &c.unsafe);
	const unsigned long bad = a->silent + a->for_ever + a->unsafe;
	count_trial(a, detected, harmless, for_ever, c.unsafe);
	*w = before;
	if (bad == 0 && a->silent + a->for_ever + a->unsafe > 0) {
		a->word = word;
		a->bit = bit;
		a->time = w->time;
	}
}

/* ---- The campaign ------------------------------------------------------------------------------ */

/* Threshold of the dead zones: three quarters of the innovations of a model that has
 * been learned are smaller (paper, remark "Dead-Zone Threshold Selection"). */
static real calibrated(protection use, const KOOP(config) *config, uint64_t seed) {
	static world w;
	static real scores[LEARNING];
	KOOP(config) plain = *config;
	plain.regulator = &KOOP(reg_none);
	plain.settings = NULL;
	real delta;
	world_start(&w, use, &plain, seed);
	for (size_t k = 0; k < LEARNING; k++) { (void)world_step(&w); }
	for (size_t k = 0; k < LEARNING; k++) { scores[k] = (real)world_step(&w).innovation; }
	if (KOOP(threshold)(scores, LEARNING, (real)0.75, &delta)) { fatal("no threshold"); }
	return delta;
}

static void run(world *w, list *l, const KOOP(config) *config, unsigned long trials, uint64_t seed) {
	random_source random = random_seed(seed);
	const protection use = w->use;
	for (size_t a = 0; a < l->count; a++) { l->areas[a].next = random_below(&random, l->areas[a].words); }
	for (unsigned long t = 0; t < trials; t++) {
		for (size_t a = 0; a < l->count; a++) {
			area *now = &l->areas[a];
			if (w->time >= LONGEST_RUN) { world_start(w, use, config, random_bits(&random)); }
			const size_t pause = random_below(&random, LONGEST_PAUSE);
			for (size_t k = 0; k <= pause; k++) { (void)world_step(w); }
			try_bit(w, now, now->next, random_below(&random, 8 * WORD));
			now->next = (now->next + 1) % now->words;
		}
	}
}

static void print_line(const area *a, const world *w) {
	const KOOP(config) *c = &w->rls.config;
	printf("{\"what\": \"%s\", \"configuration\": \"%s\", \"regulator\": \"%s\", \"form\": \"%s\", "
	       "\"check\": \"%s\", \"precision\": \"%s\", \"trials\": %lu, \"detected\": %lu, \"harmless\": %lu, "
	       "\"silent\": %lu, \"for_ever\": %lu, \"unsafe\": %lu, \"example\": ",
	       a->what, use_names[w->use], c->regulator->name, c->form->name,
	       c->check == KOOP_CHECK_REFUSE ? "refuse" : "diagonal", TEST_DOUBLE ? "f64" : "f32", a->trials,
	       a->detected, a->harmless, a->silent, a->for_ever, a->unsafe);
	if (a->silent + a->for_ever + a->unsafe > 0) {
		printf("\"word %lu, bit %lu, after %lu samples\"}\n", (unsigned long)a->word, (unsigned long)a->bit,
		       (unsigned long)a->time);
	} else {
		printf("null}\n");
	}
}

static size_t place_of(const char *name, const char *const *names, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (strcmp(name, names[i]) == 0) { return i; }
	}
	fatal(name);
	return 0;
}

int main(int count, char **arguments) {
	static const char *const checks[] = {"refuse", "", "diagonal"};
	static world w;
	static list l;
	const char *regulators[REGULATORS], *forms[FORMS];
	KOOP(config) config = {.p0 = 100, .lambda = (real)0.98};
	if (count != 7) { fatal("USE REGULATOR FORM CHECK TRIALS SEED"); }
	for (int r = 0; r < REGULATORS; r++) { regulators[r] = all_regulators[r]->name; }
	for (int f = 0; f < FORMS; f++) { forms[f] = all_forms[f]->name; }
	const protection use_of = (protection)place_of(arguments[1], use_names, USES);
	config.regulator = all_regulators[place_of(arguments[2], regulators, REGULATORS)];
	config.form = all_forms[place_of(arguments[3], forms, FORMS)];
	config.check = (int)place_of(arguments[4], checks, 3);
	const uint64_t seed = strtoull(arguments[6], NULL, 10);
	const KOOP(dead_zone) zone = {calibrated(use_of, &config, seed + 1)};
	const KOOP(setting) *first = config.regulator->settings;
	if (first && strcmp(first->name, "delta") == 0) { config.settings = &zone; }
	world_start(&w, use_of, &config, seed);
	list_all(&l, &w);
	run(&w, &l, &config, strtoul(arguments[5], NULL, 10), seed);
	for (size_t a = 0; a < l.count; a++) { print_line(&l.areas[a], &w); }
	return 0;
}
