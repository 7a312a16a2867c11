#include "message.h"

#include <stdarg.h>
#include <stdio.h>

static __thread char message[4096 + 512]; /* the longest path and a sentence */

int fail(const char *format, ...) {
	va_list arguments;
	va_start(arguments, format);
	vsnprintf(message, sizeof message, format, arguments);
	va_end(arguments);
	/* what is quoted from a file must not reach a terminal as a control */
	for (char *c = message; *c; c++) {
		if ((unsigned char)*c < ' ' || *c == 127) { *c = '?'; }
	}
	return TK_ERROR;
}

const char *tk_message(void) {
	return message;
}
