"""The parts of a chip as solids, in millimetres.

Every solid has explicit coordinates: discs about the z axis, or blocks along y with their middle at y = 0, minus cavity
and ports. Heights are the chip's own.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING

from geometry import revolution
from geometry.chip import Chip
from geometry.chip_section import section_faces, volumes
from geometry.kernel import MILLIMETRES, SolidError, cadquery_module
from geometry.measure import Measure, Straight
from geometry.names import CAVITY
from geometry.parts import Layer
from geometry.shapes import outlines

if TYPE_CHECKING:
    from cadquery import Compound, Face, Shape, Solid

#: Largest relative difference between the volumes of a solid and of the chip's dimensions. The kernel integrates
#: cylinders exactly; it describes the edge of a channel in a round wall by a spline, an error of 1e-8 of the channel.
ROUND_TOLERANCE = 1e-9


#: Tolerance for shaped layers: the kernel integrates their surfaces numerically, to 1e-9 in trials.
SHAPED_TOLERANCE = 1e-7


def parts(chip: Chip) -> dict[str, tuple[Layer, ...]]:
    """The layers of each one-piece part, by its lowest region. A substrate and a sidewall of one material are one
    piece: the printed part in Fig. 3 of Acevedo-Espinosa et al. (RP-UEIS). Every other layer is a separate part."""
    printed = ("substrate", "sidewall")
    pieces: list[tuple[Layer, ...]] = []
    for layer in chip.layers:
        below = pieces[-1][-1] if pieces else None
        if below is not None and {below.role, layer.role} <= set(printed) and below.material == layer.material:
            pieces[-1] = (*pieces[-1], layer)
        else:
            pieces.append((layer,))
    return {piece[0].region: piece for piece in pieces}


def part_volumes(chip: Chip) -> dict[str, float]:
    """Volume (m^3) of every part without ports, from the chip's dimensions."""
    found = volumes(chip)
    drilled = chip.port_axis()[0].region if chip.ports is not None else None
    by_part = {
        name: sum(found[layer.region] for layer in layers)
        - (ports_volume(chip) if drilled in {layer.region for layer in layers} else 0.0)
        for name, layers in parts(chip).items()
    }
    return by_part | {region: found[region] for region in _cavities(chip)}


def ports_volume(chip: Chip) -> float:
    """Volume (m^3) of wall that the ports of a chip remove.

    A channel of radius a along x between the cylinders r = b and r = c has the volume ``2 int_{-a}^{a} sqrt(a^2 - y^2)
    (sqrt(c^2 - y^2) - sqrt(b^2 - y^2)) dy``. With y = a sin(t) the integrand is smooth and periodic, so the midpoint
    rule converges to rounding.

    Raises:
        InputError: the chip has no ports.
    """
    wall, _ = chip.port_axis()
    if chip.ports is None:
        return 0.0
    a = 0.5 * chip.ports.diameter.value
    count = 200
    total = 0.0
    for k in range(count):
        t = -0.5 * math.pi + math.pi * (k + 0.5) / count
        y = a * math.sin(t)
        length = math.sqrt(wall.outer_radius**2 - y**2) - math.sqrt(wall.inner_radius**2 - y**2)
        total += (a * math.cos(t)) ** 2 * length * math.pi / count
    return chip.ports.count * 2.0 * total


def chip_solids(chip: Chip) -> dict[str, Solid | Compound]:
    """Every part of a chip and its fluid (mm), by region.

    The chip is whole, even if a part of it is meshed. Walls on both sides of a straight channel are a compound. The
    ports are straight channels through the wall; Fig. 3 of Acevedo-Espinosa et al. (RP-UEIS) shows them without a size.
    The fluid in them is not part of ``cavity``.

    Raises:
        SolidError: CadQuery is not installed, or a solid is invalid or differs in volume from the chip's dimensions.
    """
    expected = part_volumes(chip)
    cadquery = cadquery_module()
    channels = _channels(cadquery, chip)
    drilled = chip.port_axis()[0].region if channels else None
    bodies = _of_outlines(chip) if chip.is_shaped else _discs(cadquery, chip)
    fused = {region: _fused(each) for region, each in bodies.items()}
    # Walls on both sides of a straight channel, unless a layer of the same part joins them.
    apart = {layer.region for layer in chip.layers if len(fused[layer.region].Solids()) > 1}
    made: dict[str, Solid | Compound] = {}
    for name, layers in parts(chip).items():
        shape = _fused([fused[layer.region] for layer in layers])
        volume_of_ports = 0.0
        if drilled in {layer.region for layer in layers}:
            shape = shape.cut(*channels)
            # The formula for the volume of ports holds only for round walls.
            volume_of_ports = ports_volume(chip) if chip.is_shaped else 0.0
        made[name] = _checked(name, shape, expected[name], ROUND_TOLERANCE if not chip.is_shaped else (
            SHAPED_TOLERANCE + volume_of_ports / expected[name]),
                              _pieces(chip) if all(layer.region in apart for layer in layers) else 1)
    for region, around in _cavities(chip).items():
        made[region] = _checked(region, fused[region], expected[region],
                                SHAPED_TOLERANCE if chip.is_shaped else ROUND_TOLERANCE, around[0].channels)
    return made


def _cavities(chip: Chip) -> dict[str, tuple[Layer, ...]]:
    """The layers around every cavity by its region."""
    return ({CAVITY: chip.holes} if chip.holes else {}) | chip.further_cavities


