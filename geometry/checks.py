"""Checks of a chip's description. Each raises the InputError of the first mistake it finds.

`file` is the name that mistakes are reported under; lengths in messages are in millimetres.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from geometry.assumed import FILMS
from geometry.dimension import SAME_LENGTH, SHAPES, Dimension, dimension_text, millimetres
from geometry.features import Feature
from geometry.limits import CLOSED, FULL_DISC, FURTHER_CAVITY
from geometry.measure import ABOUT_AXIS, Axisymmetric, Measure
from geometry.names import ROLES, TRANSDUCER, VACUUM, region_names
from geometry.parts import Electrodes, Layer, Ports, State, discs, further_cavities, largest_shape, port_axis
from geometry.profile import Outline, Profile
from workbench.files.errors import InputError, choose
from workbench.files.names import check_name, check_title

#: Largest taper over the thickness of a disc: cubes of a twentieth, on either side of the mean, are left out.
TAPER = 0.1


@contextmanager
def naming_layers(regions: Sequence[str]) -> Iterator[None]:
    """Name the region of a layer in the InputError of its field."""
    try:
        yield
    except InputError as error:
        if (place := re.match(r"layers\[(\d+)\]", error.field)) is not None:
            error.owner = regions[int(place[1])]
        raise


def check_names(name: str, layers: Sequence[Layer], states: Sequence[State], file: str) -> None:
    """Check that names and titles are valid text. Names of states must be valid in file names; other names are one
    line. Nobody looks up yet whether the materials exist."""
    titles = {"chip.name": name}
    for i, layer in enumerate(layers):
        titles |= {f"layers[{i}].material": layer.material, f"layers[{i}].filling": layer.filling or VACUUM}
    for state in states:
        place = f"states.{check_name(state.name, source=file, field='states')}"
        titles |= {f"{place}.cavity": state.cavity or VACUUM, f"{place}.particle": state.particle or VACUUM}
        titles |= {f"{place}.materials.{region}": material for region, material in state.materials.items()}
        titles |= {f"{place}.reported[{i}].label": each.label for i, each in enumerate(state.reported)}
    for field, title in titles.items():
        check_title(title, source=file, field=field)


def check_dimensions(
    layers: Sequence[Layer], band: tuple[float, float], named: Mapping[str, Dimension], file: str,
    measure: Measure = ABOUT_AXIS,
) -> None:
    """Check that lengths, tolerances and the `band` (Hz) are valid. `named` are all lengths by name, as in
    `geometry.chip.Chip.dimensions`."""
    low, high = band
    if not 0.0 < low < high:
        raise InputError(file, "chip.band", [low, high], "two frequencies in Hz above zero, the lower one first")
    places = [
        (f"layers[{i}].{name}", dimension)
        for i, layer in enumerate(layers)
        for name, dimension in (
            ("thickness", layer.thickness),
            (measure.across, layer.radius),
            (f"cavity_{measure.across}", layer.cavity_radius),
            (f"inner_{measure.across}", layer.bore),
        )
        if dimension is not None
    ]
    places += [(name, d) for name, d in named.items() if name.startswith(("electrode_", "ports."))]
    for place, dimension in places:
        if not (math.isfinite(dimension.value) and dimension.value > 0.0):
            raise InputError(file, place, dimension_text(dimension), "a length above zero")
        tolerance = dimension.tolerance
        if tolerance is not None and not 0.0 <= tolerance < dimension.value:
            raise InputError(
                file,
                f"{place}.tolerance",
                millimetres(tolerance),
                f"zero or more and below the value, {dimension_text(dimension)}",
            )
    for i, layer in enumerate(layers):
        if layer.density is not None and not (math.isfinite(layer.density) and layer.density > 0.0):
            raise InputError(file, f"layers[{i}].density", layer.density, "a density above zero")


def check_shapes(layers: Sequence[Layer], file: str) -> None:
    """Check that shapes of layers are possible and their tolerances valid."""
    profiled = any(layer.profile is not None for layer in layers)
    for i, layer in enumerate(layers):
        for name, size in layer.shapes.items():
            if profiled:
                raise InputError(file, f"layers[{i}].{name}", dimension_text(size, SHAPES[name]),
                                 "none in a chip in which "
                                 "a layer has a profile: state it in a profile of this layer")
            place, shown = f"layers[{i}].{name}", dimension_text(size, SHAPES[name])
            if name == "draft" and layer.cavity_radius is None:
                raise InputError(file, place, shown, "none without a hole: a draft is that of the hole's wall")
            limit = largest_shape(layer, name)
            if not abs(size.value) < limit:
                raise InputError(file, place, shown, f"less than {_shown(name, limit)} to either side")
            if size.tolerance is not None and not 0.0 <= size.tolerance < math.inf:
                raise InputError(file, f"{place}.tolerance", _shown(name, size.tolerance), "zero or more")
            if name == "draft" and layer.inner_radius + math.tan(size.value) * layer.thickness.value <= 0.0:
                raise InputError(file, place, shown, "a hole that does not close before the top of the layer")
            if name == "draft" and (room := _beside_holes(layer)) < math.tan(size.value) * layer.thickness.value:
                raise InputError(file, place, shown, "walls that stay apart and within the layer up to its top: there "
                                 f"is {millimetres(room)} beside each, which they reach at "
                                 f"{_shown(name, math.atan(room / layer.thickness.value))}")


def check_taper(layers: Sequence[Layer], features: Sequence[Feature], measure: Measure, file: str) -> None:
    """Check that a taper is small and of a bare plane disc."""
    for i, layer in enumerate(layers):
        if not layer.taper:
            continue
        place, shown, largest = f"layers[{i}].taper", millimetres(layer.taper), TAPER * layer.thickness.value
        if len(layers) > 1 or features or not isinstance(measure, Axisymmetric) or layer.inner_radius or any(
                layer.shapes.values()) or layer.profile is not None:
            raise InputError(file, place, shown, "none but in a chip of one full round disc with plane faces, without "
                             "features")
        if not 0.0 < layer.taper <= largest:
            raise InputError(file, place, shown, f"a difference of thickness up to {millimetres(largest)}, a tenth of "
                             "the thickness: higher powers of it than the square are left out")


def _beside_holes(layer: Layer) -> float:
    """The least space (m) beside the walls of a layer's holes."""
    between = [0.5 * (right[0] - left[1]) for left, right in itertools.pairwise(layer.holes)]
    (left, right), (low, high) = layer.sides, layer.hole_sides
    return min(low - left, right - high, *between)


