/* One line about what went wrong, kept for tk_message(). */
#ifndef MESSAGE_H
#define MESSAGE_H

#include "tinykoop_sim.h"

/* Returns TK_ERROR, so that `return fail(...)` reads as it acts. */
int fail(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
