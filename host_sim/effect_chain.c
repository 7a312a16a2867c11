/* The effects that act on one robot: checked, put in order, applied. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "effects.h"
#include "message.h"

struct running {
	const tk_effect *effect;
	const tk_active *active;
	double *memory;
	int throughout; /* acts all the time, and as if it were always the same time */
};

/* Whether `r` has a say in this block now; if so, tells it how far its time has passed. */
static int acts(const effect_chain *chain, const struct running *r, int block, tk_signal *signal) {
	if (r->throughout) {
		signal->passed = 0;
		return r->effect->block == block;
	}
	const double now = signal->t + 1e-6 * chain->dt; /* t is k dt: rounded */
	if (r->effect->block != block || now < r->active->t0 || now >= r->active->t1) { return 0; }
	const double end = fmin(r->active->t1, chain->end);
	signal->passed = r->effect->needs_end ? (signal->t - r->active->t0) / (end - r->active->t0) : 0;
	return 1;
}

void effects_apply(const effect_chain *chain, int block, tk_signal *signal) {
	for (size_t i = chain->blocks[block].first; i < chain->blocks[block].end && i < chain->count; i++) {
		const struct running *r = &chain->runs[i];
		if (acts(chain, r, block, signal)) { r->effect->apply(r->active->parameters, r->memory, signal); }
	}
}

void effects_undo(const effect_chain *chain, int block, tk_signal *signal) {
	for (size_t i = chain->blocks[block].end; i-- > chain->blocks[block].first;) {
		const struct running *r = &chain->runs[i];
		if (r->effect->undo && acts(chain, r, block, signal)) {
			r->effect->undo(r->active->parameters, r->memory, signal);
		}
	}
}

/* ---- Setting up ------------------------------------------------------------- */

enum { MOST_MEMORY = 1 << 20 }; /* doubles of one effect */

static int check_parameters(const tk_effect *effect, const tk_active *active) {
	if (active->n_parameters != effect->n_parameters) {
		return fail("%s: %zu parameters are given, it takes %zu", effect->name, active->n_parameters,
		            effect->n_parameters);
	}
	for (size_t i = 0; i < effect->n_parameters; i++) {
		const tk_parameter *p = &effect->parameters[i];
		const double value = active->parameters[i];
		if (!(value >= p->low && value <= p->high)) {
			return fail("%s: %s is %g, it must be between %g and %g", effect->name, p->name, value, p->low,
			            p->high);
		}
	}
	return TK_OK;
}

static size_t memory_of(const tk_effect *effect, const tk_active *active, double dt) {
	return effect->n_memory + (effect->history ? effect->history(active->parameters, dt) : 0);
}

static int check(const tk_effects *table, const tk_active *active, double dt) {
	const tk_effect *effect = effect_by_name(table, active->effect);
	if (!effect) { return fail("there is no effect named '%s'", active->effect ? active->effect : ""); }
	if (!isfinite(active->t0) || isnan(active->t1)) {
		return fail("%s: it acts from %g s to %g s; the end must be after the start", effect->name,
		            active->t0, active->t1);
	}
	if (check_parameters(effect, active) != TK_OK) { return TK_ERROR; }
	if (memory_of(effect, active, dt) > MOST_MEMORY) {
		return fail("%s reaches back over too many steps of %g s", effect->name, dt);
	}
	return TK_OK;
}

static int acts_throughout(const tk_effect *effect, const tk_active *active) {
	return active->t0 <= 0 && active->t1 == (double)INFINITY && !effect->needs_end;
}

static void enter(effect_chain *chain, size_t i, struct running run, int remembers) {
	const int block = run.effect->block;
	chain->runs[i] = run;
	if (!effects_any(chain, block)) { chain->blocks[block].first = i; }
	chain->blocks[block].end = i + 1;
	chain->blocks[block].steady &= run.throughout && !remembers;
	if (remembers) { chain->remembers = i + 1; }
}

/* In the order of the table of effects, whatever the caller's: reordering a
 * list of effects must not change a trajectory. */
static void collect(effect_chain *chain, const tk_effects *table, const tk_active *actives) {
	size_t n = 0;
	double *memory = chain->memory;
	for (size_t e = 0; e < table->count; e++) {
		const tk_effect *effect = table->effects[e];
		for (size_t i = 0; i < chain->count; i++) {
			if (effect_by_name(table, actives[i].effect) != effect) { continue; }
			const size_t size = memory_of(effect, &actives[i], chain->dt);
			enter(chain, n++, (struct running){effect, &actives[i], memory, acts_throughout(effect, &actives[i])}, size > 0);
			memory += size;
		}
	}
}

int effects_any(const effect_chain *chain, int block) {
	return chain->blocks[block].end > 0;
}

void effects_free(effect_chain *chain) {
	free(chain->runs);
	free(chain->memory);
}

void effects_restart(effect_chain *chain) {
	memset(chain->memory, 0, chain->memory_size * sizeof *chain->memory);
}

int effects_open(effect_chain *chain, const tk_effects *table, const tk_active *effects, size_t n_effects,
                 double dt, double end) {
	size_t memory_size = 1;
	for (size_t i = 0; i < n_effects; i++) {
		if (check(table, &effects[i], dt) != TK_OK) { return TK_ERROR; }
		memory_size += memory_of(effect_by_name(table, effects[i].effect), &effects[i], dt);
	}
	*chain = (effect_chain){
	    .runs = calloc(n_effects + 1, sizeof *chain->runs),
	    .memory = calloc(memory_size, sizeof *chain->memory),
	    .count = n_effects,
	    .memory_size = memory_size,
	    .dt = dt,
	    .end = end,
	};
	if (!chain->runs || !chain->memory) {
		effects_free(chain);
		return fail("out of memory");
	}
	for (size_t block = 0; block < TK_BLOCKS; block++) { chain->blocks[block].steady = 1; }
	collect(chain, table, effects);
	return TK_OK;
}
