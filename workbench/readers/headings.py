"""The meaning of a column's heading: quantity, unit and sign.

A heading is a label, words and a unit. The unit stands in brackets, after a slash, after "in", or last after a blank or
an underscore; the label of a trace or channel ("Tr1:", "Trc1_") stands first. The words must name one part (magnitude,
phase, real or imaginary part) of one quantity (impedance, admittance, reflection, transmission), in any order, with
filling words between them, or one element of an equivalent circuit. A heading with one unknown word is not understood.
``headings.toml`` holds the vocabulary. ``tests/test_workbench_readers_headings.py`` lists headings that are understood
and headings that are not.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import NamedTuple

from workbench.readers.quantities import ELEMENT_UNITS

SYMBOLS: Mapping[str, str] = {"impedance": "Z", "admittance": "Y", "reflection": "S11", "transmission": "S21"}
#: Symbols of the elements that are a part of an impedance or of an admittance.
RECTANGULAR: Mapping[tuple[str, str], str] = {("real", "impedance"): "Rs", ("imaginary", "impedance"): "X",
                                              ("real", "admittance"): "G", ("imaginary", "admittance"): "B"}
_OF_ELEMENT: Mapping[str, str] = {"C": "capacitance", "L": "inductance", "R": "impedance", "D": "ratio", "Q": "ratio"}
#: Letters that may be joined to the word of a part ("zreal", "argz"), by the quantity they name.
_LETTERS: Mapping[str, str] = {"z": "impedance", "y": "admittance"}

_TOKEN = re.compile(r"[^\W\d_]+|\d+|\S|_")
#: A word of one script, or a sign: "Cp" and not "电容Cp".
_WORD = re.compile(r"[a-z\u00c0-\u024f]+|[\u0370-\u03ff]|∠")
_BRACKETS = re.compile(r"[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]")
_IN = re.compile(r"(.*\S)\s+in\s+(\S+)", re.IGNORECASE)
_LAST = re.compile(r"(.*[^\s_,-])[\s_,-]+([^\s_,-]+)")
_EMPTY = re.compile(r"\s*[(\[]\s*[)\]]\s*$")
#: One spelling of signs: primes as apostrophe and quotation mark, ASCII minus.
_SIGNS = str.maketrans({"″": '"', "“": '"', "”": '"', "º": "°", "′": "'", "’": "'", "`": "'"})


@dataclass(frozen=True)
class Heading:
    """Meaning of a column's heading.

    ``part`` is "frequency", "magnitude", "phase", "real" or "imaginary", or "whole" for a quantity without a part
    ("Z"). ``kind`` is "impedance", "admittance", "reflection", "transmission" or "" if the heading does not state it.
    For an element of an equivalent circuit the part is "element" and the kind its symbol (Cp, D; C and L if series or
    parallel is not stated); for a standing wave ratio or return loss the part is "scalar". ``unit`` is that of
    `Quantity` or of a frequency, "" if none is given; ``strange_unit`` is an unknown unit. ``negated`` if the heading
    has a minus sign, ``primed`` if it is written Z'', which some take for -Im Z. ``port`` is the port of a reflection.
    """

    part: str
    kind: str = ""
    unit: str = ""
    strange_unit: str = ""
    negated: bool = False
    primed: bool = False
    port: int = 1


class _Word(NamedTuple):
    """A word of the vocabulary: ``part``, ``kind``, and its ``role`` beside those."""

    part: str = ""
    kind: str = ""
    role: str = ""


class _Vocabulary(NamedTuple):
    """The content of ``headings.toml``; ``units`` are (quantity, unit, pattern)."""

    words: Mapping[str, _Word]
    units: Sequence[tuple[str, str, re.Pattern[str]]]
    lost_ohm: re.Pattern[str]
    spellings: Sequence[tuple[re.Pattern[str], str]]
    patterns: Mapping[str, re.Pattern[str]]


@cache
def _vocabulary() -> _Vocabulary:
    content = tomllib.loads(resources.files("workbench.readers").joinpath("headings.toml").read_text("utf-8"))
    words = {word: _Word(entry.get("part", ""), entry.get("kind", ""), entry.get("role", ""))
             for entry in content["words"] for word in entry["words"]}
    words |= {word: _Word("element", symbol) for symbol, names in content["elements"].items() for word in names}
    lost, known = content["ohm"]["lost"], content["ohm"]["known"]
    units = [(quantity, unit, re.compile(pattern.replace("OHM", f"(?:{known}|{lost})")))
             for quantity, patterns in content["units"].items() for unit, pattern in patterns.items()]
    return _Vocabulary(words, units, re.compile(f"(?:{lost})$"),
                       [(re.compile(pattern), spelling) for pattern, spelling in content["spellings"].values()],
                       {name: re.compile(pattern) for name, pattern in content["patterns"].items()})


def understand(heading: str) -> Heading | None:
    """Meaning of a heading with one part of one quantity, or None.

    A frequency and an element of a circuit are quantities too.
    """
    text = _plain(heading)
    found = _understood(text)
    if found is None or found.strange_unit:
        bare = _vocabulary().patterns["label"].sub(" ", _EMPTY.sub("", text)).strip(" :_")
        other = _understood(bare) if bare != text else None
        if other is not None and (found is None or not other.strange_unit):
            found = other
    return found


def apparent_meaning(heading: str) -> Heading | None:
    """Apparent meaning of a heading that is not understood, or None.

    It is the meaning of its known words and of its unit, if they name one part of one quantity.
    """
    text = _plain(heading)
    last = _LAST.fullmatch(text)
    # An s is a second, and a letter without a mark is no unit.
    units = [unit for _, unit in _split(text) if unit != "s"]
    units += [unit for unit in (last[2] if last else "", text) if len(unit) > 1 or not unit.isalpha()]
    # One letter may be anything, unless a unit or another script sets it apart.
    letters = any(map(is_unit, units)) or any(letter.isalpha() and not unicodedata.name(letter, "").startswith(
        ("LATIN", "GREEK")) for letter in text)
    named = [word for token in _WORD.findall(text.casefold())
             if (len(token) > 1 or letters or not token.isascii()) and (word := _word(token)) is not None
             and not (len(token) == 1 and any(unit.casefold() == token for unit in units))]
    named = [word for word in named if not word.role and word.part != "scalar"]
    parts = {word.part for word in named if word.part} | ({"magnitude"} if text.count("|") == 2 else set())
    kinds = {word.kind for word in named if word.kind}
    found = _joined(parts, kinds)
    if found is None and parts | kinds:
        return None
    bare = [found] if found else [Heading("whole"), Heading("frequency"), Heading("element", "C"),
                                  Heading("element", "L")]
    known = next((known for each in bare for unit in units if (known := find_unit(unit, each))), None)
    if known is None and any(("ratio", "dB") in _spelled(unit) for unit in units):
        known = Heading("magnitude", min(kinds, default=""), "dB")
    return known or found


def is_series(heading: str) -> bool:
    """Whether a heading of a resistance states that it is in series."""
    return _vocabulary().patterns["series"].search(heading) is not None


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any known quantity."""
    return bool(units_of(text))


