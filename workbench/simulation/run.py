"""Simulation of a chip: spectrum, figures of merit, fields and traps.

    result = simulate(read_chip("chip.toml"), "filled")
    result.spectrum, result.figures, result.fields, result.traps
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import geometry.mesh
from geometry.chip import Chip
from geometry.names import CAVITY
from geometry.operating_point import check_operating_point
from geometry.plausible import check_frequency
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.fields import Fields, fields
from workbench.acoustics.forces import particle_forces
from workbench.acoustics.traps import TrapReport, barrier_words, find_traps
from workbench.fem.capacitance import Capacitance, capacitance
from workbench.fem.energy import by_place
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, System
from workbench.files.errors import InputError, expect
from workbench.jobs.progress import Laps, Progress, no_progress
from workbench.model.discretisation import ACCURACY, ROWS, Discretisation
from workbench.model.drive import Drive, check_drive, wired
from workbench.model.problem import FilledChip, Problem, build, fill
from workbench.reduced.at_point import reduced
from workbench.reduced.model import ReducedModel
from workbench.results.brief import Brief
from workbench.results.circuit import CircuitFit
from workbench.results.coupling import plate_of
from workbench.results.merit import Figures, measured_figures
from workbench.results.notebook import Shown, Summary
from workbench.results.resonances import resonances_of
from workbench.results.spectrum import Origin, Spectrum
from workbench.simulation.energy import EnergySpectrum, energy_spectrum_of
from workbench.simulation.features import mesh_lines, part_of, spectrum_with
from workbench.simulation.fixed_point import warmed
from workbench.simulation.mesh_error import MeshErrorEstimate
from workbench.simulation.mesh_error import estimate as mesh_error
from workbench.simulation.operating_point import OperatingPoint, operating_point
from workbench.simulation.pattern import CavityPattern, cavity_pattern
from workbench.simulation.peak_modes import PeakMode, peak_modes
from workbench.simulation.solved_spectrum import (
    SolvedSpectrum,
    band_of,
    findings_of,
    frequency_grid,
    full_spectrum,
    reduced_spectrum,
    solution_near,
    undamped,
)
from workbench.simulation.taper import spectrum_with_taper
from workbench.simulation.warm import WarmState, WarmUp

if TYPE_CHECKING:
    import xarray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest ratio of the error of a mesh to its estimate, for the warning: 1.2 to 2.9 for the meshes of all accuracies of
#: the small example chip (one more order shows only a part of the error of a singular corner).
ERROR_OVER_ESTIMATE = 3.0

#: A driven chip warms up in still air, at a fixed frequency.
IN_STILL_AIR = WarmUp()


class MeshTooCoarse(UserWarning):
    """The mesh is coarser than requested. It has fewer elements per wavelength than its discretisation in some region,
    or a larger error."""


@dataclass(frozen=True, eq=False, repr=False)
class DrawnState(Brief):
    """One state at one frequency and drive, for pictures. ``losses`` (W) are by region, ``closure`` is their relative
    difference from the electrical input power. ``traps`` is None without a fluid-filled cavity and a particle.
    ``pattern`` is that of the cavity of a simulated chip with features."""

    chip: Chip
    state: str
    problem: Problem
    fields: Fields
    losses: Mapping[str, float]
    closure: float
    traps: TrapReport | None
    pattern: CavityPattern | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(DrawnState):
    """One state at one frequency and drive, with its solution.

    ``residual`` is the scaled residual of the solve. ``findings`` are sentences on assumptions about the materials, and
    on failed solves. ``solution`` is the full one, at 1 V. ``warm`` is the steady state of the driven chip; if it
    matters, the fields and the ``problem`` are those of the warm chip. It is None if the chip is kept at its stated
    temperature, or if the warm state is unknown.
    """

    residual: float
    findings: tuple[str, ...]
    solution: Solution
    warm: WarmState | None = field(default=None, kw_only=True)

    @property
    def stated_problem(self) -> Problem:
        """The problem at the stated temperature."""
        return self.problem if self.warm is None else self.warm.problem

    @property
    def liquid_rise(self) -> float:
        """The rise (K) of the liquid above its stated temperature."""
        return 0.0 if self.warm is None else self.warm.rise

    @property
    def drawn(self) -> DrawnState:
        """The small part for pictures, which goes to another process."""
        return DrawnState(**{each.name: getattr(self, each.name) for each in dataclasses.fields(DrawnState)})


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Snapshot, Shown):
    """One state of a chip over a band, with a snapshot.

    The snapshot is at the operating point ``operating``. ``figures`` is None if the band has no resonance, and
    ``no_resonance`` gives the reason. ``error`` is the largest estimated relative error of the impedance by the reduced
    model (0 for a full solve), ``mesh_error`` that by the mesh (of ln Z; None after full solves, whose states are not
    stored), ``solves`` the number of full solves, ``residual`` the largest scaled residual of one. ``capacitance`` is
    that of the electrodes. ``seconds`` are by step. ``left_out`` (Hz) are requested frequencies whose solve did not
    converge. ``energy`` of the sound in the cavity over the band is None without a liquid there and after full solves.
    ``peak_modes`` are the modes behind its peaks and those of the conductance, empty after full solves.
    """

    operators: FullOperators
    spectrum: Spectrum
    figures: Figures | None
    no_resonance: str
    error: float
    mesh_error: MeshErrorEstimate | None
    solves: int
    capacitance: Capacitance
    seconds: Mapping[str, float]
    operating: OperatingPoint
    energy: EnergySpectrum | None = None
    left_out: tuple[float, ...] = ()
    peak_modes: tuple[PeakMode, ...] = ()

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the full model."""
        return self.operators.size

    @cached_property
    def resonances(self) -> CircuitFit | None:
        """The resonances of the band (`wb.fit_resonances`), or None."""
        return resonances_of(self.spectrum)

    def summary(self) -> Summary:
        """Figures of merit, traps and the model's accuracy, for a notebook."""
        merit = self.figures
        rows = [("f0, Z_min, Q", self.no_resonance if merit is None else
                 f"{merit.f0 / 1e6:.6g} MHz, {merit.z_min:.4g} ohm, {merit.q:.4g}"),
                ("fields", f"{self.fields.frequency / 1e6:.6g} MHz, {self.fields.drive}"),
                ("operating point", str(self.operating))]
        if self.traps is not None:
            rows += [("trap", f"{trap.measure.symbol} {1e3 * trap.radius:.3g} mm, "
                      f"{1e3 * trap.above_floor:.3g} mm above the floor, barrier "
                      f"{barrier_words(trap.barrier)}, {100.0 * trap.share:.0f} % of the cavity")
                     for trap in self.traps.traps[:3]]
        if self.warm is not None:
            rows.append(("warm chip", str(self.warm)))
        rows += [("finding", text) for text in self.findings]
        rows.append(("estimated error of Z", f"{100.0 * self.error:.1g} % by the reduced model" + (
            "" if self.mesh_error is None else f", {100.0 * self.mesh_error.rms:.1g} % rms by the mesh")))
        return Summary(f"{self.chip.name}, {self.state}", tuple(rows), {self.state: self.spectrum})

    def to_xarray(self) -> xarray.Dataset:
        """The spectrum (:meth:`Spectrum.to_xarray`) with figures as attributes. They are in Hz, ohm and 1."""
        found = self.spectrum.to_xarray().assign_attrs(chip=self.chip.name, state=self.state,
                                                       estimated_relative_error=self.error)
        if self.figures is not None:
            found = found.assign_attrs(f0_hz=self.figures.f0, z_min_ohm=self.figures.z_min, q=self.figures.q)
        return found


