"""Advice on measurements that tell explanations apart: the number to measure, and the line that states it.

Each of the parameters that an explanation moves can be measured by other means than a spectrum. The result is stated in
the campaign's [known], or in the chip's file; the spectra are the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from geometry.dimension import ACROSS
from geometry.names import TRANSDUCER, role_of
from materials.kinds import Fluid, Piezoelectric
from workbench.campaign.state import DeviceState
from workbench.catalogue.effect import Effect
from workbench.model.numbers import ParameterName, plain_words

#: Parameters that advice is given on, at most.
ADVISED = 3

#: Standard uncertainties that open, short and load leave of each element of the bench, as a campaign states them.
BENCH_LINES = {"series_resistance": "20 mohm", "series_inductance": "3 nH", "parallel_capacitance": "0.2 pF",
               "gain": "0.2 %", "phase": "0.002 rad", "delay": "0.1 ns", "clock": "1 ppm"}

#: Standard uncertainties of a measured length: with a microscope on a section, and with a caliper.
FILM, PART = "2 um", "10 um"


def advice(effects: Iterable[Effect], states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Sentences on how to measure each number that effects move, with the line to add; none for one that cannot be."""
    found = (text for effect in effects for name in effect.names for text in _of(name, states))
    return tuple(dict.fromkeys(found))[:ADVISED]


def _of(name: str, states: Sequence[DeviceState]) -> Iterator[str]:
    parsed = ParameterName.parse(name)
    materials = {m.name: m for s in states for m in s.materials.values()}
    material = materials.get(parsed.owner)
    short = parsed.owner.split("/")[0]
    said = plain_words(parsed.owner)
    if parsed.coefficient == "temperature_offset":
        own = next(s for s in states if s.fluid is not None and s.fluid.name == parsed.owner)
        yield (f"Measure the temperature of the {said} to 0.5 K while it is recorded, and state it in the chip's file "
               f'({own.chip.file}): temperature = "... degC" in [states.{own.device.state.name}].')
    elif parsed.is_bench and parsed.coefficient in BENCH_LINES:
        yield ("Measure open, short and load at the clips, correct the recordings by them, and state what is left: "
               f'"{name}" = "{BENCH_LINES[parsed.coefficient]}" in [known].')
    elif parsed.is_dimension and parsed.coefficient in ("thickness", *ACROSS):
        film = role_of(parsed.owner) in ("couplant", "bond") and parsed.is_thickness
        yield (f"Measure the {parsed.coefficient.replace('_', ' ')} of the {parsed.owner}"
               + (" (a microscope on a section, or what the parts' heights leave)" if film else " with a caliper")
               + f', write it into the chip\'s file, and state how exact it is: "{name}" = "{FILM if film else PART}" '
               "in [known].")
    elif material is not None and parsed.coefficient == "density" and not isinstance(material, Fluid):
        yield (f'Weigh a piece of {said} of known volume, write its density into the material, and state: '
               f'"{short}.density" = "0.5 %" in [known].')
    elif isinstance(material, Fluid) and parsed.coefficient == "sound_speed":
        yield (f"Measure the sound speed of the {said}, or what is dissolved in it, write it into the material, and "
               f'state: "{short}.sound_speed" = "0.1 %" in [known].')
    elif isinstance(material, Piezoelectric):
        yield ("Record the bare transducer, and add it as a state of its own: what it shows is of the ceramic alone "
               '([states.disc] with chip = "disc.toml" and recording = "disc.csv").')
    elif material is not None and role_of(_region(parsed.owner, states)) != TRANSDUCER:
        yield (f"Record a disc of {said} on the transducer, fit it (workbench fit polymer disc.csv --chip "
               f'stack.toml --save mine/{short}), and write material = "mine/{short}" into the chip\'s file.')


def _region(material: str, states: Sequence[DeviceState]) -> str:
    return next(region for state in states for region, found in state.materials.items() if found.name == material)
