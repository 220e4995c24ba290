"""Imperfect bonds against a laminate, a stack with a spring, and a soft layer that is meshed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import Basis, ElementQuad2

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import IsotropicSolid, Material, Piezoelectric
from materials.registry import Registry
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics.term import ModelError
from workbench.physics.thin_layer import ADMISSIBLE, SKIN, ImperfectBond
from workbench.reduced.at_point import reduce

TERM = ImperfectBond("bond", "epoxy", "springs", upper=True)
NORMAL, TANGENTIAL, LOSS = "springs.normal_compliance", "springs.tangential_compliance", "springs.loss_factor"
THICKNESS = "bond.thickness"


def bonded(
    base: Problem, normal: complex, tangential: complex, thickness: float = 0.1e-3, *, loss: float = 0.0,
    upper: bool = True,
) -> Problem:
    return base.with_terms((replace(TERM, upper=upper),),
                           {NORMAL: normal, TANGENTIAL: tangential, LOSS: loss, THICKNESS: thickness})


@pytest.fixture(scope="module")
def skinned(small_chip: Chip, filled_materials: dict[str, Material], meshed: Callable[..., Problem]) -> Problem:
    """The small chip with water in it, whose bond has skins."""
    return meshed(small_chip, filled_materials, elements_per_wavelength=4.0, skins={"bond": SKIN})


def forms(operators: FullOperators, *, radial: float = 0.0, axial: float = 0.0, sheared: float = 0.0
          ) -> NDArray[np.complex128]:
    """Forms (integrals,) for the displacement u_r = radial r, u_z = axial z + sheared r."""
    place = np.asarray(Basis(operators.mesh.mesh, ElementQuad2(), intorder=1).doflocs)
    state = np.zeros((operators.size, 1), dtype=complex)
    for component, shape in (("u_r", radial * place[0]), ("u_z", axial * place[1] + sheared * place[0])):
        numbers = operators.numbering[component]
        state[numbers[numbers >= 0], 0] = shape[numbers >= 0]
    return operators.quadratic(state, state)[0]


@pytest.mark.parametrize("upper", [True, False])
def test_the_skin_stores_the_energy_of_a_laminate(skinned: Problem, upper: bool) -> None:
    # The springs and the skin carry one stress sigma = [zz], and the strain of the skin alone, x, is unknown:
    # minimise c11-part + c33 (b - x)^2 ... over x. Strains are uniform: u_r = a r, u_z = b z.
    bulk, shear = 4.56e9 - 0.1e9j, 0.88e9 - 0.23e9j
    loss, thickness = 0.05, 0.1e-3
    normal, tangential = 3e-14, 2e-13
    model = bonded(skinned, normal, tangential, thickness, loss=loss, upper=upper)
    operators = assemble(model.mesh, model.terms)
    values = {**model.values, "epoxy.bulk_modulus": bulk, "epoxy.shear_modulus": shear}
    springs = np.array([i.coefficient(np.array([1.0]), values)[0] if i.skin else 0.0 for i in operators.integrals])
    volume = SKIN * model.mesh.section.volume("bond")
    skin = SKIN * thickness / (1.0 + 1j * loss)
    c33, c13 = bulk + 4 / 3 * shear, bulk - 2 / 3 * shear
    for a, b in ((1.0, 0.0), (0.0, 1.0), (1.0, -0.6), (0.3, 2.0)):
        # d/dx of 4 c13 a x + c33 x^2 + (b - x)^2 d / s; less what it is without springs, x = b
        x = (skin / normal * b - 2 * c13 * a) / (c33 + skin / normal)
        expected = 4 * c13 * a * (x - b) + c33 * (x**2 - b**2) + (b - x) ** 2 * skin / normal
        found = springs @ forms(operators, radial=a, axial=b)
        assert found == pytest.approx(expected * volume, rel=1e-9)
    series = 1.0 / (1.0 / shear + tangential / skin)
    found = springs @ forms(operators, sheared=1.0)
    assert found == pytest.approx((series - shear) * volume, rel=1e-9)


def test_a_mesh_without_the_skin_is_refused(filled: Problem) -> None:
    model = bonded(filled, 1e-14, 1e-14)
    with pytest.raises(ModelError, match=r"no row of elements for 'bond skin 0\.05'"):
        assemble(model.mesh, model.terms)


# --------------------------------------------------------------------------------------------------------------------
# A stack that vibrates along z alone

RADIUS = 0.1e-3
FREQUENCY = np.linspace(0.31e6, 1.19e6, 9)
OMEGA = 2.0 * np.pi * FREQUENCY
#: No Poisson's ratio, so that the stack is one-dimensional.
EPOXY = IsotropicSolid(name="epoxy", density=1150.0, bulk_modulus=2 / 3 * (1.5e9 - 0.05e9j),
                       shear_modulus=1.5e9 - 0.05e9j)
GLASS = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=2 / 3 * (29e9 - 0.3e9j),
                       shear_modulus=29e9 - 0.3e9j)
BOND, SAMPLE, DISC = 20e-6, 1e-3, 2e-3


def line(thickness: float, material: IsotropicSolid, end: NDArray[np.complex128], modulus: complex | None = None
         ) -> NDArray[np.complex128]:
    """sigma / (-i w u) of a layer seen from below that sees `end` above, e^{-i w t}."""
    stiffness = 2.0 * material.shear_modulus if modulus is None else modulus
    own = np.sqrt(material.density * stiffness)
    phase = -1j * np.tan(OMEGA * thickness * np.sqrt(material.density / stiffness))
    return own * (end + own * phase) / (own + end * phase)


def plate(material: Piezoelectric, load: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Z (e^{-i w t}) of the plate with a specific impedance above it: u = A sin k z + B cos k z from the middle."""
    permittivity = material.absolute_eps33
    h = material.e33 / permittivity
    modulus = material.c33 + material.e33**2 / permittivity
    found = []
    for omega, above in zip(OMEGA, load, strict=True):
        k = omega * np.sqrt(material.density / modulus)
        s, c = np.sin(0.5 * k * DISC), np.cos(0.5 * k * DISC)
        # c_D u' - h D = i w Z u above, 0 below, for D = 1.
        matrix = np.array([[modulus * k * c - 1j * omega * above * s, -modulus * k * s - 1j * omega * above * c],
                           [modulus * k * c, modulus * k * s]])
        a, _ = np.linalg.solve(matrix, [h, h])
        voltage = DISC / permittivity - 2.0 * h * a * s
        found.append(voltage / (-1j * omega * np.pi * RADIUS**2))
    return np.array(found)


