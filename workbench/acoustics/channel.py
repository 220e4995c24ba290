"""Sound in a straight channel: energy density, pressure profiles, focus lines.

Particles focus across a channel within seconds, and rest at some height, or at its floor or lid, within minutes. The
lines across are therefore those of the potential averaged over the height.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from geometry.dimension import SAME_LENGTH
from geometry.measure import Measure
from workbench.acoustics.basins import find_basins, label_basins
from workbench.acoustics.fields import Fields
from workbench.acoustics.focusing import FROM, TO
from workbench.acoustics.forces import Excitation, ParticleForces, focus_time_along, way_to_wall
from workbench.acoustics.nodal import FloatArray, NodalArray, NodalMesh, integrate, interpolate, raster
from workbench.acoustics.streaming import critical_diameter
from workbench.results.brief import Brief

#: Points per wavelength of sound across the channel, and number of points up. With a linear force between two points,
#: lines are within (pi / 64)^2 of a wavelength.
POINTS_PER_WAVELENGTH, POINTS_UP = 128, 41
#: Depth of a line, as a share of the span of the potential, below which it may be an artefact of the mesh.
LEAST_LINE = 1e-2


@dataclass(frozen=True, kw_only=True)
class FocusLine:
    """A line along the channel to which particles focus.

    A half section has its mirror image too. ``place`` x in m; ``depth`` J, averaged over the height, below the pass to
    a deeper line or, for the deepest, below the maximum; ``share`` of the channel's width that drains to it;
    ``stiffness`` N/m; ``time`` s from 90 to 10 % of a quarter wavelength beside it, or of the distance to the side wall
    if that is shorter, at mid-height, None if particles do not reach it from either side; ``at_side`` if it is at a
    side wall.
    """

    place: float
    depth: float
    share: float
    stiffness: float
    time: float | None
    at_side: bool
    measure: Measure

    def __str__(self) -> str:
        time = "" if self.time is None else f", {self.time:.3g} s from beside it"
        return (f"{self.measure.place_words(self.place)}{' at the side wall' if self.at_side else ''}: "
                f"{100.0 * self.share:.0f} % of the width{time}")


@dataclass(frozen=True)
class ChannelShare:
    """One of the channels of a section. ``left`` and ``right`` are its sides (m), ``energy_density`` (J/m^3) is the
    mean in it."""

    left: float
    right: float
    energy_density: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ChannelFigures(Brief):
    """Figures of one or several straight channels at one frequency and drive.

    ``power`` W for the length of the chip. ``energy_density`` J/m^3 is the mean over the ``channels``, from left to
    right those of the section; it is also given over the squared voltage at the electrodes (``energy_per_square_volt``,
    J/(m^3 Vpp^2)) and over the power (``energy_per_watt``, J/(m^3 W)). ``across`` (n, 2) are x in m and |p| in Pa at
    mid-height, ``up`` (m, 2) heights above the floor and |p| at the largest |p| across. Without a particle, the focus
    ``lines``, deepest first, are empty and ``critical_diameter`` (m), for equal speeds by radiation and streaming, is
    None.
    """

    excitation: Excitation
    power: float
    energy_density: float
    channels: tuple[ChannelShare, ...]
    across: FloatArray
    up: FloatArray
    lines: tuple[FocusLine, ...]
    critical_diameter: float | None

    @property
    def energy_per_square_volt(self) -> float:
        return self.energy_density / (2.0 * self.excitation.voltage) ** 2

    @property
    def energy_per_watt(self) -> float:
        return self.energy_density / self.power

    @property
    def unevenness(self) -> float:
        """Relative variation of |p| over the height at its largest value across."""
        return float(np.ptp(self.up[:, 1]) / self.up[:, 1].mean())

    @property
    def focus_time(self) -> float:
        """Time (s) of a particle to the deepest line, or NaN."""
        time = self.lines[0].time if self.lines else None
        return math.nan if time is None else time

    def __str__(self) -> str:
        largest = 1e-3 * float(self.across[:, 1].max())
        figures = (f"mean E_ac {self.energy_density:.3g} J/m^3, {self.energy_per_square_volt:.3g} J/m^3 per Vpp^2, "
                   f"{self.energy_per_watt:.3g} J/m^3 per W; |p| up to {largest:.4g} kPa across, "
                   f"uneven by {100.0 * self.unevenness:.2g} % over the height")
        critical = "" if self.critical_diameter is None else (
            f"\ncritical diameter {1e6 * self.critical_diameter:.3g} um")
        if len(self.channels) > 1:
            figures += "\n  mean E_ac from left to right " + ", ".join(
                f"{each.energy_density:.3g}" for each in self.channels) + " J/m^3"
        return "\n".join([figures, *(f"  focus {line}" for line in self.lines)]) + f"{critical}\n{self.excitation}"


def channel_of(
    fields: Fields, excitation: Excitation, *, region: str, forces: ParticleForces | None = None,
) -> ChannelFigures:
    """The figures of a channel, with focus lines for `forces`. The channel is the `region` of `fields`."""
    mesh = fields.mesh
    nodes = mesh.points[mesh.nodes_of([region])]
    (left, floor), (right, lid) = nodes.min(axis=0), nodes.max(axis=0)

    def pressure(along: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
        """Places (n,) in the liquid and |p| there."""
        found: NodalArray = interpolate(mesh, fields.pressure, np.stack(np.broadcast_arrays(x, z), axis=1), [region])
        rows = np.stack([along, np.abs(found)], axis=1)
        return rows[~np.isnan(rows[:, 1])]

    x, z = np.linspace(left, right, 2 * POINTS_UP - 1), np.linspace(floor, lid, POINTS_UP)
    across = pressure(x, x, np.array(0.5 * (floor + lid)))
    up = pressure(z - floor, across[across[:, 1].argmax(), 0], z)
    factor = 0.0 if forces is None else forces.scattering.contrast_factor
    return ChannelFigures(
        excitation=excitation, power=fields.power, energy_density=excitation.mean_energy_density,
        channels=tuple(_shares(fields, region)), across=across, up=up,
        lines=() if forces is None else focus_lines(forces),
        critical_diameter=None if forces is None or not factor else critical_diameter(
            factor, forces.fluid, fields.frequency))


def _shares(fields: Fields, region: str) -> Iterator[ChannelShare]:
    """The channels of the section, from left to right, with their energy."""
    mesh = fields.mesh
    for left, right in channel_sides(mesh, region):
        here = ((mesh.points[:, 0] >= left) & (mesh.points[:, 0] <= right)).astype(float)
        energy = integrate(mesh, fields.energy_density * here, [region]) / integrate(mesh, here, [region])
        yield ChannelShare(left, right, float(energy))


def channel_sides(mesh: NodalMesh, region: str) -> Iterator[tuple[float, float]]:
    """The sides (m) of a section's channels, from left to right. A channel is a range across of adjoining cells of the
    `region`."""
    x = mesh.points[mesh.cells[mesh.cells_of([region])], 0].reshape(-1, (mesh.order + 1) ** 2)
    sides = np.stack([x.min(axis=1), x.max(axis=1)], axis=1)
    sides = sides[np.argsort(sides[:, 0])]
    reached = np.maximum.accumulate(sides[:, 1])
    begins = np.flatnonzero(np.append(True, sides[1:, 0] > reached[:-1] + SAME_LENGTH))
    for first, last in zip(begins, [*begins[1:], len(sides)], strict=True):
        yield float(sides[first, 0]), float(reached[last - 1])


def focus_lines(forces: ParticleForces) -> tuple[FocusLine, ...]:
    """The lines along a straight channel to which particles focus, deepest first."""
    mesh = forces.mesh
    (left, floor), (right, lid) = mesh.points.min(axis=0), mesh.points.max(axis=0)
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    x = np.linspace(left, right, max(3, math.ceil(POINTS_PER_WAVELENGTH * (right - left) / wavelength)))
    z = np.linspace(floor, lid, POINTS_UP)
    maps = np.stack([raster(mesh, values, x, z, [forces.region]) for values in (forces.potential, forces.force[:, 0])])
    liquid = ~np.isnan(maps[0])
    # The mean over the liquid part of the height.
    weight = np.where(liquid, np.gradient(z) * np.where((z == floor) | (z == lid), 0.5, 1.0), 0.0)
    wet = weight.sum(axis=1) > 0.0
    potential, force = np.sum(weight * np.nan_to_num(maps), axis=2) / np.where(wet, weight.sum(axis=1), np.nan)
    force[mesh.mirrors.on(x)] = 0.0
    span = float(np.nanmax(potential) - np.nanmin(potential))
    label = label_basins(potential[:, None], least=LEAST_LINE * span)[:, 0]
    widths = np.gradient(x)
    widths[[0, -1]] *= 0.5
    widths[~wet] = 0.0
    found = []
    for (i, _), highest in find_basins(potential[:, None]):
        depth = highest - float(potential[i])
        if depth <= LEAST_LINE * span:
            continue
        place, stiffness = _zero(x, force, i)
        # At a plane of symmetry the channel continues.
        at_side = not (wet[max(i - 1, 0)] and wet[min(i + 1, len(x) - 1)]) or (
            i in (0, len(x) - 1) and not mesh.mirrors.on(x[i]))
        found.append(FocusLine(
            place=mesh.mirrors.snapped(place), depth=depth, share=float(widths[label == i].sum() / widths.sum()),
            stiffness=stiffness, at_side=bool(at_side), measure=mesh.measure,
            time=_time(forces, place, 0.5 * (floor + lid), 0.25 * wavelength)))
    return tuple(sorted(found, key=lambda line: -line.depth))


def _zero(x: FloatArray, force: FloatArray, i: int) -> tuple[float, float]:
    """The zero of a falling `force` near a point, and stiffness (N/m). The point of `x` (n,) itself if there is no
    zero."""
    near = [k for k in (i - 1, i, i + 1) if 0 <= k < len(x) and np.isfinite(force[k])]
    stiffness = float((force[near[0]] - force[near[-1]]) / (x[near[-1]] - x[near[0]]))
    for first in (i - 1, i):
        if 0 <= first < len(x) - 1 and force[first] > 0.0 >= force[first + 1]:
            share = force[first] / (force[first] - force[first + 1])
            return float(x[first] + share * (x[first + 1] - x[first])), stiffness
    return float(x[i]), stiffness


def _time(forces: ParticleForces, place: float, height: float, quarter: float) -> float | None:
    """The shorter time (s) to a line from either side, or None."""
    found = []
    for side in (1.0, -1.0):
        reach = side * min(quarter, way_to_wall(forces, place, height, side))
        with suppress(ValueError):
            found.append(focus_time_along(forces, 0, across=height, start=place + FROM * reach,
                                          stop=place + TO * reach))
    return min(found, default=None)
