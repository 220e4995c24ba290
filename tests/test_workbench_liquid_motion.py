"""The motion of the liquid by sound and by heat together, on a small device: how it grows, and where it is refused."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support import CELL, chip_from

import workbench as wb
from workbench.acoustics import heat
from workbench.files.errors import InputError
from workbench.model.problem import fill
from workbench.report.particles import flow_answer
from workbench.simulation.liquid_motion import liquid_motion


@cache
def shot_at(volts: float) -> wb.Snapshot:
    chip = chip_from(CELL, "cell.toml")
    return wb.snapshot(chip, "filled", 1e6, drive=wb.parse_drive(f"{volts} Vpp"), accuracy=5e-3)


def own_liquid(folder: Path) -> wb.Registry:
    (folder / "lawless").mkdir()
    (folder / "references.bib").write_text("@misc{sheet, title = {Data sheet}}\n")
    (folder / "lawless" / "sheet.toml").write_text("""
kind = "fluid"
title = "liquid of which nobody states a slope"
source = "sheet"
conditions = "25 degC"
density = { value = 1100, unit = "kg/m^3" }
sound_speed = { value = 1600, unit = "m/s" }
shear_viscosity = { value = 2, unit = "mPa s" }
""")
    return wb.Registry(folder)


def test_a_liquid_at_rest_carries_nothing() -> None:
    moving = liquid_motion(shot_at(0.5), by="none")
    assert (moving.streaming, moving.heat, moving.velocity, moving.notes) == (None, None, None, ())
    assert str(moving) == "the liquid stays at rest"


def test_sound_and_heat_are_those_of_each_alone() -> None:
    shot = shot_at(0.5)
    sound, warm = (liquid_motion(shot, by=by) for by in ("sound", "heat"))
    assert sound.heat is None
    assert warm.heat is not None
    assert sound.streaming is not None
    assert warm.streaming is not None
    assert set(warm.streaming.causes) - set(sound.streaming.causes) == {"heat", "buoyancy"}
    assert np.array_equal(warm.streaming.causes["walls"], sound.streaming.causes["walls"])
    assert np.array_equal(warm.heat.rise, wb.heating(shot).rise, equal_nan=True)
    assert shot.traps is not None
    assert warm.velocity is not None
    assert warm.velocity.shape == (len(shot.traps.forces.mesh.points), 2)
    assert any("time constant" in note for note in warm.notes)


def test_heat_drives_the_liquid_with_the_fourth_power_of_the_voltage_and_sound_with_the_second() -> None:
    one, two = (liquid_motion(shot_at(volts)).streaming for volts in (0.25, 0.5))
    assert one is not None
    assert two is not None
    grown = {cause: two.rms_of(two.causes[cause]) / one.rms_of(one.causes[cause]) for cause in one.causes}
    print(grown)
    assert grown["walls"] == pytest.approx(4.0, rel=1e-9)
    assert grown["absorption"] == pytest.approx(4.0, rel=1e-9)
    assert grown["buoyancy"] == pytest.approx(4.0, rel=1e-3)
    # The slopes are those of water that is 5 mK warmer.
    assert grown["heat"] == pytest.approx(16.0, rel=1e-3)


def test_boiling_and_a_flow_that_carries_the_heat_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"at most .* Vpp: driven steadily, water/iapws_2011 would be .* K warmer"):
        liquid_motion(shot_at(50.0))
    # This small device boils before its flow is so fast.
    monkeypatch.setattr(heat, "HIGHEST_PECLET", 1e-5)
    with pytest.raises(InputError, match="Peclet number"):
        liquid_motion(shot_at(0.5))
    assert liquid_motion(shot_at(50.0), by="sound").streaming is not None


def test_a_liquid_without_a_law_moves_by_sound_alone(tmp_path: Path) -> None:
    """The sentence stands in the answer and in the notes."""
    registry = own_liquid(tmp_path)
    chip = chip_from(CELL.replace('"water"\ntemperature = "20 degC"', '"lawless"'), "cell.toml")
    shot = wb.snapshot(chip, "filled", 1e6, registry=registry, accuracy=5e-3)
    moving = liquid_motion(shot, registry=registry)
    assert moving.heat is None
    assert moving.streaming is not None
    assert set(moving.streaming.causes) == {"walls", "absorption"}
    assert "lawless/sheet states no law of temperature: the flow is that of sound alone" in moving.notes[0]
    assert moving.notes[0] in flow_answer(moving)
    # The field of a user asks for a slope by name.
    with pytest.raises(InputError, match="a liquid whose entry states its law of temperature, or slopes="):
        wb.streaming(shot, temperature=np.zeros(len(shot.fields.mesh.points)), registry=registry)


def test_a_folder_of_materials_comes_with_the_chip(tmp_path: Path) -> None:
    """The chip is simulated without a word on it, and its liquid found again for the flow."""
    own_liquid(tmp_path)
    (tmp_path / "cell.toml").write_text(CELL.replace('"water"\ntemperature = "20 degC"', '"lawless"'))
    with pytest.raises(InputError, match=r"--materials DIR \(in Python registry=wb.Registry\(DIR\)\)"):
        wb.snapshot(wb.read_chip(tmp_path / "cell.toml"), "filled", 1e6)
    chip = wb.read_chip(tmp_path / "cell.toml", materials=tmp_path)
    assert chip == wb.read_chip(tmp_path / "cell.toml", materials=[str(tmp_path)])
    assert fill(chip.with_tolerances({}), "filled").materials["cavity"].name == "lawless/sheet"
    assert fill(chip, "filled", wb.Registry(tmp_path)).materials["cavity"].name == "lawless/sheet"
    with pytest.raises(InputError, match=r"materials: received .*nowhere'; expected an existing folder"):
        wb.read_chip(tmp_path / "cell.toml", materials=tmp_path / "nowhere")


def test_an_unknown_cause_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="heat"):
        liquid_motion(shot_at(0.5), by="heet")


def test_a_particle_is_carried() -> None:
    """Where the flow alone acts, beads drift as far as the liquid does."""
    shot = shot_at(0.5)
    moving = liquid_motion(shot, by="sound")
    at_rest, carried = (wb.trajectories(shot, 30.0, particles=20, flow=flow) for flow in (None, moving.velocity))
    assert moving.streaming is not None
    apart = np.linalg.norm(carried.positions[:, -1] - at_rest.positions[:, -1], axis=1).max()
    assert 0.0 < apart < 40.0 * 30.0 * moving.streaming.largest_speed
