"""Necks in a side wall against the closed form of a disc of fluid, and against a wall that yields as much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq, root
from scipy.special import jv
from support import fluid_modes

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Fluid as FluidMaterial
from materials.kinds import Material
from materials.registry import Registry
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem
from workbench.physics import electrodes, fluid, piezoelectric
from workbench.physics.port_necks import ADMISSIBLE, PortNecks
from workbench.physics.term import Integral, Monomial, Product, Term

DENSITY, SPEED, RADIUS = 998.0, 1482.0, 1e-3
TERM = PortNecks("cavity|sidewall", "sidewall", "cavity", "water", "necks")
NAMES = ("necks.share", "necks.length", "necks.resistance", "necks.stiffness")


@dataclass(frozen=True)
class YieldingWall(Term):
    """A wall that yields to the fluid by the displacement C p along its normal: - C p q over the wall."""

    def integrals(self) -> tuple[Integral, ...]:
        return (Integral(Monomial(-1.0, 0, (("wall.compliance", 1),)), TERM.boundary, (Product("p", "p"),), TERM.solid,
                         TERM.fluid),)


def necks(share: float, length: float, resistance: float, stiffness: float = 0.0) -> dict[str, complex]:
    return dict(zip(NAMES, map(complex, (share, length, resistance, stiffness)), strict=True))


@pytest.fixture(scope="module")
def disc_of_water(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    reference_materials: Callable[[str], dict[str, Material]], rows: Callable[..., NDArray[np.int64]],
) -> Callable[[dict[str, complex], float], NDArray[np.complex128]]:
    """w^2 of the modes of water in a rigid cavity with necks, which are as they are at a frequency."""
    chip = stacked([("transducer", 0.4e-3, 1.4e-3, None), ("layer", 0.4e-3, 1.4e-3, None),
                    ("sidewall", 0.72e-3, 1.4e-3, RADIUS), ("superstrate", 0.4e-3, 1.4e-3, None)], band=(1e5, 3e6))
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    operators = assemble(uniform_mesh(chip, 0.1e-3), (
        piezoelectric.PiezoelectricSolid("transducer", "pzt"),
        electrodes.ElectrodePotential("electrode_live", "electrode_ground"),
        fluid.AcousticFluid("cavity", "water"), TERM))
    known = {f"pzt.{name}": value for name, value in pzt.parameters().items()} | {
        "water.density": DENSITY, "water.sound_speed": SPEED}
    pressure = rows(operators, "cavity", "p")
    return lambda values, omega: fluid_modes(operators, {**known, **values}, pressure, omega)


@pytest.mark.parametrize(("share", "length"), [(0.002, 4e-4), (0.05, 4e-4), (0.2, 2e-4)])
def test_a_disc_with_open_necks_has_the_modes_of_helmholtz_and_of_bessel(
    share: float, length: float, disc_of_water: Callable[..., NDArray[np.complex128]]
) -> None:
    # d_r p = rho w^2 xi = -s / l p at any frequency: k J1(k R) / J0(k R) = s / l; the lowest is Helmholtz's, whose
    # pressure is the same all over: w^2 = s A c^2 / (l V), A / V = 2 / R.
    def closed(x: float) -> float:
        return float(x * jv(1, x) - share * RADIUS / length * jv(0, x))

    for low, high in ((1e-6, 2.4048), (3.0, 5.52)):
        expected = (SPEED * float(brentq(closed, low, high, xtol=1e-13)) / RADIUS) ** 2
        found = disc_of_water(necks(share, length, 0.0), expected**0.5)
        closest = complex(found[np.abs(found - expected).argmin()])
        print(f"s {share}, l {length}: {expected**0.5 / 2e6 / np.pi:.4f} MHz, off by {closest / expected - 1.0:.1e}")
        assert closest == pytest.approx(expected, rel=1e-4)  # (k h)^4 / 720 with k h = 0.4
        if high < 2.5:
            helmholtz = 2.0 * share * SPEED**2 / (length * RADIUS)
            assert expected == pytest.approx(helmholtz, rel=0.3 * share * RADIUS / length)
        else:
            assert expected > 1.0005 * (3.8317 * SPEED / RADIUS) ** 2


@pytest.mark.parametrize("values", [necks(0.1, 4e-4, 3e5), necks(0.2, 2e-4, 1e6, 5e12), necks(0.05, 1e-4, 0.0, 5e12)])
def test_friction_and_what_is_behind_enter_as_a_wall_impedance(
    values: dict[str, complex], disc_of_water: Callable[..., NDArray[np.complex128]]
) -> None:
    rigid = 3.8317 / RADIUS
    omega = SPEED * rigid
    share, length, resistance, stiffness = values.values()
    given = DENSITY * omega**2 * share / (stiffness - omega**2 * DENSITY * length - 1j * omega * resistance)

    def residual(x: NDArray[np.float64]) -> list[float]:
        k = complex(*x) * rigid
        value = (k * jv(1, k * RADIUS) + given * jv(0, k * RADIUS)) / rigid
        return [value.real, value.imag]

    solved = root(residual, [1.0, 0.0], tol=1e-13)
    assert solved.success
    expected = SPEED**2 * (complex(*solved.x) * rigid) ** 2
    found = disc_of_water(values, omega)
    closest = complex(found[np.abs(found - expected).argmin()])
    print(f"{values}: w^2 / w0^2 {closest / omega**2:.6f}, closed form {expected / omega**2:.6f}")
    assert abs(expected / omega**2 - 1.0) > 0.01
    assert closest == pytest.approx(expected, rel=1e-4)
    assert (expected.imag < 0.0) == (resistance.real > 0.0)


def test_at_each_frequency_it_is_a_wall_that_yields_as_much(filled: Problem) -> None:
    model = filled.with_terms((TERM,), necks(0.1, 4e-4, 3e5, 1e11))
    plain = solve_full(assemble(filled.mesh, filled.terms), np.array([310e3, 390e3]), filled.values).impedance
    operators = assemble(model.mesh, model.terms)
    for frequency, without in zip((310e3, 390e3), plain, strict=True):
        omega = 2.0 * np.pi * frequency
        density = complex(filled.values["water.density"])
        yields = 0.1 / (1e11 - omega**2 * density * 4e-4 - 1j * omega * 3e5)
        wall = filled.with_terms((YieldingWall(),), {"wall.compliance": yields})
        expected = solve_full(assemble(wall.mesh, wall.terms), np.array([frequency]), wall.values).impedance[0]
        found = solve_full(operators, np.array([frequency]), model.values).impedance[0]
        assert abs(expected / without - 1.0) > 1e-5
        assert found == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("resistance", [3e5, 0.0])
def test_necks_take_the_power_that_enters_them(filled: Problem, resistance: float) -> None:
    model = filled.with_terms((TERM,), necks(0.2, 2e-4, resistance))
    frequency = np.linspace(300e3, 400e3, 5)
    solution = solve_full(assemble(model.mesh, model.terms), frequency, model.values)
    operators = solution.operators
    assert isinstance(operators, FullOperators)
    losses = solution.dissipation()
    assert np.abs(losses.sum(axis=1) / solution.input_power() - 1.0).max() < 1e-10
    mine = [q for q, i in enumerate(operators.integrals) if "necks.share" in i.coefficient.parameters]
    place = operators.places[TERM.boundary]
    pressure = np.abs(operators.evaluate(place, ["p"], solution.states)["p"]) ** 2
    # s R |v|^2 / 2 over the wall, with the velocity v = p / |R - i w rho l| in the necks.
    omega = 2.0 * np.pi * frequency
    density = complex(filled.values["water.density"]).real
    taken = 0.5 * 0.2 * resistance / (resistance**2 + (omega * density * 2e-4) ** 2)
    expected = taken * np.einsum("eqn,eq->n", pressure, place.weights)
    assert losses[:, mine[0]] == pytest.approx(expected, rel=1e-10, abs=1e-14 * np.abs(losses).max())
    assert (expected > 0.0).all() == (resistance > 0.0)


def test_the_limits_are_those_of_holes_and_of_water() -> None:
    water = Registry().load("water")
    assert isinstance(water, FluidMaterial)
    assert ADMISSIBLE["resistance"].highest == pytest.approx(water.density * water.sound_speed, rel=0.02)
    assert ADMISSIBLE["length"].lowest == pytest.approx(16.0 * 30e-6 / (3.0 * np.pi), rel=0.03)
    holes, wall = 4.0 * np.pi * 0.5e-3**2, 2.0 * np.pi * 2e-3 * 1e-3
    assert ADMISSIBLE["share"].highest == pytest.approx(holes / wall)
