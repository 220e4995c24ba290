"""Temperatures of a driven chip: losses, conduction and cooling.

The losses (`heat_source`) are conducted (`conduction`) to the outside, and dissipated by natural convection and
radiation, or into a holder. Convection in the liquid is neglected, which :func:`check_peclet` verifies; material
constants do not depend on the temperature.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from materials.kinds import Fluid, Material
from materials.registry import Registry
from workbench.acoustics.conduction import Conduction, ThermalConstants, conduction, is_outer, mean_over
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.heat_source import HeatSource, heat_source
from workbench.acoustics.nodal import NodalMesh
from workbench.fem.solve import Solution
from workbench.files.errors import InputError, choose, nearest_names
from workbench.model.problem import Problem
from workbench.results.brief import Brief

Real = NDArray[np.float64]

#: Heat transfer coefficient (W/(m^2 K)) of a surface in still air: natural convection and radiation. Free convection in
#: gases gives 2 to 25 (Incropera and DeWitt, Fundamentals of Heat and Mass Transfer, table 1.1). A plate of 25 mm that
#: is 10 K warmer has 1.32 (dT / L)^(1/4) = 6, radiation adds at most 6. Doubled, the temperature rise of a chip is
#: almost half.
STILL_AIR = 10.0

#: The material of an empty region for conduction.
EMPTY = "air"

#: Peclet number above which conduction alone raises: convection is then as large as conduction.
HIGHEST_PECLET = 1.0

#: The constants of a material for conduction, with units.
NEEDED: Mapping[str, str] = {"thermal_conductivity": "W/(m K)", "heat_capacity": "J/(kg K)"}


@dataclass(frozen=True)
class PartTemperature:
    """One part of a chip in the steady state. ``mean`` and ``peak`` K above ambient; ``loss`` W in it; ``capacity``
    J/K; ``resistance`` K/W, the rise of its mean per watt lost in the whole chip."""

    mean: float
    peak: float
    loss: float
    capacity: float
    resistance: float

    @property
    def initial_rate(self) -> float:
        """Rate (K/s) of its mean temperature at switch-on, loss over capacity."""
        return self.loss / self.capacity


@dataclass(frozen=True, eq=False, repr=False)
class Heating(Brief):
    """Steady temperatures of a chip at one frequency, in K above ambient.

    ``rise`` (N,) at the nodes of ``mesh``, NaN outside conducting regions; ``parts`` by region; ``power`` W of
    electrical input, ``released`` W of heat, ``convected`` W by outer boundary, ``into_holder`` W; ``closure`` the
    relative difference of produced and leaving heat. ``hottest`` r, z (m) of the hottest point, ``peak`` K there and
    ``peak_resistance`` K/W. ``time_constant`` s, the slowest. ``drive`` in words, ``frequency`` Hz. ``notes`` are
    sentences on assumptions.
    """

    mesh: NodalMesh
    rise: Real
    parts: Mapping[str, PartTemperature]
    power: float
    released: float
    convected: Mapping[str, float]
    into_holder: float
    closure: float
    hottest: tuple[float, float]
    peak: float
    peak_resistance: float
    time_constant: float
    drive: str
    frequency: float
    notes: tuple[str, ...] = ()

    @property
    def initial_rate(self) -> float:
        """Rate (K/s) of the chip's mean temperature at switch-on. The mean is weighted with the heat capacity."""
        return self.released / sum(part.capacity for part in self.parts.values())

    def __str__(self) -> str:
        parts = "\n".join(
            f"{name}: mean {part.mean:.3g} K, peak {part.peak:.3g} K, {part.resistance:.3g} K/W, {part.loss:.3g} W "
            f"lost in it, {part.initial_rate:.3g} K/s at switch-on" for name, part in self.parts.items())
        r, z = (1e3 * each for each in self.hottest)
        return (f"{self.frequency / 1e6:.4f} MHz, {self.drive}, {self.power:.3g} W: hottest {self.peak:.3g} K above "
                f"ambient at {self.mesh.measure.symbol} = {r:.3g} mm, z = {z:.3g} mm, time constant "
                f"{self.time_constant:.3g} s\n{parts}")


