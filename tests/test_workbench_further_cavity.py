"""A second cavity below the first or above it: the same liquid as the first, by its places, solids and mistakes."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import quadratic

from geometry.chip import Chip, parse_chip, read_chip
from geometry.chip_file import chip_text, write_chip
from geometry.chip_section import region_volumes, volumes
from geometry.solid import chip_solids, volume
from workbench.files.errors import InputError
from workbench.simulation.run import snapshot

COARSE = quadratic(3.0)
FIRST, SECOND = "cavity", "inner"


def made(measure: str, *, lower: str, upper: str, filling: str | None = "water", **more: Any) -> Chip:
    """A stack with two holes, one of them the cavity and the other one an inner radius or half width."""
    across = "radius" if measure == "axisymmetric" else "half_width"

    def layer(role: str, thickness: str, width: str = "6 mm", material: str = "pmma", **keys: Any) -> dict[str, Any]:
        return {"role": role, "material": material, "thickness": thickness, across: width, **keys}

    def wall(hole: str) -> dict[str, Any]:
        filled = {"filling": filling} if hole == SECOND and filling else {}
        return layer("sidewall", "0.4 mm", **{f"{hole}_{across}": "2.5 mm"}, **filled)

    layers = [layer("transducer", "1 mm", "5 mm", "pzt4/acevedo_2026_fitted"), layer("bond", "20 um", material="epoxy"),
              layer("substrate", "0.5 mm"), wall(lower), layer("layer", "0.3 mm"), wall(upper),
              layer("superstrate", "0.5 mm")]
    layers[2]["half_width" if across == "half_width" else "radius"] = "6 mm"
    layers[1][across] = "4.5 mm"
    return parse_chip({
        "chip": {"name": "two cavities", "band": ["0.5 MHz", "1.5 MHz"],
                 **({} if across == "radius" else {"geometry": "straight", "length": "10 mm"})},
        "layers": layers, "states": {"filled": {"cavity": "water", **more}}}, source="chip.toml")


def current(chip: Chip) -> complex:
    return complex(snapshot(chip, "filled", 0.9e6, accuracy=COARSE).fields.current)


@pytest.mark.parametrize("measure", ["axisymmetric", "straight"])
def test_the_second_cavity_is_as_the_first(measure: str, tmp_path: Path) -> None:
    chip, other = made(measure, lower=FIRST, upper=SECOND), made(measure, lower=SECOND, upper=FIRST)
    assert chip.regions[-2:] == ("cavity", "cavity_2")
    assert read_chip(write_chip(chip, tmp_path / "chip.toml")).layers == chip.layers
    assert volumes(chip)["cavity_2"] == pytest.approx(volumes(chip)["cavity"], rel=1e-12)
    assert region_volumes(chip) == pytest.approx(volumes(chip), rel=1e-12)
    solids = chip_solids(chip)
    assert volume(solids["cavity_2"]) == pytest.approx(volumes(chip)["cavity_2"], rel=1e-9)
    one = current(chip)
    # Either hole may be the first: the same terms, boundary layers among them, in another order.
    assert current(other) == pytest.approx(one, rel=1e-9)
    dry = current(made(measure, lower=FIRST, upper=SECOND, filling=None))
    assert abs(dry / one - 1.0) > 1e-3
    assert current(made(measure, lower=FIRST, upper=SECOND, filling="vacuum")) == pytest.approx(dry, rel=1e-12)
    emptied = made(measure, lower=FIRST, upper=SECOND, materials={"cavity_2": "vacuum"})
    assert current(emptied) == pytest.approx(dry, rel=1e-12)


def test_its_losses_are_those_of_its_boundary_layers() -> None:
    shot = snapshot(made("axisymmetric", lower=FIRST, upper=SECOND), "filled", 0.9e6, accuracy=COARSE)
    names = {str(term) for term in shot.problem.terms}
    assert any("ViscousBoundaryLayer" in name and "cavity_2" in name for name in names)
    assert shot.closure < 1e-9
    pressure = shot.fields.pressure[shot.fields.mesh.nodes_of(["cavity_2"])]
    assert np.isfinite(pressure).all()
    assert np.abs(pressure).max() > 0.0


@pytest.mark.parametrize(("keys", "words"), [
    ({"lower": FIRST, "upper": SECOND, "filling": "wter"}, "did you mean 'water'"),
    ({"lower": FIRST, "upper": SECOND, "filling": "pmma"}, "filling of cavity_2: .*a liquid or a gas"),
    ({"lower": SECOND, "upper": SECOND}, "a first cavity, of layers with a cavity_radius"),
    ({"lower": FIRST, "upper": SECOND, "materials": {"cavity_3": "air"}}, "cavity_2"),
])
def test_what_is_no_second_cavity_is_told(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        current(made("axisymmetric", **keys))


@pytest.mark.parametrize(("number", "key", "value", "words"), [
    (6, None, None, "a closed cavity: a layer above 'sidewall_2' that covers it"),
    (4, "inner_radius", "1 mm", "a closed cavity"),
    (4, "filling", "water", "the inner_radius of the cavity that it fills"),
    (0, "filling", "water", "the inner_radius of the cavity that it fills"),
])
def test_a_second_cavity_that_is_not_closed_is_told(number: int, key: str | None, value: str, words: str) -> None:
    content = tomllib.loads(chip_text(made("axisymmetric", lower=FIRST, upper=SECOND)))
    if key is None:
        del content["layers"][number]
    else:
        content["layers"][number][key] = value
    with pytest.raises(InputError, match=words):
        parse_chip(content, source="chip.toml")
