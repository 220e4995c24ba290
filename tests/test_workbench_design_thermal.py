"""The figure "heating" with thermal resistances that conduction gives."""

from __future__ import annotations

from typing import Any

import pytest

import workbench as wb
from geometry.chip import Chip, parse_chip
from workbench.design.evaluation import Operation
from workbench.design.model import full_evaluation
from workbench.files.errors import InputError
from workbench.model.drive import PowerDrive

#: About the lowest radial resonance of the chip.
BAND, COARSE = (340e3, 385e3), 5e-3
VARY = {"superstrate.thickness": {"from": 0.9e-3, "to": 1.1e-3, "points": 3}}


def small() -> Chip:
    def layer(role: str, material: str, thickness: str, **more: str) -> dict[str, str]:
        return {"role": role, "material": material, "thickness": thickness, "radius": "3 mm", **more}

    return parse_chip({
        "chip": {"name": "small", "band": ["340 kHz", "385 kHz"]},
        "layers": [layer("transducer", "pzt4/acevedo_2026_initial", "2 mm"), layer("substrate", "pla", "0.85 mm"),
                   layer("sidewall", "pla", "0.72 mm", cavity_radius="1.5 mm"),
                   layer("superstrate", "pmma", "1 mm")],
        "states": {"empty": {"cavity": "vacuum"}, "filled": {"cavity": "water"}}}, source="small.toml")


def study(thermal: dict[str, Any], **options: Any) -> wb.Study:
    return wb.Study(small(), VARY, figures=["heating"], state="filled", thermal=thermal, **options)


def test_heating_with_computed_resistances_is_the_temperature_of_the_part() -> None:
    drive = PowerDrive(0.05)
    run = wb.simulate(small(), "filled", points=41, accuracy=COARSE, drive=drive, at="f0", warm=None)
    resistances = wb.thermal_resistances(run, part="cavity")
    found = full_evaluation(small(), "filled", {}, figures=("heating", "f0"), band=BAND, points=41, accuracy=COARSE,
                            operation=Operation(drive, "f0", resistances)).figures
    # Both at f0 of the same mesh; f0 by the spectrum and by the model agree to a hertz.
    assert found["heating"] == pytest.approx(wb.heating(run).parts["cavity"].mean, rel=1e-3)


def test_a_study_and_a_goal_compute_their_resistances() -> None:
    run = wb.simulate(small(), "filled", points=161, accuracy=COARSE, relative_error=1e-2, warm=None)
    expected = wb.thermal_resistances(run, part="superstrate", convection=20.0, holder="transducer|outside")
    thermal = {"computed": "superstrate", "convection": "20 W/(m^2 K)", "holder": "transducer|outside"}
    found = study(thermal).operation.thermal_resistance
    assert found == pytest.approx(expected, rel=1e-6)
    assert set(found) >= {"cavity", "transducer", "cavity|substrate"}
    goal = wb.Goal(small(), {"superstrate.thickness": {"from": 0.9e-3, "to": 1.1e-3}}, maximise="e_ac",
                   constraints=["heating <= 5 K"], state="filled", thermal={"computed": "cavity"})
    assert goal.operation.thermal_resistance == pytest.approx(wb.thermal_resistances(run), rel=1e-6)


def test_typed_resistances_stay() -> None:
    assert study({"transducer": "4 K/W", "all": "10 K/W"}).operation.thermal_resistance == {
        "transducer": 4.0, "": 10.0}


@pytest.mark.parametrize(("thermal", "words"), [
    ({"computed": "cavty"}, r"thermal.computed: received 'cavty'.*did you mean 'cavity'"),
    ({"computed": "cavity", "all": "3 K/W"}, r"thermal.all: received 'all'; expected one of computed, convection, hol"),
    ({"computed": "cavity", "convection": "10 K/W"}, r"thermal.convection: .*W/\(m\^2 K\)"),
    ({"computed": "cavity", "holder": "electrode_live"}, r"thermal.holder: .*expected one of [^,]*\|outside, "),
    ({"computed": "cavity", "holder": "lid"}, r"thermal.holder: received 'lid'"),
    ({"convection": "10 W/(m^2 K)"}, r"thermal.convection: received 'convection'; expected one of .*computed"),
    ({}, r'or computed = "cavity"'),
])
def test_mistakes_in_computed_resistances_are_named(thermal: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        study(thermal)


def test_resistances_are_of_one_state() -> None:
    with pytest.raises(InputError, match="one state of the chip, not 2"):
        wb.Study(small(), VARY, figures=["heating"], states=["empty", "filled"], thermal={"computed": "cavity"})
