"""Fields of a solution: displacement, pressure, velocity, stress, energy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from skfem.assembly.dofs import Dofs

from geometry.free_section import FreeSection
from geometry.mesh import SectionMesh
from materials.kinds import CubicSolid, Fluid, IsotropicSolid, Piezoelectric
from workbench.acoustics.nodal import NodalMesh, gradient, grid_nodes
from workbench.fem.elements import Lagrange
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.drive import Drive, VoltageDrive
from workbench.model.problem import Problem
from workbench.physics.term import Values
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, repr=False)
class Fields(Brief):
    """Fields of one state of a device at one frequency and drive.

    The time factor is e^{-i w t}, amplitudes are zero to peak. ``voltage`` (V) and ``current`` (A) at the electrodes,
    ``power`` (W) electrical input. On the N nodes of ``mesh``: ``displacement`` (N, 2) m in solids, ``potential`` (N,)
    V in the piezoelectric, ``pressure`` (N,) Pa in fluids, ``velocity`` (N, 2) m/s, ``stress`` (N, 4) Pa (rr, tt, zz,
    rz) in solids, ``energy_density`` (N,) J/m^3 averaged over time: kinetic plus elastic or compressional, and electric
    in the piezoelectric. NaN in regions without the field. ``drive`` describes the drive in words, with its voltage at
    the electrodes.
    """

    mesh: NodalMesh
    frequency: float
    voltage: complex
    current: complex
    power: float
    displacement: Complex
    potential: Complex
    pressure: Complex
    velocity: Complex
    stress: Complex
    energy_density: Real
    drive: str

    @property
    def fluid_regions(self) -> tuple[str, ...]:
        """Regions with a pressure."""
        return tuple(r for r in self.mesh.regions if not np.isnan(self.pressure[self.mesh.nodes_of([r])]).any())

    @property
    def solid_regions(self) -> tuple[str, ...]:
        """Regions with a displacement."""
        return tuple(r for r in self.mesh.regions if not np.isnan(self.displacement[self.mesh.nodes_of([r]), 0]).any())


def fields(problem: Problem, operators: FullOperators, solution: Solution, drive: Drive) -> Fields:
    """The fields of a full `solution` at one frequency, under `drive`. Stress and velocity in fluids follow from
    gradients recovered at the nodes (`nodal.gradient`)."""
    frequency, omega = float(solution.frequency[0]), float(solution.omega[0])
    mesh, dofs = section_nodes(operators.mesh)
    values = problem.values
    impedance = complex(solution.impedance[0])
    voltage = complex(drive.amplitude(np.array([impedance]))[0])
    nodal = nodal_components(operators, solution.states[:, 0] * voltage, mesh, dofs)
    count = len(mesh.points)
    displacement = np.stack([nodal["u_r"], nodal["u_z"]], axis=1)
    velocity = -1j * omega * displacement
    stress = np.full((count, 4), np.nan + 0j)
    energy = np.full(count, np.nan)
    for region, material in problem.materials.items():
        nodes = mesh.nodes_of([region])
        name = material.name
        density = complex(values[f"{name}.density"]).real
        match material:
            case Fluid():
                slope = gradient(mesh, nodal["p"], [region])[nodes]
                velocity[nodes] = slope / (1j * omega * density)
                compressibility = 1.0 / (density * complex(values[f"{name}.sound_speed"]).real ** 2)
                potential_energy = compressibility * np.abs(nodal["p"][nodes]) ** 2
            case Piezoelectric() | IsotropicSolid() | CubicSolid():
                strain = _strain(mesh, displacement, region, nodes)
                if isinstance(material, Piezoelectric):
                    electric = -gradient(mesh, nodal["phi"], [region])[nodes]
                    stress[nodes], flux = _piezoelectric(strain, electric, name, values)
                    stored = np.sum(strain.conj() * stress[nodes], axis=1) + np.sum(electric.conj() * flux, axis=1)
                else:
                    stress[nodes] = (_cubic(strain, material, values) if isinstance(material, CubicSolid)
                                     else _isotropic(strain, name, values))
                    stored = np.sum(strain.conj() * stress[nodes], axis=1)
                potential_energy = stored.real
        kinetic = density * np.sum(np.abs(velocity[nodes]) ** 2, axis=1)
        energy[nodes] = 0.25 * (kinetic + potential_energy)
    current = voltage / impedance
    power = 0.5 * float((voltage * np.conj(current)).real)
    words = str(drive)
    if not isinstance(drive, VoltageDrive):
        words += f" ({2.0 * abs(voltage):.3g} Vpp at the electrodes)"
    return Fields(mesh, frequency, voltage, current, power, displacement, nodal["phi"], nodal["p"], velocity, stress,
                  energy, words)


def nodal_components(
    operators: FullOperators, state: Complex, mesh: NodalMesh, dofs: NDArray[np.int64]
) -> dict[str, Complex]:
    """The components of a `state` at the nodes, or NaN.

    Components of a state (size,) are (N,), those of n states (size, n) are (N, n). `mesh` and `dofs` (N,) are those of
    :func:`section_nodes`. A component is NaN in regions without it.
    """
    several = state.shape[1:]
    padded = np.concatenate([state, np.zeros((1, *several))])
    nodal = {component: np.full((len(dofs), *several), np.nan + 0j) for component in operators.numbering}
    for component, region in {pair for term in operators.terms for pair in term.unknowns}:
        nodes = mesh.nodes_of([region])
        nodal[component][nodes] = padded[operators.numbering[component][dofs[nodes]]]
        if component in operators.shares:
            shares = operators.shares[component][dofs[nodes]]
            nodal[component][nodes] *= shares.reshape(-1, *(1 for _ in several))
    return nodal


def section_nodes(mesh: SectionMesh) -> tuple[NodalMesh, NDArray[np.int64]]:
    """The nodes of the fields, and their scalar dofs (N,). Nodes are doubled between regions."""
    element = Lagrange(mesh.order)
    element_dofs = np.asarray(Dofs(mesh.mesh, element).element_dofs)
    along, across = np.array(element.indices).T
    corners = mesh.mesh.p[:, mesh.mesh.t]  # (2, 4, cells)
    free = isinstance(mesh.section, FreeSection)
    cells, region, points, straight, dofs = [], [], [], [], []
    names = mesh.section.regions
    offset = 0
    for index, name in enumerate(names):
        chosen = mesh.mesh.subdomains[name]
        own, local = np.unique(element_dofs[:, chosen].T, return_inverse=True)
        members = np.empty((len(chosen), mesh.order + 1, mesh.order + 1), dtype=np.int64)
        members[:, along, across] = local.reshape(len(chosen), -1)
        place, there = np.empty((2, own.size, 2))
        if not free:
            place[members] = grid_nodes(corners[:, 0, chosen].T, corners[:, 2, chosen].T, mesh.order)
            straight.append(place)
        if mesh.coordinates is not None:
            there[members[:, along, across]] = mesh.coordinates[:, :, chosen].T
        points.append(place if mesh.coordinates is None else there)
        cells.append(offset + members)
        region.append(np.full(len(members), index))
        dofs.append(own)
        offset += own.size
    nodal = NodalMesh(np.concatenate(points), np.concatenate(cells), np.concatenate(region), tuple(names),
                      None if free or mesh.coordinates is None else np.concatenate(straight), free, mesh.measure)
    return nodal, np.concatenate(dofs)


def _strain(mesh: NodalMesh, displacement: Complex, region: str, nodes: NDArray[np.int64]) -> Complex:
    """Strain (n, 4) at a region's nodes: rr, tt, zz, 2rz. On the axis u_r / r is its limit, d u_r / d r; in a straight
    section it is zero."""
    slope = gradient(mesh, displacement, [region])[nodes]  # (n, 2 directions, 2 components)
    r = mesh.points[nodes, 0]
    hoop = mesh.measure.hoop(displacement[nodes, 0], slope[:, 0, 0], r)
    return np.stack([slope[:, 0, 0], hoop, slope[:, 1, 1], slope[:, 1, 0] + slope[:, 0, 1]], axis=1)


def _isotropic(strain: Complex, name: str, values: Values) -> Complex:
    bulk, shear = complex(values[f"{name}.bulk_modulus"]), complex(values[f"{name}.shear_modulus"])
    lame = bulk - 2.0 * shear / 3.0
    pressure = lame * strain[:, :3].sum(axis=1)
    normal = pressure[:, None] + 2.0 * shear * strain[:, :3]
    return np.column_stack([normal, shear * strain[:, 3]])


def _cubic(strain: Complex, material: CubicSolid, values: Values) -> Complex:
    """Stress (n, 4) in a crystal in plane strain."""
    c11, c12, c44 = (complex(values[f"{material.name}.{key}"]) for key in ("c11", "c12", "c44"))
    across, along = replace(material, c11=c11, c12=c12, c44=c44).stiffness
    stiffness = np.array([[across, along, c12, 0], [along, across, c12, 0], [c12, c12, c11, 0], [0, 0, 0, c44]])
    return np.asarray(strain @ stiffness)


def _piezoelectric(strain: Complex, electric: Complex, name: str, values: Values) -> tuple[Complex, Complex]:
    """Stress (n, 4) and electric displacement (n, 2). sigma = C eps - e^T E, D = e eps + epsilon E."""
    c = {key: complex(values[f"{name}.{key}"]) for key in
         ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33")}
    stiffness = np.array([[c["c11"], c["c12"], c["c13"], 0], [c["c12"], c["c11"], c["c13"], 0],
                          [c["c13"], c["c13"], c["c33"], 0], [0, 0, 0, c["c44"]]])
    coupling = np.array([[0, 0, 0, c["e15"]], [c["e31"], c["e31"], c["e33"], 0]])
    permittivity = VACUUM_PERMITTIVITY * np.array([c["eps11"], c["eps33"]])
    return strain @ stiffness.T - electric @ coupling, strain @ coupling.T + electric * permittivity
