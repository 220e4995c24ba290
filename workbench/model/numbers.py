"""The real parameters of a device: names, values, units, ranges, uncertainties.

Fits, tolerance analyses, the live view and the diagnosis use :class:`Number`; `workbench.model.device_numbers` reads
those of a chip and its materials. The names are::

    pzt4/acevedo_2026_initial.c33        real part of a material's coefficient, SI
    pzt4/acevedo_2026_initial.c33.loss   its imaginary part, e^{-i w t}: negative for a lossy stiffness
    transducer.thickness                 a dimension of the chip, metres
    sidewall.draft                       a shape of a layer (`geometry.shapes`), metres or radians
    bench.series_resistance              an element between the electrodes and the instrument
    bench.gain[filled]                   the addition of one state to the parameter of that name
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

#: Brackets of the state of a parameter, behind its name. Only names of states may contain the first.
STATE, STATE_END = "[", "]"

#: Suffixes of the names of dimensions of a chip (`geometry.chip.Chip.dimensions`).
LENGTHS = ("thickness", "radius", "inner_radius", "cavity_radius", "diameter", "height", "half_width",
           "inner_half_width", "cavity_half_width")


#: Suffixes of names of a layer that are not dimensions. ``gauge`` is the common factor of density, stiffness and
#: piezoelectric constants, which a free disc does not determine.
NO_DIMENSION = ("density", "material", "gauge")

#: Dimension of every coefficient of a material, a key of `workbench.files.quantities.UNITS`: those of the first form of
#: each kind, and one derived coefficient.
COEFFICIENTS: Mapping[str, str] = {
    **{name: dimension for kind in KINDS.values() for stated in (kind.required, kind.optional, kind.forms[0].dimensions)
       for name, dimension in stated.items()}, "diffusivity_of_sound": "diffusivity"}

#: The source of a material, behind its name.
_SOURCE = re.compile(r"(\w)/[\w@-]+")


@dataclass(frozen=True)
class Element:
    """A bench element. ``text`` describes it, ``quantity`` is its dimension, ``prior`` its standard uncertainty before
    the measurement; ``low`` and ``high`` are its bounds (SI)."""

    text: str
    quantity: str
    prior: float
    low: float
    high: float

    @property
    def unit(self) -> str:
        """Its SI unit."""
        return si_unit(self.quantity)


#: The bench in Z_seen = gain e^{i (phase - w delay)} (R + i w L + 1 / (1 / Z + i w C)), e^{+j w t}, with Z at the
#: generator's frequency (1 + clock) f; all are zero (the gain as its logarithm) for an ideal bench. Bounds are those of
#: contacts, leads and probes; data sheets of generators state 1 to 50 ppm. Overcompensation makes them negative: a bad
#: contact, 10 cm of wire, 20 cm of cable.
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
    """The kind of a parameter; ``TERM`` is none of the others."""

    MATERIAL = "material"
    DIMENSION = "dimension"
    BENCH = "bench"
    TERM = "term"


@dataclass(frozen=True)
class ParameterName:
    """The parts of a parameter's name.

    ``owner`` is a material, a region or "bench", empty for a single word; ``coefficient`` is the quantity; ``is_loss``
    marks the imaginary part. ``state`` is the only state of the parameter, empty if all states have it.
    """

    owner: str
    coefficient: str
    is_loss: bool
    kind: ParameterKind
    state: str = ""

    @classmethod
    @cache
    def parse(cls, text: str) -> ParameterName:
        """The parts of ``owner.coefficient``, ``.loss`` and ``[state]``, cached. ``.loss`` and ``[state]`` are
        optional; a bench element has no ``.loss``."""
        name, _, state = text.partition(STATE)
        state = state.removesuffix(STATE_END)
        if name.startswith(BENCH):
            return cls(BENCH.removesuffix("."), name.removeprefix(BENCH), False, ParameterKind.BENCH, state)
        key, is_loss = name.removesuffix(LOSS), name.endswith(LOSS)
        if "/" in name:
            # Names of materials in the registry have no dot; regions of terms may.
            owner, _, coefficient = key.partition(".")
            return cls(owner, coefficient, is_loss, ParameterKind.MATERIAL, state)
        owner, _, coefficient = key.rpartition(".")
        # Any other size of a layer is a dimension of its profile; parameters of terms have other names.
        of_layer = role_of(owner) in ROLES and coefficient not in NO_DIMENSION
        is_dimension = (coefficient in LENGTHS or coefficient in SHAPES or of_layer) and not is_loss
        return cls(owner, coefficient, is_loss, ParameterKind.DIMENSION if is_dimension else ParameterKind.TERM, state)

    def __str__(self) -> str:
        return self.shared + (STATE + self.state + STATE_END if self.state else "")

    @property
    def shared(self) -> str:
        """The name without ``[state]``."""
        return self.key + (LOSS if self.is_loss else "")

    def of_state(self, state: str) -> ParameterName:
        """The name of the addition of one `state` to the parameter."""
        return replace(self, state=state)

    @property
    def key(self) -> str:
        """Name of the complex value: without ``.loss`` and ``[state]``."""
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
        """Whether it is a distance from the axis or the middle."""
        return self.is_dimension and self.coefficient.endswith(ACROSS)

    @property
    def is_thickness(self) -> bool:
        return self.is_dimension and self.coefficient == "thickness"

    @property
    def is_shape(self) -> bool:
        """Whether it is a shape or a profile's parameter (`geometry.profile`)."""
        return self.is_dimension and self.coefficient not in LENGTHS

    @property
    def quantity(self) -> str:
        """The dimension, a key of `workbench.files.quantities.UNITS`. Empty for a parameter of a term, whose name does
        not determine it."""
        if self.is_dimension:
            return SHAPES.get(self.coefficient, "length")
        if self.is_bench:
            return BENCH_ELEMENTS[self.coefficient].quantity if self.coefficient in BENCH_ELEMENTS else ""
        return COEFFICIENTS.get(self.coefficient, "")

    @property
    def unit(self) -> str:
        """The SI unit; empty if the name does not determine it."""
        return si_unit(self.quantity)

    @property
    def in_words(self) -> str:
        """The name in plain words.

        Examples: "substrate thickness", "pla shear modulus loss in the state filled".
        """
        words = plain_words(f"{self.owner} {self.local}".strip()).replace(".", " ")
        return f"{words} in the state {self.state}" if self.state else words

    def within(self, owner: str) -> str:
        """The name without its owner if that is `owner`, otherwise in full."""
        return self.local if self.owner == owner else str(self)

    def part_of(self, value: complex) -> float:
        """The real or the imaginary part of a complex `value`."""
        return value.imag if self.is_loss else value.real


