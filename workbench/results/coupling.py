"""Coupling factors of a mode from its two resonances, and the plates whose modes have a coupling factor of a name.

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

#: Least width over thickness of a plate whose thickness mode, or planar mode, is that of its formula (EN 50324-2).
#: Halved, radial overtones share the thickness mode.
WIDE = 10.0

#: Relative distance up to which a resonance is taken for a mode whose frequency follows from dimensions and material.
#: Doubled, a radial overtone beside the thickness mode is called by its name.
NEAR = 0.1

#: Most that the largest |Z| of the planar mode lies above its smallest |Z|: kp of 0.8. Further up, it is of another
#: mode.
PLANAR_PAIR = 1.5

#: Part of a face's half width that an electrode covers at least. Lowered, the rim without field lowers the coupling.
COVERED = 0.95


@dataclass(frozen=True)
class Plate:
    """A bare piezoelectric plate with electrodes all over its faces, wide beside its thickness.

    ``thickness_mode`` is the pair of its series and its parallel resonance (Hz) through the thickness; ``planar_mode``
    the series resonance (Hz) of the first radial mode of a disc, None for a straight plate; ``poisson_ratio`` that of
    the disc in its plane.
    """

    thickness_mode: tuple[float, float]
    planar_mode: float | None
    poisson_ratio: float

    def thickness_coupling(self, series: float, parallel: float) -> float:
        """kt of the mode with these two resonances (Hz), NaN if it is not the thickness mode of the plate."""
        low, high = self.thickness_mode
        if abs(series / low - 1.0) > NEAR or abs(parallel / high - 1.0) > NEAR:
            return math.nan
        return thickness_coupling(series, parallel)

    def planar_coupling(self, series: float, parallel: float) -> float:
        """kp of the mode with these two resonances (Hz), NaN if it is not the planar mode of the plate."""
        expected = self.planar_mode
        if expected is None or abs(series / expected - 1.0) > NEAR or parallel > PLANAR_PAIR * series:
            return math.nan
        return planar_coupling(series, parallel, self.poisson_ratio)


def effective_coupling(series: float, parallel: float) -> float:
    """The effective coupling factor of any mode, k^2 = (fp^2 - fs^2) / fp^2 (IEEE Std 176-1987)."""
    return math.sqrt(1.0 - _ratio(series, parallel) ** 2)


def thickness_coupling(series: float, parallel: float) -> float:
    """Coupling factor kt of the thickness mode of a wide plate from its two resonances (Hz).

    kt^2 = (pi / 2) (fs / fp) tan((pi / 2) (fp - fs) / fp), IEEE Std 176-1987.
    """
    ratio = _ratio(series, parallel)
    return math.sqrt(0.5 * math.pi * ratio * math.tan(0.5 * math.pi * (1.0 - ratio)))


def planar_coupling(series: float, parallel: float, poisson_ratio: float) -> float:
    """Coupling factor kp of the first radial mode of a thin disc from its two resonances (Hz).

    kp^2 / (1 - kp^2) = (1 - nu - x J0(x) / J1(x)) / (1 + nu) at x = x1 fp / fs, where x1 is the first root of
    x J0(x) = (1 - nu) J1(x): the planar resonance equation (Onoe, Tiersten and Meitzler 1963; IEEE Std 176-1987).
    """
    x = planar_root(poisson_ratio) / _ratio(series, parallel)
    squared = (1.0 - poisson_ratio - x * float(j0(x)) / float(j1(x))) / (1.0 + poisson_ratio)
    return math.sqrt(squared / (1.0 + squared))


def planar_root(poisson_ratio: float) -> float:
    """The first root of x J0(x) = (1 - nu) J1(x), 2 pi fs a over the speed of sound of a thin disc of radius a."""
    return float(brentq(lambda x: x * float(j0(x)) - (1.0 - poisson_ratio) * float(j1(x)), 1.0, 3.0))


def plate_of(chip: Chip, materials: Mapping[str, Material]) -> Plate | None:
    """The plate that a chip of one layer is; None for a stack, and for a shape or electrodes without the formulas."""
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
        raise ValueError(f"the parallel resonance must lie above the series one, received {parallel} and {series} Hz")
    return series / parallel
