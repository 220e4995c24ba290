"""A fluid warmer than stated: the same as the fluid of that temperature, as its law has it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from materials.kinds import Fluid
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.fluid_slopes import fluid_slopes
from workbench.model.problem import Problem
from workbench.physics.fluid_temperature import ADMISSIBLE, FluidTemperature

FREQUENCIES = np.array([310e3, 350e3, 390e3])
STATED = 298.15


def water(temperature: float) -> Fluid:
    found = Registry().load("water", temperature=temperature)
    assert isinstance(found, Fluid)
    return found


def named(fluid: Fluid, slope: dict[str, float], offset: float) -> dict[str, complex]:
    """The values of the term, for a problem that calls its fluid "water"."""
    found = {name.replace(fluid.name, "water"): complex(value) for name, value in slope.items()}
    return {**found, "water.temperature_offset": complex(offset)}


@pytest.mark.parametrize("offset", [-10.0, -1.0, 5.0, 10.0])
def test_it_is_water_of_that_temperature(filled: Problem, offset: float) -> None:
    stated, there = water(STATED), water(STATED + offset)
    slope = fluid_slopes(stated, water)
    assert slope is not None

    def of(fluid: Fluid) -> Problem:
        return filled.with_values({"water.density": fluid.density, "water.sound_speed": fluid.sound_speed})

    warmer = of(stated).with_terms((FluidTemperature("cavity", "water"),), named(stated, slope, offset))
    nominal, found, expected = (solve_full(assemble(p.mesh, p.terms), FREQUENCIES, p.values).impedance
                                for p in (of(stated), warmer, of(there)))
    # The parabola meets the law 5 K off and leaves out the cube: 1e-4 of the speed at 10 K, of the 1.6 % it moves.
    error = np.abs(found / expected - 1.0).max() / np.abs(nominal / expected - 1.0).max()
    print(f"{offset:+.0f} K: {error:.1e} of the change")
    assert error < 1e-2


def test_water_is_faster_when_warmer_and_a_fluid_without_a_law_has_no_slope() -> None:
    found = fluid_slopes(water(STATED), water)
    assert found is not None
    # 2.7 m/s per kelvin at 25 degC: IAPWS 2011.
    assert found["water/iapws_2011.speed_slope"] * 1496.7 == pytest.approx(2.68, rel=0.02)
    assert found["water/iapws_2011.density_slope"] == pytest.approx(-2.57e-4, rel=0.01)
    gel = Registry().load("coupling_gel")
    assert isinstance(gel, Fluid)
    assert fluid_slopes(gel, partial(Registry().load, "coupling_gel")) is None  # type: ignore[arg-type]
    # At the end of its law there is no slope to both sides.
    assert fluid_slopes(water(280.15), water) is None
    assert all(limit.lowest < limit.highest and limit.source for limit in ADMISSIBLE.values())
