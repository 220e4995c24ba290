"""The coupling of orders by a thickness that varies as cos t.

The map z -> z (1 + s r cos t / R) takes a plane disc to one with the thickness h (1 + s cos t) at its edge R. On the
plane disc, with j = 1 + s x / R and x = r cos t,

    d/dz -> 1 / j d/dz,      d/dx -> d/dx - s z / (R j) d/dz,      dV -> j dV,

so that an integral of the products a(v) a(u) changes by

    s int x / R (a(v) a(u) - a_z(v) a(u) - a(v) a_z(u)) - z / R (a_x(v) a(u) + a(v) a_x(u)) dV
    + s^2 int (x a_z(v) + z a_x(v)) (x a_z(u) + z a_x(u)) / R^2 dV + O(s^3) ,

with the part a_z of an operator that has d/dz, and a_x, the operator with d/dz in the place of d/dx and nothing else.
The first line couples every order with the next one alone. Of the second line, the part within order 0 changes a charge
by s^2 as well; that of other orders changes it by s^4.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import Basis

from geometry.names import TRANSDUCER
from workbench.fem.elements import Lagrange
from workbench.fem.operators import FullOperators
from workbench.fem.places import Place
from workbench.physics.orders import products_of_orders
from workbench.physics.term import OPERATORS, Integral, ModelError, by_order

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Primitive parts of operators, (component, operation), by their place in a vector.
_PARTS = {part: k for k, part in enumerate(
    (component, kind) for component in ("u_r", "u_z", "u_s", "phi") for kind in ("value", "d_r", "d_z", "over_r"))}

#: Operators with d/dz in the place of d/dx: for every component the factor of its derivative, and that which changes
#: sign with the order that receives, the next (1) or the previous one (-1).
_TILTED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "strain_rr": {"u_r": (1.0, 0.0)}, "strain_tt": {"u_s": (0.0, 1.0)},
    "strain_plane": {"u_r": (1.0, 0.0), "u_s": (0.0, 1.0)}, "strain_rs": {"u_s": (1.0, 0.0), "u_r": (0.0, -1.0)},
    "strain_rz": {"u_z": (1.0, 0.0)}, "strain_sz": {"u_z": (0.0, -1.0)},
    "grad_phi_r": {"phi": (1.0, 0.0)}, "grad_phi_s": {"phi": (0.0, -1.0)},
    **{name: {} for name in ("strain_zz", "grad_phi_z", "u_r", "u_z", "u_s")},
}


@dataclass(frozen=True, eq=False)
class TaperForms:
    """Forms of fields of two orders in a disc with a taper.

    ``left`` and ``right`` (16 points, size) evaluate the primitive parts of the fields. Each of the integrals is a sum
    of products of parts, ``sums`` (q, 16, 16), for every one of the ``densities`` (points,).
    """

    left: sparse.csr_array
    right: sparse.csr_array
    densities: tuple[Real, ...]
    sums: tuple[Real, ...]

    @classmethod
    def coupling(
        cls, lower: FullOperators, upper: FullOperators, order: int, integrals: Iterable[Integral]
    ) -> TaperForms:
        """The forms of the next order and the `order`.

        They are those for a unit s.

        Raises
        ------
        ModelError : an integral has an operator that a taper does not know.
        """
        place, across, along = _lengths(lower)
        # The mean over the angle of cos t cos m t cos (m + 1) t is a half for order 0, and a quarter for higher ones,
        # whose weights have a half already.
        weights = 0.5 * place.weights
        sums = np.array([_coupled(integral, order) for integral in integrals])
        return cls(_evaluation(upper, upper.places[TRANSDUCER]), _evaluation(lower, place),
                   ((weights * across).ravel(), (weights * along).ravel()), (sums[:, 0], sums[:, 1]))

    @classmethod
    def square(cls, operators: FullOperators, integrals: Iterable[Integral]) -> TaperForms:
        """The forms within order 0 for a unit s^2.

        Raises
        ------
        ModelError : an integral has an operator that a taper does not know.
        """
        place, across, along = _lengths(operators)
        evaluation, sums = _evaluation(operators, place), np.array([_squared(integral) for integral in integrals])
        densities = (across**2, across * along, along**2)
        return cls(evaluation, evaluation, tuple((0.5 * place.weights * each).ravel() for each in densities),
                   (sums[:, 0], sums[:, 1], sums[:, 2]))

    def projected(self, left: Real, right: Real) -> Real:
        """Matrices (q, k, l) of every integral on real bases.

        The bases are (size, k) and (size, l).
        """
        one, other = self._parts(self.left, left), self._parts(self.right, right)
        result = np.zeros((len(self.sums[0]), left.shape[1], right.shape[1]))
        for density, sums in zip(self.densities, self.sums, strict=True):
            for row, column in np.argwhere(sums.any(axis=0)):
                gram = (density[:, None] * one[:, row]).T @ other[:, column]
                for q in np.flatnonzero(sums[:, row, column]):
                    result[q] += sums[q, row, column] * gram
        return result

    def load(self, constants: Complex, states: Complex, *, upwards: bool) -> Complex:
        """The loads (size, n) of one order by states of the other.

        `constants` (q,) are the coefficients of the integrals. The states are those of the lower order if the load
        goes `upwards`.
        """
        given, taken = (self.right, self.left) if upwards else (self.left, self.right)
        parts = self._parts(given, states)
        loads = np.zeros(parts.shape, dtype=complex)
        for density, sums in zip(self.densities, self.sums, strict=True):
            summed = np.tensordot(constants, sums, axes=1)
            loads += density[:, None, None] * ((summed if upwards else summed.T) @ parts)
        return np.asarray(taken.T @ loads.reshape(-1, states.shape[1]))

    @staticmethod
    def _parts(evaluation: sparse.csr_array, states: NDArray[np.inexact]) -> NDArray[np.inexact]:
        return np.asarray(evaluation @ states).reshape(-1, len(_PARTS), states.shape[1])


def _lengths(operators: FullOperators) -> tuple[Place, Real, Real]:
    """The points of the disc, with their lengths (ne, nq).

    They are the distances from its axis and its middle plane, over its radius.
    """
    place = operators.places[TRANSDUCER]
    nodes = Basis(operators.mesh.mesh, Lagrange(operators.mesh.order)).doflocs
    heights = np.einsum("eqb,be->eq", place.shapes["value"], nodes[1][place.dofs])
    return place, place.radius / nodes[0].max(), (heights - 0.5 * (nodes[1].min() + nodes[1].max())) / nodes[0].max()


def _evaluation(operators: FullOperators, place: Place) -> sparse.csr_array:
    """The matrix (16 points, size) of primitive parts at points."""
    rows, columns, values = [], [], []
    points = len(_PARTS) * np.arange(place.weights.size).reshape(place.weights.shape)
    for (component, kind), part in _PARTS.items():
        if component not in operators.numbering:
            continue
        shapes, dofs = place.shapes[kind], place.dofs.T
        if component in operators.shares:
            shapes = shapes * operators.shares[component][dofs][:, None]
        column = np.broadcast_to(operators.numbering[component][dofs][:, None], shapes.shape)
        row, known = np.broadcast_to((points + part)[:, :, None], shapes.shape), column >= 0
        rows.append(row[known])
        columns.append(column[known])
        values.append(shapes[known])
    return sparse.csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                            shape=(len(_PARTS) * place.weights.size, operators.size))


def _is_of_disc(integral: Integral) -> bool:
    return integral.place == TRANSDUCER and not integral.on_boundary


def _coupled(integral: Integral, order: int) -> Real:
    """Sums (2, 16, 16) of products of parts of two orders.

    The next order comes first. They are those with x / R and those with z / R.
    """
    found = np.zeros((2, len(_PARTS), len(_PARTS)))
    for product in products_of_orders(integral) if _is_of_disc(integral) else ():
        # Each product of two operators is symmetric.
        for one, other in ((product.row, product.column), (product.column, product.row)):
            above, below = _parts_of(one, order + 1), _parts_of(other, order)
            found[0] += 0.5 * product.weight * (np.outer(above, below) - np.outer(_along_z(above), below)
                                                - np.outer(above, _along_z(below)))
            found[1] -= 0.5 * product.weight * (np.outer(_tilted(one, -1.0), below)
                                                + np.outer(above, _tilted(other, 1.0)))
    return found


def _squared(integral: Integral) -> Real:
    """Sums (3, 16, 16) of products of parts of order 0.

    They are those with x^2, x z and z^2 over R^2.
    """
    found = np.zeros((3, len(_PARTS), len(_PARTS)))
    for product in products_of_orders(integral) if _is_of_disc(integral) else ():
        for one, other in ((product.row, product.column), (product.column, product.row)):
            stretched, moved = ([_along_z(_parts_of(each, 0)), _tilted(each, 1.0)] for each in (one, other))
            for i, a in enumerate(stretched):
                for j, b in enumerate(moved):
                    found[i + j] += 0.5 * product.weight * np.outer(a, b)
    return found


def _parts_of(name: str, order: int) -> Real:
    """The weights (16,) of an operator at an order."""
    found = np.zeros(len(_PARTS))
    for power, part_name in by_order(name):
        for component, kind, _ in OPERATORS[part_name]:
            sign = -1.0 if kind.startswith("less_") else 1.0
            kind = "over_r" if kind.endswith("turned") else kind.removeprefix("less_")
            found[_PARTS[component, kind]] += sign * float(order) ** power
    return found


def _along_z(parts: Real) -> Real:
    """Weights (16,) without those of other parts than d/dz."""
    return parts * np.array([kind == "d_z" for _, kind in _PARTS])


def _tilted(name: str, step: float) -> Real:
    """Weights (16,) of an operator with d/dz for d/dx.

    They are for the next (`step` 1) or the previous order (-1).
    """
    if name not in _TILTED:
        raise ModelError(f"{name!r} has no form in a disc with a taper")
    found = np.zeros(len(_PARTS))
    for component, (plain, by_step) in _TILTED[name].items():
        found[_PARTS[component, "d_z"]] += plain + step * by_step
    return found
