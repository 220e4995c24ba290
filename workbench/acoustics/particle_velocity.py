"""Velocity of a particle: radiation force and weight against drag, and flow.

::

    dx/dt = v2 + F / (6 pi eta a) - W / (6 pi eta a) e_z

Near a wall the drag is larger: along it by Faxen's formula, towards it by Brenner's, for the nearest wall only. Inertia
is negligible: the relaxation time of a bead of 10 um in water is microseconds. ``v2`` is the velocity at which the
liquid carries a particle, streaming plus Stokes drift (Bach and Bruus, J. Acoust. Soc. Am. 144, 766, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import FloatArray, IntArray
from workbench.acoustics.walls import Walls
from workbench.model.particles import drag_coefficient, net_weight


@dataclass(frozen=True, eq=False, repr=False)
class ParticleVelocity(Interpolant):
    """Velocity (m/s) along r and z, continued beyond mirror lines by symmetry. ``values`` (N, 2) are at the nodes of
    ``mesh``. It is called like an :class:`Interpolant`; points may be beyond a mirror line, such as at negative r."""

    def __call__(
        self, points: FloatArray, cell: IntArray, *, slopes: bool = False
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        inside, sense = self.mesh.mirrors.folded(points)
        velocity, slope, found = super().__call__(inside, cell, slopes=slopes)
        velocity[:, 0] *= sense
        if slopes:
            slope[:, 0, 1] *= sense
            slope[:, 1, 0] *= sense
        return velocity, slope, found


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class VelocityNearWalls(ParticleVelocity):
    """The velocity of a particle whose drag grows near ``walls``.

    ``values`` are those far away; ``radius`` is in m. ``parts`` interpolates the velocity by forces and that of the
    liquid (N, 4). A wall ``holds`` a particle at a gap of so many radii: from twice that gap its approach slows to
    zero, while it may slide and leave.
    """

    walls: Walls
    radius: float
    parts: Interpolant
    holds: float = 0.0

    def __call__(
        self, points: FloatArray, cell: IntArray, *, slopes: bool = False
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        inside, sense = self.mesh.mirrors.folded(points)
        both, slope, found = self.parts(inside, cell, slopes=slopes)
        distance, away = self.walls.nearest(inside)
        (along, d_along), (towards, d_towards) = wall_mobilities(distance / self.radius)
        normal = (both[:, :2] * away).sum(axis=1)[:, None] * away
        tangential = both[:, :2] - normal
        velocity = both[:, 2:] + along[:, None] * tangential + towards[:, None] * normal
        inwards = np.minimum((velocity * away).sum(axis=1), 0.0) if self.holds else np.zeros(len(velocity))
        gap = (distance / self.radius - 1.0 - self.holds) / self.holds if self.holds else np.ones(len(velocity))
        let = np.clip(gap, 0.0, 1.0)
        velocity += ((let - 1.0) * inwards)[:, None] * away
        velocity[:, 0] *= sense
        if slopes:
            projected = away[:, :, None] * away[:, None]
            mobility = along[:, None, None] * (np.eye(2) - projected) + towards[:, None, None] * projected
            turned = (d_along[:, None] * tangential + d_towards[:, None] * normal) / self.radius
            slope = slope[:, 2:] + mobility @ slope[:, :2] + turned[:, :, None] * away[:, None]
            slope += np.where(inwards < 0.0, let - 1.0, 0.0)[:, None, None] * (projected @ slope)
            steep = np.where((gap > 0.0) & (gap < 1.0), inwards / (self.holds * self.radius or 1.0), 0.0)
            slope += steep[:, None, None] * projected
            slope[:, 0, 1] *= sense
            slope[:, 1, 0] *= sense
        return velocity, slope, found


def wall_mobilities(
    distance: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Relative mobilities (K,) along and towards a plane wall, and derivatives.

    `distance` (K,) is that of the centre of the sphere in radii. Along: Faxen's series (Happel and Brenner 1965, eq.
    7-4.28), 1 % below the exact one at 1.54 radii. Towards: the rational form of Brenner's series (Bevan and Prieve, J.
    Chem. Phys. 113, 1228, 2000), within 1 %.
    """
    far = np.maximum(distance, 1.0)
    x, touching = 1.0 / far, distance < 1.0
    along = 1.0 - 9.0 / 16.0 * x + x**3 / 8.0 - 45.0 / 256.0 * x**4 - x**5 / 16.0
    d_along = (9.0 / 16.0 - 3.0 * x**2 / 8.0 + 45.0 / 64.0 * x**3 + 5.0 / 16.0 * x**4) * x**2
    gap = far - 1.0
    top, bottom = 6.0 * gap**2 + 2.0 * gap, 6.0 * gap**2 + 9.0 * gap + 2.0
    d_towards = ((12.0 * gap + 2.0) * bottom - top * (12.0 * gap + 9.0)) / bottom**2
    return ((along, np.where(touching, 0.0, d_along)), (top / bottom, np.where(touching, 0.0, d_towards)))


def particle_velocity(
    forces: ParticleForces, *, flow: FloatArray | None = None, voltage_factor: float = 1.0, walls: Walls | None = None,
    holds: float = 0.0,
) -> ParticleVelocity:
    """The velocity of the particle of `forces` in a `flow`.

    The `flow` (N, 2) is in m/s at the nodes of the mesh of `forces`. With `walls` the drag grows near them, and they
    hold the particle at a gap of `holds` radii; the flow there is that without the particle. The radiation force is
    multiplied by `voltage_factor` squared; the flow is not scaled.

    Raises:
        ValueError: a flow of another shape, or with values that are not finite.
    """
    mesh = forces.mesh
    drag = drag_coefficient(forces.particle, forces.fluid)
    velocity = voltage_factor**2 * forces.force / drag
    velocity[:, 1] -= net_weight(forces.particle, forces.fluid) / drag
    if flow is not None:
        if flow.shape != velocity.shape or not np.isfinite(flow).all():
            raise ValueError(f"flow has shape {flow.shape}, {np.isnan(flow).sum()} values not finite; expected finite "
                             f"{velocity.shape}, the velocity at the nodes of the mesh of the forces")
    else:
        flow = np.zeros_like(velocity)
    parts = np.concatenate([velocity, flow], axis=1)
    # On a mirror line, the force along r is zero except for the error of the mesh.
    parts[mesh.mirrors.on(mesh.points[:, 0]), ::2] = 0.0
    velocity = parts[:, :2] + parts[:, 2:]
    if walls is None:
        return ParticleVelocity(mesh, velocity)
    return VelocityNearWalls(mesh, velocity, walls=walls, radius=forces.particle.radius, holds=holds,
                             parts=Interpolant(mesh, parts))
