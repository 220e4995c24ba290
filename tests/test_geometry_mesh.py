"""Section and mesh: names, sizes, volumes, order of nodes, and gmsh's one session."""

import math
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
import skfem
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.chip import Chip, parse_chip, read_chip
from geometry.chip_section import volumes
from geometry.free_faces import gmsh_session
from geometry.mesh import MeshError, SectionMesh, elements_per_wavelength, mesh_section
from geometry.mesh_size import MeshSize, refined
from geometry.section import Section, cut_section
from workbench.files.errors import InputError

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
#: Slowest waves of the reference chip, m/s: shear in the solids, sound in the fluids.
SLOWEST = {
    "transducer": 1700.0,
    "couplant": 1480.0,
    "substrate": 900.0,
    "sidewall": 900.0,
    "bond": 930.0,
    "superstrate": 3400.0,
    "cavity": 1482.0,
}
SIZE = MeshSize(SLOWEST, 1.155e6, 10.0, 2, minimum_through_thickness=2, corner_refinement=0.5, growth=1.5)


@pytest.fixture(scope="module")
def chip() -> Chip:
    return read_chip(CHIPS / "reference_chip.toml")


@pytest.fixture(scope="module")
def section(chip: Chip) -> Section:
    return cut_section(chip)


@pytest.fixture(scope="module")
def mesh(section: Section) -> SectionMesh:
    return mesh_section(section, SIZE)


def make(layers: list[dict[str, Any]], *, filled: bool = False, unusual: tuple[str, ...] = ()) -> Chip:
    states = {"filled": {"cavity": "water"}} if filled else {}
    chip = {"name": "test", "band": ["0.9 MHz", "1.2 MHz"], "unusual": list(unusual)}
    content = {"chip": chip, "layers": layers, "states": states}
    return parse_chip(content, source="test")


def layer(role: str, thickness: str, radius: str, hole: str = "", **more: Any) -> dict[str, Any]:
    entry = {"role": role, "material": "m", "thickness": thickness, "radius": radius}
    return entry | ({"cavity_radius": hole} if hole else {}) | more


def uniform(section: Section, *, speed: float = 2000.0, frequency: float = 1e6) -> MeshSize:
    return MeshSize(dict.fromkeys(section.regions, speed), frequency, 10.0, 2, minimum_through_thickness=2,
                    corner_refinement=0.5, growth=1.5)


def node_lines(mesh: SectionMesh) -> tuple[np.ndarray, np.ndarray]:
    return np.unique(mesh.mesh.p[0]), np.unique(mesh.mesh.p[1])


# ---- section


def test_the_section_has_the_breaks_and_volumes_of_the_chip(chip: Chip, section: Section) -> None:
    assert section.r_breaks == pytest.approx([0, 4e-3, 12.5e-3, 13e-3], abs=1e-15)
    assert section.z_breaks == pytest.approx([0, 2.02e-3, 2.04e-3, 2.89e-3, 3.61e-3, 3.71e-3, 4.71e-3], abs=1e-15)
    for region, volume in volumes(chip).items():
        # Heights are differences of rounded sums: 1e-18 m of the 20 um layer.
        assert section.volume(region) == pytest.approx(volume, rel=1e-13)
    assert section.area("cavity") == pytest.approx(4e-3 * 0.82e-3, rel=1e-13)
    with pytest.raises(InputError, match=r"'cavty'.*did you mean 'cavity'"):
        section.volume("cavty")


def test_the_section_names_its_boundaries(section: Section) -> None:
    assert set(section.boundary_names()) == {
        "axis",
        "electrode_live",
        "electrode_ground",
        "couplant|transducer",
        "couplant|substrate",
        "cavity|substrate",
        "sidewall|substrate",
        "cavity|sidewall",
        "bond|cavity",
        "bond|sidewall",
        "cavity|superstrate",
        "bond|superstrate",
        *(f"{region}|outside" for region in section.regions if region != "cavity"),
    }


def test_breaks_closer_than_a_nanometre_are_one() -> None:
    discs = [layer("transducer", "2 mm", "10 mm"), layer("sample", "1 mm", "10.0000005 mm")]
    assert len(cut_section(make(discs)).r_breaks) == 2
    discs[1]["radius"] = "10.00001 mm"
    assert len(cut_section(make(discs)).r_breaks) == 3


