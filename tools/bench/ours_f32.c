/* TinyKoop's part of the benchmark in float32. */
#include "bench.h"
#include "tinykoop.h"

#define REAL float
#define PRECISION "f32"
#define MATH(function) function##f
#define KOOP(name) koopf_##name
#define BENCH(name) bench_##name##_f32

#include "ours.h"
