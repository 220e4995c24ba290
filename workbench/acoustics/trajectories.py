"""Trajectories of particles in a computed field, and their arrivals.

Particles do not interact. Each follows the velocity of `particle_velocity` until the time is over or its surface
touches a wall, where it stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.channel import focus_lines
from workbench.acoustics.focusing import TO
from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.motion import Motion
from workbench.acoustics.nodal import FloatArray, IntArray
from workbench.acoustics.particle_velocity import ParticleVelocity, particle_velocity
from workbench.acoustics.starts import draw_starts, put_down
from workbench.acoustics.traps import TrapReport
from workbench.acoustics.walls import Walls, walls_of
from workbench.files.errors import InputError, expect_number, expect_whole
from workbench.jobs.progress import Progress, no_progress
from workbench.model.particles import net_weight
from workbench.results.brief import Brief

#: Estimated error of one step, as a share of the wavelength of sound: 15 nm at 1 MHz. Halved, no capture fraction of
#: the shipped chips changes by 0.1 %.
TOLERANCE = 1e-5
#: Share of the time that a particle must spend at its end to count as arrived. Doubled, late arrivals count as moving;
#: at zero, circulating particles that pass count as arrived.
STAYS = 0.1
#: Default number of recorded times. They are denser at the beginning, with the square of their number: the first of 30
#: minutes after 0.06 s, the last but one 20 s before the end. Doubled, there are more steps than accuracy needs.
RECORDED = 181
#: Gap in radii between a wall and a touching particle, for the drag near walls: the roughness of a bead. Halved, beads
#: of 10 um stop a second later, and leave the floor a second later.
CONTACT = 0.01
#: Smallest vertical part of the unit vector from a wall that supports a weight: slopes up to 45 degrees.
CARRIES = 0.7071
#: Steps of the search for a place of rest near a trap, and largest step as a share of the wavelength of sound: half the
#: distance to the next antinode takes four.
REST_STEPS, LARGEST_REST_STEP = 60, 1.0 / 32.0


#: Description of the seed of start points.
SEED = "a whole number of 0 or more, such as 0"
#: Length of the shown piece of a straight channel, as a multiple of its width. Doubled, a picture shows half as many
#: particles per width.
STRIP = 1.5


class Fate(IntEnum):
    """The end of a particle within the time.

    A wall, or the surface of an open well, that supports its net weight lets it settle (``SEDIMENTED``), the lid holds
    one that sound or flow press to it, any other wall stops it. One that stays at its height is levitated; in a
    channel, one that stays at its place across, and still rises or falls there, is focused.
    """

    MOVING, LEVITATED, TRAPPED, AT_WALL, SEDIMENTED, FOCUSED, AT_LID = range(7)

    @property
    def words(self) -> str:
        """The fate in words."""
        return ("still moving", "levitated", "in a trap", "at a wall", "settled on the floor, lid or surface",
                "focused across the channel", "pressed to the lid")[self]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Trajectories(Brief):
    """The trajectories of particles in the field of ``report``.

    ``voltage_factor`` multiplies its voltage. ``positions`` (particles, n, 2) r, z in m at ``times`` (n,) in s, folded
    into a half section; ``azimuths`` (particles,) in radians, constant and, in a straight section, a measure of the
    place along the channel. ``fate`` (particles,) numbers of :class:`Fate`; ``trap`` (particles,) number of the trap,
    -1 without. ``rest`` (traps, 2) are the places where weight and flow let a particle rest near the traps of the
    report, NaN for a trap without. ``levitated_at``, ``focused_at``, ``trapped_at`` (particles,) s: the time from which
    the particle stays at the height where it neither rises nor falls, at the place across a channel where it moves to
    neither side, and at its final trap; NaN for one that only passed, or that stays for less than :data:`STAYS` of the
    time. ``stopped_at`` is the time of its contact with a wall, NaN without. ``within`` m is the distance of an
    arrival, ``lying`` whether they lay on a wall at the start.
    """

    report: TrapReport
    velocity: ParticleVelocity
    voltage_factor: float
    times: FloatArray
    positions: FloatArray
    azimuths: FloatArray
    fate: IntArray
    trap: IntArray
    rest: FloatArray
    levitated_at: FloatArray
    focused_at: FloatArray
    trapped_at: FloatArray
    stopped_at: FloatArray
    within: float
    lying: bool = False

    @property
    def forces(self) -> ParticleForces:
        """The forces of the report at the voltage of the trajectories."""
        return self.report.forces.at_voltage(self.voltage_factor)

    @property
    def count(self) -> int:
        """The number of particles."""
        return len(self.positions)

    @property
    def spatial(self) -> FloatArray:
        """Positions (particles, n, 3) x, y, z in m. In a straight section they spread over a piece of the channel of
        length :attr:`strip`."""
        r, z = np.moveaxis(self.positions, 2, 0)
        x, y = self.velocity.mesh.measure.spatial(r, self.azimuths[:, None], self.strip)
        return np.stack([x, y, z], axis=2)

    @property
    def strip(self) -> float:
        """Length (m) of the shown piece of a channel. It is :data:`STRIP` of its width."""
        return STRIP * 2.0 * float(np.abs(self.velocity.mesh.points[:, 0]).max())

    def __str__(self) -> str:
        ends = ", ".join(f"{int((self.fate == fate).sum())} {fate.words}" for fate in Fate
                         if (self.fate == fate).any())
        return f"{self.count} particles over {self.times[-1]:.4g} s: {ends}\n{self.forces}"


def time_text(seconds: float) -> str:
    """A time in words."""
    if seconds < 60.0:
        return f"{seconds:.3g} s" if seconds < 9.95 else f"{seconds:.0f} s"
    return f"{seconds / 60.0:.3g} min"


def record_times(duration: float) -> FloatArray:
    """:data:`RECORDED` times from 0 to `duration` (s), closer at the beginning."""
    return np.asarray(duration * np.linspace(0.0, 1.0, RECORDED) ** 2)


def follow(
    report: TrapReport, times: FloatArray, *, particles: int | FloatArray = 200, seed: int = 0,
    flow: FloatArray | None = None, voltage_factor: float = 1.0, tolerance: float | None = None,
    near_walls: bool = False, lying: bool = False, progress: Progress = no_progress,
) -> Trajectories:
    """Follow particles in the field of `report`, recorded at `times` (n,).

    Args:
        times: ascending from 0 s.
        particles: number of start points, spread evenly over the volume by `seed`; or start points (P, 2) r, z in m.
        flow: velocity (N, 2) in m/s at which the liquid carries a particle, at the nodes of ``report.forces.mesh``.
        voltage_factor: of the voltage of the field; forces grow with its square.
        tolerance: estimated error of a step in m; :data:`TOLERANCE` of the wavelength unless given.
        near_walls: whether drag increases near walls (`particle_velocity`), which particles then touch at a gap of
            :data:`CONTACT` radii.
        lying: whether random start points are on the wall below them (above, for a light particle). Walls then hold
            particles, which slide along them and may leave, and `near_walls` applies.

    Raises:
        InputError: times that do not ascend from 0, a start outside the cavity or nearer to a wall than the particle's
            radius, a particle that does not fit, a number, factor or tolerance that is not positive, a negative seed.
        ValueError: a flow of another shape.
    """
    forces = report.forces
    radius, wavelength = forces.particle.radius, forces.fluid.sound_speed / forces.excitation.frequency
    times = np.asarray(times, dtype=float)
    tolerance = TOLERANCE * wavelength if tolerance is None else tolerance
    _check(times, voltage_factor, tolerance)
    expect_whole(seed, SEED, source="trajectories", field="seed", low=0)
    random, walls = np.random.default_rng(seed), walls_of(forces.mesh)
    velocity = particle_velocity(forces, flow=flow, voltage_factor=voltage_factor, holds=CONTACT if lying else 0.0,
                                 walls=walls if near_walls or lying else None)
    contact = radius * (1.0 + (0.5 * CONTACT if lying else CONTACT if near_walls else 0.0))
    if isinstance(particles, int):
        if particles < 1:
            raise InputError("trajectories", "particles", particles, "at least one particle")
        starts = draw_starts(forces.mesh, walls, particles, radius=contact, random=random)
        if lying:
            down = -1.0 if net_weight(forces.particle, forces.fluid) > 0.0 else 1.0
            starts = put_down(forces.mesh, walls, starts, radius=radius * (1.0 + 2.0 * CONTACT), down=down)
    else:
        starts = np.array(particles, dtype=float)
        _check_starts(starts, velocity, walls, radius)
    rest = rest_places(report, velocity, walls)
    motion = Motion(velocity, walls, starts, times, radius=contact, rest=rest,
                    within=TO * 0.25 * wavelength, tolerance=tolerance)
    motion.run(progress)
    if 0 in forces.mesh.measure.focusing:
        motion.focused_at[~_on_a_line(motion, forces)] = np.nan
    if lying:
        motion.levitated_at[_lies(motion, radius)] = np.nan
    fate, trap = _fates(motion, net_weight(forces.particle, forces.fluid), _lies(motion, radius) if lying else None)
    trapped = fate == Fate.TRAPPED
    levitated_at = np.where(_stays(motion, motion.levitated_at), motion.levitated_at, np.nan)
    focused_at = np.where(_stays(motion, motion.focused_at), motion.focused_at, np.nan)
    return Trajectories(
        report=report, velocity=velocity, voltage_factor=voltage_factor, times=times, positions=motion.positions,
        azimuths=random.uniform(0.0, 2.0 * np.pi, len(starts)), fate=fate, trap=trap, rest=rest,
        levitated_at=levitated_at, focused_at=focused_at, stopped_at=motion.stopped_at,
        within=motion.within, lying=lying,
        trapped_at=np.where(trapped, motion.trapped_at[np.arange(len(starts)), trap] if rest.size else np.nan, np.nan),
    )


def rest_places(report: TrapReport, velocity: ParticleVelocity, walls: Walls) -> FloatArray:
    """Places of rest (traps, 2) near each trap of `report`.

    They are zeros of the `velocity` that attract the particle, by Newton's method from the trap. NaN for a trap on a
    wall, one without such a place, and one that shares its place with a deeper trap.
    """
    forces = report.forces
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    found = np.full((len(report.traps), 2), np.nan)
    for number, trap in enumerate(report.traps):
        place = np.array([[trap.radius, trap.height]])
        if trap.on_wall:
            continue
        cell = np.maximum(velocity.cells_at(place), 0)
        for _ in range(REST_STEPS):
            speed, slope, inside = velocity(place, cell, slopes=True)
            step = -np.linalg.lstsq(slope[0], speed[0], rcond=None)[0]
            size = float(np.linalg.norm(step))
            place = place + step * min(1.0, LARGEST_REST_STEP * wavelength / size) if size else place
            place = velocity.mesh.mirrors.folded(place)[0]
            cell = np.where(inside >= 0, inside, cell)
            if size < 1e-3 * TOLERANCE * wavelength:
                break
        else:
            continue
        draws_in = np.trace(slope[0]) < 0.0 < np.linalg.det(slope[0])
        fits = inside[0] >= 0 and walls.nearest(place)[0][0] >= forces.particle.radius
        taken = np.linalg.norm(found - place, axis=1) < TO * 0.25 * wavelength
        if draws_in and fits and not taken.any():
            found[number] = place[0]
    return found


def _fates(motion: Motion, weight: float, lies: NDArray[np.bool_] | None) -> tuple[IntArray, IntArray]:
    """The fate and the trap (P,) of every particle. `weight` in N; `lies` (P,) whether a wall holds it."""
    count = len(motion.place)
    fate, trap = np.full(count, int(Fate.MOVING)), np.full(count, -1)
    for axis in sorted(motion.velocity.mesh.measure.focusing, reverse=True):
        fate[_stays(motion, (motion.focused_at, motion.levitated_at)[axis])] = (Fate.FOCUSED, Fate.LEVITATED)[axis]
    if motion.rest.size:
        apart = np.linalg.norm(motion.positions[:, -1, None] - motion.rest, axis=2)
        apart = np.where(np.isnan(apart), np.inf, apart)
        trapped = apart.min(axis=1) <= motion.within
        fate[trapped], trap[trapped] = Fate.TRAPPED, apart.argmin(axis=1)[trapped]
    stopped = ~np.isnan(motion.stopped_at) if lies is None else lies | ~np.isnan(motion.stopped_at)
    carried = motion.away[:, 1] * np.sign(weight) >= CARRIES
    under_lid = motion.away[:, 1] <= -CARRIES
    fate[stopped] = np.where(carried, Fate.SEDIMENTED, np.where(under_lid, Fate.AT_LID, Fate.AT_WALL))[stopped]
    trap[stopped] = -1
    return fate, trap


def _lies(motion: Motion, radius: float) -> NDArray[np.bool_]:
    """Whether a wall holds each particle at the end. Its direction is recorded."""
    distance, away = motion.walls.nearest(motion.positions[:, -1])
    lies = distance < radius * (1.0 + 2.0 * CONTACT)
    motion.away[lies] = away[lies]
    return np.asarray(lies)


def _stays(motion: Motion, at: FloatArray) -> NDArray[np.bool_]:
    """Whether each particle stays for :data:`STAYS` of the time. It stays from `at` (P,) on."""
    return np.asarray(at <= (1.0 - STAYS) * motion.times[-1])


def _on_a_line(motion: Motion, forces: ParticleForces) -> NDArray[np.bool_]:
    """Whether each particle of a channel ends at a focus line. True for all without such a line. In the middle of a
    streaming roll nothing moves a particle to either side, but it is not focused."""
    places = [line.place for line in focus_lines(forces)]
    if not places:
        return np.ones(len(motion.place), dtype=bool)
    return np.asarray((np.abs(motion.positions[:, -1, :1] - places) <= 2.0 * motion.within).any(axis=1))


def _check(times: FloatArray, voltage_factor: float, tolerance: float) -> None:
    if times.ndim != 1 or times.size < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all() \
            or not np.isfinite(times).all():
        raise InputError("trajectories", "times", _listed(times), "two or more times in s, ascending from 0")
    for name, value in (("voltage_factor", voltage_factor), ("tolerance", tolerance)):
        if not expect_number(value, "a positive number", source="trajectories", field=name) > 0.0:
            raise InputError("trajectories", name, value, "a positive number")


def _check_starts(starts: FloatArray, velocity: ParticleVelocity, walls: Walls, radius: float) -> None:
    if starts.ndim != 2 or starts.shape[1] != 2 or not len(starts):
        raise InputError("trajectories", "particles", f"an array of shape {starts.shape}",
                         "a number of particles, or start points (P, 2) r, z in m")
    outside = (velocity.cells_at(starts) < 0) | ~np.isfinite(starts).all(axis=1)
    distance = np.where(outside, -1.0, walls.nearest(np.nan_to_num(starts))[0])
    wrong = np.flatnonzero(distance < radius)
    if wrong.size:
        r, z = 1e3 * starts[wrong[0]]
        nodes = 1e3 * velocity.mesh.points
        (low_r, low_z), (high_r, high_z) = nodes.min(axis=0), nodes.max(axis=0)
        symbol = velocity.mesh.measure.symbol
        raise InputError("trajectories", f"particles[{wrong[0]}]", f"{symbol} = {r:.6g} mm, z = {z:.6g} mm",
                         f"a place in the cavity ({low_r:.4g} to {high_r:.4g} mm by {low_z:.4g} to {high_z:.4g} mm), a "
                         f"radius of the particle ({1e6 * radius:.4g} um) or more from its walls")


def _listed(values: Sequence[float] | FloatArray) -> str:
    """The first few of some numbers."""
    shown = np.asarray(values, dtype=float).ravel()
    return ", ".join(f"{each:g}" for each in shown[:5]) + (", ..." if shown.size > 5 else "")
