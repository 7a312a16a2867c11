"""Makes the tools importable without installing them, and computes as they do: in one thread."""

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_collection_modifyitems(items):
    """Tests of a file run in one process, and those of flights too: it then works out once what a healthy flight shows."""
    for item in items:
        name = item.path.stem
        item.add_marker(pytest.mark.xdist_group("flight" if name.startswith("test_flight") else name))
