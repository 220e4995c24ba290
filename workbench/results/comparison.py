"""Comparison of a simulated spectrum with a measured one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.files.quantities import frequency_text
from workbench.results.merit import Figures, NoResonance, figures
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Spectrum, WithSpectrum, spectrum_of

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class MetricRow:
    """One line of a table like Table 5 of Acevedo-Espinosa et al. (RP-UEIS)."""

    metric: str
    measured: float
    simulated: float

    @property
    def difference_percent(self) -> float:
        """100 (simulated - measured) / measured, in per cent."""
        return 100.0 * (self.simulated - self.measured) / self.measured


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown):
    """Differences between `simulated` and `measured` over their common band.

    Both are on the n points of the measured grid in that band; ``fraction_used`` is n over the measured points.
    ``log_residual`` (n,) is ln(Z_sim / Z_meas): its real part is the relative error of magnitude, its imaginary part
    the error of phase in radian, principal value. (Passive impedances differ by at most 180 degrees of phase, so no
    unwrapping is needed.) ``mape_percent`` is the mean of | |Z_sim| - |Z_meas| | / |Z_meas|, ``rms_log_residual`` the
    root mean square of |ln(Z_sim / Z_meas)|, ``worst_percent`` the largest relative error of |Z|, at
    ``worst_frequency``, usually on a peak. ``reduced_chi_square`` (2 n real data, no parameter discounted; the
    uncertainties of both spectra added in squares) is None if neither is known. ``rows`` compare f0, Z_min and Q, and
    before them fs and Q by the conductance if a resonance is weak. Without a resonance they are empty and
    ``rows_missing`` gives the reason.
    """

    measured: Spectrum
    simulated: Spectrum
    fraction_used: float
    log_residual: NDArray[np.complex128]
    mape_percent: float
    rms_log_residual: float
    phase_mean_deg: float
    phase_max_deg: float
    worst_percent: float
    worst_frequency: float
    reduced_chi_square: float | None
    rows: tuple[MetricRow, ...]
    rows_missing: str

    @property
    def scaled_percent(self) -> tuple[float, float]:
        """MAPE (%) of simulation and plain capacitor, each scaled.

        Each |Z| has the factor that minimises its MAPE, so that the capacitance does not matter. A simulation above the
        capacitor does not explain the resonances of the recording.
        """
        measured = self.measured.magnitude
        return (_scaled(self.simulated.magnitude / measured)[0],
                _scaled(1.0 / (self.measured.frequency * measured))[0])

    @property
    def constant_percent(self) -> float:
        """MAPE (%) of the constant |Z| that is nearest to the recording."""
        return _scaled(1.0 / self.measured.magnitude)[0]

    @property
    def best_factor(self) -> float:
        """Factor on the recorded |Z| that brings it nearest to the simulation."""
        return 1.0 / _scaled(self.simulated.magnitude / self.measured.magnitude)[1]

    def summary(self) -> Summary:
        """Errors and figures side by side, for a notebook."""
        rows = [("", "measured", "simulated", "difference"),
                *((row.metric, f"{row.measured:.6g}", f"{row.simulated:.6g}", f"{row.difference_percent:+.3g} %")
                  for row in self.rows),
                ("MAPE of |Z|", "", "", f"{self.mape_percent:.3g} %"),
                ("rms of |ln ratio|", "", "", f"{100.0 * self.rms_log_residual:.3g} %")]
        return Summary("Comparison", tuple(rows), {"measured": self.measured, "simulated": self.simulated},
                       ("measured",))

    def to_xarray(self) -> xarray.Dataset:
        """Both impedances (ohm) and ln(Z_sim / Z_meas) over ``frequency`` (Hz)."""
        both = {f"{name}_{part}": values for name, spectrum in (("measured", self.measured),
                                                                ("simulated", self.simulated))
                for part, values in spectrum.to_xarray().data_vars.items()}
        found = self.measured.to_xarray().drop_vars(["resistance", "reactance", "uncertainty"], errors="ignore")
        residual = {"log_magnitude_ratio": ("frequency", self.log_residual.real, {"units": "1"}),
                    "phase_difference": ("frequency", self.log_residual.imag, {"units": "rad"})}
        return found.assign(both).assign(residual).assign_attrs(mape_percent=self.mape_percent,
                                                                rms_log_residual=self.rms_log_residual)


def compare(
    measured: Spectrum | WithSpectrum, simulated: Spectrum | WithSpectrum, *, near: float | None = None
) -> Comparison:
    """Compare two spectra at the measured points that `simulated` covers.

    Both are spectra, or results with one: a reading, a simulation. Figures of merit are of the resonance nearest to
    `near` (Hz), by default the deepest, in each spectrum on its own grid within the common band.

    Raises:
        ValueError: the bands share fewer than two measured points, or two simulated ones.
    """
    measured, simulated = spectrum_of(measured), spectrum_of(simulated)
    low = max(measured.frequency[0], simulated.frequency[0])
    high = min(measured.frequency[-1], simulated.frequency[-1])
    if not low < high:
        raise ValueError(
            f"the bands do not overlap: measured {frequency_text(*measured.frequency[[0, -1]])}, "
            f"simulated {frequency_text(*simulated.frequency[[0, -1]])}"
        )
    common = measured.restricted(low, high)
    on_grid = simulated.on(common.frequency)
    ratio = on_grid.impedance / common.impedance
    residual = np.log(np.abs(ratio)) + 1j * np.angle(ratio)
    residual.flags.writeable = False
    magnitude_percent = 100.0 * np.abs(np.abs(ratio) - 1.0)
    phase = np.degrees(np.abs(residual.imag))
    worst = int(np.argmax(magnitude_percent))
    rows, rows_missing = _rows(common, simulated.restricted(low, high), near)
    return Comparison(
        measured=common,
        simulated=on_grid,
        fraction_used=len(common.frequency) / len(measured.frequency),
        log_residual=residual,
        mape_percent=float(np.mean(magnitude_percent)),
        rms_log_residual=float(np.sqrt(np.mean(np.abs(residual) ** 2))),
        phase_mean_deg=float(np.mean(phase)),
        phase_max_deg=float(np.max(phase)),
        worst_percent=float(magnitude_percent[worst]),
        worst_frequency=float(common.frequency[worst]),
        reduced_chi_square=_reduced_chi_square(common, on_grid),
        rows=rows,
        rows_missing=rows_missing,
    )


def _reduced_chi_square(measured: Spectrum, simulated: Spectrum) -> float | None:
    variances = [s.uncertainty**2 for s in (measured, simulated) if s.uncertainty is not None]
    if not variances:
        return None
    squares = np.abs(simulated.impedance - measured.impedance) ** 2 / np.sum(variances, axis=0)
    return float(np.mean(squares)) / 2.0


def _scaled(ratio: NDArray[np.float64]) -> tuple[float, float]:
    """Least mean of 100 |s ratio - 1|, and its s.

    The best s is the median of 1 / ratio, weighted by ratio.
    """
    ascending = np.sort(1.0 / ratio)
    weight = np.cumsum(1.0 / ascending)
    best = float(ascending[np.searchsorted(weight, 0.5 * weight[-1])])
    return 100.0 * float(np.mean(np.abs(best * ratio - 1.0))), best


def _rows(measured: Spectrum, simulated: Spectrum, near: float | None) -> tuple[tuple[MetricRow, ...], str]:
    found: list[Figures] = []
    for name, spectrum in (("measured", measured), ("simulated", simulated)):
        try:
            found.append(figures(spectrum, near=near))
        except NoResonance as error:
            return (), f"{name}: {error.reason}"
    ours, theirs = found
    right: tuple[MetricRow, ...] = ()
    if (ours.is_weak or theirs.is_weak) and ours.conductance is not None and theirs.conductance is not None:
        right = (MetricRow("fs (Hz), by the conductance", ours.conductance.frequency, theirs.conductance.frequency),
                 MetricRow("Q, by the conductance", ours.conductance.q, theirs.conductance.q))
    return (
        *(row for row in right if math.isfinite(row.measured + row.simulated)),
        MetricRow("f0 (Hz)", ours.f0, theirs.f0),
        MetricRow("Z_min (ohm)", ours.z_min, theirs.z_min),
        MetricRow("Q factor", ours.q, theirs.q),
    ), ""
