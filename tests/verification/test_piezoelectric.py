"""The transducer against closed forms and published modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Piezoelectric
from materials.registry import Registry
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem

RADIUS, THICKNESS = 1e-3, 2e-3


def lossless(material: Piezoelectric) -> Piezoelectric:
    """Only the stiffness has losses in the reference material, and c13 is zero already."""
    return replace(material, c11=complex(material.c11).real, c12=complex(material.c12).real,
                   c33=complex(material.c33).real, c44=complex(material.c44).real)


def plate_impedance(material: Piezoelectric, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Z = (1 - kt^2 tan X / X) / (-i w C0), e^{-i w t}, X = w h / (2 v_D)."""
    omega = 2.0 * np.pi * frequency
    permittivity = material.absolute_eps33
    stiffened = material.c33 + material.e33**2 / permittivity
    kt2 = material.e33**2 / (permittivity * stiffened)
    x = 0.5 * omega * THICKNESS / np.sqrt(stiffened / material.density)
    capacitance = permittivity * np.pi * RADIUS**2 / THICKNESS
    return (1.0 - kt2 * np.tan(x) / x) / (-1j * omega * capacitance)


@pytest.fixture(scope="module")
def plate_error(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh]
) -> Callable[[Piezoelectric, int, NDArray[np.float64]], NDArray[np.float64]]:
    """|Z / Z_exact - 1| of the plate cut in a number of elements, at the given frequencies."""
    chip = stacked([("transducer", THICKNESS, RADIUS, None)], band=(1e5, 4e6))

    def error(material: Piezoelectric, elements: int, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
        plate = problem(uniform_mesh(chip, THICKNESS / elements), {"transducer": material}, chip.band)
        solution = solve_full(assemble(plate.mesh, plate.terms), frequency, plate.values)
        return np.abs(solution.impedance / plate_impedance(material, frequency) - 1.0)

    return error


@pytest.mark.parametrize("loss", [False, True])
def test_a_plate_without_radial_coupling_has_the_closed_form_of_thickness_vibration(
    loss: bool, plate_error: Callable[..., Any], plain_ceramic: Piezoelectric
) -> None:
    # Three resonances; the grid stays clear of the poles and zeros of the lossless plate.
    frequency = np.linspace(0.11e6, 4.0e6, 40)
    error = plate_error(plain_ceramic if loss else lossless(plain_ceramic), 40, frequency)
    low = error[frequency < 1.5e6].max()
    print(f"plate, loss {loss}: relative error of Z {error.max():.1e}, below 1.5 MHz {low:.1e}")
    # 40 elements on up to two wavelengths place the resonances within (k h)^4 / 1440 = 5e-6; on the flank of the sharp
    # third one, where |dln Z / dln f| is of the order of 200 on this grid, that shows as 1e-3.
    assert error.max() < 2e-3
    assert low < 1e-6


def test_the_impedance_of_the_plate_converges_with_the_fourth_order(
    plate_error: Callable[..., Any], plain_ceramic: Piezoelectric
) -> None:
    frequency = np.array([0.6e6, 0.95e6, 1.4e6])
    errors = np.array([plate_error(plain_ceramic, n, frequency) for n in (4, 8, 16)])
    order = np.log2(errors[:-1] / errors[1:])
    print(f"order of Z of the plate: {np.round(order, 2).tolist()}")
    # Twice the degree of the elements, since the charge is a quadratic form of the state.
    assert np.abs(order[-1] - 4.0).max() < 0.15


def free_permittivity(material: Piezoelectric) -> complex:
    """eps33 at constant stress (F/m) along the poling: eps33 + e C^-1 e^T with the full tensor."""
    c11, c12, c13 = material.c11, material.c12, material.c13
    stiffness = np.array([[c11, c12, c13], [c12, c11, c13], [c13, c13, material.c33]])
    coupling = np.array([material.e31, material.e31, material.e33])
    return complex(material.absolute_eps33 + coupling @ np.linalg.solve(stiffness, coupling))


def test_a_free_disc_has_the_stress_free_capacitance_at_low_frequency(small_disc: Problem) -> None:
    material = small_disc.materials["transducer"]
    assert isinstance(material, Piezoelectric)
    radius, thickness = 3e-3, 2e-3
    expected = free_permittivity(material) * np.pi * radius**2 / thickness
    # The static state is linear in r and z, so the mesh is exact and only (f / 600 kHz)^2 remains, here 3e-6.
    solution = solve_full(assemble(small_disc.mesh, small_disc.terms), np.array([1e3]), small_disc.values)
    error = abs(solution.charge[0] / expected - 1.0)
    print(f"free capacitance {expected.real:.4e} F: relative error {error:.1e}")
    assert error < 1e-5


def test_a_disc_held_by_its_own_stiffness_has_the_clamped_capacitance(small_disc: Problem) -> None:
    material = small_disc.materials["transducer"]
    assert isinstance(material, Piezoelectric)
    expected = material.absolute_eps33 * np.pi * 3e-3**2 / 2e-3
    stiff = {f"pzt.{name}": 1e7 * value for name, value in material.parameters().items() if name.startswith("c")}
    problem_ = small_disc.with_values(stiff)
    solution = solve_full(assemble(problem_.mesh, problem_.terms), np.array([300e3]), problem_.values)
    # What strain is left adds e33^2 / (1e7 c33) to eps33, 4e-8 of it.
    assert abs(solution.charge[0] / expected - 1.0) < 2e-7


#: Short-circuit axisymmetric modes (kHz) of a PZT-5A disc of 25 x 10 mm from an independent quadratic-element model.
SHORT_CIRCUIT_MODES = (61.46, 72.66, 123.98, 126.09, 150.63, 161.49, 185.75, 201.75, 223.78)


Modes = Callable[..., tuple[FullOperators, Mapping[str, complex], NDArray[np.float64]]]


@pytest.fixture(scope="module")
def pzt5a_modes(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    modes: Callable[..., NDArray[np.float64]], rows: Callable[..., NDArray[np.int64]],
) -> Modes:
    """Operators, values and short-circuit modes (Hz) of that disc, by the length (m) of its elements."""
    chip = stacked([("transducer", 10e-3, 12.5e-3, None)], band=(40e3, 230e3))

    def found(edge: float, *, near: float = 140e3, count: int = 14) -> tuple[
            FullOperators, Mapping[str, complex], NDArray[np.float64]]:
        disc = problem(uniform_mesh(chip, edge), {"transducer": Registry().load("pzt5a/freefem_2020")}, chip.band)
        operators = assemble(disc.mesh, disc.terms)
        unknowns = rows(operators, "transducer", "u_r", "u_z", "phi")
        frequency = modes(operators, disc.values, unknowns, near=near, count=count)
        return operators, disc.values, frequency[(frequency > 1e3) & (frequency < 230e3)]

    return found


def test_a_pzt5a_disc_has_the_published_short_circuit_modes(pzt5a_modes: Modes) -> None:
    _, _, found = pzt5a_modes(0.7e-3)
    print("PZT-5A modes (kHz):", np.round(1e-3 * found, 3).tolist())
    # They are printed to 10 Hz, and were computed with elements of 0.5 mm: 1e-4 covers both.
    assert np.abs(1e-3 * found[: len(SHORT_CIRCUIT_MODES)] / SHORT_CIRCUIT_MODES - 1.0).max() < 1e-4


def test_the_short_circuit_modes_are_the_poles_of_the_admittance(pzt5a_modes: Modes) -> None:
    operators, values, found = pzt5a_modes(2.5e-3)
    poles = []
    for mode in found:
        # Near a pole B = a / (f - f_p) + b: 1 / B changes sign there; three points give a, b and f_p.
        f = mode * np.array([1.0 - 1e-4, 1.0 + 0.5e-4, 1.0 + 1e-4])
        susceptance = solve_full(operators, f, values).admittance.imag
        if susceptance[0] * susceptance[2] < 0.0:  # else odd in z: the voltage does not drive it
            poles.append(_pole(f, susceptance) / mode - 1.0)
    print(f"poles of Y: {len(poles)} of {found.size} modes, relative difference {np.abs(poles).max():.1e}")
    assert len(poles) >= 5
    # The three-point fit of a single pole is off by the curvature of the rest over 1e-4 of the frequency.
    assert np.abs(poles).max() < 1e-7


def _pole(f: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """f_p of y = a / (f - f_p) + b through three points: y f = y f_p + b f + const is linear in (f_p, b, const)."""
    x = f / f[1] - 1.0
    size = np.abs(y).max()
    p, _, _ = np.linalg.solve(np.column_stack([y / size, x, np.ones(3)]), x * y / size)
    return float(f[1] * (1.0 + p))


def test_the_modes_of_the_disc_converge(pzt5a_modes: Modes) -> None:
    found = [pzt5a_modes(edge, near=90e3, count=6)[2][:2] for edge in (5e-3, 2.5e-3, 1.25e-3, 0.625e-3)]
    errors = np.abs(np.array(found[:-1]) / found[-1] - 1.0)
    order = np.log2(errors[:-1] / errors[1:])
    print("order of the modes of the disc:", np.round(order, 2).tolist())
    # All constants take part. Free edges leave stresses like distance^1.7, so a little below 4; first-order errors
    # in any integral would show as 2.
    assert order[-1].min() > 3.3
