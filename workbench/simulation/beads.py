"""Trajectories of particles in the cavity of a simulated state.

    run = simulate(read_chip("chip.toml"), "filled")
    found = trajectories(run, 1800.0)
    found.positions, found.fate, capture_statistics(found)
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

import numpy as np

from geometry.chip import Chip
from geometry.names import CAVITY
from materials.registry import Registry
from workbench.acoustics.nodal import FloatArray, transfer
from workbench.acoustics.streaming import Streaming
from workbench.acoustics.trajectories import SEED, Trajectories, follow, record_times
from workbench.acoustics.traps import find_traps
from workbench.files.errors import InputError, choose, expect_number, expect_whole
from workbench.jobs.progress import Progress, no_progress
from workbench.model.drive import check_scaled
from workbench.model.problem import FilledChip, fill
from workbench.simulation.liquid_motion import LiquidMotion
from workbench.simulation.run import Snapshot

#: Depth of a trap, relative to the range of the potential, below which particles at rest count as levitated, not as
#: trapped. Annular traps in the plane of levitation have some 1e-2; with a limit of 1e-2, two thirds of the particles
#: of the paper's chip rest in annuli that do not count as its traps.
LEAST_DEPTH = 1e-4


class BeadStart(StrEnum):
    """The positions of particles when the sound is switched on."""

    SPREAD = "spread"
    FLOOR = "floor"


def trajectories(
    shot: Snapshot, duration: float, *, particles: int | FloatArray = 200, seed: int = 0,
    flow: FloatArray | None = None, voltage_factor: float = 1.0, times: FloatArray | None = None,
    tolerance: float | None = None, start: str = BeadStart.SPREAD, progress: Progress = no_progress,
) -> Trajectories:
    """Follow the particles of a simulated state for a `duration` (s).

    Near walls, the drag is increased.

    Args:
        shot: a state at one frequency and drive, with a particle: of `snapshot` or `simulate`.
        particles: number of start points, drawn evenly over the cavity's volume by `seed`; or start points (P, 2) r, z
            in m.
        flow: velocity (N, 2) in m/s with which the liquid carries a particle (streaming and Stokes drift), at the nodes
            of the mesh of the fields or of that of the forces (``shot.traps.forces.mesh``), such as
            ``liquid_motion(shot).velocity``; default: none.
        voltage_factor: factor on the voltage of `shot`; the radiation force grows with its square. The flow is not
            scaled.
        times: times (n,) in s of the record, ascending from 0 to `duration`; by default denser at the beginning.
        tolerance: estimated error of a step in m.
        start: "spread" over the cavity, or on its "floor" below such places (under the lid, if they are light).

    Raises:
        InputError: a state without particle, an unknown start, a duration that is not positive, a negative seed, a flow
            that is not at the nodes of the cavity, an impossible voltage, or see
            `workbench.acoustics.trajectories.follow`.
    """
    if shot.traps is None:
        raise InputError("trajectories", "shot", f"state {shot.state} of {shot.chip.name}", "a state with a particle "
                         'in a liquid: lines such as particle = "polystyrene" and particle_radius = "5 um" in '
                         f"[states.{shot.state}] of the chip file")
    positive = "a positive time in s, such as 30.0"
    if not expect_number(duration, positive, source="trajectories", field="duration") > 0.0:
        raise InputError("trajectories", "duration", duration, positive)
    lying = BeadStart(choose(start, list(BeadStart), source="trajectories", field="start")) is BeadStart.FLOOR
    expect_whole(seed, SEED, source="trajectories", field="seed", low=0)
    factor = expect_number(voltage_factor, "a positive number", source="trajectories", field="voltage_factor")
    check_scaled(2.0 * shot.traps.excitation.voltage, factor, source="trajectories", field="voltage_factor")
    forces = shot.traps.forces
    record = record_times(duration) if times is None else np.asarray(times, dtype=float)
    if record.size and record[-1] != duration:
        raise InputError("trajectories", "times", f"times up to {record[-1]:g} s", f"times that end at {duration:g} s")
    report = find_traps(forces, least_depth=LEAST_DEPTH)
    return follow(report, record, particles=particles, seed=seed, flow=_on_forces(shot, flow),
                  voltage_factor=voltage_factor, tolerance=tolerance, near_walls=True, lying=lying, progress=progress)


def with_particle(chip: Chip, state: str | None, *, particle: str | None, radius: float | None) -> Chip:
    """The chip with another particle or radius (m) in a state.

    Raises:
        InputError: no such state, one of the two is missing, or the particle does not fit the cavity.
    """
    chosen = chip.state(state)
    changed = replace(chosen, particle=particle or chosen.particle,
                      particle_radius=chosen.particle_radius if radius is None else radius)
    return replace(chip, states=tuple(changed if each is chosen else each for each in chip.states))


def carrier_of(chip: Chip, state: str | None, registry: Registry | None = None) -> FilledChip:
    """The chip in a state with a particle in a liquid.

    Raises:
        InputError: a state without particle, or see `workbench.model.problem.fill`.
    """
    device = fill(chip, state, registry)
    if device.particle is None:
        raise InputError(chip.file, f"states.{device.state.name}.particle", None, "a particle to follow, such as "
                         'particle = "polystyrene" with particle_radius = "5 um"')
    return device


def _on_forces(shot: Snapshot, flow: FloatArray | None) -> FloatArray | None:
    """A flow at the nodes of the mesh of the forces."""
    assert shot.traps is not None
    own = shot.traps.forces.mesh
    if flow is None:
        return None
    if not isinstance(flow, np.ndarray):
        # New users pass the result that contains the array.
        instead = {Streaming: "flow.carried_on(shot.traps.forces.mesh) of this streaming",
                   LiquidMotion: "flow.velocity of this motion"}.get(type(flow), "an array (N, 2) in m/s")
        raise InputError("trajectories", "flow", type(flow).__name__, f"velocities at the nodes: {instead}")
    if flow.shape == (len(own.points), 2):
        moved = flow
    elif flow.shape == (len(shot.fields.mesh.points), 2):
        moved = transfer(shot.fields.mesh, flow, own)
    else:
        raise InputError("trajectories", "flow", f"an array of shape {flow.shape}", f"velocities of shape "
                         f"({len(own.points)}, 2) at the nodes of the forces, or ({len(shot.fields.mesh.points)}, 2) "
                         "at those of the fields")
    wrong = int((~np.isfinite(moved)).sum())
    if wrong:
        raise InputError("trajectories", "flow", f"{wrong} values that are not finite",
                         f"a velocity at every node of the {CAVITY}")
    return moved
