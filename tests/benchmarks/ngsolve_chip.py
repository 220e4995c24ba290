"""The reference chip's spectrum by NGSolve and by `workbench.simulation.run`: accuracy and wall time in one run.

    .venv/bin/python tests/benchmarks/ngsolve_chip.py [--states empty filled] [--no-workbench] [--ordering COLAMD]
    .venv/bin/python tests/benchmarks/ngsolve_chip.py --draft 10 [--accuracy 2e-4]
    .venv/bin/python tests/benchmarks/ngsolve_chip.py --fillet 0.3 [--accuracy 2e-4]

NGSolve (the extra `oracle`) at its best for this chip: triangles of order 4 graded twice by 0.15 towards every corner,
full solves at 22 frequencies with SuperLU of scipy on the symmetrically scaled system, and a Galerkin sweep of all 491
frequencies on their states. Both programs run one after the other, each in a process of its own, on one thread, without
its imports. Their spectra are compared with those of an independent solver (tests/data/reference), which are known to
0.01 % rms of ln Z; a program's time is that of the spectrum alone. Run it on a quiet machine. With a `--draft`
(degrees) the hole of the sidewall is a cone, with a `--fillet` (mm) its lower end is rounded, which for the workbench
is a profile of the substrate and the sidewall in one; the two programs are then compared with each other.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).resolve().parent)]

from measurements import Measurements, alone, measurements, with_json  # noqa: E402
from support import pot  # noqa: E402

from geometry.chip import Chip, read_chip  # noqa: E402
from geometry.measure import Axisymmetric, Measure, Parity  # noqa: E402
from geometry.names import AXIS, CAVITY, ELECTRODE_GROUND, ELECTRODE_LIVE, TRANSDUCER  # noqa: E402
from geometry.parts import Dimension  # noqa: E402
from geometry.section import Section  # noqa: E402
from geometry.shapes import Side, sides  # noqa: E402
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.files.quantities import VACUUM_PERMITTIVITY  # noqa: E402
from workbench.model.discretisation import ACCURACY  # noqa: E402
from workbench.model.problem import fill  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402
from workbench.simulation.run import simulate  # noqa: E402

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

CHIP = ROOT / "geometry" / "chips" / "reference_chip.toml"

REFERENCE = ROOT / "tests" / "data" / "reference"

#: The water of the references, which has no losses and differs by 0.03 % in speed from the registry's: 0.7 % rms in Z.
WATER = "water/independent_reference"

#: Where a fluid ends in nothing: p = 0.
RELEASE = "release"

#: Of a contact: the direction (r, z) out of the solid.
DIRECTIONS = {"right": (1, 0), "left": (-1, 0), "up": (0, 1), "down": (0, -1)}


@dataclass(frozen=True, eq=False)
class Run:
    """A spectrum made by one of the programs, its number of unknowns, and the seconds of every step."""

    spectrum: Spectrum
    unknowns: int
    seconds: Mapping[str, float]
    note: str

    @property
    def total(self) -> float:
        return sum(self.seconds.values())


@dataclass(frozen=True)
class Settings:
    """How NGSolve is used. ``elements_per_wavelength`` of the slowest wave of each region at the end of the band;
    ``levels`` of grading, each with elements smaller by ``factor``; full ``solves``, and SuperLU's ``ordering``;
    ``fillet`` (m) between floor and wall of the cavity."""

    order: int
    elements_per_wavelength: float
    levels: int
    factor: float
    solves: int
    ordering: str
    fillet: float = 0.0


def reference(state: str) -> Spectrum:
    """The spectrum of the independent solver, e^{+j w t}."""
    frequency, real, imaginary = np.loadtxt(REFERENCE / f"chip_{state}.csv", delimiter=",", skiprows=1, unpack=True)
    return Spectrum(frequency, real + 1j * imaginary)


def inputs(folder: Path) -> tuple[Chip, Registry]:
    """The reference chip, and the registry with the water of the references besides, which goes to `folder`."""
    water = json.loads((REFERENCE / "chip_filled.json").read_text(encoding="utf-8"))["fluids"]["cav"]
    path = folder / f"{WATER}.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"""kind = "fluid"
