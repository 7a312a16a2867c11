"""The compiled programs of tools/bench."""

import json
import subprocess
from pathlib import Path

from ..plumbing.errors import UserError


def program(build_dir, name):
    """Path of a program; build_dir was configured with -DTINYKOOP_BENCH=ON."""
    path = Path(build_dir) / "tools" / "bench" / name
    if not path.is_file():
        raise UserError(f"{path} is missing: configure with -DTINYKOOP_BENCH=ON and build")
    return path


def read(path, *arguments):
    """The JSON lines that it prints."""
    done = subprocess.run([str(path), *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise UserError(f"{path.name} failed: {done.stderr.strip() or done.returncode}")
    return [json.loads(line) for line in done.stdout.splitlines()]
