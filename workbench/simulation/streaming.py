"""The streaming of a simulated state.

    run = simulate(read_chip("chip.toml"), "filled")
    flow = streaming(run)
    flow.velocity, flow.carrier_velocity, flow.slips
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.names import CAVITY
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.flow_forces import TemperatureSlopes
from workbench.acoustics.nodal import FloatArray
from workbench.acoustics.streaming import Streaming, acoustic_streaming
from workbench.files.errors import InputError
from workbench.model.problem import registry_of
from workbench.model.validity import check_streaming_layer
from workbench.simulation.run import Snapshot

#: Step in K of the central differences for the change of a liquid with temperature. They are exact for a parabola; the
#: third-order part of water's speed of sound gives an error of 1e-4 of its slope.
STEP = 1.0


def streaming(
    shot: Snapshot, *, temperature: FloatArray | None = None, slopes: TemperatureSlopes | None = None,
    registry: Registry | None = None, order: int | None = None,
) -> Streaming:
    """The steady flow in the cavity of a simulated state.

    Args:
        shot: a state of `snapshot` or `simulate` with a liquid in its cavity.
        temperature: K above the stated temperature of the liquid, which is that of the surroundings, at the nodes of
            the mesh of ``shot.fields`` or at those of the cavity alone; default: uniform.
        slopes: change of the liquid with temperature; default: from its law in the `registry`.
        order: polynomial order of the flow; default: that of the fields.

    Raises:
        InputError: no liquid in the cavity, or one without viscosity, or with a boundary layer above 5 % of the
            cavity's smallest length; a temperature of another shape, or outside the liquid's law.
    """
    fluid = shot.problem.materials.get(CAVITY)
    if not isinstance(fluid, Fluid):
        raise InputError("streaming", "shot", f"state {shot.state} of {shot.chip.name}", "a state with a liquid in the "
                         'cavity, such as cavity = "water" in its table of the chip file')
    if fluid.shear_viscosity is not None:
        check_streaming_layer(shot.chip, shot.state, fluid, shot.fields.frequency)
    known = {name: complex(shot.problem.values[f"{fluid.name}.{name}"]).real for name in (
        "density", "sound_speed", "shear_viscosity", "diffusivity_of_sound")
        if f"{fluid.name}.{name}" in shot.problem.values}
    # The constants of the fields, which a fit may have changed.
    fluid = replace(fluid, density=known["density"], sound_speed=known["sound_speed"],
                    shear_viscosity=known.get("shear_viscosity"))
    if temperature is not None and not isinstance(temperature, np.ndarray):
        raise InputError("streaming", "temperature", temperature, "kelvin above the liquid's stated temperature at the "
                         f"nodes of the fields, an array ({len(shot.fields.mesh.points)},), such as "
                         "wb.heating(shot).rise; leave it out for a liquid of uniform temperature")
    if temperature is not None and slopes is None:
        inside = shot.fields.mesh.nodes_of([CAVITY])
        there = temperature[inside] if temperature.size > inside.size else temperature
        slopes = slopes_of(fluid, registry_of(shot.chip, registry), warmer_by=float(np.mean(there)) - shot.liquid_rise)
    return acoustic_streaming(shot.fields, fluid=fluid, region=CAVITY,
                              diffusivity=known.get("diffusivity_of_sound"), temperature=temperature, slopes=slopes,
                              order=order, forces=None if shot.traps is None else shot.traps.forces)


def slopes_of(fluid: Fluid, registry: Registry, *, warmer_by: float = 0.0) -> TemperatureSlopes:
    """The change of `fluid` with temperature, by its law.

    It is at `warmer_by` K above the fluid's temperature.

    Raises:
        InputError: the registry states no law for the fluid, or none at this temperature.
    """
    if fluid.temperature is None:
        raise InputError("streaming", "temperature", f"{fluid.name} without a temperature",
                         "a liquid whose entry states its law of temperature, or slopes=TemperatureSlopes(...)")
    there = fluid.temperature + warmer_by
    below, above = (registry.load(fluid.name, temperature=there + side) for side in (-STEP, STEP))
    if not (isinstance(below, Fluid) and isinstance(above, Fluid)) or below.temperature is None:
        raise InputError("streaming", "temperature", fluid.name, "a liquid with a law of temperature in the registry")
    return TemperatureSlopes(density=(above.density - below.density) / (2.0 * STEP),
                             sound_speed=(above.sound_speed - below.sound_speed) / (2.0 * STEP))
