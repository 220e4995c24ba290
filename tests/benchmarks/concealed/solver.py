"""Impedance of an axisymmetric body of rectangles, by tensor-product elements of high order on a graded grid.

Apart from the solver of the workbench in everything: grid, order of the elements, fluids with viscosity as displacement
and pressure (Taylor-Hood), assembly, scaling and reduction. The unknowns are the displacement in solids and viscous
fluids, the potential in piezoelectric cells, the pressure in liquids without viscosity, e^{-i w t}:

    eps(v) : C : eps(u) - rho w^2 u.v  + eps(v) e^T grad(phi) + ...  - grad(psi) . epsilon grad(phi)
    (1 / (rho w^2)) grad(p) . grad(q) - kappa p q  + p (v . n) + q (u . n)
    2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v - p div(v) - q div(u) - kappa p q          G = G' - i w eta

At unit voltage the charge is -x^T A x, live electrode included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from concealed.elements import UNKNOWNS, edge_matrices, line, matrices
from concealed.media import Anything, Contact, Liquid, Load, Medium, Necks, Piezo, Solid, Viscous
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]

SAME = 1e-10  # metres

#: A diagonal entry is taken for pivot down to this share of the largest in its column.
PIVOT = 1e-3

#: Cells per shortest wavelength; of fifth order two give 0.1 % of Z in a chip.
CELLS = 2.0

#: Frequencies a reduced model starts from, and directions taken at each beside the solution.
START, FURTHER = 3, 4


class NotAccurate(RuntimeError):
    """A solve or the reduced model misses its tolerance."""


@dataclass(frozen=True)
class Box:
    """A rectangle r0..r1, z0..z1 (m) of a medium; None for nothing. Later boxes replace earlier ones."""

    r0: float
    r1: float
    z0: float
    z1: float
    medium: Medium | None


@dataclass(frozen=True)
class Face:
    """A straight piece of a surface: z0 == z1 when it lies flat, r0 == r1 when it stands; what acts on it."""

    r0: float
    r1: float
    z0: float
    z1: float
    surface: Load | Necks


@dataclass(frozen=True)
class Body:
    """Boxes, faces, both electrodes as (z, inner radius, outer radius), and where the grid needs further lines."""

    boxes: tuple[Box, ...]
    live: tuple[float, float, float]
    ground: tuple[float, float, float]
    faces: tuple[Face, ...] = ()
    lines_r: tuple[float, ...] = ()
    lines_z: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Grid:
    """Lines of the grid (m), and the index of the medium of every cell, (cells along r, cells along z), -1: nothing."""

    r: Real
    z: Real
    media: tuple[Medium, ...]
    fill: Integers
    counts: tuple[tuple[int, ...], tuple[int, ...]]


def _distinct(values: Sequence[float]) -> Real:
    ordered = np.sort(np.array(values))
    return ordered[np.concatenate([[True], np.diff(ordered) > SAME])]


def _shortest(medium: Medium, frequency: float) -> float:
    """Shortest wavelength (m) in a medium; in a viscous fluid that of sound, its layers are asked for by lines."""
    match medium:
        case Solid() | Piezo():
            slow = min(abs(medium.c44), 0.5 * abs(medium.c11 - medium.c12))
            return math.sqrt(slow / abs(medium.density)) / frequency
        case Viscous() | Liquid():
            w = np.array([2.0 * np.pi * frequency])
            kappa = complex(np.asarray(medium.coefficients(w)["compressibility"]).ravel()[0])
            return 1.0 / math.sqrt(abs(kappa) * abs(medium.density)) / frequency
        case _:
            raise TypeError(f"received {medium!r}; expected a solid, a ceramic or a liquid")


def grid(body: Body, frequency: float, *, per_wavelength: float | None = None,
         counts: tuple[tuple[int, ...], tuple[int, ...]] | None = None) -> Grid:
    """The grid of a body for frequencies up to `frequency` (Hz): cells of at most a `per_wavelength`-th (CELLS unless
    given) of the shortest wave beside them. `counts` (cells between neighbouring breaks) makes the same grid on a body
    slightly changed."""
    breaks = (_distinct([x for b in body.boxes for x in (b.r0, b.r1)] + [*body.lines_r, *body.live[1:],
                                                                         *body.ground[1:]]),
              _distinct([x for b in body.boxes for x in (b.z0, b.z1)] + list(body.lines_z)))
    coarse = _fill(body, *breaks)
    wanted = CELLS if per_wavelength is None else per_wavelength
    media = tuple(dict.fromkeys(b.medium for b in body.boxes if b.medium is not None))
    waves = np.array([*(_shortest(m, frequency) for m in media), np.inf])
    shortest = waves[coarse]
    lines, numbers = [], []
    for axis, at in enumerate(breaks):
        per_strip = shortest.min(axis=1 - axis)
        given = None if counts is None else counts[axis]
        if given is None:
            given = tuple(max(1, math.ceil(d / w * wanted - 1e-9)) for d, w in
                          zip(np.diff(at), per_strip, strict=True))
        if len(given) != at.size - 1:
            raise ValueError("the body has changed so much that its grid has other breaks")
        numbers.append(given)
        lines.append(np.concatenate([*(np.linspace(a, b, n, endpoint=False) for a, b, n in
                                       zip(at, at[1:], given, strict=False)), at[-1:]]))
    return Grid(lines[0], lines[1], media, _fill(body, lines[0], lines[1]), (numbers[0], numbers[1]))


def _fill(body: Body, r: Real, z: Real) -> Integers:
    media = tuple(dict.fromkeys(b.medium for b in body.boxes if b.medium is not None))
    index = {m: k for k, m in enumerate(media)}
    found = np.full((r.size - 1, z.size - 1), -1)
    mid_r, mid_z = 0.5 * (r[1:] + r[:-1]), 0.5 * (z[1:] + z[:-1])
    for box in body.boxes:
        inside = np.ix_((mid_r > box.r0) & (mid_r < box.r1), (mid_z > box.z0) & (mid_z < box.z1))
        found[inside] = -1 if box.medium is None else index[box.medium]
    return found


@dataclass(frozen=True, eq=False)
class Block:
    """Cells or edges of one medium: (cells, k) unknowns, -1 where zero, and a real matrix for each coefficient."""

    medium: Anything
    unknowns: Integers
    matrices: Mapping[str, Real]


@dataclass(frozen=True, eq=False)
class Model:
    """Blocks and the number of unknowns; the last one is the voltage of the live electrode."""

    blocks: tuple[Block, ...]
    size: int

    @cached_property
    def pattern(self) -> tuple[list[NDArray[np.bool_]], Integers, Integers, Integers]:
        """Which entries of the element matrices count, where each goes among those of the csc matrix, and its indices
        and column starts."""
        kept, rows, columns = [], [], []
        for block in self.blocks:
            shape = (*block.unknowns.shape, block.unknowns.shape[1])
            row = np.broadcast_to(block.unknowns[:, :, None], shape)
            column = np.broadcast_to(block.unknowns[:, None, :], shape)
            kept.append((row >= 0) & (column >= 0))
            rows.append(row[kept[-1]])
            columns.append(column[kept[-1]])
        places, entry = np.unique(np.concatenate(columns) * self.size + np.concatenate(rows), return_inverse=True)
        starts = np.searchsorted(places, np.arange(self.size + 1) * self.size)
        return kept, entry, places % self.size, starts


def assemble(body: Body, cells: Grid, *, order: int = 5) -> Model:
    """The real element matrices of a body on its grid."""
    n_r, n_z = (cells.r.size - 1) * order + 1, (cells.z.size - 1) * order + 1
    m_z = (cells.z.size - 1) * (order - 1) + 1
    kind_of = np.array([*(m.kind for m in cells.media), "nothing"])[cells.fill]

    def nodes(i: Integers, j: Integers, p: int, rows: int) -> Integers:
        a, b = np.repeat(np.arange(p + 1), p + 1), np.tile(np.arange(p + 1), p + 1)
        return (i[:, None] * p + a) * rows + j[:, None] * p + b

    node_z = _nodes(cells.z, order)
    node_r = _nodes(cells.r, order)
    carrying = {"ur": ("solid", "piezo", "viscous"), "uz": ("solid", "piezo", "viscous"), "phi": ("piezo",),
                "p": ("liquid",), "q": ("viscous",)}
    number: dict[str, Integers] = {}
    count = 0
    for name, among in carrying.items():
        i, j = np.nonzero(np.isin(kind_of, among))
        p, rows = (order - 1, m_z) if name == "q" else (order, n_z)
        used = np.zeros((n_r, n_z) if name != "q" else ((cells.r.size - 1) * p + 1, m_z), dtype=bool)
        used.ravel()[nodes(i, j, p, rows).ravel()] = True
        if name == "ur":
            used[0] = False
        if name == "p":
            used &= ~_rim(kind_of, order)
        if name == "phi":
            used &= ~_electrode(body.ground, node_r, node_z)
            live = used & _electrode(body.live, node_r, node_z)
            used &= ~live
        numbered = np.full(used.shape, -1)
        numbered[used] = count + np.arange(np.count_nonzero(used))
        count += int(np.count_nonzero(used))
        number[name] = numbered
    number["phi"][live] = count

    blocks = []
    for index, medium in enumerate(cells.media):
        i, j = np.nonzero(cells.fill == index)
        if i.size:
            unknowns = [number[name].ravel()[nodes(i, j, order - 1 if name == "q" else order,
                                                   m_z if name == "q" else n_z)] for name in UNKNOWNS[medium.kind]]
            found = matrices(medium.kind, order, cells.r[i], np.diff(cells.r)[i], np.diff(cells.z)[j])
            blocks.append(Block(medium, np.concatenate(unknowns, axis=1), found))
    blocks += _contacts(cells, kind_of, number, order)
    blocks += [block for face in body.faces for block in _faces(face, cells, number, order)]
    return Model(tuple(blocks), count + 1)


def _nodes(lines: Real, order: int) -> Real:
    reference = 0.5 * (1.0 + line(order, order + 2).nodes)
    inner = lines[:-1, None] + np.diff(lines)[:, None] * reference[:-1]
    return np.append(inner.ravel(), lines[-1])


def _electrode(disc: tuple[float, float, float], r: Real, z: Real) -> NDArray[np.bool_]:
    height, inner, outer = disc
    return ((r > inner - SAME) & (r < outer + SAME))[:, None] & (np.abs(z - height) < SAME)[None, :]


def _rim(kind_of: NDArray[np.str_], order: int) -> NDArray[np.bool_]:
    """Nodes on an edge between a liquid and nothing."""
    padded = np.pad(kind_of, ((0, 1), (1, 1)), constant_values="nothing")
    found = np.zeros((kind_of.shape[0] * order + 1, kind_of.shape[1] * order + 1), dtype=bool)
    for i, j in zip(*np.nonzero(kind_of == "liquid"), strict=True):
        a, b = slice(i * order, (i + 1) * order + 1), slice(j * order, (j + 1) * order + 1)
        if padded[i + 1, j + 1] == "nothing":
            found[(i + 1) * order, b] = True
        if i > 0 and padded[i - 1, j + 1] == "nothing":
            found[i * order, b] = True
        if padded[i, j] == "nothing":
            found[a, j * order] = True
        if padded[i, j + 2] == "nothing":
            found[a, (j + 1) * order] = True
    return found


def _edge_nodes(i: Integers, j: Integers, order: int, rows: int, horizontal: bool) -> Integers:
    """Nodes of the lower (left) edge of cells i, j."""
    along = np.arange(order + 1)
    return (i[:, None] * order + along) * rows + (j * order)[:, None] if horizontal else (
        (i * order)[:, None] * rows + j[:, None] * order + along)


def _contacts(cells: Grid, kind_of: NDArray[np.str_], number: Mapping[str, Integers], order: int) -> list[Block]:
    """p (v . n) + q (u . n), n out of the side with displacement."""
    rows = number["ur"].shape[1]
    liquid, moving = kind_of == "liquid", np.isin(kind_of, ("solid", "piezo", "viscous"))
    blocks = []
    for horizontal in (True, False):
        first, second = ((slice(None), slice(0, -1)), (slice(None), slice(1, None))) if horizontal else (
            (slice(0, -1), slice(None)), (slice(1, None), slice(None)))
        for low, high, sign in ((moving, liquid, 1.0), (liquid, moving, -1.0)):
            i, j = np.nonzero(low[first] & high[second])
            if i.size == 0:
                continue
            i, j = (i, j + 1) if horizontal else (i + 1, j)
            start, lengths = (cells.r[i], np.diff(cells.r)[i]) if horizontal else (cells.z[j], np.diff(cells.z)[j])
            mass = sign * edge_matrices(order, horizontal, start, lengths, cells.r[i])
            at = _edge_nodes(i, j, order, rows, horizontal)
            normal = number["uz" if horizontal else "ur"].ravel()[at]
            empty = np.zeros_like(mass)
            matrix = np.block([[empty, mass], [mass, empty]])
            blocks.append(Block(Contact(), np.concatenate([normal, number["p"].ravel()[at]], axis=1),
                                {"contact": matrix}))
    return blocks


def _faces(face: Face, cells: Grid, number: Mapping[str, Integers], order: int) -> list[Block]:
    horizontal = abs(face.z1 - face.z0) < SAME
    lines, across = (cells.r, cells.z) if horizontal else (cells.z, cells.r)
    low, high, position = (face.r0, face.r1, face.z0) if horizontal else (face.z0, face.z1, face.r0)
    middle = 0.5 * (lines[1:] + lines[:-1])
    along = np.nonzero((middle > low) & (middle < high))[0]
    level = np.full(along.size, int(np.argmin(np.abs(across - position))))
    i, j = (along, level) if horizontal else (level, along)
    mass = edge_matrices(order, horizontal, lines[along], np.diff(lines)[along], np.full(along.size, face.r0))
    at = _edge_nodes(i, j, order, number["ur"].shape[1], horizontal)
    if isinstance(face.surface, Necks):
        return [Block(face.surface, number["p"].ravel()[at], {"admittance": mass})]
    normal, tangential = ("uz", "ur") if horizontal else ("ur", "uz")
    return [Block(face.surface, number[name].ravel()[at], {key: mass})
            for name, key in ((normal, "normal"), (tangential, "tangential"))]


# --------------------------------------------------------------------------------------------------------------------
# Solving.


def system(model: Model, omega: float) -> tuple[sparse.csc_matrix, Real]:
    """A(w), live electrode last, and a scale (size - 1,) of the other unknowns: what adds up to the diagonal, taken
    without sign, since stiffness and inertia may cancel there."""
    kept, entry, indices, starts = model.pattern
    entries, size = [], np.zeros(model.size + 1)
    for block, counted in zip(model.blocks, kept, strict=True):
        coefficients = block.medium.coefficients(np.array([omega]))
        values, magnitude = np.zeros(counted.shape, dtype=complex), np.zeros(block.unknowns.shape)
        for name, matrix in block.matrices.items():
            factor = complex(np.asarray(coefficients[name]).ravel()[0])
            values += factor * matrix
            magnitude += abs(factor) * np.abs(np.einsum("cii->ci", matrix))
        np.add.at(size, block.unknowns, magnitude)
        entries.append(values[counted])
    each = np.concatenate(entries)
    data = np.bincount(entry, each.real) + 1j * np.bincount(entry, each.imag)
    matrix = sparse.csc_matrix((data, indices, starts), shape=(model.size, model.size))
    return matrix, 1.0 / np.sqrt(size[:-2])


def _slope(model: Model, omega: float, x: Complex) -> Complex:
    """dA/dw x."""
    step = 1e-4 * omega
    padded, result = np.append(x, 0.0), np.zeros(model.size + 1, dtype=complex)
    for block in model.blocks:
        coefficients = block.medium.coefficients(np.array([omega, omega + step]))
        local = padded[block.unknowns]
        for name, matrix in block.matrices.items():
            first, second = np.broadcast_to(coefficients[name], 2)
            if first != second:
                product = np.matmul(matrix, np.stack([local.real, local.imag], axis=2))
                np.add.at(result, block.unknowns, (second - first) / step * (product[..., 0] + 1j * product[..., 1]))
    return result[:-1]


def solve(model: Model, frequency: float, *, further: int = 0) -> tuple[complex, Complex]:
    """Impedance (ohm, e^{-i w t}) and the unknowns (1 + further, size) at one volt; the further ones are directions in
    which they move with the frequency, from the same factors (a Krylov space of A^-1 dA/dw).

    Raises:
        NotAccurate: the relative residual is above 1e-8 after refinement.
    """
    omega = 2.0 * np.pi * frequency
    matrix, scale = system(model, omega)
    inner = (sparse.diags(scale) @ matrix[:-1, :-1] @ sparse.diags(scale)).tocsc()
    factor = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=PIVOT, options={"SymmetricMode": True})

    right = -scale * matrix[:-1, -1].toarray().ravel()
    y = factor.solve(right)
    for _ in range(2):
        y = y + factor.solve(right - inner @ y)
    residual = float(np.linalg.norm(right - inner @ y) / np.linalg.norm(right))
    if not residual < 1e-8:
        raise NotAccurate(f"relative residual {residual:.1e} at {frequency:.9g} Hz")
    x = np.append(scale * y, 1.0)
    found = [x]
    for _ in range(further):
        # A direction need not be exact.
        found.append(np.append(scale * factor.solve(-scale * _slope(model, omega, found[-1])[:-1]), 0.0))
    return complex(1.0 / (1j * omega * (x @ (matrix @ x)))), np.array(found)


@dataclass(frozen=True, eq=False)
class Reduced:
    """The model on a real basis (size, k), the live electrode's column last."""

    basis: Real
    blocks: tuple[tuple[Anything, Mapping[str, Real]], ...]
    solves: int
    error: float

    def impedance(self, frequency: Real) -> Complex:
        """(n,) ohm, e^{-i w t}."""
        return impedance(self.blocks, frequency)


