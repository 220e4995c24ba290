"""The meaning of a column's heading: quantity, unit and sign.

A heading is a label, words and a unit. The unit stands in brackets, after a slash, after "in", or last after a blank or
an underscore; the label of a trace or channel ("Tr1:", "Trc1_") stands first. The words must name one part (magnitude,
phase, real or imaginary part) of one quantity (impedance, admittance, reflection, transmission), in any order, with
filling words between them, or one element of an equivalent circuit. A heading with one unknown word is not understood.
``tests/test_workbench_readers_headings.py`` lists headings that are understood and headings that are not.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from workbench.readers.quantities import ELEMENT_UNITS

#: Words by the part they name.
PARTS: Mapping[str, frozenset[str]] = {
    "frequency": frozenset({"f", "freq", "frequency", "frequencies", "frequenz", "fréquence", "frecuencia",
                            "frequenza"}),
    "magnitude": frozenset({"abs", "absolute", "absolut", "mag", "magnitude", "mod", "modulus", "module", "modul",
                            "betrag", "scheinwiderstand", "módulo"}),
    "phase": frozenset({"phase", "phz", "theta", "θ", "ϑ", "phi", "φ", "ϕ", "angle", "arg", "argument", "∠", "ang",
                        "phas", "winkel", "phasenwinkel", "fase"}),
    "real": frozenset({"re", "real", "r", "rs", "esr", "resistance", "g", "gp", "conductance", "realteil",
                       "wirkwiderstand", "réelle", "reell"}),
    "imaginary": frozenset({"im", "imag", "img", "imaginary", "x", "xs", "reactance", "b", "bp", "susceptance",
                            "imaginärteil", "blindwiderstand", "imaginaire", "imaginär"}),
}
#: Words by the quantity they name.
KINDS: Mapping[str, frozenset[str]] = {
    "impedance": frozenset({"z", "zs", "impedance", "impedanz", "impédance", "impedancia", "impedenza", "r", "rs",
                            "esr", "resistance", "x", "xs", "reactance", "scheinwiderstand", "wirkwiderstand",
                            "blindwiderstand"}),
    "admittance": frozenset({"y", "admittance", "admittanz", "g", "gp", "conductance", "b", "bp", "susceptance"}),
    "reflection": frozenset({"gamma", "γ", "reflection", "reflexion"}),
    "transmission": frozenset({"transmission"}),
}
#: Elements of an equivalent circuit by their words. If the first letter alone ("C", "capacitance") leaves series or
#: parallel open, a word of :data:`_CONNECTIONS` tells.
ELEMENTS: Mapping[str, frozenset[str]] = {
    "Cp": frozenset({"cp"}), "Cs": frozenset({"cs"}), "Lp": frozenset({"lp"}), "Ls": frozenset({"ls"}),
    "Rp": frozenset({"rp", "epr"}), "D": frozenset({"d", "df", "dissipation", "tanδ", "tand"}),
    "Q": frozenset({"q", "quality"}), "C": frozenset({"c", "capacitance", "kapazität"}),
    "L": frozenset({"l", "inductance", "induktivität"}),
}
SYMBOLS: Mapping[str, str] = {"impedance": "Z", "admittance": "Y", "reflection": "S11", "transmission": "S21"}
#: Words that name a number without a phase.
_SCALARS = frozenset({"vswr", "swr"})
_CONNECTIONS: Mapping[str, str] = {"series": "s", "parallel": "p", "serial": "s"}
_FILLING = frozenset({"of", "the", "part", "partie", "component", "value", "data", "trace", "measured", "factor",
                      "complex", "der", "de", "parameter"})
_SCALES = frozenset({"log", "lin", "linear", "logarithmic"})
_MINUS = frozenset({"-", "minus", "neg", "negative"})
_SEPARATING = frozenset("()[]{}<>,.:;_+")
_LETTERS = ("z", "y")

_TOKEN = re.compile(r"[^\W\d_]+|\d+|\S|_")
_BRACKETS = re.compile(r"[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]")
_IN = re.compile(r"(.*\S)\s+in\s+(\S+)", re.IGNORECASE)
_LAST = re.compile(r"(.*[^\s_,-])[\s_,-]+([^\s_,-]+)")
#: The label of a trace, channel or memory, before or in the midst of a heading.
_LABEL = re.compile(r"(?i)\b(?:traces?|trc|tr|ch(?:an(?:nel)?)?|meas(?:urement)?|cal)\s?\d+(?:\s*[:;_]\s*|\s+-?\s*|$)")
_EMPTY = re.compile(r"\s*[(\[]\s*[)\]]\s*$")
#: Z11, Z(1,1), S11, S(1,1), S[1,1], S_11 ...; one port's own parameters stand for its impedance and admittance.
_PORTS = re.compile(r"(?i)(?<![a-z])([szy])\s?[_(\[<]?\s?([1-9])\s?,?\s?([1-9])\s?[)\]>]?(?!\d)")
#: ZPlot and ZView mark their columns so: Z'(a), Z''(b).
_ZPLOT = re.compile("(?i)(z'|z\")\\s*\\([ab]\\)\\s*$")
_LOSS = re.compile(r"(?i)\b(?:return\s?loss|rückflussdämpfung)\b|^rl\b")

#: Replacements of unusual spellings: the degree sign as an apostrophe in brackets, the loss tangent, HFSS's angle.
_SPELLINGS: Mapping[re.Pattern[str], str] = {
    re.compile(r"(?i)\bdegrees?\s*[(][°'][)]"): "(deg)",
    re.compile(r"(?i)\bang_(deg|rad)(?=[(])"): "ang",
    re.compile(r"(?i)\b(?:tan\s*[(]?(?:δ|delta)[)]?|loss tangent|loss factor|dissipation factor)"): "tand",
    # C_p, R_s.
    re.compile(r"\b([CLRZ])_([ps])(?![A-Za-z])"): r"\1\2",
}

_OHM = "(?:[oO][hH][mM][sS]?|Ω)"
#: Spellings of units, by part and unit. Case counts only between milli and mega: "mHz" (a millihertz, in which nothing
#: here is measured) and "MOHM" are not understood, "mhz" is.
_UNITS: Mapping[str, Mapping[str, re.Pattern[str]]] = {
    "frequency": {"Hz": re.compile("(?i:hz|hertz)"), "kHz": re.compile("(?i:k(hz|hertz)|kilohertz)"),
                  "MHz": re.compile("(?!mHz)(?i:m(hz|hertz)|megahertz)"), "GHz": re.compile("(?i:g(hz|hertz))")},
    "impedance": {"ohm": re.compile("(?i:ohms?)|Ω"), "kohm": re.compile("[kK]((?i:ohms?)|Ω)|(?i:kiloohms?)"),
                  "mohm": re.compile("m([oO]hms?|Ω)|(?i:milliohms?)"),
                  "Mohm": re.compile("M([oO]hms?|Ω)|(?i:mega?ohms?)"),
                  "dB": re.compile("(?i:db ?(ohms?|ω))")},
    "admittance": {"S": re.compile(f"[sS]|(?i:siemens|mhos?)|1/{_OHM}|{_OHM}\\^?-1|{_OHM}⁻¹"),
                   "mS": re.compile("m[sS]|(?i:millisiemens)"),
                   "uS": re.compile("[uμ][sS]|(?i:microsiemens)"), "nS": re.compile("n[sS]"),
                   "dB": re.compile("(?i:db ?s)")},
    "phase": {"deg": re.compile("(?i:deg|deg[.]|degs?|degrees?|grad)|[°']|(?i:degrees?) ?[(][°'][)]"),
              "rad": re.compile("(?i:rads?|radians?)")},
    "ratio": {"dB": re.compile("(?i:db)"), "1": re.compile("(?i:1|u|lin|linear|-)"), "%": re.compile("%")},
    "capacitance": {"F": re.compile("[fF]|(?i:farads?)"), "mF": re.compile("m[fF]"), "uF": re.compile("[uμ][fF]"),
                    "nF": re.compile("[nN][fF]"), "pF": re.compile("[pP][fF]")},
    "inductance": {"H": re.compile("[hH]|(?i:henry|henries)"), "mH": re.compile("m[hH]"), "uH": re.compile("[uμ][hH]"),
                   "nH": re.compile("n[hH]")},
}
_OF_ELEMENT: Mapping[str, str] = {"C": "capacitance", "L": "inductance", "R": "impedance", "D": "ratio", "Q": "ratio"}


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


def understand(heading: str) -> Heading | None:
    """Meaning of a heading; None unless it names one part of a quantity, one element, or a frequency."""
    text = _plain(heading)
    found = _understood(text)
    if found is None or found.strange_unit:
        bare = _LABEL.sub(" ", _EMPTY.sub("", text)).strip(" :_")
        other = _understood(bare) if bare != text else None
        if other is not None and (found is None or not other.strange_unit):
            found = other
    return found


def hint(heading: str) -> Heading | None:
    """Apparent meaning of a heading that is not understood: the one part that its words name, and its quantity if it
    names one; None if it names no part or several."""
    text = _plain(heading)
    parts, kinds = set[str](), set[str]()
    for token in _TOKEN.findall(text.casefold()):
        # One letter may be anything.
        named = _token(token) if len(token) > 1 or not token.isascii() else None
        if named is not None and "element" not in named[0]:
            parts |= named[0]
            kinds |= named[1]
    if text.count("|") == 2:
        parts.add("magnitude")
    if len(parts) != 1:
        return None
    return Heading(parts.pop(), kinds.pop() if len(kinds) == 1 else "")


def _understood(text: str) -> Heading | None:
    text = _ZPLOT.sub(r"\1", text)
    loss = _LOSS.search(text)
    if loss is not None:
        return Heading("scalar", "reflection")
    ports = _PORTS.search(text)
    if ports is not None:
        return _scattering(text, ports)
    strange = None
    for words, unit in _split(text):
        found = _words(words)
        if found is None:
            continue
        known = find_unit(unit, found)
        if known is not None:
            return known
        strange = strange or replace(found, unit="", strange_unit=unit)
    whole = _words(text)
    if whole is not None:
        return whole
    # The last word of a heading is a unit only if it is known as one.
    last = _LAST.fullmatch(text)
    found = None if last is None else _words(last[1])
    known = None if last is None or found is None else find_unit(last[2], found)
    return known or strange


def _scattering(text: str, ports: re.Match[str]) -> Heading | None:
    """Meaning of a heading with S11, S21, Z11 ..."""
    letter, to, of = ports[1].casefold(), ports[2], ports[3]
    if letter in _LETTERS:
        # With a single port, the parameter of the port is that of the device.
        return None if to != of or to != "1" else _understood(text[:ports.start()] + ports[1] + text[ports.end():])
    if to != of and {to, of} != {"1", "2"}:
        return None
    word = "reflection" if to == of else "transmission"
    found = _understood(f"{text[:ports.start()]} {word} {text[ports.end():]}".strip())
    return None if found is None else replace(found, port=int(to))


def is_series(heading: str) -> bool:
    """Whether a heading of a resistance states that it is in series."""
    return re.search(r"(?i)(?<![a-z])(?:r_?s|esr|series|serial)(?![a-z])", heading) is not None


def is_unit(text: str) -> bool:
    """Whether a text is the unit of any quantity that a column may hold."""
    plain = _plain(text).strip("()[]{}<> ")
    return any(pattern.fullmatch(plain) for spellings in _UNITS.values() for pattern in spellings.values())


def find_unit(text: str, bare: Heading) -> Heading | None:
    """The heading with its unit, which may settle an open question of its words; None if the unit does not suit them.
    """
    for of, spellings in _UNITS.items():
        for unit, pattern in spellings.items():
            if not pattern.fullmatch(text):
                continue
            part, kind = bare.part, bare.kind
            if part == "scalar":
                return replace(bare, unit=unit)
            if part == "element":
                suits = _OF_ELEMENT[kind[0]] == of and unit in ELEMENT_UNITS.get(kind, {**ELEMENT_UNITS["Cp"],
                                                                                        **ELEMENT_UNITS["Lp"]})
            elif of in ("frequency", "phase"):
                # "Z (deg)" can only be the phase of Z.
                part = "phase" if (part, of) == ("whole", "phase") else part
                suits = part == of
            elif of == "ratio":
                suits = kind in ("reflection", "transmission") and part not in ("frequency", "phase")
                suits = suits and (unit != "dB" or part in ("magnitude", "whole"))
                part = "magnitude" if suits and unit == "dB" else part
            elif of in ("capacitance", "inductance"):
                suits = False
            else:
                suits = part not in ("frequency", "phase") and kind in ("", of)
                # The unit dB is that of a magnitude, whatever the words leave open.
                suits = suits and (unit != "dB" or part in ("magnitude", "whole"))
                kind = of
            if suits:
                return replace(bare, part=part, kind=kind, unit=unit, strange_unit="")
    return None


def _plain(text: str) -> str:
    """One spelling of signs: Ohm and micro as Greek letters, primes as apostrophe and quotation mark, ASCII minus."""
    text = text.replace("″", '"').replace("“", '"').replace("”", '"').replace("º", "°")
    text = unicodedata.normalize("NFKC", text.replace("′", "'").replace("’", "'").replace("`", "'"))
    text = re.sub("[−–]", "-", text).replace("''", '"').strip()
    for pattern, spelling in _SPELLINGS.items():
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
    # A function of several words, as in dB(S11) and re:Trc1_S11, stands before the bracket or colon.
    function = re.fullmatch(r"(?i)(db|deg|rad)\s*(?:mag)?\s*[(:_]\s*(.*?)\s*[)]?", text)
    if function is not None:
        yield function[2], function[1]
    named = _IN.fullmatch(text)
    if named is not None:
        yield named[1], named[2]


def _words(text: str) -> Heading | None:
    """The part and the quantity that the words name, if they name at most one of each and nothing else."""
    parts, kinds = set[str](), set[str]()
    bars, negated, primed, letter, scaled = 0, False, False, False, False
    connection = ""
    for token in _TOKEN.findall(text.casefold()):
        if token == "|":
            bars += 1
        elif token in ("'", '"'):
            parts.add("real" if token == "'" else "imaginary")
            primed = True
        elif token in _MINUS:
            # After the first word a hyphen joins words and negates nothing.
            if not (parts or kinds or bars):
                negated = True
            elif token != "-":
                return None
        elif token in _CONNECTIONS:
            connection = _CONNECTIONS[token]
        elif token in _SCALES:
            scaled = True
        elif token in _SCALARS:
            parts.add("scalar")
            kinds.add("reflection")
        elif token not in _FILLING and token not in _SEPARATING:
            named = _token(token)
            if named is None:
                return None
            parts |= named[0]
            kinds |= named[1]
            letter = letter or (bool(named[1]) and not named[0])
    if bars:
        parts.add("magnitude")
    if "element" in parts:
        # The magnitude or phase of a capacitance is no element of a circuit.
        element = _element(parts, kinds, connection)
        return None if element is None or negated or primed or scaled else Heading("element", element)
    if connection == "p" and (parts, kinds) == ({"real"}, {"impedance"}):
        return Heading("element", "Rp")
    if connection == "p" and kinds == {"impedance"}:
        return None
    if len(parts) > 1 or len(kinds) > 1 or bars % 2 or not (parts or kinds) or (primed and not letter):
        return None
    part, kind = (parts or {"whole"}).pop(), (kinds or {""}).pop()
    if (part == "frequency" and kind) or (negated and part not in ("phase", "imaginary")):
        return None
    if scaled and (kind not in ("reflection", "transmission") or part not in ("magnitude", "whole")):
        return None
    return Heading(part, kind, "", "", negated, primed and part == "imaginary")


def _element(parts: set[str], kinds: set[str], connection: str) -> str | None:
    """The symbol of an element of a circuit."""
    # "Capacitance Cp" names it twice.
    kinds = kinds - {"C", "L"} or kinds
    if parts != {"element"} or len(kinds) != 1:
        return None
    (symbol,) = kinds
    if symbol in ("C", "L"):
        return symbol + connection
    return symbol if not connection or symbol[1:] == connection else None


def _token(token: str) -> tuple[set[str], set[str]] | None:
    """Parts and quantities that one word names; a Z or Y may be joined to it ("zreal", "argz")."""
    named = ({part for part, words in PARTS.items() if token in words},
             {kind for kind, words in KINDS.items() if token in words})
    if named[0] or named[1]:
        return named
    element = next((symbol for symbol, words in ELEMENTS.items() if token in words), None)
    if element is not None:
        return {"element"}, {element}
    for letter in _LETTERS:
        for rest in (token.removeprefix(letter), token.removesuffix(letter)):
            if rest != token and (len(rest) > 1 or not rest.isascii()):
                part = {part for part, words in PARTS.items() if part != "frequency" and rest in words}
                other = {kind for kind, words in KINDS.items() if rest in words}
                if part and not other:
                    return part, {kind for kind, words in KINDS.items() if letter in words}
    return None
