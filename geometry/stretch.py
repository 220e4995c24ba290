"""The same mesh on another section: nodes move with the breaks of r and z, cells and names stay.

Between two breaks the map is linear, in r and in z apart, so a straight-sided quadrilateral stays one, and a
dimension of the chip becomes a parameter like a modulus: no remeshing, and nodes that move in proportion to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.chip import SAME_LENGTH, Chip
from geometry.mesh import MeshError, SectionMesh
from geometry.names import LEVEL, part
from geometry.section import Section, cut_section


def stretch(mesh: SectionMesh, target: Chip | Section) -> SectionMesh:
    """`mesh` moved onto `target`, which must have the same regions between the same breaks in the same order.

    The elements grow and shrink with their layers: :func:`geometry.mesh.elements_per_wavelength` tells when the mesh
    has become too coarse.

    Raises:
        MeshError: a break appeared, vanished or changed places, or a region lies between other breaks.
    """
    section = target if isinstance(target, Section) else cut_section(target)
    _require_same_topology(mesh.section, section)
    r, z = mesh.mesh.p
    moved = np.stack(
        [
            np.interp(r, mesh.section.r_breaks, section.r_breaks),
            np.interp(z, mesh.section.z_breaks, section.z_breaks),
        ]
    )
    return replace(mesh, mesh=replace(mesh.mesh, doflocs=moved), section=section)


def between(chip: Chip, name: str) -> tuple[float, float]:
    """The lengths (m) on both sides of a dimension of `chip` that no :func:`stretch` takes it past.

    For a radius those of the next breaks of the section; else, and where there is none, zero and infinity. All radii
    of the same length are taken to change together.

    Raises:
        KeyError: the chip has no dimension of that name.
    """
    value = chip.dimensions()[name].value
    breaks = cut_section(chip).r_breaks if name.endswith("radius") else (0.0,)
    return (max(b for b in breaks if b < value - SAME_LENGTH),
            min((b for b in breaks if b > value + SAME_LENGTH), default=math.inf))


def velocity(mesh: SectionMesh, chip: Chip, name: str, *together: str) -> NDArray[np.float64]:
    """How the nodes of `mesh` move with a dimension of `chip`: d(r, z)/d(dimension), without unit.

    Lengths that coincide (the radius of the transducer and of its couplant, say) can only be changed `together`; the
    derivative is then that with respect to all of them growing by the same amount. It is constant as long as the
    topology holds, so ``mesh.p + step * velocity`` is :func:`stretch` to the dimension longer by `step`.

    Returns:
        (2, number of nodes) array.

    Raises:
        InputError: the chip has no dimension of that name.
        MeshError: `mesh` is not of this chip, or the dimension cannot be changed without changing the topology.
    """
    if cut_section(chip) != mesh.section:
        raise MeshError(
            f"the mesh is not of chip {chip.name!r} with its present dimensions; stretch it onto the chip first"
        )
    known = chip.dimensions()
    # Ten times the distance at which breaks are told apart: enough to part breaks that coincide by chance only.
    step = 10.0 * SAME_LENGTH
    longer = {each: known[each].value + step if each in known else step for each in (name, *together)}
    section = cut_section(chip.with_dimensions(longer))
    _require_same_topology(mesh.section, section)

    def rates(old: Sequence[float], new: Sequence[float]) -> NDArray[np.float64]:
        # Every break is a sum of dimensions, each taken once: its derivative is a whole number, known exactly.
        whole: NDArray[np.float64] = np.rint((np.array(new) - np.array(old)) / step)
        return whole

    before, (r, z) = mesh.section, mesh.mesh.p
    return np.stack(
        [
            np.interp(r, before.r_breaks, rates(before.r_breaks, section.r_breaks)),
            np.interp(z, before.z_breaks, rates(before.z_breaks, section.z_breaks)),
        ]
    )


def split_by_layers(mesh: SectionMesh, chip: Chip) -> SectionMesh:
    """The same mesh that also names the parts of every region and boundary within the layers of the stack.

    A region that spans several layers (a cavity through two) has a part for each; of a boundary, the facets along z
    belong to the layer they stand in and all others to :data:`geometry.names.LEVEL`.

    Raises:
        MeshError: `mesh` is not of this chip.
    """
    if cut_section(chip) != mesh.section:
        raise MeshError(f"the mesh is not of chip {chip.name!r} with its present dimensions")
    levels = np.array([layer.z_bottom for layer in chip.layers[1:]])
    names = [layer.region for layer in chip.layers]
    z = mesh.mesh.p[1]
    of_cell = np.searchsorted(levels, z[mesh.mesh.t].mean(axis=0))
    ends = z[mesh.mesh.facets]
    of_facet = np.where(ends[0] == ends[1], -1, np.searchsorted(levels, ends.mean(axis=0)))
    regions, boundaries = dict(mesh.mesh.subdomains), dict(mesh.mesh.boundaries)
    for places, layers in ((regions, of_cell), (boundaries, of_facet)):
        for place, indices in list(places.items()):
            for layer in np.unique(layers[indices]):
                name = part(place, LEVEL if layer < 0 else names[layer])
                places[name] = np.asarray(indices)[layers[indices] == layer]
    return replace(mesh, mesh=mesh.mesh.with_subdomains(regions).with_boundaries(boundaries))


def _require_same_topology(old: Section, new: Section) -> None:
    for axis, before, after in (("r", old.r_breaks, new.r_breaks), ("z", old.z_breaks, new.z_breaks)):
        if len(before) != len(after):
            raise MeshError(
                f"the stretch would change {len(before)} breaks in {axis} into {len(after)}; "
                "lengths that coincide must change together, otherwise mesh the new section"
            )
    if (
        old.regions != new.regions
        or (old.grid() != new.grid()).any()
        or _electrode_breaks(old) != _electrode_breaks(new)
    ):
        raise MeshError("a region or electrode of the new section lies between other breaks; mesh the new section")


def _electrode_breaks(section: Section) -> list[tuple[str, int, int, int]]:
    r, z = section.r_breaks.index, section.z_breaks.index
    return [(e.name, r(e.r_inner), r(e.r_outer), z(e.z)) for e in section.electrodes]
