/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef long BaseType_t;
typedef uint32_t TickType_t;
#define pdTRUE ((BaseType_t)1)
#define pdFALSE ((BaseType_t)0)
#define portMAX_DELAY ((TickType_t)0xffffffffu)
#define M2T(milliseconds) ((TickType_t)(milliseconds)) /* a tick of the firmware is a millisecond */
