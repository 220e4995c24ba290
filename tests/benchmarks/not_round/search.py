"""The place and the mass of a part beside the axis, from recordings of a device that is not round.

The change of ln Z is the closed form of `patch_orders`. A fit of the known parameters is made with each of a grid of
distances and masses, whose change is taken at the stated constants and again at those of the fit: a heavy part moves
all resonances, so that neither the stated constants nor those fitted without a part are near the right ones. From the
best of these, known parameters and part are fitted together. Errors have heavy tails throughout, so that the bands that
a wrong part misses do not decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from not_round.patch_orders import PatchConstants, PatchOrders, PatchResponse
from numpy.typing import NDArray

from geometry.names import TRANSDUCER
from workbench.campaign.state import DeviceState
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.tasks import EXPECTED
from workbench.fem.patch import Patch
from workbench.fitting.measurement_model import log_ratio, through_bench
from workbench.fitting.search import FitSearch
from workbench.model.problem import build
from workbench.search.constrained import minimise

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Diameter (m) of the patch of a part, that of a solder joint or a drop of glue, and the standard deviation of its
#: logarithm.
DIAMETER, SPREAD = 1e-3, 0.3

#: Standard deviation of the relative shift of the frequencies of other orders: lengths move them as well.
SHIFT = 2e-3

#: The least mass (kg) of the grid, masses for each decade, and the largest share of the transducer's mass.
LIGHTEST, PER_DECADE, HEAVIEST = 2e-7, 3, 0.05

#: Distances of the grid, fits of the grid that are repeated, and of those that the part is fitted from.
DISTANCES, AGAIN, FITTED = 16, 24, 8

#: Patches about a place, the nearest ones of a parabola among them.
ABOUT = 5

#: Rounds of a fit with updated weights, the steps of each, and the fall of its cost that ends it.
ROUNDS, STEPS, SETTLED = 12, 4, 0.5

#: Median of |r| of complex normal residuals with standard deviation one of each part.
MEDIAN = math.sqrt(2.0 * math.log(2.0))

NULL = Hypothesis()


@dataclass(frozen=True)
class Place:
    """A part: its ``distance`` from the axis (m), ``mass`` (kg), ``shift`` of the other orders, and ``diameter`` (m).

    ``cost`` is minus the log likelihood of errors with heavy tails, ``before`` that of a fit without a part;
    ``reduced`` is the reduced chi-square of the fitted recordings.
    """

    distance: float
    mass: float
    shift: float
    diameter: float
    cost: float
    before: float
    reduced: float


def located(models: LocalModels) -> Place:
    """The likeliest part on the upper face of the bare transducer of a campaign."""
    model = models.model
    reach = np.array([parameter.prior or 0.0 for parameter in model.parameters])
    likelihood = models.near(NULL, model.stated, reach)
    states = likelihood.states
    radius = float(states[0].chip.transducer.radius.value)
    distances = np.linspace(DIAMETER, radius - 0.6 * DIAMETER, DISTANCES)
    layer, material = states[0].chip.transducer, states[0].materials[TRANSDUCER]
    heaviest = HEAVIEST * float(np.real(material.density)) * math.pi * radius**2 * layer.thickness.value
    masses = np.geomspace(LIGHTEST, heaviest, 1 + math.ceil(PER_DECADE * math.log10(heaviest / LIGHTEST)))
    x, before = robust(likelihood, model.stated)
    orders = _orders(model, states, model.stated, distances)
    response = [each.at(model, model.stated).constants.response() for each in orders]
    fits = []
    for mass in masses:
        changes = [log_factors(each, np.array([math.log(mass), 0.0, 0.0])) for each in response]
        for k in range(DISTANCES):
            fits.append((*robust(_with(likelihood, [change[:, k] for change in changes]), model.stated), k, mass))
    fits = sorted(fits, key=lambda each: each[1])[:AGAIN]
    again = []
    for x, _, k, mass in fits:
        z = np.array([math.log(mass), 0.0, 0.0])
        changes = [log_factors(each.at(model, x).constants.response(), z)[:, k] for each in orders]
        again.append((*robust(_with(likelihood, changes), x), k, mass))
    ends = []
    for x, _, k, mass in sorted(again, key=lambda each: each[1])[:FITTED]:
        spacing = distances[1] - distances[0]
        near = np.clip(distances[k] + spacing * np.linspace(-1.0, 1.0, ABOUT), 0.5 * DIAMETER, radius - 0.51 * DIAMETER)
        joint = Joint(model, likelihood, _orders(model, states, x, near), math.log(heaviest))
        x, z, cost = joint.optimum(x, np.array([math.log(mass), 0.0, 0.0, ABOUT // 2]))
        reduced = float(np.mean([np.mean(np.abs(each / state.noise) ** 2) / 2.0
                                 for each, state in zip(joint.residuals(x, z), states, strict=True)]))
        ends.append(Place(float(np.interp(z[3], np.arange(ABOUT), near)), math.exp(float(z[0])), SHIFT * float(z[1]),
                          DIAMETER * math.exp(SPREAD * float(z[2])), cost, before, reduced))
    return min(ends, key=lambda each: each.cost)


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


def _with(likelihood: Likelihood, changes: Sequence[Complex]) -> Likelihood:
    """The likelihood of models with a change (n,) of ln Z of each recording."""
    objective = likelihood.objective
    views = [replace(view, recording=replace(view.recording, measured=replace(
        view.recording.measured, impedance=view.recording.measured.impedance * np.exp(-change))))
        for view, change in zip(objective.views, changes, strict=True)]
    return likelihood.with_objective(replace(objective, views=tuple(views)))


def _spreads(states: Sequence[DeviceState], residuals: Sequence[Complex]) -> list[float]:
    """The typical deviation of each recording's points: of half of them, and no less than the noise."""
    return [max(float(np.median(np.abs(each))) / MEDIAN, float(np.median(state.noise)))
            for each, state in zip(residuals, states, strict=True)]