def conducted_heat(
    problem: Problem,
    solution: Solution,
    voltage: float,
    *,
    drive: str = "",
    convection: float | Mapping[str, float] = STILL_AIR,
    holder: str | Mapping[str, float] | None = None,
    empty: str | None = EMPTY,
) -> Heating:
    """The steady temperatures of a chip, from a full `solution`. The solution is at one frequency.

    Args:
        voltage: amplitude (V) at the electrodes.
        drive: the drive in words.
        convection: heat transfer coefficient (W/(m^2 K)) of the outside, or by outer boundary
            (``superstrate|outside``); the key "" means all other boundaries.
        holder: an outer boundary (``substrate|outside``) at ambient temperature, or the temperatures (K above ambient)
            of several.
        empty: material of the registry for an empty region; None: it is insulated.

    Raises:
        InputError: a material without thermal constants, no cooling, an unknown boundary, or a chip without losses.
    """
    model, notes = conduction_of(problem, convection=convection, holder=holder, empty=empty)
    source = heat_source(solution, voltage)
    power = float(solution.input_power()[0]) * voltage**2
    if not source.power > 0.0:
        raise InputError("heat", "power lost in the chip", f"{source.power:g} W", "a chip that loses power: state the "
                         "loss of its materials")
    load = source.load
    rise = model.temperature(load)
    by_power = rise if not any(model.holders.values()) else rise - model.temperature(np.zeros(model.size))
    cooled, into_holder = model.leaving(rise, load)
    mesh, dofs = section_nodes(problem.mesh)
    parts = {}
    for region, constants in model.constants.items():
        weights = model.averaging(region)
        there = np.flatnonzero(weights)
        nodes = np.unique(model.places[region].dofs)
        parts[region] = PartTemperature(
            mean=float(weights[there] @ rise[there]), peak=float(rise[nodes].max()),
            loss=source.released(region), capacity=constants.volumetric * model.volume(region),
            resistance=float(weights[there] @ by_power[there]) / source.power)
    nodal = rise[dofs]
    top = int(np.nanargmax(nodal))
    return Heating(
        mesh=mesh, rise=nodal, parts=parts, power=power, released=source.power, convected=cooled,
        into_holder=into_holder, closure=abs(sum(cooled.values()) + into_holder - source.power) / source.power,
        hottest=(float(mesh.points[top, 0]), float(mesh.points[top, 1])), peak=float(nodal[top]),
        peak_resistance=float(by_power[dofs[top]]) / source.power, time_constant=model.slowest_time(),
        drive=drive, frequency=float(solution.frequency[0]), notes=notes)


def conduction_of(
    problem: Problem,
    *,
    convection: float | Mapping[str, float] = STILL_AIR,
    holder: str | Mapping[str, float] | None = None,
    empty: str | None = EMPTY,
) -> tuple[Conduction, tuple[str, ...]]:
    """The conduction in a `problem`, and findings on assumptions; see :func:`conducted_heat`."""
    notes = list[str]()
    constants = {region: thermal_constants(material, problem) for region, material in problem.materials.items()}
    for region in problem.mesh.section.regions:
        if region in constants:
            continue
        if empty is None:
            notes.append(f"{region} is empty and insulated")
            continue
        material = Registry().load(empty)
        constants[region] = thermal_constants(material, problem)
        notes.append(f"{region} is empty and conducts heat as {material.name}, without convection or radiation inside")
    holders = {} if holder is None else {holder: 0.0} if isinstance(holder, str) else dict(holder)
    for name in holders:
        choose(name, [each for each in problem.mesh.mesh.boundaries if is_outer(each)], source="heat", field="holder")
    cooling = dict(convection) if isinstance(convection, Mapping) else {"": float(convection)}
    return conduction(problem.mesh, constants, cooling=cooling, holders=holders), tuple(notes)


