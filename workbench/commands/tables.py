"""Tables that several reports have."""

from __future__ import annotations

from workbench.report.page import Table
from workbench.simulation import Simulation
from workbench.spectrum import Origin


def model_table(runs: list[Simulation]) -> Table:
    """Size, error and time of every run."""
    columns = ("state", "unknowns", "order", "error of Z by the mesh, rms", "by the reduced model", "full solves",
               "residual", "energy closure", "time (s)")
    return Table(columns, tuple(
        (run.state, str(run.unknowns), str(run.problem.mesh.order),
         f"{run.mesh_error.rms:.1e}" if run.mesh_error else "", f"{run.error:.1e}", str(run.solves),
         f"{run.residual:.1e}", f"{run.closure:.1e}", f"{sum(run.seconds.values()):.1f}") for run in runs))


def origin_table(origin: Origin) -> Table:
    """Where a recording comes from."""
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return Table(("recording", ""), tuple((name, value) for name, value in rows if value))
