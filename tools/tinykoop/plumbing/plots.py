"""One look for all plots: readable in greyscale, units on every axis."""

import io
import os
from functools import lru_cache
from pathlib import Path

import numpy as np

from .errors import UserError
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
class _Styles(dict):
    """What the paper does not have gets a colour and a dash by its name, the same in every run."""

    def __missing__(self, name):
        seed = sum(i * byte for i, byte in enumerate(name.encode(), 1))
        return dict(color=OTHERS[seed % len(OTHERS)], ls=(0, (1 + seed % 3, 1, 4, 1)))


class _Hatches(dict):
    def __missing__(self, name):
        return "xo+*OX"[sum(name.encode()) % 6]


OTHERS = ("#762a83", "#8c510a", "#c51b7d", "#35978f", "#525252", "#bf812d")
STYLES = _Styles({
    "offline": dict(color="#999999", ls="-"),
    "none": dict(color="#bbbbbb", ls="-."),
    "ef": dict(color="#d62728", ls="--"),
    "dz_cs": dict(color="#08306b", ls="-"),
    "dz_ks": dict(color="#4292c6", ls=(0, (3, 1))),
    "ct": dict(color="#e6a000", ls="-."),
    "sift": dict(color="#1b7837", ls=":"),
    "reset": dict(color="#40004b", ls="-"),
    "vrf": dict(color="#8c510a", ls="--"),
    "er": dict(color="#c51b7d", ls=(0, (5, 1, 1, 1))),
    "cr": dict(color="#35978f", ls=(0, (3, 1))),
    "kulhavy": dict(color="#525252", ls=":"),
    "bgf": dict(color="#d8a23a", ls="-."),
})  # fmt: skip
HATCHES = _Hatches({
    "offline": "", "none": "", "ef": "xx", "dz_cs": "//", "dz_ks": "\\\\", "ct": "..", "sift": "--",
    "reset": "x", "vrf": "o", "er": "+", "cr": "*", "kulhavy": "O", "bgf": "X",
})  # fmt: skip


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


def legend(figure):
    """Below all panels, where no data is: each label once."""
    named = {label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels())}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=min(len(named), 7))


def patches():
    """Shapes for legends, as matplotlib.patches."""
    import matplotlib.patches

    return matplotlib.patches


FORMATS = ("svg", "pdf", "npz")


def _formats():
    """What is written beside the PNG: TINYKOOP_FORMAT, which the Makefile sets from FORMAT=."""
    wanted = [name for name in os.environ.get("TINYKOOP_FORMAT", "").replace(",", " ").split() if name != "png"]
    for name in wanted:
        if name not in FORMATS:
            raise UserError(f"FORMAT={name}: plots are written as png, {', '.join(FORMATS)}")
    return wanted


def traces(figure):
    """{panel and label: points (K, 2) of a line or size (K,) of bars}: what a figure shows, in the units of its axes."""
    found = {}
    for i, ax in enumerate(figure.axes):
        for j, line in enumerate(ax.get_lines()):
            label = line.get_label().lstrip("_") or f"line{j}"
            found[f"panel{i}: {label}"] = np.column_stack([np.asarray(part, float) for part in line.get_data()])
        for j, bars in enumerate(ax.containers):
            found |= {f"panel{i}: bars{j}": np.array(bars.datavalues)} if hasattr(bars, "datavalues") else {}
    return found


def _written(figure, name):
    image = io.BytesIO()
    if name == "npz":
        np.savez_compressed(image, **traces(figure))
    else:
        figure.savefig(image, format=name)
    return image.getvalue()


def save(figure, path):
    """Saves and closes the figure."""
    try:
        images = {name: _written(figure, name) for name in ("png", *_formats())}
    finally:
        _pyplot().close(figure)
    for name, image in images.items():
        write_bytes(Path(path).with_suffix(f".{name}"), image)


def smooth(values, width=50):
    """Running root mean square over `width` samples, for errors that swing with the commands."""
    width = min(width, len(values))  # else convolve() would give as many values as the kernel has
    kernel = np.ones(width) / width
    values = np.where(np.isfinite(values), values, 0)
    return np.sqrt(np.maximum(np.convolve(values**2, kernel, mode="same"), 0))
