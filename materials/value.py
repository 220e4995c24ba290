"""A number of a data file: value, unit, uncertainty, rounding, source, conditions.

In a file a number is a table on one line::

    c33 = { value = 121.67, loss = -0.30, unit = "GPa", rounding = 0.005, source = "acevedo_2026", note = "Table 3" }

``loss`` is the imaginary part for the time factor e^{-i w t}: negative for a stiffness or a modulus, positive for a
permittivity. ``loss_tangent``, ``q`` or ``attenuation`` replace it if a source prints those (see
:mod:`materials.loss`). ``uncertainty`` (of the value) and ``loss_uncertainty`` (in the form of the loss) are standard
uncertainties; ``rounding`` is half a unit of the last printed digit. A fit adds the ends of its intervals, ``low``
``high`` ``loss_low`` ``loss_high`` (missing: unbounded), and the results for both parts, ``status`` and
``loss_status``. All numbers are in the unit of the entry and in SI after reading.
"""

from __future__ import annotations

import datetime
from collections.abc import Collection
from dataclasses import dataclass

from materials.loss import LossKind, read_loss
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import UNITS
from workbench.files.tables import FileTable

#: The source of a fitted number; the [fit] table of its entry names the recording.
RECORDING = "recording"

#: Possible results of a fit for a number or for its loss.
STATUSES = ("fitted", "fixed", "at bound", "not determined")

#: Uncertainties, which are not negative, and ends of intervals, of either sign.
_SPREADS = ("uncertainty", "rounding")
_ENDS = ("low", "high", "loss_low", "loss_high")
_KEYS = ("value", "unit", *_SPREADS, *_ENDS, "status", "loss_status", "source", "conditions", "note")


@dataclass(frozen=True)
class Value:
    """One number with its statements; all numbers are SI.

    ``unit`` is the text of the file. ``rounding`` is half a unit of the last printed digit (0: not declared).
    ``loss_tolerance`` bounds the error of the imaginary part due to rounding and the stated uncertainty; it is 0 if the
    source states no loss, because the imaginary part is then an assumption. ``low`` to ``high`` and ``loss_low`` to
    ``loss_high`` are the intervals of a fit (None: unbounded); ``status`` and ``loss_status`` are from
    :data:`STATUSES`, or empty without a fit. ``loss_stated`` is the printed loss if it is not an imaginary part.
    """

    value: complex
    unit: str
    source: str
    conditions: str = ""
    note: str = ""
    uncertainty: float | None = None
    loss_uncertainty: float | None = None
    rounding: float = 0.0
    loss_tolerance: float = 0.0
    low: float | None = None
    high: float | None = None
    loss_low: float | None = None
    loss_high: float | None = None
    status: str = ""
    loss_status: str = ""
    loss_stated: str = ""


def date_text(table: FileTable, key: str) -> str:
    """The date in ISO 8601 under `key`.

    Raises:
        InputError: there is none.
    """
    found = table.text(key)
    try:
        datetime.datetime.fromisoformat(found)
    except ValueError:
        raise table.error(key, 'a date, for example "2026-11-21T14:40:00+00:00"') from None
    return found


def unit_factor(entry: FileTable, dimension: str) -> tuple[str, float]:
    """The unit of an entry and its factor to SI.

    Raises:
        InputError: the unit is missing, or is not one of the `dimension`.
    """
    units = UNITS[dimension]
    unit = entry.content.get("unit")
    if not isinstance(unit, str) or unit not in units:
        near = nearest_names(unit, units) if isinstance(unit, str) else ()
        raise entry.error("unit", f"a unit of {dimension}: one of {', '.join(units)}", near)
    return unit, units[unit]


def source_of(table: FileTable, references: Collection[str], default: str | None = None) -> str:
    """The key of a reference under ``source``.

    Raises:
        InputError: no text, or not a key of `references`.
    """
    key = table.text("source", default)
    if key not in references:
        expected = "a key of references.bib" + (" (this one needs a [fit] table)" if key == RECORDING else "")
        raise InputError(table.source, table.at("source"), key, expected, nearest_names(key, references))
    return key


def parse_value(
    entry: object,
    dimension: str,
    *,
    source: str,
    field: str,
    references: Collection[str],
    default_source: str,
    default_conditions: str,
    kind: LossKind,
) -> Value:
    """The :class:`Value` in a table of a data file.

    Args:
        entry: content of the file under `field`.
        dimension: a key of :data:`UNITS`.
        source: the file, for messages.
        field: the key in the file, for messages.
        references: keys of the bibliography.
        default_source: the file's ``source``, used if the entry has none.
        default_conditions: the file's ``conditions``, likewise.
        kind: the kind of loss of this number.

    Raises:
        InputError: not a table, an unknown key, a number missing or not finite, a wrong unit, an unknown source or
            status, an interval without its value, a loss of the wrong form (see :func:`read_loss`).
    """
    table = FileTable.of(entry, source=source, field=field, expected='a table such as { value = 1.0, unit = "GPa" }')
    table.only([*(key for key in _KEYS if kind.words or not key.startswith("loss")), *kind.keys])
    unit, factor = unit_factor(table, dimension)
    real = table.optional_number("value")
    if real is None:
        raise InputError(source, table.at("value"), None, "a finite number")
    spreads = {key: _spread(table, key, factor) for key in _SPREADS}
    rounding = spreads["rounding"] or 0.0
    loss = read_loss(table, kind, real, factor=factor, rounding=rounding)
    lost = loss.imaginary / factor if loss.stated else table.optional_number("loss") or 0.0 if kind.words else 0.0
    low, high, loss_low, loss_high = (
        _end(table, key, lost if key.startswith("loss") else real, factor) for key in _ENDS)
    status, loss_status = (table.choice(key, STATUSES) if key in table else "" for key in ("status", "loss_status"))
    zero = 273.15 if unit == "degC" else 0.0
    return Value(
        value=complex(real * factor + zero, loss.imaginary),
        unit=unit,
        source=source_of(table, references, default_source),
        conditions=table.text("conditions", default_conditions),
        note=table.text("note", ""),
        uncertainty=spreads["uncertainty"],
        loss_uncertainty=loss.uncertainty,
        rounding=rounding,
        loss_tolerance=loss.tolerance,
        low=low,
        high=high,
        loss_low=loss_low,
        loss_high=loss_high,
        status=status,
        loss_status=loss_status,
        loss_stated=loss.stated,
    )


def _spread(table: FileTable, key: str, factor: float) -> float | None:
    """An uncertainty (SI), not below zero."""
    spread = table.optional_number(key)
    if spread is not None and spread < 0:
        raise InputError(table.source, table.at(key), spread, "a number not below zero")
    return None if spread is None else spread * factor


def _end(table: FileTable, key: str, inside: float, factor: float) -> float | None:
    """One end of an interval (SI) around `inside` (in the entry's unit)."""
    end = table.optional_number(key)
    if end is not None and (end > inside if key.endswith("low") else end < inside):
        raise InputError(table.source, table.at(key), end, f"an interval that contains the value, {inside:g}")
    return None if end is None else end * factor
