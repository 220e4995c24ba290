"""What all pictures share: VTK without a display, the frame around a picture, units for an axis, atomic saving."""

from __future__ import annotations

import ctypes.util
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from inputs import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from workbench.particles import Excitation

#: For quantities with a sign, zero in the middle; and for the others, equal steps looking equal.
SIGNED_COLOURS = "RdBu_r"
PLAIN_COLOURS = "viridis"

#: The colour of a region by its role, the same in every picture; a repeated role (bond_2) keeps its colour.
ROLE_COLOURS = {
    "transducer": "#8fa9c9", "backing": "#b3b3b3", "couplant": "#f28e2b", "matching": "#e9c46a", "substrate": "#9ccb86",
    "sidewall": "#c9b2d6", "cavity": "#bfe3f2", "bond": "#b5651d", "superstrate": "#e8b4bc", "sample": "#9ccb86",
    "layer": "#d9cfa3",
}
#: What is coloured by no field and is not a known role.
OTHER_COLOUR = "#cccccc"

_PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def pyvista() -> Any:
    """The pyvista module, ready to draw off screen.

    VTK chooses its window type when it is first imported, so the choice of EGL is made here, before that.

    Raises:
        RuntimeError: there is neither a display nor the EGL library to draw without one.
    """
    if not os.environ.get("DISPLAY") and sys.platform == "linux":
        if ctypes.util.find_library("EGL") is None:
            raise RuntimeError("no display and no EGL library: install libegl1 and libgl1 to draw off screen")
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        import pyvista as module
    except ImportError as error:
        raise RuntimeError("pictures of fields and shapes need pyvista (./setup installs it)") from error
    return module


def photograph(arrange: Callable[[Any], None], *, width: int, height: int) -> NDArray[np.uint8]:
    """The (height, width, 3) picture of a white off-screen scene; `arrange` adds the actors and sets the camera."""
    plotter = pyvista().Plotter(off_screen=True, window_size=(width, height), lighting="three lights")
    try:
        plotter.set_background("white")
        plotter.enable_anti_aliasing("msaa", multi_samples=4)
        arrange(plotter)
        # Without this pyvista fits the camera to the scene when it first draws.
        plotter.camera_set = True
        return np.asarray(plotter.screenshot(return_img=True))[:, :, :3]
    finally:
        plotter.close()


def role_colour(region: str) -> str:
    """The colour of a region or solid by its role, its number and anything after a dot aside."""
    role = region.split(".")[0].rstrip("0123456789").rstrip("_")
    return ROLE_COLOURS.get(role, OTHER_COLOUR)


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Factor and label that bring values up to `largest` into the range 1 to 1000: (1e9, "nm") for 5.4e-8 m."""
    if not largest > 0.0 or not math.isfinite(largest):
        return 1.0, unit
    exponent = min(max(3 * math.floor(math.log10(largest) / 3 + 1e-9), min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-exponent, _PREFIXES[exponent] + unit


def typeset(excitation: Excitation) -> str:
    """The line that says what field a force was computed in, with its symbols set for matplotlib."""
    return str(excitation).replace("J/m^3", "J/m³").replace("p0 =", "$p_0$ =").replace("E_ac", "$E_{ac}$")


def new_figure(width: float, height: float) -> Figure:
    """An empty matplotlib figure of that size in inches, outside pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path, *, dots_per_inch: int = 150) -> Path:
    """Write `figure` as PNG or SVG, by the suffix of `path`, all at once; returns `path`.

    Raises:
        ValueError: another suffix.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg"):
        raise ValueError(f"cannot write {path.name!r}: the suffix is {path.suffix!r}; expected .png or .svg")
    with replacing(path) as whole:
        # Without a date, the same figure is the same file.
        figure.savefig(whole, format=kind, dpi=dots_per_inch, metadata={"Date": None} if kind == "svg" else None)
    return path