def test_overlapping_rectangles_are_refused(section: Section) -> None:
    double = replace(section, rectangles=(*section.rectangles, replace(section.rectangles[0], region="layer")))
    with pytest.raises(ValueError, match="overlap"):
        double.grid()


# ---- mesh


def test_the_mesh_has_every_name_of_the_section(mesh: SectionMesh, section: Section) -> None:
    assert set(mesh.mesh.subdomains) == set(section.regions)
    assert set(mesh.mesh.boundaries) == set(section.boundary_names())
    cells = np.concatenate(list(mesh.mesh.subdomains.values()))
    assert np.array_equal(np.sort(cells), np.arange(mesh.mesh.t.shape[1])), "every cell is in exactly one region"


def test_regions_revolve_to_their_volume(mesh: SectionMesh, chip: Chip) -> None:
    # By quadrature of the finite elements themselves; exact for the linear integrand, so only rounding remains.
    weight = skfem.Functional(lambda w: 2.0 * np.pi * w.x[0])
    for region, volume in volumes(chip).items():
        cells = skfem.Basis(mesh.mesh, skfem.ElementQuad0(), elements=mesh.mesh.subdomains[region], intorder=2)
        assert weight.assemble(cells) == pytest.approx(volume, rel=1e-12)


def test_boundaries_have_the_area_of_the_chip(mesh: SectionMesh) -> None:
    weight = skfem.Functional(lambda w: 2.0 * np.pi * w.x[0])

    def area(name: str) -> float:
        facets = mesh.mesh.boundaries[name]
        # An interface is counted once, from the side of its first neighbour.
        basis = skfem.FacetBasis(mesh.mesh, skfem.ElementQuad0(), facets=facets, intorder=2)
        return float(weight.assemble(basis))

    rim, lid = math.pi * 12.5e-3**2, math.pi * 13e-3**2
    expected = {
        "axis": 0.0,
        "electrode_live": rim,
        "electrode_ground": rim,
        "couplant|transducer": rim,
        "couplant|outside": 2 * math.pi * 12.5e-3 * 20e-6,
        "cavity|substrate": math.pi * 4e-3**2,
        "cavity|sidewall": 2 * math.pi * 4e-3 * 0.72e-3,
        "bond|cavity": 2 * math.pi * 4e-3 * 0.1e-3,
        "bond|superstrate": lid - math.pi * 4e-3**2,
        "transducer|outside": rim + 2 * math.pi * 12.5e-3 * 2.02e-3,
        "substrate|outside": lid - rim + 2 * math.pi * 13e-3 * 0.85e-3,
        "superstrate|outside": lid + 2 * math.pi * 13e-3 * 1e-3,
    }
    for name, exact in expected.items():
        assert area(name) == pytest.approx(exact, rel=1e-12, abs=1e-18), name


def test_every_element_is_small_enough_for_its_wave(mesh: SectionMesh) -> None:
    counts = elements_per_wavelength(mesh, SLOWEST, 1.155e6)
    # A quotient may exceed a whole number of elements by rounding without costing one more element.
    assert set(counts) == set(SLOWEST)
    assert min(counts.values()) >= 10.0 * (1 - 1e-9)
    # The slowest region sets the size of its row and column, hence is not far finer than asked for.
    assert min(counts.values()) < 10.5
    # Air in the cavity of the same mesh is too coarse, and half the frequency twice as fine.
    assert elements_per_wavelength(mesh, {"cavity": 343.0}, 1.155e6)["cavity"] < 5.0
    halved = elements_per_wavelength(mesh, SLOWEST, 0.5775e6)
    assert halved["cavity"] == pytest.approx(2 * counts["cavity"])
    with pytest.raises(InputError, match=r"'cavty'.*did you mean 'cavity'"):
        elements_per_wavelength(mesh, {"cavty": 343.0}, 1e6)


