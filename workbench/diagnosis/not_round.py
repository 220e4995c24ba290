"""Causes that are not round, from recordings of a bare disc.

They are a part beside the axis and a taper of the thickness.

The change of ln Z is the closed form of `patch_orders`, or that of the coupled orders of `simulation.taper`. It is
fitted together with the known parameters, from the optimum without it: a part from each of a grid of distances and
masses, a taper from a few sizes. Both move the resonances of all orders and a fit without them imitates this, so that
the change has to follow the known parameters: modes follow them by their forms, and are made again where a search goes
on. Errors have heavy tails, so that the bands that a wrong part misses do not decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.checks import TAPER
from geometry.measure import Axisymmetric
from geometry.names import TRANSDUCER
from workbench.campaign.state import DeviceState, reduced_chi_square
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.patch_orders import PatchModes, PatchOrders, parabola
from workbench.diagnosis.tasks import EXPECTED
from workbench.fem.patch import Patch
from workbench.fitting.measurement_model import log_ratio, through_bench
from workbench.fitting.search import FitSearch
from workbench.jobs.progress import Progress, no_progress
from workbench.model.problem import Problem, build
from workbench.search.constrained import minimise
from workbench.simulation.taper import TaperedDisc

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Values = Mapping[str, complex]

#: Diameter (m) of the patch of a part, that of a solder joint or a drop of glue, and the standard deviation of its
#: logarithm.
DIAMETER, SPREAD = 1e-3, 0.3

#: Standard deviation of the relative shift of the frequencies of other orders: lengths move them as well.
SHIFT = 2e-3

#: The least mass (kg) of the grid, masses for each decade, and the largest share of the transducer's mass.
LIGHTEST, PER_DECADE, HEAVIEST = 2e-7, 3, 0.05

#: Distances of the grid; ends of least cost that are continued, by how many rounds, and whether modes are made again
#: there; and of those, ends with a projection of their own.
DISTANCES, CONTINUED, PROJECTED = 16, ((20, 2, False), (6, 8, True)), 2

#: Projections of such an end, each of a patch of the diameter that the last one found.
PROJECTIONS = 2

#: Patches about a place, the nearest ones of a parabola among them.
ABOUT = 5

#: Rounds of a fit with updated weights, the steps of each, and the fall of its cost that ends it.
ROUNDS, STEPS, SETTLED = 12, 4, 0.5

#: Median of |r| of complex normal residuals with standard deviation one of each part.
MEDIAN = math.sqrt(2.0 * math.log(2.0))

#: Steps of difference quotients: of known parameters in their scales, and of a part in its units.
STEP, PART_STEP = 0.02, 1e-3

#: Half of the taper over the thickness, from which a search begins: discs of 2 mm are parallel to 2 to 80 um.
SHARES = (0.0005, 0.002, 0.006, 0.02)

NULL = Hypothesis()


@dataclass(frozen=True)
class NotRoundFound:
    """A cause that is not round, from a search.

    ``gain`` is the fall of minus the log likelihood of errors with heavy tails, ``held_out`` that of the states held
    out; ``before`` and ``after`` are reduced chi-squares of the fitted recordings, and ``tried`` is the number of
    starts of the search. It is ``named`` if it is a verdict.
    """

    gain: float
    held_out: float
    before: float
    after: float
    tried: int
    named: bool = field(default=False, kw_only=True)

    @property
    def share(self) -> float:
        """The share of the chi-square beyond noise that it explains."""
        return (self.before - max(self.after, 1.0)) / (self.before - 1.0) if self.before > 1.0 else 0.0

    def is_accepted(self, criteria: Criteria, limit: float) -> bool:
        """Whether it is named. Within `limit`, a reduced chi-square is one of noise.

        It needs the odds of the criteria for one of the starts, in the states held out as well, and leaves noise, or
        the share of the residual that the criteria allow an effect.
        """
        return (self.gain > math.log(criteria.accepted * self.tried) and self.held_out >= 0.0
                and (self.after < limit or self.share > criteria.most))

    @property
    def cause(self) -> str:
        """The cause in words."""
        raise NotImplementedError

    @property
    def in_words(self) -> str:
        """The cause in a sentence."""
        return f"{self.cause}, explains {100.0 * self.share:.3g} % of the residual: the device is not round"

    @property
    def finding(self) -> str:
        """Its chi-square, or why it is not named."""
        before_and_after = f"the reduced chi-square from {self.before:.3g} to {self.after:.3g}"
        if self.named:
            return f"With {self.cause}, known parameters change {before_and_after}."
        held_out = "" if self.held_out >= 0.0 else ", and the states held out contradict it"
        return (f"The likeliest cause of its kind, {self.cause}, would change {before_and_after}, "
                f"{100.0 * self.share:.2g} % of the residual: too little to name it{held_out}.")


@dataclass(frozen=True)
class PartFound(NotRoundFound):
    """A part on the upper face of a bare transducer.

    ``distance`` from the axis, ``diameter`` of its patch (m), ``mass`` (kg), and ``shift``, relative, of the
    frequencies of other orders.
    """

    distance: float
    mass: float
    diameter: float
    shift: float

    @property
    def cause(self) -> str:
        return (f"a part of {1e6 * self.mass:.2g} mg on the transducer, {1e3 * self.distance:.2f} mm from its axis and "
                f"{1e3 * self.diameter:.2f} mm wide")


@dataclass(frozen=True)
class TaperFound(NotRoundFound):
    """A taper of a bare transducer.

    ``taper`` (m) is the difference of its thickness across its diameter.
    """

    taper: float

    @property
    def cause(self) -> str:
        return f"a taper of {1e6 * self.taper:.3g} um of the transducer across its diameter"


def diameter_of(z: Real) -> float:
    """The diameter (m) of a part z (4,) (see :class:`Joint`)."""
    return DIAMETER * math.exp(SPREAD * float(z[2]))


def can_be_located(model: Model) -> bool:
    """Whether the recordings are of one bare round disc."""
    states = model.campaign.fitted
    return all(set(state.materials) == {TRANSDUCER} and isinstance(state.chip.measure, Axisymmetric)
               and state.observation is None for state in (*states, *model.campaign.held_out))


@dataclass(frozen=True, eq=False)
class Without:
    """The fit of the known parameters alone, where the searches begin.

    The optimum x (p,) and its ``cost`` are those of errors with heavy tails.
    """

    models: LocalModels
    likelihood: Likelihood
    x: Real
    cost: float

    @classmethod
    def of(cls, models: LocalModels, x: Real) -> Without:
        """The fit from an optimum x (p,) of least squares."""
        reach = np.array([parameter.prior or 0.0 for parameter in models.model.parameters])
        likelihood = models.near(NULL, x, reach)
        return cls(models, likelihood, *robust(likelihood, x))

    @property
    def reduced(self) -> float:
        """The mean reduced chi-square."""
        return _reduced(self.likelihood.states, self.likelihood.data(NULL, self.x).log_ratio)


def located(start: Without, progress: Progress = no_progress) -> PartFound:
    """The likeliest part on the upper face of a bare transducer.

    Raises
    ------
    NotConverged, OrdersNotConverged : the orders of the device cannot be solved.
    """
    model, likelihood, null = start.models.model, start.likelihood, start.x
    states = likelihood.states
    radius = float(states[0].chip.transducer.radius.value)
    distances = np.linspace(DIAMETER, radius - 0.6 * DIAMETER, DISTANCES)
    layer, material = states[0].chip.transducer, states[0].materials[TRANSDUCER]
    heaviest = HEAVIEST * float(np.real(material.density)) * math.pi * radius**2 * layer.thickness.value
    masses = np.geomspace(LIGHTEST, heaviest, 1 + math.ceil(PER_DECADE * math.log10(heaviest / LIGHTEST)))
    joint = Joint.of(model, likelihood, null, distances, math.log(heaviest))
    ends = list[_End]()
    for k in range(DISTANCES):
        progress("a part beside the axis", k / (2.0 * DISTANCES))
        ends += [joint.optimum(null, np.array([math.log(mass), 0.0, 0.0, float(k)]), 1, moves=False) for mass in masses]
    tried, final = len(ends), list[tuple[_End, Real, float]]()
    for share, (count, rounds, moves) in zip((0.5, 0.7), CONTINUED, strict=True):
        progress("a part beside the axis", share)
        ends = [joint.optimum(end.x, end.z, rounds, moves=moves) for end in _leading(ends, count)]
        if start.cost - min(end.cost for end in ends) < math.log(tried):
            # No place among so many is evident, and the further ends would be of no use.
            final = [(min(ends, key=lambda each: each.cost), distances, 0.0)]
            break
    for end in () if final else _leading(ends, PROJECTED):
        progress("a part beside the axis", 0.9)
        own, near = _projected(model, likelihood, end, distances, radius, math.log(heaviest))
        final.append((own, near, _gain_held_out(start, own, near)))
    end, places, held_out = min(final, key=lambda each: each[0].cost)
    return PartFound(start.cost - end.cost, held_out, start.reduced, end.reduced, tried,
                     float(np.interp(end.z[3], np.arange(places.size), places)), math.exp(float(end.z[0])),
                     diameter_of(end.z), SHIFT * float(end.z[1]))


def tapered(start: Without, progress: Progress = no_progress) -> TaperFound:
    """The likeliest taper of a bare transducer.

    Raises
    ------
    NotConverged, TaperNotConverged : the orders of the device cannot be solved.
    """
    model, likelihood = start.models.model, start.likelihood
    thickness = float(likelihood.states[0].chip.transducer.thickness.value)
    fit = Joint.of_taper(model, likelihood, start.x)
    ends = list[_End]()
    for k, share in enumerate(SHARES):
        progress("a taper", 0.8 * k / len(SHARES))
        ends.append(fit.optimum(start.x, np.array([share]), 1))
    end = min(ends, key=lambda each: each.cost)
    progress("a taper", 0.8)
    end = Joint.of_taper(model, likelihood, end.x).optimum(end.x, end.z, ROUNDS)
    gain = _gain_in(start, end, lambda there: Joint.of_taper(model, there, end.x))
    return TaperFound(start.cost - end.cost, gain, start.reduced, end.reduced, len(ends),
                      2.0 * float(end.z[0]) * thickness)


def _projected(
    model: Model, likelihood: Likelihood, end: _End, distances: Real, radius: float, heaviest: float
) -> tuple[_End, Real]:
    """The optimum near an end, and the distances (m) of its patches.

    Orders are projected there, of patches of the diameter found.
    """
    spacing, places = distances[1] - distances[0], distances
    for _ in range(PROJECTIONS):
        distance, diameter = float(np.interp(end.z[3], np.arange(places.size), places)), diameter_of(end.z)
        places = np.clip(distance + spacing * np.linspace(-1.0, 1.0, ABOUT), 0.51 * diameter, radius - 0.51 * diameter)
        own = Joint.of(model, likelihood, end.x, places, heaviest, diameter)
        at = np.array([*end.z[:3], float(np.interp(distance, places, np.arange(ABOUT)))])
        end = own.optimum(end.x, at, ROUNDS)
    return end, places


def _gain_held_out(start: Without, end: _End, distances: Real) -> float:
    """The fall of the cost of states held out by a part."""
    return _gain_in(start, end, lambda there: Joint.of(start.models.model, there, end.x, distances, math.inf,
                                                       diameter_of(end.z)))


def _gain_in(start: Without, end: _End, fit: Callable[[Likelihood], Joint]) -> float:
    """The fall of the cost of the states held out.

    The parameters are those of the fits. It is 0 without such states.
    """
    if start.models.model.held_out is None:
        return 0.0
    reach = np.zeros(start.x.size)
    without, there = (start.models.near(NULL, x, reach, held_out=True) for x in (start.x, end.x))
    before = without.data(NULL, start.x).log_ratio
    after = [residual for residual, _ in fit(there).residuals(there.search(NULL), end.x, end.z)]
    return (_heavy_tailed(before, _spreads(there.states, before))
            - _heavy_tailed(after, _spreads(there.states, after)))


def _reduced(states: Sequence[DeviceState], residuals: Sequence[Complex]) -> float:
    """The mean reduced chi-square of residuals (n,) of some states."""
    return float(np.mean([reduced_chi_square(each, state.noise, state.data)
                          for each, state in zip(residuals, states, strict=True)]))


# --------------------------------------------------------------------------------------------------------------------
# Errors with heavy tails


def robust(likelihood: Likelihood, x: Real) -> tuple[Real, float]:
    """The optimum of the known parameters near x (p,), and its cost."""
    search, cost = likelihood.search(NULL), math.inf
    for _ in range(ROUNDS):
        residuals = likelihood.data(NULL, x).log_ratio
        spreads = _spreads(likelihood.states, residuals)
        before, cost = cost, _heavy_tailed(residuals, spreads)
        if before - cost < SETTLED:
            break
        x = search.minimise(x, list(map(_deviations, residuals, spreads)), limit=STEPS, tolerance=1e-3).x
    return x, cost


def _spreads(states: Sequence[DeviceState], residuals: Sequence[Complex]) -> list[float]:
    """The typical deviation of the points of each recording.

    Half of the points have less. It is no less than the noise.
    """
    return [max(float(np.median(np.abs(each))) / MEDIAN, float(np.median(state.noise)))
            for each, state in zip(residuals, states, strict=True)]


def _deviations(residual: Complex, spread: float) -> Real:
    """The deviations (n,) that make least squares those of Cauchy errors."""
    return spread * np.sqrt(1.0 + np.abs(residual / spread) ** 2)


def _heavy_tailed(residuals: Sequence[Complex], spreads: Sequence[float]) -> float:
    """Minus the log likelihood of Cauchy errors, up to a constant."""
    return sum(float(np.log1p(np.abs(each / spread) ** 2).sum()) + 2.0 * each.size * math.log(spread)
               for each, spread in zip(residuals, spreads, strict=True))


# --------------------------------------------------------------------------------------------------------------------
# The device with a part


@dataclass(frozen=True, eq=False)
class _State:
    """A state of the campaign, of the ``index`` among all recordings."""

    state: DeviceState
    index: int

    def values(self, model: Model, x: Real) -> dict[str, complex]:
        """Values of the state's problem at x (p,)."""
        return {**model.whole.recordings[self.index].problem.values, **model.whole.settings(x, self.index)[0]}

    def pairs(self, model: Model, x: Real, free: NDArray[np.int64]) -> tuple[list[tuple[Values, Values]], Real]:
        """Values below and above x (p,), and distances (k,).

        They are those of each parameter `free` (k,).
        """
        scale, pairs = np.array([STEP * model.parameters[i].scale for i in free]), list[tuple[Values, Values]]()
        for i, size in zip(free, scale, strict=True):
            below, above = x.copy(), x.copy()
            below[i], above[i] = x[i] - 0.5 * size, x[i] + 0.5 * size
            pairs.append((self.values(model, below), self.values(model, above)))
        return pairs, scale

    def near(self, model: Model, x: Real) -> _State:
        """A copy that is exact at x (p,)."""
        return self

    def change(self, model: Model, x: Real, z: Real, free: NDArray[np.int64]) -> tuple[Complex, Complex]:
        """The change of ln Z (n,), and derivatives (n, k + z).

        The convention is e^{+j w t}. The derivatives are those by the parameters `free` (k,) and by the cause (z,).
        """
        raise NotImplementedError