def simulate(
    chip: Chip,
    state: str | None = None,
    *,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 481,
    at: float | str | None = None,
    full: bool = False,
    relative_error: float = 1e-4,
    drive: Drive | None = None,
    accuracy: float | Discretisation = ACCURACY,
    on_point: Callable[[float, complex], None] | None = None,
    known: Mapping[float, complex] | None = None,
    on_spectrum: Callable[[Spectrum], object] = lambda _spectrum: None,
    progress: Progress = no_progress,
    assumed_losses: bool = True,
    inviscid: bool = False,
    warm: WarmUp | None = IN_STILL_AIR,
) -> Simulation:
    """Simulate a chip in one of its states.

    Frequencies at which no solve converges are left out; a finding names them.

    Args:
        state: name of the state; default: the last one of the file.
        band: two frequencies (Hz); default: the chip's band. The mesh is made for its upper end.
        at: frequency (Hz) of the fields, or "energy" or "f0". Default: the chip's operating point, or else the largest
            peak of the energy in the cavity under the drive, f0 without one, the band's middle without either.
        full: solve every frequency instead of the reduced model; `on_point` is then called with every frequency and
            impedance (e^{+j w t}) as soon as it is known, and points in `known` are not solved again.
        relative_error: of the reduced model's impedance.
        drive: drive of the device; default: 10 Vpp at the electrodes.
        accuracy: relative error of Z for the choice of the mesh, or a discretisation.
        assumed_losses: give a ceramic without any loss that of `materials.assumed`; a finding reports it.
        inviscid: leave out the boundary layers of the cavity's fluid; a finding reports it.
        warm: ways for the heat to leave; the fields are those of the warm chip. None, for example with a Peltier
            element, keeps the liquid at its stated temperature. The spectrum is always at the stated temperature.
        on_spectrum: called with the spectrum as soon as it is known; again with the error of its mesh.

    Raises:
        InputError: a mistake in the chip, its materials or the arguments; a model that does not fit in memory.
        NotConverged: the full solves converge at few of the frequencies, or nowhere near that of the fields.
        NotEnriched: the reduced model did not reach its tolerance.
    """
    _check_operation(chip, None if isinstance(at, str) else at, drive, source="simulate", field="at")
    check_operating_point(chip.operating_point if at is None else None, band or chip.band, chip.file)
    at, drive, lap = at if at is None or isinstance(at, str) else float(at), wired(drive, chip), Laps()
    device = fill(chip, state, registry := _assuming(registry, assumed_losses, inviscid))
    _check_relative_error(relative_error, source="simulate")
    if chip.not_round and full:
        raise InputError(chip.file, "features" if chip.features else "taper", f"{'; '.join(chip.not_round)}, in a "
                         "spectrum of full solves", "reduced models for a chip that is not round (without --full): "
                         "they couple the orders of its fields")
    frequencies = frequency_grid(band_of(chip, band), points, source="simulate")
    progress("mesh", 0.0)
    span, of_mesh, energy = (float(frequencies[0]), float(frequencies[-1])), None, None
    parts = [part_of(feature) for feature in chip.features]
    radii, levels = mesh_lines(chip, parts)
    problem = build(device, band=span, accuracy=accuracy, radii=radii, levels=levels, with_features=True)
    lap("mesh")
    system = System(assemble(problem.mesh, problem.terms), problem.values)
    lap("assembly")
    found = full_spectrum(system, frequencies, known or {}, on_point, progress) if full else \
        reduced_spectrum(system, frequencies, relative_error, device, progress)
    lap("spectrum")
    if found.model is not None and found.solution is not None:
        on_spectrum(_spectrum_of(found, device))
        energy = energy_spectrum_of(found.model, found.solution, problem.values, chip) if device.is_wet else None
        of_mesh = _mesh_error(found.model, found.frequency, problem, accuracy, progress)
        lap("error of the mesh")
    more: tuple[str, ...] = ()
    if chip.features:
        found, more = spectrum_with(chip, parts, problem, found, progress)
        lap("features")
    if chip.transducer.taper:
        found, tapered = spectrum_with_taper(chip, problem, found, progress)
        more = (*more, tapered)
        lap("taper")
    on_spectrum(spectrum := _spectrum_of(found, device, of_mesh))
    merit, reason = measured_figures(spectrum, plate_of(chip, device.materials))
    operating = operating_point(at, chip.operating_point, merit, 0.5 * sum(span), energy, drive, source="simulate")
    progress("fields", 0.0)
    shot = _snapshot(device, problem, system, operating.frequency, drive, warm, registry, found.model)
    lap("fields")
    progress("fields", 1.0)
    electrodes = capacitance(system)
    named = () if found.model is None or found.solution is None else peak_modes(
        found.model, found.solution, system, electrodes.clamped, operating.peaks)
    lap("modes of the peaks")
    pattern = None
    if chip.features and device.is_wet:
        pattern = cavity_pattern(shot.problem, shot.solution, parts, drive, progress=progress,
                                 forces=None if shot.traps is None else shot.traps.forces)
        more = (*more, str(pattern))
        lap("pattern around the axis")
    left_out = tuple(map(float, np.setdiff1d(frequencies, found.frequency)))
    return Simulation(
        chip=chip, state=shot.state, problem=shot.problem, fields=shot.fields, losses=shot.losses, closure=shot.closure,
        traps=shot.traps, residual=max(found.residual, shot.residual), operators=system.operators, spectrum=spectrum,
        figures=merit, no_resonance=reason, error=found.error, mesh_error=of_mesh, solves=found.solves + 1,
        seconds=lap.seconds, capacitance=electrodes, peak_modes=named, left_out=left_out, solution=shot.solution,
        energy=energy, warm=shot.warm, pattern=pattern,
        operating=replace(operating, follows=shot.warm is not None and shot.warm.is_followed),
        findings=(*more, *findings_of(found, relative_error, device, left_out, spectrum, merit), *shot.findings))


