"""The required fineness of a mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from workbench.files.errors import InputError, nearest_names


@dataclass(frozen=True)
class MeshSize:
    """The required fineness of a mesh.

    ``slowest_wave``: the slowest wave speed (m/s) by region, ``math.inf`` in a vacuum. ``frequency_max`` in Hz.
    ``elements_per_wavelength`` for fields of polynomial ``order``. ``minimum_through_thickness``: elements across the
    thinnest layer. ``minimum_through_quarter_wave``: elements across a layer thicker than a quarter wavelength.
    ``corner_refinement``: relative element size in re-entrant corners of solids and at the edge of a couplant; its cube
    applies at the ends of electrodes; 1 means no refinement. ``cavity_corner``: largest element size in the corners of
    the cavity, relative to its longer side. ``growth``: length ratio of neighbouring elements. ``skins``: regions with
    a separate row of elements at both faces, and its share of the thickness. ``levels``: heights (m) of further lines
    of nodes, for the near field of a film. ``radii``: radii (m) of further lines of nodes, where a layer may end; radii
    very close to another line are left out.
    """

    slowest_wave: Mapping[str, float]
    frequency_max: float
    elements_per_wavelength: float
    order: int
    minimum_through_thickness: int = 1
    minimum_through_quarter_wave: int = 1
    corner_refinement: float = 1.0
    cavity_corner: float = math.inf
    growth: float = 4.0
    skins: Mapping[str, float] = field(default_factory=dict)
    levels: tuple[float, ...] = ()
    radii: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        def refuse(name: str, value: object, expected: str) -> None:
            raise InputError("mesh size", name, value, expected)

        for region, speed in self.slowest_wave.items():
            if not speed > 0.0:
                refuse(f"slowest_wave.{region}", speed, "a speed above zero in m/s")
        if not 0.0 < self.frequency_max < math.inf:
            refuse("frequency_max", self.frequency_max, "a frequency above zero in Hz")
        if not 0.0 < self.elements_per_wavelength < math.inf:
            refuse("elements_per_wavelength", self.elements_per_wavelength, "a number above zero")
        if self.order < 1:
            refuse("order", self.order, "a polynomial order of 1 or more")
        for name in ("minimum_through_thickness", "minimum_through_quarter_wave"):
            if getattr(self, name) < 1:
                refuse(name, getattr(self, name), "1 or more")
        if not 0.0 < self.corner_refinement <= 1.0:
            refuse("corner_refinement", self.corner_refinement, "a ratio above 0 and up to 1")
        if not self.cavity_corner > 0.0:
            refuse("cavity_corner", self.cavity_corner, "a ratio above 0")
        if not self.growth > 1.0:
            refuse("growth", self.growth, "a ratio above 1")
        for region, share in self.skins.items():
            if not 0.0 < share < 0.5:
                refuse(f"skins.{region}", share, "a share of the thickness above 0 and below a half")

    def largest_element(self, region: str) -> float:
        """Largest edge of an element in the region, metres.

        Raises:
            InputError: no speed is given for the region.
        """
        if region not in self.slowest_wave:
            raise InputError(
                "mesh size",
                f"slowest_wave.{region}",
                None,
                "the slowest wave speed of every region, inf where nothing propagates",
                nearest_names(region, self.slowest_wave),
            )
        return self.slowest_wave[region] / (self.frequency_max * self.elements_per_wavelength)


def refined(size: MeshSize, factor: float) -> MeshSize:
    """`size` with elements smaller by `factor` in both directions, thin layers included."""
    return replace(
        size,
        elements_per_wavelength=size.elements_per_wavelength * factor,
        minimum_through_thickness=math.ceil(size.minimum_through_thickness * factor),
        minimum_through_quarter_wave=math.ceil(size.minimum_through_quarter_wave * factor),
    )
