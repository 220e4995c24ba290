"""Quadrilaterals of any layout: neighbours run along their common side alike, and curved sides are met by both."""

from __future__ import annotations

import numpy as np
import pytest
import skfem

from geometry.quads import curved, oriented


def pinwheel(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, n) and anticlockwise cells (4, m) around one point where `count` cells meet."""
    angles = np.pi * np.arange(2 * count) / count
    rim = np.stack([np.cos(angles), np.sin(angles)]) * np.where(np.arange(2 * count) % 2, 1.4, 1.0)
    points = np.column_stack([[0.0, 0.0], rim])
    cells = [(0, 1 + 2 * k, 2 + 2 * k, 1 + (2 * k + 2) % (2 * count)) for k in range(count)]
    return points, np.array(cells).T


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_neighbours_run_along_their_common_side_alike(count: int) -> None:
    points, cells = pinwheel(count)
    rng = np.random.default_rng(count)
    rolled = np.stack([np.roll(cell, rng.integers(4)) for cell in cells.T], axis=1)
    found = oriented(rolled)
    assert np.array_equal(np.sort(found, axis=0), np.sort(cells, axis=0))
    runs: dict[frozenset[int], set[tuple[int, int]]] = {}
    for a, b, c, d in found.T:
        for begin, end in ((a, b), (b, c), (d, c), (a, d)):
            runs.setdefault(frozenset((int(begin), int(end))), set()).add((int(begin), int(end)))
    assert all(len(ways) == 1 for ways in runs.values())
    corners = points[:, found]
    sides = np.roll(corners, -1, axis=1) - corners
    turns = sides[0] * np.roll(sides[1], -1, axis=0) - sides[1] * np.roll(sides[0], -1, axis=0)
    assert turns.min() > 0.0, "anticlockwise still"


def test_a_strip_that_is_turned_over_is_refused() -> None:
    # Three cells in a ring whose last one is glued to the first upside down.
    cells = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 3, 0, 5]]).T
    with pytest.raises(ValueError, match="turned over"):
        oriented(cells)


def test_cells_are_filled_between_their_sides() -> None:
    """A quarter of a ring: arcs below and above; transfinite interpolation of it is exact."""
    nodes = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
    points = np.array([[1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 1.0]])
    angle = 0.5 * np.pi * nodes
    arcs = {(0, 3): np.stack([np.cos(angle), np.sin(angle)]),
            # The other way round: from the end to the beginning.
            (2, 1): 2.0 * np.stack([np.cos(0.5 * np.pi - angle), np.sin(0.5 * np.pi - angle)])}
    found = curved(points, np.array([[0], [1], [2], [3]]), nodes, arcs)[:, 0]
    radius, turned = (1.0 + nodes)[:, None], angle[None, :]
    np.testing.assert_allclose(found, np.stack([radius * np.cos(turned), radius * np.sin(turned)]), atol=1e-15)


def test_straight_cells_are_bilinear() -> None:
    mesh = skfem.MeshQuad.init_tensor(np.linspace(0.0, 1.0, 3), np.linspace(0.0, 2.0, 4))
    nodes = np.array([0.0, 0.5, 1.0])
    found = curved(mesh.p, mesh.t, nodes, {})
    assert found.shape == (2, mesh.t.shape[1], 3, 3)
    np.testing.assert_allclose(found[:, :, 1, 1], mesh.p[:, mesh.t].mean(axis=1), atol=1e-15)
