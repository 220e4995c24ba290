"""Smooth inhomogeneity of the parts: relative fields of stiffness, density and loss that no model of a device has.

A field is a sum of products of cosines over a part,

    s(r, z) = rms sum_mn a_mn w_mn cos(pi m r / R) cos(pi n z / H),    w_mn ~ exp(-(k_mn l / 2)^2),

with normal a_mn of unit variance, r and z from the corner of a part of extents R and H: its correlation falls with the
distance d like exp(-d^2 / (2 l^2)), l half of the shortest wave of the part at mid-band. The rms is that over the part.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from concealed.section import Body, Grid, shortest
from numpy.typing import NDArray

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

#: What a part varies in.
KINDS = ("stiffness", "density", "loss")

#: Cosines of less than this share of the first are left out.
NEGLIGIBLE = 0.03

#: Root mean square of the fields, from and to.
SMOOTH = (2e-4, 3e-3)


@dataclass(frozen=True, eq=False)
class Cosines:
    """Numbers of half-waves along r and z, and the amplitude of each product of cosines (modes,): unit variance."""

    along_r: Integers
    along_z: Integers
    amplitude: Real

    @classmethod
    def of(cls, width: float, height: float, length: float) -> Cosines:
        """Those of a part of such extents (m) and correlation length (m)."""
        most = 2.0 * math.sqrt(-math.log(NEGLIGIBLE)) / (math.pi * length)
        numbers = (np.arange(int(most * extent) + 1) for extent in (width, height))
        m, n = (grid.ravel() for grid in np.meshgrid(*numbers, indexing="ij"))
        share = np.exp(-(0.5 * math.pi * length) ** 2 * ((m / width) ** 2 + (n / height) ** 2))
        kept = share >= NEGLIGIBLE
        m, n, share = m[kept], n[kept], share[kept]
        # The mean square of a cosine is one half.
        return cls(m, n, share / np.linalg.norm(share) * np.sqrt(np.where(m > 0, 2.0, 1.0) * np.where(n > 0, 2.0, 1.0)))

    def at(self, r: Real, z: Real) -> Real:
        """(points, modes) where r and z (points,) are shares of the part's extents."""
        return np.asarray(self.amplitude * np.cos(math.pi * r[:, None] * self.along_r)
                          * np.cos(math.pi * z[:, None] * self.along_z))


@dataclass(frozen=True, eq=False)
class Inhomogeneity:
    """Fields of all parts: their ``rms``, and by part the ``cosines`` and their ``factors`` (kinds, modes)."""

    rms: float
    cosines: Mapping[str, Cosines]
    factors: Mapping[str, Real]

    def values(self, body: Body, cells: Grid, i: Integers, j: Integers) -> dict[str, Real]:
        """Relative change (cells,) at the centres of cells i, j, by kind."""
        found = np.zeros((len(KINDS), i.size))
        for part, inside, shape in self.shapes(body, cells, i, j):
            found[:, inside] = self.rms * self.factors[part] @ shape.T
        return dict(zip(KINDS, found, strict=True))

    def shapes(self, body: Body, cells: Grid, i: Integers, j: Integers) -> list[tuple[str, Integers, Real]]:
        """Part by part: which of the cells i, j are in it, and its cosines (those cells, modes) at their centres."""
        r, z = 0.5 * (cells.r[i] + cells.r[i + 1]), 0.5 * (cells.z[j] + cells.z[j + 1])
        found = []
        for part, (r0, r1, z0, z1) in body.extents().items():
            inside = np.nonzero(cells.part[i, j] == cells.parts.index(part))[0]
            if part in self.cosines and inside.size:
                found.append((part, inside, self.cosines[part].at((r[inside] - r0) / (r1 - r0),
                                                                  (z[inside] - z0) / (z1 - z0))))
        return found


def random_inhomogeneity(rng: np.random.Generator, body: Body, frequency: float) -> Inhomogeneity:
    """Fields of the parts of a body, for mid-band at `frequency` (Hz)."""
    rms = float(math.exp(rng.uniform(math.log(SMOOTH[0]), math.log(SMOOTH[1]))))
    medium = {box.part: box.medium for box in reversed(body.boxes) if box.part and box.medium is not None}
    cosines = {part: Cosines.of(r1 - r0, z1 - z0, 0.5 * shortest(medium[part], frequency))
               for part, (r0, r1, z0, z1) in body.extents().items()}
    return Inhomogeneity(rms, cosines, {part: rng.standard_normal((len(KINDS), c.amplitude.size))
                                        for part, c in cosines.items()})


def scales(name: str, field: Mapping[str, Real]) -> tuple[Real, Real]:
    """By what a field multiplies the real and the imaginary part of the coefficient called `name`, (cells,) each."""
    stiff, heavy, lossy = (1.0 + field[kind] for kind in KINDS)
    match name:
        case "c11" | "c12" | "c13" | "c33" | "c44" | "c66":
            return stiff, stiff * lossy
        case "compressibility":
            return 1.0 / stiff, lossy / stiff
        case "density":
            return heavy, heavy
        case "inertia":
            return 1.0 / heavy, 1.0 / heavy
        case "shear":
            # A viscosity.
            return np.ones_like(lossy), lossy
        case _:
            return np.ones_like(stiff), np.ones_like(stiff)


def slopes(name: str, kind: str) -> tuple[float, float]:
    """Relative change of the real and the imaginary part of a coefficient by that of a field, where all are small."""
    step = 1e-6
    zero = {each: np.zeros(1) for each in KINDS}
    moved = scales(name, {**zero, kind: np.full(1, step)})
    return float(moved[0][0] - 1.0) / step, float(moved[1][0] - 1.0) / step