def impedance(blocks: Sequence[tuple[Anything, Mapping[str, Real]]], frequency: Real) -> Complex:
    """Impedance (n,) of projected blocks."""
    omega = 2.0 * np.pi * np.asarray(frequency)
    size = next(iter(blocks[0][1].values())).shape[0]
    constant = np.zeros((size, size), dtype=complex)
    factors, parts = [], []
    for medium, projected in blocks:
        values = medium.coefficients(omega)
        for name, matrix in projected.items():
            if np.ndim(values[name]) == 0:
                constant += values[name] * matrix
            else:
                factors.append(values[name])
                parts.append(matrix.ravel())
    varying, flat = np.array(factors).T, np.array(parts)
    total = constant + (varying.real @ flat + 1j * (varying.imag @ flat)).reshape(omega.size, size, size)
    inner, right = total[:, :-1, :-1], total[:, :-1, -1:]
    y = -np.linalg.solve(inner, right)
    charge = -(total[:, -1, -1] + (right[:, :, 0] * y[:, :, 0]).sum(axis=1))
    return np.asarray(1.0 / (-1j * omega * charge))


def project(block: Block, basis: Real) -> dict[str, Real]:
    """The matrices of a block on a basis."""
    padded = np.vstack([basis, np.zeros((1, basis.shape[1]))])
    local = padded[block.unknowns]
    flat = local.reshape(-1, basis.shape[1])
    return {name: flat.T @ np.matmul(matrix, local).reshape(flat.shape) for name, matrix in block.matrices.items()}


