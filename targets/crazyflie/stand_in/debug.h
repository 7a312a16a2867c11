/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include <stdio.h>

#define DEBUG_PRINT(...) ((void)printf(DEBUG_MODULE ": " __VA_ARGS__))
