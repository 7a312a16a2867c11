/* The rows of a log that predictions need: checked, and in stretches. */
#include <math.h>

#include "effects.h"
#include "message.h"
#include "stretches.h"

int check_actives(const tk_active *effects, size_t n_effects) {
	for (size_t i = 0; i < n_effects; i++) {
		const tk_effect *effect = effect_by_name(&ddr_effects, effects[i].effect);
		if (effect && effect->block == TK_SENSOR && !effect->undo) {
			return fail("%s cannot be undone at the start of a window: it serves simulation only",
			            effect->name);
		}
	}
	return TK_OK;
}

int usable(const tk_recording *log, size_t k) {
	return !log->usable || log->usable[k];
}

int all_finite(const double *values, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (!isfinite(values[i])) { return 0; }
	}
	return 1;
}

/* Whether nothing is NaN or infinite anywhere: the usual case, in one pass without branches. */
static int wholly_finite(const double *values, size_t count) {
	double odd[4] = {0, 0, 0, 0}; /* NaN once a value is not finite */
	size_t i = 0;
	for (; i + 4 <= count; i += 4) {
		odd[0] += values[i] - values[i];
		odd[1] += values[i + 1] - values[i + 1];
		odd[2] += values[i + 2] - values[i + 2];
		odd[3] += values[i + 3] - values[i + 3];
	}
	return odd[0] + odd[1] + odd[2] + odd[3] == 0 && all_finite(values + i, count - i);
}

int check_rows(const tk_recording *log, size_t from, size_t final) {
	if (wholly_finite(log->u + 2 * from, 2 * (final - from)) &&
	    wholly_finite(log->x + 3 * from, 3 * (final - from + 1))) {
		return TK_OK;
	}
	for (size_t k = from; k < final; k++) {
		const double *x = log->x + 3 * k, *u = log->u + 2 * k;
		if (!all_finite(u, 2)) { return fail("the command in row %zu is not finite", k); }
		if (usable(log, k) && !all_finite(x, 6)) {
			return fail("the pose in row %zu or %zu is not finite", k, k + 1);
		}
	}
	return TK_OK;
}

stretch next_stretch(const tk_recording *log, size_t begin, size_t n_starts, const int64_t *starts,
                     size_t longest) {
	const size_t rows = log->warm_up, first = (size_t)starts[begin];
	stretch s = {.begin = begin, .end = begin, .from = first > rows ? first - rows : 0, .first = first};
	for (s.final = first; s.end < n_starts; s.end++) {
		const size_t start = (size_t)starts[s.end];
		if (start < first || start > s.final + rows) { break; }
		s.final = start + longest > s.final ? start + longest : s.final;
	}
	if (s.final >= log->rows) { s.final = log->rows - 1; }
	return s;
}
