"""A study divided into parts that each need one model.

A part has one state of the chip and one choice of materials.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from workbench.design.axes import centred_in_ranges, with_materials
from workbench.design.evaluation import Evaluation
from workbench.design.model import SWEEP, DesignModel, Evaluator, full_evaluation, load_design_model, of_range_model
from workbench.design.plan import Study
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress
from workbench.model.numbers import real_part as part_of
from workbench.model.problem import fill
from workbench.reduced.ranges import RangeModel, Ranges, load_range_model, range_model

Real = NDArray[np.float64]
Indices = NDArray[np.int64]
M = TypeVar("M", RangeModel, DesignModel)

#: Frequencies of the band in which resonances are first looked for.
FREQUENCIES = 161

#: Suffix of the range model beside the file of a model.
SPECTRA = ".spectra.npz"


@dataclass(frozen=True, eq=False)
class StudyPart:
    """Points of a study that share one model.

    ``number`` counts the parts and ``label`` names this one. The model is of ``chip`` in ``state``, with the
    ``materials`` chosen by region. ``rows`` (k,) of the study's table have the numbers ``points`` (k, numbers of the
    study).
    """

    number: int
    label: str
    chip: Chip
    state: str
    materials: Mapping[str, str]
    rows: Indices
    points: Real


class Models(Protocol):
    """The source of the models of a study.

    :meth:`confirmed` may be called in another process.
    """

    def model(self, study: Study, part: StudyPart, path: Path, progress: Progress) -> Evaluator:
        """The model of a part, which can be pickled.

        It is the one in the file `path`, which is made first if missing. Its stages may be saved in files beside it
        with similar names.
        """

    def confirmed(self, study: Study, part: StudyPart, point: Real) -> Evaluation:
        """The figures at one point (numbers of the study,), by full solves."""


def parts_of(study: Study) -> list[StudyPart]:
    """The parts of a study, states first.

    Together they have every row of the table once.
    """
    found: list[StudyPart] = []
    numbers, choices = study.columns(study.numbers), study.columns(study.choices).astype(np.int64)
    base = centred_in_ranges(study.chip, study.numbers)
    for index, state in enumerate(study.states):
        for chosen in np.unique(choices, axis=0):
            there = np.flatnonzero((choices == chosen).all(axis=1))
            materials = {axis.region: axis.materials[k] for axis, k in zip(study.choices, chosen, strict=True)}
            found.append(StudyPart(
                len(found), ", ".join((state, *materials.values())), with_materials(base, materials, study.registry),
                state, materials, index * len(study.sample) + there, numbers[there]))
    return found


def ranges_of(study: Study, part: StudyPart) -> Ranges:
    """The ranges of a part's model.

    They include the numbers that its chip and materials have themselves.
    """
    held = fill(part.chip, part.state, study.registry).materials.values()
    present = {f"{m.name}.{key}": value for m in held for key, value in m.parameters().items()}
    present |= {name: complex(each.value) for name, each in part.chip.dimensions().items()}
    found = {}
    for axis in study.numbers:
        own = part_of(present, axis.name)
        found[axis.name] = min(axis.low, own), max(axis.high, own)
    return found


@dataclass(frozen=True)
class ReducedModels:
    """Design models saved on disk, and full solves that confirm them.

    The range models that they are made from are saved too. Full solves are on the chip's own mesh. A model is always
    read back from the disk, even right after it was made, since another memory layout of the arrays gives other last
    bits.
    """

    def model(self, study: Study, part: StudyPart, path: Path, progress: Progress) -> Evaluator:
        """The model of a part.

        Raises:
            NotCovered: the spectra need more full solves than the study allows.
            NotConfirmed: full solves found a larger error than the study's tolerance.
        """
        chip, state, ranges, registry = part.chip, part.state, ranges_of(study, part), study.registry

        def spectra() -> RangeModel:
            return range_model(chip, state, ranges, registry=registry, band=study.band, points=FREQUENCIES,
                               relative_error=SWEEP, limit=study.limit, accuracy=study.accuracy,
                               progress=lambda text, share: progress(text, 0.5 * share))

        def made() -> DesignModel:
            rough = _kept(path.with_suffix(SPECTRA), spectra, lambda there: load_range_model(
                there, chip, state, registry=registry, accuracy=study.accuracy))
            return of_range_model(rough, chip, state, figures=study.figures, operation=study.operation,
                                  registry=registry, relative_error=study.relative_error,
                                  progress=lambda text, share: progress(text, 0.5 + 0.5 * share))

        found = _kept(path, made, lambda there: load_design_model(
            there, chip, state, ranges, figures=study.figures, operation=study.operation, registry=registry,
            accuracy=study.accuracy))
        progress("model", 1.0)
        return found

    def confirmed(self, study: Study, part: StudyPart, point: Real) -> Evaluation:
        """The figures at one point of a part, by full solves."""
        return full_evaluation(
            part.chip, part.state, numbers_by_name(study, point), figures=study.figures, operation=study.operation,
            registry=study.registry, band=study.band, accuracy=study.accuracy)


def _kept(path: Path, make: Callable[[], M], read: Callable[[Path], M]) -> M:
    """The model in a file.

    It is made if the file is missing, and again, with a warning, if the file is damaged.
    """
    if path.exists():
        try:
            return read(path)
        except InputError as error:
            if error.source != str(path):
                raise
            warnings.warn(f"{path} cannot be used ({error.field}: {error.value}): it is made again", stacklevel=2)
    make().save(path)
    return read(path)


def numbers_by_name(study: Study, point: Sequence[float] | Real) -> dict[str, float]:
    """A point (numbers of the study,) as numbers by parameter name."""
    return {axis.name: float(value) for axis, value in zip(study.numbers, point, strict=True)}
