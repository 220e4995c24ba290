"""Mass and stiffness of the electrodes against the plate with a mass on either face and films that are meshed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from concealed import media, solver
from numpy.typing import NDArray
from scipy.optimize import brentq
from skfem import Basis, ElementQuad2

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Material, Piezoelectric
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics.electrode_mass import ADMISSIBLE, POISSON, SILVER_DENSITY, SILVER_STIFFNESS, ElectrodeMass

RADIUS, THICKNESS = 0.1e-3, 2.02e-3
TERM = ElectrodeMass("electrode_live", "electrode_ground", "transducer")
MASS, STIFFNESS = "electrodes.surface_density", "electrodes.specific_stiffness"

Plate = tuple[FullOperators, dict[str, complex], Piezoelectric]


@pytest.fixture(scope="module")
def plate(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    plain_ceramic: Piezoelectric,
) -> Plate:
    """A lossy plate that vibrates through its thickness alone, with a mass on both faces."""
    material = replace(plain_ceramic, density=7862.0)
    chip = stacked([("transducer", THICKNESS, RADIUS, None)], band=(1e5, 4e6))
    bare = problem(uniform_mesh(chip, THICKNESS / 40), {"transducer": material}, chip.band)
    # Through its thickness alone, films are not stretched.
    return assemble(bare.mesh, (*bare.terms, TERM)), {**bare.values, STIFFNESS: SILVER_STIFFNESS}, material


def impedance(material: Piezoelectric, mass: float, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Z of the plate between two masses per area, e^{-i w t}.

    D is even over the thickness and sigma = c_D u' - h D; u = A sin(k z) from the middle, and a mass on either face
    asks for sigma = m w^2 u there: A (c_D k cos X - m w^2 sin X) = h D, X = k d / 2.
    """
    omega = 2.0 * np.pi * frequency
    permittivity = material.absolute_eps33
    h = material.e33 / permittivity
    stiffened = material.c33 + material.e33**2 / permittivity
    k = omega * np.sqrt(material.density / stiffened)
    x = 0.5 * k * THICKNESS
    amplitude = h / (stiffened * k * np.cos(x) - mass * omega**2 * np.sin(x))
    # V = D d / eps - 2 h A sin X for D = 1, I = -i w D area.
    voltage = THICKNESS / permittivity - 2.0 * h * amplitude * np.sin(x)
    return np.asarray(voltage / (-1j * omega * np.pi * RADIUS**2), dtype=np.complex128)


@pytest.mark.parametrize("mass", [10e-6 * SILVER_DENSITY, 3.0])
def test_a_plate_between_two_masses_has_the_closed_form(mass: float, plate: Plate) -> None:
    operators, values, material = plate
    frequency = np.linspace(0.31e6, 3.9e6, 19)
    found = solve_full(operators, frequency, values | {MASS: mass}).impedance
    error = np.abs(found / impedance(material, mass, frequency) - 1.0)
    print(f"plate between masses of {mass:.3f} kg/m^2: relative error of Z {error.max():.1e}")
    # Forty elements on up to two wavelengths, (k h)^4 / 1440 = 7e-6 at the top, times a slope of the order of 200 on
    # the flank of the sharp third resonance; the first is at ease.
    assert error.max() < 2e-3
    assert error[frequency < 1.5e6].max() < 1e-5


def antiresonance(operators: FullOperators, values: dict[str, complex]) -> float:
    """The frequency (Hz) of the half wave at open electrodes, where the reactance of the lossless plate is infinite."""
    lossless = {name: complex(value.real) for name, value in values.items()}

    def susceptance(frequency: float) -> float:
        return float(solve_full(operators, np.array([frequency]), lossless).admittance[0].imag)

    speed = np.sqrt((values["pzt.c33"].real + values["pzt.e33"].real ** 2 / (
        values["pzt.eps33"].real * 8.8541878128e-12)) / values["pzt.density"].real)
    half_wave = speed / 2.0 / THICKNESS
    return float(brentq(susceptance, 0.97 * half_wave, 1.01 * half_wave, xtol=1e-2))


@pytest.mark.parametrize("thickness", [1e-6, 10e-6])
def test_the_half_wave_falls_by_the_share_of_the_mass(thickness: float, plate: Plate) -> None:
    operators, values, material = plate
    mass = thickness * SILVER_DENSITY
    shift = antiresonance(operators, values | {MASS: mass}) / antiresonance(operators, values | {MASS: 1e-12}) - 1.0
    share = 2.0 * mass / (material.density * THICKNESS)
    print(f"{1e6 * thickness:.0f} um of silver on both faces: {100.0 * shift:.4f} %, -dm / m = {-100.0 * share:.4f} %")
    # The next order is the share itself: tan X = -k m / rho gives X (1 + share) = pi / 2.
    assert shift == pytest.approx(-share / (1.0 + share), rel=share**2 + 1e-4)
    if thickness == 10e-6:
        assert shift == pytest.approx(-0.013, abs=5e-4)  # the figure for such a disc


