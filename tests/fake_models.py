"""Models of a study that are closed formulas, for tests of all around the real ones, in other processes too."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.parts import StudyPart, numbers_by_name
from workbench.design.plan import Study
from workbench.files.writing import write_atomic
from workbench.reduced.ranges import Progress

Real = NDArray[np.float64]

#: A chip the size of a pea, with ports and one tolerance.
CHIP = """
[chip]
name = "small chip"
band = ["0.95 MHz", "1.1 MHz"]
[cavity]
ports = { diameter = "0.4 mm" }
[states.empty]
cavity = "vacuum"
[states.filled]
cavity = "water"
temperature = "20 degC"
""" + "".join(f'''
[[layers]]
role = "{role}"
material = "{material}"
thickness = {thickness}
radius = "3 mm"
{hole}
''' for role, material, thickness, hole in (
    ("transducer", "pzt4/acevedo_2026_fitted", '"2 mm"', ""), ("couplant", "coupling_gel", '"20 um"', ""),
    ("substrate", "pla", '"0.85 mm"', ""),
    ("sidewall", "pla", '{ value = "0.72 mm", tolerance = "20 um" }', 'cavity_radius = "1.5 mm"'),
    ("superstrate", "pmma", '"1 mm"', "")))


@dataclass(frozen=True)
class FormulaModel:
    """Every figure is ``offset`` and the sine of the numbers (in their own size), and is off by ``off``.

    ``pause`` (s) is what a point takes; where the first number is above ``without``, the second figure is missing.
    """

    names: tuple[str, ...]
    figures: tuple[str, ...]
    sizes: tuple[float, ...]
    offset: float
    pause: float = 0.0
    without: float = math.inf
    off: float = 0.0
    ballast: bytes = b""

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        time.sleep(self.pause)
        x = np.array([values[name] for name in self.names]) / np.array(self.sizes)
        found = {name: self.offset + k + float(np.sin((k + 1) * x).sum()) + self.off
                 for k, name in enumerate(self.figures)}
        missing = {}
        if values[self.names[0]] > self.without and len(self.figures) > 1:
            found[self.figures[1]], missing = math.nan, {self.figures[1]: "beyond the formula"}
        return Evaluation(dict(values), found, missing, 1e6 + self.offset, 1e-5)


@dataclass(frozen=True)
class FormulaModels:
    """Where they come from; ``made`` is a folder in which every model that is made leaves a file, ``ballast`` what
    makes models as heavy as real ones (bytes)."""

    pause: float = 0.0
    without: float = math.inf
    made: str = ""
    ballast: int = 0

    def model(self, study: Study, part: StudyPart, path: Path, progress: Progress) -> FormulaModel:
        if not path.exists():
            write_atomic(path, bytes(self.ballast))
            if self.made:
                (Path(self.made) / f"{part.number}-{time.time_ns()}").touch()
        progress("model", 1.0)
        return self.formula(study, part, 1e-6)

    def confirmed(self, study: Study, part: StudyPart, point: Real) -> Evaluation:
        return self.formula(study, part, 0.0)(numbers_by_name(study, point))

    def formula(self, study: Study, part: StudyPart, off: float) -> FormulaModel:
        """The model of a part."""
        return FormulaModel(tuple(axis.name for axis in study.numbers), study.figures,
                            tuple(abs(axis.high) for axis in study.numbers), float(part.number), self.pause,
                            self.without, off, bytes(self.ballast))
