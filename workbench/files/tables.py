"""TOML files and their tables."""

from __future__ import annotations

import codecs
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any

from workbench.files.errors import InputError, choose, file_error, nearest_files, nearest_names, one_of
from workbench.files.quantities import parse_quantity

#: Most levels of tables and lists in a file. Files of the workbench have at most eight; Python's own limits for reading
#: and printing a value are near a thousand.
DEEPEST = 50

#: A line that begins with a key of more parts than that.
LONG_KEY = re.compile(rf"\s*\[{{0,2}}\s*[\w-]+(?:\s*\.\s*[\w-]+){{{DEEPEST},}}\s*[]=]")

#: The parser's message for a repeated table.
TWICE = re.compile(r"Cannot declare \((?P<parts>.*?)\) twice \((?P<place>.*?)\)")

#: The parser's message for a repeated key, which names its place alone.
OVERWRITTEN = re.compile(r"Cannot overwrite a value \((?P<place>at line (?P<line>\d+).*?)\)")
#: The key at the beginning of a line.
KEY = re.compile(r"\s*(?P<key>[\w.\s\"'-]+?)\s*=")

#: Byte-order marks of encodings that TOML does not have; those of UTF-32 begin as those of UTF-16 do.
MARKS = ((codecs.BOM_UTF32_LE, "UTF-32"), (codecs.BOM_UTF32_BE, "UTF-32"), (codecs.BOM_UTF16_LE, "UTF-16"),
         (codecs.BOM_UTF16_BE, "UTF-16"))

#: Whole numbers of TOML have 64 bits.
LARGEST = 2**63


def parse_toml(text: str, *, source: str, field: str = "TOML syntax") -> dict[str, Any]:
    """The content of TOML text from a `source`, in its `field`.

    Raises:
        InputError: it is not TOML (the parser's line and column are kept), or has more levels than :data:`DEEPEST`.
    """
    # The parser's time grows with the square of the number of parts of a key.
    if any(LONG_KEY.match(line) for line in text.splitlines()):
        raise InputError(source, field, f"a key of more than {DEEPEST} parts",
                         f"valid TOML, with at most {DEEPEST} levels of tables and lists")
    return _parsed(_loaded, text, "valid TOML", source=source, field=field)


