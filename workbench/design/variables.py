"""Variables of a study or design: numbers and materials."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.stretch import canonical_names, moving_together
from materials.registry import Registry
from workbench.files.errors import InputError
from workbench.files.tables import FileTable
from workbench.model.numbers import ParameterName

Real = NDArray[np.float64]

#: Suffix of a region's material as a variable.
MATERIAL = ".material"

#: Step (m) of rounded lengths: finer than any process, coarser than rounding errors.
GRAIN = 1e-9


@dataclass(frozen=True)
class VariedNumber:
    """A number that varies (SI), by its parameter ``name``.

    It varies from ``low`` to ``high``, or over ``values`` if there are any. With a ``step`` it is a multiple of the
    step, counted from zero, such as the layers of a print. ``points`` of the range are on a grid.
    """

    name: str
    low: float
    high: float
    step: float | None = None
    values: tuple[float, ...] = ()
    points: int | None = None

    @classmethod
    def listed(cls, name: str, values: Sequence[float]) -> VariedNumber:
        """A number that takes one of `values`, such as a stock length."""
        return cls(name, min(values), max(values), values=tuple(values))

    @property
    def parsed(self) -> ParameterName:
        return ParameterName.parse(self.name)

    @property
    def unit(self) -> str:
        """Its SI unit."""
        return self.parsed.unit

    def levels(self) -> Real:
        """The numbers (n,) of a grid or a list."""
        return np.array(self.values) if self.values else np.linspace(self.low, self.high, self.points or 2)

    def at(self, share: Real) -> Real:
        """The numbers (n,) at shares (n,) of the range, 0 to 1.

        The values of a list have equal parts of it.
        """
        return self.low + (self.high - self.low) * share if not self.values else np.array(self.values)[
            _index(share, len(self.values))]

    def round(self, value: float) -> float:
        """The nearest number on a step, or :data:`GRAIN`, within the range."""
        grain = self.step or GRAIN
        lowest, highest = math.ceil(self.low / grain - 1e-6), math.floor(self.high / grain + 1e-6)
        # Through decimal digits, so that 41 layers of 0.02 mm are 0.82 mm and not 0.8200000000000001 mm.
        return float(f"{min(max(round(value / grain), lowest), highest) * grain:.12g}")

    def beside(self, value: float) -> tuple[float, ...]:
        """The numbers one step below and above, within the range.

        A `value` between steps is rounded both ways.

        Raises:
            ValueError: the number has no step.
        """
        if self.step is None:
            raise ValueError(f"{self.name} has no step")
        count = value / self.step
        on_step = abs(count - round(count)) < 1e-6
        around = (round(count) - 1, round(count) + 1) if on_step else (math.floor(count), math.ceil(count))
        found = (self.round(each * self.step) for each in around)
        return tuple(dict.fromkeys(each for each in found if abs(each - value) > GRAIN))


@dataclass(frozen=True)
class MaterialChoice:
    """The material of a ``region``: one of ``materials``, by name.

    Its numbers are indices in that list.
    """

    region: str
    materials: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.region}{MATERIAL}"

    def levels(self) -> Real:
        """The indices (n,) of the list."""
        return np.arange(float(len(self.materials)))

    def at(self, share: Real) -> Real:
        """The indices (n,) at shares (n,) of the list, 0 to 1."""
        return _index(share, len(self.materials)).astype(float)


Variable = VariedNumber | MaterialChoice


def flat_entries(content: Mapping[str, Any], *, of_tables: bool = True) -> Iterator[tuple[str, Any]]:
    """The entries of a table by their full names.

    TOML reads ``substrate.thickness`` without quotes as a table in a table. Entries `of_tables` are themselves tables,
    which contain no further tables.
    """
    for key, value in content.items():
        if isinstance(value, Mapping) and (not of_tables or (value and all(isinstance(each, Mapping)
                                                                           for each in value.values()))):
            yield from ((f"{key}.{name}", each) for name, each in flat_entries(value, of_tables=of_tables))
        else:
            yield key, value


def read_materials(entry: FileTable, registry: Registry) -> dict[str, str]:
    """Read the alternatives of a variable, ``materials = [...]``.

    Returns their full names by the names as written.

    Raises:
        InputError: other keys, an unknown material, one twice, or only one.
    """
    entry.only(("materials",))
    found: dict[str, str] = {}
    for index, text in enumerate(entry.texts("materials", expected='materials such as ["pla", "petg"]')):
        place = f"{entry.at('materials')}[{index}]"
        try:
            full, _ = registry.find(text)
        except InputError as error:
            raise InputError(entry.source, place, text, error.expected, error.nearest) from error
        if full in found.values():
            raise InputError(entry.source, place, text, "every material once")
        found[text] = full
    if len(found) < 2:
        raise entry.error("materials", "two materials at least; one alone belongs in the chip file")
    return found


def _index(share: Real, count: int) -> NDArray[np.int64]:
    return np.minimum((share * count).astype(np.int64), count - 1)


@dataclass(frozen=True)
class Selection:
    """One choice of every stock length (m) and material, by region."""

    stock: Mapping[str, float]
    materials: Mapping[str, str]

    def __str__(self) -> str:
        lengths = [f"{name} = {1e3 * value:.6g} mm" for name, value in self.stock.items()]
        return ", ".join([*lengths, *(f"{region}: {material}" for region, material in self.materials.items())])


def selections(variables: Sequence[Variable], *, with_stock: bool = True) -> Iterator[Selection]:
    """Every choice of the materials, and of the stock lengths if `with_stock`."""
    stock = [each for each in variables if isinstance(each, VariedNumber) and each.values] if with_stock else []
    materials = [each for each in variables if isinstance(each, MaterialChoice)]
    for values in product(*(each.values for each in stock)):
        for names in product(*(each.materials for each in materials)):
            yield Selection({each.name: value for each, value in zip(stock, values, strict=True)},
                            {each.region: name for each, name in zip(materials, names, strict=True)})


def first_name(chip: Chip, name: str) -> str:
    """The name of a length.

    Radii that coincide change together and have the name of the first one.
    """
    return canonical_names(chip).get(name, name)


def changed(
    chip: Chip, lengths: Mapping[str, float], materials: Mapping[str, str] | None = None, *, note: str = ""
) -> Chip:
    """`chip` with other `lengths` (m) and `materials` (by region).

    Radii that coincide stay equal. A changed length keeps its tolerance, which belongs to its process. A `note`
    replaces that of the old length.

    Raises:
        InputError: the new lengths do not make a chip.
    """
    old = chip.dimensions()
    values = {other: value for name, value in lengths.items() for other in moving_together(chip, name)
              if abs(old[name].value - value) > 0.1 * GRAIN}
    chosen = materials or {}
    found = chip.with_dimensions(values)
    layers = []
    for layer, before in zip(found.layers, chip.layers, strict=True):
        parts = {}
        for part in ("thickness", "radius", "cavity_radius"):
            new, previous = getattr(layer, part), getattr(before, part)
            if new is not None and new.value != previous.value:
                parts[part] = replace(previous, value=new.value, assumed=False if note else previous.assumed,
                                      note=note or previous.note)
        layers.append(replace(layer, **parts, material=chosen.get(layer.region, layer.material)))
    return replace(found, layers=tuple(layers))