def energy_spectrum(
    chip: Chip,
    state: str | None = None,
    *,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    points: int = 481,
    relative_error: float = 1e-4,
    accuracy: float | Discretisation = ACCURACY,
    inviscid: bool = False,
    progress: Progress = no_progress,
) -> EnergySpectrum:
    """The mean energy density of sound in the cavity over a band.

    See :func:`simulate`.

    Raises:
        InputError: a mistake in the chip, its materials or the arguments; a state without a liquid in its cavity.
        NotConverged, NotEnriched: as of :func:`simulate`.
    """
    expect(chip, Chip, reader="read_chip", source="energy_spectrum", field="chip")
    _check_relative_error(relative_error, source="energy_spectrum")
    device = fill(chip, state, _assuming(registry, True, inviscid))
    if not device.is_wet:
        raise InputError("energy_spectrum", "state", device.state.name, "a state with a liquid in its cavity")
    frequencies = frequency_grid(band_of(chip, band), points, source="energy_spectrum")
    problem = build(device, band=(float(frequencies[0]), float(frequencies[-1])), accuracy=accuracy)
    model, solution = reduced(assemble(problem.mesh, problem.terms), frequencies, problem.values,
                              tolerance=relative_error, skip_singular=True, progress=progress)
    return energy_spectrum_of(model, solution, problem.values, chip)


