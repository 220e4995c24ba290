"""Impedance of an axisymmetric body of rectangles, by tensor-product elements of high order on a graded grid.

The rectangles may be warped: nodes are then moved, and cells are curved by their order.

Apart from the solver of the workbench in everything: grid, order of the elements, fluids with viscosity as displacement
and pressure (Taylor-Hood), assembly, scaling and reduction. The unknowns are the displacement in solids and viscous
fluids, the potential in piezoelectric cells, the pressure in liquids without viscosity, e^{-i w t}:

    eps(v) : C : eps(u) - rho w^2 u.v  + eps(v) e^T grad(phi) + ...  - grad(psi) . epsilon grad(phi)
    (1 / (rho w^2)) grad(p) . grad(q) - kappa p q  + p (v . n) + q (u . n)
    2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v - p div(v) - q div(u) - kappa p q          G = G' - i w eta

At unit voltage the charge is -x^T A x, live electrode included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from concealed.blocks import Block, Model
from concealed.elements import UNKNOWNS, edge_matrices, line, matrices
from concealed.fields import Inhomogeneity, scales
from concealed.media import Anything, Coefficients, Contact, Necks
from concealed.section import SAME, Body, Box, Face, Grid, grid
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]

__all__ = ["Body", "Box", "Face", "Grid", "NotAccurate", "assemble", "grid", "reduce", "solve", "spectrum"]

#: A diagonal entry is taken for pivot down to this share of the largest in its column.
PIVOT = 1e-3

#: Frequencies a reduced model starts from, and directions taken at each beside the solution.
START, FURTHER = 3, 4

#: Frequencies at which a reduced model is compared with the one before.
PROBES = 80


class NotAccurate(RuntimeError):
    """A solve or the reduced model misses its tolerance."""


def assemble(body: Body, cells: Grid, *, order: int = 5, uneven: Inhomogeneity | None = None) -> Model:
    """The real element matrices of a body on its grid, whose parts may be `uneven`."""
    n_r, n_z = (cells.r.size - 1) * order + 1, (cells.z.size - 1) * order + 1
    m_z = (cells.z.size - 1) * (order - 1) + 1
    kind_of = np.array([*(m.kind for m in cells.media), "nothing"])[cells.fill]

    def nodes(i: Integers, j: Integers, p: int, rows: int) -> Integers:
        a, b = np.repeat(np.arange(p + 1), p + 1), np.tile(np.arange(p + 1), p + 1)
        return (i[:, None] * p + a) * rows + j[:, None] * p + b

    node_z = node_positions(cells.z, order)
    node_r = node_positions(cells.r, order)
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
            used &= ~on_electrode(body.ground, node_r, node_z)
            live = used & on_electrode(body.live, node_r, node_z)
            used &= ~live
        numbered = np.full(used.shape, -1)
        numbered[used] = count + np.arange(np.count_nonzero(used))
        count += int(np.count_nonzero(used))
        number[name] = numbered
    number["phi"][live] = count

    r_nodes, z_nodes = body.warped(node_r, node_z)
    blocks = []
    for index, medium in enumerate(cells.media):
        i, j = np.nonzero(cells.fill == index)
        if i.size:
            unknowns = [number[name].ravel()[nodes(i, j, order - 1 if name == "q" else order,
                                                   m_z if name == "q" else n_z)] for name in UNKNOWNS[medium.kind]]
            at = nodes(i, j, order, n_z)
            found = matrices(medium.kind, order, r_nodes.ravel()[at], z_nodes.ravel()[at])
            field = None if uneven is None else uneven.values(body, cells, i, j)
            blocks.append(Block(medium, np.concatenate(unknowns, axis=1), found, field, (i, j)))
    blocks += _contacts(kind_of, number, order, (r_nodes, z_nodes))
    blocks += [block for face in body.faces for block in _faces(face, cells, number, order, (r_nodes, z_nodes))]
    return Model(tuple(blocks), count + 1)


def node_positions(lines: Real, order: int) -> Real:
    """Nodes (m) of cells between neighbouring lines."""
    reference = 0.5 * (1.0 + line(order, order + 2).nodes)
    inner = lines[:-1, None] + np.diff(lines)[:, None] * reference[:-1]
    return np.append(inner.ravel(), lines[-1])


def on_electrode(disc: tuple[float, float, float], r: Real, z: Real) -> NDArray[np.bool_]:
    """Which nodes on lines r (n,) and z (m,) belong to an electrode: (n, m)."""
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


def _contacts(kind_of: NDArray[np.str_], number: Mapping[str, Integers], order: int, at_nodes: tuple[Real, Real]
              ) -> list[Block]:
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
            at = _edge_nodes(i, j, order, rows, horizontal)
            by_dr, by_dz, _ = edge_matrices(order, order, *(each.ravel()[at] for each in at_nodes))
            # n ds is (-dz, dr) where n points upwards along r, and (dz, -dr) outwards along z.
            turned = sign if horizontal else -sign
            for name, mass in (("ur", -turned * by_dz), ("uz", turned * by_dr)):
                if mass.any():
                    empty = np.zeros_like(mass)
                    matrix = np.block([[empty, mass], [mass, empty]])
                    moving_there = np.concatenate([number[name].ravel()[at], number["p"].ravel()[at]], axis=1)
                    blocks.append(Block(Contact(), moving_there, {"contact": matrix}))
    return blocks


def _faces(face: Face, cells: Grid, number: Mapping[str, Integers], order: int, at_nodes: tuple[Real, Real]
           ) -> list[Block]:
    horizontal = abs(face.z1 - face.z0) < SAME
    lines, across = (cells.r, cells.z) if horizontal else (cells.z, cells.r)
    low, high, position = (face.r0, face.r1, face.z0) if horizontal else (face.z0, face.z1, face.r0)
    middle = 0.5 * (lines[1:] + lines[:-1])
    along = np.nonzero((middle > low) & (middle < high))[0]
    level = np.full(along.size, int(np.argmin(np.abs(across - position))))
    i, j = (along, level) if horizontal else (level, along)
    at_edges = _edge_nodes(i, j, order, number["ur"].shape[1], horizontal)

    def traces(p: int) -> Real:
        return edge_matrices(order, p, *(each.ravel()[at_edges] for each in at_nodes))[2]

    if isinstance(face.surface, Necks):
        # What passes the wall is missing in the fluid: the pressure of either kind of fluid has it in its own equation.
        found = []
        for name, p in (("p", order), ("q", order - 1)):
            at = number[name].ravel()[_edge_nodes(i, j, p, number[name].shape[1], horizontal)]
            if (at >= 0).any():
                found.append(Block(face.surface, at, {"admittance": traces(p)}))
        return found
    mass, at = traces(order), _edge_nodes(i, j, order, number["ur"].shape[1], horizontal)
    normal, tangential = ("uz", "ur") if horizontal else ("ur", "uz")
    return [Block(face.surface, number[name].ravel()[at], {key: mass})
            for name, key in ((normal, "normal"), (tangential, "tangential"))]


# --------------------------------------------------------------------------------------------------------------------
# Solving.


def system(model: Model, omega: float) -> tuple[sparse.csc_matrix, Real]:
    """A(w), live electrode last, and a scale (size - 1,) of the other unknowns: what adds up to the diagonal, taken
    without sign, since stiffness and inertia may cancel there."""
    pattern, fixed = model.pattern, model.fixed
    data, size = fixed.data.copy(), fixed.size.copy()
    for each in fixed.varying:
        factor = complex(np.asarray(each.block.medium.coefficients(np.array([omega]))[each.name]).ravel()[0])
        data.real[each.places] += factor.real * each.real
        data.imag[each.places] += factor.imag * each.imaginary
        size += abs(factor) * each.size
    matrix = sparse.csc_matrix((data, pattern.row, pattern.starts), shape=(model.size, model.size))
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
                slope = np.asarray(block.scaled(name, complex(second - first) / step)).reshape(-1, 1)
                np.add.at(result, block.unknowns, slope * (product[..., 0] + 1j * product[..., 1]))
    return result[:-1]


def solve(model: Model, frequency: float, *, further: int = 0) -> tuple[complex, Complex]:
    """Impedance (ohm, e^{-i w t}) and the unknowns (1 + further, size) at one volt; the further ones are directions in
    which they move with the frequency, from the same factors (a Krylov space of A^-1 dA/dw).

    Raises:
        NotAccurate: the relative residual is above 1e-8 after refinement.
    """
    omega = 2.0 * np.pi * frequency
    matrix, scale = system(model, omega)
    inner = _inner(model, matrix, scale)
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


def _inner(model: Model, matrix: sparse.csc_matrix, scale: Real) -> sparse.csc_matrix:
    """The scaled matrix without the live electrode."""
    last, pattern = model.size - 1, model.pattern
    kept = (pattern.row < last) & (pattern.column < last)
    row, column = pattern.row[kept], pattern.column[kept]
    starts = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=last))])
    return sparse.csc_matrix((matrix.data[kept] * scale[row] * scale[column], row, starts), shape=(last, last))


#: Media with their matrices on a basis.
Projected = Sequence[tuple[Anything, Mapping[str, Real]]]


@dataclass(frozen=True, eq=False)
class Reduced:
    """The model on a real basis (size, k), the live electrode's column first."""

    basis: Real
    blocks: Projected
    solves: int
    error: float

    def impedance(self, frequency: Real) -> Complex:
        """(n,) ohm, e^{-i w t}."""
        return impedance(self.blocks, frequency)


