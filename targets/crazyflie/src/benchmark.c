/* In place of the planner, by make BENCHMARK=1: prints to the client's console how many cycles lift, update and
 * solve take on the vehicle. No plan is made, so the stock controller flies. */
#define DEBUG_MODULE "KOOPMAN"

#include "app.h"
#include "debug.h"
#include "handover.h"
#include "task.h"

#define SELF_BENCHMARK_HORIZON HORIZON
#include "../../../examples/self_benchmark.h"

static void print(const bench_result *r) {
	DEBUG_PRINT(SELF_BENCHMARK_LINE, r->function, r->n_lifted, (unsigned)BENCH_INPUTS, (unsigned)HORIZON, r->min,
	            r->median, r->max);
	vTaskDelay(M2T(100)); /* the console's buffer is small */
}

void appMain(void) {
	vTaskDelay(M2T(10000)); /* until a client is connected */
	const int status = self_benchmark(print);
	if (status == SELF_BENCHMARK_NO_COUNTER) {
		DEBUG_PRINT("no cycle counter here\n");
	} else {
		DEBUG_PRINT("benchmark: %s\n", koopf_status_message(status));
	}
	while (1) { vTaskDelay(portMAX_DELAY); }
}