def test_the_thinnest_layer_has_its_elements_across(mesh: SectionMesh, section: Section) -> None:
    assert np.count_nonzero((node_lines(mesh)[1] > 2.02e-3) & (node_lines(mesh)[1] < 2.04e-3)) == 1
    four = mesh_section(section, replace(SIZE, minimum_through_thickness=4))
    assert np.count_nonzero((node_lines(four)[1] > 2.02e-3) & (node_lines(four)[1] < 2.04e-3)) == 3


def test_a_layer_thicker_than_a_quarter_of_a_wavelength_has_its_elements_across(section: Section) -> None:
    # Of 4 mm, in elements of 8 mm: that counts for the layers that are thicker than a millimetre, here the transducer.
    size = MeshSize(dict.fromkeys(section.regions, 4e3), 1e6, 0.5, 4, minimum_through_quarter_wave=3)
    inner = node_lines(mesh_section(section, size))[1]
    across = [np.count_nonzero((inner > low + 1e-9) & (inner < high - 1e-9)) + 1
              for low, high in pairwise(section.z_breaks)]
    assert across == [3 if high - low > 1e-3 else 1 for low, high in pairwise(section.z_breaks)]
    assert sorted(set(across)) == [1, 3]


def test_elements_shrink_towards_the_corners(mesh: SectionMesh, section: Section) -> None:
    r, z = node_lines(mesh)
    regular = np.diff(r).max()
    rim = np.searchsorted(r, 4e-3 - 1e-9)
    for width in (r[rim] - r[rim - 1], r[rim + 1] - r[rim]):
        # The element at the corner is divided in two, one half again as long as the other.
        assert width == pytest.approx(regular / 2.5, rel=0.03)
    assert r[rim - 1] - r[rim - 2] == pytest.approx(regular * 1.5 / 2.5, rel=0.03)
    steep = mesh_section(section, replace(SIZE, corner_refinement=0.02, growth=6.0))
    fine = node_lines(steep)[0]
    steps = np.diff(fine)[np.searchsorted(fine, 4e-3 - 1e-9) :]
    # 1 + 6 + 36 parts of an element, the first 0.023 of it; then 1 + 6 + 36 + 216.
    assert steps[:5] == pytest.approx(regular * np.array([1.0, 6.0, 36.0, 216.0, 259.0]) / 259.0, rel=0.03)
    assert z[np.searchsorted(z, 2.89e-3 - 1e-9) + 1] - 2.89e-3 < 0.55 * 900.0 / 1.155e7
    plain = mesh_section(section, replace(SIZE, corner_refinement=1.0))
    assert np.diff(node_lines(plain)[0]).min() > 0.9 * regular
    assert plain.mesh.t.shape[1] < mesh.mesh.t.shape[1]


def test_a_layer_with_skins_has_a_row_of_elements_at_either_face(mesh: SectionMesh, section: Section) -> None:
    skinned = mesh_section(section, replace(SIZE, skins={"bond": 0.05}))
    (bond,) = (r for r in section.rectangles if r.region == "bond")
    skin = 0.05 * (bond.z_top - bond.z_bottom)
    lines = np.unique(skinned.mesh.p[1])
    inside = lines[(lines > bond.z_bottom - 1e-12) & (lines < bond.z_top + 1e-12)]
    assert np.diff(inside)[[0, -1]] == pytest.approx(skin, rel=1e-6)
    # Elsewhere the mesh is the same.
    others = np.unique(mesh.mesh.p[1])
    beside = [values[(values <= bond.z_bottom) | (values >= bond.z_top)] for values in (lines, others)]
    assert beside[0] == pytest.approx(beside[1], rel=1e-12)


def test_a_cavity_wall_that_goes_straight_on_is_no_rim() -> None:
    layers = [layer("transducer", "2 mm", "9 mm"), layer("sidewall", "2 mm", "9 mm", "4 mm")]
    layers += [layer("bond", "2 mm", "9 mm", "4 mm"), layer("superstrate", "2 mm", "9 mm")]
    straight = cut_section(make(layers, filled=True))
    layers[2]["cavity_radius"] = "5 mm"
    stepped = cut_section(make(layers, filled=True, unusual=("bond.cavity_radius",)))
    for section, width in ((straight, 0.2e-3), (stepped, 0.08e-3)):
        z = node_lines(mesh_section(section, uniform(section)))[1]
        seam = np.argmin(np.abs(z - 4e-3))
        # The regular size is rounded down to fit its interval of ten elements or so.
        assert np.diff(z)[seam - 1 : seam + 1] == pytest.approx(width, rel=0.1)