def impedance(blocks: Projected, frequency: Real) -> Complex:
    """Impedance (n,) of projected blocks."""
    charge, _ = response(blocks, frequency)
    return np.asarray(1.0 / (-2j * np.pi * np.asarray(frequency) * charge))


def response(blocks: Projected, frequency: Real) -> tuple[Complex, Complex]:
    """Charge (n,) at one volt and the unknowns (n, k) of projected blocks."""
    omega = 2.0 * np.pi * np.asarray(frequency)
    size = next(iter(blocks[0][1].values())).shape[0]
    constant = np.zeros((size, size), dtype=complex)
    factors, parts = [], []
    for medium, projected in blocks:
        values = medium.coefficients(omega)
        for key, matrix in projected.items():
            factor = coefficient(values, key)
            if np.ndim(factor) == 0:
                constant += factor * matrix
            else:
                factors.append(factor)
                parts.append(matrix.ravel())
    varying, flat = np.array(factors).T, np.array(parts)
    total = constant + (varying.real @ flat + 1j * (varying.imag @ flat)).reshape(omega.size, size, size)
    inner, right = total[:, 1:, 1:], total[:, 1:, :1]
    y = -np.linalg.solve(inner, right)[:, :, 0]
    charge = -(total[:, 0, 0] + (right[:, :, 0] * y).sum(axis=1))
    return charge, np.concatenate([np.ones((omega.size, 1)), y], axis=1)


