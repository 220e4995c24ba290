"""How large a job is before a mesh is made: unknowns, memory and time, and whether this machine has room for it.

The unknowns follow from the lengths of the section, the wavelengths at the top of the band and the order of the fields,
with no mesh made. Memory and time follow from them by the laws of nested dissection in two dimensions: a factor holds
of the order of N log N entries, and a factorisation takes of the order of N^1.5 operations. On the meshes that a
computer has room for, what is linear in N outweighs both: the stored couplings of every unknown, (order + 1)^2 of a
kind, and the states that a reduced model is made from, some more with every full solve. The constants are measured by
`tests/benchmarks/job_size.py`, which prints them beside the peak of real runs.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.free_section import FreeSection
from geometry.layout import divisions, laid_out
from geometry.mesh_size import MeshSize
from geometry.panels import divided
from geometry.section import Section
from materials.kinds import Fluid, Piezoelectric
from materials.registry import Material
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.model.discretisation import ROWS, Discretisation

#: Bytes that one unknown takes for each of the (order + 1)^2 couplings of a kind. Doubled, a job of order 4 is said to
#: take half as much again.
COUPLING = 620.0

#: Bytes of one unknown for each full solve of a reduced model: what is kept of `reduction.DEPTH` complex states, and of
#: the images of the basis made of them. Doubled, a job of 30 solves is said to take half as much again.
SNAPSHOT = 700.0

#: Bytes of the factor for each unknown and doubling of the unknowns (N log2 N).
FACTOR = 110.0

#: Bytes that libraries and small arrays take whatever the size of the job.
FIXED = 60e6

#: Bytes of one frequency of a reduced spectrum: its state, right-hand side and residual on the reduced basis.
POINT = 5e3

#: Full solves of a reduced model, at least, and for every resonance in the band; never more than the limit.
SOLVES, SOLVES_OF_RESONANCE, MOST_SOLVES = 8.3, 0.043, 40.0

#: Seconds per unknown and full solve of what is linear in the unknowns, and of what grows with their power of 1.5 (one
#: core of some 3 GHz). Doubled, every job is said to take twice as long.
LINEAR, DISSECTION = 1.6e-5, 4e-8

#: Full solves from which on projecting the model on their states takes longer than what is linear in the unknowns.
#: Doubled, wide bands are said to take a third of the time.
PROJECTED = 17.0

#: Share of the memory that is free which a job may take; the rest is for whatever else runs by then.
SHARE = 0.9

#: Cells of a section of any shape over the area of a region by that of its largest cell: thin layers and curved sides
#: have smaller ones.
CURVED = 2.0

#: Cells of such sections from which on their sides are not divided to count them; and cells of a face that gmsh fills,
#: over those of a square of as many sides around.
MOST_DIVIDED, FILLED = 1e6, 0.7

#: Names the memory that jobs may take, such as "16 GB", in place of what the system says is free.
CHOICE = "WORKBENCH_MEMORY"

#: Halvings of a band in search of one that fits: its end to a part in so many powers of two.
HALVINGS = 30


@dataclass(frozen=True)
class JobSize:
    """What a model of one state takes: ``unknowns``, full ``solves`` of its reduced model, ``memory`` in bytes at its
    peak, ``seconds`` on one core. Estimates: within a third for unknowns, a half for memory, a factor of two for time.
    """

    unknowns: float
    solves: float
    memory: float
    seconds: float

    def __str__(self) -> str:
        return (f"{_rounded(self.unknowns)} unknowns, which take about {shown_memory(self.memory)} of memory and "
                f"{shown_time(self.seconds)}")


def job_size(
    section: Section | FreeSection, materials: Mapping[str, Material], made: Discretisation, band: tuple[float, float],
    *, skins: Mapping[str, float] | None = None, radii: Sequence[float] = (),
) -> JobSize:
    """The size of the model of a `section` filled with `materials`, meshed for a `band` (Hz)."""
    size = made.mesh_size(section, materials, band[1], skins=skins, radii=radii)
    cells = _cells(section, size)
    unknowns = sum(_components(materials[region]) * (made.order**2 * inside + made.order * beside)
                   for region, (inside, beside) in cells.items() if region in materials)
    return of_unknowns(unknowns, made.order, resonances(section, materials, band))


def of_unknowns(unknowns: float, order: int, modes: float) -> JobSize:
    """Memory and time of a model of so many unknowns of fields of an `order`, with `modes` resonances in its band."""
    solves = min(MOST_SOLVES, SOLVES + SOLVES_OF_RESONANCE * modes)
    each = COUPLING * (order + 1) ** 2 + SNAPSHOT * solves + FACTOR * math.log2(max(unknowns, 2.0))
    seconds = solves * (LINEAR * (1.0 + (solves / PROJECTED) ** 2) * unknowns + DISSECTION * unknowns**1.5)
    return JobSize(unknowns, solves, FIXED + each * unknowns, seconds)


def resonances(
    section: Section | FreeSection, materials: Mapping[str, Material], band: tuple[float, float]
) -> float:
    """About how many resonances lie in a band (Hz): for every region the area, in squares of its slowest wavelength,
    times pi (Weyl's law in two dimensions)."""
    return sum(math.pi * section.area(region) * (band[1] ** 2 - band[0] ** 2) / material.slowest_wave_speed() ** 2
               for region, material in materials.items())


def check_size(
    section: Section | FreeSection, materials: Mapping[str, Material], made: Discretisation, band: tuple[float, float],
    *, source: str, skins: Mapping[str, float] | None = None, radii: Sequence[float] = (),
) -> JobSize:
    """The size of a job that this machine has the memory for.

    Raises:
        InputError: it has not; the error says what would fit.
    """
    def sized(how: Discretisation, ends: tuple[float, float]) -> JobSize:
        return job_size(section, materials, how, ends, skins=skins, radii=radii)

    found, room = sized(made, band), memory_to_use()
    if room is None or found.memory <= room:
        return found
    fitting = _what_fits(sized, made, band, room)
    raise InputError(source, "size of the model", f"{band[0] / 1e6:.4g} to {band[1] / 1e6:.4g} MHz: {found}",
                     f"at most {shown_memory(room)}, the memory that is free here ({CHOICE} states another): {fitting}",
                     _lost_point(band))


def check_points(points: int, *, source: str) -> None:
    """Refuse more frequencies than there is memory for.

    Raises:
        InputError: too many; the error says how many would fit.
    """
    room = memory_to_use()
    if room is not None and POINT * points > room:
        raise InputError(source, "points", points, f"at most {_rounded(room / POINT)}: every frequency takes "
                         f"{POINT / 1e3:.0f} kB, and {shown_memory(room)} of memory are free here")


def memory_to_use() -> float | None:
    """Bytes of memory that a job may take: what :data:`CHOICE` states, or :data:`SHARE` of what is free; None where
    the system does not say.

    Raises:
        InputError: the environment states no amount of memory.
    """
    stated = os.environ.get(CHOICE)
    if stated is not None:
        found = parse_quantity(stated, "memory", source="environment", field=CHOICE)
        if not found > 0.0:
            raise InputError("environment", CHOICE, stated, 'an amount of memory above zero, such as "16 GB"')
        return found
    free = free_memory()
    return None if free is None else SHARE * free


def free_memory() -> float | None:
    """Bytes of physical memory that are free for programs: of the machine, or of the container this runs in."""
    found = []
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            found += [1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except OSError:
        names = os.sysconf_names if hasattr(os, "sysconf_names") else {}
        if {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= set(names):  # no Linux: all there is
            found.append(float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE")))
    for most, used in (("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
                       ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes")):
        limit, taken = _number_in(most), _number_in(used)
        if limit is not None and taken is not None:
            found.append(max(limit - taken, 0.0))
    return min(found, default=None)


def shown_memory(size: float) -> str:
    """Bytes as messages show them."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size / 1e6:.3g} MB"


def shown_time(seconds: float) -> str:
    """A time as messages show it."""
    for unit, factor in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * factor:
            return f"{seconds / factor:.2g} {unit}"
    return f"{seconds:.2g} s"


def _rounded(number: float) -> str:
    """A number of things in three digits, in words from a million on."""
    if number >= 1e9:
        return f"{number / 1e9:.3g} billion"
    if number >= 1e6:
        return f"{number / 1e6:.3g} million"
    return f"{float(f'{number:.3g}'):,.0f}".replace(",", " ")


def _number_in(path: str) -> float | None:
    try:
        with open(path, encoding="ascii") as stream:
            return float(stream.read())
    except (OSError, ValueError):
        return None  # no such file, or no limit: "max"


def _components(material: Material) -> int:
    """Unknown fields in a material: pressure, or two displacements, with a potential where it is piezoelectric."""
    if isinstance(material, Fluid):
        return 1
    return 3 if isinstance(material, Piezoelectric) else 2


def _cells(section: Section | FreeSection, size: MeshSize) -> dict[str, tuple[float, float]]:
    """Cells of every region, and how many lie along its outline, halved: what nodes there are besides is along that."""
    if isinstance(section, FreeSection):
        return _cells_of_faces(section, size)
    along_r, along_z = divided(section, size)
    grid = section.grid()
    columns, rows = np.zeros(grid.shape[1]), np.zeros(grid.shape[0])
    for count, panels in ((columns, along_r), (rows, along_z)):
        for panel in panels:
            count[panel.interval] += panel.count
    found = {}
    for index, region in enumerate(section.regions):
        there = grid == index
        across, up = columns @ there.any(axis=0), rows @ there.any(axis=1)
        found[region] = (float(rows @ there @ columns), float(across + up))
    return found


def _cells_of_faces(section: FreeSection, size: MeshSize) -> dict[str, tuple[float, float]]:
    """See :func:`_cells`, of a section of any shape: by how its sides are to be divided, unless there are too many."""
    found = {}
    for region in section.regions:
        inside = CURVED * section.area(region) / size.largest_element(region) ** 2
        found[region] = (inside, 2.0 * math.sqrt(inside))
    if sum(inside for inside, _ in found.values()) > MOST_DIVIDED:
        return found
    layout = laid_out(section, size)
    along = [float(shares.size - 1) for shares in divisions(layout, section, size)]
    counted: dict[str, tuple[float, float]] = {}
    for face, region in enumerate(layout.regions):
        if face in layout.sides:
            across, up = (sum(along[edge] for edge, _ in side) for side in layout.sides[face][:2])
            inside, beside = across * up, across + up
        else:  # gmsh fills it with cells that its sides pass on
            around = sum(along[edge] for loop in layout.loops[face] for edge, _ in loop)
            inside, beside = FILLED * around**2 / 16.0, 0.5 * around
        before = counted.get(region, (0.0, 0.0))
        counted[region] = (before[0] + inside, before[1] + beside)
    return counted


def _what_fits(
    sized: Callable[[Discretisation, tuple[float, float]], JobSize], made: Discretisation, band: tuple[float, float],
    room: float,
) -> str:
    """Which accuracy and which band would fit, in words."""
    words = []
    coarser = [accuracy for accuracy, row in sorted(ROWS.items()) if sized(row, band).memory <= room]
    if coarser and made in ROWS.values():
        words.append(f"the accuracy {100.0 * coarser[0]:g} %")
    low, high = band
    if sized(made, (0.5 * low, low)).memory <= room:
        fits, too_high = low, high
        for _ in range(HALVINGS):
            middle = math.sqrt(fits * too_high)
            fits, too_high = (middle, too_high) if sized(made, (low, middle)).memory <= room else (fits, middle)
        words.append(f"a band that ends at {0.99 * fits / 1e6:.3g} MHz" if 0.99 * fits > low else
                     f"a band below {low / 1e6:.3g} MHz")
    return " or ".join(words) + " would fit" if words else "neither another accuracy nor a lower band would fit"


def _lost_point(band: tuple[float, float]) -> tuple[str, ...]:
    """The band that is meant where the point of one end was lost, or its prefix."""
    low, high = band
    for lost in (10.0, 100.0, 1000.0):
        if low < high / lost <= 3.0 * low:
            return (f"{low / 1e6:.4g} to {high / lost / 1e6:.4g} MHz",)
    return ()
