"""Lengths of a chip that move, and the parts of a mesh that follow them."""

import math
from pathlib import Path

import numpy as np
import pytest
from support import moved_onto

from geometry.chip import Chip, read_chip
from geometry.dimension import SAME_LENGTH
from geometry.mesh import MeshError, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import cut_section
from geometry.stretch import admissible_range, canonical_names, mesh_limits, split
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


@pytest.mark.parametrize("name", [*FREE, "transducer.radius"])
def test_a_stretched_mesh_is_the_new_mesh_where_the_elements_are_uniform(name: str) -> None:
    # Without grading, and so coarse that only the minimum counts, the mesher puts the same elements on both chips.
    size = MeshSize(dict.fromkeys(CHIP.regions, 1e5), 1e6, 10.0, 2, minimum_through_thickness=3)
    new = scaled(CHIP, dict.fromkeys(RIMS if name == "transducer.radius" else [name], 1.03))
    moved = moved_onto(mesh_section(cut_section(CHIP), size), new)
    meshed = mesh_section(cut_section(new), size)
    # Rounding of coordinates of 13 mm.
    assert np.abs(moved.mesh.p - meshed.mesh.p).max() < 1e-17
    assert np.array_equal(moved.mesh.t, meshed.mesh.t)
    assert moved.section == meshed.section
    for boundary, facets in meshed.mesh.boundaries.items():
        assert np.array_equal(moved.mesh.boundaries[boundary], facets)


@pytest.mark.parametrize("names", [RIMS, ["cavity.radius"], WALLS, ["bond.thickness"]])
def test_a_length_stretches_up_to_its_neighbours_and_no_further(names: list[str]) -> None:
    low, high = mesh_limits(CHIP, names[0])
    assert low < CHIP.dimensions()[names[0]].value < high
    assert math.isfinite(high) == (names in (RIMS, ["cavity.radius"]))
    step = 0.1 * (CHIP.dimensions()[names[0]].value - low)
    for inside, outside in ((low + step, low - step), (min(high - step, 1.0), high + step)):
        moved_onto(MESH, CHIP.with_dimensions(dict.fromkeys(names, inside), unusual=names))
        if math.isfinite(outside):
            with pytest.raises((MeshError, InputError, ValueError)):
                moved_onto(MESH, CHIP.with_dimensions(dict.fromkeys(names, outside)))


@pytest.mark.parametrize("name", [RIMS[0], "cavity.radius", WALLS[0], "bond.thickness"])
def test_a_length_moves_nine_tenths_of_the_way_to_its_neighbour_and_within_bounds(name: str) -> None:
    value, (before, behind) = CHIP.dimensions()[name].value, mesh_limits(CHIP, name)
    low, high = admissible_range(CHIP, name)
    assert (low - before) == pytest.approx(0.1 * (value - before), rel=1e-12)
    assert (behind - high) == pytest.approx(0.1 * (behind - value), rel=1e-12) or behind == high == math.inf
    together = RIMS if name in RIMS else WALLS if name in WALLS else [name]
    for length in (low, min(high, 1.0)):
        moved_onto(MESH, CHIP.with_dimensions(dict.fromkeys(together, length), unusual=together))
    near = 0.999 * value, 1.001 * value
    assert admissible_range(CHIP, name, *near) == near
    assert admissible_range(CHIP, name, near[0]) == (near[0], high)
    with pytest.raises(KeyError):
        admissible_range(CHIP, "sidewall.height")


def test_radii_of_one_length_are_tied_under_the_first_of_their_names() -> None:
    found = canonical_names(CHIP)
    assert found == {**dict.fromkeys(RIMS, RIMS[0]), **dict.fromkeys(WALLS, WALLS[0]), "cavity.radius": "cavity.radius"}
    # Lengths apart by more than breaks are told apart by are two; by less, one.
    for step, first in ((10.0 * SAME_LENGTH, RIMS[1]), (0.1 * SAME_LENGTH, RIMS[0])):
        longer = CHIP.with_dimensions({RIMS[1]: CHIP.dimensions()[RIMS[1]].value + step})
        assert canonical_names(longer)[RIMS[1]] == first


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
