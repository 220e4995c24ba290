"""Features beside the axis: coupled orders against three dimensions, closed forms and full solves."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, MeshHex, MeshHex2
from skfem.helpers import dot

from geometry.chip import Chip, read_chip
from geometry.features import Feature
from materials.kinds import Piezoelectric
from workbench.fem.elements import Lagrange
from workbench.fem.half_space import FITTED, HalfSpace, half_space_constants
from workbench.fem.operators import assemble
from workbench.fem.patch import ALONG, AWAY, UP, Patch, patch_forms
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.problem import Problem, build, fill
from workbench.physics.orders import ORDER, terms_of_order
from workbench.reduced.response import response
from workbench.simulation.features import RigidPart, charge_change, compliance_of, part_of
from workbench.simulation.run import simulate

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The feature of these tests: 5 mg of solder beside the axis of a disc.
SOLDER = Feature("mass", "transducer", "top", 9e-3, 2e-3, mass=5e-6)
PATCH = part_of(SOLDER).patch
BAND = (60e3, 115e3)


@pytest.fixture(scope="module")
def disc_chip() -> Chip:
    return read_chip(Path(__file__).resolve().parents[2] / "geometry/chips/free_disc_25x2.toml")


@pytest.fixture(scope="module")
def posed(disc_chip: Chip) -> Problem:
    return build(fill(disc_chip), band=BAND, radii=PATCH.radii)


def system_of(posed: Problem, order: int) -> System:
    terms = terms_of_order(posed.terms, is_first=order == 1) if order else posed.terms
    return System(assemble(posed.mesh, terms), {**posed.values, ORDER: float(order)})


def driven_of(posed: Problem, patch: Patch, frequencies: Real) -> Complex:
    """Mean displacements (3, n) of a patch by full solves of order 0."""
    system = system_of(posed, 0)
    return np.asarray(patch_forms(system.operators, patch, 0).T @ system.solutions(frequencies).states)


def changed(posed: Problem, parts: list[RigidPart], frequencies: Real, tolerance: float = 1e-3) -> Complex:
    """The change of the charge (n,) by parts."""
    total = compliance_of(posed, [part.patch for part in parts], np.array([part.angle for part in parts]), frequencies,
                          tolerance=tolerance).total
    return charge_change(parts, frequencies, [driven_of(posed, part.patch, frequencies) for part in parts], total)


@pytest.mark.parametrize("distance", [9e-3, 0.5e-3, 0.0], ids=["beside the axis", "over the axis", "about the axis"])
def test_the_mean_of_a_shift_is_the_shift(posed: Problem, distance: float) -> None:
    """A disc that shifts sideways has u_r ~ cos t, u_s ~ -sin t, and u_z is uniform: orders 1 and 0."""
    patch = Patch("transducer", True, distance, 1e-3)
    for order, u_r, u_s, u_z, expected in ((1, 1.0, -1.0, 0.0, (1.0, 0.0, 1.0)), (0, 0.0, 0.0, 1.0, (0.0, 1.0, 0.0))):
        operators = system_of(posed, order).operators
        state = np.zeros(operators.size)
        # On the axis, u_s shares the unknowns of u_r, which therefore come last.
        for component, value in (("u_s", u_s), ("u_r", u_r), ("u_z", u_z)):
            rows = operators.numbering[component]
            state[rows[rows >= 0]] = value
        assert patch_forms(operators, patch, order).T @ state == pytest.approx(expected, abs=1e-10)


def test_a_turn_about_the_axis_moves_a_patch_along_the_circumference(posed: Problem) -> None:
    operators = system_of(posed, 2).operators
    state, radius = np.zeros(operators.size), np.zeros(operators.size)
    rows = operators.numbering["u_s"]
    radius[rows[rows >= 0]] = Basis(posed.mesh.mesh, Lagrange(posed.mesh.order)).doflocs[0, rows >= 0]
    state -= radius
    assert patch_forms(operators, PATCH, 0).T @ state == pytest.approx((0.0, 0.0, PATCH.distance), abs=1e-12)


def test_a_patch_beyond_its_face_is_refused(posed: Problem) -> None:
    with pytest.raises(InputError, match="free plane face"):
        patch_forms(system_of(posed, 0).operators, replace(PATCH, distance=12e-3), 0)


def test_a_response_is_that_of_full_solves(posed: Problem) -> None:
    system, frequencies = system_of(posed, 2), np.linspace(*BAND, 31)
    forms = patch_forms(system.operators, PATCH, 2)[:, [AWAY, UP, ALONG]]
    found = response(system, forms, frequencies, 1e-6)
    for at in (3, 17, 28):
        factor = system.factored(float(frequencies[at]))[1]
        states = np.stack([factor.solve(load.astype(complex))[0] for load in forms[:-1].T], axis=1)
        exact = forms[:-1].T @ states
        # The error of a response is the square of that of the fields.
        assert np.abs(found.compliance[at] - exact).max() < 1e-6 * np.abs(exact).max()
        assert np.abs(found.fields(at) - states).max() < 1e-3 * np.abs(states).max()


def test_orders_of_a_half_space_add_up_to_its_compliance() -> None:
    """The mean of 1 / distance over a disc, twice, is 16 / (3 pi a)."""
    patch = replace(PATCH, distance=2e-3, radius=0.2e-3)
    space = HalfSpace.of([patch], np.zeros(1))
    orders = sum(space.order(order) for order in range(200))
    # Higher orders begin at k a = 20, where W^2 / (k a)^3 leaves 1e-3.
    assert orders[0, 0, 0] == pytest.approx(space.total[0, 0, 0], rel=1e-3)
    # Wave numbers below the first step, where W is nearly one, are left out; those above the last are 1e-4.
    below = (0.5 * FITTED - 0.25) / 2e-3
    assert space.total[0, 0, 0] + below == pytest.approx(16.0 / (3.0 * math.pi * patch.radius), rel=5e-3)


def test_the_constants_of_a_half_space_are_found() -> None:
    space = HalfSpace.of([PATCH], np.zeros(1))
    orders = np.array([space.order(m)[:, :, 0] for m in range(20, 20 + FITTED)])
    wanted = np.array([2e-12 - 1e-14j, 3e-12])
    found = half_space_constants((orders[:, :, 0] @ wanted)[:, None, None], orders)
    assert found[:, 0, 0] == pytest.approx(wanted, rel=1e-6)


def test_a_feature_of_no_size_changes_nothing(posed: Problem) -> None:
    """And the derivative there is the closed form w^2 y^T y."""
    frequencies = np.array([65e3, 95e3])
    driven = driven_of(posed, PATCH, frequencies)
    assert np.abs(changed(posed, [RigidPart(PATCH)], frequencies)).max() == 0.0
    small = 1e-12
    found = changed(posed, [RigidPart(PATCH, mass=small)], frequencies) / small
    slope = (2.0 * np.pi * frequencies) ** 2 * np.sum(driven**2, axis=0)
    # The next term is of the relative size w^2 dm G, some 1e-6.
    assert np.abs(found / slope - 1.0).max() < 1e-5


def test_a_part_about_the_axis_moves_with_two_orders(posed: Problem) -> None:
    frequencies, patch = np.array([70e3, 95e3]), replace(PATCH, distance=0.0)
    assert compliance_of(posed, [patch], np.zeros(1), frequencies).orders == 2
    assert np.abs(changed(posed, [RigidPart(patch, mass=5e-6)], frequencies)).max() > 0.0


def test_two_halves_at_one_place_are_one_part_and_angles_are_relative(posed: Problem) -> None:
    frequencies = np.array([70e3, 95e3])
    one = changed(posed, [RigidPart(PATCH, mass=5e-6)], frequencies, 1e-4)
    two = changed(posed, [RigidPart(PATCH, 0.7, mass=2.5e-6)] * 2, frequencies, 1e-4)
    assert two == pytest.approx(one, rel=1e-3)


def test_opposite_parts_are_those_of_even_orders(posed: Problem) -> None:
    """Equal parts on both sides move alike, so that the odd orders drop out: the sum over even ones, twice."""
    frequencies, driven = np.array([70e3, 95e3]), driven_of(posed, PATCH, np.array([70e3, 95e3]))
    parts = [RigidPart(PATCH, angle, mass=5e-6) for angle in (0.0, math.pi)]
    found = changed(posed, parts, frequencies, 1e-4)
    compliance = np.zeros((2, 2, 2), dtype=complex)
    for order in range(0, 60, 2):
        forms = patch_forms(system_of(posed, order).operators, PATCH, order)[:, [AWAY, UP]]
        compliance += 2.0 * response(system_of(posed, order), forms, frequencies, 1e-6).compliance
    stiffness = -((2.0 * np.pi * frequencies) ** 2) * 5e-6
    y = driven[[AWAY, UP]].T
    inverse = np.linalg.inv(np.eye(2) + stiffness[:, None, None] * compliance)
    expected = -2.0 * stiffness * np.einsum("ni,nij,nj->n", y, inverse, y)
    # Orders above 60 are left out here, and add some 1e-3.
    assert found == pytest.approx(expected, rel=5e-3)


def test_the_spectrum_of_a_disc_with_solder_is_that_of_three_dimensions(disc_chip: Chip) -> None:
    """Half a disc in hexahedra of the second order, with the mean over points of the patch.

    The change of ln Z by 5 mg of solder agrees within 1 %, the error of these hexahedra.
    """
    frequencies = np.linspace(*BAND, 23)
    with_solder = replace(disc_chip, features=(SOLDER,))
    changed = simulate(with_solder, band=BAND, points=frequencies.size, relative_error=1e-5)
    plain = simulate(disc_chip, band=BAND, points=frequencies.size, relative_error=1e-5)
    change = np.conj(np.log(changed.spectrum.impedance / plain.spectrum.impedance))
    assert any("orders" in finding for finding in changed.findings)
    material = fill(disc_chip).materials["transducer"]
    assert isinstance(material, Piezoelectric)
    radius, height = disc_chip.transducer.radius.value, disc_chip.transducer.thickness.value
    exact = change_in_three_dimensions(material, radius, height, frequencies[[2, 14, 20]])
    assert np.abs(change[[2, 14, 20]] / exact - 1.0).max() < 1e-2


def change_in_three_dimensions(material: Piezoelectric, radius: float, height: float, frequencies: Real) -> Complex:
    """The change (n,) of ln Z, e^{-i w t}, of a disc by the solder. The side y > 0 is meshed."""
    straight = MeshHex.init_tensor(np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 2))
    square = MeshHex2.from_mesh(straight)
    x, y, z = square.doflocs
    mesh = MeshHex2(np.stack([radius * x * np.sqrt(1.0 - 0.5 * y**2), radius * y * np.sqrt(1.0 - 0.5 * x**2),
                              height * z]), square.t)
    moved, scalar = Basis(mesh, ElementVector(ElementHex2()), intorder=5), Basis(mesh, ElementHex2(), intorder=5)
    form, mean = _forms(material, moved, scalar), _mean_of_patch(Basis(straight, ElementHex2()), radius)
    # The dofs (3, N) of a vector at those of a scalar.
    at = np.zeros((3, scalar.N), dtype=int)
    for k, rows in enumerate(scalar.element_dofs):
        for i in range(3):
            at[i, rows] = moved.element_dofs[3 * k + i]
    loads = np.zeros((moved.N + scalar.N, 2))
    loads[at[0], AWAY] = loads[at[2], UP] = mean
    x, y, z = scalar.doflocs
    live, ground = moved.N + np.flatnonzero(z > height - 1e-9), moved.N + np.flatnonzero(z < 1e-9)
    free = np.setdiff1d(np.arange(len(loads)), np.concatenate([at[1, np.abs(y) < 1e-9], live, ground]))
    voltage = np.zeros(len(loads))
    voltage[live] = 1.0
    result = []
    for omega in 2.0 * np.pi * frequencies:
        matrix = sparse.csc_array(form[0] - omega**2 * form[1])
        inner = matrix[free][:, free]
        scale = 1.0 / np.sqrt(np.abs(inner.diagonal()))
        factor = splu(sparse.csc_matrix(sparse.diags_array(scale) @ inner @ sparse.diags_array(scale)))
        right = np.column_stack([-(matrix @ voltage)[free], loads[free]]).astype(complex)
        states = scale[:, None] * factor.solve(scale[:, None] * right)
        state = voltage.astype(complex)
        state[free] += states[:, 0]
        charge, y_mean, compliance = -(state @ (matrix @ state)), loads.T @ state, loads[free].T @ states[:, 1:]
        stiffness = -(omega**2) * 0.5 * SOLDER.mass
        added = -stiffness * (y_mean @ np.linalg.solve(np.eye(2) + stiffness * compliance, y_mean))
        result.append(-np.log((charge + added) / charge))
    return np.array(result)


def _forms(material: Piezoelectric, moved: Basis, scalar: Basis) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Stiffness and mass of displacements and potential."""
    of = {name: complex(value) for name, value in material.parameters().items()}
    c = np.zeros((6, 6), dtype=complex)
    c[:3, :3] = [[of["c11"], of["c12"], of["c13"]], [of["c12"], of["c11"], of["c13"]],
                 [of["c13"], of["c13"], of["c33"]]]
    c[3, 3] = c[4, 4] = of["c44"]
    c[5, 5] = 0.5 * (of["c11"] - of["c12"])
    e = np.zeros((3, 6), dtype=complex)
    e[2, :3], e[1, 3], e[0, 4] = [of["e31"], of["e31"], of["e33"]], of["e15"], of["e15"]
    permittivity = VACUUM_PERMITTIVITY * np.array([of["eps11"], of["eps11"], of["eps33"]])

    def strain(u: object) -> list[Real]:
        g = u.grad  # type: ignore[attr-defined]
        return [g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]]

    elastic = BilinearForm(lambda u, v, w: sum(
        c[i, j] * strain(u)[j] * strain(v)[i] for i, j in zip(*np.nonzero(c), strict=True)), dtype=complex)
    electric = BilinearForm(lambda u, q, w: sum(
        e[i, j] * strain(u)[j] * q.grad[i] for i, j in zip(*np.nonzero(e), strict=True)), dtype=complex)
    dielectric = BilinearForm(lambda p, q, w: -sum(permittivity[i] * p.grad[i] * q.grad[i] for i in range(3)),
                              dtype=complex)
    inertia = BilinearForm(lambda u, v, w: material.density * dot(u, v)).assemble(moved)
    coupling = electric.assemble(moved, scalar)
    whole = sparse.bmat([[elastic.assemble(moved), coupling.T], [coupling, dielectric.assemble(scalar)]])
    return whole.tocsr(), sparse.bmat([[inertia, None], [None, sparse.csr_matrix((scalar.N, scalar.N))]]).tocsr()


def _mean_of_patch(reference: Basis, radius: float) -> Real:
    """Weights (N,) of the nodes in the mean over the half patch, by points in the reference square."""
    nodes, weights = leggauss(8)
    circles, turns = PATCH.radius * np.sqrt(0.5 * (nodes + 1.0)), np.pi * (np.arange(12) + 0.5) / 12
    r, t = (each.ravel() for each in np.meshgrid(circles, turns, indexing="ij"))
    u, v = (PATCH.distance + r * np.cos(t)) / radius, r * np.sin(t) / radius
    # The inverse of u = x sqrt(1 - y^2 / 2), v = y sqrt(1 - x^2 / 2).
    gap = 2.0 * math.sqrt(2.0)
    x = 0.5 * (np.sqrt(2.0 + u**2 - v**2 + gap * u) - np.sqrt(2.0 + u**2 - v**2 - gap * u))
    y = 0.5 * (np.sqrt(2.0 - u**2 + v**2 + gap * v) - np.sqrt(2.0 - u**2 + v**2 - gap * v))
    points = reference.probes(np.stack([x, y, np.full(x.size, 1.0 - 1e-9)]))
    return np.asarray((np.repeat(0.5 * weights, turns.size) / turns.size) @ points.toarray())
