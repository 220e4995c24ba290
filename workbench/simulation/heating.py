"""Temperatures and thermal resistances of a simulated chip, and effects on sound.

    run = simulate(read_chip("chip.toml"), "filled")
    heat = heating(run)
    heat.parts["cavity"].mean, heat.peak, liquid_warming(run, heat).resonance_slope
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from geometry.dimension import SAME_LENGTH
from geometry.names import CAVITY
from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.heat import (
    EMPTY,
    STILL_AIR,
    Heating,
    check_peclet,
    conducted_heat,
    thermal_constants,
    thermal_influence,
)
from workbench.acoustics.nodal import integrate
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.fem.level import impedance_level
from workbench.fem.linearised import FullSystem
from workbench.fem.operators import FullOperators
from workbench.fem.solve import System
from workbench.files.errors import InputError, expect, expect_number
from workbench.model.fluid_slopes import fluid_slopes
from workbench.model.problem import registry_of
from workbench.model.temperature import law_of, warmer_values
from workbench.results.merit import NoResonance
from workbench.simulation.run import Simulation, Snapshot

#: Most steps of Newton's method from the f0 of a spectrum to that of the model, and the relative step that ends it: a
#: tenth of a hertz of a megahertz, a thousandth of the width of a resonance of Q = 10000.
RESONANCE_STEPS, RESONANCE_FOUND = 8, 1e-7

#: Relative difference of two heat capacities of one part: far above rounding, far below that of two materials.
SAME_CAPACITY = 1e-6


@dataclass(frozen=True)
class LiquidWarming:
    """The liquid in the cavity of a chip driven steadily.

    ``rise`` (K) is the mean over the cavity above ambient. At the stated temperature: ``speed_slope`` (m/s per K) and
    ``density_slope`` (kg/m^3 per K) follow from the law of its entry, ``speed_change`` (m/s) and ``density_change``
    (kg/m^3) from a parabola through that law; ``thermal_expansion`` of volume is in 1/K. ``resonance`` (Hz) is f0,
    ``resonance_slope`` (Hz per K) its derivative when only the liquid is warmer, and ``resonance_shift`` (Hz) that
    times ``rise``. ``energy_slope`` (1/K) is the relative change of the mean energy density in the cavity by the first
    kelvin, at the frequency of the fields and a constant voltage. Values are None if the entry has no law on both
    sides, or the result no resonance. The slopes of f0 assume constant viscosities and solids.
    """

    fluid: str
    rise: float
    speed_slope: float | None = None
    density_slope: float | None = None
    speed_change: float | None = None
    density_change: float | None = None
    thermal_expansion: float | None = None
    resonance: float | None = None
    resonance_slope: float | None = None
    energy_slope: float | None = None

    @property
    def resonance_shift(self) -> float | None:
        return None if self.resonance_slope is None else self.resonance_slope * self.rise


def heating(
    result: Snapshot,
    *,
    convection: float | Mapping[str, float] = STILL_AIR,
    holder: str | Mapping[str, float] | None = None,
    empty: str | None = EMPTY,
    flow_speed: float = 0.0,
) -> Heating:
    """The steady temperatures of a simulated chip under its drive.

    The notes describe the change of the field with the temperature. Fields of `snapshot` without `warm` are those of
    the stated temperature; the temperatures then follow from their losses.

    Args:
        result: the result of `simulate` or `snapshot`.
        convection: heat transfer coefficient (W/(m^2 K)) of the outside, or by outer boundary
            (``superstrate|outside``), with the key "" for all others.
        holder: an outer boundary (``substrate|outside``) at ambient temperature, or the temperature (K above ambient)
            of several.
        empty: material of the registry for conduction in an empty cavity; None: it is insulated.
        flow_speed: largest speed (m/s) of the liquid, for the Peclet number across the height of the cavity.

    Raises:
        InputError: a material without thermal constants, no way for the heat to leave, an unknown boundary or none of
            the outside, a chip without losses, a negative speed, or a flow that carries more heat than conduction does.
    """
    expect(result, Snapshot, reader="read_chip", source="heating", field="result")
    expect_number(flow_speed, "a speed in m/s of 0 or more", source="heating", field="flow_speed", low=0.0)
    liquid = result.problem.materials.get(CAVITY)
    if flow_speed and isinstance(liquid, Fluid):
        check_peclet(liquid, flow_speed, cavity_height(result))
    found = conducted_heat(result.problem, result.solution, abs(result.fields.voltage), drive=result.fields.drive,
                           convection=convection, holder=holder, empty=empty)
    if result.warm is not None:
        return replace(found, notes=(*found.notes, result.warm.slopes.rstrip(".")))
    return replace(found, notes=(*found.notes, *_unwarmed(result, found)))


def _unwarmed(result: Snapshot, heat: Heating) -> tuple[str, ...]:
    slope = energy_slope(result, Registry())
    if slope is None:
        return ()
    rise = heat.parts[CAVITY].mean
    return (f"The fields are those of the liquid at its stated temperature. The first kelvin changes E_ac by "
            f"{100.0 * slope:+.2g} % at this frequency and voltage, and the rise is {rise:.3g} K. In Python "
            "warm=wb.WarmUp() solves both together",)


def energy_slope(result: Snapshot, registry: Registry) -> float | None:
    """Relative change of the mean energy density by a liquid's first kelvin. At the frequency and the voltage of the
    fields; None without a liquid whose law reaches 1 K."""
    problem, solution = result.problem, result.solution
    liquid = problem.materials.get(CAVITY)
    law = law_of(liquid, registry) if isinstance(liquid, Fluid) and not liquid.is_gas else None
    if law is None or law.highest < 1.0:
        return None
    assert isinstance(solution.operators, FullOperators)
    values = warmer_values(problem, (law,), {law.material.name: 1.0})
    sound = SoundEnergy.of(solution.operators)
    warmer = System(solution.operators, values).solutions(solution.frequency)
    here, there = (float(sound.density(each.frequency, each.states, numbers)[0])
                   for each, numbers in ((solution, problem.values), (warmer, values)))
    return there / here - 1.0


def softening_words(result: Snapshot, heat: Heating | None) -> tuple[str, ...]:
    """A sentence for each part above the softening temperature of its polymer. The surroundings are at the stated
    temperature of the liquid."""
    liquid = result.stated_problem.materials.get(CAVITY)
    if heat is None or not isinstance(liquid, Fluid) or liquid.temperature is None:
        return ()
    found, voltage = list[str](), 2.0 * abs(result.fields.voltage)
    for region, material in result.problem.materials.items():
        limit = material.softening_temperature if isinstance(material, IsotropicSolid) else None
        part = heat.parts.get(region)
        if limit is None or part is None or liquid.temperature + part.peak <= limit:
            continue
        most = voltage * max((limit - liquid.temperature) / part.peak, 0.0) ** 0.5
        found.append(f"The {region} becomes {liquid.temperature + part.peak - 273.15:.3g} degC at its warmest place, "
                     f"and {material.name.split('/')[0]} softens at {limit - 273.15:.3g} degC: its constants are valid "
                     f"up to about {most:.2g} Vpp at the electrodes.")
    return tuple(found)


def thermal_resistances(
    result: Snapshot,
    *,
    part: str = CAVITY,
    convection: float | Mapping[str, float] = STILL_AIR,
    holder: str | Mapping[str, float] | None = None,
    empty: str | None = EMPTY,
) -> dict[str, float]:
    """Thermal resistances (K/W) of a part, by place of the loss.

    They are for the figure "heating" of a study, a goal or a tolerance analysis. Each is the mean rise of `part` for a
    watt lost in one region or on one interface, distributed as in the fields of `result`. Their sum weighted with the
    losses is the mean of `part` by :func:`heating`. Other arguments are as there.

    Raises:
        InputError: as :func:`heating`; an unknown part.
    """
    expect(result, Snapshot, reader="read_chip", source="thermal resistances", field="result")
    return thermal_influence(result.problem, result.solution, part=part, convection=convection, holder=holder,
                             empty=empty)


def cavity_height(result: Snapshot) -> float:
    """Height (m) of the cavity, from its lowest to its highest point."""
    mesh = result.fields.mesh
    return float(np.ptp(mesh.points[mesh.nodes_of([CAVITY]), 1]))


def liquid_warming(result: Snapshot, heat: Heating, *, registry: Registry | None = None) -> LiquidWarming:
    """The mean rise of the cavity's liquid, and its effects.

    Effects are on its sound speed, its density and f0.

    Raises:
        InputError: the cavity contains no liquid; temperatures of another chip or state.
    """
    expect(result, Snapshot, reader="read_chip", source="liquid warming", field="result")
    liquid = result.stated_problem.materials.get(CAVITY)
    if not isinstance(liquid, Fluid):
        raise InputError("liquid warming", f"state {result.state}", None if liquid is None else liquid.name,
                         "a state with a fluid in the cavity",
                         tuple(state.name for state in result.chip.states if state.name != result.state))
    _check_own(result, heat)
    rise = heat.parts[CAVITY].mean
    known = registry_of(result.chip, registry)

    def law(temperature: float) -> Fluid:
        return cast(Fluid, known.load(liquid.name, temperature=temperature))

    found = fluid_slopes(liquid, law)
    if found is None:
        return LiquidWarming(liquid.name, rise)
    by_kelvin = {name: found[f"{liquid.name}.{name}"] for name in ("speed_slope", "speed_bend", "density_slope",
                                                                  "density_bend")}
    speed_slope = liquid.sound_speed * by_kelvin["speed_slope"]
    density_slope = liquid.density * by_kelvin["density_slope"]
    resonance = _resonance_slope(result, liquid.name, speed_slope, density_slope)
    return LiquidWarming(
        liquid.name, rise, speed_slope=speed_slope, density_slope=density_slope,
        speed_change=rise * (speed_slope + liquid.sound_speed * by_kelvin["speed_bend"] * rise),
        density_change=rise * (density_slope + liquid.density * by_kelvin["density_bend"] * rise),
        thermal_expansion=-by_kelvin["density_slope"], resonance=resonance and resonance[0],
        resonance_slope=resonance and resonance[1], energy_slope=energy_slope(result, known))


def _check_own(result: Snapshot, heat: Heating) -> None:
    """Raise if the temperatures belong to another mesh or other materials."""
    problem, refusal = result.problem, f"wb.heating of this result, {result.chip.name}, state {result.state}"
    if not isinstance(heat, Heating):
        raise InputError("liquid warming", "heat", type(heat).__name__, refusal)
    own = section_nodes(problem.mesh)[0].points
    if own.shape != heat.mesh.points.shape or not np.allclose(own, heat.mesh.points, rtol=0.0, atol=SAME_LENGTH):
        raise InputError("liquid warming", "heat", "temperatures on another mesh", refusal)
    for region, part in heat.parts.items():
        if region not in problem.materials:
            continue
        volume = float(integrate(heat.mesh, np.ones(len(own)), [region]))
        capacity = thermal_constants(problem.materials[region], problem).volumetric * volume
        if abs(part.capacity - capacity) > SAME_CAPACITY * capacity:
            raise InputError("liquid warming", "heat", f"temperatures of another {region}", refusal)


def _resonance_slope(
    result: Snapshot, fluid: str, speed_slope: float, density_slope: float
) -> tuple[float, float] | None:
    """f0 (Hz) and its derivative (Hz/K) by the liquid's temperature. L = ln |Z| has its minimum at f0, so that d f0 =
    -(d^2 L / df d theta) / (d^2 L / df^2) d theta. None if the result has no resonance."""
    if not isinstance(result, Simulation) or result.figures is None:
        return None
    system, frequency = FullSystem(result.operators, result.stated_problem.values), result.figures.f0
    for _ in range(RESONANCE_STEPS):
        state = system.linearised(frequency, (f"{fluid}.sound_speed", f"{fluid}.density"))
        level = impedance_level(state, np.ones(2, dtype=complex))
        step = -level.slope / level.curvature
        if abs(step) <= RESONANCE_FOUND * frequency:
            slopes = -level.mixed / level.curvature
            return frequency + step, float(slopes @ np.array([speed_slope, density_slope]))
        frequency += step
    raise NoResonance("the full model has no resonance near that of its spectrum", frequency=result.figures.f0,
                      impedance=result.figures.z_min)
