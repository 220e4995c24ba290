"""From a chip in a state to mesh, terms and values."""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from geometry.chip import Chip, State
from geometry.chip_section import chip_section
from geometry.free_section import FreeSection
from geometry.measure import Straight
from geometry.mesh import SectionMesh
from geometry.names import (
    CAVITY,
    ELECTRODE_GROUND,
    ELECTRODE_IDLE,
    ELECTRODE_LIVE,
    ELECTRODE_REVERSED,
    OUTSIDE,
    TRANSDUCER,
    VACUUM,
    role_of,
)
from geometry.plausible import check_masses
from geometry.section import Section
from geometry.straight import straight_findings
from materials.assumed import lossless_polymer, with_assumed_loss
from materials.kinds import CubicSolid, Fluid, IsotropicSolid, Piezoelectric
from materials.registry import Material, Registry
from materials.use import check_use
from workbench.files.errors import InputError, nearest_names
from workbench.model.discretisation import ACCURACY, Discretisation, discretisation
from workbench.model.job_size import check_size
from workbench.model.particles import STIFF, Particle, breathing_frequency, particle_from
from workbench.model.shaped_mesh import meshed, shaped
from workbench.model.validity import check_validity
from workbench.physics import absorption, boundary_layer, cubic, electrodes, fluid, piezoelectric, solid
from workbench.physics.term import Term
from workbench.results.brief import Brief

#: Kinds of material, as in their files, that a message proposes for a role; for other roles, :data:`SOLIDS`.
KINDS_OF_ROLES: Mapping[str, tuple[str, ...]] = {CAVITY: ("fluid",), TRANSDUCER: ("piezoelectric",)}
SOLIDS = ("isotropic solid", "cubic solid", "piezoelectric")


class LeftOutWarning(UserWarning):
    """A part of a solid is not axisymmetric and left out."""


@dataclass(frozen=True, eq=False, repr=False)
class Problem(Brief):
    """All input of a predicted spectrum: mesh, terms, parameter values by name.

    ``materials`` has the material of each region (none for a vacuum); ``values`` the complex parameters
    ``<material>.<property>`` in SI, e^{-i w t}; ``band`` (Hz) is that of the mesh, with its ``discretisation`` (None
    for a mesh of the caller).
    """

    mesh: SectionMesh
    terms: tuple[Term, ...]
    values: Mapping[str, complex]
    band: tuple[float, float]
    materials: Mapping[str, Material]
    name: str = ""
    discretisation: Discretisation | None = None

    def with_values(self, values: Mapping[str, complex]) -> Problem:
        """A copy with other parameter values.

        Raises:
            KeyError: a name the problem does not have.
        """
        unknown = sorted(set(values) - set(self.values))
        if unknown:
            raise KeyError(f"unknown parameters {', '.join(unknown)}; known: {', '.join(sorted(self.values))}")
        return replace(self, values={**self.values, **values})

    def following(self, like: Problem) -> Problem:
        """The problem with the mesh and terms of `like`. That one has lengths as parameters."""
        return replace(self, mesh=like.mesh, terms=like.terms, values={**like.values, **self.values})

    def with_terms(self, terms: tuple[Term, ...], values: Mapping[str, complex]) -> Problem:
        """A copy with more terms and values of their parameters.

        Raises:
            ValueError: a term or a value that the problem already has (:meth:`with_values` changes values).
            KeyError: a parameter of the terms without a value, or a value that none of them needs.
        """
        for term in terms:
            if term in self.terms or terms.count(term) > 1:
                raise ValueError(f"the model has the term {term!r} already")
        known = sorted(set(values) & set(self.values))
        if known:
            raise ValueError(f"the problem has values of {', '.join(known)} already; change them by `with_values`")
        needed = {name for term in terms for i in term.integrals() for name in i.coefficient.parameters}
        lacking = sorted(needed - set(values) - set(self.values))
        if lacking:
            raise KeyError(f"no value of {', '.join(lacking)}, which the terms {', '.join(map(repr, terms))} need")
        unused = sorted(set(values) - needed)
        if unused:
            raise KeyError(f"none of the added terms has the parameters {', '.join(unused)}; "
                           f"theirs: {', '.join(sorted(needed))}")
        return replace(self, terms=(*self.terms, *terms), values={**self.values, **values})


