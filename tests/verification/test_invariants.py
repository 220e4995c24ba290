"""What holds on any mesh: energy, reciprocity, passivity, gauge, gradients, and limits that connect two models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from support import impedance_gradient, moved_onto

from geometry.chip import Chip
from geometry.mesh import SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import cut_section
from materials.kinds import Fluid, Material
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import System, factorise, solve_full
from workbench.model.problem import Problem, problem

FREQUENCY = np.linspace(300e3, 400e3, 11)


def impedance(one: Problem, frequency: NDArray[np.float64] = FREQUENCY) -> NDArray[np.complex128]:
    return solve_full(assemble(one.mesh, one.terms), frequency, one.values).impedance


# --------------------------------------------------------------------------------------------------------------------
# Energy, passivity, reciprocity


def test_the_input_power_is_the_sum_of_the_losses(filled: Problem, filled_operators: FullOperators) -> None:
    solution = solve_full(filled_operators, FREQUENCY, filled.values)
    losses = solution.dissipation()
    closure = np.abs(losses.sum(axis=1) / solution.input_power() - 1.0)
    print(f"energy closure, filled chip: {closure.max():.1e}")
    assert closure.max() < 1e-10  # stated by the acceptance; unscaled, the same system does not close better than 3 %
    # Not by the losses vanishing: the polymer and the ceramic take their shares.
    by_parameter = {i.coefficient.parameters: share for i, share in
                    zip(filled_operators.integrals, losses.sum(axis=0), strict=True)}
    assert by_parameter[("pla.shear_modulus",)] > 0.1 * losses.sum()
    assert solution.residual.max() < 1e-12


def test_a_lossless_chip_takes_no_power(filled: Problem, filled_operators: FullOperators) -> None:
    real = {name: complex(value.real) for name, value in filled.values.items()}
    z = solve_full(filled_operators, FREQUENCY, real).impedance
    assert (np.abs(z.real) < 1e-9 * np.abs(z)).all()


def test_a_passive_chip_has_a_positive_resistance(filled: Problem) -> None:
    assert (impedance(filled, np.linspace(20e3, 1.2e6, 60)).real > 0.0).all()


def test_a_loss_of_the_wrong_sign_shows_as_a_negative_resistance(filled: Problem) -> None:
    # e^{-i w t}: a loss is a negative imaginary modulus.
    active = filled.with_values({name: np.conj(value) for name, value in filled.values.items()})
    assert (impedance(active).real < 0.0).all()


def test_the_system_is_symmetric(filled: Problem, filled_operators: FullOperators) -> None:
    matrix = System(filled_operators, filled.values).matrix(350e3)
    difference = abs(matrix - matrix.T)
    scale = np.sqrt(np.abs(matrix.diagonal()))
    difference.data /= scale[difference.tocoo().row] * scale[difference.tocoo().col]
    # Element blocks add up in another order above the diagonal than below.
    assert difference.max() < 1e-14
    assert abs(matrix).max() > 0.0


def test_drive_and_reading_can_be_exchanged(filled: Problem, filled_operators: FullOperators) -> None:
    # The displacement per volt at a point is minus the short-circuit charge per newton there, component by component.
    matrix = System(filled_operators, filled.values).matrix(350e3)
    free = filled_operators.size - 1
    factor = factorise(sparse.triu(matrix[:free, :free], format="csc"), 350e3)
    driven, _ = factor.solve(-np.asarray(matrix[:free, free].toarray()).ravel())
    electrode_row = np.asarray(matrix[free, :free].toarray()).ravel()
    for component, region in (("u_z", "superstrate"), ("u_r", "sidewall"), ("u_z", "transducer"), ("p", "cavity")):
        numbers = filled_operators.numbering[component][filled_operators.places[region].dofs]
        row = int(numbers[numbers >= 0].max())
        force = np.zeros(free, dtype=complex)
        force[row] = 1.0
        loaded, _ = factor.solve(force)
        charge = -electrode_row @ loaded  # of the live electrode at zero volt
        # Two solves with residuals of 1e-14 of a system with a condition of some thousands after scaling.
        assert driven[row] == pytest.approx(charge, rel=1e-9)


# --------------------------------------------------------------------------------------------------------------------
# Gauge


@pytest.mark.parametrize("factor", [0.5, 1.048, 3.0])
def test_density_stiffness_and_piezoelectric_constants_have_a_gauge(small_disc: Problem, factor: float) -> None:
    # (rho, C, e, eps) -> (s rho, s C, sqrt(s) e, eps) scales u by 1 / sqrt(s) and leaves the charge as it is.
    changed = {}
    for name, value in small_disc.values.items():
        key = name.removeprefix("pzt.")
        changed[name] = value * (1.0 if key.startswith("eps") else np.sqrt(factor) if key.startswith("e") else factor)
    frequency = np.linspace(200e3, 1.2e6, 21)
    difference = np.abs(impedance(small_disc.with_values(changed), frequency) / impedance(small_disc, frequency) - 1.0)
    print(f"gauge, s = {factor}: {difference.max():.1e}")
    # Rounding of residuals of 1e-14, grown by resonances of Q = 400.
    assert difference.max() < 1e-9
    # And it is no identity of the code: without sqrt(s) on e nothing of it is left.
    coupling = {name: factor * small_disc.values[name] for name in ("pzt.e31", "pzt.e33", "pzt.e15")}
    wrong = small_disc.with_values(changed | coupling)
    assert np.abs(impedance(wrong, frequency) / impedance(small_disc, frequency) - 1.0).max() > 0.1


# --------------------------------------------------------------------------------------------------------------------
# Gradients


def richardson(impedance_at: Callable[[float], complex], step: float) -> complex:
    """Central difference with its error of second order taken out."""
    def central(h: float) -> complex:
        return (impedance_at(h) - impedance_at(-h)) / (2.0 * h)

    return (4.0 * central(0.5 * step) - central(step)) / 3.0


@pytest.mark.parametrize("frequency", [317e3, 383e3])
def test_the_gradient_by_every_coefficient_is_the_central_difference(
    filled: Problem, filled_operators: FullOperators, frequency: float
) -> None:
    operators = filled_operators
    solution = solve_full(operators, np.array([frequency]), filled.values)
    exact = impedance_gradient(solution)[0]
    g = operators.coefficients(solution.omega, filled.values)[0]
    free, whole = operators.size - 1, operators.matrix(g)
    worst = 0.0
    for q in range(len(operators.integrals)):
        unit = np.zeros(g.size, dtype=complex)
        unit[q] = g[q]
        direction = operators.matrix(unit)

        def changed(h: float, direction: sparse.csr_array = direction) -> complex:
            matrix = (whole + h * direction).tocsc()
            electrode = matrix[:free, [free]].toarray().ravel()
            x, _ = factorise(sparse.triu(matrix[:free, :free], format="csc"), frequency).solve(-electrode)
            charge = -(electrode @ x + matrix[free, free])
            return complex(1.0 / (-1j * 2.0 * np.pi * frequency * charge))

        found = richardson(changed, 1e-3) / g[q]
        # What Z hardly feels is measured against Z itself: rounding is 1e-12 of it in a difference over 1e-3.
        error = abs(found - exact[q]) / max(abs(exact[q]), 1e-6 * abs(solution.impedance[0] / g[q]))
        worst = max(worst, error)
        assert error < 1e-6, operators.integrals[q]
    print(f"gradient by {g.size} coefficients at {frequency:g} Hz: worst relative error {worst:.1e}")


@pytest.mark.parametrize("part", [1.0, 1.0j], ids=["real", "imaginary"])
def test_the_gradient_by_every_parameter_is_the_central_difference(
    filled: Problem, filled_operators: FullOperators, part: complex
) -> None:
    frequency = np.array([331e3])
    solution = solve_full(filled_operators, frequency, filled.values)
    names = tuple(filled.values)
    exact = solution.parameter_gradient(filled.values, names)[0]
    worst = 0.0
    for k, name in enumerate(names):
        size = abs(filled.values[name])

        def changed(h: float, name: str = name, size: float = size) -> complex:
            values = {**filled.values, name: filled.values[name] + h * part * size}
            return complex(solve_full(filled_operators, frequency, values).impedance[0])

        found = richardson(changed, 1e-3) / size
        # Z is analytic in every parameter: the derivative along i is i times that along 1.
        floor = 1e-6 * abs(solution.impedance[0]) / size
        error = abs(found - part * exact[k]) / max(abs(exact[k]), floor)
        worst = max(worst, error)
        assert error < 1e-6, name
    print(f"gradient by {len(names)} parameters along {part}: worst relative error {worst:.1e}")


def test_the_gradient_by_two_regions_of_one_material_is_their_sum(filled: Problem) -> None:
    # Substrate and sidewall are both of "pla": the derivative must count both.
    operators = assemble(filled.mesh, filled.terms)
    solution = solve_full(operators, np.array([350e3]), filled.values)
    of_shear = [q for q, i in enumerate(operators.integrals) if i.coefficient.parameters == ("pla.shear_modulus",)]
    assert len(of_shear) == 2
    total = solution.parameter_gradient(filled.values, ("pla.shear_modulus",))[0, 0]
    parts = impedance_gradient(solution)[0, of_shear]
    assert total == pytest.approx(parts.sum(), rel=1e-12)
    assert abs(parts).min() > 1e-3 * abs(parts).max()


# --------------------------------------------------------------------------------------------------------------------
# Limits that connect two models


def test_an_empty_cavity_is_the_limit_of_a_vanishing_density(
    small_chip: Chip, filled_materials: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    full = meshed(small_chip, filled_materials, elements_per_wavelength=4.0)
    without = {region: m for region, m in filled_materials.items() if region != "cavity"}
    empty = problem(full.mesh, without, full.band)
    assert not any("cavity" in repr(term) for term in empty.terms)
    reference = impedance(empty)
    differences = []
    for density in (998.0, 0.1, 0.01, 0.001):
        z = impedance(full.with_values({"water.density": density}))
        differences.append(float(np.abs(z / reference - 1.0).max()))
    print(f"filled against empty for densities of 998, 0.1, 0.01, 0.001 kg/m^3: {differences}")
    assert differences[0] > 1e-3
    # The load of the fluid is proportional to its density, at a fixed sound speed.
    assert differences[1] / differences[2] == pytest.approx(10.0, rel=1e-2)
    assert differences[2] / differences[3] == pytest.approx(10.0, rel=1e-2)
    assert differences[3] < 1e-5


def test_a_fluid_of_the_chip_does_change_it(filled: Problem, filled_materials: dict[str, Material]) -> None:
    water = filled_materials["cavity"]
    assert isinstance(water, Fluid)
    heavier = problem(filled.mesh, filled_materials | {"cavity": replace(water, density=1100.0)}, filled.band)
    assert np.abs(impedance(heavier) / impedance(filled) - 1.0).max() > 1e-4


def _longer(chip: Chip) -> Chip:
    """Every kind of dimension changed by a few per cent; the rims that coincide move together."""
    factors = {"transducer.thickness": 1.03, "couplant.thickness": 0.9, "substrate.thickness": 0.96,
               "cavity.radius": 1.05, "transducer.radius": 0.98, "couplant.radius": 0.98}
    known = chip.dimensions()
    return chip.with_dimensions({name: factor * known[name].value for name, factor in factors.items()})


def _made(mesh: SectionMesh, materials: dict[str, Material], chip: Chip) -> Problem:
    return problem(mesh, materials, chip.band)


def test_a_stretched_chip_is_the_remeshed_one_where_the_divisions_agree(
    small_chip: Chip, filled_materials: dict[str, Material]
) -> None:
    # So coarse that only the least number of elements counts, which is the same for both chips.
    size = MeshSize(dict.fromkeys(small_chip.regions, 1e6), 400e3, 10.0, 2, minimum_through_thickness=3)
    chip = _longer(small_chip)
    moved = moved_onto(mesh_section(cut_section(small_chip), size), chip)
    remeshed = mesh_section(cut_section(chip), size)
    one, other = (impedance(_made(mesh, filled_materials, chip)) for mesh in (moved, remeshed))
    # Coordinates agree to rounding.
    assert np.abs(one / other - 1.0).max() < 1e-9
    before = impedance(_made(mesh_section(cut_section(small_chip), size), filled_materials, small_chip))
    assert np.abs(one / before - 1.0).max() > 1e-2


def test_a_stretched_chip_is_the_remeshed_one_within_the_error_of_the_mesh(
    small_chip: Chip, filled_materials: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    chip = _longer(small_chip)
    start = meshed(small_chip, filled_materials, elements_per_wavelength=8.0)
    stretched = _made(moved_onto(start.mesh, chip), filled_materials, chip)
    remeshed = meshed(chip, filled_materials, elements_per_wavelength=9.0)
    fine = impedance(meshed(chip, filled_materials, elements_per_wavelength=16.0, thickness=4))
    error = float(np.abs(impedance(remeshed) / fine - 1.0).max())
    difference = float(np.abs(impedance(stretched) / impedance(remeshed) - 1.0).max())
    change = float(np.abs(impedance(stretched) / impedance(start) - 1.0).max())
    print(f"stretched against remeshed: {difference:.1e}; mesh error {error:.1e}; change by the stretch {change:.1e}")
    # Two meshes of like fineness differ by no more than the sum of their errors; that of the stretched one, whose
    # elements have grown by 5 % and were an eighth larger, is up to 2.5 times that of the other.
    assert difference < 3.5 * error
    assert difference < 0.02 * change
