"""Figures of the channel of a simulated straight chip.

    run = simulate(read_chip("chip.toml"), "filled")
    found = channel_figures(run)
    found.energy_per_square_volt, found.lines, found.focus_time
"""

from __future__ import annotations

import numpy as np

from geometry.measure import Axisymmetric
from geometry.names import CAVITY
from materials.kinds import Fluid
from workbench.acoustics.channel import ChannelFigures, channel_of
from workbench.acoustics.forces import excitation_of
from workbench.files.errors import InputError
from workbench.simulation.run import Snapshot


def channel_figures(shot: Snapshot) -> ChannelFigures:
    """Figures of merit of a straight channel: energy density, pressure, focusing.

    Args:
        shot: a state of `snapshot` or `simulate`; focusing lines and the critical diameter need a particle in it.

    Raises:
        InputError: a round chip, or no liquid in the cavity.
    """
    if isinstance(shot.chip.measure, Axisymmetric):
        raise InputError(shot.chip.file, "chip.geometry", "axisymmetric", '"straight" for the figures of a channel')
    fluid = shot.problem.materials.get(CAVITY)
    if not isinstance(fluid, Fluid):
        raise InputError("channel figures", "shot", f"state {shot.state} of {shot.chip.name}", "a state with a liquid "
                         'in the cavity, such as cavity = "water" in its table of the chip file')
    fields = shot.fields
    if shot.traps is not None:
        return channel_of(fields, shot.traps.excitation, region=CAVITY, forces=shot.traps.forces)
    inside = fields.mesh.nodes_of([CAVITY])
    excitation = excitation_of(fields, fluid, CAVITY, amplitude=float(np.abs(fields.pressure[inside]).max()))
    return channel_of(fields, excitation, region=CAVITY)
