"""The mean acoustic energy density of the cavity.

It has exact derivatives:

    E = 1/(4 V) [ 1/(rho w^2) int |grad p|^2 + 1/(rho c^2) int |p|^2 ],

kinetic and compressional (Bruus 2012, Lab Chip 12, 20: acoustofluidics 2, eq. 24 with its time averages). Both are
integrals of the model, so any state gives E, of the full model or of a reduced one, in a cavity of any shape: E = N /
(4 V) with N = x^H B x and B = sum_q s_q Re(g_q) A_q, where s_q is 1 for the kinetic energy and -1 for the compressional
one, whose sign in the equation of motion is the opposite. V depends on the lengths of the cavity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from geometry.names import CAVITY, parent_place
from workbench.fem.coefficients import Coefficients
from workbench.fem.forms import bilinear
from workbench.fem.level import Level
from workbench.fem.linearised import LinearisedState, Twice, by_frequency, difference_frequencies, slope_columns
from workbench.fem.operators import FullOperators, Operators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.physics.fluid import AcousticFluid
from workbench.physics.orders import OfOrder
from workbench.physics.term import Coefficient, Integral, Monomial, Times, Values, times
from workbench.reduced.compact import gathered
from workbench.results.peaks import find_peaks

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Products of the kinetic energy, across and along the third direction, and of the compressional energy.
ACROSS, ALONG, COMPRESSIONAL = (set(each.products) for each in OfOrder(AcousticFluid("", "")).integrals())
KINETIC = ACROSS | ALONG

#: Smallest ratio of a peak to the higher of the valleys beside it. Doubled, a shoulder of 1.5 dB is not a peak.
LEAST_RISE = 1.2


class NoSound(ValueError):
    """A cavity without a fluid."""


@dataclass(frozen=True, eq=False)
class SoundEnergy:
    """The mean acoustic energy density in the cavity of a model.

    ``operators`` have only its integrals, on the unknowns of the model; ``signs`` (integrals,) is 1 for kinetic and -1
    for compressional energy. ``stretches`` (m,) are the factors of the ``volumes`` (m,) m^3 of the parts of the cavity,
    in a straight section for the length of the chip.
    """

    operators: Operators
    signs: Real
    stretches: Coefficients
    volumes: Real

    @classmethod
    def of(cls, full: FullOperators) -> SoundEnergy:
        """The energy of the states of a `full` model.

        Raises:
            NoSound: the cavity contains no fluid.
        """
        kinds = [KINETIC if set(each.products) <= KINETIC else COMPRESSIONAL if set(each.products) <= COMPRESSIONAL
                 else None for each in full.integrals]
        acting = np.array([q for q, (each, kind) in enumerate(zip(full.integrals, kinds, strict=True))
                           if kind is not None and parent_place(each.place) == CAVITY], dtype=int)
        if not acting.size:
            raise NoSound("the cavity contains no fluid")
        stretched = [(each, coefficient) for each in (full.integrals[q] for q in acting)
                     if (coefficient := _stretch(each)) is not None]
        return cls(full.of(acting), np.array([1.0 if kinds[q] is KINETIC else -1.0 for q in acting]),
                   Coefficients.of([Integral(coefficient, "", ()) for _, coefficient in stretched]),
                   np.array([full.places[each.domain].measure(each.radial).sum() for each, _ in stretched]))

    def on(
        self, basis: Real, moving: set[str] | None = None, values: Values = MappingProxyType({}),
    ) -> SoundEnergy:
        """The energy of states on a `basis` (size, r). Integrals with equal dependence on the parameters named `moving`
        become one; others stay at `values`."""
        full = self.operators
        assert isinstance(full, FullOperators)
        matrices = full.project(basis)
        if moving is None:
            return replace(self, operators=ReducedOperators(full.integrals, full.coefficients, matrices, full.forms))
        integrals, signs, weights = self._gathered(moving, values)
        by_form = np.zeros((len(matrices), len(weights)))
        np.add.at(by_form, full.forms, weights.T)
        return self._of(integrals, signs, np.tensordot(by_form.T, matrices, axes=1))

    def stored(self, matrices: Real, moving: set[str], values: Values) -> SoundEnergy:
        """The energy that :meth:`on` made, from its `matrices`."""
        integrals, signs, _ = self._gathered(moving, values)
        return self._of(integrals, signs, matrices)

    def _of(self, integrals: tuple[Integral, ...], signs: Real, matrices: Real) -> SoundEnergy:
        small = ReducedOperators(integrals, Coefficients.of(integrals), matrices, np.arange(len(matrices)))
        return replace(self, operators=small, signs=signs)

    def _gathered(self, moving: set[str], values: Values) -> tuple[tuple[Integral, ...], Real, Real]:
        """Integrals with equal dependence, their signs, and weights (k, integrals)."""
        integrals, signs, weights = list[Integral](), list[float](), list[Real]()
        for sign in (1.0, -1.0):
            members = np.flatnonzero(self.signs == sign)
            found, parts = gathered([self.operators.integrals[q] for q in members], moving, values)
            whole = np.zeros((len(found), self.signs.size))
            whole[:, members] = parts
            integrals, signs, weights = [*integrals, *found], [*signs, *[sign] * len(found)], [*weights, *whole]
        return tuple(integrals), np.array(signs), np.array(weights)

    def density(self, frequency: Real, states: Complex, values: Values) -> Real:
        """The mean energy density (n,) in J/m^3 of `states` at 1 V. The `states` are (size, n), at `frequency` (n,) in
        Hz."""
        coefficients = self.operators.coefficients(2.0 * np.pi * frequency, values).real
        energy = np.sum(coefficients * self.signs * self._forms(states, states), axis=1)
        return np.asarray(0.25 * energy / self.volume(values))

    def volume(self, values: Values) -> float:
        """The volume (m^3) of the cavity. A straight one has the chip's length."""
        return float(self.stretches(np.ones(1), values)[0].real @ self.volumes)

    def log_level(self, state: LinearisedState, values: Values, turns: Complex) -> Level:
        """ln E of a `state` at 1 V, with its derivatives. They are by frequency and numbers.

        Derivatives are first and second ones. The complex parameters ``state.names`` move by `turns` (k,) with the
        numbers. Second derivatives are NaN without those of the state.
        """
        frequency, names, k = state.frequency, state.names, len(state.names)
        at = 2.0 * np.pi * difference_frequencies(frequency)
        own, first, second = by_frequency(self.operators.coefficients(at, values).T, frequency)
        slopes, mixed = ((each * turns).real for each in
                         slope_columns(self.operators, frequency, values, names))
        moved, second_order = state.by_parameter * turns, state.twice
        if second_order is None:
            second_order = Twice(np.full_like(state.state, np.nan), np.full_like(moved, np.nan))
        columns = np.column_stack([state.state, state.by_frequency, second_order.by_frequency, moved,
                                   second_order.by_both * turns])
        at_state, at_slope = (self._forms(np.repeat(each[:, None], columns.shape[1], axis=1), columns)
                              for each in (state.state, state.by_frequency))

        def summed(forms: Real, coefficients: Real) -> Real:
            """Sums over the integrals: forms (n, integrals) and coefficients (integrals, ...)."""
            return np.asarray((forms * self.signs) @ coefficients)

        b, b_f, b_ff = own.real, first.real, second.real
        numbers = slice(3, 3 + k)
        n = summed(at_state[0], b)
        n_f = 2.0 * summed(at_state[1], b) + summed(at_state[0], b_f)
        n_ff = (2.0 * (summed(at_state[2], b) + summed(at_slope[1], b)) + 4.0 * summed(at_state[1], b_f)
                + summed(at_state[0], b_ff))
        n_k = 2.0 * summed(at_state[numbers], b) + summed(at_state[0], slopes)
        n_fk = (2.0 * (summed(at_state[3 + k :], b) + summed(at_slope[numbers], b) + summed(at_state[numbers], b_f)
                       + summed(at_state[1], slopes)) + summed(at_state[0], mixed))
        volume = self.volume(values)
        by_shape = self.stretches.slopes(values, names)
        widened = np.array([sum(((each * turn).real @ self.volumes for each in one.values()), 0.0)
                            for one, turn in zip(by_shape, turns, strict=True)])
        return Level(float(np.log(0.25 * n / volume)), float(n_f / n), float(n_ff / n - (n_f / n) ** 2),
                     n_k / n - widened / volume, n_fk / n - n_f * n_k / n**2)

    def _forms(self, left: Complex, right: Complex) -> Real:
        """Real parts of left^H A_q right (n, integrals) for columns of both."""
        conjugate = np.conj(left)
        if isinstance(self.operators, ReducedOperators):
            used, where = np.unique(self.operators.forms, return_inverse=True)
            return bilinear(self.operators.matrices[used], conjugate, right)[:, where].real
        return self.operators.quadratic(conjugate, right).real


def _stretch(integral: Integral) -> Coefficient | None:
    """The volume factor of a compressional integral, or None. Its product is |p|^2 / (rho c^2)."""
    base = integral.coefficient
    while isinstance(base, Times):
        base = base.first
    if not isinstance(base, Monomial) or base.omega_power or set(integral.products) != COMPRESSIONAL:
        return None
    speeds = [name for name, power in base.factors if name.endswith(".sound_speed") and power == -2]
    if not speeds:
        return None
    density = speeds[0].replace(".sound_speed", ".density")
    return times(integral.coefficient, Monomial(-1.0, 0, ((density, 1), (speeds[0], 2))))


def sound_energy(full: FullOperators) -> SoundEnergy | None:
    """The energy from :meth:`SoundEnergy.of`, None without a fluid in the cavity."""
    try:
        return SoundEnergy.of(full)
    except NoSound:
        return None


def peaks_of(energy: Real) -> list[int]:
    """Indices of the peaks of energies (n,) over frequency, the highest first. A peak rises by :data:`LEAST_RISE` above
    the valleys that part it from higher ones, or from the ends of the band."""
    places, _ = find_peaks(np.log(energy), math.log(LEAST_RISE))
    return sorted(map(int, places), key=lambda k: -energy[k])
