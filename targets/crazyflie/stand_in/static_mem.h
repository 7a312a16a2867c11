/* Stand-in for the firmware's header: only what the example needs. */
#pragma once

/* The firmware clears this section at the start and takes no initial values for it. */
#define NO_DMA_CCM_SAFE_ZERO_INIT __attribute__((section(".ccmbss")))

#define STATIC_MEM_QUEUE_ALLOC(NAME, LENGTH, SIZE)                                                           \
	enum { queue_length_##NAME = (LENGTH), queue_item_##NAME = (SIZE) };                                     \
	NO_DMA_CCM_SAFE_ZERO_INIT static uint8_t queue_items_##NAME[(LENGTH) * (SIZE)];                          \
	NO_DMA_CCM_SAFE_ZERO_INIT static StaticQueue_t queue_of_##NAME
#define STATIC_MEM_QUEUE_CREATE(NAME)                                                                        \
	xQueueCreateStatic(queue_length_##NAME, queue_item_##NAME, queue_items_##NAME, &queue_of_##NAME)
