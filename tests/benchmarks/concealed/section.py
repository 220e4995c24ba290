"""Sections of axisymmetric bodies: rectangles of media, what acts on their faces, and the grid of cells on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from concealed.media import Hold, Liquid, Load, Medium, Necks, Piezo, Solid, Viscous
from numpy.typing import NDArray

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME = 1e-10  # metres

#: Cells per shortest wavelength; of fifth order two give 0.1 % of Z in a chip.
CELLS = 2.0


@dataclass(frozen=True)
class Box:
    """A rectangle r0..r1, z0..z1 (m) of a medium; None for nothing. Later boxes replace earlier ones. ``part`` names
    the part of the device that it belongs to, if any."""

    r0: float
    r1: float
    z0: float
    z1: float
    medium: Medium | None
    part: str = ""


@dataclass(frozen=True)
class Face:
    """A straight piece of a surface: z0 == z1 when it lies flat, r0 == r1 when it stands; what acts on it."""

    r0: float
    r1: float
    z0: float
    z1: float
    surface: Load | Hold | Necks


@dataclass(frozen=True)
class Profile:
    """A function of one coordinate, nothing outside of its first and last point (m): linear between ``points`` (m,
    value), or a parabola that is 1 in the middle of the first and the last and 0 there."""

    points: tuple[tuple[float, float], ...]
    parabola: bool = False

    def __call__(self, at: Real) -> Real:
        places, values = np.array(self.points).T
        if self.parabola:
            a, b = places[0], places[-1]
            return np.asarray(np.maximum(4.0 * (at - a) * (b - at) / (b - a) ** 2, 0.0))
        return np.interp(at, places, values, left=0.0, right=0.0)


@dataclass(frozen=True)
class Warp:
    """Points that are not where the boxes have them: moved along r, or else along z, by ``size`` (m) times a profile in
    r and one in z, whose kinks lie on lines of the grid."""

    radially: bool
    size: float
    in_r: Profile
    in_z: Profile


@dataclass(frozen=True)
class Body:
    """Boxes, faces, both electrodes as (z, inner radius, outer radius), where the grid needs further lines, and how all
    that is warped."""

    boxes: tuple[Box, ...]
    live: tuple[float, float, float]
    ground: tuple[float, float, float]
    faces: tuple[Face, ...] = ()
    lines_r: tuple[float, ...] = ()
    lines_z: tuple[float, ...] = ()
    warps: tuple[Warp, ...] = ()

    def warped(self, r: Real, z: Real) -> tuple[Real, Real]:
        """Where the nodes on lines r (n,) and z (m,) of the grid are: (n, m) each, m."""
        found = [np.broadcast_to(r[:, None], (r.size, z.size)).copy(), np.broadcast_to(z, (r.size, z.size)).copy()]
        for warp in self.warps:
            found[0 if warp.radially else 1] += warp.size * np.outer(warp.in_r(r), warp.in_z(z))
        return found[0], found[1]

    def extents(self) -> dict[str, tuple[float, float, float, float]]:
        """r0, r1, z0, z1 (m) of every part that has a name."""
        found: dict[str, tuple[float, float, float, float]] = {}
        for box in self.boxes:
            if box.part:
                r0, r1, z0, z1 = found.get(box.part, (math.inf, -math.inf, math.inf, -math.inf))
                found[box.part] = min(r0, box.r0), max(r1, box.r1), min(z0, box.z0), max(z1, box.z1)
        return found


@dataclass(frozen=True, eq=False)
class Grid:
    """Lines of the grid (m), the indices of the medium and of the part of every cell, (cells along r, cells along z),
    -1: none, and how many cells lie between neighbouring breaks."""

    r: Real
    z: Real
    media: tuple[Medium, ...]
    fill: Integers
    parts: tuple[str, ...]
    part: Integers
    counts: tuple[tuple[int, ...], tuple[int, ...]]


def _distinct(values: Sequence[float]) -> Real:
    ordered = np.sort(np.array(values))
    return ordered[np.concatenate([[True], np.diff(ordered) > SAME])]


def shortest(medium: Medium, frequency: float) -> float:
    """Shortest wavelength (m) in a medium; in a viscous fluid that of sound, its layers are asked for by lines."""
    match medium:
        case Solid() | Piezo():
            slow = min(abs(medium.c44), 0.5 * abs(medium.c11 - medium.c12))
            return math.sqrt(slow / abs(medium.density)) / frequency
        case Viscous() | Liquid():
            w = np.array([2.0 * np.pi * frequency])
            kappa = complex(np.asarray(medium.coefficients(w)["compressibility"]).ravel()[0])
            return 1.0 / math.sqrt(abs(kappa) * abs(medium.density)) / frequency
        case _:
            raise TypeError(f"received {medium!r}; expected a solid, a ceramic or a liquid")


def grid(body: Body, frequency: float, *, per_wavelength: float | None = None,
         counts: tuple[tuple[int, ...], tuple[int, ...]] | None = None) -> Grid:
    """The grid of a body for frequencies up to `frequency` (Hz): cells of at most a `per_wavelength`-th (CELLS unless
    given) of the shortest wave beside them. `counts` (cells between neighbouring breaks) makes the same grid on a body
    slightly changed."""
    breaks = (_distinct([x for b in body.boxes for x in (b.r0, b.r1)] + [*body.lines_r, *body.live[1:],
                                                                         *body.ground[1:]]),
              _distinct([x for b in body.boxes for x in (b.z0, b.z1)] + list(body.lines_z)))
    media = tuple(dict.fromkeys(b.medium for b in body.boxes if b.medium is not None))
    coarse = _index(body, *breaks, [-1 if b.medium is None else media.index(b.medium) for b in body.boxes])
    wanted = CELLS if per_wavelength is None else per_wavelength
    waves = np.array([*(shortest(m, frequency) for m in media), np.inf])[coarse]
    lines, numbers = [], []
    for axis, at in enumerate(breaks):
        per_strip = waves.min(axis=1 - axis)
        given = None if counts is None else counts[axis]
        if given is None:
            given = tuple(max(1, math.ceil(d / w * wanted - 1e-9)) for d, w in
                          zip(np.diff(at), per_strip, strict=True))
        if len(given) != at.size - 1:
            raise ValueError("the body has changed so much that its grid has other breaks")
        numbers.append(given)
        lines.append(np.concatenate([*(np.linspace(a, b, n, endpoint=False) for a, b, n in
                                       zip(at, at[1:], given, strict=False)), at[-1:]]))
    parts = tuple(dict.fromkeys(b.part for b in body.boxes if b.part))
    fill = _index(body, lines[0], lines[1], [-1 if b.medium is None else media.index(b.medium) for b in body.boxes])
    part = _index(body, lines[0], lines[1], [parts.index(b.part) if b.part else -1 for b in body.boxes])
    return Grid(lines[0], lines[1], media, fill, parts, part, (numbers[0], numbers[1]))


def _index(body: Body, r: Real, z: Real, each: Sequence[int]) -> Integers:
    """What `each` box says, in every cell; -1 where there is none."""
    found = np.full((r.size - 1, z.size - 1), -1)
    mid_r, mid_z = 0.5 * (r[1:] + r[:-1]), 0.5 * (z[1:] + z[:-1])
    for box, number in zip(body.boxes, each, strict=True):
        found[np.ix_((mid_r > box.r0) & (mid_r < box.r1), (mid_z > box.z0) & (mid_z < box.z1))] = number
    return found
