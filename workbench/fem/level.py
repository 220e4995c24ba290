"""The logarithm of a response, with derivatives for Newton's method at resonances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fem.linearised import DIFFERENCE_PLACES, FIRST_WEIGHTS, SECOND_WEIGHTS, LinearisedState

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: An empty set of numbers to differentiate by.
NO_NUMBERS = np.zeros(0, dtype=complex)

#: Relative step of the difference quotients of a drive's formula. For a rational function of the impedance the error of
#: a second derivative is 1e-9.
STEP = 1e-2


@dataclass(frozen=True, eq=False)
class Level:
    """The logarithm of a response and its derivatives. ``slope`` (1/Hz) and ``curvature`` (1/Hz^2) are by frequency,
    ``by_number`` (k,) by numbers, ``mixed`` (k,) by frequency and number."""

    value: float
    slope: float
    curvature: float
    by_number: Real
    mixed: Real

    def __add__(self, other: Level) -> Level:
        return Level(self.value + other.value, self.slope + other.slope, self.curvature + other.curvature,
                     self.by_number + other.by_number, self.mixed + other.mixed)

    def __mul__(self, factor: float) -> Level:
        return Level(self.value * factor, self.slope * factor, self.curvature * factor, self.by_number * factor,
                     self.mixed * factor)


@dataclass(frozen=True, eq=False)
class _LogImpedance:
    """The derivatives of ln Z of a state. Z is i / (w Q). They are by frequency, ``twice`` by frequency, ``by_number``
    (k,) and ``mixed`` (k,)."""

    by_frequency: complex
    twice: complex
    by_number: Complex
    mixed: Complex

    @classmethod
    def of(cls, state: LinearisedState, turns: Complex) -> _LogImpedance:
        ratio, by_number = state.charge_by_frequency / state.charge, turns * state.charge_by_parameter / state.charge
        return cls(-1.0 / state.frequency - ratio,
                   1.0 / state.frequency**2 - (state.charge_twice_by_frequency / state.charge - ratio**2),
                   -by_number, -(turns * state.charge_by_both / state.charge - ratio * by_number))


def impedance_level(state: LinearisedState, turns: Complex = NO_NUMBERS) -> Level:
    """ln |Z| of a state. Its numbers move its parameters by `turns` (k,): 1 for a real part, 1j for an imaginary
    one."""
    found = _LogImpedance.of(state, turns)
    return Level(-math.log(2.0 * math.pi * state.frequency * abs(state.charge)), found.by_frequency.real,
                 found.twice.real, found.by_number.real, found.mixed.real)


def drive_level(amplitude: Callable[[Complex], Complex], state: LinearisedState, turns: Complex) -> Level:
    """ln |V|^2 of the drive's voltage V at a device. `amplitude` is a closed formula
    (`workbench.model.drive.Drive.amplitude`) of the impedance (ohm); `turns` are as in :func:`impedance_level`."""
    impedance, found = complex(state.solution.impedance[0]), _LogImpedance.of(state, turns)
    z_f, z_ff = impedance * found.by_frequency, impedance * (found.twice + found.by_frequency**2)
    z_k, z_fk = impedance * found.by_number, impedance * (found.mixed + found.by_frequency * found.by_number)
    # A constant power is a quotient by the real part, which may be small.
    steps = STEP * abs(impedance.real), STEP * abs(impedance)
    x, y = (step * DIFFERENCE_PLACES for step in steps)
    values = 2.0 * np.log(np.abs(amplitude(impedance + x[:, None] + 1j * y)))
    middle = DIFFERENCE_PLACES.size // 2
    by_x, by_y = FIRST_WEIGHTS @ values / steps[0], values @ FIRST_WEIGHTS / steps[1]
    first = np.array([by_x[middle], by_y[middle]])
    cross = float(by_x @ FIRST_WEIGHTS) / steps[1]
    second = np.array([[float(SECOND_WEIGHTS @ values[:, middle]) / steps[0] ** 2, cross],
                       [cross, float(values[middle] @ SECOND_WEIGHTS) / steps[1] ** 2]])

    def parts(z: complex | Complex) -> Real:
        return np.array([np.real(z), np.imag(z)])

    return Level(float(values[middle, middle]), float(first @ parts(z_f)),
                 float(first @ parts(z_ff) + parts(z_f) @ second @ parts(z_f)), first @ parts(z_k),
                 first @ parts(z_fk) + parts(z_f) @ second @ parts(z_k))

