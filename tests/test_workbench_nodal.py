"""NodalMesh: recovered gradients, integrals with the 2 pi r weight, interpolation anywhere, of any order."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.acoustics.nodal import (
    FloatArray,
    NodalMesh,
    borders,
    cell_raster,
    edge_nodes,
    gradient,
    integrate,
    interpolate,
    locate,
    mesh_of,
    raised,
    raster,
    transfer,
)
from workbench.fem.elements import gauss_lobatto

ORDERS = (2, 3, 4, 6)


def between(r_lines: FloatArray, z_lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners (M, 2) of the rectangles between lines."""
    low, high = (np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
                 for r, z in ((r_lines[:-1], z_lines[:-1]), (r_lines[1:], z_lines[1:])))
    return low, high


def two_layers(count: int, order: int) -> NodalMesh:
    """A layer of `count` cells on one a single thin cell high, in different regions that share no node."""
    lines = np.linspace(0.0, 1.0, count + 1)
    lower, upper = between(lines, lines), between(lines, np.array([1.0, 1.001]))
    low, high = (np.concatenate(sides) for sides in zip(lower, upper, strict=True))
    return mesh_of(low, high, np.repeat([0, 1], [count**2, count]), ("cavity", "couplant"), order=order)


def graded(order: int) -> NodalMesh:
    """Cells that shrink to a thousandth towards a corner, each a quarter of the one before."""
    lines = np.concatenate([[0.0], 0.25 ** np.arange(5, -1, -1.0)])
    low, high = between(lines, lines)
    return mesh_of(low, high, np.zeros(len(low), int), ("cavity",), order=order)


def wave(points: FloatArray) -> np.ndarray:
    return np.sin(3.0 * points[:, 0] + 1.0) * np.exp(4j * points[:, 1])


def wave_gradient(points: FloatArray) -> np.ndarray:
    return np.stack([3.0 * np.cos(3.0 * points[:, 0] + 1.0) * np.exp(4j * points[:, 1]), 4j * wave(points)], axis=1)


def gradient_error(mesh: NodalMesh) -> float:
    found = gradient(mesh, wave(mesh.points), ["cavity"])
    nodes = mesh.nodes_of(["cavity"])
    return float(np.abs(found - wave_gradient(mesh.points))[nodes].max())


@pytest.mark.parametrize("order", ORDERS)
def test_gradient_is_two_orders_better_than_the_elements_own(order: int) -> None:
    # Cells per unit length for which the errors are well above rounding; 4 rad are 0.64 wavelengths.
    counts = {2: (8, 16), 3: (4, 8), 4: (4, 8), 6: (2, 4)}[order]
    coarse, fine = (gradient_error(two_layers(count, order)) for count in counts)
    # At the rim the order and two more: observed 4.0, 4.9, 5.9, 8.0. The cell's own polynomial would give the order.
    assert np.log2(coarse / fine) > order + 1.7
    # At 1.6 wavelengths a cell and more, of the largest slope, 4.
    assert coarse < 4.0 * 5e-3


