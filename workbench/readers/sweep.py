"""From the points of a file, in any order, to a spectrum."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.readers.findings import Finding, Rows, examine, rows_in_words
from workbench.readers.tables import Table
from workbench.readers.text import READ_AS
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Origin, Spectrum, corrected

if TYPE_CHECKING:
    import xarray

#: The setting of an origin that lists the points put in order or left out.
PUT_IN_ORDER = "put in order"
#: Findings on the spectrum itself, which are found anew after a correction.
_EXAMINED = frozenset({"inverse_ratio", "negated", "active", "conjugated", "unsigned", "stretch", "magnitude",
                       "frequency", "outlier", "spacing", "radians"})
#: The setting of an origin that lists the points left out on request.
LEFT_OUT = "left out"
#: Largest relative difference of equal frequencies: digits lost in a unit. Doubled, nothing changes, since no analyser
#: steps by a thousandth of a hertz at 1 MHz.
ONE_FREQUENCY = 1e-9
#: Largest relative difference of equal values at one frequency: rounding. Doubled, twice the noise goes unsaid.
ONE_VALUE = 1e-6
#: Least difference of values at one frequency that belong to two states of a device: this many times that of
#: neighbouring frequencies and this share, or the last share in any case. Doubled, a drift of twice the size is
#: averaged with milder words.
TWO_STATES = (3.0, 0.02, 0.25)
#: Fewest rows above a last one that may be cut off: without a line end, and with one. A program that drops zeros at the
#: end makes one cell in ten shorter. Doubled, short tables are not examined.
FEW_ROWS = (4, 30)
#: Least number of repeated readings that determine the noise: ten determine it to 16 %, five to 22 %.
REPEATS = 10
_LAST_NUMBER = re.compile(r"(\d*)(?:\.(\d*))?([eE][+-]?\d*)?$")

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, repr=False)
class Reading(Shown):
    """A spectrum as recorded, its findings, and its rows of the file."""

    spectrum: Spectrum
    findings: tuple[Finding, ...]
    rows: Rows | None = None

    @property
    def read_as(self) -> str:
        """Meaning of every column, as headings or a map state it."""
        return self.spectrum.origin.settings.get(READ_AS, "")

    def summary(self) -> Summary:
        """The spectrum and its findings, for a notebook."""
        own = self.spectrum.summary()
        found = [("read as", self.read_as)] if self.read_as else []
        rows = (*own.rows, *found, *(("finding", str(finding.message)) for finding in self.findings))
        return Summary("Recording", rows, {"measured": self.spectrum}, ("measured",))

    def to_xarray(self) -> xarray.Dataset:
        """The spectrum as a dataset, see :meth:`Spectrum.to_xarray`."""
        return self.spectrum.to_xarray()

    def examined(
        self, spectrum: Spectrum, *more: Finding, rows: Rows | None = None, shunt_gain: bool = False
    ) -> Reading:
        """The reading with another `spectrum` and the findings on that.

        `more` findings stand before those; `rows` are the rows of the new points, if they are others; `shunt_gain` if
        the recording is the gain of a shunt divider.
        """
        rows = self.rows if rows is None else rows
        kept = (finding for finding in self.findings if finding.code not in _EXAMINED)
        return Reading(spectrum, (*kept, *more, *examine(spectrum, rows=rows, shunt_gain=shunt_gain)), rows)

    def corrected(self, correction: str) -> Reading:
        """The reading with its spectrum corrected, noted in the origin, and re-examined.

        `correction` is "negate", "conjugate" or "signs", see :func:`workbench.results.spectrum.corrected`.
        """
        return self.examined(corrected(self.spectrum, correction))

    def without_outliers(self) -> Reading:
        """The reading without the points in the ``rows`` of its findings.

        The origin and a finding state them.

        Raises:
            InputError: they are half of the points or more.
        """
        rows, spectrum = self.rows or Rows(tuple(range(1, self.spectrum.frequency.size + 1)), "point"), self.spectrum
        out = {row for finding in self.findings for row in finding.rows}
        kept = np.array([row not in out for row in rows.numbers])
        points = np.flatnonzero(~kept)
        if not len(points):
            return self
        words = f"{len(points)} of {len(kept)} points as outliers: {rows.named(points, spectrum.frequency)}"
        if 2 * len(points) >= len(kept):
            raise InputError(spectrum.origin.source or "recording", "without_outliers", words,
                             "fewer than half of the points; the recording as a whole is in doubt")
        origin = replace(spectrum.origin, settings={**spectrum.origin.settings, LEFT_OUT: words})
        return self.examined(replace(spectrum.at(kept), origin=origin), Finding("left_out", f"left out {words}"),
                             rows=Rows(rows.of(np.flatnonzero(kept)), rows.word))

    def share_apart(self, other: Reading) -> float:
        """Relative rms difference of another spectrum; infinite at other frequencies."""
        if not np.array_equal(self.spectrum.frequency, other.spectrum.frequency):
            return np.inf
        apart = np.abs(other.spectrum.impedance - self.spectrum.impedance)
        return float(np.sqrt(np.mean(apart**2) / np.mean(self.spectrum.magnitude**2)))


def in_order(
    table: Table, frequency: Real, impedance: Complex, *, values: Sequence[Real], column: int, origin: Origin,
    uncertainty: Real | None = None, shared_uncertainty: float = 0.0, findings: Sequence[Finding] = (),
) -> Reading:
    """The spectrum of the rows of a table, in order of frequency.

    The `frequency` (n,) Hz stands in the `column` (from one). `values` are the columns of numbers, (n,) each, behind
    the `impedance` (n,) ohm; points with NaN in one, which stands for no value
    (:data:`workbench.readers.text.NO_VALUE`), are left out, as are those without a frequency (zero: idle rows, direct
    current). A falling sweep is turned round, overlapping ones are merged, points of one frequency are joined: equal
    values to one, different ones to their mean. Without a stated noise, repeated readings give it. Findings report
    this, after `findings`, and the origin's setting :data:`PUT_IN_ORDER` holds their words.

    Raises:
        InputError: fewer than two frequencies, a negative one, none beside values, an impedance that is zero or not
            finite; several tables of the same headings that differ as states do.
    """
    text, lines = table.text, np.array(table.lines, dtype=np.intp)
    first = int(lines[0]) if lines.size else len(text.lines)
    found = [*findings, *_cut_off(table)]
    if lines.size < 2:
        raise text.error(first, None, f"{lines.size} rows of numbers", "at least 2; the file may be cut short")
    stated = np.ones(lines.size) if uncertainty is None else uncertainty
    kept, left_out = _with_values(table, frequency, [*values, stated], column)
    found += left_out
    lines, frequency, impedance, stated = lines[kept], frequency[kept], impedance[kept], stated[kept]
    wrong = np.flatnonzero(~np.isfinite(impedance) | (impedance == 0.0))
    if wrong.size:
        raise text.error(lines[wrong[0]], None, f"{impedance[wrong[0]]} ohm", "an impedance neither zero nor infinite")
    order, steps = np.argsort(frequency, kind="stable"), np.diff(frequency)
    monotonic = bool(np.all(steps > 0.0) or np.all(steps < 0.0))
    if lines.size and np.any(steps < 0.0):
        found.append(Finding("falling", f"the sweep falls ({text.row} {lines[0]} to {lines[-1]}): turned round")
                     if monotonic else Finding("order", _order(steps, lines.tolist(), text.row)))
    lines, frequency, impedance, stated = lines[order], frequency[order], impedance[order], stated[order]
    # A sweep that rises or falls throughout has no frequency twice, however small its steps.
    near = 0.0 if monotonic else ONE_FREQUENCY
    groups = np.concatenate(([0], np.cumsum(np.diff(frequency) > near * frequency[:-1])))
    if groups[-1] == 0:
        raise text.error(int(lines.min()) if lines.size else len(text.lines), column,
                         f"{lines.size} points at one frequency", "a sweep over at least 2 frequencies")
    if groups[-1] + 1 < lines.size:
        counts = np.bincount(groups)
        mean: Complex = np.asarray(
            (np.bincount(groups, impedance.real) + 1j * np.bincount(groups, impedance.imag)) / counts, complex)
        found.append(_joined(np.bincount(groups, frequency) / counts, impedance, mean, groups, counts))
        if found[-1].code == "disagree" and table.repeated:
            raise _labelled_states(table, found[-1])
        stated = np.sqrt(np.bincount(groups, stated**2)) / counts
        if uncertainty is None and found[-1].code == "averaged" and lines.size - len(counts) >= REPEATS:
            # Relative standard deviation of the real and imaginary part, each, about the mean of a group.
            off = np.abs(impedance - mean[groups]) / np.abs(mean[groups])
            noise = float(np.sqrt(np.sum(off**2) / (2.0 * (lines.size - len(mean)))))
            uncertainty = stated = noise * np.abs(mean) / np.sqrt(counts)
            found.append(Finding("noise", f"repeated readings scatter by {100.0 * noise:.2g} % of Z: taken as the "
                                 "noise of one"))
        single = np.concatenate(([True], np.diff(groups) > 0))
        frequency, impedance, lines = frequency[single], mean, lines[single]
    if found:
        # A spectrum is used without its findings, but its origin is shown everywhere.
        words = " ".join("; ".join(finding.message for finding in found).split())
        origin = replace(origin, settings={**origin.settings, PUT_IN_ORDER: words})
    spectrum = Spectrum(frequency, impedance, None if uncertainty is None else stated, origin, shared_uncertainty)
    return Reading(spectrum, tuple(found), Rows(tuple(lines.tolist()), text.row))


def _labelled_states(table: Table, disagree: Finding) -> InputError:
    """The error about several tables that differ as states do."""
    text = table.text
    places = []
    for line in (table.line + 1, *table.repeated):
        label = text.lines[line - 2].strip(" ,;\t") if line > 1 else ""
        # A row above is no label.
        named = label and not label[:1].isdigit()
        places.append(f"line {line}" + (f" (below {label[:40]!r})" if named else ""))
    return InputError(text.path, "rows", f"the same headings at {' and '.join(places)}", "the sweep of one device or "
                      f"state; here {disagree.message.partition(': their means')[0]}: keep one of these tables in a "
                      "copy of the file")


def _with_values(
    table: Table, frequency: Real, values: Sequence[Real], column: int
) -> tuple[NDArray[np.bool_], list[Finding]]:
    """Mask (n,) of the points with values, and findings on the others.

    Raises:
        InputError: fewer than two points with values, a frequency that is negative, or none beside values.
    """
    text, lines, found = table.text, np.array(table.lines), list[Finding]()
    lost = np.any(np.isnan(values), axis=0)
    for wrong, value, expected in (
            (np.isnan(frequency) & ~lost, "no number", "a finite frequency; if the analyser had none there, take the "
             f"{text.row} out of a copy of the file"), (~lost & (frequency < 0.0), "", "a frequency above zero")):
        if np.any(wrong):
            index = int(np.argmax(wrong))
            raise text.error(lines[index], column, value or float(frequency[index]), expected)
    if np.any(lost):
        words = (f"{rows_in_words(lines[lost].tolist(), text.row)}: no value (9.9e37 or more, or a word such as OVLD "
                 "or nan, which is written for overload or for nothing measured)")
        if np.count_nonzero(~lost) < 2:
            raise InputError(text.path, "rows", words, "at least 2 rows with values")
        found.append(Finding("no_value", f"{words}: left out, {np.count_nonzero(lost)} of {lines.size} rows"))
    idle = ~lost & (frequency == 0.0)
    if np.any(idle):
        found.append(Finding("idle", f"{rows_in_words(lines[idle].tolist(), text.row)} without a frequency (zero): "
                             "left out"))
    return ~lost & ~idle, found


def _cut_off(table: Table) -> list[Finding]:
    """The finding, if any, that the file ends within a number.

    Some programs write no end of the last line, so that a missing end alone is no sign. Where all cells above have the
    same number of decimals, the last one has too; where they differ, only a cell with fewer digits than all others in a
    line without an end is a sign, in a short table fewer by three than usual.
    """
    text, lines = table.text, table.lines
    last = max((line for line, content in enumerate(text.lines, 1) if content.strip()), default=0)
    if text.row != "line" or last not in lines:
        return []
    *above, end = (_last_cell(text.lines[line - 1]) for line in (*(line for line in lines if line != last), last))
    few, many = FEW_ROWS
    if len(above) < (many if text.ended else few):
        return []
    forms = {form for form, _ in above}
    (decimals, exponent), digits = end
    if len(forms) == 1:
        whole = next(iter(forms))
        short = decimals < whole[0] or exponent < whole[1]
    else:
        sizes = [size for _, size in above]
        fewest = min(sizes) if len(above) >= many else min(*sizes, float(np.median(sizes)) - 2.0)
        short = not text.ended and digits < fewest
    ending = "" if text.ended else ", whose line has no end,"
    return [Finding("cut_off", f"line {last}: its last cell{ending} is shorter than all above it: the file may have "
                    "been cut off; record or copy it again", (last,))] if short else []


def _last_cell(content: str) -> tuple[tuple[int, int], int]:
    """Decimals, exponent's length and digits of a line's last number."""
    content = content.replace(",", ".") if re.search("[;\t]", content) else content
    found = _LAST_NUMBER.search(content.partition("!")[0].rstrip(' \t.;")jiJI'))
    whole, decimals, exponent = (found[1], found[2] or "", found[3] or "") if found else ("", "", "")
    return (len(decimals), len(exponent)), len((whole + decimals).lstrip("0"))


def _order(steps: Real, lines: Sequence[int], word: str) -> str:
    """The order of frequencies that neither rise nor fall throughout, in words."""
    signs = np.sign(steps)
    moves = signs[signs != 0.0]
    if np.count_nonzero(np.diff(moves)) == 1:
        # The turn of a loop; two rising sweeps one after the other turn twice.
        turn = int(np.argmax(signs == moves[-1]))
        words = ("rises", "falls") if moves[0] > 0.0 else ("falls", "rises")
        if np.count_nonzero(signs == moves[0]) > 1 and np.count_nonzero(signs == moves[-1]) > 1:
            return f"the sweep {words[0]} to {word} {lines[turn]} and {words[1]} again: put in order of frequency"
    back = [lines[int(index) + 1] for index in np.flatnonzero(signs == (-1.0 if np.sum(moves) >= 0.0 else 1.0))]
    turns = ", ".join(map(str, back[:5])) + (" ..." if len(back) > 5 else "")
    falling = "falling " if np.sum(moves) < 0.0 else ""
    return (f"the frequencies are out of order at {word} {turns}: {len(back) + 1} {falling}sweeps or segments that "
            "follow each other, put in order of frequency")


def _joined(
    frequency: Real, impedance: Complex, mean: Complex, groups: NDArray[np.int64], counts: NDArray[np.int64]
) -> Finding:
    """The finding on frequencies that occur more than once."""
    size, apart = np.abs(mean), np.zeros(len(mean))
    np.maximum.at(apart, groups, np.abs(impedance - mean[groups]) / np.maximum(size[groups], 1e-300))
    many = counts > 1
    worst = int(np.argmax(np.where(many, apart, -1.0)))
    of = f"{np.count_nonzero(many)} of {len(mean)} frequencies stand in the file more than once"
    if apart[worst] <= ONE_VALUE:
        return Finding("joined", f"{of}, with the same values: joined")
    # The whole difference of two values is twice that from their mean.
    differ = f"{of}, with values up to {200.0 * apart[worst]:.2g} % apart (at {frequency_text(frequency[worst])})"
    step = np.abs(np.diff(mean)) / np.minimum(size[:-1], size[1:])
    beside = np.minimum(np.concatenate((step[:1], step)), np.concatenate((step, step[-1:])))
    times, least, most = TWO_STATES
    far = many & ((2.0 * apart > np.maximum(times * beside, least)) | (2.0 * apart > most))
    if 2 * np.count_nonzero(far) >= np.count_nonzero(many):
        return Finding("disagree", f"{differ}, much more than neighbouring frequencies are: their means were taken, "
                       "but these sweeps are probably of different states of the device; keep only one of them in a "
                       "copy of the file")
    return Finding("averaged", f"{differ}: their means were taken")