def _assuming(registry: Registry | None, assumed_losses: bool, inviscid: bool) -> Registry:
    registry = registry or Registry()
    return replace(registry, assumed_losses=assumed_losses or registry.assumed_losses,
                   inviscid=inviscid or registry.inviscid)


def _check_operation(chip: Chip, frequency: float | None, drive: Drive | None, *, source: str, field: str) -> None:
    expect(chip, Chip, reader="read_chip", source=source, field="chip")
    if frequency is not None and "band" not in chip.unusual:
        check_frequency(frequency, chip.band, source=source, field=field)
    check_drive(drive, source=source)


def _check_relative_error(relative_error: float, *, source: str) -> None:
    if not 0.0 < relative_error < 1.0:
        raise InputError(source, "relative_error", relative_error, "a relative error between 0 and 1")


def _mesh_error(
    model: ReducedModel, frequencies: Real, problem: Problem, accuracy: float | Discretisation, progress: Progress
) -> MeshErrorEstimate:
    """The estimated error of the mesh; warns if above the requested one.

    One digit, for the estimate has no more, and no place in the caller's code: a chip simulated again warns once.
    """
    progress("error of the mesh", 0.0)
    error = mesh_error(model, frequencies, problem.values)
    if isinstance(accuracy, float) and float(shown := f"{100.0 * error.rms:.1g}") > 100.0 * accuracy:
        finer = [row for row in ROWS if row < accuracy]
        remedy = "there is no finer one" if not finer else (
            f'--accuracy "{100.0 * max(finer):g} %" (in Python accuracy={max(finer):g}) makes a finer one')
        warnings.warn(f"{problem.name}: the mesh has an estimated error of {shown} % rms in Z, above "
                      f"the {100.0 * accuracy:g} % that it was made for; {remedy}. The error itself is "
                      f"up to {ERROR_OVER_ESTIMATE:g} times its estimate where corners are sharp", MeshTooCoarse,
                      stacklevel=1)
    return error


def snapshot(
    chip: Chip,
    state: str | None,
    frequency: float,
    *,
    registry: Registry | None = None,
    band: tuple[float, float] | None = None,
    drive: Drive | None = None,
    accuracy: float | Discretisation = ACCURACY,
    progress: Progress = no_progress,
    assumed_losses: bool = True,
    inviscid: bool = False,
    warm: WarmUp | None = None,
) -> Snapshot:
    """A chip in one state at one `frequency` (Hz).

    It takes one full solve; see :func:`simulate`. The liquid is at its stated temperature, unless `warm` states the
    ways for the heat of the drive to leave.

    Raises:
        InputError: a mistake in the chip, its materials or the arguments.
        NotConverged: the solve did not reach its tolerance there or nearby.
    """
    _check_operation(chip, frequency, drive, source="snapshot", field="frequency")
    registry = _assuming(registry, assumed_losses, inviscid)
    device = fill(chip, state, registry)
    progress("mesh", 0.0)
    problem = build(device, band=band_of(chip, band), accuracy=accuracy)
    progress("fields", 0.5)
    system = System(assemble(problem.mesh, problem.terms), problem.values)
    drive = wired(drive, chip)
    found = _snapshot(device, problem, system, frequency, drive, warm, registry)
    progress("fields", 1.0)
    return found


