/* Stack that a call took, seen by what it left below the caller's frame. */
#ifndef STACK_H
#define STACK_H

#include <stdint.h>

/* Right before the call, and right after it, from the same function. */
void stack_paint(void);
uint32_t stack_used(void);

#endif
