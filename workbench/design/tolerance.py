"""Yield of a chip under tolerances, and the tolerances to tighten.

    found = tolerance(read_chip("chip.toml"), "filled", ["f0 within 5 kHz", "e_ac >= 20 J/m^3 at 10 Vpp"])
    found.yields.together.sampled, found.yields.tightenings[0]

The yield is the share of chips that meets the requirements. Nominal figures and sensitivities are those of full solves.
Samples are evaluated on a model of the chip's figures over all uncertain numbers (`workbench.design.model`). Together
this takes a minute or two.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.operating_point import AT_ENERGY
from materials.registry import Registry
from workbench.design.drives import Driven, DrivenFigure, at_drives, driven_figures, label_of
from workbench.design.evaluation import Evaluation, Operation
from workbench.design.figures import check_figures
from workbench.design.input_uncertainty import Statement, centred_chip, numbers_of, stated_uncertainty
from workbench.design.model import design_model, full_evaluation
from workbench.design.outcomes import PARCEL, Outcomes, evaluate
from workbench.design.requirement import Requirement, parse_requirements
from workbench.design.sensitivity import (
    Sensitivities,
    SobolIndices,
    check_sobol,
    names_to_ask,
    sensitivities,
    sobol,
)
from workbench.design.uncertainty import Uncertainty
from workbench.design.yields import LinearModel, RequiredRange, Yields, bound, yields
from workbench.files.errors import InputError, expect
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import begin_workers, check_jobs
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.drive import Drive, VoltageDrive
from workbench.model.problem import fill
from workbench.results.notebook import Shown, Summary

Real = NDArray[np.float64]

#: Default number of samples: the interval of a yield is then at most 2.2 % to either side.
SAMPLES = 2000

#: Figures that are always evaluated.
ALWAYS = ("f0", "z_min", "q")


@dataclass(frozen=True)
class ModelFacts:
    """Facts about the model that samples were evaluated on.

    ``rank`` is the number of unknowns and ``error`` the largest relative error of Z that full solves found. ``seconds``
    is the time to make it. ``off`` is the relative difference of each figure from that of full solves at the mean
    numbers, by label.
    """

    rank: int
    error: float
    seconds: float
    off: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Tolerance(Shown):
    """The figures of a chip in a ``state`` under its uncertainty.

    ``requested`` are the figures with their drives; ``frequency`` (Hz) is the driving frequency, or the word of
    `geometry.operating_point.OPERATING_POINTS` for the resonance that the drive follows. ``sensitivities`` are those at
    the mean numbers. ``outcomes`` are the samples with their figures, ``redrawn`` counts the draws that were not
    admissible, ``yields`` are those of the requirements (None without any), ``sobol`` the indices if they were
    requested. ``seconds`` is the total time.
    """

    chip: Chip
    state: str
    uncertainty: Uncertainty
    requested: tuple[DrivenFigure, ...]
    drive: Drive
    frequency: float | str
    sensitivities: Sensitivities
    bounds: tuple[RequiredRange, ...]
    seed: int
    outcomes: Outcomes | None = None
    redrawn: int = 0
    yields: Yields | None = None
    sobol: SobolIndices | None = None
    model: ModelFacts | None = None
    seconds: float = 0.0

    @property
    def findings(self) -> tuple[str, ...]:
        """Further findings, in words."""
        found = [*self.uncertainty.notes]
        found += [f"the chip as stated has no {each.label}: {self.sensitivities.missing[each.label]}"
                  for each in self.requested if each.label in self.sensitivities.missing]
        found += [f"the chip as stated does not meet {each.requirement.text!r} itself" for each in self.bounds
                  if not each.low <= each.nominal <= each.high]
        if self.outcomes is not None:
            if self.redrawn:
                count = len(self.outcomes.points)
                found.append(f"{self.redrawn} of {count + self.redrawn} draws lay beyond three standard deviations or "
                             "where the chip or its materials cannot be, and were drawn again")
            for label, reasons in self.outcomes.missing.items():
                count = sum(reasons.values())
                found.append(f"{count} of {len(self.outcomes.points)} samples have no {label} and fail its "
                             f"requirements: {'; '.join(sorted(reasons))}")
        if self.yields is not None:
            found.append(_first_to_tighten(self.yields))
        return tuple(found)

    def summary(self) -> Summary:
        """Yields and the first tolerance to tighten, for a notebook."""
        rows: list[tuple[str, ...]] = [(label, f"{self.sensitivities.figures[label]:.6g}")
                                       for label in self.sensitivities.figures]
        if self.yields is not None:
            rows += [(each.name, str(each.sampled)) for each in (*self.yields.each, self.yields.together)]
            rows.append(("tighten first", _first_to_tighten(self.yields)))
        return Summary(f"Tolerance of {self.chip.name}, {self.state}", tuple(rows))


def _first_to_tighten(found: Yields) -> str:
    if found.together.sampled.passed == found.together.sampled.samples:
        return "every sample passed: no tolerance needs to be tightened"
    best = found.tightenings[0]
    if not best.is_clear:
        return "no single uncertainty, halved, adds to the yield more than twice the standard error of that"
    return (f"half the uncertainty of {best.name} would add {100.0 * best.gain:.1f} % "
            f"(standard error {100.0 * best.error:.1f} %) to the yield")


def tolerance(
    chip: Chip,
    state: str | None = None,
    requirements: Sequence[Requirement | str] = (),
    *,
    uncertainty: Uncertainty | Sequence[Statement | str] = (),
    figures: Sequence[str] = (),
    drive: Drive | None = None,
    thermal_resistance: Mapping[str, float] | None = None,
    at: float | str | None = None,
    tracking: bool = True,
    samples: int = SAMPLES,
    sobol_points: int = 0,
    every: bool = False,
    seed: int = 0,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    accuracy: float | Discretisation = ACCURACY,
    relative_error: float = 1e-3,
    jobs: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Tolerance:
    """Sensitivities, and with `requirements` the yield, of an uncertain chip.

    Args:
        requirements: sentences as of `workbench.design.requirement`.
        uncertainty: all of it, or statements beyond chip file and registry (`workbench.design.input_uncertainty`).
        figures: further figures to evaluate.
        drive: of figures for which a requirement states none, 10 Vpp by default.
        thermal_resistance: K/W by region, for heating; "" for all regions not named.
        at: the frequency (Hz) of the drive, or the word of `geometry.operating_point.OPERATING_POINTS` for the
            resonance that it follows; by default that of the chip, or else the largest peak of the energy.
        tracking: whether the drive follows the resonance of each sample, as a bench does, or stays at that of the chip
            as stated.
        samples: of the yield.
        sobol_points: a power of two, for Sobol indices by so many evaluations times the inputs plus two; 0 for none.
        every: give sensitivities to all numbers, also those without a stated uncertainty (for 1 % of them).
        seed: of all samples.
        relative_error: of the impedance of the model that samples are evaluated on.
        jobs: processes that evaluate the samples; this one if one.
        executor: evaluates the samples in place of such processes, `jobs` tasks at a time.

    Raises:
        InputError: a requirement or an uncertainty that cannot be used, nothing uncertain, or a chip without a figure
            that is required.
        NotCovered: no model over the uncertain numbers was possible.
    """
    expect(chip, Chip, reader="read_chip", source="tolerance", field="chip")
    started = time.perf_counter()
    check_jobs(jobs, source="tolerance", elsewhere=executor is not None)
    say = progress or no_progress
    device = fill(chip, state, registry)
    known = uncertainty if isinstance(uncertainty, Uncertainty) else stated_uncertainty(
        chip, state, registry=registry, statements=uncertainty)
    required = _required(requirements, chip)
    extra = check_figures(figures, chip.regions, source=chip.file, field="figures")
    drive = drive or VoltageDrive()
    asked = driven_figures(tuple(dict.fromkeys((*ALWAYS, *extra))), required, drive)
    check_tolerance_request(known, required, samples, sobol_points, chip, source="tolerance")
    say("full solves", 0.0)
    # The numbers of a fit may lie far from those of chip file and registry: one model of both is needlessly large.
    there, with_means = centred_chip(chip, registry, known.nominal())
    operation = Operation(drive, at, thermal_resistance or {}).of(device)
    solved = partial(full_evaluation, there, device.state.name, registry=with_means, band=band, accuracy=accuracy)
    if not tracking and operation.follows is not None:
        figure = "peak_frequency" if operation.frequency == AT_ENERGY else "f0"
        operation = replace(operation, frequency=_resonance(figure, solved(
            known.nominal(), figures=(figure,), operation=operation), chip))
    own = numbers_of(device)
    numbers = {**{name: own[name] for name in names_to_ask(known, list(own), every=every)}, **known.nominal()}
    nominal = at_drives(asked, operation, lambda names, driven: solved(
        numbers, figures=names, operation=driven, gradient=True))
    bounds = tuple(_bound(each, asked, drive, nominal, chip) for each in required)
    assert operation.frequency is not None
    found = Tolerance(chip, device.state.name, known, asked, drive, operation.frequency,
                      sensitivities(nominal, known), bounds, seed)
    if known.inputs and (bounds or sobol_points):
        making = time.perf_counter()
        made = design_model(
            there, device.state.name, known.ranges(numbers_of(fill(there, state, with_means))),
            figures=tuple(dict.fromkeys(each.figure.name for each in asked)), operation=operation, registry=with_means,
            band=band, relative_error=relative_error, accuracy=accuracy, seed=seed,
            progress=lambda _text, share: say("range model", share), drives=[each.drive for each in asked])
        found = _sampled(found, Driven(made, asked, operation), time.perf_counter() - making,
                         samples if bounds else 0, sobol_points, jobs, executor, say)
    return replace(found, seconds=time.perf_counter() - started)


def _required(requirements: Sequence[Requirement | str], chip: Chip) -> tuple[Requirement, ...]:
    texts = [each for each in requirements if isinstance(each, str)]
    parsed = iter(parse_requirements(texts, chip.regions, source="requirements", field="requirement"))
    return tuple(next(parsed) if isinstance(each, str) else each for each in requirements)


def check_tolerance_request(
    known: Uncertainty, required: Sequence[Requirement], samples: int, sobol_points: int, chip: Chip, *,
    source: str = "command line", names: tuple[str, str] = ("samples", "sobol_points"),
) -> None:
    """Check a request to :func:`tolerance` before anything is solved.

    `names` are those of the two counts.

    Raises:
        InputError: nothing uncertain, no sample, or Sobol indices that are not defined.
    """
    if samples < 1:
        raise InputError(source, names[0], samples, "one sample at least")
    if required and not known.inputs:
        raise InputError(chip.file, "uncertainty", None, 'something uncertain: a tolerance in the chip file, an '
                         'uncertainty in the registry, or a word such as "substrate.thickness = 20 um"')
    if sobol_points:
        check_sobol(known, sobol_points, source=source, field=names[1])


def _resonance(figure: str, found: Evaluation, chip: Chip) -> float:
    """The frequency (Hz) of the resonance that the drive follows.

    It is a `figure` of an evaluation.

    Raises:
        InputError: there is none.
    """
    if not math.isfinite(found.figures[figure]):
        raise InputError(chip.file, figure, found.missing.get(figure, "none"), "a chip that resonates in the band, so "
                         "that it can be driven there")
    return found.figures[figure]


def _bound(each: Requirement, requested: Sequence[DrivenFigure], drive: Drive, nominal: Evaluation,
           chip: Chip) -> RequiredRange:
    label = label_of(each, requested, drive)
    if label in nominal.missing or not math.isfinite(nominal.figures[label]):
        raise InputError(chip.file, f'requirement "{each.text}"', nominal.missing.get(label, "no such figure"),
                         f"a chip that as stated has the figure {each.figure.name}")
    return bound(each, label, nominal.figures[label])


def _sampled(
    found: Tolerance, model: Driven, seconds: float, samples: int, sobol_points: int, jobs: int,
    executor: Executor | None, say: Progress,
) -> Tolerance:
    """`found` with samples, yields, and Sobol indices if requested.

    The `model` was made in `seconds`.
    """
    known, nominal = found.uncertainty, found.sensitivities.figures
    there = model(known.nominal()).figures
    off = {label: there[label] / value - 1.0 for label, value in nominal.items() if value}
    found = replace(found, model=ModelFacts(model.model.bases.operating.size, model.model.error, seconds, off))
    parcels = math.ceil(max(samples, sobol_points * (2 + len(known.inputs))) / PARCEL)
    with begin_workers(min(jobs, parcels), executor) as workers:
        if samples:
            drawn = known.draw(samples, found.seed)
            outcomes = evaluate(model, known, drawn.points, workers=workers, progress=say)
            at = [found.sensitivities.names.index(name) for name in known.names]
            linear = LinearModel(known.means, nominal,
                                 {label: slopes[at] for label, slopes in found.sensitivities.gradient.items()})
            found = replace(found, outcomes=outcomes, redrawn=drawn.redrawn, yields=yields(
                found.bounds, known, drawn.points, {label: outcomes.column(label) for label in outcomes.figures},
                linear, seed=found.seed))
        if sobol_points:
            found = replace(found, sobol=sobol(model, known, sobol_points, seed=found.seed, workers=workers,
                                               progress=say))
    return found
