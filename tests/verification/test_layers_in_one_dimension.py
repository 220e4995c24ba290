"""Stacks that vibrate along z alone, against transfer matrices: every contact, loss included.

Without c13, e31 and e15, without Poisson's ratio, and with a gel whose rim does not open, u_r = 0 and fields of z alone
solve the equations of a stack of free discs exactly. The oracle is the plate as a three-port (Mason 1948; Kino 1987,
"Acoustic Waves", eq. 1.4.15) loaded by lines, written in e^{+j w t}.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, solve_full
from workbench.model.problem import base_model, problem
from workbench.physics.fluid import PressureRelease

RADIUS, EDGE = 0.1e-3, 50e-6
#: Clear of the half waves of the lossless gel of the impedance tube (493 kHz and multiples), where Z is too steep.
FREQUENCY = np.linspace(0.31e6, 1.99e6, 15)
POLYMER = IsotropicSolid(name="polymer", density=1130.0, bulk_modulus=2.0 / 3.0 * (1.6e9 - 60e6j),
                         shear_modulus=1.6e9 - 60e6j)
GLASS = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=2.0 / 3.0 * (29e9 - 0.3e9j),
                       shear_modulus=29e9 - 0.3e9j)
GEL = Fluid(name="gel", density=1020.0, sound_speed=1480.0)

#: Absorbing a hundred times more than any real gel, so that it shows: w delta / c^2 = 1 % at 1 MHz.
THICK = Fluid(name="thick", density=1020.0, sound_speed=1480.0, shear_viscosity=2.0, bulk_viscosity=1.0)

#: (role, thickness in metres, material), above the transducer; ``None`` is the transducer itself.
STACKS: dict[str, list[tuple[str, float, Material | None]]] = {
    "gel and sample": [("transducer", 2e-3, None), ("couplant", 0.1e-3, GEL), ("sample", 1e-3, POLYMER)],
    "bonded sample": [("transducer", 2e-3, None), ("sample", 1e-3, POLYMER)],
    "impedance tube": [("transducer", 2e-3, None), ("couplant", 1.5e-3, GEL), ("sample", 0.5e-3, GLASS)],
    "four layers": [("transducer", 2e-3, None), ("couplant", 0.1e-3, GEL), ("substrate", 0.8e-3, POLYMER),
                    ("couplant", 0.7e-3, GEL), ("superstrate", 1e-3, GLASS)],
    "absorbing fluid": [("transducer", 2e-3, None), ("couplant", 1.5e-3, THICK), ("sample", 0.5e-3, GLASS)],
    "backed": [("backing", 0.6e-3, POLYMER), ("transducer", 2e-3, None), ("couplant", 0.2e-3, GEL),
               ("sample", 1e-3, GLASS)],
}


def line(
    thickness: float, density: float, modulus: NDArray[np.complex128], end: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Specific impedance at the near face of a layer that sees `end` at its far face, e^{+j w t}."""
    speed = np.sqrt(modulus / density)
    own, phase = density * speed, np.tan(2.0 * np.pi * FREQUENCY * thickness / speed)
    return own * (end + 1j * own * phase) / (own + 1j * end * phase)


def load(layers: list[tuple[str, float, Material | None]]) -> NDArray[np.complex128]:
    """What a face of the transducer sees of the layers, the nearest first; nothing beyond the last."""
    seen = np.zeros(FREQUENCY.size, dtype=complex)
    for _, thickness, material in reversed(layers):
        match material:
            case Fluid():
                # Compressibility (1 + i w delta / c^2) / (rho c^2) in e^{-i w t}.
                absorbed = 2.0 * np.pi * FREQUENCY * (material.diffusivity_of_sound or 0.0) / material.sound_speed**2
                stiffness = material.density * material.sound_speed**2
                modulus = np.asarray(stiffness / (1.0 - 1j * absorbed), dtype=np.complex128)
            case IsotropicSolid():
                modulus = np.full(FREQUENCY.size, np.conj(2.0 * material.shear_modulus), dtype=np.complex128)
            case _:
                raise TypeError(material)
        seen = line(thickness, material.density, modulus, seen)
    return seen