def _posed(model: Model, state: DeviceState, x: Real) -> tuple[int, Problem]:
    """The index of a state, and its problem at x (p,)."""
    frequency = state.measured.frequency
    k = next(k for k, recording in enumerate(model.whole.recordings) if recording.name == state.name)
    values = {**model.whole.recordings[k].problem.values, **model.whole.settings(x, k)[0]}
    lengths = {name: float(np.real(values[name])) for name in state.chip.dimensions() if name in values}
    device = replace(state.device, chip=state.chip.with_dimensions(lengths)) if lengths else state.device
    posed = build(device, accuracy=model.accuracy, band=(float(frequency[0]), float(frequency[-1])))
    return k, replace(posed, values={name: values.get(name, value) for name, value in posed.values.items()})


@dataclass(frozen=True, eq=False)
class _StateTaper(_State):
    """The coupled orders of a state's disc with a taper. The cause (1,) is the share of the thickness at its edge."""

    disc: TaperedDisc

    @classmethod
    def of(cls, model: Model, state: DeviceState, x: Real) -> _StateTaper:
        """The orders of a state, projected at x (p,)."""
        index, posed = _posed(model, state, x)
        return cls(state, index, TaperedDisc.of(posed, state.measured.frequency, max(SHARES)))

    def change(self, model: Model, x: Real, z: Real, free: NDArray[np.int64]) -> tuple[Complex, Complex]:
        frequency, values = self.state.measured.frequency, self.values(model, x)
        plain, own = (disc.response(values, frequency, share) for disc, share in (
            (self.disc.plane, 0.0), (self.disc, float(z[0]))))
        pairs, scale = self.pairs(model, x, free)
        slopes = np.stack([*((plain.by_values(*pair) / plain.charge - own.by_values(*pair) / own.charge) / size
                             for pair, size in zip(pairs, scale, strict=True)), -own.by_share / own.charge], axis=1)
        return np.conj(-np.log(own.charge / plain.charge)), np.conj(slopes)


