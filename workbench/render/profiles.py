"""The Gor'kov potential along lines through a trap."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from workbench.acoustics.nodal import FloatArray, interpolate
from workbench.acoustics.traps import Trap, TrapReport
from workbench.render.canvas import new_figure, prefixed, save_figure, typeset
from workbench.render.plots import LINE_COLOURS, tidy


def draw_potential_profiles(report: TrapReport, path: Path, *, trap: Trap | None = None) -> Path:
    """Draw the Gor'kov potential along the axis and along the radius.

    The lines pass through `trap`, by default the deepest. As in Fig. 9b of Acevedo-Espinosa et al. (RP-UEIS).

    Raises:
        ValueError: there is no trap.
    """
    if trap is None:
        if not report.traps:
            raise ValueError("no trap in this field: name the trap whose profiles to draw")
        trap = report.traps[0]
    forces = report.forces
    nodes = forces.mesh.points[forces.mesh.nodes_of([forces.region])]
    height = np.linspace(nodes[:, 1].min(), nodes[:, 1].max(), 400)
    radius = np.linspace(nodes[:, 0].min(), nodes[:, 0].max(), 400)
    symbol = trap.measure.symbol

    def along(points: list[FloatArray]) -> FloatArray:
        values: FloatArray = interpolate(forces.mesh, forces.potential, np.stack(points, axis=1), [forces.region])
        return values

    axial = along([np.full_like(height, trap.radius), height])
    radial = along([radius, np.full_like(radius, trap.height)])
    factor, unit = prefixed(float(np.nanmax(np.abs(np.concatenate([axial, radial])))), "J")
    figure = new_figure(9.5, 4.4)
    over_z, over_r = figure.subplots(1, 2)
    over_z.plot(height * 1e3, axial * factor, color=LINE_COLOURS[0])
    over_z.set_xlabel("z (mm)")
    over_z.set_title(f"along {symbol} = {round(trap.radius * 1e3, 6):.3g} mm", fontsize=10)
    if trap.measure.mirror:
        # The other half is the mirror image.
        radius, radial = np.concatenate([-radius[::-1], radius]), np.concatenate([radial[::-1], radial])
    over_r.plot(radius * 1e3, radial * factor, color=LINE_COLOURS[1])
    over_r.set_xlabel(f"{symbol} (mm)")
    over_r.set_title(f"along z = {trap.height * 1e3:.3f} mm", fontsize=10)
    over_z.axvline(trap.height * 1e3, color="#888888", linewidth=0.8, linestyle=":")
    over_r.axvline(trap.radius * 1e3, color="#888888", linewidth=0.8, linestyle=":")
    for axes in (over_z, over_r):
        axes.set_ylabel(f"Gor'kov potential U ({unit})")
        tidy(axes)
    particle = f"{2e6 * forces.particle.radius:.3g} µm {forces.particle.name}"
    figure.suptitle(f"{particle}\n{typeset(forces.excitation)}", fontsize=9)
    figure.tight_layout()
    return save_figure(figure, path)
