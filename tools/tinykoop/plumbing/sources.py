"""What the sources of lib/ list, for tools that build lib/ themselves and need no host library."""

import re
from pathlib import Path

HEADER = Path(__file__).resolve().parents[3] / "lib/include/tinykoop.h"


def regulators():
    """Names of all regulators, in the order of KOOP_REGULATORS, as bridge.regulators() has them."""
    found = re.search(r"#define KOOP_REGULATORS\(X\)((?:.*\\\n)*.*)", HEADER.read_text())
    return tuple(re.findall(r"X\((\w+)\)", found[1]))
