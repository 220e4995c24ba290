"""Fields that vary along the third direction, against closed forms: discs, cylinders, channels and beams."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import jnp_zeros
from support import Held

from geometry.measure import ABOUT_AXIS, Measure, Parity, Straight
from geometry.mesh import mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.modes import eigenmodes
from workbench.fem.operators import assemble
from workbench.fem.solve import System
from workbench.model.problem import Problem, material_values, problem, with_boundary_layers
from workbench.physics import fluid
from workbench.physics.couplant_shear import CouplantShear
from workbench.physics.cubic import CubicCrystal
from workbench.physics.orders import ORDER, OfOrder, terms_of_order
from workbench.physics.solid import ElasticSolid
from workbench.physics.term import ModelError, Term
from workbench.physics.thin_layer import SKIN, ImperfectBond

Real = NDArray[np.float64]

WATER = Fluid(name="water", density=997.0, sound_speed=1482.0)
#: Young's modulus (Pa), Poisson's ratio and density (kg/m^3) of a solid without piezoelectricity.
YOUNG, POISSON, DENSITY = 70e9, 0.3, 2700.0
BULK, SHEAR = YOUNG / (3.0 * (1.0 - 2.0 * POISSON)), YOUNG / (2.0 * (1.0 + POISSON))
PASSIVE = Piezoelectric(
    name="metal", density=DENSITY, c11=BULK + 4.0 * SHEAR / 3.0, c12=BULK - 2.0 * SHEAR / 3.0,
    c13=BULK - 2.0 * SHEAR / 3.0, c33=BULK + 4.0 * SHEAR / 3.0, c44=SHEAR, e31=0.0, e33=0.0, e15=0.0, eps11=10.0,
    eps33=10.0)
METAL = IsotropicSolid(name="solid", density=DENSITY, bulk_modulus=BULK, shear_modulus=SHEAR)


def made(
    pieces: Sequence[tuple[str, float, float, float, float]], materials: dict[str, Material], measure: Measure,
    edge: float, skins: dict[str, float] | None = None,
) -> Problem:
    """The base model of rectangles (region, left, right, bottom, top), with cells no longer than `edge` (m)."""
    left, right, bottom, top = next(piece[1:] for piece in pieces if piece[0] == "transducer")
    cut = Section(tuple(Rectangle(*piece) for piece in pieces), (
        Electrode("electrode_live", left, right, bottom), Electrode("electrode_ground", left, right, top)), measure)
    mesh = mesh_section(cut, MeshSize(dict.fromkeys(cut.regions, 1.0), 1.0 / edge, 1.0, 4, skins=skins or {}))
    return problem(mesh, materials, (1e4, 1e7))


def frequencies(posed: Problem, m: float, band: tuple[float, float], terms: tuple[Term, ...] | None = None) -> Real:
    """Eigenfrequencies (n,) in Hz of an order or wave number; that of the base model for None."""
    terms = terms_of_order(posed.terms if terms is None else terms, is_first=m == 1.0)
    return eigenmodes(System(assemble(posed.mesh, terms), {**posed.values, ORDER: m}), band).frequency


@pytest.mark.parametrize(("m", "roots"), [
    (1, (1.61756, 3.52912)), (2, (1.38765, 2.51118)), (3, (2.13040,)), (4, (2.77400,))])
def test_a_thin_disc_has_the_modes_of_plane_stress(m: int, roots: tuple[float, ...]) -> None:
    """w R / c_p of a free disc in its plane; the frequency of a disc of finite height is lower by about (h / R)^2."""
    radius, height = 10e-3, 0.2e-3
    posed = made([("transducer", 0.0, radius, 0.0, height)], {"transducer": PASSIVE}, ABOUT_AXIS, 0.5e-3)
    unit = math.sqrt(YOUNG / (DENSITY * (1.0 - POISSON**2))) / (2.0 * math.pi * radius)
    found = frequencies(posed, float(m), (0.97 * unit * roots[0], 1.03 * unit * roots[-1])) / unit
    errors = [np.abs(found / root - 1.0).min() for root in roots]
    print(f"m = {m}: {errors}")
    assert max(errors) < (height / radius) ** 2


@pytest.mark.parametrize(("m", "expected"), [
    (1, (43.823, 69.552, 111.670)), (2, (10.510, 59.322, 70.153))])
def test_a_ceramic_disc_with_shorted_faces(
    m: int, expected: tuple[float, ...], reference_materials: Callable[[str], dict[str, Material]]
) -> None:
    """PZT-4, 25 x 2.02 mm, kHz; a model of three dimensions agrees within 5e-4."""
    posed = made([("transducer", 0.0, 12.5e-3, 0.0, 2.02e-3)], reference_materials("free_disc_fitted_rho7500"),
                 ABOUT_AXIS, 1e-3)
    found = frequencies(posed, float(m), (9e3, 120e3))
    errors = [np.abs(found / (1e3 * each) - 1.0).min() for each in expected]
    print(f"m = {m}: {errors}")
    assert max(errors) < 1e-4


def with_rigid_walls(pieces: list[tuple[str, float, float, float, float]], measure: Measure, edge: float) -> Problem:
    """Water beside a transducer that it does not touch: its walls are rigid."""
    posed = made(pieces, {"transducer": PASSIVE, "cavity": WATER}, measure, edge)
    apart = tuple(term for term in posed.terms if not isinstance(term, fluid.SolidFluidContact | fluid.PressureRelease))
    return replace(posed, terms=apart)


@pytest.mark.parametrize(("m", "branch", "expected"), [(1, 1, 1.03488e6), (2, 1, 1.04481e6), (3, 2, None)])
def test_a_rigid_cylinder(m: int, branch: int, expected: float | None) -> None:
    """(m, n, 1): J_m'(k R) = 0 and half a wave along the height."""
    radius, height = 4e-3, 0.72e-3
    posed = with_rigid_walls([("transducer", 0.0, 0.5e-3, -0.1e-3, 0.0), ("cavity", 0.0, radius, 0.0, height)],
                             ABOUT_AXIS, 0.4e-3)
    exact = 1482.0 / (2.0 * math.pi) * math.hypot(jnp_zeros(m, branch)[-1] / radius, math.pi / height)
    if expected is not None:
        assert exact == pytest.approx(expected, rel=5e-6)
    found = frequencies(posed, float(m), (0.995 * exact, 1.005 * exact))
    assert np.abs(found / exact - 1.0).min() < 1e-6


