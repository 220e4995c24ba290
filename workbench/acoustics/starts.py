"""Start points of particles, spread evenly over their accessible volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import FloatArray, NodalMesh
from workbench.acoustics.walls import Walls
from workbench.files.errors import InputError

#: Steps of an even sequence of points in a square, along its two sides: powers of the root of x^3 = x + 1 (M. Roberts,
#: 2018). Shares of 200 points are accurate to 1 %, those of random points to 3 %.
EVEN_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
#: Trial points per wanted one before a particle counts as too large for its cavity: its centre then has a thousandth of
#: the box around the cavity. Doubled, a tighter fit is accepted.
DRAWN_PER_POINT = 1000
#: Steps of the search for the floor, which misses no ledge higher than a hundredth of the distance, and halvings of the
#: last one: to a millionth.
WAY_DOWN, HALVINGS = 101, 14


def draw_starts(
    mesh: NodalMesh, walls: Walls, count: int, *, radius: float, random: np.random.Generator
) -> FloatArray:
    """Start points (count, 2) away from walls, even by volume. They are r, z in m.

    They are in a `mesh` of one region, more than a `radius` (m) from walls, from one even sequence shifted by `random`
    numbers.

    Raises:
        InputError: almost no place of the region is that far from all walls.
    """
    (low_r, low_z), (high_r, high_z) = mesh.points.min(axis=0), mesh.points.max(axis=0)
    search = Interpolant(mesh, np.zeros((len(mesh.points), 1)))
    found, drawn, left = [np.empty((0, 2))], 0, count
    shift = random.uniform(size=2)
    while left > 0:
        if drawn > DRAWN_PER_POINT * count:
            raise InputError("trajectories", "particle_radius", f"{1e6 * radius:.4g} um", "a particle that fits into "
                             f"the cavity, {1e3 * (high_r - low_r):.4g} mm by {1e3 * (high_z - low_z):.4g} mm")
        shares = (shift + np.arange(drawn, drawn + 2 * count)[:, None] * EVEN_STEPS) % 1.0
        points = np.stack([mesh.measure.evenly(shares[:, 0], low_r, high_r),
                           low_z + shares[:, 1] * (high_z - low_z)], axis=1)
        drawn += 2 * count
        points = points[search.cells_at(points) >= 0]
        points = points[walls.nearest(points)[0] > radius][:left]
        found.append(points)
        left -= len(points)
    return np.concatenate(found)


def put_down(mesh: NodalMesh, walls: Walls, starts: FloatArray, *, radius: float, down: float) -> FloatArray:
    """The places (count, 2) on the wall below `starts`. Their distance from it is `radius` (m). They are above if
    `down` is 1."""
    search = Interpolant(mesh, np.zeros((len(mesh.points), 1)))
    end = mesh.points[:, 1].min() if down < 0.0 else mesh.points[:, 1].max()

    def free(share: FloatArray) -> NDArray[np.bool_]:
        """Whether a particle has room after a share (count,) of the distance."""
        points = np.stack([starts[:, 0], starts[:, 1] + share * (end - starts[:, 1])], axis=1)
        return np.asarray((search.cells_at(points) >= 0) & (walls.nearest(points)[0] >= radius))

    low, on_way = np.zeros(len(starts)), np.ones(len(starts), dtype=bool)
    for share in np.linspace(0.0, 1.0, WAY_DOWN)[1:]:
        on_way &= free(np.full(len(starts), share))
        low[on_way] = share
    high = np.minimum(low + 1.0 / (WAY_DOWN - 1), 1.0)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        there = free(middle)
        low, high = np.where(there, middle, low), np.where(there, high, middle)
    return np.stack([starts[:, 0], starts[:, 1] + low * (end - starts[:, 1])], axis=1)
