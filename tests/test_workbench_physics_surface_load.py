"""Loads on outer boundaries against the loaded plate and the loaded ring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import root
from scipy.special import jv, jvp, yv, yvp
from skfem import Basis, ElementQuad2
from support import Held

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Material, Piezoelectric
from materials.registry import Registry
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics import electrodes, piezoelectric, solid
from workbench.physics.surface_load import ADMISSIBLE, SurfaceLoad, SurfaceSpring

RADIUS, THICKNESS = 0.1e-3, 2e-3
BELOW = SurfaceLoad("electrode_ground", "transducer", "below")
ABOVE = SurfaceLoad("electrode_live", "transducer", "above")


def loads(below: complex, above: complex, *, tangential: complex = 0.0) -> dict[str, complex]:
    return {"below.normal_impedance": below, "above.normal_impedance": above,
            "below.tangential_impedance": tangential, "above.tangential_impedance": tangential}


@pytest.fixture(scope="module")
def plate(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    plain_ceramic: Piezoelectric,
) -> tuple[FullOperators, dict[str, complex], Piezoelectric]:
    """A lossless plate that vibrates through its thickness alone, with a load on both faces."""
    # Its losses are all in the stiffness.
    material = replace(plain_ceramic, **{name: complex(getattr(plain_ceramic, name)).real
                                         for name in ("c11", "c12", "c33", "c44")})
    chip = stacked([("transducer", THICKNESS, RADIUS, None)], band=(1e5, 4e6))
    bare = problem(uniform_mesh(chip, THICKNESS / 40), {"transducer": material}, chip.band)
    return assemble(bare.mesh, (*bare.terms, BELOW, ABOVE)), dict(bare.values), material


def stiffened(material: Piezoelectric) -> float:
    return float((material.c33 + material.e33**2 / material.absolute_eps33).real)


def impedance(
    material: Piezoelectric, below: complex, above: complex, frequency: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Z of the plate between two specific impedances, e^{-i w t}.

    u = A sin k z + B cos k z from the middle, sigma = c_D u' - h D, and sigma n = i w Z u on both faces.
    """
    permittivity = material.absolute_eps33.real
    h, modulus = material.e33.real / permittivity, stiffened(material)
    found = []
    for omega in 2.0 * np.pi * frequency:
        k = omega * np.sqrt(material.density / modulus)
        s, c = np.sin(0.5 * k * THICKNESS), np.cos(0.5 * k * THICKNESS)
        matrix = np.array([[modulus * k * c - 1j * omega * above * s, -modulus * k * s - 1j * omega * above * c],
                           [-modulus * k * c + 1j * omega * below * s, -modulus * k * s - 1j * omega * below * c]])
        a, _ = np.linalg.solve(matrix, [h, -h])
        voltage = THICKNESS / permittivity - 2.0 * h * a * s
        found.append(voltage / (-1j * omega * np.pi * RADIUS**2))
    return np.array(found)


@pytest.mark.parametrize(("below", "above"), [(6e6, 0.0), (1e6, 3e6), (3e6 - 4e6j, 0.5e6 + 2e6j)])
def test_a_loaded_plate_has_the_closed_form(
    below: complex, above: complex, plate: tuple[FullOperators, dict[str, complex], Piezoelectric]
) -> None:
    operators, values, material = plate
    frequency = np.linspace(0.31e6, 3.9e6, 19)
    found = solve_full(operators, frequency, values | loads(below, above)).impedance
    error = np.abs(found / impedance(material, below, above, frequency) - 1.0)
    print(f"plate between {below} and {above}: relative error of Z {error.max():.1e}")
    # Forty elements on up to two wavelengths, (k h)^4 / 1440 = 7e-6, and no sharp resonance left.
    assert error.max() < 2e-4
    assert (found.real > 0.0).all()


