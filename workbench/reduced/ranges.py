"""A chip's spectrum as a fast function of parameters within ranges.

::

    model = range_model(read_chip("chip.toml"), "filled", {"substrate.thickness": (0.7e-3, 1.0e-3),
                                                           "pla.shear_modulus": (0.8e9, 1.1e9)})
    model({"substrate.thickness": 0.8e-3}).impedance

The basis of a reduced model is enriched for the ranges (weak greedy: Rozza, Huynh and Patera 2008, Arch. Comput.
Methods Eng. 15, 229): the error is estimated at points spread over the ranges and at frequencies over the band, and the
full model is solved where it is largest. These solves give the error of the model, since an estimate has an unknown
factor. Constant parts are summed once, so a model of few parameters is small.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from geometry.chip import Chip
from geometry.measure import ABOUT_AXIS
from geometry.stretch import admissible_range, canonical_names
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import System, one_thread
from workbench.files.errors import InputError, choose
from workbench.files.sealed import read_arrays, write_arrays
from workbench.jobs.progress import Progress, no_progress
from workbench.model.dimensions import parametrised_within
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.numbers import ParameterName, placed, real_part
from workbench.model.problem import Problem, build, fill
from workbench.physics.term import Values
from workbench.reduced.about_point import local_basis
from workbench.reduced.basis import smallest_part, truncated_coordinates
from workbench.reduced.compact import compacted
from workbench.reduced.estimate import energy_matrix
from workbench.reduced.growth import ENRICHING_DEPTH, TIGHTER, sample
from workbench.reduced.model import ReducedModel
from workbench.reduced.predictor import Prediction
from workbench.results.brief import Brief
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Origin, Spectrum

if TYPE_CHECKING:
    import xarray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Ranges = Mapping[str, tuple[float, float]]

#: Per round: number of frequencies at which errors are estimated, of points of the ranges, and of full solves.
WATCHED, LOOKED_AT, SOLVED = 61, 32, 12

#: Number of frequencies of the first solves, in the middle of the ranges.
FIRST = 6

#: Truncation of a basis, as an error of Z relative to the tolerance. The energy of the omitted part is a pessimistic
#: bound of the error. At 30 a disc took 6 rounds of full solves instead of 2 (with 31 vectors, not 30).
TRUNCATED_TO = 3.0

#: Threshold of the part of a unit-energy candidate outside the others.
INDEPENDENT = 1e-6

#: Default limit of the full solves of a model.
LIMIT = 400

#: Version of the layout of a stored model.
FORMAT = 3


class OutOfRange(ValueError):
    """A parameter outside the range of a model."""


class NotCovered(RuntimeError):
    """A range model that did not reach its tolerance. ``model`` is that model; its ``error`` is the error reached."""

    def __init__(self, model: RangeModel) -> None:
        super().__init__(f"the range model has an error of {100.0 * model.error:.2g} % in its last check, after "
                         f"{model.reduced.solves} full solves and at rank {model.rank}, above the tolerance of "
                         f"{100.0 * model.relative_error:.2g} %; narrow the ranges, or allow more solves")
        self.model = model

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotCovered, (self.model,))


@dataclass(frozen=True, eq=False, repr=False)
class Response(Shown):
    """A spectrum of a range model. ``values`` are the parameters by name, ``prediction`` is their prediction."""

    values: Mapping[str, float]
    prediction: Prediction

    @property
    def frequency(self) -> Real:
        """Frequency (n,) in Hz."""
        return self.prediction.solution.frequency

    @property
    def impedance(self) -> Complex:
        """Impedance (n,) in ohm, e^{+j w t}."""
        return self.prediction.impedance

    @property
    def error(self) -> Real:
        """Estimated relative error (n,) of the impedance on the same mesh."""
        return self.prediction.error

    @property
    def spectrum(self) -> Spectrum:
        """The impedance as a spectrum."""
        return Spectrum(self.frequency, self.impedance, origin=Origin("simulated"))

    def summary(self) -> Summary:
        """The parameters and the estimated error, for a notebook."""
        rows = [(name, f"{value:.6g}") for name, value in self.values.items()]
        rows.append(("estimated error of Z", f"{100.0 * float(self.error.max()):.1g} %"))
        return Summary("Range model", tuple(rows), {"simulated": self.spectrum})

    def to_xarray(self) -> xarray.Dataset:
        """The spectrum with its estimated ``error``, and the parameters as attributes (SI)."""
        return self.spectrum.to_xarray().assign(error=("frequency", self.error)).assign_attrs(self.values)

    def gradient(self, names: tuple[str, ...] | None = None) -> Complex:
        """d Z / d parameter (n, len(names)) in ohm per SI unit. By default it is for all parameters of the model."""
        names = tuple(self.values) if names is None else names
        parsed = [ParameterName.parse(name) for name in names]
        keys = tuple(dict.fromkeys(name.key for name in parsed))
        slopes = np.conj(self.prediction.solution.parameter_gradient(self.prediction.values, keys))
        columns = [slopes[:, keys.index(name.key)] * (-1j if name.is_loss else 1.0) for name in parsed]
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class RangeModel(Brief):
    """The spectrum of one problem for parameters within ``ranges``.

    ``ranges`` are in SI by name, with ``.loss`` for imaginary parts. ``frequency`` (n,) in Hz; ``relative_error`` is
    the tolerance, ``error`` the largest error in the last check by full solves (where estimates were largest),
    ``seconds`` the time of its making.
    """

    problem: Problem
    ranges: Ranges
    frequency: Real
    reduced: ReducedModel
    relative_error: float
    error: float
    seconds: float

    @property
    def rank(self) -> int:
        """Unknowns of the reduced model."""
        return self.reduced.operators.size

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.ranges)

    def __call__(self, values: Mapping[str, float] | None = None) -> Response:
        """The spectrum at these parameters, by default the problem's own.

        Raises:
            KeyError: a name without a range.
            OutOfRange: a parameter outside its range.
        """
        numbers = numbers_in_ranges(self.ranges, self.problem.values, values or {})
        placed_there = placed(self.problem.values, numbers)
        solution = self.compact.solve(self.frequency, placed_there)
        return Response(numbers, Prediction(solution, self.compact, placed_there))

    @cached_property
    def compact(self) -> ReducedModel:
        """The reduced model with constant parts summed."""
        return compacted(self.reduced, range_keys(self.ranges), self.problem.values)

    def enriched(
        self, relative_error: float | None = None, *, limit: int = LIMIT, seed: int = 1,
        progress: Progress = no_progress,
    ) -> RangeModel:
        """A model of the same ranges, checked at further points. It is enlarged if necessary.

        Raises:
            NotCovered: `limit` further solves were not enough.
        """
        wanted = self.relative_error if relative_error is None else relative_error
        return _last(_growth(self, wanted, limit, seed, progress))

    def save(self, path: Path | str) -> None:
        """Store the model in a file for :func:`load_range_model`."""
        content = {"format": FORMAT, "ranges": dict(self.ranges), "relative_error": self.relative_error,
                   "error": self.error, "seconds": self.seconds, "solves": self.reduced.solves,
                   "residual": self.reduced.residual,
                   "problem": fingerprint(self.problem)}
        write_arrays(Path(path), {
            "frequency": self.frequency, "basis": self.reduced.basis, "sizes": self.reduced.sizes,
            "test": self.reduced.test, "matrices": self.reduced.operators.matrices, "sketch": self.reduced.sketch,
        }, content)


def range_model(
    chip: Chip,
    state: str | None,
    ranges: Ranges,
    *,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 241,
    relative_error: float = 1e-3,
    limit: int = LIMIT,
    seed: int = 0,
    progress: Progress = no_progress,
    accuracy: float | Discretisation = ACCURACY,
) -> RangeModel:
    """A model of a chip's spectrum over ranges of parameters.

    Args:
        state: name of the state, by default the last one of the file.
        ranges: lowest and highest value (SI) by name: ``substrate.thickness``, ``cavity.radius``,
            ``<material>.shear_modulus``, ``<material>.shear_modulus.loss``. One name stands for equal radii.
        points: number of frequencies in the band.
        relative_error: of the impedance, against the full solution on the same mesh.
        limit: most full solves.
        seed: of the random points of enrichment and check.
        accuracy: of the mesh, see `discretisation`.

    Raises:
        InputError: an error in the chip or its materials, an unknown name, or an empty range.
        NotCovered: `limit` solves were not enough; the error has the model.
    """
    request = RangeRequest(chip, state, ranges, registry, band, points, relative_error, accuracy, limit, seed)
    return _last(growing_model(request, progress))


@dataclass(frozen=True)
class RangeRequest:
    """The input of a range model, as in :func:`range_model`."""

    chip: Chip
    state: str | None
    ranges: Ranges
    registry: Registry | None = None
    band: tuple[float, float] | None = None
    points: int = 241
    relative_error: float = 1e-3
    accuracy: float | Discretisation = ACCURACY
    limit: int = LIMIT
    seed: int = 0


def growing_model(request: RangeRequest, progress: Progress = no_progress) -> Generator[RangeModel, None, None]:
    """:func:`range_model` with all intermediate models, each computed on request.

    The first is that of the middle of the ranges; its ``error`` is infinite, since no full solve has checked it. Each
    later model has the error of the model before it.

    Raises:
        InputError, NotCovered: as in :func:`range_model`.
    """
    started = time.perf_counter()
    low, high = request.band or request.chip.band
    plain = build(fill(request.chip, request.state, request.registry), band=(low, high), accuracy=request.accuracy)
    problem, ranges = with_ranges(plain, request.chip, request.ranges)
    frequency = np.linspace(low, high, request.points)
    centre = placed(problem.values, {key: 0.5 * sum(ends) for key, ends in ranges.items()})
    moves: dict[str, float] = {}
    for number, (lowest, highest) in ranges.items():
        key = ParameterName.parse(number).key
        moves[key] = max(moves.get(key, 0.0), 0.5 * (highest - lowest))
    first = local_basis(assemble(problem.mesh, problem.terms), frequency, centre, moves,
                        tolerance=TRUNCATED_TO * request.relative_error, nodes=FIRST).model
    model = RangeModel(problem, ranges, frequency, first, request.relative_error, np.inf,
                       time.perf_counter() - started)
    yield model
    yield from _growth(model, request.relative_error, request.limit, request.seed, progress)


def numbers_in_ranges(ranges: Ranges, own: Mapping[str, complex], values: Mapping[str, float]) -> dict[str, float]:
    """A value for each of `ranges`: from `values`, or its `own` value.

    Raises:
        KeyError: a name without a range.
        OutOfRange: a value outside its range.
    """
    numbers = {name: real_part(own, name) for name in ranges} | dict(values)
    for name, number in numbers.items():
        if name not in ranges:
            raise KeyError(f"the model has no range for {name!r}; it has {', '.join(ranges)}")
        low, high = ranges[name]
        if not low - 1e-9 * abs(low) <= number <= high + 1e-9 * abs(high):
            raise OutOfRange(f"{name} is {number:g}; the range of the model is {low:g} to {high:g}")
    return numbers


def with_ranges(problem: Problem, chip: Chip, ranges: Ranges) -> tuple[Problem, Ranges]:
    """`problem` with the lengths of `ranges` as parameters. The ranges are returned by their names.

    Raises:
        InputError: a name that is neither a coefficient nor a length, an empty range, or two ranges for equal radii.
    """
    first, lengths = canonical_names(chip), chip.dimensions()
    flexed = parametrised_within(problem, chip, ranges)
    found: dict[str, tuple[float, float]] = {}
    for key, ends in ranges.items():
        known = first.get(key, key)
        value = ParameterName.parse(known).key
        choose(value, {*flexed.values, *lengths}, source=chip.file, field="range")
        if value not in flexed.values:
            raise InputError(chip.file, f"range of {key}", key, "a coefficient, or a length that affects the spectrum")
        low, high = map(float, ends)
        if not low < high:
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g}", "a lower number, then a higher one")
        if known in first and admissible_range(chip, known, low, high) != (low, high):
            least, most = admissible_range(chip, known)
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g} m", "a range at a distance from the "
                             f"next radii, within {least:g} to {most:g} m")
        if not low <= real_part(flexed.values, known) <= high:
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g}",
                             f"a range that contains the present {real_part(flexed.values, known):g}")
        found[known] = (low, high)
    return flexed, found


def range_keys(ranges: Ranges) -> set[str]:
    """Keys of the complex values of the parameters in `ranges`."""
    return {ParameterName.parse(name).key for name in ranges}


def _last(models: Iterator[RangeModel]) -> RangeModel:
    """The last of some models."""
    (found,) = deque(models, maxlen=1)
    return found


def _growth(
    model: RangeModel, tolerance: float, limit: int, seed: int, progress: Progress
) -> Iterator[RangeModel]:
    """The successive models from `model`, the last within `tolerance`."""
    started, operators, reduced = time.perf_counter(), model.reduced.full, model.reduced
    drawn = points_within(model.ranges, model.problem.values, seed)
    watched = np.linspace(model.frequency[0], model.frequency[-1], WATCHED)
    spent, error, first, share, smallest = 0, np.inf, 0.0, 0.0, smallest_part(TRUNCATED_TO * tolerance)
    with one_thread(), ThreadPoolExecutor(max_workers=max(1, min(2, os.cpu_count() or 1))) as pool:
        while True:
            compact = compacted(reduced, range_keys(model.ranges), model.problem.values)
            looked = pool.map(partial(_worst, compact, watched), islice(drawn, LOOKED_AT))
            chosen = sorted(looked, key=lambda each: -each.estimate)[:SOLVED]
            solved = list(pool.map(
                lambda each: sample(System(operators, each.values), each.frequency, ENRICHING_DEPTH), chosen))
            spent += len(solved)
            error = max(abs(one.charge / full.charge - 1.0) for one, full in zip(chosen, solved, strict=True))
            first = first or error
            reduced = reduced.counted(*(each.residual for each in solved))
            if first > tolerance:
                # The completed share, in orders of magnitude of the error.
                share = max(share, float(np.clip(np.log(first / error) / np.log(first / tolerance), 0.0, 0.99)))
                progress("spectra", share)
            done = replace(model, reduced=reduced, relative_error=tolerance, error=float(error),
                           seconds=model.seconds + time.perf_counter() - started)
            if error <= tolerance:
                progress("spectra", 1.0)
                yield done
                return
            if spent >= limit:
                raise NotCovered(done)
            states, enriched = np.column_stack([each.states for each in solved]), reduced
            while enriched is reduced:
                enriched = _enriched(reduced, states, watched, [each.values for each in chosen], smallest, pool)
                # If no candidate is needed although the samples disagree, the truncation was too coarse.
                smallest *= TIGHTER if enriched is reduced else 1.0
            reduced = enriched
            yield replace(done, reduced=reduced)


def points_within(ranges: Ranges, own: Mapping[str, complex], seed: int) -> Iterator[dict[str, complex]]:
    """Values at points spread over the ranges, without end. The rest are the `own` values of a problem."""
    low, high = (np.array(ends) for ends in zip(*ranges.values(), strict=True))
    sampler = qmc.Sobol(len(ranges), seed=seed)
    while True:
        point = low + (high - low) * sampler.random(1)[0]
        yield placed(own, dict(zip(ranges, map(float, point), strict=True)))


def _enriched(
    model: ReducedModel, candidates: Complex, frequencies: Real, places: Sequence[Values], smallest: float,
    pool: ThreadPoolExecutor,
) -> ReducedModel:
    """`model` enriched by the needed part of the `candidates` (size, n). The states are those at `places`. Each needs
    candidates of other places too, since its own are accurate only near their frequency."""
    size = np.sqrt(np.sum(np.abs(candidates[:-1]) * np.abs(model.energy @ candidates[:-1]), axis=0))
    wide, old = model.joined([(candidates / size, INDEPENDENT)]), model.sizes.size
    found = np.column_stack(list(pool.map(lambda values: wide.states(frequencies, values)[old:-1], places)))
    own, sizes = truncated_coordinates(np.column_stack([found.real, found.imag]), np.eye(len(found)), smallest)
    part = np.zeros((wide.sizes.size, old + sizes.size))
    part[:old, :old], part[old:, old:] = np.eye(old), own
    return wide.restricted(part, np.append(model.sizes, sizes)) if sizes.size else model


class _Worst(NamedTuple):
    """The largest error ``estimate`` of a model at ``values``. ``frequency`` (Hz) and ``charge`` are those there."""

    estimate: float
    frequency: float
    charge: complex
    values: Values


def _worst(model: ReducedModel, frequencies: Real, values: Values) -> _Worst:
    solution, estimate, index = model.worst(frequencies, values)
    return _Worst(estimate, float(frequencies[index]), complex(solution.charge[index]), values)


def fingerprint(problem: Problem) -> str:
    """A digest of a problem: mesh with its measure, terms and values."""
    found = hashlib.sha256()
    found.update(np.ascontiguousarray(problem.mesh.mesh.p).tobytes())
    found.update(np.ascontiguousarray(problem.mesh.mesh.t).tobytes())
    if problem.mesh.coordinates is not None:
        found.update(np.ascontiguousarray(problem.mesh.coordinates).tobytes())
    found.update(repr((problem.mesh.order, problem.terms, sorted(problem.values.items()))).encode())
    if problem.mesh.measure != ABOUT_AXIS:
        # About an axis nothing is added, so that older stored models stay readable.
        found.update(repr(problem.mesh.measure).encode())
    return found.hexdigest()


def load_range_model(
    path: Path | str, chip: Chip, state: str | None = None, *, registry: Registry | None = None,
    accuracy: float | Discretisation = ACCURACY,
) -> RangeModel:
    """A model stored by :meth:`RangeModel.save`, for its chip.

    Raises:
        InputError: the file is not such a model, or is of another chip, state, material or mesh.
    """
    path = Path(path)
    content, stored = read_arrays(path)
    if content.get("format") != FORMAT:
        raise InputError(str(path), "format", content.get("format"), f"{FORMAT}; make the model again")
    try:
        ranges = {name: (float(low), float(high)) for name, (low, high) in content["ranges"].items()}
        frequency = stored["frequency"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), "file", repr(error), "a stored range model") from error
    name = chip.state(state).name
    band = float(frequency[0]), float(frequency[-1])
    device = fill(chip, state, registry)
    problem, _ = with_ranges(build(device, band=band, accuracy=accuracy), chip, ranges)
    if fingerprint(problem) != content["problem"]:
        raise InputError(str(path), "chip", f"{chip.name}, {name}", "the chip, state, materials and mesh of "
                         "the model")
    operators = assemble(problem.mesh, problem.terms)
    energy = energy_matrix(System(operators, problem.values), float(np.median(frequency)))
    inner = ReducedOperators(operators.integrals, operators.coefficients, stored["matrices"], operators.forms)
    reduced = ReducedModel(operators, inner, stored["basis"], stored["sizes"], stored["test"], stored["sketch"],
                           energy, content["solves"], content["residual"])
    return RangeModel(problem, ranges, frequency, reduced, content["relative_error"], content["error"],
                      content["seconds"])
