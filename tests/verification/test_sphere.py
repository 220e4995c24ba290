"""Curved cells: sound in a sphere with rigid walls, against its closed form.

The modes of a sphere of radius R have j_l'(k R) = 0 (Rayleigh 1896, Theory of Sound, vol. 2, section 331). A half of it
above its plane of symmetry has those of even l.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import skfem
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import eigsh
from scipy.special import spherical_jn

from geometry.quads import curved, oriented
from workbench.elements import Lagrange, gauss_lobatto
from workbench.physics.term import Integral, Monomial, Product
from workbench.places import Place, place_of

RADIUS = 2.5e-3

#: What is stored where the fluid moves.
MOVING = Integral(Monomial(1.0, 0), "cavity", (Product("grad_p_r", "grad_p_r"), Product("grad_p_z", "grad_p_z")))


def half_sphere(order: int) -> Any:
    """Three cells that fill a quarter of a disc, in no order."""
    diagonal = np.sqrt(0.5)
    points = RADIUS * np.array([[0.0, 0.5, 0.42, 0.0, 1.0, diagonal, 0.0], [0.0, 0.0, 0.42, 0.5, 0.0, diagonal, 1.0]])
    cells = oriented(np.array([[2, 3, 0, 1], [4, 5, 2, 1], [2, 5, 6, 3]]).T)
    nodes = gauss_lobatto(order)

    def arc(begin: float, end: float) -> NDArray[np.float64]:
        angle = begin + (end - begin) * nodes
        return RADIUS * np.stack([np.cos(angle), np.sin(angle)])

    sides = {(4, 5): arc(0.0, 0.25 * np.pi), (5, 6): arc(0.25 * np.pi, 0.5 * np.pi)}
    along, across = np.array(Lagrange(order).indices).T
    coordinates = curved(points, cells, nodes, sides)[:, :, along, across].transpose(0, 2, 1)
    mesh = skfem.MeshQuad(points, cells).with_subdomains({"cavity": np.arange(3)})
    return SimpleNamespace(mesh=mesh, order=order, coordinates=coordinates)


def matrix(place: Place, kinds: tuple[str, ...]) -> sparse.csr_matrix:
    size = int(place.dofs.max()) + 1
    blocks = sum(np.einsum("eqi,eq,eqj->eij", place.shapes[kind], place.weights, place.shapes[kind]) for kind in kinds)
    rows, columns = np.broadcast_arrays(place.dofs.T[:, :, None], place.dofs.T[:, None, :])
    return sparse.csr_matrix((np.asarray(blocks).ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))


def roots() -> list[float]:
    """k R of the first modes of even l but for the constant one."""
    grid = np.linspace(0.1, 8.0, 800)
    found = []
    for degree in (0, 2, 4, 6):
        slope = spherical_jn(degree, grid, derivative=True)
        found += [brentq(lambda x, degree=degree: spherical_jn(degree, x, derivative=True), grid[k], grid[k + 1],
                         xtol=1e-14) for k in np.flatnonzero(slope[:-1] * slope[1:] < 0.0)]
    return sorted(found)


def frequencies(order: int) -> tuple[NDArray[np.float64], Place]:
    place = place_of(half_sphere(order), MOVING)
    assert place is not None
    stiffness, mass = matrix(place, ("d_r", "d_z")), matrix(place, ("value",))
    values = eigsh(stiffness * RADIUS**2, k=6, M=mass, sigma=-1.0, return_eigenvectors=False)
    return np.sqrt(np.abs(np.sort(values))), place


def test_modes_of_a_sphere() -> None:
    found, place = frequencies(10)
    wanted = roots()[:5]
    error = np.abs(found[1:] / wanted - 1.0)
    print("k R", found[1:], "relative error", error)
    assert found[0] < 1e-5, "the constant pressure"
    # Three cells of order 10 across a wavelength and a half.
    assert error.max() < 1e-6
    assert place.weights.sum() == pytest.approx(2.0 / 3.0 * np.pi * RADIUS**3, rel=1e-12)


def test_modes_converge_as_the_order_rises() -> None:
    wanted = np.array(roots()[:3])
    errors = [np.abs(frequencies(order)[0][1:4] / wanted - 1.0).max() for order in (4, 6, 8)]
    print("orders 4, 6, 8", errors)
    assert errors[1] < 0.05 * errors[0]
    assert errors[2] < 0.05 * errors[1]
