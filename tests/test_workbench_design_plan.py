"""Study files: what they say is read as it is meant, and every mistake in them is answered with the remedy."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from fake_models import CHIP

from geometry.chip import parse_chip
from geometry.names import CAVITY
from materials.registry import Registry
from workbench.design.axes import with_materials
from workbench.design.parts import parts_of, ranges_of
from workbench.design.plan import Study, read_study
from workbench.design.variables import MaterialChoice, VariedNumber
from workbench.files.errors import InputError
from workbench.files.tables import read_toml
from workbench.model.drive import PowerDrive, VoltageDrive

pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

HEAD = """
[study]
chip = "chip.toml"
states = ["empty", "filled"]
figures = ["f0", "z_min", "mean_e_ac"]
"""
VARY = """
[vary]
"substrate.thickness" = { from = "0.8 mm", to = "0.9 mm", points = 3 }
"sidewall.thickness" = { tolerance = true, points = 2 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "chip.toml").write_text(CHIP, encoding="utf-8")
    return tmp_path


def read(folder: Path, text: str) -> Study:
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return read_study(folder / "study.toml")


def test_what_is_not_said_is_what_the_chip_says(folder: Path) -> None:
    found = read(folder, HEAD.replace('states = ["empty", "filled"]', "") + VARY)
    assert found.states == ("filled",)
    assert found.band == found.chip.band
    assert found.operation.drive == VoltageDrive(10.0)
    assert found.operation.frequency is None
    assert (found.relative_error, found.accuracy, found.confirmed, found.name) == (1e-3, 5e-4, 5, "study")


def test_what_is_said_is_taken(folder: Path) -> None:
    found = read(folder, HEAD.replace("z_min", "heating") + """
name = "mine"
drive = "0.1 W"
frequency = "1.03 MHz"
band = ["1 MHz", "1.1 MHz"]
relative_error = "0.3 %"
accuracy = "0.5 %"
limit = 50
confirm = 0
[thermal]
transducer = "4 K/W"
all = "10 K/W"
[sample]
method = "latin hypercube"
points = 7
seed = 2
[vary]
substrate.thickness = { from = "0.8 mm", to = "0.9 mm" }
""")
    assert found.operation.drive == PowerDrive(0.1)
    assert found.operation.frequency == 1.03e6
    assert found.operation.thermal_resistance == {"transducer": 4.0, "": 10.0}
    assert (found.name, found.band, found.relative_error, found.accuracy) == ("mine", (1e6, 1.1e6), 3e-3, 5e-3)
    assert (found.limit, found.confirmed, found.size) == (50, 0, 14)


def test_a_grid_is_the_product_and_its_last_axis_the_fastest(folder: Path) -> None:
    found = read(folder, HEAD + VARY)
    # Rounding of the two units of the file.
    np.testing.assert_allclose(found.sample[:, 0], np.repeat([0.8e-3, 0.85e-3, 0.9e-3], 2), rtol=1e-12)
    np.testing.assert_allclose(found.sample[:, 1], np.tile([0.70e-3, 0.74e-3], 3), rtol=1e-12)
    assert found.size == 12


def test_a_list_is_taken_row_by_row_with_its_materials(folder: Path) -> None:
    found = read(folder, HEAD + """
[sample]
method = "list"
[vary]
"couplant.thickness" = { values = ["10 um", "20 um", "10 um"] }
"superstrate.material" = { materials = ["pla", "soda_lime_glass/independent_reference", "pmma"] }
""")
    np.testing.assert_allclose(found.sample, [[1e-5, 0.0], [2e-5, 1.0], [1e-5, 2.0]], rtol=1e-12)
    assert found.choices[0].materials[0] == "pla/acevedo_2026"


