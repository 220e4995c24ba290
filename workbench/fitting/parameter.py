"""The free parameters of a fit: real numbers with a start, bounds and a prior.

Their names are those of `workbench.model.numbers`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from geometry.assumed import SHAPE_UNCERTAINTY, is_film
from geometry.chip import Chip
from geometry.dimension import Dimension
from geometry.stretch import admissible_range
from materials.kinds import IsotropicSolid, Piezoelectric
from materials.registry import Material
from workbench.files.errors import InputError, nearest_names
from workbench.model.device_numbers import assumed_by_role, bench_number, coefficient_number, length_number
from workbench.model.numbers import BENCH, BENCH_ELEMENTS, LOSS, Number, ParameterName, Stated
from workbench.model.problem import Problem

#: Standard uncertainty of a data sheet's number, relative to it, by the first letters of its name: as far as data
#: sheets of one class of ceramic differ from each other (the entries pic255, pzt5a, pzt5h of the registry do so).
DATA_SHEET: Mapping[str, float] = {"c": 0.1, "eps": 0.2, "e": 0.15, "density": 0.01}

#: Relative standard uncertainty of a modulus or a sound speed of any other material.
HANDBOOK = 0.2

#: The loss a fit starts from where none is known, and how far it may lie off, relative to the real part. A ceramic
#: starts as in Acevedo-Espinosa et al. (RP-UEIS), section 4.2.
CERAMIC_LOSS = 1e-3
CERAMIC_LOSS_REACH = 5e-2
POLYMER_LOSS_REACH = 0.3

#: Share of a size that a derivative by it needs on either side.
NEARBY = 0.005

#: Remedy for a radius that would pass another (`geometry.stretch.admissible_range`).
BEYOND = "short of another radius; to search beyond that, change the radius in the chip file"


@dataclass(frozen=True, kw_only=True)
class Parameter(Number):
    """A number that a fit may move, from its value and within its range; what is stated of it is the prior.

    ``recordings`` are the names of those it acts in, empty for all. Where ``relative``, the number multiplies the
    coefficient that each recording's problem has: a fluid at two temperatures. An ``offset`` is added to what the other
    parameters of the value, or its problem, give: to the factor where both are relative. ``beyond`` tells what to do
    about a bound that does not come from what is known. ``nuisance`` is whether it is no answer, and is there for what
    it leaves uncertain of the others. ``powers`` are values, by their keys, that the number x scales together: each by
    (1 + x)**power, after all others have been set.
    """

    recordings: tuple[str, ...] = ()
    relative: bool = False
    beyond: str = ""
    offset: bool = False
    nuisance: bool = False
    powers: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise ValueError(f"{self.name}: a start must lie between {self.low:g} and {self.high:g}, which differ")
        if self.prior is not None and not self.prior > 0.0:
            raise ValueError(f"{self.name}: prior {self.prior!r} must be a positive standard uncertainty")

    @property
    def start(self) -> float:
        """The value that a fit starts from."""
        return self.value

    @property
    def prior(self) -> float | None:
        """The standard uncertainty of :attr:`start` known beforehand, None if nothing was."""
        return self.stated.deviation if self.stated else None

    @property
    def is_film(self) -> bool:
        """Whether it is the thickness of a film of gel or glue, which spectra may show at several values."""
        return self.is_dimension and is_film(self.name) and not self.offset

    def acts_in(self, recording: str) -> bool:
        """Whether it acts in the recording of that name."""
        return not self.recordings or recording in self.recordings

    @property
    def scale(self) -> float:
        """The unit of its steps: the prior, or a fifth of the admitted range."""
        return self.prior if self.prior is not None else 0.2 * (self.high - self.low)


#: Free parameters of a transducer by default: the ten of Acevedo-Espinosa et al. (RP-UEIS), Table 2.
TRANSDUCER_TEN = ("c11", "c13", "c33", "c44", "e15", "e33", "eps33", "c11.loss", "c13.loss", "c33.loss")

#: Free parameters of a polymer sample by default: section 3.5 of the paper.
POLYMER_FOUR = ("bulk_modulus", "bulk_modulus.loss", "shear_modulus", "shear_modulus.loss")


def material_parameter(problem: Problem, material: str, name: str) -> Parameter:
    """The parameter ``<material>.<name>`` of a problem, with the bounds and the prior of its kind.

    A real part may move by half of itself, with the registry's uncertainty for prior or else that of a data sheet;
    a loss within the reach of its kind. A loss the registry does not know starts at a thousandth of the real part.

    Raises:
        InputError: the material has no such coefficient, or it cannot have a loss.
    """
    known = coefficients_of(problem, material)
    parsed = ParameterName.parse(name)
    coefficient = parsed.key
    if coefficient not in known:
        raise InputError("fit", "free", name, f"a coefficient of {material}: {', '.join(known)}, each also with "
                         f"{LOSS!r}", nearest_names(coefficient, known))
    found = next(m for m in problem.materials.values() if m.name == material)
    value = complex(problem.values[f"{material}.{coefficient}"])
    full = ParameterName.parse(f"{material}.{name}")
    if parsed.is_loss:
        return _loss(full, value, found)
    stated = coefficient_number(found, coefficient).stated or Stated(_data_sheet(coefficient) * abs(value.real),
                                                                     origin="data sheets of its kind")
    reach = max(0.5 * abs(value.real), 5.0 * stated.deviation)
    low, high = value.real - reach, value.real + reach
    if coefficient in ("c11", "c33", "c44", "eps11", "eps33", "density", "sound_speed", "bulk_modulus",
                       "shear_modulus"):
        low = max(low, 0.05 * value.real)
    return Parameter(str(full), value.real, low, high, stated, full.unit)


def coefficients_of(problem: Problem, material: str) -> list[str]:
    """The coefficients of a `material` among the values of a problem, without its name."""
    return [key.removeprefix(f"{material}.") for key in problem.values if key.startswith(f"{material}.")]


def _data_sheet(coefficient: str) -> float:
    for prefix in ("density", "eps", "e", "c"):
        if coefficient.startswith(prefix):
            return DATA_SHEET[prefix]
    return HANDBOOK


def _loss(name: ParameterName, value: complex, material: Material) -> Parameter:
    coefficient = name.coefficient
    if coefficient == "density" or not isinstance(material, Piezoelectric | IsotropicSolid):
        raise InputError("fit", "free", str(name), "a coefficient that can have a loss: a stiffness, a modulus, a "
                         "piezoelectric constant or a permittivity")
    size = abs(value.real)
    ceramic = isinstance(material, Piezoelectric)
    reach = (CERAMIC_LOSS_REACH if ceramic else POLYMER_LOSS_REACH) * size
    gains = coefficient in ("eps11", "eps33")
    diagonal = gains or coefficient in ("c11", "c33", "c44", "bulk_modulus", "shear_modulus")
    sign = 1.0 if gains or not diagonal else -1.0
    start = value.imag
    if start == 0.0 and diagonal:
        start = sign * (CERAMIC_LOSS if ceramic else 0.02) * size
    reach = max(reach, 3.0 * abs(start))
    low, high = (-reach, reach) if not diagonal else ((0.0, reach) if gains else (-reach, 0.0))
    return Parameter(str(name), start, low, high, Stated(max(0.5 * reach, abs(start)), origin="losses of its kind"),
                     name.unit)


def dimension_parameter(chip: Chip, name: str) -> Parameter:
    """A dimension of a chip: within three tolerances of its value, the tolerance read as the limits of a uniform law.

    Where the chip file states none, its role says what is assumed (`geometry.assumed`). A radius does not reach the
    next one, and stands for all radii of its length, under the first of their names; what several of them state of
    their tolerance must agree.

    Raises:
        InputError: the chip has no such dimension, states it as exact, or states two tolerances of radii that coincide.
    """
    known = chip.dimensions()
    if name not in known:
        raise InputError(chip.file, "free", name, f"a dimension of the chip: {', '.join(known)}",
                         nearest_names(name, known))
    found = length_number(chip, name)
    if found.tolerance == 0.0:
        raise InputError(chip.file, name, "a tolerance of 0", "a tolerance above zero, or none, for a length that is "
                         "free")
    wanted = found.known.lowest, found.known.highest
    low, high = stretchable([chip], found.name, *wanted)
    beyond = BEYOND if found.parsed.is_radius and (low, high) != wanted else ""
    stated = found.stated or assumed_by_role(found.name, found.value)
    return Parameter(found.name, found.value, low, high, stated, found.unit, found.tied, beyond=beyond)


def about(chip: Chip, name: str) -> tuple[float, float]:
    """A range (m or rad) about a shape that the chip states, or another size of it: twice the usual size of such
    shapes, or twice :data:`NEARBY` of the size, to either side."""
    value = chip.dimensions()[name].value
    reach = 2.0 * SHAPE_UNCERTAINTY.get(ParameterName.parse(name).coefficient, NEARBY * abs(value))
    return admissible_range(chip, name, value - reach, value + reach)


def stretchable(chips: Iterable[Chip], name: str, low: float, high: float) -> tuple[float, float]:
    """The part of bounds (m) within which the meshes of those `chips` that have the dimension keep their topology."""
    for chip in chips:
        if name in chip.dimensions():
            low, high = admissible_range(chip, name, low, high)
    return low, high


def ranges_of_dimensions(
    parameters: Iterable[Parameter], known: Mapping[str, Dimension]
) -> dict[str, tuple[float, float]]:
    """The range (m or rad) of each of the `known` dimensions under `parameters` in any recording, by its name there."""
    shared: dict[str, tuple[float, float]] = {}
    own: dict[str, tuple[float, float]] = {}
    for p in parameters:
        for name in p.names:
            if p.is_dimension and name in known:
                found, start = (own, 0.0) if p.offset else (shared, known[name].value)
                low, high = found.get(name, (start, start))
                found[name] = min(low, p.low), max(high, p.high)
    result = dict(shared)
    for name, (below, above) in own.items():
        low, high = shared.get(name, (known[name].value,) * 2)
        result[name] = low + below, high + above
    return result


def shared_gain(uncertainty: float) -> Parameter:
    """The gain that all points of a recording share, known to a standard `uncertainty` (relative): of a standard's
    tolerance, say. It moves no more than what it leaves uncertain of permittivities and stiffnesses."""
    return replace(bench_parameter("gain"), stated=Stated(uncertainty, origin="the recording"), nuisance=True)


def bench_parameter(name: str, recordings: Sequence[str] = ()) -> Parameter:
    """A bench element, named with or without ``bench.``.

    Raises:
        InputError: no such element.
    """
    parsed = ParameterName.parse(name)
    element = parsed.coefficient if parsed.is_bench else name
    if element not in BENCH_ELEMENTS:
        raise InputError("fit", "free", name, f"a bench element: {', '.join(BENCH_ELEMENTS)}",
                         nearest_names(element, BENCH_ELEMENTS))
    found = bench_number(element)
    return Parameter(found.name, found.value, found.low, found.high, found.stated, found.unit,
                     recordings=tuple(recordings))


def parameters(problem: Problem, chip: Chip | None, material: str, names: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters called `names`: coefficients of `material`, dimensions of `chip`, or bench elements.

    A coefficient of another material is given by its full name, ``material/source.coefficient``.

    Raises:
        InputError: a name that is none of these, or given twice.
    """
    result: list[Parameter] = []
    for name in names:
        parsed = ParameterName.parse(name)
        if parsed.is_bench:
            found = bench_parameter(name)
        elif parsed.is_material:
            if parsed.owner not in {m.name for m in problem.materials.values()}:
                raise InputError("fit", "free", name, "a coefficient of one of "
                                 + ", ".join(sorted({m.name for m in problem.materials.values()})))
            found = material_parameter(problem, parsed.owner, parsed.local)
        elif chip is not None and name in chip.dimensions():
            found = dimension_parameter(chip, name)
        else:
            found = _own_or_none(problem, chip, material, name)
        if any(other.name == found.name for other in result):
            raise InputError("fit", "free", name, "each parameter once")
        result.append(found)
    return tuple(result)


def _own_or_none(problem: Problem, chip: Chip | None, material: str, name: str) -> Parameter:
    own = set(coefficients_of(problem, material))
    if ParameterName.parse(name).key in own:
        return material_parameter(problem, material, name)
    dimensions = [] if chip is None else list(chip.dimensions())
    known = [*sorted(own), *(f"{key}{LOSS}" for key in sorted(own)), *dimensions,
             *(BENCH + key for key in BENCH_ELEMENTS)]
    raise InputError("fit", "free", name, f"a coefficient of {material}, a dimension or a bench element: "
                     f"{', '.join(known)}", nearest_names(name, known))