def _shown(name: str, size: float) -> str:
    """A size of the shape of that name, as text for messages."""
    return f"{math.degrees(size):.4g} deg" if SHAPES[name] == "angle" else millimetres(size)


def check_cavity(
    layers: Sequence[Layer], file: str, measure: Measure = ABOUT_AXIS, *, is_open: bool = False
) -> None:
    """Check that the cavity is continuous and closed. Its holes are in neighbouring layers and narrower than these. The
    top may be open if `is_open`."""
    key = f"cavity_{measure.across}"
    # A hole is never wider than its neighbours, so every ring is supported.
    places = [i for i, layer in enumerate(layers) if layer.cavity_radius is not None]
    for i in places:
        layer = layers[i]
        if layer.role == TRANSDUCER:
            raise InputError(
                file, f"layers[{i}].{key}", _hole(layer), "no cavity in the transducer; for a ring, state "
                f"inner_{measure.across}"
            )
        if layer.bore is not None:
            raise InputError(file, f"layers[{i}].inner_{measure.across}", dimension_text(layer.bore),
                             f"either the {key} of a cavity or the inner_{measure.across} of an empty ring")
        (left, right), (low, high) = layer.sides, layer.hole_sides
        if low < left + SAME_LENGTH or high > right - SAME_LENGTH:
            raise InputError(
                file,
                f"layers[{i}].{key}",
                _hole(layer),
                f"a hole narrower than its layer, below {millimetres(layer.outer_radius)}" if layer.channels == 1 else
                f"{layer.channels} channels within their layer: with their pitch of {millimetres(layer.pitch)} they "
                f"take {millimetres(high - low)} of its {millimetres(right - left)}",
            )
        for j, side in ((i - 1, "below"), (i + 1, "above")):
            if side == "above" and is_open:
                continue
            if not 0 <= j < len(layers):
                raise InputError(
                    file,
                    f"layers[{i}].{key}",
                    _hole(layer),
                    f"a closed cavity: a layer {side} {layer.region!r}; {CLOSED}",
                )
            if not layers[j].covers(layer):
                raise InputError(
                    file,
                    f"layers[{i}].{key}",
                    _hole(layer),
                    f"a closed cavity: {layers[j].region!r} {side} reaches only "
                    f"{millimetres(layers[j].outer_radius)}",
                )
            if layers[j].bore is not None:
                raise InputError(file, f"layers[{j}].inner_{measure.across}", millimetres(layers[j].inner_radius),
                                 f"a closed cavity: no hole in {layers[j].region!r} {side} it; {CLOSED}")
    if places and places != list(range(places[0], places[-1] + 1)):
        gap = next(i for i in range(places[0], places[-1]) if i not in places)
        raise InputError(
            file,
            f"layers[{gap}].{key}",
            None,
            f"a hole through {layers[gap].region!r} too: the holes of a cavity are in neighbouring layers; "
            f"{FURTHER_CAVITY.format(across=measure.across)}",
        )
    if is_open and places:
        _check_uncovered(layers, places[-1], file)
    _check_fillings(layers, file, measure)


