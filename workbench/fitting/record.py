"""The verdict on a fit, derived quantities, sources, and registry entry."""

from __future__ import annotations

import hashlib
import importlib.metadata
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from geometry.chip import Chip
from materials.fit import Correlation, Fit, RecordingSource
from materials.kinds import IsotropicSolid, Material
from materials.registry import Registry
from materials.saving import fitted
from materials.value import Value
from workbench.fem.operators import assemble
from workbench.files.quantities import finite, shown_number
from workbench.fitting.derived import Derived, derived_moduli, moduli_of
from workbench.fitting.joint import FitResult, Match, TriedEntry
from workbench.fitting.multistart import TRIES, Start
from workbench.fitting.noise import NOISY, Noise
from workbench.fitting.objective import Objective
from workbench.fitting.parameter import Parameter, material_parameter
from workbench.fitting.prepare import Prepared, other_ceramics
from workbench.fitting.search import COARSE, NO_END, SEARCHED_POINTS, FitSearch
from workbench.fitting.uncertainty import CONFIDENCE, ParameterEstimate
from workbench.jobs.progress import Progress, no_progress
from workbench.model.numbers import LOSS, ParameterName, placed
from workbench.reduced.at_point import reduce
from workbench.reproduction.fits import PaperFit
from workbench.results.circuit import LARGE_RESIDUAL
from workbench.results.merit import NoResonance, figures

#: Most numbers that a sentence lists, and other entries that it compares.
LISTED, COMPARED = 10, 3


@dataclass(frozen=True)
class Source:
    """The files of a recording: paths as given, and SHA-256 of contents."""

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


def paper_result(paper_fit: PaperFit, prepared: Prepared) -> FitResult:
    """The result of an algorithm of the paper, in its last window. Numbers that it does not give are NaN.

    Raises:
        NotEnriched: the spectrum of the start could not be predicted.
    """
    recording, material, frequency = prepared.recordings[0], prepared.material, paper_fit.frequency
    measured = recording.measured.restricted(float(frequency[0]), float(frequency[-1]))
    values = dict(recording.problem.values)
    if prepared.kind == "pzt":
        # The algorithm knows no losses but its own.
        values |= {f"{material.name}.{key}": complex(number.real) for key, number in material.parameters().items()}
    values = placed(values, paper_fit.start)
    model = reduce(assemble(recording.problem.mesh, recording.problem.terms), frequency, values, tolerance=1e-3)
    match = Match.of(recording.name, measured, np.conj(model.solve(frequency, values).impedance), paper_fit.impedance,
                     Noise(np.ones(frequency.size), stated=False))
    rms = match.after.rms_log_residual
    match = replace(match, noise=replace(match.noise, scale=rms / math.sqrt(2.0)))
    free = [next(p for p in prepared.parameters if p.name == name) for name in paper_fit.values]
    begin, end = (np.array([numbers[p.name] for p in free]) for numbers in (paper_fit.start, paper_fit.values))
    findings = [f"{'Ended' if paper_fit.converged else 'Not converged'}: {paper_fit.reason}.",
                f"{paper_fit.spectra} spectra; the algorithm gives no intervals.",
                f"{recording.name}: MAPE of |Z| {paper_fit.mape_percent:.3g} % from {frequency[0] / 1e3:.1f} to "
                f"{frequency[-1] / 1e3:.1f} kHz."]
    if paper_fit.strayed:
        findings.append(f"Ended more than half of its start away from it: {', '.join(paper_fit.strayed)}.")
    return FitResult(
        "paper", (match,), tuple(ParameterEstimate(p, paper_fit.values[p.name]) for p in free),
        np.full((len(free), len(free)), math.nan), (),
        (Start("start", begin, end, rms, paper_fit.reason, len(paper_fit.blocks)),), (), (math.nan, math.nan),
        paper_fit.converged, rms < match.before.rms_log_residual, len(paper_fit.blocks), tuple(findings),
        paper_fit.seconds, paper_fit.solves + model.solves)


