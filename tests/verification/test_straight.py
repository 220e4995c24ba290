"""Straight sections against closed forms: transfer matrices, modes of a channel, parity, and rings of large radius."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support import Held, fluid_modes, plate_below_a_layer

from geometry.measure import ABOUT_AXIS, Measure, Parity, Straight
from geometry.mesh import SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, solve_full
from workbench.model.problem import problem, with_boundary_layers
from workbench.physics import electrodes, fluid, piezoelectric, solid
from workbench.physics.boundary_layer import ViscousBoundaryLayer

LENGTH = 0.02
GLASS = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=44e9 - 0.2e9j, shear_modulus=29e9 - 0.3e9j)
WATER = Fluid(name="water", density=997.0, sound_speed=1497.0, shear_viscosity=0.890e-3)
#: Region, left, right, bottom and top (m) of a rectangle.
Piece = tuple[str, float, float, float, float]

EVEN, ODD, NONE = Parity.EVEN, Parity.ODD, Parity.NONE


def section(
    pieces: list[Piece], measure: Measure, *,
    live: tuple[tuple[float, float], ...] = (), shift: float = 0.0,
) -> Section:
    """A section of rectangles (region, left, right, bottom, top), metres, shifted along x, with the electrodes on the
    whole of the transducer's faces unless the pieces of the `live` one are given."""
    left, right, bottom, top = next(piece[1:] for piece in pieces if piece[0] == "transducer")
    live = live or ((left, right),)
    return Section(
        tuple(Rectangle(name, a + shift, b + shift, low, high) for name, a, b, low, high in pieces),
        (*(Electrode("electrode_live", a + shift, b + shift, bottom) for a, b in live),
         Electrode("electrode_ground", left + shift, right + shift, top)), measure)


def meshed(cut: Section, edge: float, order: int = 4) -> SectionMesh:
    """A mesh of elements no longer than `edge` (m)."""
    return mesh_section(cut, MeshSize(dict.fromkeys(cut.regions, 1.0), 1.0 / edge, 1.0, order))


def solved(
    cut: Section, materials: Mapping[str, Material], frequency: NDArray[np.float64], edge: float, *,
    layers: bool = False,
) -> Solution:
    """The solution of the base model, with boundary layers in the cavity or without."""
    made = problem(meshed(cut, edge), materials, (1e5, 1e7))
    made = with_boundary_layers(made) if layers else made
    return solve_full(assemble(made.mesh, made.terms), frequency, made.values)


@pytest.fixture(scope="module")
def pzt(reference_materials: Callable[[str], dict[str, Material]]) -> Piezoelectric:
    found = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(found, Piezoelectric)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Transfer matrix


def test_between_planes_of_symmetry_a_stack_is_the_transfer_matrix(pzt: Piezoelectric) -> None:
    # Rollers at both sides: u_x = 0 and fields of z alone solve plane strain exactly, Poisson's ratio and e31 included.
    width, thick, depth = 0.5e-3, 1e-3, 0.7e-3
    frequency = np.linspace(0.4e6, 4e6, 25)
    stack = [("transducer", 0.0, width, 0.0, thick), ("substrate", 0.0, width, thick, thick + depth)]
    found = solved(section(stack, Straight(LENGTH, EVEN, EVEN)), {"transducer": pzt, "substrate": GLASS},
                   frequency, 0.1e-3).impedance
    # The oracle divides by the area of a disc: give it the radius of the plate's area.
    expected = plate_below_a_layer(pzt, thick, GLASS, depth, np.sqrt(width * LENGTH / np.pi), frequency,
                                   complex(GLASS.bulk_modulus + 4.0 * GLASS.shear_modulus / 3.0))
    error = np.abs(np.log(found / expected)).max()
    print(f"stack between rollers: ln Z off by {error:.1e}")
    # Order 4 with 9 elements on the shortest wavelength, 0.94 mm in the plate: measured 4e-10.
    assert error < 1e-7


# --------------------------------------------------------------------------------------------------------------------
# Channels

WIDTH, HEIGHT = 380e-6, 160e-6


