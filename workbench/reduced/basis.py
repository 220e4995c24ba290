"""The basis of a reduced model: real energy-orthonormal vectors and a lift.

The lift is the last vector and the only one with a voltage at the electrode, 1 V. Energy is the matrix R of
`workbench.reduced.estimate`.

All strategies share one truncation, the proper orthogonal decomposition of states over the roots of their charges in
the energy norm: the relative error of the charge, and so of Z, is at most the energy of the omitted part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A vector whose relative part outside the others is smaller than this is rounding.
DEPENDENT = 1e-9

#: Squared sizes below this times the largest are rounding, as sums of products.
ROUNDING = 1e-14


def smallest_part(tolerance: float) -> float:
    """Truncation threshold for an error of Z. It is in the root of energy over charge."""
    return float(np.sqrt(tolerance))


def without_lift(vectors: NDArray[np.inexact], lift: Real) -> Real:
    """Real and imaginary parts (size - 1, k) without the lift. The `vectors` are (size, n), the `lift` (size,). The
    zero row of the electrode and zero parts are omitted."""
    is_lifted = vectors[-1] != 0.0
    parts = [part for part in ((vectors.real, vectors.imag) if np.iscomplexobj(vectors) else (vectors,)) if part.any()]
    found = np.empty((len(vectors) - 1, len(parts) * vectors.shape[1]))
    for apart, part in zip(np.split(found, max(len(parts), 1), axis=1), parts, strict=False):
        apart[:] = part[:-1]
        apart[:, is_lifted] -= np.outer(lift[:-1], part[-1, is_lifted])
    return found


def truncated(
    vectors: Real, energy: sparse.csr_matrix, smallest: float, basis: Real, seen: Real
) -> tuple[Real, Real]:
    """Directions (m, k) of `vectors` outside a basis, and sizes (k,).

    Sizes are in the root of the energy and above `smallest`. The directions have unit energy and are orthogonal in
    `energy` (m, m) to each other and to `basis` (m, r), which is orthonormal; `seen` (m, r) is energy times the basis.
    """
    images = energy @ vectors
    large = np.sum(vectors * images, axis=0) > smallest**2
    parts, images = vectors[:, large], images[:, large]
    # The second pass removes cancellation errors.
    for _ in range(2):
        along = basis.T @ images
        parts, images = parts - basis @ along, images - seen @ along
    squares, directions = np.linalg.eigh(parts.T @ images)
    kept = squares > max(smallest**2, ROUNDING * squares.max(initial=0.0))
    sizes = np.sqrt(squares[kept])
    found = parts @ (directions[:, kept] / sizes)
    found = found - basis @ (seen.T @ found)
    return _orthonormal(found, found.T @ (energy @ found)), sizes


def truncated_coordinates(vectors: Real, energy: Real, smallest: float) -> tuple[Real, Real]:
    """:func:`truncated` for `vectors` (m, n) in coordinates. The few coordinates have the dense `energy` (m, m). Sizes
    ascend."""
    root = np.linalg.cholesky(energy)
    directions, sizes, _ = np.linalg.svd(root.T @ vectors, full_matrices=False)
    kept = np.flatnonzero(sizes > smallest)[::-1]
    return np.linalg.solve(root.T, directions[:, kept]), sizes[kept]


def _orthonormal(vectors: Real, energy: Real) -> Real:
    """Energy-orthonormal combinations of `vectors` (m, k). Their `energy` (k, k) is close to one."""
    return np.linalg.solve(np.linalg.cholesky(energy), vectors.T).T


def span(vectors: Real, energy: sparse.csr_matrix, basis: Real) -> Real:
    """Independent vectors (m, k) that span `vectors` outside a `basis`.

    `vectors` are (m, n), `basis` (m, r). Small directions are included. They are almost orthonormal in the norm of the
    energy's diagonal, in which small differences of vectors are exact.
    """
    if basis.shape[1]:
        seen = energy @ basis
        for _ in range(2):
            vectors = vectors - basis @ (seen.T @ vectors)
    weights = np.sqrt(energy.diagonal())[:, None]
    weighted = weights * vectors
    # Products are many times as fast as a QR decomposition of long columns. They lose small directions to rounding;
    # these are recovered after the large ones are removed.
    products = weighted.T @ weighted
    length = np.sqrt(np.diag(products))
    unit = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 0.0)
    squares, directions = np.linalg.eigh(unit[:, None] * products * unit)
    large = squares > 1e-12 * squares.max(initial=0.0)
    directions *= unit[:, None]
    found, rest = weighted @ (directions[:, large] / np.sqrt(squares[large])), weighted @ directions[:, ~large]
    for _ in range(2):
        rest -= found @ (found.T @ rest)
    squares, directions = np.linalg.eigh(rest.T @ rest)
    small = squares > DEPENDENT**2
    return np.hstack([found, rest @ (directions[:, small] / np.sqrt(squares[small]))]) / weights
