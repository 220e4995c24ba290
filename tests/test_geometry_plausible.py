"""Sizes that no such part has are asked about, with what was meant, and there is one way to say that they are meant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from geometry.chip import Chip, parse_chip, read_chip
from geometry.chip_file import write_chip
from geometry.dimension import Dimension
from geometry.names import ROLES
from geometry.plausible import THICKNESSES
from workbench.files.errors import InputError
from workbench.files.tables import read_toml
from workbench.model.drive import parse_drive

ROOT = Path(__file__).resolve().parent.parent
PATH = ROOT / "geometry/chips/reference_chip.toml"


@pytest.fixture
def chip() -> Chip:
    return read_chip(PATH)


def test_every_role_has_a_range_that_a_slip_of_the_unit_leaves() -> None:
    assert set(THICKNESSES) == set(ROLES)
    # Films may be a thousand times off and within: 0.5 um is 500 um then. Nothing is a million times off and within.
    assert all(each.high / each.low < 1e5 for role, each in THICKNESSES.items() if role != "layer")


@pytest.mark.parametrize(("name", "value", "received", "meant"), [
    ("couplant.thickness", 35.0, "35 m", "35 um"), ("couplant.thickness", 20e-3, "20 mm", "20 um"),
    ("couplant.thickness", 20e-9, "20 nm", "20 um"), ("transducer.thickness", 2.02, "2.02 m", "2.02 mm"),
    ("transducer.thickness", 2e-6, "2 um", "2 mm"), ("substrate.thickness", 0.85, "850 mm", "850 um"),
    ("bond.thickness", 0.1, "100 mm", "100 um"), ("superstrate.thickness", 1.0, "1 m", "1 mm"),
    ("sidewall.thickness", 0.72, "720 mm", "720 um"), ("transducer.radius", 12.5, "12.5 m", "12.5 mm"),
    ("cavity.radius", 4.0e-9, "4 nm", "4 mm"),
])
def test_a_length_of_no_such_part_is_asked_about(
    chip: Chip, name: str, value: float, received: str, meant: str
) -> None:
    with pytest.raises(InputError) as caught:
        # The electrodes and ports of the chip follow none of these.
        chip.with_dimensions({name: value})
    error = caught.value
    if error.field != name:  # what encloses it is checked first, and refuses it too
        assert name in ("cavity.radius", "transducer.radius")
        return
    assert (error.value, error.nearest) == (received, (meant,))
    assert f'if it is intended, write unusual = ["{name}"] under [chip]' in error.expected


def test_a_chip_file_of_metres_is_asked_about_and_may_insist(tmp_path: Path) -> None:
    content = read_toml(PATH)
    layer = next(each for each in content["layers"] if each["role"] == "couplant")
    layer["thickness"] = "20 mm"
    asked = (r"couplant\.thickness: received '20 mm'; expected 1 um to 500 um, the usual range of a film of gel "
             r"or glue; this is 40 times the most; .*did you mean '20 um'\?")
    with pytest.raises(InputError, match=asked):
        parse_chip(content, source="chip.toml")
    content["chip"]["unusual"] = ["couplant.thickness"]
    meant = parse_chip(content, source="chip.toml")
    assert meant.dimensions()["couplant.thickness"].value == 20e-3
    write_chip(meant, str(tmp_path / "meant.toml"))
    assert read_chip(tmp_path / "meant.toml").unusual == ("couplant.thickness",)
    content["chip"]["unusual"] = ["couplant.thicknes"]
    with pytest.raises(InputError, match=r"chip\.unusual.*did you mean 'couplant\.thickness'"):
        parse_chip(content, source="chip.toml")


def test_a_chip_made_in_code_is_asked_about(chip: Chip) -> None:
    layers = tuple(replace(layer, thickness=Dimension(2.0)) if layer.role == "transducer" else layer
                   for layer in chip.layers)
    with pytest.raises(InputError, match=r"transducer\.thickness: received '2 m'.*did you mean '2 mm'"):
        replace(chip, layers=layers[:1], states=(replace(chip.states[0], cavity=None, particle=None,
                                                         particle_radius=None, materials={}),), ports=None)


def test_a_search_may_move_a_little_beyond_and_says_so(chip: Chip) -> None:
    thin = chip.with_dimensions({"couplant.thickness": 2e-6}).with_dimensions({"couplant.thickness": 0.5e-6})
    assert thin.unusual == ("couplant.thickness",)
    assert chip.with_dimensions({"couplant.thickness": 50e-6}).unusual == ()
    assert chip.with_dimensions({"couplant.thickness": 20e-3}, unusual=["couplant.thickness"]).unusual == (
        "couplant.thickness",)


@pytest.mark.parametrize(("band", "meant"), [
    ((0.95e6, 108e6), ("0.95 to 1.08 MHz",)), ((1e6, 108e6), ("1 to 1.08 MHz",)),
    ((950.0, 1130.0), ("0.95 to 1.13 MHz",)), ((0.95e9, 1.13e9), ("0.95 to 1.13 MHz",)),
    ((9.5e3, 1.13e6), ("0.95 to 1.13 MHz",)),
])
def test_a_band_of_no_such_chip_is_asked_about(chip: Chip, band: tuple[float, float], meant: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="band") as caught:
        replace(chip, band=band)
    assert caught.value.nearest == meant
    assert replace(chip, band=band, unusual=("band",)).band == band


def test_temperatures_particles_and_densities_are_asked_about(chip: Chip) -> None:
    state = chip.states[-1]
    with pytest.raises(InputError, match=r"temperature: received '20 K'.*did you mean '20 degC'"):
        replace(chip, states=(replace(state, temperature=20.0),))
    with pytest.raises(InputError, match=r"particle_radius: received '3 nm'.*did you mean '3 um'"):
        replace(chip, states=(replace(state, particle="polystyrene", particle_radius=3e-9),))
    with pytest.raises(InputError, match=r"transducer\.density: received '7\.5 kg/m\^3'.*did you mean '7500 kg/m\^3'"):
        replace(chip, layers=tuple(replace(each, density=7.5) if each.role == "transducer" else each
                                   for each in chip.layers))


@pytest.mark.parametrize("text", ["100000 Vpp", "0.01 mVpp", "10 Vpp @ 5e7 ohm", "10000 W"])
def test_a_drive_that_no_amplifier_gives_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"a plausible .* of an amplifier"):
        parse_drive(text)
