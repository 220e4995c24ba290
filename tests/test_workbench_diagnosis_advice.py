"""What to measure next, in words: the line that is advised can be added to the campaign."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.catalogue.effect import Effect
from workbench.diagnosis.next_measurement import advice
from workbench.fitting.parameter import Parameter

EXAMPLE = Path(__file__).parents[1] / "geometry" / "chips" / "small_campaign"


def moving(name: str) -> Effect:
    return Effect(name, "", "", "", (Parameter(name, 0.0, -1.0, 1.0, None, "1"),))


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return read_campaign(EXAMPLE / "campaign.toml")


@pytest.mark.parametrize(("name", "says", "line"), [
    ("water/iapws_2011.sound_speed", "Measure the sound speed of the water", '"water.sound_speed" = "0.1 %"'),
    ("couplant.thickness", "Measure the thickness of the couplant (a microscope", '"couplant.thickness" = "2 um"'),
    ("transducer.radius", "with a caliper", '"transducer.radius" = "10 um"'),
    ("bench.series_resistance", "Measure open, short and load", '"bench.series_resistance" = "20 mohm"'),
    ("bench.clock", "Measure open", '"bench.clock" = "1 ppm"'),
    ("bench.gain", "Measure open", '"bench.gain" = "0.2 %"'),
    ("bench.delay", "Measure open", '"bench.delay" = "0.1 ns"'),
    ("bench.phase", "Measure open", '"bench.phase" = "0.002 rad"'),
    ("bench.series_inductance", "Measure open", '"bench.series_inductance" = "3 nH"'),
    ("bench.parallel_capacitance", "Measure open", '"bench.parallel_capacitance" = "0.2 pF"'),
    ("water/iapws_2011.density", "Weigh 1 ml of the water", '"water.density" = "0.5 %"'),
    ("pla/acevedo_2026.density", "Weigh a piece of pla", '"pla.density" = "0.5 %"'),
])
def test_the_line_that_is_advised_can_be_added(
    campaign: Campaign, name: str, says: str, line: str, tmp_path: Path
) -> None:
    (text,) = advice([moving(name)], campaign.states)
    assert says in text
    assert text.endswith(f"{line} in [known].")
    for file in EXAMPLE.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    kept = re.sub(rf'(?m)^"{re.escape(name)}".*\n', "", (EXAMPLE / "campaign.toml").read_text(encoding="utf-8"))
    (tmp_path / "campaign.toml").write_text(f"{kept}\n{line}\n", encoding="utf-8")
    assert name in read_campaign(tmp_path / "campaign.toml").known


def test_what_is_stated_in_files_is_told_with_the_file(campaign: Campaign) -> None:
    (text,) = advice([moving("water/iapws_2011.temperature_offset")], campaign.states)
    assert "Measure the temperature of the water to 0.5 K" in text
    assert 'temperature = "... degC" in [states.filled].' in text
    (text,) = advice([moving("pla/acevedo_2026.shear_modulus.loss")], campaign.states)
    assert "workbench fit polymer disc.csv --chip stack.toml --save mine/pla" in text
    transducer = campaign.states[0].materials["transducer"].name
    assert "Record the bare transducer" in advice([moving(f"{transducer}.c33")], campaign.states)[0]


def test_no_state_is_asked_for_that_is_there(campaign: Campaign) -> None:
    ceramic = campaign.states[0].materials["transducer"]
    pla = next(m for m in campaign.states[0].materials.values() if m.name.startswith("pla"))
    disc: Any = SimpleNamespace(materials={"transducer": ceramic})
    sample: Any = SimpleNamespace(materials={"transducer": ceramic, "couplant": SimpleNamespace(name="gel"),
                                             "substrate": pla})
    names = [f"{ceramic.name}.c33", f"{pla.name}.shear_modulus.loss", "water/iapws_2011.shear_viscosity"]
    assert len(advice(map(moving, names), campaign.states)) == 2
    assert advice(map(moving, names), (*campaign.states, disc, sample)) == ()


def test_each_is_told_once_and_what_no_instrument_tells_is_not(campaign: Campaign) -> None:
    names = ["bench.gain", "bench.gain", "somewhere.open_rim", "pla/acevedo_2026.density", "couplant.thickness",
             "transducer.radius"]
    assert len(advice([moving(name) for name in names], campaign.states)) == 3
    assert advice([moving("somewhere.open_rim")], campaign.states) == ()
