"""Sentences on whether, where and how strongly particles gather in a field, and on the reason if they do not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.names import CAVITY
from materials.kinds import Fluid
from workbench.acoustics.channel import focus_lines
from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.nodal import raster
from workbench.acoustics.traps import Trap, TrapReport, find_traps, time_to
from workbench.model.particles import net_weight
from workbench.simulation.run import Snapshot

#: Share of the cavity's volume whose particles must come to rest in the liquid to gather there. Doubled, a trap that a
#: tenth of the particles reach does not count.
LEAST_SHARE = 0.05
#: Time to focus (s) above which particles gather slowly. Doubled, a quarter of an hour for a full cavity passes without
#: a word.
SLOW = 60.0
#: Barrier in J below which thermal motion carries a particle out of a trap: ten times k T at 25 degC.
THERMAL = 10.0 * 1.380649e-23 * 298.15
#: Step, as a factor of the voltage, and largest factor of the search for a voltage that holds particles. Finer steps
#: would promise more than the accuracy of a bench's drive, and no amplifier of a bench has more.
VOLTAGE_STEP, LARGEST_FACTOR = 1.2, 15.0
#: Share of height or radius within which a place on a wall is on the floor, the lid or the side wall.
_AT = 0.02


@dataclass(frozen=True)
class Gathering:
    """The answer for one state: ``gathers`` is None if there is no particle; ``sentences`` describe it."""

    state: str
    gathers: bool | None
    sentences: tuple[str, ...]

    def __str__(self) -> str:
        return " ".join(self.sentences)


def gathering(shot: Snapshot) -> Gathering | None:
    """The answer whether and where the particles of a state gather; None without a cavity."""
    if CAVITY not in shot.chip.materials(shot.state):
        return None
    fluid, state = shot.problem.materials.get(CAVITY), shot.state
    if not isinstance(fluid, Fluid) or fluid.is_gas:
        return Gathering(state, None, (f"In state {state} the cavity holds no liquid: there are no particles to "
                                       "gather.",))
    if shot.traps is None:
        return Gathering(state, None, (
            f'State {state} names no particle. Lines such as particle = "polystyrene" and particle_radius = "5 um" in '
            f"[states.{state}] of the chip file show where such particles gather.",))
    return _of_traps(state, shot.traps)


def _of_traps(state: str, report: TrapReport) -> Gathering:
    excitation, who = report.excitation, particle_words(report.forces)
    at = f"At {excitation.frequency / 1e6:.4f} MHz and {2.0 * excitation.voltage:.3g} Vpp"
    free = [trap for trap in report.traps if not trap.on_wall]
    held = sorted((trap for trap in free if trap.holds), key=lambda trap: -trap.share)
    share = sum(trap.share for trap in held)
    if share < LEAST_SHARE:
        where = _on_walls(report)
        across = _across(report, at) if 0 in report.forces.mesh.measure.focusing else None
        if across is not None:
            return Gathering(state, *across)
        return Gathering(state, False, (
            f"{at}, {who} do not gather in the liquid" + (f": they come to rest {where}." if where else "."),
            *_why_not(report, free)))
    places = f", {place_words(held[0])}"
    if len(held) > 1:
        places = ": " + "; ".join(f"{percent(trap.share)} {place_words(trap)}" for trap in held[:3])
    rest = "" if len(held) <= 3 else f"; the others in {len(held) - 3} more traps"
    best = max(held, key=lambda trap: math.inf if trap.barrier is None else trap.barrier)
    sentences = [f"{at}, {percent(share)} of evenly spread {who} gather in the liquid{places}{rest}.",
                 _strength(best, report, several=len(held) > 1)]
    seconds = time_to(report, best)
    voltage = 2.0 * excitation.voltage
    if seconds is None:
        sentences.append(f"One that starts a quarter wavelength {trap_sides(best)} does not get there: another trap, a "
                         "wall or its weight takes it.")
    elif seconds > SLOW:
        quick = voltage * math.sqrt(seconds / 10.0)
        sentences.append(f"Focusing is slow: {rounded(seconds)} s from a quarter wavelength away; it is faster by the "
                         f"square of the voltage, so that {rounded(quick)} Vpp would take 10 s.")
    else:
        sentences.append(f"From a quarter wavelength away they are there in {rounded(seconds)} s.")
    where = _on_walls(report)
    if share < 1.0 - LEAST_SHARE and where:
        sentences.append(f"The others come to rest {where}.")
    kept = best.barrier is None or best.barrier >= THERMAL
    return Gathering(state, kept and (seconds is None or seconds <= SLOW), tuple(sentences))


def _across(report: TrapReport, at: str) -> tuple[bool, tuple[str, ...]] | None:
    """Whether particles that no trap holds at a height gather in lines across a channel, and sentences on that; None if
    they do not come to any line in the liquid."""
    lines = [line for line in focus_lines(report.forces) if not line.at_side]
    share = sum(line.share for line in lines)
    if share < LEAST_SHARE:
        return None
    places = "; ".join(line.measure.place_words(line.place) for line in sorted(lines, key=lambda line: -line.share)[:3])
    times = [line.time for line in lines if line.time is not None]
    sentences = [f"{at}, {percent(share)} of evenly spread {particle_words(report.forces)} gather across the channel: "
                 f"{places}."]
    slowest = max(times, default=None)
    if slowest is not None:
        sentences.append(f"From the sides of the channel, or a quarter wavelength away, they are there in "
                         f"{rounded(slowest)} s.")
    where = _on_walls(report)
    sentences.append("No trap holds them at a height" + (f": they come to rest {where}." if where else "."))
    held = max(line.depth for line in lines)
    if held < THERMAL:
        sentences.append("Thermal motion carries them out of the line.")
    return held >= THERMAL and (slowest is None or slowest <= SLOW), tuple(sentences)


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
    """The reason why particles do not come to rest in the liquid, and a remedy."""
    forces, excitation = report.forces, report.excitation
    weight = abs(net_weight(forces.particle, forces.fluid))
    falling = [trap for trap in free if not trap.holds and trap.lift is not None and trap.lift < weight]
    if falling:
        best = max(falling, key=lambda trap: trap.lift or 0.0)
        assert best.lift is not None
        return (f"The field is too weak: its trap {place_words(best)} lifts up to {rounded(best.lift * 1e12)} pN, and "
                f"the net weight is {rounded(weight * 1e12)} pN. {_enough(report)}",)
    if free and not any(trap.holds for trap in free):
        return ("The weight joins what traps there are in the liquid with a deeper one at a wall.",)
    if free:
        return (f"Traps in the liquid ({place_words(free[0])}) are reached from {percent(free[0].share)} of the "
                "cavity only.",)
    if not report.traps:
        return ("The potential has no minimum: the pressure hardly changes over the cavity.",)
    half = 0.5 * forces.fluid.sound_speed / excitation.frequency
    return (_antinode(forces, report.traps[0]), f"Along this line no trap lies in the liquid at any voltage; another "
            f"frequency or height of the cavity may have one (half a wavelength is {half * 1e3:.2f} mm here).")


def _enough(report: TrapReport) -> str:
    """The voltage at which traps in the liquid would hold particles, found with the potential of that voltage."""
    voltage, factor = 2.0 * report.excitation.voltage, 1.0
    while factor < LARGEST_FACTOR:
        factor *= VOLTAGE_STEP
        forces = report.forces
        stronger = replace(forces, potential=factor**2 * forces.potential, force=factor**2 * forces.force)
        held = sum(trap.share for trap in find_traps(stronger).traps if trap.holds and not trap.on_wall)
        if held >= LEAST_SHARE:
            return f"At {rounded(factor * voltage)} Vpp traps in the liquid would hold {percent(held)} of them."
    return f"Nor would it hold any at {rounded(factor * voltage)} Vpp."


def _antinode(forces: ParticleForces, trap: Trap) -> str:
    """The place of the largest energy on the vertical line through a trap at a wall, and its meaning."""
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


def _on_walls(report: TrapReport) -> str:
    """The places of particles that do not stay in the liquid; empty if there are few."""
    places = [f"{_wall_words(trap, report.forces)} ({percent(trap.share)})" for trap in
              sorted(report.traps, key=lambda trap: -trap.share)
              if trap.on_wall and trap.holds and trap.share >= LEAST_SHARE]
    if report.settled >= LEAST_SHARE:
        sinks = net_weight(report.forces.particle, report.forces.fluid) > 0.0
        places.append(f"on the {'floor' if sinks else 'lid'}, where the weight brings them ({percent(report.settled)})")
    return ", ".join(places)


def place_words(trap: Trap) -> str:
    """The place of a trap, in words."""
    return f"{trap.measure.place_words(trap.radius)}, {_above_floor(trap)}"


def trap_sides(trap: Trap) -> str:
    """The places from which a particle's time to a trap is counted."""
    beside = ", or on the same level to either side" if 0 in trap.measure.focusing else ""
    return f"above or below it on the same vertical line{beside}"


