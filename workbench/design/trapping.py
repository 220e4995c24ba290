"""The deepest trap of a potential given as a polynomial, and the exact derivatives of its figures.

The trap is the lowest place of the potential in the cavity: on a raster first, then by Newton's method. Its derivatives
follow from grad U = 0 (implicit function theorem). A trap held at a wall moves along the wall only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from geometry.measure import Axisymmetric
from workbench.acoustics.critical import critical_diameter
from workbench.acoustics.traps import RASTER_POINTS
from workbench.design.cavity import ENERGY, POTENTIAL, SQUARE, CavityField, argument
from workbench.design.dual import Dual
from workbench.design.legendre import derivatives, legendre_polynomials
from workbench.model.particles import GRAVITY, viscous_scattering

Real = NDArray[np.float64]

#: Shares of width and height below which a step of Newton's method is the last one, and most steps of it.
SETTLED, STEPS = 1e-8, 60
#: A curvature of less than this share of the other one, by shares of width and height, is none: rounding leaves 1e-7.
FLAT = 1e-5
#: Share of the width by which a place leaves the axis where the potential has its maximum on it.
OFF_AXIS = 1e-3
#: Points of the Gauss rule for the focusing time: the force is smooth over a part of a wavelength.
RULE = 24
#: The part of a quarter wavelength above the trap, or beside it, over which focusing is timed
#: (`workbench.acoustics.traps.focus_time`).
FROM, TO = 0.9, 0.1


class NoTrap(ValueError):
    """A field in which a particle is not led to where it was to go."""


@dataclass(frozen=True, eq=False)
class FoundTrap:
    """The deepest trap at unit voltage: ``place`` (xi, eta) as shares of width and height, its derivatives ``slopes``
    (2, k); ``depth`` (J), the ``radial`` and the ``axial`` stiffness (N/m)."""

    field: CavityField
    place: Real
    slopes: Real
    depth: Dual
    radial: Dual
    axial: Dual

    @property
    def radius(self) -> Dual:
        """m from the axis, or from the middle of a straight chip, below zero on its left."""
        middle = 0.0 if isinstance(self.field.cavity.measure, Axisymmetric) else 0.5
        return self.field.around.width * Dual(float(self.place[0]) - middle, self.slopes[0])

    @property
    def height(self) -> Dual:
        """m above the floor."""
        return self.field.around.height * Dual(float(self.place[1]), self.slopes[1])


def largest_square(field: CavityField) -> Dual:
    """The largest |p|^2 (Pa^2) at unit voltage, on the raster."""
    along_xi, along_eta = _raster(field)
    values = along_xi @ field.coefficients[SQUARE] @ along_eta.T
    i, j = np.unravel_index(int(np.argmax(values)), values.shape)
    return _at(field, SQUARE, along_xi[i], along_eta[j])


def find_trap(field: CavityField, near: float | None = None) -> FoundTrap:
    """The lowest place of the potential, or the minimum that the way down from the lowest place at a radius `near` (m)
    leads to, and what follows from it.

    Raises:
        NoTrap: the potential is so flat there that no place is the lowest.
    """
    along_xi, along_eta = _raster(field)
    values = along_xi @ field.coefficients[POTENTIAL] @ along_eta.T
    (i, j), (k, m) = (np.unravel_index(int(each), values.shape) for each in (np.argmin(values), np.argmax(values)))
    # Of a trap and its mirror image the one on the right is meant.
    right = max(int(i), len(values) - 1 - int(i)) if field.cavity.is_half else int(i)
    start = np.array([right, j]) / (np.array(values.shape) - 1.0)
    if near is not None:
        column = min(round(near / field.around.width.value * (len(values) - 1)), len(values) - 1)
        start = np.array([column, np.argmin(values[column])]) / (np.array(values.shape) - 1.0)
    place, free = _minimum(field, start)
    along = _at_place(place, field)

    def derivative(in_xi: int, in_eta: int) -> Dual:
        return _at(field, POTENTIAL, along[0][in_xi], along[1][in_eta])

    slopes = np.zeros((2, field.gradient.shape[-1]))
    gradient, hessian = (derivative(1, 0), derivative(0, 1)), _hessian(field, along)
    at = np.flatnonzero(free)
    if at.size:
        slopes[at] = -np.linalg.solve(hessian[np.ix_(at, at)], np.array([gradient[n].gradient for n in at]))

    def moved(in_xi: int, in_eta: int) -> Dual:
        """A derivative of the potential at the trap as it moves."""
        here = derivative(in_xi, in_eta)
        by_place = (derivative(in_xi + 1, in_eta).value, derivative(in_xi, in_eta + 1).value)
        return Dual(here.value, here.gradient + np.array(by_place) @ slopes)

    lowest, highest = moved(0, 0), _at(field, POTENTIAL, along_xi[k], along_eta[m])
    around = field.around
    return FoundTrap(field, place, slopes, highest - lowest, moved(2, 0) / around.width**2.0,
                     moved(0, 2) / around.height**2.0)


def follows_flow(trap: FoundTrap) -> str:
    """The reason why the particle comes to no trap, if streaming along plane walls moves it more than sound does; empty
    otherwise."""
    cavity, frequency = trap.field.cavity, trap.field.around.frequency.value
    assert cavity.particle is not None
    factor = viscous_scattering(cavity.particle, cavity.fluid, frequency).contrast_factor
    if not factor or 2.0 * cavity.particle.radius >= (limit := critical_diameter(factor, cavity.fluid, frequency)):
        return ""
    return (f"particles of {2e6 * cavity.particle.radius:.3g} um circulate with the streaming, however large the "
            f"voltage: their critical diameter is {1e6 * limit:.2g} um")


def trap_focus_time(trap: FoundTrap, square_of_voltage: Dual, *, beyond: float = 0.0) -> Dual:
    """Seconds from 90 to 10 % of a quarter wavelength above the trap, as `workbench.acoustics.traps.focus_time` has
    them: in a straight chip instead of that, or of the way to the side wall, to the right of the trap, where it is
    stiffer that way, or where that is the only way.

    The way may begin above the lid, up to `beyond` as a share of the height: the force goes on there along its tangent.

    Raises:
        NoTrap: the way leaves the cavity by more, the force does not lead down all of it, or the particle sinks past
            the trap, or rises past it.
    """
    stiffness = (trap.radial.value, trap.axial.value)
    failed: NoTrap | None = None
    for axis in sorted(trap.field.cavity.measure.focusing, key=lambda axis: -stiffness[axis]):
        try:
            return _time_along(trap, square_of_voltage, axis, beyond)
        except NoTrap as error:
            failed = failed or error
    raise NoTrap(str(failed))


def _time_along(trap: FoundTrap, square_of_voltage: Dual, axis: int, beyond: float) -> Dual:
    """The time (s) as in :func:`trap_focus_time` along one direction, 0 across and 1 up."""
    field, side = trap.field, ("beside", "above")[axis]
    particle, around = field.cavity.particle, field.around
    assert particle is not None
    length = (around.width, around.height)[axis]
    base = Dual(float(trap.place[axis]), trap.slopes[axis])
    reach = around.fluid["sound_speed"] / around.frequency * 0.25
    if axis == 0 and (1.0 - base.value) * length.value < reach.value:
        reach = (base * -1.0 + 1.0) * length
    points, weights = leggauss(RULE)
    share = 0.5 * (FROM + TO) + 0.5 * (FROM - TO) * points
    if base.value * length.value + FROM * reach.value > (1.0 + beyond) * length.value:
        raise NoTrap(f"a quarter wavelength {side} the deepest trap there is a wall")
    # Weight less buoyancy, as `particles.net_weight`.
    weight = (around.fluid["density"] * -1.0 + particle.density) * (particle.volume * GRAVITY if axis else 0.0)
    # The shares of the length (points,) and (points, k) of their derivatives.
    rise = reach / length
    places, by_number = base.value + share * rise.value, base.gradient + np.outer(share, rise.gradient)
    inside = np.minimum(places, 1.0)
    moving, fixed = ((_along_eta(inside, field), _along_xi(trap.place[:1], field)[:, 0]) if axis else
                     (_along_xi(inside, field), _along_eta(trap.place[1:], field)[:, 0]))
    # The polynomials and their first derivative along the tangent above the lid.
    moving = np.stack([moving[0] + (places - inside)[:, None] * moving[1], moving[1]])
    row = ENERGY + 1 + field.cavity.measure.focusing.index(axis)
    force, gradient = field.coefficients[row], field.gradient[row]
    if axis == 0:
        force, gradient = force.T, gradient.swapaxes(0, 1)
    here = fixed[0] @ force @ moving[0].T
    slopes = np.einsum("n,nmk,pm->pk", fixed[0], gradient, moving[0], optimize=True)
    slopes += (np.outer(fixed[1] @ force @ moving[0].T, trap.slopes[1 - axis])
               + (fixed[0] @ force @ moving[1].T)[:, None] * by_number)
    back = weight.value - here * square_of_voltage.value
    by_all = weight.gradient - slopes * square_of_voltage.value - np.outer(here, square_of_voltage.gradient)
    if not (back > 0.0).all():
        raise NoTrap(f"a particle a quarter wavelength {side} the deepest trap does not get there")
    if axis == 1:
        # The weight is carried by a wall, or by the sound between there and a quarter wavelength further.
        sense = -math.copysign(1.0, weight.value)
        beyond_trap = np.clip(base.value + sense * rise.value * np.linspace(0.0, 1.0, RASTER_POINTS), 0.0, 1.0)
        against = -sense * square_of_voltage.value * (fixed[0] @ force @ _along_eta(beyond_trap, field)[0].T)
        if np.ptp(beyond_trap) > SETTLED and against.max() < abs(weight.value):
            raise NoTrap("the field is too weak to hold a particle in the deepest trap against its weight")
    time = Dual(float(weights @ (1.0 / back)), -(weights / back**2) @ by_all)
    # Stokes' drag, as `particles.drag_coefficient`.
    return time * reach * around.fluid["shear_viscosity"] * (0.5 * (FROM - TO) * 6.0 * math.pi * particle.radius)


def _raster(field: CavityField) -> tuple[Real, Real]:
    """Polynomials in s (i, n) and in t (j, m) on lines a small part of a wavelength apart, both walls included."""
    wavelength = 2.0 * math.pi / field.cavity.wave_number
    counts = [math.ceil(RASTER_POINTS * length.value / wavelength) + 1
              for length in (field.around.width, field.around.height)]
    in_s, in_t = field.coefficients.shape[1:]
    return _on_lines(counts[0], in_s, field.cavity.measure.power), _on_lines(counts[1], in_t, 1)


@lru_cache(maxsize=64)
def _on_lines(lines: int, count: int, power: int) -> Real:
    """Polynomials (lines, count) in 2 xi^power - 1 at equal shares xi of the width or of the height."""
    return derivatives(2.0 * np.linspace(0.0, 1.0, lines) ** power - 1.0, count, 0)


def _along_xi(xi: Real, field: CavityField) -> Real:
    """Polynomials in s and their first three derivatives by xi (p,): (4, p, n)."""
    s, first, second = (each[:, None] for each in argument(xi, field.cavity.measure))
    by_s = legendre_polynomials(s[:, 0], field.coefficients.shape[1])
    return np.stack([by_s[0], first * by_s[1], second * by_s[1] + first**2 * by_s[2],
                     3.0 * first * second * by_s[2] + first**3 * by_s[3]])


def _along_eta(eta: Real, field: CavityField) -> Real:
    """Polynomials in t and their first three derivatives by eta (p,): (4, p, m), t = 2 eta - 1."""
    return legendre_polynomials(2.0 * eta - 1.0, field.coefficients.shape[2]) * 2.0 ** np.arange(4)[:, None, None]


def _at_place(place: Real, field: CavityField) -> tuple[Real, Real]:
    """Polynomials in s (4, n) and in t (4, m) at one place (xi, eta), with three derivatives."""
    return _along_xi(place[:1], field)[:, 0], _along_eta(place[1:], field)[:, 0]


def _at(field: CavityField, which: int, along_xi: Real, along_eta: Real) -> Dual:
    """A field where the polynomials along both directions have these values (n,) and (m,)."""
    value = float(along_xi @ field.coefficients[which] @ along_eta)
    return Dual(value, np.einsum("n,nmk,m->k", along_xi, field.gradient[which], along_eta))


def _hessian(field: CavityField, along: tuple[Real, Real]) -> Real:
    """Second derivatives (2, 2) of the potential by xi and eta."""
    potential, (in_xi, in_eta) = field.coefficients[POTENTIAL], along
    mixed = in_xi[1] @ potential @ in_eta[1]
    return np.array([[in_xi[2] @ potential @ in_eta[0], mixed], [mixed, in_xi[0] @ potential @ in_eta[2]]])


def _minimum(field: CavityField, start: Real) -> tuple[Real, NDArray[np.bool_]]:
    """The minimum (xi, eta) that the way down from a place leads to, and in which directions it may move.

    Newton's method with the absolute values of the curvatures, so that it goes down where they are negative, as far as
    the potential falls and at most to a wall. On the axis the potential is even in the radius; at a wall that it falls
    towards, the minimum stays there. Along a line on which it does not change, the place stays.

    Raises:
        NoTrap: no minimum after :data:`STEPS` steps.
    """
    place, potential = start.copy(), field.coefficients[POTENTIAL]
    about_axis = isinstance(field.cavity.measure, Axisymmetric)

    def value(at: Real) -> float:
        in_xi, in_eta = _at_place(at, field)
        return float(in_xi[0] @ potential @ in_eta[0])

    here = value(place)
    for _ in range(STEPS):
        along = _at_place(place, field)
        gradient = np.array([along[0][1] @ potential @ along[1][0], along[0][0] @ potential @ along[1][1]])
        hessian = _hessian(field, along)
        held = ((place <= 0.0) & (gradient > 0.0)) | ((place >= 1.0) & (gradient < 0.0))
        # On the axis there is no slope along the radius: the curvature tells whether it is a minimum there.
        held[0] |= about_axis and place[0] == 0.0 and hessian[0, 0] >= 0.0
        free = ~held
        if about_axis and place[0] == 0.0 and free[0]:
            place[0] = OFF_AXIS
            continue
        at = np.flatnonzero(free)
        step = np.zeros(2)
        if at.size:
            curvatures, axes = np.linalg.eigh(hessian[np.ix_(at, at)])
            least = FLAT * np.abs(hessian).max()
            step[at] = -axes @ ((axes.T @ gradient[at]) / np.maximum(np.abs(curvatures), least))
        if np.abs(step).max() < SETTLED:
            if at.size and curvatures[0] < -least:
                break
            # Where the potential is flat, any place is as good, and the trap stays.
            return place, free & (np.diag(hessian) > FLAT * np.abs(hessian).max())
        for halvings in range(30):
            further = np.clip(place + 0.5**halvings * step, 0.0, 1.0)
            there = value(further)
            if there < here or np.abs(further - place).max() < SETTLED:
                break
        place, here = further, there
    raise NoTrap("the potential is too flat about its lowest place for a trap to be found")