@pytest.mark.parametrize("order", ORDERS)
def test_gradient_of_a_polynomial_of_the_order_is_exact(order: int) -> None:
    mesh = two_layers(4, order)
    r, z = mesh.points.T
    found = gradient(mesh, r**order * z - 5.0 * z, mesh.regions)
    # Rounding, amplified by the thin layer: 1e-16 / 1e-4 per difference.
    np.testing.assert_allclose(found, np.stack([order * r ** (order - 1) * z, r**order - 5.0], axis=1), atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_noise_is_not_amplified_beside_small_cells(order: int) -> None:
    # A polynomial through the nodes of two cells of different size would make noise in the one a steep slope in the
    # other; the derivative in a cell is as good as its own spacing allows.
    mesh = graded(order)
    noise = np.random.default_rng(3).standard_normal(len(mesh.points))
    found = np.abs(gradient(mesh, noise, ["cavity"]))
    low, high = mesh.boxes
    smallest = np.full(mesh.points.shape, np.inf)
    np.minimum.at(smallest, mesh.cells, (high - low)[:, None, None])
    # The rows of the differentiation matrix of one cell add up to less than 2 p^2 / size.
    assert (found * smallest).max() < 4.0 * 2.0 * order**2


@pytest.mark.parametrize("order", [2, 4])
def test_gradient_does_not_mix_regions_and_is_nan_elsewhere(order: int) -> None:
    mesh = two_layers(4, order)
    jump = np.where(np.isin(np.arange(len(mesh.points)), mesh.nodes_of(["couplant"])), np.nan, mesh.points[:, 1])
    found = gradient(mesh, jump, ["cavity"])
    inside = mesh.nodes_of(["cavity"])
    np.testing.assert_allclose(found[inside, 1], 1.0, atol=1e-12)
    together = gradient(mesh, wave(mesh.points), mesh.regions)
    alone = gradient(mesh, wave(mesh.points), ["cavity"])
    np.testing.assert_allclose(together[inside], alone[inside], rtol=1e-13)
    assert np.isnan(found[mesh.nodes_of(["couplant"])]).all()


@pytest.mark.parametrize("order", ORDERS)
def test_integral_of_revolution(order: int) -> None:
    # With the weight r a polynomial of the order has one more than it: the rule is exact to twice the order less one.
    mesh = two_layers(3, order)
    values = mesh.points[:, 0] ** order * mesh.points[:, 1]
    assert integrate(mesh, values, ["cavity"]) == pytest.approx(2.0 * np.pi / (order + 2) / 2.0, rel=1e-13)
    both = integrate(mesh, np.ones((len(mesh.points), 3)), mesh.regions)
    np.testing.assert_allclose(both, np.pi * 1.001, rtol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
def test_sample_reproduces_what_the_cells_can_hold(order: int) -> None:
    mesh = two_layers(6, order)
    points = np.random.default_rng(1).random((20_000, 2))
    found = interpolate(mesh, (mesh.points**order).prod(axis=1) * (1.0 + 2.0j), points, ["cavity"])
    np.testing.assert_allclose(found, (points**order).prod(axis=1) * (1 + 2j), atol=1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_sample_finds_every_node_and_the_thin_layer_and_nothing_outside(order: int) -> None:
    mesh = two_layers(7, order)
    np.testing.assert_allclose(interpolate(mesh, mesh.points, mesh.points, mesh.regions), mesh.points, atol=1e-12)
    cell, _ = locate(mesh, np.array([[0.3, 1.0005], [0.3, 1.0011], [-0.01, 0.5], [1.01, 0.5]]), mesh.regions)
    assert mesh.regions[mesh.region[cell[0]]] == "couplant"
    assert (cell[1:] == -1).all()
    assert np.isnan(interpolate(mesh, mesh.points[:, 0], np.array([[0.3, 1.0005]]), ["cavity"])).all()
    # On the border, the cell with the lower number, or that of the region asked for.
    border = np.array([[0.3, 1.0]])
    assert mesh.region[locate(mesh, border, mesh.regions)[0][0]] == 0
    assert mesh.region[locate(mesh, border, ["couplant"])[0][0]] == 1


@pytest.mark.parametrize("order", ORDERS)
def test_interpolation_of_a_wave_gains_an_order_over_that_of_the_cells(order: int) -> None:
    points = np.random.default_rng(2).random((5_000, 2))

    def error(count: int) -> float:
        mesh = two_layers(count, order)
        return float(np.abs(interpolate(mesh, wave(mesh.points), points, ["cavity"]) - wave(points)).max())

    assert np.log2(error(4) / error(8)) == pytest.approx(order + 1.0, abs=0.35)


def test_a_raster_is_what_samples_are() -> None:
    mesh = two_layers(5, 4)
    # A jump between the regions shows which of them a point on their border has its value from.
    values = wave(mesh.points) + np.isin(np.arange(len(mesh.points)), mesh.nodes_of(["couplant"]))
    # Lines of the grid, the border of the regions and the outside among them.
    r, z = np.linspace(-0.1, 1.1, 61), np.array([-0.01, 0.0, 0.2, 0.37, 0.999, 1.0, 1.0007, 1.001, 1.2])
    points = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
    for regions in (mesh.regions, ["cavity"], ["couplant"]):
        np.testing.assert_allclose(raster(mesh, values, r, z, regions).ravel(),
                                   interpolate(mesh, values, points, regions),
                                   rtol=1e-12)


def test_a_raster_of_cells_names_each_and_nothing_outside() -> None:
    mesh = two_layers(2, 3)
    found = cell_raster(mesh, np.arange(6.0), np.array([-0.1, 0.2, 0.7, 1.1]), np.array([0.1, 0.6, 1.0005, 2.0]))
    np.testing.assert_array_equal(found, [[np.nan] * 4, [0, 1, 4, np.nan], [2, 3, 5, np.nan], [np.nan] * 4])


def test_a_product_keeps_all_it_holds_on_nodes_of_twice_the_order() -> None:
    mesh = two_layers(3, 3)
    finer = raised(mesh, 6, "couplant")
    assert finer.regions == ("couplant",)
    assert finer.cells.shape == (3, 7, 7)
    cubic = np.stack([mesh.points[:, 0] ** 3, mesh.points[:, 0] ** 2 * mesh.points[:, 1] ** 3], axis=1)
    moved = transfer(mesh, cubic, finer)
    points = np.column_stack([np.random.default_rng(4).random(500), 1.0 + 1e-3 * np.random.default_rng(5).random(500)])
    np.testing.assert_allclose(interpolate(finer, moved.prod(axis=1), points, ["couplant"]),
                               points[:, 0] ** 5 * points[:, 1] ** 3, atol=1e-13)


def test_borders_are_those_of_regions_and_of_the_outside_but_not_the_axis() -> None:
    mesh = two_layers(2, 4)
    lengths, cells_below = 0.0, 0
    for side, cells in borders(mesh, mesh.region):
        ends = mesh.points[edge_nodes(mesh, side, cells)[:, [0, -1]]]
        lengths += float(np.abs(ends[:, 1] - ends[:, 0]).sum())
        cells_below += int((ends[:, :, 1] == 0.0).all(axis=1).sum())
    # Bottom, rim of both layers, the border once from either side, top.
    assert lengths == pytest.approx(1.0 + 1.001 + 2.0 + 1.0, rel=1e-12)
    assert cells_below == 2
    together = borders(mesh, np.zeros(len(mesh.cells), int))
    assert sum(len(cells) for _, cells in together) == 2 + 3 + 2
    lower = borders(mesh, np.where(mesh.region == 0, 0, -1))
    assert {int(mesh.region[cell]) for _, cells in lower for cell in cells} == {0}


def test_what_is_not_such_a_mesh_is_refused() -> None:
    low, high = between(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0]))
    one = np.zeros(2, int)
    mesh = mesh_of(low, high, one, ("cavity",), order=2)
    points, cells = mesh.points, mesh.cells
    with pytest.raises(ValueError, match="belongs to two regions; duplicate it"):
        NodalMesh(points, cells, np.array([0, 1]), ("cavity", "bond"))
    with pytest.raises(ValueError, match="clockwise or folded"):
        NodalMesh(points * [1.0, -1.0], cells, one, ("cavity",))
    moved = points.copy()
    moved[cells[0, 1, 0]] += [0.0, 0.05]
    with pytest.raises(ValueError, match="cell 0 is no rectangle with nodes at the Gauss-Lobatto points"):
        NodalMesh(moved, cells, one, ("cavity",))
    with pytest.raises(ValueError, match="node 15 belongs to no cell"):
        NodalMesh(np.concatenate([points, [[5.0, 5.0]]]), cells, one, ("cavity",))
    with pytest.raises(ValueError, match=r"region holds 0 to 3; there are 1 regions"):
        NodalMesh(points, cells, np.array([0, 3]), ("cavity",))
    with pytest.raises(ValueError, match=r"expected \(M, p \+ 1, p \+ 1\) for an order p of 2 or more"):
        NodalMesh(points, cells[:, ::2, ::2], one, ("cavity",))
    with pytest.raises(ValueError, match="cell 0 is crossed by a line of other cells"):
        mesh_of(np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([[2.0, 1.0], [1.0, 2.0]]), one, ("cavity",), order=2)
    with pytest.raises(ValueError, match="cell 0 is covered by another"):
        mesh_of(low[[0, 0]], high[[0, 0]], one, ("cavity",), order=2)
    with pytest.raises(ValueError, match="unknown region 'gel'; this mesh has cavity"):
        gradient(mesh, points[:, 0], ["gel"])
    # A node in the middle of the cell is none of order four: those are at 0.17, 0.5, 0.83.
    np.testing.assert_allclose(gauss_lobatto(4), [0.0, 0.1727, 0.5, 0.8273, 1.0], atol=5e-5)
