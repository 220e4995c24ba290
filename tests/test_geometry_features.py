"""Features of a chip file: what is read, written back and refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from geometry.chip import Chip, read_chip
from geometry.chip_file import chip_text
from geometry.features import Feature
from workbench.files.errors import InputError
from workbench.model.problem import LeftOutWarning, build, fill
from workbench.render.features import draw_features
from workbench.simulation.run import simulate

CHIPS = Path(__file__).resolve().parent.parent / "geometry" / "chips"
SOLDER = """
[[features]]
kind = "mass"
layer = "transducer"
face = "bottom"
distance = "9 mm"
angle = "120 deg"
diameter = "2 mm"
mass = "5 mg"
"""
GAP = '[[features]]\nkind = "gap"\ndistance = "3 mm"\ndiameter = "2 mm"\n'
WIRE = '[[features]]\nkind = "spring"\ndistance = "1 cm"\ndiameter = "500 um"\nstiffness = "2e4 N/m"\nloss = 0.1\n'


@pytest.fixture
def disc(tmp_path: Path) -> Path:
    path = tmp_path / "disc.toml"
    path.write_text((CHIPS / "free_disc_25x2.toml").read_text(encoding="utf-8"), encoding="utf-8")
    return path


def with_features(disc: Path, text: str) -> Chip:
    disc.write_text(disc.read_text(encoding="utf-8") + text, encoding="utf-8")
    return read_chip(disc)


def test_features_are_read_and_written(disc: Path) -> None:
    chip = with_features(disc, SOLDER + WIRE + GAP)
    solder, wire, gap = chip.features
    assert gap == Feature("gap", "transducer", "top", pytest.approx(3e-3), 2e-3)
    assert str(gap).startswith("gap in the electrode on the top of transducer, 3 mm from")
    assert solder == Feature("mass", "transducer", "bottom", pytest.approx(9e-3), 2e-3,
                             pytest.approx(math.radians(120.0)), mass=pytest.approx(5e-6))
    assert (wire.region, wire.face, wire.distance, wire.stiffness, wire.loss) == (
        "transducer", "top", pytest.approx(0.01), 2e4, 0.1)
    again = disc.with_name("again.toml")
    again.write_text(chip_text(chip, disc.parent), encoding="utf-8")
    assert read_chip(again).features == chip.features


@pytest.mark.parametrize(("old", "new", "field", "words"), [
    ('"mass"', '"mas"', "features[0].kind", "mass"),
    ('"transducer"', '"transduser"', "features[0].layer", "transducer"),
    ('"bottom"', '"side"', "features[0].face", "top"),
    ('"9 mm"', '"12 mm"', "features[0].distance", "11.5 mm"),
    ('"9 mm"', '"-1 mm"', "features[0].distance", "0 mm"),
    ('"9 mm"', "9", "features[0].distance", "mm"),
    ('"2 mm"', '"0 mm"', "features[0].diameter", "above zero"),
    ('"5 mg"', '"0 mg"', "features[0].mass", "above zero"),
    ('"5 mg"', '"5 mm"', "features[0].mass", "mg"),
    ('"5 mg"', '"-5 mg"', "features[0].mass", "'-5 mg'"),
    ('mass = "5 mg"', "", "features[0].mass", "missing; expected a mass with its unit"),
    ('distance = "9 mm"', "", "features[0].distance", "missing; expected a length with its unit"),
    ('mass = "5 mg"', 'stiffness = "1 N/m"', "features[0].stiffness", "mass"),
    ('mass = "5 mg"', 'mass = "5 mg"\nloss = 0.1', "features[0].loss", "mass"),
    ('distance = "9 mm"', 'radius = "9 mm"', "features[0].radius", "distance"),
])
def test_a_mistake_is_named(disc: Path, old: str, new: str, field: str, words: str) -> None:
    with pytest.raises(InputError) as error:
        with_features(disc, SOLDER.replace(old, new))
    assert (error.value.field, words in str(error.value)) == (field, True), str(error.value)
    assert error.value.value is not None or not error.value.nearest, str(error.value)


def test_a_gap_has_only_a_diameter(disc: Path) -> None:
    with pytest.raises(InputError, match=r"features\[0\].mass.*none in .* kind 'gap', which has a diameter"):
        with_features(disc, GAP + 'mass = "1 mg"\n')


def test_a_feature_is_lighter_than_its_layer(disc: Path) -> None:
    """The disc has the mass of a cylinder: density 7862 kg/m^3, 25 mm across, 2.02 mm thick."""
    chip = with_features(disc, SOLDER.replace('"5 mg"', '"9 g"'))
    whole = 1e3 * 7862.0 * math.pi * 12.5e-3**2 * 2.02e-3
    with pytest.raises(InputError, match=rf"features\[0\].mass: received '9 g'.* to {whole / 2:.4g} g, .*'transducer', "
                                         rf"which itself has {whole:.4g} g.* unusual = .*'9 mg'"):
        fill(chip)
    assert fill(replace(chip, unusual=("features[0].mass",))).chip.features == chip.features
    lighter = replace(chip.features[0], mass=0.49e-3 * whole)
    assert fill(replace(chip, features=(lighter,))).chip.features == (lighter,)


def test_a_straight_chip_has_none() -> None:
    chip = read_chip(CHIPS / "glass_channel.toml")
    with pytest.raises(InputError, match="straight"):
        replace(chip, features=(Feature("mass", "transducer", "top", 1e-3, 1e-4, mass=1e-6),))


@pytest.mark.parametrize(("region", "face", "distance", "field", "words"), [
    ("transducer", "top", 5e-3, "features[0].face", "couplant covers"),
    ("sidewall", "top", 5e-3, "features[0].face", "bond covers"),
    ("substrate", "top", 5e-3, "features[0].face", "sidewall covers"),
    ("transducer", "bottom", 12.1e-3, "features[0].distance", "0 mm to"),
    ("superstrate", "top", 0.0, None, ""),
])
def test_a_patch_is_on_a_free_face(region: str, face: str, distance: float, field: str | None, words: str) -> None:
    chip = read_chip(CHIPS / "reference_chip.toml")
    feature = Feature("mass", region, face, distance, 1e-3, mass=1e-6)  # type: ignore[arg-type]
    if field is None:
        assert replace(chip, features=(feature,)).features == (feature,)
        return
    with pytest.raises(InputError) as error:
        replace(chip, features=(feature,))
    assert (error.value.field, words in str(error.value)) == (field, True), str(error.value)


def test_patches_do_not_overlap(disc: Path) -> None:
    chip = with_features(disc, SOLDER)
    near = replace(chip.features[0], angle=chip.features[0].angle + math.radians(10.0))
    with pytest.raises(InputError, match=r"features\[1\].distance.*1.5\d* mm from .*at least 2 mm"):
        replace(chip, features=(*chip.features, near))
    assert len(replace(chip, features=(*chip.features, replace(near, face="top"))).features) == 2


def test_an_unusual_mass_is_a_slip_of_the_unit_unless_listed(disc: Path) -> None:
    heavy = SOLDER.replace("5 mg", "50 g")
    with pytest.raises(InputError, match=r"features\[0\].mass.*50 g.*0.001 mg to 10 g.*unusual") as error:
        with_features(disc, heavy)
    assert error.value.nearest == ("50 mg",)
    head, _, rest = disc.read_text(encoding="utf-8").partition("\n[[layers]]")
    disc.write_text(f'{head}\nunusual = ["features[0].mass"]\n[[layers]]{rest}', encoding="utf-8")
    assert read_chip(disc).features[0].size == "50 g"


def test_orders_are_not_solved_point_by_point(disc: Path) -> None:
    with pytest.raises(InputError, match=r"features.*full solves"):
        simulate(with_features(disc, SOLDER), band=(60e3, 80e3), points=5, full=True)


def test_other_commands_say_that_features_are_left_out(disc: Path) -> None:
    with pytest.warns(LeftOutWarning, match="left out .mass of 5 mg on the bottom of transducer"):
        build(fill(with_features(disc, SOLDER)), band=(60e3, 80e3))


def test_features_are_drawn_from_above(disc: Path, tmp_path: Path) -> None:
    chip = with_features(disc, SOLDER + WIRE)
    picture = matplotlib.image.imread(draw_features(chip, tmp_path / "features.png"))
    # The two colours of the features are seen, each on more than a dot.
    for colour in ((0xd5, 0x5e, 0x00), (0x00, 0x72, 0xb2)):
        is_near = np.abs(255.0 * picture[:, :, :3] - np.array(colour)).max(axis=2) < 2.0
        assert is_near.sum() > 100