def three_port(
    material: Piezoelectric, thickness: float, below: NDArray[np.complex128], above: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Electrical impedance (e^{+j w t}) of the plate between two specific acoustic impedances."""
    omega = 2.0 * np.pi * FREQUENCY
    area = np.pi * RADIUS**2
    permittivity = np.conj(material.absolute_eps33)
    h = np.conj(material.e33) / permittivity
    speed = np.sqrt((np.conj(material.c33) + np.conj(material.e33) ** 2 / permittivity) / material.density)
    own, kl = material.density * speed * area, omega * thickness / speed
    cot, csc = own / np.tan(kl), own / np.sin(kl)
    # F = -Z v at both faces, v into the plate: (-j cot + Z) v1 - j csc v2 = j (h / w) I, likewise for v2.
    a, b, c = -1j * cot + area * below, -1j * csc, -1j * cot + area * above
    right = 1j * h / omega
    determinant = a * c - b * b
    v = right * (c - b) / determinant + right * (a - b) / determinant
    return -1j * (h / omega * v + thickness / (omega * permittivity * area))


@pytest.fixture(scope="module")
def solved(
    stacked: Callable[..., Chip],
    uniform_mesh: Callable[[Chip, float], SectionMesh],
    plain_ceramic: Piezoelectric,
) -> Callable[[str, float], tuple[Solution, NDArray[np.complex128]]]:
    """The model's solution of a stack for an element edge, and the oracle's Z in the solver's e^{-i w t}."""

    def solve(name: str, edge: float) -> tuple[Solution, NDArray[np.complex128]]:
        layers = STACKS[name]
        chip = stacked([(role, thickness, RADIUS, None) for role, thickness, _ in layers], band=(0.3e6, 2e6))
        materials = {layer.region: material or plain_ceramic
                     for layer, (_, _, material) in zip(chip.layers, layers, strict=True)}
        mesh = uniform_mesh(chip, edge)
        # A rim that does not open keeps the gel one-dimensional.
        terms = tuple(term for term in base_model(mesh, materials) if not isinstance(term, PressureRelease))
        assert len(terms) < len(base_model(mesh, materials)) or name == "bonded sample"
        solution = solve_full(assemble(mesh, terms), FREQUENCY, problem(mesh, materials, chip.band).values)
        place = next(i for i, (_, _, material) in enumerate(layers) if material is None)
        oracle = three_port(plain_ceramic, layers[place][1], load(layers[:place][::-1]), load(layers[place + 1:]))
        return solution, np.conj(oracle)

    return solve


@pytest.mark.parametrize("name", STACKS)
def test_a_stack_that_vibrates_along_z_alone_is_the_transfer_matrix(
    name: str, solved: Callable[[str, float], tuple[Solution, NDArray[np.complex128]]]
) -> None:
    solution, oracle = solved(name, EDGE)
    error = np.abs(solution.impedance / oracle - 1.0)
    print(f"{name}: relative error of Z {error.max():.1e}")
    # 14 or more elements on a wavelength, (k h)^4 / 1440 = 3e-5 at 2 MHz, times the slope on a resonance's flank.
    assert error.max() < 2e-4


def test_absorption_shows_in_the_tube(solved: Callable[[str, float], tuple[Solution, NDArray[np.complex128]]]) -> None:
    lossless, absorbing = (solved(name, EDGE)[0].impedance for name in ("impedance tube", "absorbing fluid"))
    assert np.abs(absorbing / lossless - 1.0).max() > 1e-2


def test_the_stack_converges_with_the_fourth_order(
    solved: Callable[[str, float], tuple[Solution, NDArray[np.complex128]]],
) -> None:
    # All of the layers are whole numbers of the largest edge.
    errors = []
    for edge in (0.1e-3, 0.05e-3, 0.025e-3):
        solution, oracle = solved("four layers", edge)
        errors.append(np.sqrt(np.mean(np.abs(solution.impedance / oracle - 1.0) ** 2)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"four layers: rms errors {errors}, order {np.round(order, 2).tolist()}")
    assert abs(order[-1] - 4.0) < 0.2


def test_the_pressure_gradient_in_the_gel_is_its_inertia(
    solved: Callable[[str, float], tuple[Solution, NDArray[np.complex128]]],
) -> None:
    # e^{-i w t}: grad p = rho w^2 u. A contact of the wrong sign leaves Z as it is and fails here.
    solution, _ = solved("gel and sample", EDGE)
    operators = solution.operators
    assert isinstance(operators, FullOperators)
    pressure, displacement = [], []
    for wall in ("couplant|transducer", "couplant|sample"):
        values = operators.evaluate(operators.places[wall], ["p", "u_z"], solution.states)
        pressure.append(values["p"].mean(axis=(0, 1)))
        displacement.append(values["u_z"].mean(axis=(0, 1)))
    found = (pressure[1] - pressure[0]) / 0.1e-3
    expected = GEL.density * solution.omega**2 * (displacement[0] + displacement[1]) / 2.0
    # The trapezoidal rule over the gel is off by (k h)^2 / 12, 5e-3 at 0.4 MHz.
    assert np.abs(found / expected - 1.0)[:2].max() < 1e-2
