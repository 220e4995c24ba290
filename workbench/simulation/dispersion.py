"""The guided waves of a straight chip: frequency over wave number.

Fields have the factor cos(k y) or sin(k y) (`workbench.physics.orders`). The modes are solved at rising k, and those of
two wave numbers are one branch if their states overlap in the mass M = -dA/dw / (2 w), of which modes of one k are
orthogonal. Between two wave numbers with an unclear overlap, a further one is solved: branches that approach each
other without crossing exchange their states within a short range of k.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import linear_sum_assignment

from geometry.chip import Chip
from geometry.measure import Straight
from geometry.names import CAVITY, TRANSDUCER
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.fem.energy import energy_shares
from workbench.fem.modes import LEAST_Q, eigenfrequency_slopes, eigenmodes
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress, no_progress
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.problem import FilledChip, Problem, build, fill, registry_of
from workbench.physics.orders import ORDER, terms_of_order
from workbench.results.brief import Brief
from workbench.results.notebook import Shown, Summary
from workbench.simulation.modes import sought_band

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of wave numbers from 0. Doubled, fewer are added between them.
WAVE_NUMBERS = 33

#: Least overlap of two states of one branch. No state has two partners, and one of two degenerate states has one.
LINKED = 0.7

#: Most halvings of a step of the wave number. Branches that approach each other within less are followed across.
HALVINGS = 4

#: Part of the band's width by which modes are sought beyond it, so that branches have partners up to its edges.
MARGIN = 0.05

#: Relative step of frequency over which the mass is taken.
STEP = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Branch(Brief):
    """A guided wave at the wave numbers ``wave_number`` (n,) in 1/m, rising.

    ``frequency`` (n,) in Hz, ``q`` (n,), ``group_velocity`` (n,) in m/s; ``liquid`` (n,) is the share of the energy in
    the cavity.
    """

    wave_number: Real
    frequency: Real
    q: Real
    group_velocity: Real
    liquid: Real

    @property
    def decay_length(self) -> Real:
        """Lengths (n,) in m over which waves decay by 1 / e."""
        return np.asarray(self.q * np.abs(self.group_velocity) / (np.pi * self.frequency))

    def curve(self, wave_number: Real) -> Real:
        """Frequencies (m,) in Hz at any wave numbers (m,), by cubics."""
        spline = CubicHermiteSpline(self.wave_number, self.frequency, self.group_velocity / (2.0 * np.pi))
        return np.asarray(spline(wave_number))

    @property
    def is_uniform(self) -> bool:
        """Whether the branch begins without variation along the channel."""
        return bool(self.wave_number[0] == 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class GuidedWaves(Shown):
    """The branches of a chip's ``state`` in a ``band`` (Hz).

    They are sorted by their first wave number and frequency, and have at least the quality factor ``least_q``. The
    solved ``wave_numbers`` (n,) in 1/m are rising. ``unlinked`` is the number of modes in no branch: none of a
    neighbouring wave number is like them.
    """

    chip: Chip
    state: str
    band: tuple[float, float]
    least_q: float
    wave_numbers: Real
    branches: tuple[Branch, ...]
    unlinked: int = 0

    @property
    def finding(self) -> str:
        """The finding on modes in no branch, or ""."""
        return "" if not self.unlinked else (
            f"{self.unlinked} modes of single wave numbers are in no branch, since no mode at a neighbouring one is "
            "like them: more wave numbers, or a longer shortest wavelength, would link them")

    def summary(self) -> Summary:
        """The branches, one a row."""
        return Summary(f"{self.chip.name}, {self.state}: waves along the channel", tuple(
            (f"{each.frequency[0] / 1e6:.6f} to {each.frequency[-1] / 1e6:.6f} MHz",
             f"k {each.wave_number[0]:.4g} to {each.wave_number[-1]:.4g} 1/m",
             f"up to {100.0 * each.liquid.max():.0f} % in the cavity") for each in self.branches))


def dispersion(
    chip: Chip,
    state: str | None = None,
    *,
    shortest: float | None = None,
    points: int = WAVE_NUMBERS,
    band: tuple[float, float] | None = None,
    least_q: float = LEAST_Q,
    accuracy: float | Discretisation = ACCURACY,
    registry: Registry | None = None,
    progress: Progress = no_progress,
) -> GuidedWaves:
    """The waves along the channel of a straight chip.

    Parameters
    ----------
    state : name of the state; the last one of the file if not given.
    shortest : wavelength (m) of the largest wave number; that of the slowest waves in liquid or disc if not given.
    points : number of wave numbers from 0; further ones are added between them.
    band : two frequencies (Hz); the chip's own if not given.
    least_q : smallest quality factor.
    accuracy : relative error of Z that the mesh is made for, or a discretisation.

    Raises
    ------
    InputError : a round chip, or a mistake in the chip, its materials or the arguments.
    ModelError : a term of the model has no waves along the channel.
    NotConverged, ModesNotConverged : the model is singular in the band, or a mode still moves after the last round.
    """
    check_channel(chip)
    if isinstance(points, bool) or not isinstance(points, numbers.Integral) or points < 2:
        raise InputError("dispersion", "points", points, "a number of wave numbers, 2 or more")
    span = sought_band(chip, band, least_q, source="dispersion")
    device = fill(chip, state, registry_of(chip, registry))
    shortest = _shortest(device, span) if shortest is None else shortest
    if not isinstance(shortest, numbers.Real) or not 0.0 < shortest < math.inf:
        raise InputError("dispersion", "shortest", shortest, "a wavelength above zero (m), so that there is a range of "
                         "wave numbers")
    wave_numbers = np.linspace(0.0, 2.0 * math.pi / shortest, points)
    solved, found, unlinked = guided_waves(build(device, band=span, accuracy=accuracy), span, wave_numbers,
                                           least_q=least_q, progress=progress)
    return GuidedWaves(chip, device.state.name, span, least_q, solved, found, unlinked)


def check_channel(chip: Chip) -> None:
    """Check that a chip has a direction along a channel.

    Raises
    ------
    InputError : a round chip.
    """
    if not isinstance(chip.measure, Straight):
        raise InputError(chip.file, "chip.geometry", "axisymmetric", '"straight" for waves along a channel; a round '
                         "chip has orders around its axis (wb.modes)")


def guided_waves(
    posed: Problem, band: tuple[float, float], wave_numbers: Real, *, least_q: float = LEAST_Q,
    progress: Progress = no_progress,
) -> tuple[Real, tuple[Branch, ...], int]:
    """The waves along a straight model in a `band` (Hz).

    Returns the solved wave numbers (n,) in 1/m, the branches, and the number of modes in no branch.
    `wave_numbers` (m,) in 1/m rise in equal steps; further ones are added where branches are unclear.

    Raises
    ------
    ModelError : a term has no waves along the channel.
    NotConverged, ModesNotConverged : see :func:`workbench.fem.modes.eigenmodes`.
    """
    operators = assemble(posed.mesh, terms_of_order(posed.terms, is_first=False))
    solved, branches = _followed(_Waves(posed, operators, band, least_q), wave_numbers, progress)
    found = sorted((part for rows in branches for part in _inside(np.array(rows), band)),
                   key=lambda branch: (branch.wave_number[0], branch.frequency[0]))
    linked = sum(branch.frequency.size for branch in found)
    inside = sum(band[0] <= row[1] <= band[1] for rows in branches for row in rows)
    return np.array(solved), tuple(found), int(inside) - linked


def _shortest(device: FilledChip, band: tuple[float, float]) -> float:
    """The shortest wavelength (m) along the channel that is followed by default."""
    inside = device.materials.get(CAVITY)
    is_liquid = isinstance(inside, Fluid) and not inside.is_gas
    return device.materials[CAVITY if is_liquid else TRANSDUCER].slowest_wave_speed() / band[1]


@dataclass(frozen=True, eq=False)
class _Station:
    """The modes at one wave number.

    ``rows`` (n, 5) are their wave number (1/m), frequency (Hz), quality factor, group velocity (m/s) and share of the
    energy in the cavity. ``states`` (size, n) are normalised, ``images`` (size, n) are the mass times them.
    """

    rows: Real
    states: Complex
    images: Complex
    wave_number: float


@dataclass(frozen=True, eq=False)
class _Waves:
    """The modes of a model by wave number.

    They are in a ``band`` (Hz), and have a quality factor above ``least_q``.
    """

    posed: Problem
    operators: FullOperators
    band: tuple[float, float]
    least_q: float

    def at(self, wave_number: float) -> _Station:
        """The modes at a wave number (1/m), also just beyond the band."""
        system = System(self.operators, {**self.posed.values, ORDER: wave_number})
        low, high = self.band
        beyond = MARGIN * (high - low)
        modes = eigenmodes(system, (max(low - beyond, 0.5 * low), high + beyond), least_q=self.least_q)
        if not modes.omega.size:
            return _Station(np.zeros((0, 5)), modes.states, modes.states, wave_number)
        middle = 0.5 * (low + high)
        images = system.change(middle * (1.0 - STEP), middle * (1.0 + STEP)).times(modes.states)
        size = np.sqrt(np.sum(modes.states * images, axis=0))
        coefficients = self.operators.coefficients(modes.omega.real, system.values)
        shares = energy_shares(self.operators, modes.states, coefficients)
        rows = np.column_stack([
            np.full(modes.omega.size, wave_number), modes.frequency, modes.q,
            eigenfrequency_slopes(system, modes, ORDER).real, shares.get(CAVITY, np.zeros(modes.omega.size))])
        return _Station(rows, modes.states / size, images / size, wave_number)


def _followed(waves: _Waves, wave_numbers: Real, progress: Progress) -> tuple[list[float], list[list[Real]]]:
    """The solved wave numbers (1/m), and the rows of every branch."""
    finest = float(wave_numbers[1] - wave_numbers[0]) / 2**HALVINGS
    before, waiting = waves.at(float(wave_numbers[0])), list[_Station]()
    current = {i: [row] for i, row in enumerate(before.rows)}
    solved, branches = [before.wave_number], list(current.values())
    for wave_number in wave_numbers[1:].tolist():
        waiting.append(waves.at(wave_number))
        while waiting:
            after = waiting[-1]
            step = after.wave_number - before.wave_number
            partners = _partners(before, after)
            if step > 1.5 * finest and _has_loose_ends(before, after, partners, waves.band):
                waiting.append(waves.at(before.wave_number + 0.5 * step))
                continue
            known, current = current, {}
            for j, row in enumerate(after.rows):
                if j not in partners:
                    branches.append([])
                current[j] = known[partners[j]] if j in partners else branches[-1]
                current[j].append(row)
            solved.append(after.wave_number)
            before = waiting.pop()
        progress("waves along the channel", wave_number / float(wave_numbers[-1]))
    return solved, branches


def _partners(before: _Station, after: _Station) -> dict[int, int]:
    """The mode before each mode, by the largest total overlap.

    Each overlap is above :data:`LINKED`.
    """
    overlaps = np.abs(before.images.T @ after.states)
    pairs = zip(*linear_sum_assignment(-overlaps), strict=True)
    return {int(j): int(i) for i, j in pairs if overlaps[i, j] >= LINKED}


def _has_loose_ends(before: _Station, after: _Station, partners: dict[int, int], band: tuple[float, float]) -> bool:
    """Whether a mode lacks a partner that its slope predicts.

    It does if it is in the band for half of the step or more.
    """
    step = 0.5 * (after.wave_number - before.wave_number)
    for station, linked, way in ((before, partners.values(), step), (after, partners.keys(), -step)):
        loose = np.setdiff1d(np.arange(len(station.rows)), np.array(list(linked), dtype=int))
        here = station.rows[loose, 1]
        there = here + way * station.rows[loose, 3] / (2.0 * np.pi)
        if ((here > band[0]) & (here < band[1]) & (there > band[0]) & (there < band[1])).any():
            return True
    return False


def _inside(rows: Real, band: tuple[float, float]) -> Iterator[Branch]:
    """The parts of a branch (n, 5) within the band.

    They have two wave numbers or more.
    """
    within = (rows[:, 1] >= band[0]) & (rows[:, 1] <= band[1])
    ends = np.flatnonzero(np.diff(np.r_[False, within, False]))
    for first, last in ends.reshape(-1, 2):
        if last > first + 1:
            yield Branch(*rows[first:last].T)