@dataclass(frozen=True, eq=False)
class _StateOrders(_State):
    """The orders of a state for patches of a ``diameter`` (m).

    Their ``modes`` are those at some values.
    """

    modes: PatchModes
    diameter: float

    @classmethod
    def of(cls, model: Model, state: DeviceState, x: Real, distances: Real, diameter: float) -> _StateOrders:
        """The orders of a state, projected at x (p,).

        The patches have that `diameter` (m).
        """
        index, posed = _posed(model, state, x)
        patches = [Patch(TRANSDUCER, True, float(each), 0.5 * diameter) for each in distances]
        orders = PatchOrders.of(posed, patches, state.measured.frequency)
        return cls(state, index, orders.at(posed.values), diameter)

    def near(self, model: Model, x: Real) -> _StateOrders:
        """The orders with their modes at x (p,)."""
        return replace(self, modes=self.modes.model.at(self.values(model, x)))

    def change(self, model: Model, x: Real, z: Real, free: NDArray[np.int64]) -> tuple[Complex, Complex]:
        pairs, scale = self.pairs(model, x, free)
        count = len(self.modes.model.patches)
        first = min(max(round(float(z[3])) - 1, 0), count - 3)
        inertia = np.asarray(-(2.0 * np.pi * self.state.measured.frequency) ** 2, dtype=np.complex128)

        here = self.modes.response(self.values(model, x), pairs, SHIFT * float(z[1]), slice(first, first + 3))

        def changed(z: Real) -> tuple[Complex, Complex]:
            return here.log_change(math.exp(float(z[0])) * inertia, diameter_of(z) / self.diameter,
                                   parabola(float(z[3]) - first - 1.0))

        change, forces = changed(z)
        slopes = here.slopes(forces, parabola(float(z[3]) - first - 1.0))
        mass, diameter, place = ((changed(z + step)[0] - changed(z - step)[0]) / (2.0 * PART_STEP)
                                 for step in PART_STEP * np.eye(4)[[0, 2, 3]])
        by_part = np.stack([mass, SHIFT * slopes[:, -1], diameter, place], axis=1)
        return np.conj(change), np.conj(np.concatenate([slopes[:, :-1] / scale, by_part], axis=1))


