"""Common parts of all pictures: VTK off screen, figures, units, atomic saving."""

from __future__ import annotations

import ctypes.util
import importlib
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.files.writing import replacing
from workbench.render.figure import text_figure

if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

    from workbench.acoustics.forces import Excitation

#: Colour map for quantities with a sign, zero in the middle; and a perceptually uniform one for the others.
SIGNED_COLOURS = "RdBu_r"
PLAIN_COLOURS = "viridis"

#: The colour of a region by its role, the same in every picture and for a repeated role (bond_2).
ROLE_COLOURS = {
    "transducer": "#8fa9c9", "backing": "#b3b3b3", "couplant": "#f28e2b", "matching": "#e9c46a", "substrate": "#9ccb86",
    "sidewall": "#c9b2d6", "cavity": "#bfe3f2", "bond": "#b5651d", "superstrate": "#e8b4bc", "sample": "#9ccb86",
    "layer": "#d9cfa3",
}
#: Colour of regions without a field and without a known role.
OTHER_COLOUR = "#cccccc"

#: Free share of a photograph at each side. Doubled, a chip is 3 % smaller.
MARGIN = 0.03

#: Largest number of panels side by side in one picture: more would be too many to read.
PANELS_ACROSS = 3

#: Points of the raster along each side of a dot, which is their mean, for smooth edges and thin layers. Doubled, four
#: times as many are computed.
POINTS_PER_DOT = 2

_PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def coloured_dots(values: NDArray[np.float64], shades: Colormap, limits: tuple[float, float]) -> NDArray[np.uint8]:
    """The dots (m, n, 3) of a picture of `values`, NaN white. `values` have POINTS_PER_DOT points each way to a dot,
    downwards and to the right."""
    from matplotlib.colors import Normalize

    down, across = (size // POINTS_PER_DOT for size in values.shape)
    shown = Normalize(*limits)(np.ma.masked_invalid(values))
    fine = shades.with_extremes(bad="white")(shown, bytes=True)[:, :, :3]
    dots: NDArray[np.uint8] = fine.reshape(down, POINTS_PER_DOT, across, POINTS_PER_DOT, 3).mean(
        axis=(1, 3)).round().astype(np.uint8)
    return dots


@dataclass(frozen=True)
class Picture:
    """A PNG file and its caption."""

    path: Path
    caption: str


@dataclass(frozen=True, eq=False)
class DrawnShape:
    """A shape to draw.

    ``points`` (N, 3) are in m; ``cells`` (M, k) are polygons, or lines if k is 2. ``colour`` is a name of matplotlib's
    or ``#rrggbb``, or one for every point, (N, 3) in 0 to 255. ``light`` are shares of ambient, diffuse and specular
    light; None draws the plain colour. ``width`` is of lines in dots.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    colour: str | NDArray[np.uint8]
    light: tuple[float, float, float] | None = None
    width: float = 1.0
    opacity: float = 1.0


def vtk_modules(*names: str) -> tuple[Any, ...]:
    """The modules of VTK with these names, ready to draw off screen.

    Importing all of VTK takes a second. VTK chooses its window type with the first window, so EGL is chosen here.

    Raises:
        RuntimeError: there is neither a display nor the EGL library to draw without one, or VTK is not installed.
    """
    if not os.environ.get("DISPLAY") and sys.platform == "linux":
        if ctypes.util.find_library("EGL") is None:
            raise RuntimeError("no display and no EGL library: install libegl1 and libgl1 to draw off screen")
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        return tuple(importlib.import_module(f"vtkmodules.{name}") for name in names)
    except ImportError as error:
        raise RuntimeError(f"pictures of the chip in space need VTK and its system libraries (./setup installs both): "
                           f"{error}; simulate --no-pictures leaves them out") from error


def photograph(
    shapes: Sequence[DrawnShape], *, azimuth: float, elevation: float, width: int, height: int
) -> NDArray[np.uint8]:
    """The (height, width, 3) picture of `shapes` on white, in parallel projection.

    The camera looks at their middle from `azimuth` (degrees from +x, about z) and `elevation`; they fill the picture up
    to a margin of :data:`MARGIN`. Three lights move with the camera.
    """
    # Importing the second module registers the drawing functions.
    rendering, _, support = vtk_modules("vtkRenderingCore", "vtkRenderingOpenGL2", "util.numpy_support")
    renderer, window = rendering.vtkRenderer(), rendering.vtkRenderWindow()
    for shape in shapes:
        renderer.AddActor(_actor(shape))
    renderer.SetBackground(1.0, 1.0, 1.0)
    renderer.RemoveAllLights()
    renderer.AutomaticLightCreationOff()
    for intensity, up, aside in ((1.0, 45.0, 45.0), (0.6, -30.0, -60.0), (0.5, -30.0, 60.0)):
        light = rendering.vtkLight()
        light.SetLightTypeToCameraLight()
        light.SetIntensity(intensity)
        rise, turn = math.radians(up), math.radians(aside)
        light.SetPosition(math.sin(turn) * math.cos(rise), math.sin(rise), math.cos(turn) * math.cos(rise))
        renderer.AddLight(light)
    turn, rise = math.radians(azimuth), math.radians(elevation)
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    towards = np.array([math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)])
    sideways = np.array([-math.sin(turn), math.cos(turn), 0.0])
    # Coordinates across, up and towards the camera, of every point.
    axes = np.stack([sideways, np.cross(towards, sideways), towards])
    seen = np.concatenate([shape.points for shape in shapes]) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high) @ axes
    camera.SetFocalPoint(*middle)
    camera.SetPosition(*(middle + float(np.linalg.norm(high - low)) * towards))
    camera.SetViewUp(0.0, 0.0, 1.0)
    half_width, half_height = 0.5 * (high - low)[:2]
    camera.SetParallelScale((1.0 + MARGIN) * max(float(half_height), float(half_width) * height / width))
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(4)
    window.SetSize(width, height)
    window.AddRenderer(renderer)
    renderer.ResetCameraClippingRange()
    grab = rendering.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    picture = support.vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars()).reshape(height, width, -1)
    window.Finalize()
    return np.ascontiguousarray(picture[::-1, :, :3])


def surface(points: NDArray[np.float64], cells: NDArray[np.int64]) -> Any:
    """A vtkPolyData of `points` (N, 3) m and `cells` (M, k). Cells are polygons, or lines if k is 2."""
    model, core, support = vtk_modules("vtkCommonDataModel", "vtkCommonCore", "util.numpy_support")
    data, holder, array = model.vtkPolyData(), core.vtkPoints(), model.vtkCellArray()
    holder.SetData(support.numpy_to_vtk(np.ascontiguousarray(points), deep=1))
    data.SetPoints(holder)
    ends = np.arange(0, cells.size + 1, cells.shape[1], dtype=np.int64)
    array.SetData(support.numpy_to_vtkIdTypeArray(ends, deep=1),
                  support.numpy_to_vtkIdTypeArray(np.ascontiguousarray(cells, dtype=np.int64).ravel(), deep=1))
    (data.SetLines if cells.shape[1] == 2 else data.SetPolys)(array)
    return data


def _actor(shape: DrawnShape) -> Any:
    from matplotlib.colors import to_rgb

    rendering, support = vtk_modules("vtkRenderingCore", "util.numpy_support")
    data, mapper, actor = surface(shape.points, shape.cells), rendering.vtkPolyDataMapper(), rendering.vtkActor()
    look = actor.GetProperty()
    look.SetInterpolationToFlat()
    look.SetOpacity(shape.opacity)
    look.SetLineWidth(shape.width)
    if isinstance(shape.colour, str):
        look.SetColor(*to_rgb(shape.colour))
    else:
        data.GetPointData().SetScalars(support.numpy_to_vtk(np.ascontiguousarray(shape.colour), deep=1))
    if shape.light is None:
        look.LightingOff()
    else:
        ambient, diffuse, specular = shape.light
        look.SetAmbient(ambient)
        look.SetDiffuse(diffuse)
        look.SetSpecular(specular)
    mapper.SetInputData(data)
    actor.SetMapper(mapper)
    return actor


def role_colour(region: str) -> str:
    """The colour of a region by its role, without number and suffix."""
    role = region.split(".")[0].rstrip("0123456789").rstrip("_")
    return ROLE_COLOURS.get(role, OTHER_COLOUR)


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Factor and label for values up to `largest`, from 1 to 1000. Example: (1e9, "nm") for 5.4e-8 m."""
    if not largest > 0.0 or not math.isfinite(largest):
        return 1.0, unit
    exponent = min(max(3 * math.floor(math.log10(largest) / 3 + 1e-9), min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-exponent, _PREFIXES[exponent] + unit


def typeset(excitation: Excitation) -> str:
    """The line that describes the field of a force, with typeset symbols."""
    return str(excitation).replace("J/m^3", "J/m³").replace("p0 =", "p₀ =")


def new_figure(width: float, height: float) -> Figure:
    """An empty matplotlib figure (inches), outside pyplot's global state. Its texts are not read as formulas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = text_figure(width, height)
    FigureCanvasAgg(figure)
    return figure


def panel_grid(
    count: int, *, across: int, panel: tuple[float, float], margin: tuple[float, float], sharey: bool = False
) -> tuple[Figure, NDArray[Any]]:
    """A figure of `count` panels, at most `across` a row. Its axes (rows, columns) are hidden if they have no panel.
    Every panel takes `panel` inches (width, height), the figure a `margin` besides."""
    columns = min(across, count)
    rows = -(-count // columns)
    figure = new_figure(margin[0] + panel[0] * columns, margin[1] + panel[1] * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=sharey)
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    return figure, grid


def save_figure(figure: Figure, path: Path, *, dots_per_inch: int = 150) -> Path:
    """Write `figure` as PNG or SVG, by the suffix of `path`, atomically.

    Raises:
        ValueError: another suffix.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg"):
        raise ValueError(f"cannot write {path.name!r}: the suffix is {path.suffix!r}; expected .png or .svg")
    with replacing(path) as whole:
        if kind == "svg":
            # Without a date, equal figures are equal files.
            figure.savefig(whole, format=kind, dpi=dots_per_inch, metadata={"Date": None})
        else:
            # A quarter larger than at the usual level of 6, in half of the time.
            figure.savefig(whole, format=kind, dpi=dots_per_inch, pil_kwargs={"compress_level": 4})
    return path
