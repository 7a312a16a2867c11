"""Other programs: whether they are there, and what they print."""

import shutil
import subprocess

from .errors import UserError


def need(programs):
    """Refuses with the install command where one of {program: Debian package} is missing."""
    packages = list(dict.fromkeys(package for program, package in programs.items() if not shutil.which(program)))
    if packages:
        raise UserError(f"missing: {', '.join(packages)}. On Debian: sudo apt-get install {' '.join(packages)}")


def run(*command, timeout=600, passes=(0,), **options):
    """What it prints; what ends with another status than `passes` is said with its last lines."""
    command = [str(part) for part in command]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=timeout, **options)
    except subprocess.TimeoutExpired:
        raise UserError(f"timeout after {timeout} s: {' '.join(command)}")
    if done.returncode not in passes:
        tail = "\n".join((done.stdout + done.stderr).strip().splitlines()[-15:])
        raise UserError(f"exit status {done.returncode}: {' '.join(command)}\n{tail}")
    return done.stdout + done.stderr
