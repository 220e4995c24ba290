"""The free parameters of a fit, with start, bounds and prior."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from geometry.assumed import SHAPE_UNCERTAINTY, is_film
from geometry.chip import Chip
from geometry.dimension import Dimension
from geometry.stretch import admissible_range
from materials.kinds import IsotropicSolid, Piezoelectric
from materials.registry import Material
from workbench.files.errors import InputError, nearest_names, one_of
from workbench.model.device_numbers import assumed_by_role, bench_number, coefficient_number, length_number
from workbench.model.numbers import BENCH, BENCH_ELEMENTS, LOSS, Number, ParameterName, Stated
from workbench.model.problem import Problem

#: Standard uncertainty of a data sheet's number, relative to it, by the first letters of its name: as far as data
#: sheets of one class of ceramic differ from each other (the entries pic255, pzt5a, pzt5h of the registry do so).
DATA_SHEET: Mapping[str, float] = {"c": 0.1, "eps": 0.2, "e": 0.15, "density": 0.01}

#: Relative standard uncertainty of a modulus or a sound speed of any other material.
HANDBOOK = 0.2

#: The loss a fit starts from where none is known, and how far it may lie off, relative to the real part. A ceramic
#: starts as in Acevedo-Espinosa et al. (RP-UEIS), section 4.2. The permittivities of a soft one at constant strain have
#: three times the loss that the sheet states at constant stress.
CERAMIC_LOSS = 1e-3
CERAMIC_LOSS_REACH = 5e-2
PERMITTIVITY_LOSS_REACH = 0.2
POLYMER_LOSS_REACH = 0.3

#: Coefficients whose real part is above zero in every solid, and whose loss has one sign.
DIAGONAL = ("c11", "c33", "c44", "bulk_modulus", "shear_modulus")
PERMITTIVITIES = ("eps11", "eps33")

#: Share of a size that a derivative by it needs on either side.
NEARBY = 0.005

#: Remedy for a radius that would pass another (`geometry.stretch.admissible_range`).
BEYOND = "short of another radius; to search beyond that, change the radius in the chip file"


@dataclass(frozen=True, kw_only=True)
class Parameter(Number):
    """A free parameter: a number with start, range and prior.

    ``recordings`` are the names of those it acts in, empty for all. If ``relative``, it multiplies the coefficient of
    each recording's problem: a fluid at two temperatures. An ``offset`` is added to the value by the other parameters
    or by the problem: to the factor if both are relative. ``beyond`` is the remedy for an arbitrary bound. A
    ``nuisance`` is free only for its effect on uncertainties. The number x scales the values of the keys in ``powers``
    together: each by (1 + x)**power, after all others have been set.
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
        """The standard uncertainty of :attr:`start`, None without a prior."""
        return self.stated.deviation if self.stated else None

    @property
    def is_film(self) -> bool:
        """Whether it is a film thickness, with several optima in a spectrum."""
        return self.is_dimension and is_film(self.name) and not self.offset

    def acts_in(self, recording: str) -> bool:
        """Whether it acts in the recording of that name."""
        return not self.recordings or recording in self.recordings

    @property
    def scale(self) -> float:
        """The unit of steps: the prior, or a fifth of its range."""
        return self.prior if self.prior is not None else 0.2 * (self.high - self.low)


#: Free parameters of a transducer by default: the ten of Acevedo-Espinosa et al. (RP-UEIS), Table 2.
TRANSDUCER_TEN = ("c11", "c13", "c33", "c44", "e15", "e33", "eps33", "c11.loss", "c13.loss", "c33.loss")

#: Free parameters of a polymer sample by default: section 3.5 of the paper.
POLYMER_FOUR = ("bulk_modulus", "bulk_modulus.loss", "shear_modulus", "shear_modulus.loss")


def material_parameter(problem: Problem, material: str, name: str) -> Parameter:
    """The parameter ``<material>.<name>`` of a problem, with bounds and prior.

    A real part may move by half of itself, with the registry's uncertainty for prior or else that of a data sheet;
    a loss within the reach of its kind. A loss the registry does not know starts at a thousandth of the real part.

    Raises:
        InputError: the material has no such coefficient, or it cannot have a loss.
    """
    known = coefficients_of(problem, material)
    full = ParameterName.parse(f"{material}.{name}")
    coefficient = full.coefficient
    if coefficient not in known:
        raise InputError("fit", "free", name, f"a coefficient of {material}: {', '.join(known)}, each also with "
                         f"{LOSS!r}", nearest_names(coefficient, known))
    solid = next(m for m in problem.materials.values() if m.name == material)
    value = complex(problem.values[full.key])
    if full.is_loss:
        return _loss(full, value, solid)
    size = abs(value.real)
    kinds = ("density", "eps", "e", "c")
    by_kind = next((DATA_SHEET[kind] for kind in kinds if coefficient.startswith(kind)), HANDBOOK)
    stated = coefficient_number(solid, coefficient).stated or Stated(by_kind * size, origin="data sheets of its kind")
    reach = max(0.5 * size, 5.0 * stated.deviation)
    low = value.real - reach
    if coefficient in (*DIAGONAL, *PERMITTIVITIES, "density", "sound_speed"):
        low = max(low, 0.05 * value.real)
    return Parameter(str(full), value.real, low, value.real + reach, stated, full.unit)


def coefficients_of(problem: Problem, material: str) -> list[str]:
    """The coefficients of a `material` in a problem, without its name."""
    return [key.removeprefix(f"{material}.") for key in problem.values if key.startswith(f"{material}.")]


