"""Resonances of spectra, fitted, as a table and as records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from workbench.report.page import TextTable, number_text
from workbench.results.circuit import (
    LARGE_CHI_SQUARE,
    LARGE_RESIDUAL,
    CircuitFit,
    FittedNumber,
    FittedResonance,
    fit_circuit,
)
from workbench.results.pole import PoleFit, fit_pole
from workbench.results.spectrum import Spectrum

RESONANCE_COLUMNS = ("resonances", "fitted f (MHz)", "fitted Q", "fitted k_eff", "M", "R1 (ohm)", "L1 (uH)", "C1 (pF)")


def resonances_table(found: Mapping[str, CircuitFit | None]) -> TextTable:
    """The resonances of spectra by label, each with standard errors; a row that says so where there are none."""
    rows: list[tuple[str, ...]] = []
    for label, fit in found.items():
        if fit is None:
            rows.append((label, "none", *[""] * (len(RESONANCE_COLUMNS) - 2)))
            continue
        rows += [(label, _with_error(each.frequency, 1e-6, 5), _with_error(each.q, 1.0, 1),
                  _with_error(each.k_eff, 1.0, 4), number_text(each.merit, 2) if math.isfinite(each.merit) else "",
                  number_text(each.resistance.value),
                  number_text(1e6 * each.inductance.value), number_text(1e12 * each.capacitance.value))
                 for each in fit.resonances]
    return TextTable(RESONANCE_COLUMNS, tuple(rows))


def resonance_notes(found: Mapping[str, CircuitFit | None]) -> tuple[str, ...]:
    """The misfit of the circuits and whether it is large, and the resonances that they do not resolve."""
    return tuple(f"{label}: {text}" for label, fit in found.items() if fit is not None
                 for text in (misfit(fit), *fit.findings))


def misfit(fit: CircuitFit) -> str:
    """A sentence on the residual of a circuit: against the stated noise, or else against that of good fits."""
    left = (f"the circuit of these resonances, beside a shunt of {1e12 * fit.static_capacitance.value:.4g} ± "
            f"{1e12 * fit.static_capacitance.standard_error:.2g} pF with a loss tangent of "
            f"{fit.loss_tangent.value + 0.0:.2g}, leaves {100.0 * fit.rms_residual:.2g} % of Z (rms)")
    if fit.reduced_chi_square is not None and fit.reduced_chi_square <= LARGE_CHI_SQUARE:
        return f"{left}, which is good: {math.sqrt(fit.reduced_chi_square):.2g} times the stated noise"
    limit = f"circuits that describe a spectrum leave less than {100.0 * LARGE_RESIDUAL:g} %"
    if fit.rms_residual <= LARGE_RESIDUAL:
        return f"{left}, which is good: {limit}"
    return (f"{left}, which is poor: {limit}. It lacks resonances, or close ones are not resolved: f, Q and k_eff are "
            "further off than their standard errors say; a narrower band (--from, --to) has fewer")


def _with_error(number: FittedNumber, factor: float, digits: int) -> str:
    if not math.isfinite(number.value):
        return "not determined"
    return f"{factor * number.value:.{digits}f} ± {factor * number.standard_error:.1g}"


def resonances_record(found: CircuitFit | None) -> dict[str, Any]:
    """The resonances of a spectrum for a JSON file: every number with its standard error, SI units in the names."""
    if found is None:
        return {"resonances": []}
    return {"resonances": [_resonance_record(each) for each in found.resonances],
            "static_capacitance_f": _pair(found.static_capacitance), "loss_tangent": _pair(found.loss_tangent),
            "rms_residual": found.rms_residual, "misfit": misfit(found), "findings": list(found.findings)}


def _resonance_record(found: FittedResonance) -> dict[str, Any]:
    return {"frequency_hz": _pair(found.frequency), "q": _pair(found.q), "k_effective": _pair(found.k_eff),
            "figure_of_merit": found.merit if math.isfinite(found.merit) else None,
            "resistance_ohm": _pair(found.resistance), "inductance_h": _pair(found.inductance),
            "capacitance_f": _pair(found.capacitance), "phase_rad": _pair(found.phase)}


def single_fits_record(spectrum: Spectrum) -> dict[str, Any]:
    """The fits of the deepest resonance alone, by its pole and by its circuit, as far as they succeed."""
    record: dict[str, Any] = {}
    for method, fit in (("pole", fit_pole), ("bvd", fit_circuit)):
        try:
            record[method] = single_fit_record(fit(spectrum))
        except ValueError:
            continue
    return record


def single_fit_record(fit: PoleFit | CircuitFit) -> dict[str, Any]:
    """The fit of one resonance for a JSON file: every number with its standard error."""
    one: PoleFit | FittedResonance = fit if isinstance(fit, PoleFit) else fit.resonances[0]
    parameters: Iterable[tuple[str, FittedNumber]] = () if isinstance(fit, PoleFit) else fit.parameters.items()
    return {"frequency_hz": _pair(one.frequency), "q": _pair(one.q), "rms_residual": fit.rms_residual,
            **{name: _pair(value) for name, value in parameters}}


def _pair(number: FittedNumber) -> list[float | None]:
    """A number with its standard error, None in place of what is not determined."""
    return [each if math.isfinite(each) else None for each in (number.value, number.standard_error)]
