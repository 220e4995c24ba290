"""A chip's spectrum as a function of its lengths, moduli and losses, anywhere within ranges, in a fraction of a second.

    model = range_model(read_chip("chip.toml"), "filled", {"substrate.thickness": (0.7e-3, 1.0e-3),
                                                           "pla.shear_modulus": (0.8e9, 1.1e9)})
    model({"substrate.thickness": 0.8e-3}).impedance

The basis of a reduced model is enriched for the ranges (weak greedy: Rozza, Huynh and Patera 2008, Arch. Comput.
Methods Eng. 15, 229): at points spread evenly over them the error is estimated at frequencies all over the band, and
where it is largest the full model is solved. Whether the model is good enough is what these solves say, since an
estimate bounds the error by a factor of its own. Constant parts are summed once, so that a model of few parameters is
small.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

#: Frequencies at which errors are estimated in a round, points of the ranges looked at, and of these solved.
WATCHED, LOOKED_AT, SOLVED = 61, 32, 12

#: Frequencies of the first solves, in the middle of the ranges.
FIRST = 6

#: A basis is truncated to what an error of Z of this times the tolerance needs: the energy of what is left out bounds
#: the error many times over. At 30 a disc took 6 rounds of full solves in place of 2 (with 31 vectors, not 30).
TRUNCATED_TO = 3.0

#: Candidates of unit energy whose part outside the others is smaller than this add nothing.
INDEPENDENT = 1e-6

#: Most full solves of a model, unless told otherwise.
LIMIT = 400

#: Number of the layout at the head of a stored model; raise it where the layout changes.
FORMAT = 3


class OutOfRange(ValueError):
    """A parameter outside the range that a model was made for."""


class NotCovered(RuntimeError):
    """A range model that did not reach its tolerance. Carries the ``model``, whose ``error`` is what it reached."""

    def __init__(self, model: RangeModel) -> None:
        super().__init__(f"the range model is off by {100.0 * model.error:.2g} % where it was checked last, after "
                         f"{model.reduced.solves} full solves and at rank {model.rank}, above the tolerance of "
                         f"{100.0 * model.relative_error:.2g} %; narrow the ranges, or allow more solves")
        self.model = model

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotCovered, (self.model,))


@dataclass(frozen=True, eq=False, repr=False)
class Response(Shown):
    """A spectrum of a range model: ``values`` the numbers asked for, by name, and the ``prediction`` made for them."""

    values: Mapping[str, float]
    prediction: Prediction

    @property
    def frequency(self) -> Real:
        """(n,) Hz."""
        return self.prediction.solution.frequency

    @property
    def impedance(self) -> Complex:
        """(n,) ohm, e^{+j w t}."""
        return self.prediction.impedance

    @property
    def error(self) -> Real:
        """Estimated relative error (n,) of the impedance, against the mesh's own full solution."""
        return self.prediction.error

    @property
    def spectrum(self) -> Spectrum:
        """The impedance as a spectrum."""
        return Spectrum(self.frequency, self.impedance, origin=Origin("simulated"))

    def summary(self) -> Summary:
        """The numbers asked for and the estimated error, for a notebook."""
        rows = [(name, f"{value:.6g}") for name, value in self.values.items()]
        rows.append(("estimated error of Z", f"{100.0 * float(self.error.max()):.1g} %"))
        return Summary("Range model", tuple(rows), {"simulated": self.spectrum})

    def to_xarray(self) -> xarray.Dataset:
        """The spectrum with the estimated ``error`` (1), and the numbers asked for as attributes (SI)."""
        return self.spectrum.to_xarray().assign(error=("frequency", self.error)).assign_attrs(self.values)

    def gradient(self, names: tuple[str, ...] | None = None) -> Complex:
        """d Z / d number (n, len(names)), ohm over the number's SI unit, by all that the model has if not named."""
        names = tuple(self.values) if names is None else names
        parsed = [ParameterName.parse(name) for name in names]
        keys = tuple(dict.fromkeys(name.key for name in parsed))
        slopes = np.conj(self.prediction.solution.parameter_gradient(self.prediction.values, keys))
        columns = [slopes[:, keys.index(name.key)] * (-1j if name.is_loss else 1.0) for name in parsed]
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class RangeModel(Brief):
    """The spectrum of one problem for parameters within ``ranges`` (SI, by name, ``.loss`` for imaginary parts).

    ``frequency`` (n,) Hz is where it answers; ``relative_error`` that it was made for, ``error`` the largest
    found by full solves where it was checked last (where estimates were largest), ``seconds`` what it took.
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
        """The spectrum at these numbers; those not given are the problem's own.

        Raises:
            KeyError: a name that the model has no range for.
            OutOfRange: a number outside its range.
        """
        numbers = numbers_in_ranges(self.ranges, self.problem.values, values or {})
        placed_there = placed(self.problem.values, numbers)
        solution = self.compact.solve(self.frequency, placed_there)
        return Response(numbers, Prediction(solution, self.compact, placed_there))

    @cached_property
    def compact(self) -> ReducedModel:
        """The reduced model with what no parameter of the ranges moves summed up."""
        return compacted(self.reduced, range_keys(self.ranges), self.problem.values)

    def enriched(
        self, relative_error: float | None = None, *, limit: int = LIMIT, seed: int = 1,
        progress: Progress = no_progress,
    ) -> RangeModel:
        """A model of the same ranges that has been checked at further points, and is larger where that asks for it.

        Raises:
            NotCovered: `limit` further solves were not enough.
        """
        wanted = self.relative_error if relative_error is None else relative_error
        return _last(_growth(self, wanted, limit, seed, progress))

    def save(self, path: Path | str) -> None:
        """Keep the model in a file, to be read by :func:`load_range_model` with the chip it is of."""
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
    """A model of a chip's spectrum over `ranges` of its lengths and of its materials' coefficients.

    Args:
        state: name of the state; the last one of the file if None.
        ranges: lowest and highest number (SI) by name: ``substrate.thickness``, ``cavity.radius``,
            ``<material>.shear_modulus``, ``<material>.shear_modulus.loss``. Of radii that coincide one is named.
        points: frequencies of the band at which it answers.
        relative_error: of the impedance, against the full solution on the same mesh.
        limit: most full solves.
        seed: of the points that it is enriched and checked at.
        accuracy: of the mesh, see `discretisation`.

    Raises:
        InputError: something in the chip or its materials, or a range that names nothing or holds no number.
        NotCovered: `limit` solves were not enough; the error carries the model.
    """
    model = _first(chip, state, ranges, registry, band, points, relative_error, accuracy)
    return _last(_growth(model, relative_error, limit, seed, progress))


def growing_model(
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
    accuracy: float | Discretisation = ACCURACY,
) -> Iterator[RangeModel]:
    """:func:`range_model` with every model on the way to the last one, for those who cannot wait.

    The first is of the middle of the ranges alone; its ``error`` is infinite, since no full solve has checked it. Each
    further one has that of the model before it.

    Raises:
        InputError, NotCovered: as of :func:`range_model`.
    """
    model = _first(chip, state, ranges, registry, band, points, relative_error, accuracy)
    yield model
    yield from _growth(model, relative_error, limit, seed, no_progress)


def _first(
    chip: Chip, state: str | None, ranges: Ranges, registry: Registry | None, band: tuple[float, float] | None,
    points: int, tolerance: float, accuracy: float | Discretisation,
) -> RangeModel:
    """The model that a range model grows from, of the middle of the ranges and of first derivatives there."""
    started = time.perf_counter()
    low, high = chip.band if band is None else band
    plain = build(fill(chip, state, registry), band=(low, high), accuracy=accuracy)
    problem, ranges = with_ranges(plain, chip, ranges)
    frequency = np.linspace(low, high, points)
    centre = placed(problem.values, {key: 0.5 * sum(ends) for key, ends in ranges.items()})
    moves: dict[str, float] = {}
    for number, (lowest, highest) in ranges.items():
        key = ParameterName.parse(number).key
        moves[key] = max(moves.get(key, 0.0), 0.5 * (highest - lowest))
    operators = assemble(problem.mesh, problem.terms)
    first = local_basis(operators, frequency, centre, moves, tolerance=TRUNCATED_TO * tolerance, nodes=FIRST).model
    return RangeModel(problem, ranges, frequency, first, tolerance, np.inf, time.perf_counter() - started)


def numbers_in_ranges(ranges: Ranges, own: Mapping[str, complex], values: Mapping[str, float]) -> dict[str, float]:
    """A number for each of `ranges`: that of `values`, or else the one among the `own` complex parameters.

    Raises:
        KeyError: a name that there is no range for.
        OutOfRange: a number outside its range.
    """
    numbers = {name: real_part(own, name) for name in ranges} | dict(values)
    for name, number in numbers.items():
        if name not in ranges:
            raise KeyError(f"the model has no range for {name!r}; it has {', '.join(ranges)}")
        low, high = ranges[name]
        if not low - 1e-9 * abs(low) <= number <= high + 1e-9 * abs(high):
            raise OutOfRange(f"{name} is {number:g}; the model was made for {low:g} to {high:g}")
    return numbers


def with_ranges(problem: Problem, chip: Chip, ranges: Ranges) -> tuple[Problem, Ranges]:
    """`problem` with the lengths among its values that `ranges` name, and the ranges by the names they have there.

    Raises:
        InputError: a name that is neither a coefficient nor a length, a range that holds no number, or two ranges for
            radii that coincide.
    """
    first, lengths = canonical_names(chip), chip.dimensions()
    flexed = parametrised_within(problem, chip, ranges)
    found: dict[str, tuple[float, float]] = {}
    for key, ends in ranges.items():
        known = first.get(key, key)
        value = ParameterName.parse(known).key
        choose(value, {*flexed.values, *lengths}, source=chip.file, field="range")
        if value not in flexed.values:
            raise InputError(chip.file, f"range of {key}", key, "a coefficient, or a length that the spectrum feels")
        low, high = map(float, ends)
        if not low < high:
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g}", "a lower number, then a higher one")
        if known in first and admissible_range(chip, known, low, high) != (low, high):
            least, most = admissible_range(chip, known)
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g} m", "a range that keeps away from the "
                             f"next radii, within {least:g} to {most:g} m")
        if not low <= real_part(flexed.values, known) <= high:
            raise InputError(chip.file, f"range of {key}", f"{low:g} to {high:g}",
                             f"a range that holds the present {real_part(flexed.values, known):g}")
        found[known] = (low, high)
    return flexed, found


def range_keys(ranges: Ranges) -> set[str]:
    """The complex values that numbers with `ranges` are parts of."""
    return {ParameterName.parse(name).key for name in ranges}


def _last(models: Iterator[RangeModel]) -> RangeModel:
    """The last of some models, of which there is one at least."""
    (found,) = deque(models, maxlen=1)
    return found


def _growth(
    model: RangeModel, tolerance: float, limit: int, seed: int, progress: Progress
) -> Iterator[RangeModel]:
    """The models that `model` becomes round by round, the last within `tolerance`."""
    started = time.perf_counter()
    operators, reduced, ranges = model.reduced.full, model.reduced, model.ranges
    low, high = (np.array(ends) for ends in zip(*ranges.values(), strict=True))
    sampler = qmc.Sobol(len(ranges), seed=seed)
    watched = np.linspace(model.frequency[0], model.frequency[-1], WATCHED)
    spent, error, first, share, smallest = 0, np.inf, 0.0, 0.0, smallest_part(TRUNCATED_TO * tolerance)
    moving = range_keys(ranges)
    with one_thread(), ThreadPoolExecutor(max_workers=max(1, min(2, os.cpu_count() or 1))) as pool:
        while True:
            points = low + (high - low) * sampler.random(LOOKED_AT)
            values = [placed(model.problem.values, dict(zip(ranges, map(float, x), strict=True))) for x in points]
            compact = compacted(reduced, moving, model.problem.values)
            seen = list(pool.map(partial(_worst, compact, watched), values))
            chosen = sorted(range(len(values)), key=lambda k: -seen[k][0])[:SOLVED]
            jobs = [(values[k], float(watched[seen[k][1]])) for k in chosen]
            solved = list(pool.map(lambda job: sample(System(operators, job[0]), job[1], ENRICHING_DEPTH), jobs))
            spent += len(solved)
            error = max(abs(seen[k][2] / each.charge - 1.0) for k, each in zip(chosen, solved, strict=True))
            first = first or error
            reduced = reduced.counted(*(each.residual for each in solved))
            if first > tolerance:
                # The share of the way, in orders of magnitude, that is behind.
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
            states = np.column_stack([each.states for each in solved])
            enriched = reduced
            while enriched is reduced:
                enriched = _enriched(reduced, states, watched, [value for value, _ in jobs], smallest, pool)
                # The samples are off: where nothing of them seems to be needed, too much was left out.
                smallest *= TIGHTER if enriched is reduced else 1.0
            reduced = enriched
            yield replace(done, reduced=reduced)


def _enriched(
    model: ReducedModel, candidates: Complex, frequencies: Real, places: Sequence[Values], smallest: float,
    pool: ThreadPoolExecutor,
) -> ReducedModel:
    """`model` enriched by what the states at `places` together need of the `candidates` (size, n), truncated.

    Each state needs candidates of other places too: its own alone are right near their frequency only.
    """
    size = np.sqrt(np.sum(np.abs(candidates[:-1]) * np.abs(model.energy @ candidates[:-1]), axis=0))
    wide, old = model.joined([(candidates / size, INDEPENDENT)]), model.sizes.size
    found = np.column_stack(list(pool.map(lambda values: wide.states(frequencies, values)[old:-1], places)))
    own, sizes = truncated_coordinates(np.column_stack([found.real, found.imag]), np.eye(len(found)), smallest)
    part = np.zeros((wide.sizes.size, old + sizes.size))
    part[:old, :old], part[old:, old:] = np.eye(old), own
    return wide.restricted(part, np.append(model.sizes, sizes)) if sizes.size else model


def _worst(model: ReducedModel, frequencies: Real, values: Mapping[str, complex]) -> tuple[float, int, complex]:
    """The largest estimated error of a model, the index of its frequency, and the charge there."""
    solution, error, index = model.worst(frequencies, values)
    return error, index, complex(solution.charge[index])


def fingerprint(problem: Problem) -> str:
    """A digest of a problem: of its mesh and the measure of that, its terms and its values."""
    found = hashlib.sha256()
    found.update(np.ascontiguousarray(problem.mesh.mesh.p).tobytes())
    found.update(np.ascontiguousarray(problem.mesh.mesh.t).tobytes())
    if problem.mesh.coordinates is not None:
        found.update(np.ascontiguousarray(problem.mesh.coordinates).tobytes())
    found.update(repr((problem.mesh.order, problem.terms, sorted(problem.values.items()))).encode())
    if problem.mesh.measure != ABOUT_AXIS:
        # Of a mesh about the axis nothing is added, so that models kept before sections could be straight are known.
        found.update(repr(problem.mesh.measure).encode())
    return found.hexdigest()


def load_range_model(
    path: Path | str, chip: Chip, state: str | None = None, *, registry: Registry | None = None,
    accuracy: float | Discretisation = ACCURACY,
) -> RangeModel:
    """A model that :meth:`RangeModel.save` has kept, with the chip it is of.

    Raises:
        InputError: the file is no such model, or one of another chip, state, material or mesh.
    """
    path = Path(path)
    content, stored = read_arrays(path)
    if content.get("format") != FORMAT:
        raise InputError(str(path), "format", content.get("format"), f"{FORMAT}; make the model again")
    try:
        ranges = {name: (float(low), float(high)) for name, (low, high) in content["ranges"].items()}
        frequency = stored["frequency"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), "file", repr(error), "a range model that was saved before") from error
    name = chip.state(state).name
    band = float(frequency[0]), float(frequency[-1])
    device = fill(chip, state, registry)
    problem, _ = with_ranges(build(device, band=band, accuracy=accuracy), chip, ranges)
    if fingerprint(problem) != content["problem"]:
        raise InputError(str(path), "chip", f"{chip.name}, {name}", "the chip, state, materials and mesh that the "
                         "model was made for")
    operators = assemble(problem.mesh, problem.terms)
    energy = energy_matrix(System(operators, problem.values), float(np.median(frequency)))
    inner = ReducedOperators(operators.integrals, operators.coefficients, stored["matrices"], operators.forms)
    reduced = ReducedModel(operators, inner, stored["basis"], stored["sizes"], stored["test"], stored["sketch"],
                           energy, content["solves"], content["residual"])
    return RangeModel(problem, ranges, frequency, reduced, content["relative_error"], content["error"],
                      content["seconds"])
