"""Velocity of a particle at any place of a cavity: radiation force and weight against drag, and the flow of the liquid.

    dx/dt = v2 + F / (6 pi eta a) - W / (6 pi eta a) e_z

Inertia is negligible: a bead of 10 um in water forgets its speed in microseconds. ``v2`` is the velocity with which the
liquid carries a particle, streaming and Stokes drift together (Bach and Bruus, J. Acoust. Soc. Am. 144, 766, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.acoustics.forces import ParticleForces
from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import FloatArray, IntArray
from workbench.model.particles import drag_coefficient, net_weight


@dataclass(frozen=True, eq=False, repr=False)
class ParticleVelocity(Interpolant):
    """Velocity (m/s) along r and z, ``values`` (N, 2) at the nodes of ``mesh``, continued by symmetry behind the axis
    or a plane of symmetry.

    Called as an :class:`Interpolant`; points may lie behind it, such as at negative r.
    """

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


def particle_velocity(
    forces: ParticleForces, *, flow: FloatArray | None = None, voltage_factor: float = 1.0
) -> ParticleVelocity:
    """The velocity of the particle of `forces`, with the `flow` (N, 2) in m/s of the liquid at the nodes of its mesh.

    The radiation force grows with the square of the drive: with `voltage_factor` times the voltage it is that factor
    squared times as large. The flow is taken as it is given.

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
        velocity = velocity + flow
    # On the axis, or a plane of symmetry, the force along r is zero but for the error of the mesh.
    velocity[mesh.mirrors.on(mesh.points[:, 0]), 0] = 0.0
    return ParticleVelocity(mesh, velocity)
