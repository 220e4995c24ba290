"""Printed losses as imaginary parts, for the time factor e^{-i w t}.

A number states its loss by one of four keys:

- ``loss``: the imaginary part, in the unit of the number and with its sign, or a text such as ``"5 %"`` of the value,
  with the sign of a passive material;
- ``loss_tangent``: tan delta, a number or a text such as ``"2 %"``;
- ``q``: a quality factor, 1 / tan delta, such as the Q_m of a ceramic;
- ``attenuation``: of a wave speed, in dB or Np per length at a ``frequency`` (``attenuation = "3 dB/cm", frequency = "1
  MHz"``) or per length and frequency (``"3 dB/(cm MHz)"``).

``loss_uncertainty`` has the same form. With v the printed phase speed and alpha the attenuation, the wavenumber is k =
w / v + i alpha, and its modulus rho (w / k)^2 has the loss tangent tan delta with tan(delta / 2) = alpha v / w. This is
exact for a loss tangent that is constant over the band (alpha proportional to the frequency). The imaginary part of a
speed is -v tan(delta / 2), which makes the complex speed w / k = v^2 / conj(v + i v'').
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import UNITS, parse_quantity
from workbench.files.tables import FileTable

#: The keys of a loss; a number has at most one.
WORDS = ("loss", "loss_tangent", "q", "attenuation")

#: Nepers per decibel: a ratio of amplitudes of 10^(1/20).
NEPERS_PER_DECIBEL = math.log(10.0) / 20.0

#: Relative step of the difference quotients that propagate an uncertainty. Doubled, their relative error is 4e-12.
_STEP = 1e-6


class LossKind(Enum):
    """The kind of loss of a number. It fixes the sign of its imaginary part and the keys."""

    NONE = "not at all"
    MODULUS = "as a modulus"
    COMPLIANCE = "as a compliance or permittivity"
    EITHER_SIGN = "with either sign"
    WAVE_SPEED = "as the speed of a wave"

    @property
    def words(self) -> tuple[str, ...]:
        """The keys of the loss of such a number."""
        match self:
            case LossKind.NONE:
                return ()
            case LossKind.EITHER_SIGN:
                return ("loss",)
            case LossKind.MODULUS | LossKind.COMPLIANCE:
                return ("loss", "loss_tangent", "q")
            case LossKind.WAVE_SPEED:
                return WORDS

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys of an entry's loss, including those rejected by name."""
        if not self.words:
            return ()
        return (*WORDS, "loss_uncertainty", *(("frequency",) if self is LossKind.WAVE_SPEED else ()))


@dataclass(frozen=True)
class Loss:
    """The ``imaginary`` part of a number and its standard ``uncertainty``, both SI.

    ``uncertainty`` is None if not stated. ``tolerance`` bounds the error of the imaginary part due to the rounding and
    the uncertainty of the printed numbers; ``stated`` is the loss as printed, empty if it is an imaginary part.
    """

    imaginary: float = 0.0
    uncertainty: float | None = None
    tolerance: float = 0.0
    stated: str = ""


def read_loss(table: FileTable, kind: LossKind, real: float, *, factor: float, rounding: float) -> Loss:
    """The loss that `table` states for the number `real`.

    `real` is in the unit of its entry, with the `factor` to SI. `rounding` (SI) is half a unit of its last printed
    digit.

    Raises:
        InputError: more than one loss, one of the wrong sign or form, or an attenuation without its frequency.
    """
    word = _word(table, kind)
    if "frequency" in table and word != "attenuation":
        raise table.error("frequency", "none: only an attenuation has one, another loss is constant in the band")
    if word is None or (word == "loss" and not isinstance(table.content["loss"], str)):
        loss = table.optional_number("loss")
        spread = table.optional_number("loss_uncertainty")
        if spread is not None and spread < 0:
            raise table.error("loss_uncertainty", "a number not below zero")
        if kind is LossKind.WAVE_SPEED and loss is not None and loss > 0:
            raise table.error("loss", "a number not above zero, the imaginary part of the speed (e^{-i w t})")
        spread = None if spread is None else spread * factor
        return Loss((loss or 0.0) * factor, spread, 0.0 if loss is None else rounding + (spread or 0.0))
    if kind is LossKind.EITHER_SIGN:
        raise table.error("loss", "an imaginary part in the unit of the value: passivity does not fix its sign")
    number, uncertainty, imaginary = _stated(table, word, kind)
    value = real * factor

    def slope(function: Callable[[float], float], at: float) -> float:
        step = _STEP * (abs(at) or 1.0)
        return abs(function(at + step) - function(at - step)) / (2.0 * step)

    spread = None if uncertainty is None else slope(lambda x: imaginary(value, x), number) * uncertainty
    tolerance = slope(lambda x: imaginary(x, number), value) * rounding + (spread or 0.0)
    return Loss(imaginary(value, number), spread, tolerance, _words(table, word))


