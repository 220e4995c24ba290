"""Simulated states, and their comparisons with recordings, as records."""

from __future__ import annotations

from typing import Any

import numpy as np

from workbench.acoustics.traps import Trap, TrapReport, focus_time, time_to
from workbench.model.particles import net_weight
from workbench.report.figures import figures_record, resonance_fits, resonance_record
from workbench.report.page import TextTable, number_text
from workbench.results.comparison import Comparison
from workbench.simulation.run import Simulation


def simulation_record(run: Simulation) -> dict[str, Any]:
    """Everything of a simulated state that merit.json holds."""
    record = figures_record(run.figures, run.no_resonance)
    record["static_capacitance_f"] = {"clamped": run.capacitance.clamped,
                                      "at_1_khz": run.capacitance.low_frequency}
    record["resonance_fits"] = {name: resonance_record(fit) for name, fit in resonance_fits(run.spectrum).items()}
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
            "net_weight_n": net_weight(run.traps.forces.particle, run.traps.forces.fluid),
            "share_settled": run.traps.settled,
            "traps": [_trap_record(trap) for trap in run.traps.traps],
        }
    record["findings"], record["left_out_hz"] = list(run.findings), list(run.left_out)
    record["seconds"] = dict(run.seconds)
    return record


def _trap_record(trap: Trap) -> dict[str, Any]:
    return {"r_m": trap.radius, "z_m": trap.height, "above_floor_m": trap.above_floor, "barrier_j": trap.barrier,
            "axial_barrier_j": trap.axial_barrier, "radial_barrier_j": trap.radial_barrier, "depth_j": trap.depth,
            "lift_n": trap.lift, "share_of_cavity": trap.share, "radial_stiffness_n_m": trap.radial_stiffness,
            "axial_stiffness_n_m": trap.axial_stiffness, "on_wall": trap.on_wall}


def field_table(report: TrapReport) -> TextTable:
    """The field a particle is in, and what it does to the particle anywhere."""
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
            f"r {1e3 * trap.radius:.3f}, z {1e3 * trap.height:.3f}{', on a wall' if trap.on_wall else ''}",
            f"{1e3 * trap.above_floor:.3f}", *(_femtojoules(each) for each in (
                trap.barrier, trap.axial_barrier, trap.radial_barrier)),
            "" if trap.lift is None or not weight else number_text(trap.lift / weight, 3), f"{100.0 * trap.share:.0f}",
            f"{1e9 * trap.radial_stiffness:.3g}, {1e9 * trap.axial_stiffness:.3g}",
            "" if seconds is None else number_text(seconds, 3)))
    return TextTable(("trap (mm)", "above the floor (mm)", "barrier (fJ)", "axial barrier (fJ)", "radial barrier (fJ)",
                      "lift / weight", "share (%)", "stiffness (pN/mm)", "focusing time (s)"), tuple(rows))


def _femtojoules(barrier: float | None) -> str:
    return "no way out" if barrier is None else number_text(1e15 * barrier, 3)


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
