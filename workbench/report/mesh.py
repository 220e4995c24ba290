"""Meshes of a chip and their convergence: tables, record and page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.mesh import elements_per_wavelength
from workbench.model.problem import Problem
from workbench.render.plots import draw_convergence
from workbench.report.page import Picture, TextTable, in_unit, table, write_report
from workbench.simulation.run import Simulation

#: The columns of ``convergence.json``.
RECORDED = ("accuracy", "unknowns", "f0_hz", "z_min_ohm", "q", "estimated_rms_error", "rms_error")


def cells_table(problem: Problem, highest: float) -> TextTable:
    """Cells of every region, and elements per wavelength at `highest` (Hz)."""
    mesh = problem.mesh
    speeds = {region: material.slowest_wave_speed() for region, material in problem.materials.items()}
    counts = elements_per_wavelength(mesh, speeds, highest)
    return table("region | cells | elements per wavelength:.1f", (
        (region, len(mesh.mesh.subdomains[region]), counts.get(region, "empty")) for region in mesh.section.regions))


@dataclass(frozen=True)
class MeshRow:
    """One mesh of a given ``accuracy`` (None: the finest).

    It has its ``unknowns``, figures of merit (Hz, ohm, 1), the rms error of ln Z as ``estimated`` on it (NaN: not) and
    against the finest, and the ``size`` of its elements (root of their mean area, m).
    """

    accuracy: float | None
    unknowns: int
    f0: float
    z_min: float
    q: float
    estimated: float
    error: float
    size: float

    @classmethod
    def of(cls, accuracy: float | None, run: Simulation, finest: Simulation) -> MeshRow:
        """From a run with figures of merit and the finest run."""
        mesh = run.problem.mesh
        area = sum(mesh.section.area(region) for region in mesh.section.regions)
        # Complex division does not give exactly one of equal numbers.
        error = 0.0 if run is finest else float(np.sqrt(np.mean(np.abs(np.log(
            run.spectrum.impedance / finest.spectrum.impedance)) ** 2)))
        merit = run.figures
        assert merit is not None
        return cls(accuracy, run.unknowns, merit.f0, merit.z_min, merit.q,
                   run.mesh_error.rms if run.mesh_error else math.nan, error, math.sqrt(area / mesh.mesh.t.shape[1]))


def convergence_table(rows: Sequence[MeshRow]) -> TextTable:
    """Figures of merit, error and estimated error of every mesh."""
    return table("accuracy | unknowns | f0 (MHz):.5f | Z_min (ohm) | Q | error (%):.4f | estimate", (
        ("finer" if row.accuracy is None else f"{100.0 * row.accuracy:g} %", row.unknowns, row.f0, row.z_min, row.q,
         None if row.accuracy is None else row.error, in_unit(row.estimated, "%", ".4f")) for row in rows))


def convergence_record(rows: Sequence[MeshRow]) -> dict[str, Any]:
    """The content of ``convergence.json``."""
    return {"columns": list(RECORDED), "rows": [
        [row.accuracy, row.unknowns, row.f0, row.z_min, row.q, row.estimated, row.error] for row in rows]}


def write_convergence_report(title: str, rows: Sequence[MeshRow], folder: Path) -> Path:
    """Write ``report.html``: table and differences from the finest mesh, the last row."""
    *others, finest = rows
    errors = {"f0": [abs(row.f0 / finest.f0 - 1.0) for row in others],
              "Z_min": [abs(row.z_min / finest.z_min - 1.0) for row in others],
              "Z, rms": [row.error for row in others], "Z, rms, estimated": [row.estimated for row in others]}
    path = draw_convergence(np.array([row.size for row in others]),
                            {label: np.array(values) for label, values in errors.items()}, folder / "convergence.png",
                            title=f"{title}: difference from the finest mesh")
    return write_report(folder / "report.html", f"{title}: accuracy of meshes", [("Accuracy", [
        convergence_table(rows),
        Picture(path, "difference from the finest mesh against the mean size of the elements, whose order is not the "
                      "same everywhere")])])