@pytest.mark.parametrize("resistance", [410.0, 1e4, 1e5])
def test_a_small_resistance_gives_the_half_wave_its_quality(
    resistance: float, plate: tuple[FullOperators, dict[str, complex], Piezoelectric]
) -> None:
    # Power R v^2 / 2 at one face over w times the energy rho h v^2 / 4 with w = pi c / h: 1/Q = 2 R / (pi rho c).
    operators, values, material = plate
    own = np.sqrt(material.density * stiffened(material))
    quality = 0.5 * np.pi * own / resistance
    half_wave = own / material.density / 2.0 / THICKNESS
    # The zero of Y (a simple one) at a complex frequency, from three real ones within a few half widths of it.
    frequency = half_wave * (1.0 + np.array([-1.0, 0.0, 1.0]) * max(1.0 / quality, 1e-5))
    y = solve_full(operators, frequency, values | loads(resistance, 0.0)).admittance
    second, first, constant = np.polyfit(frequency - half_wave, y, 2)
    zeros = np.roots([second, first, constant])
    zero = half_wave + zeros[np.abs(zeros).argmin()]
    found = -zero.real / (2.0 * zero.imag)
    print(f"R = {resistance:g} Pa s/m on one face: Q {found:.1f}, pi rho c / (2 R) = {quality:.1f}")
    # The next order is (R / rho c)^2, 1e-5 for the largest; the parabola's own is (1/Q)^2.
    assert found == pytest.approx(quality, rel=1e-3)


def test_a_matched_load_lets_no_wave_return(plate: tuple[FullOperators, dict[str, complex], Piezoelectric]) -> None:
    # With Z = rho c on both faces each sends one wave through the plate, and neither comes back:
    # u(d/2) - u(-d/2) = (h D / (i w rho c)) (e^{i k d} - 1).
    operators, values, material = plate
    own = np.sqrt(material.density * stiffened(material))
    frequency = np.linspace(0.5e6, 3.5e6, 31)
    loaded = solve_full(operators, frequency, values | loads(own, own)).impedance
    phase = frequency / (own / material.density / THICKNESS) * 2.0 * np.pi  # k d
    kt2 = (material.e33.real**2 / material.absolute_eps33.real) / stiffened(material)
    capacitance = material.absolute_eps33.real * np.pi * RADIUS**2 / THICKNESS
    expected = (1.0 - kt2 * (np.exp(1j * phase) - 1.0) / (1j * phase)) / (-2j * np.pi * frequency * capacitance)
    error = np.abs(loaded / expected - 1.0)
    print(f"matched plate: relative error of Z {error.max():.1e}")
    assert error.max() < 1e-5  # (k h)^4 / 1440 = 5e-6 at 3.5 MHz


# --------------------------------------------------------------------------------------------------------------------
# Along the surface

INNER, OUTER, HEIGHT = 1e-3, 1.4e-3, 0.2e-3
SHEAR, DENSITY = 1.1e9, 1150.0
POLYMER: dict[str, complex] = {"pla.bulk_modulus": 3.6e9, "pla.shear_modulus": SHEAR, "pla.density": DENSITY}


