/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include "FreeRTOS.h"

typedef struct {
	uint8_t *items;
	size_t length, size, held;
} StaticQueue_t;
typedef StaticQueue_t *xQueueHandle;

xQueueHandle xQueueCreateStatic(size_t length, size_t size, uint8_t *items, StaticQueue_t *queue);
BaseType_t xQueueOverwrite(xQueueHandle queue, const void *item);
BaseType_t xQueueReceive(xQueueHandle queue, void *item, TickType_t patience);