#: What the keys of projected matrices end with that go with the real or the imaginary part of a coefficient.
REAL, IMAGINARY = ".real", ".imag"


def coefficient(values: Coefficients, key: str) -> Any:
    """The coefficient that goes with a projected matrix."""
    if key.endswith(REAL):
        return np.real(values[key.removesuffix(REAL)]) + 0j
    if key.endswith(IMAGINARY):
        return 1j * np.imag(values[key.removesuffix(IMAGINARY)])
    return values[key]


def project(block: Block, basis: Real) -> dict[str, Real]:
    """The matrices of a block on a basis; where it is not homogeneous those of both parts of a coefficient."""
    return _between(block, basis, basis)


def _between(block: Block, left: Real, right: Real) -> dict[str, Real]:
    """The matrices of a block from one basis (size, k) to another (size, l): (k, l)."""
    first, local = (np.vstack([each, np.zeros((1, each.shape[1]))])[block.unknowns] for each in (left, right))
    flat = first.reshape(-1, left.shape[1])
    shape = flat.shape[0], right.shape[1]
    found = {}
    for name, matrix in block.matrices.items():
        image = np.matmul(matrix, local)
        if block.field is None:
            found[name] = flat.T @ image.reshape(shape)
        else:
            for key, scale in zip((REAL, IMAGINARY), scales(name, block.field), strict=True):
                found[name + key] = flat.T @ (scale[:, None, None] * image).reshape(shape)
    return found


