"""Names of the real numbers that a model depends on, and those numbers among complex values.

Names say what they are:

    pzt4/acevedo_2026_initial.c33        real part of a material's coefficient, SI
    pzt4/acevedo_2026_initial.c33.loss   its imaginary part, e^{-i w t}: negative for a stiffness that loses
    transducer.thickness                 a dimension of the chip, metres
    bench.series_resistance              an element between the electrodes and the instrument
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

LOSS = ".loss"
BENCH = "bench."

#: How the name of a dimension of a chip ends (`geometry.chip.Chip.dimensions`).
LENGTHS = ("thickness", "radius", "inner_radius", "cavity_radius", "diameter", "height")


class Kind(Enum):
    """What a name is of; ``TERM`` is a number that belongs to no material of the registry, dimension or bench."""

    MATERIAL = "material"
    DIMENSION = "dimension"
    BENCH = "bench"
    TERM = "term"


@dataclass(frozen=True)
class ParameterName:
    """A name taken apart.

    ``owner`` is a material, a region or "bench", empty where the name stands alone; ``coefficient`` what of it;
    ``is_loss`` whether the number is the imaginary part of the coefficient.
    """

    owner: str
    coefficient: str
    is_loss: bool
    kind: Kind

    @classmethod
    def parse(cls, text: str) -> ParameterName:
        """The parts of ``owner.coefficient``, with or without ``.loss``; a bench element has none."""
        if text.startswith(BENCH):
            return cls(BENCH.removesuffix("."), text.removeprefix(BENCH), False, Kind.BENCH)
        key, is_loss = text.removesuffix(LOSS), text.endswith(LOSS)
        if "/" in text:
            # No material of the registry has a dot in its name; regions of terms do.
            owner, _, coefficient = key.partition(".")
            return cls(owner, coefficient, is_loss, Kind.MATERIAL)
        owner, _, coefficient = key.rpartition(".")
        is_length = coefficient in LENGTHS and not is_loss
        return cls(owner, coefficient, is_loss, Kind.DIMENSION if is_length else Kind.TERM)

    def __str__(self) -> str:
        return self.key + (LOSS if self.is_loss else "")

    @property
    def key(self) -> str:
        """Name of the complex value that the number is a part of: the name without ``.loss``."""
        return f"{self.owner}.{self.coefficient}" if self.owner else self.coefficient

    @property
    def local(self) -> str:
        """The name without its owner."""
        return self.coefficient + (LOSS if self.is_loss else "")

    @property
    def is_radius(self) -> bool:
        return self.kind is Kind.DIMENSION and self.coefficient.endswith("radius")

    @property
    def is_thickness(self) -> bool:
        return self.kind is Kind.DIMENSION and self.coefficient == "thickness"

    def within(self, owner: str) -> str:
        """The name as it is told of one `owner`: without it, or in full where it belongs to another."""
        return self.local if self.owner == owner else str(self)

    def part_of(self, value: complex) -> float:
        """The real or the imaginary part of a complex `value`, whichever the number is."""
        return value.imag if self.is_loss else value.real


def part(values: Mapping[str, complex], name: str) -> float:
    """The number called `name` among complex `values`: a real part, or with ``.loss`` an imaginary one."""
    parsed = ParameterName.parse(name)
    return parsed.part_of(complex(values[parsed.key]))


def placed(values: Mapping[str, complex], numbers: Mapping[str, float]) -> dict[str, complex]:
    """Complex `values` with real `numbers`, by parameter name, in the place of the parts they are."""
    result = dict(values)
    for name, number in numbers.items():
        parsed = ParameterName.parse(name)
        old = complex(result[parsed.key])
        result[parsed.key] = complex(old.real, number) if parsed.is_loss else complex(number, old.imag)
    return result
