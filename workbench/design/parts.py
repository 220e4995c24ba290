"""A study divided into parts, each of which one model serves: one state of the chip and one choice of materials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from workbench.design.axes import centred, with_materials
from workbench.design.evaluation import Evaluation
from workbench.design.model import DesignModel, Evaluator, design_model, full_evaluation, of_range_model
from workbench.design.plan import Study
from workbench.parameter_names import part as part_of
from workbench.problem import fill
from workbench.ranges import Progress, Ranges, load

Real = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Part:
    """Points of a study that one model serves.

    ``number`` counts the parts, ``label`` tells them apart in words; ``chip`` in ``state`` is what is modelled, with
    the ``materials`` chosen by region; ``rows`` (k,) of the study's table have the numbers ``points``
    (k, numbers of the study).
    """

    number: int
    label: str
    chip: Chip
    state: str
    materials: Mapping[str, str]
    rows: Indices
    points: Real


class Divisible(Protocol):
    """A model of a part, that gives faster models for points that lie together (`workbench.design.model`)."""

    def divided(self, points: Real) -> list[Indices]: ...
    def local(self, points: Real) -> Evaluator: ...


class Models(Protocol):
    """Where the models of a study come from. What is done by :meth:`confirmed` may be done in another process."""

    def model(self, study: Study, part: Part, path: Path, progress: Progress) -> Divisible:
        """The model of a part: the one kept at `path` if there is one, which it is otherwise once this returns."""

    def confirmed(self, study: Study, part: Part, point: Real) -> Evaluation:
        """The figures at one point (numbers of the study,) of a part, by full solves."""


def parts_of(study: Study) -> list[Part]:
    """The parts of a study, states first; their rows together are all rows of the table, each once."""
    found: list[Part] = []
    numbers, choices = study.columns(study.numbers), study.columns(study.choices).astype(np.int64)
    base = centred(study.chip, study.numbers)
    for index, state in enumerate(study.states):
        for chosen in np.unique(choices, axis=0):
            there = np.flatnonzero((choices == chosen).all(axis=1))
            materials = {axis.region: axis.materials[k] for axis, k in zip(study.choices, chosen, strict=True)}
            found.append(Part(
                len(found), ", ".join((state, *materials.values())), with_materials(base, materials, study.registry),
                state, materials, index * len(study.sample) + there, numbers[there]))
    return found


def ranges_of(study: Study, part: Part) -> Ranges:
    """The ranges of the model of a part, wide enough for the numbers that its chip and materials have themselves."""
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
    """Range models, kept on disk; confirmed by full solves on a mesh of the chip's own."""

    def model(self, study: Study, part: Part, path: Path, progress: Progress) -> DesignModel:
        """The model of a part.

        Raises:
            NotCovered: more full solves are needed than the study allows.
            InputError: what is kept at `path` is of something else.
        """
        if path.exists():
            kept = load(path, part.chip, part.state, registry=study.registry, accuracy=study.accuracy)
            progress(1.0)
            return of_range_model(kept, part.chip, part.state, figures=study.figures, operation=study.operation,
                                  registry=study.registry)
        made = design_model(
            part.chip, part.state, ranges_of(study, part), figures=study.figures, operation=study.operation,
            registry=study.registry, band=study.band, tolerance=study.tolerance, limit=study.limit,
            accuracy=study.accuracy, progress=progress)
        assert made.range_model is not None  # this process made it
        made.range_model.save(path)
        return made

    def confirmed(self, study: Study, part: Part, point: Real) -> Evaluation:
        """The figures at one point of a part, by full solves."""
        return full_evaluation(
            part.chip, part.state, named(study, point), figures=study.figures, operation=study.operation,
            registry=study.registry, band=study.band, accuracy=study.accuracy)


def named(study: Study, point: Sequence[float] | Real) -> dict[str, float]:
    """A point (numbers of the study,) as numbers by parameter name."""
    return {axis.name: float(value) for axis, value in zip(study.numbers, point, strict=True)}
