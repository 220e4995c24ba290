"""Traps of a particle: minima of the potential, barriers, focus times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legder, legval2d, legvander2d

from geometry.measure import ABOUT_AXIS, Measure
from workbench.acoustics.basins import find_basins, find_walls, label_basins, lowest_pass, outward
from workbench.acoustics.focusing import FROM, TO, along_stiffest
from workbench.acoustics.forces import Excitation, ParticleForces, focus_time_along, force_at, way_to_wall
from workbench.acoustics.nodal import FloatArray, interpolate, raster
from workbench.model.particles import net_weight
from workbench.results.brief import Brief

#: Raster points per wavelength of sound for minima and passes of the potential. They are 32 per period of the potential
#: of a standing wave, so the error of a pass is at most (pi / 32)^2 / 4 = 0.2 % of its span.
RASTER_POINTS = 64
#: Degree of the polynomial fitted about a minimum; over half a period its relative error in the curvature is 1e-6.
FIT_DEGREE = 8


@dataclass(frozen=True, kw_only=True)
class Trap:
    """A place where the sound field would bring a particle to rest.

    ``radius``, ``height`` r, z in m (in a straight section, whose traps are lines along the channel, x and z), and
    ``above_floor`` m from the cavity's floor below it; ``potential`` J; ``depth`` J below the pass to a deeper trap or,
    for the deepest, below the highest potential in the region. ``radial_stiffness``, ``axial_stiffness`` N/m, along r
    (or x) and z; ``on_wall``: at a wall, where the force need not vanish (stiffness is then the curvature at the wall).
    ``measure`` is that of the section.

    With the weight less buoyancy in the potential: ``barrier`` J, the lowest pass on the way to another trap or
    to a wall on which the particle does not lie; ``axial_barrier`` and ``radial_barrier`` J, the passes for
    motion along z or along r only, hence no lower. All are 0 if the weight pulls the particle out, and None if it
    cannot leave. ``lift`` N, the largest force against the weight on the vertical line through the trap; None if a wall
    supports the weight. ``share``: the part of the cavity's volume that drains into the trap.
    """

    radius: float
    height: float
    above_floor: float
    potential: float
    depth: float
    barrier: float | None
    axial_barrier: float | None
    radial_barrier: float | None
    lift: float | None
    share: float
    radial_stiffness: float
    axial_stiffness: float
    on_wall: bool
    measure: Measure = ABOUT_AXIS

    @property
    def holds(self) -> bool:
        """Whether the particle stays against its weight."""
        return self.barrier is None or self.barrier > 0.0

    def __str__(self) -> str:
        across, up = self.measure.directions
        r, z, above = (f"{1e3 * each:.{self.measure.decimals + 1}f} mm" for each in (
            self.radius, self.height, self.above_floor))
        return (
            f"{self.measure.symbol} = {r}, z = {z}, {above} above "
            f"the floor{' on the wall' if self.on_wall else ''}: barrier {barrier_words(self.barrier)} "
            f"({up} {barrier_words(self.axial_barrier)}, {across} {barrier_words(self.radial_barrier)}), "
            f"stiffness {self.radial_stiffness * 1e9:.3g} pN/mm {across}, {self.axial_stiffness * 1e9:.3g} pN/mm {up}"
        )


def barrier_words(barrier: float | None) -> str:
    """A barrier (J) as text, in fJ."""
    return "none to pass" if barrier is None else f"{barrier * 1e15:.3g} fJ"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrapReport(Brief):
    """The traps of one field and particle, deepest first."""

    forces: ParticleForces
    traps: tuple[Trap, ...]

    @property
    def excitation(self) -> Excitation:
        """The field of the traps."""
        return self.forces.excitation

    @property
    def settled(self) -> float:
        """Share of the cavity's volume from which particles settle on a wall."""
        return max(0.0, 1.0 - sum(trap.share for trap in self.traps))

    def __str__(self) -> str:
        listed = "\n".join(f"  {number}. {trap}" for number, trap in enumerate(self.traps, start=1))
        return f"{self.forces}\n{listed or '  no trap'}"


