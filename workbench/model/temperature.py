"""Values of a problem with warmer materials, by their laws of temperature."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.interpolate import CubicSpline

from materials.registry import Material, Registry
from workbench.files.errors import InputError
from workbench.model.problem import Problem, material_values
from workbench.results.brief import Brief

#: Largest rise (K) of the search: liquids in chips stay closer to room temperature.
FARTHEST = 120.0

#: Distance (K) of the temperatures at which a law is read; cubics interpolate. Water has an error of 1e-6 between them.
SPACING = 3.0

#: Tolerance (K) of the end of a law.
OF_END = 0.05


@dataclass(frozen=True, eq=False, repr=False)
class MaterialLaw(Brief):
    """A material's parameters relative to their stated values, by its rise (K).

    The rise is that above the stated temperature. ``lowest`` and ``highest`` are the ends of its law in K of rise;
    ``ratios`` are those of the parameters ``names``.
    """

    material: Material
    registry: Registry
    lowest: float
    highest: float
    names: tuple[str, ...]
    ratios: CubicSpline

    def values(self, rise: float) -> dict[str, complex]:
        """Ratios of the parameters of a problem by name, ``<material>.<property>``."""
        return dict(zip(self.names, map(complex, self.ratios(rise)), strict=True))

    def at(self, rise: float) -> Material:
        """The material at that rise. A density from the chip file scales too."""
        found, stated = (_at(self.material, self.registry, each) for each in (rise, 0.0))
        assert found is not None
        assert stated is not None
        return replace(found, density=self.material.density * found.density / stated.density)


def law_of(material: Material, registry: Registry, *, lowest: float = 0.0) -> MaterialLaw | None:
    """The law of a material above a rise of `lowest`, or None. The rise is in K."""
    if material.temperature is None:
        return None
    low = 0.0 if lowest >= 0.0 else -_end(material, registry, -lowest, -1.0)
    high = _end(material, registry, FARTHEST, 1.0)
    if not high > OF_END:
        return None
    rises = np.linspace(low, high, max(4, math.ceil((high - low) / SPACING) + 1))
    states = [material_values(cast(Material, _at(material, registry, float(rise)))) for rise in rises]
    stated = material_values(cast(Material, _at(material, registry, 0.0)))
    keys = [key for key, value in stated.items() if value != 0.0]
    table = np.array([[state[key] / stated[key] for key in keys] for state in states])
    return MaterialLaw(material, registry, low, high, tuple(keys), CubicSpline(rises, table))


def _at(material: Material, registry: Registry, rise: float) -> Material | None:
    """A material at that rise, or None outside its law."""
    assert material.temperature is not None
    try:
        return registry.load(material.name, temperature=material.temperature + rise)
    except InputError:
        return None


def _end(material: Material, registry: Registry, farthest: float, sign: float) -> float:
    """The extent (K) of a law in the direction of a `sign`."""
    if _at(material, registry, sign * farthest) is not None:
        return farthest
    if _at(material, registry, 0.0) is None:
        return 0.0
    near, far = 0.0, farthest
    while far - near > OF_END:
        middle = 0.5 * (near + far)
        near, far = (middle, far) if _at(material, registry, sign * middle) is not None else (near, middle)
    return near


def warmer_values(problem: Problem, laws: Collection[MaterialLaw], rises: Mapping[str, float]) -> dict[str, complex]:
    """The values of a problem with materials warmer by `rises` (K)."""
    values = dict(problem.values)
    for law in laws:
        values |= {name: problem.values[name] * ratio for name, ratio in law.values(rises[law.material.name]).items()
                   if name in values}
    return values


def warmer_problem(problem: Problem, laws: Collection[MaterialLaw], rises: Mapping[str, float]) -> Problem:
    """A problem with materials warmer by `rises` (K), values included."""
    found = {law.material.name: law.at(rises[law.material.name]) for law in laws}
    return replace(problem, values=warmer_values(problem, laws, rises), materials={
        region: found.get(material.name, material) for region, material in problem.materials.items()})
