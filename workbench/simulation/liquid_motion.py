"""The flow of the liquid by sound and by heat.

    shot = snapshot(read_chip("chip.toml"), "filled", 1.03e6)
    moving = liquid_motion(shot)
    trajectories(shot, 1800.0, flow=moving.velocity)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.heat import STILL_AIR, Heating, check_peclet, lacking_constants
from workbench.acoustics.nodal import FloatArray
from workbench.acoustics.streaming import Streaming
from workbench.files.errors import InputError, choose
from workbench.model.problem import registry_of
from workbench.results.brief import Brief
from workbench.simulation.heating import heating
from workbench.simulation.run import Snapshot
from workbench.simulation.streaming import streaming


class FlowCause(StrEnum):
    """A cause of the flow; heat includes sound."""

    HEAT = "heat"
    SOUND = "sound"
    NONE = "none"


@dataclass(frozen=True, eq=False, repr=False)
class LiquidMotion(Brief):
    """The steady flow of the liquid in a cavity, and the temperatures.

    ``streaming`` is None for a liquid at rest, ``heat`` for a flow by sound alone. ``velocity`` (N, 2) m/s carries
    particles, at the nodes of the mesh of the state's forces; None at rest. ``left_out`` is a sentence on a cause that
    was requested but cannot be computed.
    """

    streaming: Streaming | None
    heat: Heating | None
    velocity: FloatArray | None
    left_out: str = ""

    def __str__(self) -> str:
        return "\n".join(map(str, filter(None, (self.streaming, self.heat)))) or "the liquid stays at rest"

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on assumptions."""
        found = () if self.streaming is None else self.streaming.assumptions
        if self.heat is not None:
            found += (f"The flow is that of the warm chip, {self.heat.peak:.3g} K warmer at the hottest place; it "
                      f"develops with a time constant of {self.heat.time_constant:.3g} s.", *self.heat.notes)
        return (self.left_out, *found) if self.left_out else found


def liquid_motion(
    shot: Snapshot, *, by: str = FlowCause.HEAT, registry: Registry | None = None,
    convection: float | Mapping[str, float] = STILL_AIR, holder: str | Mapping[str, float] | None = None,
) -> LiquidMotion:
    """The steady flow of the liquid in a simulated cavity.

    Args:
        shot: a state of `snapshot` or `simulate` with a particle in a liquid.
        by: "heat" (thermoacoustic force and buoyancy, and sound), "sound" (slip at the walls and absorption) or "none".
            Heat is left out for a liquid without a law of temperature, and for a chip without thermal constants; a note
            reports this.
        convection, holder: ways for the heat to leave, as of `heating`.

    Raises:
        InputError: an unknown cause; see `heating` and `streaming`; a liquid that the drive warms beyond its law, or
            whose flow carries more heat than conduction does (a Peclet number above 1).
    """
    cause = FlowCause(choose(by, list(FlowCause), source="liquid_motion", field="by"))
    if cause is FlowCause.NONE or shot.traps is None:
        return LiquidMotion(None, None, None)
    heat, left_out, registry = None, "", registry_of(shot.chip, registry)
    if cause is FlowCause.HEAT:
        left_out = _unknown_heat(shot)
    if cause is FlowCause.HEAT and not left_out:
        heat = heating(shot, convection=convection, holder=holder)
        _check_warm(shot, heat, registry)
    flow = streaming(shot, temperature=None if heat is None else heat.rise, registry=registry)
    if heat is not None:
        check_peclet(flow.fluid, flow.largest_speed, flow.height)
    return LiquidMotion(flow, heat, flow.carried_on(shot.traps.forces.mesh), left_out)


def _unknown_heat(shot: Snapshot) -> str:
    """The reason why the flow by heat is unknown, or ""."""
    assert shot.traps is not None
    fluid = shot.traps.forces.fluid
    if isinstance(fluid, Fluid) and fluid.temperature is None:
        return (f"The entry of {fluid.name} states no law of temperature: the flow is that of sound alone, without "
                "that of heat. Laws of its density and sound_speed would add it.")
    lacking = lacking_constants(shot.problem)
    return f"The flow by heat is left out: {lacking}." if lacking else ""


def _check_warm(shot: Snapshot, heat: Heating, registry: Registry) -> None:
    """Raise if the liquid becomes warmer than its law allows."""
    assert shot.traps is not None
    fluid, voltage = shot.traps.forces.fluid, 2.0 * abs(shot.fields.voltage)
    rise = heat.parts[shot.traps.forces.region].peak - shot.liquid_rise
    if not isinstance(fluid, Fluid) or fluid.temperature is None or _reaches(fluid, rise, registry):
        return
    remedy = 'A holder takes heat away; a flow by sound alone (by="sound", --flow sound) leaves heat out'
    if shot.warm is not None:
        raise InputError("liquid_motion", "drive", str(shot.warm.drive), f"at most {shot.warm.highest_drive}: "
                         f"{shot.warm.sentences[0]} {remedy}")
    low, high = 0.0, rise
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _reaches(fluid, middle, registry) else (low, middle)
    raise InputError(
        "liquid_motion", "drive", f"{voltage:.3g} Vpp at the electrodes",
        f"at most {voltage * (low / rise) ** 0.5:.2g} Vpp: driven steadily, {fluid.name} would be {rise:.3g} K warmer "
        f"than {fluid.temperature - 273.15:.3g} degC, beyond boiling or beyond its law, which ends {low:.3g} K above. "
        f"{remedy}")


def _reaches(fluid: Fluid, rise: float, registry: Registry) -> bool:
    assert fluid.temperature is not None
    try:
        registry.load(fluid.name, temperature=fluid.temperature + rise)
    except InputError:
        return False
    return True
