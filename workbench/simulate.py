"""The main job in Python: a chip in its states becomes spectra, figures of merit, fields and traps.

    result = simulate(read_chip("chip.toml"), "filled")
    result.spectrum, result.figures, result.fields, result.traps
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import geometry.mesh
from geometry.chip import Chip
from geometry.names import CAVITY
from inputs import InputError
from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry
from workbench import particles
from workbench.drive import Drive, VoltageDrive
from workbench.fields import Fields, fields
from workbench.merit import Figures, NoResonance, figures
from workbench.operators import FullOperators, assemble
from workbench.problem import Problem, build, mesh_speeds
from workbench.reduce import reduce
from workbench.solve import Solution, System, one_thread, sweep
from workbench.spectrum import Origin, Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Called with what is being done and the fraction of it that is done.
Progress = Callable[[str, float], None]


class MeshTooCoarse(UserWarning):
    """The mesh has fewer elements per wavelength than asked for at some frequency in some region."""


def quiet(_activity: str, _fraction: float) -> None:
    """A :data:`Progress` that shows nothing."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """One state of a chip, simulated.

    ``figures`` is None where the band has no resonance, and ``no_resonance`` says why. ``fields`` are those at f0, or
    at the frequency asked for. ``losses`` (W) dissipated there by region under the drive, ``closure`` their relative
    difference from the electrical input power. ``error`` is the largest estimated relative error of the
    impedance (0 for a full solve), ``solves`` the number of full solves, ``residual`` the largest scaled residual of
    one. ``traps`` is None without a fluid-filled cavity and a particle. ``seconds`` by step.
    """

    chip: Chip
    state: str
    problem: Problem
    operators: FullOperators
    spectrum: Spectrum
    figures: Figures | None
    no_resonance: str
    fields: Fields
    losses: Mapping[str, float]
    closure: float
    traps: particles.TrapReport | None
    error: float
    solves: int
    residual: float
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the full model."""
        return self.operators.size


def frequency_grid(band: tuple[float, float], points: int) -> Real:
    """`points` equally spaced frequencies (Hz) over `band`, both ends included.

    Raises:
        InputError: fewer than 5 points, or a band that is not rising and positive.
    """
    low, high = band
    if points < 5:
        raise InputError("simulate", "points", points, "at least 5 frequencies")
    if not 0.0 < low < high < np.inf:
        raise InputError("simulate", "band", f"{low:g} to {high:g} Hz", "a rising band of positive frequencies")
    return np.linspace(low, high, points)


def simulate(
    chip: Chip,
    state: str | None = None,
    *,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 481,
    at: float | None = None,
    full: bool = False,
    tolerance: float = 1e-5,
    drive: Drive | None = None,
    elements_per_wavelength: float = 10.0,
    mesh_cache: Path | None = None,
    on_point: Callable[[float, complex], None] | None = None,
    known: Mapping[float, complex] | None = None,
    progress: Progress = quiet,
) -> Simulation:
    """Simulate a chip in one of its states.

    Args:
        state: name of the state; the last one of the file if not given.
        band: two frequencies (Hz); the chip's own if not given. The mesh is made for its upper end.
        at: frequency (Hz) of the fields; f0 if not given, the middle of the band if there is no resonance.
        full: solve every frequency instead of the reduced model; `on_point` is then called with every frequency and
            impedance (e^{+j w t}) as soon as it is known, and points in `known` are not solved again.
        tolerance: relative error of the reduced model's impedance.
        drive: how the device is driven; 10 Vpp at the electrodes if not given.

    Raises:
        InputError: something in the chip, its materials or the arguments.
        NotConverged, NotEnriched: a full solve or the reduced model did not reach its tolerance.
    """
    started = time.perf_counter()
    seconds: dict[str, float] = {}

    def lap(name: str) -> None:
        nonlocal started
        now = time.perf_counter()
        seconds[name], started = now - started, now

    name = chip.states[-1].name if state is None else chip.state(state).name
    frequencies = frequency_grid(chip.band if band is None else band, points)
    span = (float(frequencies[0]), float(frequencies[-1]))
    progress("mesh", 0.0)
    problem = build(chip, name, registry or Registry(), band=span, elements_per_wavelength=elements_per_wavelength,
                    cache=mesh_cache)
    lap("mesh")
    operators = assemble(problem.mesh, problem.terms)
    lap("assembly")
    if full:
        impedance, solves, residual = _full_spectrum(operators, frequencies, problem, known or {}, on_point, progress)
        error = 0.0
        model = None
    else:
        model = reduce(operators, frequencies, problem.values, tolerance=tolerance,
                       progress=lambda fraction: progress("reduced model", fraction))
        solution = model.solve(frequencies, problem.values)
        impedance, solves, residual = solution.impedance, model.solves, model.residual
        error = float(model.error(solution).max())
    spectrum = Spectrum.from_solver(frequencies, impedance, origin=_origin(chip, name, problem, full, error))
    lap("spectrum")
    try:
        merit, reason = figures(spectrum), ""
    except NoResonance as missing:
        merit, reason = None, missing.reason
    frequency = at if at is not None else merit.f0 if merit is not None else 0.5 * (span[0] + span[1])
    check_mesh(problem, frequency, elements_per_wavelength)
    progress("fields", 0.0)
    with one_thread():
        exact, last_residual = System(operators, problem.values).solve(frequency)
    found = fields(problem, operators, exact, frequency, drive or VoltageDrive())
    losses, closure = loss_budget(problem, operators, exact, frequency, abs(found.voltage))
    traps = _traps(chip, name, problem, found, registry or Registry())
    lap("fields")
    progress("fields", 1.0)
    return Simulation(chip, name, problem, operators, spectrum, merit, reason, found, losses, closure, traps, error,
                      solves + 1, max(residual, last_residual), seconds)


