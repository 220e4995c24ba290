"""Parabolas for density and sound speed of a fluid about its temperature."""

from __future__ import annotations

from collections.abc import Callable

from materials.kinds import Fluid
from workbench.files.errors import InputError

#: Distance (K) to either side at which the parabola equals a fluid's law.
STEP = 5.0


def fluid_slopes(fluid: Fluid, law: Callable[[float], Fluid]) -> dict[str, float] | None:
    """Slopes and bends of `fluid_temperature.FluidTemperature`, from a `law` in K. None if the law does not extend so
    far to both sides."""
    if fluid.temperature is None:
        return None
    try:
        colder, warmer = law(fluid.temperature - STEP), law(fluid.temperature + STEP)
    except InputError:
        return None
    found: dict[str, float] = {}
    for kind, here, below, above in (("density", fluid.density, colder.density, warmer.density),
                                     ("speed", fluid.sound_speed, colder.sound_speed, warmer.sound_speed)):
        found[f"{fluid.name}.{kind}_slope"] = (above - below) / (2.0 * STEP * here)
        found[f"{fluid.name}.{kind}_bend"] = (above + below - 2.0 * here) / (2.0 * STEP**2 * here)
    return found