def attenuation_of_sound(table: FileTable, speed: float) -> tuple[float, float | None, float, str] | None:
    """Attenuation of sound in a fluid, or None if `table` states none.

    `speed` is in m/s. A fluid's classical attenuation grows with the square of the frequency, so every key needs a
    frequency.

    Returns:
        the attenuation (Np/m), its uncertainty, the frequency (Hz) and the printed text.

    Raises:
        InputError: as in :func:`read_loss`; an imaginary part, or no frequency.
    """
    word = _word(table, LossKind.WAVE_SPEED)
    if word is None:
        return None
    if word == "loss":
        raise table.error("loss", 'the absorption of a fluid: attenuation = "0.2 dB/cm" with frequency = "1 MHz"')
    stated = _words(table, word)
    if word == "attenuation":
        alpha, uncertainty, frequency = _attenuation(table, law=2)
        return alpha, uncertainty, frequency, stated
    frequency = _frequency(table, word)
    number, uncertainty, imaginary = _stated(table, word, LossKind.WAVE_SPEED)

    def alpha_of(x: float) -> float:
        return -imaginary(1.0, x) * 2.0 * math.pi * frequency / speed

    step = _STEP * (number or 1.0)
    slope = abs(alpha_of(number + step) - alpha_of(number - step)) / (2.0 * step)
    return alpha_of(number), None if uncertainty is None else slope * uncertainty, frequency, stated


def _word(table: FileTable, kind: LossKind) -> str | None:
    """The key of the loss, if any."""
    given = [word for word in WORDS if word in table]
    for word in given:
        if word not in kind.words:
            why = "only a wave speed has an attenuation" if word == "attenuation" else "passivity does not fix its sign"
            raise table.error(word, f"the loss as {' or '.join(kind.words)}: {why}")
    if len(given) > 1:
        raise InputError(table.source, table.at(given[1]), f"a second loss, beside {given[0]}",
                         f"one of {', '.join(kind.words)}")
    return given[0] if given else None


#: The imaginary part (SI) as a function of a value (SI) and its printed loss.
_Imaginary = Callable[[float, float], float]


def _stated(table: FileTable, word: str, kind: LossKind) -> tuple[float, float | None, _Imaginary]:
    """The printed loss, its uncertainty, and the function for its imaginary part."""
    sign = 1.0 if kind is LossKind.COMPLIANCE else -1.0
    wave = kind is LossKind.WAVE_SPEED

    def of_tangent(value: float, tangent: float) -> float:
        return sign * value * (math.tan(0.5 * math.atan(tangent)) if wave else tangent)

    if word == "attenuation":
        alpha, spread, frequency = _attenuation(table, law=1)
        omega = 2.0 * math.pi * frequency
        return alpha, spread, lambda value, x: -(value**2) * x / omega
    number = loss_number(table, word, word)
    spread = loss_number(table, "loss_uncertainty", word, uncertainty=True) if "loss_uncertainty" in table else None
    match word:
        case "loss":
            return number, spread, lambda value, x: sign * value * x
        case "loss_tangent":
            return number, spread, of_tangent
        case _:
            return number, spread, lambda value, x: of_tangent(value, 1.0 / x)


def loss_number(table: FileTable, key: str, word: str, *, uncertainty: bool = False) -> float:
    """The number under `key` of a loss stated as `word`.

    With `uncertainty` it is the uncertainty of such a loss. Attenuations have another reader.

    Raises:
        InputError: another form than that of the word, or an impossible number.
    """
    text, source, field = table.content[key], table.source, table.at(key)
    expected = {
        "loss": 'a number in the unit of the value, or a percentage of it such as "5 %", without a sign',
        "loss_tangent": 'a loss tangent from 0 to below 1, such as 0.02 or "2 %"',
        "q": "a quality factor above 1, a number without unit",
    }[word]
    if uncertainty:
        expected = {"loss": 'a percentage such as "0.5 %"', "loss_tangent": 'a number such as 0.005 or "0.5 %"',
                    "q": "a number without unit"}[word] + " not below zero, stated as the loss is"
    percentage = isinstance(text, str) and text.rstrip().endswith("%")
    if (word == "q" and isinstance(text, str)) or (word == "loss" and not percentage):
        raise InputError(source, field, text, expected)
    number = parse_quantity(text, "dimensionless", source=source, field=field)
    if not (number >= 0 if uncertainty else number > 1 if word == "q" else 0 <= number < 1):
        raise InputError(source, field, text, expected)
    return number


