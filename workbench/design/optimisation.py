"""The best chip for a goal: searched on reduced models, confirmed by full solves.

    found = optimise(read_goal("goal.toml"))
    found.best.after.figures["e_ac"], found.best.chip.dimensions()["substrate.thickness"].value

Every choice of stock lengths and materials is searched on models of its own, from many starts that share them. A model
extends as far as `Search.reach` says; where the optimum lies on a side that is no bound, the next model lies about it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Protocol

from geometry.chip import Chip
from materials.registry import Registry
from workbench.design.boxes import Box, Reach, middle, sides_within, within
from workbench.design.evaluation import Evaluation
from workbench.design.goal import Goal
from workbench.design.model import DesignModel, Evaluator, design_model, full_evaluation
from workbench.design.programme import Point, Programme
from workbench.design.search import Attempt, Optimum, optima, search_all
from workbench.design.steps import settle
from workbench.design.variables import Selection, changed, selections
from workbench.discretisation import ACCURACY, Discretisation
from workbench.ranges import NotCovered

#: Frequencies at which a model is asked for its resonance: a step of a band of 0.2 MHz is then a tenth of the width of
#: a resonance of quality 40 at 1 MHz. Doubled, a search takes nearly twice as long.
FREQUENCIES = 81

#: Most full solves of a model before its box is halved.
SOLVES = 250

#: Largest relative difference between the figures of the model and of the full solve with which an optimum is accepted.
CONFIRMED = 0.01
