#include "fuzz.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void stop_at(const char *file, int line, const char *condition, const char *format, ...) {
	va_list arguments;
	fprintf(stderr, "FINDING %s:%d: %s: ", file, line, condition);
	va_start(arguments, format);
	vfprintf(stderr, format, arguments);
	va_end(arguments);
	fprintf(stderr, "\n");
	abort();
}

void take(input *in, void *to, size_t count) {
	const size_t there = count < in->left ? count : in->left;
	memcpy(to, in->next, there);
	memset((char *)to + there, 0, count - there);
	in->next += there;
	in->left -= there;
}

uint8_t take_byte(input *in) {
	uint8_t byte;
	take(in, &byte, 1);
	return byte;
}

size_t take_below(input *in, size_t count) {
	return take_byte(in) % count;
}

static void *allocated[1 << 15];
static size_t n_allocated;

void *allocate(size_t bytes) {
	EXPECT(n_allocated < sizeof allocated / sizeof *allocated, "%zu pieces", n_allocated);
	void *memory = malloc(bytes ? bytes : 1);
	EXPECT(memory, "%zu bytes", bytes);
	memset(memory, 0xA5, bytes);
	allocated[n_allocated++] = memory;
	return memory;
}

void free_all(void) {
	while (n_allocated > 0) { free(allocated[--n_allocated]); }
}
