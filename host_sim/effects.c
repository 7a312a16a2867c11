/* The table of effects. Within a block they act in this order. */
#include "effects.h"

#include <string.h>

#include "message.h"

/* One line each. */
#define EFFECTS(EFFECT)                                                                                      \
	EFFECT(pacejka_slip)                                                                                     \
	EFFECT(stribeck_friction)

#define DECLARE(name) extern const tk_effect name;
#define ENTER(name) &name,

EFFECTS(DECLARE)

static const tk_effect *const table[] = {EFFECTS(ENTER)};

enum { COUNT = sizeof table / sizeof *table };

const tk_effect *effect_by_name(const char *name) {
	for (size_t i = 0; i < COUNT; i++) {
		if (name && strcmp(table[i]->name, name) == 0) { return table[i]; }
	}
	return NULL;
}

size_t tk_effect_count(void) {
	return COUNT;
}

const char *tk_effect_name(size_t effect) {
	return effect < COUNT ? table[effect]->name : NULL;
}

int tk_effect_block(size_t effect) {
	return effect < COUNT ? table[effect]->block : fail("there are only %d effects", COUNT);
}

size_t tk_effect_parameters(size_t effect) {
	return effect < COUNT ? table[effect]->n_parameters : 0;
}

int tk_effect_parameter(size_t effect, size_t parameter, const char **name, const char **unit, double *low,
                        double *high, double *usual) {
	if (parameter >= tk_effect_parameters(effect)) {
		return fail("there is no parameter %zu of effect %zu", parameter, effect);
	}
	const tk_parameter *p = &table[effect]->parameters[parameter];
	*name = p->name;
	*unit = p->unit;
	*low = p->low;
	*high = p->high;
	*usual = p->usual;
	return TK_OK;
}
