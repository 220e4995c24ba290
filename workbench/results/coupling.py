"""Coupling factors of a mode from its two resonances.

Any mode has an effective coupling factor k_eff. The thickness coupling factor kt belongs to the thickness mode of a
wide plate, the planar one kp to the first radial mode of a thin disc (IEEE Std 176-1987); a stack has neither.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from scipy.optimize import brentq
from scipy.special import j0, j1

from geometry.chip import Chip
from geometry.measure import Axisymmetric
from materials.kinds import Material, Piezoelectric
from workbench.files.quantities import frequency_text

#: Least ratio of width to thickness for the formulas of the thickness mode and the planar mode (EN 50324-2). Halved,
#: radial overtones couple with the thickness mode.
WIDE = 10.0

#: Largest relative difference between the frequency of a resonance and that computed for a mode. Doubled, a radial
#: overtone near the thickness mode counts as the thickness mode.
NEAR = 0.1

#: Largest ratio of the frequencies of the largest and the smallest |Z| of the planar mode, for kp = 0.8. Beyond it, the
#: largest |Z| is of another mode.
PLANAR_PAIR = 1.5

#: Least radius of an electrode relative to its face. Below it, the uncovered edge reduces the coupling.
COVERED = 0.95


@dataclass(frozen=True)
class Plate:
    """A bare, wide piezoelectric plate whose electrodes cover its faces.

    ``thickness_mode`` is its series and parallel resonance (Hz) through the thickness, ``planar_mode`` the series
    resonance (Hz) of the first radial mode of a disc, None for a straight plate, ``poisson_ratio`` the disc's in-plane
    ratio.
    """

    thickness_mode: tuple[float, float]
    planar_mode: float | None
    poisson_ratio: float

    def thickness_coupling(self, series: float, parallel: float) -> float:
        """kt from two resonances (Hz), NaN if they are of another mode."""
        low, high = self.thickness_mode
        if abs(series / low - 1.0) > NEAR or abs(parallel / high - 1.0) > NEAR:
            return math.nan
        return thickness_coupling(series, parallel)

    def planar_coupling(self, series: float, parallel: float) -> float:
        """kp from two resonances (Hz), NaN if they are of another mode."""
        expected = self.planar_mode
        if expected is None or abs(series / expected - 1.0) > NEAR or parallel > PLANAR_PAIR * series:
            return math.nan
        return planar_coupling(series, parallel, self.poisson_ratio)


def effective_coupling(series: float, parallel: float) -> float:
    """Effective coupling factor of any mode from its two resonances (Hz). k^2 = (fp^2 - fs^2) / fp^2 (IEEE Std
    176-1987)."""
    return math.sqrt(1.0 - _ratio(series, parallel) ** 2)


def thickness_coupling(series: float, parallel: float) -> float:
    """Coupling factor kt of a thickness mode from its two resonances (Hz). kt^2 = (pi / 2) (fs / fp) tan((pi / 2) (fp -
    fs) / fp), IEEE Std 176-1987."""
    ratio = _ratio(series, parallel)
    return math.sqrt(0.5 * math.pi * ratio * math.tan(0.5 * math.pi * (1.0 - ratio)))


def planar_coupling(series: float, parallel: float, poisson_ratio: float) -> float:
    """Coupling factor kp of a planar mode from its two resonances (Hz).

    kp^2 / (1 - kp^2) = (1 - nu - x J0(x) / J1(x)) / (1 + nu) at x = x1 fp / fs, where x1 is the first root of x J0(x) =
    (1 - nu) J1(x): the planar resonance equation (Onoe, Tiersten and Meitzler 1963; IEEE Std 176-1987).
    """
    x = planar_root(poisson_ratio) / _ratio(series, parallel)
    squared = (1.0 - poisson_ratio - x * float(j0(x)) / float(j1(x))) / (1.0 + poisson_ratio)
    return math.sqrt(squared / (1.0 + squared))


def planar_root(poisson_ratio: float) -> float:
    """The first root of x J0(x) = (1 - nu) J1(x). It is 2 pi fs a / c of a thin disc of radius a and speed of sound
    c."""
    return float(brentq(lambda x: x * float(j0(x)) - (1.0 - poisson_ratio) * float(j1(x)), 1.0, 3.0))


def plate_of(chip: Chip, materials: Mapping[str, Material]) -> Plate | None:
    """The bare plate of a chip. None for a stack, and for a shape or electrodes without the formulas."""
    layer = chip.transducer
    material = materials[layer.region]
    thickness, across = layer.thickness.value, 2.0 * layer.outer_radius
    covered = all(not (disc.inner_radius and disc.inner_radius.value) and
                  (disc.radius is None or disc.radius.value >= COVERED * layer.outer_radius)
                  for disc in (chip.electrodes.live_disc, chip.electrodes.ground_disc))
    if (len(chip.layers) > 1 or chip.is_shaped or layer.inner_radius or not covered or across < WIDE * thickness
            or not isinstance(material, Piezoelectric)):
        return None
    c11, c12, c13, c33, e33 = (complex(getattr(material, name)).real for name in ("c11", "c12", "c13", "c33", "e33"))
    stiffened = c33 + e33**2 / material.absolute_eps33.real
    parallel = math.sqrt(stiffened / material.density) / (2.0 * thickness)
    squared = (stiffened - c33) / stiffened
    # kt^2 = X / tan X at X = pi fs / (2 fp).
    x = float(brentq(lambda x: x / math.tan(x) - squared, 1e-6, 0.5 * math.pi - 1e-9))
    in_plane, beside = c11 - c13**2 / c33, c12 - c13**2 / c33
    nu = beside / in_plane
    planar = None
    if isinstance(chip.measure, Axisymmetric):
        planar = planar_root(nu) * math.sqrt(in_plane / material.density) / (math.pi * across)
    return Plate((2.0 * x / math.pi * parallel, parallel), planar, nu)


def _ratio(series: float, parallel: float) -> float:
    if not 0.0 < series < parallel:
        raise ValueError(f"the parallel resonance must lie above the series one, received "
                         f"{frequency_text(parallel)} and {frequency_text(series)}")
    return series / parallel