def _grown(block: Block, projected: Mapping[str, Real], basis: Real, fresh: Real) -> dict[str, Real]:
    """Projected matrices of a block when `fresh` columns are added to a basis."""
    known = basis.shape[1]
    found = {}
    for key, added in _between(block, np.concatenate([basis, fresh], axis=1), fresh).items():
        before = projected.get(key, np.zeros((known, known)))
        found[key] = np.block([[before, added[:known]], [added[:known].T, added[known:]]])
    return found


def reduce(model: Model, frequency: Real, *, tolerance: float = 1e-5, limit: int = 40,
           known: Real | None = None) -> Reduced:
    """A reduced model whose last new solution changed Z by less than `tolerance` everywhere, and that a full solve
    confirms where it changed most. `known` is the basis of a similar model of the same unknowns to start from.

    Raises:
        NotAccurate: not after `limit` full solves.
    """
    low, high = float(frequency[0]), float(frequency[-1])
    # Resonances are wider than the distance of so many.
    probes = frequency[:: max(1, frequency.size // PROBES)]
    start, more = (START, FURTHER) if known is None else (2, 1)
    asked = list(np.linspace(low, high, start))
    weight = system(model, np.pi * (low + high))[1]
    basis = np.eye(model.size, 1, k=1 - model.size)
    blocks = [(block, _between(block, basis, basis)) for block in model.blocks]
    fresh = [*([] if known is None else [known[:-1, 1:]]),
             *(_columns(solve(model, f, further=more)[1]) for f in asked)]
    previous, change = np.zeros(probes.size, dtype=complex), np.full(probes.size, np.inf)
    while True:
        added = _fresh(basis, np.concatenate(fresh, axis=1), weight)
        blocks = [(block, _grown(block, projected, basis, added)) for block, projected in blocks]
        basis = np.concatenate([basis, added], axis=1)
        reduced = tuple((block.medium, projected) for block, projected in blocks)
        found = impedance(reduced, probes)
        if len(asked) > start:
            change = np.abs(np.log(found / previous))
        candidate = float(probes[int(np.argmax(change))])
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
        fresh, previous = [_columns(state)], found


def _columns(states: Complex) -> Real:
    """Real columns (size - 1, 2 k) of solutions (k, size)."""
    return np.concatenate([states.real.T, states.imag.T], axis=1)[:-1]


def _fresh(basis: Real, columns: Real, weight: Real) -> Real:
    """What columns (size - 1, k) add to a basis, orthonormal in scaled unknowns."""
    old = basis[:-1, 1:] / weight[:, None]
    new = columns / weight[:, None]
    new = new / np.linalg.norm(new, axis=0)
    # Once more, for what rounding leaves of the first.
    for _ in range(2):
        new = new - old @ (old.T @ new)
    left, singular, _ = np.linalg.svd(new, full_matrices=False)
    left = left[:, singular > 1e-10 * np.sqrt(columns.shape[1])]
    left = left - old @ (old.T @ left)
    return np.vstack([left / np.linalg.norm(left, axis=0) * weight[:, None], np.zeros((1, left.shape[1]))])


def spectrum(body: Body, frequency: Real, *, order: int = 5, per_wavelength: float | None = None,
             tolerance: float = 1e-5) -> Complex:
    """Impedance (n,) of a body, e^{+j w t}."""
    cells = grid(body, float(frequency[-1]), per_wavelength=per_wavelength)
    model = assemble(body, cells, order=order)
    return np.conj(reduce(model, frequency, tolerance=tolerance).impedance(frequency))
