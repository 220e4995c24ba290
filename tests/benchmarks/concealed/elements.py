"""Matrices of tensor-product elements of any order on cells of the (r, z) plane, curved or not, weight 2 pi r dr dz.

Gauss-Lobatto nodes, Gauss quadrature; everything (cells, ...) at once. A node of a cell is counted with the one along
z running fastest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Real = NDArray[np.float64]

#: Symmetric forms by the kind of the medium: coefficient -> (weight, operator, operator), each form the sum of
#: weight * row * column, symmetrised.
FORMS: Mapping[str, Mapping[str, tuple[tuple[float, str, str], ...]]] = {
    "solid": {
        "c11": ((1.0, "rr", "rr"), (1.0, "tt", "tt")),
        "c12": ((2.0, "rr", "tt"),),
        "c13": ((2.0, "rr", "zz"), (2.0, "tt", "zz")),
        "c33": ((1.0, "zz", "zz"),),
        "c44": ((1.0, "rz", "rz"),),
        "density": ((1.0, "ur", "ur"), (1.0, "uz", "uz")),
    },
    "liquid": {"inertia": ((1.0, "pr", "pr"), (1.0, "pz", "pz")), "compressibility": ((1.0, "p", "p"),)},
    "viscous": {
        "shear": ((2.0, "rr", "rr"), (2.0, "tt", "tt"), (2.0, "zz", "zz"), (1.0, "rz", "rz"),
                  (-2.0 / 3.0, "div", "div")),
        "dilatation": ((2.0, "q", "div"),),
        "compressibility": ((1.0, "q", "q"),),
        "density": ((1.0, "ur", "ur"), (1.0, "uz", "uz")),
    },
}
_PIEZO = {
    "e31": ((2.0, "rr", "fz"), (2.0, "tt", "fz")),
    "e33": ((2.0, "zz", "fz"),),
    "e15": ((2.0, "rz", "fr"),),
    "eps11": ((1.0, "fr", "fr"),),
    "eps33": ((1.0, "fz", "fz"),),
}
#: A ceramic that varies around the axis, u_s along the circumference. An m behind a coefficient is a factor of the
#: order m of a field, in e_tt = (u_r + m u_s) / r and the like.
_TURNING = {
    **_PIEZO,
    "c11": ((1.0, "rr", "rr"), (1.0, "tt", "tt")), "c11 m": ((2.0, "tt", "ss"),), "c11 mm": ((1.0, "ss", "ss"),),
    "c12": ((2.0, "rr", "tt"),), "c12 m": ((2.0, "rr", "ss"),),
    "c13": ((2.0, "rr", "zz"), (2.0, "tt", "zz")), "c13 m": ((2.0, "ss", "zz"),),
    "c33": ((1.0, "zz", "zz"),),
    "c44": ((1.0, "rz", "rz"), (1.0, "sz", "sz")), "c44 m": ((-2.0, "sz", "uz/r"),), "c44 mm": ((1.0, "uz/r", "uz/r"),),
    "c66": ((1.0, "rs", "rs"),), "c66 m": ((-2.0, "rs", "tt"),), "c66 mm": ((1.0, "tt", "tt"),),
    "density": ((1.0, "ur", "ur"), (1.0, "uz", "uz"), (1.0, "us", "us")),
    "e31 m": ((2.0, "ss", "fz"),), "e15 m": ((-2.0, "sz", "phi/r"),), "e15 mm": ((2.0, "uz/r", "phi/r"),),
    "eps11 mm": ((1.0, "phi/r", "phi/r"),),
}
FORMS = {**FORMS, "piezo": {**FORMS["solid"], **_PIEZO}, "turning": _TURNING}

#: The unknowns of each kind, in the order of the columns of its matrices.
UNKNOWNS: Mapping[str, tuple[str, ...]] = {
    "solid": ("ur", "uz"), "piezo": ("ur", "uz", "phi"), "liquid": ("p",), "viscous": ("ur", "uz", "q"),
    "turning": ("ur", "uz", "phi", "us"),
}


@dataclass(frozen=True, eq=False)
class Line:
    """Lagrange functions on the Gauss-Lobatto nodes of [-1, 1] at quadrature points: value, slope (points, nodes)."""

    nodes: Real
    points: Real
    weights: Real
    value: Real
    slope: Real


@lru_cache
def line(order: int, points: int) -> Line:
    """Functions of that order at that many Gauss points."""
    inner = legendre.legroots(legendre.legder([0.0] * order + [1.0]))
    nodes = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    at, weights = legendre.leggauss(points)
    inverse = np.linalg.inv(legendre.legvander(nodes, order))
    slopes = np.stack([legendre.legval(at, legendre.legder(np.eye(order + 1)[k])) for k in range(order + 1)], axis=1)
    return Line(nodes, at, weights, legendre.legvander(at, order) @ inverse, slopes @ inverse)


def matrices(kind: str, order: int, r_nodes: Real, z_nodes: Real) -> dict[str, Real]:
    """(cells, k, k) matrix of every form of `kind` on cells with nodes at `r_nodes`, `z_nodes` (cells, nodes) m."""
    along = line(order, order + 2)
    value = np.einsum("ai,bj->abij", along.value, along.value).reshape(along.points.size**2, -1)
    by_r = np.einsum("ai,bj->abij", along.slope, along.value).reshape(value.shape)
    by_z = np.einsum("ai,bj->abij", along.value, along.slope).reshape(value.shape)
    r = r_nodes @ value.T
    (r_first, r_second), (z_first, z_second) = ([each @ by.T for by in (by_r, by_z)] for each in (r_nodes, z_nodes))
    area = r_first * z_second - r_second * z_first
    if area.min() <= 0.0:
        raise ValueError("a cell is folded")
    weight = np.outer(along.weights, along.weights).ravel() * 2.0 * np.pi * r * area
    cells, nodes = r_nodes.shape
    first_r, second_r, first_z, second_z = (
        (each / area)[:, :, None] for each in (z_second, -z_first, -r_second, r_first))
    d_r, d_z = first_r * by_r + second_r * by_z, first_z * by_r + second_z * by_z
    over_r = value / r[:, :, None]
    plain = np.broadcast_to(value, (cells, *value.shape))
    one = {
        "ur": {"ur": plain}, "uz": {"uz": plain}, "rr": {"ur": d_r}, "tt": {"ur": over_r}, "zz": {"uz": d_z},
        "rz": {"ur": d_z, "uz": d_r}, "div": {"ur": d_r + over_r, "uz": d_z}, "fr": {"phi": d_r}, "fz": {"phi": d_z},
        "p": {"p": plain}, "pr": {"p": d_r}, "pz": {"p": d_z},
        "us": {"us": plain}, "ss": {"us": over_r}, "sz": {"us": d_z}, "rs": {"us": d_r - over_r},
        "uz/r": {"uz": over_r}, "phi/r": {"phi": over_r},
    }
    sizes = dict.fromkeys(UNKNOWNS[kind], nodes)
    if kind == "viscous":
        lower = line(order - 1, order + 2).value
        flat = np.einsum("ai,bj->abij", lower, lower).reshape(value.shape[0], -1)
        one["q"] = {"q": np.broadcast_to(flat, (cells, *flat.shape))}
        sizes["q"] = flat.shape[1]
    start = dict(zip(sizes, np.cumsum([0, *sizes.values()])[:-1], strict=True))
    total = sum(sizes.values())
    found = {}
    for name, products in FORMS[kind].items():
        matrix = np.zeros((cells, total, total))
        for factor, row, column in products:
            for a, left in one[row].items():
                for b, right in one[column].items():
                    block = np.matmul(np.swapaxes(left * (factor * weight)[:, :, None], 1, 2), right)
                    rows, columns = slice(start[a], start[a] + sizes[a]), slice(start[b], start[b] + sizes[b])
                    matrix[:, rows, columns] += 0.5 * block
                    matrix[:, columns, rows] += 0.5 * np.swapaxes(block, 1, 2)
        found[name] = matrix
    return found


def edge_matrices(order: int, traces: int, r_nodes: Real, z_nodes: Real) -> tuple[Real, Real, Real]:
    """(edges, traces + 1, traces + 1) integrals of products of two traces with 2 pi r over edges whose nodes of `order`
    are at `r_nodes`, `z_nodes` (edges, order + 1) m: by dr, by dz and by ds along them."""
    along = line(order, order + 2)
    value = line(traces, order + 2).value
    slopes = [each @ along.slope.T for each in (r_nodes, z_nodes)]
    measures = (*slopes, np.hypot(*slopes))
    r = 2.0 * np.pi * (r_nodes @ along.value.T) * along.weights
    by_dr, by_dz, by_ds = (np.einsum("eq,qi,qj->eij", r * each, value, value) for each in measures)
    return by_dr, by_dz, by_ds
