"""Simulated states, and their comparisons with recordings, as records."""

from __future__ import annotations

from typing import Any

from workbench.comparison import Comparison
from workbench.particles import net_weight
from workbench.report.figures import figures_record, fit_record, resonance_fits
from workbench.simulation import Simulation
from workbench.traps import Trap, focus_time


def simulation_record(run: Simulation) -> dict[str, Any]:
    """Everything of a simulated state that merit.json holds."""
    record = figures_record(run.figures, run.no_resonance)
    record["static_capacitance_f"] = {"clamped": run.capacitance.clamped,
                                      "at_1_khz": run.capacitance.low_frequency}
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
            "net_weight_n": net_weight(run.traps.forces.particle, run.traps.forces.fluid),
            "share_settled": run.traps.settled,
            "traps": [_trap_record(trap) for trap in run.traps.traps],
        }
    record["seconds"] = dict(run.seconds)
    return record


def _trap_record(trap: Trap) -> dict[str, Any]:
    return {"r_m": trap.radius, "z_m": trap.height, "above_floor_m": trap.above_floor, "barrier_j": trap.barrier,
            "axial_barrier_j": trap.axial_barrier, "radial_barrier_j": trap.radial_barrier, "depth_j": trap.depth,
            "lift_n": trap.lift, "share_of_cavity": trap.share, "radial_stiffness_n_m": trap.radial_stiffness,
            "axial_stiffness_n_m": trap.axial_stiffness, "on_wall": trap.on_wall}


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
