"""Adjustable parameters of a chip, with ranges, tolerances and displayed units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from geometry.assumed import FILM_FACTOR, SHAPE_UNCERTAINTY, is_film
from geometry.chip import Chip
from geometry.names import CAVITY
from geometry.stretch import admissible_range, canonical_names
from materials.kinds import Fluid, IsotropicSolid
from workbench.files.errors import InputError, choose
from workbench.files.quantities import parse_quantity, shown_factor, shown_unit
from workbench.model.device_numbers import assumed_by_role, coefficient_number, length_number
from workbench.model.dimensions import parametrised_within
from workbench.model.numbers import LOSS, Number, ParameterName, real_part
from workbench.model.problem import Problem

#: Default relative range of a parameter to either side. Doubled, a range model of six lengths has about twice as many
#: unknowns.
RELATIVE_REACH = 0.05
#: Largest factor between a value and the chip's file, beyond its range: the mesh is stretched, and its elements were
#: made for that length. A length may move within the range of a fit.
FARTHEST = 2.0
#: The range in units of a stated tolerance, if that is wider. For an assumed tolerance it includes the limits.
TOLERANCES = 2.0
#: Significant digits of a length in a saved chip file: a nanometre of a millimetre.
SAVED_DIGITS = 6

#: Separator of the ends of a range, as in "substrate.thickness=0.8mm..0.9mm".
RANGE_MARK = ".."

#: Thickness (m) below which it is displayed in micrometres.
_THIN = 2e-4


@dataclass(frozen=True, kw_only=True)
class Control(Number):
    """An adjustable parameter.

    It is between ``low`` and ``high``, and starts at the value in the chip's file. The uncertainty of a length is
    stated as limits, that of a constant as a standard one; a length without one has that assumed by its role
    (`geometry.assumed`). It is displayed in ``shown_unit``, of which ``factor`` are one in SI. ``narrowed`` reports a
    range that is narrower than the limits.
    """

    shown_unit: str
    factor: float
    narrowed: str = ""

    @property
    def shown_tolerance(self) -> str:
        """The displayed tolerance, in ``shown_unit``; "" for none. The assumed one of a film is a factor."""
        if self.tolerance is not None:
            return f"{self.tolerance * self.factor:.4g}"
        if not self.is_dimension:
            return ""
        if is_film(self.name):
            return f"\N{MULTIPLICATION SIGN}{FILM_FACTOR:g}"
        return f"{(self.known.high - self.value) * self.factor:.4g}"

    @property
    def farthest(self) -> tuple[float, float]:
        """The limits (SI) of its values, beyond its range."""
        ends = [self.low, self.high, self.value / FARTHEST, self.value * FARTHEST]
        if self.is_dimension:
            ends += [self.known.lowest, self.known.highest]
        return min(ends), max(ends)

    def saved(self, length: float) -> float:
        """A length (m or rad) rounded as in a saved chip file. It has :data:`SAVED_DIGITS` digits in its unit."""
        unit = self.shown_unit.replace("µ", "u")
        return parse_quantity(f"{length * self.factor:.{SAVED_DIGITS}g} {unit}", self.quantity,
                              source="live view", field=self.name)

    def shown(self, number: float, digits: int = 6) -> str:
        """A number (SI) in ``shown_unit``, without the unit."""
        return f"{number * self.factor:.{digits}g}"

    def with_unit(self, number: float, digits: int = 6) -> str:
        """A number (SI) in ``shown_unit``, with the unit."""
        return f"{self.shown(number, digits)} {self.shown_unit}".rstrip()

    def reaching(self, number: float) -> Control:
        """A copy whose range includes `number` (SI) with a margin."""
        width = max(self.high - self.low, 0.0)
        return replace(self, low=min(self.low, number - 0.25 * width), high=max(self.high, number + 0.25 * width))


def controls(chip: Chip, problem: Problem, wanted: Sequence[str] = ()) -> tuple[Control, ...]:
    """The controls of `chip` for the names `wanted`, ``NAME`` or ``NAME=LOW..HIGH``.

    By default they are all thicknesses, the radius or half width of the cavity, the sound speed of its fluid, and the
    shear modulus of the first other solid.

    Args:
        problem: of the chip in its state, without lengths among its values.

    Raises:
        InputError: the name of a parameter without effect on the spectrum, one given twice, or a range that cannot be
            read, excludes the present value, or passes another radius.
    """
    first, lengths = canonical_names(chip), chip.dimensions()
    present = {name: complex(each.value) for name, each in lengths.items() if name in first
            or ParameterName.parse(name).is_thickness or ParameterName.parse(name).is_shape} | dict(problem.values)
    found: dict[str, Control] = {}
    for text in wanted or _usual(chip, problem):
        name, _, ends = text.partition("=")
        name = first.get(name.strip(), name.strip())
        choose(name.removesuffix(LOSS), present, source="command line", field="--vary")
        if name in found:
            raise InputError("command line", "--vary", text, "every number once; radii that coincide are one")
        found[name] = _control(chip, problem, name, real_part(present, name), ends.strip())
    # Raises for a radius that would pass another one, and for a shape that folds a cell.
    parametrised_within(problem, chip, {
        name: (each.low, each.high) for name, each in found.items() if each.is_dimension})
    return tuple(found.values())


def _usual(chip: Chip, problem: Problem) -> list[str]:
    names = [name for name in chip.dimensions() if name.endswith(".thickness")]
    names += [name for name in (f"{CAVITY}.{chip.measure.across}",) if name in chip.dimensions()]
    fluid = problem.materials.get(CAVITY)
    if isinstance(fluid, Fluid):
        names.append(f"{fluid.name}.sound_speed")
    solid = next((each for each in problem.materials.values() if isinstance(each, IsotropicSolid)), None)
    return names if solid is None else [*names, f"{solid.name}.shear_modulus"]


def _control(chip: Chip, problem: Problem, name: str, value: float, ends: str) -> Control:
    number = _number(chip, problem, name, value)
    shown, factor = shown_unit(number.unit), shown_factor(number.unit)
    if number.unit == "m" and value < _THIN:
        shown, factor = "µm", 1e6
    narrowed = ""
    if ends:
        low, high = _ends(name, ends, number.quantity)
    else:
        reach = max(RELATIVE_REACH * abs(value), TOLERANCES * (number.tolerance or 0.0))
        if number.parsed.is_shape and number.tolerance is None:
            reach = max(reach, TOLERANCES * SHAPE_UNCERTAINTY[number.parsed.coefficient])
        low, high = value - reach, value + reach
        if number.is_dimension:
            known = number.known
            low, high = admissible_range(chip, name, min(low, known.low), max(high, known.high))
            if low > known.low or high < known.high:
                narrowed = (f"{low * factor:.6g} to {high * factor:.6g} {shown}, narrower than its prior: "
                            f"{known.low * factor:.6g} to {known.high * factor:.6g} {shown}; the mesh cannot be "
                            "stretched farther")
    if number.is_dimension and admissible_range(chip, name, low, high) != (low, high):
        ends = f"{low:g}..{high:g} m"
        low, high = admissible_range(chip, name, low, high)
        raise InputError("command line", f"--vary {name}", ends, f"a range within {low:g}..{high:g} m, where no length "
                         "vanishes and no radius passes another")
    if not low < high or not low <= value <= high:
        raise InputError("command line", f"--vary {name}", ends or f"{low:g}..{high:g}",
                         f"a lower number, then a higher one, with the present {value * factor:.6g} {shown} between "
                         "them")
    return Control(name, value, low, high, number.stated, number.unit, number.tied, material=number.material,
                   shown_unit=shown, factor=factor, narrowed=narrowed)


def _number(chip: Chip, problem: Problem, name: str, value: float) -> Number:
    """The parameter of that name and `value` (SI), with its uncertainty. A length without one has that assumed by its
    role."""
    parsed = ParameterName.parse(name)
    if parsed.is_dimension:
        found = length_number(chip, name)
        return replace(found, stated=found.stated or assumed_by_role(name, value, found.material))
    owner = next((each for each in problem.materials.values() if each.name == parsed.owner), None)
    stated = None if owner is None else coefficient_number(owner, parsed.local).stated
    return Number(name, value, stated=stated, unit=parsed.unit)


def _ends(name: str, text: str, dimension: str) -> tuple[float, float]:
    low, between, high = text.partition(RANGE_MARK)
    field = f"--vary {name}"
    if not between:
        raise InputError("command line", field, text, f"two numbers with {RANGE_MARK!r} between them")
    one, other = (parse_quantity(end.strip(), dimension, source="command line", field=field) for end in (low, high))
    return one, other


def is_inside(ranges: Mapping[str, tuple[float, float]], values: Mapping[str, float]) -> bool:
    """Whether `values` lie in `ranges`, within rounding."""
    return all(low - 1e-9 * abs(low) <= values[name] <= high + 1e-9 * abs(high)
               for name, (low, high) in ranges.items())


def wraps(one: Mapping[str, tuple[float, float]], other: Mapping[str, tuple[float, float]]) -> bool:
    """Whether the ranges `one` include the `other` ones."""
    return all(one[name][0] <= low and high <= one[name][1] for name, (low, high) in other.items())
