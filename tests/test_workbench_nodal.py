"""NodalMesh: recovered gradients, integrals with the 2 pi r weight, interpolation anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.nodal import FloatArray, NodalMesh, gradient, integrate, locate, sample

#: Middle, corners and edges of cells as VTK numbers them: corners counter-clockwise, then bottom, right, top, left.
ORDER = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1))


def block(r_lines: FloatArray, z_lines: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Points and cells of a rectangular block of nine-node cells."""
    middles = [np.sort(np.concatenate([lines, (lines[1:] + lines[:-1]) / 2])) for lines in (r_lines, z_lines)]
    points = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (2 * n.ravel() for n in np.meshgrid(*(np.arange(len(x) - 1) for x in (r_lines, z_lines)), indexing="ij"))
    return points, np.stack([(i + a) * len(middles[1]) + j + b for a, b in ORDER], axis=1)


def two_layers(count: int) -> NodalMesh:
    """A layer of `count` cells on one a single thin cell high, in different regions that share no node."""
    lower_points, lower = block(np.linspace(0.0, 1.0, count + 1), np.linspace(0.0, 1.0, count + 1))
    upper_points, upper = block(np.linspace(0.0, 1.0, count + 1), np.array([1.0, 1.001]))
    return NodalMesh(
        np.concatenate([lower_points, upper_points]), np.concatenate([lower, upper + len(lower_points)]),
        np.repeat([0, 1], [len(lower), len(upper)]), ("cavity", "couplant"),
    )


def skewed(count: int) -> NodalMesh:
    """General quadrilaterals: the corners of a square's cells moved about."""
    points, cells = block(np.linspace(0.0, 1.0, count + 1), np.linspace(0.0, 1.0, count + 1))
    corner = np.unique(cells[:, :4])
    shift = 0.15 / count * np.sin(13.0 * np.pi * points) * np.sin(7.0 * np.pi * points[:, ::-1])
    moved = points.copy()
    moved[corner] += (shift * (np.abs(points - 0.5) < 0.499).all(axis=1)[:, None])[corner]
    for middle, ends in ((4, (0, 1)), (5, (1, 2)), (6, (2, 3)), (7, (3, 0)), (8, (0, 1, 2, 3))):
        moved[cells[:, middle]] = moved[cells[:, list(ends)]].mean(axis=1)
    return NodalMesh(moved, cells, np.zeros(len(cells), int), ("cavity",))


def wave(points: FloatArray) -> np.ndarray:
    return np.sin(3.0 * points[:, 0] + 1.0) * np.exp(4j * points[:, 1])


def wave_gradient(points: FloatArray) -> np.ndarray:
    return np.stack([3.0 * np.cos(3.0 * points[:, 0] + 1.0) * np.exp(4j * points[:, 1]), 4j * wave(points)], axis=1)


def gradient_error(mesh: NodalMesh) -> float:
    found = gradient(mesh, wave(mesh.points), ["cavity"])
    nodes = mesh.nodes_of(["cavity"])
    return float(np.abs(found - wave_gradient(mesh.points))[nodes].max())


def test_gradient_is_fourth_order_on_rectangles() -> None:
    coarse, fine = gradient_error(two_layers(8)), gradient_error(two_layers(16))
    # Observed 4.0; the biquadratic's own derivative would give 2.0 here.
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.3)
    # 16 cells for 4 rad are 25 a wavelength: (kh/2)^4 / 5 at the edge is 5e-5 of the largest slope, 4.
    assert fine < 2e-4


def test_gradient_is_second_order_on_general_quadrilaterals() -> None:
    coarse, fine = gradient_error(skewed(16)), gradient_error(skewed(32))
    # The mean of the cells' own gradients: observed 1.9, the shape of the cells changes with their number.
    assert np.log2(coarse / fine) > 1.6


@pytest.mark.parametrize("mesh", [two_layers(4), skewed(4)], ids=["rectangles", "general"])
def test_gradient_of_a_linear_field_is_exact(mesh: NodalMesh) -> None:
    values = np.stack([2.0 * mesh.points[:, 0] - 5.0 * mesh.points[:, 1] + 1.0, mesh.points[:, 1]], axis=1)
    found = gradient(mesh, values, mesh.regions)
    # Rounding, amplified by the thin layer: 1e-16 / 5e-4 per difference.
    np.testing.assert_allclose(found, np.broadcast_to([[2.0, 0.0], [-5.0, 1.0]], found.shape), atol=1e-10)


