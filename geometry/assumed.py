"""Assumed uncertainties of lengths without a stated tolerance, by layer role.

Fits, live views, tolerance analyses and diagnoses use them. The values are typical of parts of each kind. Reports mark
them as assumed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from geometry.dimension import Dimension
from geometry.names import CAVITY, role_of

#: Films are spread by hand: their thickness is uncertain by this factor and searched within these multiples of its
#: value. With twice the factor, a gel stated as 20 um is as likely 120 um as 20 um.
FILMS = ("couplant", "bond")
FILM_FACTOR, FILM_RANGE = 3.0, (0.1, 5.0)

#: Roles of printed parts, and the tolerance (m) of their lengths and holes: one printed layer, or half a filament
#: width.
PRINTED = ("substrate", "sidewall")
PRINTED_TOLERANCE = 50e-6

#: Materials that are etched (also all that end in "_glass"). Tolerances: mask (m) for widths; relative depth, at least
#: LEAST_DEPTH_TOLERANCE (m), for depths and wafers.
ETCHED, MASK_TOLERANCE, DEPTH_TOLERANCE, LEAST_DEPTH_TOLERANCE = ("silicon", "fused_silica", "quartz"), 2e-6, 0.01, 1e-6

#: Materials that are turned or milled instead.
TURNED = ("stainless_steel", "steel", "aluminium", "brass", "titanium")

#: Relative tolerance of turned, lapped or bought parts: catalogues of discs and lids state 0.5 to 2 %.
MACHINED_TOLERANCE = 0.01

#: Typical standard uncertainty of a shape (m; rad for a draft): printers and moulds widen a hole by a degree, a printed
#: side bulges by a tenth of a filament width, thin glass and lapped discs are flat to a few micrometres.
SHAPE_UNCERTAINTY: Mapping[str, float] = {"draft": math.radians(1.0), "barrel": 4e-5, "bow": 4e-6, "dome": 2e-6}


@dataclass(frozen=True)
class LengthUncertainty:
    """The uncertainty of a length.

    ``deviation`` (m; rad for an angle) is the standard uncertainty. ``low`` and ``high`` bound the uniform law,
    ``lowest`` and ``highest`` bound a search. ``assumed`` names the assumption in words; it is empty if the chip file
    states the tolerance.
    """

    deviation: float
    low: float
    high: float
    lowest: float
    highest: float
    assumed: str = ""


def is_film(name: str) -> bool:
    """Whether a dimension is the thickness of a gel or glue film."""
    region, _, what = name.rpartition(".")
    return what == "thickness" and role_of(region) in FILMS


def length_uncertainty(name: str, length: Dimension, material: str = "") -> LengthUncertainty:
    """The uncertainty of a dimension: stated in the chip file, or assumed.

    Parts are assumed to be printed, unless their `material` is usually etched or turned. A tolerance is the half width
    of a uniform law. A search extends to three tolerances, at least 2 % of the length. The logarithm of a film
    thickness is uniform.
    """
    region, _, what = name.rpartition(".")
    value, size = length.value, abs(length.value)
    if length.tolerance is not None:
        return _limited(value, length.tolerance, "")
    if what in SHAPE_UNCERTAINTY:
        return _limited(value, math.sqrt(3.0) * SHAPE_UNCERTAINTY[what], "a shape typical of parts of this kind")
    if is_film(name):
        return LengthUncertainty(
            size * math.log(FILM_FACTOR) / math.sqrt(3.0), value / FILM_FACTOR, value * FILM_FACTOR,
            FILM_RANGE[0] * value, FILM_RANGE[1] * value,
            f"a film of gel or glue is known to a factor of {FILM_FACTOR:g}")
    base = material.partition("/")[0]
    if role_of(region) in (*PRINTED, CAVITY) and (base in ETCHED or base.endswith("_glass")):
        if what == "thickness":
            return _limited(value, max(DEPTH_TOLERANCE * size, LEAST_DEPTH_TOLERANCE),
                            f"a wafer or an etched depth is known to {100.0 * DEPTH_TOLERANCE:g} %, or 1 um")
        return _limited(value, MASK_TOLERANCE, f"an etched width is known to {1e6 * MASK_TOLERANCE:g} um")
    if role_of(region) in (*PRINTED, CAVITY) and base not in TURNED:
        return _limited(value, PRINTED_TOLERANCE, f"a printed length is known to {1e6 * PRINTED_TOLERANCE:g} um")
    return _limited(value, MACHINED_TOLERANCE * size,
                    f"a turned or bought part is known to {100.0 * MACHINED_TOLERANCE:g} %")


def assumed_uncertainty(name: str, value: float, material: str = "") -> LengthUncertainty:
    """The assumed uncertainty of a dimension of that `value` (m or rad)."""
    return length_uncertainty(name, Dimension(value), material)


def _limited(value: float, tolerance: float, assumed: str) -> LengthUncertainty:
    reach = max(3.0 * tolerance, 0.02 * abs(value))
    return LengthUncertainty(tolerance / math.sqrt(3.0), value - tolerance, value + tolerance, value - reach,
                             value + reach, assumed)
