"""Features of a round chip beside its axis.

They are drops of solder or glue, wires, point supports, and gaps in an electrode.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from geometry.dimension import as_text, millimetres
from geometry.measure import Axisymmetric, Measure
from geometry.names import TRANSDUCER
from geometry.parts import Electrodes, Layer
from workbench.files.errors import InputError, choose
from workbench.files.quantities import format_quantity
from workbench.files.tables import FileTable
from workbench.files.toml import TomlEntry

#: Kinds of features, with the key of the size of each and its dimension.
KINDS: Mapping[str, tuple[str, str]] = {
    "mass": ("mass", "mass"), "spring": ("stiffness", "stiffness"), "gap": ("diameter", "length")}

#: Keys of a part of each kind; other kinds have none of them.
_OWN: Mapping[str, tuple[str, ...]] = {"mass": ("mass",), "spring": ("stiffness", "loss"), "gap": ()}

#: Units of a chip file, by dimension.
_UNITS: Mapping[str, tuple[str, ...]] = {
    "length": ("mm", "um", "m"), "angle": ("deg", "rad"), "mass": ("mg", "g", "kg"), "stiffness": ("N/m",)}

_KEYS = ("kind", "layer", "face", "distance", "angle", "diameter", "mass", "stiffness", "loss")


@dataclass(frozen=True)
class Feature:
    """A rigid part on a round patch, or a gap.

    The part is on a plane face of a layer, the gap in its electrode.

    ``distance`` (m) is that of the patch's centre from the axis, ``angle`` (rad) its place around the axis,
    ``diameter`` (m) that of the patch. A ``mass`` is in kg. A spring to a fixed point has a ``stiffness`` (N/m), equal
    in all directions, with the share ``loss`` of it as imaginary part. A gap has only its diameter.
    """

    kind: str
    region: str
    face: Literal["top", "bottom"]
    distance: float
    diameter: float
    angle: float = 0.0
    mass: float = 0.0
    stiffness: float = 0.0
    loss: float = 0.0

    @property
    def size(self) -> str:
        """The mass, the stiffness or the diameter of a gap in words."""
        key, dimension = KINDS[self.kind]
        return as_text(getattr(self, key), dimension)

    @property
    def centre(self) -> complex:
        """The place of the patch's centre in the plane (m)."""
        return cmath.rect(self.distance, self.angle)

    def __str__(self) -> str:
        name = "gap in the electrode" if self.kind == "gap" else f"{self.kind} of {self.size}"
        return (f"{name} on the {self.face} of {self.region}, {millimetres(self.distance)} from "
                f"the axis at {math.degrees(self.angle):g} deg, {millimetres(self.diameter)} wide")


def read_features(root: FileTable) -> tuple[Feature, ...]:
    """The features of a chip file, in its order."""
    return tuple(map(_feature, root.tables("features", expected="a list of features, each under [[features]]")))


def _feature(table: FileTable) -> Feature:
    table.only(_KEYS)
    kind = table.required("kind", f"a kind of feature, {' or '.join(KINDS)}")
    choose(kind, KINDS, source=table.source, field=table.at("kind"))
    key, dimension = KINDS[kind]
    for other in [each for keys in _OWN.values() for each in keys if each not in _OWN[kind]]:
        if other in table:
            raise table.error(other, f"none in a feature of the kind {kind!r}, which has a {key}")
    table.required(key, f"a {dimension} with its unit")
    for length in ("distance", "diameter"):
        table.required(length, "a length with its unit")
    face = choose(table.text("face", "top"), ("top", "bottom"), source=table.source, field=table.at("face"))
    return Feature(
        kind=kind,
        region=table.text("layer", "transducer"),
        face="top" if face == "top" else "bottom",
        distance=table.quantity("distance", "length"),
        diameter=table.quantity("diameter", "length"),
        angle=table.quantity("angle", "angle", 0.0),
        mass=table.quantity("mass", "mass", 0.0),
        stiffness=table.quantity("stiffness", "stiffness", 0.0),
        loss=table.quantity("loss", "dimensionless", 0.0),
    )


