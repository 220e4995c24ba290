"""Layers that are no discs: what is moved of the section and what stays, and shapes that cannot be made."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from support import layer_text, shape

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import volumes
from geometry.dimension import Dimension
from geometry.mesh import MeshError, SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import cut_section
from geometry.shapes import moved
from geometry.solid import chip_solids, volume
from workbench.fem.elements import Lagrange
from workbench.files.errors import InputError
from workbench.model.shaped_mesh import shaped

ORDER = 4
LOCAL = np.array(Lagrange(ORDER).doflocs).T


@pytest.fixture(scope="module")
def straight(small_chip: Chip) -> SectionMesh:
    section = cut_section(small_chip)
    return mesh_section(section, MeshSize(dict.fromkeys(section.regions, 1500.0), 4e5, 2.0, ORDER))


def nodes(mesh: SectionMesh) -> np.ndarray:
    """Where the nodes (2, nodes, cells) of a mesh are before they are moved."""
    corners = mesh.mesh.p[:, mesh.mesh.t]
    return corners[:, 0][:, None] + LOCAL[:, :, None] * (corners[:, 2] - corners[:, 0])[:, None]


def test_what_has_no_shape_stays_what_it_is(small_chip: Chip, straight: SectionMesh) -> None:
    assert moved(straight, small_chip, LOCAL) is None
    assert shaped(straight, small_chip) is straight


def test_a_hole_with_draft_is_a_cone_and_goes_on_as_a_cylinder(small_chip: Chip, straight: SectionMesh) -> None:
    angle = math.radians(5.0)
    found = moved(straight, shape(small_chip, "sidewall", draft=angle), LOCAL)
    assert found is not None
    before, (wall, bond) = nodes(straight), (small_chip.layer(region) for region in ("sidewall", "bond"))
    assert np.array_equal(found[1], before[1]), "along z nothing is moved"
    for region, cells in straight.mesh.subdomains.items():
        if region in ("transducer", "couplant", "substrate"):
            assert np.array_equal(found[:, :, cells], before[:, :, cells])
    lid = straight.mesh.subdomains["superstrate"]
    for axis, least in ((0, False), (0, True), (1, False), (1, True)):
        # The line above the hole is led back to where it was, within the lid.
        end = before[axis][:, lid].min() if least else before[axis][:, lid].max()
        face = before[axis][:, lid] == end
        if (axis, least) != (1, True):
            assert np.array_equal(found[:, :, lid][:, face], before[:, :, lid][:, face])
    at_hole = np.abs(before[0] - wall.inner_radius) < 1e-12
    inside = (before[1] > wall.z_bottom - 1e-12) & (before[1] < wall.z_top + 1e-12)
    own = np.isin(np.arange(straight.mesh.t.shape[1]), straight.mesh.subdomains["sidewall"])
    wanted = wall.inner_radius + math.tan(angle) * (before[1] - wall.z_bottom)
    chosen = at_hole & inside & own
    np.testing.assert_allclose(found[0][chosen], wanted[chosen], rtol=1e-14)
    glue = at_hole & np.isin(np.arange(straight.mesh.t.shape[1]), straight.mesh.subdomains["bond"])
    np.testing.assert_allclose(found[0][glue], wall.inner_radius + math.tan(angle) * wall.thickness.value, rtol=1e-14)
    assert bond.inner_radius == wall.inner_radius
    rim = np.abs(before[0] - wall.outer_radius) < 1e-12
    assert np.array_equal(found[0][rim], before[0][rim])


def test_a_side_that_bulges_and_a_lid_that_is_bowed(small_chip: Chip, straight: SectionMesh) -> None:
    both = shape(shape(small_chip, "sidewall", barrel=1e-4), "superstrate", bow=2e-5)
    found, before = moved(straight, both, LOCAL), nodes(straight)
    assert found is not None
    lid = small_chip.layer("superstrate")
    for face in (lid.z_bottom, lid.z_top):
        there = np.abs(before[1] - face) < 1e-12
        np.testing.assert_allclose(
            found[1][there], face + 2e-5 * (1.0 - (before[0][there] / lid.outer_radius) ** 2), rtol=1e-13)
    assert found[0].max() == pytest.approx(small_chip.layer("sidewall").outer_radius + 1e-4, rel=1e-6)


def test_a_dome_is_filled_by_what_lies_on_it(small_chip: Chip, straight: SectionMesh) -> None:
    found, before = moved(straight, shape(small_chip, "transducer", dome=1e-5), LOCAL), nodes(straight)
    assert found is not None
    disc, gel = small_chip.layer("transducer"), small_chip.layer("couplant")
    face = np.abs(before[1] - disc.z_top) < 1e-12
    np.testing.assert_allclose(found[1][face], disc.z_top + 1e-5 * (1.0 - (before[0][face] / disc.outer_radius) ** 2),
                               rtol=1e-13)
    beyond = (before[1] > gel.z_top - 1e-12) | (before[1] < disc.z_bottom + 1e-12)
    assert np.array_equal(found[:, beyond], before[:, beyond])


def test_a_shape_that_reaches_beyond_what_is_beside_it_is_refused(small_chip: Chip, straight: SectionMesh) -> None:
    # A bow of 60 um of a bond of 100 um would do; 0.12 mm do not.
    with pytest.raises(MeshError, match=r"fold its section at r = .* mm, z = .* mm"):
        shaped(straight, shape(small_chip, "superstrate", bow=-0.12e-3))


@pytest.mark.parametrize(("line", "message"), [
    ('draft = "50 deg"', r"layers\[3\].draft: .*50 deg.*less than 45 deg"),
    ('draft = "1 mm"', r"draft.*1 mm.*angle"),
    ('draft = 3', r"draft"),
    ('draft = "-40 deg"', r"a hole that does not close"),
    ('barrel = "9 mm"', r"layers\[3\].barrel.*less than"),
    ('bow = { value = "10 um", tolerance = "-1 um" }', r"layers\[3\].bow.tolerance.*zero or more"),
])
def test_mistakes_in_shapes_are_named(line: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "chip.toml"
    file.write_text(CHIP.replace("SHAPE", line))
    with pytest.raises(InputError, match=message):
        read_chip(file)


def test_draft_of_a_layer_without_a_hole_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "chip.toml"
    substrate = 'thickness = "0.85 mm"'
    file.write_text(CHIP.replace("SHAPE", "").replace(substrate, substrate + '\ndraft = "1 deg"'))
    with pytest.raises(InputError, match=r"layers\[2\].draft.*none without a hole"):
        read_chip(file)


def test_shapes_are_read_and_are_dimensions(tmp_path: Path) -> None:
    file = tmp_path / "chip.toml"
    file.write_text(CHIP.replace("SHAPE", 'draft = { value = "2 deg", tolerance = "0.5 deg" }\nbarrel = "30 um"'))
    chip = read_chip(file)
    known = chip.dimensions()
    assert known["sidewall.draft"] == Dimension(math.radians(2.0), math.radians(0.5))
    assert known["sidewall.barrel"].value == pytest.approx(30e-6, rel=1e-15)
    assert chip.with_dimensions({"sidewall.draft": 0.1}).layer("sidewall").draft == Dimension(0.1)
    assert chip.is_shaped
    again = read_chip(write_chip(chip, tmp_path / "again.toml"))
    assert again.layers == chip.layers


def test_solids_and_volumes_are_those_of_the_shapes(small_chip: Chip) -> None:
    """A cone, a barrel, a bowed lid and a domed disc, drawn and by arithmetic."""
    both = shape(shape(small_chip, "sidewall", draft=0.05, barrel=0.1e-3), "superstrate", bow=20e-6)
    chip = shape(both, "transducer", dome=10e-6)
    found = volumes(chip)
    wall, bond, disc = (chip.layer(region) for region in ("sidewall", "bond", "transducer"))
    a, b = wall.inner_radius, wall.inner_radius + math.tan(0.05) * wall.thickness.value
    rim = chip.layer("superstrate").outer_radius
    lifted = 20e-6 * math.pi * b**2 * (1.0 - 0.5 * (b / rim) ** 2)  # of the parabola over the hole
    assert found["cavity"] == pytest.approx(math.pi * wall.thickness.value * (a**2 + a * b + b**2) / 3.0
                                            + math.pi * b**2 * bond.thickness.value + lifted, rel=1e-12)
    # The paraboloid holds half of its cylinder.
    assert found["transducer"] == pytest.approx(
        math.pi * disc.outer_radius**2 * (disc.thickness.value + 5e-6), rel=1e-12)
    drawn = chip_solids(chip)
    for region in ("transducer", "couplant", "bond", "superstrate", "cavity"):
        assert volume(drawn[region]) == pytest.approx(found[region], rel=1e-7)


CHIP = """
[chip]
name = "pea"
band = ["0.3 MHz", "0.4 MHz"]
""" + "".join((
    layer_text("transducer", "pzt/trial", thickness="2 mm", radius="3 mm"),
    layer_text("couplant", "gel/trial", thickness="50 um", radius="3 mm"),
    layer_text("substrate", "pla/trial", thickness="0.85 mm", radius="3.5 mm"),
    layer_text("sidewall", "pla/trial", thickness="3 mm", radius="3.5 mm", cavity_radius="1.5 mm"),
)) + """SHAPE
""" + layer_text("superstrate", "glass/trial", thickness="1 mm", radius="3.5 mm") + """
[states.empty]
cavity = "vacuum"
"""