@pytest.mark.parametrize("load", [1e4, 1e6 - 0.5e6j])
def test_a_ring_shears_against_a_load_on_its_rim(
    load: complex, stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    reference_materials: Callable[[str], dict[str, Material]], rows: Callable[..., NDArray[np.int64]],
) -> None:
    # u_z(r) held inside, G u' = i w Z u at the rim; the normal part has nothing to do since u_r = 0.
    chip = stacked([("transducer", HEIGHT, OUTER, None), ("layer", HEIGHT, OUTER, None),
                    ("sidewall", HEIGHT, OUTER, INNER), ("superstrate", HEIGHT, OUTER, None)], band=(1e5, 3e6))
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    held = tuple(Held("u_r", b) for b in ("cavity|sidewall", "layer|sidewall", "sidewall|superstrate"))
    terms = (piezoelectric.PiezoelectricSolid("transducer", "pzt"), solid.ElasticSolid("sidewall", "pla"),
             electrodes.ElectrodePotential("electrode_live", "electrode_ground"), *held, Held("u_z", "cavity|sidewall"),
             Held("u_r", "sidewall|outside"), SurfaceLoad("sidewall|outside", "sidewall", "holder"))
    operators = assemble(uniform_mesh(chip, 0.05e-3), terms)
    values = {f"pzt.{name}": value for name, value in pzt.parameters().items()} | POLYMER | {
        "holder.normal_impedance": 5e6, "holder.tangential_impedance": load}
    omega = 2.0 * np.pi * 0.6e6

    def residual(x: NDArray[np.float64]) -> list[float]:
        k = complex(*x) / INNER
        u = jv(0, k * OUTER) * yv(0, k * INNER) - yv(0, k * OUTER) * jv(0, k * INNER)
        slope = k * (jvp(0, k * OUTER) * yv(0, k * INNER) - yvp(0, k * OUTER) * jv(0, k * INNER))
        value = INNER * (slope - 1j * omega * load / SHEAR * u)
        return [value.real, value.imag]

    solved = root(residual, [0.5 * np.pi * INNER / (OUTER - INNER), 0.0], tol=1e-13)
    assert solved.success
    expected = SHEAR / DENSITY * (complex(*solved.x) / INNER) ** 2
    every = rows(operators, "sidewall", "u_r", "u_z")
    coefficients = np.array([i.coefficient(np.array([omega]), values)[0] for i in operators.integrals])
    heavy = np.array([i.coefficient.parameters == ("pla.density",) for i in operators.integrals])

    def block(constants: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.asarray(operators.matrix(constants)[every][:, every].toarray())

    found = scipy.linalg.eigvals(block(np.where(heavy, 0.0, coefficients)),
                                 -block(np.where(heavy, coefficients, 0.0)) / omega**2)
    closest = found[np.abs(found - expected).argmin()]
    print(f"ring with {load}: w^2 {closest:.6e}, closed form {expected:.6e}")
    assert closest == pytest.approx(expected, rel=2e-5)  # (k h)^4 / 720 = 2e-6 with k h = 0.2, shifted by the load
    assert expected.imag < 0.0


def test_normal_and_tangential_motion_are_told_apart(small_disc: Problem) -> None:
    # u_z = 1 is normal to the faces and along the rim; u_r = r the other way round. With Z = 1 of either kind.
    load = SurfaceLoad("transducer|outside", "transducer", "holder")
    operators = assemble(small_disc.mesh, (*small_disc.terms, load))
    radius, thickness = 3e-3, 2e-3
    r = np.asarray(Basis(small_disc.mesh.mesh, ElementQuad2(), intorder=1).doflocs)[0]
    kinds = {i.coefficient.parameters[0]: q for q, i in enumerate(operators.integrals) if i.place == load.boundary}
    faces, rim = 2.0 * np.pi * radius**2, 2.0 * np.pi * radius * thickness
    for component, shape, normal, tangential in (
        ("u_z", np.ones(r.size), faces, rim), ("u_r", r, rim * radius**2, np.pi * radius**4)):
        state = np.zeros((operators.size, 1), dtype=complex)
        numbers = operators.numbering[component]
        state[numbers[numbers >= 0], 0] = shape[numbers >= 0]
        forms = operators.quadratic(state, state)[0]
        assert forms[kinds["holder.normal_impedance"]] == pytest.approx(normal, rel=1e-12, abs=0.0)
        assert forms[kinds["holder.tangential_impedance"]] == pytest.approx(tangential, rel=1e-12, abs=0.0)


def test_a_load_takes_the_power_that_enters_it(small_disc: Problem) -> None:
    load = SurfaceLoad("transducer|outside", "transducer", "holder")
    operators = assemble(small_disc.mesh, (*small_disc.terms, load))
    values = {**small_disc.values, "holder.normal_impedance": 1e5 - 3e5j, "holder.tangential_impedance": 4e4 + 1e5j}
    frequency = np.linspace(300e3, 700e3, 9)
    solution = solve_full(operators, frequency, values)
    losses = solution.dissipation()
    assert np.abs(losses.sum(axis=1) / solution.input_power() - 1.0).max() < 1e-10
    taken = losses[:, [q for q, i in enumerate(operators.integrals) if i.place == load.boundary]]
    assert (taken > 0.0).all()
    # R |v|^2 / 2 over the surface.
    place = operators.places[load.boundary]
    seen = operators.evaluate(place, ["u_n", "u_t"], solution.states)
    for column, (motion, resistance) in enumerate((("u_n", 1e5), ("u_t", 4e4))):
        speed = np.abs(solution.omega * seen[motion]) ** 2
        expected = 0.5 * resistance * np.einsum("eqn,eq->n", speed, place.weights)
        assert taken[:, column] == pytest.approx(expected, rel=1e-10, abs=0.0)


def test_the_air_around_a_chip_is_admissible() -> None:
    air = Registry().load("air").parameters()
    resistance = (air["density"] * air["sound_speed"]).real
    allowed = ADMISSIBLE["normal_impedance"]
    assert allowed.lowest == pytest.approx(resistance, rel=2e-3)
    assert all(limit.lowest < limit.highest and limit.source for limit in ADMISSIBLE.values())


@pytest.mark.parametrize(("below", "above", "loss"), [(1e13, 1e14, 0.3), (3e13, 1e14, 0.3), (1e20, 1e20, 0.0)])
def test_a_plate_between_springs_has_the_closed_form(
    below: float, above: float, loss: float, plate: tuple[FullOperators, dict[str, complex], Piezoelectric]
) -> None:
    # sigma n = - k (1 - i eta) u is i w Z u with Z = i k (1 - i eta) / w.
    operators, values, material = plate
    frequency = np.linspace(0.31e6, 3.9e6, 19)
    springs = (SurfaceSpring("electrode_ground", "transducer", "floor"),
               SurfaceSpring("electrode_live", "transducer", "jaw"))
    held = assemble(operators.mesh, (*operators.terms, *springs))
    found = solve_full(held, frequency, values | loads(0.0, 0.0) | {
        "floor.stiffness": below, "jaw.stiffness": above, "floor.loss_factor": loss, "jaw.loss_factor": loss}).impedance
    of_spring = 1j * (1.0 - 1j * loss) / (2.0 * np.pi * frequency)
    expected = np.array([impedance(material, below * each, above * each, np.array([f]))[0]
                         for each, f in zip(of_spring, frequency, strict=True)])
    error = np.abs(found / expected - 1.0).max()
    print(f"plate between springs of {below:g} and {above:g} Pa/m: relative error of Z {error:.1e}")
    # Forty elements on up to two wavelengths, (k h)^4 / 1440 = 7e-6, at resonances of a Q up to a hundred.
    assert error < 1e-3
    if below == above == 1e20:
        # Between rigid jaws a uniform field moves nothing: the plate is its clamped capacitance, but for 2 h^2 / (k d).
        clamped = THICKNESS / material.absolute_eps33.real / (-2j * np.pi * frequency * np.pi * RADIUS**2)
        assert np.abs(found / clamped - 1.0).max() < 1e-6


def test_a_weak_spring_moves_a_mode_as_rayleigh_says(
    plate: tuple[FullOperators, dict[str, complex], Piezoelectric]
) -> None:
    # Half wave u = U sin(pi z / d) from the middle: d w^2 = k U^2 / (rho d U^2 / 2) for one face.
    operators, values, material = plate
    stiffness = 1e11
    half_wave = np.sqrt(stiffened(material) / material.density) / 2.0 / THICKNESS
    expected = stiffness / (material.density * THICKNESS * (2.0 * np.pi * half_wave) ** 2)
    held = assemble(operators.mesh, (*operators.terms, SurfaceSpring("electrode_live", "transducer", "jaw")))
    # Zeros of a real Y: open-circuited, the plate resonates at its stiffened half wave.
    found = []
    for each in (0.0, stiffness):
        frequency = half_wave * (1.0 + np.linspace(-3e-4, 3e-4, 7) + each / stiffness * expected)
        y = solve_full(held, frequency, values | loads(0.0, 0.0) | {
            "jaw.stiffness": each, "jaw.loss_factor": 0.0}).admittance.imag
        found.append(float(np.interp(0.0, y * np.sign(y[-1] - y[0]), frequency)))
    print(f"half wave moved by {found[1] / found[0] - 1.0:.5g}, Rayleigh {expected:.5g}")
    assert found[1] / found[0] - 1.0 == pytest.approx(expected, rel=0.03)
