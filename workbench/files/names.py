"""Checks of names in a user's files, and text safe to print.

Names are of two kinds. A name that becomes part of a file name (a state, a recording of a batch, a material and its
source) has letters, digits and a few marks, and never a part of a path. A title (a chip, a study, a note) is any
printable text on one line.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from workbench.files.errors import InputError
from workbench.files.quantities import ProgramSource

#: Marks that a name may have beside letters and digits.
MARKS = " .+-_"

#: Marks in a part of a parameter's name, such as ``pzt4/disc_7.density``, in which dots and blanks end a part.
NUMBER_MARKS = "-_"

#: Most bytes (UTF-8) of a name. A file name of one or two names and a suffix then fits in 255 bytes.
MOST_BYTES = 80

#: Categories of Unicode that act on a terminal or end a line: controls, surrogates, separators of lines.
_CONTROLS = ("Cc", "Cs", "Zl", "Zp")

#: Characters that change the direction of the text after them, so that it can look like another text.
_TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def check_name(name: object, *, source: str, field: str, form: str = "name", marks: str = MARKS) -> str:
    """The `name` if it can be part of a file name.

    Args:
        form: the kind of name; "material/source" is two names with a slash between them.
        marks: allowed characters beside letters and digits of any script.

    Raises:
        InputError: another character, a mark at the start, a blank or dot at the end, or more than :data:`MOST_BYTES`
            bytes. The nearest choice is the name without them.
    """
    count = form.count("/")
    parts = name.split("/", count) if isinstance(name, str) else []
    if isinstance(name, str) and len(parts) == count + 1 and all(_is_name(part, marks) for part in parts):
        return name
    shown = " ".join((*(["blanks and"] if " " in marks else []), *marks.replace(" ", "")))
    raise InputError(
        _placed(source, name), field, name,
        f"a {form} in letters, digits, {shown}, a letter or digit first, no blank or dot last, at most {MOST_BYTES} "
        "bytes, as it names files and folders", _nearest([_as_name(part, marks) for part in parts], count + 1))


def check_title(title: object, *, source: str, field: str) -> str:
    """The `title` if it is printable text on one line.

    Raises:
        InputError: a line end, a control character, one that changes the direction of text, or nothing printable at
            all. The nearest choice is the title without them.
    """
    if isinstance(title, str) and title.strip() and (title.isprintable() or not any(map(_is_control, title))):
        return title
    plain = "" if not isinstance(title, str) else " ".join("".join(
        " " if _is_control(each) else each for each in title).split())
    raise InputError(_placed(source, title), field, title,
                     "a text on one line, without line ends and control characters", _nearest([plain], 1))


def visible(text: str, *, keep: str = "") -> str:
    r"""The `text` with control characters, except `keep`, as escapes such as ``\x1b``."""
    if text.isprintable():
        return text
    return "".join(each.encode("unicode_escape").decode("ascii") if _is_control(each) and each not in keep else each
                   for each in text)


def _is_control(character: str) -> bool:
    return character in _TURNING or unicodedata.category(character) in _CONTROLS


def _is_name(part: str, marks: str) -> bool:
    return bool(part) and _starts(part[0]) and part[-1] not in " ." and all(
        _is_of_word(each) or each in marks for each in part) and len(part.encode()) <= MOST_BYTES


def _starts(character: str) -> bool:
    # Matplotlib leaves names that begin with an underscore out of legends.
    return unicodedata.category(character)[0] in "LN"


def _is_of_word(character: str) -> bool:
    """Whether it is a letter, a digit, or a combining accent."""
    return unicodedata.category(character)[0] in "LNM"


def _as_name(part: str, marks: str) -> str:
    """The nearest valid name; empty if there is none."""
    kept = "".join(each if _is_of_word(each) or each in marks else "\0" for each in part)
    # A run of other characters becomes one underscore; the dots of "../" go with it.
    kept = re.sub(r"[\0._]*\0[\0._]*", "_", kept).rstrip("_" if "\0" in kept else " ")
    while kept and not _starts(kept[0]):
        kept = kept[1:]
    return kept.encode()[:MOST_BYTES].decode(errors="ignore").rstrip(" .")


def _nearest(parts: list[str], count: int) -> tuple[str, ...]:
    return ("/".join(parts),) if len(parts) == count and all(parts) else ()


def _placed(source: str, name: object) -> str:
    """The `source`, with the line of the name in a TOML file."""
    if not isinstance(name, str) or isinstance(source, ProgramSource) or not source.endswith(".toml"):
        return source
    try:
        lines = Path(source).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return source
    # A statement on one line is valid TOML.
    line = next((number for number, line in enumerate(lines, 1) if name in _texts(line)), None)
    return source if line is None else f"{source}, line {line}"


def _texts(line: str) -> set[str]:
    """The keys and texts in one line of TOML."""
    try:
        return set(_within(tomllib.loads(line)))
    except (ValueError, RecursionError):
        return set()


def _within(content: Any) -> Iterator[str]:
    if isinstance(content, Mapping):
        for key, each in content.items():
            yield key
            yield from _within(each)
    elif isinstance(content, list):
        for each in content:
            yield from _within(each)
    elif isinstance(content, str):
        yield content