def with_boundary_layers(problem: Problem) -> Problem:
    """A copy of `problem` with boundary layers in its cavities. Layers are viscous if the viscosity is known, and
    thermal too if the thermal constants are."""
    terms: list[Term] = []
    for contact in problem.terms:
        if not isinstance(contact, fluid.SolidFluidContact) or role_of(contact.fluid) != CAVITY:
            continue
        there = problem.materials[contact.fluid]
        assert isinstance(there, Fluid)
        terms += boundary_layers(contact.boundary, contact.solid, contact.fluid, there)
    return problem.with_terms(tuple(terms), {})


def boundary_layers(boundary: str, solid: str, region: str, material: Fluid) -> tuple[Term, ...]:
    """The boundary layers of a fluid on one solid wall. They follow from its known constants."""
    where = (boundary, solid, region, material.name)
    if material.shear_viscosity is None:
        return ()
    viscous = boundary_layer.ViscousBoundaryLayer(*where)
    if None in (material.heat_capacity_ratio, material.thermal_conductivity, material.heat_capacity):
        return (viscous,)
    return viscous, boundary_layer.ThermalBoundaryLayer(*where)


def terms_of(region: str, material: Material, *, poled_down: bool = False) -> tuple[Term, ...]:
    """The terms of the base model of a material in a region."""
    match material:
        case Piezoelectric():
            return (piezoelectric.PiezoelectricSolid(region, material.name, poled_down),)
        case IsotropicSolid():
            return (solid.ElasticSolid(region, material.name),)
        case CubicSolid():
            return (cubic.CubicCrystal(region, material.name, material.channel == "<110>"),)
        case Fluid():
            whole = fluid.AcousticFluid(region, material.name)
            absorbs = material.diffusivity_of_sound is not None
            return (whole, absorption.BulkAbsorption(region, material.name)) if absorbs else (whole,)
    return ()


@dataclass(frozen=True, eq=False, repr=False)
class FilledChip(Brief):
    """A chip in one of its states, with its materials.

    ``materials`` has the material of each region (none for a vacuum). ``particle`` is that of the state, if any;
    ``findings`` are assumptions about the materials; ``inviscid`` removes the boundary layers in the cavity.
    """

    chip: Chip
    state: State
    materials: Mapping[str, Material]
    particle: Particle | None = None
    findings: tuple[str, ...] = ()
    inviscid: bool = False

    @property
    def name(self) -> str:
        """Chip and state, for messages."""
        return f"{self.chip.name}, {self.state.name}"

    @property
    def is_wet(self) -> bool:
        """Whether the cavity contains a liquid."""
        fluid = self.materials.get(CAVITY)
        return isinstance(fluid, Fluid) and not fluid.is_gas

    def check_validity(self, band: tuple[float, float]) -> tuple[str, ...]:
        """Findings on limits of the formulas in a `band` (Hz).

        See `workbench.model.validity.check_validity`.

        Raises:
            InputError: the state is beyond them in all of the band.
        """
        liquid = self.materials.get(CAVITY)
        return () if not isinstance(liquid, Fluid) else check_validity(
            self.chip, self.state.name, liquid, self.particle, band, layers=not self.inviscid)

    @cached_property
    def section(self) -> Section | FreeSection:
        """The half section of the chip."""
        return chip_section(self.chip)


def registry_of(chip: Chip, registry: Registry | None = None) -> Registry:
    """The `registry`, by default the package's, with the chip's folders."""
    found = Registry() if registry is None else registry
    return found.with_folders(chip.material_folders)