def check_features(
    features: Sequence[Feature], layers: Sequence[Layer], electrodes: Electrodes, measure: Measure, file: str
) -> None:
    """Check the sizes and places of features.

    Raises:
        InputError: a size that is no number above zero, a patch that is not on a free plane face of its layer, or that
            overlaps another one, a gap that is not in an electrode, or features of a straight chip.
    """
    if features and not isinstance(measure, Axisymmetric):
        raise InputError(file, "features", f"{len(features)} in a straight chip", "none: only a round chip has "
                         "features at a place around its axis")
    for i, feature in enumerate(features):
        field = f"features[{i}]"
        choose(feature.region, [layer.region for layer in layers], source=file, field=f"{field}.layer")
        for name, dimension in (KINDS[feature.kind], ("diameter", "length")):
            if not 0.0 < getattr(feature, name) < math.inf:
                raise InputError(file, f"{field}.{name}", as_text(getattr(feature, name), dimension),
                                 f"a {dimension} above zero")
        if not 0.0 <= feature.loss < 1.0:
            raise InputError(file, f"{field}.loss", feature.loss, "a share from 0 to below 1")
        if not math.isfinite(feature.angle):
            raise InputError(file, f"{field}.angle", feature.angle, "an angle")
        _check_place(feature, layers, electrodes, file, field)
        for k, other in enumerate(features[:i]):
            apart, least = abs(feature.centre - other.centre), 0.5 * (feature.diameter + other.diameter)
            if (other.region, other.face) == (feature.region, feature.face) and apart < least:
                raise InputError(file, f"{field}.distance", f"{millimetres(apart)} from the centre of features[{k}]",
                                 f"at least {millimetres(least)}, so that the patches do not overlap")


def _check_place(
    feature: Feature, layers: Sequence[Layer], electrodes: Electrodes, file: str, field: str
) -> None:
    """Check that a part is on a free plane face.

    A gap is in an electrode."""
    index = next(i for i, layer in enumerate(layers) if layer.region == feature.region)
    layer, beside = layers[index], index + (1 if feature.face == "top" else -1)
    neighbour = layers[beside] if 0 <= beside < len(layers) else None
    if shape := next((name for name in ("bow", "dome", "profile") if getattr(layer, name) is not None), ""):
        raise InputError(file, f"{field}.layer", feature.region, f"a layer with plane faces; this one has a {shape}")
    low, high = layer.inner_radius if neighbour is None else neighbour.outer_radius, layer.outer_radius
    where = f"the free {feature.face} of {feature.region!r}"
    if feature.kind == "gap":
        low, high = _electrode(feature, layer, electrodes, file, field)
        where = f"the electrode on the {feature.face} of {feature.region!r}"
        if high - low < (1.0 if low else 0.5) * feature.diameter:
            raise InputError(file, f"{field}.diameter", millimetres(feature.diameter),
                             f"at most {millimetres((high - low) * (1.0 if low else 2.0))}, so that the gap is in "
                             f"{where}")
    elif neighbour is not None and high - low < feature.diameter:
        part = "" if low >= high else f" up to {millimetres(low)} of {millimetres(high)}"
        raise InputError(file, f"{field}.face", feature.face, f"a face with {millimetres(feature.diameter)} free for "
                         f"the patch: {neighbour.region} covers the {feature.face} of {feature.region}{part}")
    radius = 0.5 * feature.diameter
    # A patch may lie about the axis of a full disc.
    least, most = low + radius if low else 0.0, high - radius
    if not least <= feature.distance <= most:
        raise InputError(file, f"{field}.distance", millimetres(feature.distance),
                         f"{millimetres(least)} to {millimetres(most)}: the patch, {millimetres(feature.diameter)} "
                         f"wide, lies on {where}")


def _electrode(
    feature: Feature, layer: Layer, electrodes: Electrodes, file: str, field: str
) -> tuple[float, float]:
    """The inner and outer radius (m) of the electrode of a gap."""
    if layer.role != TRANSDUCER:
        raise InputError(file, f"{field}.layer", feature.region, "a transducer, whose electrode has the gap",
                         (TRANSDUCER,))
    own = electrodes if layer.live is None else Electrodes(layer.live)
    disc = own.live_disc if own.live == feature.face else own.ground_disc
    return (layer.inner_radius if disc.inner_radius is None else disc.inner_radius.value,
            layer.outer_radius if disc.radius is None else disc.radius.value)


def feature_keys(feature: Feature) -> dict[str, TomlEntry]:
    """The keys of a feature in a chip file."""
    size, dimension = KINDS[feature.kind]
    sizes = {"distance": "length", "diameter": "length", "angle": "angle", size: dimension}
    found: dict[str, TomlEntry] = {
        "kind": feature.kind, "layer": feature.region, "face": feature.face,
        **{key: format_quantity(getattr(feature, key), kind, _UNITS[kind]) for key, kind in sizes.items()}}
    return found | ({"loss": feature.loss} if feature.loss else {})
