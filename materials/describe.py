"""A material as text: numbers with unit, uncertainty, source and conditions."""

from __future__ import annotations

from materials.fit import Correlation, Fit
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from materials.value import Value


def describe(material: Material) -> str:
    """Lines with name, kind and source, then one per number. Numbers are in SI, with uncertainties and remarks. The
    lines of a fitted material end with its fit."""
    lines = [f"{material.name}: {type(material).__name__}, source {material.source}"]
    thermal = {} if isinstance(material, Fluid) else material.thermal()
    for name, number in (material.parameters() | thermal).items():
        known = material.values.get(name)
        lines.append(f"  {name:<22} {_number(number):<28} {'' if known is None else _remarks(known)}".rstrip())
    for name, stated in material.values.items():
        if name not in material.parameters() and name not in thermal:
            lines.append(f"  {name:<22} {_number(stated.value):<28} {_remarks(stated)}")
    match material:
        case IsotropicSolid():
            lines.append(f"  compressibility        {material.compressibility:.6g} 1/Pa")
        case Fluid():
            lines.append(f"  temperature            {_optional(material.temperature)} K")
            lines.append(f"  diffusivity of sound   {_optional(material.diffusivity_of_sound)} m^2/s")
        case Piezoelectric():
            lines.append(f"  c66                    {_number(material.c66)}")
    lines.append(f"  slowest wave           {material.slowest_wave_speed():.6g} m/s")
    if material.fit is not None:
        lines += _fit_lines(material.fit)
    return "\n".join(lines)


def _number(value: complex) -> str:
    value = complex(value)
    return f"{value.real:.6g}" if value.imag == 0.0 else f"{value.real:.6g} {value.imag:+.4g} i"


def _optional(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.6g}"


def _remarks(value: Value) -> str:
    parts = [
        f"given in {value.unit}" if value.unit else "",
        value.loss_stated,
        "" if value.uncertainty is None else f"+- {value.uncertainty:.3g}",
        _interval("", value.low, value.high),
        "" if value.loss_uncertainty is None else f"loss +- {value.loss_uncertainty:.3g}",
        _interval("loss ", value.loss_low, value.loss_high),
        value.status,
        f"loss {value.loss_status}" if value.loss_status else "",
        value.source, value.conditions, value.note,
    ]
    return "; ".join(part for part in parts if part)


def _interval(label: str, low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    if high is None:
        return f"{label}above {low:.6g}"
    return f"{label}below {high:.6g}" if low is None else f"{label}{low:.6g} to {high:.6g}"


def _fit_lines(fit: Fit) -> list[str]:
    """Lines on the recordings, method and quality of a fit."""
    rows = [("fitted on", f"{fit.date}{', NOT ACCEPTED, saved by force' if fit.forced else ''}")]
    for recording in fit.recordings:
        rows += [("recording", f"{recording.path}, SHA-256 {recording.sha256}"),
                 ("chip", f"{recording.chip}{', SHA-256 ' if recording.chip_sha256 else ''}{recording.chip_sha256}")]
    rows += [
        ("algorithm", f"{fit.algorithm}, {fit.software}"),
        ("set out from", fit.start),
        ("band", f"{fit.band[0] / 1e6:.6g} to {fit.band[1] / 1e6:.6g} MHz"),
        ("at", "" if fit.temperature is None else f"{fit.temperature:.6g} K"),
        ("sample", ", ".join(f"{key} {text}" for key, text in fit.sample.items())),
        ("error of |Z|", f"{fit.mape_percent:.4g} % (mean), rms of ln(Z_fit / Z_measured) {fit.rms_log_residual:.4g}"),
        ("intervals", f"{100.0 * fit.confidence:g} %"),
        ("free", ", ".join(fit.free)),
        ("fixed", ", ".join(fit.fixed)),
        ("correlations", "" if fit.correlation is None else _strongest(fit.correlation)),
        *(("note", note) for note in fit.notes),
    ]
    return [f"  {label:<22} {text}" for label, text in rows if text]


def _strongest(correlation: Correlation) -> str:
    """The three largest correlations."""
    names, rows = correlation.names, correlation.rows
    pairs = [(rows[i][j], names[i], names[j]) for i in range(len(names)) for j in range(i)]
    worst = sorted(pairs, key=lambda pair: -abs(pair[0]))[:3]
    return "strongest: " + ", ".join(f"{a}, {b} {r:+.2f}" for r, a, b in worst) if worst else "one parameter"