def _snapshot(
    device: FilledChip, problem: Problem, system: System, frequency: float, drive: Drive, warm: WarmUp | None,
    registry: Registry, model: ReducedModel | None = None,
) -> Snapshot:
    """The full solution of a device, warm if that matters. Particles are those of the stated temperature."""
    check_mesh(problem, frequency)
    device.check_validity((frequency, frequency))
    solution, state = solution_near(system, frequency), None
    findings = device.findings
    if solution.frequency[0] != frequency:
        findings = (f"the fields are of {solution.frequency[0] / 1e6:.8g} MHz, because the solve at "
                    f"{frequency / 1e6:.8g} MHz did not converge. {undamped(device)}", *findings)
    if warm is not None:
        found = warmed(problem, solution, drive, warm, registry=registry, model=model)
        state, findings = found.state, (*filter(None, (found.reason,)), *findings)
        if found.problem is not None and found.solution is not None:
            problem, solution = found.problem, found.solution
            device = replace(device, materials=problem.materials)
    assert isinstance(solution.operators, FullOperators)
    shown = fields(problem, solution.operators, solution, drive)
    losses, closure = loss_budget(solution, abs(shown.voltage))
    return Snapshot(device.chip, device.state.name, problem, shown, losses, closure, _traps(device, shown),
                    float(solution.residual[0]), findings, solution, warm=state)


def check_mesh(problem: Problem, frequency: float) -> None:
    """Warn of every region that is too coarse at `frequency` (Hz). It has fewer elements per wavelength than its
    discretisation. A mesh of the caller's own is not checked."""
    made = problem.discretisation
    if made is None:
        return
    wanted = made.elements_per_wavelength
    speeds = {region: speed
              for region, speed in made.mesh_speeds(problem.mesh.section.regions, problem.materials).items()
              if np.isfinite(speed)}
    counts = geometry.mesh.elements_per_wavelength(problem.mesh, speeds, frequency)
    coarse = {region: count for region, count in counts.items() if count < wanted * (1.0 - 1e-9)}
    if coarse:
        listed = ", ".join(f"{count:.1f} in {region}" for region, count in coarse.items())
        warnings.warn(f"{problem.name}: elements per wavelength at {frequency / 1e6:.4g} MHz: {listed}; wanted "
                      f"{wanted:g}. Make the mesh for a band that reaches this frequency", MeshTooCoarse, stacklevel=3)


def loss_budget(solution: Solution, voltage: float) -> tuple[dict[str, float], float]:
    """Power (W) by place of the loss, and its closure. The closure is the relative difference of their sum from the
    electrical input power. `voltage` is the amplitude at the electrodes (V); the solution is at one frequency."""
    powers = by_place(solution.operators.integrals, solution.dissipation() * voltage**2)
    losses = {place: float(power[0]) for place, power in powers.items()}
    supplied = float(solution.input_power()[0]) * voltage**2
    return losses, abs(sum(losses.values()) / supplied - 1.0) if supplied else 0.0


def _traps(device: FilledChip, found: Fields) -> TrapReport | None:
    fluid = device.materials.get(CAVITY)
    if not isinstance(fluid, Fluid) or device.particle is None:
        return None
    return find_traps(particle_forces(found, device.particle, fluid=fluid, region=CAVITY))


def _spectrum_of(found: SolvedSpectrum, device: FilledChip, of_mesh: MeshErrorEstimate | None = None) -> Spectrum:
    method = "full solves"
    if found.model is not None:
        method = f"reduced model, estimated relative error at most {found.error:.1e}"
    if of_mesh is not None:
        method += f", of its mesh {of_mesh.rms:.1e} rms"
    settings = {"chip": device.chip.name, "state": device.state.name, "method": method,
                **{f"material of {region}": material.name for region, material in device.materials.items()}}
    return Spectrum.from_solver(found.frequency, found.impedance, origin=Origin(
        kind="simulated", source=device.chip.file, settings=settings))