def reduce(model: Model, frequency: Real, *, tolerance: float = 1e-5, limit: int = 40,
           known: Real | None = None) -> Reduced:
    """A reduced model whose last new solution changed Z by less than `tolerance` everywhere, and that a full solve
    confirms where it changed most. `known` is the basis of a similar model of the same unknowns to start from.

    Raises:
        NotAccurate: not after `limit` full solves.
    """
    low, high = float(frequency[0]), float(frequency[-1])
    start, more = (START, FURTHER) if known is None else (2, 1)
    asked = list(np.linspace(low, high, start))
    states = [solve(model, f, further=more)[1] for f in asked]
    weight = system(model, np.pi * (low + high))[1]
    previous, change = np.zeros(frequency.size, dtype=complex), np.full(frequency.size, np.inf)
    while True:
        basis = _basis(np.concatenate(states), weight, known)
        reduced = tuple((block.medium, project(block, basis)) for block in model.blocks)
        found = impedance(reduced, frequency)
        if len(asked) > start:
            change = np.abs(np.log(found / previous))
        candidate = float(frequency[int(np.argmax(change))])
        if len(asked) == start or any(abs(candidate - f) < 1e-4 * candidate for f in asked):
            # Nothing to go by: the middle of the widest gap.
            gaps = np.sort(np.array(asked))
            widest = int(np.argmax(np.diff(gaps)))
            candidate = 0.5 * float(gaps[widest] + gaps[widest + 1])
        exact, state = solve(model, candidate, further=more)
        error = abs(complex(impedance(reduced, np.array([candidate]))[0]) / exact - 1.0)
        if error < tolerance and change.max() < tolerance:
            return Reduced(basis, reduced, len(asked) + 1, error)
        if len(asked) >= limit:
            raise NotAccurate(f"the reduced model is still {error:.1e} off after {limit} solves")
        asked.append(candidate)
        states.append(state)
        previous = found


def _basis(states: Complex, weight: Real, known: Real | None) -> Real:
    """Real columns orthonormal in scaled unknowns, then that of the live electrode."""
    parts = [states.real.T, states.imag.T, *([] if known is None else [known[:, :-1]])]
    columns = np.concatenate(parts, axis=1)[:-1] / weight[:, None]
    columns = columns / np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    left = left[:, singular > 1e-10 * singular[0]] * weight[:, None]
    size, count = left.shape
    basis = np.zeros((size + 1, count + 1))
    basis[:-1, :-1], basis[-1, -1] = left, 1.0
    return basis


def spectrum(body: Body, frequency: Real, *, order: int = 5, per_wavelength: float | None = None,
             tolerance: float = 1e-5) -> Complex:
    """Impedance (n,) of a body, e^{+j w t}."""
    cells = grid(body, float(frequency[-1]), per_wavelength=per_wavelength)
    model = assemble(body, cells, order=order)
    return np.conj(reduce(model, frequency, tolerance=tolerance).impedance(frequency))
