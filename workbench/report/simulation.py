"""Simulated states of a chip: tables, record and page."""

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
from workbench.acoustics.traps import TrapReport, focus_time, time_to
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
from workbench.report.page import Answer, Block, Picture, TextTable, Value, number_text, table, write_report
from workbench.report.record import record
from workbench.report.resonances import resonance_notes, resonances_record, resonances_table, single_fits_record
from workbench.report.warm import warm_record, warm_section
from workbench.simulation.channel import ChannelFigures, channel_figures
from workbench.simulation.gathering import Gathering
from workbench.simulation.run import Simulation, Snapshot

#: Peaks of the energy at most that a picture marks, the highest ones.
MOST_MARKED = 2

#: Traps around the axis at most that a table lists, the deepest ones.
MOST_LISTED = 20

#: Name of the picture of energy over frequency.
ENERGY_PICTURE = "energy.png"


def field_table(report: TrapReport) -> TextTable:
    """The field that acts on a particle, and its largest force."""
    forces, excitation = report.forces, report.excitation
    return table(
        "particle | contrast factor:.3g | net weight (pN):.3g | largest force (pN):.3g | p0 (kPa) | E_ac (J/m^3):.3g | "
        "mean E_ac (J/m^3):.3g",
        [(f"{forces.particle.name}, {2e6 * forces.particle.radius:.3g} um", forces.scattering.contrast_factor,
          net_weight(forces.particle, forces.fluid), float(np.nanmax(np.linalg.norm(forces.force, axis=1))),
          excitation.pressure_amplitude, excitation.energy_density, excitation.mean_energy_density)])


def traps_table(report: TrapReport) -> TextTable:
    """Every trap: its place, strength, share of the cavity and focusing time."""
    weight = abs(net_weight(report.forces.particle, report.forces.fluid))
    measure = report.forces.mesh.measure
    digits, (across, up) = f".{measure.decimals + 1}f", measure.directions
    rows: list[tuple[Value, ...]] = []
    for trap in report.traps:
        place = f"{measure.symbol} {1e3 * trap.radius:{digits}}, z {1e3 * trap.height:{digits}}"
        barriers = ("no way out" if each is None else each
                    for each in (trap.barrier, trap.axial_barrier, trap.radial_barrier))
        rows.append((f"{place}, on a wall" if trap.on_wall else place, trap.above_floor, *barriers,
                     None if trap.lift is None or not weight else trap.lift / weight, trap.share,
                     f"{1e9 * trap.radial_stiffness:.3g}, {1e9 * trap.axial_stiffness:.3g}", time_to(report, trap)))
    return table(
        f"trap (mm) | above the floor (mm):{digits} | barrier (fJ):.3g | {up} barrier (fJ):.3g | "
        f"{across} barrier (fJ):.3g | lift / weight:.3g | share (%):.0f | stiffness (pN/mm) | focusing time (s):.3g",
        rows)


def _channel(shot: Snapshot) -> ChannelFigures | None:
    """The figures of the channel; None in round or dry chips."""
    if isinstance(shot.chip.measure, Axisymmetric) or not isinstance(shot.problem.materials.get(CAVITY), Fluid):
        return None
    return channel_figures(shot)


def channel_tables(shot: Snapshot) -> list[TextTable]:
    """Figures of the channel of a straight chip, and its lines.

    Empty for a round chip and for a state without liquid.
    """
    found = _channel(shot)
    if found is None:
        return []
    tables = [table(
        "mean E_ac (J/m^3):.3g | per Vpp^2:.3g | per W:.3g | |p| across, mid-height (kPa) | "
        "uneven over the height (%):.2g | critical diameter (um):.3g",
        [(found.energy_density, found.energy_per_square_volt, found.energy_per_watt, float(found.across[:, 1].max()),
          found.unevenness, found.critical_diameter)])]
    if len(found.channels) > 1:
        tables.append(table("channel (mm) | mean E_ac (J/m^3):.3g", (
            (f"x {1e3 * each.left:.4f} to {1e3 * each.right:.4f}", each.energy_density) for each in found.channels)))
    if found.lines:
        tables.append(table(
            "line across (mm) | depth (fJ):.3g | share of the width (%):.0f | stiffness (pN/mm):.3g | "
            "focusing time (s):.3g",
            ((f"x {1e3 * line.place:.4f}{', at the side wall' if line.at_side else ''}", line.depth, line.share,
              line.stiffness, line.time) for line in found.lines)))
    return tables


