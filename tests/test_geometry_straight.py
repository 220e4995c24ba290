"""Straight chips: their files, sections and meshes, and what they are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import chip_from, layer_text

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import volumes
from geometry.limits import ETCHED, OFF_THE_MIDDLE, ONE_CHANNEL
from geometry.measure import ABOUT_AXIS, Parity, Straight
from geometry.mesh import mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section, cut_section
from workbench.files.errors import InputError

CHIP = """
[chip]
name = "channel"
band = ["1.5 MHz", "2.5 MHz"]
geometry = "straight"
length = "20 mm"
symmetry = "even"
""" + "".join((
    layer_text("transducer", "pzt4/acevedo_2026_fitted", thickness="1 mm",
               width='{ value = "5 mm", tolerance = "40 um" }',
               electrodes='{ live = "bottom", ground_half_width = "2 mm" }'),
    layer_text("bond", "epoxy", thickness="20 um", half_width="1.5 mm"),
    layer_text("substrate", "soda_lime_glass/ono_2020", thickness="0.5 mm", half_width="1.5 mm"),
    layer_text("sidewall", "soda_lime_glass/ono_2020", thickness="160 um", half_width="1.5 mm", cavity_width="380 um"),
    layer_text("superstrate", "soda_lime_glass/ono_2020", thickness="0.5 mm", half_width="1.5 mm"),
)) + """
[states.filled]
cavity = "water"
"""


def chip(text: str = CHIP) -> Chip:
    return chip_from(text)


def test_a_file_says_length_symmetry_and_widths() -> None:
    found = chip()
    assert found.measure == Straight(0.02, Parity.EVEN)
    known = found.dimensions()
    assert known["transducer.half_width"].value == pytest.approx(2.5e-3)
    assert known["transducer.half_width"].tolerance == pytest.approx(20e-6)
    assert known["cavity.half_width"].value == pytest.approx(190e-6)
    assert known["electrode_ground.half_width"].value == pytest.approx(2e-3)
    moved = found.with_dimensions({"cavity.half_width": 2e-4, "electrode_ground.half_width": 1.9e-3})
    assert moved.layer("sidewall").inner_radius == 2e-4
    assert moved.dimensions()["electrode_ground.half_width"].value == 1.9e-3


def test_per_metre_and_even_unless_said() -> None:
    text = CHIP.replace('length = "20 mm"\nsymmetry = "even"\n', "")
    assert chip(text).measure == Straight(1.0, Parity.EVEN)


@pytest.mark.parametrize("symmetry", ["even", "odd", "none"])
def test_a_written_file_is_read_back(symmetry: str, tmp_path: Path) -> None:
    text = CHIP.replace('"even"', f'"{symmetry}"').replace('live = "bottom"', 'live = "bottom", '
                                                           'live_inner_half_width = "0.2 mm"')
    found = replace(chip(text), file=str(tmp_path / "chip.toml"))
    assert read_chip(write_chip(found, tmp_path / "chip.toml")) == found


@pytest.mark.parametrize(("old", "new", "words"), [
    ('width = { value = "5 mm", tolerance = "40 um" }', 'radius = "2.5 mm"', "half_width"),
    ('cavity_width = "380 um"', 'cavity_diameter = "380 um"', "cavity_width"),
    ('ground_half_width = "2 mm"', 'ground_radius = "2 mm"', "ground_half_width"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\ndraft = "50 deg"', "less than 45 deg to either side"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\nundercut = "3 um"', "draft = .* angle by which it grows"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\noffset = "0.5 mm"', "no offset.*none"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\ncavity_offset = "0.1 mm"', "no offset.*none"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\nx_offset = "0.5 mm"', "cavity_offset of a channel"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\nspacing = "1 mm"', "channels = 3 and pitch"),
    ('cavity_width = "380 um"', 'cavity_width = "4 mm"', "cavity_half_width.*narrower than its layer"),
    ('cavity_width = "380 um"', 'cavity_width = "380 um"\nprofile = { points = [] }', "three or more points"),
    ('length = "20 mm"', 'length = "-1 mm"', "above zero"),
    ('length = "20 mm"', 'length = "20 m"', r"chip\.length: received '20 m'.*did you mean '20 mm'"),
    ('symmetry = "even"', 'symmetry = "mirror"', "even, none, odd"),
    ('live = "bottom"', 'live = "bottom", live_half_width = "1 mm", live_inner_half_width = "2 mm"',
     r"electrode_live\.inner_half_width: .*below its half width, 1 mm"),
    ('cavity_width = "380 um"', 'cavity_width = { value = "380 um", tolerance = "400 um" }',
     r"layers\[3\]\.cavity_half_width\.tolerance"),
    ('geometry = "straight"', 'geometry = "axisymmetric"', 'geometry = "straight"'),
    ('geometry = "straight"', 'geometry = "strait"', "straight"),
    ('symmetry = "even"', 'symmetry = "odd"', "gap"),
    ("[states.filled]", '[cavity]\nports = { diameter = "0.1 mm" }\n\n[states.filled]', "no ports"),
])
def test_mistakes_and_what_is_not_there_yet_are_told(old: str, new: str, words: str) -> None:
    assert old in CHIP
    with pytest.raises(InputError, match="(?s)" + words):
        chip(CHIP.replace(old, new))


def test_a_row_of_chips_has_no_file_and_a_plane_on_the_right_alone_is_no_section(tmp_path: Path) -> None:
    row = replace(chip(), measure=Straight(1.0, Parity.EVEN, Parity.EVEN))
    with pytest.raises(InputError, match="no row"):
        write_chip(row, tmp_path / "chip.toml")
    with pytest.raises(InputError, match="on the left"):
        replace(chip(), measure=Straight(1.0, Parity.NONE, Parity.EVEN))
    with pytest.raises(InputError, match="above zero"):
        Straight(0.0)


def test_volumes_are_those_of_the_whole_chip_whatever_is_meshed() -> None:
    even, whole = chip(), chip(CHIP.replace('"even"', '"none"'))
    for found in (even, whole):
        assert volumes(found)["cavity"] == pytest.approx(380e-6 * 160e-6 * 0.02, rel=1e-12)
        assert volumes(found)["sidewall"] == pytest.approx((3e-3 - 380e-6) * 160e-6 * 0.02, rel=1e-12)
    assert cut_section(even).area("cavity") == pytest.approx(0.5 * cut_section(whole).area("cavity"), rel=1e-12)


def test_a_mesh_names_the_plane_and_all_pieces_of_an_electrode() -> None:
    whole = chip(CHIP.replace('"even"', '"none"').replace('live = "bottom"',
                                                          'live = "bottom", live_inner_half_width = "0.2 mm"'))
    for found, planes in ((chip(), {"plane_left"}), (whole, set())):
        section = cut_section(found)
        mesh = mesh_section(section, MeshSize(dict.fromkeys(section.regions, 1.0), 2500.0, 1.0, 2)).mesh
        assert {name for name in mesh.boundaries if "plane" in name or name == "axis"} == planes
        for name in planes:
            assert (mesh.p[0, mesh.facets[:, mesh.boundaries[name]]] == 0.0).all()
    ends = mesh.p[0, mesh.facets[:, mesh.boundaries["electrode_live"]]]
    assert np.ptp(ends, axis=0).sum() == pytest.approx(2.0 * 2.3e-3, rel=1e-12)
    assert np.abs(ends).min() == pytest.approx(0.2e-3)
    assert ends.min() == pytest.approx(-2.5e-3)


OFF = CHIP.replace('"even"', '"none"').replace(
    'role = "transducer"', 'role = "transducer"\noffset = "-0.3 mm"').replace(
    'cavity_width = "380 um"', 'cavity_width = "380 um"\ncavity_offset = "0.2 mm"')


def test_parts_off_the_middle_are_where_their_offsets_put_them(tmp_path: Path) -> None:
    found = replace(chip(OFF), file=str(tmp_path / "chip.toml"))
    assert read_chip(write_chip(found, tmp_path / "chip.toml")) == found
    section = cut_section(found)
    reach = {region: (min(p.r_inner for p in section.rectangles if p.region == region),
                      max(p.r_outer for p in section.rectangles if p.region == region)) for region in section.regions}
    half = found.transducer.outer_radius
    assert reach["transducer"] == pytest.approx((-0.3e-3 - half, -0.3e-3 + half))
    assert reach["cavity"] == pytest.approx((10e-6, 390e-6))
    assert reach["sidewall"] == pytest.approx((-1.5e-3, 1.5e-3))
    live = [(each.r_inner, each.r_outer) for each in section.electrodes if each.name == "electrode_live"]
    assert live == [reach["transducer"]]
    assert volumes(found) == pytest.approx(volumes(chip()), rel=1e-12)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('offset = "-0.3 mm"', 'offset = "5 mm"', "lies on 'transducer'"),
    ('cavity_offset = "0.2 mm"', 'cavity_offset = "1.4 mm"', "narrower than its layer"),
])
def test_parts_that_miss_each_other_are_told(old: str, new: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        chip(OFF.replace(old, new))


@pytest.mark.parametrize("symmetry", ["even", "none"])
def test_elements_in_corners_of_a_channel_and_at_the_end_of_a_bond_are_of_their_size(symmetry: str) -> None:
    section = cut_section(chip(CHIP.replace('"even"', f'"{symmetry}"')))
    size = MeshSize(dict.fromkeys(section.regions, 1500.0), 2.5e6, 1.5, 4, corner_refinement=0.5, cavity_corner=0.1)

    def steps(place: float, axis: int) -> list[float]:
        """Lengths (m) of the elements on both sides of a place."""
        nodes = np.unique(np.round(mesh_section(section, size).mesh.p[axis], 12))
        at = int(np.abs(nodes - place).argmin())
        return [float(nodes[at + 1] - nodes[at]), float(nodes[at] - nodes[at - 1])]

    # A tenth of the 190 um from the middle to the side wall, whichever part of the channel is meshed; the channel
    # stands on 1.52 mm.
    for place, axis in ((190e-6, 0), (1.52e-3, 1), (1.68e-3, 1)):
        assert max(steps(place, axis)) <= 19e-6 * (1.0 + 1e-9)
    assert max(steps(1.5e-3, 0)) <= 20e-6 * (1.0 + 1e-9)  # the bond is 20 um thick
    # A corner that is not the channel's has what it had: half of the 0.4 mm of an element.
    size = replace(size, cavity_corner=math.inf)
    assert max(steps(190e-6, 0)) > 50e-6


def test_sections_that_make_no_sense_are_refused() -> None:
    plate = (Rectangle("transducer", 0.0, 1e-3, 0.0, 1e-3),)
    lines = (Electrode("electrode_live", 0.0, 1e-3, 0.0), Electrode("electrode_ground", 0.0, 1e-3, 1e-3))
    with pytest.raises(ValueError, match="odd symmetry"):
        Section(plate, lines, Straight(1.0, Parity.ODD))
    with pytest.raises(ValueError, match=r"begins at r = -0\.001"):
        Section((Rectangle("transducer", -1e-3, 1e-3, 0.0, 1e-3),), lines, ABOUT_AXIS)


def test_limits_of_straight_chips_are_documented() -> None:
    text = " ".join((Path(__file__).resolve().parent.parent / "docs" / "model.md").read_text(encoding="utf-8").split())
    for words in (OFF_THE_MIDDLE, ONE_CHANNEL, ETCHED):
        assert words in text


def test_a_second_and_an_open_channel_are_refused_in_words_of_straight_chips() -> None:
    lid = CHIP[CHIP.rindex("[[layers]]"):CHIP.index("[states.filled]")]
    wall = CHIP[CHIP.rindex("[[layers]]", 0, CHIP.index('role = "sidewall"')):CHIP.rindex("[[layers]]")]
    with pytest.raises(InputError, match='inner_half_width and filling = "water"') as caught:
        chip(CHIP.replace(lid, lid.replace("superstrate", "substrate") + wall + lid))
    assert "axisymmetric" not in str(caught.value)
    with pytest.raises(InputError, match="for an open well or channel, state open = true") as caught:
        chip(CHIP.replace(lid, ""))
    assert "cavity_half_width" in str(caught.value)
