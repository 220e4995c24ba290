"""What the acoustic field does to a suspended particle: contrast, Gor'kov potential, force, traps, time to focus.

A particle is a compressible sphere much smaller than the wavelength, alone and away from walls. The formulas are
those of Settnes & Bruus, Phys. Rev. E 85, 016327 (2012), and of Gor'kov (1962) without viscosity; time factor
e^{-i w t}.
A force means nothing without the field it was computed in, so every result carries an :class:`Excitation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.polynomial.legendre import legder, legval2d, legvander2d
from numpy.typing import NDArray

from workbench.nodal import FloatArray, NodalMesh, gradient, integrate, raised, raster, sample, transfer

if TYPE_CHECKING:
    from workbench.fields import Fields

#: Standard gravity, m/s^2; it acts along -z.
GRAVITY = 9.80665

#: Points a wavelength of sound at which minima and passes of the potential are looked for: 32 a period of the potential
#: of a standing wave, so a pass is at most (pi / 32)^2 / 4 = 0.2 % of its span off.
RASTER_POINTS = 64
#: Degree of the polynomial fitted about a minimum; over half a period it leaves 1e-6 of the curvature.
FIT_DEGREE = 8
_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


class FluidProperties(Protocol):
    """What a particle has to know of the fluid: density kg/m^3, sound speed m/s, shear viscosity Pa s."""

    @property
    def density(self) -> float: ...
    @property
    def sound_speed(self) -> float: ...
    @property
    def shear_viscosity(self) -> float | None: ...


class ParticleMaterial(Protocol):
    """What is asked of the solid a particle is made of: name, density kg/m^3, compressibility 1/Pa."""

    @property
    def name(self) -> str: ...
    @property
    def density(self) -> float: ...
    @property
    def compressibility(self) -> float: ...


@dataclass(frozen=True, kw_only=True)
class FluidState:
    """A fluid given by its numbers alone: density kg/m^3, sound speed m/s, shear viscosity Pa s."""

    density: float
    sound_speed: float
    shear_viscosity: float | None


@dataclass(frozen=True, kw_only=True)
class Particle:
    """A sphere: name, radius m, density kg/m^3, compressibility 1/Pa (one over the *bulk* modulus).

    Raises:
        ValueError: a radius or density that is not positive, or a negative compressibility.
    """

    name: str
    radius: float
    density: float
    compressibility: float

    def __post_init__(self) -> None:
        for label, value in (("radius", self.radius), ("density", self.density)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"particle {self.name!r}: {label} is {value}; expected a positive number")
        if not (math.isfinite(self.compressibility) and self.compressibility >= 0.0):
            raise ValueError(f"particle {self.name!r}: compressibility is {self.compressibility}; expected 0 or more")

    @property
    def volume(self) -> float:
        """Volume in m^3."""
        return 4.0 / 3.0 * math.pi * self.radius**3


@dataclass(frozen=True)
class Scattering:
    """How a small sphere answers the wave: monopole coefficient f1 (pressure) and dipole coefficient f2 (velocity).

    Both are dimensionless. Viscosity makes f2 complex; with e^{-i w t} a passive particle has Im f2 >= 0.
    """

    monopole: float
    dipole: complex

    @property
    def contrast_factor(self) -> float:
        """Phi = f1/3 + Re f2/2: positive for particles that gather at pressure nodes."""
        return self.monopole / 3.0 + complex(self.dipole).real / 2.0


def particle_from(material: ParticleMaterial, radius: float) -> Particle:
    """A sphere of `radius` (m) made of `material` (an isotropic solid of the registry)."""
    return Particle(
        name=material.name, radius=radius, density=material.density, compressibility=material.compressibility
    )


def bulk_compressibility(*, density: float, longitudinal_speed: float, poisson_ratio: float) -> float:
    """Compressibility (1/Pa) under pressure of a solid known by its wave speed: 3 (1 - nu) / ((1 + nu) rho c_L^2).

    Not 1 / (rho c_L^2), which is that of a liquid: a solid's longitudinal wave also shears it, and for polystyrene the
    shortcut makes the contrast factor a third too large.
    """
    return 3.0 * (1.0 - poisson_ratio) / ((1.0 + poisson_ratio) * density * longitudinal_speed**2)


def compressibility(fluid: FluidProperties) -> float:
    """Compressibility (1/Pa) of the fluid: 1 / (rho c^2)."""
    return 1.0 / (fluid.density * fluid.sound_speed**2)


def viscosity(fluid: FluidProperties) -> float:
    """Shear viscosity (Pa s) of the fluid.

    Raises:
        ValueError: the fluid has none.
    """
    if fluid.shear_viscosity is None or not fluid.shear_viscosity > 0.0:
        raise ValueError(f"shear viscosity of {fluid} is {fluid.shear_viscosity}; expected a positive number")
    return fluid.shear_viscosity


def boundary_layer_thickness(fluid: FluidProperties, frequency: float) -> float:
    """Thickness (m) of the viscous boundary layer: delta = sqrt(2 eta / (rho w))."""
    return math.sqrt(2.0 * viscosity(fluid) / (fluid.density * 2.0 * math.pi * frequency))


def monopole(particle: Particle, fluid: FluidProperties) -> float:
    """f1 = 1 - kappa_p / kappa_f (Settnes & Bruus 2012)."""
    return 1.0 - particle.compressibility / compressibility(fluid)


def dipole(particle: Particle, fluid: FluidProperties) -> float:
    """f2 = 2 (r - 1) / (2 r + 1), r = rho_p / rho_f, without viscosity (Gor'kov 1962)."""
    ratio = particle.density / fluid.density
    return 2.0 * (ratio - 1.0) / (2.0 * ratio + 1.0)


def viscous_dipole(particle: Particle, fluid: FluidProperties, frequency: float) -> complex:
    """f2 = 2 (1 - g)(r - 1) / (2 r + 1 - 3 g), g = -(3/2) [1 + i (1 + d)] d, d = delta / a (Settnes & Bruus 2012)."""
    ratio = particle.density / fluid.density
    layer = boundary_layer_thickness(fluid, frequency) / particle.radius
    drag = -1.5 * (1.0 + 1j * (1.0 + layer)) * layer
    return 2.0 * (1.0 - drag) * (ratio - 1.0) / (2.0 * ratio + 1.0 - 3.0 * drag)


def inviscid_scattering(particle: Particle, fluid: FluidProperties) -> Scattering:
    """Coefficients of a sphere much larger than the viscous boundary layer."""
    return Scattering(monopole(particle, fluid), complex(dipole(particle, fluid)))


def viscous_scattering(particle: Particle, fluid: FluidProperties, frequency: float) -> Scattering:
    """Coefficients of a sphere in a viscous fluid, for any ratio of radius to boundary layer."""
    return Scattering(monopole(particle, fluid), viscous_dipole(particle, fluid, frequency))


def acoustic_energy_density(pressure_amplitude: float, fluid: FluidProperties) -> float:
    """Energy density (J/m^3), mean over time and space, of a standing wave of that amplitude (Pa): p0^2/(4 rho c^2)."""
    return pressure_amplitude**2 * compressibility(fluid) / 4.0


def gorkov_potential(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    pressure: NDArray[Any],
    velocity: NDArray[Any],
) -> FloatArray:
    """U = V [ (f1/2) kappa <p^2> - (3/4) Re f2 rho <v^2> ] in J.

    `pressure` (...) in Pa and `velocity` (..., d) in m/s are complex amplitudes, so <p^2> = |p|^2/2.
    """
    mean_pressure = np.abs(pressure) ** 2 / 2.0
    mean_velocity = (np.abs(velocity) ** 2).sum(axis=-1) / 2.0
    potential: FloatArray = particle.volume * (
        scattering.monopole / 2.0 * compressibility(fluid) * mean_pressure
        - 0.75 * complex(scattering.dipole).real * fluid.density * mean_velocity
    )
    return potential


def radiation_force(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    pressure: NDArray[Any],
    pressure_gradient: NDArray[Any],
    velocity: NDArray[Any],
    velocity_gradient: NDArray[Any],
) -> FloatArray:
    """Time-averaged radiation force (..., d) in N, standing and travelling parts (Settnes & Bruus 2012).

        F = -pi a^3 [ (2 kappa/3) Re(f1* p* grad p) - rho Re(f2* (v* . grad) v) ]

    Complex amplitudes: `pressure` (...) Pa, `pressure_gradient` (..., d) Pa/m, `velocity` (..., d) m/s and
    `velocity_gradient` (..., d, d) 1/s, the direction of differentiation before the component. It is -grad U for a
    standing wave; in a travelling one the imaginary part of f2 pushes the particle along.
    """
    from_pressure = np.real(scattering.monopole * np.conj(pressure)[..., None] * pressure_gradient)
    convected = np.einsum("...j,...ji->...i", np.conj(velocity), velocity_gradient)
    from_velocity = np.real(np.conj(scattering.dipole) * convected)
    force: FloatArray = -math.pi * particle.radius**3 * (
        2.0 / 3.0 * compressibility(fluid) * from_pressure - fluid.density * from_velocity
    )
    return force


def standing_wave_force(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    frequency: float,
    energy_density: float,
    position: float,
) -> float:
    """Force (N) along z in p = p0 cos(k z), at `position` z (m): 4 pi Phi k a^3 E_ac sin(2 k z)."""
    wavenumber = 2.0 * math.pi * frequency / fluid.sound_speed
    peak = 4.0 * math.pi * scattering.contrast_factor * wavenumber * particle.radius**3 * energy_density
    return peak * math.sin(2.0 * wavenumber * position)


def standing_wave_focus_time(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    frequency: float,
    energy_density: float,
    start: float,
    stop: float,
) -> float:
    """Time (s) from `start` to `stop` (m from the pressure antinode) in a plane standing wave, against Stokes drag.

    t = 3 eta / (4 Phi (k a)^2 E_ac) ln[ tan(k stop) / tan(k start) ].

    Raises:
        ValueError: the force does not carry the particle from `start` to `stop` within one quarter wavelength.
    """
    wavenumber = 2.0 * math.pi * frequency / fluid.sound_speed
    quarter = math.pi / 2.0 / wavenumber
    contrast = scattering.contrast_factor
    if not (0.0 < start < quarter and 0.0 < stop < quarter) or (stop - start) * contrast <= 0.0:
        raise ValueError(
            f"from {start} m to {stop} m with contrast factor {contrast:.4g}; expected two places between 0 and a "
            f"quarter wavelength, {quarter:.4g} m, in the direction of the force"
        )
    prefactor = 3.0 * viscosity(fluid) / (4.0 * contrast * (wavenumber * particle.radius) ** 2 * energy_density)
    return prefactor * math.log(math.tan(wavenumber * stop) / math.tan(wavenumber * start))


def rayleigh_streaming_speed(fluid: FluidProperties, energy_density: float) -> float:
    """Largest speed (m/s) of the streaming a standing wave drives along a plane wall: (3/8) v0^2 / c (Rayleigh 1884).

    v0 is the velocity amplitude of the wave, E_ac = rho v0^2 / 4.
    """
    return 3.0 / 8.0 * 4.0 * energy_density / fluid.density / fluid.sound_speed


def crossover_radius(fluid: FluidProperties, *, frequency: float, contrast_factor: float) -> float:
    """Radius (m) below which Rayleigh streaming drags a particle faster than radiation force: delta sqrt(9/(8 Phi))."""
    return boundary_layer_thickness(fluid, frequency) * math.sqrt(3.0 * 3.0 / 8.0 / abs(contrast_factor))


def drag_coefficient(particle: Particle, fluid: FluidProperties) -> float:
    """Stokes drag per speed, 6 pi eta a, in N s/m."""
    return 6.0 * math.pi * viscosity(fluid) * particle.radius


def net_weight(particle: Particle, fluid: FluidProperties) -> float:
    """Weight minus buoyancy in N: positive for a particle that sinks, along -z."""
    return particle.volume * (particle.density - fluid.density) * GRAVITY


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """The field a force was computed in, without which the force says nothing.

    ``description`` how the device was driven, in words; ``frequency`` Hz; ``voltage`` V amplitude across the
    transducer; ``pressure_amplitude`` Pa, the largest |p| in the region; ``energy_density`` J/m^3 of a standing wave of
    that amplitude, p0^2/(4 rho c^2); ``mean_energy_density`` J/m^3, the field's own mean over the region.
    """

    description: str
    frequency: float
    voltage: float
    pressure_amplitude: float
    energy_density: float
    mean_energy_density: float

    def __str__(self) -> str:
        return (
            f"{self.frequency / 1e6:.4f} MHz, {self.description}, "
            f"p0 = {self.pressure_amplitude / 1e3:.4g} kPa, E_ac = {self.energy_density:.3g} J/m^3 "
            f"(mean over the region {self.mean_energy_density:.3g} J/m^3)"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ParticleForces:
    """Potential (N,) J and radiation force (N, 2) N on a particle at the nodes of ``mesh``, which is that of ``region``
    alone."""

    excitation: Excitation
    mesh: NodalMesh
    region: str
    particle: Particle
    fluid: FluidProperties
    scattering: Scattering
    potential: FloatArray
    force: FloatArray

    def __str__(self) -> str:
        largest = float(np.nanmax(np.linalg.norm(self.force, axis=1)))
        return (
            f"{self.particle.name}, {2e6 * self.particle.radius:.3g} um in {self.region}: "
            f"up to {largest * 1e12:.3g} pN, net weight {net_weight(self.particle, self.fluid) * 1e12:.3g} pN, "
            f"contrast factor {self.scattering.contrast_factor:.4g}\n{self.excitation}"
        )


@dataclass(frozen=True, kw_only=True)
class Trap:
    """A place where the particle comes to rest.

    ``radius``, ``height`` r, z in m; ``potential`` J; ``depth`` J, what it takes to leave for a deeper trap or, from
    the deepest, to reach the highest potential in the region; ``radial_stiffness``, ``axial_stiffness`` N/m;
    ``on_wall``: held at a wall, where the force need not vanish (stiffness is then the curvature at the wall).
    """

    radius: float
    height: float
    potential: float
    depth: float
    radial_stiffness: float
    axial_stiffness: float
    on_wall: bool

    def __str__(self) -> str:
        return (
            f"r = {self.radius * 1e3:.3f} mm, z = {self.height * 1e3:.3f} mm{' on the wall' if self.on_wall else ''}: "
            f"depth {self.depth * 1e15:.3g} fJ, stiffness {self.radial_stiffness * 1e9:.3g} pN/mm radial, "
            f"{self.axial_stiffness * 1e9:.3g} pN/mm axial"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class TrapReport:
    """The traps of one field for one particle, deepest first, with the forces they were found in."""

    forces: ParticleForces
    traps: tuple[Trap, ...]

    @property
    def excitation(self) -> Excitation:
        """The field the traps were found in."""
        return self.forces.excitation

    def __str__(self) -> str:
        listed = "\n".join(f"  {number}. {trap}" for number, trap in enumerate(self.traps, start=1))
        return f"{self.forces}\n{listed or '  no trap'}"


def particle_forces(
    fields: Fields,
    particle: Particle,
    *,
    fluid: FluidProperties,
    region: str,
    scattering: Scattering | None = None,
) -> ParticleForces:
    """Potential and radiation force on `particle` in the fluid `region`, on nodes of twice the order of the fields'.

    `scattering` is :func:`viscous_scattering` at the field's frequency unless given.

    Raises:
        ValueError: unknown region, or a region without pressure.
    """
    mesh = fields.mesh
    if not np.isfinite(fields.pressure[mesh.nodes_of([region])]).all():
        raise ValueError(f"region {region!r} carries no pressure; choose a fluid region")
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
    amplitude = float(np.abs(pressure).max())
    one = np.ones(len(mesh.points))
    mean = float(integrate(mesh, fields.energy_density, [region]) / integrate(mesh, one, [region]))
    excitation = Excitation(
        description=fields.drive, frequency=fields.frequency, voltage=abs(fields.voltage), pressure_amplitude=amplitude,
        energy_density=acoustic_energy_density(amplitude, fluid), mean_energy_density=mean,
    )
    return ParticleForces(
        excitation=excitation, mesh=finer, region=region, particle=particle, fluid=fluid, scattering=scattering,
        potential=potential, force=force,
    )


def force_at(forces: ParticleForces, points: FloatArray) -> FloatArray:
    """Radiation force (K, 2) in N, along r and z, at `points` (K, 2) r, z in m; NaN outside the region."""
    return sample(forces.mesh, forces.force, points, [forces.region])


def find_traps(forces: ParticleForces, *, least_depth: float = 1e-2) -> TrapReport:
    """Minima of the potential, deepest first.

    A minimum shallower than `least_depth` times the span of the potential in the region is left out: it may be no more
    than the mesh showing. Depths are topological: the lowest pass to a deeper minimum, on a raster of
    :data:`RASTER_POINTS` a wavelength. Place, value and stiffness come from a polynomial fitted to the potential
    around, mirrored where that reaches the axis.
    """
    mesh, potential = forces.mesh, forces.potential
    wavelength = forces.fluid.sound_speed / forces.excitation.frequency
    r, z = (_subdivided(lines, wavelength / RASTER_POINTS) for lines in (mesh.grid.r, mesh.grid.z))
    values = raster(mesh, potential, r, z, [forces.region])
    span = float(np.nanmax(values) - np.nanmin(values))
    walls = _walls(np.isfinite(values), on_axis=bool(r[0] < 1e-9 * r[-1]))
    traps = []
    for (i, j), highest in _basins(values):
        if highest - values[i, j] <= least_depth * span:
            continue
        place, value, curvature = _refine(forces, np.array([r[i], z[j]]), wavelength)
        if not np.isfinite(sample(mesh, potential, place[None, :], [forces.region])[0]):
            place, value = np.array([r[i], z[j]]), float(values[i, j])
        # A trap on the axis is on it, not a rounding error beside it.
        radius = 0.0 if place[0] < 1e-9 * r[-1] else float(place[0])
        traps.append(Trap(
            radius=radius, height=float(place[1]), potential=value, depth=highest - value,
            radial_stiffness=float(curvature[0]), axial_stiffness=float(curvature[1]), on_wall=bool(walls[i, j]),
        ))
    return TrapReport(forces=forces, traps=tuple(sorted(traps, key=lambda trap: -trap.depth)))


def axial_focus_time(forces: ParticleForces, *, radius: float, start: float, stop: float, points: int = 2001) -> float:
    """Time (s) from height `start` to `stop` (m) at constant `radius` (m): radiation force and weight against drag.

    Inertia is negligible (a 10 um bead in water forgets its speed in microseconds), so 6 pi eta a dz/dt = F_z - W and
    the time is the integral of dz over the speed; it diverges logarithmically towards the trap itself. Simpson's rule
    over an odd number of `points`.

    Raises:
        ValueError: part of the way lies outside the region, the force stops or turns before `stop`, or an even number
            of points.
    """
    if points < 3 or points % 2 == 0:
        raise ValueError(f"{points} points; expected an odd number of 3 or more")
    height = np.linspace(start, stop, points)
    line = np.stack([np.full(points, radius), height], axis=1)
    net = force_at(forces, line)[:, 1] - net_weight(forces.particle, forces.fluid)
    if not np.isfinite(net).all():
        place = height[~np.isfinite(net)][0]
        raise ValueError(f"z = {place:.6g} m at r = {radius:.6g} m lies outside region {forces.region!r}")
    against = net * (stop - start) <= 0.0
    if against.any():
        raise ValueError(f"the particle does not get from z = {start:.6g} m to {stop:.6g} m: at "
                         f"{height[against][0]:.6g} m the net force is {net[against][0]:.3g} N")
    weights = np.full(points, 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    step = (stop - start) / (points - 1)
    return float(drag_coefficient(forces.particle, forces.fluid) * step / 3.0 * np.sum(weights / net))


def focus_time(report: TrapReport) -> float | None:
    """Time (s) to the deepest trap along the axial line through it, from 90 % to 10 % of a quarter wavelength above it.

    None where there is no trap, or where a particle starting there is not drawn all the way down: a wall is in between,
    or the field is too weak against the particle's weight.
    """
    if not report.traps:
        return None
    trap, forces = report.traps[0], report.forces
    quarter = 0.25 * forces.fluid.sound_speed / forces.excitation.frequency
    try:
        return axial_focus_time(forces, radius=trap.radius, start=trap.height + 0.9 * quarter,
                                stop=trap.height + 0.1 * quarter)
    except ValueError:
        return None


def _subdivided(lines: FloatArray, spacing: float) -> FloatArray:
    """`lines` with equally spaced ones between, no further apart than `spacing`."""
    parts = [np.linspace(low, high, math.ceil((high - low) / spacing), endpoint=False)
             for low, high in pairwise(lines)]
    return np.concatenate([*parts, lines[-1:]])


def _around(values: NDArray[Any], outside: Any) -> NDArray[Any]:
    """The eight neighbours (8, n, m) of every point of a raster (n, m), those beyond its edge `outside`."""
    rows, columns = values.shape
    padded = np.pad(values, 1, constant_values=outside)
    return np.stack([padded[1 + i:1 + i + rows, 1 + j:1 + j + columns] for i, j in _NEIGHBOURS])


def _walls(inside: NDArray[np.bool_], *, on_axis: bool) -> NDArray[np.bool_]:
    """Which points (n, m) of a region on a raster have no neighbour on some side; the field goes on behind the axis."""
    if on_axis:
        return _walls(np.concatenate([inside[1::-1], inside[1:]]), on_axis=False)[1:]
    return inside & ~_around(inside, outside=False).all(axis=0)


def _basins(values: FloatArray) -> list[tuple[tuple[int, int], float]]:
    """Every local minimum of a raster (n, m), NaN outside the region, and how high its basin reaches (J).

    Every point belongs to the minimum to which the steepest way down leads. From the lowest up, the passes between
    basins join them: at a pass the shallower one ends (the persistence of topological data analysis). The deepest never
    ends; it reaches up to the highest potential.
    """
    height = np.where(np.isfinite(values), values, np.inf)
    number = np.arange(height.size).reshape(height.shape)
    beside, numbers = _around(height, np.inf), _around(number, -1)
    steepest = beside.argmin(axis=0)[None]
    lower = np.take_along_axis(beside, steepest, axis=0)[0]
    goal = np.take_along_axis(numbers, steepest, axis=0)[0]
    # Of equal points the one with the smaller number is the lower.
    down = (lower < height) | ((lower == height) & (goal < number))
    basin = np.where(down & np.isfinite(height), goal, number).ravel()
    while True:
        further = basin[basin]
        if (further == basin).all():
            break
        basin = further
    label = basin.reshape(height.shape)
    passes: dict[tuple[int, int], float] = {}
    for other_height, other in zip(beside, numbers, strict=True):
        meet = np.isfinite(height) & np.isfinite(other_height)
        meet[meet] = label[meet] < basin[other[meet]]
        for one, two, at in zip(label[meet].tolist(), basin[other[meet]].tolist(),
                                np.maximum(height, other_height)[meet].tolist(), strict=True):
            passes[one, two] = min(at, passes.get((one, two), math.inf))
    flat = height.ravel()
    minima = [int(each) for each in np.unique(label[np.isfinite(height)])]
    joined = {each: each for each in minima}

    def bottom(each: int) -> int:
        while joined[each] != each:
            each = joined[each]
        return each

    reach = dict.fromkeys(minima, float(flat[np.isfinite(flat)].max()))
    for (one, two), at in sorted(passes.items(), key=lambda item: item[1]):
        deeper, shallower = sorted((bottom(one), bottom(two)), key=lambda each: (flat[each], each))
        if deeper != shallower:
            joined[shallower] = deeper
            reach[shallower] = at
    return [((each // height.shape[1], each % height.shape[1]), high) for each, high in reach.items()]


def _refine(forces: ParticleForces, start: FloatArray, wavelength: float) -> tuple[FloatArray, float, FloatArray]:
    """Place (2,), value and second derivatives (2,) along r and z of the minimum next to `start` (2,).

    Newton's method on a polynomial of :data:`FIT_DEGREE` along r and along z, fitted to the potential within an eighth
    of the `wavelength` of sound on all sides: that is half a period of the potential of a standing wave. The potential
    is even in r, so behind the axis it is as before it.
    """
    reach = wavelength / 8.0
    across = np.linspace(-1.0, 1.0, 2 * FIT_DEGREE + 1)
    local = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2)
    points = start + reach * local
    points[:, 0] = np.abs(points[:, 0])
    values = sample(forces.mesh, forces.potential, points, [forces.region])
    inside = np.isfinite(values)
    local, values = local[inside], values[inside]
    degree = [min(FIT_DEGREE, len(np.unique(local[:, axis])) - 1) for axis in (0, 1)]
    design = legvander2d(local[:, 0], local[:, 1], degree)
    fitted = np.linalg.lstsq(design, values, rcond=None)[0].reshape(degree[0] + 1, degree[1] + 1)

    def derivative(along_r: int, along_z: int, at: FloatArray) -> float:
        polynomial = legder(legder(fitted, along_r, axis=0), along_z, axis=1)
        return float(legval2d(at[0], at[1], polynomial))

    place = np.zeros(2)
    for _ in range(20):
        slope = np.array([derivative(1, 0, place), derivative(0, 1, place)])
        cross = derivative(1, 1, place)
        hessian = np.array([[derivative(2, 0, place), cross], [cross, derivative(0, 2, place)]])
        if np.linalg.eigvalsh(hessian)[0] <= 0.0:
            place = np.zeros(2)
            break
        step = np.linalg.solve(hessian, slope)
        place = place - step
        # A minimum that is not within half the patch belongs to another point, or to a wall.
        if np.abs(place).max() > 0.5:
            place = np.zeros(2)
            break
        if np.abs(step).max() < 1e-12:
            break
    curvature = np.array([derivative(2, 0, place), derivative(0, 2, place)]) / reach**2
    minimum = start + place * reach
    # Rounding may put a minimum on the axis a hair behind it.
    minimum[0] = max(minimum[0], 0.0)
    return minimum, derivative(0, 0, place), curvature
