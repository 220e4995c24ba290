"""The cavity's pressure as a polynomial, and the fields derived from it.

These are the potential, the radiation force and the energy density. A state of the model, full or reduced, gives the
pressure at the nodes of the cavity. Sound there varies no faster than its wavelength, so one polynomial represents it
over the whole cavity:

    p(r, z) = sum_kl C_kl P_k(s) P_l(t),   s = 2 xi^q - 1,   xi = (r - r_0) / R,   t = 2 z / H - 1

P are Legendre polynomials, z counts from the floor, H is the height of the cavity. About an axis, R is the radius,
q = 2 and r_0 = 0, so that the field is even in r. In a straight section R is the width, r_0 = -R / 2 the left side and
q = 1; if only half of it is meshed, the pressure is mirrored by its parity. Either way ds is proportional to the
volume. Squares of such fields are polynomials of twice the degree, given by their values at Gauss-Legendre points.
Their minima, derivatives and integrals are exact. Lengths may move: the values at constant s and t change, and R and H.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legder, leggauss
from numpy.typing import NDArray
from scipy.special import eval_legendre

from geometry.chip import Chip
from geometry.dimension import SAME_LENGTH
from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.names import CAVITY, parent_place
from geometry.section import cut_section
from geometry.stretch import canonical_names, moved_places
from materials.kinds import Fluid
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.radiation import gorkov_potential, radiation_force
from workbench.fem.dual import Dual, dual_derivative
from workbench.fem.operators import FullOperators
from workbench.model.particles import Particle, compressibility, viscous_scattering

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Degree in s and in t beyond half of the phase k R, or k H, across the cavity: beyond it the coefficients of a wave
#: fall faster than geometrically (Jacobi-Anger). With ten the residual is 1e-7.
BEYOND = 10

#: Indices of the quadratic fields of the pressure.
POTENTIAL, SQUARE, ENERGY = range(3)


#: Properties of the fluid that the fields depend on besides the pressure.
OF_FLUID = ("density", "sound_speed", "shear_viscosity")


#: The scalars that these fields depend on too, by name: ``frequency`` Hz, ``width`` (of a round cavity
#: its radius) and ``height`` m, and :data:`OF_FLUID` where known, in kg/m^3, m/s and Pa s.
Surroundings = Mapping[str, Dual]


class NoCavity(ValueError):
    """Raised when the cavity has no field of the kind needed."""


@dataclass(frozen=True, eq=False)
class Cavity:
    """The cavity of a chip: nodes, fluid and particle.

    ``rows`` (n, m) index the unknown pressure at its nodes, -1 where the pressure is zero. The nodes are at ``r`` (n,)
    and ``z`` (m,) in metres, z from the floor. ``fluid`` fills the cavity; ``particle`` is None if there is none. The
    places are linear in ``lengths``, whose initial values are ``start`` (SI). ``wave_number`` (1/m) is the largest one.
    ``measure`` is that of the section.
    """

    rows: NDArray[np.int64]
    r: Dual
    z: Dual
    fluid: Fluid
    particle: Particle | None
    lengths: tuple[str, ...]
    start: Real
    wave_number: float
    measure: Measure = ABOUT_AXIS

    @cached_property
    def across(self) -> Dual:
        """The places across the whole cavity.

        They are ``r``, mirrored if only half of a straight section is meshed.
        """
        return Dual(self.unfolded(self.r.value, -1), self.unfolded(self.r.gradient.T, -1).T)

    def lines(self, change: Real, moving: Real) -> tuple[Dual, Dual]:
        """The places across and up after a `change` of ``lengths``.

        `moving` (lengths, k) are the derivatives of the lengths.
        """
        across, up = (Dual(each.value + change @ each.gradient, moving.T @ each.gradient)
                      for each in (self.across, self.z))
        return across, up

    @property
    def is_half(self) -> bool:
        """Whether only half of a symmetric straight section is meshed."""
        return isinstance(self.measure, Straight) and self.measure.mirror != 0

    def unfolded(self, values: Any, sign: int) -> Any:
        """Values (n, ...) over half a cavity, extended to the whole.

        Their mirror images, multiplied by `sign`, come first.
        """
        return np.concatenate([sign * values[:0:-1], values]) if self.is_half else values

    def change(self, values: Mapping[str, complex]) -> Real:
        """The change (m) of each of ``lengths`` from its start."""
        return np.array([complex(values[name]).real for name in self.lengths]) - self.start

    def pressure_rows(self, basis: Real) -> Real:
        """The nodal pressure rows (n, m, r) of a basis (size, r)."""
        found = basis[self.rows]
        found[self.rows < 0] = 0.0
        return found

    @cached_property
    def polynomials(self) -> Polynomials:
        """The polynomials for the cavity as meshed."""
        lines = self.across.value, self.z.value
        counts = [min(math.ceil(0.5 * self.wave_number * np.ptp(each)) + BEYOND, (2 * each.size) // 3)
                  for each in lines]
        return Polynomials.of(counts[0], counts[1])


def cavity_of(
    operators: FullOperators, chip: Chip, fluid: Fluid, particle: Particle | None, lengths: Sequence[str],
    frequency: float,
) -> Cavity:
    """The cavity of a chip on the mesh of `operators`.

    Args:
        lengths: parameters that the model varies.
        frequency: the highest one (Hz), for the degree of the polynomials.

    Raises:
        NoCavity: the holes have different radii, there are several channels or one off the middle, or the cavity is not
            a rectangle or does not remain one when the lengths change.
    """
    holes = chip.holes
    if max(hole.inner_radius for hole in holes) - min(hole.inner_radius for hole in holes) > SAME_LENGTH:
        raise NoCavity(f"figures of fields need a cavity of one {chip.measure.across.replace('_', ' ')} throughout its "
                       "height")
    if any(hole.cavity_offset or hole.channels > 1 for hole in holes):
        raise NoCavity("figures of fields need one channel, in the middle of the chip")
    mesh, dofs = section_nodes(operators.mesh)
    nodes = mesh.nodes_of([CAVITY])
    floor, names = holes[0].z_bottom, tuple(lengths)
    lines, where = [], []
    for axis in (0, 1):
        found, index = np.unique(np.round(mesh.points[nodes, axis] / SAME_LENGTH).astype(np.int64), return_inverse=True)
        lines.append(found * SAME_LENGTH)
        where.append(index)
    rows = np.full((lines[0].size, lines[1].size), -2)
    rows[where[0], where[1]] = operators.numbering["p"][dofs[nodes]]
    if (rows == -2).any():
        raise NoCavity("figures of fields need a cavity with plane faces and upright walls: layers have shapes or "
                       "outlines about this one")
    if shapes := _shaping(operators, lengths):
        raise NoCavity("figures of fields need a cavity that keeps plane faces and upright walls, and this one changes "
                       "its shape with " + ", ".join(shapes))
    known = chip.dimensions()
    ends, first = (lines[0][0] - SAME_LENGTH, lines[0][-1] + SAME_LENGTH), canonical_names(chip)
    breaks = np.array([b for b in cut_section(chip).r_breaks if ends[0] <= b <= ends[1]])
    movers = moved_places(chip, [first[name] for name in names if name in first])
    of_breaks = np.array([[float(sign) * (first.get(n) == mover) for n in names]
                          for mover, sign in (movers.get(float(b), ("", 0)) for b in breaks)])
    levels = np.cumsum([0.0, *(hole.thickness.value for hole in holes)])
    of_levels = np.cumsum([[0.0] * len(names), *([float(n == f"{hole.region}.thickness") for n in names]
                                                 for hole in holes)], axis=0)
    return Cavity(
        rows, _interpolated(lines[0], breaks, of_breaks), _interpolated(lines[1] - floor, levels, of_levels), fluid,
        particle, names, np.array([known[n].value for n in names]), 2.0 * math.pi * frequency / fluid.sound_speed,
        chip.measure)


def _shaping(operators: FullOperators, lengths: Sequence[str]) -> list[str]:
    """The parameters that deform the cavity's cells.

    Integrals over variants of the mesh depend on them.
    """
    found = {name for i in operators.integrals if i.variant and parent_place(i.place) == CAVITY
             for name in i.coefficient.parameters}
    return [length for length in lengths if length in found]


def _interpolated(places: Real, breaks: Real, slopes: Real) -> Dual:
    """Places between breaks, with derivatives interpolated from `slopes` (breaks, k)."""
    return Dual(places, np.array([np.interp(places, breaks, each) for each in slopes.T]).reshape(-1, places.size))


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Constants of the polynomial transform, the same for every pressure.

    ``s`` are the Gauss-Legendre points across. ``along_s`` and ``along_t`` are the values (points, k) of the Legendre
    polynomials there and of their first and second derivatives. ``back`` transforms values to coefficients.
    """

    s: Real
    along_s: tuple[Real, ...]
    along_t: tuple[Real, ...]
    back: tuple[Real, Real]

    @classmethod
    def of(cls, in_s: int, in_t: int) -> Polynomials:
        """The polynomials for `in_s` times `in_t` coefficients of the pressure."""
        tables, points, back = [], [], []
        for count in (in_s, in_t):
            x, w = leggauss(2 * count - 1)
            points.append(x)
            tables.append(tuple(derivatives(x, count, order) for order in range(3)))
            back.append((derivatives(x, x.size, 0) * w[:, None]).T * (np.arange(x.size) + 0.5)[:, None])
        return cls(points[0], tables[0], tables[1], (back[0], back[1]))

    @property
    def counts(self) -> tuple[int, int]:
        """The numbers of coefficients of the pressure in s and in t."""
        return self.along_s[0].shape[1], self.along_t[0].shape[1]

    def coefficients(self, values: Real) -> Real:
        """The coefficients in s and t of fields at the Gauss-Legendre points.

        The fields are (..., points in s, points in t).
        """
        return np.asarray(self.back[0] @ values @ self.back[1].T)