title = "Water of the independent reference spectra"
source = "independent_reference"
conditions = "input of a computation, lossless"
density = {{ value = {water["rho"]}, unit = "kg/m^3" }}
sound_speed = {{ value = {water["c"]}, unit = "m/s" }}
""", encoding="utf-8")
    chip = read_chip(CHIP)
    states = tuple(replace(state, cavity=WATER, temperature=None) if state.cavity == "water" else state
                   for state in chip.states)
    return replace(chip, states=states), Registry((folder,))


def rms(spectrum: Spectrum, other: Spectrum) -> float:
    """Root mean square of |ln(Z / Z_other)|."""
    return float(np.sqrt(np.mean(np.abs(np.log(spectrum.impedance / other.impedance)) ** 2)))


# --------------------------------------------------------------------------------------------------------------------
# The workbench


def by_workbench(chip: Chip, registry: Registry, state: str, accuracy: float) -> Run:
    """The public path, its fields at f0 not counted."""
    frequency = reference(state).frequency
    result = simulate(chip, state, registry=registry, band=(float(frequency[0]), float(frequency[-1])),
                      points=frequency.size, accuracy=accuracy)
    seconds = {step: taken for step, taken in result.seconds.items() if step != "fields"}
    return Run(result.spectrum, result.unknowns, seconds, f"estimated error of the reduced model {result.error:.0e}")


# --------------------------------------------------------------------------------------------------------------------
# NGSolve


def imported() -> tuple[ModuleType, ModuleType]:
    """ngsolve, and the module of netgen for plane geometries."""
    try:
        import netgen.geom2d
        import ngsolve
    except ImportError as error:
        raise ImportError(f"this benchmark needs the extra `oracle`: pip install -e '.[oracle]' ({error})") from error
    return ngsolve, netgen.geom2d


def by_ngsolve(chip: Chip, registry: Registry, state: str, settings: Settings) -> Run:
    """The same chip and materials in NGSolve."""
    ngsolve, geom2d = imported()
    device = fill(chip, state, registry)
    section, materials = device.section, device.materials
    frequency = reference(state).frequency
    seconds: dict[str, float] = {}
    started = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal started
        now = time.perf_counter()
        seconds[name], started = now - started, now

    shape = list(sides(chip, section))
    mesh = triangles(ngsolve, geom2d, section, shape, materials, float(frequency[-1]), settings)
    lap("mesh")
    space, kept, electrode = unknowns(ngsolve, mesh, materials, settings.order, section.measure)
    parts = matrices(ngsolve, mesh, materials, space, kept, section.measure)
    lap("assembly")
    # Equally spaced: at Chebyshev points the same number of states leaves up to ten times the error in the middle.
    nodes = np.linspace(frequency[0], frequency[-1], settings.solves)
    states, scale = solved(parts, electrode, nodes, settings.ordering)
    lap("solves")
    impedance = swept(parts, electrode, states, scale, frequency)
    lap("sweep")
    between = frequency[[61, 231, 407]]
    exact = 1.0 / (-2j * np.pi * between * charges(parts, solved(parts, electrode, between, settings.ordering)[0]))
    error = np.abs(impedance[[61, 231, 407]] / exact - 1.0).max()
    return Run(Spectrum.from_solver(frequency, impedance), electrode.size - int(np.count_nonzero(electrode)), seconds,
               f"{mesh.ne} elements, sweep against full solves {error:.0e}")


def triangles(
    ngsolve: ModuleType, geom2d: ModuleType, section: Section, shape: Sequence[Side], materials: Mapping[str, Material],
    frequency: float, settings: Settings,
) -> Any:
    """The section in triangles, graded towards its corners, its upright sides moved as the `shape` of the chip says.

    Boundaries are named after what holds there: the axis or a plane of symmetry at the left end, an electrode, a
    release, or a contact ``fluid_direction``; an electrode under a fluid is both, ``electrode_live_fluid_direction``.
    """
    r, z = section.r_breaks, section.z_breaks
    (end,) = section.measure.ends(r)
    ends_of_electrodes = {(place, e.z) for e in section.electrodes for place in (e.r_inner, e.r_outer)}
    # What is on all sides of a break: the regions counted from 1, 0 where there is nothing.
    cells = np.pad(section.grid() + 1, 1)
    for number, region in enumerate(section.regions, start=1):
        if region not in materials:
            cells[cells == number] = 0
    geometry = geom2d.SplineGeometry()
    points: dict[tuple[int, int], int] = {}

    def moved(radius: float, height: float) -> float:
        """Outwards; sides that meet in a point agree."""
        there = [side for side in shape if abs(side.at - radius) < 1e-9
                 and side.begin - 1e-9 < height < side.end + 1e-9]
        return float(there[0].moved(np.array(height))) if there else 0.0

    def point(column: int, row: int) -> int:
        if (column, row) not in points:
            around = cells[row:row + 2, column:column + 2]
            straight = (around[0] == around[1]).all() or (around[:, 0] == around[:, 1]).all()
            # The free edge of one solid alone is no singularity that shows, nor is a point on the axis.
            singular = column > 0 and not straight and np.count_nonzero(around) > 1
            # An electrode that ends on a plane face is one, straight or not.
            singular |= straight and column > 0 and (r[column], z[row]) in ends_of_electrodes
            points[column, row] = geometry.AppendPoint(r[column] + moved(r[column], z[row]), z[row],
                                                       hpref=1 if singular else 0)
        return points[column, row]

    def name(first: int, second: int, height: float | None, begin: float = 0.0) -> str:
        """Of an edge between two regions, the second of them above or to the right, that begins at that radius."""
        ahead, behind = ("right", "left") if height is None else ("up", "down")
        one, other = (section.regions[number - 1] if number else None for number in (first, second))
        parts = [e.name for e in section.electrodes
                 if e.z == height and e.r_inner <= begin < e.r_outer and TRANSDUCER in (one, other)]
        for solid, fluid, direction in ((one, other, ahead), (other, one, behind)):
            if fluid is not None and isinstance(materials[fluid], Fluid):
                parts.append(RELEASE if solid is None else f"{fluid}_{direction}")
        return "_".join(parts) or "free"

    corner = _cavity_floor(section, r, z) if settings.fillet else None
    for row in range(len(z)):
        for column in range(len(r) - 1):
            below, above = (int(number) for number in cells[row:row + 2, column + 1])
            if (column + 1, row) == corner:
                solid = int(cells[row + 1, column + 2])
                ends = [geometry.AppendPoint(r[column + 1] - settings.fillet, z[row]), point(column + 1, row),
                        geometry.AppendPoint(r[column + 1], z[row] + settings.fillet)]
                geometry.Append(["line", point(column, row), ends[0]], leftdomain=above, rightdomain=below,
                                bc=name(below, above, z[row], r[column]))
                geometry.Append(["line", ends[0], ends[1]], leftdomain=solid, rightdomain=below, bc="free")
                geometry.Append(["spline3", *ends], leftdomain=above, rightdomain=solid, bc=name(above, solid, None))
            elif below != above:
                geometry.Append(["line", point(column, row), point(column + 1, row)], leftdomain=above,
                                rightdomain=below, bc=name(below, above, z[row], r[column]))
    for column in range(len(r)):
        for row in range(len(z) - 1):
            left, right = (int(number) for number in cells[row + 1, column:column + 2])
            if left != right:
                begin = ends[2] if (column, row) == corner else point(column, row)
                geometry.Append(["line", begin, point(column, row + 1)], leftdomain=left,
                                rightdomain=right, bc=name(left, right, None) if column else end)
    for number, region in enumerate(section.regions, start=1):
        geometry.SetMaterial(number, region)
        if region in materials:
            wavelength = materials[region].slowest_wave_speed() / frequency
            geometry.SetDomainMaxH(number, wavelength / settings.elements_per_wavelength)
    mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=max(r), grading=0.6))
    if settings.levels:
        mesh.RefineHP(settings.levels, settings.factor)
    if settings.fillet:
        mesh.Curve(settings.order)
    return mesh


def _cavity_floor(section: Section, r: Sequence[float], z: Sequence[float]) -> tuple[int, int]:
    """The break, column and row, where floor and wall of the cavity meet."""
    cavity = min((each for each in section.rectangles if each.region == CAVITY), key=lambda each: each.z_bottom)
    return r.index(cavity.r_outer), z.index(cavity.z_bottom)


def unknowns(
    ngsolve: ModuleType, mesh: Any, materials: Mapping[str, Material], order: int, measure: Measure
) -> tuple[Any, NDArray[np.int64], Complex]:
    """The space of displacement, potential and pressure; the unknowns (n,) of it that are free or on the electrode; and
    the state (n,) that is 1 V on the electrode and zero elsewhere.

    The potential of the live electrode is that of its vertices, whose functions add up to one there.
    """
    solids = "|".join(name for name, material in materials.items() if not isinstance(material, Fluid))
    fluids = "|".join(name for name, material in materials.items() if isinstance(material, Fluid))
    electrodes, release = f"{ELECTRODE_LIVE}.*|{ELECTRODE_GROUND}.*", RELEASE
    ((end, parity),) = ((AXIS, Parity.EVEN),) if isinstance(measure, Axisymmetric) else measure.planes.items()
    held = {"dirichletx" if parity is Parity.EVEN else "dirichlety": end}
    if parity is Parity.ODD:
        electrodes, release = f"{electrodes}|{end}", f"{release}|{end}"
    space = ngsolve.FESpace([
        ngsolve.VectorH1(mesh, order=order, definedon=mesh.Materials(solids), complex=True, **held),
        ngsolve.H1(mesh, order=order, definedon=mesh.Materials(TRANSDUCER), dirichlet=electrodes, complex=True),
        ngsolve.H1(mesh, order=order, definedon=mesh.Materials(fluids), dirichlet=release, complex=True),
    ])
    live = ngsolve.GridFunction(space)
    live.components[1].Set(1.0, definedon=mesh.Boundaries(f"{ELECTRODE_LIVE}.*"))
    electrode = np.array(live.vec.FV().NumPy())
    kept = np.flatnonzero(np.array(space.FreeDofs(), dtype=bool) | (electrode != 0.0))
    return space, kept, electrode[kept]


def depth(ngsolve: ModuleType, measure: Measure) -> Any:
    """The weight of a small area: 2 pi r, or the length of a straight chip for both of its halves."""
    return 2.0 * np.pi * ngsolve.x if isinstance(measure, Axisymmetric) else measure.copies * measure.length


def wall(ngsolve: ModuleType, boundary: str) -> tuple[Any, Any] | None:
    """The normal out of the solid on a contact of this name, whichever way its edge was drawn, and the tangent; None of
    another boundary."""
    direction = DIRECTIONS.get(boundary.rpartition("_")[2])
    if direction is None:
        return None
    drawn = ngsolve.specialcf.normal(2)
    normal = ngsolve.IfPos(drawn[0] * direction[0] + drawn[1] * direction[1], drawn, -drawn)
    return normal, ngsolve.CF((-normal[1], normal[0]))


def assembled(form: Any, kept: NDArray[np.int64]) -> sparse.csr_matrix:
    """The matrix of a form on the `kept` unknowns."""
    form.Assemble()
    entries, columns, starts = (np.array(each) for each in form.mat.CSR())
    return sparse.csr_matrix((entries, columns, starts), shape=(form.space.ndof,) * 2)[kept][:, kept]


def matrices(
    ngsolve: ModuleType, mesh: Any, materials: Mapping[str, Material], space: Any, kept: NDArray[np.int64],
    measure: Measure,
) -> dict[float, sparse.csr_matrix]:
    """The model as matrices (n, n) by their power of w, e^{-i w t}, on the unknowns that are free and on the electrode.

        solids   eps(v) : C : eps(u) - rho w^2 u.v
        ceramic  + eps(v) e^T grad(phi) + grad(psi) e eps(u) - grad(psi) . epsilon grad(phi)
        fluids   (1 / (rho w^2)) grad(p).grad(q) - (1 / (rho c^2)) p q
        contact  p (v.n) + q (u.n)            n out of the solid

    with the weight 2 pi r dr dz, or in a straight chip length dx dz, without the hoop strain.
    """
    (u, phi, p), (v, psi, q) = space.TnT()
    weight, is_round = depth(ngsolve, measure), isinstance(measure, Axisymmetric)
    forms = {power: ngsolve.BilinearForm(space) for power in (0, 2, -2)}

    def strain(w: Any) -> tuple[Any, Any, Any, Any]:
        """rr, tt, zz, 2rz."""
        slope = ngsolve.Grad(w)
        return (slope[0, 0], w[0] / ngsolve.x if is_round else 0.0 * w[0], slope[1, 1],
                slope[0, 1] + slope[1, 0])

    (rr, tt, zz, rz), (rr_v, tt_v, zz_v, rz_v) = strain(u), strain(v)
    for region, material in materials.items():
        inside = ngsolve.dx(definedon=mesh.Materials(region), bonus_intorder=1)
        match material:
            case Fluid():
                forms[-2] += weight / material.density * ngsolve.grad(p) * ngsolve.grad(q) * inside
                forms[0] += -weight * material.compressibility * p * q * inside
                continue
            case IsotropicSolid():
                shear = complex(material.shear_modulus)
                bulk = complex(material.bulk_modulus)
                c11 = c33 = bulk + 4.0 / 3.0 * shear
                c12 = c13 = bulk - 2.0 / 3.0 * shear
                c44 = shear
            case Piezoelectric():
                c11, c12, c13, c33, c44 = (complex(getattr(material, name)) for name in
                                           ("c11", "c12", "c13", "c33", "c44"))
                e31, e33, e15 = (complex(getattr(material, name)) for name in ("e31", "e33", "e15"))
                eps11, eps33 = (complex(eps) * VACUUM_PERMITTIVITY for eps in (material.eps11, material.eps33))
                slope, slope_v = ngsolve.grad(phi), ngsolve.grad(psi)
                forms[0] += weight * (
                    e31 * ((rr + tt) * slope_v[1] + (rr_v + tt_v) * slope[1])
                    + e33 * (zz * slope_v[1] + zz_v * slope[1]) + e15 * (rz * slope_v[0] + rz_v * slope[0])
                    - eps11 * slope[0] * slope_v[0] - eps33 * slope[1] * slope_v[1]) * inside
            case _:
                raise ValueError(f"{region}: expected a fluid, an isotropic solid or a ceramic, received {material!r}")
        forms[0] += weight * (
            c11 * (rr * rr_v + tt * tt_v) + c12 * (rr * tt_v + tt * rr_v)
            + c13 * ((rr + tt) * zz_v + zz * (rr_v + tt_v)) + c33 * zz * zz_v + c44 * rz * rz_v) * inside
        forms[2] += -weight * material.density * u * v * inside
    for boundary in dict.fromkeys(mesh.GetBoundaries()):
        if (directions := wall(ngsolve, boundary)) is not None:
            normal, _ = directions
            on = ngsolve.ds(definedon=mesh.Boundaries(boundary), bonus_intorder=1)
            forms[0] += weight * (p.Trace() * (v.Trace() * normal) + q.Trace() * (u.Trace() * normal)) * on
    return {power: assembled(form, kept) for power, form in forms.items()}


def at(parts: Mapping[float, sparse.csr_matrix], frequency: float) -> sparse.csr_matrix:
    """A(w)."""
    return sum((2.0 * np.pi * frequency) ** power * matrix for power, matrix in parts.items())


def solved(
    parts: Mapping[float, sparse.csr_matrix], electrode: Complex, frequencies: Real, ordering: str
) -> tuple[list[Any], Real]:
    """(frequency, state (n,)) at 1 V for every frequency, and the scale (free unknowns,) they were solved with."""
    free = np.flatnonzero(electrode == 0.0)
    inner = {power: matrix[free][:, free] for power, matrix in parts.items()}
    driven = {power: matrix[free] @ electrode for power, matrix in parts.items()}
    scale = 1.0 / np.sqrt(np.abs(at(inner, float(frequencies.mean())).diagonal()))
    scaled = {power: sparse.diags(scale) @ matrix @ sparse.diags(scale) for power, matrix in inner.items()}
    # By default SuperLU takes the pattern for unsymmetric; told that it is symmetric, it takes a quarter of the time.
    told: dict[str, Any] = {"permc_spec": ordering}
    if ordering == "MMD_AT_PLUS_A":
        told |= {"diag_pivot_thresh": 0.01, "options": {"SymmetricMode": True}}
    states = []
    for frequency in frequencies:
        right = -scale * sum((2.0 * np.pi * frequency) ** power * each for power, each in driven.items())
        matrix = at(scaled, float(frequency)).tocsc()
        factor = splu(matrix, **told)
        x = factor.solve(right)
        x = x + factor.solve(right - matrix @ x)
        state = electrode.copy()
        state[free] = scale * x
        states.append((float(frequency), state))
    return states, scale


def charges(parts: Mapping[float, sparse.csr_matrix], states: list[Any]) -> Complex:
    """Q = -x^T A x (number of states,) at 1 V."""
    return np.array([-state @ (at(parts, frequency) @ state) for frequency, state in states])


def swept(
    parts: Mapping[float, sparse.csr_matrix], electrode: Complex, states: list[Any], scale: Real, frequencies: Real
) -> Complex:
    """Z (number of frequencies,), e^{-i w t}, on the real and imaginary parts of the states."""
    free = np.flatnonzero(electrode == 0.0)
    found = np.stack([state[free] / scale for _, state in states], axis=1)
    columns, sizes, _ = np.linalg.svd(np.concatenate([found.real, found.imag], axis=1), full_matrices=False)
    columns = columns[:, sizes > 1e-10 * sizes[0]]
    basis = np.zeros((electrode.size, columns.shape[1] + 1))
    basis[free, :-1] = scale[:, None] * columns
    basis[:, -1] = electrode.real
    small = {power: basis.T @ (matrix @ basis) for power, matrix in parts.items()}
    omega = 2.0 * np.pi * frequencies
    whole = sum(omega[:, None, None] ** power * matrix for power, matrix in small.items())
    x = np.linalg.solve(whole[:, :-1, :-1], -whole[:, :-1, -1:])
    # Q = -x^T A x, of which the rows of the free unknowns are zero.
    charge = -(whole[:, -1, -1] + (whole[:, -1:, :-1] @ x)[:, 0, 0])
    return np.asarray(1.0 / (-1j * omega * charge))


# --------------------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", nargs="+", default=["empty", "filled"], choices=["empty", "filled"])
    parser.add_argument("--order", type=int, default=4)
    parser.add_argument("--elements-per-wavelength", type=float, default=3.0)
    parser.add_argument("--levels", type=int, default=2, help="how often corners are graded")
    parser.add_argument("--factor", type=float, default=0.15, help="size of the elements of a level over the last")
    parser.add_argument("--solves", type=int, default=22)
    parser.add_argument("--ordering", default="MMD_AT_PLUS_A", choices=["MMD_AT_PLUS_A", "COLAMD"],
                        help="of SuperLU, which is told that the pattern is symmetric, or is left to its defaults")
    parser.add_argument("--draft", type=float, default=0.0, help="of the sidewall's hole, degrees")
    parser.add_argument("--fillet", type=float, default=0.0, help="between floor and wall of the cavity, mm")
    parser.add_argument("--accuracy", type=float, default=ACCURACY, help="of the workbench's mesh")
    parser.add_argument("--no-workbench", action="store_true", help="NGSolve alone")
    with_json(parser)
    options = parser.parse_args()
    with measurements(options.json) as kept:
        measure(options, kept)


def measure(options: argparse.Namespace, kept: Measurements) -> None:
    settings = Settings(options.order, options.elements_per_wavelength, options.levels, options.factor, options.solves,
                        options.ordering, 1e-3 * options.fillet)
    print("| state | program | unknowns | rms of ln(Z/Z_ref) | steps (s) | spectrum (s) | share of NGSolve's |")
    print("| --- | --- | ---: | ---: | --- | ---: | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        chip, registry = inputs(Path(folder))
        if options.draft:
            chip = replace(chip, layers=tuple(
                replace(layer, draft=Dimension(math.radians(options.draft))) if layer.role == "sidewall" else layer
                for layer in chip.layers))
        for state in options.states:
            runs = {"NGSolve": alone(by_ngsolve, chip, registry, state, settings)}
            if not options.no_workbench:
                own = pot(chip, fillet=settings.fillet) if settings.fillet else chip
                runs["workbench"] = alone(by_workbench, own, registry, state, options.accuracy)
            other = runs["NGSolve"].spectrum if options.draft or options.fillet else reference(state)
            for program, run in runs.items():
                kept.add(f"{state}, {program}", run.total, "s")
                steps = ", ".join(f"{step} {taken:.2f}" for step, taken in run.seconds.items())
                print(f"| {state} | {program} ({run.note}) | {run.unknowns} | "
                      f"{100 * rms(run.spectrum, other):.3f} % | {steps} | {run.total:.2f} | "
                      f"{run.total / runs['NGSolve'].total:.2f} |", flush=True)


if __name__ == "__main__":
    main()
