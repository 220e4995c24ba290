"""Solids that stand otherwise in their file: named as what they are, and read once the key that is named is stated."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import volumes
from workbench.files.errors import InputError

cadquery = pytest.importorskip("cadquery")

pytestmark = pytest.mark.usefixtures("kernel_here")

LAYERS = (("transducer", "pzt4/acevedo_2026_fitted", "disc"), ("substrate", "pla", "plate"))

#: Volumes (m^3): a disc of 10 x 2 mm, and on it a plate of 10 x 1.5 mm.
DISC, PLATE = math.pi * 10e-3**2 * 2e-3, math.pi * 10e-3**2 * 1.5e-3


def pair() -> dict[str, Any]:
    disc = cadquery.Workplane().circle(10).extrude(2)
    plate = cadquery.Workplane().workplane(offset=2).circle(10).extrude(1.5)
    return {"disc": disc, "plate": plate}


def saved(path: Path, parts: dict[str, Any]) -> Path:
    assembly = cadquery.Assembly(name="chip")
    for name, part in parts.items():
        assembly.add(part, name=name)
    assembly.export(str(path))
    return path


def described(folder: Path, keys: str = "") -> Path:
    text = '[chip]\nname = "x"\nband = ["0.8 MHz", "1.2 MHz"]\n' + "".join(
        f'[[layers]]\nrole = "{role}"\nmaterial = "{material}"\n'
        f'profile = {{ step = "chip.step", part = "{part}"{keys} }}\n' for role, material, part in LAYERS)
    file = folder / "chip.toml"
    file.write_text(text)
    return file


def half(part: Any) -> Any:
    return part.intersect(cadquery.Workplane().box(100, 100, 100).translate((50, 0, 0)))


def quarter(part: Any) -> Any:
    return part.intersect(cadquery.Workplane().box(100, 100, 100).translate((50, -50, 0)))


MOVED = {
    "beside": (lambda part: part.translate((15, -3, 7)), "about z through x = 15 mm, y = -3 mm", "origin = "),
    "y beside": (lambda part: part.rotate((0, 0, 0), (1, 0, 0), -90).translate((0, 0, 30)),
                 "about y through z = 30 mm", 'axis = "y", origin = '),
    "oblique": (lambda part: part.rotate((0, 0, 0), (0, 1, 0), 36.8698976458440).translate((1, 2, 3)),
                "about the direction [0.6, 0, 0.8] through", "axis = [0.6, 0, 0.8], origin = "),
    "quarter": (quarter, "a quarter of a body of revolution about z", 'sector = "90 deg"'),
    "half of y": (lambda part: half(part).rotate((0, 0, 0), (1, 0, 0), -90),
                  "half of a body of revolution about y", 'axis = "y", sector = "180 deg"'),
}


@pytest.mark.parametrize("name", MOVED)
def test_how_a_body_stands_is_named_and_the_key_mends_it(name: str, tmp_path: Path) -> None:
    move, words, key = MOVED[name]
    saved(tmp_path / "chip.step", {part: move(shape) for part, shape in pair().items()})
    with pytest.raises(InputError) as failed:
        read_chip(described(tmp_path))
    said = str(failed.value)
    assert words in said, said
    advice = re.search(r"in the profile (.*) states the axis of this one", said)
    assert advice is not None, said
    assert advice[1].startswith(key), said
    chip = read_chip(described(tmp_path, f", {advice[1]}"))
    assert volumes(chip)["transducer"] == pytest.approx(DISC, rel=1e-9)
    assert volumes(chip)["substrate"] == pytest.approx(PLATE, rel=1e-9)
    again = read_chip(write_chip(chip, tmp_path / "again.toml"))
    assert [layer.profile for layer in again.layers] == [layer.profile for layer in chip.layers]


def test_a_file_that_is_upside_down_is_turned_over(tmp_path: Path) -> None:
    saved(tmp_path / "chip.step", {name: part.rotate((0, 0, 0), (1, 0, 0), 180) for name, part in pair().items()})
    with pytest.raises(InputError, match=r"part that ends at z = -2 mm, below 'transducer'.*upside down.*: \"-z\""):
        read_chip(described(tmp_path))
    chip = read_chip(described(tmp_path, ', axis = "-z"'))
    assert chip.layers[1].z_bottom == pytest.approx(2e-3)
    assert volumes(chip)["substrate"] == pytest.approx(PLATE, rel=1e-9)


def test_a_plate_is_told_that_the_model_is_axisymmetric(tmp_path: Path) -> None:
    saved(tmp_path / "chip.step", {name: cadquery.Workplane().box(20, 10, 2) for name in ("disc", "plate")})
    with pytest.raises(InputError, match=r"axisymmetric only: .*disc of its thickness and area") as failed:
        read_chip(described(tmp_path))
    # No share above the whole, and no advice to leave out most of it.
    assert all(float(share) <= 100.0 for share in re.findall(r"([\d.e+]+) %", str(failed.value)))


def test_ports_are_left_out_of_a_body_about_another_axis(tmp_path: Path) -> None:
    """The advice for one with holes states what is left out too."""
    drilled = {name: part.cut(cadquery.Workplane().center(7, 0).circle(0.5).extrude(10)).rotate(
        (0, 0, 0), (1, 0, 0), -90) for name, part in pair().items()}
    saved(tmp_path / "chip.step", drilled)
    with pytest.raises(InputError) as failed:
        read_chip(described(tmp_path))
    advice = re.search(r'in the profile (axis = "y", asymmetry = "0.\d+ %") states', str(failed.value))
    assert advice is not None, failed.value
    assert isinstance(read_chip(described(tmp_path, f", {advice[1]}")), Chip)
