"""Comparison of recorded focusing with the simulated energy of the sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import cast

import numpy as np
from numpy.typing import NDArray

from geometry.measure import Straight
from geometry.names import CAVITY
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.files.errors import InputError, expect
from workbench.files.quantities import frequency_text
from workbench.model.drive import VoltageDrive
from workbench.model.fluid_slopes import fluid_slopes
from workbench.results.brief import Brief
from workbench.results.energy_recording import FOCUSING_TIME, EnergyRecording
from workbench.results.lorentzian import FittedPeak, PeakFit
from workbench.simulation.energy import EnergyPeak, EnergySpectrum
from workbench.simulation.run import Simulation

Real = NDArray[np.float64]

#: Least height of a compared peak, relative to the largest simulated one. Halved, invisible peaks are compared.
LEAST_SHARE = 0.1

#: Relative difference of frequencies above which a first-order change is no explanation: the modes may differ.
FIRST_ORDER = 0.05

#: Largest change of temperature (K) computed with a slope dc/dT: that of water halves within 30 K.
LARGEST_WARMING = 20.0


@dataclass(frozen=True)
class ComparedPeak:
    """A recorded peak and its simulated partner. One of them is None if it has no partner. Differences are (simulated -
    recorded) / recorded."""

    recorded: FittedPeak | None
    simulated: EnergyPeak | None

    @property
    def difference(self) -> float | None:
        """Relative difference of the frequencies."""
        if self.recorded is None or self.simulated is None:
            return None
        return self.simulated.frequency / self.recorded.frequency - 1.0

    @property
    def widths(self) -> float | None:
        """Difference of the frequencies over the recorded half-power width."""
        found = self.difference
        return None if found is None or self.recorded is None else found * self.recorded.q

    @property
    def q_difference(self) -> float | None:
        """Relative difference of the quality factors."""
        if self.recorded is None or self.simulated is None or self.simulated.q is None:
            return None
        return self.simulated.q / self.recorded.q - 1.0


@dataclass(frozen=True, eq=False, repr=False)
class EnergyComparison(Brief):
    """A recording of focusing and a simulated energy spectrum.

    The spectrum is under a constant voltage at the electrodes. ``fit`` are the recorded peaks, ``peaks`` the pairs.
    ``factor`` is the geometric mean of recorded over simulated at the recorded frequencies within the simulated band,
    ``inside`` (n,). ``rms_log_residual`` is the rms of ln(recorded / simulated), after removing that factor if the
    recording is not absolute. ``findings`` are sentences.
    """

    recording: EnergyRecording
    spectrum: EnergySpectrum
    fit: PeakFit
    peaks: tuple[ComparedPeak, ...]
    factor: float
    rms_log_residual: float
    inside: NDArray[np.bool_]
    findings: tuple[str, ...]

    @property
    def scaled_by(self) -> float:
        """The divisor of recorded rates for a comparison: 1 if absolute."""
        return 1.0 if self.recording.is_absolute else self.factor

    @property
    def basis(self) -> str:
        """The compared quantity and the factor, in words."""
        if self.recording.is_absolute:
            return ("E_ac per Vpp^2 is compared without scaling: the recorded one is "
                    f"{self.factor:.3g} times the simulated one (geometric mean over the points).")
        voltage = ", over the square of the voltage" if self.recording.voltage is not None else (
            ", at a voltage that is assumed equal at all frequencies")
        rate = "1/t*" if self.recording.kind == FOCUSING_TIME else "E_ac"
        return (f"Only the shape counts: the recorded {rate}{voltage}, is divided by one factor, {self.factor:.4g}, "
                "its geometric mean ratio to the simulated E_ac per Vpp^2.")


def compare_energy(
    recording: EnergyRecording, simulated: EnergySpectrum | Simulation, *, registry: Registry | None = None
) -> EnergyComparison:
    """Compare recorded focusing with the energy in a simulated cavity.

    `simulated` is the spectrum of the energy, or a simulation. With a simulation, a difference of frequencies is also
    expressed as one of width, sound speed and temperature (by the law in the `registry`).

    Raises:
        InputError: a simulation without an energy spectrum, or fewer than two recorded frequencies in its band.
    """
    expect(recording, EnergyRecording, reader="read_energy_recording", source="compare_energy", field="recording")
    run = simulated if isinstance(simulated, Simulation) else None
    spectrum = run.energy if run is not None else simulated
    if not isinstance(spectrum, EnergySpectrum):
        raise InputError("compare_energy", "simulated", f"state {run.state}" if run is not None else simulated,
                         "a simulation of a state with a liquid by the reduced model, or wb.energy_spectrum of one")
    low, high = float(spectrum.frequency[0]), float(spectrum.frequency[-1])
    inside = (recording.frequency >= low) & (recording.frequency <= high)
    if np.count_nonzero(inside) < 2:
        raise InputError(recording.source or "compare_energy", "frequency",
                         frequency_text(*recording.frequency[[0, -1]]),
                         f"2 points or more in the simulated band, {frequency_text(low, high)}")
    per_square_volt = spectrum.evaluate(recording.frequency[inside])[0] / 4.0
    away = np.log(recording.rate[inside] / per_square_volt)
    factor = float(np.exp(away.mean()))
    fit = recording.peaks()
    peaks = _pairs(fit.peaks, spectrum, (float(recording.frequency[0]), float(recording.frequency[-1])))
    findings = [*recording.findings, *fit.findings]
    if not np.all(inside):
        findings.append(f"{np.count_nonzero(~inside)} of {inside.size} recorded points lie outside the simulated band, "
                        f"{low / 1e6:.4f} to {high / 1e6:.4f} MHz, and are not compared: --from and --to widen it")
    findings += [text for pair in peaks for text in _differences(pair, run, registry or Registry())]
    rest = away if recording.is_absolute else away - away.mean()
    return EnergyComparison(recording, spectrum, fit, peaks, factor, float(np.sqrt(np.mean(rest**2))), inside,
                            tuple(findings))


def _pairs(
    recorded: Sequence[FittedPeak], spectrum: EnergySpectrum, band: tuple[float, float]
) -> tuple[ComparedPeak, ...]:
    """Recorded peaks with the nearest simulated ones, then other simulated ones. The latter are within the recorded
    `band`."""
    found = spectrum.peaks(VoltageDrive(1.0))
    seen = [peak for peak in found if peak.per_square_volt >= LEAST_SHARE * found[0].per_square_volt]
    # A recorded peak beyond the simulated ones has no partner.
    choices = permutations([*seen, *[None] * max(len(recorded) - len(seen), 0)], len(recorded))
    chosen = min(choices, key=lambda them: sum(
        0.0 if one is None else abs(np.log(one.frequency / each.frequency))
        for each, one in zip(recorded, them, strict=True)))
    pairs = [ComparedPeak(each, one) for each, one in zip(recorded, chosen, strict=True)]
    return (*pairs, *(ComparedPeak(None, peak) for peak in seen
                      if peak not in chosen and band[0] <= peak.frequency <= band[1]))


def _differences(pair: ComparedPeak, run: Simulation | None, registry: Registry) -> list[str]:
    """Findings on a pair that differs by more than the recording's interval."""
    recorded, simulated, found = pair.recorded, pair.simulated, list[str]()
    if recorded is None:
        return [] if simulated is None else [
            f"the simulation has a peak at {simulated.frequency / 1e6:.4f} MHz, within the recorded band, which the "
            "fit of the recording lacks"]
    if simulated is None:
        return [f"the recorded peak at {recorded.frequency / 1e6:.4f} MHz has no simulated one: no further peak of the "
                "energy is in the simulated band"]
    interval = recorded.frequency_interval
    if interval is not None and not interval[0] <= simulated.frequency <= interval[1]:
        difference, widths = pair.difference or 0.0, pair.widths or 0.0
        found.append(
            f"the simulated peak, {simulated.frequency / 1e6:.4f} MHz, lies {100.0 * abs(difference):.2g} % or "
            f"{abs(widths):.2g} recorded widths {'above' if difference > 0.0 else 'below'} the recorded one, outside "
            f"its 95 % interval, {interval[0] / 1e6:.4f} to {interval[1] / 1e6:.4f} MHz"
            + _explained(recorded.frequency / simulated.frequency - 1.0, run, registry))
    interval = recorded.q_interval
    if interval is not None and simulated.q is not None and not interval[0] <= simulated.q <= interval[1]:
        more = "more" if simulated.q > recorded.q else "less"
        found.append(
            f"the simulated Q, {simulated.q:.3g}, is {simulated.q / recorded.q:.2g} times the recorded one, outside "
            f"its 95 % interval, {interval[0]:.3g} to {interval[1]:.3g}: the device has {more} loss than the model"
            + (", or its peak moved while it was recorded" if more == "more" else ""))
    return found


