"""Simulated states, and their comparisons with recordings, as records."""

from __future__ import annotations

from typing import Any

from workbench.comparison import Comparison
from workbench.report.figures import figures_record, fit_record, resonance_fits
from workbench.simulation import Simulation
from workbench.traps import focus_time


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
    record["findings"], record["left_out_hz"] = list(run.findings), list(run.left_out)
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
