"""Points of a study: all combinations on a grid, the rows of a list, or a sample spread over the ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.design.variables import Variable, VariedNumber
from workbench.files.errors import InputError
from workbench.files.tables import FileTable

Real = NDArray[np.float64]

GRID, LIST, SOBOL, LATIN_HYPERCUBE = "grid", "list", "sobol", "latin hypercube"
METHODS = (GRID, LIST, SOBOL, LATIN_HYPERCUBE)

#: Most points of a study: a million take a day on two cores.
MOST = 1_000_000


@dataclass(frozen=True)
class Sampling:
    """``method`` is one of :data:`METHODS`; ``points`` and ``seed`` those of a Sobol sequence or a Latin hypercube."""

    method: str = GRID
    points: int = 0
    seed: int = 0


def read_sampling(table: FileTable) -> Sampling:
    """The sampling that the table [sample] states; a grid where there is none.

    Raises:
        InputError: an unknown method, or points of a grid or a list.
    """
    table.only(("method", "points", "seed"))
    method = table.choice("method", METHODS, GRID)
    seed = table.whole("seed", 0, low=0, high=2**32 - 1)
    if method in (GRID, LIST):
        if "points" in table:
            raise table.error("points", f"none: [vary] says how many points a {method} has")
        return Sampling(method, 0, seed)
    table.required("points", f"how many points a sample by {method!r} has")
    return Sampling(method, table.whole("points", low=1, high=MOST), seed)


def sample_points(axes: Sequence[Variable], sampling: Sampling, *, source: str) -> Real:
    """The points (n, len(axes)): numbers in SI, materials by their place in the list of alternatives.

    On a grid the last axis changes fastest. The first points of a Sobol sequence are the same however many there are.

    Raises:
        InputError: columns of a list that are not equally long, or more than :data:`MOST` points.
    """
    if sampling.method == GRID:
        levels = [axis.levels() for axis in axes]
        count = math.prod(map(len, levels))
        if count > MOST:
            raise InputError(source, "vary", f"{count} points", f"a grid of at most {MOST} points, or a sample: "
                             '[sample] with method = "sobol" and points')
        return np.stack([each.ravel() for each in np.meshgrid(*levels, indexing="ij")], axis=1)
    if sampling.method == LIST:
        levels = [axis.levels() for axis in axes]
        for axis, each in zip(axes, levels, strict=True):
            if len(each) != len(levels[0]):
                what = "values" if isinstance(axis, VariedNumber) else "materials"
                raise InputError(source, f"vary.{axis.name}.{what}", f"{len(each)} of them",
                                 f"{len(levels[0])}, as many as {axes[0].name} has: a list is taken row by row")
        return np.stack(levels, axis=1)
    shares = _shares(len(axes), sampling)
    return np.stack([axis.at(column) for axis, column in zip(axes, shares.T, strict=True)], axis=1)


def _shares(count: int, sampling: Sampling) -> Real:
    """Points (n, count) spread over the unit cube."""
    from scipy.stats import qmc

    if sampling.method == LATIN_HYPERCUBE:
        return np.asarray(qmc.LatinHypercube(count, seed=sampling.seed).random(sampling.points))
    # A whole number of powers of two keeps its balance; what is left of it is the beginning of the same sequence.
    power = math.ceil(math.log2(sampling.points))
    return np.asarray(qmc.Sobol(count, seed=sampling.seed).random_base2(power)[: sampling.points])