def _loss(name: ParameterName, value: complex, material: Material) -> Parameter:
    if name.coefficient == "density" or not isinstance(material, Piezoelectric | IsotropicSolid):
        raise InputError("fit", "free", str(name), "a coefficient that can have a loss: a stiffness, a modulus, a "
                         "piezoelectric constant or a permittivity")
    size, start = abs(value.real), value.imag
    ceramic = isinstance(material, Piezoelectric)
    permittivity = name.coefficient in PERMITTIVITIES
    diagonal = permittivity or name.coefficient in DIAGONAL
    if start == 0.0 and diagonal:
        start = (1.0 if permittivity else -1.0) * (CERAMIC_LOSS if ceramic else 0.02) * size
    reach = PERMITTIVITY_LOSS_REACH if permittivity else CERAMIC_LOSS_REACH if ceramic else POLYMER_LOSS_REACH
    reach = max(reach * size, 3.0 * abs(start))
    low, high = 0.0 if permittivity else -reach, reach if permittivity or not diagonal else 0.0
    return Parameter(str(name), start, low, high, Stated(max(0.5 * reach, abs(start)), origin="losses of its kind"),
                     name.unit)


def dimension_parameter(chip: Chip, name: str) -> Parameter:
    """A dimension of a chip, within three tolerances of its value.

    The tolerance bounds a uniform law; if not stated, it is that of the role (`geometry.assumed`). A radius does not
    reach the next one, and stands for all radii of its length, by the first name; their stated tolerances must agree.

    Raises:
        InputError: the chip has no such dimension, states it as exact, or states two tolerances of radii that coincide.
    """
    known = chip.dimensions()
    if name not in known:
        raise InputError(chip.file, "free", name, f"a dimension of the chip: {', '.join(known)}",
                         nearest_names(name, known))
    number = length_number(chip, name)
    if number.tolerance == 0.0:
        raise InputError(chip.file, name, "a tolerance of 0", "a tolerance above zero, or none, for a length that is "
                         "free")
    wanted = number.known.lowest, number.known.highest
    low, high = stretchable([chip], number.name, *wanted)
    beyond = BEYOND if number.parsed.is_radius and (low, high) != wanted else ""
    stated = number.stated or assumed_by_role(number.name, number.value, number.material)
    return Parameter(number.name, number.value, low, high, stated, number.unit, number.tied, material=number.material,
                     beyond=beyond)


def about(chip: Chip, name: str) -> tuple[float, float]:
    """A narrow range (m or rad) about a size, for derivatives."""
    value = chip.dimensions()[name].value
    reach = 2.0 * SHAPE_UNCERTAINTY.get(ParameterName.parse(name).coefficient, NEARBY * abs(value))
    return admissible_range(chip, name, value - reach, value + reach)


def stretchable(chips: Iterable[Chip], name: str, low: float, high: float) -> tuple[float, float]:
    """The part of bounds (m) where meshes of `chips` keep their topology."""
    for chip in chips:
        if name in chip.dimensions():
            low, high = admissible_range(chip, name, low, high)
    return low, high


def ranges_of_dimensions(
    parameters: Iterable[Parameter], known: Mapping[str, Dimension]
) -> dict[str, tuple[float, float]]:
    """The ranges (m or rad) of the `known` dimensions under `parameters`. They are over any recording, by name."""
    shared: dict[str, tuple[float, float]] = {}
    own: dict[str, tuple[float, float]] = {}
    for p in parameters:
        for name in p.names:
            if p.is_dimension and name in known:
                ranges, start = (own, 0.0) if p.offset else (shared, known[name].value)
                low, high = ranges.get(name, (start, start))
                ranges[name] = min(low, p.low), max(high, p.high)
    for name, (below, above) in own.items():
        low, high = shared.get(name, (known[name].value,) * 2)
        shared[name] = low + below, high + above
    return shared


def shared_gain(uncertainty: float) -> Parameter:
    """The gain of all points of a recording, with a relative `uncertainty`."""
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
    number = bench_number(element)
    return Parameter(number.name, number.value, number.low, number.high, number.stated, number.unit,
                     recordings=tuple(recordings))


def parameters(problem: Problem, chip: Chip | None, material: str, names: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters of some `names`: coefficients, dimensions, or bench elements.

    A coefficient of another material is given by its full name, ``material/source.coefficient``.

    Raises:
        InputError: a name that is none of these, or given twice.
    """
    result: list[Parameter] = []
    owners = {m.name for m in problem.materials.values()}
    own, dimensions = coefficients_of(problem, material), {} if chip is None else chip.dimensions()
    for name in names:
        parsed = ParameterName.parse(name)
        if parsed.is_bench:
            added = bench_parameter(name)
        elif parsed.is_material:
            if parsed.owner not in owners:
                raise InputError("fit", "free", name, f"a coefficient of one of {', '.join(sorted(owners))}")
            added = material_parameter(problem, parsed.owner, parsed.local)
        elif chip is not None and name in dimensions:
            added = dimension_parameter(chip, name)
        elif parsed.key in own:
            added = material_parameter(problem, material, name)
        else:
            known = [*sorted(own), *(f"{key}{LOSS}" for key in sorted(own)), *dimensions,
                     *(BENCH + key for key in BENCH_ELEMENTS)]
            raise InputError("fit", "free", name, f"a coefficient of {material}, a dimension or a bench element: "
                             f"{one_of(known, name)}", nearest_names(name, known))
        if any(other.name == added.name for other in result):
            raise InputError("fit", "free", name, "each parameter once")
        result.append(added)
    return tuple(result)
