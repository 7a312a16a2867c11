#include "stack.h"

#define DEPTH 512 /* words that are painted */
#define PAINT 0x5AFEC0DEu

/* Both are leaves whose frames are a few words; what is nearer to the caller than
 * that is taken as used. */
#define OWN 8

static uint32_t *top;

__attribute__((noinline)) void stack_paint(void) {
	top = __builtin_frame_address(0);
	volatile uint32_t *word = top - OWN;
	for (int i = 0; i < DEPTH; i++) { *--word = PAINT; }
}

__attribute__((noinline)) uint32_t stack_used(void) {
	const volatile uint32_t *word = top - OWN - DEPTH;
	while (*word == PAINT && word < top - OWN) { word++; }
	return (uint32_t)(top - word) * (uint32_t)sizeof *word;
}
