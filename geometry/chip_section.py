"""The half section of any chip: rectangles if all layers are discs, else the faces that CadQuery draws."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from geometry import revolution
from geometry.chip import Chip
from geometry.free_section import FreeSection
from geometry.measure import Straight
from geometry.names import OUTSIDE, TRANSDUCER
from geometry.parts import Electrodes, Layer
from geometry.section import Section, cut_section, section_of_layers
from geometry.shapes import outlines

if TYPE_CHECKING:
    from cadquery import Face

    from geometry.cad import DrawnLayer


def chip_section(chip: Chip, like: FreeSection | None = None) -> Section | FreeSection:
    """The half section of `chip` with its cavity, filled or not, and without its ports.

    Faces of layers with profiles are cut at the radii of another section, `like`, if given, so that only differing
    lines move.

    Raises:
        InputError: outlines that cannot be made or do not fit each other.
        SolidError: a layer has a profile and CadQuery is not installed.
    """
    if not chip.is_profiled:
        return cut_section(chip)
    return _free_section(chip.layers, chip.electrodes, chip.file, () if like is None else like.cuts)


def outer_boundaries(chip: Chip) -> tuple[str, ...]:
    """Names of the boundaries between the parts of `chip` and its surroundings, which a holder may touch, sorted.

    Raises:
        InputError, SolidError: as in :func:`chip_section`.
    """
    return tuple(name for name in chip_section(chip).boundary_names() if name.endswith(f"|{OUTSIDE}"))


@lru_cache(maxsize=32)
def _free_section(layers: tuple[Layer, ...], electrodes: Electrodes, file: str,
                  cuts: tuple[tuple[str, tuple[float, ...]], ...]) -> FreeSection:
    from geometry.dissection import section_of  # CadQuery takes seconds to import

    stated = section_of_layers(layers, electrodes)
    return section_of(drawn_layers(layers, file), stated.electrodes, stated.rectangles,
                      walls=_walls(layers), source=file, cuts=dict(cuts))


def _walls(layers: tuple[Layer, ...]) -> list[str]:
    """The layers around the cavity."""
    return [layer.region for layer in layers if layer.cavity_radius is not None]


def drawn_layers(layers: tuple[Layer, ...], file: str) -> dict[str, DrawnLayer]:
    """The section of every layer by region, as CadQuery draws it.

    Raises:
        InputError: an outline that cannot be made.
        SolidError: CadQuery is not installed.
    """
    from geometry import cad

    drawn = {}
    for number, layer in enumerate(layers):
        if layer.profile is None:
            lengths = (layer.inner_radius, layer.outer_radius, layer.z_bottom, layer.z_top)
            drawn[layer.region] = cad.DrawnLayer(revolution.rectangle(*(cad.MILLIMETRES * each for each in lengths)))
            continue
        sizes = {"thickness": layer.thickness.value, "radius": layer.outer_radius}
        if layer.cavity_radius is not None:
            sizes["cavity_radius"] = layer.inner_radius
        drawn[layer.region] = cad.profile_face(layer.profile, sizes, layer.z_bottom, source=file,
                                               field=f"layers[{number}].profile",
                                               is_transducer=layer.role == TRANSDUCER)
    return drawn


def section_faces(chip: Chip) -> dict[str, Face]:
    """The faces of the layers of a chip with profiles, and of its cavity, by region (mm).

    Raises:
        InputError: as in :func:`chip_section`.
        SolidError: CadQuery is not installed.
    """
    from geometry.dissection import faces_of

    return faces_of(drawn_layers(chip.layers, chip.file), walls=_walls(chip.layers), source=chip.file)


def volumes(chip: Chip) -> dict[str, float]:
    """Volume of every region in cubic metres, from the outlines of its section; ports are not counted.

    Raises:
        InputError: as in :func:`chip_section`.
        SolidError: a layer has a profile and CadQuery is not installed.
    """
    if chip.is_profiled or isinstance(chip.measure, Straight):
        section = chip_section(chip)
        return {region: section.volume(region) for region in section.regions}
    found: dict[str, float] = {}
    for region, arcs in outlines(chip):
        found[region] = found.get(region, 0.0) + sum(arc.volume for arc in arcs)
    return found