def fill(chip: Chip, state: str | None = None, registry: Registry | None = None) -> FilledChip:
    """The chip in a state with its materials.

    The default state is the last one of its file; the default registry is the package's with the chip's folders. A
    density in the chip file replaces the material's own. The state's temperature is that of the material in the cavity.
    A lossless ceramic has an assumed loss if the registry has ``assumed_losses``; a finding names a lossless polymer.

    Raises:
        InputError: unknown state or material, a transducer that is not piezoelectric, one material with two densities,
            a solid layer without a shear modulus, a particle that is not a sphere of a small compressible solid or
            fluid, a feature about as heavy as its layer, or a state beyond the limits of the formulas in its band
            (`workbench.model.validity`).
    """
    chosen, registry = chip.state(state), registry_of(chip, registry)
    found: dict[str, Material] = {}
    findings = list(straight_findings(chip.measure, chip.electrodes))
    for region, name in chip.materials(chosen.name).items():
        if name == VACUUM:
            continue
        material = _load(chip, chosen, region, name, registry, findings)
        density = None if role_of(region) == CAVITY else chip.layer(region).density
        if density is not None:
            material = replace(material, density=density)
        _check_kind(chip, region, name, material)
        if registry.assumed_losses:
            material, assumed = with_assumed_loss(material)
            findings.append(assumed)
        findings.append(lossless_polymer(material))
        if isinstance(material, Piezoelectric) and role_of(region) != TRANSDUCER:
            findings.append(f"{region} of {material.name} is a passive layer: its whole surface is an electrode at "
                            "ground, so that it is short-circuited")
        for other, known in found.items():
            if known.name == material.name and known != material:
                raise InputError(chip.file, f"density of {region}", material.density,
                                 f"the {known.density:g} kg/m^3 of the same material {known.name!r} in {other}")
        found[region] = material
    particle = _particle(chip, chosen, found.get(CAVITY), registry, findings)
    for region, material in found.items():
        if role_of(region) == CAVITY and isinstance(material, Fluid):
            findings += [_without_layers(region, material, registry), absorption_known(region, material, chip.band)]
    device = FilledChip(chip, chosen, found, particle, inviscid=registry.inviscid)
    findings += device.check_validity(chip.band)
    _check_passive_layers(device)
    if chip.features:
        check_masses(chip.features, {region: material.density * device.section.volume(region)
                                     for region, material in found.items()}, chip.unusual, chip.file)
    return replace(device, findings=tuple(dict.fromkeys(filter(None, findings))))


def _without_layers(region: str, fluid: Fluid, registry: Registry) -> str:
    """The finding that a fluid has no boundary layers, or ""."""
    if registry.inviscid:
        return f"the boundary layers of {fluid.name} in the {region} are left out, as requested"
    if fluid.shear_viscosity is None:
        return f"the boundary layers of {fluid.name} in the {region} are left out: its shear_viscosity is not stated"
    return ""


def absorption_known(region: str, fluid: Fluid, band: tuple[float, float]) -> str:
    """The finding that a fluid absorbs more than modelled, or "". The quality factor of its loss is that in the middle
    of the `band` (Hz)."""
    diffusivity, frequency = fluid.diffusivity_of_sound, 0.5 * sum(band)
    if diffusivity is None:
        return (f"{fluid.name} in the {region} does not absorb sound in its bulk: neither its viscosities nor its "
                "absorption are stated")
    if not fluid.absorbs_more:
        return ""
    quality = fluid.sound_speed**2 / (2.0 * math.pi * frequency * diffusivity)
    heat = " and heat conduction" if fluid.heat_capacity_ratio is not None else ""
    return (f"the absorption of sound in {fluid.name} in the {region} is a lower bound: its bulk_viscosity is not "
            f"stated. Its shear viscosity{heat} alone give {diffusivity:.2g} m^2/s, a quality factor of "
            f"{float(f'{quality:.2g}'):.0f} at {frequency / 1e6:.3g} MHz")


def _check_kind(chip: Chip, region: str, name: str, material: Material) -> None:
    """Raise if the region cannot have a material of this kind."""
    if role_of(region) == TRANSDUCER and not isinstance(material, Piezoelectric):
        raise InputError(chip.file, f"material of {region}", name,
                         f"a piezoelectric material; this is {_kind(material)}")
    if role_of(region) == CAVITY and isinstance(material, Piezoelectric):
        raise InputError(chip.file, f"material of {region}", name, f"a solid or a fluid; this is {_kind(material)}")
    if role_of(region) == CAVITY and region != CAVITY and not isinstance(material, Fluid):
        raise InputError(chip.file, f"filling of {region}", name, f"a liquid or a gas; this is {_kind(material)}")
    if isinstance(material, CubicSolid) and not isinstance(chip.measure, Straight):
        raise InputError(chip.file, f"material of {region}", name, "no single crystal in a round chip, whose section "
                         "turns about an axis: an isotropic average, such as silicon/hill_average")
    if isinstance(material, IsotropicSolid) and not complex(material.shear_modulus).real > 0.0:
        raise InputError(chip.file, f"material of {region}", name, "a solid with a shear modulus; a material without "
                         'one is an entry of kind = "fluid"')


def _kind(material: Material) -> str:
    match material:
        case Piezoelectric():
            return "a piezoelectric one"
        case IsotropicSolid():
            return "an isotropic solid"
        case CubicSolid():
            return "a single crystal"
        case Fluid():
            return "a fluid"
    return f"a {type(material).__name__}"