def _explained(wanted: float, run: Simulation | None, registry: Registry) -> str:
    """First-order changes that shift the simulated peak by the share `wanted`."""
    if abs(wanted) > FIRST_ORDER:
        return ". So far apart they may be different modes"
    share = f"{100.0 * abs(wanted):.2g} %"
    width, sound = f"a cavity {share} {'narrower' if wanted > 0.0 else 'wider'}", (
        f"sound {share} {'faster' if wanted > 0.0 else 'slower'} in the liquid")
    if run is not None and isinstance(run.chip.measure, Straight):
        across = 2.0 * run.chip.dimensions()["cavity.half_width"].value
        width += f" ({-1e6 * wanted * across:+.2g} um of {1e6 * across:.4g} um)"
    liquid = None if run is None else run.problem.materials.get(CAVITY)
    if isinstance(liquid, Fluid):
        slopes = fluid_slopes(liquid, lambda temperature: cast(Fluid, registry.load(
            liquid.name, temperature=temperature)))
        kelvin = np.inf if slopes is None else wanted / slopes[f"{liquid.name}.speed_slope"]
        warmer = f", which {kelvin:+.2g} K give" if abs(kelvin) <= LARGEST_WARMING else ""
        sound += f" ({wanted * liquid.sound_speed:+.2g} m/s of {liquid.sound_speed:.4g} m/s{warmer})"
    return (f". {width[0].upper()}{width[1:]}, or {sound}, would remove the difference. That holds to first order, "
            "df/f = -dw/w = dc/c, for half a wave across a cavity that sets the frequency alone, with its liquid")
