"""The section of any chip: rectangles, or faces drawn by CadQuery."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from geometry import revolution
from geometry.chip import Chip
from geometry.free_section import FreeSection
from geometry.kernel import MILLIMETRES
from geometry.measure import ABOUT_AXIS, Measure
from geometry.names import CAVITY, OUTSIDE, TRANSDUCER
from geometry.parts import Electrodes, Layer
from geometry.profile import names_of_layer, step_profiles
from geometry.section import Section, cut_section, section_of_layers
from geometry.shapes import outlines

if TYPE_CHECKING:
    from cadquery import Shape

    from geometry.cad import DrawnLayer


def chip_section(chip: Chip, like: FreeSection | None = None) -> Section | FreeSection:
    """The half section of a chip with its cavity and without ports.

    Faces of layers with profiles are cut at the radii of the section `like`, if given, so that both have the same
    faces.

    Raises:
        InputError: outlines are invalid or do not fit each other.
        SolidError: a layer has a profile and CadQuery is not installed.
    """
    if not chip.is_profiled:
        return cut_section(chip)
    return _free_section(chip.layers, chip.electrodes, chip.file, () if like is None else like.cuts, chip.measure)


def outer_boundaries(chip: Chip) -> tuple[str, ...]:
    """Sorted names of the boundaries between parts and surroundings. A holder may touch them.

    Raises:
        InputError, SolidError: as in :func:`chip_section`.
    """
    return tuple(name for name in chip_section(chip).boundary_names() if name.endswith(f"|{OUTSIDE}"))


@lru_cache(maxsize=32)
def _free_section(layers: tuple[Layer, ...], electrodes: Electrodes, file: str,
                  cuts: tuple[tuple[str, tuple[float, ...]], ...], measure: Measure) -> FreeSection:
    from geometry.dissection import section_of  # CadQuery takes seconds to import

    stated = section_of_layers(layers, electrodes, measure)
    return section_of(drawn_layers(layers, file, measure), stated.electrodes, stated.rectangles,
                      walls=_walls(layers), source=file, cuts=dict(cuts), measure=measure)


def _walls(layers: tuple[Layer, ...]) -> list[str]:
    """Names of the layers around the cavity."""
    return [layer.region for layer in layers if layer.cavity_radius is not None]


def drawn_layers(layers: tuple[Layer, ...], file: str, measure: Measure = ABOUT_AXIS) -> dict[str, DrawnLayer]:
    """The CadQuery section of every layer by region.

    A section extends from the axis, or over both sides if the `measure` shows both.

    Raises:
        InputError: an outline is invalid.
        SolidError: CadQuery is not installed.
    """
    from geometry import cad

    drawn, steps = {}, step_profiles(layer.profile for layer in layers)
    for number, layer in enumerate(layers):
        if layer.profile is None:
            lengths = (layer.inner_radius, layer.outer_radius, layer.z_bottom, layer.z_top)
            drawn[layer.region] = cad.DrawnLayer(revolution.rectangle(*(MILLIMETRES * each for each in lengths)))
            continue
        thickness, across, hole = names_of_layer(measure)
        sizes = {thickness: layer.thickness.value, across: layer.outer_radius}
        if layer.cavity_radius is not None:
            sizes[hole] = layer.inner_radius
        drawn[layer.region] = cad.profile_face(layer.profile, sizes, layer.z_bottom, source=file,
                                               field=f"layers[{number}].profile", measure=measure,
                                               is_transducer=layer.role == TRANSDUCER, steps=steps)
    if measure.is_whole:
        return {layer.region: cad.mirrored(drawn[layer.region], layer.offset) for layer in layers}
    return drawn


def section_faces(chip: Chip) -> dict[str, Shape]:
    """The faces (mm) of a profiled chip's layers and cavity, by region.

    Raises:
        InputError: as in :func:`chip_section`.
        SolidError: CadQuery is not installed.
    """
    from geometry.dissection import faces_of

    return faces_of(drawn_layers(chip.layers, chip.file, chip.measure), walls=_walls(chip.layers), source=chip.file,
                    measure=chip.measure)


def volumes(chip: Chip) -> dict[str, float]:
    """Volume (m^3) of every region, without ports, from its outlines.

    Raises:
        InputError: as in :func:`chip_section`.
        SolidError: a layer has a profile and CadQuery is not installed.
    """
    if chip.is_profiled:
        section = chip_section(chip)
        return {region: section.volume(region) for region in section.regions}
    found: dict[str, float] = {}
    for region, arcs in outlines(chip):
        area, moment = sum(arc.area for arc in arcs), sum(arc.moment for arc in arcs)
        found[region] = found.get(region, 0.0) + chip.measure.body(area, moment)
    return found


def region_volumes(chip: Chip) -> dict[str, float]:
    """Volume (m^3) of every region, in closed form for rectangular sections. The closed form is a thousand times as
    fast as :func:`volumes`."""
    if any(layer.profile is not None or layer.shapes for layer in chip.layers):
        return volumes(chip)
    volume = chip.measure.device_volume
    found = {layer.region: volume(layer.channels * layer.inner_radius, layer.outer_radius, layer.thickness.value)
             for layer in chip.layers}
    for region, around in chip.further_cavities.items():
        found[region] = sum(volume(0.0, hole.inner_radius, hole.thickness.value) for hole in around)
    if chip.holes:
        found[CAVITY] = sum(volume(0.0, hole.channels * hole.inner_radius, hole.thickness.value) for hole in chip.holes)
    return found
