/* Feeds the files of a folder to a fuzz target: the corpus, with any compiler and without a fuzzer. */
#define _POSIX_C_SOURCE 200809L

#include "fuzz.h"

#include <dirent.h>
#include <stdio.h>

static uint8_t bytes[1 << 16];

static int replay(const char *folder, const char *name) {
	char path[4096];
	snprintf(path, sizeof path, "%s/%s", folder, name);
	FILE *file = fopen(path, "rb");
	if (!file) { return 0; }
	const size_t size = fread(bytes, 1, sizeof bytes, file);
	const int whole = !ferror(file) && feof(file);
	fclose(file);
	if (!whole) { return 0; }
	LLVMFuzzerTestOneInput(bytes, size);
	return 1;
}

int main(int argc, char **argv) {
	size_t count = 0;
	DIR *folder = argc == 2 ? opendir(argv[1]) : NULL;
	if (!folder) {
		fprintf(stderr, "replay: one argument, a folder of inputs\n");
		return 2;
	}
	for (struct dirent *entry; (entry = readdir(folder));) {
		if (entry->d_name[0] == '.') { continue; }
		if (!replay(argv[1], entry->d_name)) {
			fprintf(stderr, "replay: %s/%s cannot be read\n", argv[1], entry->d_name);
			return 2;
		}
		count++;
	}
	closedir(folder);
	printf("%zu inputs\n", count);
	return count ? 0 : 2; /* an empty corpus tests nothing */
}
