"""Limits of the formulas of a filled chip: particles small against the wavelength, boundary layers thin in the cavity.

Both are known from the chip file and a frequency, so every command finds them before anything is solved.
"""

from __future__ import annotations

import math

from geometry.chip import Chip
from materials.kinds import Fluid
from workbench.files.errors import InputError
from workbench.model.particles import Particle, boundary_layer_thickness

#: Radius of a particle times the wave number of sound from which its error of (k a)^2 is said, a tenth, and above which
#: it is refused: 40 %, where the force may have the wrong sign a little later.
SAID_SIZE, LARGEST_SIZE = 0.3, 0.6
#: Thickness of the boundary layer over the smallest length of the cavity from which the error of its loss, twice that,
#: is said, and above which a state, or its streaming, is refused. Doubled, losses that are 40 % too small pass.
SAID_LAYER, LARGEST_LAYER, LARGEST_LAYER_OF_STREAMING = 0.01, 0.1, 0.05
#: Pressure amplitude (Pa) above which water that holds gas may cavitate at megahertz: a mechanical index of about one.
CAVITATES = 1e6


def check_validity(
    chip: Chip, state: str, fluid: Fluid, particle: Particle | None, band: tuple[float, float], *, layers: bool = True
) -> tuple[str, ...]:
    """Sentences on the limits that a state comes near to at the frequencies (Hz) of a `band`.

    Args:
        layers: whether boundary layers are part of the model.

    Raises:
        InputError: at every frequency of the band the particle is too large, or the boundary layer too thick.
    """
    found = []
    if particle is not None:
        sizes = [2.0 * math.pi * each / fluid.sound_speed * particle.radius for each in band]
        if min(sizes) > LARGEST_SIZE:
            wavelength = fluid.sound_speed / min(band)
            most = LARGEST_SIZE * wavelength / (2.0 * math.pi)
            raise InputError(chip.file, f"states.{state}.particle_radius", f"{1e6 * particle.radius:.4g} um",
                             f"at most {1e6 * most:.3g} um: Gor'kov's formula holds for spheres much smaller than the "
                             f"wavelength of {1e3 * wavelength:.3g} mm")
        if max(sizes) > SAID_SIZE:
            found.append(f"particles of {2e6 * particle.radius:.4g} um are large for the formula of the force: k a is "
                         f"{_range(sizes, 1.0)}, and the force is off by about (k a)^2, "
                         f"{_range([size**2 for size in sizes], 100.0)} %")
    if layers and fluid.shear_viscosity is not None and chip.holes:
        size = cavity_size(chip)
        thick = [boundary_layer_thickness(fluid, each) / size for each in band]
        if min(thick) > LARGEST_LAYER:
            raise InputError(chip.file, f"states.{state}.cavity", fluid.name,
                             f"boundary layers of at most {100.0 * LARGEST_LAYER:g} % of the cavity's smallest "
                             f"length, {1e6 * size:.4g} um: those of {fluid.name} are {1e6 * size * min(thick):.3g} um "
                             f"thick at {max(band) / 1e6:.4g} MHz, and the model takes them as thin. A larger cavity, "
                             "a higher frequency or a thinner liquid; --inviscid leaves them out")
        if max(thick) > SAID_LAYER:
            found.append(f"the boundary layers of {fluid.name} are {_range(thick, 100.0)} % as thick as the cavity's "
                         f"smallest length, {1e6 * size:.4g} um: their loss comes out too small by about twice that, "
                         f"{_range(thick, 200.0)} %")
    return tuple(found)


def cavity_size(chip: Chip) -> float:
    """The smaller of the height of the first cavity and its width (m)."""
    holes = chip.holes
    return min(holes[-1].z_top - holes[0].z_bottom, 2.0 * min(hole.inner_radius for hole in holes))


def check_streaming_layer(chip: Chip, state: str, fluid: Fluid, frequency: float) -> None:
    """Raise if the boundary layer is too thick for the slip that it drives at a `frequency` (Hz)."""
    share = boundary_layer_thickness(fluid, frequency) / cavity_size(chip)
    if share > LARGEST_LAYER_OF_STREAMING:
        raise InputError("streaming", f"state {state}", fluid.name,
                         f"boundary layers of at most {100.0 * LARGEST_LAYER_OF_STREAMING:g} % of the cavity's "
                         f"smallest length: here {100.0 * share:.3g} %, too thick for a slip at the walls")


def cavitation_words(pressure: float, frequency: float) -> tuple[str, ...]:
    """A sentence if a pressure amplitude (Pa) in the liquid is above :data:`CAVITATES`."""
    if pressure <= CAVITATES:
        return ()
    index = 1e-6 * pressure / math.sqrt(1e-6 * frequency)
    return (f"The pressure amplitude is up to {1e-6 * pressure:.3g} MPa (mechanical index {index:.2g}): water that is "
            "not degassed may cavitate.",)


def _range(values: list[float], factor: float) -> str:
    """The least and the largest of some values times a factor, to two digits: once if they are the same."""
    ends = [f"{float(f'{factor * value:.2g}'):g}" for value in (min(values), max(values))]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"
