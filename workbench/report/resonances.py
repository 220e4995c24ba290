"""Resonances of spectra, fitted, as a table and as records."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from workbench.report.page import TextTable, Value, table
from workbench.report.record import plain, record
from workbench.results.circuit import LARGE_CHI_SQUARE, LARGE_RESIDUAL, CircuitFit, FittedNumber, fit_circuit
from workbench.results.pole import PoleFit, fit_pole
from workbench.results.spectrum import Spectrum

RESONANCE_COLUMNS = ("resonances", "fitted f (MHz)", "fitted Q", "fitted k_eff", "M", "R1 (ohm)", "L1 (uH)", "C1 (pF)")


def resonances_table(found: Mapping[str, CircuitFit | None]) -> TextTable:
    """The resonances of spectra by label, with standard errors; "none" without one."""
    rows: list[tuple[Value, ...]] = []
    for label, fit in found.items():
        if fit is None:
            rows.append((label, "none", *[None] * (len(RESONANCE_COLUMNS) - 2)))
            continue
        rows += [(label, _with_error(each.frequency, 1e-6, 5), _with_error(each.q, 1.0, 1),
                  _with_error(each.k_eff, 1.0, 4), f"{each.merit:.2g}" if math.isfinite(each.merit) else None,
                  each.resistance.value, each.inductance.value, each.capacitance.value) for each in fit.resonances]
    return table(" | ".join(RESONANCE_COLUMNS), rows)


def resonance_notes(found: Mapping[str, CircuitFit | None]) -> tuple[str, ...]:
    """The misfit of each circuit, and the resonances it does not resolve."""
    return tuple(f"{label}: {text}" for label, fit in found.items() if fit is not None
                 for text in (misfit(fit), *fit.findings))


def misfit(fit: CircuitFit) -> str:
    """A sentence on the residual of a circuit.

    The residual is compared with the stated noise, or else with that of good fits. A circuit that is not passive is
    never good.
    """
    left = (f"the circuit of these resonances, beside a shunt of {1e12 * fit.static_capacitance.value:.4g} ± "
            f"{1e12 * fit.static_capacitance.standard_error:.2g} pF with a loss tangent of "
            f"{fit.loss_tangent.value + 0.0:.2g}, leaves {100.0 * fit.rms_residual:.2g} % of Z (rms)")
    limit = f"circuits that describe a spectrum leave less than {100.0 * LARGE_RESIDUAL:g} %"
    active = "" if not fit.active else (
        f"is not passive: {' and '.join(fit.active)} would supply power. The losses of its parts compensate each "
        "other: none is that of one mode; a narrower band (--from, --to) has fewer resonances")
    if fit.reduced_chi_square is not None and fit.reduced_chi_square <= LARGE_CHI_SQUARE:
        limit = f"{math.sqrt(fit.reduced_chi_square):.2g} times the stated noise"
    elif fit.rms_residual > LARGE_RESIDUAL:
        return (f"{left}, which is poor: {limit}. It lacks resonances, or close ones are not resolved: f, Q and k_eff "
                "are further off than their standard errors say; a narrower band (--from, --to) has fewer"
                + (active and f". The circuit {active}"))
    return f"{left}, but {active}" if active else f"{left}, which is good: {limit}"


def _with_error(number: FittedNumber, factor: float, digits: int) -> str:
    if not math.isfinite(number.value):
        return "not determined"
    return f"{factor * number.value:.{digits}f} ± {factor * number.standard_error:.1g}"


def resonances_record(found: CircuitFit | None) -> dict[str, Any]:
    """The resonances of a spectrum for a JSON file, with standard errors."""
    if found is None:
        return {"resonances": []}
    return record(found, "resonances { frequency_hz q k_effective=k_eff figure_of_merit=merit resistance_ohm "
                         "inductance_h capacitance_f phase_rad } static_capacitance_f loss_tangent rms_residual "
                         "findings") | {"misfit": misfit(found)}


def single_fits_record(spectrum: Spectrum) -> dict[str, Any]:
    """The fits of the deepest resonance alone, by pole and by circuit."""
    found: dict[str, Any] = {}
    for method, fit in (("pole", fit_pole), ("bvd", fit_circuit)):
        with suppress(ValueError):
            found[method] = single_fit_record(fit(spectrum))
    return found


def single_fit_record(fit: PoleFit | CircuitFit) -> dict[str, Any]:
    """The fit of one resonance for a JSON file, with standard errors."""
    one, parameters = (fit, {}) if isinstance(fit, PoleFit) else (fit.resonances[0], plain(fit.parameters))
    return {**record(one, "frequency_hz q"), **record(fit, "rms_residual"), **parameters}
