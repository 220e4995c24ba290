"""The statement whether, where and when particles gather.

It follows from trajectories of particles in the radiation force, their weight and the flow of the liquid. If the flow
moves a particle more than sound does, no trajectories are computed: it circulates at any voltage.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.names import CAVITY
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.captures import place_across
from workbench.acoustics.channel import focus_lines
from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.nodal import FloatArray, IntArray, raster
from workbench.acoustics.trajectories import Fate, Trajectories, time_text
from workbench.acoustics.traps import Trap, TrapReport, find_traps
from workbench.files.errors import InputError
from workbench.model.particles import drag_coefficient, net_weight
from workbench.model.validity import cavitation_words
from workbench.simulation.beads import trajectories
from workbench.simulation.heating import softening_words
from workbench.simulation.liquid_motion import FlowCause, LiquidMotion, liquid_motion
from workbench.simulation.run import Snapshot
from workbench.simulation.warm import WarmUp

#: Least share of the particles at a place where they gather. Doubled, a trap that a tenth of them reach does not count.
LEAST_SHARE = 0.05
#: Time to the plane or the line (s) above which particles gather slowly. Doubled, a quarter of an hour for a full
#: cavity is not reported as slow.
SLOW = 60.0
#: Energy (J) of thermal motion at 25 degC, and the barrier below which it moves a particle out of a trap.
KT = 1.380649e-23 * 298.15
THERMAL = 10.0 * KT
#: Step and largest factor of the search for a voltage that traps particles. Finer steps would exceed the accuracy of a
#: bench's drive, and a larger factor its amplifier.
VOLTAGE_STEP, LARGEST_FACTOR = 1.2, 15.0
#: Duration (s) of trajectories, that of `workbench particles`, and their number. Doubled, shares change by a hundredth.
FOLLOWED, COUNT = 1800.0, 200
#: Most turns of the flow about the cavity during trajectories. Doubled, fast rolls take twice the time.
TURNS = 30.0
#: Times of the record, and error of a step relative to the wavelength: shares agree with the default's within 1 %, in
#: half the time.
RECORDED, TOLERANCE = 31, 1e-4


@dataclass(frozen=True)
class GatheredAt:
    """A place where particles stay. ``words`` describe it, ``share`` is that of all particles. ``half`` is the time (s)
    at which half of the former have arrived, None if they started there or the time is unknown."""

    words: str
    share: float
    half: float | None

    def __str__(self) -> str:
        when = "" if self.half is None else f" (half of these within {time_text(self.half)})"
        return f"{percent(self.share)} {self.words}{when}"


@dataclass(frozen=True)
class Gathering:
    """The answer for one state.

    ``gathers`` is None if there is no particle; ``sentences`` describe it. ``first`` is the plane of levitation, or the
    line across a channel, which particles reach first; ``places`` are their final ones. ``critical_diameters`` (m) are
    by direction, empty if the flow is unknown.
    """

    state: str
    gathers: bool | None
    sentences: tuple[str, ...]
    first: GatheredAt | None = None
    places: tuple[GatheredAt, ...] = ()
    critical_diameters: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return " ".join(self.sentences)


def gathering(shot: Snapshot, *, registry: Registry | None = None, kept: bool = False) -> Gathering | None:
    """Whether and where the particles of a state gather; None without cavity. A liquid that is `kept` at its stated
    temperature has no flow by heat."""
    if CAVITY not in shot.chip.materials(shot.state):
        return None
    fluid, state = shot.problem.materials.get(CAVITY), shot.state
    if not isinstance(fluid, Fluid) or fluid.is_gas:
        return Gathering(state, None, (f"In state {state} the cavity holds no liquid: there are no particles to "
                                       "gather.",))
    if shot.traps is None:
        return Gathering(state, None, (
            f'State {state} names no particle. Lines such as particle = "polystyrene" and particle_radius = "5 um" in '
            f"[states.{state}] of the chip file show where such particles gather.",
            *cavitation_words(float(np.abs(shot.fields.pressure[shot.fields.mesh.nodes_of([CAVITY])]).max()),
                              shot.fields.frequency)))
    moving, left_out = _known_motion(shot, registry, kept)
    answer = statement(state, shot.traps, moving, None) if circulates(shot.traps, moving) else statement(
        state, shot.traps, moving, _followed(shot, moving))
    return replace(answer, sentences=(*left_out, *answer.sentences))


def statement(state: str, report: TrapReport, moving: LiquidMotion, found: Trajectories | None) -> Gathering:
    """The answer for particles with trajectories, or that circulate.

    Args:
        report: the traps of the field, for the reason why particles do not gather.
        moving: the flow of the liquid that carried them.
        found: their trajectories; None only if they circulate.
    """
    report = report if found is None else found.report
    critical = {} if moving.streaming is None else dict(moving.streaming.critical_diameters)
    ends = () if found is None else tuple(_ends(found))
    first = None if found is None else _first(found)
    sentences = [] if found is None else [_ends_words(found, ends)]
    gathers = False
    if circulates(report, moving):
        sentences += _circulating(report, critical)
    elif found is None or first is None or first.share < LEAST_SHARE:
        sentences += _why_not(report, [trap for trap in report.traps if not trap.on_wall])
    else:
        gathers, more = _gathered(found, first, critical)
        sentences += more
    sentences += [*_weightless(report.forces), *cavitation_words(report.excitation.pressure_amplitude,
                                                                 report.excitation.frequency)]
    return Gathering(state, gathers, tuple(sentences), first, ends, critical)


def circulates(report: TrapReport, moving: LiquidMotion) -> bool:
    """Whether the flow moves the particle more than sound does. Only the direction of fast focusing counts."""
    if moving.streaming is None:
        return False
    limit = moving.streaming.critical_diameters[_first_direction(report.forces)]
    return math.isnan(limit) or 2.0 * report.forces.particle.radius < limit


def _first_direction(forces: ParticleForces) -> str:
    """The direction of fast focusing: across a channel, else up."""
    measure = forces.mesh.measure
    return measure.directions[min(measure.focusing)]


def _known_motion(
    shot: Snapshot, registry: Registry | None, kept: bool
) -> tuple[LiquidMotion, tuple[str, ...]]:
    """The computable flow, and sentences on causes that are left out."""
    left_out, causes = list[str](), [(FlowCause.SOUND, "flow of the liquid")]
    if kept or (shot.warm is not None and shot.warm.here is None):
        left_out.append("The following is for a liquid that is kept at its stated temperature.")
    else:
        causes.insert(0, (FlowCause.HEAT, "heat of the drive"))
    up = WarmUp() if shot.warm is None else shot.warm.up
    for cause, words in causes:
        try:
            moving = liquid_motion(shot, by=cause, registry=registry, convection=up.convection, holder=up.holder)
            return moving, (*left_out[-1:], *softening_words(shot, moving.heat))
        except InputError as error:
            left_out.append(f"The {words} is left out of the following, because this state has {error.value} and the "
                            f"computation needs {error.expected}.")
    return liquid_motion(shot, by=FlowCause.NONE), tuple(left_out[-1:])


def _followed(shot: Snapshot, moving: LiquidMotion) -> Trajectories:
    """Trajectories as of `workbench particles`, with larger steps."""
    assert shot.traps is not None
    forces = shot.traps.forces
    duration = FOLLOWED
    if moving.streaming is not None and moving.streaming.rms_speed > 0.0:
        around = 2.0 * float(np.ptp(forces.mesh.points, axis=0).sum())
        duration = min(duration, TURNS * around / moving.streaming.rms_speed)
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    return trajectories(shot, duration, particles=COUNT, flow=moving.velocity, tolerance=TOLERANCE * wavelength,
                        times=duration * np.linspace(0.0, 1.0, RECORDED) ** 2)


# Places --------------------------------------------------------------------------------------------------------------


def _half(at: FloatArray) -> float | None:
    """The median time of arrival (s); None if one has none."""
    return float(np.median(at)) if at.size and np.isfinite(at).all() else None


def _first(found: Trajectories) -> GatheredAt:
    """The plane of levitation or the line that particles reach first."""
    across = 0 in found.velocity.mesh.measure.focusing
    at = found.focused_at if across else found.levitated_at
    which = np.flatnonzero(np.isfinite(at))
    if across:
        words = f"focus across the channel{place_across(found, which)}"
    else:
        floor = float(found.velocity.mesh.points[:, 1].min())
        levels = _levels(found.positions[which, -1, 1] - floor, found.within)
        words = "levitate" + (
            f" {' and '.join(f'{1e3 * level:.2f}' for level in levels)} mm above the floor" if levels else "")
    return GatheredAt(words, which.size / found.count, _half(at[which]))


def _levels(heights: FloatArray, apart: float) -> list[float]:
    """The medians of the groups of heights that are `apart` (m)."""
    ordered = np.sort(heights)
    groups = np.split(ordered, np.flatnonzero(np.diff(ordered) > apart) + 1) if ordered.size else []
    # A few particles that still move along a slope are not a level.
    return [float(np.median(group)) for group in groups if group.size >= LEAST_SHARE * ordered.size]


def _ends(found: Trajectories) -> Iterator[GatheredAt]:
    """The final places, those in the liquid first, sorted by share."""
    def at(words: str, which: IntArray, arrived: FloatArray | None = None) -> GatheredAt:
        return GatheredAt(words, which.size / found.count, None if arrived is None else _half(arrived[which]))

    measure = found.velocity.mesh.measure
    trapped = [at(f"in a trap {place_words(_at_rest(found, number))}", np.flatnonzero(found.trap == number),
                  found.trapped_at) for number in np.unique(found.trap[found.trap >= 0])]
    yield from sorted(trapped, key=lambda place: -place.share)
    rests = _rests(found.report.forces)
    for fate, arrived in ((Fate.FOCUSED, found.focused_at), (Fate.LEVITATED, None), (Fate.MOVING, None),
                          (Fate.SEDIMENTED, found.stopped_at), (Fate.AT_LID, found.stopped_at),
                          (Fate.AT_WALL, found.stopped_at)):
        which = np.flatnonzero(found.fate == fate)
        if not which.size:
            continue
        words = fate.words
        if fate is Fate.SEDIMENTED:
            words = f"{'settled on' if rests else 'carried to'} the {_bottom(found.report.forces)}"
        if fate is Fate.LEVITATED:
            words = "levitated, in no trap"
        place = place_across(found, which) if fate is not Fate.MOVING else ""
        yield at(words + place, which, arrived if 0 in measure.focusing or fate is not Fate.FOCUSED else None)


def _at_rest(found: Trajectories, number: int) -> Trap:
    """A trap at the point of rest under weight and flow."""
    trap, (r, z) = found.report.traps[number], found.rest[number]
    return replace(trap, radius=found.velocity.mesh.mirrors.snapped(float(r)), height=float(z),
                   above_floor=trap.above_floor + float(z) - trap.height)


def _ends_words(found: Trajectories, ends: tuple[GatheredAt, ...]) -> str:
    excitation = found.forces.excitation
    shown = ends if len(ends) <= 7 else ends[:7]
    rest = sum(each.share for each in ends[len(shown):])
    more = f"; {percent(rest)} elsewhere" if rest else ""
    who = particle_words(found.report.forces)
    who = f"{who} that lay on the {_bottom(found.report.forces)}" if found.lying else f"evenly spread {who}"
    return (f"After {time_text(float(found.times[-1]))} at {excitation.frequency / 1e6:.4f} MHz and "
            f"{2.0 * excitation.voltage:.3g} Vpp, of {found.count} {who}: {'; '.join(map(str, shown))}{more}.")


# Sentences -----------------------------------------------------------------------------------------------------------


def _gathered(found: Trajectories, first: GatheredAt, critical: Mapping[str, float]) -> tuple[bool, list[str]]:
    """Whether particles at a plane or a line gather, and sentences."""
    report, across = found.report, 0 in found.velocity.mesh.measure.focusing
    at = found.focused_at if across else found.levitated_at
    ninety = float(np.quantile(at[np.isfinite(at)], 0.9))
    half = first.half or 0.0
    halves = f"half of these within {time_text(half)}" if half > 0.0 else "half of these start there"
    sentences = [f"{percent(first.share)} {first.words}: {halves}, nine tenths within {time_text(ninety)}."]
    if half > SLOW:
        voltage = 2.0 * found.forces.excitation.voltage
        sentences.append(f"This is slow; the force grows with the square of the voltage, so that "
                         f"{rounded(voltage * math.sqrt(half / 10.0))} Vpp would take 10 s if the chip stayed as warm.")
    occupied = [_at_rest(found, number) for number in np.unique(found.trap[found.trap >= 0])]
    share = float((found.trap >= 0).mean())
    if occupied:
        best = max(occupied, key=lambda trap: math.inf if trap.barrier is None else trap.barrier)
        sentences += [_strength(best, report, several=len(occupied) > 1), *_two_times(best, report)]
    kept = any(trap.barrier is None or trap.barrier >= THERMAL for trap in occupied)
    if across:
        lines = [line for line in focus_lines(report.forces) if not line.at_side]
        kept, share = any(line.depth >= THERMAL for line in lines), first.share
        if not kept:
            sentences.append("Thermal motion carries them out of the line.")
    slow_direction = found.velocity.mesh.measure.directions[1 if across else 0]
    limit, own = critical.get(slow_direction), 2.0 * report.forces.particle.radius
    if not across and limit is not None and not own > limit:
        sentences.append(f"Along the plane the flow moves them more than the sound does, however large the voltage"
                         f"{_limit_words(limit)}.")
    return kept and share >= LEAST_SHARE and half <= SLOW, sentences


def _two_times(trap: Trap, report: TrapReport) -> list[str]:
    """Time constants of the approach to a trap, up and across."""
    drag = drag_coefficient(report.forces.particle, report.forces.fluid)
    if trap.on_wall or not (trap.axial_stiffness > 0.0 and trap.radial_stiffness > 0.0):
        return []
    along = "across" if 0 in trap.measure.focusing else "along the plane"
    return [f"Beside it the sound brings them e times nearer in {time_text(drag / trap.axial_stiffness)} up and down, "
            f"and in {time_text(drag / trap.radial_stiffness)} {along}."]


def _circulating(report: TrapReport, critical: Mapping[str, float]) -> list[str]:
    excitation, direction = report.excitation, _first_direction(report.forces)
    return [f"At {excitation.frequency / 1e6:.4f} MHz and {2.0 * excitation.voltage:.3g} Vpp, "
            f"{particle_words(report.forces)} do not gather: they circulate with the streaming, however large the "
            f"voltage{_limit_words(critical[direction])}.",
            "Larger particles, or a higher frequency, gather."]


def _limit_words(limit: float) -> str:
    if math.isnan(limit):
        return " (no size of them is moved more by the sound)"
    return f" (their critical diameter is {rounded(1e6 * limit)} um)"


def _rests(forces: ParticleForces) -> bool:
    """Whether weight keeps a particle on the floor against thermal motion. The scale height kT over weight is then
    below the cavity's height."""
    weight = abs(net_weight(forces.particle, forces.fluid))
    return weight * float(np.ptp(forces.mesh.points[:, 1])) > KT


