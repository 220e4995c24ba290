"""Spectra of a device in its states, and what small changes of it do to them, on reduced models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from concealed.design import Design
from concealed.device import State, Values, body, seen, swept
from concealed.fields import KINDS, Inhomogeneity, slopes
from concealed.section import Body
from concealed.solver import Block, Grid, Model, Reduced, assemble, coefficient, grid, project, reduce, response
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Order of the elements, and how far the reduced model may be off, relative to Z (noise is ten times that or more).
ORDER, TOLERANCE = 5, 3e-4

#: Step of the differences for tangents, in uncertainties: small, lest lines of the grid pass one another.
STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Solved:
    """A body with its reduced model."""

    body: Body
    cells: Grid
    model: Model
    reduced: Reduced


@dataclass(frozen=True, eq=False)
class Point:
    """A state of the device about which things change: its solved body, the frequencies (n,) Hz it was asked for, its
    own ln Z there (n,), its charge (n,), unknowns (n, k) and d ln Z seen / d ln Z of its own (n,); all e^{-i w t} but
    what is seen."""

    solved: Solved
    frequency: Real
    charge: Complex
    unknowns: Complex
    through: Complex

    @property
    def own(self) -> Complex:
        """Impedance (n,) of the device itself, e^{+j w t}."""
        return np.conj(1.0 / (-2j * np.pi * self.frequency * self.charge))

    def form(self, matrix: Real) -> Complex:
        """What a projected matrix adds to ln Z (n,) for a coefficient of one: x^T A x / Q at a charge Q = -x^T A x."""
        return np.asarray(((self.unknowns.real @ matrix + 1j * (self.unknowns.imag @ matrix))
                           * self.unknowns).sum(axis=1) / self.charge)


class Device:
    """The solved states of a device whose parts may be uneven; a body that was solved before is not solved again."""

    def __init__(self, design: Design, uneven: Inhomogeneity | None = None, *, order: int | None = None,
                 tolerance: float | None = None) -> None:
        self.design = design
        self.uneven = uneven
        self.order = ORDER if order is None else order
        self.tolerance = TOLERANCE if tolerance is None else tolerance
        self._solved: dict[Body, Solved] = {}
        self._basis: dict[int, Real] = {}

    def solved(self, values: Values, defects: Values, state: State) -> Solved:
        """The model of a state."""
        wanted = body(values, defects, state)
        if wanted not in self._solved:
            cells = grid(wanted, float(self.design.frequency[-1]))
            model = assemble(wanted, cells, order=self.order, uneven=self.uneven)
            # Whatever has as many unknowns is the same section with other numbers.
            reduced = reduce(model, self.design.frequency, tolerance=self.tolerance, known=self._basis.get(model.size))
            self._basis.setdefault(model.size, reduced.basis)
            self._solved[wanted] = Solved(wanted, cells, model, reduced)
        return self._solved[wanted]

    def spectrum(self, values: Values, defects: Values, state: State) -> Complex:
        """Impedance (n,) as the bench sees it without noise, e^{+j w t}."""
        frequency = swept(values, defects, state, self.design.frequency)
        own = np.conj(self.solved(values, defects, state).reduced.impedance(frequency))
        return seen(values, defects, state, frequency, own)

    def point(self, values: Values, defects: Values, state: State) -> Point:
        """A state about which things change."""
        solved = self.solved(values, defects, state)
        frequency = swept(values, defects, state, self.design.frequency)
        charge, unknowns = response(solved.reduced.blocks, frequency)
        own, step = np.conj(1.0 / (-2j * np.pi * frequency * charge)), 1e-5
        bench = [seen(values, defects, state, frequency, own * (1.0 + sign * step)) for sign in (1.0, -1.0)]
        return Point(solved, frequency, charge, unknowns, np.log(bench[0] / bench[1]) / (2.0 * step))

    def tangent(self, at: Point, values: Values, defects: Values, state: State, name: str, size: float) -> Complex:
        """Change (n,) of the seen ln Z, e^{+j w t}, with one parameter by `size` (SI), to first order."""
        moved = self.design.moved(values, {name: STEP * size})
        if name.startswith("bench."):
            back = self.design.moved(values, {name: -STEP * size})
            shown = []
            for each in (moved, back):
                frequency = swept(each, defects, state, self.design.frequency)
                own = at.own if np.array_equal(frequency, at.frequency) else np.conj(
                    at.solved.reduced.impedance(frequency))
                shown.append(seen(each, defects, state, frequency, own))
            return np.asarray(np.log(shown[0] / shown[1]) / (2.0 * STEP))
        other = body(moved, defects, state)
        if other == at.solved.body:
            return np.zeros(at.frequency.size, dtype=complex)
        return at.through * np.conj(self._change(at, other)) / STEP

    def _change(self, at: Point, other: Body) -> Complex:
        """Change (n,) of the device's own ln Z, e^{-i w t}, if it were another body, to first order."""
        base, omega = at.solved, 2.0 * np.pi * at.frequency
        cells = grid(other, float(self.design.frequency[-1]), counts=base.cells.counts)
        renamed = dict(zip(base.cells.media, cells.media, strict=True))
        total = np.zeros(omega.size, dtype=complex)
        for medium, projected in base.reduced.blocks:
            after = renamed.get(medium, medium)  # type: ignore[arg-type]
            if after != medium:
                before, values = medium.coefficients(omega), after.coefficients(omega)
                for key, matrix in projected.items():
                    change = coefficient(values, key) - coefficient(before, key)
                    if np.any(change):
                        total += change * at.form(matrix)
        if not (np.array_equal(cells.r, base.cells.r) and np.array_equal(cells.z, base.cells.z)):
            moved = assemble(other, cells, order=self.order, uneven=self.uneven)
            for old, new in zip(base.model.blocks, moved.blocks, strict=True):
                values = old.medium.coefficients(omega)
                for key, matrix in _moved(old, new, base.reduced.basis).items():
                    total += coefficient(values, key) * at.form(matrix)
        return total

    def uneven_tangents(self, at: Point) -> dict[tuple[str, str], Complex]:
        """Change (n, modes) of the seen ln Z, e^{+j w t}, with every cosine of the fields by their rms, to first order,
        by part and kind."""
        if self.uneven is None:
            return {}
        found: dict[tuple[str, str], Complex] = {}
        for block in at.solved.model.blocks:
            if block.cells is not None:
                energies = _energies(block, at)
                for part, inside, shape in self.uneven.shapes(at.solved.body, at.solved.cells, *block.cells):
                    for kind, energy in energies.items():
                        seen_by = at.through[:, None] * np.conj(self.uneven.rms * (shape.T @ energy[inside]).T)
                        found[part, kind] = found.get((part, kind), 0.0) + seen_by
        return found


