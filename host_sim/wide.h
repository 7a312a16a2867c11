/* Inner loops with the widest vectors that the processor has. Each element is computed by itself and nothing
 * is contracted, so the numbers are the same with all of them. Sanitizers do not yet run when a loader
 * chooses. */
#ifndef TINYKOOP_WIDE_H
#define TINYKOOP_WIDE_H

#if defined(__x86_64__) && defined(__linux__) && defined(__GLIBC__) && defined(__GNUC__) &&                  \
    !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define WIDE __attribute__((flatten, target_clones("default", "avx2")))
#else
#define WIDE
#endif

#endif
