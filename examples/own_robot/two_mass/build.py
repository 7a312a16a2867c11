"""Makes drive.fmu of two_mass.c and modelDescription.xml, with gcc and the headers that come with fmpy.

python build.py [drive.fmu]
"""

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import fmpy

HERE = Path(__file__).resolve().parent
LIBRARY = f"two_mass{fmpy.sharedLibraryExtension}"


def build(fmu):
    """Writes the FMU to a path."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / LIBRARY
        headers = Path(fmpy.__file__).parent / "c-code"
        subprocess.run(["gcc", "-O2", "-shared", "-fPIC", f"-I{headers}", HERE / "two_mass.c", "-o", library, "-lm"], check=True)
        with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(HERE / "modelDescription.xml", "modelDescription.xml")
            archive.write(library, f"binaries/{fmpy.platform}/{LIBRARY}")


if __name__ == "__main__":
    build(sys.argv[1] if len(sys.argv) > 1 else HERE / "drive.fmu")
