/* What a ground station would see of a log variable or a parameter. The groups of all
 * sources are gathered in one section, as in the firmware. */
#pragma once

typedef struct {
	const char *kind, *group, *name, *type;
	void *address;
} variable;

#define VARIABLES(KIND, GROUP)                                                                               \
	__attribute__((section("variables"), used)) static const variable KIND##_##GROUP[] = {                   \
	    {#KIND, #GROUP, "", "", (void *)0},
#define VARIABLE(TYPE, NAME, ADDRESS) {"", "", #NAME, TYPE, (void *)(ADDRESS)},
#define VARIABLES_END                                                                                        \
	}                                                                                                        \
	;