def peak_modes_table(runs: Sequence[Simulation]) -> TextTable:
    """The mode behind every peak of the conductance and of the energy."""
    return table(
        "state | peak (MHz):.4f | of | part (%):.0f | f (MHz):.6f | Q:.4g | mode",
        ((run.state, peak.frequency, peak.quantity, peak.share, peak.mode.frequency, peak.mode.q, peak.mode.words)
         for run in runs for peak in run.peak_modes))


def pattern_table(run: Simulation) -> TextTable:
    """The deepest traps of a particle around the axis."""
    assert run.pattern is not None
    return table("trap around the axis | r (mm):.3f | z (mm):.3f | angle (deg):.0f | potential (fJ):.3g", (
        (number, trap.radius, trap.height, trap.angle, trap.potential)
        for number, trap in enumerate(run.pattern.traps[:MOST_LISTED], 1)))


def model_table(runs: Sequence[Simulation]) -> TextTable:
    """Size, error and time of every run."""
    return table(
        "state | unknowns | order | error of Z by the mesh, rms:.1e | by the reduced model:.1e | full solves | "
        "residual:.1e | energy closure:.1e | time (s):.1f",
        ((run.state, run.unknowns, run.problem.mesh.order, run.mesh_error and run.mesh_error.rms, run.error,
          run.solves, run.residual, run.closure, sum(run.seconds.values())) for run in runs))


def simulated_figures_table(chip: Chip, runs: Sequence[Simulation]) -> TextTable:
    """Figures of merit of every state, simulated and stated."""
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


def findings_by_state(runs: Sequence[Simulation], first: Sequence[str]) -> list[str]:
    """Findings of all runs but the `first`, each with its states."""
    found: dict[str, list[str]] = {}
    for run in runs:
        for text in (text for text in run.findings if text not in first):
            found.setdefault(text, []).append(run.state)
    return [f"{', '.join(states)}: {text}" for text, states in found.items()]


def _millimetres(name: str, value: float, factor: float) -> str:
    """A dimension (m) times a factor; an angle (rad) in degrees."""
    if ParameterName.parse(name).quantity == "angle":
        return f"{math.degrees(value):.3g} deg"
    return f"{factor * value:.4g}"


def write_simulation_report(
    chip: Chip, runs: Sequence[Simulation], answers: Sequence[Gathering], pictures: Mapping[str, Sequence[Picture]],
    solid_view: Sequence[Picture], folder: Path,
) -> Path:
    """Write ``report.html``: answers, figures of merit, states, chip and model.

    The last state is first in the answers, because the device works in it.
    """
    found = {run.state: run.resonances for run in runs}
    spectra = draw_spectra({run.state: run.spectrum for run in runs}, folder / "impedance.png", title=chip.name)
    return write_report(folder / "report.html", chip.name, module=__name__, values={
        "chip": chip, "runs": runs, "straight": straight_findings(chip.measure, chip.electrodes), "answers": answers,
        "driven": _driven(chip, runs, folder), "warm": warm_section(chip.name, runs, folder), "pictures": pictures,
        "solid_view": solid_view, "spectra": Picture(spectra, _resolution(runs)),
        "resonances": [resonances_table(found), *resonance_notes(found)]})


def materials_of(runs: Sequence[Simulation]) -> TextTable:
    """The material of every region, by state."""
    return table("state | region | material | source", (
        (run.state, region, m.name, m.source) for run in runs for region, m in run.problem.materials.items()))


def dimensions_table(chip: Chip) -> TextTable:
    """Every dimension of a chip with its tolerance and source."""
    return table("dimension | value (mm) | tolerance (um) | source", (
        (name, _millimetres(name, d.value, 1e3), None if d.tolerance is None else _millimetres(name, d.tolerance, 1e6),
         ": ".join(filter(None, ("assumed" if d.assumed else "", d.note)))) for name, d in chip.dimensions().items()))


