#include "counter.h"

#include "mark.h"

#ifdef __riscv

static uint32_t begun, overhead;

static uint32_t retired(void) {
	uint32_t count;
	__asm__ volatile("csrr %0, minstret" : "=r"(count) : : "memory");
	return count;
}

void counter_start(void) {
	begun = retired();
}

uint32_t counter_stop(void) {
	return retired() - begun - overhead;
}

void counter_open(void) {
	overhead = 0;
	counter_start();
	overhead = counter_stop();
}

#else

/* ARM's SysTick counts down at the machine's clock, a tick every 6 to 40
 * instructions. To count single ones, a measurement begins right after a tick, and
 * at its end the instructions to the next tick are counted. It must be shorter than
 * 2^24 ticks, which is 100 million instructions or more. */
struct systick {
	volatile uint32_t control, reload, value;
};
#define SYSTICK ((struct systick *)0xE000E010u)
#define SYSTICK_MAX 0xFFFFFFu

static float per_tick; /* instructions */
static float overhead; /* instructions */
static uint32_t begun;

/* Waits for the tick after the one that was read as `before`; returns how many instructions that took. */
static uint32_t wait_for_tick(uint32_t before) {
	const volatile uint32_t *value = &SYSTICK->value;
	uint32_t now, loops = 0;
	__asm__ volatile("1: ldr %0, [%2]\n"
	                 "   adds %1, #1\n"
	                 "   cmp %0, %3\n"
	                 "   beq 1b\n"
	                 : "=&r"(now), "+r"(loops)
	                 : "r"(value), "r"(before)
	                 : "cc", "memory");
	return 4 * loops;
}

static float elapsed(void) {
	const uint32_t value = SYSTICK->value;
	const uint32_t rest = wait_for_tick(value);
	const uint32_t ticks = (begun - value) & SYSTICK_MAX;
	return (float)(ticks + 1) * per_tick - (float)rest;
}

void counter_start(void) {
	wait_for_tick(SYSTICK->value);
	begun = SYSTICK->value;
}

uint32_t counter_stop(void) {
	const float instructions = elapsed() - overhead;
	return instructions > 0 ? (uint32_t)(instructions + 0.5f) : 0;
}

void counter_open(void) {
	SYSTICK->reload = SYSTICK_MAX;
	SYSTICK->value = 0;
	SYSTICK->control = 5; /* on, by the processor's clock */

	uint32_t loops = 1000000;
	counter_start();
	__asm__ volatile("1: subs %0, #1\n"
	                 "   bne 1b\n"
	                 : "+r"(loops)
	                 :
	                 : "cc");
	per_tick = 2e6f / (float)((begun - SYSTICK->value) & SYSTICK_MAX);

	counter_start();
	MARK_BEGIN();
	MARK_END();
	overhead = elapsed();
}

#endif
