"""How detectable an effect is: what is left of it in standard deviations where everything else imitates it best.

All that a bench does not know imitates: the known parameters within their priors, what every state has of its own, and
the inhomogeneity of the parts, whose share of the covariance is Sigma = W + J J^T with J the tangents of its cosines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from concealed.device import PZT, State, Values
from concealed.mechanisms import Effect
from concealed.response import Device
from concealed.solver import NotAccurate
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Own = Mapping[str, Mapping[str, float]]

#: An imitation takes at most so many steps, until one changes less than this share of what is left.
IMITATED, SETTLED = 10, 5e-3

#: Below so many standard deviations an effect is not detectable, above so many it is, and nobody asks further.
LOW, CLEAR = 2.0, 30.0

#: A step of less than so many uncertainties leaves the tangents as they are.
NEAR = 1.0

#: Weight of the first step's length beside what it should take away, and how the next ones' falls, or grows after one
#: that did not help (Levenberg and Marquardt).
DAMPING, FREER, TIGHTER = 100.0, 0.1, 100.0

#: Order of the elements and tolerance of the reduced models where only differences count: as good as the fifth order by
#: 0.1 standard deviations, where the third sees three in a finer grid alone.
COARSE, LOOSE = 4, 1e-3


def detectability(
    change: Callable[[Real], Real], tangents: Callable[[Real], Real], parameters: int, covariance: Real
) -> float:
    """Length (standard deviations) of what is left of a change of ln Z when `parameters` p with unit priors imitate it
    as well as they can: `change` (m,) is what is left of it where these have moved by their argument (p,), `tangents`
    (m, p) their effects there, `covariance` (m, m) of the rest. Never more than what a linear device would leave.

    Damped steps; they end early where what is left will not come below `CLEAR` at the rate it falls, or is below `LOW`.
    """
    factor = np.linalg.cholesky(covariance)

    def lengths(moves: Real) -> Real:
        return np.concatenate([solve_triangular(factor, change(moves), lower=True), moves])

    def slopes(moves: Real) -> Real:
        return np.concatenate([-solve_triangular(factor, tangents(moves), lower=True), np.eye(parameters)])

    moves, damping = np.zeros(parameters), DAMPING
    here, steep = lengths(moves), slopes(moves)
    linear = float(np.linalg.norm(here + steep @ np.linalg.lstsq(steep, -here)[0]))
    size = float(np.linalg.norm(here))
    for left in reversed(range(IMITATED)):
        if min(linear, size) < LOW:
            break
        damped = np.vstack([steep, math.sqrt(damping) * np.eye(parameters)])
        step = np.linalg.lstsq(damped, np.concatenate([-here, np.zeros(parameters)]))[0]
        try:
            there = lengths(moves + step)
            after = float(np.linalg.norm(there))
        except (NotAccurate, ValueError):
            # So far away there is no such device.
            after = math.inf
        if not after < size:
            if damping > DAMPING:
                break
            damping *= TIGHTER
            continue
        rate, size = after / size, after
        if rate > 1.0 - SETTLED or size * rate**left > CLEAR:
            break
        moves, here, damping = moves + step, there, damping * FREER
        if np.abs(step).max() > NEAR:
            steep = slopes(moves)
    return min(linear, size)


def hidden(plain: Values, effects: Sequence[Effect]) -> tuple[dict[str, float], dict[str, float]]:
    """True numbers and defects of a device with effects."""
    values, defects = dict(plain), dict[str, float]()
    for effect in effects:
        values |= effect.values
        for name, size in effect.defects.items():
            # Two effects may each bring in the same kind of loss.
            defects[name] = defects.get(name, 0.0) + size if name.endswith(".loss") else size
    return values, defects


@dataclass(frozen=True, eq=False)
class Unknown:
    """What a bench does not know of a device: a number shared by all ``states``, or one of a single state, with its
    standard uncertainty (SI)."""

    name: str
    size: float
    states: frozenset[str]


def unknowns(device: Device, states: Sequence[State]) -> tuple[Unknown, ...]:
    """All that is unknown of a device in these states."""
    everywhere = frozenset(state.name for state in states)
    shared = [Unknown(name, size, everywhere) for name, size in device.design.prior.items()]
    return (*shared, *(Unknown(name, size, frozenset({state.name})) for state in states
                       for name, size in device.design.between(state.filling).items()))


@dataclass(frozen=True, eq=False)
class Bystander:
    """A device with everything but an effect, in the states that are fitted; ``own`` by how much their numbers differ
    from those that they share."""

    device: Device
    values: Values
    defects: Values
    states: tuple[State, ...]
    own: Own

    def at(self, state: State, moves: Real) -> Values:
        """Numbers of a state where the unknowns have moved."""
        by = dict(self.own[state.name])
        for move, each in zip(moves.tolist(), unknowns(self.device, self.states), strict=True):
            if move and state.name in each.states:
                by[each.name] = by.get(each.name, 0.0) + move * each.size
        return self.device.design.moved(self.values, by)

    def rest(self, spectra: Mapping[str, Complex], moves: Real) -> Real:
        """(m,) what is left of ln Z of the spectra."""
        ratios = (spectra[s.name] / self.device.spectrum(self.at(s, moves), self.defects, s) for s in self.states)
        return np.concatenate([_parts(np.log(ratio)) for ratio in ratios])

    def tangents(self, moves: Real) -> Real:
        """(m, p) change of ln Z with the unknowns."""
        rows = []
        known = unknowns(self.device, self.states)
        for state in self.states:
            values = self.at(state, moves)
            point = self.device.point(values, self.defects, state)
            unit = {name: self.device.tangent(point, values, self.defects, state, name, size)
                    for name, size in {u.name: u.size for u in reversed(known)}.items()}
            size = {u.name: u.size for u in reversed(known)}
            none = np.zeros(point.frequency.size, dtype=complex)
            rows.append(np.array([_parts(unit[u.name] * (u.size / size[u.name]) if state.name in u.states else none)
                                  for u in known]).T)
        return np.concatenate(rows)

    def covariance(self) -> Real:
        """(m, m) of ln Z: noise and inhomogeneity."""
        fields = []
        for state in self.states:
            point = self.device.point(self.at(state, np.zeros(len(unknowns(self.device, self.states)))), self.defects,
                                      state)
            fields.append(self.device.uneven_tangents(point))
        keys = dict.fromkeys(key for each in fields for key in each)
        widths = {key: next(each[key].shape[1] for each in fields if key in each) for key in keys}
        n = self.device.design.frequency.size
        uneven = np.concatenate([np.concatenate([_parts(each[key]) if key in each else np.zeros((2 * n, widths[key]))
                                                 for key in keys], axis=1) for each in fields]
                                ) if keys else np.zeros((2 * n * len(self.states), 0))
        return uneven @ uneven.T + self.device.design.noise**2 * np.eye(len(uneven))

    def detectability(self, spectra: Mapping[str, Complex]) -> float:
        """Of the effect that these spectra have beside this device."""
        count = len(unknowns(self.device, self.states))
        return detectability(lambda moves: self.rest(spectra, moves), self.tangents, count, self.covariance())


def _parts(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def measured(
    device: Device, plain: Values, effects: tuple[Effect, ...], states: tuple[State, ...], own: Own
) -> tuple[tuple[Effect, ...], float]:
    """The effects with their detectability in the states that are fitted, each beside the others, and that of all."""
    if not effects:
        return (), 0.0
    fitted = tuple(state for state in states if not state.held_out)

    def bystander(others: tuple[Effect, ...]) -> Bystander:
        values, defects = hidden(plain, others)
        return Bystander(device, values, defects, fitted, own)

    whole = bystander(effects)
    nothing = np.zeros(len(unknowns(device, fitted)))
    spectra = {s.name: device.spectrum(whole.at(s, nothing), whole.defects, s) for s in fitted}
    total = bystander(()).detectability(spectra)
    if len(effects) == 1:
        total = min(total, imitated(device, effects[0]))
        return (replace(effects[0], detectability=total),), total
    each = [min(bystander(tuple(o for o in effects if o is not e)).detectability(spectra), imitated(device, e))
            for e in effects]
    return tuple(replace(e, detectability=d) for e, d in zip(effects, each, strict=True)), total


def imitated(device: Device, effect: Effect) -> float:
    """Price (standard deviations) of moving what is known to where the effect has it; infinite where it cannot be."""
    # Tangents do not reach far. What only moves a known parameter is that parameter, at the price of its prior.
    design = device.design
    to = {**effect.values, **{f"{PZT}.{name}": effect.parameters.get(f"{PZT}.{name}", math.nan)
                              for name in effect.defects}}
    if not set(to) <= set(design.prior):
        return math.inf
    return math.hypot(*((value - design.nominal[name]) / design.prior[name] for name, value in to.items()))