def _check_fillings(layers: Sequence[Layer], file: str, measure: Measure) -> None:
    """Check that further cavities are closed, and each filled with one material."""
    bore = f"inner_{measure.across}"
    for i, layer in enumerate(layers):
        if layer.filling is None:
            continue
        place = f"layers[{i}].filling"
        if layer.bore is None or layer.role == TRANSDUCER or layer.channels > 1:
            raise InputError(file, place, layer.filling, f"the {bore} of the cavity that it fills, one in a layer that "
                             "is no transducer")
        if not any(each.cavity_radius is not None for each in layers):
            raise InputError(file, place, layer.filling, f"a first cavity, of layers with a cavity_{measure.across}")
        for j, side in ((i - 1, "below"), (i + 1, "above")):
            beside = layers[j] if 0 <= j < len(layers) else None
            if beside is not None and beside.filling not in (None, layer.filling):
                raise InputError(file, f"layers[{j}].filling", beside.filling,
                                 f"{layer.filling!r}, as in {layer.region!r}: they are one cavity")
            if beside is None or (beside.filling is None and (beside.holes or not beside.covers(layer))):
                raise InputError(file, place, layer.filling, f"a closed cavity: a layer {side} {layer.region!r} that "
                                 "covers it")


def _check_uncovered(layers: Sequence[Layer], top: int, file: str) -> None:
    """Check that no layer covers an open cavity. Its uppermost hole is in ``layers[top]``."""
    above = layers[top + 1] if top + 1 < len(layers) else None
    if above is None or above.bore is not None or above.profile is not None:
        return
    (left, right), (low, high) = above.sides, layers[top].hole_sides
    if left < low + SAME_LENGTH and right > high - SAME_LENGTH:
        raise InputError(file, "cavity.open", True, f"a free surface: {above.region!r} covers the cavity; leave out "
                         "that layer, give it a hole, or state open = false")


def warn_of_films(layers: Sequence[Layer], unusual: Sequence[str], file: str, measure: Measure = ABOUT_AXIS) -> None:
    """Warn of a film whose hole differs from the cavity beside it.

    A name in `unusual`, such as ``bond.cavity_radius``, is intended.
    """
    for i, film in enumerate(layers):
        name = f"{film.region}.cavity_{measure.across}"
        if film.role not in FILMS or film.cavity_radius is None or name in unusual:
            continue
        beside = [each for each in layers[max(i - 1, 0):i + 2]
                  if each.role not in FILMS and each.cavity_radius is not None]
        if beside and min(abs(each.inner_radius - film.inner_radius) for each in beside) > SAME_LENGTH:
            cavity = " or ".join(f"{_hole(each)} of {each.region!r}" for each in beside)
            warnings.warn(f"{file}: layers[{i}].cavity_{measure.across}: received {_hole(film)} of {film.region!r}; "
                          f"expected that of the cavity beside it, {cavity}; if the step is intended, state "
                          f'unusual = ["{name}"]', stacklevel=3)


def _hole(layer: Layer) -> str:
    return millimetres(layer.inner_radius) if layer.cavity_radius is None else dimension_text(layer.cavity_radius)


