"""Faces filled by gmsh with triangles and quadrilaterals, then cut into quadrilaterals."""

from __future__ import annotations

import ctypes
import math
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from threading import RLock
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from geometry.kernel import MILLIMETRES
from geometry.layout import SectionLayout, numbers_along
from geometry.mesh import MeshError
from geometry.mesh_size import MeshSize

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Two sides of an element on the edge of a face that turn by less than this (degrees) belong to one smooth line.
FLAT_TURN = 40.0


#: Threads take turns, since gmsh is one session for the whole process.
_GMSH_TURN = RLock()


def _keep_broken_pipes_errors() -> None:
    """Restore Python's SIGPIPE handling: gmsh makes writing to a closed pipe fatal. It works from any thread;
    :func:`signal.signal` does not."""
    if hasattr(signal, "SIGPIPE") and signal.getsignal(signal.SIGPIPE) is signal.SIG_IGN:
        set_handler = ctypes.pythonapi.PyOS_setsig
        set_handler.argtypes, set_handler.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_void_p
        set_handler(signal.SIGPIPE, int(signal.SIG_IGN))


@contextmanager
def gmsh_session() -> Iterator[ModuleType]:
    """Start gmsh with its defaults, and shut it down on leaving.

    gmsh is one global session with global options; a new session for every mesh keeps meshes independent.

    Raises:
        MeshError: gmsh is not installed, or a session is open already.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MeshError(f"meshing needs gmsh and its system libraries: {error}") from error
    with _GMSH_TURN:
        if gmsh.isInitialized():
            raise MeshError("a gmsh session is open already; close it before meshing a section")
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        _keep_broken_pipes_errors()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            yield gmsh
        finally:
            gmsh.finalize()


def freely(
    layout: SectionLayout, faces: Sequence[int], along: Sequence[Integers], points: Real, size: MeshSize
) -> Iterator[tuple[Real, Integers]]:
    """Fill faces with gmsh: inner points (2, n) and cells (4, m). Inner points are numbered from the number of existing
    `points` (2, count) on."""
    if not faces:
        return
    with gmsh_session() as gmsh:
        geo = gmsh.model.geo
        tags: dict[int, int] = {}
        lines: dict[tuple[int, int], int] = {}

        def point(number: int) -> int:
            if number not in tags:
                r, z = MILLIMETRES * points[:, number]  # The tolerances of gmsh are made for such numbers.
                tags[number] = geo.addPoint(r, z, 0.0)
            return tags[number]

        def line(begin: int, end: int) -> int:
            if (end, begin) in lines:
                return -lines[end, begin]
            if (begin, end) not in lines:
                lines[begin, end] = geo.addLine(point(begin), point(end))
                geo.mesh.setTransfiniteCurve(lines[begin, end], 2)
            return lines[begin, end]

        surfaces = []
        for face in faces:
            loops = []
            for loop in layout.loops[face]:
                every = numbers_along(loop, along)[::2]
                loops.append(geo.addCurveLoop([line(int(a), int(b)) for a, b in pairwise(every)]))
            surfaces.append(geo.addPlaneSurface(loops))
            geo.mesh.setRecombine(2, surfaces[-1])
        geo.synchronize()
        limits = {surface: 2.0 * MILLIMETRES * size.largest_element(layout.regions[face])
                  for face, surface in zip(faces, surfaces, strict=True)}
        gmsh.option.setNumber("Mesh.Algorithm", 8)
        # The default joins triangles across a boundary that is not straight.
        gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 0)
        gmsh.model.mesh.setSizeCallback(
            lambda dim, tag, x, y, z, lc: min(lc, limits.get(tag, lc)) if dim == 2 else lc)
        try:
            gmsh.model.mesh.generate(2)
        except Exception as error:
            raise MeshError(f"gmsh cannot fill a face of {', '.join({layout.regions[f] for f in faces})}: {error}"
                            ) from error
        known = {int(gmsh.model.mesh.getNodes(0, tag)[0][0]): number for number, tag in tags.items()}
        for face, surface in zip(faces, surfaces, strict=True):
            halves = {}
            for loop in layout.loops[face]:
                every = numbers_along(loop, along).tolist()
                for a, middle, b in zip(every[:-1:2], every[1::2], every[2::2], strict=True):
                    halves[min(a, b), max(a, b)] = middle
            elements, inner = _elements(gmsh, surface, known, points)
            own, cells = _subdivided(elements, halves, points, inner)
            points = np.concatenate([points, own], axis=1)
            yield own, cells


def _elements(
    gmsh: ModuleType, surface: int, known: Mapping[int, int], points: Real
) -> tuple[list[list[int]], Real]:
    """Elements of a surface filled by gmsh, and inner points (2, n). Elements have anticlockwise corners. Inner points
    are numbered from the number of `points` (2, count) on. `known` maps gmsh tags to numbers of these."""
    kinds, _, members = gmsh.model.mesh.getElements(2, surface)
    tags, coordinates, _ = gmsh.model.mesh.getNodes(2, surface)
    inner = coordinates.reshape(-1, 3)[:, :2].T / MILLIMETRES
    number = {**known, **{int(tag): points.shape[1] + place for place, tag in enumerate(tags)}}
    where = np.concatenate([points, inner], axis=1)
    elements = []
    for kind, nodes in zip(kinds, members, strict=True):
        for element in np.asarray(nodes, dtype=np.int64).reshape(-1, {2: 3, 3: 4}[int(kind)]).tolist():
            corners = [number[tag] for tag in element]
            r, z = where[:, corners]
            clockwise = np.sum(r * np.roll(z, -1) - np.roll(r, -1) * z) < 0.0
            elements.append(corners[::-1] if clockwise else corners)
    return elements, inner


def _opened(elements: list[list[int]], edge_sides: set[tuple[int, int]], at: Callable[[int], Real]) -> list[list[int]]:
    """Elements without flat corners on the edge of a face.

    An element with two consecutive sides on a smooth part of `edge_sides` (pairs of points, smaller number first) would
    get a quadrilateral with a corner of 180 degrees. A quadrilateral is halved from that corner; a triangle is joined
    with the element behind it, and both are divided from there.
    """
    found = [list(element) for element in elements]
    for place, element in enumerate(found):
        corner = _flat(element, edge_sides, at)
        if corner is None:
            continue
        ring = element[corner:] + element[:corner]  # the corner first
        if len(ring) == 3:
            a, b = ring[1], ring[2]
            behind = next((k for k, other in enumerate(found) if k != place and {a, b} <= set(other)), None)
            if behind is None:
                continue
            other = found[behind]
            begin = next(k for k in range(len(other)) if {other[k - 1], other[k]} == {a, b})
            ring = [ring[0], *other[begin:], *other[:begin]] if other[begin] == a else [
                ring[0], *(other[begin:] + other[:begin])]
            found[behind] = []
        found[place] = [ring[0], ring[1], ring[2]]
        found += [[ring[0], ring[k], ring[k + 1]] for k in range(2, len(ring) - 1)]
    return [element for element in found if element]


def _flat(element: Sequence[int], edge_sides: set[tuple[int, int]], at: Callable[[int], Real]) -> int | None:
    """The corner of an element with two flat sides on the edge. None if there is none."""
    for k in range(len(element)):
        before, here, after = element[k - 1], element[k], element[(k + 1) % len(element)]
        if all((min(pair), max(pair)) in edge_sides for pair in ((before, here), (here, after))):
            (r0, z0), (r1, z1) = at(here) - at(before), at(after) - at(here)
            if abs(math.degrees(math.atan2(r0 * z1 - z0 * r1, r0 * r1 + z0 * z1))) < FLAT_TURN:
                return k
    return None


def _subdivided(
    elements: Sequence[Sequence[int]], halves: Mapping[tuple[int, int], int], points: Real, inner: Real
) -> tuple[Real, Integers]:
    """Cut elements into quadrilaterals: inner points (2, n), cells (4, m).

    Args:
        elements: numbers of their corners, anticlockwise.
        halves: the midpoint of every side on the edge of the face, by the numbers of its ends.
        points: existing points (2, count) in metres; new ones are numbered from there on.
        inner: the first inner points (2, k).
    """
    added, count = list(inner.T), points.shape[1]
    middles = dict(halves)

    def new(place: Real) -> int:
        added.append(place)
        return count + len(added) - 1

    def at(number: int) -> Real:
        return points[:, number] if number < count else added[number - count]

    def middle(a: int, b: int) -> int:
        pair = (min(a, b), max(a, b))
        if pair not in middles:
            middles[pair] = new(0.5 * (at(a) + at(b)))
        return middles[pair]

    cells = []
    for element in _opened([list(each) for each in elements], set(halves), at):
        sides = [middle(a, b) for a, b in pairwise([*element, element[0]])]
        centre = new(np.mean([at(each) for each in sides], axis=0))
        for k, corner in enumerate(element):
            cells.append((corner, sides[k], centre, sides[k - 1]))
    own = np.stack(added, axis=1) if added else np.empty((2, 0))
    return own, np.array(cells, dtype=np.int64).T


