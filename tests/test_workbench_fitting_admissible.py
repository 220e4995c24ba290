"""The conditions on free material parameters against the matrices and ratios they stand for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials import passivity
from materials.kinds import IsotropicSolid, Material, Piezoelectric
from workbench.files.errors import InputError
from workbench.fitting.admissible import POISSON_RATIO, inequalities
from workbench.fitting.parameter import Parameter, material_parameter
from workbench.model.numbers import Stated
from workbench.model.problem import Problem
from workbench.search.constrained import Inequality

Real = NDArray[np.float64]

PZT, PLA = "pzt/test", "pla/test"
ALONG, ACROSS = "passivity of shear along the poling", "passivity of shear across the poling"
STIFFNESS = ("c11", "c12", "c13", "c33", "c44")
COEFFICIENTS = (*STIFFNESS, "e31", "e33", "e15", "eps11", "eps33")


@pytest.fixture(scope="module")
def stack(
    stacked: Callable[..., Chip], meshed: Callable[..., Problem],
    reference_materials: Callable[[str], Mapping[str, Material]],
) -> Problem:
    """A transducer under gel and PLA."""
    chip = stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 1e-3, 3e-3, None)],
                   band=(300e3, 450e3))
    found = reference_materials("chip_filled")
    names = {"transducer": PZT, "couplant": "gel/test", "substrate": PLA}
    return meshed(chip, {region: replace(found[region], name=name) for region, name in names.items()},
                  elements_per_wavelength=1.0)


def free(problem: Problem, material: str, *names: str) -> tuple[Parameter, ...]:
    return tuple(material_parameter(problem, material, name) for name in names)


def of(problem: Problem, material: str, parameters: tuple[Parameter, ...]) -> dict[str, Inequality]:
    return {i.name.removesuffix(f" of {material}"): i for i in inequalities([problem], parameters)}


def moved(problem: Problem, parameters: tuple[Parameter, ...], x: Real) -> Piezoelectric:
    """The ceramic that the vector x (p,) means."""
    numbers = {name: complex(problem.values[f"{PZT}.{name}"]) for name in Piezoelectric.PARAMETERS}
    for parameter, number in zip(parameters, x, strict=True):
        name = parameter.parsed.coefficient
        old = numbers[name]
        numbers[name] = complex(old.real, number) if parameter.is_loss else complex(number, old.imag)
    ceramic = problem.materials["transducer"]
    assert isinstance(ceramic, Piezoelectric)
    density = numbers.pop("density").real
    return replace(ceramic, density=density, **numbers)  # type: ignore[arg-type]


# --------------------------------------------------------------------------------------------------------------------
# What one recording adds


def test_a_material_is_one_in_each_recording_with_what_is_added_there(stack: Problem) -> None:
    shared = free(stack, PLA, "shear_modulus", "bulk_modulus")
    own = replace(shared[0], name=f"{PLA}.shear_modulus[again]", value=0.0, low=-1e9, high=1e9, recordings=("again",),
                  offset=True)
    everything = (own, *shared)
    found = {i.name: i for i in inequalities([stack, stack], everything, recordings=["first", "again"])}
    plain = {i.name: i for i in inequalities([stack], shared)}
    start = np.array([0.0, *(p.start for p in shared)])
    for added in (-2e8, 0.0, 3e8):
        x = start + np.array([added, 1e7, 0.0])
        for name, condition in plain.items():
            # A state without the offset does not see it; one with it is the same as one whose number is that much more.
            assert found[name](x) == pytest.approx(condition(x[1:]), rel=1e-12)
            assert found[f"{name} in again"](x) == pytest.approx(condition(x[1:] + np.array([added, 0.0])), rel=1e-12)
    above, below = (found[name] for name in found if "[again]" in name)
    for total, kept in ((shared[0].low, (True, True)), (shared[0].low - 1e6, (False, True)),
                        (shared[0].high + 1e6, (True, False))):
        x = np.array([total - shared[0].start, shared[0].start, shared[1].start])
        assert (above.margin(x) > -1e-12, below.margin(x) > -1e-12) == kept
    # Alone an offset goes on from what the problem has.
    alone = inequalities([stack], (own,), recordings=["again"])
    assert alone[0](np.array([1e8])) == pytest.approx(plain[alone[0].name.removesuffix(" in again")](
        start[1:] + np.array([1e8, 0.0])), rel=1e-12)
    assert inequalities([stack], (own,), recordings=["first"]) == ()


# --------------------------------------------------------------------------------------------------------------------
# Ceramics


def test_the_blocks_hold_every_eigenvalue_of_the_whole_matrix_of_dissipation(stack: Problem) -> None:
    parameters = free(stack, PZT, *(f"{name}.loss" for name in COEFFICIENTS))
    blocks = of(stack, PZT, parameters)
    assert sorted(blocks) == ["passivity", ACROSS, ALONG]
    size = stack.values[f"{PZT}.c33"].real
    random = np.random.default_rng(3)
    for _ in range(20):
        x = np.array([p.scale * random.standard_normal() for p in parameters])
        plane, across, along = (size * np.linalg.eigvalsh(blocks[name](x)) for name in sorted(blocks))
        # Shear along the poling stands twice in the matrix (13 and 23); across it once as a difference of strains and
        # once as engineering shear, with half the stiffness.
        whole = np.sort(np.concatenate([plane, along, along, across, 0.5 * across]))
        exact = np.linalg.eigvalsh(passivity.dissipation_matrix(moved(stack, parameters, x)))
        assert whole == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())  # rounding of eigenvalues


def test_any_parameter_set_passes_where_the_whole_matrices_do(stack: Problem) -> None:
    names = (*COEFFICIENTS, *(f"{name}.loss" for name in COEFFICIENTS))
    parameters = free(stack, PZT, *names)
    conditions = inequalities([stack], parameters)
    assert len(conditions) == 5
    start = np.array([p.start for p in parameters])
    loss = np.array([p.is_loss for p in parameters])
    # Losses on the diagonal large enough that about half of the sets are passive.
    start[loss] *= 10.0
    spread = np.where(loss, 0.4 * np.abs(start) + 0.03 * np.array([p.scale for p in parameters]), 0.25 * np.abs(start))
    random = np.random.default_rng(11)
    passed = {True: 0, False: 0}
    stable = {True: 0, False: 0}
    for _ in range(400):
        x = start + spread * random.standard_normal(start.size)
        if any(v <= 0.0 for p, v in zip(parameters, x, strict=True)
               if p.name.split(".", 1)[1] in ("c44", "eps11", "eps33", "c33")):
            continue  # their bounds see to that
        material = moved(stack, parameters, x)
        for part, count in (("passivity", passed), ("stored energy", stable)):
            ours = min(i.margin(x) for i in conditions if i.name.startswith(part))
            if part == "passivity":
                theirs = passivity.smallest_dissipation(material) / complex(material.c33).real
            else:
                c = {name: complex(getattr(material, name)).real for name in STIFFNESS}
                matrix = np.diag([c["c11"], c["c11"], c["c33"], c["c44"], c["c44"], 0.5 * (c["c11"] - c["c12"])])
                matrix[0, 1] = matrix[1, 0] = c["c12"]
                matrix[:2, 2] = matrix[2, :2] = c["c13"]
                theirs = float(np.linalg.eigvalsh(matrix)[0]) / c["c33"]
            if abs(theirs) > 1e-12:  # a sign is no rounding
                assert (ours > 0.0) == (theirs > 0.0), (part, ours, theirs)
                count[ours > 0.0] += 1
    print(f"passive {passed}, stable {stable}")
    assert min(*passed.values(), *stable.values()) > 20  # or one side was never tried


def test_what_is_not_free_keeps_the_value_of_the_problem(stack: Problem) -> None:
    # Im of [[-(c11 + c12), -sqrt2 c13], [-sqrt2 c13, -c33]]: c13'' may reach sqrt((c11'' + c12'') c33'' / 2).
    (loss,) = free(stack, PZT, "c13.loss")
    (only,) = inequalities([stack], (loss,))
    assert only.name == f"passivity of {PZT}"
    c11, c33 = (stack.values[f"{PZT}.{name}"].imag for name in ("c11", "c33"))
    limit = np.sqrt(0.5 * c11 * c33)
    assert limit > 0.0
    for sign in (-1.0, 1.0):
        assert only.margin(np.array([sign * 0.999 * limit])) > 0.0
        assert only.margin(np.array([sign * 1.001 * limit])) < 0.0


def test_a_motion_without_loss_of_its_own_is_left_out(stack: Problem) -> None:
    # Neither eps33 nor e31, e33 lose: the block of the axial field is of stiffnesses alone.
    found = of(stack, PZT, free(stack, PZT, "c11.loss", "c44.loss"))
    sizes = {name: i.constant.shape[0] for name, i in found.items()}
    assert sizes == {"passivity": 2, ALONG: 1, ACROSS: 1}


@pytest.mark.parametrize(("name", "needed"), [("e33.loss", "eps33.loss"), ("e31.loss", "eps33.loss"),
                                              ("e15.loss", "c44.loss")])
def test_a_coupling_that_loses_alone_is_refused(stack: Problem, name: str, needed: str) -> None:
    with pytest.raises(InputError, match="would make energy") as caught:
        inequalities([stack], free(stack, PZT, "c33.loss", name))
    assert caught.value.value == f"{PZT}.{name}"
    assert caught.value.expected.startswith(needed)


def test_a_coupling_may_lose_together_with_what_it_couples(stack: Problem) -> None:
    along = of(stack, PZT, free(stack, PZT, "e15.loss", "c44.loss", "eps11.loss"))[ALONG]
    c44, eps11 = -0.2e9, 8.0
    # -c44'' eps11'' eps0 >= e15''^2
    limit = np.sqrt(-c44 * eps11 * 8.8541878128e-12)
    for share in (0.999, -0.999):
        assert along.margin(np.array([share * limit, c44, eps11])) > 0.0
    for share in (1.001, -1.001):
        assert along.margin(np.array([share * limit, c44, eps11])) < 0.0


def test_a_material_in_two_recordings_is_conditioned_once(stack: Problem) -> None:
    parameters = free(stack, PZT, "c11", "c33")
    assert len(inequalities([stack, stack], parameters)) == len(inequalities([stack], parameters)) == 2


def test_parameters_that_are_no_materials_bring_no_conditions(stack: Problem) -> None:
    assert inequalities([stack], (Parameter("bench.gain", 0.0, -1.0, 1.0, Stated(0.1), "1"),)) == ()
    assert inequalities([stack], free(stack, PZT, "e31", "density")) == ()
    assert inequalities([stack], free(stack, "gel/test", "sound_speed")) == ()


# --------------------------------------------------------------------------------------------------------------------
# Polymers


def poisson(bulk: float, shear: float) -> float:
    return (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))


@pytest.mark.parametrize("limits", [POISSON_RATIO, (0.25, 0.4)])
def test_the_bounds_of_poissons_ratio_are_those_of_the_moduli(stack: Problem, limits: tuple[float, float]) -> None:
    parameters = free(stack, PLA, "bulk_modulus", "shear_modulus", "bulk_modulus.loss")
    above, below = inequalities([stack], parameters, poisson=limits)
    random = np.random.default_rng(2)
    seen = {True: 0, False: 0}
    for _ in range(200):
        bulk, shear = 10.0 ** random.uniform(8.5, 10.5, 2)
        x = np.array([bulk, shear, -1e8])
        assert (above.margin(x) > 0.0) == (poisson(bulk, shear) > limits[0])
        assert (below.margin(x) > 0.0) == (poisson(bulk, shear) < limits[1])
        seen[limits[0] < poisson(bulk, shear) < limits[1]] += 1
    assert min(seen.values()) > 20
    # On the very limits: G = 3 K (1 - 2 nu) / (2 (1 + nu)).
    for condition, limit in ((above, limits[0]), (below, limits[1])):
        x = np.array([4e9, 3.0 * 4e9 * (1.0 - 2.0 * limit) / (2.0 * (1.0 + limit)), 0.0])
        assert poisson(*x[:2]) == pytest.approx(limit, rel=1e-12)
        assert condition.margin(x) == pytest.approx(0.0, abs=1e-14)


def test_a_single_modulus_is_held_by_the_other(stack: Problem) -> None:
    (shear,) = free(stack, PLA, "shear_modulus")
    above, below = inequalities([stack], (shear,))
    assert isinstance(stack.materials["substrate"], IsotropicSolid)
    bulk = complex(stack.values[f"{PLA}.bulk_modulus"]).real
    for number in np.linspace(0.01, 2.0, 50) * bulk:
        x = np.array([number])
        assert (above.margin(x) > 0.0) == (poisson(bulk, number) > POISSON_RATIO[0])
        assert (below.margin(x) > 0.0) == (poisson(bulk, number) < POISSON_RATIO[1])
