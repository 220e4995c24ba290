"""The spectrum of a state, by the reduced model or by full solves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.plausible import check_band
from workbench.fem.solve import NotConverged, Solution, System
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress
from workbench.model.job_size import check_points
from workbench.reduced.at_point import NotEnriched, reduced
from workbench.reduced.model import ReducedModel
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of frequencies that may fail to converge for each one that does, and number in any case, before a spectrum is
#: given up: a model that is singular everywhere is not held by anything. Doubled, the message takes twice as long.
FAILED_PER_SOLVED, FAILED_ANYWAY = 0.5, 5

#: Ratio of the error of a reduced model to the requested one up to which it is used, and said. Doubled, a spectrum may
#: be off by 2e-3 where 1e-4 was asked.
NEARLY = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class SolvedSpectrum(Brief):
    """The impedance (n,) ohm, e^{-i w t}, at the ``frequency`` (n,) Hz of all requested ones that could be solved.

    ``solves`` is the number of full solves and ``residual`` the largest scaled residual of them; ``error`` the largest
    estimated relative error of the impedance by the reduced model, whose ``model`` and ``solution`` are None, and error
    0, after full solves.
    """

    frequency: Real
    impedance: Complex
    solves: int
    residual: float
    error: float = 0.0
    model: ReducedModel | None = None
    solution: Solution | None = None


def frequency_grid(band: tuple[float, float], points: int) -> Real:
    """Equally spaced frequencies (points,) in Hz over `band`, both ends included.

    Raises:
        InputError: fewer than 5 points, or a band that is not rising and positive.
    """
    low, high = band
    if points < 5:
        raise InputError("simulate", "points", points, "at least 5 frequencies")
    check_points(points, source="simulate")
    if not 0.0 < low < high < np.inf:
        raise InputError("simulate", "band", f"{low:g} to {high:g} Hz", "a rising band of positive frequencies")
    return np.linspace(low, high, points)


def band_of(chip: Chip, band: tuple[float, float] | None) -> tuple[float, float]:
    """The requested band (Hz), or the chip's own.

    Raises:
        InputError: a band that nobody drives such a chip in, and that the chip does not list as unusual.
    """
    if band is None:
        return chip.band
    if 0.0 < band[0] < band[1] and "band" not in chip.unusual:
        check_band(chip.layers, band, chip.file, "band")
    return band


def reduced_spectrum(
    system: System, frequencies: Real, relative_error: float, progress: Progress
) -> SolvedSpectrum:
    """The spectrum by the reduced model; one that nearly reached its tolerance is better than none.

    Raises:
        NotEnriched: it is off by more than :data:`NEARLY` times the tolerance.
    """
    try:
        model, solution = reduced(system.operators, frequencies, system.values, tolerance=relative_error,
                                  skip_singular=True, system=system, progress=progress)
    except NotEnriched as error:
        if error.found is None or error.estimate > NEARLY * relative_error:
            raise
        model, solution = error.found
    return SolvedSpectrum(solution.frequency, solution.impedance, model.solves, model.residual,
                          float(model.error(solution).max()), model, solution)


def findings_of(found: SolvedSpectrum, asked: float, *, is_wet: bool) -> tuple[str, ...]:
    """Findings that the reduced model is off by more than was `asked`, or that without it the energy of the sound in a
    liquid is not known over frequency."""
    if found.model is None:
        return ("full solves keep no states: the energy of the sound in the liquid is not known over frequency, and "
                "the fields are not at its peak; --at states their frequency",) if is_wet else ()
    if found.error <= asked:
        return ()
    return (f"the reduced model is at an estimated relative error of {found.error:.1e}, above the {asked:.0e} that was "
            "asked; --full solves every frequency, --from and --to narrow the band",)


def full_spectrum(
    system: System, frequencies: Real, known: Mapping[float, complex],
    on_point: Callable[[float, complex], None] | None, progress: Progress,
) -> SolvedSpectrum:
    """The spectrum by full solves; `on_point` is called with each frequency and impedance (e^{+j w t}), and points
    `known` already are not solved again.

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
