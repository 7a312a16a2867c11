/* The rows of a log that predictions need: checked, and in stretches. */
#ifndef STRETCHES_H
#define STRETCHES_H

#include "tinykoop_sim.h"

/* Windows `begin` to `end`, the path that holds them, and the row from which actuators are rolled for it. */
typedef struct stretch {
	size_t begin, end;
	size_t from, first, final;
} stretch;

/* Whether the transition from row k may be used. */
int usable(const tk_recording *log, size_t k);
int all_finite(const double *values, size_t count);
/* Rows `from` to `final`. */
int check_rows(const tk_recording *log, size_t from, size_t final);
/* Whether sensor effects among them can be undone, where a prediction starts at what was measured. */
int check_actives(const tk_active *effects, size_t n_effects);
/* The windows from `begin` on that follow each other more closely than the actuators need. */
stretch next_stretch(const tk_recording *log, size_t begin, size_t n_starts, const int64_t *starts,
                     size_t longest);

#endif