def _check_passive_layers(device: FilledChip) -> None:
    """Raise if a passive piezoelectric layer touches the live electrode."""
    passive = [region for region, material in device.materials.items()
               if role_of(region) != TRANSDUCER and isinstance(material, Piezoelectric)]
    if not passive:
        return
    pieces = [each for each in device.section.electrodes if each.name == ELECTRODE_LIVE]
    touching = {each.region for each in device.section.rectangles for live in pieces if each.r_inner < live.r_outer
                and each.r_outer > live.r_inner and live.z in (each.z_bottom, each.z_top)}
    for region in passive:
        if region in touching:
            raise InputError(device.chip.file, f"material of {region}", device.materials[region].name,
                             "a layer that is not on the live electrode, which would drive it: turn the transducer "
                             "over by electrodes.live, or put a bond between them")


def _particle(
    chip: Chip, state: State, fluid: Material | None, registry: Registry, findings: list[str]
) -> Particle | None:
    """The particle of a state, if any, checked against its fluid.

    Raises:
        InputError: an unsuitable material, a cavity without fluid, a fluid without viscosity, or a particle that
            resonates in the band.
    """
    if state.particle is None or state.particle_radius is None:
        return None
    where = f"states.{state.name}.particle"
    if not isinstance(fluid, Fluid):
        raise InputError(chip.file, where, state.particle, "no particle without a fluid to carry it; the cavity "
                         f"contains {'nothing' if fluid is None else _kind(fluid)}")
    try:
        material = registry.load(state.particle, notes=findings)
        if material.temperature is not None and state.temperature is not None:
            material = registry.load(state.particle, temperature=state.temperature, notes=findings)
    except InputError as error:
        if error.source == "materials" and error.field == "name":
            raise InputError(chip.file, where, state.particle, error.expected, error.nearest) from error
        raise
    if not isinstance(material, IsotropicSolid | Fluid):
        raise InputError(chip.file, where, state.particle, "an isotropic solid (a bead), a fluid (a droplet), or an "
                         f"entry with density and compressibility (a cell); this is {_kind(material)}")
    if fluid.shear_viscosity is None:
        raise InputError(chip.file, where, state.particle, f"no particle, or a shear_viscosity in the entry of "
                         f"{fluid.name}: drag and motion of a particle depend on it")
    made = particle_from(material, state.particle_radius)
    resonance, highest = breathing_frequency(made, fluid), chip.band[1]
    if isinstance(material, Fluid) and highest > STIFF * resonance:
        raise InputError(chip.file, where, state.particle, "a droplet or cell whose resonance is far above the band: "
                         f"one of {2e6 * made.radius:.3g} um resonates at {resonance / 1e6:.3g} MHz, like a bubble, "
                         f"and the band reaches {highest / 1e6:.3g} MHz. Gor'kov's formula holds below {STIFF:g} of it")
    return made


def _load(
    chip: Chip, state: State, region: str, name: str, registry: Registry, findings: list[str]
) -> Material:
    """The material; errors of its name or temperature name the chip file."""
    temperature = state.temperature if role_of(region) == CAVITY else None
    try:
        return registry.load(name, temperature=temperature, notes=findings)
    except InputError as error:
        if error.source == "materials" and error.field == "name":
            known = registry.names_of_kind(KINDS_OF_ROLES.get(role_of(region), SOLIDS))
            near = tuple(each for each in error.nearest if each in known) or nearest_names(name, sorted(known))
            raise InputError(chip.file, f"material of {region}", name, error.expected, near) from error
        if temperature is not None and "temperature" in error.field:
            material = registry.load(name, notes=[])
            if not isinstance(material, Fluid):
                raise InputError(chip.file, f"states.{state.name}.cavity", name, "a liquid or a gas in a state with a "
                                 f"temperature; this is {_kind(material)}") from error
            field = f"states.{state.name}.temperature"
            raise InputError(chip.file, field, error.value, f"{error.expected}, by {name}") from error
        raise


