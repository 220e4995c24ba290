"""Chip files: what is read, what can be changed by name, and what is refused with which words."""

import math
import pickle
from dataclasses import replace
from pathlib import Path

import pytest
from support import layer_text

from geometry.chip import Chip, parse_chip, read_chip
from geometry.chip_section import volumes
from geometry.limits import CENTRED, CLOSED, FULL_DISC, FURTHER_CAVITY, NOT_ROUND
from geometry.names import interface, outside, region_names, role_of
from workbench.files.errors import InputError

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"

TEXT = """
[chip]
name = "test chip"
band = ["0.91 MHz", "1.155 MHz"]
""" + "".join((
    layer_text("transducer", "pzt4", density="7500 kg/m^3",
               thickness='{ value = "2.02 mm", tolerance = "20 um", assumed = true, note = "caliper" }',
               radius="12.5 mm", electrodes='{ live = "top", live_radius = "9 mm" }'),
    layer_text("couplant", "gel", thickness="20 um", radius="12.5 mm"),
    layer_text("substrate", "pla", thickness="0.85 mm", radius="13 mm"),
    layer_text("sidewall", "pla", thickness="0.72 mm", radius="13 mm", cavity_radius="4 mm"),
    layer_text("bond", "epoxy", thickness="0.1 mm", radius="13 mm", cavity_radius="4 mm"),
    layer_text("superstrate", "glass", thickness="1 mm", radius="13 mm"),
)) + """[cavity]
ports = { diameter = "0.4 mm", count = 2 }
[states.empty]
cavity = "vacuum"
[states.filled]
cavity = "water"
temperature = "25 degC"
particle = "polystyrene"
particle_radius = "5 um"
materials = { substrate = "pla/wet" }
"""


def read(text: str, folder: Path) -> Chip:
    path = folder / "chip.toml"
    path.write_text(text, encoding="utf-8")
    return read_chip(path)


