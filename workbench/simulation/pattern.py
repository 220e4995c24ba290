"""The pressure and the traps in the cavity around the axis.

Features beside the axis move the liquid with all orders m. The pressure is

    p(r, z, t) = sum over m of  c_m(r, z) cos(m t) + s_m(r, z) sin(m t) ,

where c_0 contains the field of the drive, and the others are those of the forces of the features
(`workbench.simulation.features`). Its velocity is grad p / (i w rho), and a particle has the Gor'kov potential of both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from geometry.names import CAVITY
from materials.kinds import Fluid
from workbench.acoustics.fields import nodal_components, section_nodes
from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.nodal import NodalMesh, gradient, interpolate
from workbench.acoustics.radiation import gorkov_potential
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress, no_progress
from workbench.model.drive import Drive
from workbench.model.problem import Problem
from workbench.results.brief import Brief
from workbench.simulation.features import (
    Part,
    charge_change,
    compliance_of,
    driven_on,
    forces_of,
    is_odd_of,
    owners_of,
)

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Places of the raster of minima along each wavelength of sound: 16 in each period of the potential of a standing wave.
RASTER = 32

#: Least rise of the potential around the axis next to a minimum, relative to its span. Rounding is far below.
LEAST_DEPTH = 1e-9

#: Radius beside the axis, over that of the cavity: the field there is that of the axis to its square.
BESIDE = 1e-5

#: Orders whose pressure is below this share of the largest one are left out.
NEGLIGIBLE = 1e-4


class PatternTrap(NamedTuple):
    """A minimum of the potential (J) of a particle.

    Its place has a radius and a height (m), and an angle (rad); None for a ring.
    """

    radius: float
    height: float
    angle: float | None
    potential: float


@dataclass(frozen=True, eq=False, repr=False)
class CavityPattern(Brief):
    """The pressure in the cavity around the axis.

    ``cosines`` and ``sines`` (N, M) are c_m and s_m in Pa on the nodes of ``mesh``, NaN beside the cavity. The
    ``frequency`` is in Hz, ``density`` and ``sound_speed`` are those of the liquid. ``forces`` have the particle of the
    state, None without one.
    """

    mesh: NodalMesh
    frequency: float
    density: float
    sound_speed: float
    cosines: Complex
    sines: Complex
    forces: ParticleForces | None = None

    @property
    def orders(self) -> int:
        """The number of orders."""
        return self.cosines.shape[1]

    @property
    def wavelength(self) -> float:
        """The wavelength (m) of sound in the liquid."""
        return self.sound_speed / self.frequency

    @property
    def radius(self) -> float:
        """The radius (m) of the cavity."""
        return float(self.mesh.points[self.mesh.nodes_of([CAVITY]), 0].max())

    @cached_property
    def height(self) -> float:
        """The height (m) of the largest pressure amplitude."""
        return float(self.mesh.points[np.nanargmax(self._amplitude), 1])

    @property
    def unevenness(self) -> float:
        """The largest amplitude that varies around the axis.

        It is relative to the largest amplitude of order 0.
        """
        varying = np.abs(self.cosines[:, 1:]) + np.abs(self.sines[:, 1:])
        return float(np.nanmax(varying.sum(axis=1), initial=0.0) / np.nanmax(np.abs(self.cosines[:, 0])))

    def __str__(self) -> str:
        if self.orders == 1:
            return (f"with the features, the pressure at {self.frequency / 1e6:.6g} MHz is the same at all angles "
                    "around the axis")
        return (f"features move the liquid at {self.frequency / 1e6:.6g} MHz with {self.orders} orders around the "
                f"axis: up to {100.0 * self.unevenness:.3g} % of the largest pressure of order 0")

    def pressure(self, places: Real, angles: Real) -> Complex:
        """The pressure (n, a) in Pa; NaN beside the cavity.

        It is at `places` (n, 2) in m and `angles` (a,) in rad.
        """
        cosine, sine = self._waves(angles)
        cosines, sines = (interpolate(self.mesh, each, places, [CAVITY]) for each in (self.cosines, self.sines))
        return np.asarray(cosines @ cosine + sines @ sine)

    def velocity(self, places: Real, angles: Real) -> Complex:
        """The velocity (n, a, 3) in m/s.

        Its components are along r, around the axis, and along z.
        """
        # On the axis p / r is its limit, which a place beside it has.
        places = np.column_stack([np.maximum(places[:, 0], BESIDE * self.radius), places[:, 1]])
        (cosine, sine), order, radius = self._waves(angles), np.arange(self.orders), places[:, :1]
        cosines, sines = (interpolate(self.mesh, each, places, [CAVITY]) for each in self._slopes)
        across, up = (cosines[:, k] @ cosine + sines[:, k] @ sine for k in (0, 1))
        c, s = (interpolate(self.mesh, each, places, [CAVITY]) for each in (self.cosines, self.sines))
        around = (s * order / radius) @ cosine - (c * order / radius) @ sine
        slopes: Complex = np.stack([across, around, up], axis=2)
        return slopes / (2j * np.pi * self.frequency * self.density)

    def potential(self, places: Real, angles: Real) -> Real:
        """The Gor'kov potential (n, a) in J of the particle.

        Raises
        ------
        InputError : the state has no particle.
        """
        if self.forces is None:
            raise InputError("pattern", "particle", None, "a state with a particle")
        return np.asarray(gorkov_potential(
            self.forces.particle, self.forces.fluid, scattering=self.forces.scattering,
            pressure=self.pressure(places, angles), velocity=self.velocity(places, angles)))

    @cached_property
    def traps(self) -> tuple[PatternTrap, ...]:
        """Minima of the potential of the particle, deepest first.

        They are places of a raster (:data:`RASTER`), without those at walls. Without a particle there are none.
        """
        if self.forces is None:
            return ()
        r, z, angles = self._raster
        places = np.stack(np.meshgrid(r, z, indexing="ij"), axis=2).reshape(-1, 2)
        values = self.potential(places, angles).reshape(r.size, z.size, angles.size)
        inside = np.where(np.isfinite(values), values, np.inf)
        if self.orders == 1:
            inside[:] = inside[:, :, :1]
        # All angles of the axis are one place.
        inside[0] = inside[0].mean(axis=1, keepdims=True)
        beside = minimum_filter(np.stack([inside[0], inside[1]]).min(axis=2), size=(1, 3), mode="nearest").min(axis=0)
        lowest = minimum_filter(inside, size=3, mode=("nearest", "nearest", "wrap"))
        lowest[0] = beside[:, None]
        is_trap = inside <= lowest
        is_trap[0, :, 1:] = False
        # At a wall the potential need not be lowest.
        is_trap[-1], is_trap[:, [0, -1]] = False, False
        # A field without other orders has rings. A trap beside the axis has a higher place next to it around the axis.
        if self.orders == 1:
            is_trap[1:, :, 1:] = False
        else:
            turns = np.stack([np.roll(inside, step, axis=2) for step in (-1, 1)]) - inside
            span = float(np.ptp(values[np.isfinite(values)]))
            is_trap[1:] &= (turns.max(axis=0) > LEAST_DEPTH * span)[1:]
        found = [PatternTrap(float(r[i]), float(z[k]), None if i and self.orders == 1 else float(angles[n]),
                             float(inside[i, k, n])) for i, k, n in np.argwhere(is_trap)]
        return tuple(sorted(found, key=lambda trap: trap.potential))

    @cached_property
    def _raster(self) -> tuple[Real, Real, Real]:
        """Radii and heights (m) and angles (rad) of a raster."""
        points = self.mesh.points[self.mesh.nodes_of([CAVITY])]
        (_, low), (radius, high) = points.min(axis=0), points.max(axis=0)
        r, z = (np.linspace(start, end, math.ceil(RASTER * (end - start) / self.wavelength) + 2)
                for start, end in ((0.0, radius), (low, high)))
        # An even number, since the opposite angle is needed, and eight for each wave of the highest order.
        count = 2 * max(math.ceil(RASTER * math.pi * radius / self.wavelength), 4 * self.orders)
        return r, z, np.arange(count) * (2.0 * math.pi / count)

    @cached_property
    def _amplitude(self) -> Real:
        """The sum of the amplitudes of all orders (N,)."""
        return np.asarray(np.hypot(np.abs(self.cosines), np.abs(self.sines)).sum(axis=1))

    @cached_property
    def _slopes(self) -> tuple[Complex, Complex]:
        """Gradients (N, 2, M) of the orders."""
        cosines, sines = (gradient(self.mesh, each, [CAVITY]) for each in (self.cosines, self.sines))
        return cosines, sines

    def _waves(self, angles: Real) -> tuple[Real, Real]:
        """cos and sin (M, a) of the orders times the angles."""
        turns = np.arange(self.orders)[:, None] * angles
        return np.cos(turns), np.sin(turns)


def cavity_pattern(
    posed: Problem, solution: Solution, parts: Sequence[Part], drive: Drive, *,
    forces: ParticleForces | None = None, progress: Progress = no_progress,
) -> CavityPattern:
    """The pressure in the cavity of a chip with rigid `parts`.

    It is that under the `drive`. `solution` is that of the chip without the parts at one frequency, and 1 V. The
    `forces` have the particle of the state.

    Raises
    ------
    NotConverged, OrdersNotConverged : see :func:`~workbench.simulation.features.compliance_of`.
    """
    operators, fluid = solution.operators, posed.materials[CAVITY]
    assert isinstance(operators, FullOperators)
    assert isinstance(fluid, Fluid)
    mesh, dofs = section_nodes(operators.mesh)
    inside = mesh.nodes_of([CAVITY])

    def pressure(of: FullOperators, states: Complex) -> Complex:
        whole = np.vstack([states, np.zeros((of.prescribed, states.shape[1]))])
        return nodal_components(of, whole, mesh, dofs)["p"][inside]

    angles, patches = np.array([part.angle for part in parts]), [part.patch for part in parts]
    between = compliance_of(posed, patches, angles, solution.frequency, keep=pressure, progress=progress)
    driven = driven_on(posed, operators, parts, solution.states, solution.frequency)
    on_patches = forces_of(parts, solution.frequency, driven, between.total)[0]
    change = charge_change(parts, solution.frequency, driven, between.total)
    voltage = drive.amplitude(solution.impedance * solution.charge / (solution.charge + change))[0]
    is_odd, at = is_odd_of(patches), angles[owners_of(patches)]
    cosines, sines = [], []
    for order, field in enumerate(between.fields):
        own, turned = field * on_patches, order * at
        cosines.append((own * np.where(is_odd, -np.sin(turned), np.cos(turned))).sum(axis=1))
        sines.append((own * np.where(is_odd, np.cos(turned), np.sin(turned))).sum(axis=1))
    cosines[0] = cosines[0] + pressure(operators, solution.states[:-1])[:, 0]
    both = np.stack([np.stack(each, axis=1) for each in (cosines, sines)])
    largest = np.abs(both).max(axis=(0, 1))
    count = int(np.flatnonzero(largest > NEGLIGIBLE * largest.max())[-1]) + 1
    whole = np.full((2, len(mesh.points), count), np.nan, dtype=complex)
    whole[:, inside] = voltage * both[:, :, :count]
    return CavityPattern(mesh, float(solution.frequency[0]), fluid.density, fluid.sound_speed, whole[0], whole[1],
                         forces)