def refusals(result: FitResult) -> tuple[str, ...]:
    """Reasons not to trust a fit, in words; empty if none.

    A residual explains a recording up to :data:`~workbench.fitting.noise.NOISY` times its stated noise, or up to an rms
    of |ln(Z_fit / Z_measured)| of LARGE_RESIDUAL where it states none. (The published fits of Acevedo-Espinosa et al.
    (RP-UEIS) have a mean error of |Z| of 22 to 26 %.) A smaller residual that is more than noise is accepted only after
    the whole search for a better optimum.
    """
    reasons = []
    if not result.improved:
        reasons.append("The fit is not better than its start.")
    if not result.converged:
        reasons.append("The search did not converge.")
    for e in result.estimates:
        # The joint fit stays inside; the paper's simplex knows no bounds.
        if not e.parameter.low <= e.value <= e.parameter.high:
            reasons.append(f"{e.parameter.name} ended at {e.value:.4g} {e.parameter.unit}, outside "
                           f"{e.parameter.low:.4g} to {e.parameter.high:.4g}, all that such a material may have.")
    short = result.untried > 0 and (result.interrupted or result.further < TRIES)
    for match in result.recordings:
        left, noise = match.after, match.noise
        if noise.stated and not noise.ratio <= NOISY:
            too_much = f"{noise.ratio:.3g} times the noise that it states, more than {NOISY:g} times"
        elif not noise.stated and not left.rms_log_residual <= LARGE_RESIDUAL:
            too_much = f"more than the {100.0 * LARGE_RESIDUAL:g} % that are accepted if a recording states no noise"
        elif short and not noise.explains(left.rms_log_residual):
            reasons.append(f"{match.name}: {100.0 * left.rms_log_residual:.2g} % of Z remains (rms), more than noise, "
                           f"and a better optimum was searched for by {result.further} further descents only: "
                           f"{'let the search end' if result.interrupted else f'try `--tries {TRIES}`'}. Other "
                           f"remedies: {'; '.join(_remedies(result))}.")
            continue
        else:
            continue
        reasons.append(f"{match.name}: {100.0 * left.rms_log_residual:.2g} % of Z remains (rms; MAPE of |Z| "
                       f"{left.mape_percent:.3g} %), {too_much}: {'; '.join(_remedies(result))}, or the recording is "
                       "of another device or geometry.")
    return tuple(reasons)


def _remedies(result: FitResult) -> list[str]:
    """Remedies for a large residual: free parameters, other ceramics, a diagnosis."""
    remedies = []
    if result.held:
        text = f"fixed parameters: {held_names(result)}"
        if proposed := [h for h in result.held if h.taken > 0.0]:
            names = [name_in_fit(h.parameter, result) for h in proposed]
            text += (f", of which {' and '.join(names)} would take {100.0 * sum(h.taken for h in proposed):.0f} % of "
                     f"the residual's square to first order: try `--free default,{','.join(names)}`")
        remedies.append(text)
    if nearer := [each for each in result.entries if each.rms < rms_log_residual(result)]:
        remedies.append("short fits that take all constants of another entry leave "
                        + ", ".join(f"{100.0 * each.rms:.2g} % ({each.name})" for each in nearer[:COMPARED])
                        + f": try `--material {nearer[0].name}`")
    elif result.entries:
        remedies.append("none of the other ceramics of the registry leaves less")
    return [*remedies, "another optimum or missing physics: try `workbench diagnose`"]


def rms_log_residual(result: FitResult) -> float:
    """The rms of |ln(Z_fit / Z_measured)|, all recordings with equal weight."""
    return float(np.sqrt(np.mean([m.after.rms_log_residual**2 for m in result.recordings])))


#: A number that was held mattered if it moves an estimate by this part of its standard error.
MATTERED = 0.1


def tried(
    result: FitResult, prepared: Prepared, registry: Registry, most: int, progress: Progress = no_progress
) -> FitResult:
    """The result with at `most` so many other ceramics tried.

    They are tried as a whole if it is refused and its fixed parameters mattered. Each is tried by a descent on the
    search mesh, with fixed parameters of its own; one without a prediction is omitted. An accepted fit whose residual
    is more than noise has a finding on it.
    """
    if not refusals(result):
        return replace(result, findings=(*result.findings, *reservations(result)))
    if result.interrupted or not any(h.part > MATTERED for h in result.held):
        return result
    own, entries = prepared.material.name, list[TriedEntry]()
    for name in other_ceramics(prepared, registry)[:most]:
        progress(f"trying {name}", 0.95)
        values = {f"{own}.{key}": value for key, value in registry.load(name, notes=[]).parameters().items()
                  if key != "density"}
        recordings = [replace(each, problem=each.problem.with_values(
            {key: value for key, value in values.items() if key in each.problem.values}))
            for each in (whole.thinned(SEARCHED_POINTS) for whole in prepared.coarse)]
        free = [material_parameter(recordings[0].problem, own, p.parsed.local)
                if p.is_material and p.parsed.owner == own else p for p in prepared.parameters]
        try:
            search = FitSearch(Objective.of(recordings, free, tolerance=COARSE))
            with suppress(*NO_END):
                entries.append(TriedEntry(name, search.descend(search.centre).residual.data.rms))
        except KeyboardInterrupt:
            result = replace(result, interrupted=True)
            break
    return replace(result, entries=tuple(sorted(entries, key=lambda each: each.rms)))


def reservations(result: FitResult) -> tuple[str, ...]:
    """Statements on an accepted fit whose residual is more than noise."""
    return tuple(f"{match.name}: {100.0 * match.after.rms_log_residual:.2g} % of Z remains (rms), which is more than "
                 "noise: the model lacks something, and values may be further off than their intervals. Remedies: "
                 f"{'; '.join(_remedies(result))}."
                 for match in result.recordings if not match.noise.explains(match.after.rms_log_residual))


def held_names(result: FitResult) -> str:
    """The uncertain fixed parameters, the most important first. The rest is a count."""
    names = [name_in_fit(h.parameter, result) for h in result.held]
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")


