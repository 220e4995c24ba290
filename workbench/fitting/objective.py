"""The objective of a fit: weighted residuals and their exact derivative.

The residual is ln(Z_model / Z_measured), complex, over the relative standard deviation of each point. The relative
error of the magnitude and the error of the phase in radian weigh the same, as for an instrument of constant accuracy.

A spectrum with sharp overtones has a local minimum for every match of the model's overtones to those of the recording.
Both admittances are therefore smoothed first with the same Lorentzian weights: for a causal response this is the
response at a complex frequency, with damping added, in which overtones merge into one broad resonance. The width is
then reduced to zero (`joint`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.stretch import canonical_names
from workbench.fem.operators import FullOperators, assemble
from workbench.fitting.fit_recording import CORNERS, OF_STATES
from workbench.fitting.fit_recording import FitRecording as FitRecording
from workbench.fitting.measurement_model import CLOCK, log_ratio, lorentzian, rms, through_bench
from workbench.fitting.parameter import Parameter, ranges_of_dimensions
from workbench.model.dimensions import parametrised_within
from workbench.model.numbers import LOSS, ParameterKind, ParameterName, placed, real_part
from workbench.model.problem import Problem
from workbench.reduced.about_point import DRAWS, TERMS, local_basis
from workbench.reduced.predictor import Prediction, Predictor

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
_Moved = tuple[tuple[int, Parameter, str], ...]
_Scaled = tuple[tuple[int, str, float], ...]
_Bench = tuple[tuple[int, Parameter], ...]


@dataclass(frozen=True, eq=False)
class Residual:
    """Weighted residuals and their derivative by the parameters (SI).

    ``vector`` (2 n,) real parts then imaginary parts, recording after recording; ``jacobian`` (2 n, p). For every
    recording: ``log_ratio`` ln(Z_model / Z_measured) (n,), unweighted, ``impedance`` (n,) ohm, and the ``predictions``.
    """

    vector: Real
    jacobian: Real
    log_ratio: tuple[Complex, ...]
    impedance: tuple[Complex, ...]
    predictions: tuple[Prediction, ...] = ()

    @cached_property
    def error(self) -> float:
        """The largest estimated relative error of any prediction."""
        return max((float(each.error.max()) for each in self.predictions), default=0.0)

    @property
    def rms(self) -> float:
        """The rms of |ln(Z_model / Z_measured)| over all points of all recordings."""
        return rms(np.concatenate(self.log_ratio))


@dataclass(frozen=True, eq=False)
class RecordingView:
    """A recording with its predictor and acting parameters.

    ``moved`` are columns, parameters and the values of its problem that they move, offsets last; ``scaled`` columns,
    values of its problem that they scale, and powers; ``bench`` the columns and parameters of the bench.
    """

    recording: FitRecording
    predictor: Predictor
    moved: _Moved
    scaled: _Scaled
    bench: _Bench

    @property
    def keys(self) -> tuple[str, ...]:
        """The values that parameters move."""
        return _keys(self.moved, self.scaled)


@dataclass(frozen=True, eq=False)
class Objective:
    """Residuals of several recordings as a function of one parameter vector.

    A parameter moves the value of its name among those of a recording's problem, and an offset adds to that; dimensions
    of the chip are put among them. Recordings of one problem share a predictor. An objective is a value: a prediction
    beyond the tolerance of its models comes from enriched copies, and :meth:`holding` keeps these.
    """

    views: tuple[RecordingView, ...]
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(
        cls, recordings: Sequence[FitRecording], parameters: Sequence[Parameter], *, tolerance: float
    ) -> Objective:
        """The objective of some recordings; `tolerance` as of a `Predictor`.

        Raises:
            ValueError: two recordings of one name.
        """
        names = [r.name for r in recordings]
        if len(set(names)) < len(names):
            raise ValueError(f"recordings must have names of their own, received {', '.join(names)}")
        flexed: dict[Any, Problem] = {}
        acting = [p for p in parameters if any(p.acts_in(r.owner) for r in recordings)]
        recordings = [_with_lengths(r, acting, flexed) for r in recordings]
        parts = [_acting_on(r, parameters) for r in recordings]
        predictors = _shared(recordings, [_keys(*each[:2]) for each in parts], tolerance)
        return cls(tuple(RecordingView(r, predictor, *each) for r, predictor, each in zip(
            recordings, predictors, parts, strict=True)), tuple(parameters))

    def with_parameters(self, more: Sequence[Parameter]) -> Objective:
        """A copy with further parameters after its own. Its models are not made to move their values."""
        parameters = (*self.parameters, *more)
        return Objective(tuple(RecordingView(view.recording, view.predictor, *_acting_on(view.recording, parameters))
                               for view in self.views), parameters)

    @cached_property
    def recordings(self) -> tuple[FitRecording, ...]:
        return tuple(view.recording for view in self.views)

    @cached_property
    def predictors(self) -> tuple[Predictor, ...]:
        """The predictor of every recording; recordings of one model share theirs."""
        return tuple(view.predictor for view in self.views)

    @property
    def solves(self) -> int:
        """Full solves spent on the present models."""
        return sum(p.solves for p in set(self.predictors))

    def predicted_by(self, predictors: Sequence[Predictor]) -> Objective:
        """A copy whose recordings are predicted by others."""
        return replace(self, views=tuple(replace(view, predictor=each)
                                         for view, each in zip(self.views, predictors, strict=True)))

    def holding(self, predictions: Sequence[Prediction]) -> Objective:
        """The objective with the models of `predictions`, one per recording."""
        latest = {predictor: prediction.model
                  for predictor, prediction in zip(self.predictors, predictions, strict=True)}
        if all(predictor.model is model for predictor, model in latest.items()):
            return self
        made = {predictor: predictor.holding(model) for predictor, model in latest.items()}
        return self.predicted_by([made[predictor] for predictor in self.predictors])

    def near(
        self, x: Real, reach: Mapping[str, float], tolerance: float, *, only: Collection[int] | None = None,
        enriches: bool = True,
    ) -> Objective:
        """A copy on local bases about x (p,), for moves by `reach`.

        See `about_point.local_basis`. Models stay as they are. If only the parameters of the indices `only` will move,
        models contain no more. Unless they are to be `neumann_enriched`, the factors of the full solves are dropped.
        """
        own = self if only is None else self._acting(x, only)
        made = dict[int, Predictor]()
        for predictor, sharing in own._sharing().items():
            # Recordings of one model whose values differ, by their offsets, have a basis each.
            for indices in own._alike(x, sharing):
                moves, within = self._moves_about(x, indices, reach), tolerance
                if observes := self.recordings[indices[0]].observable is not None:
                    within = min(tolerance, OF_STATES)
                basis = local_basis(predictor.operators, predictor.frequencies, self._values(x, indices[0]), moves,
                                    tolerance=within, draws=len(moves) if observes else DRAWS)
                if observes:
                    # Places where all values have moved by as much as is expected, in directions that are drawn.
                    signs = np.random.default_rng(1).choice([-1.0, 1.0], (CORNERS, len(moves)))
                    corners = [{**basis.values, **{name: basis.values[name] + sign * moves[name]
                                                   for sign, name in zip(row, moves, strict=True)}} for row in signs]
                    basis = basis.neumann_enriched(corners, within)
                made.update(dict.fromkeys(indices, predictor.on_basis(basis if enriches else basis.without_factors())))
        return own.predicted_by([made[index] for index in range(len(own.views))])

    def enriched(self, x: Real, tolerance: float) -> Objective:
        """A copy whose models predict at x (p,) within `tolerance` of Z.

        Raises:
            NotEnriched: a model did not reach the tolerance.
        """
        def strict(predictor: Predictor, indices: Sequence[int]) -> Predictor:
            made = replace(predictor, tolerance=tolerance)
            for index in indices:
                made = made.holding(made(self._values(x, index)).model)
            return replace(made, tolerance=predictor.tolerance)

        return self._remade(strict)

    def on_bases_of(self, other: Objective) -> Objective | None:
        """A copy on another objective's local bases over the same recordings. None if their meshes differ."""
        made = dict[Predictor, Predictor]()
        for own, known in zip(self.predictors, other.predictors, strict=True):
            if known.local is None or own.every.size != known.every.size or not np.array_equal(
                    own.every.mesh.mesh.p, known.every.mesh.mesh.p):
                return None
            if known not in made:
                values = {**own.problem.values, **known.local.values}
                made[known] = own.on_basis(replace(known.local.of(own.every), values=values))
        return self.predicted_by([made[known] for known in other.predictors])

    def coarser(self, tolerance: float) -> Objective:
        """A copy on local bases reduced to `tolerance` of Z."""
        def few(predictor: Predictor, indices: Sequence[int]) -> Predictor:
            local = predictor.local
            return predictor if local is None else predictor.on_basis(
                replace(local, model=local.model.coarser(tolerance)))

        return self._remade(few)

    def _acting(self, x: Real, only: Collection[int]) -> Objective:
        """A copy without terms that stay zero while only `only` move. x is (p,)."""
        moving = sorted(only)
        # Anywhere else: a term that is zero there too is zero everywhere, unless a number brings it in further on.
        scales = np.array([self.parameters[i].scale for i in moving])
        y = x.copy()
        y[moving] += 0.01 * scales * np.random.default_rng(0).uniform(0.5, 1.0, len(moving))

        def acting(predictor: Predictor, indices: Sequence[int]) -> Predictor:
            there = {key: value for index in indices for key, value in self.settings(y, index)[0].items()}
            brought = {key for index in indices for i, p, key in self.views[index].moved
                       if i in only and p.prior is None and p.parsed.kind is ParameterKind.TERM}
            return predictor.restricted(self._values(x, indices[0]), there, brought)

        return self._remade(acting)

    def neumann_enriched(
        self, x: Real, places: Sequence[Real], tolerance: float, *, only: Collection[int], terms: int = TERMS
    ) -> Objective:
        """A copy of :meth:`near`, with models of the way to `places` (p,).

        The way begins at x (p,). Only the parameters of the indices `only` will move.
        """
        own = self._acting(x, only)

        def further(predictor: Predictor, indices: Sequence[int]) -> Predictor:
            assert predictor.local is not None  # one of `near`
            # Values relative to the point that the local basis was made at; places equal to x are left out.
            here, made_at = self._values(x, indices[0]), predictor.local.values
            there = [{name: made_at[name] + values[name] - here[name] for name in made_at}
                     for values in (self._values(each, indices[0]) for each in places) if values != here]
            observes = self.recordings[indices[0]].observable is not None
            return predictor.on_basis(predictor.local.neumann_enriched(
                there, min(tolerance, OF_STATES) if observes else tolerance, terms))

        return own._remade(further)

    def with_every(self, x: Real) -> Objective:
        """A copy at x (p,) alone, with derivatives by every parameter."""
        views = [view if (observable := view.recording.observable) is None else replace(
            view, recording=replace(view.recording, observable=observable.by_full_solves())) for view in self.views]
        return replace(self, views=tuple(views))._remade(lambda predictor, indices: predictor.with_every(
            [self.settings(x, index)[0] for index in indices]))

    def _values(self, x: Real, index: int) -> dict[str, complex]:
        """All problem values of a recording at x (p,)."""
        return {**self.recordings[index].problem.values, **self.settings(x, index)[0]}

    def _alike(self, x: Real, indices: Sequence[int]) -> list[list[int]]:
        """Recordings, by index, in groups of equal values at x (p,). Unused values are ignored."""
        groups: dict[frozenset[tuple[str, complex]], list[int]] = {}
        for index in indices:
            depending = self.predictors[index].operators.coefficients.parameters
            values = frozenset(item for item in self._values(x, index).items() if item[0] in depending)
            groups.setdefault(values, []).append(index)
        return list(groups.values())

    def _moves_about(self, x: Real, indices: Sequence[int], reach: Mapping[str, float]) -> dict[str, float]:
        """Distances of the values of recordings of one model, at x (p,). They are from the first recording."""
        values, _ = self.settings(x, indices[0])
        moves: dict[str, float] = {}
        for index in indices:
            there = self.settings(x, index)[0]
            # Offsets set recordings apart that share a model: it has to reach from the first to each.
            apart = {key: size for key in values if (size := abs(there.get(key, values[key]) - values[key])) > 0.0}
            own = self._reach(index, reach)
            for key in {**own, **apart}:
                moves[key] = max(moves.get(key, 0.0), own.get(key, 0.0) + apart.get(key, 0.0))
        return moves

    def _sharing(self) -> dict[Predictor, list[int]]:
        """The recordings of each predictor, by index."""
        indices: dict[Predictor, list[int]] = {}
        for index, predictor in enumerate(self.predictors):
            indices.setdefault(predictor, []).append(index)
        return indices

    def _remade(self, make: Callable[[Predictor, Sequence[int]], Predictor]) -> Objective:
        """A copy with predictors made from each and its recordings' indices."""
        made = {predictor: make(predictor, indices) for predictor, indices in self._sharing().items()}
        return self.predicted_by([made[predictor] for predictor in self.predictors])

    def _reach(self, index: int, reach: Mapping[str, float]) -> dict[str, float]:
        """The moves of one recording's values for parameter moves `reach`.

        An offset adds to the others. Only values that parameters in `reach` move are included.
        """
        problem = self.recordings[index].problem
        parts: dict[tuple[str, bool], float] = {}
        for _, p, key in self.views[index].moved:
            if p.name in reach:
                size = reach[p.name] * (abs(problem.values[key]) if p.relative else 1.0)
                before = parts.get((key, p.is_loss), 0.0)
                parts[key, p.is_loss] = before + size if p.offset else max(before, size)
        for column, key, power in self.views[index].scaled:
            size = abs(power * problem.values[key]) * reach.get(self.parameters[column].name, 0.0)
            if size:
                parts[key, False] = max(parts.get((key, False), 0.0), size)
        return {key: max(parts.get((key, False), 0.0), parts.get((key, True), 0.0)) for key, _ in parts}

    def among(self, names: Collection[str]) -> Objective:
        """A copy of the recordings of these names only."""
        return replace(self, views=tuple(view for view in self.views if view.recording.name in names))

    def joined(self, other: Objective) -> Objective:
        """A copy with the recordings of another objective after its own. Both have the same parameters."""
        return replace(self, views=self.views + other.views)

    def truncated(self, points: Sequence[Real], error: float | None = None) -> Objective:
        """A copy with bases truncated for `points` (p,), and its own count.

        The truncation adds a relative `error` of Z; see `Predictor.truncated`.
        """
        def few(predictor: Predictor, indices: Sequence[int]) -> Predictor:
            settings: list[dict[str, complex]] = []
            for each in (self.settings(point, index)[0] for point in points for index in indices):
                settings += [each] if each not in settings else []
            return predictor.truncated(settings, error)

        return self._remade(few)

    def thinned(self, points: int) -> Objective:
        """A copy of about `points` points of each recording. It has a count of its own."""
        views, known = [], dict[tuple[Predictor, bytes], Predictor]()
        for view in self.views:
            recording = view.recording.thinned(points)
            # Recordings go on sharing their predictors.
            key = view.predictor, recording.measured.frequency.tobytes()
            if key not in known:
                known[key] = view.predictor.at(recording.measured.frequency)
            views.append(replace(view, recording=recording, predictor=known[key]))
        return replace(self, views=tuple(views))

    def settings(self, x: Real, index: int) -> tuple[dict[str, complex], dict[str, float]]:
        """Complex values and bench elements of a recording at x (p,)."""
        view = self.views[index]
        problem = view.recording.problem
        result = {name: complex(problem.values[name]) for name in view.keys}
        for column, p, key in view.moved:
            number = float(x[column]) * (real_part(problem.values, p.name) if p.relative else 1.0)
            where = key + LOSS if p.is_loss else key
            result = placed(result, {where: number + (real_part(result, where) if p.offset else 0.0)})
        bench: dict[str, float] = {}
        for column, p in view.bench:
            # An ideal element is zero, so the shared number and the offset of one recording add up.
            bench[p.parsed.key] = bench.get(p.parsed.key, 0.0) + float(x[column])
        return {key: value * self._scale(x, index, key) for key, value in result.items()}, bench

    def _scale(self, x: Real, index: int, key: str) -> float:
        """The factor on a value of a problem by all scaling parameters."""
        powers = [(1.0 + x[column]) ** power for column, own, power in self.views[index].scaled if own == key]
        return float(np.prod(powers))

    def predict(
        self, x: Real, index: int, free: Collection[int] | None = None, known: Prediction | None = None
    ) -> tuple[Complex, Complex, Prediction]:
        """Impedance (n,) behind the bench, its logarithmic derivatives, and the prediction.

        d ln Z / dx (n, p) by parameters outside the indices `free`, if given, stays zero. A prediction `known` of the
        same system is used again.
        """
        view = self.views[index]
        problem, predictor = view.recording.problem, view.predictor
        if known is not None:
            predictor = predictor.holding(known.model)
        moved = [each for each in view.moved if free is None or each[0] in free]
        scaled = [each for each in view.scaled if free is None or each[0] in free]
        keys = _keys(moved, scaled)
        values, bench = self.settings(x, index)
        observable, elements = view.recording.observable, dict[str, Complex]()
        if observable is None:
            prediction = predictor({**problem.values, **values}, bench.get(CLOCK, 0.0), known)
            omega = prediction.solution.omega
            seen, device, elements = through_bench(
                prediction.impedance, omega, bench, lambda: prediction.frequency_slope)
            slopes = np.conj(prediction.logarithmic_gradient(keys))
        else:
            prediction = predictor({**problem.values, **values}, 0.0, known)
            value, by_value = observable(prediction, keys)
            seen, device, slopes = np.array([value + 0j]), np.ones(1, dtype=complex), np.conj(by_value)[None]
        gradient = np.zeros((seen.size, len(self.parameters)), dtype=complex)
        for column, p in view.bench:
            if elements and (free is None or column in free):
                gradient[:, column] = elements[p.parsed.key]
        for column, p, key in moved:
            slope = slopes[:, keys.index(key)] * self._scale(x, index, key)
            # The imaginary part moves theta along i, and the spectrum is the conjugate of the solution.
            factor = real_part(problem.values, p.name) if p.relative else 1.0
            gradient[:, column] = device * factor * (-1j * slope if p.is_loss else slope)
        for column, key, power in scaled:
            by_number = power * np.conj(values[key]) / (1.0 + float(x[column]))
            gradient[:, column] += device * slopes[:, keys.index(key)] * by_number
        return seen, gradient if observable is None else gradient.real.astype(complex), prediction

    def __call__(
        self, x: Real, *, deviation: Sequence[Real | float], smoothing: float = 0.0,
        free: Collection[int] | None = None,
    ) -> Residual:
        """The residuals at x (p,), SI, smoothed by a Lorentzian.

        `smoothing` is its half width (Hz), 0 for none; `free` as in :meth:`predict`.

        Raises:
            NotEnriched, MeshError, InputError: nothing can be predicted at x.
        """
        parts, rows, logs, seen, predictions = [], [], [], [], list[Prediction]()
        known: dict[Predictor, Prediction] = {}
        for index, (recording, predictor) in enumerate(zip(self.recordings, self.predictors, strict=True)):
            impedance, gradient, prediction = self.predict(x, index, free, known.get(predictor))
            known[predictor] = prediction
            measured = recording.measured.impedance
            predictions.append(prediction)
            logs.append(log_ratio(impedance, measured))
            seen.append(impedance)
            if smoothing > 0.0 and recording.observable is None:
                weights = lorentzian(recording.measured.frequency, smoothing)
                admittance = weights @ (1.0 / impedance)
                gradient = (weights @ (gradient / impedance[:, None])) / admittance[:, None]
                impedance, measured = 1.0 / admittance, 1.0 / (weights @ (1.0 / measured))
            ratio = log_ratio(impedance, measured) / deviation[index]
            scaled = gradient / (deviation[index] if np.isscalar(deviation[index])
                                 else np.asarray(deviation[index])[:, None])
            parts += [ratio.real, ratio.imag]
            rows += [scaled.real, scaled.imag]
        return Residual(np.concatenate(parts), np.concatenate(rows), tuple(logs), tuple(seen), tuple(predictions))


