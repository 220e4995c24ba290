"""Models of straight chips over ranges of lengths and coefficients: derivatives, full solves, and a kept file."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import moved_onto, quadratic
from test_geometry_straight import CHIP, chip

from geometry.chip import Chip
from workbench.fem.linearised import FullSystem
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import NotConverged, System, solve_full
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised
from workbench.model.numbers import ParameterName, placed
from workbench.model.problem import build, fill
from workbench.reduced.ranges import load_range_model, range_model

COARSE = quadratic(2.0)
GLASS = "soda_lime_glass/ono_2020"
#: A thickness, a half width, a stiffness and a loss.
RANGES = {"superstrate.thickness": (0.45e-3, 0.55e-3), "cavity.half_width": (1.8e-4, 2.0e-4),
          f"{GLASS}.shear_modulus": (28e9, 31e9)}


def of_symmetry(name: str) -> Chip:
    split = CHIP.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"')
    return chip(split.replace('symmetry = "even"', f'symmetry = "{name}"'))


@pytest.mark.parametrize(("symmetry", "coefficients"), [("even", True), ("odd", False), ("none", False)])
def test_ln_z_has_the_derivatives_of_differences_by_every_length_and_coefficient(
    symmetry: str, coefficients: bool
) -> None:
    there = of_symmetry(symmetry)
    radii = [name for name in there.dimensions() if name.endswith("half_width")]
    problem = build(fill(there), accuracy=COARSE)
    problem = parametrised(problem, there, list(dict.fromkeys(radii)))
    names = tuple(name for name in problem.values if ParameterName.parse(name).is_dimension or coefficients)
    operators = assemble(problem.mesh, problem.terms)
    state = FullSystem(operators, problem.values).linearised(1.97e6, names)
    found = -state.charge_by_parameter / state.charge
    scale = np.array([abs(problem.values[name]) for name in names])
    steps = 1e-5 * scale
    expected = np.array([difference(operators, problem.values, name, step) for name, step in zip(names, steps,
                                                                                               strict=True)])
    seen = np.abs(found) * scale > 0.0
    off = np.abs((found - expected) * scale)[seen]
    print(f"{symmetry}: d ln Z by {seen.sum()} of {len(names)} numbers, off by {off.max():.1e} of "
          f"{(np.abs(found) * scale).max():.2f}")
    assert {"cavity.half_width", "sidewall.thickness", "electrode_live.inner_half_width"} <= set(names)
    assert seen.sum() > (20 if coefficients else 8)
    # Of a step of 1e-5 the square is 1e-10, times the third derivative near a resonance; rounding is 1e-11 / 1e-5.
    assert off.max() < 1e-5


def difference(operators: FullOperators, values: Mapping[str, complex], name: str, step: float) -> complex:
    """d ln Z by one number, by central differences."""
    both = [solve_full(operators, np.array([1.97e6]), {**values, name: values[name] + sign * step}).impedance[0]
            for sign in (1.0, -1.0)]
    return complex(np.log(both[0] / both[1]) / (2.0 * step))


@pytest.mark.parametrize("symmetry", ["even", "odd"])
def test_a_range_model_is_that_of_full_solves(symmetry: str, tmp_path: Path) -> None:
    there = of_symmetry(symmetry)
    model = range_model(there, "filled", RANGES, band=(1.8e6, 2.1e6), points=31, accuracy=COARSE)
    numbers = {"superstrate.thickness": 0.53e-3, "cavity.half_width": 1.86e-4, f"{GLASS}.shear_modulus": 29e9}
    found = model(numbers)
    problem = build(fill(there, "filled"), band=(1.8e6, 2.1e6), accuracy=COARSE)
    lengths = {name: value for name, value in numbers.items() if name in there.dimensions()}
    moved = replace(problem, mesh=moved_onto(problem.mesh, there.with_dimensions(lengths)))
    values = placed(problem.values, {name: value for name, value in numbers.items() if name not in lengths})
    few = model.frequency[::6]
    expected = np.conj(solve_full(assemble(moved.mesh, moved.terms), few, values).impedance)
    off = np.abs(found.impedance[::6] / expected - 1.0).max()
    print(f"{symmetry}: rank {model.rank}, {model.reduced.solves} solves, {model.seconds:.1f} s, off by {off:.1e}")
    # What the model was made for.
    assert off < 1e-3
    model.save(tmp_path / "model.npz")
    again = load_range_model(tmp_path / "model.npz", there, "filled", accuracy=COARSE)
    assert again(numbers).impedance == pytest.approx(found.impedance, rel=1e-12)
    with pytest.raises(InputError, match="chip, state, materials and mesh"):
        load_range_model(tmp_path / "model.npz", replace(there, measure=replace(there.measure, length=0.03)), "filled",
                         accuracy=COARSE)


def test_a_derivative_is_accepted_at_a_limit_of_its_own() -> None:
    problem = build(fill(of_symmetry("even")), accuracy=COARSE)
    _, factor = System(assemble(problem.mesh, problem.terms), problem.values).factored(1.97e6)
    right = np.ones(factor.triangle.shape[0], dtype=complex)
    with pytest.raises(NotConverged, match="above 1e-30") as caught:
        factor.solve(right, 1e-30)
    assert factor.solve(right, 1.01 * caught.value.residual)[1] == caught.value.residual
    assert pickle.loads(pickle.dumps(caught.value)).limit == 1e-30
