"""Errors for mistakes in a user's input, and names chosen from closed lists."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


@dataclass
class InputError(ValueError):
    """A mistake in a user's input, with all that is needed to mend it.

    ``source`` is the file (or command) at fault, ``field`` the place in it, ``value`` the received value and
    ``expected`` a description of a correct one; ``nearest`` lists valid choices close to a mistyped name.
    """

    source: str
    field: str
    value: object
    expected: str
    nearest: tuple[str, ...] = ()

    def __str__(self) -> str:
        hint = f"; did you mean {' or '.join(repr(n) for n in self.nearest)}?" if self.nearest else ""
        return f"{self.source}: {self.field}: received {self.value!r}; expected {self.expected}{hint}"

    def __reduce__(self) -> tuple[Any, ...]:
        return (InputError, (self.source, self.field, self.value, self.expected, self.nearest))


def nearest_names(name: str, known: Iterable[str], *, count: int = 3) -> tuple[str, ...]:
    """Names in `known` that `name` may stand for, best first (case is ignored)."""
    folded = {k.casefold(): k for k in known}
    return tuple(folded[m] for m in difflib.get_close_matches(name.casefold(), folded, n=count, cutoff=0.5))


def choose(name: object, known: Iterable[str], *, source: str, field: str) -> str:
    """The `name` if it is one of `known`; otherwise an :class:`InputError` that lists them and the nearest."""
    names = sorted(known)
    if isinstance(name, str) and name in names:
        return name
    raise InputError(source, field, name, "one of " + ", ".join(names), nearest_names(str(name), names))