@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize(("compliance", "loss"), [(5e-15, 0.0), (2e-14, 0.25)])
def test_a_stack_sees_a_spring_at_a_face_of_the_layer(
    compliance: float, loss: float, upper: bool, stacked: Callable[..., Chip],
    uniform_mesh: Callable[..., SectionMesh], plain_ceramic: Piezoelectric,
) -> None:
    chip = stacked([("transducer", DISC, RADIUS, None), ("bond", BOND, RADIUS, None),
                    ("sample", SAMPLE, RADIUS, None)], band=(0.3e6, 1.2e6))
    bare = problem(uniform_mesh(chip, 50e-6, {"bond": SKIN}),
                   {"transducer": plain_ceramic, "bond": EPOXY, "sample": GLASS}, chip.band)
    model = bonded(bare, compliance, 0.0, BOND, loss=loss, upper=upper)
    found = solve_full(assemble(model.mesh, model.terms), FREQUENCY, model.values).impedance

    def sprung(load: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.asarray(1.0 / (1.0 / load - 1j * OMEGA * compliance * (1.0 + 1j * loss)), dtype=np.complex128)

    beyond = line(SAMPLE, GLASS, np.zeros(OMEGA.size, dtype=complex))
    above, below = (plate(plain_ceramic, load) for load in (
        line(BOND, EPOXY, sprung(beyond)), sprung(line(BOND, EPOXY, beyond))))
    expected, other = (above, below) if upper else (below, above)
    perfect = plate(plain_ceramic, line(BOND, EPOXY, beyond))
    effect, missed, apart = (np.abs(z - expected).max() for z in (perfect, found, other))
    print(f"spring {compliance} at {'upper' if upper else 'lower'} face: effect {effect:.2e} ohm, misses "
          f"{missed / effect:.1e} of it, other face {apart / effect:.1e}")
    assert np.abs(perfect / expected - 1.0).max() > 0.05
    # Half a skin, a fortieth of the layer, hangs on the other side: 0.06 % of the sample's mass, and more on a flank.
    assert missed < 2e-3 * effect
    # That tells the faces apart.
    assert apart > 10.0 * missed


def test_a_soft_layer_that_is_meshed_does_the_same(
    stacked: Callable[..., Chip], meshed: Callable[..., Problem],
    reference_materials: Callable[[str], dict[str, Material]],
) -> None:
    # In the whole of the axisymmetric problem: 1 um of something light and soft on top of the bond of 20 um.
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    registry = Registry()
    materials = {"transducer": pzt, "bond": replace(registry.load("epoxy"), name="epoxy"), "sample":
                 replace(registry.load("pla"), name="pla")}
    soft, normal, tangential = 1e-6, 4e-14, 1.6e-13
    shear = soft / tangential
    thin = IsotropicSolid(name="thin", density=10.0, shear_modulus=shear, bulk_modulus=soft / normal - 4 / 3 * shear)
    layers = [("transducer", 2e-3, 3e-3, None), ("bond", 20e-6, 3e-3, None), ("sample", 1e-3, 3e-3, None)]
    frequency = np.linspace(310e3, 690e3, 13)

    def impedance(model: Problem) -> NDArray[np.complex128]:
        return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance

    base = meshed(stacked(layers, band=(300e3, 700e3)), materials, elements_per_wavelength=6.0, skins={"bond": SKIN})
    layers.insert(2, ("layer", soft, 3e-3, None))
    # The soft layer's own waves are of no interest: it follows its neighbours, like them in mesh size.
    resolved = meshed(stacked(layers, band=(300e3, 700e3)), {**materials, "layer": thin}, elements_per_wavelength=6.0)
    perfect = impedance(base)
    expected = impedance(resolved)
    effect = np.abs(expected - perfect).max()
    misses = {name: np.abs(impedance(bonded(base, *pair, 20e-6)) - expected).max() / effect for name, pair in {
        "both": (normal, tangential), "normal only": (normal, 0.0), "tangential only": (0.0, tangential)}.items()}
    print(f"meshed soft layer: effect {np.abs(expected / perfect - 1.0).max():.2f} of Z, misses {misses}")
    assert np.abs(expected / perfect - 1.0).max() > 0.05
    # The skin, 1 um of the bond, hangs on the springs in part, and the soft layer makes the stack 1 um higher; on the
    # flanks of resonances that have moved by several widths.
    assert misses["both"] < 5e-3
    assert misses["normal only"] > 0.1
    assert misses["tangential only"] > 0.1


def test_the_reduced_model_follows(skinned: Problem) -> None:
    model = bonded(skinned, 2e-14, 1e-13, loss=0.05)
    frequency = np.linspace(300e3, 400e3, 7)
    operators = assemble(model.mesh, model.terms)
    full = solve_full(operators, frequency, model.values).impedance
    reduced = reduce(operators, np.linspace(300e3, 400e3, 21), model.values)
    assert np.abs(reduced.solve(frequency, model.values).impedance / full - 1.0).max() < 1e-5
    # Three powers of w, as without the bond: the reduced model is solved by its eigenvectors.
    assert len(operators.coefficients.groups(frequency, model.values)) == 3


def test_the_limits_are_a_hundred_times_the_epoxy_of_the_paper() -> None:
    epoxy = Registry().load("epoxy").parameters()
    bulk, shear = epoxy["bulk_modulus"].real, epoxy["shear_modulus"].real
    for name, stiffness in (("normal_compliance", bulk + 4 / 3 * shear), ("tangential_compliance", shear)):
        assert ADMISSIBLE[name].highest == pytest.approx(100 * 1e-4 / stiffness, rel=0.05)
        assert ADMISSIBLE[name].lowest == 0.0