def channel(pzt: Piezoelectric, measure: Measure, left: float, edge: float) -> tuple[FullOperators, dict[str, complex]]:
    """Water between walls of glass that are held, from x = `left` to half the width."""
    half = 0.5 * WIDTH
    wall, outer = (half, half + HEIGHT), half + HEIGHT
    begin = -outer if left < 0.0 else 0.0
    pieces = [("transducer", begin, outer, -2 * HEIGHT, -HEIGHT), ("substrate", begin, outer, -HEIGHT, 0.0),
              ("cavity", left, half, 0.0, HEIGHT), ("sidewall", *wall, 0.0, HEIGHT),
              ("superstrate", begin, outer, HEIGHT, 2 * HEIGHT)]
    pieces += [("sidewall", -wall[1], -wall[0], 0.0, HEIGHT)] if left < 0.0 else []
    walls = {"cavity|substrate": "substrate", "cavity|sidewall": "sidewall", "cavity|superstrate": "superstrate"}
    terms = [piezoelectric.PiezoelectricSolid("transducer", "pzt"), fluid.AcousticFluid("cavity", "water"),
             electrodes.ElectrodePotential("electrode_live", "electrode_ground")]
    for boundary, region in walls.items():
        terms += [solid.ElasticSolid(region, "glass"), fluid.SolidFluidContact(boundary, region, "cavity"),
                  ViscousBoundaryLayer(boundary, region, "cavity", "water"), Held("u_r", boundary),
                  Held("u_z", boundary)]
    live = ((0.1e-3, outer),) if getattr(measure, "left", NONE) is ODD else ()
    operators = assemble(meshed(section(pieces, measure, live=live), edge), tuple(dict.fromkeys(terms)))
    values = {f"{m.name}.{key}": value for m in (pzt, GLASS, WATER) for key, value in m.parameters().items()}
    return operators, {**values, "water.shear_viscosity": 0.890e-3}


#: Modes (n across, m up) of a rigid channel that an even plane, an odd one or none admits.
ADMITTED = {EVEN: [(0, 1), (2, 0), (2, 1), (4, 0)], ODD: [(1, 0), (1, 1), (3, 0), (3, 1)],
            NONE: [(1, 0), (0, 1), (1, 1), (2, 0)]}


@pytest.mark.parametrize("parity", ADMITTED)
def test_a_rigid_channel_has_the_modes_of_a_rectangle(
    parity: Parity, pzt: Piezoelectric, rows: Callable[..., NDArray[np.int64]]
) -> None:
    left = -0.5 * WIDTH if parity is NONE else 0.0
    operators, values = channel(pzt, Straight(LENGTH, parity), left, 60e-6 if parity is NONE else 40e-6)
    expected = np.array([1497.0**2 * np.pi**2 * ((n / WIDTH) ** 2 + (m / HEIGHT) ** 2) for n, m in ADMITTED[parity]])
    found = fluid_modes(operators, values | {"water.shear_viscosity": 1e-30}, rows(operators, "cavity", "p"), 1e7)
    error = max(np.abs(found / each - 1.0).min() for each in expected)
    others = found.real[(found.real > 1e12) & (found.real < expected.max() * 1.01)]
    print(f"rigid channel, {parity.value}: w^2 off by {error:.1e}; {others.size} modes up to the last")
    # Order 4 with k h = 1.3 at most leaves 2.3e-7 of w^2, and 6e-9 with 0.94: (k h)^8 of the order.
    assert error < 1e-6
    assert all(np.abs(each / admitted_by(parity) - 1.0).min() < 1e-6 for each in others)


def admitted_by(parity: Parity) -> NDArray[np.float64]:
    """Squared angular frequencies (rad/s)^2 of the modes of a rigid channel that the parity admits, high ones too."""
    across = {EVEN: range(0, 12, 2), ODD: range(1, 12, 2), NONE: range(12)}[parity]
    return np.array([1497.0**2 * np.pi**2 * ((n / WIDTH) ** 2 + (m / HEIGHT) ** 2)
                     for n in across for m in range(6) if n + m])


def test_a_straight_channel_of_380_by_160_um_has_the_quality_421(
    pzt: Piezoelectric, rows: Callable[..., NDArray[np.int64]]
) -> None:
    # Half a wave across the width, moving along floor and lid: 1 / Q = delta / H, and the side walls, which it does
    # not move along, do nothing to first order.
    operators, values = channel(pzt, Straight(1.0, ODD), 0.0, 40e-6)
    omega = 1497.0 * np.pi / WIDTH
    modes = fluid_modes(operators, values, rows(operators, "cavity", "p"), omega)
    found = np.sqrt(modes[np.abs(modes - omega**2).argmin()])
    quality = -0.5 * found.real / found.imag
    delta = np.sqrt(2.0 * 0.890e-3 / (997.0 * omega))
    print(f"channel: Q {quality:.2f}, H / delta = {HEIGHT / delta:.2f}, at {omega / 2e6 / np.pi:.3f} MHz")
    # The root of a squared frequency is linear in delta to 2 delta / H = 5e-3.
    assert quality == pytest.approx(421.0, rel=4e-3)
    assert quality == pytest.approx(HEIGHT / delta, rel=4e-3)


# --------------------------------------------------------------------------------------------------------------------
# A chip: plate, glue, base, walls, channel, lid