def _full_spectrum(
    operators: FullOperators, frequencies: Real, problem: Problem, known: Mapping[float, complex],
    on_point: Callable[[float, complex], None] | None, progress: Progress,
) -> tuple[Complex, int, float]:
    """Impedance (e^{-i w t}) at every frequency by full solves, their number, and the largest residual."""
    impedance = np.array([np.conj(known.get(float(f), 0.0)) for f in frequencies])
    missing = np.flatnonzero(impedance == 0.0)
    residual = 0.0
    for done, (index, solution) in enumerate(zip(missing, sweep(operators, frequencies[missing], problem.values),
                                                 strict=True), start=1):
        impedance[index] = solution.impedance[0]
        residual = max(residual, float(solution.residual[0]))
        if on_point is not None:
            on_point(float(frequencies[index]), complex(np.conj(impedance[index])))
        progress("full spectrum", done / missing.size)
    return impedance, int(missing.size), residual


def check_mesh(problem: Problem, frequency: float, wanted: float) -> None:
    """Warn, once for the problem, of every region with too few elements per wavelength at `frequency` (Hz)."""
    speeds = {region: speed for region, speed in mesh_speeds(problem.mesh.section.regions, problem.materials).items()
              if np.isfinite(speed)}
    counts = geometry.mesh.elements_per_wavelength(problem.mesh, speeds, frequency)
    coarse = {region: count for region, count in counts.items() if count < wanted * (1.0 - 1e-9)}
    if coarse:
        listed = ", ".join(f"{count:.1f} in {region}" for region, count in coarse.items())
        warnings.warn(f"{problem.name}: elements per wavelength at {frequency / 1e6:.4g} MHz: {listed}; wanted "
                      f"{wanted:g}. Make the mesh for a band that reaches this frequency", MeshTooCoarse, stacklevel=3)


def loss_budget(
    problem: Problem, operators: FullOperators, state: Complex, frequency: float, voltage: float
) -> tuple[dict[str, float], float]:
    """Power (W) lost in every place at the electrode voltage amplitude, and how far the sum is from the input power."""
    omega = 2.0 * np.pi * frequency
    g = np.array([[i.coefficient(np.array([omega]), problem.values)[0] for i in operators.integrals]])
    solution = Solution(operators, np.array([frequency]), g, state[:, None], np.zeros(1))
    parts = solution.dissipation()[0] * voltage**2
    losses: dict[str, float] = {}
    for integral, power in zip(operators.integrals, parts, strict=True):
        if power != 0.0:
            losses[integral.place] = losses.get(integral.place, 0.0) + float(power)
    supplied = float(solution.input_power()[0]) * voltage**2
    return losses, abs(sum(losses.values()) / supplied - 1.0) if supplied else 0.0


def _traps(
    chip: Chip, state: str, problem: Problem, found: Fields, registry: Registry
) -> particles.TrapReport | None:
    chosen = chip.state(state)
    fluid = problem.materials.get(CAVITY)
    if not isinstance(fluid, Fluid) or chosen.particle is None or chosen.particle_radius is None:
        return None
    material = registry.load(chosen.particle)
    if not isinstance(material, IsotropicSolid):
        raise InputError(chip.file, f"states.{state}.particle", chosen.particle, "an isotropic solid")
    bead = particles.particle_from(material, chosen.particle_radius)
    forces = particles.particle_forces(found, bead, fluid=fluid, region=CAVITY, drive=found.drive)
    return particles.find_traps(forces)


def _origin(chip: Chip, state: str, problem: Problem, full: bool, error: float) -> Origin:
    method = "full solves" if full else f"reduced model, estimated relative error at most {error:.1e}"
    settings = {"chip": chip.name, "state": state, "method": method,
                **{f"material of {region}": material.name for region, material in problem.materials.items()}}
    return Origin(kind="simulated", source=chip.file, settings=settings)