def _weightless(forces: ParticleForces) -> list[str]:
    weight = abs(net_weight(forces.particle, forces.fluid))
    if _rests(forces) or not weight:
        return []
    return [f"They do not rest on the {_bottom(forces)}: thermal motion spreads them over a height of "
            f"{rounded(1e3 * KT / weight)} mm against their weight."]


def _bottom(forces: ParticleForces) -> str:
    return "floor" if net_weight(forces.particle, forces.fluid) > 0.0 else "lid or surface"


def _strength(trap: Trap, report: TrapReport, *, several: bool) -> str:
    which = f"the strongest trap ({place_words(trap)})" if several else "the trap"
    if trap.barrier is None:
        words = f"Nothing leads out of {which}"
    else:
        words = (f"To leave {which} one needs {rounded(trap.barrier * 1e15)} fJ (along z {_femto(trap.axial_barrier)}, "
                 f"along {trap.measure.symbol} {_femto(trap.radial_barrier)})")
        if trap.barrier < THERMAL:
            words += ", which thermal motion gives it"
    weight = abs(net_weight(report.forces.particle, report.forces.fluid))
    if trap.lift is None or not weight:
        return words + "."
    return f"{words}, and the field lifts up to {rounded(trap.lift / weight)} times its net weight."


def _why_not(report: TrapReport, free: list[Trap]) -> tuple[str, ...]:
    forces, excitation = report.forces, report.excitation
    weight = abs(net_weight(forces.particle, forces.fluid))
    falling = [trap for trap in free if not trap.holds and trap.lift is not None and trap.lift < weight]
    if falling:
        best = max(falling, key=lambda trap: trap.lift or 0.0)
        assert best.lift is not None
        return (f"The field is too weak: its trap {place_words(best)} lifts up to {rounded(best.lift * 1e12)} pN, and "
                f"the net weight is {rounded(weight * 1e12)} pN. {_enough(report)}",)
    if free and not any(trap.holds for trap in free):
        return ("The weight joins all traps in the liquid with a deeper one at a wall.",)
    if free:
        return (f"Traps in the liquid ({place_words(free[0])}) are reached from {percent(free[0].share)} of the "
                "cavity only.",)
    if not report.traps:
        return ("The potential has no minimum: the pressure hardly changes over the cavity.",)
    half = 0.5 * forces.fluid.sound_speed / excitation.frequency
    return (_antinode(forces, report.traps[0]), f"Along this line no trap lies in the liquid at any voltage; another "
            f"frequency or height of the cavity may have one (half a wavelength is {half * 1e3:.2f} mm here).")