def test_a_chip_file_is_read_in_si_units(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    assert chip.regions == ("transducer", "couplant", "substrate", "sidewall", "bond", "superstrate", "cavity")
    assert chip.band == (0.91e6, 1.155e6)
    thickness = chip.transducer.thickness
    assert thickness.value == pytest.approx(2.02e-3)
    assert thickness.tolerance == pytest.approx(20e-6)
    assert thickness.assumed
    assert thickness.note == "caliper"
    assert chip.transducer.density == 7500.0
    assert chip.layer("bond").z_bottom == pytest.approx(3.61e-3, abs=1e-15)
    assert chip.layer("superstrate").z_top == pytest.approx(4.71e-3, abs=1e-15)
    assert (chip.layer("bond").inner_radius, chip.layer("superstrate").inner_radius) == (4e-3, 0.0)
    assert chip.dimensions()["electrode_live.radius"].value == pytest.approx(9e-3)
    assert chip.electrodes.ground_disc.radius is None
    filled = chip.state("filled")
    assert (filled.temperature, filled.particle) == (298.15, "polystyrene")
    assert filled.particle_radius == pytest.approx(5e-6)
    assert chip.materials("filled")["substrate"] == "pla/wet"
    assert chip.materials("empty")["substrate"] == "pla"
    assert chip.materials("filled")["cavity"] == "water"
    assert chip.materials("empty")["cavity"] == "vacuum"


def test_a_chip_without_cavity_has_one_state(tmp_path: Path) -> None:
    chip = read(TEXT[: TEXT.index('[[layers]]\nrole = "substrate"')], tmp_path)
    assert [state.name for state in chip.states] == ["default"]
    assert chip.materials("default") == {"transducer": "pzt4", "couplant": "gel"}
    assert chip.regions == ("transducer", "couplant")
    assert set(volumes(chip)) == set(chip.regions)


def test_an_explicit_bottom_moves_the_lowest_layer_and_agrees_with_the_stack(tmp_path: Path) -> None:
    lowest = TEXT.replace('material = "pzt4"', 'material = "pzt4"\nbottom = "1 mm"')
    chip = read(lowest.replace('material = "gel"', 'material = "gel"\nbottom = "3.02 mm"'), tmp_path)
    assert chip.layer("substrate").z_bottom == pytest.approx(3.04e-3, abs=1e-15)


def test_volumes_are_the_closed_forms(tmp_path: Path) -> None:
    found = volumes(read(TEXT, tmp_path))
    assert found["transducer"] == pytest.approx(math.pi * 12.5e-3**2 * 2.02e-3, rel=1e-14)
    assert found["bond"] == pytest.approx(math.pi * (13e-3**2 - 4e-3**2) * 0.1e-3, rel=1e-14)
    # The cavity passes through the bond ring as well.
    assert found["cavity"] == pytest.approx(math.pi * 4e-3**2 * 0.82e-3, rel=1e-14)


def test_dimensions_are_named_and_changed_by_name(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    names = chip.dimensions()
    assert names["cavity.radius"].value == 4e-3
    assert names["electrode_live.radius"].value == pytest.approx(9e-3)
    assert "bond.cavity_radius" not in names
    assert "electrode_ground.radius" not in names
    wider = chip.with_dimensions({"cavity.radius": 4.1e-3, "couplant.thickness": 30e-6})
    assert [hole.inner_radius for hole in wider.holes] == [4.1e-3, 4.1e-3]
    assert wider.layer("superstrate").z_top == pytest.approx(4.72e-3, abs=1e-15)
    assert chip.holes[0].inner_radius == 4e-3, "the chip it came from is unchanged"
    assert chip.with_dimensions({name: d.value for name, d in names.items()}) == chip
    for name, dimension in names.items():
        changed = chip.with_dimensions({name: 0.999 * dimension.value}).dimensions()
        assert changed[name].value == 0.999 * dimension.value
        assert {k: v for k, v in changed.items() if k != name} == {k: v for k, v in names.items() if k != name}
        assert changed[name].note == dimension.note


def test_holes_of_different_width_are_dimensions_of_their_layers(tmp_path: Path) -> None:
    bond = TEXT.index('role = "bond"')
    text = TEXT[:bond] + TEXT[bond:].replace('cavity_radius = "4 mm"', 'cavity_radius = "5 mm"')
    with pytest.warns(UserWarning, match=r"layers\[4\]\.cavity_radius: received 5 mm of 'bond'; expected that of the "
                      r"cavity beside it, 4 mm of 'sidewall'; .* unusual = \[\"bond\.cavity_radius\"\]"):
        read(text, tmp_path)
    chip = read(text.replace("[chip]", '[chip]\nunusual = ["bond.cavity_radius"]'), tmp_path)
    names = chip.dimensions()
    assert (names["sidewall.cavity_radius"].value, names["bond.cavity_radius"].value) == (4e-3, 5e-3)
    assert "cavity.radius" not in names
    assert [h.inner_radius for h in chip.with_dimensions({"bond.cavity_radius": 6e-3}).holes] == [4e-3, 6e-3]


def test_a_full_electrode_follows_the_disc(tmp_path: Path) -> None:
    chip = read(TEXT.replace('live_radius = "9 mm"', 'live_radius = "12.5 mm"'), tmp_path)
    assert chip.electrodes.live_disc.radius is None
    assert chip.with_dimensions({"transducer.radius": 11e-3}).electrodes == chip.electrodes


def test_repeated_roles_are_numbered_from_below() -> None:
    assert region_names(["bond", "layer", "bond", "bond"]) == ("bond", "layer", "bond_2", "bond_3")
    assert [role_of(region) for region in ("bond", "bond_2", "layer_10")] == ["bond", "bond", "layer"]


def test_boundary_names_do_not_depend_on_the_order() -> None:
    assert interface("cavity", "bond") == interface("bond", "cavity") == "bond|cavity"
    assert outside("bond") == "bond|outside"


# (what is replaced in TEXT, by what, field, further words of the message)
TOP_RING = 'thickness = "1 mm"\nradius = "13 mm"\ncavity_radius = "4 mm"'
MISTAKES = {
    "zero thickness": ('"0.85 mm"', '"0 mm"', "layers[2].thickness", ("above zero",)),
    "negative thickness": ('"0.85 mm"', '"-0.85 mm"', "layers[2].thickness", ("-0.85 mm", "above zero")),
    "zero radius": (
        'thickness = "1 mm"\nradius = "13 mm"',
        'thickness = "1 mm"\nradius = "0 mm"',
        "layers[5].radius",
        (),
    ),
    "negative film": ('"20 um"\nradius', '"-20 um"\nradius', "layers[1].thickness", ("received '-20 um'",)),
    "decimal comma": ('"0.85 mm"', '"0,85 mm"', "layers[2].thickness", ("decimal point, not a comma: \"0.85 mm\"",)),
    "negative tolerance": ('nce = "20 um"', 'nce = "-20 um"', "layers[0].thickness.tolerance", ("'-20 um'",)),
    "radius and diameter": ('live_radius = "9 mm"', 'live_radius = "9 mm", live_diameter = "18 mm"',
                            "layers[0].electrodes.live_diameter", ("live_radius or live_diameter, not both",)),
    "electrode wider by its diameter": ('live_radius = "9 mm"', 'live_diameter = "26 mm"',
                                        "layers[0].electrodes.live_diameter", ("26 mm", "diameter, 25 mm")),
    "width of a plate": ('material = "gel"', 'material = "gel"\nwidth = "5 mm"', "layers[1].width",
                         ("'5 mm'", "axisymmetric only", "a disc of its thickness and area")),
    "offset": ('material = "gel"', 'material = "gel"\noffset = "5 mm"', "layers[1].offset",
               ("axisymmetric only", "state a part beside the axis")),
    "fill height": ('cavity = "water"', 'cavity = "water"\nfill_height = "0.5 mm"', "states.filled.fill_height",
                    ("open well", "under [cavity]")),
    "missing unit": ('"0.85 mm"', '"0.85"', "layers[2].thickness", ("'0.85'", "mm")),
    "bare number": ('"0.85 mm"', "0.85", "layers[2].thickness", ("0.85", "unit")),
    "unknown unit": ('"20 um"\nradius', '"20 mum"\nradius', "layers[1].thickness", ("'20 mum'", "'um'")),
    "wrong quantity": ('"7500 kg/m^3"', '"7500 kg"', "layers[0].density", ("'7500 kg'", "kg/m^3")),
    "zero density": ('"7500 kg/m^3"', '"0 kg/m^3"', "layers[0].density", ("above zero",)),
    "unknown key": ("cavity_radius", "cavity_radios", "layers[3].cavity_radios", ("'cavity_radius'",)),
    "unknown table": ("[cavity]", "[cavty]", "cavty", ("'cavity'",)),
    "unknown role": ('"superstrate"', '"superstate"', "layers[5].role", ("'superstate'", "did you mean 'superstrate'")),
    "electrodes of a backing": ('role = "transducer"', 'role = "backing"', "layers[0].electrodes", ("'electrodes'",)),
    "two transducers": ('role = "substrate"', 'role = "transducer"', "layers[2].electrodes", ('{ live = "top" }',)),
    "no transducer": ('role = "transducer"', 'role = "layer"', "layers[0].electrodes", ("'electrodes'",)),
    "a poled substrate": ('role = "substrate"', 'role = "substrate"\npoled = "down"', "layers[2].poled", ("'poled'",)),
    "poled sideways": ('role = "transducer"', 'role = "transducer"\npoled = "left"', "layers[0].poled", ("down, up",)),
    "a ring without a rim": ('role = "transducer"', 'role = "transducer"\ninner_radius = "12.5 mm"',
                             "layers[0].inner_radius", ("12.5 mm", "narrower")),
    "electrode inside the ring": ('live_radius = "9 mm"', 'live_radius = "9 mm", live_inner_radius = "2 mm" }\n'
                                  'inner_radius = "3 mm"\nunused = {', "layers[0].unused", ()),
    "a hole below the cavity": ('role = "substrate"', 'role = "substrate"\ninner_radius = "1 mm"',
                                "layers[2].inner_radius", ("a closed cavity", "open = true")),
    "a cavity and a bore": ('cavity_radius = "4 mm"', 'cavity_radius = "4 mm"\ninner_radius = "4 mm"',
                            "layers[3].inner_radius", ("either",)),
    "more fill than cavity": ("[cavity]", '[cavity]\nfill = "2 mm"', "cavity.fill", ("2 mm", "0.82 mm")),
    "a closed fill": ("[cavity]", '[cavity]\nopen = false\nfill = "0.2 mm"', "cavity.fill", ("free",)),
    "cavity wider than its layer": (
        'cavity_radius = "4 mm"',
        'cavity_radius = "13 mm"',
        "layers[3].cavity_radius",
        ("13 mm", "below"),
    ),
    "cavity open at the top": (
        'thickness = "1 mm"\nradius = "13 mm"',
        TOP_RING,
        "layers[5].cavity_radius",
        ("4 mm", "layer above", "open well", "open = true"),
    ),
    "cavity open at the lid": (
        'thickness = "1 mm"\nradius = "13 mm"',
        'thickness = "1 mm"\nradius = "3 mm"',
        "layers[4].cavity_radius",
        ("closed", "'superstrate' above reaches only 3 mm"),
    ),
    "cavity wider than its floor": (
        '"0.85 mm"\nradius = "13 mm"',
        '"0.85 mm"\nradius = "3.5 mm"',
        "layers[3].cavity_radius",
        ("closed", "'substrate' below reaches only 3.5 mm"),
    ),
    "holes apart": (
        'role = "bond"',
        'role = "layer"\nmaterial = "pla"\nthickness = "1 mm"\nradius = "13 mm"\n[[layers]]\nrole = "bond"',
        "layers[4].cavity_radius",
        ("'layer'", "neighbouring", "the one with the particles is the cavity", 'inner_radius and filling = "water"'),
    ),
    "hole through the transducer": (
        'density = "7500 kg/m^3"',
        'cavity_radius = "1 mm"',
        "layers[0].cavity_radius",
        ("received '1 mm'", "for a ring, state inner_radius"),
    ),
    "electrode wider than the disc": (
        'live_radius = "9 mm"',
        'live_radius = "12.6 mm"',
        "layers[0].electrodes.live_radius",
        ("12.6 mm", "12.5 mm"),
    ),
    "electrode ring inside out": (
        'live_radius = "9 mm"',
        'live_radius = "9 mm", live_inner_radius = "9.5 mm"',
        "electrode_live.inner_radius",
        ("9.5 mm", "below"),
    ),
    "electrode on the side": ('live = "top"', 'live = "side"', "layers[0].electrodes.live", ("'side'", "bottom, top")),
    "band reversed": ('["0.91 MHz", "1.155 MHz"]', '["1.155 MHz", "0.91 MHz"]', "chip.band",
                      ("['1.155 MHz', '0.91 MHz']", "lower one first")),
    "band of one": ('["0.91 MHz", "1.155 MHz"]', '["0.91 MHz"]', "chip.band", ("two frequencies",)),
    "band in metres": ('"0.91 MHz"', '"0.91 mm"', "chip.band[0]", ("'0.91 mm'", "Hz")),
    "overlap": (
        'material = "gel"',
        'material = "gel"\nbottom = "2 mm"',
        "layers[1].bottom",
        ("2 mm", "2.02 mm", "overlaps by 0.02 mm"),
    ),
    "gap": ('material = "gel"', 'material = "gel"\nbottom = "2.1 mm"', "layers[1].bottom", ("gap", "0.08 mm")),
    "particle too big": ('"5 um"', '"0.5 mm"', "states.filled.particle_radius", ("0.5 mm", "0.41 mm")),
    "particle without radius": ('particle_radius = "5 um"', "", "states.filled.particle_radius", ("both",)),
    "particle in a vacuum": ('cavity = "water"', 'cavity = "vacuum"', "states.filled.particle", ("fluid",)),
    "port wider than the wall": ('diameter = "0.4 mm"', 'diameter = "0.8 mm"', "cavity.ports", ("0.8 mm", "0.72 mm")),
    "port beside the cavity": (
        'diameter = "0.4 mm"',
        'diameter = "0.4 mm", height = "2 mm"',
        "cavity.ports.height",
        ("2 mm", "0.82 mm"),
    ),
    "half a port": ("count = 2", "count = 1.5", "cavity.ports.count", ("1.5", "whole number")),
    "no ports": ("count = 2", "count = 0", "cavity.ports.count", ("0", "1 to 8")),
    "crowded ports": ("count = 2", "count = 8", "cavity.ports.count", ("8", "overlap")),
    "chip as a text": (
        '[chip]\nname = "test chip"\nband = ["0.91 MHz", "1.155 MHz"]',
        'chip = "test chip"',
        "chip",
        ("'test chip'", "a table"),
    ),
    "material as a number": ('"gel"', "3", "layers[1].material", ("3", "a text")),
    "tolerance above the value": (
        'tolerance = "20 um"',
        'tolerance = "3 mm"',
        "layers[0].thickness.tolerance",
        ("3 mm", "2.02 mm"),
    ),
    "assumed maybe": ("assumed = true", 'assumed = "maybe"', "layers[0].thickness.assumed", ("true or false",)),
    "state without filling": ('cavity = "vacuum"', "", "states.empty.cavity", ("vacuum",)),
    "cold state": ('"25 degC"', '"-300 degC"', "states.filled.temperature", ("absolute zero",)),
    "material of no layer": (
        "{ substrate =",
        "{ substrat =",
        "states.filled.materials",
        ("'substrat'", "did you mean 'substrate'"),
    ),
    "no name": ('name = "test chip"', "", "chip.name", ("a text",)),
    "no material": ('material = "gel"', "", "layers[1].material", ("a text",)),
    "broken syntax": ("[states.empty]", "[states.empty", "TOML syntax", ("line",)),
    "a state twice": ("[states.empty]", '[states.empty]\ncavity = "air"\n\n[states.empty]', "TOML syntax",
                      ("the table [states.empty] a second time", "line")),
}


def test_a_byte_order_mark_and_other_encodings(tmp_path: Path) -> None:
    path = tmp_path / "chip.toml"
    path.write_text(TEXT, encoding="utf-8-sig", newline="\r\n")
    assert read_chip(path).layers == read(TEXT, tmp_path).layers
    text = TEXT.replace('name = "test chip"', 'name = "Prüfling"')
    line = text[:text.index("Prüf")].count("\n") + 1
    for encoding, field, value in (
            ("latin-1", f"line {line}", "byte 0xfc, 'ü' in Latin-1, which is no UTF-8"),
            ("utf-16", "line 1", "text in UTF-16"), ("utf-32", "line 1", "text in UTF-32")):
        path.write_text(text, encoding=encoding)
        with pytest.raises(InputError, match="save it as UTF-8") as caught:
            read_chip(path)
        assert (caught.value.field, caught.value.value) == (field, value)


@pytest.mark.parametrize(("line", "key"), [
    ('band = ["1 MHz", "2 MHz"]\nband = ["1 MHz",\n "3 MHz"]', "'band'"), ('"a b" = 1\n"a b" = 2', "'\"a b\"'"),
    ("electrodes.live = 1\nelectrodes.live = 2", "'electrodes.live'")])
def test_a_key_twice_is_named(line: str, key: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(f"[chip]\n{line}\n", tmp_path)
    assert f"the key {key} a second time (at line" in str(caught.value.value)


@pytest.mark.parametrize("outline", [
    '["7.5 mm", "0 mm"], ["radius", "0 mm"], ["radius", "thickness"], ["7.5 mm", "thickness"]',
    '["bore", "0 mm"], ["radius", "0 mm"], ["radius", "thickness"], ["bore", "thickness"]'])
def test_a_ring_by_points_is_refused_in_the_words_of_one_by_its_radius(outline: str, tmp_path: Path) -> None:
    profile = f'profile = {{ points = [{outline}], parameters = {{ bore = "7.5 mm" }} }}'
    with pytest.raises(InputError, match=r"profile.points: received 'r = 7.5 mm and more'") as caught:
        read(TEXT.replace('density = "7500 kg/m^3"', profile, 1), tmp_path)
    assert caught.value.expected == f"no hole through the transducer: {FULL_DISC}"


def test_a_diameter_is_read_wherever_a_radius_is(tmp_path: Path) -> None:
    plain = read(TEXT, tmp_path)
    text = TEXT
    for old, new in (('radius = "13 mm"\n', 'diameter = { value = "26 mm", tolerance = "0.2 mm" }\n'),
                     ('cavity_radius = "4 mm"', 'cavity_diameter = "8 mm"'),
                     ('live_radius = "9 mm"', 'live_diameter = "18 mm"'),
                     ('particle_radius = "5 um"', 'particle_diameter = "10 um"')):
        assert old in text
        text = text.replace(old, new)
    chip = read(text, tmp_path)
    assert {name: each.value for name, each in chip.dimensions().items()} == pytest.approx(
        {name: each.value for name, each in plain.dimensions().items()})
    assert chip.layer("substrate").radius.tolerance == pytest.approx(0.1e-3)
    assert chip.state("filled").particle_radius == pytest.approx(5e-6)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_with_its_place_and_remedy(mistake: str, tmp_path: Path) -> None:
    old, new, place, words = MISTAKES[mistake]
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if mistake == "crowded ports":
        text = text.replace('cavity_radius = "4 mm"', 'cavity_radius = "0.5 mm"')
    with pytest.raises(InputError) as caught:
        read(text, tmp_path)
    assert caught.value.field == place
    message = str(caught.value)
    assert "chip.toml" in message
    for word in words:
        assert word in message


def test_a_chip_without_transducer_is_refused(tmp_path: Path) -> None:
    start, end = TEXT.index("[[layers]]"), TEXT.index('[[layers]]\nrole = "couplant"')
    with pytest.raises(InputError, match=r"no layer with role 'transducer'"):
        read(TEXT[:start] + TEXT[end:], tmp_path)


def test_a_filling_or_ports_without_a_cavity_are_refused(tmp_path: Path) -> None:
    plain = TEXT.replace('cavity_radius = "4 mm"', "")
    with pytest.raises(InputError, match=r"cavity\.ports.*no layer has a cavity_radius"):
        read(plain, tmp_path)
    without_ports = plain.replace('ports = { diameter = "0.4 mm", count = 2 }', "")
    with pytest.raises(InputError, match=r"states\.empty\.cavity.*'vacuum'.*no layer has a cavity_radius"):
        read(without_ports, tmp_path)


def test_a_cavity_that_leaks_past_a_narrow_lid_is_refused(tmp_path: Path) -> None:
    # A disc instead of the upper ring that would fall into the hole below it.
    lid = TEXT.index('role = "superstrate"')
    bond = TEXT.index('role = "bond"')
    text = (
        TEXT[:bond]
        + TEXT[bond:lid].replace('radius = "13 mm"\ncavity_radius = "4 mm"', 'radius = "3.9 mm"')
        + TEXT[lid:]
    )
    with pytest.raises(InputError, match=r"layers\[3\]\.cavity_radius.*'bond' above reaches only 3.9 mm"):
        read(text, tmp_path)
    # Two holes: the upper one wider than the layer the lower one is in.
    text = TEXT[:bond] + TEXT[bond:].replace('cavity_radius = "4 mm"', 'cavity_radius = "12 mm"')
    text = text.replace('thickness = "0.72 mm"\nradius = "13 mm"', 'thickness = "0.72 mm"\nradius = "12 mm"')
    with pytest.raises(InputError, match=r"layers\[4\]\.cavity_radius.*'sidewall' below reaches only 12 mm"):
        read(text, tmp_path)


def test_a_port_wider_than_the_cavity_is_refused(tmp_path: Path) -> None:
    narrow = TEXT.replace('cavity_radius = "4 mm"', 'cavity_radius = "0.15 mm"').replace("count = 2", "count = 1")
    with pytest.raises(InputError, match=r"cavity\.ports: .*diameter 0.4 mm.*narrower than the cavity, 0.3 mm"):
        read(narrow.replace('particle_radius = "5 um"', 'particle_radius = "50 um"'), tmp_path)


@pytest.mark.parametrize("layers", ["layers = 3", "layers = []", "layers = [3]", ""])
def test_layers_that_are_no_layers_are_refused(layers: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"layers: .*under \[\[layers\]\]"):
        read(f'{layers}\n[chip]\nname = "none"\nband = ["1 MHz", "2 MHz"]', tmp_path)


def test_the_lowest_hole_speaks_for_the_cavity(tmp_path: Path) -> None:
    stated = '{ value = "4 mm", tolerance = "50 um", note = "lowest" }'
    chip = read(TEXT.replace('cavity_radius = "4 mm"', f"cavity_radius = {stated}", 1), tmp_path)
    assert chip.dimensions()["cavity.radius"].note == "lowest"


def test_a_chip_reaches_another_process_whole(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    assert pickle.loads(pickle.dumps(chip)) == chip


def test_a_chip_made_in_code_is_checked_like_a_file(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    with pytest.raises(InputError, match=r"states: .*at least one state"):
        replace(chip, states=())
    with pytest.raises(InputError, match=r"layers\[1\]\.region: received 'gel'.*'couplant'"):
        replace(chip, layers=(chip.layers[0], replace(chip.layers[1], region="gel"), *chip.layers[2:]))
    with pytest.raises(InputError, match=r"layers\[1\]\.role: received 'gel'"):
        replace(chip, layers=(chip.layers[0], replace(chip.layers[1], role="gel"), *chip.layers[2:]))


def test_unknown_names_are_answered_with_near_ones(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    with pytest.raises(InputError, match=r"state: received 'fild'.*did you mean 'filled'"):
        chip.state("fild")
    with pytest.raises(InputError, match=r"received 'cavity\.radios'.*'cavity\.radius'"):
        chip.with_dimensions({"cavity.radios": 4e-3})
    with pytest.raises(InputError, match=r"region: received 'sidewal'.*'sidewall'"):
        chip.layer("sidewal")
    with pytest.raises(InputError, match=r"did you mean 'chip\.toml'"):
        read_chip(tmp_path / "chip.tml")


def test_changed_dimensions_are_checked_like_a_file(tmp_path: Path) -> None:
    chip = read(TEXT, tmp_path)
    with pytest.raises(InputError, match=r"layers\[3\]\.cavity_radius.*narrower than its layer"):
        chip.with_dimensions({"cavity.radius": 14e-3})
    with pytest.raises(InputError, match=r"layers\[1\]\.thickness.*above zero"):
        chip.with_dimensions({"couplant.thickness": -1e-6})
    with pytest.raises(InputError, match=r"electrode_live\.radius.*12.5 mm"):
        chip.with_dimensions({"electrode_live.radius": 12.6e-3})


@pytest.mark.parametrize("path", sorted(CHIPS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_chip_of_the_package_is_read_and_has_a_source(path: Path) -> None:
    chip = read_chip(path)
    assert chip.source
    assert chip.description
    assert chip.band[0] < chip.band[1]


def test_the_reference_chip_has_the_dimensions_of_its_reference_spectra() -> None:
    # The geometry under which the independent spectra of tests/data were computed.
    chip = read_chip(CHIPS / "reference_chip.toml")
    thicknesses = [layer.thickness.value for layer in chip.layers]
    assert thicknesses == pytest.approx([2.02e-3, 20e-6, 0.85e-3, 0.72e-3, 0.1e-3, 1e-3], abs=1e-12)
    assert [layer.outer_radius for layer in chip.layers] == pytest.approx([12.5e-3] * 2 + [13e-3] * 4, abs=1e-12)
    assert [hole.region for hole in chip.holes] == ["sidewall", "bond"]
    assert chip.dimensions()["cavity.radius"].value == pytest.approx(4e-3)
    assert chip.transducer.density == 7500.0


def test_the_density_of_the_weighed_disc_is_its_mass_over_its_volume() -> None:
    chip = read_chip(CHIPS / "disc_20x2.toml")
    # 5.0315 g is printed to 1e-5 of itself, the density to 1.3e-5.
    assert chip.transducer.density is not None
    assert chip.transducer.density * volumes(chip)["transducer"] == pytest.approx(5.0315e-3, rel=2e-5)


def test_a_chip_can_be_given_as_tables() -> None:
    disc = {"role": "transducer", "material": "pzt4", "thickness": "2 mm", "radius": "10 mm"}
    chip = parse_chip({"chip": {"name": "disc", "band": ["0.9 MHz", "1.1 MHz"]}, "layers": [disc]}, source="here")
    assert chip.regions == ("transducer",)
    with pytest.raises(InputError, match=r"here: transducer, layers\[0\]\.radius"):
        parse_chip(
            {"chip": {"name": "disc", "band": ["0.9 MHz", "1.1 MHz"]}, "layers": [disc | {"radius": 10}]}, source="here"
        )


def test_the_limits_are_documented_in_the_words_of_the_messages() -> None:
    page = " ".join((Path(__file__).parents[1] / "docs" / "model.md").read_text(encoding="utf-8").split())
    for words in (FULL_DISC, NOT_ROUND, CENTRED, FURTHER_CAVITY.format(across="radius"), CLOSED):
        assert words in page
