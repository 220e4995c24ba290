"""One data file to one material.

A file states its ``kind`` and the numbers of one *form* of it: the same solid may be printed as bulk and shear modulus,
as Young's modulus and Poisson's ratio, or as wave speeds. The numbers are kept as printed, in ``values``; the form's
conversion gives the fields of the kind.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from materials import conversions, passivity
from materials.fit import parse_fit
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from materials.lines import located
from materials.temperature import parse_law
from materials.value import RECORDING, Value, parse_value, source_of, unit_factor
from workbench.files.errors import InputError
from workbench.files.tables import Table, read_toml

_Numbers = Mapping[str, complex]


@dataclass(frozen=True)
class Form:
    """One way a source may print a solid: the dimension of each number, and the fields they give."""

    dimensions: Mapping[str, str]
    convert: Callable[[_Numbers], dict[str, complex]]


@dataclass(frozen=True)
class Kind:
    """What a file of one kind may state. ``forms`` are alternatives, of which exactly one must be complete."""

    build: Callable[..., Material]
    required: Mapping[str, str]
    optional: Mapping[str, str]
    forms: tuple[Form, ...]


def _unchanged(*names: str) -> Callable[[_Numbers], dict[str, complex]]:
    return lambda numbers: {name: numbers[name] for name in names}


def _from_young_poisson(numbers: _Numbers) -> dict[str, complex]:
    bulk, shear = conversions.bulk_and_shear(numbers["youngs_modulus"], numbers["poisson_ratio"])
    return {"bulk_modulus": bulk, "shear_modulus": shear}


def _from_speeds(numbers: _Numbers) -> dict[str, complex]:
    return _from_moduli(numbers["density"] * numbers["longitudinal_speed"] ** 2,
                        numbers["density"] * numbers["shear_speed"] ** 2)


def _from_speed_poisson(numbers: _Numbers) -> dict[str, complex]:
    longitudinal = numbers["density"] * numbers["longitudinal_speed"] ** 2
    return _from_moduli(longitudinal, conversions.shear_from_longitudinal(longitudinal, numbers["poisson_ratio"]))


def _from_moduli(longitudinal: complex, shear: complex) -> dict[str, complex]:
    return {"bulk_modulus": longitudinal - 4 * shear / 3, "shear_modulus": shear}


_STRAIN_CHARGE = {
    **dict.fromkeys(("s11", "s12", "s13", "s33", "s44"), "compliance"),
    **dict.fromkeys(("d31", "d33", "d15"), "piezoelectric charge"),
    **dict.fromkeys(("free_eps11", "free_eps33"), "permittivity"),
}


def _from_strain_charge(numbers: _Numbers) -> dict[str, complex]:
    return conversions.stress_charge(**{name: numbers[name] for name in _STRAIN_CHARGE})


_THERMAL = {
    "thermal_conductivity": "thermal conductivity",
    "heat_capacity": "heat capacity",
    "thermal_expansion": "thermal expansion",
}

KINDS: Mapping[str, Kind] = {
    "piezoelectric": Kind(
        build=Piezoelectric,
        required={"density": "density"},
        optional=_THERMAL,
        forms=(
            Form(
                {
                    **dict.fromkeys(("c11", "c12", "c13", "c33", "c44"), "pressure"),
                    **dict.fromkeys(("e31", "e33", "e15"), "piezoelectric"),
                    **dict.fromkeys(("eps11", "eps33"), "permittivity"),
                },
                _unchanged("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33"),
            ),
            Form(_STRAIN_CHARGE, _from_strain_charge),
        ),
    ),
    "isotropic solid": Kind(
        build=IsotropicSolid,
        required={"density": "density"},
        optional=_THERMAL,
        forms=(
            Form({"bulk_modulus": "pressure", "shear_modulus": "pressure"},
                 _unchanged("bulk_modulus", "shear_modulus")),
            Form({"youngs_modulus": "pressure", "poisson_ratio": "dimensionless"}, _from_young_poisson),
            Form({"longitudinal_speed": "speed", "shear_speed": "speed"}, _from_speeds),
            Form({"longitudinal_speed": "speed", "poisson_ratio": "dimensionless"}, _from_speed_poisson),
        ),
    ),
    "fluid": Kind(
        build=Fluid,
        required={"density": "density", "sound_speed": "speed"},
        optional={
            "shear_viscosity": "viscosity",
            "bulk_viscosity": "viscosity",
            "heat_capacity_ratio": "dimensionless",
            "thermal_conductivity": "thermal conductivity",
            "heat_capacity": "heat capacity",
        },
        forms=(),
    ),
}

#: Numbers of a form that have no imaginary part: the loss of a wave is its attenuation.
_LOSSLESS = ("longitudinal_speed", "shear_speed")
_HEAD = ("kind", "title", "source", "conditions", "note", "default", "temperature", "fit")


def _choose_form(kind_name: str, kind: Kind, given: Collection[str], *, source: str) -> Form | None:
    """The form whose numbers are exactly those `given`; an :class:`InputError` that names what is missing otherwise."""
    if not kind.forms:
        return None
    for form in kind.forms:
        if set(form.dimensions) == set(given):
            return form
    nearest = max(kind.forms, key=lambda form: (len(set(form.dimensions) & set(given)), -len(form.dimensions)))
    missing = [name for name in nearest.dimensions if name not in given]
    if missing:
        raise InputError(source, missing[0], "nothing", f"this number of the {kind_name} (one set of: "
                         + "; ".join(" ".join(form.dimensions) for form in kind.forms) + ")")
    surplus = sorted(set(given) - set(nearest.dimensions))
    raise InputError(source, surplus[0], "a number that the others already give",
                     f"only {' '.join(nearest.dimensions)} beside what every {kind_name} has")


@dataclass(frozen=True)
class _Reader:
    """What the reading of one file has in common: its name for messages, its head, the keys it may cite."""

    file: str
    conditions: str
    source: str
    references: Collection[str]
    temperature: float | None

    def value(self, entry: object, dimension: str, *, field: str, lossy: bool) -> Value:
        """The value of one entry: fixed, or at the temperature asked for if the file gives laws."""
        if self.temperature is None:
            return self._fixed(entry, dimension, field=field, lossy=lossy)
        if not isinstance(entry, Mapping) or "law" not in entry or "value" in entry:
            raise InputError(self.file, field, "a fixed value",
                             "a law alone, because other numbers of this file depend on temperature")
        _, factor = unit_factor(Table(self.file, field, entry), dimension)
        law = parse_law(entry["law"], factor, source=self.file, field=f"{field}.law")
        at = law.at(self.temperature, source=self.file, field=field)
        rest = {key: item for key, item in entry.items() if key != "law"}
        value = self._fixed(rest | {"value": at / factor}, dimension, field=field, lossy=False)
        return dataclasses.replace(value, conditions=f"{value.conditions}, {self.temperature:g} K")

    def _fixed(self, entry: object, dimension: str, *, field: str, lossy: bool) -> Value:
        return parse_value(
            entry, dimension, source=self.file, field=field, references=self.references,
            default_source=self.source, default_conditions=self.conditions, lossy=lossy,
        )


def _temperature(table: Table, entries: Mapping[str, object], asked: float | None) -> float | None:
    """The temperature (K) of a file with laws: the one asked for, or else the reference temperature it states."""
    if not any(isinstance(entry, Mapping) and "law" in entry for entry in entries.values()):
        if "temperature" in table:
            raise table.error("temperature",
                              "no temperature, because no number of this file depends on it (use conditions)")
        if asked is not None:
            raise InputError(table.source, "temperature", f"{asked:g} K",
                             "no temperature: this entry has no laws for it")
        return None
    reference = table.quantity("temperature", "temperature")
    return reference if asked is None else asked


def read_entry(
    path: Path, name: str, *, references: Collection[str], temperature: float | None
) -> Material:
    """The material in the file at `path`, checked, under the name `name`.

    Args:
        path: a TOML file; see the package's page for its layout.
        name: ``material/source`` as the registry knows it.
        references: keys of the bibliography that the file may cite.
        temperature: in K, for a file whose numbers depend on it; None for its own reference temperature.

    Raises:
        InputError: anything the file states wrongly, with the line; or a temperature it cannot serve.

    Warns:
        passivity.PassivityWarning: active by no more than its own rounding.
    """
    with located(path):
        return parse_entry(read_toml(path), name, file=str(path), references=references, temperature=temperature)


def parse_entry(
    content: Mapping[str, Any], name: str, *, file: str, references: Collection[str], temperature: float | None = None
) -> Material:
    """The material in the content of an entry file; see :func:`read_entry`."""
    table = Table(file, "", content)
    kind_name = table.choice("kind", KINDS)
    kind = KINDS[kind_name]
    entries = {key: item for key, item in content.items() if key not in _HEAD}
    in_forms = {key: dimension for form in kind.forms for key, dimension in form.dimensions.items()}
    dimensions = {**kind.required, **kind.optional, **in_forms}
    table.only([*_HEAD, *dimensions])
    table.text("title")
    table.text("note", "")
    table.flag("default")
    for required in kind.required:
        if required not in entries:
            raise InputError(file, required, "nothing", f"this number of the {kind_name}")
    if "fit" in table:
        references = {RECORDING, *references}
    form = _choose_form(kind_name, kind, [key for key in entries if key in in_forms], source=file)

    reader = _Reader(
        file=file,
        conditions=table.text("conditions"),
        source=source_of(table, references),
        references=references,
        temperature=_temperature(table, entries, temperature),
    )
    values = {
        key: reader.value(entry, dimensions[key], field=key, lossy=key in in_forms and key not in _LOSSLESS)
        for key, entry in entries.items()
    }
    numbers = {key: value.value for key, value in values.items()}
    fields: dict[str, Any] = {key: number.real for key, number in numbers.items() if key not in in_forms}
    tolerances: dict[str, float] = {}
    if form is not None:
        fields.update(form.convert(numbers))
        tolerances = _loss_tolerances(form, numbers, values)
    fit = parse_fit(content["fit"], density=fields["density"], source=file) if "fit" in table else None
    material = kind.build(name=name, source=reader.source, temperature=reader.temperature, values=values, fit=fit,
                          **fields)
    passivity.check(material, loss_tolerances=tolerances, source=file)
    return material


def _loss_tolerances(form: Form, numbers: _Numbers, values: Mapping[str, Value]) -> dict[str, float]:
    """Bound on the imaginary part of each field from those of the printed numbers, to first order."""
    exact = form.convert(numbers)
    bounds = dict.fromkeys(exact, 0.0)
    for key in form.dimensions:
        if values[key].loss_tolerance:
            moved = form.convert({**numbers, key: numbers[key] + 1j * values[key].loss_tolerance})
            for field in bounds:
                bounds[field] += abs((moved[field] - exact[field]).imag)
    return bounds
