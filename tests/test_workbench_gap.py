"""A gap in an electrode: orders of its potentials against direct solves and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.special import jv, lpmv, spherical_jn

from geometry.chip import Chip, read_chip
from geometry.features import Feature
from materials.kinds import Piezoelectric
from workbench.fem.gap import Gap, electrode_dofs
from workbench.fem.half_space import HalfSpace, order_factors
from workbench.fem.operators import assemble
from workbench.fem.patch import UP, Patch, patch_forms
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.model.problem import Problem, build, fill
from workbench.simulation.features import (
    ElectrodeGap,
    Part,
    RigidPart,
    charge_change,
    compliance_of,
    driven_on,
    mesh_lines,
    part_of,
)

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Below the first mode of a disc of 12 mm, and in the modes of an order beside it.
FREQUENCIES = np.array([1e3, 150e3])
STATIC = FREQUENCIES[:1]
BESIDE = Feature("gap", "transducer", "top", 3e-3, 2e-3)
CHIPS = Path(__file__).resolve().parents[1] / "geometry" / "chips"


@pytest.fixture(scope="module")
def disc() -> Chip:
    """A disc of 12 mm, 2.02 mm thick."""
    chip = read_chip(CHIPS / "free_disc_25x2.toml")
    (layer,) = chip.layers
    return replace(chip, layers=(replace(layer, radius=replace(layer.radius, value=6e-3)),))


def posed_for(disc: Chip, *features: Feature) -> tuple[Problem, list[Part]]:
    """The problem with the lines of nodes of `features`, and their parts."""
    parts = [part_of(feature) for feature in features]
    radii, levels = mesh_lines(replace(disc, features=features), parts)
    return build(fill(disc), band=(100e3, 200e3), radii=radii, levels=levels), parts


def change_of(posed: Problem, parts: list[Part], frequencies: Real = FREQUENCIES) -> tuple[Complex, int]:
    """The relative change (n,) of the charge by `parts`, and the number of orders."""
    operators = assemble(posed.mesh, posed.terms)
    solution = System(operators, posed.values).solutions(frequencies)
    driven = driven_on(posed, operators, parts, solution.states, frequencies)
    between = compliance_of(posed, [part.patch for part in parts], np.array([part.angle for part in parts]),
                            frequencies)
    return charge_change(parts, frequencies, driven, between.total) / solution.charge, between.orders


def lacking_electrode(posed: Problem, gap: Gap) -> Complex:
    """The relative change (n,) of the charge if the potentials within a gap about the axis are unknowns."""
    operators = assemble(posed.mesh, posed.terms)
    freed = replace(operators.prescribing(electrode_dofs(operators, gap)[0]), prescribed=1)
    one, other = (System(each, posed.values).solutions(FREQUENCIES).charge for each in (operators, freed))
    return other / one - 1.0


def test_hankel_transforms_of_the_functions_are_spherical_bessel_functions() -> None:
    number = 2.7
    for degree, wave, _ in Gap("transducer", True, 0.0, 1.0, degree=5).functions:
        norm = (degree + wave) * (-1.0) ** ((degree - wave - 1) // 2) * lpmv(wave, degree - 1, 0.0)
        found = quad(lambda r, q=wave, n=degree: r * lpmv(q, n, math.sqrt(1.0 - r * r)) * jv(q, number * r), 0, 1)[0]
        assert found / norm == pytest.approx(spherical_jn(degree, number) / number, rel=1e-9)


def test_amplitudes_of_orders_add_up_to_the_function() -> None:
    """The first function is the root of 1 - rho^2; 300 orders, whose amplitudes fall with m^-1.5, leave 1e-3."""
    gap = Gap("transducer", True, 2e-3, 0.8e-3)
    radius, angle = np.array([2.3e-3]), 0.15
    total = sum(gap.potentials(radius, order)[0] * np.where([is_sine for *_, is_sine in gap.functions],
                                                            math.sin(order * angle), math.cos(order * angle))
                for order in range(300))
    place = (radius[0] * np.exp(1j * angle) - gap.distance) / gap.radius
    root = math.sqrt(1.0 - abs(place) ** 2)
    scale = total[0] / root
    assert scale == pytest.approx(0.03 / gap.radius, rel=2e-3)
    # P_2^1 = -3 z rho, N = 3 P_1^1(0) = -3: the second one is z x, its sine z y.
    assert total[[1, 6]] / scale == pytest.approx(root * np.array([place.real, place.imag]), rel=1e-2)


def test_orders_of_gaps_in_a_half_space_add_up() -> None:
    """Total and orders are independent formulas. The share of higher orders falls with the number of orders."""
    gaps = [Gap("transducer", True, 2e-3, 0.4e-3), Gap("transducer", True, 2.4e-3, 0.5e-3)]
    space = HalfSpace.of(gaps, np.array([0.3, 1.2]))
    angles = np.repeat([0.3, 1.2], len(gaps[0].functions))
    off = []
    for count in (20, 40):
        total = sum(space.order(order) * order_factors(order, angles, space.is_odd) for order in range(count))
        off.append(np.abs(total - space.total)[0].max() / np.abs(space.total[0]).max())
    # Half of the rest is that beyond the wave number count / distance, where the mean of j_l^2 is 1 / (2 k^2).
    assert off[0] < 0.25
    assert off[1] == pytest.approx(0.5 * off[0], rel=0.3)
    # The first function of a gap has pi / 6, less the wave numbers below the first.
    assert space.total[0, 0, 0] * gaps[0].radius / 0.03**2 == pytest.approx(math.pi / 6.0, rel=0.05)


def test_a_gap_about_the_axis_is_an_electrode_that_lacks_there(disc: Chip) -> None:
    """The same mesh with free potentials: within 1e-3 with functions up to l = 3, to 5 within 3e-4."""
    posed, (part,) = posed_for(disc, replace(BESIDE, distance=0.0))
    assert isinstance(part, ElectrodeGap)
    exact = lacking_electrode(posed, part.patch)
    off = []
    for degree in (1, 3, 5):
        found, orders = change_of(posed, [replace(part, patch=replace(part.patch, degree=degree))])
        assert orders == max(degree, 1)
        off.append(np.abs(found / exact - 1.0).max())
    assert off[2] <= off[1] <= off[0]
    assert off[1] < 1e-3
    assert off[2] < 3e-4


def test_a_mass_below_a_gap_about_the_axis_has_its_coupling(disc: Chip) -> None:
    """Free potentials and the compliance of the mass in one direct solve of order 0. The tolerance is as above."""
    frequency = np.array([150e3])
    posed, (gap, mass) = posed_for(disc, replace(BESIDE, distance=0.0), Feature(
        "mass", "transducer", "bottom", 0.0, 2e-3, mass=20e-6))
    assert isinstance(gap, ElectrodeGap)
    assert isinstance(mass, RigidPart)
    operators = assemble(posed.mesh, posed.terms)
    freed = replace(operators.prescribing(electrode_dofs(operators, gap.patch)[0]), prescribed=1)
    system, form = System(freed, posed.values), patch_forms(freed, mass.patch, 0)[:, UP]
    solution, factor = system.solutions(frequency), system.factored(150e3)[1]
    compliance = form[:-1] @ factor.solve(form[:-1].astype(complex))[0]
    stiffness = mass.dynamic_stiffness(frequency)
    moved = -stiffness * (form @ solution.states) ** 2 / (1.0 + stiffness * compliance)
    before = System(operators, posed.values).solutions(frequency).charge
    found, _ = change_of(posed, [gap, mass], frequency)
    exact = (solution.charge + moved) / before - 1.0
    alone, _ = change_of(posed, [gap], frequency)
    assert found == pytest.approx(exact, rel=1e-3)
    # The mass changes the charge by 0.4 % more than without the gap.
    added, expected = found - alone, exact - (solution.charge / before - 1.0)
    assert added == pytest.approx(expected, rel=5e-4)
    assert np.abs(change_of(posed, [mass], frequency)[0] / expected - 1.0).max() > 2e-3


def test_a_gap_beside_the_axis_has_the_closed_form_of_a_half_space(disc: Chip) -> None:
    """Without piezoelectric coupling, -(4/3) sqrt(eps33^3 / eps11) a^3 / h^2 of capacitance.

    A plate of half the thickness 2 a has a correction of the order (a / h)^3, below 2 % for a = 1 mm and 2.02 mm.
    """
    posed, parts = posed_for(disc, BESIDE)
    name = next(material.name for material in posed.materials.values() if isinstance(material, Piezoelectric))
    values = {**posed.values, **{f"{name}.{key}": 0j for key in ("e31", "e33", "e15")}}
    found, _ = change_of(replace(posed, values=values), parts, STATIC)
    eps11, eps33 = (values[f"{name}.{key}"] for key in ("eps11", "eps33"))
    radius, height, outer = 1e-3, disc.transducer.thickness.value, disc.transducer.radius.value
    expected = -(4.0 / 3.0) * np.sqrt(eps33 / eps11) * radius**3 / (height * math.pi * outer**2)
    assert found == pytest.approx(np.full(1, expected), rel=0.02)


def test_a_gap_changes_the_same_beside_the_axis_and_about_it(disc: Chip) -> None:
    """At 1 kHz the field is uniform. The mesh about the axis is off by 0.7 %, that beside it by 0.1 %."""
    found = [change_of(*posed_for(disc, replace(BESIDE, distance=distance)), STATIC)[0][0] for distance in (0.0, 3e-3)]
    assert found[0] == pytest.approx(found[1], rel=1e-2)


def test_a_small_gap_changes_the_charge_with_the_cube_of_its_radius(disc: Chip) -> None:
    small, large = (change_of(*posed_for(disc, replace(BESIDE, distance=1.5e-3, diameter=size)), STATIC)[0][0]
                    for size in (0.5e-3, 1e-3))
    # The next term has the relative size (a / h)^3 = 1.5 %.
    assert large / small == pytest.approx(8.0, rel=0.03)


def test_a_mirrored_chip_with_a_gap_and_a_mass_has_the_same_charge(disc: Chip) -> None:
    """And a part of no mass changes nothing beside the gap."""
    mass = Feature("mass", "transducer", "bottom", 3e-3, 2e-3, angle=2.0, mass=2e-6)
    posed, parts = posed_for(disc, BESIDE, mass)
    band = np.array([150e3])
    both, _ = change_of(posed, parts, band)
    patch = parts[1].patch
    assert isinstance(patch, Patch)
    mirrored, _ = change_of(posed, [replace(part, angle=-part.angle) for part in parts], band)
    assert mirrored == pytest.approx(both, rel=1e-6)
    alone, _ = change_of(posed, [parts[0]], band)
    weightless, _ = change_of(posed, [parts[0], RigidPart(patch, 2.0)], band)
    assert weightless == pytest.approx(alone, rel=2e-3)


def test_a_mistake_in_a_gap_is_named(disc: Chip) -> None:
    reference = read_chip(CHIPS / "reference_chip.toml")
    mass = Feature("mass", "transducer", "top", 3.5e-3, 2e-3, mass=1e-6)
    for chip, features, field, words in (
        (reference, (replace(BESIDE, region="substrate"),), "layer", "a transducer, whose electrode"),
        (disc, (replace(BESIDE, diameter=26e-3, distance=0.0),), "diameter", "at most 12 mm"),
        (disc, (replace(BESIDE, distance=5.5e-3),), "distance", "0 mm to 5 mm.*electrode on the top"),
        (disc, (mass, BESIDE), "distance", "do not overlap"),
    ):
        with pytest.raises(InputError, match=words) as error:
            replace(chip, features=features)
        assert error.value.field == f"features[{len(features) - 1}].{field}"
    with pytest.raises(InputError, match=r"features\[0\].diameter: received '0.1 mm'.*above 0.2"):
        posed_for(disc, replace(BESIDE, diameter=0.1e-3))
    # A gap may lie under a layer.
    assert replace(reference, features=(replace(BESIDE, distance=2e-3, diameter=1e-3),)).features