@pytest.mark.parametrize("method", ["sobol", "latin hypercube"])
def test_a_sample_fills_ranges_lists_and_alternatives_evenly(folder: Path, method: str) -> None:
    found = read(folder, HEAD + f"""
[sample]
method = "{method}"
points = 48
[vary]
"pla.shear_modulus" = {{ tolerance = "10 %" }}
"pla.shear_modulus.loss" = {{ tolerance = "10 %" }}
"couplant.thickness" = {{ values = ["10 um", "20 um", "50 um"] }}
"superstrate.material" = {{ materials = ["pla", "pmma"] }}
""")
    modulus, loss, gel, lid = found.sample.T
    assert [axis.name for axis in found.numbers[:2]] == [
        "pla/acevedo_2026.shear_modulus", "pla/acevedo_2026.shear_modulus.loss"]
    low, high = found.numbers[0].low, found.numbers[0].high
    assert low <= modulus.min() < modulus.max() <= high
    # A loss is negative, and its range rises all the same.
    assert found.numbers[1].low < found.numbers[1].high < 0.0
    assert loss.max() < 0.0
    # Of 48 points every third, and half, falls to each; a Sobol sequence cut short of 64 may miss that by a few.
    assert all(abs(np.count_nonzero(gel == value) - 16) <= 3 for value in found.numbers[2].values)
    assert abs(np.count_nonzero(lid == 1.0) - 24) <= 3


def test_more_points_of_a_sobol_sequence_begin_with_the_fewer(folder: Path) -> None:
    text = HEAD + """
[sample]
method = "sobol"
points = 10
[vary]
"substrate.thickness" = { from = "0.8 mm", to = "0.9 mm" }
"sidewall.thickness" = { tolerance = "20 um" }
"""
    few, many = read(folder, text), read(folder, text.replace("points = 10", "points = 40"))
    np.testing.assert_array_equal(few.sample, many.sample[:10])


def test_parts_hold_every_row_once_and_their_own_materials(folder: Path) -> None:
    found = read(folder, HEAD + VARY + '"superstrate.material" = { materials = ["pla", "pmma"] }\n')
    parts = parts_of(found)
    assert [part.label for part in parts] == [
        f"{state}, {name}" for state in ("empty", "filled") for name in found.choices[0].materials]
    assert sorted(row for part in parts for row in part.rows) == list(range(24))
    for part in parts:
        assert part.chip.layer("superstrate").material == part.materials["superstrate"]
        # Row s n + i is point i in state s.
        there = found.sample[part.rows % 12]
        np.testing.assert_array_equal(part.points, there[:, :2])
        assert {found.choices[0].materials[int(k)] for k in there[:, 2]} == set(part.materials.values())


def test_a_model_is_made_for_the_chip_itself_too(folder: Path) -> None:
    found = read(folder, HEAD + """
[sample]
method = "sobol"
points = 4
[vary]
"substrate.thickness" = { from = "1.0 mm", to = "1.2 mm" }
"pla.shear_modulus" = { from = "1.0 GPa", to = "1.2 GPa" }
""")
    part = parts_of(found)[0]
    ranges = ranges_of(found, part)
    # The length is set to the middle of its range; the modulus of the material stays, and its range is widened.
    assert part.chip.dimensions()["substrate.thickness"].value == pytest.approx(1.1e-3)
    assert ranges["substrate.thickness"] == pytest.approx((1.0e-3, 1.2e-3))
    own = Registry().load("pla").shear_modulus.real
    assert own < 1e9
    assert ranges["pla/acevedo_2026.shear_modulus"] == pytest.approx((own, 1.2e9))


def test_another_material_brings_its_own_density(folder: Path) -> None:
    content = read_toml(folder / "chip.toml")
    content["layers"][-1]["density"] = "2600 kg/m^3"
    chip, registry = parse_chip(content, source="chip.toml"), Registry()
    own = registry.find(chip.layer("superstrate").material)[0]
    assert with_materials(chip, {"superstrate": own}, registry).layer("superstrate").density == 2600.0
    other = with_materials(chip, {"superstrate": "pla/acevedo_2026", CAVITY: "mine/oil"}, registry)
    assert other.layer("superstrate").density is None
    assert [state.cavity for state in other.states] == ["vacuum", "mine/oil"]


