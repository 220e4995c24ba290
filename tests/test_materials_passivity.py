"""Passivity: the eigenvalue check against the source paper's inequalities, its tolerance, and wrong signs."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from materials import Fluid, IsotropicSolid, PassivityWarning, Piezoelectric, Registry, passivity
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY

GPA = 1e9


def _fitted() -> Piezoelectric:
    """Table 3 of Acevedo-Espinosa et al. (RP-UEIS), fitted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PassivityWarning)
        material = Registry().load("pzt4/acevedo_2026_fitted")
    assert isinstance(material, Piezoelectric)
    return material


def _initial() -> Piezoelectric:
    material = Registry().load("pzt4/acevedo_2026_initial")
    assert isinstance(material, Piezoelectric)
    return material


def _with_losses(material: Piezoelectric, **losses: float) -> Piezoelectric:
    """`material` with imaginary stiffnesses (Pa); all those not named are zero."""
    names = ("c11", "c12", "c13", "c33", "c44", "eps11", "eps33")
    changed: dict[str, Any] = {name: complex(material.parameters()[name].real, losses.get(name, 0.0)) for name in names}
    return replace(material, **changed)


def _inequalities_13(c11: float, c12: float, c13: float, c33: float, c44: float) -> bool:
    """Eqs. 13 and 14 of the RP-UEIS paper for imaginary stiffnesses (real e, no dielectric loss)."""
    r = c11**2 + 2 * c11 * c12 - 2 * c11 * c33 + c12**2 - 2 * c12 * c33 + 8 * c13**2 + c33**2
    return c12 >= c11 and c44 <= 0 and (c11 - c12) / 2 <= 0 and c11 + c12 + c33 <= -math.sqrt(r)


def test_eigenvalues_agree_with_the_inequalities_of_the_paper() -> None:
    random = np.random.default_rng(20260118)
    material, verdicts = _initial(), []
    for _ in range(400):
        c12, c13 = random.uniform(-0.5, 0.5, 2) * GPA
        c11, c33, c44 = -random.uniform(0.0, 1.0, 3) * GPA
        lossy = _with_losses(material, c11=c11, c12=c12, c13=c13, c33=c33, c44=c44)
        # eps'' = 0 leaves zero eigenvalues, known to rounding: 1e-6 of a GPa is far above that and below any sample.
        passive = passivity.smallest_dissipation(lossy) >= -1e-6 * GPA
        assert passive == _inequalities_13(c11, c12, c13, c33, c44)
        verdicts.append(passive)
    assert 50 < sum(verdicts) < 350  # both answers are well represented, so the comparison says something


def test_complex_piezoelectric_constants_are_part_of_the_matrix() -> None:
    # The 2 x 2 block of (E3, strain 33): passive while e33''^2 <= |c33''| eps33''. The inequalities (13) cannot see it.
    base = _with_losses(_initial(), c11=-1 * GPA, c33=-0.3 * GPA, c44=-1 * GPA, eps11=5.0, eps33=5.0)
    limit = math.sqrt(0.3 * GPA * base.absolute_eps33.imag)
    within = replace(base, e33=base.e33 + 0.99j * limit)
    beyond = replace(base, e33=base.e33 + 1.01j * limit)
    assert passivity.smallest_dissipation(within) >= 0
    assert passivity.smallest_dissipation(beyond) < 0
    with pytest.raises(InputError, match="dissipation matrix"):
        passivity.check_passive(beyond, loss_tolerances={}, source="here")


