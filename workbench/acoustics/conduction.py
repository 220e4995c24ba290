"""Heat conduction in a section by finite elements.

::

    -div(k grad T) = q,    -k d_n T = h T on the outside,    T the rise above the ambient temperature

in every conducting region, with the measure of the section. Temperatures are continuous across interfaces: contacts are
perfect. Elements are those of the fields (`workbench.fem.elements.Lagrange`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu
from skfem import Dofs

from geometry.mesh import SectionMesh
from geometry.names import OUTSIDE, SECTION_ENDS, outside
from workbench.fem.elements import Lagrange
from workbench.fem.places import Place, place_of
from workbench.fem.solve import one_thread
from workbench.files.errors import InputError, choose
from workbench.physics.term import Integral, Monomial
from workbench.results.brief import Brief

Real = NDArray[np.float64]

#: Number of corrections of a solution by its residual. Two reduce the error of the power balance to rounding; doubled,
#: nothing changes.
CORRECTIONS = 2


@dataclass(frozen=True)
class ThermalConstants:
    """Thermal conductivity (W/(m K)), density (kg/m^3) and heat capacity (J/(kg K))."""

    conductivity: float
    density: float
    heat_capacity: float

    @property
    def volumetric(self) -> float:
        """Heat capacity by volume, J/(m^3 K)."""
        return self.density * self.heat_capacity

    @property
    def diffusivity(self) -> float:
        """Thermal diffusivity, m^2/s."""
        return self.conductivity / self.volumetric


@dataclass(frozen=True, eq=False, repr=False)
class Conduction(Brief):
    """The assembled conduction of a section.

    ``constants`` by region; a region without is insulated. ``cooling`` W/(m^2 K) of every outer boundary that loses
    heat to the surroundings; ``holders`` K above ambient of every boundary at a fixed temperature. ``places`` are the
    regions and ``walls`` the cooled boundaries with their nodal functions; ``size`` is the number N of scalar nodes.
    """

    mesh: SectionMesh
    constants: Mapping[str, ThermalConstants]
    cooling: Mapping[str, float]
    holders: Mapping[str, float]
    places: Mapping[str, Place]
    walls: Mapping[str, Place]
    size: int

    @cached_property
    def nodes(self) -> NDArray[np.int64]:
        """The scalar nodes (n,) that conduct."""
        return np.unique(np.concatenate([place.dofs.ravel() for place in self.places.values()]))

    @cached_property
    def fixed(self) -> dict[int, float]:
        """Temperature (K above ambient) of every node on a holder."""
        return {int(node): rise for name, rise in self.holders.items()
                for node in np.unique(boundary_place(self.mesh, name).dofs)}

    @cached_property
    def loss(self) -> Mapping[str, sparse.csr_matrix]:
        """Matrix (N, N) of h T on every cooled boundary, W/K."""
        return {name: assembled(self.size, self.walls[name], [("value", h)]) for name, h in self.cooling.items()}

    @cached_property
    def matrix(self) -> sparse.csr_matrix:
        """Matrix (N, N) of conduction and cooling together, W/K."""
        parts = [assembled(self.size, place, [("d_r", self.constants[region].conductivity),
                                              ("d_z", self.constants[region].conductivity)])
                 for region, place in self.places.items()]
        return sum([*parts[1:], *self.loss.values()], parts[0])

    @cached_property
    def capacity(self) -> sparse.csr_matrix:
        """Matrix (N, N) of the heat capacity, J/K."""
        parts = [assembled(self.size, place, [("value", self.constants[region].volumetric)])
                 for region, place in self.places.items()]
        return sum(parts[1:], parts[0])

    def averaging(self, region: str) -> Real:
        """Weights (N,) of nodal temperatures for the mean over a region's volume."""
        return _mean_of(self.size, self.places[region])

    def volume(self, region: str) -> float:
        """Volume of a region, m^3."""
        return float(self.places[region].weights.sum())

    @cached_property
    def free(self) -> NDArray[np.int64]:
        """The nodes whose temperature is unknown."""
        return np.setdiff1d(self.nodes, np.array(sorted(self.fixed), dtype=np.int64))

    @cached_property
    def solve_free(self) -> Callable[[Real], Real]:
        """The solver for a load (W) on :attr:`free` nodes."""
        inner = self.matrix[self.free][:, self.free].tocsc()
        scale = 1.0 / np.sqrt(inner.diagonal())
        scaled = (sparse.diags(scale) @ inner @ sparse.diags(scale)).tocsc()
        with one_thread():
            factor = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

        def solve(load: Real) -> Real:
            right = scale * load
            found = factor.solve(right)
            for _ in range(CORRECTIONS):
                found = found + factor.solve(right - scaled @ found)
            return np.asarray(scale * found)

        return solve

    def temperature(self, load: Real, *, driven: bool = True) -> Real:
        """Temperatures (N,) in K above ambient under a `load` (N,) in W. They are NaN at nodes that do not conduct.
        With `driven` False the holders are at ambient temperature."""
        found = np.full(self.size, np.nan)
        fixed = np.array(sorted(self.fixed), dtype=np.int64)
        found[fixed] = [self.fixed[int(node)] if driven else 0.0 for node in fixed]
        coupled = self.matrix[self.free][:, fixed] @ found[fixed] if fixed.size else 0.0
        found[self.free] = self.solve_free(load[self.free] - coupled)
        return found

    def leaving(self, temperature: Real, load: Real) -> tuple[dict[str, float], float]:
        """Heat (W) that leaves through every cooled boundary, and through the holders."""
        known = np.where(np.isnan(temperature), 0.0, temperature)
        fixed = np.array(sorted(self.fixed), dtype=np.int64)
        cooled = {name: float((matrix @ known).sum()) for name, matrix in self.loss.items()}
        return cooled, float((load[fixed] - self.matrix[fixed] @ known).sum()) if fixed.size else 0.0

    def slowest_time(self) -> float:
        """The slowest time constant (s) of the temperatures. The equation is C dT/dt + K T = 0. It is that of the
        smallest eigenvalue of K x = C x / tau."""
        capacity = self.capacity[self.free][:, self.free]
        shape = capacity.shape
        with one_thread():
            values = eigsh(self.matrix[self.free][:, self.free], k=1, M=capacity, sigma=0.0, v0=np.ones(shape[0]),
                           OPinv=LinearOperator(shape, matvec=self.solve_free), return_eigenvectors=False)
        return float(1.0 / values[0])