def _enough(report: TrapReport) -> str:
    """The voltage at which traps in the liquid hold particles. Traps are computed with the potential at that
    voltage."""
    voltage, factor = 2.0 * report.excitation.voltage, 1.0
    while factor < LARGEST_FACTOR:
        factor *= VOLTAGE_STEP
        forces = report.forces
        stronger = replace(forces, potential=factor**2 * forces.potential, force=factor**2 * forces.force)
        share = sum(trap.share for trap in find_traps(stronger).traps if trap.holds and not trap.on_wall)
        if share >= LEAST_SHARE:
            return f"At {rounded(factor * voltage)} Vpp traps in the liquid would hold {percent(share)} of them."
    return f"Nor would it hold any at {rounded(factor * voltage)} Vpp."


def _antinode(forces: ParticleForces, trap: Trap) -> str:
    """The largest energy on the vertical line through a wall's trap."""
    nodes = forces.mesh.points
    z = np.linspace(nodes[:, 1].min(), nodes[:, 1].max(), 101)
    values = raster(forces.mesh, forces.potential, np.array([trap.radius]), z, [forces.region])[0]
    share = float((z[int(np.nanargmax(values))] - z[0]) / (z[-1] - z[0]))
    if forces.scattering.contrast_factor > 0.0:
        kind, goal = "antinode of the pressure", "nodes"
    else:
        kind, goal = "node of the pressure", "antinodes"
    where = "at the floor" if share <= 0.25 else "at mid-height" if share < 0.75 else "at the lid"
    return (f"On the vertical line through the deepest trap the {kind} is {where}, and these particles go to pressure "
            f"{goal} (contrast factor {rounded(forces.scattering.contrast_factor)}).")


def place_words(trap: Trap) -> str:
    """The place of a trap, in words."""
    return f"{trap.measure.place_words(trap.radius)}, {_above_floor(trap)}"


def _above_floor(trap: Trap) -> str:
    return f"{trap.above_floor * 1e3:.{trap.measure.decimals}f} mm above the floor"


def particle_words(forces: ParticleForces) -> str:
    """The particles, as in "polystyrene spheres of 10 um"."""
    return f"{forces.particle.name.split('/')[0]} spheres of {2e6 * forces.particle.radius:.3g} um"


def percent(share: float) -> str:
    """A share as a whole per cent, with decimals if needed."""
    whole = round(100.0 * share)
    return f"{whole} %" if whole == 100.0 * share or 0 < whole < 100 else f"{100.0 * share:.3g} %"


def rounded(value: float) -> str:
    """Two significant digits in plain notation, such as 170."""
    return f"{float(f'{value:.2g}'):g}"


def _femto(barrier: float | None) -> str:
    return "none" if barrier is None else f"{rounded(barrier * 1e15)} fJ"