def base_model(
    mesh: SectionMesh, materials: Mapping[str, Material], poled_down: Collection[str] = (), share: float = 1.0
) -> tuple[Term, ...]:
    """The terms of the base model: solids, fluids, contacts, free edges, electrodes.

    The bulk absorption of a fluid follows from its known viscosities; a fluid without any is lossless. A piezoelectric
    layer that is not a transducer is short-circuited (`electrodes.ShortCircuit`). Regions `poled_down` are poled
    against z. A live electrode has the `share` of the drive's voltage against ground. Regions absent from `materials`
    are empty; their walls are traction-free.
    """
    terms: list[Term] = []
    for region, material in materials.items():
        terms += terms_of(region, material, poled_down=region in poled_down)
    for boundary in mesh.section.boundary_names():
        sides = boundary.split("|")
        if len(sides) == 2:
            fluids = [side for side in sides if isinstance(materials.get(side), Fluid)]
            empty = [side for side in sides if side == OUTSIDE or side not in materials]
            if len(fluids) == 1 and empty:
                terms.append(fluid.PressureRelease(boundary))
            elif len(fluids) == 1:
                (other,) = (side for side in sides if side != fluids[0])
                terms.append(fluid.SolidFluidContact(boundary, other, fluids[0]))
    passive = [region for region, material in materials.items()
               if role_of(region) != TRANSDUCER and isinstance(material, Piezoelectric)]
    terms += [electrodes.ShortCircuit(boundary) for boundary in mesh.section.boundary_names()
              if set(boundary.split("|")) & set(passive)]
    parts = set(mesh.section.boundary_names())
    turned, idle = (name if name in parts else None for name in (ELECTRODE_REVERSED, ELECTRODE_IDLE))
    terms.append(electrodes.ElectrodePotential(ELECTRODE_LIVE, ELECTRODE_GROUND) if (share, turned, idle) == (
        1.0, None, None) else electrodes.SplitElectrode(ELECTRODE_LIVE, ELECTRODE_GROUND, turned, idle, share))
    return tuple(terms)


def build(
    device: FilledChip,
    *,
    band: tuple[float, float] | None = None,
    accuracy: float | Discretisation = ACCURACY,
    skins: Mapping[str, float] | None = None,
    radii: Sequence[float] = (),
    levels: Sequence[float] = (),
    with_features: bool = False,
) -> Problem:
    """The problem of a `device`, meshed for `band` (Hz). The default is the chip's band.

    It is that of the round chip. A warning says that features and a taper of the chip file are left out, unless the
    caller adds them (`with_features`). Boundary layers of the cavity's fluid are part of it, unless the device is
    `inviscid`. `accuracy` is the relative accuracy of Z, or a discretisation; `skins`, `radii` and `levels` are as in
    `geometry.mesh_size.MeshSize`.

    Raises:
        InputError: see `workbench.model.discretisation.discretisation`; or the model is too large for the memory
            (`workbench.model.job_size`).
        MeshError: the mesh cannot be made.
    """
    fineness = discretisation(accuracy)
    low, high = device.chip.band if band is None else band
    check_use(device.materials.values(), band=(low, high))
    check_size(device.section, device.materials, fineness, (low, high), source=device.chip.file, skins=skins,
               radii=radii, levels=levels)
    size = fineness.mesh_size(device.section, device.materials, high, skins=skins, radii=radii,
                              levels=levels)
    if device.chip.not_round and not with_features:
        listed = "; ".join(device.chip.not_round)
        warnings.warn(LeftOutWarning(f"{device.chip.file}: left out ({listed}): only the spectra of `simulate` and "
                                     "`compare` have features and tapers"), stacklevel=2)
    for note in device.section.notes if isinstance(device.section, FreeSection) else ():
        warnings.warn(LeftOutWarning(f"{device.chip.file}: left out of {note}"), stacklevel=2)
    mesh = shaped(meshed(device.section, size), device.chip)
    turned = [layer.region for layer in device.chip.layers if layer.poled == "down"]
    made = replace(problem(mesh, device.materials, (low, high), name=device.name, poled_down=turned,
                           share=device.chip.electrodes.share), discretisation=fineness)
    return made if device.inviscid else with_boundary_layers(made)


def problem(
    mesh: SectionMesh, materials: Mapping[str, Material], band: tuple[float, float], *, name: str = "",
    poled_down: Collection[str] = (), share: float = 1.0,
) -> Problem:
    """The base model on a given mesh, from :func:`base_model`."""
    values = {name: value for material in materials.values() for name, value in material_values(material).items()}
    return Problem(mesh, base_model(mesh, materials, poled_down, share), values, band, dict(materials), name)


def material_values(material: Material) -> dict[str, complex]:
    """The parameters of a material by their names in a problem, ``<material>.<property>``."""
    values = {f"{material.name}.{key}": value for key, value in material.parameters().items()}
    if isinstance(material, Fluid) and material.diffusivity_of_sound is not None:
        values[f"{material.name}.diffusivity_of_sound"] = complex(material.diffusivity_of_sound)
    return values