def _driven(chip: Chip, runs: Sequence[Simulation], folder: Path) -> list[Block]:
    """The operating points and energy peaks of wet states; empty without one."""
    energy = {run.state: run.energy.resolved(run.operating.peaks) for run in runs if run.energy is not None}
    if not energy:
        return []
    marked = {run.state: [peak.frequency for peak in run.operating.peaks[:MOST_MARKED]]
              for run in runs if run.state in energy}
    picture = draw_energy(energy, marked, folder / ENERGY_PICTURE, title=chip.name)
    peaks = table("state | peak of the energy (MHz):.4f | Q:.3g | mean E_ac (J/m^3):.3g | per Vpp^2:.3g | per W:.3g", (
        (run.state, peak.frequency, peak.q, peak.energy_density, peak.per_square_volt, peak.per_watt)
        for run in runs for peak in run.operating.peaks))
    return [*(Answer(f"{run.state}: {run.operating}") for run in reversed(runs) if run.state in energy), peaks,
            Picture(picture, "impedance, and the energy of the sound in the cavity per square of the voltage; its "
                             "peaks are marked")]


def _resolution(runs: Sequence[Simulation]) -> str:
    """The caption of the spectra: interpolation, and points on each resonance."""
    resolved = [f"{run.figures.count_within(run.spectrum.frequency)} of {run.state}" for run in runs
                if run.figures is not None]
    words = "impedance; between the points that were computed the curve is their interpolant, from which f0 and Q are"
    if not resolved:
        return words
    return f"{words}. Points within the half-power width of the resonance: {', '.join(resolved)}"


def gathering_record(answers: Sequence[Gathering]) -> dict[str, Any]:
    """Places and times of gathering, by state."""
    place = "{ words share half_s }"
    return {answer.state: record(answer, f"gathers sentences first {place} places {place} "
                                         "critical_diameter_m=critical_diameters") for answer in answers}


def simulation_record(run: Simulation) -> dict[str, Any]:
    """The entry of a simulated state in merit.json."""
    found: dict[str, Any] = figures_record(run.figures, run.no_resonance) | record(
        run, "static_capacitance_f=capacitance { clamped at_1_khz=low_frequency } "
             "fields { frequency_hz drive power_w } operating_point=operating { frequency_hz } "
             "energy_peaks=operating.peaks { frequency_hz q mean_energy_density_j_m3=energy_density "
             "per_square_vpp_j_m3_v2=per_square_volt per_watt_j_m3_w=per_watt } "
             "losses_w findings left_out_hz=left_out seconds "
             "peak_modes { frequency_hz quantity share_of_conductance=share "
             "mode { frequency_hz q k_eff capacitance_f energy loss zeros=crossings words } }")
    found["resonance_fits"], found["circuit"] = single_fits_record(run.spectrum), resonances_record(run.resonances)
    found["model"] = record(
        run, "unknowns cells=problem.mesh.mesh.nelements full_solves=solves order=problem.mesh.order "
             "estimated_mesh_error_rms=mesh_error.rms estimated_relative_error=error largest_residual=residual "
             "energy_closure=closure")
    found["fields"]["voltage_amplitude_v"] = abs(run.fields.voltage)
    found["operating_point"]["words"] = str(run.operating)
    if run.traps is not None:
        forces = run.traps.forces
        found["particles"] = record(
            run.traps, "particle=forces.particle.name radius_m=forces.particle.radius "
                       "contrast_factor=forces.scattering.contrast_factor "
                       "pressure_amplitude_pa=excitation.pressure_amplitude "
                       "energy_density_j_m3=excitation.energy_density drive=excitation.description "
                       "share_settled=settled traps { r_m=radius z_m=height above_floor_m barrier_j axial_barrier_j "
                       "radial_barrier_j depth_j lift_n share_of_cavity=share radial_stiffness_n_m "
                       "axial_stiffness_n_m on_wall }") | {
            "focus_time_s": focus_time(run.traps), "net_weight_n": net_weight(forces.particle, forces.fluid)}
    if run.pattern is not None:
        found["pattern"] = record(
            run.pattern, "frequency_hz orders unevenness height_m=height "
                         "traps { r_m=radius z_m=height angle_rad=angle potential_j=potential }")
    channel = record(
        _channel(run), "mean_energy_density_j_m3=energy_density per_square_vpp_j_m3_v2=energy_per_square_volt "
                       "per_watt_j_m3_w=energy_per_watt unevenness_over_height=unevenness "
                       "channels { left_m right_m mean_energy_density_j_m3=energy_density } across_m_pa=across "
                       "up_m_pa=up critical_diameter_m focus_time_s lines { x_m=place depth_j share_of_width=share "
                       "at_side_wall=at_side stiffness_n_m focus_time_s=time }")
    return found | ({} if channel is None else {"channel": channel}) | warm_record(run)