def name_in_fit(parameter: Parameter, result: FitResult) -> str:
    """The name of a parameter, without the material that the fit frees."""
    owners = {e.parameter.parsed.owner for e in result.estimates if e.parameter.is_material}
    return parameter.parsed.within(parameter.parsed.owner if parameter.parsed.owner in owners else "")


def derived_quantities(result: FitResult, prepared: Prepared) -> tuple[Derived, ...]:
    """Table 4 of the fitted solid at :func:`reference_frequency`; empty for a transducer."""
    material = prepared.material
    if not isinstance(material, IsotropicSolid):
        return ()
    estimates = {e.parameter.name: e for e in result.estimates}
    moduli, covariance = moduli_of(list(estimates), np.array([e.value for e in estimates.values()]), result.covariance,
                                   prepared.recordings[0].problem.values, material.name)
    density = estimates.get(f"{material.name}.density")
    return derived_moduli(moduli, covariance, density=density.value if density else material.density,
                          frequency=reference_frequency(result),
                          density_error=density.standard_error if density else 0.0)


def reference_frequency(result: FitResult) -> float:
    """f0 (Hz) of the first recording, or the middle of its band."""
    measured = result.recordings[0].measured
    try:
        return figures(measured).f0
    except NoResonance:
        return float(np.mean(measured.frequency[[0, -1]]))


def registry_entry(
    result: FitResult, prepared: Prepared, sources: Sequence[Source], *, date: datetime, forced: bool,
    start: str = "", temperature: float | None = None,
) -> Material:
    """The freed material with the fitted values, for `materials.save`.

    Args:
        date: with its time zone.
        forced: whether the fit was not accepted and is saved all the same.
        start: the registry's name of the start material; the freed material's own by default.
        temperature: of the recording, K.
    """
    material, measured = prepared.material, [m.measured.frequency for m in result.recordings]
    own = {e.parameter.parsed.local: i for i, e in enumerate(result.estimates)
           if e.parameter.is_material and e.parameter.parsed.owner == material.name}
    by_name = {name: result.estimates[i] for name, i in own.items()}
    estimates: dict[str, Value] = {}
    for field, number in material.parameters().items():
        value, loss = by_name.get(field), by_name.get(field + LOSS)
        if value or loss:
            held = [f"{part}held by {e.at_bound}" for part, e in (("", value), ("loss ", loss)) if e and e.at_bound]
            estimates[field] = Value(
                complex(value.value if value else number.real, loss.value if loss else number.imag), "", "",
                note="; ".join(held), **_interval("", value), **_interval("loss_", loss))
    determined = {_in_entry(name): i for name, i in own.items() if result.estimates[i].determined}
    correlation = None
    if len(determined) > 1 and np.isfinite(result.covariance).all():
        matrix = result.correlation[np.ix_([*determined.values()], [*determined.values()])]
        matrix = np.clip(0.5 * (matrix + matrix.T), -1.0, 1.0)
        np.fill_diagonal(matrix, 1.0)
        correlation = Correlation(tuple(determined), tuple(tuple(row) for row in matrix.tolist()))
    return fitted(material, estimates, fit=Fit(
        recordings=tuple(RecordingSource(s.recording, s.sha256, s.chip, s.chip_sha256) for s in sources),
        algorithm=result.algorithm, software=software(), date=date.isoformat(timespec="seconds"),
        band=(min(float(f[0]) for f in measured), max(float(f[-1]) for f in measured)),
        mape_percent=float(np.mean([m.after.mape_percent for m in result.recordings])),
        rms_log_residual=rms_log_residual(result), confidence=CONFIDENCE, free=tuple(map(_in_entry, own)),
        fixed=tuple(field for field in material.parameters() if field not in own), start=start or material.name,
        temperature=temperature, sample=_sample(prepared.chip, result), correlation=correlation,
        notes=(*refusals(result), *result.findings), forced=forced))


def _in_entry(name: str) -> str:
    """The name of a coefficient as registry entries have it: "c33 loss"."""
    return name.replace(LOSS, " loss")


def _interval(part: str, estimate: ParameterEstimate | None) -> dict[str, Any]:
    """The uncertainty fields of one `part` of a value."""
    if estimate is None:
        return {} if part else {"status": "fixed"}
    status = "not determined" if not estimate.determined else "at bound" if estimate.at_bound else "fitted"
    return {f"{part}uncertainty": finite(estimate.standard_error), f"{part}low": finite(estimate.low),
            f"{part}high": finite(estimate.high), f"{part}status": status}


def _sample(chip: Chip, result: FitResult) -> dict[str, str]:
    sample = {"chip": chip.name}
    for name, dimension in chip.dimensions().items():
        sample[name] = shown_number(dimension.value, ParameterName.parse(name).unit, digits=6)
    sample |= {f"{layer.region}.density": f"{layer.density:g} kg/m^3" for layer in chip.layers
               if layer.density is not None}
    for e in result.estimates:
        p = e.parameter
        if not p.is_material:
            of = f" ({', '.join(p.recordings)})" if p.recordings else ""
            sample[p.name + of] = f"{e.value:.6g} {p.unit}, fitted, {e.low:.6g} to {e.high:.6g}"
    return sample
