"""Models of a chip's figures over ranges of its parameters.

A model gives the figures of one chip in one state, for all lengths, moduli and losses within ranges:

    model = design_model(read_chip("chip.toml"), "filled", {"substrate.thickness": (0.8e-3, 0.9e-3)},
                         figures=("f0", "e_ac", "trap_offset"))
    found = model({"substrate.thickness": 0.83e-3}, gradient=True)
    found.figures["e_ac"], found.gradient["e_ac"]

Figures need far less of a range model than its spectra (`workbench.design.bases`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.names import CAVITY
from geometry.stretch import canonical_names, moving_together
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.sound_energy import sound_energy
from workbench.design.bases import Bases, bases_of, stored_bases
from workbench.design.cavity import Cavity, NoCavity, cavity_of
from workbench.design.evaluation import (
    OF_FIELD,
    Evaluation,
    FigureValues,
    Operation,
    Question,
    answer,
    responses,
)
from workbench.design.figures import LOSS_SHARE, check_figures, with_parts
from workbench.design.resonance import Impedance, Responding
from workbench.fem.linearised import FullSystem, ReducedSystem
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import NotConverged, one_thread
from workbench.files.errors import InputError, nearest_names
from workbench.files.sealed import read_arrays, write_arrays
from workbench.fitting.parameter import about
from workbench.jobs.progress import Progress, no_progress
from workbench.model.dimensions import parametrised, parametrised_within
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.drive import Drive
from workbench.model.numbers import ParameterName, placed
from workbench.model.problem import FilledChip, Problem, build, fill
from workbench.reduced.at_point import reduced
from workbench.reduced.ranges import (
    LIMIT,
    RangeModel,
    Ranges,
    fingerprint,
    numbers_in_ranges,
    range_model,
    with_ranges,
)
from workbench.results.brief import Brief
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative error of Z of the range model, which locates resonances.
SWEEP = 0.01
#: Relative error of the reduced model's impedance in :func:`full_evaluation`, whose figures then come from full solves.
TOLERANCE = 1e-5
#: Number of the layout of a stored model; raise it where the layout changes.
FORMAT = 2


class Evaluator(Protocol):
    """The figures as a function of parameters.

    Studies, tolerances and optimisation need only this.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters (`workbench.model.numbers`)."""

    @property
    def figures(self) -> tuple[str, ...]:
        """The names of the figures (`workbench.design.figures`)."""

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        """The figures at these numbers (SI); the others are the chip's own.

        Raises:
            KeyError: a name is not a parameter.
            OutOfRange: a number is outside the ranges.
        """


@dataclass(frozen=True, eq=False, repr=False)
class DesignModel(Brief):
    """An :class:`Evaluator` on reduced models, which can be pickled.

    ``values`` are the problem's own complex parameters and ``bases`` the reduced bases. ``cavity`` has the places of
    the pressure; it is None if there is none, and ``reason`` explains why. ``range_model`` stays in the process that
    made it, and is None in a model read from a file.
    """

    chip: Chip
    state: str
    figures: tuple[str, ...]
    operation: Operation
    ranges: Ranges
    values: Mapping[str, complex]
    bases: Bases
    cavity: Cavity | None
    reason: str
    range_model: RangeModel | None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.ranges)

    @property
    def error(self) -> float:
        """The largest relative error of Z at f0 or of the pressure.

        The pressure's is that of its root mean square. Both were found against full solves.
        """
        return max(self.bases.error, self.bases.pressure_error)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "range_model": None}

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        numbers, bases = self.numbers(values), self.bases
        there = placed(self.values, numbers)
        question = Question(self.figures, self.names if gradient else (), there, self.operation.wired(self.chip),
                            self.cavity, self.reason, bases.pressure)
        with one_thread():
            rough = ReducedSystem(bases.sweeping, there)
            model = Responding(ReducedSystem(bases.operating, there), there, bases.sound)
            return answer(question, model, lambda: (Responding(rough, there, bases.sweeping_sound),
                                                    rough.sweep(bases.frequency))).evaluation(numbers, bases.estimate)

    def save(self, path: Path) -> None:
        """Save the model in a file for :func:`load_design_model`.

        Raises:
            ValueError: this is a copy in another process, without the range model.
        """
        if self.range_model is None:
            raise ValueError("a design model that was sent to another process cannot be saved")
        write_arrays(path, self.bases.arrays(), {"format": FORMAT, "problem": fingerprint(self.range_model.problem)})

    def spectrum(self, values: Mapping[str, float] | None = None) -> Spectrum:
        """The impedance over the band at these numbers, from the range model.

        Raises:
            ValueError: this is a copy in another process, without the range model.
        """
        if self.range_model is None:
            raise ValueError("a design model that was sent to another process, or read from a file, has no spectrum "
                             "over the band")
        return self.range_model(values).spectrum

    def numbers(self, values: Mapping[str, float]) -> dict[str, float]:
        """All numbers of the model; `values` replace the chip's own.

        Raises:
            KeyError: a name is not a parameter.
            OutOfRange: a number is outside the ranges.
        """
        return numbers_in_ranges(self.ranges, self.values, values)


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
    relative_error: float = 1e-3,
    limit: int = LIMIT,
    seed: int = 0,
    progress: Progress = no_progress,
    accuracy: float | Discretisation = ACCURACY,
    drives: Sequence[Drive] = (),
) -> DesignModel:
    """Make a model of a chip's figures over `ranges`.

    See `workbench.reduced.ranges.range_model` for the other arguments.

    Args:
        drives: further drives at which figures will be evaluated.
        relative_error: of Z in driven states; that of the pressure is `workbench.design.bases.OF_PRESSURE` times
            as much.

    Raises:
        InputError: something in the chip, its materials, the ranges or the figures.
        NotCovered: `limit` full solves were not enough for the spectra.
        NotConfirmed: full solves found a larger error than `relative_error`.
    """
    check_figures(figures, chip.regions, source=chip.file, field="figures")
    made = range_model(
        chip, state, ranges, registry=registry, band=band, points=points, relative_error=SWEEP, limit=limit, seed=seed,
        progress=lambda text, share: progress(text, 0.5 * share), accuracy=accuracy)
    return of_range_model(
        made, chip, state, figures=figures, operation=operation, registry=registry, relative_error=relative_error,
        seed=seed, progress=lambda text, share: progress(text, 0.5 + 0.5 * share), drives=drives)


def of_range_model(
    made: RangeModel, chip: Chip, state: str | None, *, figures: Sequence[str], operation: Operation | None = None,
    registry: Registry | None = None, relative_error: float = 1e-3, seed: int = 0,
    progress: Progress = no_progress, drives: Sequence[Drive] = (),
) -> DesignModel:
    """Make a model of figures on an existing range model.

    The range model must be of the same chip and state. `seed` is that of the points where the bases are made and
    checked. `drives` are further drives at which figures will be evaluated.

    Raises:
        InputError: something in the chip, its materials or the figures.
        NotConfirmed: see :func:`design_model`.
    """
    wanted = check_figures(figures, chip.regions, source=chip.file, field="figures")
    device, problem = fill(chip, state, registry), made.problem
    operation = (operation or Operation()).of(device)
    cavity, reason = _cavity(device, made.reduced.full, tuple(made.ranges), made.frequency[-1], wanted)
    followed = responses(wanted, *(replace(operation, drive=each) for each in (operation.drive, *drives)))
    stated = operation.frequency if isinstance(operation.frequency, float) else None
    bases = bases_of(made, followed if device.is_wet else [Impedance()] * bool(followed), stated,
                     cavity, tolerance=relative_error, by_place=_by_place(wanted),
                     seed=seed, progress=progress)
    return DesignModel(chip, device.state.name, wanted, operation, made.ranges, problem.values, bases, cavity, reason,
                       made)


def load_design_model(
    path: Path, chip: Chip, state: str | None, ranges: Ranges, *, figures: Sequence[str],
    operation: Operation | None = None, registry: Registry | None = None,
    accuracy: float | Discretisation = ACCURACY,
) -> DesignModel:
    """Load a model that :meth:`DesignModel.save` saved.

    Chip, ranges and figures must be those that it was made for.

    Raises:
        InputError: the file is not such a model, or is for another chip, state, material or mesh.
    """
    wanted = check_figures(figures, chip.regions, source=chip.file, field="figures")
    content, arrays = read_arrays(path)
    if content.get("format") != FORMAT or "frequency" not in arrays:
        raise InputError(str(path), "format", content.get("format"), f"{FORMAT}; make the model again")
    band = float(arrays["frequency"][0]), float(arrays["frequency"][-1])
    device = fill(chip, state, registry)
    problem, ranges = with_ranges(build(device, band=band, accuracy=accuracy), chip, ranges)
    if fingerprint(problem) != content.get("problem"):
        raise InputError(str(path), "chip", f"{chip.name}, {device.state.name}", "the chip, state, materials and mesh "
                         "that the model was made for")
    operators = assemble(problem.mesh, problem.terms)
    cavity, reason = _cavity(device, operators, tuple(ranges), band[1], wanted)
    try:
        bases = stored_bases(arrays, problem, operators, ranges, by_place=_by_place(wanted))
    except (KeyError, ValueError) as error:
        raise InputError(str(path), "file", repr(error), "the arrays of a design model") from error
    return DesignModel(chip, device.state.name, wanted, (operation or Operation()).of(device), ranges, problem.values,
                       bases, cavity, reason, None)


def _by_place(figures: Sequence[str]) -> bool:
    """Whether a figure needs the losses by place."""
    return any(name == "heating" or name.startswith(LOSS_SHARE) for name in with_parts(figures))


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
    """The figures by full solves on the chip's own mesh.

    They confirm those of a reduced model. Lengths among `values` change the geometry, coefficients replace the chip's.
    A reduced model at these numbers alone, to :data:`TOLERANCE`, locates the resonance; the states at f0 and at the
    half-power frequencies are full ones.

    Raises:
        InputError: something in the chip, its materials, the values or the figures.
    """
    wanted = check_figures(figures, chip.regions, source=chip.file, field="figures")
    lengths = {n: v for n, v in values.items() if ParameterName.parse(n).is_dimension}
    others = {n: v for n, v in values.items() if n not in lengths}
    moved = chip.with_dimensions(all_of_one_length(chip, lengths))
    device = fill(moved, state, registry)
    problem = build(device, band=band, accuracy=accuracy)
    if gradient and lengths:
        parsed = [ParameterName.parse(n) for n in lengths]
        if moved.is_profiled:
            problem = parametrised_within(problem, moved, {n: about(moved, n) for n in lengths})
        else:
            problem = parametrised(problem, moved, [str(n) for n in parsed if n.is_radius],
                               {str(n): about(moved, str(n)) for n in parsed if n.is_shape})
    unknown = sorted(n for n in others if ParameterName.parse(n).key not in problem.values)
    if unknown:
        raise InputError(chip.file, "values", unknown[0], "a length or a coefficient of the chip's materials",
                         nearest_names(unknown[0], problem.values))
    return _evaluated(device, replace(problem, values=placed(problem.values, others)), values, wanted,
                      (operation or Operation()).of(device), registry, points, gradient)


def all_of_one_length(chip: Chip, lengths: Mapping[str, float]) -> dict[str, float]:
    """`lengths` (m) by all names, for radii that coincide.

    Radii that coincide are one parameter.
    """
    return {other: value for name, value in lengths.items() for other in moving_together(chip, name)}


def _cavity(
    device: FilledChip, operators: FullOperators, names: Sequence[str], highest: float, figures: Sequence[str],
) -> tuple[Cavity | None, str]:
    """The cavity and its particle, or the reason why there is none.

    It is made only if a figure needs it.
    """
    fluid = device.materials.get(CAVITY)
    if not set(with_parts(figures)) & set(OF_FIELD):
        return None, ""
    if not isinstance(fluid, Fluid):
        return None, f"there is no fluid in the cavity in state {device.state.name!r}"
    lengths = [n for n in names if ParameterName.parse(n).is_dimension]
    try:
        found = cavity_of(operators, device.chip, fluid, device.particle, lengths, highest)
    except NoCavity as error:
        return None, str(error)
    return found, ""


def _evaluated(
    device: FilledChip, problem: Problem, numbers: Mapping[str, float], figures: tuple[str, ...],
    operation: Operation, registry: Registry | None, points: int, gradient: bool,
) -> Evaluation:
    operators = assemble(problem.mesh, problem.terms)
    frequency = np.linspace(*problem.band, points)
    small, sweep = reduced(operators, frequency, problem.values, tolerance=TOLERANCE, confirmed=False,
                           skip_singular=True)
    first = canonical_names(device.chip)
    names = tuple(first.get(name, name) for name in numbers) if gradient else ()
    cavity, reason = _cavity(device, operators, names, frequency[-1], figures)

    def pressure(states: Complex) -> Complex:
        assert cavity is not None
        return np.asarray(np.append(states, np.zeros((1, states.shape[1])), axis=0)[cavity.rows])

    question = Question(figures, names, problem.values, operation, cavity, reason, pressure)
    try:
        with one_thread():
            whole = sound_energy(operators)
            model = Responding(ReducedSystem(small.operators, problem.values), problem.values,
                               None if whole is None else whole.on(small.basis))
            found = answer(question, model, lambda: (model, sweep),
                           Responding(FullSystem(operators, problem.values), problem.values, whole))
    except NotConverged as error:  # an undamped resonance: this chip has no figures, others have
        found = FigureValues(question, {}, dict.fromkeys(figures, str(error)), error.frequency, None)
    return found.evaluation(numbers, None)
