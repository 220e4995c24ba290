"""A rigid mass on a round patch of a disc, beside its axis: finite elements in the section, splines in the angle.

A mass acts on the mean displacement of its patch, away from the axis and upwards, with the force w^2 m of each. With
the compliance G of the disc under such forces, the sum over all discrete orders, and the mean displacement y of the
driven disc, the charge changes by -y^T D (1 + G D)^-1 y, D = -w^2 m, all e^{-i w t}.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from concealed.angle import Angle
from concealed.elements import UNKNOWNS, line, matrices
from concealed.fields import Inhomogeneity, scales
from concealed.media import Piezo
from concealed.section import SAME, Body, Grid
from concealed.solver import PIVOT, NotAccurate, node_positions, on_electrode
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

FIELDS = UNKNOWNS["turning"]

#: Unit (V) of the potential beside metres: entries of the matrices have one size.
POTENTIAL = 4e9

#: Gauss points along the radius in a cell.
POINTS = 16

#: Last change of a response by more vectors, relative to its largest. Losses, which the vectors do not have, are
#: followed slowly: at this one the error is 1e-4.
TOLERANCE = 3e-4

#: Blocks of a basis before it is checked, and most of them.
BLOCKS, MOST_BLOCKS = 4, 60


@dataclass(frozen=True)
class Patch:
    """A round patch on the upper face, its centre a ``distance`` from the axis (m)."""

    distance: float
    diameter: float

    def points(self, lines: Real) -> tuple[Real, Real, Real]:
        """Radii (m), weights (m) and halves of the angle (rad) of the circles about the axis within the patch, (n,),
        in cells between lines."""
        radius = 0.5 * self.diameter
        near, far = abs(self.distance - radius), self.distance + radius
        nodes, weights = leggauss(POINTS)
        inner = np.unique(np.clip(lines, 0.0, max(radius - self.distance, 0.0)))
        # The chord of a circle has a root at both of its ends: r = middle + half sin(s) removes it.
        outer = np.arcsin(np.clip((np.unique(np.clip(lines, near, far)) - 0.5 * (far + near)) * 2.0 / (far - near),
                                  -1.0, 1.0))
        r, s = (each[:-1, None] + 0.5 * np.diff(each)[:, None] * (1.0 + nodes) for each in (inner, outer))
        by_r, by_s = (0.5 * np.diff(each)[:, None] * weights for each in (inner, outer))
        chord = 0.5 * (far + near) + 0.5 * (far - near) * np.sin(s)
        r = np.concatenate([r.ravel(), chord.ravel()])
        weight = np.concatenate([by_r.ravel(), (by_s * 0.5 * (far - near) * np.cos(s)).ravel()])
        cosine = (r**2 + self.distance**2 - radius**2) / np.maximum(2.0 * r * self.distance, SAME**2)
        return r, weight, np.arccos(np.clip(cosine, -1.0, 1.0))


@dataclass(frozen=True, eq=False)
class Section:
    """Matrices of a disc on all nodes, FIELDS after FIELDS: ``stiffness`` by the power of the order, ``mass``, which
    nodes are on the ``axis``, the ``live`` and the ``ground`` electrode, (nodes,), and where the nodes are along r and
    z (m)."""

    stiffness: tuple[sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix]
    mass: sparse.csc_matrix
    axis: NDArray[np.bool_]
    live: NDArray[np.bool_]
    ground: NDArray[np.bool_]
    lines: Real
    order: int

    @classmethod
    def of(cls, body: Body, cells: Grid, order: int, uneven: Inhomogeneity | None) -> Section:
        """That of a body of ceramic alone."""
        r, z = node_positions(cells.r, order), node_positions(cells.z, order)
        size = r.size * z.size
        at_r, at_z = (each.ravel() for each in body.warped(r, z))
        data: dict[str, list[Complex]] = {power: [] for power in ("", "m", "mm", "mass")}
        places = []
        a, b = np.repeat(np.arange(order + 1), order + 1), np.tile(np.arange(order + 1), order + 1)
        for index, medium in enumerate(cells.media):
            if not isinstance(medium, Piezo):
                raise TypeError(f"received {medium!r}; expected a ceramic")
            i, j = np.nonzero(cells.fill == index)
            nodes = (i[:, None] * order + a) * z.size + j[:, None] * order + b
            unknowns = np.concatenate([nodes + size * k for k in range(len(FIELDS))], axis=1)
            places.append((np.repeat(unknowns, unknowns.shape[1], axis=1).ravel(),
                           np.tile(unknowns, unknowns.shape[1]).ravel()))
            known = medium.coefficients(np.ones(1))
            constants = {**known, "c66": 0.5 * (known["c11"] - known["c12"])}
            field = None if uneven is None else uneven.values(body, cells, i, j)
            total = {power: np.zeros((i.size, unknowns.shape[1], unknowns.shape[1]), dtype=complex) for power in data}
            for key, matrix in matrices("turning", order, at_r[nodes], at_z[nodes]).items():
                name, _, power = key.partition(" ")
                value = complex(np.asarray(constants[name]).ravel()[0])
                real, imaginary = (1.0, 1.0) if field is None else (each[:, None, None] for each in scales(name, field))
                total["mass" if name == "density" else power] += (value.real * real + 1j * value.imag * imaginary
                                                                  ) * matrix
            for power, each in total.items():
                data[power].append(each.ravel())
        row, column = (np.concatenate(each) for each in zip(*places, strict=True))
        whole = {power: sparse.coo_matrix((np.concatenate(each), (row, column)),
                                          shape=2 * (size * len(FIELDS),)).tocsc() for power, each in data.items()}
        axis = np.broadcast_to((r < SAME)[:, None], (r.size, z.size)).ravel()
        return cls((whole[""], whole["m"], whole["mm"]), -whole["mass"], axis,
                   on_electrode(body.live, r, z).ravel(), on_electrode(body.ground, r, z).ravel(), cells.r, order)

    def unknowns(self, order: int) -> sparse.csc_matrix:
        """Values of the nodes by the unknowns of an order, none of them on the electrodes."""
        kept = np.ones((len(FIELDS), self.axis.size), dtype=bool)
        u_r, u_z, phi, u_s = range(len(FIELDS))
        kept[phi, self.live | self.ground] = False
        kept[u_r, self.axis] = order == 1
        kept[u_s, self.axis] = False
        if order == 0:
            # Torsion is not driven.
            kept[u_s] = False
        else:
            kept[u_z, self.axis] = kept[phi, self.axis] = False
        scale = np.where(np.arange(kept.size) // self.axis.size == phi, POTENTIAL, 1.0)
        found = sparse.diags(scale).tolil()
        if order == 1:
            # A shift: u_r ~ cos t, u_s ~ -sin t.
            on_axis = np.flatnonzero(self.axis)
            found[u_s * self.axis.size + on_axis, on_axis] = -1.0
        return found.tocsc()[:, kept.ravel()]

    def voltage(self) -> Real:
        """Values of the nodes at one volt on the live electrode."""
        found = np.zeros((len(FIELDS), self.axis.size))
        found[FIELDS.index("phi"), self.live] = 1.0
        return found.ravel()

    def patch(self, patch: Patch, angle: Angle) -> Real:
        """The mean displacement of a patch away from the axis and upwards, by order and nodes: (orders, nodes, 2)."""
        radius, weight, halves = patch.points(self.lines)
        cell = np.clip(np.searchsorted(self.lines, radius) - 1, 0, self.lines.size - 2)
        inside = 2.0 * (radius - self.lines[cell]) / np.diff(self.lines)[cell] - 1.0
        values = legvander(inside, self.order) @ np.linalg.inv(legvander(line(self.order, 1).nodes, self.order))
        along = np.zeros((radius.size, (self.lines.size - 1) * self.order + 1))
        np.put_along_axis(along, cell[:, None] * self.order + np.arange(self.order + 1), values, axis=1)
        area = 0.25 * np.pi * patch.diameter**2
        around = np.array([angle.within(half) for half in halves.tolist()])
        up, across, turned = np.einsum("qkm,qr->kmr", around, along * (weight * radius / area)[:, None])
        found = np.zeros((angle.orders.size, len(FIELDS), along.shape[1], self.axis.size // along.shape[1], 2))
        # The upper face has the last nodes along z.
        found[:, FIELDS.index("ur"), :, -1, 0] = across
        found[:, FIELDS.index("us"), :, -1, 0] = -turned
        found[:, FIELDS.index("uz"), :, -1, 1] = up
        return found.reshape(angle.orders.size, -1, 2)


@dataclass(frozen=True, eq=False)
class Poles:
    """loads^T A(w)^-1 loads on a basis: sum of left * right / (1 - (w^2 - shift) * values)."""

    shift: float
    values: Complex
    left: Complex
    right: Complex

    def __call__(self, frequency: Real) -> Complex:
        """(n, k, k) at frequencies (n,) Hz."""
        away = 1.0 - ((2.0 * np.pi * frequency) ** 2 - self.shift)[:, None] * self.values
        return np.asarray((self.left / away[:, None, :]) @ self.right)


def poles(stiffness: sparse.csc_matrix, mass: sparse.csc_matrix, loads: Complex, band: Real, tolerance: float) -> Poles:
    """The response of K - w^2 M to loads (size, k), by a Krylov space of the disc without losses.

    Raises:
        NotAccurate: not settled after `MOST_BLOCKS`.
    """
    shift = float(np.mean((2.0 * np.pi * band[[0, -1]]) ** 2))
    shifted = stiffness - shift * mass
    halves = [getattr(each, part).copy() for each in (shifted, mass) for part in ("real", "imag")]
    factor = splu(halves[0].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=PIVOT,
                  options={"SymmetricMode": True})
    fresh, basis = factor.solve(np.ascontiguousarray(loads.real)), np.zeros((loads.shape[0], 0))
    projected = np.zeros((len(halves), 0, 0))
    before: Complex | None = None
    probes = np.linspace(band[0], band[-1], 40)
    for block in range(1, MOST_BLOCKS + 1):
        fresh /= np.linalg.norm(fresh, axis=0)
        for _ in range(2):
            fresh = fresh - basis @ (basis.T @ fresh)
        fresh = np.linalg.qr(fresh)[0]
        images = [each @ fresh for each in halves]
        off, own = (np.array([each.T @ image for image in images]) for each in (basis, fresh))
        projected = np.block([[projected, off], [off.swapaxes(1, 2), own]])
        basis = np.hstack([basis, fresh])
        if block % BLOCKS == 0:
            on_basis = basis.T @ loads
            small, heavy = projected[0] + 1j * projected[1], projected[2] + 1j * projected[3]
            values, vectors = linalg.eig(linalg.solve(small, heavy))
            found = Poles(shift, values, on_basis.T @ vectors, linalg.solve(vectors, linalg.solve(small, on_basis)))
            now = found(probes)
            size = np.sqrt(np.abs(np.einsum("nii->ni", now)).max(axis=0))
            if before is not None and (np.abs(now - before) / np.outer(size, size)).max() < tolerance:
                return found
            before = now
        fresh = factor.solve(images[2])
    raise NotAccurate(f"a response is not settled to {tolerance:.0e} in {MOST_BLOCKS} blocks")


@dataclass(frozen=True, eq=False)
class PatchedDisc:
    """A disc by its responses: ``capacitance`` of the live electrode where nothing moves, ``driven`` under a voltage
    and both forces of order 0, ``further`` ones with the weight of their order."""

    capacitance: complex
    driven: Poles
    further: Sequence[tuple[float, Poles]]

    @classmethod
    def of(cls, body: Body, cells: Grid, patch: Patch, angle: Angle, band: Real, *, order: int,
           uneven: Inhomogeneity | None = None, tolerance: float = TOLERANCE) -> PatchedDisc:
        """That of a body of ceramic on its grid, for the band (n,) Hz."""
        section = Section.of(body, cells, order, uneven)
        forms, voltage = section.patch(patch, angle), section.voltage()
        driven, further = None, []
        for number, (square, first, second) in enumerate(zip(*angle.factors, strict=True)):
            if number < 3:
                free = section.unknowns(number)
                parts = [(free.T @ each @ free).tocsc() for each in (*section.stiffness, section.mass)]
            stiffness, loads = parts[0] + first * parts[1] + second * parts[2], free.T @ forms[number]
            if number == 0:
                electric = free.T @ (section.stiffness[0] @ voltage)
                driven = poles(parts[0], parts[3], np.column_stack([electric, loads]), band, tolerance)
            else:
                further.append((2.0 / square, poles(stiffness.tocsc(), parts[3], loads, band, tolerance)))
        assert driven is not None
        return cls(complex(voltage @ (section.stiffness[0] @ voltage)), driven, further)

    def impedance_ratio(self, frequency: Real, mass: float) -> Complex:
        """Impedance (n,) with a mass (kg) on the patch over that without it, e^{-i w t}."""
        order_0 = self.driven(frequency)
        charge, moved = order_0[:, 0, 0] - self.capacitance, order_0[:, 1:, 0]
        total = order_0[:, 1:, 1:] + sum(weight * each(frequency) for weight, each in self.further)
        stiffness = (-mass * (2.0 * np.pi * frequency) ** 2)[:, None, None]
        force = np.linalg.solve(np.eye(2) + stiffness * total, stiffness * moved[:, :, None])[:, :, 0]
        return np.asarray(1.0 / (1.0 - (moved * force).sum(axis=1) / charge))
