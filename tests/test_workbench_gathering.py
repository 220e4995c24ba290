"""The sentences that say whether particles gather: one case of every answer, on potentials with a known one."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_workbench_barriers import HEIGHT, NEUTRAL, RADIUS, WATER, half_wave, points, shaped

from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.traps import find_traps
from workbench.model.particles import net_weight
from workbench.simulation.gathering import THERMAL, Gathering, gathering


def shot(forces: ParticleForces | None, fluid: Any = None, cavity: str = "water") -> Any:
    held = {"cavity": Registry().load("water") if fluid is None else fluid}
    return SimpleNamespace(
        state="filled", chip=SimpleNamespace(materials=lambda _state: {"cavity": cavity} if cavity else {}),
        problem=SimpleNamespace(materials={} if fluid is False else held),
        traps=None if forces is None else find_traps(forces))


def said(forces: ParticleForces) -> Gathering:
    found = gathering(shot(forces))
    assert found is not None
    assert 1 <= len(found.sentences) <= 4
    return found


def test_in_a_trap_in_the_liquid_they_gather() -> None:
    r, z = points()
    potential = -1e-13 * np.exp(-2.0 * (r / 1.2e-3) ** 2) * np.sin(math.pi * z / HEIGHT) ** 2
    found = said(shaped(potential))
    assert found.gathers
    first, second, *_ = found.sentences
    assert first == ("At 0.9980 MHz and 10 Vpp, 100 % of evenly spread neutral spheres of 10 um gather in the liquid, "
                     "on the axis, 0.38 mm above the floor.")
    assert second == "To leave the trap one needs 96 fJ (along z 100 fJ, along r 96 fJ)."


def test_in_two_traps_each_has_its_share() -> None:
    found = said(half_wave(replace(NEUTRAL, density=1050.0), half_waves=2))
    assert found.sentences[0].count(" mm above the floor") == 2
    assert "0.19 mm" in found.sentences[0]
    assert "0.56 mm" in found.sentences[0]
    assert "the strongest trap" in found.sentences[1]
    assert "times its net weight" in found.sentences[1]


def test_where_the_antinode_is_at_mid_height_they_go_to_floor_and_lid() -> None:
    _, z = points()
    found = said(shaped(-1e-13 * np.cos(math.pi * z / HEIGHT) ** 2))
    assert found.gathers is False
    text = str(found)
    assert "do not gather in the liquid: they come to rest on the floor" in text
    assert "at the lid" in text
    assert "the antinode of the pressure is at mid-height" in text
    assert "half a wavelength is 0.75 mm" in text


def test_a_field_too_weak_for_the_weight_is_said_with_the_voltage_that_is_enough() -> None:
    lead = replace(NEUTRAL, density=11000.0)
    found = said(half_wave(lead, p0=1e5))
    assert found.gathers is False
    assert "on the floor, where the weight brings them (100 %)" in found.sentences[0]
    assert "The field is too weak" in found.sentences[1]
    # At that voltage it does, and two steps below the lift, which goes with its square, is less than the weight.
    enough = float(found.sentences[1].split("At ")[1].split(" Vpp")[0])
    assert "of evenly spread neutral spheres" in said(half_wave(lead, p0=1.02e5 * enough / 10.0)).sentences[0]
    lift = find_traps(half_wave(lead)).traps[0].lift
    assert lift is not None
    assert (enough / 1.44 / 10.0) ** 2 * lift < net_weight(lead, WATER)


def test_slow_focusing_is_said_with_a_voltage() -> None:
    found = said(half_wave(replace(NEUTRAL, radius=1e-6), p0=2e4))
    assert found.gathers is False
    assert "Focusing is slow" in str(found)
    assert "Vpp would take 10 s" in str(found)


def test_a_barrier_below_thermal_motion_is_no_trap() -> None:
    r, z = points()
    assert pytest.approx(4.1e-20, rel=0.01, abs=0.0) == THERMAL
    potential = -2e-20 * np.exp(-2.0 * (r / 1.2e-3) ** 2) * np.sin(math.pi * z / HEIGHT) ** 2
    found = said(shaped(potential))
    assert "thermal motion" in str(found)
    assert found.gathers is False


def test_no_trap_is_said() -> None:
    forces = half_wave(NEUTRAL)
    found = gathering(SimpleNamespace(**{**vars(shot(forces)), "traps": replace(find_traps(forces), traps=())}))
    assert found is not None
    assert found.gathers is False
    assert "no minimum" in str(found)


def test_without_liquid_or_particle_it_says_what_is_missing() -> None:
    assert gathering(shot(None, cavity="")) is None
    for fluid in (False, Registry().load("air")):
        found = gathering(shot(None, fluid=fluid))
        assert found is not None
        assert found.gathers is None
        assert "holds no liquid" in str(found)
    found = gathering(shot(None))
    assert found is not None
    assert 'particle = "polystyrene"' in str(found)
    assert "[states.filled]" in str(found)
    assert isinstance(Registry().load("air"), Fluid)
    assert RADIUS == 1.5e-3
