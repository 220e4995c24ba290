"""An axisymmetric piezoelectric disc with complex tensors against openCFS, on the mesh of openCFS.

The data are those of its test `HarmAxiQ` (github openCFS/cfs, MIT licence, folder
Testsuite/TESTSUIT/Coupledfield/Piezo/HarmAxiQ, commit ae2e0a955b50fe88c2741dfd6a2fee451a5dffbf): a disc of 10 mm radius
and 0.5 mm thickness, free but for its electrodes, in 64 bilinear quadrilaterals. On one mesh with one quadrature
(2 x 2 Gauss points) two codes that write the same equations differ by rounding only. The time factor there is
e^{+j w t}: constants and voltage are conjugated on the way in, displacement and charge on the way back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import skfem
from numpy.typing import NDArray

from geometry.mesh import SectionMesh
from geometry.names import AXIS, ELECTRODE_GROUND, ELECTRODE_LIVE, TRANSDUCER, outside
from geometry.section import Electrode, Rectangle, Section
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.electrodes import ElectrodePotential
from workbench.physics.piezoelectric import PiezoelectricSolid

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Of the largest displacement, and of the charge found as theirs. Rounding leaves 1e-14.
ROUNDING = 1e-10

#: Of the charge of a solution, which is the reaction of the electrode, against theirs, the flux of D through it. Equal
#: on a fine mesh only: with four elements through the thickness they are 0.05 to 0.30 % apart.
REACTION = 0.5e-2

#: Amplitude and phase of the drive, V, e^{+j w t}.
VOLTAGE = 10.0 * np.exp(1j * np.radians(30.0))

#: Real parts of what does not depend on frequency, SI. The imaginary parts are as large: a test of complex tensors, no
#: ceramic.
CONSTANTS = {"c11": 132e9, "c12": 71e9, "c13": 73e9, "c44": 26e9, "e31": -4.1, "e15": 10.5, "eps11": 7.12e-9}
DENSITY = 7502.55


@dataclass(frozen=True, eq=False)
class Result:
    """What openCFS found, e^{+j w t}.

    ``nodes`` (2, n) in m, ``cells`` (4, m) of nodes, ``groups`` of nodes by name; ``frequency`` (k,) in Hz;
    ``displacement`` (k, 2, n) in m, along r and z; ``charge`` (k,) of the live electrode in C.
    """

    nodes: Real
    cells: NDArray[np.int64]
    groups: Mapping[str, NDArray[np.int64]]
    frequency: Real
    displacement: Complex
    charge: Complex


@pytest.fixture(scope="module")
def folder(shared: Path) -> Path:
    found = shared / "oracles" / "opencfs-harmaxiq"
    if not found.is_dir():
        pytest.skip("the openCFS result is not among the shared data")
    return found


@pytest.fixture(scope="module")
def result(folder: Path) -> Result:
    with h5py.File(folder / "HarmAxiQ.h5ref") as file:
        mesh, fields = file["Mesh"], file["Results/Mesh/MultiStep_1"]
        steps = sorted((name for name in fields if name.startswith("Step_")), key=lambda name: int(name[5:]))
        whole = mesh["Regions/piezo_ax/Elements"][:] - 1
        charge = file["Results/History/MultiStep_1/elecCharge/ElementGroup/surf"]
        moved = [fields[f"{step}/mechDisplacement/piezo_ax/Nodes"] for step in steps]
        return Result(
            nodes=mesh["Nodes/Coordinates"][:, :2].T,
            cells=mesh["Elements/Connectivity"][:][whole].T.astype(np.int64) - 1,
            groups={name: group["Nodes"][:].astype(np.int64) - 1 for name, group in mesh["Groups"].items()},
            frequency=np.array([fields[step].attrs["StepValue"] for step in steps]),
            displacement=np.stack([(each["Real"][:] + 1j * each["Imag"][:]).T for each in moved]),
            charge=(charge["Real"][:] + 1j * charge["Imag"][:])[:, 0],
        )


@pytest.fixture(scope="module")
def operators(result: Result) -> FullOperators:
    """The workbench's own terms on that mesh, with fields of the first order."""
    return assemble(section_mesh(result), (PiezoelectricSolid(TRANSDUCER, "disc"),
                                           ElectrodePotential(ELECTRODE_LIVE, ELECTRODE_GROUND)))


