/* Long sequences of calls on one estimator with its controller, supervisor and filter: sound settings, any
 * data.
 */
#include "world.h"

enum { MOST_CALLS = 40 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
	world w = {.in = {data, size}};
	begin_sound(&w);
	for (size_t k = 0; k < MOST_CALLS && w.in.left > 0; k++) { call(&w); }
	free_all();
	return 0;
}
