/* Counts instructions under QEMU's -icount shift=0, where every instruction takes 1 ns. */
#ifndef COUNTER_H
#define COUNTER_H

#include <stdint.h>

/* Once, before all counting. */
void counter_open(void);
void counter_start(void);
/* Instructions since counter_start(), without those of the two calls themselves. */
uint32_t counter_stop(void);

#endif