def find_traps(forces: ParticleForces, *, least_depth: float = 1e-2) -> TrapReport:
    """Minima of the potential, deepest first.

    A minimum shallower than `least_depth` times the span of the potential in the region is omitted, since it may be an
    artefact of the mesh. Depths are topological: the lowest pass to a deeper minimum, on a raster of
    :data:`RASTER_POINTS` per wavelength. Barriers are found in the same way in the potential that includes the weight.
    Place, value and stiffness come from a polynomial fitted to the potential around, mirrored at the axis
    or at planes of symmetry.
    """
    mesh, potential = forces.mesh, forces.potential
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    r, z = (_subdivided(lines, wavelength / RASTER_POINTS) for lines in mesh.lines)
    values = raster(mesh, potential, r, z, [forces.region])
    least = least_depth * float(np.nanmax(values) - np.nanmin(values))
    landscape = _Landscape(forces, r, z, values, least)
    traps = []
    # Deepest first: if the weight merges two traps, the merged one counts for the deeper.
    for (i, j), highest in sorted(find_basins(values), key=lambda basin: values[basin[0]] - basin[1]):
        if highest - values[i, j] <= least:
            continue
        place, value, curvature = _refine(forces, np.array([r[i], z[j]]), wavelength)
        if not np.isfinite(interpolate(mesh, potential, place[None, :], [forces.region])[0]):
            place, value = np.array([r[i], z[j]]), float(values[i, j])
        # A trap on a mirror line is exactly on it, without rounding.
        radius = mesh.mirrors.snapped(float(place[0]))
        column = np.flatnonzero(np.isfinite(values[i, :j + 1]))
        floor = z[column[np.flatnonzero(np.diff(column, prepend=-2) > 1)[-1]]]
        traps.append(Trap(
            radius=radius, height=float(place[1]), above_floor=max(0.0, float(place[1] - floor)), potential=value,
            depth=highest - value, radial_stiffness=float(curvature[0]), axial_stiffness=float(curvature[1]),
            on_wall=bool(landscape.walls[i, j]), measure=mesh.measure, **landscape.hold(i, j)))
    return TrapReport(forces=forces, traps=tuple(sorted(traps, key=lambda trap: -trap.depth)))


class _Landscape:
    """The potential with weight on a raster, and ways out. A particle leaves a trap when it comes to another one, or to
    a wall on which it does not lie: near a wall other forces act and it may stay. Walls with normals within 60 degrees
    of that of the trap's wall count as that wall."""

    def __init__(self, forces: ParticleForces, r: FloatArray, z: FloatArray, values: FloatArray, least: float) -> None:
        self.forces, self.r, self.z, self.acoustic, self.least = forces, r, z, values, least
        self.weight = net_weight(forces.particle, forces.fluid)
        self.total = values + self.weight * z
        inside = np.isfinite(values)
        self.mirrored = forces.mesh.mirrors.there
        self.walls = find_walls(inside, mirrored=self.mirrored)
        self.outward = outward(inside, mirrored=self.mirrored)
        self.by_sound = label_basins(values, least=least)
        self.label = label_basins(self.total, least=least)
        self.minima = np.zeros(values.shape, dtype=bool)
        self.minima.ravel()[np.unique(self.label[inside])] = True
        edges = np.concatenate([r[:1], 0.5 * (r[1:] + r[:-1]), r[-1:]])
        heights = np.gradient(z)
        heights[[0, -1]] *= 0.5
        depth = forces.mesh.measure.depth(0.5 * (edges[1:] + edges[:-1]))
        self.volume = np.where(inside, np.outer(depth * np.diff(edges), heights), 0.0)
        self.used: set[int] = set()

    def hold(self, i: int, j: int) -> dict[str, Any]:
        """The barriers around a trap of the raster, by fields of :class:`Trap`."""
        rest = int(self.label[i, j])
        at = divmod(rest, self.total.shape[1])
        lies = bool(self.walls[i, j])
        lift = self._lift(i, j)
        # At a wall with another direction, another wall supports the particle.
        elsewhere = self.walls[at] and not (lies and float(self.outward[i, j] @ self.outward[at]) >= 0.5)
        if rest in self.used or self.by_sound[at] != self.by_sound[i, j] or elsewhere:
            return {"barrier": 0.0, "axial_barrier": 0.0, "radial_barrier": 0.0, "lift": lift, "share": 0.0}
        self.used.add(rest)
        others = self.walls.copy()
        if lies:
            others &= self.outward @ self.outward[at] < 0.5
        exits = others | self.minima
        exits[at] = False
        share = float(self.volume[self.label == rest].sum() / self.volume.sum())
        i, j = at
        axial = self._climb(self._along(self.total[i], j, mirrored=(False, False)), at)
        radial = self._climb(self._along(self.total[:, j], i, mirrored=self.mirrored), at)
        # In a corner, where two walls share one mean direction, a straight path may end sooner.
        ways = [way for way in (self._climb(lowest_pass(self.total, at, exits), at), axial, radial) if way is not None]
        return {"barrier": min(ways, default=None), "axial_barrier": axial, "radial_barrier": radial, "lift": lift,
                "share": share}

    def _climb(self, level: float | None, at: tuple[int, int]) -> float | None:
        return None if level is None else level - float(self.total[at])

    def _along(self, line: FloatArray, start: int, *, mirrored: tuple[bool, bool]) -> float | None:
        """The lowest pass (J) out of a place of a line. The line is (n,), the place is `start`. The line ends at a wall
        or at another minimum. A `mirrored` line continues beyond its first or last point: there is no wall."""
        inside = np.pad(np.isfinite(line), 1)
        inside[[0, -1]] = mirrored
        exits = inside[1:-1] & ~(inside[:-2] & inside[2:])
        label = label_basins(line[:, None], least=self.least)[:, 0]
        minima = np.unique(label[label >= 0])
        exits[minima[minima != label[start]]] = True
        exits[start] = False
        return lowest_pass(line[:, None], (start, 0), exits[:, None])

    def _lift(self, i: int, j: int) -> float | None:
        """The largest force (N) against the weight up to the next pass. The pass is in the direction of the weight."""
        step = -1 if self.weight > 0.0 else 1
        column = self.acoustic[i]
        end = j
        while 0 <= end + step < len(column) and column[end + step] >= column[end]:
            end += step
        if end == j:
            return None
        height = np.linspace(self.z[j], self.z[end], 4 * abs(end - j) + 1)
        force = force_at(self.forces, np.stack([np.full(height.size, self.r[i]), height], axis=1))[:, 1]
        return float(np.nanmax(-step * force))


