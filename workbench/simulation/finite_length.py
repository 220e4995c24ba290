"""A straight chip of a stated length, driven by its electrode.

The ends are simply supported: the displacements in the section and the pressure are zero there, the displacement along
the channel is free. The potential at the ends is that of the clamped section, f V. With y from the middle of the length
L, a uniform load is the sum of a_n cos(k_n y) over odd n, k_n = n pi / L and a_n = 4 / (n pi) (-1)^((n - 1) / 2). Each
part is a problem of the section (`workbench.physics.orders`). The field is f V and a part x_n cos(k_n y) of each n with
short-circuited electrodes,

    A(w, k_n) x_n = -a_n b_n V,        b_n = A(w, k_n) f without the slope of f along y,

and the charge at 1 V is -f^T A f - sum a_n b_n^T x_n. High n have no resonances in the band and one common static
response, which closes the sum. Without ends, only k = 0 is driven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from geometry.chip import Chip
from geometry.measure import Straight
from geometry.straight import check_stated_length
from materials.registry import Registry
from workbench.acoustics.sound_energy import NoSound, SoundEnergy, peaks_of
from workbench.fem.capacitance import clamped_state
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.jobs.progress import Progress, no_progress
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.problem import Problem, build, fill, registry_of
from workbench.physics.orders import ORDER, terms_of_order
from workbench.physics.term import Integral
from workbench.reduced.response import response
from workbench.results.brief import Brief
from workbench.results.notebook import Shown, Summary
from workbench.results.peaks import find_peaks
from workbench.simulation.solved_spectrum import band_of, frequency_grid

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative tolerance of the response of each part, and of the sum. Doubled, resonances of high n of 0.2 % are left out.
TOLERANCE = 1e-3

#: Parts in a row that have to be within the tolerance before the sum ends, and most parts.
IN_A_ROW, MOST_PARTS = 3, 400

#: Least rise of the energy at a hot spot above the valleys beside it.
LEAST_RISE = 1.05

#: Places along the channel for each half wave of the highest part.
PLACES = 12


class LengthNotConverged(RuntimeError):
    """The sum over wave numbers is not converged after :data:`MOST_PARTS`."""


@dataclass(frozen=True, eq=False, repr=False)
class EnergyProfile(Brief):
    """The energy along the channel at a ``frequency`` (Hz), at 1 V.

    ``place`` (m,) in m from the middle of the length, ``energy_density`` (m,) in J/m^3 the mean over the cavity's
    section there. ``spots`` (k,) in m are its maxima, where beads bunch.
    """

    frequency: float
    place: Real
    energy_density: Real
    spots: Real

    @property
    def contrast(self) -> float:
        """The largest energy density over the mean."""
        return float(self.energy_density.max() / self.energy_density.mean())

    @property
    def spacing(self) -> float | None:
        """The mean distance (m) of the maxima, None for one."""
        return float(np.ptp(self.spots)) / (self.spots.size - 1) if self.spots.size > 1 else None

    def __str__(self) -> str:
        count = self.spots.size
        spacing = "" if self.spacing is None else f", {1e3 * self.spacing:.3g} mm apart"
        maxima = f"{count} maxim{'um' if count == 1 else 'a'} along the channel"
        return (f"{self.frequency / 1e6:.4f} MHz: {maxima}{spacing}; the energy is up to {self.contrast:.2g} "
                "times its mean")


@dataclass(frozen=True, eq=False)
class CavityEnergy:
    """The energy of pressures of several wave numbers in the cavity.

    ``matrices`` are the integrals of the energy on the unknowns ``rows``. ``coefficients`` (n, integrals) make them
    energies (J) at the frequencies (n,), over the square of the wave number where they are ``along`` (integrals,) the
    channel. ``volume`` (m^3) is that of the cavity.
    """

    rows: NDArray[np.int64]
    matrices: tuple[sparse.csr_array, ...]
    coefficients: Real
    along: NDArray[np.bool_]
    volume: float

    @classmethod
    def of(cls, operators: FullOperators, problem: Problem, frequencies: Real) -> CavityEnergy:
        """The cavity of a straight model with fields along the channel.

        Raises
        ------
        NoSound : there is no fluid in it.
        """
        sound, values = SoundEnergy.of(operators), {**problem.values, ORDER: 1.0}
        full = sound.operators
        assert isinstance(full, FullOperators)
        rows = np.unique(full.numbering["p"])
        rows = rows[rows >= 0]
        energies = 0.25 * sound.signs * full.coefficients(2.0 * np.pi * frequencies, values).real
        return cls(rows, tuple(full.matrix(one).real.tocsr()[rows][:, rows] for one in np.eye(sound.signs.size) + 0j),
                   energies, np.array([ORDER in each.coefficient.parameters for each in full.integrals]),
                   2.0 * sound.volume(values))  # Integrals are over half of it, the mean of cos^2.

    def mean(self, pressure: Complex, wave_number: float) -> Real:
        """The mean energy density (n,) of fields of one wave number.

        The fields are `pressure` (rows, n).
        """
        forms = np.array([np.sum(np.conj(pressure) * (matrix @ pressure), axis=0).real for matrix in self.matrices])
        factors = np.where(self.along, wave_number**2, 1.0)
        return np.asarray((self.coefficients.T * forms * factors[:, None]).sum(axis=0) / self.volume)

    def along_channel(self, index: int, pressure: Complex, wave_numbers: Real, place: Real) -> Real:
        """The energy density (m,) at places (m,) along the channel.

        It is that of the sum of fields `pressure` (rows, N) of N wave numbers, at the index of a frequency.
        """
        turns = np.outer(wave_numbers, place)
        result = np.zeros(place.size)
        for matrix, coefficient, is_along in zip(self.matrices, self.coefficients[index], self.along, strict=True):
            shape = wave_numbers[:, None] * np.sin(turns) if is_along else np.cos(turns)
            gram = (np.conj(pressure).T @ (matrix @ pressure)).real
            result += 2.0 * coefficient * np.sum(shape * (gram @ shape), axis=0)
        return result / self.volume


@dataclass(frozen=True, eq=False)
class Part:
    """The part of one wave number (1/m) at 1 V.

    ``charge`` (n,) in C, ``pressure`` (rows, n) in Pa, None without a fluid. ``energy`` (n,) in J/m^3 is
    its mean in the cavity.
    """

    wave_number: float
    charge: Complex
    pressure: Complex | None
    energy: Real


@dataclass(frozen=True, eq=False, repr=False)
class FiniteLength(Shown):
    """A straight chip of its length at 1 V, and without ends.

    ``frequency`` (n,) in Hz; ``impedance`` and ``without_ends`` (n,) in ohm, e^{+j w t}; ``energy_density`` and
    ``energy_without_ends`` (n,) are means over the cavity in J/m^3, zero without a fluid. ``moved`` is the relative
    change of the charge by the last parts. The ``parts`` are those of odd n from 1.
    """

    chip: Chip
    state: str
    frequency: Real
    impedance: Complex
    without_ends: Complex
    energy_without_ends: Real
    moved: float
    parts: tuple[Part, ...]
    cavity: CavityEnergy | None = field(compare=False)

    @property
    def length(self) -> float:
        """The length (m) of the chip."""
        assert isinstance(self.chip.measure, Straight)
        return self.chip.measure.length

    @property
    def energy_density(self) -> Real:
        return np.asarray(sum((part.energy for part in self.parts), np.zeros(self.frequency.size)))

    @cached_property
    def peaks(self) -> tuple[float, ...]:
        """Frequencies (Hz) of the peaks of the mean energy, the highest first."""
        return tuple(self.frequency[peaks_of(self.energy_density)].tolist()) if self.cavity is not None else ()

    def profile(self, frequency: float | None = None) -> EnergyProfile:
        """The energy along the channel near a frequency (Hz).

        It is at the nearest solved frequency; without one, at the highest peak of the energy.

        Raises
        ------
        InputError : a frequency outside the solved ones, or no fluid in the cavity.
        """
        if self.cavity is None:
            raise InputError("profile", "state", self.state, "a state with a liquid in the cavity")
        low, high = float(self.frequency[0]), float(self.frequency[-1])
        if frequency is None:
            frequency = self.peaks[0] if self.peaks else float(self.frequency[np.argmax(self.energy_density)])
        if not low <= frequency <= high:
            raise InputError("profile", "frequency", frequency, f"a frequency within {frequency_text(low, high)}")
        index = int(np.argmin(np.abs(self.frequency - frequency)))
        place = self._places
        density = self._density(index)
        spots = find_peaks(np.log(np.maximum(density, 1e-300)), math.log(LEAST_RISE))[0]
        return EnergyProfile(float(self.frequency[index]), place, density, place[spots])

    def energy_map(self) -> tuple[Real, Real]:
        """Places (m,) in m along the channel, and the energy density there.

        It is (n, m) in J/m^3, at all frequencies.
        """
        return self._places, np.array([self._density(index) for index in range(self.frequency.size)])

    @property
    def _places(self) -> Real:
        half = 0.5 * self.length
        return np.linspace(-half, half, 2 * PLACES * len(self.parts) + 1)

    def _density(self, index: int) -> Real:
        assert self.cavity is not None
        pressure = np.stack([part.pressure[:, index] for part in self.parts if part.pressure is not None], axis=1)
        numbers = np.array([part.wave_number for part in self.parts])
        return self.cavity.along_channel(index, pressure, numbers, self._places)

    def summary(self) -> Summary:
        """The peaks of the energy with the maxima along the channel."""
        return Summary(f"{self.chip.name}, {self.state}: {1e3 * self.length:.4g} mm long, {len(self.parts)} wave "
                       f"numbers", tuple(("", str(self.profile(each))) for each in self.peaks[:4]))


def stated_measure(chip: Chip) -> Straight:
    """The measure of a straight chip of a stated length.

    Raises
    ------
    InputError : a round chip, or one without a length.
    """
    if not isinstance(chip.measure, Straight):
        raise InputError(chip.file, "chip.geometry", "axisymmetric", '"straight" for a chip of some length')
    check_stated_length(chip.measure, chip.file, "the response between its ends")
    return chip.measure


def finite_length(
    chip: Chip,
    state: str | None = None,
    *,
    band: tuple[float, float] | None = None,
    points: int = 241,
    accuracy: float | Discretisation = ACCURACY,
    registry: Registry | None = None,
    progress: Progress = no_progress,
) -> FiniteLength:
    """The response of a straight chip between simply supported ends.

    The length is that of its file.

    Parameters
    ----------
    state : name of the state; the last one of the file if not given.
    band : two frequencies (Hz); the chip's own if not given.
    points : number of frequencies.
    accuracy : relative error of Z that the mesh is made for, or a discretisation.

    Raises
    ------
    InputError : a round chip, one without a length, or a mistake in the chip, its materials or the arguments.
    ModelError : a term of the model has no waves along the channel.
    NotConverged, ResponseNotConverged, LengthNotConverged : a solve fails, or too many wave numbers matter.
    """
    measure = stated_measure(chip)
    device = fill(chip, state, registry_of(chip, registry))
    span = band_of(chip, band)
    frequencies = frequency_grid(span, points, source="finite_length")
    posed = build(device, band=span, accuracy=accuracy)
    section = DrivenSection.of(posed, frequencies)
    driven = driven_length(section, measure.length, progress)
    impedance, without = (np.conj(1.0 / (-2j * np.pi * frequencies * each)) for each in (
        driven.charge, driven.charge_without_ends))
    return FiniteLength(chip, device.state.name, frequencies, impedance, without, driven.energy_without_ends,
                        driven.moved, driven.parts, section.cavity)


@dataclass(frozen=True, eq=False)
class DrivenLength:
    """The sum over wave numbers at 1 V.

    ``charge`` and ``charge_without_ends`` (n,) are in C; the rest is as in :class:`FiniteLength`.
    """

    charge: Complex
    charge_without_ends: Complex
    energy_without_ends: Real
    moved: float
    parts: tuple[Part, ...]


def driven_length(section: DrivenSection, length: float, progress: Progress = no_progress) -> DrivenLength:
    """The sum over wave numbers of a section of some `length` (m).

    Raises
    ------
    NotConverged, ResponseNotConverged, LengthNotConverged : a solve fails, or too many wave numbers matter.
    """
    frequencies = section.frequencies
    endless = section.part(0.0, math.sqrt(2.0))  # cos(0 y) has the mean square 1, not a half.
    parts, charge, rest, close = list[Part](), section.fixed_charge, 2.0, 0
    total, moved = charge, math.inf
    while close < IN_A_ROW:
        if len(parts) == MOST_PARTS:
            raise LengthNotConverged(f"the sum of {MOST_PARTS} wave numbers still moves by {moved:.1e}; state a "
                                     "shorter chip, or narrow the band")
        n = 2 * len(parts) + 1
        factor = 4.0 / (n * math.pi) * (-1.0) ** len(parts)
        parts.append(section.part(n * math.pi / length, factor))
        charge, rest = charge + parts[-1].charge, rest - factor**2
        # All further parts have the static response of this one.
        summed = charge + rest / factor**2 * parts[-1].charge
        moved, total = float(np.abs(summed / total - 1.0).max()), summed
        energy = sum((part.energy for part in parts), np.zeros(frequencies.size))
        share = float(np.divide(parts[-1].energy, energy, out=np.zeros(energy.size), where=energy > 0.0).max())
        close = close + 1 if max(moved, share) <= TOLERANCE else 0
        progress(f"wave number {len(parts)}", 1.0 - 0.9 ** len(parts))
    return DrivenLength(total, section.fixed_charge + endless.charge, endless.energy, moved, tuple(parts))


@dataclass(frozen=True, eq=False)
class DrivenSection:
    """The section of a straight chip, driven at any wave number.

    ``lift`` (size,) is the potential of the clamped section at 1 V. ``fixed_charge`` (n,) in C is its charge at the
    frequencies (n,) in Hz.
    """

    posed: Problem
    operators: FullOperators
    frequencies: Real
    lift: Real
    cavity: CavityEnergy | None

    @classmethod
    def of(cls, posed: Problem, frequencies: Real) -> DrivenSection:
        """The section of a straight model.

        Raises
        ------
        ModelError : a term has no waves along the channel.
        """
        operators = assemble(posed.mesh, terms_of_order(posed.terms, is_first=False))
        middle = float(np.median(frequencies))
        lift = clamped_state(operators, {**posed.values, ORDER: 0.0}, middle)
        try:
            cavity = CavityEnergy.of(operators, posed, frequencies)
        except NoSound:
            cavity = None
        return cls(posed, operators, frequencies, lift, cavity)

    @cached_property
    def fixed_charge(self) -> Complex:
        factors, images = self._images(0.0)
        return np.asarray(-2.0 * (self.lift @ images) @ factors)

    def part(self, wave_number: float, factor: float) -> Part:
        """The part of a wave number (1/m) at `factor` times 1 V."""
        system = System(self.operators, {**self.posed.values, ORDER: wave_number})
        laws, images = self._images(wave_number)
        loads = np.column_stack([images.real, images.imag])
        weights = factor * np.vstack([laws, 1j * laws])
        acting = np.abs(loads[:-1]).max(axis=0) > 0.0
        loads, weights = loads[:, acting], weights[acting]
        found = response(system, loads, self.frequencies, TOLERANCE)
        charge = np.einsum("in,nij,jn->n", weights, found.compliance, weights)
        if self.cavity is None:
            return Part(wave_number, charge, None, np.zeros(self.frequencies.size))
        coordinates = np.einsum("krn,kn->rn", found.coordinates, weights)
        pressure = -(found.basis[self.cavity.rows] @ coordinates)
        return Part(wave_number, charge, pressure, self.cavity.mean(pressure, wave_number))

    def _images(self, wave_number: float) -> tuple[Complex, Complex]:
        """Laws (g, n) of frequency and vectors (size, g).

        Their products sum to b.
        """
        omega, values = 2.0 * np.pi * self.frequencies, {**self.posed.values, ORDER: wave_number}
        groups = self.operators.coefficients.groups(omega, values)
        kept = np.array([not _slopes_along(each) for each in self.operators.integrals])
        images = self.operators.images(self.lift.astype(complex), np.array([each * kept for _, each in groups]).T)
        return np.array([law for law, _ in groups]), images


def _slopes_along(integral: Integral) -> bool:
    """Whether an integral has the slope of the potential along the channel."""
    names: Sequence[str] = [name for each in integral.products for name in (each.row, each.column)]
    return "grad_phi_s, turned" in names
