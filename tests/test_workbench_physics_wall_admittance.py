"""Walls that let fluid through against the closed forms of a tube and a disc of fluid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root
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
from workbench.physics.wall_admittance import ADMISSIBLE, WallAdmittance

DENSITY, SPEED = 998.0, 1482.0
RADIUS, HEIGHT = 1e-3, 0.72e-3


def wall(admittance: complex, compliance: complex = 0.0) -> dict[str, complex]:
    return {"port.admittance": admittance, "port.compliance": compliance}


@pytest.mark.parametrize("values", [wall(0.2 / (DENSITY * SPEED)), wall(0.0, 5e-14), wall(1e-7 - 0.5e-7j, 1e-14)])
@pytest.mark.parametrize("boundary", ["cavity|superstrate", "cavity|sidewall"])
def test_a_tube_and_a_disc_with_such_a_wall_have_the_closed_form(
    boundary: str, values: dict[str, complex], stacked: Callable[..., Chip],
    uniform_mesh: Callable[[Chip, float], SectionMesh], reference_materials: Callable[[str], dict[str, Material]],
    rows: Callable[..., NDArray[np.int64]],
) -> None:
    # d_n p = rho w^2 (i Y / w + C) p. Along a tube closed at z = 0: p = cos(k z), -k tan(k L) = that; in a disc:
    # p = J0(k r), -k J1(k R) / J0(k R) = that.
    chip = stacked([("transducer", 0.4e-3, 1.4e-3, None), ("layer", 0.4e-3, 1.4e-3, None),
                    ("sidewall", HEIGHT, 1.4e-3, RADIUS), ("superstrate", 0.4e-3, 1.4e-3, None)], band=(1e5, 3e6))
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    solid = boundary.split("|")[1]
    terms = (piezoelectric.PiezoelectricSolid("transducer", "pzt"), electrodes.ElectrodePotential("electrode_live",
             "electrode_ground"), fluid.AcousticFluid("cavity", "water"),
             WallAdmittance(boundary, solid, "cavity", "port"))
    operators = assemble(uniform_mesh(chip, 0.1e-3), terms)
    known = {f"pzt.{name}": value for name, value in pzt.parameters().items()} | values | {
        "water.density": DENSITY, "water.sound_speed": SPEED}
    along = solid == "superstrate"
    rigid = np.pi / HEIGHT if along else 3.8317 / RADIUS
    omega = SPEED * rigid
    given = DENSITY * omega**2 * (1j * values["port.admittance"] / omega + values["port.compliance"])

    def residual(x: NDArray[np.float64]) -> list[float]:
        k = complex(*x) * rigid
        value = (k * np.sin(k * HEIGHT) + given * np.cos(k * HEIGHT) if along
                 else k * jv(1, k * RADIUS) + given * jv(0, k * RADIUS)) / rigid
        return [value.real, value.imag]

    solved = root(residual, [1.0, 0.0], tol=1e-13)
    assert solved.success
    expected = SPEED**2 * (complex(*solved.x) * rigid) ** 2
    found = fluid_modes(operators, known, rows(operators, "cavity", "p"), omega)
    closest = complex(found[np.abs(found - expected).argmin()])
    print(f"{boundary}, {values}: w^2 / w0^2 {closest / omega**2:.6f}, closed form {expected / omega**2:.6f}")
    assert abs(expected / omega**2 - 1.0) > 0.05
    assert closest == pytest.approx(expected, rel=1e-4)  # (k h)^4 / 720 with k h = 0.4
    assert values["port.admittance"] == 0.0 or expected.imag < 0.0


TERM = WallAdmittance("cavity|sidewall", "sidewall", "cavity", "port")


@pytest.mark.parametrize("name", list(wall(0.0)))
def test_a_tight_wall_changes_nothing_and_the_tangent_is_the_change(filled: Problem, name: str) -> None:
    model = filled.with_terms((TERM,), wall(0.0))
    frequency = np.array([310e3, 350e3, 395e3])
    operators = assemble(model.mesh, model.terms)
    base = solve_full(assemble(filled.mesh, filled.terms), frequency, filled.values).impedance
    step = 1e-5 * ADMISSIBLE[name.removeprefix("port.")].highest
    below, at, above = (solve_full(operators, frequency, {**model.values, name: s}) for s in (-step, 0.0, step))
    assert np.abs(at.impedance / base - 1.0).max() < 1e-11
    slope = at.parameter_gradient(model.values, (name,))[:, 0]
    assert np.abs((above.impedance - below.impedance) / (2.0 * step) / slope - 1.0).max() < 1e-4


def test_a_leak_takes_the_power_that_enters_it(filled: Problem) -> None:
    model = filled.with_terms((TERM,), wall(1e-7 - 1e-7j, 1e-14))
    solution = solve_full(assemble(model.mesh, model.terms), np.linspace(300e3, 400e3, 5), model.values)
    operators = solution.operators
    assert isinstance(operators, FullOperators)
    losses = solution.dissipation()
    assert np.abs(losses.sum(axis=1) / solution.input_power() - 1.0).max() < 1e-10
    mine = [q for q, i in enumerate(operators.integrals) if i.coefficient.parameters == ("port.admittance",)]
    place = operators.places[TERM.boundary]
    pressure = np.abs(operators.evaluate(place, ["p"], solution.states)["p"]) ** 2
    # Re(Y) |p|^2 / 2 over the wall.
    expected = 0.5 * 1e-7 * np.einsum("eqn,eq->n", pressure, place.weights)
    assert losses[:, mine[0]] == pytest.approx(expected, rel=1e-10, abs=0.0)
    assert (expected > 0.0).all()


def test_the_limits_are_those_of_water() -> None:
    water = Registry().load("water")
    assert isinstance(water, FluidMaterial)
    impedance = water.density * water.sound_speed
    assert ADMISSIBLE["admittance"].highest == pytest.approx(1.0 / impedance, rel=0.02)
    assert ADMISSIBLE["compliance"].highest == pytest.approx(1e-3 / (impedance * water.sound_speed), rel=0.03)