def conduction(
    mesh: SectionMesh,
    constants: Mapping[str, ThermalConstants],
    *,
    cooling: Mapping[str, float],
    holders: Mapping[str, float] | None = None,
) -> Conduction:
    """The conduction of a section.

    Args:
        constants: by region; other regions are insulated.
        cooling: W/(m^2 K) by outer boundary; the key "" means all other boundaries. Holders have none.
        holders: K above ambient by boundary.

    Raises:
        InputError: an unknown boundary, the axis or a plane of symmetry, a negative coefficient, or no cooling at all.
    """
    holders = holders or {}
    outer = [outside(region) for region in constants if outside(region) in mesh.mesh.boundaries]
    for name in (name for name in cooling if name):
        choose(name, outer, source="heat", field="convection")
    for name in holders:
        choose(name, [each for each in mesh.mesh.boundaries if each not in SECTION_ENDS and ("|" not in each
                      or set(each.split("|")) & set(constants))], source="heat", field="holder")
    chosen = {name: cooling.get(name, cooling.get("", 0.0)) for name in outer if name not in holders}
    for name, value in chosen.items():
        if not 0.0 <= value < np.inf:
            raise InputError("heat", f"convection of {name}", value, "a heat transfer coefficient of 0 W/(m^2 K) or "
                             "more")
    if not holders and not any(chosen.values()):
        raise InputError("heat", "convection", 0.0, "some cooling: a heat transfer coefficient above "
                         "0 W/(m^2 K) or a holder")
    places = {region: _region_place(mesh, region) for region in constants}
    chosen = {name: value for name, value in chosen.items() if value > 0.0}
    walls = {name: boundary_place(mesh, name) for name in chosen}
    size = int(Dofs(mesh.mesh, Lagrange(mesh.order)).N)
    return Conduction(mesh, dict(constants), chosen, dict(holders), places, walls, size)


def boundary_place(mesh: SectionMesh, name: str) -> Place:
    """A boundary with the nodal functions that do not vanish on it."""
    facets = np.asarray(mesh.mesh.boundaries[name])
    owner = mesh.mesh.f2t[0, facets[0]]
    solid = next(region for region, cells in mesh.mesh.subdomains.items() if owner in cells)
    found = place_of(mesh, Integral(Monomial(1.0, 0), name, (), solid=solid))
    assert found is not None
    return found


def mean_over(mesh: SectionMesh, size: int, name: str) -> Real:
    """Weights (N,) of nodal temperatures for the mean over a boundary."""
    return _mean_of(size, boundary_place(mesh, name))


def is_outer(name: str) -> bool:
    """Whether a boundary is a part of the outside."""
    return name.endswith(f"|{OUTSIDE}")


def _region_place(mesh: SectionMesh, region: str) -> Place:
    found = place_of(mesh, Integral(Monomial(1.0, 0), region, ()))
    assert found is not None
    return found


def _mean_of(size: int, place: Place) -> Real:
    weights = np.einsum("eqi,eq->ie", place.shapes["value"], place.weights)
    result = np.bincount(place.dofs.ravel(), weights=weights.ravel(), minlength=size)
    return np.asarray(result / place.weights.sum())


def assembled(size: int, place: Place, products: list[tuple[str, float]]) -> sparse.csr_matrix:
    """The matrix (size, size) of weighted products of operations with themselves."""
    entries = sum(factor * place.shapes[kind].transpose(0, 2, 1) @ (place.weights[:, :, None] * place.shapes[kind])
                  for kind, factor in products)
    dofs = place.dofs.T
    rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
    return sparse.coo_matrix((np.ravel(entries), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsr()