def check_stack(layers: Sequence[Layer], file: str, measure: Measure = ABOUT_AXIS) -> None:
    """Check the roles of layers, and that each rests on another."""
    roles = [layer.role for layer in layers]
    for i, layer in enumerate(layers):
        choose(layer.role, ROLES, source=file, field=f"layers[{i}].role")
    if TRANSDUCER not in roles:
        raise InputError(file, "layers", "no layer with role 'transducer'", "one or more")
    for i, layer in enumerate(layers):
        if layer.bore is not None and layer.inner_radius > layer.outer_radius - SAME_LENGTH:
            raise InputError(file, f"layers[{i}].inner_{measure.across}", dimension_text(layer.bore),
                             f"a hole narrower than its layer, below {millimetres(layer.outer_radius)}")
        if layer.bore is not None and any(each.profile is not None for each in layers):
            raise InputError(file, f"layers[{i}].inner_{measure.across}", dimension_text(layer.bore),
                             "no empty ring in a chip in which a layer has a profile: draw it as an outline")
        if layer.role != TRANSDUCER:
            if layer.poled != "up" or layer.live is not None:
                raise InputError(file, f"layers[{i}].poled", layer.poled, "no poling of a layer that is no transducer")
            continue
        if layer.profile is not None and (nearest := _nearest(layer.profile, layer, measure)) > SAME_LENGTH:
            raise InputError(file, f"layers[{i}].profile.points",
                             f"{measure.symbol} = {millimetres(nearest)} and more",
                             f"no hole through the transducer: {FULL_DISC}")
    _check_transducers(layers, file)
    for i, (layer, region) in enumerate(zip(layers, region_names(roles), strict=True)):
        if layer.region != region:
            raise InputError(
                file, f"layers[{i}].region", layer.region, f"{region!r}, its role numbered from below"
            )
        if i == 0:
            continue
        below = layers[i - 1]
        if layer.profile is not None or below.profile is not None:
            continue  # The section shows whether they fit.
        distance = layer.z_bottom - below.z_top
        if abs(distance) > SAME_LENGTH:
            fault = "leaves a gap above" if distance > 0 else "overlaps"
            raise InputError(
                file,
                f"layers[{i}].bottom",
                millimetres(layer.z_bottom),
                f"{millimetres(below.z_top)}, the top of {below.region!r}, which it {fault} by "
                f"{millimetres(abs(distance))}; leave 'bottom' out to stack the layers",
            )


def _check_transducers(layers: Sequence[Layer], file: str) -> None:
    """Check that several transducers have separate electrodes."""
    places = [i for i, layer in enumerate(layers) if layer.role == TRANSDUCER]
    for i in places[1:]:
        if layers[i].live is None:
            raise InputError(file, f"layers[{i}].electrodes", None, 'electrodes = { live = "top" } or "bottom": '
                             "transducers in one stack are wired in parallel, each by its own faces")
        if layers[i].profile is not None:
            raise InputError(file, f"layers[{i}].profile", "a profile", f"no profile: {FULL_DISC}, "
                             "where there are several transducers")


def check_shared_electrodes(layers: Sequence[Layer], electrodes: Electrodes, file: str) -> None:
    """Check that transducers that touch have one potential where they do."""
    for i, (below, above) in enumerate(itertools.pairwise(layers)):
        if below.role != TRANSDUCER or above.role != TRANSDUCER:
            continue
        low, high = (electrodes.live if layer.live is None else layer.live for layer in (below, above))
        if (low == "top") != (high == "bottom"):
            raise InputError(file, f"layers[{i + 1}].electrodes.live", high,
                             f'"{"bottom" if low == "top" else "top"}": it lies on {below.region!r}, whose upper face '
                             f"is {'live' if low == 'top' else 'at ground'}; or put a bond between them")


def _nearest(profile: Profile, layer: Layer, measure: Measure) -> float:
    """Smallest radius (m) of an outline's points; 0 without an outline."""
    if not isinstance(profile.source, Outline):
        return 0.0
    sizes = profile.sizes({"thickness": layer.thickness.value, measure.across: layer.outer_radius})
    corners = profile.source.corners
    points = (point for corner in corners for point in (corner.at, *corner.through, corner.arc) if point)
    radii = (radius for radius, _ in points)
    return min(sizes.get(radius, 0.0) if isinstance(radius, str) else radius for radius in radii)


