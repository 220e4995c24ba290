"""Usual sizes of the parts of a chip, by role.

A size outside its range raises an error, since it is probably a slip of the unit. The ranges are wide: they include
parts on the market, from thin-film devices to ultrasonic baths, and exclude sizes that are wrong by a factor of a
thousand. A chip lists intended sizes outside under ``unusual``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real

from geometry.dimension import ACROSS, Dimension, as_text
from geometry.features import KINDS, Feature
from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.names import CAVITY, TRANSDUCER, role_of
from geometry.parts import Layer, State
from workbench.files.errors import InputError, choose
from workbench.files.quantities import SOLID_DENSITIES, frequency_text


@dataclass(frozen=True)
class Range:
    """The smallest and largest usual size (SI) of a part. ``subject`` is its name in messages."""

    low: float
    high: float
    subject: str

    def __contains__(self, value: object) -> bool:
        # The ends may be written in other units than the value.
        return isinstance(value, float | int) and self.low * (1.0 - 1e-9) <= value <= self.high * (1.0 + 1e-9)


#: Thicknesses (m) of layers by role. With ranges twice as wide, a slip by a factor of 1000 is still outside, except for
#: films.
THICKNESSES: Mapping[str, Range] = {
    TRANSDUCER: Range(5e-6, 50e-3, "a piezoelectric disc"),
    "couplant": Range(1e-6, 500e-6, "a film of gel or glue"),
    "bond": Range(0.1e-6, 2e-3, "a bond"),
    "substrate": Range(5e-6, 50e-3, "a substrate"),
    "sidewall": Range(5e-6, 50e-3, "the wall of a cavity"),
    "superstrate": Range(5e-6, 50e-3, "a lid"),
    "sample": Range(5e-6, 50e-3, "a sample"),
    "matching": Range(1e-6, 20e-3, "a matching layer"),
    "backing": Range(10e-6, 200e-3, "a backing"),
    "layer": Range(10e-9, 100e-3, "a layer"),
}

#: Other lengths (m) by name.
RADIUS = Range(0.1e-3, 200e-3, "the radius of a part")
CAVITY_RADIUS = Range(20e-6, 150e-3, "the radius of a cavity")
BORE = Range(20e-6, 200e-3, "the hole of a ring")
ELECTRODE_RADIUS = Range(10e-6, 200e-3, "the radius of an electrode")
ELECTRODE_GAP = Range(1e-6, 200e-3, "the hole or the gap in an electrode")
#: The upper end is the default length of a straight chip, 1 m.
LENGTH = Range(0.1e-3, 1.0, "a straight chip along its channel")
FILL = Range(5e-6, 100e-3, "the liquid in a well")
PORT = Range(5e-6, 50e-3, "a port")
PARTICLE_RADIUS = Range(10e-9, 0.5e-3, "the radius of a particle")

#: Sizes of features, by their keys: kg, N/m, m.
FEATURES: Mapping[str, tuple[Range, str]] = {
    "mass": (Range(1e-9, 10e-3, "a drop of solder or glue"), "mass"),
    "stiffness": (Range(1.0, 1e9, "a wire or a support"), "stiffness"),
    "diameter": (Range(10e-6, 50e-3, "the patch of a feature"), "length")}

#: Largest mass of a feature over that of its layer. Doubled, a drop of solder as heavy as its disc passes.
HEAVIEST = 0.5

#: Names in ``unusual`` of the depth of a liquid and of the length of a straight chip, which are not dimensions.
FILL_KEY, LENGTH_KEY = "fill", "length"

#: Other quantities: K, Hz, kg/m^3.
TEMPERATURE = Range(253.15, 423.15, "a chip in use")
FREQUENCY = Range(1e3, 100e6, "a chip driven by a piezoelectric disc")
DENSITY = Range(*SOLID_DENSITIES, "a solid")

#: Largest ratio of the ends of a band; largest number of half wavelengths across the transducer at its top, with 2000
#: Hz m for one. Doubled, a lost decimal point in a band of 2 mm discs passes at 10.8 MHz.
WIDEST, OVERTONES, FREQUENCY_CONSTANT = 60.0, 30.0, 2000.0

#: Largest factor by which a search may move a length out of its range and make it unusual. Doubled, a slip between cm
#: and mm in code passes more often.
LARGEST_MOVE = 30.0

#: Factors between units that are often confused, the most likely first.
SLIPS = (1e-3, 1e3, 1e-6, 1e6, 0.1, 10.0, 0.01, 100.0)


def range_of(name: str) -> Range | None:
    """The range of a dimension by its name, or None. Shapes and sizes of profiles have none; they are checked against
    their layers."""
    region, _, what = name.rpartition(".")
    if name in (FILL_KEY, LENGTH_KEY):
        return FILL if name == FILL_KEY else LENGTH
    if region.startswith("electrode_"):
        return ELECTRODE_RADIUS if what in ACROSS else ELECTRODE_GAP if what.startswith("inner_") else None
    if region == "ports":
        return PORT
    if what.startswith("cavity_") or (region == CAVITY and what in ACROSS):
        return CAVITY_RADIUS
    if what == "thickness":
        return THICKNESSES.get(role_of(region), THICKNESSES["layer"])
    if what.startswith("inner_"):
        return BORE
    return RADIUS if what in ACROSS else None


def check_plausible(
    layers: Sequence[Layer], band: tuple[float, float], named: Mapping[str, Dimension], states: Sequence[State],
    unusual: Sequence[str], file: str, *, measure: Measure = ABOUT_AXIS, is_open: bool = False,
    features: Sequence[Feature] = (),
) -> None:
    """Check that all sizes are usual, except those listed as `unusual`.

    The sizes are lengths (`named`), band, densities, temperatures, particles and features.

    Raises:
        InputError: the first unusual size, or an unusual name that the chip does not have.
    """
    stated = list(_stated(layers, named, states, features))
    # The depth of a liquid is checked when it is read: afterwards it is the thickness of a wall.
    more = [*([FILL_KEY] if is_open else []), *([LENGTH_KEY] if isinstance(measure, Straight) else [])]
    for name in unusual:
        choose(name, ["band", *more, *(each for each, _, _, _ in stated)], source=file, field="chip.unusual")
    for name, value, usual, kind in stated:
        if name not in unusual and usual is not None and value not in usual:
            raise implausible(name, value, usual, kind, file)
    if isinstance(measure, Straight):
        check_length(LENGTH_KEY, measure.length, source=file, field=f"chip.{LENGTH_KEY}", unusual=unusual)
    if "band" not in unusual:
        check_band(layers, band, file)


def check_length(name: str, value: float, *, source: str, field: str, unusual: Sequence[str] = ()) -> None:
    """Check that a length (m) above zero is usual for that dimension.

    Raises:
        InputError: it is not, and the name is not in `unusual`.
    """
    usual = range_of(name)
    # Values that are not lengths are rejected elsewhere.
    if usual is not None and value > 0.0 and name not in unusual and value not in usual:
        raise implausible(name, value, usual, "length", source, field)


def check_masses(features: Sequence[Feature], masses: Mapping[str, float], unusual: Sequence[str], file: str) -> None:
    """Check that features are lighter than the layers below them. `masses` (kg) are by region.

    Raises:
        InputError: the first feature that is heavier than :data:`HEAVIEST` allows, with both masses.
    """
    for i, feature in enumerate(features):
        name, whole = f"features[{i}].mass", masses.get(feature.region, math.inf)
        if feature.mass > HEAVIEST * whole and name not in unusual:
            usual = Range(FEATURES["mass"][0].low, HEAVIEST * whole,
                          f"a mass on {feature.region!r}, which itself has {as_text(whole, 'mass')}")
            raise implausible(name, feature.mass, usual, "mass", file)


def check_band(layers: Sequence[Layer], band: tuple[float, float], source: str, field: str = "chip.band") -> None:
    """Check that a band (Hz) is usual for these layers.

    Raises:
        InputError: they are not, or the band is too wide.
    """
    low, high = band
    thickness = _transducer_thickness(layers)
    top = OVERTONES * FREQUENCY_CONSTANT / thickness
    if low not in FREQUENCY or high not in FREQUENCY:
        expected = f"frequencies of {frequency_text(FREQUENCY.low, FREQUENCY.high)}, at which {FREQUENCY.subject} works"
    elif high > top:
        expected = (f"at most {as_text(top, 'frequency')}, where the transducer of {as_text(thickness, 'length')} is "
                    f"{OVERTONES:g} half wavelengths thick")
    elif high > WIDEST * low:
        expected = f"a band whose ends are at most a factor of {WIDEST:g} apart"
    else:
        return
    raise InputError(source, field, frequency_text(*band), f"{expected}; {_how('band')}", meant_band(band, layers))


def _transducer_thickness(layers: Sequence[Layer]) -> float:
    """The thickness (m) of the lowest transducer; infinite without any."""
    return next((layer.thickness.value for layer in layers if layer.role == TRANSDUCER), math.inf)


def check_frequency(frequency: object, band: tuple[float, float], *, source: str, field: str) -> float:
    """Return a drive frequency (Hz) after a check.

    Raises:
        InputError: not a number, or outside :data:`FREQUENCY`; with the probable frequency: of those by a slip of the
            unit or the sign, the nearest to the `band` (Hz).
    """
    # Numbers of numpy are accepted too.
    if isinstance(frequency, Real) and float(frequency) in FREQUENCY:
        return float(frequency)
    expected = (f"a frequency in Hz, of {frequency_text(FREQUENCY.low, FREQUENCY.high)}, at which {FREQUENCY.subject} "
                f"works; the band of this chip is {frequency_text(*band)}")
    meant: tuple[str, ...] = ()
    if isinstance(frequency, Real) and 0.0 < abs(float(frequency)) < math.inf:
        slips = [each for factor in (1.0, *SLIPS) if (each := abs(float(frequency)) * factor) in FREQUENCY]
        nearest = min(slips, key=lambda each: abs(math.log(each**2 / (band[0] * band[1]))), default=None)
        # A program states it in Hz.
        meant = () if nearest is None else (f"{nearest:.10g} Hz",)
    raise InputError(source, field, frequency, expected, meant)


def implausible(name: str, value: float, usual: Range, kind: str, source: str, field: str | None = None) -> InputError:
    """The error of an unusual value, with the probable value."""
    off = value / usual.high if value > usual.high else usual.low / value if value > 0.0 else math.inf
    than = "the most" if value > usual.high else "less than the least"
    times = f"; this is {float(f'{off:.3g}'):,.12g} times {than}" if kind != "temperature" and off >= 1.5 else ""
    expected = (f"{as_text(usual.low, kind)} to {as_text(usual.high, kind)}, the usual range of "
                f"{usual.subject}{times}; {_how(name)}")
    meant = [value + 273.15, value - 273.15] if kind == "temperature" else [value * factor for factor in SLIPS]
    likely = tuple(as_text(each, kind) for each in meant if each in usual)[:1]
    return InputError(source, field or name, as_text(value, kind, as_stated=True), expected, likely)


def moved_beyond(name: str, old: float, new: float) -> bool:
    """Whether a length leaves its range by a small factor only."""
    usual = range_of(name)
    return usual is not None and new not in usual and old / LARGEST_MOVE < new < LARGEST_MOVE * old


def _how(name: str) -> str:
    return f'if it is intended, write unusual = ["{name}"] under [chip]'


def _stated(
    layers: Sequence[Layer], named: Mapping[str, Dimension], states: Sequence[State], features: Sequence[Feature]
) -> Iterator[tuple[str, float, Range | None, str]]:
    """Sizes that a chip states: name, value (SI), range, kind of quantity."""
    for name, dimension in named.items():
        yield name, dimension.value, range_of(name), "length"
    for layer in layers:
        if layer.density is not None:
            yield f"{layer.region}.density", layer.density, DENSITY, "density"
    for state in states:
        if state.temperature is not None:
            yield f"states.{state.name}.temperature", state.temperature, TEMPERATURE, "temperature"
        if state.particle_radius is not None:
            yield f"states.{state.name}.particle_radius", state.particle_radius, PARTICLE_RADIUS, "length"
    for i, feature in enumerate(features):
        for name in dict.fromkeys((KINDS[feature.kind][0], "diameter")):
            usual, kind = FEATURES[name]
            yield f"features[{i}].{name}", getattr(feature, name), usual, kind


def meant_band(band: tuple[float, float], layers: Sequence[Layer]) -> tuple[str, ...]:
    """The probable band after a slip of decimal point or unit. It is the plausible band nearest to the first
    resonance of the transducer."""
    low, high = band
    thickness = _transducer_thickness(layers)
    found = [ends for factor in SLIPS for ends in ((low, high * factor), (low * factor, high * factor),
                                                   (low * factor, high))
             if FREQUENCY.low <= ends[0] < ends[1] <= min(FREQUENCY.high, 4.0 * ends[0])]
    if not found or math.isinf(thickness):
        return ()
    first = FREQUENCY_CONSTANT / thickness
    low, high = min(found, key=lambda ends: abs(math.log(ends[0] * ends[1] / first**2)))
    return (frequency_text(low, high),)
