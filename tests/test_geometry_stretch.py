"""A mesh moved with the dimensions of its chip."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.chip import Chip, Dimension, read_chip
from geometry.mesh import MeshError, SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.parts import SAME_LENGTH, ElectrodeDisc
from geometry.section import cut_section
from geometry.stretch import between, movable, split, stretch, tied, velocity
from workbench.files.errors import InputError

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
CHIP = read_chip(CHIPS / "reference_chip.toml")
MESH = mesh_section(cut_section(CHIP), MeshSize(dict.fromkeys(CHIP.regions, 3000.0), 1e6, 10.0, 2))
#: Lengths that can be changed by themselves: no other one coincides with them.
FREE = [name for name in CHIP.dimensions() if name.endswith(".thickness")] + ["cavity.radius"]
RIMS = ["transducer.radius", "couplant.radius"]
WALLS = [f"{region}.radius" for region in ("substrate", "sidewall", "bond", "superstrate")]


def scaled(chip: Chip, factors: dict[str, float]) -> Chip:
    known = chip.dimensions()
    return chip.with_dimensions({name: factor * known[name].value for name, factor in factors.items()})


def test_stretching_onto_the_same_chip_changes_nothing() -> None:
    same = stretch(MESH, CHIP)
    assert np.array_equal(same.mesh.p, MESH.mesh.p)
    assert same.section == MESH.section


@pytest.mark.parametrize("name", [*FREE, "transducer.radius"])
def test_a_stretched_mesh_is_the_new_mesh_where_the_elements_are_uniform(name: str) -> None:
    # Without grading, and so coarse that only the minimum counts, the mesher puts the same elements on both chips.
    size = MeshSize(dict.fromkeys(CHIP.regions, 1e5), 1e6, 10.0, 2, minimum_through_thickness=3)
    new = scaled(CHIP, dict.fromkeys(RIMS if name == "transducer.radius" else [name], 1.03))
    moved = stretch(mesh_section(cut_section(CHIP), size), new)
    meshed = mesh_section(cut_section(new), size)
    # Rounding of coordinates of 13 mm.
    assert np.abs(moved.mesh.p - meshed.mesh.p).max() < 1e-17
    assert np.array_equal(moved.mesh.t, meshed.mesh.t)
    assert moved.section == meshed.section
    for boundary, facets in meshed.mesh.boundaries.items():
        assert np.array_equal(moved.mesh.boundaries[boundary], facets)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(factors=st.fixed_dictionaries({name: st.floats(0.7, 1.4) for name in FREE}))
def test_stretched_regions_have_the_volumes_of_the_new_chip(factors: dict[str, float]) -> None:
    new = scaled(CHIP, factors)
    moved = stretch(MESH, new)  # names and volumes are checked by the mesh itself
    r, z = moved.mesh.p[:, moved.mesh.t]
    for region, volume in new.volumes().items():
        cells = moved.mesh.subdomains[region]
        revolved = np.pi * ((r[1] ** 2 - r[0] ** 2) * (z[3] - z[0]))[cells].sum()
        # The 20 um layer lies 2 mm up: its height is exact to 1e-14 of itself.
        assert revolved == pytest.approx(volume, rel=1e-12)


def test_a_stretch_can_be_undone() -> None:
    there = stretch(MESH, scaled(CHIP, {"couplant.thickness": 2.0, "cavity.radius": 0.8}))
    assert np.abs(stretch(there, CHIP).mesh.p - MESH.mesh.p).max() < 1e-17


def test_the_mesh_it_came_from_is_left_alone() -> None:
    before = MESH.mesh.p.copy()
    stretch(MESH, scaled(CHIP, {"substrate.thickness": 1.2}))
    assert np.array_equal(MESH.mesh.p, before)


def test_a_stretch_that_would_change_the_topology_is_refused() -> None:
    with pytest.raises(MeshError, match="4 breaks in r into 5"):
        stretch(MESH, scaled(CHIP, {"transducer.radius": 0.99}))
    with pytest.raises(MeshError, match="4 breaks in r into 3"):
        stretch(MESH, scaled(CHIP, dict.fromkeys(RIMS, 13.0 / 12.5)))
    with pytest.raises(MeshError, match="between other breaks"):
        stretch(MESH, scaled(CHIP, dict.fromkeys(WALLS, 12.0 / 13.0)))  # narrower than the transducer
    # Only the lid overhangs, then everything but the lid: the same number of breaks, the regions between others.
    overhanging = cut_section(scaled(CHIP, {"superstrate.radius": 1.1}))
    lid = mesh_section(overhanging, MeshSize(dict.fromkeys(CHIP.regions, 9e3), 1e6, 10.0, 2))
    with pytest.raises(MeshError, match="between other breaks"):
        stretch(lid, scaled(CHIP, dict.fromkeys(WALLS[:-1], 1.1)))


@pytest.mark.parametrize("names", [RIMS, ["cavity.radius"], WALLS, ["bond.thickness"]])
def test_a_length_stretches_up_to_its_neighbours_and_no_further(names: list[str]) -> None:
    low, high = between(CHIP, names[0])
    assert low < CHIP.dimensions()[names[0]].value < high
    assert math.isfinite(high) == (names in (RIMS, ["cavity.radius"]))
    step = 0.1 * (CHIP.dimensions()[names[0]].value - low)
    for inside, outside in ((low + step, low - step), (min(high - step, 1.0), high + step)):
        stretch(MESH, CHIP.with_dimensions(dict.fromkeys(names, inside)))
        if math.isfinite(outside):
            with pytest.raises((MeshError, InputError)):
                stretch(MESH, CHIP.with_dimensions(dict.fromkeys(names, outside)))


@pytest.mark.parametrize("name", [RIMS[0], "cavity.radius", WALLS[0], "bond.thickness"])
def test_a_length_moves_nine_tenths_of_the_way_to_its_neighbour_and_within_bounds(name: str) -> None:
    value, (before, behind) = CHIP.dimensions()[name].value, between(CHIP, name)
    low, high = movable(CHIP, name)
    assert (low - before) == pytest.approx(0.1 * (value - before), rel=1e-12)
    assert (behind - high) == pytest.approx(0.1 * (behind - value), rel=1e-12) or behind == high == math.inf
    together = RIMS if name in RIMS else WALLS if name in WALLS else [name]
    for length in (low, min(high, 1.0)):
        stretch(MESH, CHIP.with_dimensions(dict.fromkeys(together, length)))
    near = 0.999 * value, 1.001 * value
    assert movable(CHIP, name, *near) == near
    assert movable(CHIP, name, near[0]) == (near[0], high)
    with pytest.raises(KeyError):
        movable(CHIP, "sidewall.height")


def test_radii_of_one_length_are_tied_under_the_first_of_their_names() -> None:
    found = tied(CHIP)
    assert found == {**dict.fromkeys(RIMS, RIMS[0]), **dict.fromkeys(WALLS, WALLS[0]), "cavity.radius": "cavity.radius"}
    # Lengths apart by more than breaks are told apart by are two; by less, one.
    for step, first in ((10.0 * SAME_LENGTH, RIMS[1]), (0.1 * SAME_LENGTH, RIMS[0])):
        longer = CHIP.with_dimensions({RIMS[1]: CHIP.dimensions()[RIMS[1]].value + step})
        assert tied(longer)[RIMS[1]] == first


def test_the_parts_of_a_place_make_it_up_and_lie_where_they_say() -> None:
    lengths = {name: each.value for name, each in CHIP.dimensions().items()}
    rim, cavity = lengths[RIMS[0]], lengths["cavity.radius"]
    mesh, pieces = split(MESH, CHIP, (rim, cavity))
    assert np.array_equal(mesh.mesh.p, MESH.mesh.p)
    assert np.array_equal(mesh.mesh.t, MESH.mesh.t)
    r, z = mesh.mesh.p
    bottoms = {layer.region: (layer.z_bottom, layer.z_bottom + layer.thickness.value) for layer in CHIP.layers}
    for named, corners in ((mesh.mesh.subdomains, mesh.mesh.t), (mesh.mesh.boundaries, mesh.mesh.facets)):
        old = MESH.mesh.subdomains if named is mesh.mesh.subdomains else MESH.mesh.boundaries
        for place, indices in old.items():
            own = pieces[place]
            assert sorted(np.concatenate([named[piece.name] for piece in own])) == sorted(indices), place
            for piece in own:
                members = corners[:, named[piece.name]]
                level = named is mesh.mesh.boundaries and np.ptp(z[members], axis=0).max() == 0.0
                assert (piece.layer == "") == level, piece
                if piece.layer:
                    low, high = bottoms[piece.layer]
                    assert low - 1e-15 <= z[members].min()
                    assert z[members].max() <= high + 1e-15
                if piece.column is None:
                    continue
                inner, outer = piece.column
                assert inner - 1e-15 <= r[members].min()
                assert r[members].max() <= outer + 1e-15
                assert {inner, outer} & {rim, cavity}  # what follows no radius is in no column
                if inner == outer:
                    assert np.ptp(r[members]) == 0.0
                else:
                    assert (r[members].min(), r[members].max()) == pytest.approx((inner, outer), rel=1e-12)
    # The lid goes beyond both radii; its outermost column is bounded by one that moves, and by one that does not.
    assert [piece.column for piece in pieces["superstrate"]] == [
        (0.0, cavity), (cavity, rim), (rim, lengths["superstrate.radius"])]
    # By thicknesses alone, nothing is in a column.
    _, thick = split(MESH, CHIP)
    assert all(piece.column is None for own in thick.values() for piece in own)


def test_only_radii_of_the_section_split_it() -> None:
    with pytest.raises(MeshError, match="not at every one of"):
        split(MESH, CHIP, (1.23e-3,))
    with pytest.raises(MeshError, match="not of chip"):
        split(MESH, scaled(CHIP, {"bond.thickness": 1.1}))


def test_a_stretch_onto_a_section_of_other_names_electrodes_or_layers_is_refused() -> None:
    old = MESH.section
    renamed = [replace(piece, region="layer") if piece.region == "bond" else piece for piece in old.rectangles]
    with pytest.raises(MeshError, match="between other breaks"):
        stretch(MESH, replace(old, rectangles=tuple(renamed)))
    narrow = replace(old.electrodes[0], r_outer=old.r_breaks[1])
    with pytest.raises(MeshError, match="between other breaks"):
        stretch(MESH, replace(old, electrodes=(narrow, old.electrodes[1])))
    # Without the gel: the substrate reaches down to the transducer.
    lower = replace(old.rectangles[2], z_bottom=old.z_breaks[1])
    with pytest.raises(MeshError, match="7 breaks in z into 6"):
        stretch(MESH, replace(old, rectangles=(old.rectangles[0], lower, *old.rectangles[3:])))


@pytest.mark.parametrize("names", [*([name] for name in FREE), RIMS, WALLS], ids=lambda names: "+".join(names))
def test_the_velocity_is_the_derivative_of_the_stretch(names: list[str]) -> None:
    rate = velocity(MESH, CHIP, *names)
    assert rate.shape == MESH.mesh.p.shape
    assert np.abs(rate).max() == 1.0
    known = CHIP.dimensions()
    for step in (3e-6, -2e-6):  # metres; the map is linear, so any step within the topology
        moved = stretch(MESH, CHIP.with_dimensions({name: known[name].value + step for name in names}))
        # Rounding of coordinates of 13 mm.
        assert np.abs(MESH.mesh.p + step * rate - moved.mesh.p).max() < 2e-17


def test_a_thickness_lifts_all_that_is_above() -> None:
    r, z = MESH.mesh.p
    along_r, along_z = velocity(MESH, CHIP, "couplant.thickness")
    assert (along_r == 0.0).all()
    assert (along_z[z >= MESH.section.z_breaks[2]] == 1.0).all()
    assert (along_z[z <= MESH.section.z_breaks[1]] == 0.0).all()
    along_r, along_z = velocity(MESH, CHIP, "cavity.radius")
    assert (along_z == 0.0).all()
    assert (along_r[r == 4e-3] == 1.0).all()
    assert (along_r[(r == 0.0) | (r >= 12.5e-3)] == 0.0).all()


def test_a_velocity_of_another_chip_or_of_no_dimension_is_refused() -> None:
    with pytest.raises(MeshError, match="stretch it onto the chip first"):
        velocity(MESH, scaled(CHIP, {"bond.thickness": 1.1}), "bond.thickness")
    with pytest.raises(InputError, match=r"'bond\.thicknes'.*did you mean 'bond\.thickness'"):
        velocity(MESH, CHIP, "bond.thicknes")
    with pytest.raises(MeshError, match="must change together"):
        velocity(MESH, CHIP, "transducer.radius")


def test_a_partial_electrode_moves_by_its_own_name() -> None:
    # A ring electrode on the free disc: its edges are breaks of their own.
    chip = read_chip(CHIPS / "free_disc_25x2.toml")
    ring = ElectrodeDisc(Dimension(9e-3), Dimension(2e-3))
    chip = replace(chip, electrodes=replace(chip.electrodes, live_disc=ring))
    mesh = mesh_section(cut_section(chip), MeshSize({"transducer": 3000.0}, 1e6, 10.0, 2))
    new = chip.with_dimensions({"electrode_live.radius": 9.5e-3, "electrode_live.inner_radius": 1e-3})
    moved: SectionMesh = stretch(mesh, new)
    r = moved.mesh.p[0, moved.mesh.facets[:, moved.mesh.boundaries["electrode_live"]]]
    assert (r.min(), r.max()) == pytest.approx((1e-3, 9.5e-3))
    rate = velocity(mesh, chip, "electrode_live.radius")[0]
    r = mesh.mesh.p[0]
    assert rate[r == 9e-3] == pytest.approx(1.0)
    assert rate[r == 12.5e-3] == pytest.approx(0.0)
