"""Features of a round chip beside its axis.

They are drops of solder or glue, wires, and point supports.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from geometry.dimension import millimetres
from geometry.measure import Axisymmetric, Measure
from geometry.parts import Layer
from workbench.files.errors import InputError, choose
from workbench.files.quantities import format_quantity
from workbench.files.tables import FileTable
from workbench.files.toml import TomlEntry

#: Kinds of features, with the key of the size of each and its dimension.
KINDS: Mapping[str, tuple[str, str]] = {"mass": ("mass", "mass"), "spring": ("stiffness", "stiffness")}

_KEYS = ("kind", "layer", "face", "distance", "angle", "diameter", "mass", "stiffness", "loss")


@dataclass(frozen=True)
class Feature:
    """A rigid part on a round patch of a layer's plane face.

    ``distance`` (m) is that of the patch's centre from the axis, ``angle`` (rad) its place around the axis,
    ``diameter`` (m) that of the patch. A ``mass`` is in kg. A spring to a fixed point has a ``stiffness`` (N/m), equal
    in all directions, with the share ``loss`` of it as imaginary part.
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
        """The mass or the stiffness in words."""
        return f"{1e6 * self.mass:.6g} mg" if self.kind == "mass" else f"{self.stiffness:.6g} N/m"

    def __str__(self) -> str:
        return (f"{self.kind} of {self.size} on the {self.face} of {self.region}, {millimetres(self.distance)} from "
                f"the axis at {math.degrees(self.angle):g} deg, {millimetres(self.diameter)} wide")


def read_features(root: FileTable) -> tuple[Feature, ...]:
    """The features of a chip file, in its order."""
    return tuple(map(_feature, root.tables("features", expected="a list of features, each under [[features]]")))


def _feature(table: FileTable) -> Feature:
    table.only(_KEYS)
    kind = choose(table.required("kind", "a kind of feature"), KINDS, source=table.source, field=table.at("kind"))
    key, dimension = KINDS[kind]
    for other in {each for each, _ in KINDS.values()} - {key} | ({"loss"} if kind == "mass" else set()):
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


def check_features(features: Sequence[Feature], layers: Sequence[Layer], measure: Measure, file: str) -> None:
    """Check the sizes and places of features.

    Raises:
        InputError: otherwise.
    """
    if features and not isinstance(measure, Axisymmetric):
        raise InputError(file, "features", f"{len(features)} in a straight chip", "none: only a round chip has "
                         "features at a place around its axis")
    by_region = {layer.region: layer for layer in layers}
    for i, feature in enumerate(features):
        field = f"features[{i}]"
        layer = by_region[choose(feature.region, by_region, source=file, field=f"{field}.layer")]
        size, _ = KINDS[feature.kind]
        for name in (size, "diameter"):
            if not 0.0 < getattr(feature, name) < math.inf:
                raise InputError(file, f"{field}.{name}", getattr(feature, name), "a value above zero")
        if not 0.0 <= feature.loss < 1.0:
            raise InputError(file, f"{field}.loss", feature.loss, "a share from 0 to below 1")
        if not math.isfinite(feature.angle):
            raise InputError(file, f"{field}.angle", feature.angle, "an angle")
        if not feature.distance >= 0.0 or feature.distance + 0.5 * feature.diameter > layer.outer_radius:
            raise InputError(file, f"{field}.distance", millimetres(feature.distance),
                             f"0 mm to {millimetres(layer.outer_radius - 0.5 * feature.diameter)}: the patch, "
                             f"{millimetres(feature.diameter)} wide, lies on {feature.region!r}")


def feature_keys(feature: Feature) -> dict[str, TomlEntry]:
    """The keys of a feature in a chip file."""
    size, dimension = KINDS[feature.kind]
    units = ("mg", "g", "kg") if size == "mass" else ("N/m",)
    found: dict[str, TomlEntry] = {
        "kind": feature.kind, "layer": feature.region, "face": feature.face,
        "distance": format_quantity(feature.distance, "length", ("mm", "um", "m")),
        "diameter": format_quantity(feature.diameter, "length", ("mm", "um", "m")),
        "angle": format_quantity(feature.angle, "angle", ("deg", "rad")),
        size: format_quantity(getattr(feature, size), dimension, units)}
    return found | ({"loss": feature.loss} if feature.loss else {})
