"""What ``-o DIR`` receives: spectrum.csv, merit.json, pictures, and report.html, one file that opens offline."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.comparison import Comparison
from workbench.files.writing import write_atomic
from workbench.merit import Estimate, Figures, NoResonance, ResonanceFit, figures, fit_resonance
from workbench.simulation import Simulation
from workbench.spectrum import Spectrum
from workbench.traps import focus_time

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: .8rem 0; }
th, td { padding: .25rem .7rem; text-align: right; }
th { background: #f3f3f3; } th:first-child, td:first-child { text-align: left; }
tr { border-bottom: 1px solid #e5e5e5; }
img { max-width: 100%; } figure { margin: 1rem 0; } figcaption { color: #555; font-size: .9rem; }
.note { background: #fff7e0; border-left: 4px solid #e0a800; padding: .4rem .8rem; }
"""


@dataclass(frozen=True)
class Table:
    """A table of text: a heading for every column, and rows of as many cells."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A PNG file and what it shows."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Note:
    """A sentence the reader must not miss."""

    text: str


Block = str | Table | Picture | Note


def write_report(path: Path, title: str, sections: Sequence[tuple[str, Sequence[Block]]]) -> Path:
    """Write an HTML page with every picture inside it. `sections` are (heading, blocks)."""
    parts = [f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>",
             f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>"]
    for heading, blocks in sections:
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts += [_html(block) for block in blocks]
    write_atomic(path, "\n".join(parts) + "\n")
    return path


def _html(block: Block) -> str:
    match block:
        case Table(columns, rows):
            head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
            body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
            return f"<table><tr>{head}</tr>{body}</table>"
        case Picture(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            text = html.escape(caption)
            image = f'<img src="data:image/png;base64,{data}" alt="{text}">'
            return f"<figure>{image}<figcaption>{text}</figcaption></figure>"
        case Note(text):
            return f'<p class="note">{html.escape(text)}</p>'
        case str():
            return "".join(f"<p>{html.escape(line)}</p>" for line in block.splitlines() if line)


def number(value: float, digits: int = 4) -> str:
    """A number for a table: `digits` significant digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else str(value)


def figures_row(label: str, merit: Figures | None) -> tuple[str, ...]:
    """The cells of :data:`FIGURE_COLUMNS` as text."""
    if merit is None:
        return (label, "none", "", "", "", "")
    anti = merit.antiresonance
    return (label, f"{merit.f0 / 1e6:.4f}", number(merit.z_min), number(merit.q),
            number(anti.kt, 3) if anti else "", f"{anti.static_capacitance * 1e12:.0f}" if anti else "")


FIGURE_COLUMNS = ("", "f0 (MHz)", "Z_min (ohm)", "Q", "kt", "C0 (pF)")


def figures_record(merit: Figures | None, reason: str) -> dict[str, Any]:
    """Figures of merit for a JSON file, SI units in the names."""
    if merit is None:
        return {"f0_hz": None, "z_min_ohm": None, "q": None, "no_resonance": reason}
    record: dict[str, Any] = {"f0_hz": merit.f0, "z_min_ohm": merit.z_min, "q": merit.q,
                              "half_power_hz": [merit.f1, merit.f2]}
    if merit.antiresonance is not None:
        anti = merit.antiresonance
        record |= {"antiresonance_hz": anti.frequency, "z_max_ohm": anti.z_max, "kt": anti.kt,
                   "k_effective": anti.k_effective, "static_capacitance_f":
                   anti.static_capacitance if math.isfinite(anti.static_capacitance) else None}
    return record


def resonance_fits(spectrum: Spectrum) -> dict[str, ResonanceFit]:
    """The fits of the resonance that succeed, by method."""
    fits = {}
    for method in ("pole", "bvd"):
        try:
            fits[method] = fit_resonance(spectrum, method)
        except (NoResonance, ValueError, RuntimeError):
            continue
    return fits


def fit_record(fit: ResonanceFit) -> dict[str, Any]:
    """A resonance fit for a JSON file: every value with its standard error."""
    def pair(estimate: Estimate) -> list[float]:
        return [estimate.value, estimate.standard_error]

    return {"frequency_hz": pair(fit.frequency), "q": pair(fit.q), "rms_residual": fit.rms_residual,
            **{name: pair(value) for name, value in fit.parameters.items()}}


def simulation_record(run: Simulation) -> dict[str, Any]:
    """Everything of a simulated state that merit.json holds."""
    record = figures_record(run.figures, run.no_resonance)
    record["resonance_fits"] = {name: fit_record(fit) for name, fit in resonance_fits(run.spectrum).items()}
    record["model"] = {
        "unknowns": run.unknowns, "cells": int(run.problem.mesh.mesh.t.shape[1]), "full_solves": run.solves,
        "order": run.problem.mesh.order, "estimated_mesh_error_rms": run.mesh_error.rms if run.mesh_error else None,
        "estimated_relative_error": run.error, "largest_residual": run.residual, "energy_closure": run.closure,
    }
    record["fields"] = {"frequency_hz": run.fields.frequency, "drive": run.fields.drive,
                        "voltage_amplitude_v": abs(run.fields.voltage), "power_w": run.fields.power}
    record["losses_w"] = dict(run.losses)
    if run.traps is not None:
        excitation = run.traps.excitation
        record["particles"] = {
            "particle": run.traps.forces.particle.name, "radius_m": run.traps.forces.particle.radius,
            "contrast_factor": run.traps.forces.scattering.contrast_factor,
            "pressure_amplitude_pa": excitation.pressure_amplitude, "energy_density_j_m3": excitation.energy_density,
            "drive": excitation.description, "focus_time_s": focus_time(run.traps),
            "traps": [{"r_m": t.radius, "z_m": t.height, "depth_j": t.depth, "radial_stiffness_n_m": t.radial_stiffness,
                       "axial_stiffness_n_m": t.axial_stiffness, "on_wall": t.on_wall} for t in run.traps.traps],
        }
    record["seconds"] = dict(run.seconds)
    return record


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """A comparison for a JSON file."""
    return {
        "mape_percent": comparison.mape_percent, "rms_log_residual": comparison.rms_log_residual,
        "phase_mean_deg": comparison.phase_mean_deg, "phase_max_deg": comparison.phase_max_deg,
        "worst_percent": comparison.worst_percent, "worst_frequency_hz": comparison.worst_frequency,
        "fraction_used": comparison.fraction_used, "reduced_chi_square": comparison.reduced_chi_square,
        "figures": {row.metric: {"measured": row.measured, "simulated": row.simulated,
                                 "difference_percent": row.difference_percent} for row in comparison.rows},
        "figures_missing": comparison.rows_missing,
    }


def write_json(path: Path, record: Mapping[str, Any]) -> Path:
    """Write a record as JSON, whole or not at all."""
    write_atomic(path, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return path


def measured_figures(spectrum: Spectrum) -> tuple[Figures | None, str]:
    """Figures of a recording, or why there are none."""
    try:
        return figures(spectrum), ""
    except NoResonance as missing:
        return None, missing.reason
