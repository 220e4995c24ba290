"""The particle size at which radiation and flow cause equal speeds.

Particles are first balanced along the fast direction: on a plane of levitation in a flat round cavity, on a line across
a straight channel. There they move along the other direction, much more slowly. So the speed by radiation is that in
the whole cavity along the fast direction, and that on the plane or line along the slow one. The flow is that in the
whole cavity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.nodal import FloatArray, NodalArray, NodalMesh, integrate, interpolate, raster
from workbench.acoustics.radiation import radiation_force
from workbench.files.errors import InputError
from workbench.model.particles import (
    FluidProperties,
    Scattering,
    boundary_layer_thickness,
    drag_coefficient,
    net_weight,
    viscous_scattering,
)

#: Largest slip of a standing wave along a plane wall, in units of v0^2 / c (Rayleigh 1884).
RAYLEIGH_SLIP = 3.0 / 8.0
#: Diameters (m) that limit the search. Below, thermal motion exceeds both.
SMALLEST, LARGEST = 10e-9, 1e-3
#: Number of points across and up in the search for the balance. Doubled, critical diameters change by less than 1 %.
POINTS = 161


def critical_diameter(
    contrast_factor: float, fluid: FluidProperties, frequency: float, *, slip: float = RAYLEIGH_SLIP
) -> float:
    """Diameter (m) for equal speeds by radiation and streaming.

    It is sqrt(12 s / |Phi|) delta, from the largest speeds: that by radiation against Stokes drag and that of a slip of
    s v0^2 / c; smaller particles follow the flow (Muller, Barnkob, Jensen and Bruus, Lab Chip 12, 4617, 2012). It holds
    along the wave: across a channel that is half a wave wide.

    Raises:
        InputError: a contrast factor of zero, for which there is no radiation force.
    """
    if contrast_factor == 0.0:
        raise InputError("critical_diameter", "contrast_factor", contrast_factor, "a contrast factor other than zero")
    return math.sqrt(12.0 * slip / abs(contrast_factor)) * boundary_layer_thickness(fluid, frequency)


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstOrderFields:
    """First-order fields at the N nodes of one region's mesh. They are complex amplitudes, e^{-i w t}.
    ``pressure`` (N,) Pa, ``velocity`` (N, 2) m/s, its gradient (N, 2, 2) 1/s with the direction
    first."""

    mesh: NodalMesh
    pressure: NodalArray
    velocity: NodalArray
    velocity_gradient: NodalArray


def critical_diameters(forces: ParticleForces, sound: FirstOrderFields, flow: FloatArray) -> tuple[float, float]:
    """Critical diameters (m) along r (or x) and z. The `flow` (N, 2) is in m/s.

    Each is the diameter at which the rms speed by radiation along that direction equals the rms flow along it. Across a
    straight channel :func:`critical_diameter` is its lower limit; it also applies without a plane or line of balance.
    NaN if radiation is slower for all sizes.
    """
    measure, (region,) = forces.mesh.measure, sound.mesh.regions
    parts = _by_coefficient(forces, sound)
    first = max(measure.focusing) if measure.focusing == (1,) else 0
    found = [math.nan, math.nan]

    def everywhere(values: FloatArray) -> float:
        return float(integrate(sound.mesh, values, [region]) / integrate(sound.mesh, np.ones(len(values)), [region]))

    carried = [math.sqrt(everywhere(flow[:, axis] ** 2)) for axis in (0, 1)]
    found[first] = _equal(forces, _squares(parts[:, :, first], everywhere), carried[first])
    factor = forces.scattering.contrast_factor
    closed = critical_diameter(factor, forces.fluid, forces.excitation.frequency) if factor else math.nan
    if first == 0:
        found[0] = float(np.fmax(found[0], closed))
    second, there = 1 - first, _balanced(forces, first)
    if there is None:
        found[second] = closed
    else:
        points, weight = there
        rows = interpolate(sound.mesh, parts[:, :, second].T, points, [region])
        wet = np.isfinite(rows).all(axis=1)
        if wet.any():
            weight = weight[wet] / weight[wet].sum()
            found[second] = _equal(forces, _squares(rows[wet].T, lambda values: float(weight @ values)),
                                   carried[second])
    return found[0], found[1]


def _by_coefficient(forces: ParticleForces, sound: FirstOrderFields) -> FloatArray:
    """Velocities (3, N, 2) in m/s for unit monopole and dipoles. The dipoles are 1 and i."""
    fluid, particle = forces.fluid, forces.particle
    slope = 2j * math.pi * forces.excitation.frequency * fluid.density * sound.velocity
    return np.stack([radiation_force(
        particle, fluid, scattering=Scattering(monopole, dipole), pressure=sound.pressure, pressure_gradient=slope,
        velocity=sound.velocity, velocity_gradient=sound.velocity_gradient) / drag_coefficient(particle, fluid)
        for monopole, dipole in ((1.0, 0j), (0.0, 1.0 + 0j), (0.0, 1j))])


def _squares(parts: FloatArray, mean: Callable[[FloatArray], float]) -> FloatArray:
    """The means (3, 3) of products of velocity parts (3, K)."""
    return np.array([[mean(one * other) for other in parts] for one in parts])


def _equal(forces: ParticleForces, squares: FloatArray, flow: float) -> float:
    """The diameter (m) with the rms speed `flow` (m/s), or NaN."""
    own = forces.particle.radius

    def excess(log_radius: float) -> float:
        particle = replace(forces.particle, radius=math.exp(log_radius))
        scattering = viscous_scattering(particle, forces.fluid, forces.excitation.frequency)
        weights = np.array([scattering.monopole, complex(scattering.dipole).real, complex(scattering.dipole).imag])
        return float((particle.radius / own) ** 4 * (weights @ squares @ weights)) - flow**2

    low, high = math.log(0.5 * SMALLEST), math.log(0.5 * LARGEST)
    if excess(low) >= 0.0:
        return SMALLEST
    return 2.0 * math.exp(brentq(excess, low, high, xtol=1e-4)) if excess(high) > 0.0 else math.nan


def _balanced(forces: ParticleForces, axis: int) -> tuple[FloatArray, FloatArray] | None:
    """Points (K, 2) of balance along a direction, with volumes (K,). Radiation and weight are balanced. None if there
    are none."""
    mesh = forces.mesh
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    lines = [np.linspace(low[each], high[each], POINTS) for each in (0, 1)]
    pull = raster(mesh, forces.force[:, axis], lines[0], lines[1], [forces.region])
    if axis == 1:
        pull = pull - net_weight(forces.particle, forces.fluid)
    else:
        pull[mesh.mirrors.on(lines[0])] *= 0.0
    along, pull = lines[axis], np.moveaxis(pull, axis, 0)
    before, after = pull[:-1], pull[1:]
    i, j = np.nonzero((before >= 0.0) & (after <= 0.0) & (before > after))
    if not i.size:
        return None
    part = before[i, j] / (before[i, j] - after[i, j])
    points = np.empty((i.size, 2))
    points[:, axis], points[:, 1 - axis] = along[i] + part * (along[i + 1] - along[i]), lines[1 - axis][j]
    return points, mesh.measure.depth(points[:, 0])
