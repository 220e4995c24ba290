"""What looks wrong in a spectrum that could be read: signs, activity, units. Reported, never mended silently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.spectrum import Spectrum

#: Lowest and highest impedance and lowest frequency that bench analysers of this kind reach (E4990A data sheet:
#: 20 Hz; 25 milliohm to 40 megohm), with a margin: outside, a unit has probably been misread.
PLAUSIBLE_OHM = (1e-3, 1e9)
PLAUSIBLE_HZ = 20.0


@dataclass(frozen=True)
class Finding:
    """One thing noticed. ``code`` is a key of this module's rules, ``message`` says what and what may be done."""

    code: str
    message: str


def examine(spectrum: Spectrum, *, shunt_gain: bool = False) -> tuple[Finding, ...]:
    """Everything noticed in `spectrum`; `shunt_gain` if it was computed from the gain of a shunt divider.

    - ``inverse_ratio`` or ``negated``: Re Z < 0 at nine points in ten or more, which a passive device never shows.
    - ``active``: Re Z < 0 at fewer points.
    - ``conjugated``: the reflection coefficient turns anticlockwise with rising frequency. Foster's reactance
      theorem, dX/dw >= |X|/w for a lossless one-port, makes it turn clockwise, for an inductor as for a capacitor or
      a resonator, so a genuine inductor is not accused.
    - ``magnitude``, ``frequency``: values no analyser of this kind reaches.
    """
    findings: list[Finding] = []
    resistance = spectrum.impedance.real
    active = int(np.count_nonzero(resistance < 0.0))
    points = len(resistance)
    if active >= 0.9 * points:
        if shunt_gain:
            findings.append(Finding("inverse_ratio", f"Re Z < 0 at {active} of {points} points: the gain is "
                                    "probably the inverse ratio; read with inverse=True (or False if it was set)"))
        else:
            findings.append(Finding("negated", f"Re Z < 0 at {active} of {points} points: the phase is probably "
                                    "off by 180 degrees (reversed polarity); read with correction='negate'"))
    else:
        if active:
            worst = int(np.argmax(-resistance / spectrum.magnitude))
            findings.append(Finding("active", f"Re Z < 0 at {active} of {points} points, worst "
                                    f"{spectrum.phase_deg[worst]:.2f} degrees at {spectrum.frequency[worst]:.9g} Hz: "
                                    "a passive device cannot do so (noise, or the analyser's compensation)"))
        if _turns_anticlockwise(spectrum):
            findings.append(Finding("conjugated", "possible phase-sign error: the reflection coefficient turns "
                                    "anticlockwise with rising frequency; read with correction='conjugate'"))
    typical = float(np.median(spectrum.magnitude))
    if not PLAUSIBLE_OHM[0] <= typical <= PLAUSIBLE_OHM[1]:
        findings.append(Finding("magnitude", f"the median |Z| is {typical:.3g} ohm: is the unit right?"))
    if spectrum.frequency[-1] < PLAUSIBLE_HZ:
        findings.append(Finding("frequency", f"the highest frequency is {spectrum.frequency[-1]:.6g} Hz: is the unit "
                                "right?"))
    return tuple(findings)


def _turns_anticlockwise(spectrum: Spectrum) -> bool:
    """Whether twice the area swept about the origin of the reflection plane is clearly positive.

    A capacitor or inductor sweeps at least 2 |X| Z0 / (X^2 + Z0^2), about one, times ln(f2 / f1) in the other sense;
    a quarter of that is demanded, so that a resistor (which sweeps nothing but noise) is left alone.
    """
    z0 = float(np.exp(np.mean(np.log(spectrum.magnitude))))
    reflection = (spectrum.impedance - z0) / (spectrum.impedance + z0)
    swept = float(np.sum((np.conj(reflection[:-1]) * reflection[1:]).imag))
    return swept > 0.25 * float(np.log(spectrum.frequency[-1] / spectrum.frequency[0]))
