"""Distance of particles from the walls of a region, and wall directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.acoustics.nodal import FloatArray, NodalMesh, border_lines
from workbench.results.brief import Brief

#: Number of distances per block: 64 MB. Doubled, start points in a mesh with many walls take twice that.
DISTANCES_AT_A_TIME = 2_000_000


@dataclass(frozen=True, eq=False, repr=False)
class Walls(Brief):
    """The walls of a region as straight pieces. They go from `begin` (S, 2) to `end` (S, 2), r and z in m."""

    begin: FloatArray
    end: FloatArray

    def nearest(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (K,) in m of points from walls, and directions (K, 2). The `points` are (K, 2). The directions are
        unit vectors from the nearest wall, zero for a point on a wall."""
        distance, away = np.empty(len(points)), np.empty((len(points), 2))
        at_a_time = max(1, DISTANCES_AT_A_TIME // len(self.begin))
        along = self.end - self.begin
        square = (along**2).sum(axis=1)
        for first in range(0, len(points), at_a_time):
            some = slice(first, first + at_a_time)
            apart = points[some, None] - self.begin
            share = np.clip((apart * along).sum(axis=2) / square, 0.0, 1.0)
            apart -= share[:, :, None] * along
            squares = (apart**2).sum(axis=2)
            closest = squares.argmin(axis=1)[:, None]
            distance[some] = np.sqrt(np.take_along_axis(squares, closest, axis=1)[:, 0])
            away[some] = np.take_along_axis(apart, closest[:, :, None], axis=1)[:, 0]
        return distance, away / np.where(distance > 0.0, distance, 1.0)[:, None]


def walls_of(mesh: NodalMesh) -> Walls:
    """The walls of a `mesh` of one region, without mirror lines. Pieces on one line are joined."""
    ends = mesh.points[border_lines(mesh, np.zeros(len(mesh.cells), dtype=np.int64))]
    if not mesh.is_grid:
        return Walls(ends[:, 0], ends[:, 1])
    # Sides of rectangles are along r or z: a line is a direction and a place across it.
    pieces: list[FloatArray] = []
    for axis in (0, 1):
        own = ends[ends[:, 1, axis] != ends[:, 0, axis]]
        for place in np.unique(own[:, 0, 1 - axis]):
            line = own[own[:, 0, 1 - axis] == place]
            line = line[np.argsort(line[:, 0, axis])]
            breaks = np.flatnonzero(line[1:, 0, axis] != line[:-1, 1, axis])
            pieces.append(np.stack([line[np.concatenate([[0], breaks + 1]), 0],
                                    line[np.concatenate([breaks, [len(line) - 1]]), 1]], axis=1))
    joined = np.concatenate(pieces)
    return Walls(joined[:, 0], joined[:, 1])
