"""Check of the conditions under which a fitted material is used."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

from materials.kinds import Material

#: Largest relative difference of equal densities and bands, which are decimal numbers in files.
_SAME = 1e-6


class UseWarning(UserWarning):
    """A fitted material is used outside its band or with another density."""


def check_use(materials: Iterable[Material], *, band: tuple[float, float]) -> None:
    """Warn of fitted materials outside the conditions of their fit.

    A free disc determines its ten constants per density only (all of them scale with it), and losses change with
    frequency.

    Args:
        materials: with the density in use.
        band: the frequencies in use (Hz).

    Warns:
        UseWarning: with both numbers.
    """
    for material in {material.name: material for material in materials}.values():
        fit = material.fit
        if fit is None:
            continue
        if band[0] < fit.band[0] * (1.0 - _SAME) or band[1] > fit.band[1] * (1.0 + _SAME):
            warnings.warn(
                f"{material.name} was fitted from {fit.band[0] / 1e6:.6g} to {fit.band[1] / 1e6:.6g} MHz and is used "
                f"from {band[0] / 1e6:.6g} to {band[1] / 1e6:.6g} MHz", UseWarning, stacklevel=2)
        if fit.density is not None and abs(material.density - fit.density) > _SAME * fit.density:
            warnings.warn(
                f"{material.name} was fitted with a density of {fit.density:g} kg/m^3 and is used with "
                f"{material.density:g} kg/m^3", UseWarning, stacklevel=2)