def _deviations(residual: Complex, spread: float) -> Real:
    """The deviations (n,) whose least squares are those of Cauchy errors about a `residual`."""
    return spread * np.sqrt(1.0 + np.abs(residual / spread) ** 2)


def _heavy_tailed(residuals: Sequence[Complex], spreads: Sequence[float]) -> float:
    """Minus the log likelihood of Cauchy errors, up to a constant."""
    return sum(float(np.log1p(np.abs(each / spread) ** 2).sum()) + 2.0 * each.size * math.log(spread)
               for each, spread in zip(residuals, spreads, strict=True))


# --------------------------------------------------------------------------------------------------------------------
# The device with a part


@dataclass(frozen=True, eq=False)
class _StateOrders:
    """The orders of a state, whose ``index`` is that among all recordings."""

    state: DeviceState
    index: int
    orders: PatchOrders

    def at(self, model: Model, x: Real) -> _StateAt:
        """The orders at parameters x (p,) of a model."""
        settings, bench = model.whole.settings(x, self.index)
        values = {**model.whole.recordings[self.index].problem.values, **settings}
        return _StateAt(self.state, self.orders.at(values), bench)


@dataclass(frozen=True, eq=False)
class _StateAt:
    """The orders of a state at some values of its constants, and the elements of its bench."""

    state: DeviceState
    constants: PatchConstants
    bench: Mapping[str, float]

    def change(self, z: Real) -> Complex:
        """The change of ln Z (n,), as the bench measures it, by a part z (4,) (see :class:`Joint`)."""
        response = self.constants.response(SHIFT * float(z[1]), float(z[3]))
        impedance, omega = np.conj(self.constants.driven.impedance), self.constants.driven.omega
        before, after = (through_bench(each, omega, self.bench)[0]
                         for each in (impedance, impedance * np.exp(log_factors(response, z)[:, 0])))
        return log_ratio(after, before)


def log_factors(response: PatchResponse, z: Real) -> Complex:
    """ln of the factor on the impedance (n, k), e^{+j w t}, by a part on each patch of a response."""
    inertia = -(2.0 * np.pi * response.frequencies) ** 2 * math.exp(float(z[0])) + 0j
    return np.conj(response.log_change(inertia, math.exp(SPREAD * float(z[2]))))


def _orders(model: Model, states: Sequence[DeviceState], x: Real, distances: Real) -> list[_StateOrders]:
    """The orders of every fitted state, projected at x (p,)."""
    index = {recording.name: k for k, recording in enumerate(model.whole.recordings)}
    found = []
    for state in states:
        k, frequency = index[state.name], state.measured.frequency
        values = {**model.whole.recordings[k].problem.values, **model.whole.settings(x, k)[0]}
        lengths = {name: float(np.real(values[name])) for name in state.chip.dimensions() if name in values}
        device = replace(state.device, chip=state.chip.with_dimensions(lengths)) if lengths else state.device
        posed = build(device, accuracy=model.accuracy, band=(float(frequency[0]), float(frequency[-1])))
        posed = replace(posed, values={name: values.get(name, value) for name, value in posed.values.items()})
        patches = [Patch(TRANSDUCER, True, float(each), 0.5 * DIAMETER) for each in distances]
        found.append(_StateOrders(state, k, PatchOrders.of(posed, patches, frequency)))
    return found


# --------------------------------------------------------------------------------------------------------------------
# The fit of both


@dataclass(frozen=True, eq=False)
class _Point:
    """A residual with its derivative, for `minimise`."""

    vector: Real
    jacobian: Real


