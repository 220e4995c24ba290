"""Acoustic streaming: the steady flow that sound drives in a liquid.

The flow v2 obeys Stokes' equations in the bulk (`stokes`), with the slip of the boundary layers along the walls
(`slip`) and the forces of sound and gravity on the liquid (`flow_forces`). Particles and dye move with the mean
velocity of the liquid itself, v2 plus the Stokes drift vS of the sound. For this sum u::

    -grad p + eta lap (u - vS) + f = 0        div u = 0        n.u = 0,  t.u = slip + t.vS  at walls

The flow is slow: its inertia, and its transport of heat and particles, are neglected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from materials.kinds import Fluid
from workbench.acoustics.critical import RAYLEIGH_SLIP as RAYLEIGH_SLIP
from workbench.acoustics.critical import FirstOrderFields, critical_diameters
from workbench.acoustics.critical import critical_diameter as critical_diameter
from workbench.acoustics.fields import Fields
from workbench.acoustics.flow_forces import TemperatureSlopes, absorption_force, thermoacoustic_force
from workbench.acoustics.flow_walls import FlowBorder, WallSlip, flow_border, raised_edges
from workbench.acoustics.forces import Excitation, ParticleForces, excitation_of
from workbench.acoustics.heat import peclet_number
from workbench.acoustics.nodal import FloatArray, NodalArray, NodalMesh, gradient, integrate, raised, transfer
from workbench.acoustics.slip import WallEdges, slip_velocity, stokes_drift, wall_edges, wall_fields
from workbench.acoustics.stokes import StokesSolver
from workbench.files.errors import InputError
from workbench.model.particles import viscosity
from workbench.results.brief import Brief


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Streaming(Brief):
    """The steady flow in ``region``, at the N nodes of its ``mesh``.

    ``velocity`` (N, 2) m/s along r and z is the flow v2, ``drift`` (N, 2) the Stokes drift; their sum carries
    particles, :attr:`carrier_velocity`. ``causes`` are its parts (N, 2): of the "walls", of the "absorption" in the
    bulk, of "heat" (the thermoacoustic force) and of "buoyancy", if known. ``slips`` have the slip along every wall.
    ``net_flux`` is the largest relative flux imbalance of a cell or patch of cells, ``residual`` that of the solves.
    ``assumptions`` are sentences on surfaces without a wall and on neglected forces. ``critical_diameters`` (m), at
    which radiation and this flow cause equal speeds, are by direction (``radial``, ``axial``, or ``lateral``,
    ``vertical``; `acoustics.critical`), empty without a particle.
    """

    excitation: Excitation
    region: str
    fluid: Fluid
    mesh: NodalMesh
    velocity: FloatArray
    drift: FloatArray
    causes: Mapping[str, FloatArray]
    slips: tuple[WallSlip, ...]
    net_flux: float
    residual: float
    assumptions: tuple[str, ...]
    critical_diameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def critical_diameter(self) -> float | None:
        """Critical diameter (m) along the plane of levitation or across a channel. NaN if no size is as fast as the
        flow, None without a particle."""
        return self.critical_diameters.get(self.mesh.measure.directions[0])

    @property
    def carrier_velocity(self) -> FloatArray:
        """Velocity (N, 2) in m/s of suspended particles: flow plus Stokes drift."""
        return self.velocity + self.drift

    @cached_property
    def largest_speed(self) -> float:
        """Largest speed (m/s) of suspended particles."""
        return float(np.linalg.norm(self.carrier_velocity, axis=1).max())

    @cached_property
    def rms_speed(self) -> float:
        """Root mean square speed (m/s) of suspended particles over the volume."""
        return self.rms_of(self.carrier_velocity)

    def carried_on(self, mesh: NodalMesh) -> FloatArray:
        """:attr:`carrier_velocity` (N', 2) at the nodes of `mesh`. It has the same cells with nodes of any order, such
        as the mesh of `forces.ParticleForces` in the region."""
        return transfer(self.mesh, self.carrier_velocity, mesh)

    def rms_of(self, velocity: FloatArray) -> float:
        """Root mean square of a `velocity` (N, 2) in m/s."""
        square = np.stack([(velocity**2).sum(axis=1), np.ones(len(velocity))], axis=1)
        total, volume = integrate(self.mesh, square, [self.region])
        return math.sqrt(float(total / volume))

    @property
    def height(self) -> float:
        """The smaller of height and width (m), for the Peclet number."""
        return float(np.ptp(self.mesh.points, axis=0).min())

    @property
    def peclet(self) -> float | None:
        """Thermal Peclet number, or None if the thermal diffusivity is unknown. It is the largest speed times
        :attr:`height` over the diffusivity. Above one the flow changes the temperature that drives it."""
        fluid = self.fluid
        if fluid.thermal_conductivity is None or fluid.heat_capacity is None:
            return None
        return peclet_number(fluid, self.largest_speed, self.height)

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {1e6 * self.rms_of(each):.3g}" for name, each in self.causes.items())
        peclet = "" if self.peclet is None else f", Peclet number {self.peclet:.2g}"
        return (f"streaming in the {self.region}: up to {1e6 * self.largest_speed:.3g} um/s, "
                f"{1e6 * self.rms_speed:.3g} um/s rms ({parts} um/s rms){peclet}\n{self.excitation}")


def acoustic_streaming(
    fields: Fields, *, fluid: Fluid, region: str, diffusivity: float | None = None,
    temperature: FloatArray | None = None, slopes: TemperatureSlopes | None = None,
    forces: ParticleForces | None = None, order: int | None = None,
) -> Streaming:
    """The steady flow of `fluid` in `region` under the sound of `fields`.

    Args:
        diffusivity: of sound, in m^2/s, for the force of absorption; that of the fluid unless given.
        temperature: K above ambient at the nodes (N,) of the mesh of `fields` (NaN outside of the region), or at those
            of the region alone, in their order; uniform unless given.
        slopes: change of the fluid with temperature; needed with a temperature.
        forces: on a particle in this field, for its critical diameters.
        order: polynomial order of the flow's velocity, 2 or more; that of the fields unless given. On the chips of the
            package order 4 has an error of 0.3 % rms of the flow and order 6 a tenth of that, in five times the time.

    Raises:
        InputError: a region without pressure or that touches another fluid, a fluid without viscosity, a temperature of
            another shape, with values that are not finite, or without `slopes`, an order below two.
    """
    mesh = fields.mesh
    if order is not None and order < 2:
        raise InputError("streaming", "order", order, "an order of 2 or more")
    edges = _checked(fields, fluid, region)
    walls = [each for each in edges if _is_solid(fields, each.neighbour)]
    opened = [each for each in edges if each not in walls]
    finer = raised(mesh, mesh.order if order is None else order, region)
    velocity_gradient = gradient(mesh, fields.velocity, [region])
    pressure, velocity, there = (transfer(mesh, each, finer) for each in (
        fields.pressure, fields.velocity, velocity_gradient))
    nodes = {each.neighbour: raised_edges(mesh, finer, each) for each in edges}
    border = flow_border(finer, [nodes[each.neighbour] for each in walls], [nodes[each.neighbour] for each in opened])
    drift = stokes_drift(velocity, there, fields.frequency)
    drift[border.axis, 0] = 0.0
    slips = tuple(_slip(fields, fluid, each, nodes[each.neighbour], velocity_gradient, finer.order) for each in walls)
    pushing: dict[str, FloatArray] = {}
    assumed = _open_words(opened, region)
    diffusivity = fluid.diffusivity_of_sound if diffusivity is None else diffusivity
    if diffusivity is None:
        assumed.append(f"The absorption of {fluid.name} is unknown; its force on the liquid is neglected.")
    else:
        if isinstance(fluid, Fluid) and fluid.absorbs_more and diffusivity == fluid.diffusivity_of_sound:
            assumed.append(f"The absorption of {fluid.name} is a lower bound, and so is its force on the liquid.")
        pushing["absorption"] = absorption_force(fluid, diffusivity, fields.frequency, pressure=pressure,
                                                 velocity=velocity)
    if temperature is None:
        assumed.append("The temperature is assumed uniform: no force of sound or gravity on warmer liquid.")
    else:
        pushing |= _heat_forces(fields, fluid, slopes, temperature, finer, pressure, velocity)
    causes, net_flux, residual = _flows(finer, border, viscosity(fluid), _at_nodes(slips, len(finer.points)), drift,
                                        pushing)
    return Streaming(
        excitation=excitation_of(fields, fluid, region, amplitude=float(np.abs(pressure).max())), region=region,
        fluid=fluid, mesh=finer, velocity=sum(causes.values()) - drift, drift=drift, causes=causes, slips=slips,
        net_flux=net_flux, residual=residual, assumptions=tuple(assumed),
        critical_diameters={} if forces is None else dict(zip(mesh.measure.directions, critical_diameters(
            forces, FirstOrderFields(mesh=finer, pressure=pressure, velocity=velocity, velocity_gradient=there),
            np.sum(list(causes.values()), axis=0)), strict=True)))


def _checked(fields: Fields, fluid: Fluid, region: str) -> tuple[WallEdges, ...]:
    """The border of a region with pressure that touches no other fluid."""
    if region not in fields.fluid_regions:
        raise InputError("streaming", "region", region, "a region with a pressure: "
                         + (", ".join(fields.fluid_regions) or "there is none"))
    if fluid.shear_viscosity is None or not fluid.shear_viscosity > 0.0:
        raise InputError("streaming", "shear_viscosity", fluid.shear_viscosity,
                         f"a positive viscosity of {fluid.name}, which drives and resists the flow")
    edges = wall_edges(fields.mesh, region)
    touching = [each.neighbour for each in edges if each.neighbour in fields.fluid_regions]
    if touching:
        raise InputError("streaming", "region", region, f"a region bounded by solids; {touching[0]} is a fluid too, "
                         "and a flow between two fluids is not implemented")
    return edges


def _is_solid(fields: Fields, region: str) -> bool:
    return region in fields.solid_regions


def _open_words(opened: list[WallEdges], region: str) -> list[str]:
    """A sentence for each open part of the border."""
    return [f"The surface between the {region} and {each.neighbour or 'the outside'} is assumed fixed and "
            "frictionless: nothing flows through it." for each in opened]


def _slip(
    fields: Fields, fluid: Fluid, edges: WallEdges, nodes: NodalArray, velocity_gradient: NodalArray, order: int
) -> WallSlip:
    """The slip along one wall, at nodes (L, m + 1). They belong to the flow's mesh."""
    wall = -2j * np.pi * fields.frequency * fields.displacement
    along = wall_fields(fields.mesh, edges, pressure=fields.pressure, velocity=fields.velocity,
                        velocity_gradient=velocity_gradient, wall=wall, order=order)
    speed = slip_velocity(along, frequency=fields.frequency, density=fluid.density, sound_speed=fluid.sound_speed,
                          measure=fields.mesh.measure)
    return WallSlip(edges.neighbour, nodes, along.points, along.tangent, speed)


def _at_nodes(slips: tuple[WallSlip, ...], count: int) -> FloatArray:
    """The slip as velocities (N, 2). They are means over edges, and zero off the walls."""
    total, times = np.zeros((count, 2)), np.zeros(count)
    for each in slips:
        np.add.at(total, each.nodes, each.speed[:, :, None] * each.tangent)
        np.add.at(times, each.nodes, 1.0)
    return total / np.maximum(times, 1.0)[:, None]


def _flows(
    mesh: NodalMesh, border: FlowBorder, eta: float, slip: FloatArray, drift: FloatArray,
    forces: Mapping[str, FloatArray],
) -> tuple[dict[str, FloatArray], float, float]:
    """The flow with drift by cause, net flux and residual. Net flux and residual are the largest ones."""
    solver = StokesSolver(mesh, border.conditions())
    flows = {"walls": solver.solve(eta, velocity=border.along_walls(slip + drift), strained=drift)}
    flows |= {cause: solver.solve(eta, force=force) for cause, force in forces.items()}
    return ({cause: each.velocity for cause, each in flows.items()}, max(each.net_flux for each in flows.values()),
            max(each.residual for each in flows.values()))


def _heat_forces(
    fields: Fields, fluid: Fluid, slopes: TemperatureSlopes | None, temperature: FloatArray, finer: NodalMesh,
    pressure: NodalArray, velocity: NodalArray,
) -> dict[str, FloatArray]:
    """The forces (N, 2) on warm liquid at nodes of `finer`. They are those of sound and of gravity."""
    mesh, (region,) = fields.mesh, finer.regions
    if slopes is None:
        raise InputError("streaming", "slopes", slopes, f"the change of {fluid.name} with temperature")
    nodes = mesh.nodes_of([region])
    whole = np.full(len(mesh.points), np.nan)
    if temperature.shape == whole.shape:
        whole[nodes] = temperature[nodes]
    elif temperature.shape == nodes.shape:
        whole[nodes] = temperature
    else:
        raise InputError("streaming", "temperature", f"an array of shape {temperature.shape}",
                         f"K above ambient, ({len(whole)},) at the nodes of the fields or ({len(nodes)},) at those of "
                         f"the {region}")
    if not np.isfinite(whole[nodes]).all():
        raise InputError("streaming", "temperature", f"{int((~np.isfinite(whole[nodes])).sum())} values that are not "
                         "finite", f"a temperature at every node of the {region}")
    warm, rise = (transfer(mesh, each, finer) for each in (whole, gradient(mesh, whole, [region])))
    sound = thermoacoustic_force(fluid, slopes, pressure=pressure, velocity=velocity, temperature=warm,
                                 temperature_gradient=rise, gravity=0.0)
    both = thermoacoustic_force(fluid, slopes, pressure=pressure, velocity=velocity, temperature=warm,
                                temperature_gradient=rise)
    return {"heat": sound, "buoyancy": both - sound}