def _shared(
    recordings: Sequence[FitRecording], moved: Sequence[tuple[str, ...]], tolerance: float
) -> tuple[Predictor, ...]:
    """One predictor for every problem, with tangents by all parameters `moved`.

    Values that only one recording moves do not separate them: predictors get all values with every call.
    """
    alike = [(id(r.problem.mesh), r.problem.terms, r.measured.frequency.tobytes()) for r in recordings]
    predictors: dict[Any, Predictor] = {}
    assembled: dict[Any, FullOperators] = {}
    for r, key in zip(recordings, alike, strict=True):
        if key not in predictors:
            tangents = dict.fromkeys(name for names, other in zip(moved, alike, strict=True) if other == key
                                     for name in names if name in r.problem.values)
            if key[:2] not in assembled:
                assembled[key[:2]] = assemble(r.problem.mesh, r.problem.terms)
            predictors[key] = Predictor(r.problem, r.measured.frequency, tolerance=tolerance, tangents=tuple(tangents),
                                        every=assembled[key[:2]])
    return tuple(predictors[key] for key in alike)


def _with_lengths(recording: FitRecording, parameters: Sequence[Parameter], known: dict[Any, Problem]) -> FitRecording:
    """The recording with moved lengths of its chip among its problem's values.

    Problems of one mesh and one model go on sharing these; `known` holds those made so far.
    """
    chip, problem = recording.chip, recording.problem
    lacking = [p for p in parameters if p.is_dimension and not set(p.names) & set(problem.values)]
    if chip is None or not lacking:
        return recording
    ranges = ranges_of_dimensions(lacking, chip.dimensions())
    if not any(each.is_thickness or each.is_radius or each.is_shape for each in map(ParameterName.parse, ranges)):
        return recording
    key = id(problem.mesh), problem.terms, tuple(ranges.items())
    if key not in known:
        known[key] = parametrised_within(problem, chip, ranges)
    return replace(recording, problem=problem.following(known[key]))


