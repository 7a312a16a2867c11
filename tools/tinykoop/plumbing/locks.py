"""Locks between processes: of files and folders by flock(), on Windows of the first byte of a file."""

import os
import sys
import time
from contextlib import contextmanager
from pathlib import Path

PAUSE = 0.1  # s, between two attempts on Windows

if sys.platform == "win32":
    import msvcrt

    def _open(path):
        path = Path(path) / ".lock" if Path(path).is_dir() else path  # Windows opens no folder
        return os.open(path, os.O_RDWR | os.O_CREAT)

    def _take(lock, wait):
        while True:
            try:
                return msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
            except PermissionError as error:  # another process has it
                if not wait:
                    raise BlockingIOError(*error.args) from None
                time.sleep(PAUSE)

else:
    import fcntl

    def _open(path):
        return os.open(path, os.O_RDONLY if Path(path).is_dir() else os.O_RDWR | os.O_CREAT, 0o666)

    def _take(lock, wait):
        fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


@contextmanager
def locked(path, wait=True):
    """Holds the lock of a folder, or of a file that is made if need be. BlockingIOError: another has it, and this does not wait."""
    lock = _open(path)
    try:
        _take(lock, wait)
        yield
    finally:
        os.close(lock)  # which releases it
