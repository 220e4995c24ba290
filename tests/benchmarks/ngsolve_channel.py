"""A straight chip by NGSolve and by the workbench: E_ac(f) about a resonance, with the boundary layers and without.

    .venv/bin/python tests/benchmarks/ngsolve_channel.py [--chip glass_channel] [--near 1.89] [--accuracy 1e-4]

Both programs solve the chip at the same frequencies, in processes of their own, and E_ac is the mean over the channel
at 1 V. Its f0 and the width of its peak come from both in the same way. NGSolve (the extra `oracle`) has triangles of
order 5 graded three times by 0.15 towards every corner and towards the edge of the split electrode, in plane strain,
and these conditions at the walls of the channel (Bach and Bruus, J. Acoust. Soc. Am. 144, 766, 2018):

    tangential   - beta / (rho w^2) (d_t p - rho w^2 u_t) (d_t q - rho w^2 v_t)    beta = (1 + i) delta / 2
    thermal      - (gamma - 1) (1 + i) delta_t / (2 rho c^2) p q

Asserted: f0 within 1e-4, E_ac at the peak within 1 %, Q within 0.5 %.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import ngsolve_chip as oracle
import numpy as np
from measurements import Measurements, alone, measurements, with_json
from scipy import sparse
from scipy.interpolate import CubicSpline

from geometry.chip import Chip, read_chip
from geometry.dimension import Dimension
from geometry.names import CAVITY
from geometry.shapes import sides
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.fields import fields
from workbench.acoustics.forces import excitation_of
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.drive import VoltageDrive
from workbench.model.problem import FilledChip, build, fill

#: Largest relative differences of f0, E_ac at the peak and Q.
TOLERANCES = {"f0": 1e-4, "E_ac": 1e-2, "Q": 5e-3}

#: Number of frequencies of a coarse search and of the peak, and half of the span of the latter in widths of the peak.
SEARCHED, POINTS, WIDTHS = 41, 25, 1.5

#: Half of the span of the search, as a share of the frequency.
SEARCH = 0.01


@dataclass(frozen=True, eq=False)
class Curve:
    """E_ac (J/m^3) at 1 V and impedance (ohm, e^{-i w t}) at ``frequency`` (Hz), and the number of unknowns."""

    frequency: oracle.Real
    energy: oracle.Real
    impedance: oracle.Complex
    unknowns: int

    def peak(self) -> dict[str, float]:
        """f0 (Hz), E_ac (J/m^3) there, and Q = f0 over the width at half of it.

        The reciprocal of E_ac is next to a parabola, which a spline follows.
        """
        reciprocal = CubicSpline(self.frequency, 1.0 / self.energy)
        turns = [f for f in reciprocal.derivative().roots(extrapolate=False) if reciprocal(f, 2) > 0.0]
        f0 = float(min(turns, key=reciprocal))
        lowest = float(reciprocal(f0))
        sides = CubicSpline(self.frequency, 1.0 / self.energy - 2.0 * lowest).roots(extrapolate=False)
        low, high = max(f for f in sides if f < f0), min(f for f in sides if f > f0)
        return {"f0": f0, "E_ac": 1.0 / lowest, "Q": f0 / float(high - low)}


def filled(chip: Chip, inviscid: bool) -> FilledChip:
    return fill(chip, "filled", Registry(assumed_losses=True, inviscid=inviscid))


def by_workbench(chip: Chip, inviscid: bool, frequency: oracle.Real, accuracy: float) -> Curve:
    """Full solves of the workbench, and the fields that it recovers from them."""
    problem = build(filled(chip, inviscid), accuracy=accuracy)
    operators = assemble(problem.mesh, problem.terms)
    energy, impedance = [], []
    for each in frequency:
        solution = solve_full(operators, np.array([each]), problem.values)
        found = fields(problem, operators, solution, VoltageDrive(2.0))  # Vpp
        energy.append(excitation_of(found, problem.materials[CAVITY], CAVITY, amplitude=1.0).mean_energy_density)
        impedance.append(complex(solution.impedance[0]))
    return Curve(frequency, np.array(energy), np.array(impedance), operators.size)


def by_ngsolve(chip: Chip, inviscid: bool, frequency: oracle.Real, settings: oracle.Settings) -> Curve:
    """The same chip and materials in NGSolve."""
    ngsolve, geom2d = oracle.imported()
    device = filled(chip, inviscid)
    section, materials = device.section, device.materials
    mesh = oracle.triangles(ngsolve, geom2d, section, list(sides(chip, section)), materials, chip.band[1], settings)
    space, kept, electrode = oracle.unknowns(ngsolve, mesh, materials, settings.order, section.measure)
    parts = oracle.matrices(ngsolve, mesh, materials, space, kept, section.measure)
    liquid = materials[CAVITY]
    assert isinstance(liquid, Fluid)
    added = losses_of(ngsolve, mesh, liquid, space, kept, oracle.depth(ngsolve, section.measure), inviscid)
    parts = {power: sum(each[power] for each in (parts, added) if power in each) for power in {**parts, **added}}
    states, _ = oracle.solved(parts, electrode, frequency, settings.ordering)
    kinetic, compressional, area = energies(ngsolve, mesh, liquid, space, kept)
    energy = [0.25 * np.vdot(x, kinetic @ x / (2.0 * np.pi * f) ** 2 + compressional @ x).real / area
              for f, x in states]
    impedance = 1.0 / (-2j * np.pi * frequency * oracle.charges(parts, states))
    return Curve(frequency, np.array(energy), impedance, electrode.size - int(np.count_nonzero(electrode)))


def losses_of(
    ngsolve: ModuleType, mesh: Any, liquid: Fluid, space: Any, kept: Any, weight: Any, inviscid: bool
) -> dict[float, sparse.csr_matrix]:
    """Absorption in the bulk of the liquid, and unless `inviscid` its boundary layers, as matrices by their power of
    w: those of the module's docstring, and - i w delta / (rho c^4) p q with the diffusivity delta of sound."""
    (u, _, p), (v, _, q) = space.TnT()
    forms = {power: ngsolve.BilinearForm(space) for power in (1, -0.5, -2.5, 1.5)}
    rho, kappa = liquid.density, liquid.compressibility
    if liquid.diffusivity_of_sound is not None:
        inside = ngsolve.dx(definedon=mesh.Materials(CAVITY))
        forms[1] += -1j * liquid.diffusivity_of_sound * kappa / liquid.sound_speed**2 * weight * p * q * inside
    for boundary in () if inviscid else dict.fromkeys(mesh.GetBoundaries()):
        if boundary.rpartition("_")[0] != CAVITY:
            continue
        _, tangent = oracle.wall(ngsolve, boundary)
        on = ngsolve.ds(definedon=mesh.Boundaries(boundary))
        slope, slope_q = ngsolve.grad(p).Trace() * tangent, ngsolve.grad(q).Trace() * tangent
        along, along_v = u.Trace() * tangent, v.Trace() * tangent
        # Both at w = 1 rad/s: they fall as its root.
        beta = 0.5 * (1.0 + 1.0j) * math.sqrt(2.0 * liquid.shear_viscosity / rho)
        thermal = 0.5 * (1.0 + 1.0j) * math.sqrt(2.0 * liquid.thermal_conductivity / (rho * liquid.heat_capacity))
        forms[-2.5] += -beta / rho * weight * slope * slope_q * on
        forms[-0.5] += beta * weight * (slope * along_v + along * slope_q) * on
        forms[1.5] += -beta * rho * weight * along * along_v * on
        forms[-0.5] += -(liquid.heat_capacity_ratio - 1.0) * thermal * kappa * weight * p.Trace() * q.Trace() * on
    return {power: oracle.assembled(form, kept) for power, form in forms.items()}