def _pieces(chip: Chip) -> int:
    """Number of pieces of the wall. There are two beside a straight channel, and one between neighbouring channels."""
    return chip.measure.sides + (chip.holes[0].channels - 1 if chip.holes else 0)


def _discs(cadquery: ModuleType, chip: Chip) -> dict[str, list[Shape]]:
    """Layers with plane faces and upright sides, and the cavity, by region."""
    measure = chip.measure
    found = {layer.region: [_ring(cadquery, layer, measure)] for layer in chip.layers}
    return found | {region: [body for hole in around for body in _inside(cadquery, hole, measure)]
                    for region, around in _cavities(chip).items()}


def _of_outlines(chip: Chip) -> dict[str, list[Shape]]:
    """Layers and cavity by region, made from their outlines."""
    from geometry import cad

    faces: dict[str, list[Face]] = {}
    if chip.is_profiled:
        faces = {region: shape.Faces() for region, shape in section_faces(chip).items()}
    else:
        for region, arcs in outlines(chip):
            faces.setdefault(region, []).append(cad.face_of(arcs))
    return {region: [body for face in each for body in _bodies(face, chip.measure)] for region, each in faces.items()}


def _bodies(face: Face, measure: Measure) -> list[Shape]:
    """The bodies of a section face (mm): of revolution, or prisms. A plane of symmetry adds the mirror image of the
    prism."""
    if not isinstance(measure, Straight):
        return [revolution.revolved(face)]
    cadquery, long = cadquery_module(), MILLIMETRES * measure.length
    prism = cadquery.Solid.extrudeLinear(face, cadquery.Vector(0.0, long, 0.0)).moved(
        cadquery.Location(cadquery.Vector(0.0, -0.5 * long, 0.0)))
    return [prism, prism.mirror("YZ")] if measure.copies == 2 else [prism]


def _full(cadquery: ModuleType, distance: float, layer: Layer, measure: Measure, middle: float = 0.0) -> Shape:
    """A layer without a hole. It extends to a `distance` (m) from the axis, or on both sides of a `middle` (m)."""
    height, up = MILLIMETRES * layer.thickness.value, cadquery.Vector(0.0, 0.0, 1.0)
    bottom, reach = MILLIMETRES * layer.z_bottom, MILLIMETRES * distance
    body: Shape
    if isinstance(measure, Straight):
        left, long = (reach if measure.sides == 2 else 0.0), MILLIMETRES * measure.length
        body = cadquery.Solid.makeBox(left + reach, long, height, cadquery.Vector(
            MILLIMETRES * middle - left, -0.5 * long, bottom), up)
    else:
        body = cadquery.Solid.makeCylinder(reach, height, cadquery.Vector(0.0, 0.0, bottom), up)
    return body


def _ring(cadquery: ModuleType, layer: Layer, measure: Measure) -> Shape:
    whole = _full(cadquery, layer.outer_radius, layer, measure, layer.offset)
    if not layer.inner_radius:
        return whole
    return whole.cut(*_inside(cadquery, layer, measure))


def _inside(cadquery: ModuleType, layer: Layer, measure: Measure) -> list[Shape]:
    """The holes of a layer, filled."""
    return [_full(cadquery, layer.inner_radius, layer, measure, 0.5 * (left + right)) for left, right in layer.holes]


def _fused(shapes: list[Shape]) -> Shape:
    """One shape without the seams between equal faces."""
    return shapes[0] if len(shapes) == 1 else shapes[0].fuse(*shapes[1:]).clean()


def _channels(cadquery: ModuleType, chip: Chip) -> list[Shape]:
    """The ports as cylinders from the axis to beyond the outer surface."""
    if chip.ports is None:
        return []
    wall, height = chip.port_axis()
    start = cadquery.Vector(0.0, 0.0, MILLIMETRES * height)
    angles = [2.0 * math.pi * k / chip.ports.count for k in range(chip.ports.count)]
    return [
        cadquery.Solid.makeCylinder(
            MILLIMETRES * 0.5 * chip.ports.diameter.value,
            MILLIMETRES * 1.1 * wall.outer_radius,
            start,
            cadquery.Vector(math.cos(angle), math.sin(angle), 0.0),
        )
        for angle in angles
    ]


def volume(shape: Shape) -> float:
    """Volume (m^3) of a solid of :func:`chip_solids`. The integration is adaptive: CadQuery's default has a fixed
    number of points and errors up to 1 % in a channel that ends in round walls."""
    return float(shape.Volume(tol=0.1 * ROUND_TOLERANCE)) / MILLIMETRES**3


def _checked(name: str, shape: Shape, expected: float, tolerance: float, pieces: int = 1) -> Solid | Compound:
    """The checked solid in `shape`, or a compound of its `pieces`. Booleans return a solid wrapped in a compound.
    `expected` is its volume (m^3)."""
    found = shape.Solids()
    if len(found) != pieces or not shape.isValid():
        raise SolidError(f"{name!r} should be {'one valid solid' if pieces == 1 else f'{pieces} valid solids'} and is "
                         f"{len(found)}, valid: {shape.isValid()}")
    if not abs(volume(shape) - expected) <= tolerance * expected:
        raise SolidError(
            f"volume of the solid {name!r} is {volume(shape):.12g} m^3, by the chip's dimensions {expected:.12g}"
        )
    made: Solid | Compound = found[0] if pieces == 1 else cadquery_module().Compound.makeCompound(found)
    return made
