/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include "FreeRTOS.h"

void vTaskDelay(TickType_t ticks);
