"""Differences of two materials, number by number."""

from __future__ import annotations

import math
from dataclasses import dataclass

from materials.kinds import Material
from workbench.files.errors import InputError


@dataclass(frozen=True)
class Difference:
    """One number of two materials, SI.

    ``percent`` is the second relative to the first, None if the first is zero. ``deviations`` is the difference in
    units of the combined standard uncertainty, None if an uncertainty is unknown or both are zero.
    """

    parameter: str
    first: float
    second: float
    percent: float | None
    deviations: float | None


def differences(first: Material, second: Material) -> tuple[Difference, ...]:
    """Differences of all numbers; real parts and losses (`"c33 loss"`) are separate.

    A loss is omitted if both are zero; so is a number that only one of two fluids has.

    Raises:
        InputError: materials of different kinds.
    """
    if type(first) is not type(second):
        raise InputError("materials", "kind", f"{type(first).__name__} {first.name}, {type(second).__name__} "
                         f"{second.name}", "two materials of one kind")
    found = []
    ours, theirs = first.parameters(), second.parameters()
    for name in (name for name in ours if name in theirs):
        a, b = complex(ours[name]), complex(theirs[name])
        values = first.values.get(name), second.values.get(name)
        found.append(_difference(name, a.real, b.real, [None if v is None else v.uncertainty for v in values]))
        if a.imag != 0.0 or b.imag != 0.0:
            spreads = [None if v is None else v.loss_uncertainty for v in values]
            found.append(_difference(f"{name} loss", a.imag, b.imag, spreads))
    return tuple(found)


def _difference(parameter: str, first: float, second: float, spreads: list[float | None]) -> Difference:
    known = [spread for spread in spreads if spread is not None]
    combined = math.hypot(*known) if len(known) == len(spreads) else 0.0
    return Difference(parameter, first, second,
                      None if first == 0.0 else 100.0 * (second / first - 1.0),
                      None if combined == 0.0 else (second - first) / combined)
