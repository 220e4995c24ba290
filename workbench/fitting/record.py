"""The verdict whether to trust a fit, what follows from it, its sources, and its entry for the registry.

A number that an algorithm does not give - those of the paper have no intervals - is NaN in a :class:`FitResult`.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from geometry.chip import Chip
from materials.fit import Correlation, Fit
from materials.fit import RecordingSource as FitRecording
from materials.kinds import IsotropicSolid, Material
from materials.saving import fitted
from materials.value import Value
from workbench.fem.operators import assemble
from workbench.files.quantities import finite, shown_factor, shown_unit
from workbench.fitting.derived import Derived, derived_moduli, moduli_of
from workbench.fitting.joint import FitResult, Match
from workbench.fitting.multistart import NOISY, Start
from workbench.fitting.prepare import Prepared
from workbench.fitting.uncertainty import CONFIDENCE, Noise, ParameterEstimate
from workbench.model.numbers import LOSS, ParameterName, placed
from workbench.reduced.at_point import reduce
from workbench.reproduction.fits import PaperFit
from workbench.results.circuit import LARGE_RESIDUAL
from workbench.results.comparison import compare
from workbench.results.merit import NoResonance, figures
from workbench.results.spectrum import Origin, Spectrum

#: A fit that leaves more than this many times the noise that a recording states has not explained it; nor has one that
#: leaves more than an rms of |ln(Z_fit / Z_measured)| of LARGE_RESIDUAL where none is stated. (The published fits of
#: Acevedo-Espinosa et al. (RP-UEIS) leave a mean error of |Z| of 22 to 26 %.)
LARGE_RATIO = NOISY

#: Remedy for a fit that leaves too much.
TRY_DIAGNOSE = "another optimum or missing physics: try `workbench diagnose`"


@dataclass(frozen=True)
class Source:
    """The files a recording was fitted from: their paths as given and the SHA-256 of their contents."""

    recording: str
    sha256: str
    chip: str
    chip_sha256: str
    findings: tuple[str, ...] = ()


def source(recording: Path, chip: Path, *, findings: Sequence[str] = ()) -> Source:
    """The source of a recording that has just been read."""
    return Source(str(recording), file_digest(recording), str(chip), file_digest(chip), tuple(findings))


def file_digest(path: Path) -> str:
    """The SHA-256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def software() -> str:
    """Name and version of this software."""
    name = "acoustofluidic-chip-workbench"
    return f"{name} {importlib.metadata.version(name)}"


def paper_result(found: PaperFit, prepared: Prepared) -> FitResult:
    """The result of an algorithm of the paper as one of a fit: values without intervals, in its last window.

    Raises:
        NotEnriched: the spectrum of the start could not be predicted.
    """
    recording, material = prepared.recordings[0], prepared.material
    measured = recording.measured.restricted(float(found.frequency[0]), float(found.frequency[-1]))
    values = dict(recording.problem.values)
    if prepared.kind == "pzt":
        # The algorithm knows no losses but its own.
        values |= {f"{material.name}.{key}": complex(number.real) for key, number in material.parameters().items()}
    values = placed(values, found.start)
    model = reduce(assemble(recording.problem.mesh, recording.problem.terms), found.frequency, values, tolerance=1e-3)
    begin = np.conj(model.solve(found.frequency, values).impedance)
    start, fitted_spectrum = (Spectrum(found.frequency, z, origin=Origin("simulated"))
                              for z in (begin, found.impedance))
    before, after = compare(measured, start), compare(measured, fitted_spectrum)
    free = [next(p for p in prepared.parameters if p.name == name) for name in found.values]
    estimates = tuple(
        ParameterEstimate(p, found.values[p.name], math.nan, math.nan, math.nan, math.nan, "none", "", True, math.nan)
        for p in free)
    vectors = [np.array([numbers[p.name] for p in free]) for numbers in (found.start, found.values)]
    findings = [f"{'Ended' if found.converged else 'Not converged'}: {found.reason}.",
                f"{found.spectra} spectra; the algorithm gives no intervals.",
                f"{recording.name}: MAPE of |Z| {found.mape_percent:.3g} % from {found.frequency[0] / 1e3:.1f} to "
                f"{found.frequency[-1] / 1e3:.1f} kHz."]
    if found.strayed:
        findings.append(f"Ended more than half of its start away from it: {', '.join(found.strayed)}.")
    return FitResult(
        "paper", (Match(recording.name, measured, start, fitted_spectrum, before, after,
                        Noise(after.rms_log_residual / math.sqrt(2.0), 1.0, False, 1.0)),),
        estimates, np.full((len(free), len(free)), math.nan), (),
        (Start("start", vectors[0], vectors[1], after.rms_log_residual, found.reason, len(found.blocks)),), (),
        (math.nan, math.nan), found.converged, after.rms_log_residual < before.rms_log_residual, len(found.blocks),
        tuple(findings), found.seconds, found.solves + model.solves)