def test_matrix_gives_the_power_lost() -> None:
    # Mean power in = -(w/2) Im(sigma . conj(strain) + E . conj(D)) for e^{-i w t} (eq. A.2 prints it without the minus,
    # eq. A.4 has it right), straight from the constitutive relations (eq. 10), for random complex motions; agreement
    # to rounding.
    random = np.random.default_rng(7)
    m = replace(_fitted(), e33=16.56 + 0.02j, e31=-5.2 - 0.01j, e15=13.05 + 0.03j, eps11=762.5 + 3j, eps33=753.87 + 2j)
    c66 = m.c66
    c = np.array([
        [m.c11, m.c12, m.c13, 0, 0, 0], [m.c12, m.c11, m.c13, 0, 0, 0], [m.c13, m.c13, m.c33, 0, 0, 0],
        [0, 0, 0, m.c44, 0, 0], [0, 0, 0, 0, m.c44, 0], [0, 0, 0, 0, 0, c66],
    ])  # fmt: skip
    e = np.array([[0, 0, 0, 0, m.e15, 0], [0, 0, 0, m.e15, 0, 0], [m.e31, m.e31, m.e33, 0, 0, 0]])
    eps = np.diag([m.eps11, m.eps11, m.eps33]) * VACUUM_PERMITTIVITY
    field_unit = math.sqrt(m.c33.real / m.absolute_eps33.real)
    for _ in range(5):
        strain = random.normal(size=6) + 1j * random.normal(size=6)
        scaled_field = random.normal(size=3) + 1j * random.normal(size=3)
        field = field_unit * scaled_field
        stress, displacement = c @ strain - e.T @ field, e @ strain + eps @ field
        direct = -(np.sum(stress * strain.conj()) + np.sum(field * displacement.conj())).imag
        x = np.concatenate([strain, scaled_field])
        assert np.vdot(x, passivity.dissipation_matrix(m) @ x).real == pytest.approx(direct, rel=1e-9)


def test_table_3_is_active_by_less_than_its_rounding() -> None:
    material = _fitted()
    # By hand: the block of (strain 11 + 22, strain 33) of -C'' is [[0.08, 0.11 sqrt 2], [., 0.30]] GPa.
    by_hand = (0.38 - math.sqrt(0.38**2 - 4 * (0.08 * 0.30 - 2 * 0.11**2))) / 2
    assert by_hand == pytest.approx(-0.000526, abs=1e-6)
    assert passivity.smallest_dissipation(material) == pytest.approx(by_hand * GPA, rel=1e-6)
    # Its tolerance by hand: c11'', c13'', c33'' rounded to 0.005 GPa, c12'' exact; [[0.005, 0.005 sqrt 2], [., 0.005]].
    with pytest.warns(PassivityWarning, match=r"0\.000526 GPa .* 0\.0121 GPa") as caught:
        Registry().load("pzt4/acevedo_2026_fitted")
    assert caught[0].filename == __file__  # the warning points at the caller, not at the package
    tolerances = dict.fromkeys(("c11", "c13", "c33"), 0.005 * GPA)
    assert passivity.rounding_tolerance(material, tolerances) == pytest.approx(0.005 * (1 + math.sqrt(2)) * GPA)


def test_without_declared_rounding_the_same_constants_are_refused() -> None:
    with pytest.raises(InputError, match=r"smallest eigenvalue -0\.000526 GPa"):
        passivity.check_passive(_fitted(), loss_tolerances={}, source="here")


def test_tolerance_covers_every_choice_of_the_unprinted_digits() -> None:
    # Weyl: whatever the digits below the printed ones, the smallest eigenvalue moves by no more than the tolerance.
    random = np.random.default_rng(3)
    material = _fitted()
    bounds = {"c11": 0.005 * GPA, "c12": 0.002 * GPA, "c13": 0.005 * GPA, "c33": 0.005 * GPA, "e33": 0.005,
              "eps33": 0.05}
    allowed = passivity.rounding_tolerance(material, bounds)
    start = passivity.smallest_dissipation(material)
    moves = []
    for _ in range(200):
        signs = random.choice([-1.0, 1.0], size=len(bounds))
        changed: dict[str, Any] = {}
        for (name, bound), sign in zip(bounds.items(), signs, strict=True):
            changed[name] = material.parameters()[name] + 1j * sign * bound
        moved = replace(material, **changed)
        moves.append(abs(passivity.smallest_dissipation(moved) - start))
    assert max(moves) <= allowed
    assert max(moves) > 0.2 * allowed  # a bound, but not an idle one