def thermal_constants(material: Material, problem: Problem | None = None) -> ThermalConstants:
    """The constants of a material for conduction. Those of a `problem` come first.

    Raises:
        InputError: the material lacks one; the error names the nearest materials of the package that have it.
    """
    values = {} if problem is None else problem.values
    numbers = {}
    for name, unit in NEEDED.items():
        stated = getattr(material, name)
        found = values.get(f"{material.name}.{name}", stated)
        if found is None:
            raise InputError(f"material {material.name}", name, None, f"a number in {unit}: temperatures depend on it; "
                             "state it in the material's entry, or use a material that has it",
                             _with_constant(material, name))
        numbers[name] = complex(found).real
    density = complex(values.get(f"{material.name}.density", material.density)).real
    return ThermalConstants(numbers["thermal_conductivity"], density, numbers["heat_capacity"])


def lacking_constants(problem: Problem) -> str:
    """A sentence on the first material without thermal constants, or ""."""
    for material in problem.materials.values():
        try:
            thermal_constants(material, problem)
        except InputError as error:
            return str(error)
    return ""


def _with_constant(material: Material, name: str) -> tuple[str, ...]:
    """Materials of the package and kind that have a constant. They are those of a similar name, or the one of the
    nearest density."""
    registry = Registry()
    known = {each.name: each for each in (registry.load(entry, notes=[]) for entry in registry.names())
             if isinstance(each, type(material)) and getattr(each, name) is not None}
    similar = nearest_names(material.name, known) or tuple(
        each for each in known if each.split("/")[0] == material.name.split("/")[0])
    return similar or (min(known, key=lambda each: abs(known[each].density - material.density)),)


def thermal_influence(
    problem: Problem,
    solution: Solution | None = None,
    *,
    part: str,
    convection: float | Mapping[str, float] = STILL_AIR,
    holder: str | Mapping[str, float] | None = None,
    empty: str | None = EMPTY,
) -> dict[str, float]:
    """Thermal resistances (K/W) of `part`, by region or interface of the loss.

    A resistance is the mean rise of `part` per watt. The loss is distributed as in `solution`, or uniformly if that has
    none. The matrix of conduction is symmetric, so one solve with the weights of the mean as its load gives all
    resistances. The sum of losses times resistances is the mean of `part` by :func:`conducted_heat`.

    Raises:
        InputError: see :func:`conducted_heat`; an unknown part.
    """
    model, _ = conduction_of(problem, convection=convection, holder=holder, empty=empty)
    return influence_on(part, model, None if solution is None else heat_source(solution, 1.0))


def influence_on(part: str, model: Conduction, source: HeatSource | None) -> dict[str, float]:
    """The thermal resistances (K/W) of :func:`thermal_influence` for a conduction. `source` is the distribution of the
    heat."""
    choose(part, model.constants, source="heat", field="part")
    influence = np.nan_to_num(model.temperature(model.averaging(part), driven=False))
    found = {region: float(model.averaging(region) @ influence) for region in model.constants}
    for name in model.mesh.mesh.boundaries:
        if "|" in name and not is_outer(name) and set(name.split("|")) <= set(model.constants):
            found[name] = float(mean_over(model.mesh, model.size, name) @ influence)
    if source is not None:
        found |= {place: float(load @ influence) / float(load.sum())
                  for place, load in source.loads.items() if load.sum() > 0.0}
    return found


def peclet_number(fluid: Fluid, speed: float, length: float) -> float:
    """The Peclet number: `speed` (m/s) times `length` (m) over thermal diffusivity.

    `length` is the smaller of the cavity's height and width.

    Raises:
        InputError: a fluid without thermal constants.
    """
    return speed * length / thermal_constants(fluid).diffusivity


def check_peclet(fluid: Fluid, speed: float, length: float) -> float:
    """The Peclet number of a flow, checked for heat conduction.

    Raises:
        InputError: it is above :data:`HIGHEST_PECLET`, or a fluid without thermal constants.
    """
    found = peclet_number(fluid, speed, length)
    if not found <= HIGHEST_PECLET:
        raise InputError("heat", "speed of the flow", f"{speed:g} m/s",
                         f"at most {HIGHEST_PECLET * speed / found:.3g} m/s in {fluid.name} across {1e3 * length:.3g} "
                         f"mm: the Peclet number is {found:.3g}, and above {HIGHEST_PECLET:g} convection exceeds "
                         "conduction, the only transport in this model. Lower the drive: the speed of the flow falls "
                         "faster than the loss")
    return found