def refusals(result: FitResult) -> tuple[str, ...]:
    """Reasons not to trust a fit, in words; empty if there are none."""
    found = []
    if not result.improved:
        found.append("The fit is not better than its start.")
    if not result.converged:
        found.append("The search did not converge.")
    for e in result.estimates:
        # The joint fit stays inside; the paper's simplex knows no bounds.
        if not e.parameter.low <= e.value <= e.parameter.high:
            found.append(f"{e.parameter.name} ended at {e.value:.4g} {e.parameter.unit}, outside {e.parameter.low:.4g} "
                         f"to {e.parameter.high:.4g}, all that such a material may have.")
    for match in result.recordings:
        left, noise = match.after, match.noise
        if noise.stated and not noise.ratio <= LARGE_RATIO:
            too_much = f"{noise.ratio:.3g} times the noise that it states, more than {LARGE_RATIO:g} times"
        elif not noise.stated and not left.rms_log_residual <= LARGE_RESIDUAL:
            too_much = f"more than the {100.0 * LARGE_RESIDUAL:g} % that are taken where a recording states no noise"
        else:
            continue
        found.append(f"{match.name}: {100.0 * left.rms_log_residual:.2g} % of Z is left (rms; MAPE of |Z| "
                     f"{left.mape_percent:.3g} %), {too_much}: {TRY_DIAGNOSE}, or the recording is of another device "
                     "or geometry.")
    return tuple(found)


def derived_quantities(result: FitResult, prepared: Prepared) -> tuple[Derived, ...]:
    """Table 4 of the fitted solid at the resonance of the first recording (the middle of its band if there is none).

    Empty for a transducer.
    """
    material = prepared.material
    if not isinstance(material, IsotropicSolid):
        return ()
    names = [e.parameter.name for e in result.estimates]
    values = np.array([e.value for e in result.estimates])
    moduli, covariance = moduli_of(names, values, result.covariance, prepared.recordings[0].problem.values,
                                   material.name)
    density, error = material.density, 0.0
    if f"{material.name}.density" in names:
        estimate = result.estimates[names.index(f"{material.name}.density")]
        density, error = estimate.value, estimate.standard_error
    return derived_moduli(moduli, covariance, density=density, frequency=reference_frequency(result),
                          density_error=error)


def reference_frequency(result: FitResult) -> float:
    """f0 (Hz) of the first recording, or the middle of its band if it has no resonance."""
    measured = result.recordings[0].measured
    try:
        return figures(measured).f0
    except NoResonance:
        return float(np.mean(measured.frequency[[0, -1]]))


