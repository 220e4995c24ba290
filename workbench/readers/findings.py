"""Findings on a readable spectrum that looks wrong: signs, activity, units. They are reported, never mended silently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.files.quantities import frequency_text
from workbench.readers.outliers import off_the_grid, outliers
from workbench.results.signs import lost_signs, with_signs
from workbench.results.spectrum import CORRECTION, Spectrum, scatter, turns_anticlockwise

#: Lowest and highest impedance and lowest frequency that bench analysers of this kind reach (E4990A data sheet: 20 Hz;
#: 25 milliohm to 40 megohm), with a margin. A value outside is probably in a misread unit.
PLAUSIBLE_OHM = (1e-3, 1e9)
PLAUSIBLE_HZ = 20.0
#: Factor beyond :data:`PLAUSIBLE_OHM` at which one point is wrong by itself. Doubled, nothing changes.
BEYOND = 1e3
#: Standard deviations of Re Z / |Z| below zero that are more than noise. Doubled, an active point passes for noise.
BEYOND_NOISE = 5.0

#: A step between two points is out of line if a mirror image of one side fits the other better by the first of these
#: factors (squares of second differences), if the other end of such a stretch fits better by the second, and if the
#: misfit is the third times the usual one of the file (median). Doubled, flips at coarsely sampled resonances go
#: unseen.
OUT_OF_LINE = (8.0, 2.0, 6.0)


#: Ratio of a radian to a degree. Phases that Bode's relation makes this much too small were in radians; halfway between
#: the two units, by ratio, neither is likelier.
RADIAN = float(np.degrees(1.0))

#: Stretches of rows that a finding names. Doubled, it fills the screen.
NAMED = 8


@dataclass(frozen=True)
class Finding:
    """One finding: its ``code``, and a ``message`` with the possible remedy.

    ``rows`` of the file hold points that :meth:`workbench.readers.Reading.without_outliers` leaves out.
    """

    code: str
    message: str
    rows: tuple[int, ...] = ()


@dataclass(frozen=True)
class Rows:
    """The row ``numbers`` (n,) of every point, and the ``word`` for one."""

    numbers: tuple[int, ...]
    word: str = "line"

    def of(self, points: NDArray[np.intp]) -> tuple[int, ...]:
        """The rows of some points."""
        return tuple(self.numbers[int(point)] for point in points)

    def named(self, points: NDArray[np.intp], frequency: NDArray[np.float64]) -> str:
        """Some points in words; one point with its `frequency` (n,) Hz."""
        words = rows_in_words(self.of(points), self.word)
        return f"{words} ({frequency_text(frequency[points[0]])})" if len(points) == 1 else words


def rows_in_words(numbers: Sequence[int], word: str = "line") -> str:
    """Rows in words: "line 3", "lines 3, 7 and 9 to 12"."""
    ends: list[list[int]] = []
    for number in sorted(set(numbers)):
        if ends and number == ends[-1][1] + 1:
            ends[-1][1] = number
        else:
            ends.append([number, number])
    said = [str(a) if a == b else f"{a} to {b}" for a, b in ends[:NAMED]]
    rest = sum(b - a + 1 for a, b in ends[NAMED:])
    said += [f"{rest} more"] if rest else []
    head = word if ends[0][0] == ends[-1][1] else f"{word}s"
    return f"{head} {' and '.join(filter(None, (', '.join(said[:-1]), said[-1])))}"


#: Remedy for points that are named with their rows.
LEAVE_OUT = "--without-outliers (without_outliers=True) leaves {it} out"


def examine(spectrum: Spectrum, *, rows: Rows | None = None, shunt_gain: bool = False) -> tuple[Finding, ...]:
    """All findings on a spectrum.

    Without the `rows` of the file points are counted from one; `shunt_gain` if the spectrum was computed from the gain
    of a shunt divider.

    - ``inverse_ratio`` or ``negated``: Re Z < 0 at nine points in ten or more, which a passive device never shows.
    - ``active``: Re Z < 0 at fewer points.
    - ``outlier``: points that leave their neighbours by far more than the noise (:mod:`workbench.readers.outliers`),
      or with |Z| that nothing has. The findings below are on the rest.
    - ``spacing``: frequencies beside the even steps of the others.
    - ``conjugated``: the reflection coefficient turns anticlockwise with rising frequency. Foster's reactance
      theorem, dX/dw >= |X|/w for a lossless one-port, makes it turn clockwise, for an inductor as for a capacitor or
      a resonator, so a genuine inductor is not accused.
    - ``stretch``: some points do not join their neighbours, as if their sign were turned. Then no correction is
      advised, since each applies to every point.
    - ``unsigned``: the reactance is never of the other sign and touches zero with a kink: it was written without its
      sign. The findings below are on the spectrum with its signs.
    - ``radians``: |Z| changes far more than its phases allow, and as much as they would if they were in radians.
    - ``magnitude``, ``frequency``: values no analyser of this kind reaches.
    """
    frequency = spectrum.frequency
    points = len(frequency)
    rows = Rows(tuple(range(1, points + 1)), "point") if rows is None else rows
    kinks = lost_signs(spectrum.impedance)
    if len(kinks):
        places = ", ".join(frequency_text(frequency[k]) for k in kinks[:3])
        said = f"{rows_in_words(rows.of(kinks), rows.word)} ({places})"
        word = "negative" if spectrum.impedance.imag[kinks[0]] >= 0.0 else "positive"
        lost = Finding("unsigned", f"the phase (or reactance) is never {word} and touches zero with a kink behind "
                       f"{said}: it was written without its sign; read with "
                       f"{CORRECTION.format(name='signs')}, which puts the signs back from the kinks")
        signed = replace(spectrum, impedance=with_signs(spectrum.impedance))
        return lost, *examine(signed, rows=rows, shunt_gain=shunt_gain)
    odd_points = outliers(frequency, spectrum.impedance)
    # A single wrong point breaks a curve as the end of a turned stretch does, so the rest is looked at without it.
    smooth = ~np.isin(np.arange(points), list(odd_points))
    rest = np.flatnonzero(smooth)
    stretches = [] if rest.size < 2 else [
        (int(rest[begin]), int(rest[end - 1]) + 1) for begin, end in _stretches(spectrum.at(smooth))]
    turned = np.concatenate([np.arange(begin, end) for begin, end in stretches]) if stretches else np.empty(0, np.intp)
    findings = _odd_points(spectrum, odd_points, rows, turned)
    if stretches:
        words = " and ".join(rows.named(np.arange(begin, end), frequency) for begin, end in stretches)
        findings.append(Finding("stretch", f"{words} do not join their neighbours, as if a sign were turned there: "
                                "look at them in the file, or measure again; no correction mends them, since each "
                                f"turns every point; {LEAVE_OUT.format(it='them')}", rows.of(turned)))
    odd = {row for finding in findings for row in finding.rows}
    whole = np.array([row not in odd for row in rows.numbers])
    resistance = spectrum.impedance.real
    active = int(np.count_nonzero(resistance < 0.0))
    if active < 0.9 * points:
        findings += _active(spectrum, rows, whole)
    if np.count_nonzero(whole) >= max(2, points / 2):
        spectrum = spectrum.at(whole)
    if active >= 0.9 * points and not stretches:
        if shunt_gain:
            findings.append(Finding("inverse_ratio", f"Re Z < 0 at {active} of {points} points: the gain is "
                                    "probably the inverse ratio; set inverse = true in the column map (false if it "
                                    "was true)"))
        else:
            findings.append(Finding("negated", f"Re Z < 0 at {active} of {points} points: the phase is probably "
                                    "off by 180 degrees (reversed polarity); read with "
                                    f"{CORRECTION.format(name='negate')}"))
    elif not stretches and turns_anticlockwise(spectrum):
        findings.append(Finding("conjugated", "possible phase-sign error: the reflection coefficient turns "
                                "anticlockwise with rising frequency; read with "
                                f"{CORRECTION.format(name='conjugate')}"))
    findings += _in_radians(spectrum)
    typical = float(np.median(spectrum.magnitude))
    if not PLAUSIBLE_OHM[0] <= typical <= PLAUSIBLE_OHM[1]:
        findings.append(Finding("magnitude", f"the median |Z| is {typical:.3g} ohm: is the unit right?"))
    if spectrum.frequency[-1] < PLAUSIBLE_HZ:
        findings.append(Finding("frequency", f"the highest frequency is "
                                f"{frequency_text(spectrum.frequency[-1])}: is the unit right?"))
    return tuple(findings)


def _odd_points(
    spectrum: Spectrum, odd: Mapping[int, float], rows: Rows, turned: NDArray[np.intp]
) -> list[Finding]:
    """The findings on points apart from the rest.

    `odd` are those that leave their neighbours, with their deviations; points in a stretch that is `turned` have a
    finding of their own.
    """
    frequency, size, found = spectrum.frequency, spectrum.magnitude, dict(odd)
    low, high = PLAUSIBLE_OHM[0] / BEYOND, PLAUSIBLE_OHM[1] * BEYOND
    typical = float(np.median(size))
    if low <= typical <= high:
        # Tables too short for a comparison of neighbours have such points too.
        found |= {int(i): float(np.log(size[i] / typical)) for i in np.flatnonzero((size < low) | (size > high))}
    findings = []
    points = np.array(sorted(set(found) - set(turned.tolist())), dtype=np.intp)
    if len(points):
        worst = max(points.tolist(), key=lambda point: abs(found[point]))
        away = abs(found[worst])
        by = f"{100.0 * np.expm1(away):.2g} %" if away < 1.0 else f"a factor of {np.exp(min(away, 700.0)):.2g}"
        by += f" at {frequency_text(frequency[worst])}" if len(points) > 1 else ""
        leave, it = ("leaves its", "it") if len(points) == 1 else ("leave their", "them")
        findings.append(Finding("outlier", f"{rows.named(points, frequency)} {leave} neighbours by far more than the "
                                f"noise, by up to {by}: a faulty reading, or a resonance narrower than the step; "
                                f"{LEAVE_OUT.format(it=it)}", rows.of(points)))
    points, step = off_the_grid(frequency)
    if len(points):
        it = "it" if len(points) == 1 else "them"
        findings.append(Finding("spacing", f"{rows.named(points, frequency)}: beside the even steps of the other "
                                f"frequencies ({step}): a digit may be wrong; {LEAVE_OUT.format(it=it)}",
                                rows.of(points)))
    return findings


def _active(spectrum: Spectrum, rows: Rows, whole: NDArray[np.bool_]) -> list[Finding]:
    """The finding on points with Re Z < 0.

    Its rows are those beyond the noise of the `whole` points.
    """
    share = spectrum.impedance.real / spectrum.magnitude
    active = np.flatnonzero(share < 0.0)
    if not len(active):
        return []
    worst = int(np.argmin(share))
    noise = scatter(spectrum.at(whole)) if np.count_nonzero(whole) > 1 else 0.0
    beyond = active[share[active] < -BEYOND_NOISE * noise]
    words = (f"Re Z < 0 at {len(active)} of {len(share)} points, worst {spectrum.phase_deg[worst]:.2f} degrees at "
             f"{frequency_text(spectrum.frequency[worst])}: a passive device cannot do so (noise, or the analyser's "
             "compensation)")
    if len(beyond):
        words += f"; beyond the noise: {rows.named(beyond, spectrum.frequency)}; {LEAVE_OUT.format(it='them')}"
    return [Finding("active", words, rows.of(beyond))]


def _in_radians(spectrum: Spectrum) -> list[Finding]:
    """The finding on phases in radians that were read as degrees.

    By Bode's relation a phase phi goes with a slope d ln |Z| / d ln f of 2 phi / pi, and ln |Z| of a resonance changes
    by no more than its phase does. The sum of the two is the largest change of ln |Z| that the phases allow.
    """
    phase = np.angle(spectrum.impedance)
    largest = float(np.max(np.abs(phase)))
    # A phase in radians does not exceed pi.
    if np.degrees(largest) > np.pi:
        return []
    sweep = float(np.log(spectrum.frequency[-1] / spectrum.frequency[0]))
    allowed = 2.0 / np.pi * largest * sweep + float(np.ptp(phase))
    change = float(np.ptp(np.log(spectrum.magnitude)))
    if not allowed * RADIAN**0.5 < change < allowed * RADIAN**1.5:
        return []
    return [Finding("radians", f"no phase is beyond {np.degrees(largest):.2g} degrees, but |Z| changes by a factor of "
                    f"{np.exp(change):.3g}, which takes phases about {RADIAN:.0f} times as large: are the phases in "
                    'radians? If so, read with --columns MAP.toml, phase_unit = "rad" in its quantity and the column '
                    "of the phase by its number (such as second = 3), which overrules its heading")]


def _stretches(spectrum: Spectrum) -> list[tuple[int, int]]:
    """Stretches of points that a mirror image would join to the rest.

    Each is the index of the first and the index after the last. The mirror images are those of a sign that is turned in
    an instrument: of Im S or Im Z, of Re S, of S, of Re Z and of Z. Between smooth data and such an image the second
    difference of the reflection coefficient breaks at both ends of the stretch, and is small there once the stretch is
    mirrored back.
    """
    points = len(spectrum.frequency)
    if points < 6:
        return []
    # A recording of reversed polarity passes the pole of its reflection coefficient; its negative does not.
    reversed_ = np.count_nonzero(spectrum.impedance.real < 0.0) > 0.5 * points
    impedance = -spectrum.impedance if reversed_ else spectrum.impedance
    best: list[tuple[int, int]] = []
    least = np.inf
    for z0 in (50.0, float(np.exp(np.mean(np.log(spectrum.magnitude))))):
        with np.errstate(divide="ignore", invalid="ignore"):
            value: NDArray[np.complex128] = np.asarray((impedance - z0) / (impedance + z0))
            if not np.all(np.isfinite(value)) or np.any(value == 0.0):
                continue
            images: tuple[NDArray[np.complex128], ...] = (
                np.conj(value), -np.conj(value), -value, np.asarray(1.0 / value), np.asarray(1.0 / np.conj(value)))
        for image in images:
            found, left = _turned(value, image)
            if found and left < least:
                best, least = found, left
    return best


def _turned(value: NDArray[np.complex128], image: NDArray[np.complex128]) -> tuple[list[tuple[int, int]], float]:
    """The stretches that `image` (n,) would join, and the remaining roughness."""
    points = len(value)
    usual = float(np.median(np.abs(np.diff(value, 2)) ** 2))

    def misfit(left: NDArray[np.complex128], right: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Squares (n - 3,) of the second differences across every step."""
        return np.asarray(np.abs(left[:-3] - 2.0 * left[1:-2] + right[2:-1]) ** 2
                          + np.abs(left[1:-2] - 2.0 * right[2:-1] + right[3:]) ** 2)

    plain, mirrored = misfit(value, value), misfit(value, image)
    factor, weaker, rough = OUT_OF_LINE
    gain = plain / np.maximum(mirrored, 1e-300)
    if not np.any((gain > factor) & (plain > 2.0 * rough * usual)):
        return [], np.inf
    # Near the axis of the mirror both steps about a point may fit; the one that fits best is taken.
    most = (gain >= np.concatenate((gain[1:], [0.0]))) & (gain > np.concatenate(([0.0], gain[:-1])))
    places = np.flatnonzero((gain > weaker) & (plain > 2.0 * usual) & most)
    if len(places) % 2 and len(places) > 1:
        places = np.delete(places, np.argmin(gain[places]))
    ends = (places + 2).tolist()
    if len(ends) == 1:
        # With one end, the shorter side is turned. A sharp resonance between two points looks a little like it.
        if gain[places[0]] < factor**2:
            return [], np.inf
        ends = [ends[0], points] if ends[0] > points / 2 else [0, ends[0]]
    if sum(ends[1::2]) - sum(ends[::2]) > points / 2:
        # The larger part is the one that the rest does not join.
        ends = [0, *ends, points]
    found = [(begin, end) for begin, end in zip(ends[::2], ends[1::2], strict=True) if begin < end]
    mended = value.copy()
    for begin, end in found:
        mended[begin:end] = image[begin:end]
    rest = float(np.sum(np.abs(np.diff(mended, 2)) ** 2))
    whole = float(np.sum(np.abs(np.diff(value, 2)) ** 2))
    return (found, rest / whole) if rest * 3.0 < whole else ([], np.inf)
