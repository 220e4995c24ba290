"""The figures of one chip in one state, anywhere within ranges of its lengths, moduli and losses.

    model = design_model(read_chip("chip.toml"), "filled", {"substrate.thickness": (0.8e-3, 0.9e-3)},
                         figures=("f0", "e_ac", "trap_offset"))
    found = model({"substrate.thickness": 0.83e-3}, gradient=True)
    found.figures["e_ac"], found.gradient["e_ac"]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.registry import Registry
from workbench.discretisation import ACCURACY, Discretisation
from workbench.drive import Drive, VoltageDrive
from workbench.ranges import LIMIT, Progress, RangeModel, Ranges, Response

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Operation:
    """How a chip is operated: its ``drive``; ``frequency`` (Hz) it is driven at, None where the drive follows f0;
    ``thermal_resistance`` (K/W) of regions for :attr:`heating`, the key "" standing for all regions not named."""

    drive: Drive = field(default_factory=VoltageDrive)
    frequency: float | None = None
    thermal_resistance: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Figures of one chip.

    ``values`` the numbers it was asked for (SI, by parameter name); ``figures`` SI, by name, NaN where there is none
    and ``missing`` says why, by the figure's name; ``gradient`` by figure, (len(values),) in the order of ``values``,
    None where not asked for; ``frequency`` (Hz) it is driven at; ``error`` estimated relative error of Z there.
    """

    values: Mapping[str, float]
    figures: Mapping[str, float]
    missing: Mapping[str, str]
    frequency: float
    error: float
    gradient: Mapping[str, Real] | None = None


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
    """An :class:`Evaluator` on a range model, which can be pickled for other processes."""

    chip: Chip
    state: str
    figures: tuple[str, ...]
    operation: Operation
    range_model: RangeModel

    @property
    def names(self) -> tuple[str, ...]:
        return self.range_model.names

    @property
    def ranges(self) -> Ranges:
        """Lowest and highest number (SI) of every parameter."""
        return self.range_model.ranges

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        raise NotImplementedError

    def spectrum(self, values: Mapping[str, float]) -> Response:
        """The impedance at these numbers, see `workbench.ranges.RangeModel`."""
        return self.range_model(values)

    def localised(self, points: Real) -> list[tuple[NDArray[np.int64], DesignModel]]:
        """Smaller, faster models for `points` (n, len(names)): the indices that each is for, and the model.

        Points are divided until the basis that serves them is small; each model was checked against this one.
        """
        raise NotImplementedError


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
    raise NotImplementedError


def full_evaluation(
    chip: Chip,
    state: str | None,
    values: Mapping[str, float],
    *,
    figures: Sequence[str],
    operation: Operation | None = None,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    gradient: bool = False,
    accuracy: float | Discretisation = ACCURACY,
) -> Evaluation:
    """The same figures by full solves on a mesh of the chip's own: lengths among `values` are built in, coefficients
    replaced. What a reduced model says is confirmed by this.

    Raises:
        InputError: something in the chip, its materials, the values or the figures.
        NotConverged: a full solve.
    """
    raise NotImplementedError
