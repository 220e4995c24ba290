"""Simulated states of a chip as tables, as a page and as records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.chip import Chip
from geometry.measure import Axisymmetric
from geometry.names import CAVITY
from geometry.straight import straight_findings
from materials.kinds import Fluid
from workbench.acoustics.traps import Trap, TrapReport, focus_time, time_to
from workbench.files.quantities import finite
from workbench.model.numbers import ParameterName
from workbench.model.particles import net_weight
from workbench.render.plots import draw_energy, draw_spectra
from workbench.report.figures import (
    CAPACITANCE_COLUMNS,
    FigureRows,
    capacitance_cells,
    figures_record,
    figures_rows,
    figures_table,
)
from workbench.report.page import Answer, Block, Note, Picture, TextTable, number_text, write_report
from workbench.report.resonances import (
    resonance_notes,
    resonances_record,
    resonances_table,
    single_fits_record,
)
from workbench.report.warm import warm_record, warm_section
from workbench.simulation.channel import ChannelFigures, channel_figures
from workbench.simulation.energy import EnergySpectrum
from workbench.simulation.gathering import GatheredAt, Gathering
from workbench.simulation.run import Simulation, Snapshot

#: Peaks of the energy at most that a picture marks, the highest ones.
MOST_MARKED = 2

#: Name of the picture of energy over frequency.
ENERGY_PICTURE = "energy.png"


def field_table(report: TrapReport) -> TextTable:
    """The field a particle is in, and its effect on the particle anywhere."""
    forces, excitation = report.forces, report.excitation
    largest = float(np.nanmax(np.linalg.norm(forces.force, axis=1)))
    return TextTable(
        ("particle", "contrast factor", "net weight (pN)", "largest force (pN)", "p0 (kPa)", "E_ac (J/m^3)",
         "mean E_ac (J/m^3)"),
        ((f"{forces.particle.name}, {2e6 * forces.particle.radius:.3g} um",
          number_text(forces.scattering.contrast_factor, 3),
          number_text(1e12 * net_weight(forces.particle, forces.fluid), 3),
          number_text(1e12 * largest, 3), number_text(1e-3 * excitation.pressure_amplitude),
          number_text(excitation.energy_density, 3), number_text(excitation.mean_energy_density, 3)),))


def traps_table(report: TrapReport) -> TextTable:
    """Every trap: where, how strong, how much of the cavity drains to it and how fast."""
    weight = abs(net_weight(report.forces.particle, report.forces.fluid))
    rows = []
    for trap in report.traps:
        seconds = time_to(report, trap)
        rows.append((
            f"{trap.measure.symbol} {1e3 * trap.radius:.{trap.measure.decimals + 1}f}, z "
            f"{1e3 * trap.height:.{trap.measure.decimals + 1}f}{', on a wall' if trap.on_wall else ''}",
            f"{1e3 * trap.above_floor:.{trap.measure.decimals + 1}f}", *(_femtojoules(each) for each in (
                trap.barrier, trap.axial_barrier, trap.radial_barrier)),
            "" if trap.lift is None or not weight else number_text(trap.lift / weight, 3), f"{100.0 * trap.share:.0f}",
            f"{1e9 * trap.radial_stiffness:.3g}, {1e9 * trap.axial_stiffness:.3g}",
            "" if seconds is None else number_text(seconds, 3)))
    across, up = report.forces.mesh.measure.directions
    return TextTable(("trap (mm)", "above the floor (mm)", "barrier (fJ)", f"{up} barrier (fJ)",
                      f"{across} barrier (fJ)", "lift / weight", "share (%)", "stiffness (pN/mm)",
                      "focusing time (s)"), tuple(rows))


def _channel(shot: Snapshot) -> ChannelFigures | None:
    """The figures of the channel of a straight chip; None for a round chip and for a state without liquid."""
    if isinstance(shot.chip.measure, Axisymmetric) or not isinstance(shot.problem.materials.get(CAVITY), Fluid):
        return None
    return channel_figures(shot)


def channel_tables(shot: Snapshot) -> list[TextTable]:
    """Figures of the channel of a straight chip, and the lines that its particles focus to; nothing for a round chip
    and for a state without liquid."""
    found = _channel(shot)
    if found is None:
        return []
    tables = [TextTable(
        ("mean E_ac (J/m^3)", "per Vpp^2", "per W", "|p| across, mid-height (kPa)", "uneven over the height (%)",
         "critical diameter (um)"),
        ((number_text(found.energy_density, 3), number_text(found.energy_per_square_volt, 3),
          number_text(found.energy_per_watt, 3), number_text(1e-3 * float(found.across[:, 1].max())),
          number_text(100.0 * found.unevenness, 2),
          "" if found.critical_diameter is None else number_text(1e6 * found.critical_diameter, 3)),))]
    if len(found.channels) > 1:
        tables.append(TextTable(("channel (mm)", "mean E_ac (J/m^3)"), tuple(
            (f"x {1e3 * each.left:.4f} to {1e3 * each.right:.4f}", number_text(each.energy_density, 3))
            for each in found.channels)))
    if found.lines:
        tables.append(TextTable(
            ("line across (mm)", "depth (fJ)", "share of the width (%)", "stiffness (pN/mm)", "focusing time (s)"),
            tuple((f"x {1e3 * line.place:.4f}{', at the side wall' if line.at_side else ''}",
                   number_text(1e15 * line.depth, 3), f"{100.0 * line.share:.0f}", number_text(1e9 * line.stiffness, 3),
                   "" if line.time is None else number_text(line.time, 3)) for line in found.lines)))
    return tables


def _femtojoules(barrier: float | None) -> str:
    return "no way out" if barrier is None else number_text(1e15 * barrier, 3)


def model_table(runs: Sequence[Simulation]) -> TextTable:
    """Size, error and time of every run."""
    columns = ("state", "unknowns", "order", "error of Z by the mesh, rms", "by the reduced model", "full solves",
               "residual", "energy closure", "time (s)")
    return TextTable(columns, tuple(
        (run.state, str(run.unknowns), str(run.problem.mesh.order),
         f"{run.mesh_error.rms:.1e}" if run.mesh_error else "", f"{run.error:.1e}", str(run.solves),
         f"{run.residual:.1e}", f"{run.closure:.1e}", f"{sum(run.seconds.values()):.1f}") for run in runs))


def simulated_figures_table(chip: Chip, runs: Sequence[Simulation]) -> TextTable:
    """Figures of merit of every state as simulated, and as the chip file reports them."""
    rows: FigureRows = []
    for run in runs:
        (first, named), *rest = figures_rows(f"{run.state}, simulated", run.figures)
        cells = dict(zip(CAPACITANCE_COLUMNS, capacitance_cells(run.capacitance), strict=True))
        rows += [(first, named | cells), *rest]
        rows += [((f"{run.state}, {r.label}", f"{r.f0 / 1e6:.4f}", number_text(r.z_min), number_text(r.q), ""), {})
                 for r in chip.state(run.state).reported]
    return figures_table(rows, CAPACITANCE_COLUMNS)


def without_resonance(runs: Sequence[Simulation]) -> list[str]:
    """Reasons why states have no figures of merit, a sentence each."""
    return [f"{run.state}: {run.no_resonance}" for run in runs if run.figures is None]


def energy_table(runs: Sequence[Simulation]) -> TextTable:
    """The peaks of the energy in the cavity, of every state with a liquid, under its drive."""
    rows = []
    for run in runs:
        for peak in run.operating.peaks:
            rows.append((run.state, f"{peak.frequency / 1e6:.4f}", "" if peak.q is None else number_text(peak.q, 3),
                         number_text(peak.energy_density, 3), number_text(peak.per_square_volt, 3),
                         number_text(peak.per_watt, 3)))
    return TextTable(("state", "peak of the energy (MHz)", "Q", "mean E_ac (J/m^3)", "per Vpp^2", "per W"), tuple(rows))


def _findings(runs: Sequence[Simulation], first: Sequence[str]) -> list[Note]:
    """Findings of all runs but the `first` ones, each once with the states that it holds in."""
    found: dict[str, list[str]] = {}
    for run in runs:
        for text in (text for text in run.findings if text not in first):
            found.setdefault(text, []).append(run.state)
    return [Note(f"{', '.join(states)}: {text}") for text, states in found.items()]


def _millimetres(name: str, value: float, factor: float) -> str:
    """A dimension (m or rad) times a factor; an angle with its unit."""
    if ParameterName.parse(name).quantity == "angle":
        return f"{math.degrees(value):.3g} deg"
    return f"{factor * value:.4g}"


def write_simulation_report(
    chip: Chip, runs: Sequence[Simulation], answers: Sequence[Gathering], pictures: Mapping[str, Sequence[Picture]],
    solid_view: Sequence[Picture], folder: Path,
) -> Path:
    """``report.html``: its purpose first, then figures of merit, every state with its pictures, chip and model."""
    spectra = draw_spectra({run.state: run.spectrum for run in runs}, folder / "impedance.png", title=chip.name)
    dimensions = TextTable(("dimension", "value (mm)", "tolerance (um)", "where it comes from"), tuple(
        (name, _millimetres(name, d.value, 1e3), "" if d.tolerance is None else _millimetres(name, d.tolerance, 1e6),
         ": ".join(filter(None, ("assumed" if d.assumed else "", d.note)))) for name, d in chip.dimensions().items()))
    found = {run.state: run.resonances for run in runs}
    first = straight_findings(chip.measure, chip.electrodes)
    sections: list[tuple[str, list[Block]]] = [("What is computed?", [*map(Note, first)])] if first else []
    driven = _driven(chip, runs, folder)
    if driven:
        sections.append(("At which frequency?", driven))
    warmth = warm_section(chip.name, runs, folder)
    if warmth:
        sections.append(("How warm does it get?", warmth))
    if answers:
        # That of the last state first: it is the one the device works in.
        sections.append(("Do particles gather?", [Answer(str(answer)) for answer in reversed(answers)]))
    sections.append(("Figures of merit", [
        chip.description, f"Source: {chip.source}" if chip.source else "", simulated_figures_table(chip, runs),
        *map(Note, without_resonance(runs)), *_findings(runs, first), Picture(spectra, _resolution(runs)),
        resonances_table(found), *resonance_notes(found)]))
    for run in runs:
        blocks: list[Block] = []
        if run.traps is not None:
            blocks += [field_table(run.traps), traps_table(run.traps)]
        blocks += channel_tables(run)
        sections.append((f"State {run.state} at {run.fields.frequency / 1e6:.4f} MHz, {run.fields.drive}",
                         [*blocks, *pictures.get(run.state, ())]))
    used = TextTable(("state", "region", "material", "source"), tuple(
        (run.state, region, m.name, m.source) for run in runs for region, m in run.problem.materials.items()))
    sections += [("The chip", [*solid_view, dimensions, used]), ("The model", [model_table(runs)])]
    return write_report(folder / "report.html", chip.name, sections)


def _driven(chip: Chip, runs: Sequence[Simulation], folder: Path) -> list[Block]:
    """The operating points of states with a liquid, the peaks of their energy, and a picture; nothing without one."""
    energy, peaks = dict[str, EnergySpectrum](), dict[str, list[float]]()
    for run in runs:
        if run.energy is not None:
            energy[run.state] = run.energy
            peaks[run.state] = [peak.frequency for peak in run.operating.peaks[:MOST_MARKED]]
    if not energy:
        return []
    picture = draw_energy(energy, peaks, folder / ENERGY_PICTURE, title=chip.name)
    return [*(Answer(f"{run.state}: {run.operating}") for run in reversed(runs) if run.state in energy),
            energy_table(runs), Picture(picture, "impedance, and the energy of the sound in the cavity per square of "
                                        "the voltage; its peaks are marked")]


def _resolution(runs: Sequence[Simulation]) -> str:
    """The caption of the spectra: the number of points on each resonance, and the interpolation between them."""
    resolved = [f"{run.figures.count_within(run.spectrum.frequency)} of {run.state}" for run in runs
                if run.figures is not None]
    words = "impedance; between the points that were computed the curve is their interpolant, from which f0 and Q are"
    if not resolved:
        return words
    return f"{words}. Points within the half-power width of the resonance: {', '.join(resolved)}"


# --------------------------------------------------------------------------------------------------------------------
# merit.json.


def gathering_record(answers: Sequence[Gathering]) -> dict[str, Any]:
    """Whether, where and when particles gather, by state."""
    def place(found: GatheredAt) -> dict[str, Any]:
        return {"words": found.words, "share": found.share, "half_s": found.half}

    return {answer.state: {
        "gathers": answer.gathers, "sentences": list(answer.sentences),
        "first": None if answer.first is None else place(answer.first), "places": list(map(place, answer.places)),
        "critical_diameter_m": {name: finite(value) for name, value in answer.critical_diameters.items()},
    } for answer in answers}


def simulation_record(run: Simulation) -> dict[str, Any]:
    """Everything of a simulated state that merit.json holds."""
    record = figures_record(run.figures, run.no_resonance)
    record["static_capacitance_f"] = {"clamped": run.capacitance.clamped,
                                      "at_1_khz": run.capacitance.low_frequency}
    record["resonance_fits"] = single_fits_record(run.spectrum)
    record["circuit"] = resonances_record(run.resonances)
    record["model"] = {
        "unknowns": run.unknowns, "cells": int(run.problem.mesh.mesh.t.shape[1]), "full_solves": run.solves,
        "order": run.problem.mesh.order, "estimated_mesh_error_rms": run.mesh_error.rms if run.mesh_error else None,
        "estimated_relative_error": run.error, "largest_residual": run.residual, "energy_closure": run.closure,
    }
    record["fields"] = {"frequency_hz": run.fields.frequency, "drive": run.fields.drive,
                        "voltage_amplitude_v": abs(run.fields.voltage), "power_w": run.fields.power}
    record["operating_point"] = {
        "frequency_hz": run.operating.frequency, "words": str(run.operating)}
    record["energy_peaks"] = [
        {"frequency_hz": peak.frequency, "q": peak.q, "mean_energy_density_j_m3": peak.energy_density,
         "per_square_vpp_j_m3_v2": peak.per_square_volt, "per_watt_j_m3_w": peak.per_watt}
        for peak in run.operating.peaks]
    record["losses_w"] = dict(run.losses)
    if run.traps is not None:
        excitation = run.traps.excitation
        record["particles"] = {
            "particle": run.traps.forces.particle.name, "radius_m": run.traps.forces.particle.radius,
            "contrast_factor": run.traps.forces.scattering.contrast_factor,
            "pressure_amplitude_pa": excitation.pressure_amplitude, "energy_density_j_m3": excitation.energy_density,
            "drive": excitation.description, "focus_time_s": focus_time(run.traps),
            "net_weight_n": net_weight(run.traps.forces.particle, run.traps.forces.fluid),
            "share_settled": run.traps.settled,
            "traps": [_trap_record(trap) for trap in run.traps.traps],
        }
    record |= _channel_record(run)
    record |= warm_record(run)
    record["findings"], record["left_out_hz"] = list(run.findings), list(run.left_out)
    record["seconds"] = dict(run.seconds)
    return record


def _channel_record(shot: Snapshot) -> dict[str, Any]:
    """The figures of the channel of a straight chip; empty for others."""
    found = _channel(shot)
    if found is None:
        return {}
    return {"channel": {
        "mean_energy_density_j_m3": found.energy_density, "per_square_vpp_j_m3_v2": found.energy_per_square_volt,
        "per_watt_j_m3_w": found.energy_per_watt, "unevenness_over_height": found.unevenness,
        "channels": [{"left_m": each.left, "right_m": each.right, "mean_energy_density_j_m3": each.energy_density}
                     for each in found.channels],
        "across_m_pa": found.across.tolist(), "up_m_pa": found.up.tolist(),
        "critical_diameter_m": found.critical_diameter,
        "focus_time_s": None if math.isnan(found.focus_time) else found.focus_time,
        "lines": [{"x_m": line.place, "depth_j": line.depth, "share_of_width": line.share, "at_side_wall": line.at_side,
                   "stiffness_n_m": line.stiffness, "focus_time_s": line.time} for line in found.lines]}}


def _trap_record(trap: Trap) -> dict[str, Any]:
    return {"r_m": trap.radius, "z_m": trap.height, "above_floor_m": trap.above_floor, "barrier_j": trap.barrier,
            "axial_barrier_j": trap.axial_barrier, "radial_barrier_j": trap.radial_barrier, "depth_j": trap.depth,
            "lift_n": trap.lift, "share_of_cavity": trap.share, "radial_stiffness_n_m": trap.radial_stiffness,
            "axial_stiffness_n_m": trap.axial_stiffness, "on_wall": trap.on_wall}
