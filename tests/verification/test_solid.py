"""Isotropic solids against closed forms: vibration in plane strain, of a thin disc, and through the thickness."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import j0, j1, jn_zeros
from support import Held

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from workbench.fem.operators import FullOperators, assemble
from workbench.physics import electrodes, piezoelectric, solid
from workbench.physics.term import Term

BULK, SHEAR, DENSITY = 3.6e9, 1.1e9, 1150.0


@pytest.fixture(scope="module")
def solid_modes(
    stacked: Callable[..., Chip],
    uniform_mesh: Callable[[Chip, float], SectionMesh],
    modes: Callable[..., NDArray[np.float64]],
    rows: Callable[..., NDArray[np.int64]],
    reference_materials: Callable[..., dict[str, object]],
) -> Callable[..., NDArray[np.float64]]:
    """Eigenfrequencies (Hz) of a disc between two layers with nothing in them, which part it from the transducer."""
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    values: dict[str, complex] = {f"pzt.{n}": v for n, v in pzt.parameters().items()}  # type: ignore[attr-defined]

    def found(
        radius: float, thickness: float, edge: float, *, near: float, bulk: float = BULK, clamps: tuple[Held, ...] = ()
    ) -> NDArray[np.float64]:
        chip = stacked([("transducer", thickness, radius, None), ("couplant", thickness, radius, None),
                        ("sample", thickness, radius, None), ("superstrate", thickness, radius, None)], band=(1e5, 1e6))
        terms: tuple[Term, ...] = (
            piezoelectric.PiezoelectricSolid("transducer", "pzt"), solid.ElasticSolid("sample", "polymer"),
            electrodes.ElectrodePotential("electrode_live", "electrode_ground"), *clamps,
        )
        operators: FullOperators = assemble(uniform_mesh(chip, edge), terms)
        polymer = {"polymer.bulk_modulus": bulk, "polymer.shear_modulus": SHEAR, "polymer.density": DENSITY}
        return modes(operators, values | polymer, rows(operators, "sample", "u_r", "u_z"), near=near, count=4)

    return found


RADIUS = 4e-3
#: Both faces slide, or only the rim does.
FACES = (Held("u_z", "couplant|sample"), Held("u_z", "sample|superstrate"))
RIM = (Held("u_r", "sample|outside"),)


def plane_strain_frequency() -> float:
    """Lowest radial mode of a free cylinder with u_z = 0: (K + 4G/3) x J0(x) = 2 G J1(x), x = w R / c_L."""
    stiffness = BULK + 4.0 * SHEAR / 3.0
    x = brentq(lambda x: stiffness * x * j0(x) - 2.0 * SHEAR * j1(x), 0.5, 3.0, xtol=1e-14)
    return float(x * np.sqrt(stiffness / DENSITY) / (2.0 * np.pi * RADIUS))


def test_a_cylinder_in_plane_strain_has_the_bessel_mode_with_the_fourth_order(
    solid_modes: Callable[..., NDArray[np.float64]],
) -> None:
    exact = plane_strain_frequency()
    errors = []
    for elements in (2, 4, 8):
        found = solid_modes(RADIUS, 0.5e-3, RADIUS / elements, near=exact, clamps=FACES)
        errors.append(float(np.abs(found / exact - 1.0).min()))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"plane strain: errors {errors}, order {np.round(order, 2).tolist()}")
    # Four elements on two thirds of a wavelength already give 1e-5; the rate is twice the degree of the elements.
    assert errors[-1] < 2e-6
    assert abs(order[-1] - 4.0) < 0.15


def test_a_thin_disc_has_the_contour_mode_of_plane_stress(solid_modes: Callable[..., NDArray[np.float64]]) -> None:
    young = 9.0 * BULK * SHEAR / (3.0 * BULK + SHEAR)
    poisson = (3.0 * BULK - 2.0 * SHEAR) / (2.0 * (3.0 * BULK + SHEAR))
    x = brentq(lambda x: x * j0(x) - (1.0 - poisson) * j1(x), 0.5, 3.0, xtol=1e-14)
    exact = x * np.sqrt(young / (DENSITY * (1.0 - poisson**2))) / (2.0 * np.pi * 5e-3)
    errors = []
    for thickness in (0.4e-3, 0.2e-3):
        found = solid_modes(5e-3, thickness, 0.5e-3, near=exact)
        errors.append(float((found / exact - 1.0)[np.abs(found / exact - 1.0).argmin()]))
    print(f"contour mode: relative errors {errors}")
    # Rayleigh: u_z = -nu / (1 - nu) z div u adds inertia, -1/2 (nu / (1 - nu))^2 (h^2 / 12) int (div u)^2 / int u^2.
    # The next order is (h / R)^2 = 6e-3 of it times a number of the order of one.
    s = np.linspace(0.0, x, 2001)
    share = np.trapezoid(s * j0(s) ** 2, s) / np.trapezoid(s * j1(s) ** 2, s)
    for thickness, error in zip((0.4e-3, 0.2e-3), errors, strict=True):
        expected = -((poisson / (1.0 - poisson)) ** 2) * (x * thickness / 5e-3) ** 2 / 24.0 * share
        assert error == pytest.approx(expected, rel=0.01)


def test_a_plate_without_poissons_ratio_vibrates_through_its_thickness(
    solid_modes: Callable[..., NDArray[np.float64]],
) -> None:
    # K = 2 G / 3: no lateral strain, sound speed sqrt(2 G / rho), half a wave on the thickness; u_r = 0 by the clamps,
    # which take away the modes of bending.
    thickness = 1e-3
    exact = np.sqrt(2.0 * SHEAR / DENSITY) / (2.0 * thickness)
    clamps = (Held("u_r", "couplant|sample"), Held("u_r", "sample|superstrate"), *RIM)
    found = solid_modes(1e-3, thickness, 0.125e-3, near=exact, bulk=2.0 * SHEAR / 3.0, clamps=clamps)
    # (k h)^4 / 720 of 8 biquadratic elements on half a wave, halved for the frequency.
    assert np.abs(found / exact - 1.0).min() < 2e-5


def test_a_disc_that_slides_on_its_walls_has_the_shear_mode_with_the_fourth_order(
    solid_modes: Callable[..., NDArray[np.float64]],
) -> None:
    # u = rot(J1(a r) sin(b z)), no change of volume, with a R a zero of J1 and b h = pi: u_z = 0 and no shear stress on
    # the faces, u_r = 0 and no shear stress on the rim; rho w^2 = G (a^2 + b^2).
    radius, thickness = 2e-3, 1e-3
    exact = np.sqrt(SHEAR / DENSITY) * np.hypot(jn_zeros(1, 1)[0] / radius, np.pi / thickness) / (2.0 * np.pi)
    errors = []
    for edge in (0.5e-3, 0.25e-3, 0.125e-3):
        found = solid_modes(radius, thickness, edge, near=exact, clamps=FACES + RIM)
        errors.append(float(np.abs(found / exact - 1.0).min()))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"shear mode: errors {errors}, order {np.round(order, 2).tolist()}")
    # (k h)^4 / 1440 with k h = 0.46.
    assert errors[-1] < 4e-5
    assert abs(order[-1] - 4.0) < 0.15
