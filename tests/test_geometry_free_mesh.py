"""Meshes of sections of any shape: sides that follow curves, names, divisions that pass from face to face."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support import pot

from geometry.chip import Chip
from geometry.chip_section import chip_section
from geometry.curves import Arc, Curve
from geometry.dimension import Dimension
from geometry.dissection import four_sides
from geometry.free_mesh import mesh_free, moved_free
from geometry.free_section import FreeSection
from geometry.mesh import MeshError, SectionMesh
from geometry.mesh_size import MeshSize
from geometry.parts import ElectrodeDisc, Electrodes
from geometry.profile import Corner, Outline, Profile
from geometry.quads import measures, numbering

pytest.importorskip("cadquery")


def fine(section: FreeSection, order: int = 4, **others: float) -> MeshSize:
    return MeshSize(dict.fromkeys(section.regions, 1500.0), 4e5, 3.0, order, corner_refinement=0.2, **others)


def section_of(chip: Chip) -> FreeSection:
    found = chip_section(chip)
    assert isinstance(found, FreeSection)
    return found


@pytest.fixture(scope="module")
def rounded(small_chip: Chip) -> FreeSection:
    return section_of(pot(small_chip, fillet=0.2e-3))


@pytest.fixture(scope="module")
def mesh(rounded: FreeSection) -> SectionMesh:
    return mesh_free(rounded, fine(rounded))


def test_regions_and_boundaries_have_their_measures(rounded: FreeSection, mesh: SectionMesh) -> None:
    """What the mesh is made of has the length of the section's curves, and its cells share their nodes."""
    assert set(mesh.mesh.subdomains) == set(rounded.regions)
    assert set(mesh.mesh.boundaries) == set(rounded.boundary_names())
    assert mesh.coordinates is not None
    ends = mesh.mesh.p[:, mesh.mesh.facets]
    for name in rounded.boundary_names():
        edges = [arc for edge, arc in enumerate(rounded.edges) if rounded.name(edge) == name]
        if edges and all(arc.is_straight for arc in edges):
            found = np.hypot(*(ends[:, 0] - ends[:, 1]))[mesh.mesh.boundaries[name]].sum()
            assert found == pytest.approx(sum(arc.length for arc in edges), rel=1e-12)
    corners = [numbering(mesh.order).index(corner) for corner in (
        (0, 0), (mesh.order, 0), (mesh.order, mesh.order), (0, mesh.order))]
    assert np.abs(mesh.coordinates[:, corners] - mesh.mesh.p[:, mesh.mesh.t]).max() < 1e-15


def test_curved_sides_lie_on_their_curve(rounded: FreeSection, mesh: SectionMesh) -> None:
    """The nodes between cavity and printed part in the fillet are as far from its centre as its radius."""
    assert mesh.coordinates is not None
    own = mesh.coordinates[:, :, mesh.mesh.subdomains["cavity"]]
    arc = next(each for each in rounded.edges if not each.is_straight)
    middle = arc.at(np.array(0.5))
    (r0, z0), (r1, z1) = arc.ends
    centre = np.array([min(r0, r1), max(z0, z1)])
    assert np.hypot(*(middle - centre)) == pytest.approx(0.2e-3, rel=1e-9)
    distance = np.hypot(own[0] - centre[0], own[1] - centre[1])
    beyond = (own[0] > centre[0]) & (own[1] < centre[1])
    assert distance[beyond].max() == pytest.approx(0.2e-3, rel=1e-9)
    assert (np.abs(distance[beyond] - 0.2e-3) < 1e-12).sum() > mesh.order


