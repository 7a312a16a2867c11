/* What Windows does otherwise than POSIX: the locale of a thread, and files on the disk. */
#ifndef SYSTEM_H
#define SYSTEM_H

#include <locale.h>
#include <stdio.h>

/* Numbers have a point, whatever the program's locale, which this thread sets aside. Null: it cannot. */
#ifdef _WIN32

#include <io.h>
#include <process.h>
#include <stdlib.h>
#include <string.h>
#include <windows.h>

typedef char *saved_locale; /* its name */

static saved_locale set_locale_aside(void) {
	_configthreadlocale(_ENABLE_PER_THREAD_LOCALE);
	const char *now = setlocale(LC_ALL, NULL);
	char *before = malloc(strlen(now) + 1);
	if (!before) { return NULL; }
	strcpy(before, now);
	setlocale(LC_ALL, "C");
	return before;
}

static void put_locale_back(saved_locale before) {
	setlocale(LC_ALL, before);
	free(before);
}

static long process_id(void) {
	return (long)_getpid();
}

static int to_disk(FILE *file) {
	return _commit(_fileno(file));
}

static int rename_over(const char *from, const char *to) {
	return MoveFileExA(from, to, MOVEFILE_REPLACE_EXISTING) ? 0 : -1;
}

#else

#include <unistd.h>

typedef locale_t saved_locale;

static saved_locale set_locale_aside(void) {
	const locale_t plain = newlocale(LC_ALL_MASK, "C", (locale_t)0);
	return plain ? uselocale(plain) : (locale_t)0;
}

static void put_locale_back(saved_locale before) {
	freelocale(uselocale(before));
}

static long process_id(void) {
	return (long)getpid();
}

static int to_disk(FILE *file) {
	return fsync(fileno(file));
}

static int rename_over(const char *from, const char *to) {
	return rename(from, to);
}

#endif
#endif
