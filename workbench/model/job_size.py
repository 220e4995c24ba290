"""The size of a job before meshing: unknowns, memory and time.

The unknowns follow from the lengths of the section, the wavelengths at the top of the band and the order of the fields.
Memory and time follow from them by the laws of nested dissection in two dimensions: a factor has of the order of N log
N entries, and a factorisation takes of the order of N^1.5 operations. For models that fit into a computer, the parts
linear in N dominate: the stored couplings of every unknown, (order + 1)^2 of a kind, and the states of a reduced model,
more with every full solve. `tests/benchmarks/job_size.py` measures the constants and prints them beside the peak of
real runs.
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
from workbench.jobs.memory import Room, free_memory, shown_memory
from workbench.model.discretisation import ROWS, Discretisation

#: Bytes per unknown and each of its (order + 1)^2 couplings of a kind. Doubled, the estimated memory of a job of order
#: 4 is half as much again.
COUPLING = 620.0

#: Bytes per unknown and full solve of a reduced model: the kept part of `reduction.DEPTH` complex states, and the
#: images of their basis. Doubled, the estimated memory of a job of 30 solves is half as much again.
SNAPSHOT = 700.0

#: Bytes of the factor per unknown and doubling of the unknowns (N log2 N).
FACTOR = 110.0

#: Bytes of libraries and small arrays, for any size of the job.
FIXED = 60e6

#: Bytes per frequency of a reduced spectrum: its state, right-hand side and residual on the reduced basis.
POINT = 5e3

#: Least number of frequencies of a spectrum. Doubled, spectra of 5 to 9 frequencies are refused.
LEAST_POINTS = 5

#: Least number of full solves of a reduced model, number per resonance in the band, and largest number.
LEAST_SOLVES, SOLVES_OF_RESONANCE, MOST_SOLVES = 8.3, 0.043, 40.0

#: Seconds per unknown and full solve, of the linear part and of the part with the power 1.5 (one core of about 3 GHz).
#: Doubled, the estimated time of every job is twice as long.
LINEAR, DISSECTION = 1.6e-5, 4e-8

#: Number of full solves above which the projection on their states takes longer than the linear part. Doubled, the
#: estimated time of wide bands is a third.
PROJECTED = 17.0

#: Share of the free memory for a job.
MEMORY_SHARE = 0.9

#: Ratio of the number of cells of a section of any shape to that of cells of the largest size: thin layers and curved
#: sides have smaller cells.
CURVED_CELLS = 2.0

#: Number of cells above which the sides of such a section are not divided to count them; ratio of the cells of a face
#: filled by gmsh to those of a square with as many sides around.
MOST_DIVIDED, FILLED = 1e6, 0.7

#: Environment variable for the memory of a process, such as "16 GB"; without it, the free memory applies.
MEMORY_VARIABLE = "WORKBENCH_MEMORY"

#: Number of halvings in the search for a band that fits; each halves the error of its end.
HALVINGS = 30


@dataclass(frozen=True)
class JobSize:
    """Cost of a model of one state.

    ``unknowns``; full ``solves`` of its reduced model; peak ``memory`` in bytes; ``seconds`` on one core. The estimates
    are within a third for unknowns, a half for memory, a factor of two for time.
    """

    unknowns: float
    solves: float
    memory: float
    seconds: float

    def __str__(self) -> str:
        return (f"{_rounded(self.unknowns)} unknowns, with about {shown_memory(self.memory)} of memory and "
                f"{shown_time(self.seconds)}")


def job_size(
    section: Section | FreeSection, materials: Mapping[str, Material], made: Discretisation, band: tuple[float, float],
    *, skins: Mapping[str, float] | None = None, radii: Sequence[float] = (), levels: Sequence[float] = (),
) -> JobSize:
    """The size of the model of a filled `section` and `band` (Hz)."""
    size = made.mesh_size(section, materials, band[1], skins=skins, radii=radii, levels=levels)
    cells = _cells(section, size)
    unknowns = sum(_components(materials[region]) * (made.order**2 * inside + made.order * beside)
                   for region, (inside, beside) in cells.items() if region in materials)
    return of_unknowns(unknowns, made.order, resonances(section, materials, band))


def of_unknowns(unknowns: float, order: int, modes: float) -> JobSize:
    """Memory and time of a model from its number of unknowns. `order` is that of its fields; `modes` is the number of
    resonances in its band."""
    solves = min(MOST_SOLVES, LEAST_SOLVES + SOLVES_OF_RESONANCE * modes)
    each = COUPLING * (order + 1) ** 2 + SNAPSHOT * solves + FACTOR * math.log2(max(unknowns, 2.0))
    seconds = solves * (LINEAR * (1.0 + (solves / PROJECTED) ** 2) * unknowns + DISSECTION * unknowns**1.5)
    return JobSize(unknowns, solves, FIXED + each * unknowns, seconds)


def resonances(
    section: Section | FreeSection, materials: Mapping[str, Material], band: tuple[float, float]
) -> float:
    """Approximate number of resonances in a band (Hz). It is the sum over the regions of pi times the area in squares
    of the slowest wavelength (Weyl's law in two dimensions)."""
    return sum(math.pi * section.area(region) * (band[1] ** 2 - band[0] ** 2) / material.slowest_wave_speed() ** 2
               for region, material in materials.items())


def check_size(
    section: Section | FreeSection, materials: Mapping[str, Material], made: Discretisation, band: tuple[float, float],
    *, source: str, skins: Mapping[str, float] | None = None, radii: Sequence[float] = (), levels: Sequence[float] = (),
) -> JobSize:
    """The size of a job, checked against the memory of this machine.

    Raises:
        InputError: the memory is too small; the error states the largest job that fits.
    """
    def sized(how: Discretisation, ends: tuple[float, float]) -> JobSize:
        return job_size(section, materials, how, ends, skins=skins, radii=radii, levels=levels)

    found, room = sized(made, band), memory_to_use()
    if found.memory <= room.size:
        return found
    fitting = _fitting_jobs(sized, made, band, room.size)
    raise InputError(source, "size of the model", f"{band[0] / 1e6:.4g} to {band[1] / 1e6:.4g} MHz: {found}",
                     f"at most {shown_memory(room.size)}, {room.limit}: {fitting}", _lost_point(band))


def check_points(points: int, *, source: str, field: str = "points") -> None:
    """Check a number of frequencies of a spectrum.

    Raises:
        InputError: too few, or more than the memory has room for; the error states the largest number that fits.
    """
    if points < LEAST_POINTS:
        raise InputError(source, field, points, f"at least {LEAST_POINTS} frequencies")
    room = memory_to_use()
    if POINT * points > room.size:
        raise InputError(source, field, points, f"at most {_rounded(room.size / POINT)}: every frequency takes "
                         f"{POINT / 1e3:.0f} kB of {shown_memory(room.size)}, {room.limit}")


def memory_to_use() -> Room:
    """The memory that a job may take.

    It is the value of :data:`MEMORY_VARIABLE`, or :data:`MEMORY_SHARE` of the free memory.

    Raises:
        InputError: the variable is not an amount of memory.
    """
    stated = os.environ.get(MEMORY_VARIABLE)
    if stated is None:
        free = free_memory()
        return Room(MEMORY_SHARE * free.size, f"{free.limit} ({MEMORY_VARIABLE} states another amount)")
    size = parse_quantity(stated, "memory", source="environment", field=MEMORY_VARIABLE)
    if not size > 0.0:
        raise InputError("environment", MEMORY_VARIABLE, stated, 'an amount of memory above zero, such as "16 GB"')
    return Room(size, f"the memory in {MEMORY_VARIABLE}")


def shown_time(seconds: float) -> str:
    """A time (s) as text for messages."""
    for unit, factor in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * factor:
            return f"{seconds / factor:.2g} {unit}"
    return f"{seconds:.2g} s"


def _rounded(number: float) -> str:
    """A number with three digits, in words from a million on."""
    if number >= 1e9:
        return f"{number / 1e9:.3g} billion"
    if number >= 1e6:
        return f"{number / 1e6:.3g} million"
    return f"{float(f'{number:.3g}'):,.0f}".replace(",", " ")


def _components(material: Material) -> int:
    """Number of unknown fields in a material. A fluid has a pressure, a solid two displacements, a piezoelectric solid
    a potential too."""
    if isinstance(material, Fluid):
        return 1
    return 3 if isinstance(material, Piezoelectric) else 2


def _cells(section: Section | FreeSection, size: MeshSize) -> dict[str, tuple[float, float]]:
    """Cells of every region, and half the number along its outline. The remaining nodes lie along the outline."""
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
    """Cells as in :func:`_cells`, for a section of any shape. They follow from the divisions of its sides, unless there
    are too many."""
    found = {}
    for region in section.regions:
        inside = CURVED_CELLS * section.area(region) / size.largest_element(region) ** 2
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
        else:  # gmsh fills it with cells of the sides' sizes.
            around = sum(along[edge] for loop in layout.loops[face] for edge, _ in loop)
            inside, beside = FILLED * around**2 / 16.0, 0.5 * around
        before = counted.get(region, (0.0, 0.0))
        counted[region] = (before[0] + inside, before[1] + beside)
    return counted


def _fitting_jobs(
    sized: Callable[[Discretisation, tuple[float, float]], JobSize], made: Discretisation, band: tuple[float, float],
    room: float,
) -> str:
    """The accuracy and the band that would fit, in words."""
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
    """The probable band after a lost decimal point or prefix."""
    low, high = band
    for lost in (10.0, 100.0, 1000.0):
        if low < high / lost <= 3.0 * low:
            return (f"{low / 1e6:.4g} to {high / lost / 1e6:.4g} MHz",)
    return ()
