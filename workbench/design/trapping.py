"""The deepest trap of a polynomial potential, with exact derivatives.

The trap is the lowest place of the potential in the cavity: on a raster first, then by Newton's method. Its derivatives
follow from grad U = 0 (implicit function theorem). A trap at a wall moves along the wall only.
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
from workbench.acoustics.focusing import FROM, TO, along_stiffest, travel_time
from workbench.acoustics.traps import RASTER_POINTS
from workbench.design.cavity import (
    ENERGY,
    POTENTIAL,
    SQUARE,
    CavityField,
    argument,
    derivatives,
    legendre_polynomials,
)
from workbench.fem.dual import Dual
from workbench.model.particles import GRAVITY, viscous_scattering

Real = NDArray[np.float64]

#: Size (in shares of width and height) of the last step of Newton's method, and most steps.
SETTLED, STEPS = 1e-8, 60
#: A curvature below this share of the other one (by shares of width and height) counts as zero: rounding gives 1e-7.
FLAT = 1e-5
#: Share of the width by which a place leaves the axis if the potential has its maximum there.
OFF_AXIS = 1e-3
#: Points of the Gauss rule for the focusing time: the force is smooth over a part of a wavelength.
RULE = 24


class NoTrap(ValueError):
    """Raised when the field does not bring a particle into a trap."""


@dataclass(frozen=True, eq=False)
class FoundTrap:
    """The deepest trap at unit voltage.

    ``place`` (2,) are xi and eta, shares of width and height. ``depth`` is in J, the ``radial`` and the ``axial``
    stiffness in N/m.
    """

    field: CavityField
    place: Dual
    depth: Dual
    radial: Dual
    axial: Dual

    @property
    def radius(self) -> Dual:
        """The distance (m) from the axis.

        In a straight chip it is from the middle, negative to its left.
        """
        middle = 0.0 if isinstance(self.field.cavity.measure, Axisymmetric) else 0.5
        return self.field.around["width"] * (self.place[0] - middle)

    @property
    def height(self) -> Dual:
        """The height (m) above the floor."""
        return self.field.around["height"] * self.place[1]


def largest_square(field: CavityField) -> Dual:
    """The largest |p|^2 (Pa^2) at unit voltage, on the raster."""
    lines = _raster(field)
    square = field.coefficients[SQUARE]
    values = lines[0] @ square.value @ lines[1].T
    i, j = np.unravel_index(int(np.argmax(values)), values.shape)
    return lines[0][i] @ square @ lines[1][j]


def find_trap(field: CavityField, near: float | None = None) -> FoundTrap:
    """Find the trap: the lowest place of the potential.

    With `near` (m) it is the local minimum reached by descent from the lowest place at that radius.

    Raises:
        NoTrap: the potential is too flat for a lowest place.
    """
    lines, potential, around = _raster(field), field.coefficients[POTENTIAL], field.around
    values = lines[0] @ potential.value @ lines[1].T
    (i, j), (k, m) = (np.unravel_index(int(each), values.shape) for each in (np.argmin(values), np.argmax(values)))
    # If a trap has a mirror image, use the right-hand one.
    right = max(int(i), len(values) - 1 - int(i)) if field.cavity.is_half else int(i)
    start = np.array([right, j]) / (np.array(values.shape) - 1.0)
    if near is not None:
        column = min(round(near / around["width"].value * (len(values) - 1)), len(values) - 1)
        start = np.array([column, np.argmin(values[column])]) / (np.array(values.shape) - 1.0)
    place, free = _minimum(field, start)
    by_number = np.zeros((len(potential.gradient), 2))
    across, up = _at_place(field, place)
    at = np.flatnonzero(free)
    if at.size:
        gradient = np.stack([(across[1] @ potential @ up[0]).gradient, (across[0] @ potential @ up[1]).gradient])
        by_number[:, at] = -np.linalg.solve(_hessian(potential.value, across, up)[np.ix_(at, at)], gradient[at]).T
    moving = Dual(place, by_number)
    xi, eta = ([each[0] for each in _along(field, axis, moving[axis:axis + 1])] for axis in (0, 1))
    highest, lowest = lines[0][k] @ potential @ lines[1][m], xi[0] @ potential @ eta[0]
    return FoundTrap(field, moving, highest - lowest, xi[2] @ potential @ eta[0] / around["width"]**2.0,
                     xi[0] @ potential @ eta[2] / around["height"]**2.0)


def follows_flow(trap: FoundTrap) -> str:
    """The reason why streaming keeps the particle from a trap.

    Streaming along plane walls then moves it more than sound does. The reason is empty otherwise.
    """
    cavity, frequency = trap.field.cavity, trap.field.around["frequency"].value
    assert cavity.particle is not None
    factor = viscous_scattering(cavity.particle, cavity.fluid, frequency).contrast_factor
    if not factor or 2.0 * cavity.particle.radius >= (limit := critical_diameter(factor, cavity.fluid, frequency)):
        return ""
    return (f"particles of {2e6 * cavity.particle.radius:.3g} um circulate with the streaming, however large the "
            f"voltage: their critical diameter is {1e6 * limit:.2g} um")


def trap_focus_time(trap: FoundTrap, square_of_voltage: Dual, *, beyond: float = 0.0) -> Dual:
    """The focusing time (s) of a particle to the trap.

    It is from 90 to 10 % of a quarter wavelength above the trap, as in `workbench.acoustics.traps.focus_time`. In a
    straight chip the path is horizontal instead, to the right of the trap, if the trap is stiffer that way or is
    reached only that way. The distance to the side wall then replaces the quarter wavelength if it is shorter. The path
    may begin above the lid, up to `beyond` as a share of the height: the force is extrapolated there along its tangent.

    Raises:
        NoTrap: the path leaves the cavity by more, the force does not lead down all of it, or the particle sinks or
            rises past the trap.
    """
    return along_stiffest(trap.field.cavity.measure, (trap.radial.value, trap.axial.value),
                          lambda axis: _time_along(trap, square_of_voltage, axis, beyond))


def _time_along(trap: FoundTrap, square_of_voltage: Dual, axis: int, beyond: float) -> Dual:
    """The time (s) of :func:`trap_focus_time` along one direction.

    `axis` is 0 across and 1 up.
    """
    field, side = trap.field, ("beside", "above")[axis]
    particle, around = field.cavity.particle, field.around
    assert particle is not None
    length, base = (around["width"], around["height"])[axis], trap.place[axis]
    reach = around["sound_speed"] / around["frequency"] * 0.25
    if axis == 0 and (1.0 - base.value) * length.value < reach.value:
        reach = (base * -1.0 + 1.0) * length
    if base.value * length.value + FROM * reach.value > (1.0 + beyond) * length.value:
        raise NoTrap(f"a quarter wavelength {side} the deepest trap there is a wall")
    # Weight less buoyancy, as `particles.net_weight`.
    weight = (around["density"] * -1.0 + particle.density) * (particle.volume * GRAVITY if axis else 0.0)
    rise = reach / length
    points, weights = leggauss(RULE)
    back = weight - _force(trap, axis, base + rise * (0.5 * (FROM + TO) + 0.5 * (FROM - TO) * points)
                           ) * square_of_voltage
    if not (back.value > 0.0).all():
        raise NoTrap(f"a particle a quarter wavelength {side} the deepest trap does not get there")
    if axis == 1:
        # A wall supports the weight, or the sound within the next quarter wavelength.
        sense = -math.copysign(1.0, weight.value)
        further = np.clip(base.value + sense * rise.value * np.linspace(0.0, 1.0, RASTER_POINTS), 0.0, 1.0)
        force = _force(trap, axis, Dual(further, np.zeros((len(base.gradient), further.size)))).value
        against = -sense * square_of_voltage.value * force
        if np.ptp(further) > SETTLED and against.max() < abs(weight.value):
            raise NoTrap("the field is too weak to hold a particle in the deepest trap against its weight")
    # Stokes' drag, as `particles.drag_coefficient`.
    drag = around["shear_viscosity"] * (6.0 * math.pi * particle.radius)
    return travel_time(drag, reach * (FROM - TO), back, 0.5 * weights)


def _force(trap: FoundTrap, axis: int, places: Dual) -> Dual:
    """The force (p,) N at unit voltage through the trap.

    The line goes across or up, `places` (p,) are shares of it. Beyond the lid the force is extrapolated along its
    tangent.
    """
    field = trap.field
    inside = np.minimum(places.value, 1.0)
    value, slope = _polynomials(field, axis, inside)[:2]
    moving = Dual(value + (places.value - inside)[:, None] * slope, places.gradient[:, :, None] * slope)
    fixed = _along(field, 1 - axis, trap.place[1 - axis:2 - axis])[0][0]
    force = field.coefficients[ENERGY + 1 + field.cavity.measure.focusing.index(axis)]
    return fixed @ (force if axis else force.T) @ moving.T


def _raster(field: CavityField) -> tuple[Real, Real]:
    """Polynomials on a raster: in s (i, n) and t (j, m).

    Its lines are a small part of a wavelength apart, and include both walls.
    """
    wavelength = 2.0 * math.pi / field.cavity.wave_number
    counts = [math.ceil(RASTER_POINTS * length.value / wavelength) + 1
              for length in (field.around["width"], field.around["height"])]
    in_s, in_t = field.coefficients.value.shape[1:]
    return _on_lines(counts[0], in_s, field.cavity.measure.power), _on_lines(counts[1], in_t, 1)


@lru_cache(maxsize=64)
def _on_lines(lines: int, count: int, power: int) -> Real:
    """Polynomials (lines, count) in 2 xi^power - 1 at equally spaced lines.

    xi are shares of the width or of the height.
    """
    return derivatives(argument(np.linspace(0.0, 1.0, lines), power)[0], count, 0)


def _polynomials(field: CavityField, axis: int, shares: Real) -> Real:
    """Polynomials across or up with three derivatives by `shares`: (4, p, count).

    `shares` (p,) are those of the width or the height.
    """
    power = 1 if axis else field.cavity.measure.power
    s, first, second = (each[:, None] for each in argument(shares, power))
    by_s = legendre_polynomials(s[:, 0], field.coefficients.value.shape[1 + axis])
    return np.stack([by_s[0], first * by_s[1], second * by_s[1] + first**2 * by_s[2],
                     3.0 * first * second * by_s[2] + first**3 * by_s[3]])


def _along(field: CavityField, axis: int, shares: Dual) -> list[Dual]:
    """Polynomials (p, count) across or up at shares (p,), and two derivatives.

    The shares have derivatives by the numbers.
    """
    values = _polynomials(field, axis, shares.value)
    return [Dual(values[order], shares.gradient[:, :, None] * values[order + 1]) for order in range(3)]


def _at_place(field: CavityField, place: Real) -> tuple[Real, Real]:
    """Polynomials at one place: in s (4, n) and t (4, m).

    `place` is (xi, eta). The first axis has the values and three derivatives.
    """
    return _polynomials(field, 0, place[:1])[:, 0], _polynomials(field, 1, place[1:])[:, 0]


def _hessian(potential: Real, across: Real, up: Real) -> Real:
    """The second derivatives (2, 2) of the potential by xi and eta."""
    mixed = across[1] @ potential @ up[1]
    return np.array([[across[2] @ potential @ up[0], mixed], [mixed, across[0] @ potential @ up[2]]])


def _minimum(field: CavityField, start: Real) -> tuple[Real, NDArray[np.bool_]]:
    """Find the local minimum (xi, eta) by descent, and its free directions.

    It is Newton's method with the absolute values of the curvatures, so that it descends where they are negative, as
    long as the potential falls and at most to a wall. On the axis the potential is even in the radius. At a wall that
    it falls towards, the minimum stays there. Along a line on which it does not change, the place stays.

    Raises:
        NoTrap: no minimum after :data:`STEPS` steps.
    """
    place, potential = start.copy(), field.coefficients[POTENTIAL].value
    about_axis = isinstance(field.cavity.measure, Axisymmetric)

    def value(at: Real) -> float:
        across, up = _at_place(field, at)
        return float(across[0] @ potential @ up[0])

    here = value(place)
    for _ in range(STEPS):
        across, up = _at_place(field, place)
        gradient = np.array([across[1] @ potential @ up[0], across[0] @ potential @ up[1]])
        hessian = _hessian(potential, across, up)
        held = ((place <= 0.0) & (gradient > 0.0)) | ((place >= 1.0) & (gradient < 0.0))
        # The slope along the radius is zero on the axis: the curvature decides whether it is a minimum.
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
            # If the potential is flat, all places are equal, and the trap stays.
            return place, free & (np.diag(hessian) > FLAT * np.abs(hessian).max())
        for halvings in range(30):
            further = np.clip(place + 0.5**halvings * step, 0.0, 1.0)
            there = value(further)
            if there < here or np.abs(further - place).max() < SETTLED:
                break
        place, here = further, there
    raise NoTrap("the potential is too flat about its lowest place for a trap to be found")
