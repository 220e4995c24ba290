"""Models of a study that are closed formulas: for tests of all that is around the real ones, also in other processes."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.parts import Part
from workbench.design.plan import Study
from workbench.files.writing import write_atomic
from workbench.ranges import Progress

Real = NDArray[np.float64]


@dataclass(frozen=True)
class FormulaModel:
    """Every figure is ``offset`` and the sine of the numbers (in their own size); a local model is ``shifted`` by
    1e-6 of the mean of its points, so that it matters which points share one.

    ``pause`` (s) is what a point takes; where the first number is above ``without``, the second figure is missing.
    """

    names: tuple[str, ...]
    figures: tuple[str, ...]
    sizes: tuple[float, ...]
    offset: float
    pause: float = 0.0
    without: float = math.inf
    shifted: float = 0.0

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        time.sleep(self.pause)
        x = np.array([values[name] for name in self.names]) / np.array(self.sizes)
        found = {name: self.offset + k + float(np.sin((k + 1) * x).sum()) + self.shifted
                 for k, name in enumerate(self.figures)}
        missing = {}
        if values[self.names[0]] > self.without and len(self.figures) > 1:
            found[self.figures[1]], missing = math.nan, {self.figures[1]: "beyond the formula"}
        return Evaluation(dict(values), found, missing, 1e6 + self.offset, 1e-5)

    def divided(self, points: Real) -> list[NDArray[np.int64]]:
        """Groups of 40 by the first number."""
        order = np.argsort(points[:, 0], kind="stable")
        return [np.sort(order[at:at + 40]) for at in range(0, len(points), 40)]

    def local(self, points: Real) -> FormulaModel:
        mean = float((points / np.array(self.sizes)).mean())
        return FormulaModel(self.names, self.figures, self.sizes, self.offset, self.pause, self.without, 1e-6 * mean)


@dataclass(frozen=True)
class FormulaModels:
    """Where they come from; ``made`` is a folder in which every model that is made leaves a file."""

    pause: float = 0.0
    without: float = math.inf
    made: str = ""

    def model(self, study: Study, part: Part, path: Path, progress: Progress) -> FormulaModel:
        if not path.exists():
            write_atomic(path, b"a formula needs nothing")
            if self.made:
                (Path(self.made) / f"{part.number}-{time.time_ns()}").touch()
        progress(1.0)
        return self._formula(study, part)

    def confirmed(self, study: Study, part: Part, point: Real) -> Evaluation:
        return self._formula(study, part)(dict(zip([a.name for a in study.numbers], map(float, point), strict=True)))

    def _formula(self, study: Study, part: Part) -> FormulaModel:
        return FormulaModel(tuple(axis.name for axis in study.numbers), study.figures,
                            tuple(abs(axis.high) for axis in study.numbers), float(part.number), self.pause,
                            self.without)
