"""Lengths as parameters of the model: the same numbers as a stretched mesh, to rounding."""


import numpy as np
import pytest
from support import chip_from, layer_text, moved_onto, quadratic

from geometry.chip import Chip
from geometry.mesh import MeshError
from geometry.names import LEVEL, outside, part_name
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised
from workbench.model.problem import Problem, build, fill
from workbench.physics.boundary_layer import ViscousBoundaryLayer
from workbench.physics.surface_load import SurfaceLoad

CHIP = """
[chip]
unusual = ["bond.cavity_radius"]
name = "two rings"
band = ["0.4 MHz", "0.6 MHz"]
""" + "".join((
    layer_text("transducer", "pic255/plutho", thickness="2 mm", radius="3 mm", electrodes='{ live = "top" }'),
    layer_text("couplant", "coupling_gel/acevedo_2026", thickness="40 um", radius="3 mm"),
    layer_text("substrate", "pla/acevedo_2026", thickness="0.8 mm", radius="3.5 mm"),
    layer_text("sidewall", "pla/acevedo_2026", thickness="0.7 mm", radius="3.5 mm", cavity_radius="1.5 mm"),
    layer_text("bond", "epoxy/acevedo_2026", thickness="60 um", radius="3.5 mm", cavity_radius="2 mm"),
    layer_text("superstrate", "soda_lime_glass", thickness="0.8 mm", radius="3.5 mm"),
)) + """[states.filled]
cavity = "water"
"""

#: Two rings of different holes: the cavity spans two layers, and its boundary with the bond holds facets both ways.
LONGER = {"couplant.thickness": 47e-6, "sidewall.thickness": 0.74e-3, "bond.thickness": 50e-6,
          "transducer.thickness": 1.98e-3}
#: Both rings, and the two outer radii, which several layers share.
WIDER = {"sidewall.cavity_radius": 1.6e-3, "bond.cavity_radius": 1.93e-3, "transducer.radius": 2.9e-3,
         "substrate.radius": 3.65e-3}
TIED = {"couplant.radius": "transducer.radius", "sidewall.radius": "substrate.radius",
        "bond.radius": "substrate.radius",
        "superstrate.radius": "substrate.radius"}
FREQUENCIES = np.array([4.3e5, 5.2e5])


@pytest.fixture(scope="module")
def chip() -> Chip:
    return chip_from(CHIP)


@pytest.fixture(scope="module")
def problem(chip: Chip) -> Problem:
    found = build(fill(chip, "filled", Registry(inviscid=True)), accuracy=quadratic(3.0))
    water = found.materials["cavity"]
    walls = [b for b in found.mesh.section.boundary_names() if "cavity" in b.split("|")]
    layers = tuple(ViscousBoundaryLayer(wall, next(side for side in wall.split("|") if side != "cavity"), "cavity",
                                        water.name) for wall in walls)
    return found.with_terms(layers, {})


def test_a_new_thickness_is_that_of_the_stretched_mesh(chip: Chip, problem: Problem) -> None:
    stretched = assemble(moved_onto(problem.mesh, chip.with_dimensions(LONGER)), problem.terms)
    expected = solve_full(stretched, FREQUENCIES, problem.values).impedance
    thick = parametrised(problem, chip)
    values = {**thick.values, **{name: complex(value) for name, value in LONGER.items()}}
    found = solve_full(assemble(thick.mesh, thick.terms), FREQUENCIES, values).impedance
    # Two ways to the same matrices: what is left is rounding, which the resonances magnify.
    assert np.abs(found / expected - 1.0).max() < 1e-9
    # and the change is no small matter
    before = solve_full(assemble(problem.mesh, problem.terms), FREQUENCIES, problem.values).impedance
    assert np.abs(found / before - 1.0).max() > 0.03


