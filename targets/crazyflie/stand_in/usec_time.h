/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include <stdint.h>

uint64_t usecTimestamp(void);