def smallest_beside(lines: np.ndarray, line: float) -> float:
    """The shorter of the elements on either side of a line that is not the last one."""
    at = int(np.argmin(np.abs(lines - line)))
    return float(np.diff(lines)[at - 1 : at + 1].min())


def test_the_mesh_is_graded_to_what_makes_a_singular_field_only() -> None:
    ends = {"live": "top", "live_radius": "4 mm"}
    layers = [layer("backing", "2 mm", "7 mm"), layer("transducer", "2 mm", "10 mm", electrodes=ends),
              layer("couplant", "20 um", "9 mm"), layer("sample", "1 mm", "11 mm")]
    section = cut_section(make(layers))
    coarse = replace(uniform(section), corner_refinement=0.1, growth=9.0, minimum_through_thickness=1)
    r, z = node_lines(mesh_section(section, coarse))
    # The corner between backing and disc, the end of the electrode, the rim of the gel; the rims of solids are none.
    for radius, graded in ((4e-3, True), (7e-3, True), (9e-3, True), (10e-3, False)):
        assert (smallest_beside(r, radius) < 0.021e-3) is graded, radius
    # The end of an electrode, in radius and height: smaller by the cube.
    assert max(smallest_beside(r, 4e-3), smallest_beside(z, 4e-3)) < 0.21e-6
    assert smallest_beside(z, 2e-3) < 0.021e-3
    # With electrodes that cover the disc there is nothing across the gel, and nothing at its faces.
    layers[1]["electrodes"] = {"live": "top"}
    section = cut_section(make(layers))
    z = node_lines(mesh_section(section, coarse))[1]
    assert np.diff(z)[np.searchsorted(z, 4e-3 - 1e-9) - 1 :][:3] == pytest.approx([0.2e-3, 0.02e-3, 0.2e-3], rel=1e-6)


def test_nodes_run_anticlockwise_from_bottom_left(mesh: SectionMesh) -> None:
    r, z = mesh.mesh.p[:, mesh.mesh.t]
    assert (r[0] == r[3]).all()
    assert (r[1] == r[2]).all()
    assert (r[1] > r[0]).all()
    assert (z[0] == z[1]).all()
    assert (z[2] == z[3]).all()
    assert (z[3] > z[0]).all()
    # Nodes and cells are numbered along r, then upwards.
    assert (np.lexsort(mesh.mesh.p) == np.arange(mesh.mesh.p.shape[1])).all()
    assert (np.diff(mesh.mesh.t[0]) > 0).all()


def test_breaks_are_met_exactly(mesh: SectionMesh, section: Section) -> None:
    r, z = node_lines(mesh)
    assert set(section.r_breaks) <= set(r)
    assert set(section.z_breaks) <= set(z)


def test_partial_electrodes_are_where_the_chip_says() -> None:
    electrodes = {"live": "bottom", "live_radius": "4 mm", "live_inner_radius": "1 mm", "ground_radius": "9.5 mm"}
    section = cut_section(
        make([layer("transducer", "2 mm", "10 mm", electrodes=electrodes), layer("sample", "1 mm", "11 mm")])
    )
    mesh = mesh_section(section, uniform(section)).mesh
    for name, inner, outer, height in (("electrode_live", 1e-3, 4e-3, 0.0), ("electrode_ground", 0.0, 9.5e-3, 2e-3)):
        r, z = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]]
        assert (r.min(), r.max()) == pytest.approx((inner, outer))
        assert z == pytest.approx(height)
        assert np.abs(np.diff(r, axis=0)).sum() == pytest.approx(outer - inner, rel=1e-12)
    # Live below, the layer above: what is not electrode there is interface only.
    assert set(mesh.boundaries["electrode_ground"]) < set(mesh.boundaries["sample|transducer"])
    assert set(mesh.boundaries["electrode_live"]) < set(mesh.boundaries["transducer|outside"])


