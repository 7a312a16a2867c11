"""What the sources of lib/ list, for developers' commands, which build lib/ themselves and need no host library."""

import re

from . import checkout

HEADER = checkout.ROOT / "lib/include/tinykoop.h"


def regulators():
    """Names of all regulators, in the order of KOOP_REGULATORS, as bridge.regulators() has them.

    An installed package has no sources and refuses these commands: there are none then."""
    if not checkout.EXISTS:
        return ()
    found = re.search(r"#define KOOP_REGULATORS\(X\)((?:.*\\\n)*.*)", HEADER.read_text())
    return tuple(re.findall(r"X\((\w+)\)", found[1]))
