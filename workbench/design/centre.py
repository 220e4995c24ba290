"""A chip at the mean of its uncertain numbers: where a fit gives other numbers than the chip file and the registry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from geometry.chip import Chip
from materials.assumed import with_assumed_loss
from materials.kinds import Material
from materials.registry import Registry
from workbench.design.model import all_of_one_length
from workbench.model.numbers import ParameterName, placed


@dataclass(frozen=True)
class CentredRegistry(Registry):
    """A registry whose materials have other ``numbers`` (SI, by parameter name) than their entries."""

    numbers: Mapping[str, float] = field(default_factory=dict)

    def load(self, name: str, *, temperature: float | None = None, notes: list[str] | None = None) -> Material:
        """The material called `name`, with the numbers that are stated of it in the place of its own."""
        material = super().load(name, temperature=temperature, notes=notes)
        if self.assumed_losses:  # the numbers are those of the ceramic as it is simulated
            material, _ = with_assumed_loss(material)
        mine = {key: number for key, number in self.numbers.items() if ParameterName.parse(key).owner == material.name}
        before = {f"{material.name}.{key}": value for key, value in material.parameters().items()}
        after = placed(before, mine)
        changed: dict[str, Any] = {}
        for key, value in after.items():
            if value != before[key]:
                coefficient = key.removeprefix(f"{material.name}.")
                kept_real = isinstance(getattr(material, coefficient), float)
                changed[coefficient] = value.real if kept_real else value
        return replace(material, **changed) if changed else material


def centred_chip(chip: Chip, registry: Registry | None, numbers: Mapping[str, float]) -> tuple[Chip, Registry]:
    """`chip` and `registry` with `numbers` (SI, by parameter name) in the place of their own."""
    known = chip.dimensions()
    lengths = {name: number for name, number in numbers.items()
               if ParameterName.parse(name).is_dimension and number != known[name].value}
    others = {name: number for name,
              number in numbers.items() if not ParameterName.parse(name).is_dimension}
    moved = chip.with_dimensions(all_of_one_length(chip, lengths)) if lengths else chip
    registry = registry or Registry()
    return moved, CentredRegistry(registry.folders, registry.assumed_losses, registry.inviscid, others)