@dataclass(frozen=True, eq=False)
class CavityField:
    """The quadratic fields of a pressure at unit voltage, as polynomials.

    ``coefficients`` (f, n, m) are those of the potential (J), |p|^2 (Pa^2), the energy density (J/m^3) and the forces
    (N) in the directions of focusing (`geometry.measure`), with derivatives at constant s and t. ``around`` are the
    scalars they depend on. ``unfitted`` is the largest residual of the pressure's polynomial, relative to the largest
    pressure.
    """

    cavity: Cavity
    coefficients: Dual
    around: Surroundings
    unfitted: float

    @property
    def mean_energy_density(self) -> Dual:
        """The mean over the cavity's volume.

        It is the coefficient of P_0 P_0, since ds is proportional to the volume.
        """
        return self.coefficients[ENERGY, 0, 0]


def cavity_field(cavity: Cavity, pressure: Complex, slopes: Complex, around: Surroundings, change: Real,
                 moving: Real) -> CavityField:
    """The field of a pressure at the cavity's nodes.

    Args:
        pressure: (n, m) at unit voltage.
        slopes: (n, m, k) its derivatives by k parameters, at the nodes as they move.
        around: the scalars and their derivatives.
        change: of the lengths that move the cavity (m), see :meth:`Cavity.change`.
        moving: (lengths, k) derivative of the lengths by the parameters.
    """
    polynomials = cavity.polynomials
    pressure, slopes = (cavity.unfolded(each, cavity.measure.mirror) for each in (pressure, slopes))
    xi, eta = ((each - each[0]) / (each[-1] - each[0]) for each in cavity.lines(change, moving))
    counts = polynomials.counts
    s, by_share, _ = argument(xi.value, cavity.measure.power)
    tables = [(derivatives(x, count, 0), derivatives(x, count, 1))
              for x, count in ((s, counts[0]), (2.0 * eta.value - 1.0, counts[1]))]
    inverse = [np.linalg.pinv(values) for values, _ in tables]
    found = inverse[0] @ pressure @ inverse[1].T
    left = pressure - tables[0][0] @ found @ tables[1][0].T
    by_s = by_share[:, None] * (tables[0][1] @ found @ tables[1][0].T)
    by_t = 2.0 * (tables[0][0] @ found @ tables[1][1].T)
    fixed = np.moveaxis(slopes, -1, 0) - by_s * xi.gradient[:, :, None] - by_t * eta.gradient[:, None, :]
    changes = inverse[0] @ fixed @ inverse[1].T
    scalars = {name: number.value for name, number in around.items()}
    values = squares(cavity, found, scalars)
    gradient = np.zeros((len(changes), *values.shape))
    size = np.linalg.norm(found)
    for k, each in enumerate(changes):
        length = np.linalg.norm(each)
        if length > 0.0:
            # Half the central difference is the exact derivative of a quadratic form.
            step = (size / length) * each
            both = squares(cavity, found + step, scalars) - squares(cavity, found - step, scalars)
            gradient[k] = (0.5 * length / size) * both
    for name, number in around.items():
        if number.gradient.any():
            by_scalar = dual_derivative(lambda x, name=name: squares(cavity, found, {**scalars, name: x}), number.value)  # type: ignore[misc]
            gradient += np.multiply.outer(number.gradient, by_scalar)
    return CavityField(cavity, Dual(polynomials.coefficients(values), polynomials.coefficients(gradient)), around,
                       float(np.abs(left).max() / np.abs(pressure).max()))