_AMOUNT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")
_UNIT = re.compile(r"(dB|Np)/(?:\(([^()]+)\)|([^()]+))$")
_PART = re.compile(r"([A-Za-zµμ]+)(?:\^(\d))?$")


def _attenuation(table: FileTable, *, law: int) -> tuple[float, float | None, float]:
    """The attenuation (Np/m), its uncertainty, and its frequency (Hz). It grows with the frequency to the power `law`;
    an attenuation per frequency to that power needs no frequency."""
    text, expected = table.content["attenuation"], 'an attenuation such as "3 dB/cm" with frequency = "1 MHz" beside it'
    if not isinstance(text, str):
        raise table.error("attenuation", expected)
    amount, at, named = text.partition(" at ")
    if at and "frequency" in table:
        raise InputError(table.source, table.at("frequency"), table.content["frequency"],
                         f"the frequency once: attenuation = {text!r} has one")
    factor, per, power = _amount(table, "attenuation", amount, expected)
    if at:
        frequency = parse_quantity(named, "frequency", source=table.source, field=table.at("attenuation"))
    elif power == law and "frequency" not in table:
        frequency = per
    else:
        frequency = _frequency(table, "attenuation")
    scale = (frequency / per) ** power
    spread = None
    if "loss_uncertainty" in table:
        words = table.content["loss_uncertainty"]
        stated = 'an attenuation in the unit of the loss, such as "0.5 dB/cm"'
        if not isinstance(words, str):
            raise table.error("loss_uncertainty", stated)
        spread, other, same = _amount(table, "loss_uncertainty", words, stated)
        if same != power:
            raise table.error("loss_uncertainty", stated)
        spread *= (frequency / other) ** power
    return factor * scale, spread, frequency


def _amount(table: FileTable, key: str, text: str, expected: str) -> tuple[float, float, int]:
    """The attenuation (Np/m) at 1 Hz, and its exponent of frequency."""
    whole = _AMOUNT.match(text)
    value, unit = (float(whole[1]), whole[2]) if whole else (math.nan, text)
    found = _UNIT.match(re.sub(r"\s*/\s*", "/", unit.replace("²", "^2")))
    parts = [_PART.match(part) for part in re.split(r"[\s/·*]+", found[2] or found[3])] if found else []
    known = [part for part in parts if part is not None]
    lengths = [part[1] for part in known if part[1] in UNITS["length"] and part[2] is None]
    frequencies = [part for part in known if part[1] in UNITS["frequency"]]
    if len(lengths) != 1 or len(frequencies) > 1 or len(lengths) + len(frequencies) != len(parts) or not value >= 0:
        near = nearest_names(unit, ("dB/cm", "dB/m", "dB/mm", "Np/m", "Np/cm", "dB/(cm MHz)")) if unit else ()
        raise InputError(table.source, table.at(key), text, f"{expected}, not below zero, in dB/cm, dB/m, dB/mm, Np/m, "
                         "Np/cm or dB/(cm MHz)", near)
    assert found is not None
    value *= (NEPERS_PER_DECIBEL if found[1] == "dB" else 1.0) / UNITS["length"][lengths[0]]
    if not frequencies:
        return value, 1.0, 0
    return value, UNITS["frequency"][frequencies[0][1]], int(frequencies[0][2] or 1)


def _frequency(table: FileTable, word: str) -> float:
    """The frequency (Hz) of a loss stated as `word`."""
    if "frequency" not in table:
        raise InputError(table.source, table.at(word), table.content[word],
                         'its frequency beside it, such as frequency = "1 MHz"')
    frequency = table.quantity("frequency", "frequency")
    if not frequency > 0:
        raise table.error("frequency", "a frequency above zero")
    return frequency


def _words(table: FileTable, word: str) -> str:
    """The printed loss as text."""
    at = f" at {table.content['frequency']}" if "frequency" in table else ""
    return f"{word.replace('_', ' ')} {table.content[word]}{at}"
