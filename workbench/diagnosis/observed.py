"""Observables beside Z as functionals of the field, with exact derivatives.

An observable is a figure of the first-order field at one frequency and drive (`workbench.design.evaluation`). Its
derivative by a parameter needs one more solve of the same system for the state, and the chain rule for lengths of the
cavity and properties of the liquid. Shapes that deform the cavity act through the pressure alone.

- focusing time: seconds from 90 to 10 % of a quarter wavelength above the deepest trap
  (`workbench.acoustics.traps.focus_time`), which may begin a little above the lid;
- temperature rate: K/s of the mean of the whole chip at switch-on, the electrical input power over the heat capacity;
- temperature rise: K of the mean of a part in the steady state: the losses by region and interface, distributed as in
  the chip as stated, times thermal resistances;
- ring: the radius of the trap that a particle at the observed radius moves to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from geometry.chip_section import region_volumes
from geometry.mesh import SectionMesh
from geometry.names import CAVITY
from geometry.stretch import moving_together
from materials.kinds import Fluid
from workbench.acoustics.heat import thermal_constants, thermal_influence
from workbench.campaign.observation import (
    FOCUSING_TIME,
    OF_PARTICLE,
    RING_RADII,
    TEMPERATURE_RATE,
    TEMPERATURE_RISE,
    Observation,
)
from workbench.design.cavity import Cavity, NoCavity, cavity_of
from workbench.design.evaluation import Operation, Question, answer
from workbench.design.resonance import Responding
from workbench.fem.dual import Dual, dual_derivative
from workbench.fem.linearised import FullSystem, ReducedSystem
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.numbers import LOSS, ParameterName
from workbench.model.problem import FilledChip, build
from workbench.reduced.predictor import Prediction

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The figure of the field that each observable is, or rests on.
FIGURES = {FOCUSING_TIME: "focus_time", TEMPERATURE_RATE: "power", TEMPERATURE_RISE: "heating",
           RING_RADII: "trap_radius"}

#: Share of the cavity's height by which the timed path may begin above the lid, where the force continues along its
#: tangent: a search crosses that height, nine tenths of half a wavelength. Doubled, the tangent would cover a fifth.
BEYOND_LID = 0.1

#: Error of Z of the mesh for the distribution of losses. Doubled, a mean temperature changes by a thousandth.
OF_LOSSES = 5e-3


class NotObservable(ValueError):
    """A field without the observable, such as a particle outside any trap."""


@dataclass(frozen=True, eq=False)
class FieldObservable:
    """An ``observation`` of a ``device`` as a functional of the field.

    See `fitting.fit_recording.Observable`. ``full`` makes derivatives by full solves. ``known`` caches the last cavity.
    """

    observation: Observation
    device: FilledChip
    full: bool = False
    known: list[tuple[SectionMesh, tuple[str, ...], Cavity]] = field(default_factory=list)

    def by_full_solves(self) -> FieldObservable:
        return replace(self, full=True)

    def __call__(self, prediction: Prediction, names: Sequence[str]) -> tuple[float, Complex]:
        """The value and its logarithmic derivatives; see `fitting.fit_recording.Observable`.

        Raises:
            InputError: the cavity has no field of this kind.
            NotObservable: the particle does not reach the trap, or there is no ring.
        """
        observation, model, values = self.observation, prediction.model, prediction.values
        figure = FIGURES[observation.kind]
        keys = tuple(names)
        cavity = self._cavity(model.full, values) if observation.kind in OF_PARTICLE else None
        # The derivatives by real parts, then those by imaginary parts.
        question = Question((figure,), (*keys, *(key + LOSS for key in keys)), values,
                            Operation(observation.drive, observation.frequency,
                                      _thermal_resistances(observation, self.device)), cavity, "there is no fluid",
                            None if cavity is None else self._pressure(cavity, None if self.full else model.basis),
                            BEYOND_LID, observation.value if observation.kind == RING_RADII else None)
        system = FullSystem(model.full, values) if self.full else ReducedSystem(model.operators, values)
        result = answer(question, Responding(system, values))
        if figure not in result.figures:
            raise NotObservable(f"{observation.name}: {result.missing[figure]}")
        value = result.figures[figure]
        if observation.kind == TEMPERATURE_RATE:
            value = value / self._heat_capacity(question)
        if not value.value > 0.0:
            raise NotObservable(f"{observation.name}: particles {1e3 * observation.value:.4g} mm from the axis are led "
                                "to it")
        by_real, by_imaginary = np.split(value.gradient / value.value, 2)
        return value.value, by_real - 1j * by_imaginary

    @staticmethod
    def _pressure(cavity: Cavity, basis: Real | None) -> Callable[[Complex], Complex]:
        """The pressure at the cavity's nodes from states. They are full (size, k), or (r, k) on a basis (size, r)."""
        if basis is None:
            return lambda states: np.asarray(np.append(states, np.zeros((1, states.shape[1])), axis=0)[cavity.rows],
                                             dtype=np.complex128)
        rows = cavity.pressure_rows(basis)
        return lambda states: np.asarray(rows @ states, dtype=np.complex128)

    def _cavity(self, operators: FullOperators, values: Mapping[str, complex]) -> Cavity:
        for mesh, names, cavity in self.known:
            if mesh is operators.mesh and names == tuple(values):
                return cavity
        device, fluid = self.device, self.device.materials[CAVITY]
        assert isinstance(fluid, Fluid)
        try:
            made = cavity_of(operators, device.chip, fluid, device.particle, self._lengths(operators, values),
                             self.observation.frequency)
        except NoCavity as error:
            raise InputError(device.chip.file, self.observation.name, "this chip", f"a cavity that is a cylinder: "
                             f"{error}") from error
        self.known[:] = [(operators.mesh, tuple(values), made)]
        return made

    def _lengths(self, operators: FullOperators, values: Mapping[str, complex]) -> list[str]:
        """The lengths of the chip without those that deform the cavity's cells."""
        deforming = {name for each in operators.integrals if each.variant for name in each.coefficient.parameters}
        return [name for name in values if name in self.device.chip.dimensions() and name not in deforming]

    def _heat_capacity(self, question: Question) -> Dual:
        """The heat capacity (J/K) of all parts; empty regions have none."""
        values, materials = question.values, self.device.materials
        lengths = {name: complex(values[name]).real for name in values if name in self.device.chip.dimensions()}
        stated = {region: thermal_constants(material) for region, material in materials.items()}

        def capacity(moved: Mapping[str, float], densities: Mapping[str, float]) -> float:
            chip = self.device.chip
            changed = {other: value for name, value in moved.items() for other in moving_together(chip, name)
                       if value != chip.dimensions()[name].value}
            sizes = region_volumes(chip.with_dimensions(changed) if changed else chip)
            return sum(sizes[region] * densities[material.name] * stated[region].heat_capacity
                       for region, material in materials.items())

        here = {material.name: complex(values.get(f"{material.name}.density", material.density)).real
                for material in materials.values()}
        gradient = np.zeros(len(question.names))
        for index, name in enumerate(question.names):
            parsed = ParameterName.parse(name)
            if name in lengths:
                gradient[index] = dual_derivative(
                    lambda x, name=name: np.array(capacity({**lengths, name: x}, here)), lengths[name])  # type: ignore[misc]
            elif parsed.coefficient == "density" and not parsed.is_loss and parsed.owner in here:
                own = {other: float(other == parsed.owner) for other in here}
                gradient[index] = capacity(lengths, own)
        return Dual(capacity(lengths, here), gradient)


@lru_cache(maxsize=32)
def _thermal_resistances(observation: Observation, device: FilledChip) -> Mapping[str, float]:
    """The thermal resistances (K/W) of the observed part. Only temperature rises have them."""
    cooling = observation.cooling
    if cooling is None:
        return {}
    problem = build(device, accuracy=OF_LOSSES)
    solution = solve_full(assemble(problem.mesh, problem.terms), np.array([observation.frequency]), problem.values)
    return thermal_influence(problem, solution, part=cooling.part, convection=cooling.convection,
                             holder=cooling.holder)
