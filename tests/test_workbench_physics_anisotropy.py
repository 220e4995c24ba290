"""Printed polymers against the stiffness matrix of transverse isotropy and waves along and across its axis."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import jv, yv
from skfem import Basis, ElementQuad2
from support import Held, plate_below_a_layer

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics import electrodes, piezoelectric, solid
from workbench.physics.anisotropy import TransverseIsotropy

TERM = TransverseIsotropy("substrate", "pla")


def excesses(axial: complex = 0.0, shear: complex = 0.0, lateral: complex = 0.0) -> dict[str, complex]:
    return {"pla.axial_excess": axial, "pla.shear_excess": shear, "pla.lateral_excess": lateral}


def test_the_energy_is_that_of_the_stiffness_matrix(filled: Problem) -> None:
    # u_r = a r, u_z = b z + g r: strains (a, a, b) and 2 eps_rz = g, everywhere.
    bulk, shear = 3.57e9 - 0.03e9j, 0.93e9 - 0.05e9j
    values = {**filled.values, "pla.bulk_modulus": bulk, "pla.shear_modulus": shear, **excesses(0.15, -0.1, 0.07)}
    operators = assemble(filled.mesh, (*filled.terms, TERM))
    mine = np.array([i.place == "substrate" and i.coefficient.parameters != ("pla.density",)
                     for i in operators.integrals])
    constants = np.array([i.coefficient(np.array([1.0]), values)[0] for i in operators.integrals]) * mine
    c11, c12 = bulk + 4 / 3 * shear, bulk - 2 / 3 * shear
    c33, c13, c44 = 1.15 * c11, 1.07 * c12, 0.9 * shear
    matrix = np.array([[c11, c12, c13, 0], [c12, c11, c13, 0], [c13, c13, c33, 0], [0, 0, 0, c44]])
    r, z = np.asarray(Basis(filled.mesh.mesh, ElementQuad2(), intorder=1).doflocs)
    for a, b, g in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.4, -1.0, 0.7)):
        state = np.zeros((operators.size, 1), dtype=complex)
        for component, shape in (("u_r", a * r), ("u_z", b * z + g * r)):
            numbers = operators.numbering[component]
            state[numbers[numbers >= 0], 0] = shape[numbers >= 0]
        strain = np.array([a, a, b, g])
        expected = strain @ matrix @ strain * filled.mesh.section.volume("substrate")
        assert constants @ operators.quadratic(state, state)[0] == pytest.approx(expected, rel=1e-9)


RADIUS, DISC, SAMPLE = 0.1e-3, 2e-3, 1e-3
FREQUENCY = np.linspace(0.31e6, 1.19e6, 9)
#: No Poisson's ratio, so that the stack is one-dimensional.
POLYMER = IsotropicSolid(name="pla", density=1130.0, bulk_modulus=2 / 3 * (1.6e9 - 60e6j), shear_modulus=1.6e9 - 60e6j)


def impedance(material: Piezoelectric, stiffness: complex) -> NDArray[np.complex128]:
    return plate_below_a_layer(material, DISC, POLYMER, SAMPLE, RADIUS, FREQUENCY, stiffness)


@pytest.mark.parametrize("excess", [0.2, -0.15])
def test_a_wave_along_the_axis_has_the_speed_of_the_axial_stiffness(
    excess: float, stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    plain_ceramic: Piezoelectric,
) -> None:
    chip = stacked([("transducer", DISC, RADIUS, None), ("substrate", SAMPLE, RADIUS, None)], band=(0.3e6, 1.2e6))
    base = problem(uniform_mesh(chip, 50e-6), {"transducer": plain_ceramic, "substrate": POLYMER}, chip.band)
    # The shear's has nothing to do, and neither has the lateral one without Poisson's ratio.
    model = base.with_terms((TERM,), excesses(excess, 0.3, 0.2))
    found = solve_full(assemble(model.mesh, model.terms), FREQUENCY, model.values).impedance
    stiffness = 2.0 * POLYMER.shear_modulus
    expected, without = impedance(plain_ceramic, stiffness * (1.0 + excess)), impedance(plain_ceramic, stiffness)
    print(f"axial excess {excess}: effect {np.abs(expected / without - 1.0).max():.2f}, "
          f"error {np.abs(found / expected - 1.0).max():.1e} of Z")
    assert np.abs(expected / without - 1.0).max() > 0.1
    assert np.abs(found / expected - 1.0).max() < 2e-4  # twenty elements on a wavelength, 1e-5, on resonances' flanks


INNER, OUTER, HEIGHT = 1e-3, 1.4e-3, 0.2e-3


@pytest.mark.parametrize("excess", [0.2, -0.15])
def test_a_wave_across_the_axis_has_the_speed_of_the_axial_shear(
    excess: float, stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    reference_materials: Callable[[str], dict[str, Material]], rows: Callable[..., NDArray[np.int64]],
    modes: Callable[..., NDArray[np.float64]],
) -> None:
    # u_z(r) = J0(k r) Y0(k a) - Y0(k r) J0(k a) in a ring held inside and free outside; u_r is held at zero.
    chip = stacked([("transducer", HEIGHT, OUTER, None), ("layer", HEIGHT, OUTER, None),
                    ("sidewall", HEIGHT, OUTER, INNER), ("superstrate", HEIGHT, OUTER, None)], band=(1e5, 3e6))
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    held = tuple(Held("u_r", b) for b in ("cavity|sidewall", "layer|sidewall", "sidewall|superstrate",
                                          "sidewall|outside"))
    terms = (piezoelectric.PiezoelectricSolid("transducer", "pzt"), solid.ElasticSolid("sidewall", "pla"),
             electrodes.ElectrodePotential("electrode_live", "electrode_ground"), *held, Held("u_z", "cavity|sidewall"),
             TransverseIsotropy("sidewall", "pla"))
    operators = assemble(uniform_mesh(chip, 0.05e-3), terms)
    values = {f"pzt.{name}": value for name, value in pzt.parameters().items()} | {
        "pla.bulk_modulus": 3.6e9, "pla.shear_modulus": 1.1e9, "pla.density": 1150.0, **excesses(0.3, excess, 0.1)}

    def residual(k: float) -> float:
        return float(-jv(1, k * OUTER) * yv(0, k * INNER) + yv(1, k * OUTER) * jv(0, k * INNER))

    quarter = 0.5 * np.pi / (OUTER - INNER)
    k = brentq(residual, 0.7 * quarter, 1.3 * quarter)
    expected = np.sqrt(1.1e9 * (1.0 + excess) / 1150.0) * k / (2.0 * np.pi)
    found = modes(operators, values, rows(operators, "sidewall", "u_r", "u_z"), near=expected, count=1)[0]
    print(f"shear excess {excess}: {found:.1f} Hz, closed form {expected:.1f} Hz")
    assert found == pytest.approx(expected, rel=5e-6)  # (k h)^4 / 1440 with k h = 0.2
