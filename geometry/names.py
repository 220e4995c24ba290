"""The closed vocabulary of regions and boundaries.

A chip is a stack of layers. Every layer has a role from :data:`ROLES`; its region has the name of its role, with
``_2``, ``_3``, ... appended if the role occurs again further up. The holes through the layers together are the region
:data:`CAVITY`, further closed cavities ``cavity_2``, ``cavity_3``, ... from below. Boundaries are called :data:`AXIS`,
:data:`PLANE_LEFT`, :data:`PLANE_RIGHT`, :data:`ELECTRODE_LIVE` with its parts :data:`ELECTRODE_REVERSED` and
:data:`ELECTRODE_IDLE`, :data:`ELECTRODE_GROUND`,
``<region>|<region>`` (alphabetical, :func:`interface`) and ``<region>|outside`` (:func:`outside`). A part of one of
these within one layer of the stack is ``<place>@<layer>`` (:func:`part_name`), and a part of that within one column
between two radii ``<place>@<layer>#<column>``. The cells of any of these that the same shapes of layers move are
``<place>~<shape>`` (:func:`moved_by`). No other name of a place exists anywhere.
"""

from __future__ import annotations

from collections.abc import Iterable

TRANSDUCER = "transducer"
CAVITY = "cavity"

#: Roles a layer may have.
ROLES = (
    TRANSDUCER,
    "couplant",
    "substrate",
    "sidewall",
    "bond",
    "superstrate",
    "sample",
    "matching",
    "backing",
    "layer",
)

AXIS = "axis"
#: Planes of symmetry of a straight section, at its left and its right end.
PLANE_LEFT = "plane_left"
PLANE_RIGHT = "plane_right"
#: Lines at which a section ends while the device goes on.
SECTION_ENDS = (AXIS, PLANE_LEFT, PLANE_RIGHT)
ELECTRODE_LIVE = "electrode_live"
ELECTRODE_GROUND = "electrode_ground"
#: Parts of the live electrode at minus the voltage, and at ground; a chip whose electrode has one sign has neither.
ELECTRODE_REVERSED = "electrode_reversed"
ELECTRODE_IDLE = "electrode_idle"
OUTSIDE = "outside"

#: Joins a region or boundary and the layer of the stack that a part of it lies in: ``cavity@sidewall``.
PART = "@"

#: Stands for a layer in the name of the part of a boundary that lies in a plane of constant z.
LEVEL = "level"

#: Joins the name of a part and the column, between two radii, or the radius that a part of it is in:
#: ``cavity@sidewall#0``.
COLUMN = "#"

#: Joins a region or a part of one and the shapes of layers that move its cells: ``cavity@sidewall~sidewall.draft``.
MOVED = "~"

#: Name in a state of an empty cavity: its walls are then traction-free.
VACUUM = "vacuum"


def region_names(roles: Iterable[str]) -> tuple[str, ...]:
    """Region names of layers with these roles, bottom to top. Example: ``bond, layer, bond`` gives ``bond, layer,
    bond_2``."""
    seen: dict[str, int] = {}
    names = []
    for role in roles:
        seen[role] = seen.get(role, 0) + 1
        names.append(role if seen[role] == 1 else f"{role}_{seen[role]}")
    return tuple(names)


def role_of(region: str) -> str:
    """The role of a region: ``bond_2`` is a ``bond``."""
    stem, _, number = region.rpartition("_")
    return stem if stem and number.isdigit() else region


def interface(a: str, b: str) -> str:
    """Name of the boundary between two regions, in either order."""
    return "|".join(sorted((a, b)))


def outside(region: str) -> str:
    """Name of the outer boundary of a region, without the axis."""
    return f"{region}|{OUTSIDE}"


def part_name(place: str, layer: str) -> str:
    """Name of the part of a place within one layer. Level parts have the layer :data:`LEVEL`."""
    return f"{place}{PART}{layer}"


def moved_by(place: str, shapes: Iterable[str]) -> str:
    """Name of the cells that exactly these shapes of layers move."""
    return f"{place}{MOVED}{'+'.join(shapes)}"


def parent_part(place: str) -> str:
    """Name of the part that contains the column or cells `place`. A part gives itself."""
    return place.split(MOVED)[0].split(COLUMN)[0]


def parent_place(place: str) -> str:
    """Name of the region or boundary that contains `place`."""
    return place.split(MOVED)[0].split(PART)[0].split(COLUMN)[0]