def test_a_rigid_channel_of_some_length() -> None:
    """k = l pi / L between rigid ends: c / 2 pi times the root of the squares."""
    width, height, length = 0.38e-3, 0.16e-3, 5e-3
    measure = Straight(1.0, Parity.EVEN, Parity.NONE)
    half = 0.5 * width
    posed = with_rigid_walls([("transducer", 0.0, half, -0.1e-3, 0.0), ("cavity", 0.0, half, 0.0, height)], measure,
                             0.1e-3)
    for along in (1, 4):
        k = along * math.pi / length
        exact = 1482.0 / (2.0 * math.pi) * math.hypot(2.0 * math.pi / width, k)
        found = frequencies(posed, k, (0.99 * exact, 1.01 * exact))
        assert np.abs(found / exact - 1.0).min() < 1e-6


@pytest.mark.parametrize("is_isotropic", [False, True], ids=["transversely isotropic", "isotropic"])
def test_a_beam_between_rollers(is_isotropic: bool) -> None:
    """A rectangle on rollers at four sides, simply supported at both ends, has plane waves of either kind."""
    width, height, k = 1e-3, 0.4e-3, 2000.0
    posed = made([("transducer", 0.0, width, 0.0, height)], {"transducer": PASSIVE},
                 Straight(1.0, Parity.EVEN, Parity.EVEN), 0.2e-3)
    terms = (*posed.terms, Held("u_z", "electrode_live"), Held("u_z", "electrode_ground"))
    if is_isotropic:
        # The ceramic keeps its permittivity; the term of an isotropic solid moves in its place.
        nothing = {name: 0.0 for name in posed.values if name.startswith("metal.c") or name == "metal.density"}
        posed = replace(posed, values={**posed.values, **nothing, **material_values(METAL)})
        terms = (*terms, ElasticSolid("transducer", METAL.name))
    for speed in (math.sqrt((BULK + 4.0 * SHEAR / 3.0) / DENSITY), math.sqrt(SHEAR / DENSITY)):
        exact = speed / (2.0 * math.pi) * math.hypot(math.pi / width, math.pi / height, k)
        found = frequencies(posed, k, (0.999 * exact, 1.001 * exact), terms)
        assert np.abs(found / exact - 1.0).min() < 1e-6


