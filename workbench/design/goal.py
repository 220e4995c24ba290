"""What a chip is to be best at, what of it may change, and what it must keep to: the content of GOAL.toml.

    [goal]
    chip = "chip.toml"                        # where the search starts; the path is relative to this file
    state = "filled"
    drive = "10 Vpp"                          # or "1 W": figures are per volt or per watt as they are at this drive
    maximise = "e_ac"                         # or minimise = "focus_time"; both, or a list of two: a Pareto front

    [variables]
    substrate.thickness = { from = "0.7 mm", to = "1.0 mm", step = "20 um" }     # layers of a printer
    sidewall.thickness = { from = "0.65 mm", to = "0.8 mm" }
    superstrate.thickness = { values = ["0.15 mm", "0.5 mm", "1.0 mm"] }
    superstrate.material = { materials = ["soda_lime_glass", "borosilicate_glass"] }

    [[constraints]]                           # or constraints = ["...", "..."] in [goal]
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geometry.chip import Chip, read_chip
from geometry.names import VACUUM
from materials.registry import Registry
from workbench.design.bounds import Bound, read_bounds
from workbench.design.figures import FIGURES, LOSS_SHARE, figure
from workbench.design.model import Operation
from workbench.design.variables import MATERIAL, Length, MaterialChoice, Stock, Variable, selections, together
from workbench.drive import parse_drive
from workbench.files.errors import InputError, choose
from workbench.files.tables import Table

#: Name of the objective that is the largest common scale of all tolerances with which every constraint holds.
TOLERANCE = "tolerance"
