"""The programs of test/soak and test/flips: built in one tree, since both link the same library."""

from ..plumbing.checkout import ROOT
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.locks import locked

BUILD = ROOT / "build/campaigns"
PRECISIONS = ("koopf", "koopd")


def program(name, precision):
    """Path of the program of a campaign."""
    return BUILD / "test" / f"{name}_{precision}"


def build(name):
    """The programs of a campaign; another that is built at the same time is waited for."""
    need({"cmake": "cmake", "gcc": "gcc"})
    BUILD.mkdir(parents=True, exist_ok=True)
    with locked(BUILD):
        run_command("cmake", "-S", ROOT, "-B", BUILD, "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF", "-DCMAKE_C_COMPILER=gcc")
        run_command("cmake", "--build", BUILD, "--target", *(program(name, precision).name for precision in PRECISIONS))
