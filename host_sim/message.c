#include "message.h"

#include <stdarg.h>
#include <stdio.h>

static __thread char message[512];

int fail(const char *format, ...) {
	va_list arguments;
	va_start(arguments, format);
	vsnprintf(message, sizeof message, format, arguments);
	va_end(arguments);
	return TK_ERROR;
}

const char *tk_message(void) {
	return message;
}