def section_mesh(result: Result) -> SectionMesh:
    """The mesh as it is, its nodes in their order, the four of a cell anticlockwise from bottom left."""
    r, z = result.nodes[:, result.cells]
    middle = np.stack([r.mean(axis=0), z.mean(axis=0)])
    turn = np.argsort(np.arctan2(z - middle[1], r - middle[0]), axis=0)
    mesh = skfem.MeshQuad(result.nodes, np.take_along_axis(result.cells, turn, axis=0))
    # The groups of nodes are whole sides of the disc.
    sides = {name: np.flatnonzero(np.isin(mesh.facets, result.groups[group]).all(axis=0)) for name, group in
             ((AXIS, "axisBoun"), (ELECTRODE_GROUND, "ep-lower"), (ELECTRODE_LIVE, "ep-top"))}
    sides[outside(TRANSDUCER)] = np.setdiff1d(mesh.boundary_facets(), sides[AXIS])
    (low, bottom), (high, top) = result.nodes.min(axis=1), result.nodes.max(axis=1)
    section = Section((Rectangle(TRANSDUCER, low, high, bottom, top),),
                      (Electrode(ELECTRODE_GROUND, low, high, bottom), Electrode(ELECTRODE_LIVE, low, high, top)))
    regions = {TRANSDUCER: np.arange(mesh.nelements)}
    return SectionMesh(mesh.with_subdomains(regions).with_boundaries(sides), 1, section)


def values(folder: Path, frequency: float) -> dict[str, complex]:
    """The parameters of the terms at one frequency (Hz), e^{-i w t}."""
    found = {name: complex(value, value) for name, value in CONSTANTS.items()}
    for name in ("c33", "e33", "eps33"):
        found[name] = complex(*(np.interp(frequency, *np.loadtxt(folder / f"{name}{part}.fnc", unpack=True))
                                for part in "ri"))
    found = {name: value.conjugate() / (VACUUM_PERMITTIVITY if name.startswith("eps") else 1.0)
             for name, value in found.items()}
    return {f"disc.{name}": value for name, value in found.items()} | {"disc.density": complex(DENSITY)}


def solved(operators: FullOperators, folder: Path, frequency: float) -> tuple[Complex, complex, complex]:
    """Displacement (2, number of nodes), charge, and flux of D into the live electrode, at one frequency (Hz),
    e^{+j w t}."""
    constants = values(folder, frequency)
    solution = solve_full(operators, np.array([frequency]), constants)
    state = np.conj(VOLTAGE) * solution.states[:, 0]
    rows = np.stack([operators.numbering[component] for component in ("u_r", "u_z", "phi")])
    nodal = np.where(rows < 0, 0.0, state[rows])
    flux = electrode_flux(operators.mesh.mesh, nodal, constants)
    return np.conj(nodal[:2]), complex(np.conj(np.conj(VOLTAGE) * solution.charge[0])), complex(np.conj(flux))


def electrode_flux(mesh: skfem.MeshQuad, nodal: Complex, constants: Mapping[str, complex]) -> complex:
    """Integral of -D_z over the live electrode, which is on top, by scikit-fem alone; `nodal` (3, n): u_r, u_z, phi."""
    basis = skfem.FacetBasis(mesh, skfem.ElementQuad1(), facets=ELECTRODE_LIVE, intorder=3)
    u_r, u_z, phi = (basis.interpolate(each) for each in nodal)
    radius = basis.global_coordinates()[0]
    along_z = (constants["disc.e31"] * (u_r.grad[0] + u_r / radius) + constants["disc.e33"] * u_z.grad[1]
               - constants["disc.eps33"] * VACUUM_PERMITTIVITY * phi.grad[1])
    return complex(-np.sum(2.0 * np.pi * radius * along_z * basis.dx))


def difference(found: Complex, expected: Complex) -> float:
    """The largest difference, of the largest value expected."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def test_the_mesh_and_the_frequencies_are_those_stated(result: Result) -> None:
    assert result.nodes.shape == (2, 85)
    assert result.cells.shape == (4, 64)
    assert result.frequency == pytest.approx([2e6, 3e6, 4e6, 5e6, 6e6])
    assert result.displacement.shape == (5, 2, 85)


@pytest.mark.parametrize("step", range(5))
def test_displacement_and_charge_are_those_of_opencfs(
    step: int, result: Result, operators: FullOperators, folder: Path
) -> None:
    frequency = float(result.frequency[step])
    displacement, charge, flux = solved(operators, folder, frequency)
    moved = difference(displacement, result.displacement[step])
    through, reaction = (abs(each / result.charge[step] - 1.0) for each in (flux, charge))
    print(f"\n{1e-6 * frequency:g} MHz: displacement within {moved:.1e} of its maximum "
          f"{np.abs(result.displacement[step]).max():.3e} m; charge, by the flux of D {through:.1e}, by the reaction "
          f"{100 * reaction:.2f} %")
    assert moved <= ROUNDING
    assert through <= ROUNDING
    assert reaction <= REACTION


def test_the_other_time_factor_would_not_pass(result: Result, operators: FullOperators, folder: Path) -> None:
    displacement, charge, _ = solved(operators, folder, float(result.frequency[0]))
    # Nor would another phase of the drive.
    assert difference(np.conj(displacement), result.displacement[0]) > 0.1
    assert difference(1j ** (1.0 / 3.0) * displacement, result.displacement[0]) > 0.1
    assert abs(np.conj(charge) / result.charge[0] - 1.0) > 0.1
