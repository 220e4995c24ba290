"""Resonances of spectra, fitted, as a table and as records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from workbench.report.page import TextTable, number_text
from workbench.results.circuit import CircuitFit, FittedNumber, FittedResonance, fit_circuit
from workbench.results.pole import PoleFit, fit_pole
from workbench.results.spectrum import Spectrum

RESONANCE_COLUMNS = ("resonances", "fitted f (MHz)", "fitted Q", "k_eff", "R1 (ohm)", "L1 (uH)", "C1 (pF)")


def resonances_table(found: Mapping[str, CircuitFit | None]) -> TextTable:
    """The resonances of spectra by label, each with standard errors; a row that says so where there are none."""
    rows: list[tuple[str, ...]] = []
    for label, fit in found.items():
        if fit is None:
            rows.append((label, "none", "", "", "", "", ""))
            continue
        rows += [(label, _with_error(each.frequency, 1e-6, 5), _with_error(each.q, 1.0, 1),
                  _with_error(each.k_eff, 1.0, 4), number_text(each.resistance.value),
                  number_text(1e6 * each.inductance.value), number_text(1e12 * each.capacitance.value))
                 for each in fit.resonances]
    return TextTable(RESONANCE_COLUMNS, tuple(rows))


def resonance_notes(found: Mapping[str, CircuitFit | None]) -> tuple[str, ...]:
    """The misfit of the circuits, and the resonances that they do not resolve: a sentence each."""
    return tuple(f"{label}: {text}" for label, fit in found.items() if fit is not None for text in (
        f"the circuit of these resonances leaves {100.0 * fit.rms_residual:.2g} % of Z (rms)", *fit.findings))


def _with_error(number: FittedNumber, factor: float, digits: int) -> str:
    return f"{factor * number.value:.{digits}f} ± {factor * number.standard_error:.1g}"


def resonances_record(found: CircuitFit | None) -> dict[str, Any]:
    """The resonances of a spectrum for a JSON file: every number with its standard error, SI units in the names."""
    if found is None:
        return {"resonances": []}
    return {"resonances": [_resonance_record(each) for each in found.resonances],
            "static_capacitance_f": _pair(found.static_capacitance), "loss_tangent": _pair(found.loss_tangent),
            "rms_residual": found.rms_residual, "findings": list(found.findings)}


def _resonance_record(found: FittedResonance) -> dict[str, Any]:
    return {"frequency_hz": _pair(found.frequency), "q": _pair(found.q), "k_effective": _pair(found.k_eff),
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


def _pair(number: FittedNumber) -> list[float]:
    return [number.value, number.standard_error]
