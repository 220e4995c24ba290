"""The cavity's polynomial and the trap in it, against the closed forms of standing waves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0, j1

from geometry.chip import Chip
from geometry.shapes import with_shapes
from materials.kinds import Fluid
from workbench.acoustics.critical import critical_diameter
from workbench.design.cavity import OF_FLUID, Cavity, CavityField, NoCavity, cavity_field, cavity_of
from workbench.design.trapping import NoTrap, find_trap, follows_flow, largest_square, trap_focus_time
from workbench.fem.dual import Dual, dual_derivative
from workbench.fem.elements import gauss_lobatto
from workbench.fem.operators import assemble
from workbench.model.dimensions import parametrised
from workbench.model.particles import Particle, viscous_scattering
from workbench.model.problem import Problem

RADIUS, HEIGHT = 2e-3, 0.72e-3
WATER = Fluid(name="water", density=998.0, sound_speed=1482.0, shear_viscosity=1e-3)
#: As heavy as the water, so that nothing but sound moves it.
BEAD = Particle(name="bead", radius=5e-6, density=998.0, compressibility=2.2e-10)
WAVE = math.pi / HEIGHT
FREQUENCY = WAVE * WATER.sound_speed / (2.0 * math.pi)
AMPLITUDE = 1e5


def lines(length: float, cells: int) -> np.ndarray:
    """Nodes of elements of order 4."""
    inside = gauss_lobatto(4)
    return np.unique(np.round(np.concatenate([(k + inside) / cells for k in range(cells)]), 12)) * length


def cavity(particle: Particle | None = BEAD) -> Cavity:
    """A cavity whose height and radius move."""
    r, z = lines(RADIUS, 8), lines(HEIGHT, 3)
    return Cavity(np.zeros((r.size, z.size), dtype=np.int64),
                  Dual(r, np.outer([1.0, 0.0], r / RADIUS)), Dual(z, np.outer([0.0, 1.0], z / HEIGHT)), WATER,
                  particle, ("cavity.radius", "sidewall.thickness"), np.array([RADIUS, HEIGHT]), WAVE)


def field(pressure: object, by_radius: object = None, by_height: object = None,
          place: Cavity | None = None) -> CavityField:
    """The field of a pressure p(r, z), with its derivatives by radius and height at points that stay in place."""
    place = place or cavity()
    r, z = np.meshgrid(place.r.value, place.z.value, indexing="ij")
    slopes = np.zeros((*r.shape, 2), dtype=complex)
    for column, each in enumerate((by_radius, by_height)):
        if each is not None:
            slopes[:, :, column] = each(r, z)
    nothing = np.zeros(2)
    around = {"frequency": Dual(FREQUENCY, nothing), "width": Dual(RADIUS, np.array([1.0, 0.0])),
              "height": Dual(HEIGHT, np.array([0.0, 1.0])),
              **{name: Dual(getattr(WATER, name), nothing) for name in OF_FLUID}}
    return cavity_field(place, pressure(r, z).astype(complex), slopes, around, np.zeros(2), np.eye(2))


def plane(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    return AMPLITUDE * np.cos(WAVE * z) * (1.0 + 0.0 * r)


def plane_by_height(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    # The wave is stretched with the cavity: p(z / H). At a node, which moves along, nothing changes.
    return np.zeros_like(r)


def test_a_half_wave_traps_at_mid_height_with_the_stiffness_of_its_closed_form() -> None:
    found = field(plane, None, plane_by_height)
    assert found.unfitted < 1e-6  # three elements of order 4 hold a half wave to that
    energy = AMPLITUDE**2 / (4.0 * WATER.density * WATER.sound_speed**2)
    assert found.mean_energy_density.value == pytest.approx(energy, rel=1e-6)
    assert largest_square(found).value == pytest.approx(AMPLITUDE**2, rel=1e-6)
    trap = find_trap(found)
    assert trap.height.value == pytest.approx(0.5 * HEIGHT, rel=1e-9)
    # U = 4/3 pi a^3 E [f1 cos^2 kz - (3/2) Re f2 sin^2 kz]: F = 4 pi a^3 k E Phi sin 2kz.
    scattering = viscous_scattering(BEAD, WATER, FREQUENCY)
    stiffness = 8.0 * math.pi * BEAD.radius**3 * WAVE**2 * energy * scattering.contrast_factor
    assert trap.axial.value == pytest.approx(stiffness, rel=1e-5)
    depth = 4.0 * math.pi * BEAD.radius**3 * energy * scattering.contrast_factor
    assert trap.depth.value == pytest.approx(depth, rel=1e-6)


def test_focusing_takes_the_time_of_its_closed_form() -> None:
    found = field(plane)
    square = Dual(4.0, np.zeros(2))
    energy = 4.0 * AMPLITUDE**2 / (4.0 * WATER.density * WATER.sound_speed**2)
    contrast = viscous_scattering(BEAD, WATER, FREQUENCY).contrast_factor
    start, stop = (0.5 * HEIGHT + share * 0.5 * HEIGHT for share in (0.9, 0.1))
    # dz/dt = (2 Phi / 3 eta) a^2 k E sin 2kz: Barnkob et al. 2010, Lab Chip 10, 563.
    seconds = 3.0 * WATER.shear_viscosity / (4.0 * contrast * (WAVE * BEAD.radius) ** 2 * energy) * math.log(
        math.tan(WAVE * stop) / math.tan(WAVE * start))
    # Gauss's rule of 24 points over 1 / sin, and the force of a neutral bead.
    assert trap_focus_time(find_trap(found), square).value == pytest.approx(seconds, rel=1e-5)


def test_a_bead_below_the_critical_diameter_has_no_focusing_time() -> None:
    # sqrt(12 s / Phi) delta with s = 3/8 and Phi = 0.166.
    limit = critical_diameter(viscous_scattering(BEAD, WATER, FREQUENCY).contrast_factor, WATER, FREQUENCY)
    for factor, follows in ((0.8, True), (1.3, False)):
        small = replace(BEAD, radius=0.5 * factor * limit)
        words = follows_flow(find_trap(field(plane, place=cavity(small))))
        assert ("circulate with the streaming, however large the voltage" in words) is follows


def test_derivatives_follow_the_stretched_wave() -> None:
    found = field(plane, None, plane_by_height)
    trap = find_trap(found)
    assert trap.height.gradient == pytest.approx([0.0, 0.5], abs=1e-9)
    # Pressure as before, velocity with 1 / H: both parts of the energy at one frequency.
    own = 0.5 * found.mean_energy_density.value
    assert found.mean_energy_density.gradient[1] == pytest.approx(-2.0 * own / HEIGHT, rel=1e-5)
    dipole = viscous_scattering(BEAD, WATER, FREQUENCY).dipole.real
    mono = viscous_scattering(BEAD, WATER, FREQUENCY).monopole
    energy = AMPLITUDE**2 / (4.0 * WATER.density * WATER.sound_speed**2)

    def stiffness(height: float) -> float:
        share = (HEIGHT / height) ** 2
        return (8.0 * math.pi * BEAD.radius**3 * (math.pi / height) ** 2 * energy
                * (mono / 3.0 + 0.5 * dipole * share))

    step = 1e-4 * HEIGHT
    exact = (stiffness(HEIGHT + step) - stiffness(HEIGHT - step)) / (2.0 * step)
    assert trap.axial.gradient[1] == pytest.approx(exact, rel=1e-4)
    assert trap.axial.gradient[0] == pytest.approx(0.0, abs=1e-9 * abs(trap.axial.value) / RADIUS)


def test_squares_of_a_pressure_that_grows_grow_twice_as_fast() -> None:
    # d |p|^2 = 2 Re p* dp, whatever the phase: only the part in phase counts.
    found = field(lambda r, z: plane(r, z) * np.exp(0.7j), lambda r, z: plane(r, z) * np.exp(0.7j) * (3.0 + 5.0j))
    energy, trap = found.mean_energy_density, find_trap(found)
    # At constant places the cavity's radius moves nothing in a plane wave.
    assert energy.gradient[0] == pytest.approx(6.0 * energy.value, rel=1e-6)
    assert trap.axial.gradient[0] == pytest.approx(6.0 * trap.axial.value, rel=1e-5)


def test_a_radial_mode_is_even_and_traps_where_its_closed_form_does() -> None:
    across = 3.8317059702 / RADIUS
    up = math.sqrt((2.0 * math.pi * FREQUENCY / WATER.sound_speed) ** 2 - across**2)

    def mode(r: np.ndarray, z: np.ndarray) -> np.ndarray:
        return AMPLITUDE * j0(across * r) * np.sin(up * (z - 0.5 * HEIGHT))

    # Only a bead that is heavier than water tells one place of the nodal plane from another.
    heavy = replace(BEAD, density=1100.0)
    found = field(mode, place=cavity(heavy))
    assert found.unfitted < 1e-5
    scattering = viscous_scattering(heavy, WATER, FREQUENCY)
    r, z = np.meshgrid(np.linspace(0.0, RADIUS, 401), np.linspace(0.0, HEIGHT, 201), indexing="ij")
    square = mode(r, z) ** 2
    slopes = ((AMPLITUDE * across * j1(across * r) * np.sin(up * (z - 0.5 * HEIGHT))) ** 2
              + (AMPLITUDE * up * j0(across * r) * np.cos(up * (z - 0.5 * HEIGHT))) ** 2)
    velocity = slopes / (2.0 * math.pi * FREQUENCY * WATER.density) ** 2
    potential = BEAD.volume * (scattering.monopole / 4.0 * WATER.compressibility * square
                               - 0.375 * scattering.dipole.real * WATER.density * velocity)
    i, j = np.unravel_index(int(np.argmin(potential)), potential.shape)
    trap = find_trap(found)
    assert trap.radius.value == pytest.approx(r[i, j], abs=RADIUS / 400)
    assert trap.height.value == pytest.approx(z[i, j], abs=HEIGHT / 200)
    assert trap.depth.value == pytest.approx(potential.max() - potential.min(), rel=1e-3)


def test_what_does_not_lead_to_the_trap_is_said() -> None:
    # A quarter wavelength above mid-height of a low cavity there is a wall.
    low = replace(cavity(), wave_number=WAVE)
    found = field(plane, place=low)
    short = replace(found, around={**found.around, "frequency": found.around["frequency"] * 0.8})
    with pytest.raises(NoTrap, match="there is a wall"):
        trap_focus_time(find_trap(short), Dual(1.0, np.zeros(2)))
    heavy = replace(BEAD, density=19300.0)
    with pytest.raises(NoTrap, match="does not get there"):
        trap_focus_time(find_trap(field(plane, place=cavity(replace(heavy, density=500.0)))), Dual(1e-9, np.zeros(2)))


def test_numbers_with_derivatives_follow_the_rules() -> None:
    x, y = Dual(3.0, np.array([1.0, 0.0])), Dual(5.0, np.array([0.0, 1.0]))
    found = (x * y + x**2.0 - y * 2.0) / y
    value, step = (lambda a, b: (a * b + a * a - 2.0 * b) / b), 1e-6
    assert found.value == pytest.approx(value(3.0, 5.0))
    assert found.gradient == pytest.approx([(value(3.0 + step, 5.0) - value(3.0 - step, 5.0)) / (2.0 * step),
                                            (value(3.0, 5.0 + step) - value(3.0, 5.0 - step)) / (2.0 * step)], rel=1e-8)
    assert (x**0.5 * x**0.5).gradient == pytest.approx(x.gradient)
    # Arrays broadcast, and matrix products follow the rule of products.
    matrix = np.arange(6.0).reshape(2, 3)
    row, column = Dual(matrix, np.ones((2, 2, 3))), x * np.arange(3.0) + y
    assert (row @ column).gradient == pytest.approx(np.ones((2, 2, 3)) @ column.value
                                                    + column.gradient @ matrix.T)
    assert (np.ones(2) @ row @ np.ones(3)).gradient == pytest.approx([6.0, 6.0])
    assert (row.T[2] - 1.0).value == pytest.approx([1.0, 4.0])
    # Differences of sixth order leave rounding only.
    assert float(dual_derivative(lambda t: np.array(t**3.5), 2.0)) == pytest.approx(3.5 * 2.0**2.5, rel=1e-11)


def test_a_cavity_that_a_length_deforms_has_no_such_field(small_chip: Chip, filled: Problem) -> None:
    """It would be that of the cylinder it no longer is; the side that a barrel moves is not the cavity's."""
    chip = with_shapes(small_chip, ["sidewall.draft", "sidewall.barrel"])
    flexed = parametrised(filled, chip, (), {"sidewall.draft": (-0.1, 0.1), "sidewall.barrel": (-5e-5, 5e-5)})
    operators = assemble(flexed.mesh, flexed.terms)
    assert cavity_of(operators, chip, WATER, BEAD, [], FREQUENCY).lengths == ()
    assert cavity_of(operators, chip, WATER, BEAD, ["sidewall.barrel"], FREQUENCY).lengths == ("sidewall.barrel",)
    with pytest.raises(NoCavity, match=r"upright walls, and this one changes its shape with sidewall\.draft$"):
        cavity_of(operators, chip, WATER, BEAD, ["sidewall.draft", "sidewall.barrel"], FREQUENCY)