def check_electrodes(
    electrodes: Electrodes, inner: float, outer: float, file: str, measure: Measure = ABOUT_AXIS
) -> None:
    """Check that the electrodes lie on the transducer. Its radii (half widths) are `inner` and `outer` (m)."""
    across = measure.across
    label = across.replace("_", " ")
    choose(electrodes.live, ("top", "bottom"), source=file, field="electrodes.live")
    for name, disc in discs(electrodes):
        radius = outer if disc.radius is None else disc.radius.value
        if radius > outer + SAME_LENGTH:
            raise InputError(file, f"{name}.{across}",
                             millimetres(radius) if disc.radius is None else dimension_text(disc.radius),
                             f"at most the transducer's {label}, {millimetres(outer)}")
        if disc.inner_radius is not None and disc.inner_radius.value < inner - SAME_LENGTH:
            raise InputError(file, f"{name}.inner_{across}", dimension_text(disc.inner_radius),
                             f"at least the transducer's inner {label}, {millimetres(inner)}")
        if disc.inner_radius is not None and disc.inner_radius.value > radius - SAME_LENGTH:
            raise InputError(file, f"{name}.inner_{across}", dimension_text(disc.inner_radius),
                             f"below its {label}, {millimetres(radius)}")


def check_ports(ports: Ports | None, holes: Sequence[Layer], file: str) -> None:
    """Check that the ports run through the cavity wall without overlap."""
    if ports is None:
        return
    if not holes:
        raise InputError(file, "cavity.ports", "ports", "no ports: no layer has a cavity_radius")
    if not 1 <= ports.count <= 8:
        raise InputError(file, "cavity.ports.count", ports.count, "a whole number from 1 to 8")
    wall, height = port_axis(ports, holes, file=file)
    radius = 0.5 * ports.diameter.value
    if radius > min(height - wall.z_bottom, wall.z_top - height) + SAME_LENGTH or radius >= wall.inner_radius:
        raise InputError(
            file,
            "cavity.ports",
            f"diameter {millimetres(2 * radius)}, axis {millimetres(height - holes[0].z_bottom)} above the cavity "
            "floor",
            f"a channel inside the wall {wall.region!r}, which is {millimetres(wall.thickness.value)} high, "
            f"and narrower than the cavity, {millimetres(2 * wall.inner_radius)}",
        )
    if 2.0 * wall.inner_radius * math.sin(math.pi / ports.count) < 2.0 * radius and ports.count > 1:
        raise InputError(
            file,
            "cavity.ports.count",
            ports.count,
            "fewer or narrower ports: they overlap at the cavity wall",
        )


def check_states(
    states: Sequence[State], layers: Sequence[Layer], file: str, measure: Measure = ABOUT_AXIS
) -> None:
    """Check that every state fills the cavity, and its particle fits."""
    holes = [layer for layer in layers if layer.cavity_radius is not None]
    if not states:
        raise InputError(file, "states", None, "at least one state")
    for state in states:
        place = f"states.{state.name}"
        if holes and state.cavity is None:
            raise InputError(file, f"{place}.cavity", None, f'the filling of the cavity: a material or "{VACUUM}"')
        if not holes and state.cavity is not None:
            raise InputError(
                file, f"{place}.cavity", state.cavity, f"no cavity entry: no layer has a cavity_{measure.across}"
            )
        if state.temperature is not None and not (math.isfinite(state.temperature) and state.temperature > 0.0):
            raise InputError(file, f"{place}.temperature", state.temperature, "a temperature above absolute zero")
        for region in state.materials:
            choose(region, (*(layer.region for layer in layers), *further_cavities(layers)), source=file,
                   field=f"{place}.materials")
        if (state.particle is None) != (state.particle_radius is None):
            missing = "particle" if state.particle is None else "particle_radius"
            raise InputError(file, f"{place}.{missing}", None, "both 'particle' and 'particle_radius', or neither")
        if state.particle_radius is None:
            continue
        if not holes or state.cavity == VACUUM:
            raise InputError(file, f"{place}.particle", state.particle, "no particle without a fluid to carry it")
        room = min(min(hole.inner_radius for hole in holes), 0.5 * (holes[-1].z_top - holes[0].z_bottom))
        if not 0.0 < state.particle_radius < room:
            raise InputError(
                file,
                f"{place}.particle_radius",
                millimetres(state.particle_radius),
                f"above zero and below {millimetres(room)}, or it does not fit the cavity",
            )