def test_repeated_layers_get_their_own_regions() -> None:
    layers = [layer(role, "0.3 mm", "5 mm") for role in ("transducer", "bond", "layer", "bond", "layer", "bond")]
    section = cut_section(make(layers))
    mesh = mesh_section(section, uniform(section)).mesh
    assert {"bond", "bond_2", "bond_3", "layer", "layer_2"} < set(mesh.subdomains)
    assert {"bond_2|layer", "bond_2|layer_2", "bond_3|layer_2", "bond|layer"} < set(mesh.boundaries)


def test_a_region_where_nothing_propagates_does_not_refine(section: Section) -> None:
    air = mesh_section(section, replace(SIZE, slowest_wave=SLOWEST | {"cavity": 343.0}))
    vacuum = mesh_section(section, replace(SIZE, slowest_wave=SLOWEST | {"cavity": math.inf}))
    assert len(air.mesh.subdomains["cavity"]) > 2 * len(vacuum.mesh.subdomains["cavity"])
    with pytest.raises(InputError, match="finite speed"):
        mesh_section(section, replace(SIZE, slowest_wave=dict.fromkeys(SLOWEST, math.inf)))


def test_refining_doubles_the_elements_per_wavelength(mesh: SectionMesh, section: Section) -> None:
    finer = mesh_section(section, refined(SIZE, 2.0))
    before, after = (elements_per_wavelength(m, SLOWEST, 1.155e6) for m in (mesh, finer))
    assert after["substrate"] >= 20.0 * (1 - 1e-9)
    assert after["substrate"] / before["substrate"] == pytest.approx(2, rel=0.05)
    assert 3.0 < finer.mesh.t.shape[1] / mesh.mesh.t.shape[1] < 4.5
    assert np.count_nonzero((node_lines(finer)[1] > 2.02e-3) & (node_lines(finer)[1] < 2.04e-3)) == 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frequency_max": 0.0}, "frequency_max: received 0.0"),
        ({"elements_per_wavelength": -1.0}, "elements_per_wavelength: received -1.0"),
        ({"order": 0}, "order: received 0"),
        ({"minimum_through_thickness": 0}, "minimum_through_thickness: received 0"),
        ({"minimum_through_quarter_wave": 0}, "minimum_through_quarter_wave: received 0"),
        ({"corner_refinement": 1.5}, "corner_refinement: received 1.5"),
        ({"skins": {"bond": 0.5}}, "skins.bond: received 0.5"),
        ({"slowest_wave": {"cavity": -1.0}}, r"slowest_wave\.cavity: received -1.0"),
    ],
)
def test_a_size_out_of_range_is_refused(change: Mapping[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(SIZE, **change)


def test_a_region_without_speed_is_refused(section: Section) -> None:
    speeds = {name: speed for name, speed in SLOWEST.items() if name != "bond"} | {"bnd": 930.0}
    with pytest.raises(InputError, match=r"slowest_wave\.bond.*did you mean 'bnd'"):
        mesh_section(section, replace(SIZE, slowest_wave=speeds))


def test_a_mesh_that_is_not_the_section_is_refused(mesh: SectionMesh) -> None:
    inner = mesh.mesh
    fewer = {name: cells for name, cells in inner.subdomains.items() if name != "bond"}
    with pytest.raises(MeshError, match=r"regions missing from the mesh: \['bond'\]"):
        SectionMesh(replace(inner, _subdomains=fewer), 2, mesh.section)
    with pytest.raises(MeshError, match=r"boundaries missing from the mesh: \['axis'\]"):
        SectionMesh(replace(inner, _boundaries=inner.boundaries | {"axis": np.array([], dtype=int)}), 2, mesh.section)
    with pytest.raises(MeshError, match=r"not of the section: \['rim'\]"):
        SectionMesh(replace(inner, _boundaries=inner.boundaries | {"rim": np.array([0])}), 2, mesh.section)
    with pytest.raises(MeshError, match=r"volume of|area of"):
        SectionMesh(replace(inner, doflocs=inner.p * (1 + 1e-8)), 2, mesh.section)
    with pytest.raises(MeshError, match="without area"):
        SectionMesh(replace(inner, t=inner.t[[1, 0, 3, 2]]), 2, mesh.section)


# ---- random chips

LENGTHS = st.integers(1, 12).map(lambda n: f"{n / 4} mm")


@st.composite
def chips(draw: st.DrawFn) -> Chip:
    """Stacks with radii from a coarse lattice, so that some coincide, and often a cavity through one or two layers."""

    def radius(low: int) -> str:
        return f"{draw(st.integers(low, 40)) / 4} mm"

    thin = st.sampled_from(["10 um", "20 um", "0.13 mm", "0.85 mm", "2.02 mm"])
    electrodes = {"live": draw(st.sampled_from(["top", "bottom"]))}
    if draw(st.booleans()):
        electrodes["live_radius"] = f"{draw(st.integers(1, 16)) / 4} mm"
    layers = [layer("transducer", draw(thin), radius(16), electrodes=electrodes)]
    if draw(st.booleans()):
        layers.insert(0, layer("backing", draw(thin), radius(4)))
    layers += [layer("layer", draw(thin), radius(16)) for _ in range(draw(st.integers(0, 2)))]
    holes = draw(st.integers(0, 2))
    layers += [layer("sidewall", draw(thin), radius(17), f"{draw(st.integers(1, 15)) / 4} mm") for _ in range(holes)]
    layers += [layer("superstrate", draw(thin), radius(16))]
    return make(layers, filled=holes > 0)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(chip=chips(), speed=st.sampled_from([700.0, 1500.0, 4000.0]), refinement=st.sampled_from([0.3, 0.5, 1.0]))
def test_any_chip_is_meshed_conforming_and_complete(chip: Chip, speed: float, refinement: float) -> None:
    section = cut_section(chip)
    size = replace(uniform(section, speed=speed), corner_refinement=refinement)
    mesh = mesh_section(section, size)
    # Names and volumes are checked by the mesh itself; conforming: no node lies on the side of a cell.
    # On a tensor grid that is the same as no two neighbouring lines of one cell having another line between them.
    r_lines, z_lines = node_lines(mesh)
    r, z = mesh.mesh.p[:, mesh.mesh.t]
    assert (np.searchsorted(r_lines, r[1]) - np.searchsorted(r_lines, r[0]) == 1).all()
    assert (np.searchsorted(z_lines, z[3]) - np.searchsorted(z_lines, z[0]) == 1).all()
    assert len(np.unique(mesh.mesh.p, axis=1).T) == mesh.mesh.p.shape[1], "no node twice"
    for region, volume in volumes(chip).items():
        assert section.volume(region) == pytest.approx(volume, rel=1e-12)
    assert min(elements_per_wavelength(mesh, size.slowest_wave, 1e6).values()) >= 10 * (1 - 1e-9)


# ---- gmsh's session


def test_the_session_refuses_to_nest_and_closes_on_an_error() -> None:
    with pytest.raises(MeshError, match="open already"), gmsh_session(), gmsh_session():
        pass
    assert not gmsh.isInitialized()
    with pytest.raises(ZeroDivisionError), gmsh_session():
        1 / 0  # noqa: B018
    assert not gmsh.isInitialized()


def test_options_of_one_session_do_not_reach_the_next() -> None:
    with gmsh_session() as session:
        session.option.setNumber("Mesh.ElementOrder", 2)
    with gmsh_session() as session:
        assert session.option.getNumber("Mesh.ElementOrder") == 1


@pytest.mark.skipif(os.name != "posix", reason="a broken pipe is a signal on POSIX systems only")
def test_a_program_that_has_meshed_outlives_a_broken_pipe() -> None:
    # gmsh sets the handler of the system, here in a thread: a page whose browser is closed would end its server.
    code = """
import os, threading
from geometry.free_faces import gmsh_session

def mesh():
    with gmsh_session():
        pass

thread = threading.Thread(target=mesh)
thread.start()
thread.join()
reading, writing = os.pipe()
os.close(reading)
try:
    os.write(writing, b"x")
except BrokenPipeError:
    print("alive")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False,
                          cwd=Path(__file__).resolve().parent.parent)
    assert (done.stdout.strip(), done.returncode) == ("alive", 0)
