"""The motion of the liquid by sound and by heat together, on a small device: how it grows, and where it is refused."""

from __future__ import annotations

import tomllib
from functools import cache

import numpy as np
import pytest
from support import CELL

import workbench as wb
from geometry.chip import parse_chip
from workbench.acoustics import heat
from workbench.files.errors import InputError
from workbench.simulation.liquid_motion import liquid_motion


@cache
def shot_at(volts: float) -> wb.Snapshot:
    chip = parse_chip(tomllib.loads(CELL), source="cell.toml")
    return wb.snapshot(chip, "filled", 1e6, drive=wb.parse_drive(f"{volts} Vpp"), accuracy=5e-3)


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