def test_gradient_does_not_mix_regions_and_is_nan_elsewhere() -> None:
    mesh = two_layers(4)
    jump = np.where(np.isin(np.arange(len(mesh.points)), mesh.nodes_of(["couplant"])), np.nan, mesh.points[:, 1])
    found = gradient(mesh, jump, ["cavity"])
    inside = mesh.nodes_of(["cavity"])
    np.testing.assert_allclose(found[inside, 1], 1.0, atol=1e-12)
    together = gradient(mesh, wave(mesh.points), mesh.regions)
    np.testing.assert_array_equal(together[inside], gradient(mesh, wave(mesh.points), ["cavity"])[inside])
    assert np.isnan(found[mesh.nodes_of(["couplant"])]).all()


def test_integral_of_revolution() -> None:
    # r^2 z is cubic with the weight r in one direction and linear in the other: exact for three Gauss points.
    mesh = two_layers(3)
    values = mesh.points[:, 0] ** 2 * mesh.points[:, 1]
    assert integrate(mesh, values, ["cavity"]) == pytest.approx(2.0 * np.pi / 4.0 / 2.0, rel=1e-13)
    both = integrate(mesh, np.ones((len(mesh.points), 3)), mesh.regions)
    np.testing.assert_allclose(both, np.pi * 1.001, rtol=1e-13)
    # A skewed mesh of the same square has the same volume.
    assert integrate(skewed(5), np.ones(len(skewed(5).points)), ["cavity"]) == pytest.approx(np.pi, rel=1e-13)


@pytest.mark.parametrize("mesh", [two_layers(6), skewed(6)], ids=["rectangles", "general"])
def test_sample_reproduces_what_the_cells_can_hold(mesh: NodalMesh) -> None:
    points = np.random.default_rng(1).random((20_000, 2))
    # Bilinear in r, z: held exactly by straight-sided cells of any shape; a full biquadratic only by rectangles.
    np.testing.assert_allclose(
        sample(mesh, 3.0 - mesh.points[:, 0] + 2.0 * mesh.points[:, 1], points, ["cavity"]),
        3.0 - points[:, 0] + 2.0 * points[:, 1], atol=1e-12,
    )
    if mesh.regions != ("cavity",):
        values = (mesh.points**2).prod(axis=1) * (1.0 + 2.0j)
        found = sample(mesh, values, points, ["cavity"])
        np.testing.assert_allclose(found, (points**2).prod(axis=1) * (1 + 2j), atol=1e-12)


def test_sample_finds_every_node_and_the_thin_layer_and_nothing_outside() -> None:
    mesh = two_layers(7)
    np.testing.assert_allclose(sample(mesh, mesh.points, mesh.points, mesh.regions), mesh.points, atol=1e-12)
    cell, _ = locate(mesh, np.array([[0.3, 1.0005], [0.3, 1.0011], [-0.01, 0.5], [1.01, 0.5]]), mesh.regions)
    assert mesh.regions[mesh.region[cell[0]]] == "couplant"
    assert (cell[1:] == -1).all()
    assert np.isnan(sample(mesh, mesh.points[:, 0], np.array([[0.3, 1.0005]]), ["cavity"])).all()


def test_interpolation_of_a_wave_is_third_order() -> None:
    points = np.random.default_rng(2).random((5_000, 2))

    def error(count: int) -> float:
        mesh = two_layers(count)
        return float(np.abs(sample(mesh, wave(mesh.points), points, ["cavity"]) - wave(points)).max())

    assert np.log2(error(8) / error(16)) == pytest.approx(3.0, abs=0.2)


def test_what_is_not_such_a_mesh_is_refused() -> None:
    points, cells = block(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0]))
    one = np.zeros(2, int)
    with pytest.raises(ValueError, match="belongs to two regions; duplicate it"):
        NodalMesh(points, cells, np.array([0, 1]), ("cavity", "bond"))
    with pytest.raises(ValueError, match="clockwise or folded"):
        NodalMesh(points * [1.0, -1.0], cells, one, ("cavity",))
    curved = points.copy()
    curved[cells[0, 4]] += [0.0, 0.05]
    with pytest.raises(ValueError, match="cell 0 is not straight sided"):
        NodalMesh(curved, cells, one, ("cavity",))
    with pytest.raises(ValueError, match="node 15 belongs to no cell"):
        NodalMesh(np.concatenate([points, [[5.0, 5.0]]]), cells, one, ("cavity",))
    with pytest.raises(ValueError, match=r"region holds 0 to 3; there are 1 regions"):
        NodalMesh(points, cells, np.array([0, 3]), ("cavity",))
    mesh = NodalMesh(points, cells, one, ("cavity",))
    with pytest.raises(ValueError, match="unknown region 'gel'; this mesh has cavity"):
        gradient(mesh, points[:, 0], ["gel"])