# --------------------------------------------------------------------------------------------------------------------
# The fit of both


@dataclass(frozen=True, eq=False)
class _Point:
    """A residual with its derivative, for `minimise`."""

    vector: Real
    jacobian: Real


@dataclass(frozen=True, eq=False)
class _End:
    """The end of a fit: parameters x (p,) and cause z."""

    x: Real
    z: Real
    cost: float
    reduced: float


def _leading(ends: Sequence[_End], count: int) -> list[_End]:
    """The `count` ends of least cost, each of another place or mass."""
    chosen = list[_End]()
    for end in sorted(ends, key=lambda each: each.cost):
        if all(abs(end.z[3] - each.z[3]) > 0.25 or abs(end.z[0] - each.z[0]) > 0.1 for each in chosen):
            chosen.append(end)
    return chosen[:count]


@dataclass(frozen=True)
class _Range:
    """The ends and the ``scale`` of a cause z.

    ``normal`` are the places of those with a standard normal prior.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    scale: tuple[float, ...]
    normal: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Joint:
    """Known parameters and a cause that is not round together.

    A part is z (4,): the log of the mass (kg), shift and log diameter in their standard deviations, and the place
    between the patches of the ``orders``, an index. A taper is z (1,). Its values are in the ``range``.
    """

    model: Model
    likelihood: Likelihood
    orders: Sequence[_State]
    range: _Range

    @classmethod
    def of(cls, model: Model, likelihood: Likelihood, x: Real, distances: Real, heaviest: float,
           diameter: float = DIAMETER) -> Joint:
        """The fit of patches at `distances` (k,), projected at x (p,).

        Distances from the axis and `diameter` are in m, `heaviest` is the largest log mass.
        """
        orders = [_StateOrders.of(model, state, x, distances, diameter) for state in likelihood.states]
        return cls(model, likelihood, orders, _Range(
            (math.log(0.1 * LIGHTEST), -4.0, -4.0, 0.0), (heaviest, 4.0, 4.0, distances.size - 1.0),
            (0.3, 1.0, 1.0, 1.0), (1, 2)))

    @classmethod
    def of_taper(cls, model: Model, likelihood: Likelihood, x: Real) -> Joint:
        """The fit of a taper, projected at x (p,)."""
        orders = [_StateTaper.of(model, state, x) for state in likelihood.states]
        return cls(model, likelihood, orders, _Range((0.0,), (0.5 * TAPER,), (min(SHARES),)))

    def optimum(self, x: Real, z: Real, rounds: int, *, moves: bool = True) -> _End:
        """The optimum near x (p,) and z.

        Errors have heavy tails. In each round the modes are made again where it is, if it `moves` them.
        """
        search = self.likelihood.search(NULL)
        free, cost, known = search.free, math.inf, self
        low, high, scale = (np.concatenate([own[free], each]) for own, each in (
            (search.low, self.range.low), (search.high, self.range.high), (search.scale, self.range.scale)))
        conditions = [replace(each, slopes=np.concatenate([each.slopes, np.zeros((z.size, *each.slopes.shape[1:]))]))
                      for each in search.conditions(x, free)]
        for _ in range(rounds):
            if moves:
                known = replace(self, orders=[each.near(self.model, x) for each in self.orders])
            residuals = [residual for residual, _ in known.residuals(search, x, z)]
            spreads = _spreads(self.likelihood.states, residuals)
            before, cost = cost, _heavy_tailed(residuals, spreads)
            if before - cost < SETTLED:
                break
            point = partial(known._point, search, x, list(map(_deviations, residuals, spreads)))
            end = minimise(point, np.concatenate([x[free], z]), low=low, high=high, scale=scale,
                           inequalities=conditions, tolerance=1e-3, limit=STEPS, refused=EXPECTED)
            x, z = _split(x, free, end.x)
        residuals = [residual for residual, _ in known.residuals(search, x, z)]
        cost = _heavy_tailed(residuals, _spreads(self.likelihood.states, residuals))
        return _End(x, z, cost, _reduced(self.likelihood.states, residuals))

    def residuals(self, search: FitSearch, x: Real, z: Real) -> list[tuple[Complex, Complex]]:
        """The residual (n,) of every recording, and derivatives (n, k + z).

        It is ln(Z_model / Z_measured). Derivatives are those by the free parameters (k,) and by the cause (z,).
        """
        data, found, free = self.likelihood.data(NULL, x), [], search.free
        for k, (each, rows) in enumerate(zip(self.orders, self.likelihood.places, strict=True)):
            real, imaginary = np.split(data.jacobian[rows][:, free], 2)
            by_known = (real + 1j * imaginary) * each.state.noise[:, None]
            prediction, bench = data.predictions[k], self.model.whole.settings(x, each.index)[1]
            omega = prediction.solution.omega
            acting = [place for place, i in enumerate(free) if not (
                self.model.parameters[i].is_bench or self.model.parameters[i].is_dimension)]
            change, slopes = each.change(self.model, x, z, free[acting])
            seen, device, elements = through_bench(prediction.impedance * np.exp(change), omega, bench,
                                                   partial(getattr, prediction, "frequency_slope"))
            before = through_bench(prediction.impedance, omega, bench)[1]
            columns = np.zeros((seen.size, free.size + z.size), dtype=complex)
            columns[:, :free.size] = by_known * (device / before)[:, None]
            columns[:, acting] += device[:, None] * slopes[:, :len(acting)]
            columns[:, free.size:] = device[:, None] * slopes[:, len(acting):]
            for place, i in enumerate(free):
                key = self.model.parameters[i].parsed.key
                if self.model.parameters[i].is_bench and by_known[:, place].any() and key in elements:
                    columns[:, place] = elements[key]
            found.append((log_ratio(seen, each.state.measured.impedance), columns))
        return found

    def _point(self, search: FitSearch, x: Real, deviations: Sequence[Real], y: Real) -> _Point:
        """The residual at `y`, with its derivative.

        The free parameters among x (p,) come first in `y`, the cause last. The residual is in some `deviations` of the
        points.
        """
        free = search.free
        x, z = _split(x, free, y)
        vector, rows = [], []
        for (residual, slopes), deviation in zip(self.residuals(search, x, z), deviations, strict=True):
            scaled, slopes = residual / deviation, slopes / deviation[:, None]
            vector += [scaled.real, scaled.imag]
            rows += [slopes.real, slopes.imag]
        count, normal = free.size, np.array(self.range.normal, dtype=int)
        prior = np.zeros((count + normal.size, count + z.size))
        prior[:count, :count] = search.prior_rows[np.ix_(free, free)]
        prior[count + np.arange(normal.size), count + normal] = 1.0
        return _Point(np.concatenate([*vector, search.prior_rows[free] @ (x - search.centre), z[normal]]),
                      np.vstack([*rows, prior]))


def _split(x: Real, free: NDArray[np.int64], y: Real) -> tuple[Real, Real]:
    """Parameters (p,) with the `free` ones from y, and the cause (z,)."""
    moved = x.copy()
    moved[free] = y[:free.size]
    return moved, y[free.size:]