#: Left, right, bottom and top (mm) of the right half, for a plate wider than the chip.
HALF: list[Piece] = [
    ("transducer", 0.0, 1.0, 0.0, 0.5), ("bond", 0.0, 0.7, 0.5, 0.55), ("substrate", 0.0, 0.7, 0.55, 0.8),
    ("cavity", 0.0, 0.19, 0.8, 0.96), ("sidewall", 0.19, 0.7, 0.8, 0.96), ("superstrate", 0.0, 0.7, 0.96, 1.2)]
EPOXY = IsotropicSolid(name="epoxy", density=1150.0, bulk_modulus=5e9 - 0.1e9j, shear_modulus=1.6e9 - 60e6j)
PLACES: list[Piece] = [(name, 1e-3 * a, 1e-3 * b, 1e-3 * low, 1e-3 * high) for name, a, b, low, high in HALF]
GAP = 0.3e-3


def filled(pzt: Piezoelectric) -> dict[str, Material]:
    return {"transducer": pzt, "bond": EPOXY, "substrate": GLASS, "sidewall": GLASS, "superstrate": GLASS,
            "cavity": WATER}


def whole() -> list[Piece]:
    """Both halves of the chip."""
    return [(name, -right, right if left == 0.0 else -left, low, high) for name, left, right, low, high in PLACES] + [
        piece for piece in PLACES if piece[1] > 0.0]


def test_halves_by_parity_equal_the_whole(pzt: Piezoelectric) -> None:
    frequency, materials = np.array([1.3e6, 1.97e6, 2.6e6]), filled(pzt)
    half = solved(section(PLACES, Straight(LENGTH, EVEN)), materials, frequency, 0.1e-3, layers=True)
    both = solved(section(whole(), Straight(LENGTH)), materials, frequency, 0.1e-3, layers=True)
    even = np.abs(np.log(half.impedance / both.impedance)).max()
    # Split electrodes: the voltage on the right piece alone is half of the even and half of the odd answer.
    live = ((GAP, 1e-3),)
    parts = [solved(section(PLACES, Straight(LENGTH, parity), live=live), materials, frequency, 0.1e-3, layers=True)
             for parity in (EVEN, ODD)]
    right = whole_with_one_electrode(materials, frequency)
    expected = 0.25 * (1.0 / parts[0].impedance + 1.0 / parts[1].impedance)
    one = np.abs(np.log(1.0 / right / expected)).max()
    print(f"halves against the whole: even {even:.1e}, one of two electrodes {one:.1e}; residual "
          f"{both.residual.max():.1e}")
    assert even < 1e-9
    assert one < 1e-9


def whole_with_one_electrode(
    materials: Mapping[str, Material], frequency: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Impedance of the whole chip with a voltage on the right piece of a split electrode, the left one at ground."""
    made = section(whole(), Straight(LENGTH), live=((GAP, 1e-3),))
    mesh = meshed(replace(made, electrodes=(*made.electrodes,
                                            Electrode("electrode_ground", -1e-3, -GAP, 0.0))), 0.1e-3)
    posed = with_boundary_layers(problem(mesh, materials, (1e5, 1e7)))
    return solve_full(assemble(mesh, posed.terms), frequency, posed.values).impedance


@pytest.mark.parametrize(("pieces", "order"), [(PLACES, 1.0), (whole(), 2.0)], ids=["one half", "whole"])
def test_a_ring_of_large_radius_tends_to_the_straight_chip(
    pieces: list[Piece], order: float, pzt: Piezoelectric
) -> None:
    # The section turned about an axis at a distance R, per length 2 pi R: off by 1 / R. A section that is its own
    # mirror image cannot tell on which side the axis is, so that only even powers of 1 / R are left.
    frequency, materials = np.array([1.31e6, 1.97e6, 2.6e6]), filled(pzt)
    straight = solved(section(pieces, Straight(1.0)), materials, frequency, 0.15e-3, layers=True).impedance
    radii, errors = 0.05 * 2.0 ** np.arange(3), []
    for radius in radii:
        ring = section(pieces, ABOUT_AXIS, shift=radius)
        # The middle of the plate is on the circle of the radius R.
        middle = radius + 0.5 * (pieces[0][1] + pieces[0][2])
        found = solved(ring, materials, frequency, 0.15e-3, layers=True).impedance * 2.0 * np.pi * middle
        errors.append(np.abs(np.log(found / straight)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"rings of R = {radii.tolist()} m: ln Z off by {[f'{e:.2e}' for e in errors]}, orders {orders.round(3)}")
    assert orders == pytest.approx(order, abs=0.05)
    assert errors[-1] < 1e-2
