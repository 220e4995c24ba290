"""Where a mismatch sits, whatever its physics: the evidence for a change somewhere in each region.

No hypothesis is asked for. Any pattern of changes within a region is allowed, each patch of it a little stiffer,
heavier or lossier, independently and by a normal distribution of one width. What the known parameters can imitate is
projected out, and the width is that of the largest likelihood of the residual with all patterns integrated over
(Gaussian processes: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.2 and 5.4). A
region that needs larger or more intricate patterns is worth less for it. The patches are the same in all states, so
that what acts in the filled states alone sits in the cavity.

A mode that the axisymmetric model does not have is a resonance of its own in the transducer's admittance: one in every
state, those of one body together, at any frequency and of any quality.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from geometry.names import TRANSDUCER, whole
from workbench.diagnosis.device import Model
from workbench.diagnosis.score import Score, Tangents
from workbench.fitting.predict import Prediction
from workbench.operators import FullOperators
from workbench.physics.term import OPERATORS, Integral
from workbench.solve import Solution

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Patches of a region: along its radius and along its height.
RADIAL, AXIAL = 8, 2

#: Qualities of the modes that are looked for, every half width, and what their kind is called.
QUALITIES = (60.0, 150.0, 400.0)
MODE = "mode"

#: Widths of the distribution of changes that are tried, relative.
WIDTHS = np.logspace(-5.0, 1.0, 61)

#: Directions below this share of the largest are rounding.
ROUNDING = 1e-14

#: What a patch may be, with the index of :func:`changes` and its axis: a loss acts along the imaginary one.
KINDS = {"stiffness": (0, 1.0 + 0j), "mass": (1, 1.0 + 0j), "loss": (0, -1j)}


class Place(NamedTuple):
    """A region, the kind that explains most there, and how much it explains in all, in standard deviations.

    Of a mode, which: its frequency and quality in every state in which there is evidence for one.
    """

    region: str
    kind: str
    sigmas: float
    modes: tuple[str, ...] = ()


def located(
    model: Model, x: Real, deviation: Sequence[Real | float], tangents: Tangents, scores: Sequence[Score]
) -> tuple[Place, ...]:
    """The regions, best first.

    At x (p,), on bases about it; `scores` are asked of regions without cells (the bench). The square of the standard
    deviations is twice the logarithm of the evidence.
    """
    columns: dict[tuple[str, str, int], Real] = {}
    states = _predicted(model, x, deviation)
    for state in states:
        for key, slope in _patterns(state.seen):
            column = columns.setdefault(key, np.zeros(tangents.left.size))
            column[state.rows] += state.weighted(slope)
    keys, projected = list(columns), tangents.projected(np.stack(list(columns.values()), axis=1))

    def sigmas(place: str, *kinds: str) -> float:
        chosen = [k for k, (region, kind, _) in enumerate(keys) if region == place and kind in kinds]
        return float(np.sqrt(evidence(projected[:, chosen], tangents.left)))

    found = {region: Place(region, max(KINDS, key=lambda kind: sigmas(region, kind)), sigmas(region, *KINDS))
             for region in dict.fromkeys(region for region, _, _ in keys)}
    found[TRANSDUCER] = max(found[TRANSDUCER], _modes(states, tangents), key=lambda place: place.sigmas)
    for region in dict.fromkeys(s.effect.region for s in scores if s.effect.region not in found):
        own = [s for s in scores if s.effect.region == region]
        unit = [column / max(np.linalg.norm(column), 1e-300) for s in own for column in s.tangent.T]
        found[region] = Place(region, max(own, key=lambda s: s.gain).effect.kind,
                              float(np.sqrt(evidence(tangents.projected(np.stack(unit, axis=1)), tangents.left))))
    return tuple(sorted(found.values(), key=lambda place: -place.sigmas))


@dataclass(frozen=True, eq=False)
class _State:
    """A state as predicted, its name, its rows among the data, its frequency (n,) and its standard deviations."""

    name: str
    seen: Seen
    rows: slice
    frequency: Real
    spread: Real | float

    def weighted(self, slope: Complex) -> Real:
        """(2 n, ...) change of the data, in standard deviations, by what changes ln Z by `slope` (n, ...)."""
        spread = np.reshape(self.spread, (-1, *[1] * (slope.ndim - 1)))
        return np.concatenate([(slope / spread).real, (slope / spread).imag])


def _predicted(model: Model, x: Real, deviation: Sequence[Real | float]) -> list[_State]:
    found, start = [], 0
    for seen, recording, spread in zip(cell_changes(model, x), model.fitted.recordings, deviation, strict=True):
        frequency = recording.measured.frequency
        found.append(_State(recording.name, seen, slice(start, start + 2 * frequency.size), frequency, spread))
        start += 2 * frequency.size
    return found


def _patterns(seen: Seen) -> Iterator[tuple[tuple[str, str, int], Complex]]:
    """What every patch of a state may be, and d ln Z (n,) by that."""
    for region, patch in _patches(seen.operators):
        cells = np.asarray(seen.operators.mesh.mesh.subdomains[region])
        for kind, (index, turn) in KINDS.items():
            for number in np.unique(patch):
                slopes = seen.slopes[index, cells[patch == number]].sum(axis=0)
                yield (region, kind, int(number)), np.conj(turn * slopes)


def _modes(states: Sequence[_State], tangents: Tangents) -> Place:
    """The transducer with a mode besides in every body, each quality and each place as likely."""
    bodies: dict[int, list[_State]] = {}
    for state in states:
        bodies.setdefault(id(state.seen.slopes), []).append(state)
    tried = [[(quality, *_mode(body, quality, tangents)) for quality in QUALITIES] for body in bodies.values()]
    worth = [logsumexp([logsumexp(found, axis=1) - np.log(centre.size * len(QUALITIES)) for _, centre, found in each],
                       axis=0) for each in tried]
    whole = np.sum(worth, axis=0)
    width = int(np.argmax(whole))
    modes = []
    for body, each, gained in zip(bodies.values(), tried, worth, strict=True):
        quality, centre, found = max(each, key=lambda mode: mode[2][width].max())
        if gained[width] > 0.0:
            modes.append(f"{', '.join(state.name for state in body)}: {centre[np.argmax(found[width])] / 1e3:.1f} kHz, "
                         f"Q about {quality:.0f}")
    return Place(TRANSDUCER, MODE, float(np.sqrt(max(0.0, 2.0 * whole[width]))), tuple(modes))


def _mode(body: Sequence[_State], quality: float, tangents: Tangents) -> tuple[Real, Real]:
    """Frequencies (k,) in Hz, and the logarithm of the evidence (widths, k) for a mode there in states of one body."""
    low, high = body[0].frequency[0], body[0].frequency[-1]
    centre = np.geomspace(low, high, 1 + int(np.ceil(2.0 * quality * np.log(high / low))))
    columns = np.zeros((tangents.left.size, 2, centre.size))
    for state in body:
        frequency, impedance = state.frequency[:, None], state.seen.impedance[:, None]
        width = 1j * frequency * centre / quality
        # d ln Z = -Z dY, in units of the band's mean admittance.
        slope = -impedance / np.mean(np.abs(impedance)) * width / (centre**2 - frequency**2 + width)
        columns[state.rows] = np.stack([state.weighted(slope), state.weighted(1j * slope)], axis=1)
    projected = tangents.projected(columns.reshape(tangents.left.size, -1)).reshape(columns.shape)
    return centre, 0.5 * _by_width(np.moveaxis(projected, -1, 0), tangents.left)


def evidence(columns: Real, residual: Real) -> float:
    """Twice the logarithm of the evidence that a residual (m,) holds a combination of columns (m, k).

    Their amplitudes are independent and normal, of the one width that fits best; 0 where none is better than none. The
    noise is of unit size, or of that of the residual where this is larger: a strong effect bends away from all
    tangents, and no pattern is worth more for following it to the last bend.
    """
    return max(0.0, float(_by_width(columns, residual).max()))


def _by_width(columns: Real, residual: Real) -> Real:
    """Twice the logarithm of that evidence (widths, ...) for every one of the widths, of columns (..., m, k)."""
    noise = max(1.0, float(residual @ residual) / residual.size)
    turned = np.swapaxes(columns, -1, -2)
    sizes, vectors = np.linalg.eigh(turned @ columns / noise)
    kept = sizes > ROUNDING * np.maximum(sizes[..., -1:], 1e-300)
    along = np.einsum("...ij,...i->...j", vectors, turned @ residual / noise) ** 2 / np.where(kept, sizes, np.inf)
    ratio = np.multiply.outer(WIDTHS**2, np.where(kept, sizes, 0.0))
    return np.asarray((along * ratio / (1.0 + ratio) - np.log1p(ratio)).sum(axis=-1))


def _patches(operators: FullOperators) -> list[tuple[str, NDArray[np.int64]]]:
    """Every region with the number of the patch that each of its cells is in."""
    mesh, found = operators.mesh.mesh, []
    for region, cells in mesh.subdomains.items():
        if whole(region) != region:  # a layer's part of one
            continue
        corners = mesh.p[:, mesh.t[:, cells]]
        low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
        low[0] = 0.0
        share = (corners.mean(axis=1) - low[:, None]) / (high - low)[:, None]
        along, up = np.minimum((share.T * [RADIAL, AXIAL]).astype(int).T, [[RADIAL - 1], [AXIAL - 1]])
        found.append((region, along * AXIAL + up))
    return found


@dataclass(frozen=True, eq=False)
class Seen:
    """A state as predicted: its impedance (n,) ohm, and ``slopes`` (2, cells, n) as of :func:`changes`.

    States of one solution share their slopes.
    """

    impedance: Complex
    operators: FullOperators
    slopes: Complex


def cell_changes(model: Model, x: Real) -> list[Seen]:
    """Every fitted state at x (p,), on bases about it."""
    found: list[Seen] = []
    known: list[tuple[Solution, FullOperators, Complex]] = []
    for k in range(len(model.fitted.predictors)):
        impedance, _, prediction = model.fitted.predict(x, k)
        same = next((each for each in known if each[0] is prediction.solution), None)
        if same is None:
            operators, states = prediction.full
            same = prediction.solution, operators, changes(operators, states, prediction)
            known.append(same)
        found.append(Seen(impedance, *same[1:]))
    return found


def changes(operators: FullOperators, states: Complex, prediction: Prediction) -> Complex:
    """d ln Z (2, cells, n), e^{-i w t}, by a relative change of stiffness and of mass of every cell."""
    kinds = [_kind(integral) for integral in operators.integrals]
    g = prediction.solution.coefficients
    used = [q for q, kind in enumerate(kinds) if kind is not None and g[:, q].any()]
    result = np.zeros((2, operators.mesh.mesh.t.shape[1], g.shape[0]), dtype=complex)
    for q, forms in zip(used, operators.of(np.array(used)).element_quadratic(states, states), strict=True):
        cells = operators.places[operators.integrals[q].domain].elements
        result[("stiffness", "mass").index(str(kinds[q]))][cells] += g[:, q] * forms
    return result / prediction.solution.charge


def _kind(integral: Integral) -> str | None:
    """Whether an integral over cells stores what stiffness or what mass stores; None for all others."""
    if integral.on_boundary:
        return None
    taken = {(component[0], kind == "value") for product in integral.products
             for name in (product.row, product.column) for component, kind, _ in OPERATORS[name]}
    components = {component for component, _ in taken}
    if components == {"u"}:
        return "mass" if all(value for _, value in taken) else "stiffness"
    if components == {"p"}:
        return "stiffness" if all(value for _, value in taken) else "mass"
    return None