def _loaded(text: str) -> dict[str, Any]:
    """The content of TOML text, with clear errors for repetitions."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if again := OVERWRITTEN.search(str(error)):
            # The value of the key may begin on a line above.
            above = map(KEY.match, reversed(text.splitlines()[:int(again["line"])]))
            key = next((found["key"] for found in above if found), "")
            raise ValueError(f"the key {key!r} a second time ({again['place']})") from None
        twice = TWICE.search(str(error))
        if twice is None:
            raise
        name = ".".join(part.strip(" '\"") for part in twice["parts"].split(",") if part.strip())
        raise ValueError(f"the table [{name}] a second time ({twice['place']})") from None


def parse_json(text: str, *, source: str, expected: str) -> Any:
    """The content of JSON text from a `source`.

    `expected` describes the file.

    Raises:
        InputError: it is not JSON, or has more levels than :data:`DEEPEST`.
    """
    return _parsed(json.loads, text, expected, source=source, field="JSON syntax")


def _parsed(parse: Callable[[str], Any], text: str, expected: str, *, source: str, field: str) -> Any:
    levels = f"{expected}, with at most {DEEPEST} levels of tables and lists"
    try:
        content = parse(text)
    except RecursionError:
        raise InputError(source, field, "deeper levels than can be read", levels) from None
    except ValueError as error:
        # For thousands of digits, Python's message has a remedy for programmers after the semicolon.
        raise InputError(source, field, str(error).partition(";")[0], expected) from None
    # Level by level, since a recursion could fail as the parser's does.
    level = [content]
    for _ in range(DEEPEST + 1):
        level = [each for table in level if isinstance(table, Mapping | list)
                 for each in (table.values() if isinstance(table, Mapping) else table)]
        if any(isinstance(each, int) and not -LARGEST <= each < LARGEST for each in level):
            raise InputError(source, field, "a whole number of more than 64 bits",
                             f"{expected}, with a decimal point in numbers above {LARGEST - 1}")
    if level:
        raise InputError(source, field, f"more than {DEEPEST} levels", levels)
    return content


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file, with or without a byte-order mark.

    Raises:
        InputError: the file does not exist, is not text in UTF-8, or is not TOML (the parser's line and column are
            kept).
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        near = nearest_files(path, lambda each: each.suffix == ".toml")
        raise file_error(path, "an existing file", near) from None
    except IsADirectoryError:
        inside = sorted(path.glob("*.toml"), key=lambda each: (each.name != "chip.toml", each.name))
        raise file_error(path, "a readable text file; this is a folder", tuple(map(str, inside[:1]))) from None
    except (OSError, ValueError) as error:
        # A path with a zero byte is a ValueError.
        raise file_error(path, f"a readable text file ({error})") from None
    return parse_toml(_utf8(data, str(path)), source=str(path))


def _utf8(data: bytes, source: str) -> str:
    """The text of a file, without its mark, with plain line ends."""
    expected = "text in UTF-8; save it as UTF-8 in the editor"
    encoding = next((name for mark, name in MARKS if data.startswith(mark)), "")
    if encoding:
        raise InputError(source, "line 1", f"text in {encoding}", expected)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        letter = data[error.start:error.start + 1]
        raise InputError(source, f"line {line}", f"byte 0x{letter.hex()}, {letter.decode('latin-1')!r} in Latin-1, "
                         "which is no UTF-8", expected) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


@dataclass(frozen=True)
class FileTable:
    """A table of a file and its place there, with checked keys.

    ``source`` is the file, ``field`` the dotted name of the table in it (empty: the whole file). Every method for a key
    raises an :class:`InputError` with file, field, value and expectation for an invalid value. A default replaces a
    missing key; without a default the key is required.
    """

    source: str
    field: str
    content: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path) -> FileTable:
        """The whole content of a TOML file as a table.

        Raises:
            InputError: as in :func:`read_toml`.
        """
        return cls(str(path), "", read_toml(path))

    @classmethod
    def made(cls, source: str, content: Mapping[str, Any]) -> FileTable:
        """A table of values from a program. Tuples and arrays become lists, and paths become texts. Values of None are
        omitted."""
        return cls(source, "", _plain(content))

    @classmethod
    def of(cls, content: object, *, source: str, field: str, expected: str = "a table") -> FileTable:
        """The `content` as a table.

        Raises:
            InputError: it is not a table.
        """
        if not isinstance(content, Mapping):
            raise InputError(source, field, content, expected)
        return cls(source, field, content)

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def __iter__(self) -> Iterator[str]:
        return iter(self.content)

    def at(self, key: str) -> str:
        """The dotted name of a key."""
        return f"{self.field}.{key}" if self.field else key

    def error(self, key: str, expected: str, nearest: tuple[str, ...] = ()) -> InputError:
        """The error for the value of `key`, with the `expected` one."""
        return InputError(self.source, self.at(key), self.content.get(key), expected, nearest)

    def only(self, keys: Iterable[str], *, renamed: Mapping[str, str] = MappingProxyType({})) -> FileTable:
        """The table itself, if all its keys are in `keys`.

        `renamed` maps former names to present ones.

        Raises:
            InputError: another key.
        """
        known = sorted(keys)
        for key in self.content:
            if key not in known:
                hint = f"; {key!r} was renamed to {renamed[key]!r}" if key in renamed else ""
                raise InputError(self.source, self.at(key), key, one_of(known, key) + hint,
                                 () if hint else nearest_names(key, known))
        return self

    def required(self, key: str, expected: str) -> Any:
        """The value of a required key, of any type."""
        if key not in self.content:
            raise self.error(key, expected)
        return self.content[key]

    def text(self, key: str, default: str | None = None, *, expected: str = "a text") -> str:
        """A text, not empty unless there is a default."""
        value = self.content.get(key, default)
        if not isinstance(value, str) or (default is None and not value):
            raise self.error(key, expected)
        return value

    def optional_text(self, key: str) -> str | None:
        """A text that is not empty, or None without the key."""
        return self.text(key) if key in self else None

    def texts(self, key: str, default: tuple[str, ...] | None = None, *, expected: str = "a list of texts"
              ) -> tuple[str, ...]:
        """A list of texts, which may be empty."""
        if key not in self and default is not None:
            return default
        value = self.content.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.error(key, expected)
        return tuple(value)

    def entries(self, key: str, *, expected: str) -> tuple[Any, ...]:
        """A list of anything."""
        value = self.content.get(key)
        if not isinstance(value, list):
            raise self.error(key, expected)
        return tuple(value)

    def quantity(self, key: str, dimension: str, default: float | None = None) -> float:
        """A quantity with its unit, in SI. `dimension` is a key of `workbench.files.quantities.UNITS`."""
        if key not in self and default is not None:
            return default
        return parse_quantity(self.content.get(key), dimension, source=self.source, field=self.at(key))

    def optional_quantity(self, key: str, dimension: str) -> float | None:
        """A quantity as in :meth:`quantity`, or None without the key."""
        return self.quantity(key, dimension) if key in self else None

    def quantities(self, key: str, dimension: str, *, expected: str, numbered: bool = False) -> tuple[float, float]:
        """Two quantities with their units, in SI. If `numbered`, errors name ``key[0]`` or ``key[1]``."""
        value = self.content.get(key)
        if not isinstance(value, list) or len(value) != 2:
            raise self.error(key, expected)
        first, second = (parse_quantity(each, dimension, source=self.source,
                                        field=f"{self.at(key)}[{index}]" if numbered else self.at(key))
                         for index, each in enumerate(value))
        return first, second

    def optional_number(self, key: str) -> float | None:
        """A finite number without unit, or None without the key."""
        if key not in self:
            return None
        value = self.content[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.error(key, "a finite number")
        return float(value)

    def whole(self, key: str, default: int | None = None, *, low: int, high: int) -> int:
        """A whole number from `low` to `high`."""
        value = self.content.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, f"a whole number from {low} to {high}")
        return value

    def flag(self, key: str, *, default: bool = False) -> bool:
        """A truth value."""
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, "true or false")
        return value

    def choice(self, key: str, known: Iterable[str], default: str | None = None) -> str:
        """One of the names in `known`."""
        return choose(self.content.get(key, default), known, source=self.source, field=self.at(key))

    def path(self, key: str, folder: Path, *, expected: str) -> Path:
        """An existing file, relative to `folder`.

        Raises:
            InputError: there is no such file; it has files of similar names.
        """
        found = folder / self.text(key, expected=expected)
        if not found.is_file():
            raise self.error(key, f"{expected} that is there", nearest_files(found, Path.is_file))
        return found

    def table(self, key: str, *, expected: str = "a table") -> FileTable:
        """The table of a key, empty without the key."""
        return FileTable.of(self.content.get(key, {}), source=self.source, field=self.at(key), expected=expected)

    def tables(self, key: str, *, expected: str) -> tuple[FileTable, ...]:
        """The list of tables of a key, empty without the key."""
        rows = self.content.get(key, [])
        if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
            raise self.error(key, expected)
        return tuple(FileTable(self.source, f"{self.at(key)}[{index}]", row) for index, row in enumerate(rows))


def _plain(value: Any) -> Any:
    """A value in the types of a TOML file, where possible."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items() if each is not None}
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, list | tuple) or (hasattr(value, "tolist") and hasattr(value, "dtype")):
        # An array of no dimensions is a number.
        listed = value.tolist() if hasattr(value, "tolist") else value
        return [_plain(each) for each in listed] if isinstance(listed, list | tuple) else listed
    return value