def argument(xi: Real, power: int) -> tuple[Real, Real, Real]:
    """The argument s = 2 xi^power - 1 and its two derivatives.

    xi (n,) are shares of the cavity. A power of 1 or 2 has no third derivative.
    """
    return (2.0 * xi**power - 1.0, 2.0 * power * xi ** (power - 1), np.full_like(xi, 2.0 * power * (power - 1)))


def squares(cavity: Cavity, found: Complex, scalars: Mapping[str, float]) -> Real:
    """Potential, |p|^2, energy density and focusing forces of a pressure.

    `found` are the pressure's coefficients. The result (f, points in s, points in t) is quadratic in these and a closed
    formula of the scalars.
    """
    polynomials = cavity.polynomials
    (s0, s1, s2), (t0, t1, t2) = polynomials.along_s, polynomials.along_t
    width, height, density = scalars["width"], scalars["height"], scalars["density"]
    xi = (0.5 * (polynomials.s + 1.0)) ** (1.0 / cavity.measure.power)
    first, second = (each[:, None] for each in argument(xi, cavity.measure.power)[1:])
    half, mixed = s0 @ found, s1 @ found
    pressure, along_z = half @ t0.T, (2.0 / height) * (half @ t1.T)
    along_r, twice_z = (first / width) * (mixed @ t0.T), (2.0 / height) ** 2 * (half @ t2.T)
    crossed = (first / width) * (2.0 / height) * (mixed @ t1.T)
    twice_r = (second * (mixed @ t0.T) + first**2 * (s2 @ found @ t0.T)) / width**2
    slopes = np.stack([along_r, along_z], axis=-1)
    # Euler: -i w rho v = -grad p.
    to_velocity = 1.0 / (2j * math.pi * scalars["frequency"] * density)
    velocity = to_velocity * slopes
    fluid = replace(cavity.fluid, density=density, sound_speed=scalars["sound_speed"],
                    shear_viscosity=scalars.get("shear_viscosity"))
    square = np.abs(pressure) ** 2
    energy = 0.25 * (density * (np.abs(velocity) ** 2).sum(axis=-1) + compressibility(fluid) * square)
    focusing = list(cavity.measure.focusing)
    potential, force = np.zeros(square.shape), np.zeros((*square.shape, len(focusing)))
    if cavity.particle is not None:
        scattering = viscous_scattering(cavity.particle, fluid, scalars["frequency"])
        curvature = np.stack([np.stack([twice_r, crossed], axis=-1), np.stack([crossed, twice_z], axis=-1)], axis=-2)
        potential = gorkov_potential(cavity.particle, fluid, scattering=scattering, pressure=pressure,
                                     velocity=velocity)
        force = radiation_force(
            cavity.particle, fluid, scattering=scattering, pressure=pressure, pressure_gradient=slopes,
            velocity=velocity, velocity_gradient=to_velocity * curvature)[..., focusing]
    return np.concatenate([np.stack([potential, square, energy]), np.moveaxis(force, -1, 0)])


@lru_cache(maxsize=64)
def _differentiation(count: int, order: int) -> Real:
    """The matrix (count - order, count) that differentiates P_0 ... P_(count - 1) `order` times."""
    return np.asarray(legder(np.eye(count), order))


def derivatives(x: Real, count: int, order: int) -> Real:
    """The `order`-th derivatives (n, count) of P_0 ... P_(count - 1) at x (n,)."""
    if order >= count:
        return np.zeros((x.size, count))
    values = eval_legendre(np.arange(count - order), x[:, None])
    return np.asarray(values @ _differentiation(count, order) if order else values)


def legendre_polynomials(x: Real, count: int) -> Real:
    """P_0 ... P_(count - 1) at x (n,) and three derivatives: (4, n, count)."""
    values = derivatives(x, count, 0)
    return np.stack([values, *(values[:, : count - order] @ _differentiation(count, order) for order in (1, 2, 3))])
