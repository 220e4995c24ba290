"""Where a mismatch sits, whatever its physics: the evidence for a change somewhere in each region.

No hypothesis is asked for. Any pattern of changes within a region is allowed, each patch of it a little stiffer,
heavier or lossier, independently and by a normal distribution of one width. What the known parameters can imitate is
projected out, and the width is that of the largest likelihood of the residual with all patterns integrated over
(Gaussian processes: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.2 and 5.4). A
region that needs larger or more intricate patterns is worth less for it. The patches are the same in all states, so
that what acts in the filled states alone sits in the cavity.

A mode that the axisymmetric model does not have is a resonance of its own in the transducer's admittance; it is looked
for at any frequency and quality, in every state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geometry.names import TRANSDUCER, whole
from workbench.diagnose.device import Model
from workbench.diagnose.score import Score, Tangents
from workbench.fit.predict import Prediction
from workbench.operators import FullOperators
from workbench.physics.term import OPERATORS, Integral

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Place = tuple[str, str, float]

#: Patches of a region: along its radius and along its height.
RADIAL, AXIAL = 8, 2

#: Frequencies and qualities of the modes that are looked for.
MODES, QUALITIES = 40, (60.0, 150.0, 400.0)

#: Widths of the distribution of changes that are tried, relative.
WIDTHS = np.logspace(-5.0, 1.0, 61)

#: Directions below this share of the largest are rounding.
ROUNDING = 1e-14

#: What a patch may be, with the index of :func:`changes` and its axis: a loss acts along the imaginary one.
KINDS = {"stiffness": (0, 1.0 + 0j), "mass": (1, 1.0 + 0j), "loss": (0, -1j)}


def located(
    model: Model, x: Real, deviation: Sequence[Real | float], tangents: Tangents, scores: Sequence[Score]
) -> tuple[Place, ...]:
    """Regions with the kind that explains most there, and how much in all, in standard deviations; best first.

    At x (p,), on bases about it; `scores` are asked of regions without cells (the bench). The square of the standard
    deviations is twice the logarithm of the evidence.
    """
    patches: dict[tuple[str, str], dict[int, Real]] = {}
    modes: dict[tuple[int, int, float, complex], Real] = {}
    known: dict[int, tuple[FullOperators, Complex]] = {}
    start = 0
    for k, recording in enumerate(model.fitted.recordings):
        frequency = recording.measured.frequency
        impedance, _, prediction = model.fitted.predict(x, k)
        rows = slice(start, start + 2 * frequency.size)
        start = rows.stop

        def add(column: Real, slope: Complex, rows: slice = rows, spread: Real | float = deviation[k]) -> None:
            column[rows] += np.concatenate([(slope / spread).real, (slope / spread).imag])

        solution = id(prediction.solution)
        if solution not in known:
            operators, states = model.fitted.predictors[k].expanded(prediction)
            known[solution] = operators, changes(operators, states, prediction)
        operators, slopes = known[solution]
        for region, patch in _patches(operators):
            for kind, (index, turn) in KINDS.items():
                columns = patches.setdefault((region, kind), {})
                for number in np.unique(patch):
                    column = columns.setdefault(int(number), np.zeros(tangents.left.size))
                    cells = np.asarray(operators.mesh.mesh.subdomains[region])[patch == number]
                    add(column, np.conj(turn * slopes[index, cells].sum(axis=0)))
        same = list(known).index(solution)
        for number, centre in enumerate(np.linspace(frequency[0], frequency[-1], MODES)):
            for quality in QUALITIES:
                width = 1j * frequency * centre / quality
                # d ln Z = -Z dY, in units of the band's mean admittance.
                slope = -impedance / np.mean(np.abs(impedance)) * width / (centre**2 - frequency**2 + width)
                for turn in (1.0, 1j):
                    add(modes.setdefault((same, number, quality, turn), np.zeros(tangents.left.size)), turn * slope)

    def sigmas(columns: Sequence[Real]) -> float:
        return float(np.sqrt(evidence(tangents.projected(np.stack(columns, axis=1)), tangents.left)))

    found: dict[str, list[tuple[float, str]]] = {}
    for region in dict.fromkeys(region for region, _ in patches):
        of_kinds = {kind: list(patches[region, kind].values()) for kind in KINDS}
        best = max(of_kinds, key=lambda kind: sigmas(of_kinds[kind]))
        found[region] = [(sigmas([column for each in of_kinds.values() for column in each]), best)]
    found.setdefault(TRANSDUCER, []).append((sigmas(list(modes.values())), "mode"))
    for region in dict.fromkeys(s.effect.region for s in scores if s.effect.region not in found):
        own = [s for s in scores if s.effect.region == region]
        unit = [column / max(np.linalg.norm(column), 1e-300) for s in own for column in s.tangent.T]
        found[region] = [(sigmas(unit), max(own, key=lambda s: s.gain).effect.kind)]
    ranked = sorted(((region, *max(each)) for region, each in found.items()), key=lambda item: -item[1])
    return tuple((region, kind, size) for region, size, kind in ranked)


def evidence(columns: Real, residual: Real) -> float:
    """Twice the logarithm of the evidence that a residual (m,) of unit noise holds a combination of columns (m, k).

    Their amplitudes are independent and normal, of the one width that fits best; 0 where none is better than none.
    """
    sizes, vectors = np.linalg.eigh(columns.T @ columns)
    kept = sizes > ROUNDING * max(sizes[-1], 1e-300)
    along = (vectors[:, kept].T @ (columns.T @ residual)) ** 2 / sizes[kept]
    ratio = np.outer(WIDTHS**2, sizes[kept])
    return float(max(0.0, np.max((along * ratio / (1.0 + ratio) - np.log1p(ratio)).sum(axis=1))))


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
