"""The parameters of a chip and its materials, with their stated uncertainties.

Fits, tolerance analyses, the live view and the diagnosis all read tolerances and uncertainties here.
"""

from __future__ import annotations

from collections.abc import Iterable

from geometry.assumed import assumed_uncertainty
from geometry.chip import Chip
from geometry.stretch import canonical_names
from materials.kinds import Material
from materials.versions import split_version
from workbench.files.errors import InputError
from workbench.model.numbers import BENCH, BENCH_ELEMENTS, LOSS, Number, ParameterName, Stated, limits

#: The amount that stands for an uncertainty assumed by the role of a layer.
ASSUMED = "assumed"


def device_numbers(chip: Chip | None, materials: Iterable[Material]) -> dict[str, Number]:
    """Every parameter of a chip and of materials, by name.

    Equal radii occur once, under their first name.

    Raises:
        InputError: equal radii have two tolerances.
    """
    found: dict[str, Number] = {}
    if chip is not None:
        first = canonical_names(chip)
        found = {name: length_number(chip, name) for name in chip.dimensions() if first.get(name, name) == name}
    for material in {each.name: each for each in materials}.values():
        for key in material.parameters():
            for name in (key, key + LOSS):
                found[f"{material.name}.{name}"] = coefficient_number(material, name)
    return found


def full_names(written: str, materials: Iterable[str]) -> list[str]:
    """The full names for one `written` without a source or version. `materials` are the full names of the known
    materials."""
    parsed = ParameterName.parse(written)
    return [f"{name}.{parsed.local}" for name in sorted(set(materials))
            if parsed.owner in (name.split("/")[0], (split_version(name) or ("",))[0])]


def length_number(chip: Chip, name: str) -> Number:
    """A dimension of a chip, under the first name of equal radii.

    Raises:
        InputError: equal radii have two tolerances.
    """
    first, known = canonical_names(chip), chip.dimensions()
    mine = first.get(name, name)
    others = tuple(other for other, each in first.items() if each == mine and other != mine)
    tolerances = {each: tolerance for each in (mine, *others) if (tolerance := known[each].tolerance) is not None}
    if len(set(tolerances.values())) > 1:
        raise InputError(chip.file, f"{name}.tolerance", ", ".join(f"{k}: {v:g} m" for k, v in tolerances.items()),
                         "one tolerance for equal radii, which are one length")
    stated = next((Stated(each, "uniform", chip.file) for each in tolerances.values()), None)
    value = known[mine].value
    return Number(mine, value, *limits(mine, value), stated, ParameterName.parse(mine).unit, others,
                  material=_material_of(chip, mine))


def _material_of(chip: Chip, name: str) -> str:
    """The material of a dimension's layer. A cavity has that of the first layer around it."""
    region = ParameterName.parse(name).owner
    around = [layer.material for layer in (*chip.layers, *chip.holes) if layer.region == region]
    return next(iter((*around, *(hole.material for hole in chip.holes))), "")


def coefficient_number(material: Material, name: str) -> Number:
    """A coefficient of a material; with ``.loss``, its imaginary part."""
    parsed = ParameterName.parse(f"{material.name}.{name}")
    value, entry = parsed.part_of(material.parameters()[parsed.coefficient]), material.values.get(parsed.coefficient)
    spread = entry and (entry.loss_uncertainty if parsed.is_loss else entry.uncertainty)
    stated = Stated(spread, origin=material.name) if spread else None
    return Number(str(parsed), value, *limits(str(parsed), value), stated, parsed.unit)


def bench_number(element: str) -> Number:
    """A bench element of :data:`BENCH_ELEMENTS`; zero for an ideal bench."""
    known = BENCH_ELEMENTS[element]
    return Number(BENCH + element, 0.0, known.low, known.high, Stated(known.prior, origin="benches of laboratories"),
                  known.unit)


def assumed_by_role(name: str, value: float, material: str = "") -> Stated:
    """The assumed uncertainty of a dimension, by role and `material`. `value` is in m or rad."""
    found = assumed_uncertainty(name, value, material)
    return Stated(found.deviation, origin=f"assumed: {found.assumed}", assumed=found.assumed)
