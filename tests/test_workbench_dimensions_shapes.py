"""Shapes of layers as parameters of the model: the same numbers as a mesh moved to the shapes and lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import moved_onto, quadratic, shape
from test_workbench_dimensions import CHIP, FREQUENCIES, LONGER, TIED, WIDER

from geometry.chip import Chip, read_chip
from geometry.dimension import Dimension
from geometry.mesh import MeshError
from geometry.shapes import with_shapes
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised
from workbench.model.moved_mesh import Interpolation
from workbench.model.problem import Problem, build, fill
from workbench.model.shaped_mesh import shaped
from workbench.physics.boundary_layer import ViscousBoundaryLayer
from workbench.physics.couplant_shear import CouplantShear
from workbench.physics.shaped import InterpolationGrid
from workbench.physics.term import ModelError

#: Every kind of shape, two of them (draft and barrel) on the same cells, with the sizes that are tried: none at a node.
RANGES = {"sidewall.draft": (-0.1, 0.1), "sidewall.barrel": (-0.1e-3, 0.1e-3), "superstrate.bow": (-8e-6, 8e-6),
          "transducer.dome": (-8e-6, 8e-6)}
SIZES = {"sidewall.draft": 0.063, "sidewall.barrel": 0.071e-3, "superstrate.bow": -6.3e-6, "transducer.dome": 5.1e-6}

#: Z follows the interpolation, which the resonances magnify: 3e-10 measured.
AGREEMENT = 1e-8


@pytest.fixture(scope="module")
def chip(tmp_path_factory: pytest.TempPathFactory) -> Chip:
    """With all shapes at 0: u_r / r is integrated with one point more than in a straight chip."""
    path = Path(tmp_path_factory.mktemp("chip")) / "chip.toml"
    path.write_text(CHIP)
    return with_shapes(read_chip(path), list(RANGES))


@pytest.fixture(scope="module")
def problem(chip: Chip) -> Problem:
    found = build(fill(chip, "filled", Registry(inviscid=True)), accuracy=quadratic(3.0))
    water, gel = found.materials["cavity"], found.materials["couplant"]
    walls = [b for b in found.mesh.section.boundary_names() if "cavity" in b.split("|")]
    layers = tuple(ViscousBoundaryLayer(wall, next(side for side in wall.split("|") if side != "cavity"), "cavity",
                                        water.name) for wall in walls)
    # What it takes across the gel lies on two faces of which a dome bends one.
    shear = CouplantShear("couplant", gel.name, "couplant|transducer", "couplant|substrate", "transducer", "substrate")
    values = {**{each.name: 0.5 for each in shear.free()}, **shear.fixed(), "couplant.thickness": 40e-6}
    return found.with_terms((*layers, shear), values)


def there(problem: Problem, chip: Chip, values: Mapping[str, float]) -> NDArray[np.complex128]:
    """Z of the mesh stretched and moved to those dimensions."""
    lengths = {name: value for name, value in values.items() if name not in RANGES}
    tied = {name: values[first] for name, first in TIED.items() if first in values}
    straight = replace(problem.mesh, coordinates=None)
    plain = replace(chip, layers=tuple(layer.with_shapes(dict.fromkeys(layer.shapes)) for layer in chip.layers))
    mesh = shaped(moved_onto(straight, plain.with_dimensions({**lengths, **tied})),
                  chip.with_dimensions({**values, **tied}))
    own = {name: complex(value) for name, value in lengths.items() if name in problem.values}
    return solve_full(assemble(mesh, problem.terms), FREQUENCIES, {**problem.values, **own}).impedance


def within(flexed: Problem, values: Mapping[str, float]) -> NDArray[np.complex128]:
    """Z of the parameters."""
    return solve_full(assemble(flexed.mesh, flexed.terms), FREQUENCIES, {
        **flexed.values, **{name: complex(value) for name, value in values.items()}}).impedance


def off(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> float:
    return float(np.abs(one / other - 1.0).max())


@pytest.mark.parametrize("names", [
    *([name] for name in RANGES), ["sidewall.draft", "sidewall.barrel"], ["sidewall.draft", "superstrate.bow"]])
def test_a_new_shape_is_that_of_the_moved_mesh(chip: Chip, problem: Problem, names: list[str]) -> None:
    flexed = parametrised(problem, chip, (), {name: RANGES[name] for name in names})
    sizes = {name: SIZES[name] for name in names}
    before = solve_full(assemble(problem.mesh, problem.terms), FREQUENCIES, problem.values).impedance
    assert off(within(flexed, {}), before) < 1e-11
    # At other shapes, and at other thicknesses as well.
    found, longer = within(flexed, sizes), within(flexed, {**sizes, **LONGER})
    assert off(found, there(problem, chip, sizes)) < AGREEMENT
    assert off(longer, there(problem, chip, {**sizes, **LONGER})) < AGREEMENT
    # No small matter, both of them.
    assert off(found, before) > 1e-3
    assert off(longer, found) > 0.03


@pytest.mark.parametrize(("names", "agreement"), [
    (["sidewall.draft"], AGREEMENT),
    # Lines within the wall follow its width on a mesh of its own; here they stay in proportion. The side is the same.
    (["sidewall.draft", "sidewall.barrel"], 1e-5),
])
def test_radii_move_with_shapes(chip: Chip, problem: Problem, names: list[str], agreement: float) -> None:
    drafted = replace(chip, layers=tuple(layer.with_shapes({"bow": None, "dome": None}) for layer in chip.layers))
    lengths = {name: chip.dimensions()[name].value for name in WIDER}
    flexed = parametrised(problem, drafted, {name: (0.92 * value, 1.08 * value) for name, value in lengths.items()},
                      {name: (0.4 * RANGES[name][0], 0.4 * RANGES[name][1]) for name in names})
    values = {**{name: 0.35 * SIZES[name] for name in names}, **LONGER, **WIDER}
    expected = there(problem, drafted, values)
    assert off(within(flexed, values), expected) < agreement
    assert off(within(flexed, {**LONGER, **WIDER}), expected) > 5e-4


def test_the_gradient_is_that_of_moved_meshes(chip: Chip, problem: Problem) -> None:
    names = ("sidewall.draft", "sidewall.barrel", "superstrate.bow", "couplant.thickness", "bond.thickness",
             "sidewall.thickness")
    flexed = parametrised(problem, chip, (), {name: RANGES[name] for name in names if name in RANGES})
    at = {name: value for name, value in {**SIZES, **LONGER}.items() if name in names}
    values = {**flexed.values, **{name: complex(value) for name, value in at.items()}}
    exact = solve_full(assemble(flexed.mesh, flexed.terms), FREQUENCIES, values).parameter_gradient(values, names)
    for column, name in enumerate(names):
        step = 2e-3 * at[name]
        slopes = []
        for width in (step, 2.0 * step):
            ahead, behind = (there(problem, chip, {**at, name: at[name] + sign * width}) for sign in (1.0, -1.0))
            slopes.append((ahead - behind) / (2.0 * width))
        # Of fourth order in the step.
        assert exact[:, column] == pytest.approx((4.0 * slopes[0] - slopes[1]) / 3.0, rel=1e-5, abs=0.0), name


def test_a_stated_shape_goes_on_from_its_size(chip: Chip, problem: Problem) -> None:
    """A chip with a draft, with that draft among its parameters and without."""
    drafted = chip.with_dimensions({"sidewall.draft": 0.05})
    mesh = shaped(replace(problem.mesh, coordinates=None), drafted)
    made = replace(problem, mesh=mesh)
    before = solve_full(assemble(mesh, problem.terms), FREQUENCIES, problem.values).impedance
    for shapes in ({}, {"sidewall.draft": (0.0, 0.08)}):
        flexed = parametrised(made, drafted, (), shapes)
        assert flexed.values.get("sidewall.draft", 0.05) == 0.05
        assert off(within(flexed, {}), before) < AGREEMENT
        values = {**LONGER, **({"sidewall.draft": 0.071} if shapes else {})}
        assert off(within(flexed, values), there(problem, drafted, {"sidewall.draft": 0.05, **values})) < AGREEMENT


def test_what_is_not_moved_is_as_it_was(chip: Chip, problem: Problem) -> None:
    plain = replace(problem, mesh=replace(problem.mesh, coordinates=None))
    straight = replace(chip, layers=tuple(layer.with_shapes(dict.fromkeys(layer.shapes)) for layer in chip.layers))
    before, after = (assemble(each.mesh, each.terms) for each in (
        parametrised(plain, straight), parametrised(plain, straight, (), {"sidewall.draft": RANGES["sidewall.draft"]})))
    assert not parametrised(plain, straight).mesh.variants
    kept = [name for name in before.places if name in after.places]
    assert any(name.startswith("transducer") for name in kept)
    assert "cavity" not in kept, sorted(kept)
    for name in kept:
        assert np.array_equal(before.places[name].weights, after.places[name].weights)
    # Of the wall and what is about it the cells are cut in those that move and those that do not.
    assert any("substrate~" not in name and name.startswith("substrate") for name in after.places)


def test_thickness_beyond_its_range_is_refused(chip: Chip, problem: Problem) -> None:
    flexed = parametrised(problem, chip, (), {"superstrate.bow": RANGES["superstrate.bow"]})
    thin = {"superstrate.bow": 7e-6, "bond.thickness": 20e-6}
    with pytest.raises(ModelError, match="outside the range of this model"):
        within(flexed, thin)
    wider = parametrised(problem, chip, (), {"superstrate.bow": RANGES["superstrate.bow"]},
                     thicknesses={"bond.thickness": (20e-6, 90e-6)})
    assert off(within(wider, thin), there(problem, chip, thin)) < AGREEMENT


@pytest.mark.parametrize(("shapes", "message"), [
    ({"sidewall.drafts": (-0.1, 0.1)}, "did you mean 'sidewall.draft'"),
    ({"substrate.draft": (-0.1, 0.1)}, "substrate.draft"),
    ({"sidewall.draft": (0.02, 0.1)}, r"sidewall.draft: .*0.02 to 0.1.*a range that contains its size, 0"),
])
def test_shapes_that_make_no_sense_are_refused(
    chip: Chip, problem: Problem, shapes: dict[str, tuple[float, float]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        parametrised(problem, chip, (), shapes)


def test_a_range_that_folds_a_cell_is_refused(chip: Chip, problem: Problem) -> None:
    with pytest.raises(MeshError, match="fold its section"):
        parametrised(problem, chip, (), {"superstrate.bow": (-70e-6, 0.0)})


def test_a_radius_within_a_parabola_is_refused_unless_carried(chip: Chip, problem: Problem) -> None:
    bowed = {"superstrate.bow": RANGES["superstrate.bow"]}
    with pytest.raises(InputError, match=r"sidewall.cavity_radius.*within the parabola of superstrate.bow"):
        parametrised(problem, chip, ("sidewall.cavity_radius",), bowed)
    flexed = parametrised(problem, chip, ("sidewall.cavity_radius",), bowed, interpolation=Interpolation(carried=True))
    sizes = {"superstrate.bow": SIZES["superstrate.bow"]}
    assert off(within(flexed, sizes), there(problem, chip, sizes)) < AGREEMENT
    # The radius 1 % wider: off by a few percent of what the bow changes.
    moved = {**sizes, "sidewall.cavity_radius": 1.515e-3}
    expected = there(problem, chip, moved)
    effect = off(within(flexed, {**moved, "superstrate.bow": 0.0}), expected)
    assert off(within(flexed, moved), expected) < 0.05 * effect


def test_a_mesh_without_the_shapes_of_its_chip_is_refused(chip: Chip, problem: Problem) -> None:
    with pytest.raises(MeshError, match="with the shapes that its layers have"):
        parametrised(problem, shape(chip, "sidewall", draft=0.05))


@pytest.mark.parametrize("degrees", [(4,), (0, 3), (5, 3), (2, 4, 3)])
def test_a_grid_interpolates_its_polynomials(degrees: tuple[int, ...]) -> None:
    bounds = tuple((0.3 - 0.1 * k, 1.1) for k in range(len(degrees)))
    start = tuple(0.6 + 0.05 * k for k in range(len(degrees)))
    grid = InterpolationGrid(bounds, start, degrees, bounds)

    def function(x: tuple[float, ...]) -> float:
        # The powers of each variable that the grid has alone, and the product of the first of all pairs.
        alone = sum(each**degree for each, degree in zip(x, degrees, strict=True))
        free = [each for each, degree in zip(x, degrees, strict=True) if degree > 1]
        return alone + (free[0] * free[1] if len(free) > 1 else 0.0)

    point = tuple(0.71 - 0.05 * k for k in range(len(degrees)))
    values = np.array([function(node) for node in grid.nodes])
    polynomials, slopes = grid.polynomials(point)
    fixed = tuple(each if degree else begin for each, begin, degree in zip(point, start, degrees, strict=True))
    assert polynomials @ values == pytest.approx(function(fixed), rel=1e-12)
    for k, degree in enumerate(degrees):
        step = np.eye(len(degrees))[k] * 1e-5
        ahead, behind = (function(tuple(np.array(fixed) + sign * step)) for sign in (1.0, -1.0))
        wanted = (ahead - behind) / 2e-5 if degree else 0.0
        assert slopes[k] @ values == pytest.approx(wanted, rel=1e-8, abs=1e-12)
        # With a variable at its start, nodes elsewhere have no part, not even by rounding.
        there, _ = grid.polynomials((*point[:k], start[k], *point[k + 1 :]))
        assert not there[[node[k] != start[k] for node in grid.nodes]].any()


def test_names_of_shapes_are_dimensions(chip: Chip) -> None:
    known = chip.dimensions()
    assert set(RANGES) <= set(known)
    assert known["transducer.dome"] == Dimension(0.0)
    assert chip.with_dimensions({"transducer.dome": 3e-6}).layer("transducer").dome == Dimension(3e-6)


def test_terms_that_are_nothing_on_the_mesh_may_follow_shapes_roughly(chip: Chip, problem: Problem) -> None:
    """What they add is right to the error asked for; without them all is as it was."""
    shear = next(term for term in problem.terms if isinstance(term, CouplantShear))
    ranges, sizes = ({name: each[name] for name in ("transducer.dome",)} for each in (RANGES, SIZES))
    nothing = {**sizes, **{each.name: 0.0 for each in shear.free()}}
    exact = parametrised(problem, chip, (), ranges)
    rough = parametrised(problem, chip, (), ranges, interpolation=Interpolation(neutral=0.03), neutral=(shear,))
    assert off(within(rough, nothing), within(exact, nothing)) < 1e-12
    added, roughly = (within(flexed, sizes) - within(flexed, nothing) for flexed in (exact, rough))
    assert 1e-7 < np.abs(roughly - added).max() / np.abs(added).max() < 0.03
    few, many = (sum(len(term.integrals()) for term in flexed.terms) for flexed in (rough, exact))
    assert few < many
