"""The result of a study: its table, statistics and confirmations."""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.design.figures import figure_named
from workbench.design.plan import GRID, Study
from workbench.design.study_folder import FinishedPoints
from workbench.design.variables import Variable, VariedNumber
from workbench.files.writing import replacing, write_json
from workbench.results.notebook import Shown, Summary

if TYPE_CHECKING:
    import pyarrow
    import xarray

Real = NDArray[np.float64]

#: Columns of the table that are neither a parameter nor a figure.
STATE, FREQUENCY, ERROR, MISSING = "state", "frequency", "error", "missing"

_WORDS = {FREQUENCY: "frequency driven at", ERROR: "estimated relative error of Z there"}

#: Quantiles of a statistic besides the median.
LOW, HIGH = 0.05, 0.95


@dataclass(frozen=True)
class Statistic:
    """Statistics of a figure over the points of one state (SI).

    ``count`` of the ``points`` have the figure. The extremes have their rows in the table. The quantiles are 5, 50 and
    95 %. Numbers are NaN if no point has the figure.
    """

    state: str
    figure: str
    points: int
    count: int
    lowest: float
    low: float
    median: float
    high: float
    highest: float
    mean: float
    lowest_row: int
    highest_row: int


@dataclass(frozen=True)
class Confirmation:
    """A ``figure`` (SI) at one ``row``, by reduced model and full solve."""

    row: int
    figure: str
    reduced: float
    full: float

    @property
    def difference(self) -> float:
        """The reduced model's figure minus that of the full solve, SI."""
        return self.reduced - self.full


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(Shown):
    """The table of a ``study``.

    ``rows`` are all of its points, ``full`` those that were also solved in full.
    """

    study: Study
    rows: FinishedPoints
    full: FinishedPoints

    @cached_property
    def columns(self) -> Mapping[str, NDArray[Any]]:
        """The table (n,) by column.

        The columns are the state, the variables (numbers in SI, materials by name), the figures (SI), the driven
        frequency (Hz), the estimated relative error of Z there, and the reasons for missing figures.
        """
        plan = self.study
        states, count = np.array(plan.states, dtype=np.str_), len(plan.sample)
        found: dict[str, NDArray[Any]] = {STATE: np.repeat(states, count)}
        for axis, column in zip(plan.axes, plan.sample.T, strict=True):
            found[axis.name] = np.tile(_formatted(axis, column), len(plan.states))
        found |= dict(zip(plan.figures, self.rows.figures.T, strict=True))
        return {**found, FREQUENCY: self.rows.frequency, ERROR: self.rows.error, MISSING: self.rows.missing}

    @property
    def units(self) -> Mapping[str, str]:
        """SI units of the columns that are numbers."""
        return {**{axis.name: axis.unit for axis in self.study.numbers},
                **{name: figure_named(name).unit for name in self.study.figures}, FREQUENCY: "Hz", ERROR: "1"}

    @cached_property
    def statistics(self) -> tuple[Statistic, ...]:
        """Statistics of every figure in every state."""
        states = self.columns[STATE]
        return tuple(_statistic(state, name, np.flatnonzero(states == state), self.columns[name])
                     for state in self.study.states for name in self.study.figures)

    @cached_property
    def confirmations(self) -> tuple[Confirmation, ...]:
        """Every figure at every point solved in full.

        Figures that neither the reduced model nor the full solve has are left out.
        """
        return tuple(Confirmation(row, name, float(reduced), float(full))
                     for row, solved in zip(map(int, self.full.index), self.full.figures, strict=True)
                     for name, reduced, full in zip(self.study.figures, self.rows.figures[row], solved, strict=True)
                     if not (math.isnan(reduced) and math.isnan(full)))

    def summary(self) -> Summary:
        """Lowest, median and highest of every figure, for a notebook."""
        rows: list[tuple[str, ...]] = [("figure", "state", "lowest", "median", "highest")]
        for each in self.statistics:
            shown = figure_named(each.figure)
            numbers = (f"{value / shown.factor:.4g} {shown.shown}" for value in
                       (each.lowest, each.median, each.highest))
            rows.append((each.figure, each.state, *numbers))
        return Summary(f"Study {self.study.name}, {self.study.size} points", tuple(rows))

    def to_xarray(self) -> xarray.Dataset:
        """The figures over ``state`` and the variables or ``point``.

        A grid has a dimension for each variable, other samples have ``point``. Units are attributes. Names of
        coefficients have "_" for "/", which NetCDF uses otherwise, and their own name as ``long_name``.
        """
        import xarray

        plan = self.study
        grid = plan.sampling.method == GRID
        names = {name: name.replace("/", "_") for name in self.columns}
        inner = tuple(names[axis.name] for axis in plan.axes) if grid else ("point",)
        shape = tuple(len(axis.levels()) for axis in plan.axes) if grid else (len(plan.sample),)
        coordinates: dict[str, Any] = {STATE: (STATE, list(plan.states))}
        for axis, column in zip(plan.axes, plan.sample.T, strict=True):
            attributes = {"long_name": axis.name} | ({"units": axis.unit} if isinstance(axis, VariedNumber) else {})
            told = _formatted(axis, axis.levels() if grid else column)
            coordinates[names[axis.name]] = (names[axis.name] if grid else "point",
                                             told if isinstance(axis, VariedNumber) else list(told), attributes)
        data: dict[str, Any] = {}
        for name in (*plan.figures, FREQUENCY, ERROR):
            words = _WORDS[name] if name in _WORDS else figure_named(name).words
            attributes = {"units": self.units[name], "long_name": words}
            data[name] = ((STATE, *inner), self.columns[name].reshape(len(plan.states), *shape), attributes)
        missing = self.columns[MISSING].astype(object).reshape(len(plan.states), *shape)
        data[MISSING] = ((STATE, *inner), missing, {"long_name": "why figures are missing"})
        return xarray.Dataset(data, coordinates, {"study": plan.name, "chip": plan.chip.name,
                                                  "sample": plan.sampling.method})

    def to_arrow(self) -> pyarrow.Table:
        """The table, with units in the metadata of its columns."""
        import pyarrow

        columns = {name: pyarrow.array(values.tolist() if values.dtype.kind == "U" else values)
                   for name, values in self.columns.items()}
        schema = pyarrow.schema([
            pyarrow.field(name, each.type, metadata={"unit": self.units[name]} if name in self.units else None)
            for name, each in columns.items()], metadata={"study": self.study.name, "chip": self.study.chip.name})
        return pyarrow.table(columns, schema=schema)

    def write(self, folder: Path | str) -> None:
        """Write ``study.parquet``, ``study.nc`` and ``study.json`` into a folder."""
        import pyarrow.parquet

        folder = Path(folder)
        with replacing(folder / "study.parquet") as path:
            pyarrow.parquet.write_table(self.to_arrow(), path)
        with replacing(folder / "study.nc") as path:
            self.to_xarray().to_netcdf(path, engine="h5netcdf")
        write_json(folder / "study.json", self.record())

    def record(self) -> dict[str, Any]:
        """The request, statistics and confirmations, for a JSON file.

        Numbers are in SI; those that do not exist are None.
        """
        plan = self.study
        return {
            "name": plan.name, "version": importlib.metadata.version("acoustofluidic-chip-workbench"),
            "chip": plan.chip.name, "states": list(plan.states), "figures": list(plan.figures),
            "drive": str(plan.operation.drive), "frequency": plan.operation.frequency or "as the chip states",
            "band": list(plan.band), "relative_error": plan.relative_error, "accuracy": plan.accuracy,
            "sample": {"method": plan.sampling.method, "points": len(plan.sample), "seed": plan.sampling.seed},
            "varies": {each.name: {"unit": each.unit, "from": each.low, "to": each.high}
                       if isinstance(each, VariedNumber) else {"materials": list(each.materials)}
                       for each in plan.axes},
            "units": dict(self.units),
            "statistics": [_without_nan(vars(each)) for each in self.statistics],
            "confirmed": [_without_nan({**vars(each), "difference": each.difference})
                          for each in self.confirmations],
        }


def _formatted(axis: Variable, column: Real) -> NDArray[Any]:
    """A column of the sample for output: numbers, or names of materials."""
    return column if isinstance(axis, VariedNumber) else np.array(axis.materials, dtype=np.str_)[column.astype(int)]


def _statistic(state: str, name: str, rows: NDArray[np.int64], values: Real) -> Statistic:
    known = rows[np.isfinite(values[rows])]
    there = values[known]
    if not known.size:
        none = math.nan
        return Statistic(state, name, rows.size, 0, none, none, none, none, none, none, -1, -1)
    low, median, high = map(float, np.quantile(there, (LOW, 0.5, HIGH)))
    return Statistic(
        state, name, rows.size, known.size, float(there.min()), low, median, high, float(there.max()),
        float(there.mean()), int(known[np.argmin(there)]), int(known[np.argmax(there)]))


def _without_nan(record: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in record.items()}
