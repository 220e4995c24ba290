"""The figures of one chip in one state, anywhere within ranges of its lengths, moduli and losses.

    model = design_model(read_chip("chip.toml"), "filled", {"substrate.thickness": (0.8e-3, 0.9e-3)},
                         figures=("f0", "e_ac", "trap_offset"))
    found = model({"substrate.thickness": 0.83e-3}, gradient=True)
    found.figures["e_ac"], found.gradient["e_ac"]

The basis of a range model serves all of the ranges; a part of them needs less of it, and dense solves cost the cube of
its rank. Many points are therefore divided into groups (:meth:`DesignModel.divided`), each served by the part of the
basis that it needs (:meth:`DesignModel.local`; local reduced bases: Amsallem, Zahr and Farhat 2012, Int. J. Numer.
Meth. Eng. 92, 891).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.names import CAVITY
from geometry.stretch import tied
from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry
from workbench.design.cavity import Cavity, NoCavity, cavity_of
from workbench.design.evaluation import OF_FIELD, OF_RESONANCE, Evaluation, Operation, Question, answer
from workbench.design.figures import LOSS_SHARE, check_figures
from workbench.dimensions import flexible
from workbench.discretisation import ACCURACY, Discretisation
from workbench.energy_norm import estimated_error
from workbench.files.errors import InputError, nearest_names
from workbench.forms import combined
from workbench.linearised import FullSystem, ReducedSystem
from workbench.operators import FullOperators, assemble
from workbench.parameter_names import Kind, ParameterName, part, placed
from workbench.particles import Particle, particle_from
from workbench.problem import FilledChip, Problem, build, fill
from workbench.ranges import LIMIT, OutOfRange, Progress, RangeModel, Ranges, compacted, keys, range_model
from workbench.reduced_operators import ReducedOperators
from workbench.reduction import reduced, smallest
from workbench.solve import Solution, one_thread
from workbench.spectrum import Origin, Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Points of a group: a local basis costs about as much as twenty evaluations of the whole model, and more points in a
#: group need a larger basis.
GROUP = 200
#: States of a local basis are taken at so many points of its group, and it is checked at so many others.
TAKEN, CHECKED = 16, 3
#: Frequencies that states are taken at.
WATCHED = 81
#: A local basis that is not as good as asked for keeps directions smaller by this.
FINER = 0.4
#: Relative error of the reduced model's impedance in :func:`full_evaluation`, whose figures then come of full solves.
TOLERANCE = 1e-5


class Evaluator(Protocol):
    """Whatever gives figures for numbers of parameters: what studies, tolerances and optimisation ask."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (`workbench.parameter_names`)."""

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures (`workbench.design.figures`)."""

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        """The figures at these numbers (SI); parameters not given are the chip's own.

        Raises:
            KeyError: a name that is no parameter.
            OutOfRange: a number outside the ranges.
        """


@dataclass(frozen=True, eq=False)
class DesignModel:
    """An :class:`Evaluator` on a range model, which can be pickled for other processes.

    ``frequency`` (n,) Hz of the spectrum that resonances are first looked for in; ``values`` the problem's own complex
    parameters; ``operators`` and ``sketch`` the reduced model with what no parameter moves summed up, of ``gram``
    (r - 1, r - 1) the energy of its vectors; ``rows`` (n, m, r) the pressure at the cavity's nodes, None without
    ``cavity``, and ``reason`` says why. ``error`` is the largest relative error of Z found by full solves, and by a
    check of this part of the basis if it is a local one. ``range_model`` stays with the process that made it.
    """

    chip: Chip
    state: str
    figures: tuple[str, ...]
    operation: Operation
    ranges: Ranges
    frequency: Real
    values: Mapping[str, complex]
    operators: ReducedOperators
    sketch: Real
    gram: Real
    cavity: Cavity | None
    rows: Real | None
    reason: str
    tolerance: float
    error: float
    range_model: RangeModel | None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.ranges)

    @property
    def rank(self) -> int:
        """Unknowns of the reduced model."""
        return self.operators.size

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "range_model": None}

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        numbers = self.numbers(values)
        there = placed(self.values, numbers)
        with one_thread():
            system = ReducedSystem(self.operators, there)
            sweep = system.sweep(self.frequency) if self._needs_spectrum else None
            charge = np.zeros(0, dtype=complex) if sweep is None else sweep.charge
            question = Question(self.figures, self.names if gradient else (), there, self.operation, self.cavity,
                                self.reason, None if self.rows is None else self._pressure)
            found = answer(question, system, self.frequency, charge)
            error = math.nan
            if math.isfinite(found.frequency):
                error = float(self._estimate(system.sweep(np.array([found.frequency])))[0])
        return Evaluation(
            numbers, {name: found.figures[name].value if name in found.figures else math.nan
                      for name in self.figures},
            found.missing, found.frequency, error,
            {name: found.figures[name].gradient if name in found.figures else np.full(len(self.names), math.nan)
             for name in self.figures} if gradient else None)

    def spectrum(self, values: Mapping[str, float] | None = None) -> Spectrum:
        """The impedance at these numbers, at :attr:`frequency`."""
        return Spectrum(self.frequency, np.conj(self.solution(values or {}).impedance), origin=Origin("simulated"))

    def solution(self, values: Mapping[str, float]) -> Solution:
        """Reduced states at :attr:`frequency`, e^{-i w t}."""
        with one_thread():
            return ReducedSystem(self.operators, placed(self.values, self.numbers(values))).sweep(self.frequency)

    def numbers(self, values: Mapping[str, float]) -> dict[str, float]:
        """All numbers of the model, those given in the place of the chip's own.

        Raises:
            KeyError: a name that is no parameter.
            OutOfRange: a number outside the ranges.
        """
        found = {name: part(self.values, name) for name in self.ranges} | dict(values)
        for name, number in found.items():
            if name not in self.ranges:
                raise KeyError(f"the model has no range for {name!r}; it has {', '.join(self.ranges)}")
            low, high = self.ranges[name]
            if not low - 1e-9 * abs(low) <= number <= high + 1e-9 * abs(high):
                raise OutOfRange(f"{name} is {number:g}; the model was made for {low:g} to {high:g}")
        return found

    def divided(self, points: Real) -> list[NDArray[np.int64]]:
        """Groups of `points` (n, len(names)), each the indices (k,) of points that lie together.

        A group is halved across the parameter that moves its spectrum most, until it has no more than :data:`GROUP`.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        middle = dict(zip(self.names, map(float, 0.5 * (low + high)), strict=True))
        with one_thread():
            there = placed(self.values, self.numbers(middle))
            solution = ReducedSystem(self.operators, there).sweep(self._watched)
            slopes = solution.parameter_gradient(there, tuple(ParameterName.parse(n).key for n in self.names))
        influence = np.sqrt(np.mean(np.abs(slopes / solution.impedance[:, None]) ** 2, axis=0))
        groups, waiting = [], [np.arange(len(points))]
        while waiting:
            group = waiting.pop()
            extent = np.ptp(points[group], axis=0) * influence
            if group.size <= GROUP or not extent.any():
                groups.append(group)
                continue
            order = group[np.argsort(points[group, int(np.argmax(extent))], kind="stable")]
            waiting += [np.sort(order[group.size // 2 :]), np.sort(order[: group.size // 2])]
        return groups

    def local(self, points: Real) -> DesignModel:
        """The model for `points` (n, len(names)) that lie together: as good there, and faster.

        The directions kept are those that states at some of the points have more energy in than the tolerance allows;
        at others the impedance is compared with this model's, and more are kept until it is within the tolerance.
        """
        chosen = np.unique(np.linspace(0, len(points) - 1, TAKEN + CHECKED).astype(int))
        checked = chosen[1 :: max(2, chosen.size // CHECKED)][:CHECKED]
        every = {int(k): self._states(points[k]) for k in chosen}
        taken = [every[int(k)] for k in chosen if k not in checked] or list(every.values())
        whole = np.concatenate([each.states[:-1] / np.sqrt(np.abs(each.charge)) for each in taken], axis=1)
        root = np.linalg.cholesky(self.gram).T
        directions, sizes, _ = np.linalg.svd(root @ np.column_stack([whole.real, whole.imag]), full_matrices=False)
        least = smallest(self.tolerance)
        while True:
            kept = sizes > least
            basis = np.zeros((self.rank, int(kept.sum()) + 1))
            basis[:-1, :-1], basis[-1, -1] = np.linalg.solve(root, directions[:, kept]), 1.0
            found = self._within(basis)
            off = max(float(np.abs(found._states(points[k]).charge / every[int(k)].charge - 1.0).max())
                      for k in (checked if checked.size else chosen))
            if off <= self.tolerance or kept.all():
                return replace(found, error=max(self.error, off))
            least *= FINER

    def localised(self, points: Real) -> list[tuple[NDArray[np.int64], DesignModel]]:
        """:meth:`local` models for `points` (n, len(names)), with the indices that each is for."""
        return [(group, self.local(points[group])) for group in self.divided(points)]

    @property
    def _needs_spectrum(self) -> bool:
        return self.operation.frequency is None or bool(set(self.figures) & set(OF_RESONANCE))

    @property
    def _watched(self) -> Real:
        return np.linspace(self.frequency[0], self.frequency[-1], min(WATCHED, self.frequency.size))

    def _states(self, point: Real) -> Solution:
        there = placed(self.values, dict(zip(self.names, map(float, point), strict=True)))
        with one_thread():
            return ReducedSystem(self.operators, there).sweep(self._watched)

    def _within(self, basis: Real) -> DesignModel:
        """The model on a part (r, k) of its basis, given in that, its lift last."""
        inner = basis[:-1, :-1]
        return replace(
            self, operators=replace(self.operators, matrices=basis.T @ self.operators.matrices @ basis),
            sketch=self.sketch @ basis, gram=inner.T @ self.gram @ inner,
            rows=None if self.rows is None else self.rows @ basis, range_model=None)

    def _pressure(self, states: Complex) -> Complex:
        assert self.rows is not None
        return np.asarray(self.rows @ states.real + 1j * (self.rows @ states.imag))

    def _estimate(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance, see `workbench.reduction.ReducedModel.error`."""
        sketches = combined(self.operators.by_form(np.array([c for _, c in solution.groups])), self.sketch)
        residual = sum(h * (sketch @ solution.states) for (h, _), sketch in zip(solution.groups, sketches, strict=True))
        return estimated_error(np.asarray(residual), solution.charge)


def design_model(
    chip: Chip,
    state: str | None,
    ranges: Ranges,
    *,
    figures: Sequence[str],
    operation: Operation | None = None,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 161,
    tolerance: float = 1e-3,
    limit: int = LIMIT,
    seed: int = 0,
    progress: Progress | None = None,
    accuracy: float | Discretisation = ACCURACY,
) -> DesignModel:
    """A model of a chip's figures over `ranges`, see `workbench.ranges.range_model` for the arguments.

    Raises:
        InputError: something in the chip, its materials, the ranges or the figures.
        NotCovered: `limit` full solves were not enough.
    """
    check_figures(figures, chip.regions, source=chip.file, field="figures")
    made = range_model(chip, state, ranges, registry=registry, band=band, points=points, tolerance=tolerance,
                       limit=limit, seed=seed, progress=progress, accuracy=accuracy)
    return of_range_model(made, chip, state, figures=figures, operation=operation, registry=registry)


def of_range_model(
    made: RangeModel, chip: Chip, state: str | None, *, figures: Sequence[str], operation: Operation | None = None,
    registry: Registry | None = None,
) -> DesignModel:
    """The figures on a range model of that chip and state.

    Raises:
        InputError: something in the chip, its materials or the figures.
    """
    wanted = check_figures(figures, chip.regions, source=chip.file, field="figures")
    operation = operation or Operation()
    device, problem = fill(chip, state, registry), made.problem
    cavity, reason = _cavity(device, made.reduced.full, tuple(made.ranges), made.frequency[-1], wanted, registry)
    apart = any(name == "heating" or name.startswith(LOSS_SHARE) for name in wanted)
    model = compacted(made.reduced, keys(made.ranges), problem.values, by_place=True) if apart else made.compact
    inner = made.reduced.basis[:-1, :-1]
    return DesignModel(
        chip, device.state.name, wanted, operation, made.ranges, made.frequency, problem.values,
        model.operators, model.sketch, inner.T @ (made.reduced.energy @ inner), cavity,
        None if cavity is None else cavity.pressure_rows(made.reduced.basis), reason, made.tolerance, made.error, made)


def full_evaluation(
    chip: Chip,
    state: str | None,
    values: Mapping[str, float],
    *,
    figures: Sequence[str],
    operation: Operation | None = None,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 161,
    gradient: bool = False,
    accuracy: float | Discretisation = ACCURACY,
) -> Evaluation:
    """The same figures by full solves on a mesh of the chip's own: lengths among `values` are built in, coefficients
    replaced. What a reduced model says is confirmed by this.

    A reduced model of these numbers alone, to :data:`TOLERANCE`, says where the resonance is; the states at f0 and at
    the half-power frequencies are full ones.

    Raises:
        InputError: something in the chip, its materials, the values or the figures.
        NotConverged: a full solve.
    """
    wanted = check_figures(figures, chip.regions, source=chip.file, field="figures")
    lengths = {n: v for n, v in values.items() if ParameterName.parse(n).kind is Kind.DIMENSION}
    others = {n: v for n, v in values.items() if n not in lengths}
    moved = chip.with_dimensions(all_of_one_length(chip, lengths))
    device = fill(moved, state, registry)
    problem = build(device, band=band, accuracy=accuracy)
    if gradient and lengths:
        problem = flexible(problem, moved, [n for n in lengths if ParameterName.parse(n).is_radius])
    unknown = sorted(n for n in others if ParameterName.parse(n).key not in problem.values)
    if unknown:
        raise InputError(chip.file, "values", unknown[0], "a length or a coefficient of the chip's materials",
                         nearest_names(unknown[0], problem.values))
    return _evaluated(device, replace(problem, values=placed(problem.values, others)), values, wanted,
                      operation or Operation(), registry, points, gradient)


def all_of_one_length(chip: Chip, lengths: Mapping[str, float]) -> dict[str, float]:
    """`lengths` (m) with the radii that coincide with one of them, which are one parameter, by all of their names."""
    first = tied(chip)
    found = dict(lengths)
    for name, value in lengths.items():
        found |= {other: value for other in first if name in first and first[other] == first[name]}
    return found


def _cavity(
    device: FilledChip, operators: FullOperators, names: Sequence[str], highest: float, figures: Sequence[str],
    registry: Registry | None,
) -> tuple[Cavity | None, str]:
    """The cavity and its particle, or why there is none; looked at only if a figure needs it.

    Raises:
        InputError: a particle that is no isotropic solid.
    """
    fluid = device.materials.get(CAVITY)
    if not set(figures) & set(OF_FIELD):
        return None, ""
    if not isinstance(fluid, Fluid):
        return None, f"there is no fluid in the cavity in state {device.state.name!r}"
    lengths = [n for n in names if ParameterName.parse(n).kind is Kind.DIMENSION]
    try:
        found = cavity_of(operators, device.chip, fluid, particle_of(device, registry), lengths, highest)
    except NoCavity as error:
        return None, str(error)
    return found, ""


def particle_of(device: FilledChip, registry: Registry | None) -> Particle | None:
    """The particle that the state of a chip names, if any.

    Raises:
        InputError: its material is no isotropic solid.
    """
    chosen = device.state
    if chosen.particle is None or chosen.particle_radius is None:
        return None
    material = (Registry() if registry is None else registry).load(chosen.particle)
    if not isinstance(material, IsotropicSolid):
        raise InputError(device.chip.file, f"states.{chosen.name}.particle", chosen.particle, "an isotropic solid")
    return particle_from(material, chosen.particle_radius)


def _evaluated(
    device: FilledChip, problem: Problem, numbers: Mapping[str, float], figures: tuple[str, ...],
    operation: Operation, registry: Registry | None, points: int, gradient: bool,
) -> Evaluation:
    operators = assemble(problem.mesh, problem.terms)
    frequency = np.linspace(*problem.band, points)
    small, sweep = reduced(operators, frequency, problem.values, tolerance=TOLERANCE, confirmed=False)
    first = tied(device.chip)
    names = tuple(first.get(name, name) for name in numbers) if gradient else ()
    cavity, reason = _cavity(device, operators, names, frequency[-1], figures, registry)

    def pressure(states: Complex) -> Complex:
        assert cavity is not None
        return np.asarray(np.append(states, np.zeros((1, states.shape[1])), axis=0)[cavity.rows])

    question = Question(figures, names, problem.values, operation, cavity, reason, pressure)
    with one_thread():
        found = answer(question, ReducedSystem(small.operators, problem.values), frequency, sweep.charge,
                       FullSystem(operators, problem.values))
    nothing = np.full(len(numbers), math.nan)
    return Evaluation(
        dict(numbers), {name: found.figures[name].value if name in found.figures else math.nan for name in figures},
        found.missing, found.frequency, 0.0,
        {name: found.figures[name].gradient if name in found.figures else nothing for name in figures}
        if gradient else None)
