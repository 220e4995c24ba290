"""The spectrum of a state, by a reduced model or full solves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.names import CAVITY
from geometry.plausible import check_band
from materials.assumed import is_lossless
from materials.kinds import Fluid
from workbench.fem.solve import NotConverged, Solution, System
from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.jobs.progress import Progress
from workbench.model.job_size import check_points
from workbench.model.problem import FilledChip
from workbench.reduced.at_point import NotEnriched, reduced
from workbench.reduced.model import ReducedModel
from workbench.results.brief import Brief
from workbench.results.merit import Figures
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest number of frequencies that fail to converge, for each one that converges and in any case, before an error: a
#: free body without any support is singular everywhere. Doubled, the error takes twice as long.
FAILED_PER_SOLVED, FAILED_ANYWAY = 0.5, 5

#: Least number of frequencies within the half-power width of a resonance that determine its figures. Doubled, grids
#: that are accurate to 0.1 % would give a finding.
RESOLVED = 2

#: Largest ratio of the error of a reduced model to the requested one: up to it the model is used, with a finding.
#: Doubled, a spectrum may have an error of 2e-3 instead of the requested 1e-4.
NEARLY = 10.0

#: Relative distances of alternative frequencies for fields whose solve does not converge: within the width of a
#: resonance with Q = 1e4. Doubled, fields are further from the resonance and smaller.
NEARBY = (1e-5, -1e-5, 1e-4, -1e-4, 1e-3, -1e-3)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedSpectrum(Brief):
    """The impedance (n,) ohm, e^{-i w t}, at ``frequency`` (n,) Hz.

    Frequencies whose solve failed are left out. ``solves`` is the number of full solves and ``residual`` the largest
    scaled residual of them. ``error`` is the largest estimated relative error of the impedance by the reduced ``model``
    with its ``solution``; after full solves these are None and the error is 0.
    """

    frequency: Real
    impedance: Complex
    solves: int
    residual: float
    error: float = 0.0
    model: ReducedModel | None = None
    solution: Solution | None = None

    def change_from(self, other: SolvedSpectrum) -> str:
        """The largest change of ln Z from another spectrum in words."""
        changes = 100.0 * np.abs(np.log(self.impedance / other.impedance))
        at = int(changes.argmax())
        return (f"ln Z changes by {changes[at]:.3g} % at {self.frequency[at] / 1e6:.6g} MHz and less at the other "
                "frequencies")


def frequency_grid(band: tuple[float, float], points: int, *, source: str) -> Real:
    """Equally spaced frequencies (points,) in Hz over `band`, ends included.

    Raises:
        InputError: from the `source`, a wrong number of points, or a band that is not rising and positive.
    """
    low, high = band
    check_points(points, source=source)
    if not 0.0 < low < high < np.inf:
        raise InputError(source, "band", frequency_text(low, high), "a rising band of positive frequencies")
    return np.linspace(low, high, points)


def band_of(chip: Chip, band: tuple[float, float] | None) -> tuple[float, float]:
    """The requested band (Hz), or the chip's own.

    Raises:
        InputError: a band that is implausible for such a chip, unless the chip lists it as unusual.
    """
    if band is None:
        return chip.band
    if 0.0 < band[0] < band[1] and "band" not in chip.unusual:
        check_band(chip.layers, band, chip.file, "band")
    return band


def reduced_spectrum(
    system: System, frequencies: Real, relative_error: float, device: FilledChip, progress: Progress
) -> SolvedSpectrum:
    """The spectrum by the reduced model, possibly less accurate than requested.

    Raises:
        NotEnriched: the error is above :data:`NEARLY` times the tolerance; it has remedies for the `device`.
    """
    try:
        model, solution = reduced(system.operators, frequencies, system.values, tolerance=relative_error,
                                  skip_singular=True, system=system, progress=progress)
    except NotEnriched as error:
        if error.found is None or error.estimate > NEARLY * relative_error:
            raise NotEnriched(error.estimate, error.tolerance, error.solves,
                              remedy=_remedy(device, error.estimate)) from error
        model, solution = error.found
    return SolvedSpectrum(solution.frequency, solution.impedance, model.solves, model.residual,
                          float(model.error(solution).max()), model, solution)


def _remedy(device: FilledChip, estimate: float) -> str:
    power = 10.0 ** math.floor(math.log10(estimate))
    enough = next(each * power for each in (2.0, 5.0, 10.0) if each * power >= 1.2 * estimate)
    inside = device.materials.get(CAVITY)
    gas = (f' In a chip file, cavity = "vacuum" in place of "{device.state.cavity}" leaves out the modes of the gas, '
           "of which this band has many") if isinstance(inside, Fluid) and inside.is_gas else ""
    return (f'for state {device.state.name}, --relative-error "{100.0 * enough:.2g} %" (in Python relative_error='
            f"{enough:.0e}) accepts that, --full (full=True) solves every frequency, --from and --to narrow the band."
            f"{gas}")


def findings_of(
    found: SolvedSpectrum, requested: float, device: FilledChip, left_out: tuple[float, ...], spectrum: Spectrum,
    merit: Figures | None,
) -> tuple[str, ...]:
    """Findings on a spectrum and its resonance. They report frequencies (Hz) that are `left_out`, a reduced model above
    the `requested` error, an unknown energy, and a resonance with too few frequencies."""
    return (*_left_out(device, left_out, found.frequency.size + len(left_out)),
            *_inexact(found, requested, is_wet=device.is_wet), *_unresolved(spectrum, merit))


def _inexact(found: SolvedSpectrum, requested: float, *, is_wet: bool) -> tuple[str, ...]:
    """Findings on a reduced model above the `requested` error, or none. Without a reduced model, the energy of the
    sound over frequency is unknown."""
    if found.model is None:
        return ("full solves keep no states: the energy of the sound in the liquid is not known over frequency, and "
                "the fields are not at its peak; --at states their frequency",) if is_wet else ()
    if found.error <= requested:
        return ()
    return (f"the reduced model is at an estimated relative error of {found.error:.1e}, above the requested "
            f"{requested:.0e}; --full solves every frequency, --from and --to narrow the band",)


def full_spectrum(
    system: System, frequencies: Real, known: Mapping[float, complex],
    on_point: Callable[[float, complex], None] | None, progress: Progress,
) -> SolvedSpectrum:
    """The spectrum by full solves.

    `on_point` is called with each frequency and impedance (e^{+j w t}); points in `known` are not solved again.

    Raises:
        NotConverged: more frequencies than :data:`FAILED_PER_SOLVED` of them do not converge.
    """
    impedance = np.conj(np.array([known.get(float(f), 0.0) for f in frequencies], dtype=np.complex128))
    missing = np.flatnonzero(impedance == 0.0)
    residual, done, failed = 0.0, 0, list[NotConverged]()

    def leave_out(error: NotConverged) -> None:
        failed.append(error)
        if len(failed) > max(FAILED_PER_SOLVED * done, FAILED_ANYWAY):
            raise error

    for solution in system.sweep(frequencies[missing], failed=leave_out):
        done += 1
        (index,) = np.flatnonzero(frequencies == solution.frequency[0])
        impedance[index] = solution.impedance[0]
        residual = max(residual, float(solution.residual[0]))
        if on_point is not None:
            on_point(float(frequencies[index]), complex(np.conj(impedance[index])))
        progress("full spectrum", (done + len(failed)) / missing.size)
    if failed and missing.size < 2 + len(failed):
        raise failed[-1]
    solved = impedance != 0.0
    return SolvedSpectrum(frequencies[solved], impedance[solved], done, residual)


def solution_near(system: System, frequency: float) -> Solution:
    """The full solution at `frequency` (Hz), or at one of :data:`NEARBY`.

    Raises:
        NotConverged: it converges at none of them.
    """
    try:
        return system.solutions(np.array([frequency]))
    except NotConverged as error:
        for beside in NEARBY:
            try:
                return system.solutions(np.array([frequency * (1.0 + beside)]))
            except NotConverged:
                continue
        raise error


def _left_out(device: FilledChip, frequencies: tuple[float, ...], requested: int) -> tuple[str, ...]:
    """The finding on `frequencies` (Hz) at which no solve converged."""
    if not frequencies:
        return ()
    listed = ", ".join(f"{f / 1e6:.6g}" for f in frequencies[:5]) + (" ..." if len(frequencies) > 5 else "")
    return (f"{len(frequencies)} of {requested} frequencies are left out, because the solve there did not converge: "
            f"{listed} MHz. {undamped(device)}",)


def _unresolved(spectrum: Spectrum, merit: Figures | None) -> tuple[str, ...]:
    """Findings on a weak resonance, and on one with few frequencies."""
    if merit is None:
        return ()
    width = merit.f2 - merit.f1
    inside = merit.count_within(spectrum.frequency)
    if inside >= RESOLVED:
        return (merit.weakness,) if merit.is_weak else ()
    enough = math.ceil((spectrum.frequency[-1] - spectrum.frequency[0]) / width * 2 * RESOLVED) + 1
    return (f"{inside} of the {spectrum.frequency.size} frequencies lie within the resonance, which is "
            f"{width / 1e3:.3g} kHz wide: f0, Z_min and Q may be far off; {enough} points, or a narrower band, would "
            "show it.",)


def undamped(device: FilledChip) -> str:
    """The reason why a solve may not converge, from the materials."""
    lossless = [f"{material.name} ({region})" for region, material in device.materials.items()
                if not isinstance(material, Fluid) and is_lossless(material)]
    if not lossless:
        return "The model is close to singular there: a resonance with next to no loss"
    return f"A resonance without loss has no height: state a loss of {', '.join(lossless)}"
