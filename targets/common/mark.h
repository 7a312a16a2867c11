/* Marks around a call: what is executed between them is weighed by the plugin weigh.c. They are hints to a
 * debugger and do nothing else. RISC-V has no such hint, and its instructions are not weighed. */
#ifndef MARK_H
#define MARK_H

#ifdef __arm__
#define MARK_BEGIN() __asm__ volatile("dbg #1" : : : "memory")
#define MARK_END() __asm__ volatile("dbg #2" : : : "memory")
#else
#define MARK_BEGIN() ((void)0)
#define MARK_END() ((void)0)
#endif

#endif