def _above_floor(trap: Trap) -> str:
    return f"{trap.above_floor * 1e3:.{trap.measure.decimals}f} mm above the floor"


def _wall_words(trap: Trap, forces: ParticleForces) -> str:
    nodes = forces.mesh.points
    if trap.above_floor < _AT * float(np.ptp(nodes[:, 1])):
        wall = "on the floor"
    elif abs(trap.radius) > (1.0 - _AT) * np.abs(nodes[:, 0]).max():
        return f"at the side wall {_above_floor(trap)}"
    else:
        wall = "at the lid"
    return f"{wall} {trap.measure.wall_place_words(trap.radius)}"


def particle_words(forces: ParticleForces) -> str:
    """The particles, as in "polystyrene spheres of 10 um"."""
    return f"{forces.particle.name.split('/')[0]} spheres of {2e6 * forces.particle.radius:.3g} um"


def percent(share: float) -> str:
    """A share as a whole per cent."""
    return f"{100.0 * share:.0f} %"


def rounded(value: float) -> str:
    """Two significant digits in plain notation: 170 rather than 1.7e+02."""
    return f"{float(f'{value:.2g}'):g}"


def _femto(barrier: float | None) -> str:
    return "none" if barrier is None else f"{rounded(barrier * 1e15)} fJ"