def registry_entry(
    result: FitResult, prepared: Prepared, sources: Sequence[Source], *, date: datetime, forced: bool,
    start: str = "", temperature: float | None = None,
) -> Material:
    """The freed material with the fitted numbers, ready for `materials.save`.

    Dimensions and bench elements that were free, and the sizes of the part, are noted with the sample.

    Args:
        date: with its time zone.
        forced: whether the fit was not accepted and is saved all the same.
        start: the registry's name of the material the fit set out from; the freed material's own by default.
        temperature: of the recording, K.
    """
    material = prepared.material
    own = {e.parameter.parsed.local: e for e in result.estimates
           if e.parameter.is_material and e.parameter.parsed.owner == material.name}
    estimates: dict[str, Value] = {}
    for field, number in material.parameters().items():
        value, loss = own.get(field), own.get(field + LOSS)
        if value is None and loss is None:
            continue
        estimates[field] = Value(
            complex(value.value if value else number.real, loss.value if loss else number.imag), "", "",
            note="; ".join(filter(None, (_note("", value), _note("loss ", loss)))),
            uncertainty=finite(value.standard_error) if value else None,
            loss_uncertainty=finite(loss.standard_error) if loss else None,
            low=finite(value.low) if value else None, high=finite(value.high) if value else None,
            loss_low=finite(loss.low) if loss else None, loss_high=finite(loss.high) if loss else None,
            status=_status(value), loss_status=_status(loss) if loss else "")
    band = (min(float(m.measured.frequency[0]) for m in result.recordings),
            max(float(m.measured.frequency[-1]) for m in result.recordings))
    free = tuple(_with_loss_apart(name) for name in own)
    determined = [i for i, e in enumerate(result.estimates) if e.determined and e in own.values()]
    correlation = None
    if len(determined) > 1 and np.isfinite(result.covariance).all():
        matrix = result.correlation[np.ix_(determined, determined)]
        matrix = np.clip(0.5 * (matrix + matrix.T), -1.0, 1.0)
        np.fill_diagonal(matrix, 1.0)
        names = {id(e): _with_loss_apart(name) for name, e in own.items()}
        correlation = Correlation(tuple(names[id(result.estimates[i])] for i in determined),
                                  tuple(tuple(float(x) for x in row) for row in matrix))
    fixed = tuple(field for field in material.parameters() if field not in own)
    return fitted(material, estimates, fit=Fit(
        recordings=tuple(FitRecording(s.recording, s.sha256, s.chip, s.chip_sha256) for s in sources),
        algorithm=result.algorithm, software=software(), date=date.isoformat(timespec="seconds"), band=band,
        mape_percent=float(np.mean([m.after.mape_percent for m in result.recordings])),
        rms_log_residual=float(np.sqrt(np.mean([m.after.rms_log_residual**2 for m in result.recordings]))),
        confidence=CONFIDENCE, free=free, fixed=fixed, start=start or material.name, temperature=temperature,
        sample=_sample(prepared.chip, result), correlation=correlation,
        notes=(*refusals(result), *result.findings), forced=forced))


def _with_loss_apart(name: str) -> str:
    """The name of a coefficient as registry entries have it: "c33 loss"."""
    parsed = ParameterName.parse(name)
    return f"{parsed.key} loss" if parsed.is_loss else parsed.key


def _note(part: str, estimate: ParameterEstimate | None) -> str:
    return "" if estimate is None or not estimate.at_bound else f"{part}held by {estimate.at_bound}"


def _status(estimate: ParameterEstimate | None) -> str:
    if estimate is None:
        return "fixed"
    if not estimate.determined:
        return "not determined"
    return "at bound" if estimate.at_bound else "fitted"


def _sample(chip: Chip, result: FitResult) -> dict[str, str]:
    found = {"chip": chip.name}
    found |= {name: f"{d.value * shown_factor(unit):.6g} {shown_unit(unit)}" for name, d in chip.dimensions().items()
              for unit in [ParameterName.parse(name).unit]}
    for layer in chip.layers:
        if layer.density is not None:
            found[f"{layer.region}.density"] = f"{layer.density:g} kg/m^3"
    for e in result.estimates:
        if not e.parameter.is_material:
            key = e.parameter.name if not e.parameter.recordings else (
                f"{e.parameter.name} ({', '.join(e.parameter.recordings)})")
            found[key] = f"{e.value:.6g} {e.parameter.unit}, fitted, {e.low:.6g} to {e.high:.6g}"
    return found
