/* The sources of TinyKoop, each after those that it uses.
 * koopf.c and koopd.c define `real`, MATH and KOOP, and include this file. */
#include "strict.h"
#include "attributes.h"

#include "finite.c"
#include "checksum.c"
#include "vector.c"
#include "status.c"
#include "elementary.c"

#include "dictionary.c"
#include "dictionary_ddr.c"
#include "dictionary_fwmav.c"
#include "dictionary_combined.c"

/* koopf_name_ef and so on. Literals would share a section, of which a program links all. */
#define NAME_OF(name) static const char KOOP(name_##name)[] = #name;
KOOP_REGULATORS(NAME_OF)
#undef NAME_OF

#include "regulator_none.c"
#include "regulator_ef.c"
#include "regulator_dead_zone.c"
#include "regulator_ct.c"
#include "regulator_sift.c"
#include "regulator_reset.c"
#include "regulator_vrf.c"
#include "regulator_er.c"
#include "regulator_kulhavy.c"
#include "regulator_bgf.c"

#include "triangle.c"
#include "symmetric.c"
#include "form_plain.c"
#include "form_sqrt.c"

#include "rls.c"
#include "extension.c"
#include "gate.c"
#include "threshold.c"
#include "lowpass.c"
#include "model.c"

#include "limits.c"
#include "condensed.c"
#include "weights.c"
#include "newton.c"
#include "projected.c"
#include "mpc.c"

#include "self_test.c"