MISTAKES = {
    "no chip": (HEAD.replace('chip = "chip.toml"', ""), VARY, "study.chip", "the path of a chip file"),
    "a chip that is not there": (HEAD.replace("chip.toml", "chop.toml"), VARY, "study.chip",
                                "did you mean 'chip.toml'"),
    "a key mistyped": (HEAD + 'figure = ["f0"]\n', VARY, "study.figure", "did you mean 'figures'"),
    "a state mistyped": (HEAD.replace("filled", "fillet"), VARY, "study.states", "did you mean 'filled'"),
    "both ways to say a state": (HEAD + 'state = "filled"\n', VARY, "study.state", "not both"),
    "a figure mistyped": (HEAD.replace("z_min", "zmin"), VARY, "study.figures", "did you mean 'z_min'"),
    "a figure twice": (HEAD.replace("z_min", "f0"), VARY, "study.figures", "every figure once"),
    "no figure": (HEAD.replace('"f0", "z_min", "mean_e_ac"', ""), VARY, "study.figures", "one figure at least"),
    "a frequency outside the band": (HEAD + 'frequency = "3 MHz"\n', VARY, "study.frequency", "within the band"),
    "a band of other units": (HEAD + 'band = ["0.95 kHz", "1.15 kHz"]\n', VARY, "study.band",
                              "did you mean '0.95 to 1.15 MHz'"),
    "a band of hertz": (HEAD + 'band = ["1 Hz", "2 Hz"]\n', VARY, "study.band", "did you mean '1 to 2 MHz'"),
    "a key's former name": (HEAD + 'tolerance = "0.1 %"\n', VARY, "study.tolerance", "renamed to 'relative_error'"),
    "a band upside down": (HEAD + 'band = ["2 MHz", "1 MHz"]\n', VARY, "study.band", "a lower and a higher"),
    "a drive without its unit": (HEAD + 'drive = "10 V"\n', VARY, "study.drive", "10 Vpp"),
    "an error of the model of 100": (HEAD + 'relative_error = "100 %"\n', VARY, "study.relative_error",
                                     "between 0 and 1"),
    "heating without resistances": (HEAD.replace("z_min", "heating"), VARY, "thermal", 'all = "10 K/W"'),
    "a resistance of no region": (HEAD, '[thermal]\nlid = "3 K/W"' + VARY, "thermal.lid", "superstrate"),
    "an unknown method": (HEAD, '[sample]\nmethod = "sobel"\npoints = 8' + VARY, "sample.method", "'sobol'"),
    "points of a grid": (HEAD, "[sample]\npoints = 8" + VARY, "sample.points", "[vary] says how many"),
    "no points of a sample": (HEAD, '[sample]\nmethod = "sobol"' + VARY, "sample.points", "how many points"),
    "points twice": (HEAD, '[sample]\nmethod = "sobol"\npoints = 8' + VARY, "points", "[sample] says how many"),
    "nothing varies": (HEAD, "[vary]\n", "vary", "at least one thing"),
    "no table of what varies": (HEAD, "", "vary", "a table [vary]"),
    "a length mistyped": (HEAD, VARY.replace("substrate", "substrat"), "vary.substrat.thickness",
                          "did you mean 'substrate.thickness'"),
    "a length that no spectrum feels": (HEAD, '[vary]\n"ports.diameter" = { from = "1 mm", to = "2 mm", points = 2 }',
                                        "vary.ports.diameter", "a length that the spectrum feels"),
    "a length without its unit": (HEAD, VARY.replace('"0.8 mm"', "0.8"), "vary.substrate.thickness.from",
                                  "with its unit"),
    "a modulus in millimetres": (HEAD, '[vary]\n"pla.shear_modulus" = { from = "1 mm", to = "2 mm", points = 2 }',
                                 "vary.pla.shear_modulus.from", "a pressure in one of"),
    "a range upside down": (HEAD, VARY.replace('"0.8 mm"', '"1.8 mm"'), "vary.substrate.thickness", "a lower number"),
    "a range without points": (HEAD, VARY.replace(", points = 3", ""), "vary.substrate.thickness.points",
                               "how many points"),
    "a tolerance nobody stated": (HEAD, VARY.replace("sidewall", "couplant"), "vary.couplant.thickness.tolerance",
                                  "the chip file states none"),
    "a tolerance of a coefficient": (HEAD, '[vary]\n"pla.shear_modulus" = { tolerance = true, points = 2 }',
                                     "vary.pla.shear_modulus.tolerance", "only lengths have one"),
    "a tolerance wider than the length": (HEAD, VARY.replace("tolerance = true", 'tolerance = "1 mm"'),
                                          "vary.sidewall.thickness", "lengths above zero"),
    "a radius that passes another": (HEAD, '[vary]\n"cavity.radius" = { from = "1 mm", to = "3.5 mm", points = 2 }',
                                     "vary.cavity.radius", "the next ones are at"),
    "one radius by two names": (HEAD, "[vary]\n" + "".join(
        f'"{name}.radius" = {{ tolerance = "10 um", points = 2 }}\n' for name in ("substrate", "sidewall")),
        "vary.sidewall.radius", "substrate.radius varies already"),
    "radii that meet": (HEAD, '[vary]\n"cavity.radius" = { from = "1.5 mm", to = "2.7 mm", points = 2 }\n'
                        '"substrate.radius" = { from = "2.6 mm", to = "3.5 mm", points = 2 }', "vary.substrate.radius",
                        "that cavity.radius reaches"),
    "a material of one state alone": (HEAD, '[vary]\n"water.sound_speed" = { tolerance = "1 %", points = 2 }',
                                      "vary.water.sound_speed", "its own study"),
    "a material mistyped": (HEAD, '[vary]\n"superstrate.material" = { materials = ["pla", "pma"] }',
                            "vary.superstrate.material.materials[1]", "pmma"),
    "a material twice": (HEAD, '[vary]\n"superstrate.material" = { materials = ["pla", "pla"] }',
                         "vary.superstrate.material.materials[1]", "every material once"),
    "a lid of no region": (HEAD, '[vary]\n"lid.material" = { materials = ["pla", "pmma"] }', "vary.lid.material",
                           "superstrate.material"),
    "a transducer of glass": (HEAD, '[vary]\n"transducer.material" = { materials = ["pic255", "pmma"] }',
                              "vary.transducer.material.materials", "a piezoelectric material"),
    "a liquid in an empty cavity": (HEAD, '[vary]\n"cavity.material" = { materials = ["water", "pmma"] }',
                                    "vary.cavity.material", "'empty' has nothing there"),
    "a list with columns of two lengths": (HEAD, '[sample]\nmethod = "list"\n[vary]\n"couplant.thickness" = '
                                           '{ values = ["10 um", "20 um"] }\n"substrate.thickness" = '
                                           '{ values = ["0.8 mm", "0.85 mm", "0.9 mm"] }',
                                           "vary.substrate.thickness.values", "row by row"),
    "a range in a list": (HEAD, '[sample]\nmethod = "list"\n[vary]\n"couplant.thickness" = '
                          '{ from = "10 um", to = "20 um" }', "vary.couplant.thickness", "row by row"),
    "values and a range": (HEAD, '[vary]\n"couplant.thickness" = { values = ["10 um", "20 um"], to = "20 um" }',
                           "vary.couplant.thickness.to", "not both"),
    "one value": (HEAD, '[vary]\n"couplant.thickness" = { values = ["10 um"] }', "vary.couplant.thickness.values",
                  "two different values"),
    "too large a grid": (HEAD, VARY.replace("points = 3", "points = 100000").replace("points = 2", "points = 100000"),
                         "vary", "at most 1000000 points"),
    "a number in place of a table": (HEAD, '[vary]\n"couplant.thickness" = "10 um"', "vary.couplant.thickness",
                                     "{ from = ..., to = ... }"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_answered(folder: Path, mistake: str) -> None:
    head, rest, field, words = MISTAKES[mistake]
    with pytest.raises(InputError) as caught:
        read(folder, head + rest)
    assert field in caught.value.field
    assert words in str(caught.value)
    assert re.search(r"\.toml: ", str(caught.value))


def test_axes_span_what_they_say() -> None:
    axis = VariedNumber("x", 1.0, 2.0, points=3)
    np.testing.assert_allclose(axis.levels(), [1.0, 1.5, 2.0])
    np.testing.assert_allclose(axis.at(np.array([0.0, 1.0])), [1.0, 2.0])
    listed = VariedNumber.listed("x", (5.0, 1.0))
    # Half of the way each; the end belongs to the last.
    np.testing.assert_allclose(listed.at(np.array([0.0, 0.49, 0.5, 1.0])), [5.0, 5.0, 1.0, 1.0])
    assert MaterialChoice("bond", ("a", "b", "c")).at(np.array([math.nextafter(1.0, 0.0)])) == [2.0]