def energies(ngsolve: ModuleType, mesh: Any, liquid: Fluid, space: Any, kept: Any) -> tuple[Any, Any, float]:
    """Matrices of 1 / rho |grad p|^2 and of |p|^2 / (rho c^2) over the channel, and its area (m^2)."""
    (_, _, p), (_, _, q) = space.TnT()
    inside = ngsolve.dx(definedon=mesh.Materials(CAVITY))
    forms = [ngsolve.BilinearForm(space) for _ in range(2)]
    forms[0] += 1.0 / liquid.density * ngsolve.grad(p) * ngsolve.grad(q) * inside
    forms[1] += liquid.compressibility * p * q * inside
    area = ngsolve.Integrate(ngsolve.CF(1.0) * inside, mesh)
    return *(oracle.assembled(form, kept) for form in forms), float(area)


# --------------------------------------------------------------------------------------------------------------------


def peak_near(chip: Chip, inviscid: bool, frequency: float) -> oracle.Real:
    """The frequencies (Hz) to compare at: about the largest E_ac near `frequency` on a coarse mesh."""
    span = np.linspace(frequency * (1.0 - SEARCH), frequency * (1.0 + SEARCH), SEARCHED)
    found = by_workbench(chip, inviscid, span, 1e-3).peak()
    half = WIDTHS * found["f0"] / found["Q"]
    return np.linspace(found["f0"] - half, found["f0"] + half, POINTS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chip", default="glass_channel", help="name of a straight chip in geometry/chips")
    parser.add_argument("--near", type=float, default=1.89, help="frequency near the resonance, MHz")
    parser.add_argument("--draft", type=float, default=0.0, help="angle by which the channel grows wider upwards, deg")
    parser.add_argument("--accuracy", type=float, default=1e-4, help="of the workbench's mesh")
    parser.add_argument("--order", type=int, default=5)
    parser.add_argument("--elements-per-wavelength", type=float, default=3.0)
    parser.add_argument("--levels", type=int, default=3, help="how often corners are graded")
    parser.add_argument("--layers", nargs="+", default=["on", "off"], choices=["on", "off"])
    with_json(parser)
    options = parser.parse_args()
    with measurements(options.json) as kept:
        measure(options, kept)


def measure(options: argparse.Namespace, kept: Measurements) -> None:
    chip = read_chip(oracle.ROOT / "geometry" / "chips" / f"{options.chip}.toml")
    if options.draft:
        draft = Dimension(math.radians(options.draft))
        chip = replace(chip, layers=tuple(each.with_shapes({"draft": draft}) if each.cavity_radius else each
                                          for each in chip.layers))
    settings = oracle.Settings(options.order, options.elements_per_wavelength, options.levels, 0.15, 0, "MMD_AT_PLUS_A")
    far: list[str] = []
    print("| layers | program | unknowns | f0 (MHz) | E_ac at 1 V (J/m^3) | Q |")
    print("| --- | --- | ---: | ---: | ---: | ---: |")
    for layers in options.layers:
        inviscid = layers == "off"
        frequency = peak_near(chip, inviscid, 1e6 * options.near)
        curves: Mapping[str, Curve] = {
            "NGSolve": alone(by_ngsolve, chip, inviscid, frequency, settings),
            "workbench": alone(by_workbench, chip, inviscid, frequency, options.accuracy)}
        peaks = {program: curve.peak() for program, curve in curves.items()}
        for program, found in peaks.items():
            print(f"| {layers} | {program} | {curves[program].unknowns} | {1e-6 * found['f0']:.6f} | "
                  f"{found['E_ac']:.5g} | {found['Q']:.2f} |", flush=True)
        off = {figure: abs(peaks["workbench"][figure] / value - 1.0) for figure, value in peaks["NGSolve"].items()}
        off["ln Z, rms"] = float(np.sqrt(np.mean(np.abs(np.log(
            curves["workbench"].impedance / curves["NGSolve"].impedance)) ** 2)))
        print(f"| {layers} | difference | | {off['f0']:.1e} | {off['E_ac']:.1e} | {off['Q']:.1e} |   "
              f"ln Z, rms {off['ln Z, rms']:.1e}", flush=True)
        for figure, value in off.items():
            kept.add(f"layers {layers}, {figure}", value, "1")
        far += [f"layers {layers}: {figure} off by {off[figure]:.1e}" for figure, tolerance in TOLERANCES.items()
                if not off[figure] <= tolerance]
    if far:
        raise SystemExit("; ".join(far))


if __name__ == "__main__":
    main()
