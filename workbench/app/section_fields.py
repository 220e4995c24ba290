"""The fields of a changed chip, by a reduced model.

A state of the reduced model is on its own mesh. Changed lengths move its nodes: between two breaks of the section the
map is linear, along r and along z (`geometry.stretch`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from geometry.names import CAVITY
from geometry.section import cut_section
from geometry.stretch import canonical_names
from materials.kinds import Fluid, IsotropicSolid, Material
from materials.registry import Registry
from workbench.acoustics.fields import Fields, fields
from workbench.acoustics.forces import particle_forces
from workbench.acoustics.traps import TrapReport, find_traps
from workbench.model.drive import Drive
from workbench.model.numbers import ParameterName, placed
from workbench.model.particles import Particle, particle_from
from workbench.model.shaped_mesh import shaped
from workbench.reduced.ranges import RangeModel

#: The default particle of the potential: a material, and its radius (m).
BEAD = ("polystyrene", 5e-6)


@dataclass(frozen=True, eq=False)
class SectionFields:
    """The fields of a chip with these ``values`` (SI, by name). ``traps`` is None without a fluid in the cavity, or
    without a particle."""

    values: Mapping[str, float]
    fields: Fields
    traps: TrapReport | None


def section_fields(
    chip: Chip, model: RangeModel, values: Mapping[str, float], frequency: float, drive: Drive,
    particle: Particle | None,
) -> SectionFields:
    """The fields at one `frequency` (Hz) under `drive`, with `values` (SI). `chip` is that of the `model`."""
    numbers = placed(model.problem.values, values)
    compact = model.compact
    solution = compact.solve(np.array([frequency]), numbers)
    full = model.reduced.full
    mesh = moved_mesh(full.mesh, chip, moved_chip(chip, values))
    problem = replace(model.problem, values=numbers)
    found = fields(problem, replace(full, mesh=mesh), replace(solution, states=compact.expand(solution)), drive)
    fluid = model.problem.materials.get(CAVITY)
    if not isinstance(fluid, Fluid) or particle is None:
        return SectionFields(values, found, None)
    present = with_numbers(fluid, values)
    assert isinstance(present, Fluid)
    return SectionFields(values, found, find_traps(particle_forces(found, particle, fluid=present, region=CAVITY)))


def usual_bead(registry: Registry) -> Particle:
    """The default particle."""
    material = registry.load(BEAD[0])
    assert isinstance(material, IsotropicSolid)
    return particle_from(material, BEAD[1])


def moved_chip(chip: Chip, values: Mapping[str, float]) -> Chip:
    """A copy of `chip` with the lengths among `values` (SI). Coinciding radii move together, under their canonical
    name. An unchanged length keeps its tolerance and its note."""
    first = canonical_names(chip)
    return chip.with_dimensions({
        name: values[first.get(name, name)] for name in chip.dimensions() if first.get(name, name) in values})


def moved_mesh(mesh: SectionMesh, chip: Chip, moved: Chip) -> SectionMesh:
    """The `mesh` of `chip` with its nodes moved to `moved`.

    Raises:
        MeshError: the breaks of the two do not correspond.
    """
    old, new = cut_section(chip), cut_section(moved)
    r, z = mesh.mesh.p
    places = np.stack([np.interp(r, old.r_breaks, new.r_breaks), np.interp(z, old.z_breaks, new.z_breaks)])
    straight = replace(mesh, mesh=replace(mesh.mesh, doflocs=places), section=new, coordinates=None, variants={})
    return shaped(straight, moved)


def with_numbers(material: Material, values: Mapping[str, float]) -> Material:
    """A copy of `material` with its constants among `values` (SI)."""
    parameters = material.parameters()
    own = {name: number for name, number in values.items() if ParameterName.parse(name).owner == material.name}
    named = placed({f"{material.name}.{key}": number for key, number in parameters.items()}, own)
    changed: dict[str, complex] = {}
    for key, before in parameters.items():
        after = named[f"{material.name}.{key}"]
        if after != before:
            changed[key] = after if isinstance(getattr(material, key), complex) else after.real
    return replace(material, **changed)  # type: ignore[arg-type]
