/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include <stdbool.h>

bool supervisorIsFlying(void);
