"""Where on the section a mismatch sits: the score test element by element.

A hypothesis "this element is a little stiffer, heavier or lossier than its material" changes ln Z by a quadratic form
of the states there, x^T A_e x / Q. What the known parameters can imitate is projected out; what is left is compared
with the residual. Neighbours see much the same, so the map is smooth: it shows where to look, not how much is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.locate import KINDS, cell_changes
from workbench.diagnosis.refit import UNNEEDED, Refit
from workbench.fields import section_nodes
from workbench.nodal import NodalMesh

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

@dataclass(frozen=True, eq=False)
class ElementMap:
    """Standard deviations (cells,) that each kind of change of one cell of ``mesh`` would explain, by kind."""

    mesh: NodalMesh
    sigmas: dict[str, Real]
    states: tuple[str, ...]


def element_map(model: Model, fit: Refit) -> ElementMap:
    """The map of what `fit` leaves, on the largest mesh (that of the chip, not of its disc alone)."""
    objective, states = model.fitted, model.campaign.fitted
    objective.cover(fit.x, {}, UNNEEDED)
    meshes = [predictor.problem.mesh for predictor in objective.predictors]
    mesh = max(meshes, key=lambda each: each.mesh.t.shape[1])
    shown = [k for k, each in enumerate(meshes) if each is mesh]
    rows, columns = [], []
    start = 0
    for k, (state, seen) in enumerate(zip(states, cell_changes(model, fit.x), strict=True)):
        count = state.noise.size
        if k in shown:
            columns.append(seen.slopes / state.noise)
            rows.append(np.arange(start, start + 2 * count))
        start += 2 * count
    tangents = fit.tangents()
    within = np.concatenate(rows)
    basis, left = tangents.basis[within], tangents.left[within]
    sigmas = {}
    for kind, (index, turn) in KINDS.items():
        slopes = [np.conj(turn * each[index]) for each in columns]
        whole = np.concatenate([part for slope in slopes for part in (slope.real.T, slope.imag.T)])
        # The other rows of a column are zero, of its projection they are not.
        overlap = basis.T @ whole
        size = np.sqrt(np.maximum(np.sum(whole**2, axis=0) - np.sum(overlap**2, axis=0), 0.0))
        along = np.abs(left @ whole)
        sigmas[kind] = np.where(size > 1e-9 * size.max(), along / np.maximum(size, 1e-300), 0.0)
    nodes, _ = section_nodes(mesh)
    order = np.concatenate([mesh.mesh.subdomains[name] for name in nodes.regions])
    return ElementMap(nodes, {kind: values[order] for kind, values in sigmas.items()},
                      tuple(states[k].name for k in shown))


def largest(found: ElementMap) -> Sequence[tuple[str, str, float]]:
    """(kind, region, sigmas) of the largest value of every kind."""
    result = []
    for kind, values in found.sigmas.items():
        cell = int(np.argmax(values))
        result.append((kind, found.mesh.regions[int(found.mesh.region[cell])], float(values[cell])))
    return result
