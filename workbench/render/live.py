"""Pictures of a section for a page with its own axes.

They are colours alone, made in some hundredths of a second.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geometry.names import CAVITY
from workbench.acoustics.nodal import FloatArray, NodalMesh, raster
from workbench.acoustics.traps import TrapReport
from workbench.render.canvas import PLAIN_COLOURS, POINTS_PER_DOT, SIGNED_COLOURS, coloured_dots, prefixed
from workbench.render.sections import at_largest, region_edges

if TYPE_CHECKING:
    from workbench.acoustics.fields import Fields

#: Width of a picture in dots, as on the page.
_DOTS = 880
#: Steps of the colour gradient of a legend.
_STRIP = 9


@dataclass(frozen=True)
class LivePicture:
    """A field in the section, mirrored about its axis or symmetry plane.

    ``png`` fills ``window`` (left, right, bottom, top; mm). ``low`` and ``high`` in ``unit`` are the values at the ends
    of ``colours`` (CSS); ``outline`` are lines of regions (x, z, x, z; mm), ``marks`` are points (r, z; mm) with their
    names; ``tall`` is the factor by which heights are enlarged.
    """

    name: str
    title: str
    png: bytes
    window: tuple[float, float, float, float]
    low: float
    high: float
    unit: str
    colours: str
    outline: tuple[tuple[float, float, float, float], ...]
    marks: tuple[tuple[float, float, str], ...] = ()
    tall: float = 1.0


def live_pictures(fields: Fields, traps: TrapReport | None) -> Iterator[LivePicture]:
    """The pictures of displacement, cavity pressure and potential, drawn on request. The potential has its traps."""
    mesh = fields.mesh
    yield _signed("displacement", "axial displacement u_z", mesh, fields.displacement[:, 1], "m", tall=1.0)
    if CAVITY in fields.fluid_regions:
        pressure = np.full_like(fields.pressure, np.nan)
        nodes = mesh.nodes_of([CAVITY])
        pressure[nodes] = fields.pressure[nodes]
        yield _signed("pressure", "pressure", mesh, pressure, "Pa", tall=2.0)
    if traps is not None:
        forces = traps.forces
        factor, unit = prefixed(float(np.nanmax(np.abs(forces.potential))), "J")
        values = forces.potential * factor
        marks = tuple((sign * trap.radius * 1e3, trap.height * 1e3, str(trap)) for trap in traps.traps
                      for sign in ((-1.0, 1.0) if trap.measure.mirror and trap.radius > 0.0 else (1.0,)))
        title = f"Gor'kov potential, {2e6 * forces.particle.radius:.3g} µm {forces.particle.name.split('/')[0]}"
        yield _picture("potential", title, forces.mesh, values, unit, PLAIN_COLOURS,
                       (float(values.min()), float(values.max())), marks, tall=2.0)


def _signed(
    name: str, title: str, mesh: NodalMesh, amplitude: NDArray[np.complex128], unit: str, *, tall: float
) -> LivePicture:
    """A field with a sign, at the phase of its maximum."""
    values, _ = at_largest(amplitude)
    largest = float(np.nanmax(np.abs(values)))
    factor, shown = prefixed(largest, unit)
    end = largest * factor or 1.0
    return _picture(name, title, mesh, values * factor, shown, SIGNED_COLOURS, (-end, end), (), tall=tall,
                    image=float(mesh.measure.mirror))


def _picture(
    name: str, title: str, mesh: NodalMesh, values: FloatArray, unit: str, colours: str, limits: tuple[float, float],
    marks: tuple[tuple[float, float, str], ...], *, tall: float, image: float = 1.0,
) -> LivePicture:
    """The picture of `values` (N,); the mirror image has them `image` times."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex
    from PIL import Image

    regions = [each for each in mesh.regions if np.isfinite(values[mesh.nodes_of([each])]).all()]
    there = mesh.points[mesh.nodes_of(regions)]
    # The solids are shown with their surroundings; a field of the cavity alone fills the picture.
    shown = mesh.points if len(regions) > 1 else there
    radius, bottom, top = (float(each) for each in (shown[:, 0].max(), shown[:, 1].min(), shown[:, 1].max()))
    mirrored = mesh.measure.mirror != 0
    left, across = (0.0, _DOTS // 2) if mirrored else (-radius, _DOTS)
    up = max(1, round(tall * _DOTS * (top - bottom) / (2.0 * radius)))
    r = left + (np.arange(POINTS_PER_DOT * across) + 0.5) * (radius - left) / (POINTS_PER_DOT * across)
    z = bottom + (np.arange(POINTS_PER_DOT * up) + 0.5) * (top - bottom) / (POINTS_PER_DOT * up)
    seen, shades = raster(mesh, values, r, z, regions).T[::-1], colormaps[colours]
    right = coloured_dots(seen, shades, limits)
    # The mirror image of an even field has the same colours.
    other = right if image == 1.0 else coloured_dots(image * seen, shades, limits)
    whole = np.concatenate([other[:, ::-1], right], axis=1) if mirrored else right
    file = io.BytesIO()
    Image.fromarray(whole).save(file, "png", compress_level=1)
    strip = ", ".join(to_hex(shades(share)) for share in np.linspace(0.0, 1.0, _STRIP))
    outline = tuple((float(a[0]), float(a[1]), float(b[0]), float(b[1])) for a, b in region_edges(mesh)
                    if max(a[1], b[1]) <= 1e3 * top + 1e-6 and min(a[1], b[1]) >= 1e3 * bottom - 1e-6
                    and max(abs(a[0]), abs(b[0])) <= 1e3 * radius + 1e-6)
    return LivePicture(name, title, file.getvalue(), (-1e3 * radius, 1e3 * radius, 1e3 * bottom, 1e3 * top), *limits,
                       unit, f"linear-gradient(to right, {strip})", outline, marks, tall)
