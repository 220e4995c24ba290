"""The real numbers of a device: their names, values, units and ranges, and what is stated of them.

Fits, tolerance analyses, the live view and the diagnosis each look at a :class:`Number` in a way of their own;
`workbench.model.device_numbers` reads those of a chip and its materials. Names say what they are:

    pzt4/acevedo_2026_initial.c33        real part of a material's coefficient, SI
    pzt4/acevedo_2026_initial.c33.loss   its imaginary part, e^{-i w t}: negative for a stiffness that loses
    transducer.thickness                 a dimension of the chip, metres
    sidewall.draft                       a shape of a layer (`geometry.shapes`), metres or radians
    bench.series_resistance              an element between the electrodes and the instrument
    bench.gain[filled]                   what that state alone adds to the number of that name
    pzt4/disc_7@2.c33                    of the second saved version of a material (`materials.versions`)
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache, cached_property
from typing import Literal

from geometry.assumed import LengthUncertainty, length_uncertainty
from geometry.dimension import ACROSS, SHAPES, Dimension
from geometry.names import ROLES, role_of
from materials.entry import KINDS
from workbench.files.quantities import si_unit

LOSS = ".loss"
BENCH = "bench."

#: About the one state that a number acts in, behind its name. No name holds the first sign; that of a state may.
STATE, STATE_END = "[", "]"

#: Ends of the names of dimensions of a chip (`geometry.chip.Chip.dimensions`).
LENGTHS = ("thickness", "radius", "inner_radius", "cavity_radius", "diameter", "height", "half_width",
           "inner_half_width", "cavity_half_width")


#: Ends of names of a layer that are no dimensions of it; ``gauge`` is the factor of density, stiffness and
#: piezoelectric constants together that a free disc does not show.
NO_DIMENSION = ("density", "material", "gauge")

#: Dimension of every coefficient of a material, a key of `workbench.files.quantities.UNITS`: as entries state it (the
#: first form of a kind is the one that a solver has), and one that follows from others.
COEFFICIENTS: Mapping[str, str] = {
    **{name: dimension for kind in KINDS.values() for stated in (kind.required, kind.optional, kind.forms[0].dimensions)
       for name, dimension in stated.items()}, "diffusivity_of_sound": "diffusivity"}

#: A material's source behind its name.
_SOURCE = re.compile(r"(\w)/[\w@-]+")


@dataclass(frozen=True)
class Element:
    """A bench element: what it is in words, its dimension, its standard uncertainty before the measurement, its bounds
    (SI)."""

    text: str
    quantity: str
    prior: float
    low: float
    high: float

    @property
    def unit(self) -> str:
        """Its SI unit."""
        return si_unit(self.quantity)


#: The bench as in Z_seen = gain e^{i (phase - w delay)} (R + i w L + 1 / (1 / Z + i w C)), e^{+j w t}, with Z at the
#: frequency (1 + clock) f that the generator makes of f; all are zero (the gain as its logarithm) where it is ideal.
#: Bounds are those of contacts, leads and probes; data sheets of generators state 1 to 50 in a million. A compensation
#: that takes away too much leaves less than zero: a bad contact, 10 cm of wire, 20 cm of cable.
BENCH_ELEMENTS: Mapping[str, Element] = {
    "series_resistance": Element("resistance of leads and contacts", "resistance", 0.3, -0.3, 5.0),
    "series_inductance": Element("inductance of the leads", "inductance", 2e-7, -1e-7, 2e-6),
    "parallel_capacitance": Element("stray and probe capacitance", "capacitance", 1e-11, -2e-11, 2e-10),
    "gain": Element("logarithm of the gain", "share", 0.05, -0.5, 0.5),
    "phase": Element("phase of the gain", "angle", 0.02, -0.5, 0.5),
    "delay": Element("delay between the channels", "time", 2e-9, -5e-8, 5e-8),
    "clock": Element("relative error of the generator's clock", "share", 1e-5, -1e-4, 1e-4),
}


class ParameterKind(Enum):
    """The kind of number of a name; ``TERM`` belongs to no material of the registry, dimension or bench."""

    MATERIAL = "material"
    DIMENSION = "dimension"
    BENCH = "bench"
    TERM = "term"


@dataclass(frozen=True)
class ParameterName:
    """A name taken apart.

    ``owner`` is a material, a region or "bench", empty where the name stands alone; ``coefficient`` what of it;
    ``is_loss`` whether the number is the imaginary part of the coefficient. ``state`` is the state that it is of alone,
    empty for a number that all have.
    """

    owner: str
    coefficient: str
    is_loss: bool
    kind: ParameterKind
    state: str = ""

    @classmethod
    @cache
    def parse(cls, text: str) -> ParameterName:
        """The parts of ``owner.coefficient``, with or without ``.loss`` (a bench element has none) and ``[state]``.

        A name is taken apart once in a process.
        """
        name, _, state = text.partition(STATE)
        state = state.removesuffix(STATE_END)
        if name.startswith(BENCH):
            return cls(BENCH.removesuffix("."), name.removeprefix(BENCH), False, ParameterKind.BENCH, state)
        key, is_loss = name.removesuffix(LOSS), name.endswith(LOSS)
        if "/" in name:
            # No material of the registry has a dot in its name; regions of terms do.
            owner, _, coefficient = key.partition(".")
            return cls(owner, coefficient, is_loss, ParameterKind.MATERIAL, state)
        owner, _, coefficient = key.rpartition(".")
        # Any size of a layer is a dimension, whatever its profile calls it; numbers of terms have names of their own.
        of_layer = role_of(owner) in ROLES and coefficient not in NO_DIMENSION
        is_dimension = (coefficient in LENGTHS or coefficient in SHAPES or of_layer) and not is_loss
        return cls(owner, coefficient, is_loss, ParameterKind.DIMENSION if is_dimension else ParameterKind.TERM, state)

    def __str__(self) -> str:
        return self.shared + (STATE + self.state + STATE_END if self.state else "")

    @property
    def shared(self) -> str:
        """The name of the number that all states have: without ``[state]``."""
        return self.key + (LOSS if self.is_loss else "")

    def of_state(self, state: str) -> ParameterName:
        """The name of what one `state` adds to the number."""
        return replace(self, state=state)

    @property
    def key(self) -> str:
        """Name of the complex value that the number is a part of: the name without ``.loss`` and ``[state]``."""
        return f"{self.owner}.{self.coefficient}" if self.owner else self.coefficient

    @property
    def local(self) -> str:
        """The name without its owner and its state."""
        return self.coefficient + (LOSS if self.is_loss else "")

    @property
    def is_dimension(self) -> bool:
        """Whether it is a dimension of a chip."""
        return self.kind is ParameterKind.DIMENSION

    @property
    def is_material(self) -> bool:
        """Whether it is a coefficient of a material of the registry."""
        return self.kind is ParameterKind.MATERIAL

    @property
    def is_bench(self) -> bool:
        """Whether it is an element between the electrodes and the instrument."""
        return self.kind is ParameterKind.BENCH

    @property
    def is_radius(self) -> bool:
        """Whether it is a distance from the axis, or from the middle of a straight chip."""
        return self.is_dimension and self.coefficient.endswith(ACROSS)

    @property
    def is_thickness(self) -> bool:
        return self.is_dimension and self.coefficient == "thickness"

    @property
    def is_shape(self) -> bool:
        """Whether it is the size of a shape, or a parameter of a profile (`geometry.profile`)."""
        return self.is_dimension and self.coefficient not in LENGTHS

    @property
    def quantity(self) -> str:
        """The dimension of the number, a key of `workbench.files.quantities.UNITS`; empty for a number that a term
        brings in, whose name does not tell."""
        if self.is_dimension:
            return SHAPES.get(self.coefficient, "length")
        if self.is_bench:
            return BENCH_ELEMENTS[self.coefficient].quantity if self.coefficient in BENCH_ELEMENTS else ""
        return COEFFICIENTS.get(self.coefficient, "")

    @property
    def unit(self) -> str:
        """The SI unit of the number; empty where its name alone does not tell."""
        return si_unit(self.quantity)

    @property
    def in_words(self) -> str:
        """The name in plain words: "substrate thickness", "pla shear modulus loss in the state filled"."""
        words = plain_words(f"{self.owner} {self.local}".strip()).replace(".", " ")
        return f"{words} in the state {self.state}" if self.state else words

    def within(self, owner: str) -> str:
        """The name as it is told of one `owner`: without it, or in full where it belongs to another."""
        return self.local if self.owner == owner else str(self)

    def part_of(self, value: complex) -> float:
        """The real or the imaginary part of a complex `value`, whichever the number is."""
        return value.imag if self.is_loss else value.real


#: Standard deviations at which a normal law is cut, and from which the limits of a tolerance are read as one. Doubled,
#: range models would have to cover twice the width, for one sample in four hundred of each input.
CUT = 3.0

Law = Literal["uniform", "normal"]


@dataclass(frozen=True)
class Stated:
    """The uncertainty of a number as it is stated (SI), and its origin.

    ``amount`` is the limit to either side of a uniform law (a tolerance: GUM, JCGM 100:2008, 4.3.7), or the standard
    uncertainty of a normal one (what a registry or a fit states); 0 states the number as exact. ``origin`` is the file,
    the table or the entry that states it. ``assumed`` is the assumption in words, if nobody states it.
    """

    amount: float
    law: Law = "normal"
    origin: str = ""
    assumed: str = ""

    @classmethod
    def within(cls, half_width: float, law: Law, *, origin: str) -> Stated:
        """A tolerance: limits of a uniform law, or :data:`CUT` standard deviations of a normal one."""
        return cls(half_width if law == "uniform" else half_width / CUT, law, origin)

    @property
    def deviation(self) -> float:
        """The standard uncertainty."""
        return self.amount / math.sqrt(3.0) if self.law == "uniform" else self.amount

    @property
    def half_width(self) -> float:
        """Half the width of the law: its limits, or :data:`CUT` standard deviations."""
        return self.amount if self.law == "uniform" else CUT * self.amount


@dataclass(frozen=True)
class Number:
    """One real number of a device.

    ``value`` lies in its admissible range, ``low`` to ``high``; all in the SI ``unit``. ``stated`` is its uncertainty,
    None if nobody states it. ``tied`` are the other names of the same number: radii that coincide.
    ``material`` is that of the layer that a length is of.
    """

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    stated: Stated | None = None
    unit: str = ""
    tied: tuple[str, ...] = ()
    material: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.name}: {self.value:g} must lie between {self.low:g} and {self.high:g}")

    @cached_property
    def parsed(self) -> ParameterName:
        """Its name, taken apart."""
        return ParameterName.parse(self.name)

    @property
    def is_bench(self) -> bool:
        return self.parsed.is_bench

    @property
    def is_material(self) -> bool:
        return self.parsed.is_material

    @property
    def is_dimension(self) -> bool:
        return self.parsed.is_dimension

    @property
    def is_loss(self) -> bool:
        return self.parsed.is_loss

    @property
    def names(self) -> tuple[str, ...]:
        """The name of the number that it is or adds to, and those of the lengths tied to it."""
        return (self.parsed.shared, *self.tied)

    @property
    def quantity(self) -> str:
        """Its dimension as files state it: dimensionless where its name does not tell."""
        return self.parsed.quantity or "dimensionless"

    @property
    def law(self) -> Law:
        """The law of its uncertainty."""
        return self.stated.law if self.stated else "normal"

    @property
    def deviation(self) -> float:
        """Its standard uncertainty, 0 where nothing is stated."""
        return self.stated.deviation if self.stated else 0.0

    @property
    def half_width(self) -> float:
        """Half the width of its law, 0 where nothing is stated."""
        return self.stated.half_width if self.stated else 0.0

    @property
    def origin(self) -> str:
        """The file, table or entry that states its uncertainty; empty if none does."""
        return self.stated.origin if self.stated else ""

    @property
    def assumed(self) -> str:
        """The assumption about a number that nobody states, in words; empty if its uncertainty is stated."""
        return self.stated.assumed if self.stated else ""

    @property
    def tolerance(self) -> float | None:
        """The stated amount of its uncertainty; None if it is assumed, or nobody states it."""
        return self.stated.amount if self.stated and not self.stated.assumed else None

    @property
    def known(self) -> LengthUncertainty:
        """The uncertainty of a length: stated, or assumed by its role (`geometry.assumed`)."""
        return length_uncertainty(self.name, Dimension(self.value, self.tolerance), self.material)


def limits(name: str, value: float) -> tuple[float, float]:
    """Lowest and highest number (SI) that a coefficient may have in matter that exists: a modulus is above zero, a loss
    takes energy up. Coefficients that couple two motions may have either sign."""
    parsed = ParameterName.parse(name)
    if parsed.is_dimension:
        return -math.inf if parsed.is_shape else 0.0, math.inf
    coefficient = parsed.key.rpartition(".")[2]
    if coefficient in ("c12", "c13", "e31", "e33", "e15"):
        return -math.inf, math.inf
    if not parsed.is_loss:
        return 0.0, math.inf
    return (min(0.0, value), math.inf) if coefficient.startswith("eps") else (-math.inf, max(0.0, value))


def plain_words(text: str) -> str:
    """A `text` with names in plain words: without the sources of materials, and without joined words."""
    return _SOURCE.sub(r"\1", text).replace("_", " ")


def word_list(words: Sequence[str]) -> str:
    """Words as in "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def real_part(values: Mapping[str, complex], name: str) -> float:
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
