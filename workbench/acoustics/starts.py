"""Start points of particles, drawn evenly over the volume that their centres can take."""

from __future__ import annotations

import numpy as np

from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import FloatArray, NodalMesh
from workbench.acoustics.walls import Walls
from workbench.files.errors import InputError

#: Points drawn for each one wanted, over all attempts, before a particle counts as too large for its cavity: its centre
#: has a thousandth of the box around the cavity. Doubled, a still tighter fit is accepted.
DRAWN_PER_POINT = 1000


def draw_starts(
    mesh: NodalMesh, walls: Walls, count: int, *, radius: float, random: np.random.Generator
) -> FloatArray:
    """Start points (count, 2) r, z in m in a `mesh` of one region, evenly by volume, none within a `radius`
    (m) of a wall.

    Raises:
        InputError: next to no place of the region is that far from all walls.
    """
    (low_r, low_z), (high_r, high_z) = mesh.points.min(axis=0), mesh.points.max(axis=0)
    search = Interpolant(mesh, np.zeros((len(mesh.points), 1)))
    found, drawn, left = [np.empty((0, 2))], 0, count
    while left > 0:
        if drawn > DRAWN_PER_POINT * count:
            raise InputError("trajectories", "particle_radius", f"{1e6 * radius:.4g} um", "a particle that fits into "
                             f"the cavity, {1e3 * (high_r - low_r):.4g} mm by {1e3 * (high_z - low_z):.4g} mm")
        r = mesh.measure.evenly(random, low_r, high_r, 2 * count)
        points = np.stack([r, random.uniform(low_z, high_z, 2 * count)], axis=1)
        drawn += 2 * count
        points = points[search.cells_at(points) >= 0]
        points = points[walls.nearest(points)[0] > radius][:left]
        found.append(points)
        left -= len(points)
    return np.concatenate(found)
