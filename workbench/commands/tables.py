"""Tables that several reports have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from workbench.report.page import TextTable, number_text
from workbench.results.merit import Figures
from workbench.results.spectrum import Origin
from workbench.simulation.run import Simulation

if TYPE_CHECKING:
    from workbench.diagnosis.record import Contribution


def model_table(runs: list[Simulation]) -> TextTable:
    """Size, error and time of every run."""
    columns = ("state", "unknowns", "order", "error of Z by the mesh, rms", "by the reduced model", "full solves",
               "residual", "energy closure", "time (s)")
    return TextTable(columns, tuple(
        (run.state, str(run.unknowns), str(run.problem.mesh.order),
         f"{run.mesh_error.rms:.1e}" if run.mesh_error else "", f"{run.error:.1e}", str(run.solves),
         f"{run.residual:.1e}", f"{run.closure:.1e}", f"{sum(run.seconds.values()):.1f}") for run in runs))


def known_physics_table(known: Sequence[Contribution]) -> TextTable:
    """What every effect with known constants changes."""
    return TextTable(("effect", "state", "f0 (Hz)", "Q", "ln Z, rms (%)"), tuple(
        (row.effect, row.state, *("none" if value is None else f"{value:+.3g}"
                                  for value in (row.f0_change, row.q_change)),
         f"{100.0 * row.rms_log_change:.3g}") for row in known))


def merit_cells(merit: Figures | None) -> tuple[str, str, str]:
    """f0 (kHz), Z_min (ohm) and Q."""
    if merit is None:
        return "none", "none", "none"
    return f"{merit.f0 / 1e3:.3f}", number_text(merit.z_min), number_text(merit.q)


def origin_table(origin: Origin) -> TextTable:
    """Where a recording comes from."""
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return TextTable(("recording", "value"), tuple((name, value) for name, value in rows if value))