@pytest.mark.parametrize("name", ["c11", "c33", "c44", "eps11", "eps33"])
def test_a_flipped_sign_names_the_convention(name: str) -> None:
    material = _with_losses(_initial(), c11=-0.14 * GPA, c13=0.07 * GPA, c33=-0.12 * GPA, c44=-0.1 * GPA, eps11=3.0,
                            eps33=3.0)
    passivity.check_passive(material, loss_tolerances={}, source="here")
    changed: dict[str, Any] = {name: material.parameters()[name].conjugate()}
    flipped = replace(material, **changed)
    with pytest.raises(InputError, match=rf"here: {name}: .*e\^\{{-i w t\}}"):
        passivity.check_passive(flipped, loss_tolerances={}, source="here")


@pytest.mark.parametrize("name", ["bulk_modulus", "shear_modulus"])
def test_a_flipped_sign_of_an_isotropic_solid(name: str) -> None:
    solid = IsotropicSolid(name="s", density=1100.0, bulk_modulus=3e9 - 1e7j, shear_modulus=1e9 - 1e7j)
    passivity.check_passive(solid, loss_tolerances={}, source="here")
    with pytest.raises(InputError, match=rf"{name}.*negative imaginary stiffness"):
        passivity.check_passive(replace(solid, **{name: getattr(solid, name).conjugate()}), loss_tolerances={},
                                source="here")


def test_isotropic_reduction_agrees_with_the_full_matrix() -> None:
    # An isotropic solid written as a transversely isotropic one: its 6 x 6 block has eigenvalues -3K'' (compression),
    # -2G'' (shear, twice) and -G'' (engineering shear, three times).
    bulk, shear = 3e9 - 2e7j, 1e9 - 5e7j
    full = replace(_initial(), c11=bulk + 4 * shear / 3, c33=bulk + 4 * shear / 3, c12=bulk - 2 * shear / 3,
                   c13=bulk - 2 * shear / 3, c44=shear)
    eigenvalues = np.linalg.eigvalsh(passivity.dissipation_matrix(full)[:6, :6])
    assert eigenvalues == pytest.approx([5e7, 5e7, 5e7, 6e7, 1e8, 1e8], rel=1e-9)
    solid = IsotropicSolid(name="s", density=1.0, bulk_modulus=bulk, shear_modulus=shear)
    assert passivity.smallest_dissipation(solid) == 2e7


def test_losses_exactly_on_the_boundary_are_neither_refused_nor_warned_of() -> None:
    # -C'' = v v^T with v = (a, a, b): singular by construction, so its zero eigenvalues are +-rounding. A material of
    # this kind is passive, and no tolerance but that of the arithmetic is needed to see it.
    random = np.random.default_rng(11)
    smallest = []
    for a, b in random.uniform(0.1, 1.0, size=(30, 2)) * math.sqrt(GPA):
        material = _with_losses(_initial(), c11=-a * a, c12=-a * a, c13=-a * b, c33=-b * b)
        smallest.append(passivity.smallest_dissipation(material))
        with warnings.catch_warnings():
            warnings.simplefilter("error", PassivityWarning)
            passivity.check_passive(material, loss_tolerances={}, source="here")
    assert min(smallest) < 0  # rounding did go below zero, so the allowance was needed


def test_unstable_stiffness_is_refused() -> None:
    with pytest.raises(InputError, match="positive definite"):
        passivity.check_passive(replace(_initial(), c13=120 * GPA), loss_tolerances={}, source="here")


@pytest.mark.parametrize(
    "material",
    [
        Fluid(name="f", density=-1.0, sound_speed=1500.0),
        Fluid(name="f", density=1000.0, sound_speed=1500.0, shear_viscosity=-1e-3),
        IsotropicSolid(name="s", density=1.0, bulk_modulus=-1e9, shear_modulus=1e9),
        IsotropicSolid(name="s", density=1.0, bulk_modulus=float("nan"), shear_modulus=1e9),
        IsotropicSolid(name="s", density=1.0, bulk_modulus=1e9, shear_modulus=complex(1e9, float("-inf"))),
    ],
)
def test_impossible_numbers_are_refused(material: Fluid | IsotropicSolid) -> None:
    with pytest.raises(InputError, match=r"a positive number|a finite number"):
        passivity.check_passive(material, loss_tolerances={}, source="here")