def units_of(text: str) -> set[str]:
    """The units of any quantity that a text may be."""
    return {unit for _, unit in _spelled(_plain(text).strip("()[]{}<> "))}


def find_unit(text: str, bare: Heading) -> Heading | None:
    """The heading with its unit, None if the words contradict."""
    lost = _vocabulary().lost_ohm.search(text) is not None
    if lost and bare.part == "phase":
        return bare
    if lost and bare.kind not in ("impedance", "Rp"):
        return None
    return next((suited for quantity, unit in _spelled(text) if (suited := _suited(bare, quantity, unit))), None)


def _suited(bare: Heading, quantity: str, unit: str) -> Heading | None:
    """The heading with the `unit` of a `quantity`, None if unsuited."""
    part, kind = bare.part, bare.kind
    sized = part not in ("frequency", "phase")
    if part == "scalar":
        suits = True
    elif part == "element":
        allowed = ELEMENT_UNITS.get(kind, {**ELEMENT_UNITS["Cp"], **ELEMENT_UNITS["Lp"]})
        suits = _OF_ELEMENT[kind[0]] == quantity and unit in allowed
    elif quantity in ("frequency", "phase"):
        # "Z (deg)" can only be the phase of Z.
        part = "phase" if (part, quantity) == ("whole", "phase") else part
        suits = part == quantity
    else:
        # The unit dB is that of a magnitude, whatever the words leave open.
        suits = sized and (unit != "dB" or part in ("magnitude", "whole"))
        if quantity == "ratio":
            suits = suits and kind in ("reflection", "transmission")
            part = "magnitude" if unit == "dB" else part
        else:
            suits = suits and quantity in SYMBOLS and kind in ("", quantity)
            kind = quantity
    return replace(bare, part=part, kind=kind, unit=unit, strange_unit="") if suits else None


def _spelled(text: str) -> list[tuple[str, str]]:
    """The units that a text spells, each with its quantity."""
    return [(quantity, unit) for quantity, unit, pattern in _vocabulary().units if pattern.fullmatch(text)]