def test_a_layered_plate_does_not_tell_its_directions() -> None:
    """Modes of a stack that vary along x in plane strain are those that vary along y by the same wave number.

    This holds every term with parts along s: solids, ceramic, contacts, boundary layers, a bond and a gel with shear.
    """
    k, height = 2000.0, 1e-4
    layers = ("transducer", "couplant", "substrate", "cavity", "superstrate")
    glass = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=44e9 - 0.2e9j, shear_modulus=29e9 - 0.3e9j)
    gel = Fluid(name="gel", density=1020.0, sound_speed=1500.0)
    water = replace(WATER, shear_viscosity=0.89e-3)
    materials = {"transducer": replace(PASSIVE, e31=-5.0, e33=15.0, e15=12.0, c13=60e9), "couplant": gel,
                 "substrate": glass, "cavity": water, "superstrate": glass}
    found = []
    for width, along in ((math.pi / k, 0.0), (0.5e-3, k)):
        posed = made([(name, 0.0, width, n * height, (n + 1) * height) for n, name in enumerate(layers)], materials,
                     Straight(1.0, Parity.EVEN, Parity.EVEN), 0.25e-3, {"substrate": SKIN})
        walls = "couplant|transducer", "couplant|substrate", "transducer", "substrate"
        posed = with_boundary_layers(posed).with_terms(
            (CouplantShear("couplant", "gel", *walls), ImperfectBond("substrate", "glass", "bond", True)),
            {"gel.gel_viscosity_root": 0.3, "gel.gel_shear_modulus": 0.0, "couplant.thickness": height,
             "bond.normal_compliance": 1e-14, "bond.tangential_compliance": 2e-14, "bond.loss_factor": 0.1,
             "substrate.thickness": height})
        terms = posed.terms if along == 0.0 else terms_of_order(posed.terms, is_first=False)
        modes = eigenmodes(System(assemble(posed.mesh, terms), {**posed.values, ORDER: along}), (0.5e6, 4e6))
        found.append(modes.omega)
    distances = [np.abs(found[0] / each - 1.0).min() for each in found[1]]
    print(len(found[0]), len(found[1]), distances)
    assert len(found[1]) > 3
    # Modes that move along x alone, sheared by k, are of another number in the first section.
    assert sum(each < 1e-7 for each in distances) >= 4


def test_without_variation_along_the_channel_it_is_plane_strain() -> None:
    """The in-plane modes of the base model are among those of k = 0, where the motion along the channel decouples."""
    posed = made([("transducer", 0.0, 1e-3, 0.0, 0.4e-3)], {"transducer": PASSIVE}, Straight(1.0), 0.2e-3)
    band = (1e6, 4e6)
    plane = eigenmodes(System(assemble(posed.mesh, posed.terms), posed.values), band)
    every = frequencies(posed, 0.0, band)
    distances = [np.abs(every / each - 1.0).min() for each in plane.frequency]
    print(len(plane.frequency), len(every), max(distances))
    assert len(every) > len(plane.frequency) >= 3
    assert max(distances) < 1e-11


def test_a_term_that_is_not_isotropic_about_the_axis_has_no_orders() -> None:
    with pytest.raises(ModelError, match=r"CubicCrystal\(.*not isotropic"):
        OfOrder(CubicCrystal("substrate", "silicon", True)).integrals()
