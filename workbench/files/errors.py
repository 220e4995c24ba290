"""Errors for mistakes in a user's input, and choices of names."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any

#: Characters of a received value in a message. Doubled, an array hides the description of the expected value.
SHOWN_CHARACTERS = 200

#: Names in a message. Doubled, the list of a folder of materials hides the nearest one.
LISTED = 15


@dataclass
class InputError(ValueError):
    """A mistake in a user's input. ``source`` is the file or command, ``field`` the place in it, ``value`` the received
    value, None if missing, and ``expected`` a description of a correct one; ``nearest`` lists valid choices close to a
    mistyped name. ``owner`` names the part of a device to which the field belongs."""

    source: str
    field: str
    value: object
    expected: str
    nearest: tuple[str, ...] = ()
    owner: str = ""

    def __str__(self) -> str:
        received = "missing" if self.value is None else f"received {_shown(self.value)}"
        field = f"{self.owner}, {self.field}" if self.owner else self.field
        return f"{self.source}: {field}: {received}; expected {self.expected}{hint(self.nearest)}"

    def __reduce__(self) -> tuple[Any, ...]:
        return (InputError, (self.source, self.field, self.value, self.expected, self.nearest, self.owner))


def hint(nearest: Iterable[str]) -> str:
    """The question for one of the `nearest` choices, or ""."""
    names = " or ".join(map(repr, nearest))
    return f"; did you mean {names}?" if names else ""


def file_error(path: Path, expected: str, nearest: tuple[str, ...] = ()) -> InputError:
    """The error for a file that cannot be read."""
    # The path of the working folder has no name.
    return InputError(str(path), "file", path.name or str(path), expected, nearest)


def _shown(value: object) -> str:
    """A received value on one line, cut off if it is long."""
    text = " ".join(line.strip() for line in repr(value).splitlines())
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}... ({len(text)} characters)"


def expect(value: object, kind: type, *, reader: str, source: str, field: str) -> None:
    """Raise for a value that is not of a `kind`.

    `reader` is the public function that reads one from a file.

    Raises:
        InputError: it is of another kind, such as the path of a file.
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InputError(source, field, value, f"{article} {kind.__name__}; read one with wb.{reader} (this is a "
                         f"{type(value).__name__})")


def expect_number(value: object, expected: str, *, source: str, field: str, low: float = -math.inf) -> float:
    """The finite number from a caller, not below `low`.

    `expected` describes it with its unit.

    Raises:
        InputError: anything else, such as a text with a unit.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value) or value < low:
        raise InputError(source, field, value, expected)
    return float(value)


def expect_whole(value: object, expected: str, *, source: str, field: str, low: int) -> int:
    """The whole number from a caller, not below `low`.

    Raises:
        InputError: anything else.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < low:
        raise InputError(source, field, value, expected)
    return int(value)


def one_of(names: Collection[str], name: object) -> str:
    """The choices for a message. For more than :data:`LISTED` choices, their count and the three nearest to `name`."""
    if len(names) <= LISTED:
        return "one of " + ", ".join(names)
    folded = {each.casefold(): each for each in names}
    near = difflib.get_close_matches(str(name).casefold(), folded, n=3, cutoff=0.0)
    return f"one of {len(names)} names, such as {', '.join(folded[each] for each in near)}"


def nearest_names(name: str, known: Iterable[str], *, count: int = 3) -> tuple[str, ...]:
    """Names in `known` similar to `name`, best first; case is ignored."""
    folded = {k.casefold(): k for k in known}
    return tuple(folded[m] for m in difflib.get_close_matches(name.casefold(), folded, n=count, cutoff=0.5))


def nearest_files(path: Path, wanted: Callable[[Path], bool]) -> tuple[str, ...]:
    """Names of `wanted` files with names similar to `path`. They are in its folder or, if there is no such folder, in
    the working directory."""
    folder = path.parent if path.parent.is_dir() else Path()
    return nearest_names(path.name, (each.name for each in folder.iterdir() if wanted(each)))


def choose(name: object, known: Iterable[str], *, source: str, field: str) -> str:
    """The `name` if it is one of `known`.

    Raises:
        InputError: it is not; with :func:`one_of` and the nearest names.
    """
    names = sorted(known)
    if isinstance(name, str) and name in names:
        return name
    raise InputError(source, field, name, one_of(names, name), nearest_names(str(name), names))
