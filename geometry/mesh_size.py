"""The required fineness of a mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from workbench.files.errors import InputError, nearest_names


@dataclass(frozen=True)
class MeshSize:
    """The required fineness of a mesh.

    ``slowest_wave``: the slowest sound or shear speed (m/s) of every region, ``math.inf`` if nothing propagates (a
    vacuum). ``frequency_max`` in Hz. ``elements_per_wavelength`` for fields of polynomial ``order``.
    ``minimum_through_thickness``: elements across the thinnest layer. ``minimum_through_quarter_wave``: elements across
    a layer that is thicker than a quarter of the slowest wavelength in it. ``corner_refinement``: largest size of the
    elements in re-entrant corners of the solids and at the rim of a couplant, relative to the others, and its cube at
    the ends of electrodes; 1 leaves them alike. ``cavity_corner``: largest size of the elements in the corners of the
    cavity, relative to its longer side. ``growth``: ratio between neighbouring elements from there on.
    ``skins``: regions that have a row of elements of its own at either face, and the share of the thickness that it
    takes. ``levels``: heights (m) of further lines of nodes; the near field of a film decays within them. ``radii``:
    radii (m) of further lines of nodes, at which a layer may end within the section's own; those very close to another
    line are left out.
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
