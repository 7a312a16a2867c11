/* A dictionary of the user's own in one precision: of parts, or one whose states the caller lifts. Included by
 * estimator.c twice, with REAL, KOOP and SIM defined. */

/* Settings of one part, with what they point to. */
typedef struct SIM(own_part) {
	KOOP(angles) angles;
	KOOP(products) products;
	KOOP(polynomials) polynomials;
	KOOP(rbf) rbf;
	unsigned char *states;
	REAL *numbers; /* centers, then widths */
} SIM(own_part);

typedef struct SIM(own) {
	KOOP(dictionary) dictionary;
	KOOP(combination) combination;
	char *name;
	KOOP(part) *parts;
	SIM(own_part) *settings;
	size_t n_parts;
} SIM(own);

static void SIM(own_free)(SIM(own) * own) {
	if (!own) { return; }
	for (size_t i = 0; own->settings && i < own->n_parts; i++) {
		free(own->settings[i].states);
		free(own->settings[i].numbers);
	}
	free(own->settings);
	free(own->parts);
	free(own->name);
	free(own);
}

static const KOOP(kernel) *SIM(kernel)(const char *name) {
	static const struct {
		const char *name;
		const KOOP(kernel) *kernel;
	} table[] = {
	    {"gaussian", &KOOP(gaussian)},
	    {"inverse_quadratic", &KOOP(inverse_quadratic)},
	    {"inverse_multiquadric", &KOOP(inverse_multiquadric)},
	    {"multiquadric", &KOOP(multiquadric)},
	    {"thin_plate", &KOOP(thin_plate)},
	};
	for (size_t i = 0; name && i < sizeof table / sizeof *table; i++) {
		if (strcmp(table[i].name, name) == 0) { return table[i].kernel; }
	}
	return NULL;
}

/* Copies what a part points to; returns 0 without memory. */
static int SIM(copy_part)(SIM(own_part) * own, const tk_part *part) {
	const size_t indices = part->states ? part->n * (strcmp(part->kind, "products") == 0 ? 2 : 1) : 0;
	const size_t centers = part->centers ? part->count * part->n : 0, widths = part->widths ? part->count : 0;
	own->states = calloc(indices + 1, 1);
	own->numbers = calloc(centers + widths + 1, sizeof(REAL));
	if (!own->states || !own->numbers) { return 0; }
	if (indices > 0) { memcpy(own->states, part->states, indices); }
	for (size_t i = 0; i < centers; i++) { own->numbers[i] = (REAL)part->centers[i]; }
	for (size_t i = 0; i < widths; i++) { own->numbers[centers + i] = (REAL)part->widths[i]; }
	own->angles = (KOOP(angles)){own->states, part->n, part->wrapped};
	own->products = (KOOP(products)){own->states, part->n};
	own->polynomials = (KOOP(polynomials)){own->states, part->n, part->low, part->high};
	own->rbf = (KOOP(rbf)){own->states, part->n, part->count, own->numbers, own->numbers + centers, SIM(kernel)(part->kernel)};
	return 1;
}

/* The part of this kind; kind is null if there is none. */
static KOOP(part) SIM(part)(const SIM(own_part) *own, const char *kind) {
	const struct {
		const char *name;
		KOOP(part) part;
	} table[] = {
	    {"constant", {&KOOP(part_constant), NULL}},
	    {"angles", {&KOOP(part_angles), &own->angles}},
	    {"products", {&KOOP(part_products), &own->products}},
	    {"polynomials", {&KOOP(part_polynomials), &own->polynomials}},
	    {"rbf", {&KOOP(part_rbf), &own->rbf}},
	};
	for (size_t i = 0; i < sizeof table / sizeof *table; i++) {
		if (strcmp(table[i].name, kind) == 0) { return table[i].part; }
	}
	return (KOOP(part)){NULL, NULL};
}

static int SIM(own_name)(SIM(own) * own, const char *name) {
	own->name = calloc(strlen(name) + 1, 1);
	if (!own->name) { return fail("out of memory"); }
	strcpy(own->name, name);
	return TK_OK;
}

