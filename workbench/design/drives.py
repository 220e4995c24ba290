"""The figures of one chip at several drives.

Requirements may state different drives. A chip is linear, but the voltage at its electrodes from a generator or a
constant power depends on its impedance. So each drive is an operation of its own on the same reduced model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation, Operation
from workbench.design.figures import LOSS_SHARE, Figure, figure_named
from workbench.design.model import DesignModel
from workbench.design.requirement import Requirement
from workbench.model.drive import Drive, VoltageDrive

Real = NDArray[np.float64]

#: Figures that are the same at every drive, and those that are the same at every voltage. The latter depend on the peak
#: of the energy, which moves under a constant power or behind a generator.
UNDRIVEN = ("f0", "z_min", "q")
OF_VOLTAGE = ("trap_height", "trap_offset", "trap_radius", "peak_frequency", "peak_q")


@dataclass(frozen=True)
class DrivenFigure:
    """A figure at a drive.

    ``label`` is the figure's name, with the drive if there are several.
    """

    label: str
    figure: Figure
    drive: Drive


def driven_figures(names: Sequence[str], requirements: Sequence[Requirement], drive: Drive) -> tuple[DrivenFigure, ...]:
    """The figures `names` at the `drive`, and those of `requirements` at theirs.

    Each is listed once.
    """
    asked = [(figure_named(name), drive) for name in names]
    asked += [(each.figure, each.drive or drive) for each in requirements]
    found: dict[tuple[str, str], DrivenFigure] = {}
    for each, at in asked:
        alike = each.name in OF_VOLTAGE or each.name.startswith(LOSS_SHARE)
        undriven = each.name in UNDRIVEN or (alike and all(isinstance(one, VoltageDrive) for one in (drive, at)))
        key = each.name, "" if undriven or str(at) == str(drive) else str(at)
        found.setdefault(key, DrivenFigure(each.name if not key[1] else f"{each.name} at {at}", each,
                                           drive if undriven else at))
    return tuple(found.values())


def label_of(requirement: Requirement, known: Sequence[DrivenFigure], drive: Drive) -> str:
    """The label among the `known` figures that a requirement applies to."""
    at = requirement.drive or drive
    mine = [each for each in known if each.figure == requirement.figure]
    return next((each.label for each in mine if str(each.drive) == str(at)), mine[0].label)


@dataclass(frozen=True, eq=False)
class Driven:
    """Evaluates figures at several drives on one reduced ``model``.

    It is a `workbench.design.model.Evaluator` whose figures are the labels of ``requested``. ``operation`` has the
    frequency and thermal resistances of all drives.
    """

    model: DesignModel
    requested: tuple[DrivenFigure, ...]
    operation: Operation = field(default_factory=Operation)

    @property
    def names(self) -> tuple[str, ...]:
        return self.model.names

    @property
    def figures(self) -> tuple[str, ...]:
        return tuple(each.label for each in self.requested)

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        return at_drives(self.requested, self.operation, lambda figures, operation: replace(
            self.model, figures=figures, operation=operation)(values, gradient=gradient))


def at_drives(
    requested: Sequence[DrivenFigure], operation: Operation,
    evaluate: Callable[[tuple[str, ...], Operation], Evaluation],
) -> Evaluation:
    """The figures of one chip by label.

    `evaluate` gives the named figures at an operation. It is called once for each drive.
    """
    drives = {str(each.drive): each.drive for each in requested}
    parts = [([each for each in requested if str(each.drive) == words], drive) for words, drive in drives.items()]
    found: list[tuple[DrivenFigure, Evaluation]] = []
    for mine, drive in parts:
        evaluation = evaluate(tuple(each.figure.name for each in mine), replace(operation, drive=drive))
        found += [(each, evaluation) for each in mine]
    named = [(each.label, each.figure.name, evaluation) for each, evaluation in found]
    return replace(
        found[0][1], figures={label: one.figures[name] for label, name, one in named},
        missing={label: one.missing[name] for label, name, one in named if name in one.missing},
        gradient={label: one.gradient[name] for label, name, one in named if one.gradient is not None} or None)
