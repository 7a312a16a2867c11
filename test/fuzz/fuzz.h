/* What every fuzz target needs: values out of the bytes of an input, and a check that stops it. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>

/* What a fuzzer, or replay.c, calls with one input. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Stops with a formatted message, which is the finding. */
#define EXPECT(condition, ...)                                                                               \
	do {                                                                                                     \
		if (!(condition)) { stop_at(__FILE__, __LINE__, #condition, __VA_ARGS__); }                          \
	} while (0)
void stop_at(const char *file, int line, const char *condition, const char *format, ...);

/* The bytes not used yet; zeros follow them. */
typedef struct {
	const uint8_t *next;
	size_t left;
} input;

void take(input *in, void *to, size_t count);
uint8_t take_byte(input *in);
size_t take_below(input *in, size_t count); /* 1 to 256 */

/* Memory of exactly this size, so that a sanitizer sees every byte beyond; all of it lasts until free_all().
 */
void *allocate(size_t bytes);
void free_all(void);

#endif
