"""How accurate the recovered fields are: stress, velocity, force, traps and energies by order and fineness of the mesh.

    python tests/benchmarks/recovered_fields.py

The filled reference chip with polystyrene beads of 10 um, driven at its f0, on the meshes of :data:`TRIED`, against
:data:`REFERENCE`, a mesh of higher order and twice as fine. Fields are compared at 1500 random points of every region,
the same for all meshes, and relative to the rms of the field in the region: the rms of the difference over all points,
and its rms and largest value more than 0.3 mm away from corners, where stresses are infinite. Order 2 with 10 elements
per wavelength is what `simulate` used up to commit c06b350; the default row is to have no larger rms, in any region.
The code of that commit, run on the same points, gave the same row but for the stress in the bond (0.991 / 0.152 /
0.31), and for force and potential in the cavity (0.242 / 0.247 / 2.36 and 0.157 / 0.160 / 0.99), which it interpolated
between nodes of the order of the fields.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.chip import read_chip
from geometry.mesh import mesh_section
from geometry.names import CAVITY
from geometry.section import Section, cut_section
from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry
from workbench.acoustics.fields import Fields, fields
from workbench.acoustics.forces import force_at, particle_forces
from workbench.acoustics.nodal import integrate, interpolate
from workbench.acoustics.traps import Trap, find_traps
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.discretisation import ROWS, Discretisation
from workbench.model.drive import VoltageDrive
from workbench.model.particles import particle_from
from workbench.model.problem import fill, problem

Real = NDArray[np.float64]

CHIP = Path(__file__).resolve().parent.parent.parent / "geometry" / "chips" / "reference_chip.toml"
STATE, FREQUENCY, RADIUS = "filled", 1.0305e6, 5e-6
#: The rows that are usual, by their accuracy, and what was before them.
TRIED = {"order 2, 10": Discretisation(2, 10.0, through_thickness=2, corner_refinement=0.5, growth=1.2, gas_finer=0.5),
         "1e-3": ROWS[1e-3], "5e-4": ROWS[5e-4], "2e-4": ROWS[2e-4]}
REFERENCE = Discretisation(6, 4.0, through_thickness=2, corner_refinement=0.05, growth=4.0, transducer_finer=1.2,
                           gas_finer=1.0)
#: Metres from the nearest corner of a region from which on a point is away from it.
AWAY = 0.3e-3


@dataclass(frozen=True, eq=False)
class Found:
    """Fields of one mesh: unknowns, values at the points by region and name, energy (J) by region, the traps."""

    unknowns: int
    values: dict[tuple[str, str], NDArray[np.complex128]]
    energy: dict[str, float]
    traps: tuple[Trap, ...]


def points_of(section: Section, count: int = 1500) -> dict[str, Real]:
    """Random points (count, 2) of every region, evenly over its area."""
    random = np.random.default_rng(5)
    found = {}
    for name in section.regions:
        pieces = [piece for piece in section.rectangles if piece.region == name]
        low = np.array([(piece.r_inner, piece.z_bottom) for piece in pieces])
        high = np.array([(piece.r_outer, piece.z_top) for piece in pieces])
        area = (high - low).prod(axis=1)
        which = random.choice(len(pieces), count, p=area / area.sum())
        found[name] = low[which] + (high - low)[which] * (0.001 + 0.998 * random.random((count, 2)))
    return found


def away(section: Section, points: Real) -> NDArray[np.bool_]:
    """Which of `points` (K, 2) are away from the corners of all regions."""
    corners = np.array([(r, z) for piece in section.rectangles for r in (piece.r_inner, piece.r_outer) if r > 0.0
                        for z in (piece.z_bottom, piece.z_top)])
    far: NDArray[np.bool_] = (np.linalg.norm(points[:, None] - corners, axis=2) > AWAY).all(axis=1)
    return far


def solve(how: Discretisation) -> Found:
    """The fields on the mesh of a discretisation."""
    chip, registry = read_chip(CHIP), Registry()
    device = fill(chip, STATE, registry)
    materials, section = device.materials, device.section
    model = problem(mesh_section(section, how.mesh_size(section, materials, chip.band[1])), materials, chip.band)
    operators = assemble(model.mesh, model.terms)
    solution = solve_full(operators, np.array([FREQUENCY]), model.values)
    shown = fields(model, operators, solution, VoltageDrive(10.0))
    fluid, bead = materials[CAVITY], registry.load("polystyrene")
    assert isinstance(fluid, Fluid)
    assert isinstance(bead, IsotropicSolid)
    forces = particle_forces(shown, particle_from(bead, RADIUS), fluid=fluid, region=CAVITY)
    values = sampled(shown, points_of(section))
    values[CAVITY, "force"] = force_at(forces, points_of(section)[CAVITY])
    values[CAVITY, "potential"] = interpolate(forces.mesh, forces.potential[:, None], points_of(section)[CAVITY],
                                              [CAVITY])
    energy = {name: float(integrate(shown.mesh, shown.energy_density, [name])) for name in section.regions}
    return Found(operators.size, values, energy, find_traps(forces).traps)


def sampled(shown: Fields, points: dict[str, Real]) -> dict[tuple[str, str], NDArray[np.complex128]]:
    """Stress in solids and velocity everywhere, at the points of every region."""
    values = {}
    for name, places in points.items():
        values[name, "velocity"] = interpolate(shown.mesh, shown.velocity, places, [name])
        if name in shown.solid_regions:
            values[name, "stress"] = interpolate(shown.mesh, shown.stress, places, [name])
    return values


def errors(found: Found, reference: Found, key: tuple[str, str], far: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Relative rms difference of a field, its rms away from corners, and its largest value there."""
    exact = reference.values[key]
    difference = np.linalg.norm(found.values[key] - exact, axis=1)
    unit = float(np.sqrt(np.mean(np.linalg.norm(exact, axis=1) ** 2)))
    return (float(np.sqrt(np.mean(difference**2))) / unit, float(np.sqrt(np.mean(difference[far] ** 2))) / unit,
            float(difference[far].max()) / unit)