def test_faces_with_four_sides_need_no_gmsh(small_chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    """A printed part with a sharp corner is cut there into two faces of four sides each, like a stack of rectangles."""
    section = section_of(pot(small_chip, fillet=0.0))
    assert all(four_sides(list(section.arcs(face.loops[0]))) is not None for face in section.faces)
    monkeypatch.setattr("geometry.free_faces.gmsh_session", None)
    found = mesh_free(section, fine(section))
    corners = found.mesh.p[:, found.mesh.t]
    sides = np.abs(np.roll(corners, -1, axis=1) - corners)
    assert sides.min(axis=0).max() < 1e-12, "each side runs along r or along z"


def test_only_what_is_around_a_fillet_is_filled_freely(rounded: FreeSection) -> None:
    free = [face for face in rounded.faces if four_sides(list(rounded.arcs(face.loops[0]))) is None]
    assert sorted(face.region for face in free) == ["cavity", "substrate"]
    for face in free:
        r = np.concatenate([arc.polyline[0] for arc in rounded.arcs(face.loops[0])])
        assert np.ptp(r) < 1.5e-3


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_areas_converge_with_the_order(rounded: FreeSection, order: int) -> None:
    found = mesh_free(rounded, fine(rounded, order))
    assert found.coordinates is not None
    along, across = np.array(numbering(order)).T
    nodes = np.empty((2, found.coordinates.shape[2], order + 1, order + 1))
    nodes[:, :, along, across] = found.coordinates.transpose(0, 2, 1)
    area = measures(nodes)[0][found.mesh.subdomains["cavity"]].sum()
    # Of a fillet a hundredth of whose cavity parabolas miss by (15 degrees)^4 / 180, at order 2.
    assert abs(area / rounded.area("cavity") - 1.0) < {2: 1e-6, 4: 1e-11, 6: 1e-12, 8: 1e-12}[order]


def test_an_electrode_of_a_part_of_the_face_ends_at_a_node(small_chip: Chip) -> None:
    chip = replace(pot(small_chip, fillet=0.2e-3), electrodes=Electrodes("top", ElectrodeDisc(Dimension(2e-3))))
    section = section_of(chip)
    found = mesh_free(section, fine(section))
    for name, radius in (("electrode_live", 2e-3), ("electrode_ground", chip.transducer.outer_radius)):
        r, z = found.mesh.p[:, found.mesh.facets[:, found.mesh.boundaries[name]]]
        assert r.max() == pytest.approx(radius, abs=1e-12)
        assert r.min() == 0.0
        assert np.ptp(z) < 1e-12
    # Elements are smaller there, by the cube.
    widths = np.ptp(found.mesh.p[0, found.mesh.facets[:, found.mesh.boundaries["electrode_live"]]], axis=0)
    assert widths.min() < 0.05 * widths.max()


def test_a_mesh_that_is_not_the_section_is_refused(rounded: FreeSection, mesh: SectionMesh) -> None:
    assert mesh.coordinates is not None
    with pytest.raises(MeshError, match=r"area of 'transducer' in the mesh is"):
        replace(mesh, coordinates=mesh.coordinates * 1.001)
    folded = mesh.coordinates.copy()
    folded[:, 0, 0] = folded[:, 2, 0] + 0.2 * (folded[:, 2, 0] - folded[:, 0, 0])
    with pytest.raises(MeshError, match=r"folded cell at r = .* mm, z = "):
        replace(mesh, coordinates=folded)
    with pytest.raises(MeshError, match="without the nodes"):
        replace(mesh, coordinates=None)


def test_curves() -> None:
    """A quarter of a circle and a parabola: points, lengths, areas, first moments, where a coordinate is reached."""
    half = math.sqrt(0.5)
    quarter = Arc(Curve(2, (0.0, 0.0, 0.0, 1.0, 1.0, 1.0), ((1.0, 0.0, 1.0), (half, half, half), (0.0, 1.0, 1.0))))
    assert quarter.length == pytest.approx(0.5 * math.pi, rel=1e-12)
    assert quarter.turning == pytest.approx(0.5 * math.pi, rel=1e-12)
    assert quarter.area == pytest.approx(0.25 * math.pi, rel=1e-12)
    assert quarter.moment == pytest.approx(1.0 / 3.0, rel=1e-12)
    assert quarter.back.area == pytest.approx(-quarter.area, rel=1e-14)
    share = quarter.share_of(1, math.sin(0.3))
    assert share is not None
    assert quarter.at(np.array(share)) == pytest.approx([math.cos(0.3), math.sin(0.3)], rel=1e-12)
    assert quarter.share_of(0, 2.0) is None
    assert not quarter.is_straight
    parabola = Arc(Curve.parabola((0.0, 0.0), (0.5, 0.25), (1.0, 0.0)))
    assert parabola.area == pytest.approx(-2.0 / 3.0 * 0.25, rel=1e-13)
    first, second = parabola.part(0.0, 0.3), parabola.part(0.3, 1.0)
    assert first.area + second.area == pytest.approx(parabola.area, rel=1e-13)
    assert Arc(Curve.line((0.0, 0.0), (1.0, 2.0))).is_straight


def test_lines_of_nodes_are_where_they_are_asked_for_and_go_with_the_layer(small_chip: Chip) -> None:
    """A skin of the bond and a radius where something may end; both keep their share when sizes change."""
    chip = pot(small_chip, fillet=0.2e-3)
    section, skin, radius = section_of(chip), 0.1, 0.9 * chip.layer("bond").radius.value
    mesh = mesh_free(section, replace(fine(section), skins={"bond": skin}, radii=(radius,)))
    thicker = chip.with_dimensions({"bond.thickness": 1.3 * chip.layer("bond").thickness.value})
    like = chip_section(thicker, like=section)
    assert isinstance(like, FreeSection)
    for made, own in ((mesh, chip), (moved_free(mesh, like), thicker)):
        r, z = made.mesh.p[:, made.mesh.t[:, made.mesh.subdomains["bond"]]]
        layer = own.layer("bond")
        for height in (skin, 1.0 - skin):
            level = layer.z_bottom + height * layer.thickness.value
            on_level, on_face = ((np.abs(z - each) < 1e-12).any(axis=0).sum() for each in (level, layer.z_bottom))
            assert on_level == 2 * on_face  # cells below it and above
        assert not ((r.min(axis=0) < radius - 1e-9) & (r.max(axis=0) > radius + 1e-9)).any()


def test_columns_stand_upright_below_what_is_oblique(small_chip: Chip) -> None:
    """A lid with a shallow cone below: what divides its lower face is straight above what divides the layers below."""
    lid, rim = small_chip.layer("superstrate"), small_chip.layer("sidewall").inner_radius
    corners = (Corner((0.0, "hollow")), Corner(("rim", 0.0)), Corner(("radius", 0.0)), Corner(("radius", "thickness")),
               Corner((0.0, "thickness")))
    profile = Profile(Outline(corners), (("hollow", Dimension(0.05e-3)), ("rim", Dimension(rim))))
    chip = replace(small_chip, layers=tuple(
        replace(layer, profile=profile) if layer is lid else layer for layer in small_chip.layers), ports=None)
    section = section_of(chip)
    mesh = mesh_free(section, replace(fine(section), radii=(0.6 * rim,)))
    r, z = mesh.mesh.p[:, np.unique(mesh.mesh.t[:, mesh.mesh.subdomains["superstrate"]])]
    top = r[np.abs(z - z.max()) < 1e-12]
    assert top.size > 3
    assert np.abs(r[:, None] - top).min(axis=1).max() < 1e-12
