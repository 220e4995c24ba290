"""What the heading of a column says: which quantity, in which unit, with which sign.

A heading is words and a unit. The unit stands in brackets, after a slash, after "in", or last behind a blank or an
underscore. The words must name one part (magnitude, phase, real or imaginary part) of one quantity (impedance or
admittance), in any order, with filling words between them; one word that is not known, and the heading is not
understood. ``tests/test_workbench_readers_headings.py`` lists what is understood and what is not.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

#: Words by the part they name.
PARTS: Mapping[str, frozenset[str]] = {
    "frequency": frozenset({"f", "freq", "frequency", "frequencies", "frequenz", "fréquence", "frecuencia",
                            "frequenza"}),
    "magnitude": frozenset({"abs", "absolute", "mag", "magnitude", "mod", "modulus"}),
    "phase": frozenset({"phase", "phz", "theta", "θ", "ϑ", "phi", "φ", "ϕ", "angle", "arg", "argument", "∠"}),
    "real": frozenset({"re", "real", "r", "rs", "resistance", "g", "gp", "conductance"}),
    "imaginary": frozenset({"im", "imag", "imaginary", "x", "xs", "reactance", "b", "bp", "susceptance"}),
}
#: Words by the quantity they name.
KINDS: Mapping[str, frozenset[str]] = {
    "impedance": frozenset({"z", "impedance", "impedanz", "r", "rs", "resistance", "x", "xs", "reactance"}),
    "admittance": frozenset({"y", "admittance", "admittanz", "g", "gp", "conductance", "b", "bp", "susceptance"}),
}
SYMBOLS: Mapping[str, str] = {"impedance": "Z", "admittance": "Y"}
_FILLING = frozenset({"of", "the", "part", "component", "value", "data", "trace", "series"})
_MINUS = frozenset({"-", "minus", "neg", "negative"})
_SEPARATING = frozenset("()[]{}<>,.:;_+")
_LETTERS = ("z", "y")

_TOKEN = re.compile(r"[^\W\d_]+|\d+|\S|_")
_BRACKETS = re.compile(r"[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]")
_IN = re.compile(r"(.*\S)\s+in\s+(\S+)", re.IGNORECASE)
_LAST = re.compile(r"(.*[^\s_,-])[\s_,-]+([^\s_,-]+)")

#: Spellings of units, by part and unit. Case counts only where it tells milli from mega: "mHz" (a millihertz, which
#: nothing here is measured in) and "MOHM" are not understood, "mhz" is.
_UNITS: Mapping[str, Mapping[str, re.Pattern[str]]] = {
    "frequency": {"Hz": re.compile("(?i:hz|hertz)"), "kHz": re.compile("(?i:k(hz|hertz))"),
                  "MHz": re.compile("(?!mHz)(?i:m(hz|hertz)|megahertz)")},
    "impedance": {"ohm": re.compile("(?i:ohms?)|Ω"), "kohm": re.compile("[kK]((?i:ohms?)|Ω)|(?i:kiloohms?)"),
                  "mohm": re.compile("m([oO]hms?|Ω)"), "Mohm": re.compile("M([oO]hms?|Ω)|(?i:mega?ohms?)"),
                  "dB": re.compile("(?i:db ?(ohms?|ω))")},
    "admittance": {"S": re.compile("[sS]|(?i:siemens|mhos?|1/ohms?)|1/Ω"), "mS": re.compile("m[sS]|(?i:millisiemens)"),
                   "uS": re.compile("[uμ][sS]|(?i:microsiemens)"), "dB": re.compile("(?i:db ?s)")},
    "phase": {"deg": re.compile("(?i:deg|deg[.]|degrees?)|°"), "rad": re.compile("(?i:rads?|radians?)")},
}


@dataclass(frozen=True)
class Heading:
    """What a column holds, as its heading says.

    ``part`` is "frequency", "magnitude", "phase", "real" or "imaginary", or "whole" where a quantity is named and no
    part of it ("Z"). ``kind`` is "impedance", "admittance" or "" where the heading does not say. ``unit`` is that of
    `Quantity` or of a frequency, "" where none is given; ``strange_unit`` is a unit that is not known. ``negated`` if
    the heading has a minus sign, ``primed`` if it is written Z'', which some take for -Im Z.
    """

    part: str
    kind: str = ""
    unit: str = ""
    strange_unit: str = ""
    negated: bool = False
    primed: bool = False


def understand(heading: str) -> Heading | None:
    """What a heading says; None where it does not name one part of an impedance, an admittance, or a frequency."""
    text = _plain(heading)
    strange = None
    for words, unit in _split(text):
        found = _words(words)
        if found is None:
            continue
        known = find_unit(unit, found)
        if known is not None:
            return known
        strange = strange or Heading(found.part, found.kind, "", unit, found.negated, found.primed)
    whole = _words(text)
    if whole is not None:
        return whole
    # The last word of a heading is a unit only where it is known as one.
    last = _LAST.fullmatch(text)
    found = None if last is None else _words(last[1])
    known = None if last is None or found is None else find_unit(last[2], found)
    return known or strange


def is_unit(text: str) -> bool:
    """Whether a text is the unit of anything that a column may hold."""
    plain = _plain(text).strip("()[]{}<> ")
    return any(pattern.fullmatch(plain) for spellings in _UNITS.values() for pattern in spellings.values())


def find_unit(text: str, bare: Heading) -> Heading | None:
    """The heading with its unit, which may say what the words left open; None where the unit does not suit them."""
    for of, spellings in _UNITS.items():
        for unit, pattern in spellings.items():
            if not pattern.fullmatch(text):
                continue
            part, kind = bare.part, bare.kind
            if of in ("frequency", "phase"):
                # "Z (deg)" can only be the phase of Z.
                part = "phase" if (part, of) == ("whole", "phase") else part
                suits = part == of
            else:
                suits = part not in ("frequency", "phase") and kind in ("", of)
                # The unit dB is that of a magnitude, whatever the words leave open.
                suits = suits and (unit != "dB" or part in ("magnitude", "whole"))
                kind = of
            if suits:
                return Heading(part, kind, unit, "", bare.negated, bare.primed)
    return None


def _plain(text: str) -> str:
    """One spelling of signs: Ohm and micro as Greek letters, primes as apostrophe and quotation mark, ASCII minus."""
    text = text.replace("″", '"').replace("“", '"').replace("”", '"').replace("º", "°")
    text = unicodedata.normalize("NFKC", text.replace("′", "'").replace("’", "'").replace("`", "'"))
    return re.sub("[−–]", "-", text).replace("''", '"').strip()


def _split(text: str) -> Iterator[tuple[str, str]]:
    """Every way to take a heading apart into words and a unit that is marked as one."""
    for found in _BRACKETS.finditer(text):
        if found[1]:
            yield f"{text[:found.start()]} {text[found.end():]}".strip(), found[1]
    words, slash, unit = text.partition("/")
    if slash:
        yield words.strip(), unit.strip().strip("()[]")
    named = _IN.fullmatch(text)
    if named is not None:
        yield named[1], named[2]


def _words(text: str) -> Heading | None:
    """The part and the quantity that the words name, if they name one of each at most and nothing else."""
    parts, kinds = set[str](), set[str]()
    bars, negated, primed, letter = 0, False, False, False
    for token in _TOKEN.findall(text.casefold()):
        if token == "|":
            bars += 1
        elif token in ("'", '"'):
            parts.add("real" if token == "'" else "imaginary")
            primed = True
        elif token in _MINUS:
            # Behind the first word a hyphen joins words and negates nothing.
            if not (parts or kinds or bars):
                negated = True
            elif token != "-":
                return None
        elif token not in _FILLING and token not in _SEPARATING:
            named = _token(token)
            if named is None:
                return None
            parts |= named[0]
            kinds |= named[1]
            letter = letter or (bool(named[1]) and not named[0])
    if bars:
        parts.add("magnitude")
    if len(parts) > 1 or len(kinds) > 1 or bars % 2 or not (parts or kinds) or (primed and not letter):
        return None
    part, kind = (parts or {"whole"}).pop(), (kinds or {""}).pop()
    if (part == "frequency" and kind) or (negated and part not in ("phase", "imaginary")):
        return None
    return Heading(part, kind, "", "", negated, primed and part == "imaginary")


def _token(token: str) -> tuple[set[str], set[str]] | None:
    """Parts and quantities that one word names; a Z or Y may be grown together with it ("zreal", "argz")."""
    named = ({part for part, words in PARTS.items() if token in words},
             {kind for kind, words in KINDS.items() if token in words})
    if named[0] or named[1]:
        return named
    for letter in _LETTERS:
        for rest in (token.removeprefix(letter), token.removesuffix(letter)):
            if rest != token and (len(rest) > 1 or not rest.isascii()):
                part = {part for part, words in PARTS.items() if part != "frequency" and rest in words}
                other = {kind for kind, words in KINDS.items() if rest in words}
                if part and not other:
                    return part, {kind for kind, words in KINDS.items() if letter in words}
    return None
