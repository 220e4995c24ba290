"""Potential and radiation force on a particle, and the resulting focus times.

A force depends on its field, so every result has an :class:`Excitation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from workbench.acoustics.focusing import travel_time
from workbench.acoustics.nodal import FloatArray, NodalMesh, gradient, integrate, interpolate, raised, transfer
from workbench.acoustics.radiation import acoustic_energy_density, gorkov_potential, radiation_force
from workbench.model.particles import (
    FluidProperties,
    Particle,
    Scattering,
    drag_coefficient,
    net_weight,
    viscous_scattering,
)
from workbench.results.brief import Brief

if TYPE_CHECKING:
    from workbench.acoustics.fields import Fields

#: Points on the way from a trap to a side wall: one that slopes or is round is as far off as they are apart.
WAY_POINTS = 257


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """The field of a computed force.

    ``description`` of the drive in words; ``frequency`` Hz; ``voltage`` V amplitude across the transducer;
    ``pressure_amplitude`` Pa, the largest |p| in the region; ``energy_density`` J/m^3 of a standing wave of that
    amplitude, p0^2/(4 rho c^2); ``mean_energy_density`` J/m^3, the mean of the field over the region.
    """

    description: str
    frequency: float
    voltage: float
    pressure_amplitude: float
    energy_density: float
    mean_energy_density: float

    def at_voltage(self, factor: float) -> Excitation:
        """The field at `factor` times the voltage, stated at the electrodes."""
        if factor == 1.0:
            return self
        voltage, square = factor * self.voltage, factor**2
        return replace(
            self, description=f"{2.0 * voltage:.4g} Vpp at the electrodes", voltage=voltage,
            pressure_amplitude=factor * self.pressure_amplitude, energy_density=square * self.energy_density,
            mean_energy_density=square * self.mean_energy_density)

    def __str__(self) -> str:
        return (
            f"{self.frequency / 1e6:.4f} MHz, {self.description}, "
            f"p0 = {self.pressure_amplitude / 1e3:.4g} kPa, E_ac = {self.energy_density:.3g} J/m^3 "
            f"(mean over the region {self.mean_energy_density:.3g} J/m^3)"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ParticleForces(Brief):
    """Potential (N,) J and radiation force (N, 2) N on a particle. The nodes are those of ``mesh``, the mesh of
    ``region`` alone."""

    excitation: Excitation
    mesh: NodalMesh
    region: str
    particle: Particle
    fluid: FluidProperties
    scattering: Scattering
    potential: FloatArray
    force: FloatArray

    def at_voltage(self, factor: float) -> ParticleForces:
        """The forces at `factor` times the voltage: they grow with its square."""
        return self if factor == 1.0 else replace(
            self, excitation=self.excitation.at_voltage(factor), potential=factor**2 * self.potential,
            force=factor**2 * self.force)

    def __str__(self) -> str:
        largest = float(np.nanmax(np.linalg.norm(self.force, axis=1)))
        return (
            f"{self.particle.name}, {2e6 * self.particle.radius:.3g} um in {self.region}: "
            f"up to {largest * 1e12:.3g} pN, net weight {net_weight(self.particle, self.fluid) * 1e12:.3g} pN, "
            f"contrast factor {self.scattering.contrast_factor:.4g}\n{self.excitation}"
        )


def particle_forces(
    fields: Fields,
    particle: Particle,
    *,
    fluid: FluidProperties,
    region: str,
    scattering: Scattering | None = None,
) -> ParticleForces:
    """Potential and radiation force on `particle` in the fluid `region`.

    The nodes have twice the order of the fields'. `scattering` is :func:`viscous_scattering` at the field's frequency
    unless given.

    Raises:
        ValueError: unknown region, or a region without pressure.
    """
    mesh = fields.mesh
    if not np.isfinite(fields.pressure[mesh.nodes_of([region])]).all():
        raise ValueError(f"region {region!r} has no pressure; choose a fluid region")
    if scattering is None:
        scattering = viscous_scattering(particle, fluid, fields.frequency)
    finer = raised(mesh, 2 * mesh.order, region)
    pressure, velocity, pressure_gradient, velocity_gradient = (transfer(mesh, values, finer) for values in (
        fields.pressure, fields.velocity, gradient(mesh, fields.pressure, [region]),
        gradient(mesh, fields.velocity, [region]),
    ))
    potential = gorkov_potential(particle, fluid, scattering=scattering, pressure=pressure, velocity=velocity)
    force = radiation_force(
        particle, fluid, scattering=scattering, pressure=pressure, pressure_gradient=pressure_gradient,
        velocity=velocity, velocity_gradient=velocity_gradient,
    )
    excitation = excitation_of(fields, fluid, region, amplitude=float(np.abs(pressure).max()))
    return ParticleForces(
        excitation=excitation, mesh=finer, region=region, particle=particle, fluid=fluid, scattering=scattering,
        potential=potential, force=force,
    )


def excitation_of(fields: Fields, fluid: FluidProperties, region: str, *, amplitude: float) -> Excitation:
    """The excitation of the `fluid` in `region`. `amplitude` (Pa) is the largest |p| there."""
    mesh = fields.mesh
    one = np.ones(len(mesh.points))
    mean = float(integrate(mesh, fields.energy_density, [region]) / integrate(mesh, one, [region]))
    return Excitation(
        description=fields.drive, frequency=fields.frequency, voltage=abs(fields.voltage), pressure_amplitude=amplitude,
        energy_density=acoustic_energy_density(amplitude, fluid), mean_energy_density=mean,
    )


def force_at(forces: ParticleForces, points: FloatArray) -> FloatArray:
    """Radiation force (K, 2) in N at `points` (K, 2). It is NaN outside the region. The components are along r and z;
    points are r, z in m."""
    return interpolate(forces.mesh, forces.force, points, [forces.region])


def focus_time_along(
    forces: ParticleForces, axis: int, *, across: float, start: float, stop: float, points: int = 2001
) -> float:
    """Time (s) from `start` to `stop` (m) along one direction.

    `axis` is 0 for r or x, 1 for z; the other coordinate is `across` (m). Radiation force, and along z weight, act
    against drag. Simpson's rule has an odd number of `points` (`workbench.acoustics.focusing.travel_time`).

    Raises:
        ValueError: part of the path is outside the region, the force vanishes or reverses before `stop`, or an even
            number of points.
    """
    if points < 3 or points % 2 == 0:
        raise ValueError(f"{points} points; expected an odd number of 3 or more")
    way = np.linspace(start, stop, points)
    line = np.full((points, 2), across)
    line[:, axis] = way
    net = force_at(forces, line)[:, axis] - (net_weight(forces.particle, forces.fluid) if axis else 0.0)
    along, beside = (forces.mesh.measure.symbol, "z")[::1 - 2 * axis]
    if not np.isfinite(net).all():
        place = way[~np.isfinite(net)][0]
        raise ValueError(f"{along} = {place:.6g} m at {beside} = {across:.6g} m lies outside region {forces.region!r}")
    against = net * (stop - start) <= 0.0
    if against.any():
        raise ValueError(f"the particle does not get from {along} = {start:.6g} m to {stop:.6g} m: at "
                         f"{way[against][0]:.6g} m the net force is {net[against][0]:.3g} N")
    weights = np.tile([2.0, 4.0], points // 2 + 1)[:points]
    weights[[0, -1]] = 1.0
    return float(travel_time(drag_coefficient(forces.particle, forces.fluid), stop - start, net,
                             weights / (3.0 * (points - 1))))


def way_to_wall(forces: ParticleForces, place: float, height: float, side: float) -> float:
    """The distance (m) from a `place` to the wall at a `height`.

    Both are in m. The wall is on the right (`side` 1) or on the left (-1). The distance to a plane of symmetry is
    infinite.
    """
    mirrors, across = forces.mesh.mirrors, forces.mesh.points[:, 0]
    way = np.linspace(place, float(across.max() if side > 0.0 else across.min()), WAY_POINTS)
    inside = np.isfinite(force_at(forces, np.stack([way, np.full(way.size, height)], axis=1))[:, 0])
    last = way.size - 1 if inside.all() else max(int(np.argmin(inside)) - 1, 0)
    return math.inf if mirrors.on(way[last:last + 1]).all() else abs(float(way[last]) - place)
