"""Reads the variables of a study: ranges, lists and alternative materials.

They are the table [vary] of a study's file::

    [vary]
    "substrate.thickness" = { from = "0.7 mm", to = "1.0 mm", points = 5 }
    "couplant.thickness" = { values = ["10 um", "20 um", "50 um"] }
    "sidewall.thickness" = { tolerance = true }          # the tolerance of the chip file
    "cavity.radius" = { tolerance = "50 um" }            # to both sides of the chip file's value; or "2 %"
    "pla/acevedo_2026.shear_modulus" = { tolerance = "10 %" }
    "superstrate.material" = { materials = ["soda_lime_glass", "borosilicate_glass"] }
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.dimension import millimetres
from geometry.names import CAVITY, VACUUM
from geometry.plausible import check_length
from geometry.stretch import admissible_range, canonical_names, mesh_limits
from materials.registry import Registry
from workbench.design.variables import MATERIAL, MaterialChoice, Variable, VariedNumber, flat_entries, read_materials
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable
from workbench.model.device_numbers import device_numbers, full_names
from workbench.model.numbers import Number, ParameterName
from workbench.model.problem import fill

Real = NDArray[np.float64]

_KEYS = ("from", "to", "points", "values", "tolerance", "materials")
#: Keys that exclude the other keys of a range, in words.
_RIVALS = {"values": "values, or a range", "tolerance": "a tolerance, or from and to"}
_EXAMPLE = ('{ from = ..., to = ... }, { values = [...] }, { tolerance = ... } or, for the material of a region, '
            '{ materials = [...] }')


def read_axes(table: FileTable, chip: Chip, states: Sequence[str], registry: Registry, *,
              method: str) -> tuple[Variable, ...]:
    """Read the variables of the table [vary] of a chip in `states`.

    `method` is the sampling method of the study.

    Raises:
        InputError: an unknown name; an invalid range, or one that passes a neighbouring radius; a tolerance that is not
            stated; a material that is unknown or that a state cannot contain.
    """
    entries = {name: FileTable.of(value, source=table.source, field=table.at(name), expected=_EXAMPLE).only(_KEYS)
               for name, value in flat_entries(table.content)}
    if not entries:
        raise InputError(table.source, table.field, None, "at least one thing that varies")
    choices = {name: _choice(name, entry, chip, states, registry)
               for name, entry in entries.items() if "materials" in entry or name.endswith(MATERIAL)}
    common, others = _numbers(chip, states, list(choices.values()), registry)
    axes: list[Variable] = []
    for name, entry in entries.items():
        _check_points(entry, method, ranged="from" in entry or "tolerance" in entry)
        axes.append(choices[name] if name in choices else _number_axis(name, entry, chip, common, others))
    _check_lengths(chip, [axis for axis in axes if isinstance(axis, VariedNumber)], table)
    return tuple(axes)


def _check_points(entry: FileTable, method: str, *, ranged: bool) -> None:
    if method == "grid" and ranged:
        entry.required("points", "how many points the range has on the grid, such as points = 5")
        entry.whole("points", low=2, high=100_000)
    elif "points" in entry:
        raise entry.error("points", "none here: " + ("values say how many" if not ranged else
                          f"[sample] says how many there are where the method is {method!r}"))
    if method == "list" and ranged:
        raise InputError(entry.source, entry.field, "a range", "values = [...], or materials = [...], as many as "
                         "everything else has: a list is taken row by row")


# --------------------------------------------------------------------------------------------------------------------


def _numbers(
    chip: Chip, states: Sequence[str], choices: Sequence[MaterialChoice], registry: Registry
) -> tuple[dict[str, list[Number]], set[str]]:
    """The numbers of a chip, and the names not always present.

    Each name has its numbers in all states with all alternatives. The second result has the names that only some of
    these have.
    """
    found: list[dict[str, Number]] = []
    for state, *chosen in product(states, *(axis.materials for axis in choices)):
        picked = {axis.region: name for axis, name in zip(choices, chosen, strict=True)}
        held = fill(with_materials(chip, picked, registry), state, registry).materials.values()
        found.append({name: each for each in device_numbers(chip, held).values() for name in each.names
                      if not name.startswith("ports.")})
    common = {name: [each[name] for each in found] for name in found[0] if all(name in each for each in found)}
    return common, set().union(*found) - set(common)


def _number_axis(
    written: str, entry: FileTable, chip: Chip, common: Mapping[str, Sequence[Number]], others: Collection[str]
) -> VariedNumber:
    owners = {ParameterName.parse(name).owner for name in {*common, *others}}
    # ``pla.density`` means ``pla/acevedo_2026.density`` if that is the only material of that name.
    full = full_names(written, (owner for owner in owners if "/" in owner))
    name = full[0] if len(full) == 1 else written
    if name in others:
        raise InputError(entry.source, entry.field, written, "a number of a material that every state and every "
                         "alternative contains; a material that only some of them contain needs its own study")
    if name not in common:
        shown = [known for known in common if not known.endswith(".loss")]
        raise InputError(entry.source, entry.field, written, "a length that the spectrum feels or a material's "
                         f"coefficient (with .loss its imaginary part): {', '.join(shown)}",
                         nearest_names(name, common))
    kind = next((key for key in _RIVALS if key in entry), "from")
    for key in ("from", "to", "tolerance"):
        if kind in _RIVALS and key in entry and key != kind:
            raise entry.error(key, f"{_RIVALS[kind]}, not both")
    if kind == "values":
        found = VariedNumber.listed(name, _values(entry, name))
    else:
        low, high = _tolerance(name, entry, common[name]) if kind == "tolerance" else (
            _quantity(entry, key, name) for key in ("from", "to"))
        if not low < high:
            raise InputError(entry.source, entry.field, f"{low:g} to {high:g} {ParameterName.parse(name).unit}",
                             "from a lower number to a higher one")
        found = VariedNumber(name, low, high, points=entry.content.get("points"))
    for value in found.values or (found.low, found.high):
        check_length(name, value, source=entry.source, field=entry.field, unusual=chip.unusual)
    return found


def _quantity(entry: FileTable, key: str, name: str) -> float:
    dimension = ParameterName.parse(name).quantity
    entry.required(key, f"a {dimension} with its unit; a variable is given as {_EXAMPLE}")
    return entry.quantity(key, dimension)


def _values(entry: FileTable, name: str) -> tuple[float, ...]:
    """The values of a list."""
    dimension, listed = ParameterName.parse(name).quantity, entry.content["values"]
    if not isinstance(listed, list) or not listed:
        raise entry.error("values", f"a list of {dimension}s with their units")
    found = tuple(parse_quantity(text, dimension, source=entry.source, field=f"{entry.at('values')}[{index}]")
                  for index, text in enumerate(listed))
    if len(set(found)) < 2:
        raise entry.error("values", "at least two different values; a constant belongs in the chip file")
    return found


def _tolerance(name: str, entry: FileTable, numbers: Sequence[Number]) -> tuple[float, float]:
    """The range that a tolerance gives around the nominal number."""
    value, stated = numbers[0].value, entry.content["tolerance"]
    if any(each.value != value for each in numbers):
        raise entry.error("tolerance", f"from and to: {name} is not the same number in all states")
    if stated is True:
        width = numbers[0].tolerance if numbers[0].is_dimension else None
        if width is None:
            expected = ("a tolerance such as \"20 um\": the chip file states none of this length"
                        if numbers[0].is_dimension else 'a tolerance such as "5 %"; only lengths have one of their '
                        "own, in the chip file")
            raise entry.error("tolerance", expected)
    elif isinstance(stated, str) and stated.strip().endswith("%"):
        width = abs(value) * entry.quantity("tolerance", "dimensionless")
    else:
        width = entry.quantity("tolerance", ParameterName.parse(name).quantity)
    if not width > 0.0:
        raise entry.error("tolerance", f"a tolerance above zero; {name} is {value:g}")
    return value - width, value + width


def _check_lengths(chip: Chip, axes: Sequence[VariedNumber], table: FileTable) -> None:
    """Check that lengths are positive and radii keep their order.

    Only one of several radii that coincide may vary.
    """
    first = canonical_names(chip)
    base = centred_in_ranges(chip, axes, table)
    radii: dict[str, VariedNumber] = {}
    for axis in axes:
        if axis.name not in base.dimensions():
            continue
        field, ends = table.at(axis.name), f"{millimetres(axis.low)} to {millimetres(axis.high)}"
        low, high = admissible_range(base, axis.name)
        if not axis.low > 0.0 and not axis.parsed.is_shape:
            raise InputError(table.source, field, ends, "lengths above zero")
        if axis.name not in first:
            continue
        other = radii.setdefault(first[axis.name], axis)
        if other is not axis:
            raise InputError(table.source, field, axis.name, f"one of the radii that coincide, which move together: "
                             f"{other.name} varies already")
        if not low <= axis.low or not axis.high <= high:
            below, above = mesh_limits(base, axis.name)
            raise InputError(table.source, field, ends, f"radii from {millimetres(low)} to {millimetres(high)}: the "
                             f"next ones are at {millimetres(below)} and {millimetres(above)}, and the parts between "
                             "must stay")
    ordered = sorted(radii.values(), key=lambda axis: base.dimensions()[axis.name].value)
    for inner, outer in pairwise(ordered):
        if not inner.high < outer.low:
            raise InputError(table.source, table.at(outer.name), f"from {millimetres(outer.low)}",
                             f"a radius above the {millimetres(inner.high)} that {inner.name} reaches")


def centred_in_ranges(chip: Chip, axes: Sequence[VariedNumber], table: FileTable | None = None) -> Chip:
    """The chip with lengths outside their ranges moved to the middle."""
    known, first = chip.dimensions(), canonical_names(chip)
    moved = {axis.name: 0.5 * (axis.low + axis.high) for axis in axes
             if axis.name in known and not axis.low <= known[axis.name].value <= axis.high}
    together = {other: value for name, value in moved.items() for other in known
                if other == name or first.get(other, other) == first.get(name, name)}
    try:
        return chip.with_dimensions(together)
    except InputError as error:
        if table is None:
            raise
        raise InputError(table.source, table.field, ", ".join(f"{n} of {millimetres(v)}" for n, v in moved.items()),
                         f"lengths that make a chip; {error.field} would be {error.value}, expected is "
                         f"{error.expected}") from error


# --------------------------------------------------------------------------------------------------------------------


def _choice(name: str, entry: FileTable, chip: Chip, states: Sequence[str], registry: Registry) -> MaterialChoice:
    region, regions = name.removesuffix(MATERIAL), chip.regions
    if not name.endswith(MATERIAL) or region not in regions:
        known = [f"{each}{MATERIAL}" for each in regions]
        raise InputError(entry.source, entry.field, name, f"the material of a region: {', '.join(known)}",
                         nearest_names(name, known))
    if "materials" not in entry:
        raise InputError(entry.source, entry.field, dict(entry.content), "{ materials = [...] }, names of materials")
    found = tuple(read_materials(entry, registry).values())
    for state, full in product(states, found):
        if region == CAVITY and chip.state(state).cavity in (None, VACUUM):
            raise InputError(entry.source, entry.field, name, f"states with something in the cavity; {state!r} has "
                             "nothing there")
        try:
            fill(with_materials(chip, {region: full}, registry), state, registry)
        except InputError as error:
            raise InputError(entry.source, entry.at("materials"), full, f"a material that {region} can be made of: "
                             f"{error}") from error
    return MaterialChoice(region, found)


def with_materials(chip: Chip, chosen: Mapping[str, str], registry: Registry) -> Chip:
    """The chip with other materials by region (full names).

    A new material brings its own density.
    """
    layers = tuple(
        replace(layer, material=name, density=layer.density if registry.find(layer.material)[0] == name else None)
        if (name := chosen.get(layer.region)) is not None else layer for layer in chip.layers)
    states = tuple(replace(
        state, cavity=state.cavity if state.cavity in (None, VACUUM) else chosen.get(CAVITY, state.cavity),
        materials={region: chosen.get(region, name) for region, name in state.materials.items()})
        for state in chip.states)
    return replace(chip, layers=layers, states=states)