def _energies(block: Block, at: Point) -> dict[str, Complex]:
    """Change (cells, n) of the device's own ln Z with the relative change of every cell, by kind."""
    basis = at.solved.reduced.basis
    padded = np.vstack([basis, np.zeros((1, basis.shape[1]))])[block.unknowns]
    # (cells, unknowns, real and imaginary parts at all frequencies)
    local = np.matmul(padded, np.concatenate([at.unknowns.real.T, at.unknowns.imag.T], axis=1))
    n = at.frequency.size
    field = local[..., :n] + 1j * local[..., n:]
    coefficients = block.medium.coefficients(2.0 * np.pi * at.frequency)
    found = {kind: np.zeros((len(field), n), dtype=complex) for kind in KINDS}
    for name, matrix in block.matrices.items():
        weights = {kind: slopes(name, kind) for kind in KINDS}
        if any(map(any, weights.values())):
            image = np.matmul(matrix, local)
            form = ((image[..., :n] + 1j * image[..., n:]) * field).sum(axis=1) / at.charge
            factor = np.asarray(coefficients[name])
            for kind, (real, imaginary) in weights.items():
                if real or imaginary:
                    found[kind] += (real * factor.real + 1j * imaginary * factor.imag) * form
    return found


def _moved(old: Block, new: Block, basis: Real) -> Mapping[str, Real]:
    """Change of the projected matrices of a block some of whose cells have changed."""
    differs = np.zeros(old.unknowns.shape[0], dtype=bool)
    for name, matrix in old.matrices.items():
        # Rounding of the lines of the grid is no change.
        size = np.abs(matrix).max(axis=(1, 2))
        differs |= np.abs(new.matrices[name] - matrix).max(axis=(1, 2)) > 1e-9 * size
    for kind, field in (old.field or {}).items():
        differs |= np.abs((new.field or {})[kind] - field) > 1e-12
    if not differs.any():
        return {}
    before, after = (project(Block(
        old.medium, each.unknowns[differs], {name: matrix[differs] for name, matrix in each.matrices.items()},
        None if each.field is None else {kind: field[differs] for kind, field in each.field.items()}), basis)
        for each in (old, new))
    return {key: after[key] - before[key] for key in before}