static int SIM(own_of_parts)(SIM(own) * own, const char *name, size_t n_states, size_t n_parts,
                             const tk_part *parts) {
	if (SIM(own_name)(own, name) != TK_OK) { return TK_ERROR; }
	own->parts = calloc(n_parts + 1, sizeof *own->parts);
	own->settings = calloc(n_parts + 1, sizeof *own->settings);
	if (!own->parts || !own->settings) { return fail("out of memory"); }
	own->n_parts = n_parts;
	for (size_t i = 0; i < n_parts; i++) {
		if (!SIM(copy_part)(&own->settings[i], &parts[i])) { return fail("out of memory"); }
		own->parts[i] = SIM(part)(&own->settings[i], parts[i].kind);
		if (!own->parts[i].kind) { return fail("there is no part of a dictionary named '%s'", parts[i].kind); }
	}
	own->combination = (KOOP(combination)){own->parts, n_parts};
	const int status = KOOP(combine)(&own->dictionary, own->name, n_states, &own->combination);
	return status == KOOP_OK ? TK_OK : fail("dictionary '%s': %s", name, KOOP(status_message)(status));
}

/* The caller lifts: nothing that this writes passes for psi. */
static void SIM(lift_outside)(const KOOP(dictionary) *self, const REAL *x, REAL *psi) {
	(void)x;
	for (size_t i = 0; i < self->n_lifted; i++) { psi[i] = (REAL)NAN; }
}

/* Whether n and N are within the library's limits. */
static int SIM(own_fits)(const char *name, size_t n_states, size_t n_lifted) {
	if (n_states >= 1 && n_lifted >= n_states && n_lifted <= KOOP_MAX_DIM) { return TK_OK; }
	return fail("dictionary '%s' makes %zu lifted states of %zu: at least as many as states are needed, and at most %d",
	            name, n_lifted, n_states, KOOP_MAX_DIM);
}

static int SIM(own_outside)(SIM(own) * own, const char *name, size_t n_states, size_t n_lifted) {
	if (SIM(own_fits)(name, n_states, n_lifted) != TK_OK || SIM(own_name)(own, name) != TK_OK) { return TK_ERROR; }
	own->dictionary = (KOOP(dictionary)){own->name, n_states, n_lifted, SIM(lift_outside), NULL};
	return TK_OK;
}

/* Lifts one state and looks at what was written: a loop of the user's own may end too early or too late. */
static int SIM(own_writes)(const KOOP(dictionary) *given) {
	const REAL unwritten = (REAL)-3.0e33;
	REAL x[KOOP_MAX_DIM], psi[KOOP_MAX_DIM + 1];
	for (size_t i = 0; i < KOOP_MAX_DIM; i++) { x[i] = (REAL)0.125 * (REAL)(i + 1); }
	for (size_t i = 0; i <= KOOP_MAX_DIM; i++) { psi[i] = unwritten; }
	given->lift(given, x, psi);
	for (size_t i = 0; i <= given->n_lifted; i++) {
		const int written = memcmp(&psi[i], &unwritten, sizeof unwritten) != 0;
		if (i < given->n_states && memcmp(&psi[i], &x[i], sizeof *x) != 0) {
			return fail("dictionary '%s': psi must begin with the state, but psi[%zu] is not x[%zu]", given->name, i, i);
		}
		if (written == (i == given->n_lifted)) {
			return fail("dictionary '%s': n_lifted is %zu, but lift() %s psi[%zu]", given->name, given->n_lifted,
			            written ? "also writes" : "does not write", i);
		}
	}
	return TK_OK;
}

static int SIM(own_given)(SIM(own) * own, const KOOP(dictionary) *given) {
	if (!given->name || !given->lift) {
		return fail("dictionary '%s': name and lift must be filled in where the constant is defined", given->name ? given->name : "");
	}
	if (SIM(own_fits)(given->name, given->n_states, given->n_lifted) != TK_OK || SIM(own_writes)(given) != TK_OK) { return TK_ERROR; }
	own->dictionary = *given;
	return TK_OK;
}
