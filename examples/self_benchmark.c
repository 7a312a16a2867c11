/* Prints how many cycles lift, update and solve take on this chip. Where no cycles are counted, as in QEMU and on
 * a PC, it says so. docs/microcontroller.md says how to build it and where to send the results.
 *
 * It prints with printf: by semihosting, or by what your board's support package connects it to. */
#include "self_benchmark.h"

#include <stdio.h>

static void print(const bench_result *r) {
	printf(SELF_BENCHMARK_LINE, r->function, r->n_lifted, (unsigned)BENCH_INPUTS, (unsigned)SELF_BENCHMARK_HORIZON,
	       r->min, r->median, r->max);
}

int main(void) {
	const int status = self_benchmark(print);
	if (status == SELF_BENCHMARK_NO_COUNTER) {
		printf("no cycle counter here\n");
		return 0;
	}
	if (status != KOOP_OK) { printf("%s\n", koopf_status_message(status)); }
	return status != KOOP_OK;
}
