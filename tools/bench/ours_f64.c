/* TinyKoop's part of the benchmark in float64. */
#include "bench.h"
#include "tinykoop.h"

#define REAL double
#define PRECISION "f64"
#define MATH(function) function
#define KOOP(name) koopd_##name
#define BENCH(name) bench_##name##_f64

#include "ours.h"
