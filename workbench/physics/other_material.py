"""Another material than stated in a region. Examples are PETG for PLA, or glycerol in water."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workbench.physics.term import Admissible, Formula, FreeParameter, Integral, ModelError, Monomial, Term, times

#: Share of the way from the stated material to the other one.
ADMISSIBLE = Admissible(0.0, 1.0, "1", "from the stated material to the other one of the registry, or a mixture")


@dataclass(frozen=True)
class OtherMaterial(Term):
    """Constants of a region between those of two materials.

    A constant c of the base ``terms`` is replaced by c (c' / c)^s; s = 1 is the other material. Each coefficient g of
    these terms, a product of powers n of constants, gets

        g (prod (c' / c)^(n s) - 1)

    so that constants lie between the two materials like those of mixtures (Lichtenecker 1926, Phys. Z. 27, 115);
    complex ones have a phase between the two phases, which is passive if both are. The ratios are fixed, and c may
    move: the other material has the same relative uncertainty as the stated one. Parameters ``<name>.share`` s, and
    ``<name>.<constant>_ratio`` for every constant of the terms.
    """

    terms: tuple[Term, ...]
    name: str

    @property
    def share(self) -> str:
        """The full name of s."""
        return f"{self.name}.share"

    @property
    def needs_axis(self) -> bool:
        return any(term.needs_axis for term in self.terms)

    def free(self) -> tuple[FreeParameter, ...]:
        return (FreeParameter(self.share, 0.0, ADMISSIBLE),)

    def constants(self) -> tuple[str, ...]:
        """Names, without the material's, of the constants in the terms."""
        return tuple(dict.fromkeys(name.rpartition(".")[2] for term in self.terms for integral in term.integrals()
                                   for name in integral.coefficient.parameters))

    def ratio(self, constant: str) -> str:
        """The full name of the ratio c' / c of a constant."""
        return f"{self.name}.{constant}_ratio"

    def integrals(self) -> tuple[Integral, ...]:
        found = []
        for integral in (each for term in self.terms for each in term.integrals()):
            if not isinstance(integral.coefficient, Monomial):
                raise ModelError(f"{self.name!r}: a coefficient in {integral.domain!r} is not a product of constants")
            powers = {name.rpartition(".")[2]: power for name, power in integral.coefficient.factors}
            symbols = (("s", self.share), *((constant, self.ratio(constant)) for constant in powers))
            exchanged = Formula(Exchanged(tuple(powers.items())), symbols)
            found.append(replace(integral, coefficient=times(integral.coefficient, exchanged)))
        return tuple(found)


@dataclass(frozen=True)
class Exchanged:
    """The law prod r^(n s) - 1 of ratios r. Their ``powers`` are n."""

    powers: tuple[tuple[str, float], ...]

    @cached_property
    def _exponents(self) -> dict[str, float]:
        return dict(self.powers)

    def __call__(self, v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
        rate = sum(power * complex(np.log(v[name])) for name, power in self._exponents.items())
        whole = complex(np.exp(v["s"] * rate))
        slopes = {name: whole * v["s"] * power / v[name] for name, power in self._exponents.items()}
        return whole - 1.0, {"s": whole * rate, **slopes}