def _understood(text: str) -> Heading | None:
    patterns = _vocabulary().patterns
    text = patterns["zplot"].sub(r"\1", text)
    if patterns["return_loss"].search(text):
        return Heading("scalar", "reflection")
    ports = patterns["ports"].search(text)
    if ports is not None:
        return _scattering(text, ports)
    strange = None
    for words, unit in _split(text):
        found = _meaning(words)
        if found is not None:
            known = find_unit(unit, found)
            if known is not None:
                return known
            strange = strange or replace(found, unit="", strange_unit=unit)
    whole = _meaning(text)
    if whole is not None:
        return whole
    # The last word of a heading is a unit only if it is known as one.
    last = _LAST.fullmatch(text)
    found = None if last is None else _meaning(last[1])
    known = None if last is None or found is None else find_unit(last[2], found)
    return known or strange


def _scattering(text: str, ports: re.Match[str]) -> Heading | None:
    """Meaning of a heading with S11, S21, Z11 ..."""
    before, after, to, of = text[:ports.start()], text[ports.end():], ports[2], ports[3]
    if ports[1].casefold() in _LETTERS:
        # With a single port, the parameter of the port is that of the device.
        return _understood(before + ports[1] + after) if to == of == "1" else None
    if to != of and {to, of} != {"1", "2"}:
        return None
    found = _understood(f"{before} {'reflection' if to == of else 'transmission'} {after}".strip())
    return None if found is None else replace(found, port=int(to))


def _plain(text: str) -> str:
    """One spelling of signs and words, by the table ``spellings``."""
    text = re.sub("[−–]", "-", unicodedata.normalize("NFKC", text.translate(_SIGNS))).replace("''", '"').strip()
    for pattern, spelling in _vocabulary().spellings:
        text = pattern.sub(spelling, text)
    return text


def _split(text: str) -> Iterator[tuple[str, str]]:
    """Every way to split a heading into words and a marked unit."""
    for found in _BRACKETS.finditer(text):
        if found[1]:
            yield f"{text[:found.start()]} {text[found.end():]}".strip(), found[1]
    words, slash, unit = text.partition("/")
    if slash:
        yield words.strip(), unit.strip().strip("()[]")
    function = _vocabulary().patterns["function"].fullmatch(text)
    if function is not None:
        yield function[2], function[1]
    named = _IN.fullmatch(text)
    if named is not None:
        yield named[1], named[2]


def _meaning(text: str) -> Heading | None:
    """The part and the quantity that the words name, and nothing else."""
    words: list[_Word] = []
    for token in _TOKEN.findall(text.casefold()):
        word = _word(token)
        if word is None:
            return None
        if word.role == "minus" and any(each.part or each.kind for each in words):
            # After the first word a hyphen joins words and negates nothing.
            if token != "-":
                return None
            continue
        words.append(word)
    parts, kinds = {word.part for word in words if word.part}, {word.kind for word in words if word.kind}
    roles = [word.role for word in words]
    negated, primed, scaled = "minus" in roles, "prime" in roles, "scale" in roles
    found = _joined(parts, kinds, next((role for role in reversed(roles) if role in ("s", "p")), ""))
    if found is None or roles.count("bar") % 2:
        return None
    part, kind = found.part, found.kind
    refused = (
        primed and not any(word.kind and not word.part for word in words),
        part == "frequency" and kind,
        negated and part not in ("phase", "imaginary"),
        scaled and (kind not in ("reflection", "transmission") or part not in ("magnitude", "whole")),
    )
    return None if any(refused) else replace(found, negated=negated, primed=primed and part == "imaginary")


def _joined(parts: set[str], kinds: set[str], connection: str = "") -> Heading | None:
    """The one part of one quantity, or element, that words name.

    `connection` is that of an element: in series (s) or parallel (p).
    """
    if "element" in parts:
        # "Capacitance Cp" names it twice; the magnitude of a capacitance is no element.
        kinds = kinds - {"C", "L"} or kinds
        if parts != {"element"} or len(kinds) != 1 or not kinds <= {"C", "L", *ELEMENT_UNITS}:
            return None
        (symbol,) = kinds
        if symbol in ("C", "L"):
            return Heading("element", symbol + connection)
        return Heading("element", symbol) if not connection or symbol[1:] == connection else None
    if connection == "p" and kinds == {"impedance"}:
        return Heading("element", "Rp") if parts == {"real"} else None
    if len(parts) > 1 or len(kinds) > 1 or not (parts or kinds):
        return None
    return Heading(next(iter(parts), "whole"), next(iter(kinds), ""))


def _word(token: str) -> _Word | None:
    """The meaning of a word, or one joined to Z or Y."""
    words = _vocabulary().words
    if token in words:
        return words[token]
    for letter, kind in _LETTERS.items():
        for rest in (token.removeprefix(letter), token.removesuffix(letter)):
            word = words.get(rest)
            if rest != token and (len(rest) > 1 or not rest.isascii()) and word is not None and not (
                    word.kind or word.role or word.part in ("", "frequency")):
                return _Word(word.part, kind)
    return None