def test_both_components_move_the_mass_and_stretch_the_film_of_both_faces(small_disc: Problem) -> None:
    # As a whole along z: the area of both faces. Stretched by u_r = r: the integral of r^2 over them, and of
    # e_rr^2 + e_tt^2 + 2 nu e_rr e_tt = 2 (1 + nu).
    operators = assemble(small_disc.mesh, (*small_disc.terms, TERM))
    radius = 3e-3
    area = np.pi * radius**2
    r = np.asarray(Basis(small_disc.mesh.mesh, ElementQuad2(), intorder=1).doflocs)[0]
    for component, shape, moved, stretched in (
        ("u_z", np.ones(r.size), area, 0.0), ("u_r", r, area * radius**2 / 2.0, 2.0 * (1.0 + POISSON) * area),
    ):
        state = np.zeros((operators.size, 1), dtype=complex)
        numbers = operators.numbering[component]
        state[numbers[numbers >= 0], 0] = shape[numbers >= 0]
        forms = operators.quadratic(state, state)[0]
        own = [(form, i.coefficient.parameters) for form, i in zip(forms, operators.integrals, strict=True)]
        for names, expected, rounding in (((MASS,), moved, 0.0), ((MASS, STIFFNESS), stretched, 1e-12 * area)):
            faces = [form for form, parameters in own if parameters == names]
            assert faces == pytest.approx([expected, expected], rel=1e-12, abs=rounding)


def test_a_disc_with_films_has_the_spectrum_of_one_with_meshed_films(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    reference_materials: Callable[[str], dict[str, Material]],
) -> None:
    radius, height, film = 5e-3, 1e-3, 2e-6
    ceramic = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(ceramic, Piezoelectric)
    # The first radial resonance, which mass lowers and stiffness raises, and its overtone.
    frequency = np.concatenate([np.linspace(200e3, 300e3, 21), np.linspace(550e3, 700e3, 21)])
    bare = problem(uniform_mesh(stacked([("transducer", height, radius, None)], band=(2e5, 7e5)), height / 6),
                   {"transducer": ceramic}, (2e5, 7e5))
    operators = assemble(bare.mesh, (*bare.terms, TERM))

    young = SILVER_STIFFNESS * SILVER_DENSITY * (1.0 - POISSON**2)
    silver = media.Solid.isotropic(SILVER_DENSITY, young / (3.0 * (1.0 - 2.0 * POISSON)),
                                   young / (2.0 * (1.0 + POISSON)))
    pzt = media.Piezo(ceramic.density, ceramic.c11, ceramic.c12, ceramic.c13, ceramic.c33, ceramic.c44, ceramic.e31,
                      ceramic.e33, ceramic.e15, ceramic.eps11, ceramic.eps33)

    def meshed(thickness: float) -> NDArray[np.complex128]:
        boxes = [solver.Box(0.0, radius, thickness, thickness + height, pzt)]
        if thickness:
            boxes += [solver.Box(0.0, radius, low, low + thickness, silver) for low in (0.0, thickness + height)]
        section = solver.Body(tuple(boxes), (thickness + height, 0.0, radius), (thickness, 0.0, radius))
        return solver.spectrum(section, frequency, order=5, per_wavelength=1.6, tolerance=1e-6)

    def changed(stiffness: float) -> NDArray[np.complex128]:
        values = {**bare.values, MASS: film * SILVER_DENSITY, STIFFNESS: stiffness}
        found = [solve_full(operators, frequency, {**values, MASS: mass}).impedance for mass in (values[MASS], 0.0)]
        return np.asarray(np.log(np.conj(found[0] / found[1])))

    exact = np.log(meshed(film) / meshed(0.0))
    off, without = (float(np.linalg.norm(changed(s) - exact) / np.linalg.norm(exact)) for s in (SILVER_STIFFNESS, 0.0))
    print(f"films of silver: off by {100 * off:.2f} % of what they do, by {100 * without:.0f} % as mere masses")
    # Films as membranes in the middle of the face: film / height times small factors is left out.
    assert off < 0.005
    # Masses without stiffness would be off by more than all that films do.
    assert without > 1.0


def test_ten_micrometres_of_silver_are_admissible() -> None:
    allowed = ADMISSIBLE["surface_density"]
    assert allowed.lowest < 10e-6 * SILVER_DENSITY < allowed.highest
    assert allowed.source
