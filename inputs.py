"""What people write in files: quantities with units, names from closed lists, and the errors that answer mistakes.

Everything inside the packages is a float in SI units. Text such as ``"2.02 mm"`` is read here, once, where a file is
read. Every complaint about a file is an :class:`InputError`, which always names the file, the field, the value that
was received, what was expected and, for a name, the nearest valid choice.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Factor to SI of every unit accepted in a file, by dimension. Temperatures are handled in :func:`parse_quantity`.
UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
    "peak-to-peak voltage": {"Vpp": 1.0, "mVpp": 1e-3},
    "power": {"W": 1.0, "mW": 1e-3},
    "resistance": {"ohm": 1.0, "Ohm": 1.0, "mohm": 1e-3, "kohm": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "speed": {"m/s": 1.0, "mm/us": 1e3},
    "viscosity": {"Pa s": 1.0, "mPa s": 1e-3, "uPa s": 1e-6},
    "piezoelectric": {"C/m^2": 1.0},
    "temperature": {"K": 1.0, "degC": 1.0},
    "inductance": {"H": 1.0, "mH": 1e-3, "uH": 1e-6, "nH": 1e-9},
    "capacitance": {"F": 1.0, "uF": 1e-6, "nF": 1e-9, "pF": 1e-12},
    "current": {"A": 1.0, "mA": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "diffusivity": {"m^2/s": 1.0},
    "dimensionless": {"1": 1.0, "%": 1e-2},
}


@dataclass
class InputError(ValueError):
    """A mistake in something a person wrote, with all that is needed to mend it.

    ``source`` is the file (or command) at fault, ``field`` the place in it, ``value`` what was received and
    ``expected`` what would have been right; ``nearest`` lists valid choices close to a mistyped name.
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
    """Names in `known` that `name` may have been meant to be, best first (case is ignored)."""
    folded = {k.casefold(): k for k in known}
    return tuple(folded[m] for m in difflib.get_close_matches(name.casefold(), folded, n=count, cutoff=0.5))


def choose(name: object, known: Iterable[str], *, source: str, field: str) -> str:
    """`name` if it is one of `known`; otherwise an :class:`InputError` that lists them and the nearest."""
    names = sorted(known)
    if isinstance(name, str) and name in names:
        return name
    raise InputError(source, field, name, "one of " + ", ".join(names), nearest_names(str(name), names))


_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")


def parse_quantity(text: object, dimension: str, *, source: str, field: str) -> float:
    """The SI value of a text such as ``"2.02 mm"``. `dimension` is a key of :data:`UNITS`.

    A bare number is refused unless the dimension is dimensionless: a length without its unit is the commonest
    mistake in a chip file. Temperatures in degC are returned in kelvin.

    Raises:
        InputError: no number, no unit, an unknown unit, or a value that is not finite.
    """
    units = UNITS[dimension]
    example, named = next(iter(units)), f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"
    if dimension == "dimensionless" and isinstance(text, int | float) and not isinstance(text, bool):
        if not math.isfinite(text):
            raise InputError(source, field, text, "a finite number")
        return float(text)
    if isinstance(text, bool) or not isinstance(text, str):
        raise InputError(source, field, text, f'{named} with its unit, for example "1.5 {example}"')
    match = _NUMBER.match(text)
    if match is None:
        raise InputError(source, field, text, f'{named} with its unit, for example "1.5 {example}"')
    number, unit = float(match.group(1)), match.group(2) or ("1" if dimension == "dimensionless" else "")
    if unit not in units:
        expected = f"{named} in one of {', '.join(units)}"
        raise InputError(source, field, text, expected, nearest_names(unit, units) if unit else ())
    if not math.isfinite(number):
        raise InputError(source, field, text, "a finite number")
    return number + 273.15 if unit == "degC" else number * units[unit]


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: the file does not exist, is not text, or is not TOML (the parser's line and column are kept).
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        folder = path.parent if path.parent.is_dir() else Path()
        near = nearest_names(path.name, (p.name for p in folder.iterdir() if p.suffix == ".toml"))
        raise InputError(str(path), "file", path.name, "an existing file", near) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "file", path.name, f"a readable text file ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), "TOML syntax", str(error), "valid TOML") from None


def refuse_unknown_keys(table: Mapping[str, object], allowed: Iterable[str], *, source: str, field: str) -> None:
    """Raise an :class:`InputError` at the first key of `table` that is not in `allowed`."""
    names = sorted(allowed)
    for key in table:
        if key not in names:
            raise InputError(source, f"{field}.{key}" if field else key, key, "one of " + ", ".join(names),
                             nearest_names(key, names))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path of the same name to write to, whose file takes the place of `path` once it is whole.

    A reader sees either the old file or the new one, never a part of it, and a power cut leaves one of the two. A
    device or a pipe is written to, and stays what it is.
    """
    replaceable = path.is_file() or not path.exists()
    if replaceable:
        path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent if replaceable else None, prefix=f".{path.name}.") as folder:
        whole = Path(folder) / path.name
        yield whole
        if not replaceable:
            path.write_bytes(whole.read_bytes())
            return
        with whole.open("rb") as stream:
            os.fsync(stream.fileno())
        os.replace(whole, path)
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make a new name in a folder last."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write `content` to `path` so that a reader sees either the old file or the new one (:func:`replacing`)."""
    with replacing(path) as whole:
        whole.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