def main() -> None:
    warnings.simplefilter("ignore")
    section = cut_section(read_chip(CHIP))
    points = points_of(section)
    reference = solve(REFERENCE)
    runs = [solve(each) for each in TRIED.values()]
    print("rms / rms away from corners / largest away from corners, %")
    print(f"{'':24}" + "".join(f"{name:>24}" for name in TRIED))
    print(f"{'unknowns':24}" + "".join(f"{run.unknowns:24}" for run in runs))
    for region, name in sorted(reference.values, key=lambda key: (key[1], section.regions.index(key[0]))):
        far = away(section, points[region])
        found = (errors(run, reference, (region, name), far) for run in runs)
        cells = (" / ".join(f"{100 * part:.3f}" for part in parts) for parts in found)
        print(f"{f'{name}, {region}':24}" + "".join(f"{cell:>24}" for cell in cells))
    for region in section.regions:
        print(f"{f'energy, {region} (%)':24}" + "".join(
            f"{100 * (run.energy[region] / reference.energy[region] - 1):24.4f}" for run in runs))
    first = reference.traps[0]
    for name, unit in (("radius", 1e6), ("height", 1e6)):
        print(f"{f'trap, {name} (um)':24}" + "".join(
            f"{unit * (getattr(run.traps[0], name) - getattr(first, name)):24.3f}" for run in runs))
    for name in ("depth", "radial_stiffness", "axial_stiffness"):
        print(f"{f'trap, {name} (%)':24}" + "".join(
            f"{100 * (getattr(run.traps[0], name) / getattr(first, name) - 1):24.3f}" for run in runs))
    print(f"traps: {len(reference.traps)} in the reference, {[len(run.traps) for run in runs]}")


if __name__ == "__main__":
    main()
