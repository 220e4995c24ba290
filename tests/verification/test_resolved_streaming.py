"""Streaming with a slip at the walls against a viscous compressible liquid whose layers are meshed.

A round cavity with prescribed motion of its walls, along and across them and out of phase, so that every term of the
slip acts: at flat walls and at a curved one, with the circumference of a ring that changes. The resolved side solves
the linear equations of a viscous liquid without slip, and then those of the mean flow of second order, with the mean
momentum flux, the mean mass flux and the drift of the moving walls. Elements reach down to a share of the layer.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import pytest
import skfem
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import grad

from materials.kinds import Fluid
from workbench.acoustics.fields import Fields
from workbench.acoustics.nodal import gradient, interpolate, mesh_of
from workbench.acoustics.streaming import Streaming, acoustic_streaming
from workbench.fem.elements import Lagrange

RADIUS, HEIGHT, FREQUENCY = 0.9e-3, 0.6e-3, 1e6
OMEGA = 2.0 * math.pi * FREQUENCY
DENSITY, SPEED = 1000.0, 1500.0
#: Velocities of the walls in m/s: with pressures of 1 MPa the liquid's own are below 1 m/s.
ACROSS = (0.30 + 0.10j, -0.25 + 0.30j, 0.20 - 0.25j, 0.15 + 0.20j)
ALONG = (0.12 - 0.20j, 0.10 + 0.15j, -0.15 + 0.05j)

#: Length in m that the resolved side counts in, since the mesh's own maps are solved to an absolute tolerance. With
#: velocities in m/s, times are in units of it too.
UNIT = 1e-4
#: Order of the resolved velocity. The drift in the layer is 500 times as fast as the flow that is compared: with order
#: 5 on as many unknowns a tenth of the flow is error.
ORDER = 7

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

#: Parts of a form: of a function's value, its slopes along r and z, and r.
VALUE, R_SLOPE, Z_SLOPE, HOOP, SPREAD = (
    lambda u, u_r, u_z, r: u, lambda u, u_r, u_z, r: u_r, lambda u, u_r, u_z, r: u_z, lambda u, u_r, u_z, r: u / r,
    lambda u, u_r, u_z, r: u_r + u / r)


def liquid(layer: float) -> Fluid:
    """A liquid with a boundary layer of that thickness (m)."""
    viscosity = 0.5 * DENSITY * OMEGA * layer**2
    return Fluid(name="oil", density=DENSITY, sound_speed=SPEED, shear_viscosity=viscosity, bulk_viscosity=viscosity)


def wall_motion(points: Real) -> Complex:
    """Velocity (..., 2) of the walls at points (..., 2)."""
    r, z = points[..., 0] / RADIUS, points[..., 1] / HEIGHT
    along = r * (ALONG[0] + ALONG[1] * z + ALONG[2] * r**2)
    across = ACROSS[0] + ACROSS[1] * z + (ACROSS[2] + ACROSS[3] * z) * r**2
    return np.stack([along, across], axis=-1)


def towards(low: float, high: float, layer: float, coarse: int, *, both: bool) -> Real:
    """Lines from `low` to `high` that close in on the upper end, or on both."""
    near = np.cumsum([0.0, 0.4, 0.8, 1.3, 2.0, 3.2, 6.0, 12.0]) * layer
    inner = np.linspace(low + (near[-1] if both else 0.0), high - near[-1], coarse + 1)
    return np.concatenate([low + near[:-1] if both else [], inner, high - near[-2::-1]])


class Resolved:
    """The viscous liquid on a mesh that reaches into the layers: velocity of :data:`ORDER`, pressure of one less."""

    def __init__(self, fluid: Fluid, layer: float, coarse: int) -> None:
        self.fluid = fluid
        r, z = towards(0.0, RADIUS, layer, coarse, both=False), towards(0.0, HEIGHT, layer, coarse - 1, both=True)
        place = (np.arange(z.size - 1)[:, None] * r.size + np.arange(r.size - 1)).ravel()
        cells = np.stack([place, place + 1, place + r.size + 1, place + r.size])
        mesh = skfem.MeshQuad(np.stack([np.tile(r, z.size), np.repeat(z, r.size)]) / UNIT, cells)
        self.omega = OMEGA * UNIT
        assert fluid.shear_viscosity is not None
        assert fluid.bulk_viscosity is not None
        self.shear, self.bulk = fluid.shear_viscosity / UNIT, fluid.bulk_viscosity / UNIT
        self.u, self.p = (skfem.Basis(mesh, Lagrange(k), intorder=3 * ORDER + 1) for k in (ORDER, ORDER - 1))
        self._at_nodes = skfem.Basis(mesh, Lagrange(ORDER), quadrature=(Lagrange(ORDER).doflocs.T,
                                                                          np.ones((ORDER + 1)**2)))
        r, z = self.u.doflocs * UNIT
        self.wall = (r > RADIUS - 1e-12) | (z < 1e-12) | (z > HEIGHT - 1e-12)
        self.axis = r < 1e-12
        self.velocity, self.pressure = self._first_order()
        self.drifted = self._second_order()

    def _form(self, rows: skfem.Basis, columns: skfem.Basis, *products: tuple[Any, ...]) -> sparse.csr_matrix:
        """Integral over the cavity of the sum of `products`, each a factor and the parts of a row and of a column.

        A part is a function of value (n, cells, points), slopes along r and z, and r.
        """
        weight = rows.dx * rows.global_coordinates()[0]
        r = np.asarray(rows.global_coordinates()[0])

        def of(basis: skfem.Basis, part: Any) -> Real:
            own = [each[0] for each in basis.basis]
            value, slope = np.array([np.asarray(each) for each in own]), np.array([each.grad for each in own])
            return np.asarray(part(value, slope[:, 0], slope[:, 1], r)).transpose(1, 0, 2)

        cells = sum(factor * (of(rows, row) * weight[:, None]) @ of(columns, column).transpose(0, 2, 1)
                    for factor, row, column in products)
        i, j = (np.broadcast_to(each, cells.shape) for each in (
            rows.element_dofs.T[:, :, None], columns.element_dofs.T[:, None, :]))
        return sparse.coo_matrix((cells.ravel(), (i.ravel(), j.ravel())), shape=(rows.N, columns.N)).tocsr()

    @cached_property
    def _operators(self) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """The viscous stress on (u_r, u_z), and the divergence tested by the pressure."""
        eta, u = self.shear, self.u
        second = self.bulk - 2.0 * eta / 3.0
        rr = self._form(u, u, (2.0 * eta, R_SLOPE, R_SLOPE), (2.0 * eta, HOOP, HOOP), (eta, Z_SLOPE, Z_SLOPE),
                        (second, SPREAD, SPREAD))
        zz = self._form(u, u, (2.0 * eta + second, Z_SLOPE, Z_SLOPE), (eta, R_SLOPE, R_SLOPE))
        rz = self._form(u, u, (eta, Z_SLOPE, R_SLOPE), (second, SPREAD, Z_SLOPE))
        divergence = sparse.hstack([self._form(self.p, u, (1.0, VALUE, part)) for part in (SPREAD, Z_SLOPE)])
        return sparse.bmat([[rr, rz], [rz.T, zz]]).tocsr(), divergence.tocsr()

    def _solved(self, matrix: sparse.csr_matrix, load: Complex, held: NDArray[np.bool_], values: Complex) -> Complex:
        free = np.flatnonzero(~held)
        x = np.where(held, values, 0.0).astype(load.dtype)
        right = load - matrix @ x
        inside = matrix[free][:, free]
        scale = sparse.diags(1.0 / np.sqrt(np.asarray(abs(inside).max(axis=0).todense()).ravel()))
        factor = splu((scale @ inside @ scale).tocsc())
        found = np.zeros(free.size, dtype=load.dtype)
        for _ in range(3):
            found = found + scale @ factor.solve(scale @ (right[free] - inside @ found))
        x[free] = found
        return x

    def _first_order(self) -> tuple[Complex, Complex]:
        viscous, divergence = self._operators
        mass, squares = (self._form(each, each, (1.0, VALUE, VALUE)) for each in (self.u, self.p))
        matrix = sparse.bmat([[viscous - 1j * self.omega * DENSITY * sparse.block_diag([mass, mass]), -divergence.T],
                              [-divergence, 1j * self.omega / (DENSITY * SPEED**2) * squares]]).tocsr()
        prescribed = wall_motion(self.u.doflocs.T * UNIT).T
        held = np.concatenate([self.wall | self.axis, self.wall, np.zeros(self.p.N, dtype=bool)])
        values = np.concatenate([np.where(self.axis, 0.0, prescribed[0]), prescribed[1], np.zeros(self.p.N)])
        x = self._solved(matrix, np.zeros(held.size, dtype=complex), held, values)
        return x[:2 * self.u.N].reshape(2, -1), x[2 * self.u.N:]

    def _drift(self) -> Real:
        """<s.grad v> (2, N) at the nodes."""
        slope = np.zeros((2, 2, self.u.N), dtype=complex)
        times = np.bincount(self.u.element_dofs.T.ravel(), minlength=self.u.N)
        for i, component in enumerate(self.velocity):
            for axis, part in enumerate(self._at_nodes.interpolate(component).grad):
                np.add.at(slope[axis, i], self.u.element_dofs.T.ravel(), np.asarray(part).ravel())
        return np.asarray(np.einsum("jn,jin->in", self.velocity.conj(), slope / times).imag / (2.0 * self.omega))

    def _second_order(self) -> Real:
        """The mean velocity of the liquid itself, flow plus drift (2, N)."""
        viscous, divergence = self._operators
        v = [np.asarray(self.u.interpolate(component)) for component in self.velocity]
        # The pressure of the mean flow is little more than that of the sound alone, -potential. What the elements leave
        # of it would drive a flow, so that it is taken off exactly.
        parts = [self.p.interpolate(part) for part in (self.pressure.real, self.pressure.imag)]
        potential = sum(0.25 * (np.asarray(part.grad)**2).sum(axis=0) / (DENSITY * self.omega**2)
                        - 0.25 * np.asarray(part)**2 / (DENSITY * SPEED**2) for part in parts)
        load = []
        for i in range(2):
            flux = [0.5 * DENSITY * np.real(v[j].conj() * v[i]) - potential * (i == j) for j in range(2)]
            hoop = -potential if i == 0 else 0.0 * potential
            load.append(skfem.LinearForm(lambda w, x, f=flux, h=hoop: (
                f[0] * grad(w)[0] + f[1] * grad(w)[1]) * x.x[0] + h * w).assemble(self.u))
        # div <rho1 v>, of which rho1 div v is a quarter of a period off.
        slopes = [part.grad / SPEED**2 for part in parts]
        outflow = sum(0.5 * np.real((slopes[0][i] - 1j * slopes[1][i]) * v[i]) for i in range(2)) / DENSITY
        source = -skfem.LinearForm(lambda q, x: outflow * q * x.x[0]).assemble(self.p)
        drift = self._drift()
        matrix = sparse.bmat([[viscous, -divergence.T], [-divergence, None]]).tocsr()
        held = np.concatenate([self.wall | self.axis, self.wall, np.arange(self.p.N) == 0])
        values = np.concatenate([np.where(self.axis, 0.0, -drift[0]), -drift[1], np.zeros(self.p.N)])
        right = np.concatenate([*load, -source])
        # What the boundary values leave of a net flux is spread over the liquid.
        flux, within = right - matrix @ np.where(held, values, 0.0), slice(2 * self.u.N, None)
        volume = skfem.LinearForm(lambda q, x: q * x.x[0]).assemble(self.p)
        right[within] -= volume * flux[within].sum() / volume.sum()
        x = self._solved(matrix, right, held, values)
        return x[:2 * self.u.N].reshape(2, -1).real + drift

    def carried(self, points: Real) -> Real:
        """Mean velocity (K, 2) of the liquid itself at points (K, 2)."""
        probe = self.u.probes(points.T / UNIT)
        return np.stack([probe @ component for component in self.drifted], axis=1)


def with_slip(resolved: Resolved, order: int = 8) -> Streaming:
    """The streaming of the workbench from the pressure of the resolved liquid and the motion of the walls."""
    thick = 0.1e-3
    r = np.concatenate([np.linspace(0.0, RADIUS, 4), [RADIUS + thick]])
    z = np.concatenate([[-thick], np.linspace(0.0, HEIGHT, 3), [HEIGHT + thick]])
    low = np.array([(a, b) for a in r[:-1] for b in z[:-1]])
    high = np.array([(a, b) for a in r[1:] for b in z[1:]])
    middle = 0.5 * (low + high)
    region = np.where(middle[:, 0] > RADIUS, 2, np.where(middle[:, 1] < 0.0, 1, np.where(middle[:, 1] > HEIGHT, 3, 0)))
    mesh = mesh_of(low, high, region, ("cavity", "substrate", "sidewall", "superstrate"), order=order)
    inside, solid = mesh.nodes_of(["cavity"]), mesh.nodes_of(["substrate", "sidewall", "superstrate"])
    nothing = np.full(len(mesh.points), np.nan + 0j)
    pressure, displacement, velocity = nothing.copy(), np.stack([nothing] * 2, axis=1), np.stack([nothing] * 2, axis=1)
    pressure[inside] = resolved.p.probes(mesh.points[inside].T / UNIT) @ resolved.pressure
    velocity[inside] = gradient(mesh, pressure, ["cavity"])[inside] / (1j * OMEGA * DENSITY)
    velocity[solid] = wall_motion(mesh.points[solid])
    displacement[solid] = velocity[solid] / (-1j * OMEGA)
    made = Fields(mesh, FREQUENCY, 1.0, 0.0, 0.0, displacement, nothing, pressure, velocity,
                  np.stack([nothing] * 4, axis=1), np.zeros(len(mesh.points)), "prescribed walls")
    return acoustic_streaming(made, fluid=resolved.fluid, region="cavity")


def difference(layer: float, coarse: int) -> float:
    """Root mean square difference of the flow outside the layers, relative to the flow."""
    resolved = Resolved(liquid(layer), layer, coarse)
    found = with_slip(resolved)
    edge = 15.0 * LAYERS[0]
    r, z = (edge * start + np.linspace(0.02, 0.98, 25) * (size - edge * (1 + start))
            for start, size in ((0, RADIUS), (1, HEIGHT)))
    points = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
    expected = resolved.carried(points)
    actual = interpolate(found.mesh, found.carrier_velocity, points, ["cavity"])
    return float(np.sqrt(((actual - expected)**2).mean() / (expected**2).mean()))


#: Thicknesses of the layer in m: 0.27 and 0.13 % of the height. In the chips of the package it is 0.07 %.
LAYERS = (1.6e-6, 0.8e-6)
#: Elements between the layers of each, along the radius: with one more, differences stay as they are.
COARSE = (4, 5)


@pytest.mark.slow
def test_the_flow_is_that_of_a_resolved_layer() -> None:
    errors = [difference(layer, coarse) for layer, coarse in zip(LAYERS, COARSE, strict=True)]
    print("difference " + ", ".join(f"{100.0 * error:.2f} % with a layer of {1e6 * layer:.2g} um"
                                    for layer, error in zip(LAYERS, errors, strict=True)))
    # To leading order in layer over height: 3.7 and 1.85 %.
    assert errors[1] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.15)