def _acting_on(recording: FitRecording, parameters: Sequence[Parameter]) -> tuple[_Moved, _Scaled, _Bench]:
    """The parameters that act on a recording, as a :class:`RecordingView` has them."""
    own = [(column, p) for column, p in enumerate(parameters) if p.acts_in(recording.owner)]
    moved = sorted(((column, p, key) for column, p in own if (key := _moves(p, recording)) is not None),
                   key=lambda each: each[1].offset)
    scaled = [(column, key, power) for column, p in own for key, power in p.powers if key in recording.problem.values]
    return tuple(moved), tuple(scaled), tuple((column, p) for column, p in own if p.is_bench)


def _keys(moved: Iterable[tuple[int, Parameter, str]], scaled: Iterable[tuple[int, str, float]]) -> tuple[str, ...]:
    """The values that are moved or scaled, each once."""
    return tuple(dict.fromkeys([*(key for _, _, key in moved), *(key for _, key, _ in scaled)]))


def _moves(parameter: Parameter, recording: FitRecording) -> str | None:
    """The value of a recording's problem that a parameter moves, or None."""
    values = recording.problem.values
    if parameter.is_bench:
        return None
    if not parameter.is_dimension:
        return parameter.parsed.key if parameter.parsed.key in values else None
    known = {} if recording.chip is None else canonical_names(recording.chip)
    return next((key for name in parameter.names for key in (name, known.get(name, name)) if key in values), None)
