"""One look for all plots: readable in greyscale, units on every axis."""

import io
from functools import lru_cache

import numpy as np

from .results import write_bytes

LOOK = {
    "figure.dpi": 130,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
}

# Colour and dash differ together, and the colours differ in lightness.
STYLES = {
    "offline": dict(color="#999999", ls="-"),
    "none": dict(color="#bbbbbb", ls="-."),
    "ef": dict(color="#d62728", ls="--"),
    "dz_cs": dict(color="#08306b", ls="-"),
    "dz_ks": dict(color="#4292c6", ls=(0, (3, 1))),
    "ct": dict(color="#e6a000", ls="-."),
    "sift": dict(color="#1b7837", ls=":"),
}
HATCHES = {"offline": "", "none": "", "ef": "xx", "dz_cs": "//", "dz_ks": "\\\\", "ct": "..", "sift": "--"}


@lru_cache
def _pyplot():
    """Imported for the first figure: what fails before that need not wait half a second for it."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot

    matplotlib.pyplot.rcParams.update(LOOK)
    return matplotlib.pyplot


def subplots(*arguments, **options):
    """Figure and axes, as pyplot.subplots()."""
    return _pyplot().subplots(*arguments, **options)


def patches():
    """Shapes for legends, as matplotlib.patches."""
    import matplotlib.patches

    return matplotlib.patches


def save(figure, path):
    """Saves and closes the figure."""
    image = io.BytesIO()
    try:
        figure.savefig(image, format="png")
    finally:
        _pyplot().close(figure)
    write_bytes(path, image.getvalue())


def smooth(values, width=50):
    """Running root mean square over `width` samples, for errors that swing with the commands."""
    kernel = np.ones(width) / width
    values = np.where(np.isfinite(values), values, 0)
    return np.sqrt(np.maximum(np.convolve(values**2, kernel, mode="same"), 0))
