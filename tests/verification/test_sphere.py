"""Curved cells: sound in a sphere with rigid walls, against its closed form.

The modes of a sphere of radius R have j_l'(k R) = 0 (Rayleigh 1896, Theory of Sound, vol. 2, section 331). A half of it
above its plane of symmetry has those of even l.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
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

from geometry.curves import Arc, Curve
from geometry.free_mesh import mesh_free
from geometry.free_section import Face, FreeSection
from geometry.measure import ABOUT_AXIS
from geometry.mesh import SectionMesh
from geometry.mesh_size import MeshSize
from geometry.quads import curved, oriented
from workbench.fem.elements import Lagrange, gauss_lobatto
from workbench.fem.places import Place, place_of
from workbench.physics.term import Integral, Monomial, Product

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
    wall = np.flatnonzero(np.isin(mesh.facets, (4, 5, 6)).all(axis=0))
    mesh = mesh.with_boundaries({"wall": wall})
    return SimpleNamespace(mesh=mesh, order=order, coordinates=coordinates, nodes=coordinates, measure=ABOUT_AXIS)


#: Of the gradient along the wall: what a boundary layer there lives on.
ALONG = Integral(Monomial(1.0, 0), "wall", (Product("grad_p_t", "grad_p_t"),), solid="cavity")


def matrix(place: Place, kinds: tuple[str, ...]) -> sparse.csr_matrix:
    size = int(place.dofs.max()) + 1
    blocks = sum(np.einsum("eqi,eq,eqj->eij", place.shapes[kind], place.weights, place.shapes[kind]) for kind in kinds)
    rows, columns = np.broadcast_arrays(place.dofs.T[:, :, None], place.dofs.T[:, None, :])
    return sparse.csr_matrix((np.asarray(blocks).ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))


def roots(degrees: Iterable[int] = (0, 2, 4, 6)) -> list[float]:
    """k R of the first modes of some l, of even ones unless told, but for the constant one."""
    grid = np.linspace(0.1, 8.0, 800)
    found = []
    for degree in degrees:
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


def meshed_sphere() -> SectionMesh:
    """A whole sphere, which the mesher fills with quadrilaterals of its own choice."""
    half = math.sqrt(0.5)
    weights = ((0.0, -1.0, 1.0), (half, -half, half), (1.0, 0.0, 1.0), (half, half, half), (0.0, 1.0, 1.0))
    poles = tuple((RADIUS * r, RADIUS * z, w) for r, z, w in weights)
    arc = Arc(Curve(2, (0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0, 1.0), poles))
    axis = Arc(Curve.line((0.0, RADIUS), (0.0, -RADIUS)))
    section = FreeSection(((0.0, -RADIUS), (0.0, RADIUS)), (arc, axis), ((0, 1), (1, 0)),
                          (Face("cavity", (((0, True), (1, True)),)),), ())
    # Six elements of order 6 to a wavelength of the highest mode, k R = 6.
    return mesh_free(section, MeshSize({"cavity": 1500.0}, 6.0 * 1500.0 / (2.0 * np.pi * RADIUS), 4.0, 6))


def test_modes_and_loss_of_a_sphere_that_was_meshed() -> None:
    """Those of odd l are found too: k R = 2.0816 is the lowest, of l = 1."""
    mesh = meshed_sphere()
    inside, wall = place_of(mesh, MOVING), place_of(mesh, replace(ALONG, place="cavity|outside"))
    assert inside is not None
    assert wall is not None
    assert inside.weights.sum() == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=1e-9)
    assert wall.weights.sum() == pytest.approx(4.0 * np.pi * RADIUS**2, rel=1e-9)
    stiffness, mass = matrix(inside, ("d_r", "d_z")), matrix(inside, ("value",))
    squares, modes = eigsh(stiffness * RADIUS**2, k=6, M=mass, sigma=-1.0)
    wanted = roots(range(5))[:5]
    error = np.abs(np.sqrt(squares[1:]) / wanted - 1.0)
    print(f"{mesh.mesh.t.shape[1]} cells; k R", np.sqrt(squares[1:]), "relative error", error)
    assert error.max() < 1e-7
    # Loss of the mode of l = 1 in the layer at the wall, by the closed form below.
    mode = modes[:, 1]
    slopes = [np.einsum("eqi,ie->eq", wall.shapes[kind], mode[wall.dofs]) for kind in ("d_r", "d_z")]
    along = float(np.sum(wall.weights * (wall.factor("t_r") * slopes[0] + wall.factor("t_z") * slopes[1]) ** 2))
    moving = float(mode @ stiffness @ mode)
    square = squares[1]
    closed = 2.0 / RADIUS / square / (1.0 - 2.0 / square)
    print("int |grad_t p|^2 dS / 2 int |grad p|^2 dV", 0.5 * along / moving, "closed form", closed)
    assert 0.5 * along / moving == pytest.approx(closed, rel=1e-6)


def test_what_a_boundary_layer_lives_on_at_a_curved_wall() -> None:
    """Of p = j_l(k r) P_l(cos theta) the integral of |grad_t p|^2 over the wall, and the viscous loss of a mode.

    It is j_l(k R)^2 l (l + 1) 4 pi / (2 l + 1) over the whole sphere. The layer of thickness d loses, per energy of the
    mode, 1 / Q = (d / 2) int |grad_t p|^2 dS / int |grad p|^2 dV (Landau and Lifshitz, Fluid Mechanics, section 24, for
    d << R), with int |grad p|^2 dV = k^2 int p^2 dV in a mode, and int j_l^2 r^2 dr = (R^3 / 2) j_l^2 (1 - l (l + 1) /
    (k R)^2) by the equation of j_l.
    """
    degree = 2
    wavenumber = brentq(lambda x: spherical_jn(degree, x, derivative=True), 3.0, 3.6, xtol=1e-14) / RADIUS
    mesh = half_sphere(10)
    inside, wall = place_of(mesh, MOVING), place_of(mesh, ALONG)
    assert inside is not None
    assert wall is not None
    assert wall.normal is not None
    pressure = np.empty(int(inside.dofs.max()) + 1)
    r, z = mesh.coordinates
    distance = np.maximum(np.hypot(r, z), 1e-300)
    pressure[inside.dofs] = (spherical_jn(degree, wavenumber * distance) * (1.5 * (z / distance) ** 2 - 0.5))
    slopes = [np.einsum("eqi,ie->eq", wall.shapes[kind], pressure[wall.dofs]) for kind in ("d_r", "d_z")]
    tangential = wall.factor("t_r") * slopes[0] + wall.factor("t_z") * slopes[1]
    found = float(np.sum(wall.weights * tangential**2))
    end = spherical_jn(degree, wavenumber * RADIUS) ** 2
    wanted = end * degree * (degree + 1) * 2.0 * np.pi / (2 * degree + 1)
    assert found == pytest.approx(wanted, rel=1e-6)
    within = [np.einsum("eqi,ie->eq", inside.shapes[kind], pressure[inside.dofs]) for kind in ("d_r", "d_z")]
    moving = float(np.sum(inside.weights * (within[0] ** 2 + within[1] ** 2)))
    thickness = 0.6e-6
    loss = 0.5 * thickness * found / moving
    square = (wavenumber * RADIUS) ** 2
    closed = thickness / RADIUS * degree * (degree + 1) / square / (1.0 - degree * (degree + 1) / square)
    print("1 / Q", loss, "closed form", closed)
    assert loss == pytest.approx(closed, rel=1e-6)
    # Normals are radial.
    radial = wall.radius * wall.normal[1] / wall.normal[0]
    assert np.hypot(wall.radius, radial) == pytest.approx(RADIUS, rel=1e-9)
