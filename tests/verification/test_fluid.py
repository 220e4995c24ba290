"""Fluids against closed forms: cavity modes, free rims, and a fluid in an elastic ring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import csc_matrix
from scipy.special import j0, j1, jn_zeros, jvp, y1, yvp

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Material
from workbench.fem.operators import FullOperators, assemble
from workbench.physics import electrodes, fluid, piezoelectric, solid
from workbench.physics.term import Condition, Term

SPEED, DENSITY = 1482.0, 998.0
RADIUS, HEIGHT = 4e-3, 1e-3
WATER: dict[str, complex] = {"water.density": DENSITY, "water.sound_speed": SPEED}


@dataclass(frozen=True)
class PlaneStrain(Term):
    """u_z = 0 on a boundary; for these tests only."""

    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("u_z", self.boundary),)


@pytest.fixture(scope="module")
def cavity_chip(stacked: Callable[..., Chip]) -> Chip:
    """A cavity in a ring, parted from the transducer by a layer that stays empty."""
    return stacked(
        [("transducer", HEIGHT, 6e-3, None), ("layer", HEIGHT, 6e-3, None), ("sidewall", HEIGHT, 6e-3, RADIUS),
         ("superstrate", HEIGHT, 6e-3, None)],
        band=(1e5, 1e6),
    )


@pytest.fixture(scope="module")
def base(reference_materials: Callable[[str], dict[str, Material]]) -> tuple[tuple[Term, ...], dict[str, complex]]:
    """A transducer, which every model needs, and its values."""
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    terms = (piezoelectric.PiezoelectricSolid("transducer", "pzt"),
             electrodes.ElectrodePotential("electrode_live", "electrode_ground"))
    return terms, {f"pzt.{name}": value for name, value in pzt.parameters().items()} | WATER


def rigid_cavity(radial: float, axial: int) -> float:
    """f = (c / 2 pi) sqrt((j / r)^2 + (l pi / h)^2)."""
    return float(SPEED / (2.0 * np.pi) * np.hypot(radial / RADIUS, axial * np.pi / HEIGHT))


@pytest.mark.parametrize("rim", ["rigid", "free"])
def test_the_modes_of_a_cylinder_of_fluid_converge_to_the_closed_form_with_the_fourth_order(
    rim: str,
    cavity_chip: Chip,
    uniform_mesh: Callable[[Chip, float], SectionMesh],
    base: tuple[tuple[Term, ...], dict[str, complex]],
    modes: Callable[..., NDArray[np.float64]],
    rows: Callable[..., NDArray[np.int64]],
) -> None:
    terms, values = base
    terms += (fluid.AcousticFluid("cavity", "water"),)
    if rim == "free":
        terms += (fluid.PressureRelease("cavity|sidewall"),)
    # Rigid: zeros of J0' = -J1, with 0 for the waves along the axis. Free: zeros of J0.
    radial = [0.0, *jn_zeros(1, 6)] if rim == "rigid" else list(jn_zeros(0, 7))
    exact = np.sort([rigid_cavity(j, axial) for j in radial for axial in (0, 1)])
    exact = exact[exact > 0.0][:5]
    errors = []
    for edge in (HEIGHT, HEIGHT / 2, HEIGHT / 4):
        operators = assemble(uniform_mesh(cavity_chip, edge), terms)
        found = modes(operators, values, rows(operators, "cavity", "p"), near=0.3e6, count=7)
        found = found[found > 1e3][:5]
        errors.append(np.abs(found / exact - 1.0))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"cavity, {rim}: modes (kHz) {np.round(1e-3 * exact, 2).tolist()}, errors {errors[-1].max():.1e}, "
          f"order {np.round(order[-1], 2).tolist()}")
    # The phase error of quadratic elements is (k h)^4 / 1440 for a plane wave along an edge, less for others.
    assert (errors[-1] < 1.1 * (2.0 * np.pi * exact / SPEED * HEIGHT / 4) ** 4 / 1440).all()
    assert np.abs(order[-1] - 4.0).max() < 0.3


BULK, SHEAR, WALL_DENSITY, OUTER = 3.6e9, 1.1e9, 1150.0, 6e-3
POLYMER: dict[str, complex] = {"pla.bulk_modulus": BULK, "pla.shear_modulus": SHEAR, "pla.density": WALL_DENSITY}


def ring_determinant(frequency: float) -> float:
    """Zero at the modes of fluid p = J0(k r) in a ring u_r = A J1 + B Y1 in plane strain, free outside.

    sigma_rr = (K + 4G/3) u' + (K - 2G/3) u / r; at the wall sigma_rr = -p and rho w^2 u = dp/dr.
    """
    omega = 2.0 * np.pi * frequency
    stiffness = BULK + 4.0 * SHEAR / 3.0
    k, kf = omega * np.sqrt(WALL_DENSITY / stiffness), omega / SPEED

    def stress(value: float, slope: float, r: float) -> float:
        return stiffness * slope + (BULK - 2.0 * SHEAR / 3.0) * value / r

    def solid_stress(r: float) -> list[float]:
        return [stress(j1(k * r), k * jvp(1, k * r), r), stress(y1(k * r), k * yvp(1, k * r), r)]

    inner = solid_stress(RADIUS)
    inertia = DENSITY * omega**2
    matrix = np.array([
        [*solid_stress(OUTER), 0.0],
        [*inner, j0(kf * RADIUS)],
        [inertia * j1(k * RADIUS), inertia * y1(k * RADIUS), kf * j1(kf * RADIUS)],
    ])
    scaled = matrix / np.abs(matrix).max(axis=1, keepdims=True)
    return float(np.linalg.det(scaled))


@pytest.fixture(scope="module")
def ring(
    cavity_chip: Chip,
    uniform_mesh: Callable[[Chip, float], SectionMesh],
    base: tuple[tuple[Term, ...], dict[str, complex]],
    rows: Callable[..., NDArray[np.int64]],
    pencil: Callable[..., dict[int, csc_matrix]],
) -> Callable[[float], tuple[FullOperators, NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]]:
    """Modes (Hz), their shapes in columns, and the rows these are on, for an element edge."""
    terms, values = base
    terms += (
        fluid.AcousticFluid("cavity", "water"), solid.ElasticSolid("sidewall", "pla"),
        fluid.SolidFluidContact("cavity|sidewall", "sidewall", "cavity"),
        PlaneStrain("layer|sidewall"), PlaneStrain("sidewall|superstrate"),
    )

    def solved(edge: float) -> tuple[FullOperators, NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        operators = assemble(uniform_mesh(cavity_chip, edge), terms)
        u, p = rows(operators, "sidewall", "u_r", "u_z"), rows(operators, "cavity", "p")
        every = np.concatenate([u, p])
        blocks = {power: m[every][:, every].toarray() for power, m in pencil(operators, values | POLYMER).items()}
        # (1/w^2) S + K + w^2 M with the fluid rows multiplied by w^2, scaled to pascals on both sides: linear in w^2.
        n, size = u.size, 1e9
        left, right = blocks[0].copy(), -blocks[2]
        left[n:, n:] = blocks[-2][n:, n:]
        left[n:, :n] = 0.0
        right[n:] = -blocks[0][n:]
        scale = np.concatenate([np.ones(n), np.full(p.size, size)])
        found, shapes = scipy.linalg.eig(left * scale, right * scale)
        usable = np.isfinite(found) & (np.abs(found.imag) < 1e-6 * np.abs(found)) & (found.real > 1e8)
        order = np.argsort(found[usable].real)
        frequency = np.sqrt(found[usable].real[order]) / (2.0 * np.pi)
        return operators, frequency, (scale[:, None] * shapes[:, usable].real)[:, order], every

    return solved


def test_a_fluid_in_an_elastic_ring_has_the_coupled_modes(
    ring: Callable[[float], tuple[FullOperators, NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]],
) -> None:
    grid = np.linspace(20e3, 600e3, 400)
    signs = np.array([ring_determinant(f) for f in grid])
    exact = [brentq(ring_determinant, a, b, xtol=1e-6) for a, b, s, t in
             zip(grid, grid[1:], signs, signs[1:], strict=False) if s * t < 0.0]
    errors = []
    for edge in (HEIGHT, HEIGHT / 2):
        _, found, _, _ = ring(edge)
        errors.append(np.array([np.abs(found / mode - 1.0).min() for mode in exact]))
    order = np.log2(errors[0] / errors[1])
    print(f"ring and fluid: modes (kHz) {np.round(1e-3 * np.array(exact), 2).tolist()}, errors {errors[1]}, "
          f"order {np.round(order, 2).tolist()}")
    assert len(exact) >= 3
    # (k h)^4 / 1440 with k of the water, the slower of the two.
    assert (errors[-1] < 1.1 * (2.0 * np.pi * np.array(exact) / SPEED * HEIGHT / 2) ** 4 / 1440).all()
    assert np.abs(order - 4.0).max() < 0.5


def test_the_pressure_at_a_moving_wall_has_the_sign_of_newtons_law(
    ring: Callable[[float], tuple[FullOperators, NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]],
) -> None:
    # A wrong sign of the contact changes neither the modes nor Z: only the pressure. At the wall dp/dr = rho w^2 u_r.
    operators, found, shapes, every = ring(HEIGHT / 4)
    place = operators.places["cavity|sidewall"]
    mode = next(k for k, f in enumerate(found)
                if f > 20e3 and ring_determinant(f * 0.999) * ring_determinant(f * 1.001) < 0.0)
    state = np.zeros((operators.size, 1))
    state[every, 0] = shapes[:, mode]
    displacement = operators.evaluate(place, ["u_r"], state)["u_r"]
    cells = operators.places["cavity"]
    slope = operators.evaluate(cells, ["grad_p_r", "p"], state)
    # The slope is that of a parabola, taken at the quadrature points next to the wall and continued to it.
    r = cells.weights  # 2 pi r dr dz: only its largest entries, the outermost points, are wanted
    outermost = np.unravel_index(np.argmax(r), r.shape)
    expected = DENSITY * (2.0 * np.pi * found[mode]) ** 2 * displacement.mean()
    # Between the outermost point and the wall (0.03 mm) dp/dr changes by less than 5 %.
    assert slope["grad_p_r"][outermost][0] == pytest.approx(expected, rel=0.1)
