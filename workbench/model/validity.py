"""Limits of the formulas of a filled chip.

Particles must be small against the wavelength, boundary layers thin in the cavity. Chip file and frequency determine
both, so every command checks them before it solves.
"""

from __future__ import annotations

import math

from geometry.chip import Chip
from materials.kinds import Fluid
from workbench.files.errors import InputError
from workbench.model.particles import Particle, boundary_layer_thickness

#: Radius of a particle times the wavenumber of sound from which its error of (k a)^2, a tenth, is a finding, and above
#: which it raises: 40 %, where the force soon may have the wrong sign.
WARNING_SIZE, LARGEST_SIZE = 0.3, 0.6
#: Thickness of the boundary layer over the smallest length of the cavity from which the error of its loss, twice that,
#: is a finding, and above which a state, or its streaming, raises. Doubled, losses that are 40 % too small pass.
WARNING_LAYER, LARGEST_LAYER, LARGEST_LAYER_OF_STREAMING = 0.01, 0.1, 0.05
#: Pressure amplitude (Pa) above which water with gas may cavitate at megahertz: a mechanical index of about one.
CAVITATES = 1e6


def check_validity(
    chip: Chip, state: str, fluid: Fluid, particle: Particle | None, band: tuple[float, float], *, layers: bool = True
) -> tuple[str, ...]:
    """Findings on limits of the formulas in a `band` (Hz).

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
        if max(sizes) > WARNING_SIZE:
            found.append(f"particles of {2e6 * particle.radius:.4g} um are large for the formula of the force: k a is "
                         f"{_range(sizes, 1.0)}, and the force has an error of about (k a)^2, "
                         f"{_range([size**2 for size in sizes], 100.0)} %")
    if layers and fluid.shear_viscosity is not None and chip.holes:
        size = cavity_size(chip)
        thick = [boundary_layer_thickness(fluid, each) / size for each in band]
        if min(thick) > LARGEST_LAYER:
            raise InputError(chip.file, f"states.{state}.cavity", fluid.name,
                             f"boundary layers of at most {100.0 * LARGEST_LAYER:g} % of the cavity's smallest "
                             f"length, {1e6 * size:.4g} um: those of {fluid.name} are {1e6 * size * min(thick):.3g} um "
                             f"thick at {max(band) / 1e6:.4g} MHz, and the model requires thin ones. Use a larger "
                             "cavity, a higher frequency or a thinner liquid; --inviscid leaves them out")
        if max(thick) > WARNING_LAYER:
            found.append(f"the boundary layers of {fluid.name} are {_range(thick, 100.0)} % as thick as the cavity's "
                         f"smallest length, {1e6 * size:.4g} um: their computed loss is too small by about twice that, "
                         f"{_range(thick, 200.0)} %")
    return tuple(found)


def cavity_size(chip: Chip) -> float:
    """The smaller of height and width (m) of the first cavity."""
    holes = chip.holes
    return min(holes[-1].z_top - holes[0].z_bottom, 2.0 * min(hole.inner_radius for hole in holes))


def check_streaming_layer(chip: Chip, state: str, fluid: Fluid, frequency: float) -> None:
    """Raise if the boundary layer is too thick for its slip. The frequency is in Hz."""
    share = boundary_layer_thickness(fluid, frequency) / cavity_size(chip)
    if share > LARGEST_LAYER_OF_STREAMING:
        raise InputError("streaming", f"state {state}", fluid.name,
                         f"boundary layers of at most {100.0 * LARGEST_LAYER_OF_STREAMING:g} % of the cavity's "
                         f"smallest length: here {100.0 * share:.3g} %, too thick for a slip at the walls")


def cavitation_words(pressure: float, frequency: float) -> tuple[str, ...]:
    """A sentence if a pressure amplitude (Pa) is above :data:`CAVITATES`."""
    if pressure <= CAVITATES:
        return ()
    index = 1e-6 * pressure / math.sqrt(1e-6 * frequency)
    return (f"The pressure amplitude is up to {1e-6 * pressure:.3g} MPa (mechanical index {index:.2g}): water that is "
            "not degassed may cavitate.",)


def _range(values: list[float], factor: float) -> str:
    """The range of values times a factor, as text with two digits."""
    ends = [f"{float(f'{factor * value:.2g}'):g}" for value in (min(values), max(values))]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"