@dataclass(frozen=True, eq=False)
class Joint:
    """Known parameters and a part together.

    The part is z (4,): the log of the mass (kg), shift and log diameter in their standard deviations, and the place
    between the patches of the ``orders``, an index. ``heaviest`` is the largest log mass.
    """

    model: Model
    likelihood: Likelihood
    orders: Sequence[_StateOrders]
    heaviest: float

    def optimum(self, x: Real, z: Real) -> tuple[Real, Real, float]:
        """The optimum near x (p,) and z (4,), and its cost with errors of heavy tails."""
        search = self.likelihood.search(NULL)
        free, cost = search.free, math.inf
        low = np.concatenate([search.low[free], [math.log(0.1 * LIGHTEST), -4.0, -4.0, 0.0]])
        high = np.concatenate([search.high[free], [self.heaviest, 4.0, 4.0, ABOUT - 1.0]])
        scale = np.concatenate([search.scale[free], [0.3, 1.0, 1.0, 1.0]])
        conditions = [replace(each, slopes=np.concatenate([each.slopes, np.zeros((4, *each.slopes.shape[1:]))]))
                      for each in search.conditions(x, free)]

        for _ in range(ROUNDS):
            residuals = self.residuals(x, z)
            spreads = _spreads(self.likelihood.states, residuals)
            before, cost = cost, _heavy_tailed(residuals, spreads)
            if before - cost < SETTLED:
                break
            deviations, slopes = list(map(_deviations, residuals, spreads)), self._slopes(search, x, z)
            point = partial(self._point, search, x, deviations, slopes)
            end = minimise(point, np.concatenate([x[free], z]), low=low, high=high, scale=scale,
                           inequalities=conditions, tolerance=1e-3, limit=STEPS, refused=EXPECTED)
            x, z = _split(x, free, end.x)
        return x, z, cost

    def residuals(self, x: Real, z: Real) -> list[Complex]:
        """ln(Z_model / Z_measured) (n,) of every fitted recording with a part."""
        return [log + each.at(self.model, x).change(z)
                for log, each in zip(self.likelihood.data(NULL, x).log_ratio, self.orders, strict=True)]

    def _point(self, search: FitSearch, x: Real, deviations: Sequence[Real], slopes: Real, y: Real) -> _Point:
        """The residual at `y`, the free parameters among x (p,) and then a part, with its derivative.

        It is in some `deviations` of the points; `slopes` (m, p) are those of the change of the data by the known
        parameters.
        """
        free = search.free
        x, z = _split(x, free, y)
        data = self.likelihood.data(NULL, x)
        at = [each.at(self.model, x) for each in self.orders]
        by_part = np.stack([(_stacked(at, z + step) - _stacked(at, z - step)) / 2e-3 for step in 1e-3 * np.eye(4)],
                           axis=1)
        root = np.concatenate([np.tile(state.noise / each, 2)
                               for state, each in zip(self.likelihood.states, deviations, strict=True)])
        vector = np.concatenate([(data.vector + _stacked(at, z)) * root,
                                 search.prior_rows[free] @ (x - search.centre), z[1:3]])
        rows, count = root.size, free.size
        jacobian = np.zeros((vector.size, count + 4))
        jacobian[:rows, :count] = (data.jacobian + slopes)[:, free] * root[:, None]
        jacobian[:rows, count:] = by_part * root[:, None]
        jacobian[rows:rows + count, :count] = search.prior_rows[np.ix_(free, free)]
        jacobian[rows + count:, count + 1:count + 3] = np.eye(2)
        return _Point(vector, jacobian)

    def _slopes(self, search: FitSearch, x: Real, z: Real) -> Real:
        """Derivatives (m, p) of the change of the data by the constants. Lengths and the bench act on it little."""
        change = _stacked([each.at(self.model, x) for each in self.orders], z)
        columns = np.zeros((change.size, x.size))
        for i in search.free:
            parameter = self.model.parameters[i]
            if parameter.is_dimension or parameter.is_bench:
                continue
            moved = x.copy()
            moved[i] += 0.05 * parameter.scale
            columns[:, i] = (_stacked([each.at(self.model, moved) for each in self.orders], z) - change) / (
                0.05 * parameter.scale)
        return columns


def _split(x: Real, free: NDArray[np.int64], y: Real) -> tuple[Real, Real]:
    """Parameters (p,) with the `free` ones from y, and the part (4,) that follows them."""
    moved = x.copy()
    moved[free] = y[:-4]
    return moved, y[-4:]


def _stacked(states: Sequence[_StateAt], z: Real) -> Real:
    """The change of the data (m,) by a part z (4,), in units of the noise."""
    changes = [each.change(z) / each.state.noise for each in states]
    return np.concatenate([part for each in changes for part in (each.real, each.imag)])