def focus_time(report: TrapReport) -> float | None:
    """Time (s) to the deepest trap along the axial line through it.

    The particle moves from 90 % to 10 % of a quarter wavelength above it. In a straight section the line is across the
    channel instead, over a quarter wavelength or the distance to the side wall if that is shorter, if the trap is
    stiffer that way, or if that is the only way. None without a trap, or if a particle starting there does not come to
    rest at it: a wall is in between, or the field is too weak against the weight.
    """
    return None if not report.traps else _time_from(report, report.traps[0], 1.0)


def time_to(report: TrapReport, trap: Trap) -> float | None:
    """Time (s) to a trap as in :func:`focus_time`, from either side. The other side is used if the first gives None."""
    above = _time_from(report, trap, 1.0)
    return _time_from(report, trap, -1.0) if above is None else above


def _time_from(report: TrapReport, trap: Trap, side: float) -> float | None:
    forces = report.forces
    quarter = 0.25 * forces.fluid.sound_speed / forces.excitation.frequency

    def along(axis: int) -> float:
        if axis == 1 and trap.lift is not None and trap.lift < abs(net_weight(forces.particle, forces.fluid)):
            raise ValueError("the field is too weak to hold the particle against its weight")
        begin = (trap.radius, trap.height)[axis]
        reach = side * min(quarter, math.inf if axis else way_to_wall(forces, trap.radius, trap.height, side))
        return focus_time_along(forces, axis, across=(trap.height, trap.radius)[axis], start=begin + FROM * reach,
                                stop=begin + TO * reach)

    try:
        return along_stiffest(trap.measure, (trap.radial_stiffness, trap.axial_stiffness), along)
    except ValueError:
        return None


def _subdivided(lines: FloatArray, spacing: float) -> FloatArray:
    """`lines` with equally spaced ones between, no further apart than `spacing`."""
    parts = [np.linspace(low, high, math.ceil((high - low) / spacing), endpoint=False)
             for low, high in pairwise(lines)]
    return np.concatenate([*parts, lines[-1:]])


def _refine(forces: ParticleForces, start: FloatArray, wavelength: float) -> tuple[FloatArray, float, FloatArray]:
    """Place (2,), value and second derivatives (2,) of the minimum near `start`.

    The derivatives are along r and z. Newton's method runs on a polynomial of :data:`FIT_DEGREE` along r and along z,
    fitted to the potential within an eighth of the `wavelength` of sound on all sides, half a period of the potential
    of a standing wave. The potential is mirrored at the axis and at planes of symmetry, where it is even.
    """
    reach = wavelength / 8.0
    across = np.linspace(-1.0, 1.0, 2 * FIT_DEGREE + 1)
    local = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2)
    points = start + reach * local
    points = forces.mesh.mirrors.folded(points)[0]
    values = interpolate(forces.mesh, forces.potential, points, [forces.region])
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
        # A minimum outside half the patch belongs to another point, or to a wall.
        if np.abs(place).max() > 0.5:
            place = np.zeros(2)
            break
        if np.abs(step).max() < 1e-12:
            break
    curvature = np.array([derivative(2, 0, place), derivative(0, 2, place)]) / reach**2
    minimum = start + place * reach
    # Rounding may put a minimum on the axis slightly beyond it.
    minimum = forces.mesh.mirrors.folded(minimum[None])[0][0]
    return minimum, derivative(0, 0, place), curvature
