/* Every public call with any settings, any data and null pointers, in any order. */
#include "world.h"

enum { MOST_CALLS = 12, LARGE = 20 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
	world w = {.in = {data, size}, .arbitrary = 1};
	/* what is large costs time, and is no other code */
	for (size_t k = 0; k < (w.rls.n_regressors > LARGE ? 2 : MOST_CALLS) && w.in.left > 0; k++) { call(&w); }
	free_all();
	return 0;
}
