"""Where a particle comes to rest: minima of the potential, their depth and stiffness, and the time to reach them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legder, legval2d, legvander2d

from workbench.basins import find_basins, find_walls
from workbench.field_forces import Excitation, ParticleForces, axial_focus_time
from workbench.nodal import FloatArray, raster, sample

#: Points a wavelength of sound at which minima and passes of the potential are looked for: 32 a period of the potential
#: of a standing wave, so a pass is at most (pi / 32)^2 / 4 = 0.2 % of its span off.
RASTER_POINTS = 64
#: Degree of the polynomial fitted about a minimum; over half a period it leaves 1e-6 of the curvature.
FIT_DEGREE = 8


@dataclass(frozen=True, kw_only=True)
class Trap:
    """A place where the particle comes to rest.

    ``radius``, ``height`` r, z in m; ``potential`` J; ``depth`` J, what it takes to leave for a deeper trap or, from
    the deepest, to reach the highest potential in the region; ``radial_stiffness``, ``axial_stiffness`` N/m;
    ``on_wall``: held at a wall, where the force need not vanish (stiffness is then the curvature at the wall).
    """

    radius: float
    height: float
    potential: float
    depth: float
    radial_stiffness: float
    axial_stiffness: float
    on_wall: bool

    def __str__(self) -> str:
        return (
            f"r = {self.radius * 1e3:.3f} mm, z = {self.height * 1e3:.3f} mm{' on the wall' if self.on_wall else ''}: "
            f"depth {self.depth * 1e15:.3g} fJ, stiffness {self.radial_stiffness * 1e9:.3g} pN/mm radial, "
            f"{self.axial_stiffness * 1e9:.3g} pN/mm axial"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class TrapReport:
    """The traps of one field for one particle, deepest first, with the forces they were found in."""

    forces: ParticleForces
    traps: tuple[Trap, ...]

    @property
    def excitation(self) -> Excitation:
        """The field the traps were found in."""
        return self.forces.excitation

    def __str__(self) -> str:
        listed = "\n".join(f"  {number}. {trap}" for number, trap in enumerate(self.traps, start=1))
        return f"{self.forces}\n{listed or '  no trap'}"


def find_traps(forces: ParticleForces, *, least_depth: float = 1e-2) -> TrapReport:
    """Minima of the potential, deepest first.

    A minimum shallower than `least_depth` times the span of the potential in the region is left out: it may be no more
    than the mesh showing. Depths are topological: the lowest pass to a deeper minimum, on a raster of
    :data:`RASTER_POINTS` a wavelength. Place, value and stiffness come from a polynomial fitted to the potential
    around, mirrored where that reaches the axis.
    """
    mesh, potential = forces.mesh, forces.potential
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    r, z = (_subdivided(lines, wavelength / RASTER_POINTS) for lines in mesh.lines)
    values = raster(mesh, potential, r, z, [forces.region])
    span = float(np.nanmax(values) - np.nanmin(values))
    at_wall = find_walls(np.isfinite(values), on_axis=bool(r[0] < 1e-9 * r[-1]))
    traps = []
    for (i, j), highest in find_basins(values):
        if highest - values[i, j] <= least_depth * span:
            continue
        place, value, curvature = _refine(forces, np.array([r[i], z[j]]), wavelength)
        if not np.isfinite(sample(mesh, potential, place[None, :], [forces.region])[0]):
            place, value = np.array([r[i], z[j]]), float(values[i, j])
        # A trap on the axis is on it, not a rounding error beside it.
        radius = 0.0 if place[0] < 1e-9 * r[-1] else float(place[0])
        traps.append(Trap(
            radius=radius, height=float(place[1]), potential=value, depth=highest - value,
            radial_stiffness=float(curvature[0]), axial_stiffness=float(curvature[1]), on_wall=bool(at_wall[i, j]),
        ))
    return TrapReport(forces=forces, traps=tuple(sorted(traps, key=lambda trap: -trap.depth)))


def focus_time(report: TrapReport) -> float | None:
    """Time (s) to the deepest trap along the axial line through it, from 90 % to 10 % of a quarter wavelength above it.

    None where there is no trap, or where a particle starting there is not drawn all the way down: a wall is in between,
    or the field is too weak against the particle's weight.
    """
    if not report.traps:
        return None
    trap, forces = report.traps[0], report.forces
    quarter = 0.25 * forces.fluid.sound_speed / forces.excitation.frequency
    try:
        return axial_focus_time(forces, radius=trap.radius, start=trap.height + 0.9 * quarter,
                                stop=trap.height + 0.1 * quarter)
    except ValueError:
        return None


def _subdivided(lines: FloatArray, spacing: float) -> FloatArray:
    """`lines` with equally spaced ones between, no further apart than `spacing`."""
    parts = [np.linspace(low, high, math.ceil((high - low) / spacing), endpoint=False)
             for low, high in pairwise(lines)]
    return np.concatenate([*parts, lines[-1:]])


def _refine(forces: ParticleForces, start: FloatArray, wavelength: float) -> tuple[FloatArray, float, FloatArray]:
    """Place (2,), value and second derivatives (2,) along r and z of the minimum next to `start` (2,).

    Newton's method on a polynomial of :data:`FIT_DEGREE` along r and along z, fitted to the potential within an eighth
    of the `wavelength` of sound on all sides: that is half a period of the potential of a standing wave. The potential
    is even in r, so behind the axis it is as before it.
    """
    reach = wavelength / 8.0
    across = np.linspace(-1.0, 1.0, 2 * FIT_DEGREE + 1)
    local = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2)
    points = start + reach * local
    points[:, 0] = np.abs(points[:, 0])
    values = sample(forces.mesh, forces.potential, points, [forces.region])
    inside = np.isfinite(values)
    local, values = local[inside], values[inside]
    degree = [min(FIT_DEGREE, len(np.unique(local[:, axis])) - 1) for axis in (0, 1)]
    design = legvander2d(local[:, 0], local[:, 1], degree)
    fitted = np.linalg.lstsq(design, values, rcond=None)[0].reshape(degree[0] + 1, degree[1] + 1)

    def derivative(along_r: int, along_z: int, at: FloatArray) -> float:
        polynomial = legder(legder(fitted, along_r, axis=0), along_z, axis=1)
        return float(legval2d(at[0], at[1], polynomial))

    place = np.zeros(2)
    for _ in range(20):
        slope = np.array([derivative(1, 0, place), derivative(0, 1, place)])
        cross = derivative(1, 1, place)
        hessian = np.array([[derivative(2, 0, place), cross], [cross, derivative(0, 2, place)]])
        if np.linalg.eigvalsh(hessian)[0] <= 0.0:
            place = np.zeros(2)
            break
        step = np.linalg.solve(hessian, slope)
        place = place - step
        # A minimum that is not within half the patch belongs to another point, or to a wall.
        if np.abs(place).max() > 0.5:
            place = np.zeros(2)
            break
        if np.abs(step).max() < 1e-12:
            break
    curvature = np.array([derivative(2, 0, place), derivative(0, 2, place)]) / reach**2
    minimum = start + place * reach
    # Rounding may put a minimum on the axis a hair behind it.
    minimum[0] = max(minimum[0], 0.0)
    return minimum, derivative(0, 0, place), curvature