def test_new_radii_are_those_of_the_stretched_mesh(chip: Chip, problem: Problem) -> None:
    lengths = {**LONGER, **WIDER}
    moved = chip.with_dimensions({**lengths, **{name: WIDER[first] for name, first in TIED.items()}})
    there = assemble(moved_onto(problem.mesh, moved), problem.terms)
    expected = solve_full(there, FREQUENCIES, problem.values).impedance
    wide = parametrised(problem, chip, tuple(WIDER))
    operators = assemble(wide.mesh, wide.terms)
    values = {**wide.values, **{name: complex(value) for name, value in lengths.items()}}
    found = solve_full(operators, FREQUENCIES, values).impedance
    # The hoop stiffness is interpolated to 1e-9, which the resonances magnify.
    assert np.abs(found / expected - 1.0).max() < 1e-8
    before = solve_full(assemble(problem.mesh, problem.terms), FREQUENCIES, problem.values).impedance
    assert solve_full(operators, FREQUENCIES, wide.values).impedance == pytest.approx(before, rel=1e-8, abs=0.0)
    thicker = {**wide.values, **{name: complex(value) for name, value in LONGER.items()}}
    assert np.abs(found / solve_full(operators, FREQUENCIES, thicker).impedance - 1.0).max() > 0.03


def test_radii_that_coincide_are_one_parameter(chip: Chip, problem: Problem) -> None:
    alone = parametrised(problem, chip, ("substrate.radius",))
    for names in (("bond.radius",), ("superstrate.radius", "sidewall.radius", "substrate.radius", "bond.radius")):
        together = parametrised(problem, chip, names)
        assert together.terms == alone.terms
        assert together.values == alone.values


@pytest.mark.parametrize(("radii", "message"), [
    (("sidewall.height",), "sidewall.height"),
    ({"bond.radius": (3.4e-3, 3.6e-3), "sidewall.radius": (3.3e-3, 3.6e-3)}, "one range for equal radii"),
    ({"bond.radius": (3.6e-3, 3.7e-3)}, "a range around its length"),
])
def test_radii_that_contradict_each_other_are_refused(
    chip: Chip, problem: Problem, radii: dict[str, tuple[float, float]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        parametrised(problem, chip, radii)


def test_the_gradient_by_a_length_is_that_of_differences(chip: Chip, problem: Problem) -> None:
    wide = parametrised(problem, chip, tuple(WIDER))
    operators = assemble(wide.mesh, wide.terms)
    names = (*sorted(LONGER), *WIDER)
    exact = solve_full(operators, FREQUENCIES, wide.values).parameter_gradient(wide.values, names)
    for column, name in enumerate(names):
        step = 1e-5 * wide.values[name]
        ahead, behind = (
            solve_full(operators, FREQUENCIES, {**wide.values, name: wide.values[name] + sign * step}).impedance
            for sign in (1.0, -1.0))
        # Central differences: an error of the step squared, 1e-10, times the curvature in units of the length.
        assert exact[:, column] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=0.0)


def test_a_mesh_of_another_chip_is_refused(chip: Chip, problem: Problem) -> None:
    with pytest.raises(MeshError, match="not of chip"):
        parametrised(problem, chip.with_dimensions({"bond.thickness": 70e-6}))


def test_a_term_on_a_part_of_a_boundary_stays_there(chip: Chip, problem: Problem) -> None:
    # The lid's outside is its top and its side: a load on what lies level is on the top alone.
    load = SurfaceLoad(part_name(outside("superstrate"), LEVEL), "superstrate", "load")
    values = {"load.normal_impedance": 1e5, "load.tangential_impedance": 0.0}
    loaded = parametrised(problem.with_terms((load,), values), chip)
    operators = assemble(loaded.mesh, loaded.terms)
    raised = np.zeros((operators.size, 1), dtype=complex)
    for component in ("u_r", "u_z"):
        numbers = operators.numbering[component]
        raised[numbers[numbers >= 0], 0] = 1.0
    on_load = ["load.normal_impedance" in i.coefficient.parameters for i in operators.integrals]
    # Normal to the side is u_r, and it is 1 as well: nothing of that is in it.
    area = operators.quadratic(raised, raised)[0][on_load].sum()
    assert area == pytest.approx(np.pi * (3.5e-3) ** 2, rel=1e-12)