#: Number of standard deviations at which a normal law is cut, and that a tolerance of a normal law means. Doubled,
#: range models must cover twice the width, for one sample in four hundred of each parameter.
CUT = 3.0

Law = Literal["uniform", "normal"]


@dataclass(frozen=True)
class Stated:
    """The stated uncertainty of a parameter (SI), and its origin.

    ``amount`` is the limit to either side of a uniform law (a tolerance: GUM, JCGM 100:2008, 4.3.7), or the standard
    uncertainty of a normal one (from a registry or a fit); 0 means exact. ``origin`` is its file, table or entry.
    ``assumed`` is the assumption in words, if it is not stated.
    """

    amount: float
    law: Law = "normal"
    origin: str = ""
    assumed: str = ""

    @classmethod
    def within(cls, half_width: float, law: Law, *, origin: str) -> Stated:
        """A tolerance: limits of a uniform law, or :data:`CUT` standard deviations."""
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
    """One real parameter of a device.

    ``value`` lies in its admissible range, ``low`` to ``high``; all in the SI ``unit``. ``stated`` is its uncertainty,
    None if not stated. ``tied`` are other names of the same parameter: equal radii. ``material`` is that of a length's
    layer.
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
        """The name without state, and those of tied lengths."""
        return (self.parsed.shared, *self.tied)

    @property
    def quantity(self) -> str:
        """Its dimension in files; dimensionless if the name does not determine it."""
        return self.parsed.quantity or "dimensionless"

    @property
    def law(self) -> Law:
        """The law of its uncertainty."""
        return self.stated.law if self.stated else "normal"

    @property
    def deviation(self) -> float:
        """Its standard uncertainty, 0 if not stated."""
        return self.stated.deviation if self.stated else 0.0

    @property
    def half_width(self) -> float:
        """Half the width of its law, 0 if not stated."""
        return self.stated.half_width if self.stated else 0.0

    @property
    def origin(self) -> str:
        """The file, table or entry of its uncertainty; empty without one."""
        return self.stated.origin if self.stated else ""

    @property
    def assumed(self) -> str:
        """The assumption about its uncertainty, in words; empty if stated."""
        return self.stated.assumed if self.stated else ""

    @property
    def tolerance(self) -> float | None:
        """The stated amount of its uncertainty; None if assumed or missing."""
        return self.stated.amount if self.stated and not self.stated.assumed else None

    @property
    def known(self) -> LengthUncertainty:
        """The uncertainty of a length: stated, or assumed by its role (`geometry.assumed`)."""
        return length_uncertainty(self.name, Dimension(self.value, self.tolerance), self.material)


def limits(name: str, value: float) -> tuple[float, float]:
    """Lowest and highest physical value (SI) of a coefficient. A modulus is positive, a loss dissipates energy.
    Coefficients that couple two motions may have either sign."""
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
    """A `text` with names in plain words, without sources of materials."""
    return _SOURCE.sub(r"\1", text).replace("_", " ")


def word_list(words: Sequence[str]) -> str:
    """Words as in "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def real_part(values: Mapping[str, complex], name: str) -> float:
    """A real or, with ``.loss``, imaginary part of `values`, by name."""
    parsed = ParameterName.parse(name)
    return parsed.part_of(complex(values[parsed.key]))


def placed(values: Mapping[str, complex], numbers: Mapping[str, float]) -> dict[str, complex]:
    """Complex `values` with some real or imaginary parts replaced. `numbers` are these parts by parameter name."""
    result = dict(values)
    for name, number in numbers.items():
        parsed = ParameterName.parse(name)
        old = complex(result[parsed.key])
        result[parsed.key] = complex(old.real, number) if parsed.is_loss else complex(number, old.imag)
    return result
