"""Reading of one data file into one material.

A file states its ``kind`` and the numbers of one *form* of it: a solid may have bulk and shear modulus, Young's modulus
and Poisson's ratio, or wave speeds. ``values`` has the numbers as printed; the form converts them to the fields of the
kind. A loss is an imaginary part, loss tangent, quality factor or attenuation of a number (:mod:`materials.loss`), or
common to all constants of a ceramic.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from materials import conversions, passivity
from materials.ceramic_sheet import CONSTANTS, FIGURES
from materials.completion import Library, announce, as_printed, check_constants, complete, doubts
from materials.fit import parse_fit
from materials.kinds import CERAMICS, CHANNELS, CubicSolid, Fluid, IsotropicSolid, Material, Piezoelectric
from materials.lines import with_line_number
from materials.loss import WORDS, LossKind, attenuation_of_sound, loss_number
from materials.temperature import parse_law
from materials.value import RECORDING, Value, parse_value, source_of, unit_factor
from workbench.files.errors import InputError, choose
from workbench.files.quantities import BARE, SOLID_DENSITIES
from workbench.files.tables import FileTable, read_toml

_Numbers = Mapping[str, complex]


@dataclass(frozen=True)
class Form:
    """One set of numbers for a solid, with dimensions and conversion."""

    dimensions: Mapping[str, str]
    convert: Callable[[_Numbers], dict[str, complex]]


@dataclass(frozen=True)
class EntryKind:
    """The possible keys of a file of one kind.

    ``forms`` are alternatives, of which exactly one must be complete. ``words`` are texts from closed lists, required
    if ``worded``. ``lossy`` allows complex results of a form. ``common_losses`` apply to all constants: for each key,
    the word and the dimensions of the numbers. ``figures`` are further numbers of a data sheet, which may complete
    strain-charge constants.
    """

    build: Callable[..., Material]
    required: Mapping[str, str]
    optional: Mapping[str, str]
    forms: tuple[Form, ...]
    words: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    worded: bool = False
    lossy: bool = True
    common_losses: Mapping[str, tuple[str, tuple[str, ...]]] = dataclasses.field(default_factory=dict)
    figures: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def lossy_fields(self) -> Collection[str]:
        """The fields that may be complex."""
        return self.forms[0].dimensions if self.lossy and self.forms else ()


def _unchanged(*names: str) -> Callable[[_Numbers], dict[str, complex]]:
    return lambda numbers: {name: numbers[name] for name in names}


def _from_young_poisson(numbers: _Numbers) -> dict[str, complex]:
    bulk, shear = conversions.bulk_and_shear(numbers["youngs_modulus"], numbers["poisson_ratio"])
    return {"bulk_modulus": bulk, "shear_modulus": shear}


def _from_speeds(numbers: _Numbers) -> dict[str, complex]:
    return _from_moduli(conversions.wave_modulus(numbers["longitudinal_speed"], density=numbers["density"].real),
                        conversions.wave_modulus(numbers["shear_speed"], density=numbers["density"].real))


def _from_speed_poisson(numbers: _Numbers) -> dict[str, complex]:
    longitudinal = conversions.wave_modulus(numbers["longitudinal_speed"], density=numbers["density"].real)
    return _from_moduli(longitudinal, conversions.shear_from_longitudinal(longitudinal, numbers["poisson_ratio"]))


def _from_compressibility(numbers: _Numbers) -> dict[str, complex]:
    return {"bulk_modulus": 1.0 / numbers["compressibility"], "shear_modulus": numbers.get("shear_modulus", 0.0)}


def _sound_speed(numbers: _Numbers) -> dict[str, complex]:
    return {"sound_speed": (numbers["density"].real * numbers["compressibility"].real) ** -0.5}


def _from_moduli(longitudinal: complex, shear: complex) -> dict[str, complex]:
    return {"bulk_modulus": longitudinal - 4 * shear / 3, "shear_modulus": shear}


def _from_strain_charge(numbers: _Numbers) -> dict[str, complex]:
    return conversions.stress_charge(**{name: numbers[name] for name in CONSTANTS})


#: The form of data sheets, which figures may complete (:mod:`materials.completion`).
_STRAIN_CHARGE = Form(CONSTANTS, _from_strain_charge)

_THERMAL = {
    "thermal_conductivity": "thermal conductivity",
    "heat_capacity": "heat capacity",
    "thermal_expansion": "thermal expansion",
}

KINDS: Mapping[str, EntryKind] = {
    "piezoelectric": EntryKind(
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
            _STRAIN_CHARGE,
        ),
        words={"ceramic": CERAMICS},
        common_losses={
            "mechanical_q": ("q", ("pressure", "compliance")),
            "dielectric_loss_tangent": ("loss_tangent", ("permittivity",)),
        },
        figures=FIGURES,
    ),
    "isotropic solid": EntryKind(
        build=IsotropicSolid,
        required={"density": "density"},
        optional={**_THERMAL, "softening_temperature": "temperature"},
        forms=(
            Form({"bulk_modulus": "pressure", "shear_modulus": "pressure"},
                 _unchanged("bulk_modulus", "shear_modulus")),
            Form({"youngs_modulus": "pressure", "poisson_ratio": "dimensionless"}, _from_young_poisson),
            Form({"longitudinal_speed": "speed", "shear_speed": "speed"}, _from_speeds),
            Form({"longitudinal_speed": "speed", "poisson_ratio": "dimensionless"}, _from_speed_poisson),
            Form({"compressibility": "compliance", "shear_modulus": "pressure"}, _from_compressibility),
            Form({"compressibility": "compliance"}, _from_compressibility),
        ),
    ),
    "cubic solid": EntryKind(
        build=CubicSolid,
        required={"density": "density"},
        optional=_THERMAL,
        forms=(Form(dict.fromkeys(("c11", "c12", "c44"), "pressure"), _unchanged("c11", "c12", "c44")),),
        words={"channel": CHANNELS},
        worded=True,
        common_losses={"mechanical_q": ("q", ("pressure",))},
    ),
    "fluid": EntryKind(
        build=Fluid,
        required={"density": "density"},
        optional={
            "shear_viscosity": "viscosity",
            "bulk_viscosity": "viscosity",
            "heat_capacity_ratio": "dimensionless",
            "thermal_conductivity": "thermal conductivity",
            "heat_capacity": "heat capacity",
        },
        forms=(Form({"sound_speed": "speed"}, _unchanged("sound_speed")),
               Form({"compressibility": "compliance"}, _sound_speed)),
        lossy=False,
    ),
}

#: The kind of loss of a form's numbers, by their dimension.
_LOSS_KINDS = {
    "pressure": LossKind.MODULUS, "compliance": LossKind.COMPLIANCE, "permittivity": LossKind.COMPLIANCE,
    "piezoelectric charge": LossKind.COMPLIANCE, "speed": LossKind.WAVE_SPEED,
}
_HEAD = ("kind", "title", "source", "conditions", "note", "default", "temperature", "fit", "unusual")

#: The form of two wave speeds, each with a loss.
_FOR_SHEAR = ("longitudinal_speed", "shear_speed")

#: Share of a number of at least :data:`PLAIN` (in its printed unit) below which its loss raises a warning: a quality
#: factor of ten thousand, ten times that of the hardest ceramics. Doubled, 5000.
QUESTIONABLE, PLAIN = 1e-4, 1e2


class LossWarning(UserWarning):
    """A loss so small that it probably was meant as a share."""


def _choose_form(kind_name: str, kind: EntryKind, given: Collection[str], *, source: str) -> Form | None:
    """The form with exactly the numbers `given`, or one to complete.

    Figures of a data sheet may be present too.

    Raises:
        InputError: there is none; it names the missing numbers.
    """
    if not kind.forms:
        return None
    for form in kind.forms:
        if set(form.dimensions) == set(given):
            return form
    if kind.figures:
        whole = [form for form in kind.forms if set(form.dimensions) <= set(given) <= {*form.dimensions, *kind.figures}]
        if whole:
            return whole[0]
        if given and set(given) <= {*_STRAIN_CHARGE.dimensions, *kind.figures}:
            return _STRAIN_CHARGE
    nearest = max(kind.forms, key=lambda form: (len(set(form.dimensions) & set(given)), -len(form.dimensions)))
    missing = [name for name in nearest.dimensions if name not in given]
    if missing:
        raise InputError(source, missing[0], None, f"this number of the {kind_name} (one set of: "
                         + "; ".join(" ".join(form.dimensions) for form in kind.forms) + ")")
    surplus = sorted(set(given) - set(nearest.dimensions))
    raise InputError(source, surplus[0], "a number that the others already give",
                     f"only {' '.join(nearest.dimensions)}, besides the numbers that every {kind_name} has")


@dataclass(frozen=True)
class _Reader:
    """Shared state while one file is read."""

    file: str
    conditions: str
    source: str
    references: Collection[str]
    temperature: float | None

    def value(self, entry: object, dimension: str, *, field: str, kind: LossKind) -> Value:
        """The value of an entry. A law gives it at the requested temperature."""
        if self.temperature is None:
            return self._fixed(entry, dimension, field=field, kind=kind)
        if not isinstance(entry, Mapping) or "law" not in entry or "value" in entry:
            raise InputError(self.file, field, "a fixed value",
                             "a law alone, because other numbers of this file depend on temperature")
        _, factor = unit_factor(FileTable(self.file, field, entry), dimension)
        law = parse_law(entry["law"], factor, source=self.file, field=f"{field}.law")
        at = law.at(self.temperature, source=self.file, field=field)
        rest = {key: item for key, item in entry.items() if key != "law"}
        value = self._fixed(rest | {"value": at / factor}, dimension, field=field, kind=LossKind.NONE)
        return dataclasses.replace(value, conditions=f"{value.conditions}, {self.temperature:g} K")

    def _fixed(self, entry: object, dimension: str, *, field: str, kind: LossKind) -> Value:
        return parse_value(
            entry, dimension, source=self.file, field=field, references=self.references,
            default_source=self.source, default_conditions=self.conditions, kind=kind,
        )


def _temperature(table: FileTable, entries: Mapping[str, object], requested: float | None) -> float | None:
    """The temperature (K) of a file with laws: requested, or its reference."""
    if not any(isinstance(entry, Mapping) and "law" in entry for entry in entries.values()):
        if "temperature" in table:
            raise table.error("temperature",
                              "no temperature, because no number of this file depends on it (use conditions)")
        if requested is not None:
            raise InputError(table.source, "temperature", f"{requested:g} K",
                             "no temperature: this entry has no laws for it")
        return None
    reference = table.quantity("temperature", "temperature")
    return reference if requested is None else requested


def read_entry(
    path: Path, name: str, *, references: Collection[str], temperature: float | None, notes: list[str] | None = None,
    library: Library | None = None,
) -> Material:
    """Read and check the material `name` in the file at `path`.

    Args:
        path: a TOML file; see the package's docstring for its layout.
        name: ``material/source`` as in the registry.
        references: keys of the bibliography that the file may cite.
        temperature: in K, for a file with laws; None for its reference temperature.
        notes: a list that collects warnings of rounding and completion as text.
        library: the materials that the entry may name under ``like``.

    Raises:
        InputError: any wrong statement of the file, with the line; or a temperature without a law for it.

    Warns:
        passivity.PassivityWarning: active by no more than its rounding.
        LossWarning: a loss far below published values.
        completion.SheetWarning: constants are derived or assumed, or figures of the sheet contradict each other.
    """
    with with_line_number(path):
        return parse_entry(read_toml(path), name, file=str(path), references=references, temperature=temperature,
                           notes=notes, library=library)


def parse_entry(
    content: Mapping[str, Any], name: str, *, file: str, references: Collection[str], temperature: float | None = None,
    notes: list[str] | None = None, library: Library | None = None,
) -> Material:
    """The material in the content of an entry file; see :func:`read_entry`."""
    table = FileTable(file, "", content)
    kind_name = table.choice("kind", KINDS)
    kind = KINDS[kind_name]
    head = (*_HEAD, *kind.words, *kind.common_losses, *(("like",) if kind.figures else ()))
    entries = {key: item for key, item in content.items() if key not in head}
    in_forms = {key: dimension for form in kind.forms for key, dimension in form.dimensions.items()}
    dimensions = {**kind.required, **kind.optional, **kind.figures, **in_forms}
    table.only([*head, *dimensions])
    # A coupling factor needs no unit.
    entries = {key: {"value": item, "unit": "1"} if dimensions[key] in BARE and type(item) in (int, float) else item
               for key, item in entries.items()}
    table.text("title")
    table.text("note", "")
    table.flag("default")
    for required in kind.required:
        if required not in entries:
            raise InputError(file, required, None, f"this number of the {kind_name}")
    if "fit" in table:
        references = {RECORDING, *references}
    form = _choose_form(kind_name, kind, [key for key in entries if key in in_forms or key in kind.figures],
                        source=file)

    reader = _Reader(
        file=file,
        conditions=table.text("conditions"),
        source=source_of(table, references),
        references=references,
        temperature=_temperature(table, entries, temperature),
    )
    entries = _with_common_losses(table, kind, entries, in_forms)
    absorbed = _Absorption.of_entry(table, entries) if kind.build is Fluid else None
    if absorbed is not None:
        entries = {**entries, "sound_speed": absorbed.speed}

    def read(entries: Mapping[str, object]) -> dict[str, Value]:
        return {key: reader.value(entry, dimensions[key], field=key,
                                  kind=_LOSS_KINDS.get(dimensions[key], LossKind.EITHER_SIGN)
                                  if kind.lossy and key in in_forms else LossKind.NONE)
                for key, entry in entries.items()}

    values, findings = read(entries), []
    if form is _STRAIN_CHARGE and not set(form.dimensions) <= set(values):
        completed = complete(table, values, dimensions, library, name=name)
        values = as_printed(values) | read(_with_common_losses(table, kind, completed.entries, in_forms))
        findings.append(completed.finding)
    elif "like" in table:
        raise table.error("like", "no such key: the entry states all its constants")
    if absorbed is not None:
        values["bulk_viscosity"] = absorbed.bulk_viscosity(values, file)
    numbers = {key: value.value for key, value in values.items()}
    if form is _STRAIN_CHARGE:
        check_constants(file, values)
    fields: dict[str, Any] = {key: number.real for key, number in numbers.items()
                              if key not in in_forms and key not in kind.figures}
    fields.update({key: table.choice(key, known) for key, known in kind.words.items()
                   if key in table or kind.worded})
    tolerances: dict[str, float] = {}
    if form is not None:
        converted = _converted(form, numbers, kind_name, file)
        fields.update(converted if kind.lossy else {key: complex(number).real for key, number in converted.items()})
        tolerances = _loss_tolerances(form, numbers, values)
        if set(_FOR_SHEAR) == set(form.dimensions):
            passivity.check_longitudinal_loss(converted, numbers, tolerances, file)
    if kind.build is not Fluid:
        _check_density(table, fields["density"])
    fit = parse_fit(content["fit"], density=fields["density"], source=file) if "fit" in table else None
    material = kind.build(name=name, source=reader.source, temperature=reader.temperature, values=values, fit=fit,
                          **fields)
    passivity.check_passive(material, loss_tolerances=tolerances, source=file, notes=notes)
    _question_small_losses(material, values, dimensions)
    if isinstance(material, Piezoelectric):
        findings.append(doubts(material, values, () if form is None else form.dimensions))
    announce(findings, notes)
    return material


def _check_density(table: FileTable, density: float) -> None:
    """Check that a density (kg/m^3) is usual, or listed."""
    unusual = table.texts("unusual", (), expected='a list such as ["density"]')
    for name in unusual:
        choose(name, ["density"], source=table.source, field="unusual")
    low, high = SOLID_DENSITIES
    # One that is not positive has an error of its own.
    if low <= density <= high or unusual or not density > 0.0:
        return
    meant = (f"{density * factor:g} kg/m^3" for factor in (1e3, 1e-3) if low <= density * factor <= high)
    raise InputError(table.source, "density", f"{density:g} kg/m^3", f"{low:g} to {high:g} kg/m^3, the usual range of "
                     'a solid; if it is intended, write unusual = ["density"] in this entry', tuple(meant))


def _converted(form: Form, numbers: _Numbers, kind_name: str, file: str) -> dict[str, complex]:
    """The fields from the numbers of a form."""
    for key in ("compressibility", *_FOR_SHEAR):
        if key in numbers and not numbers[key].real > 0:
            raise InputError(file, key, numbers[key].real, "a positive number (SI)")
    try:
        return form.convert(numbers)
    except ZeroDivisionError:
        raise InputError(file, next(iter(form.dimensions)), "a singular set of numbers",
                         f"numbers of a {kind_name} that can be converted") from None


def _with_common_losses(
    table: FileTable, kind: EntryKind, entries: Mapping[str, object], dimensions: Mapping[str, str]
) -> dict[str, object]:
    """The `entries` with the common losses of the file.

    Raises:
        InputError: a number has a separate loss as well.
    """
    found = dict(entries)
    for key, (word, of) in kind.common_losses.items():
        if key not in table:
            continue
        loss_number(table, key, word)
        for name, entry in entries.items():
            if dimensions.get(name) not in of or not isinstance(entry, Mapping):
                continue
            own = [each for each in WORDS if each in entry]
            if own:
                raise InputError(table.source, key, f"a second loss of {name}, which states {own[0]}",
                                 f"{key} for all constants, or a loss beside each")
            found[name] = {**entry, word: table.content[key]}
    return found


@dataclass(frozen=True)
class _Absorption:
    """The absorption of sound that a fluid's file states with the speed. ``diffusivity`` of sound (m^2/s) and its
    ``uncertainty``; ``stated`` is the text in the file; ``speed`` is the entry of the sound speed without it."""

    diffusivity: float
    uncertainty: float | None
    stated: str
    speed: Mapping[str, object]

    @classmethod
    def of_entry(cls, table: FileTable, entries: Mapping[str, object]) -> _Absorption | None:
        """The absorption in the entry of the sound speed, or None."""
        entry = entries.get("sound_speed")
        if not isinstance(entry, Mapping) or "value" not in entry or not any(word in entry for word in WORDS):
            return None
        own = FileTable(table.source, "sound_speed", entry)
        _, factor = unit_factor(own, "speed")
        value = own.optional_number("value")
        if value is None or value <= 0:
            raise own.error("value", "a number above zero")
        found = attenuation_of_sound(own, value * factor)
        assert found is not None
        if "bulk_viscosity" in entries:
            raise InputError(table.source, "bulk_viscosity", "a second loss, beside that of sound_speed",
                             "the bulk viscosity or the absorption of sound, which follow from each other")
        alpha, uncertainty, frequency, stated = found
        # alpha = omega^2 D / (2 c^3) (Pierce, Acoustics, 1989, section 10-2).
        per_alpha = 2.0 * (value * factor) ** 3 / (2.0 * math.pi * frequency) ** 2
        speed = {key: item for key, item in entry.items() if key not in (*WORDS, "frequency", "loss_uncertainty")}
        return cls(alpha * per_alpha, None if uncertainty is None else uncertainty * per_alpha, stated, speed)

    def bulk_viscosity(self, values: Mapping[str, Value], file: str) -> Value:
        """The bulk viscosity (Pa s) that completes this absorption.

        Raises:
            InputError: shear viscosity and heat conduction absorb more already.
        """
        numbers = {key: value.value.real for key, value in values.items()}
        density = numbers["density"]
        others = 4.0 / 3.0 * numbers.get("shear_viscosity", 0.0)
        if {"heat_capacity_ratio", "thermal_conductivity", "heat_capacity"} <= set(numbers):
            ratio, heat = numbers["heat_capacity_ratio"], numbers["heat_capacity"]
            others += (ratio - 1.0) * numbers["thermal_conductivity"] / heat
        bulk = density * self.diffusivity - others
        if bulk < 0:
            raise InputError(file, "sound_speed", self.stated, "an absorption of at least "
                             f"{others / (density * self.diffusivity):.3g} times that, the part of shear viscosity "
                             "and heat conduction")
        of = values["sound_speed"]
        return Value(bulk, "Pa s", of.source, of.conditions, f"from the {self.stated} of sound",
                     None if self.uncertainty is None else density * self.uncertainty)


def _question_small_losses(material: Material, values: Mapping[str, Value], dimensions: Mapping[str, str]) -> None:
    """Warn of losses that probably are loss tangents in a wrong key."""
    found = []
    for key, value in values.items():
        share = abs(value.value.imag / value.value.real) if value.value.real else 0.0
        factor = unit_factor(FileTable("", "", {"unit": value.unit}), dimensions[key])[1] if value.unit else 1.0
        printed = abs(value.value.real) / factor
        ceramic = isinstance(material, Piezoelectric) and _LOSS_KINDS.get(dimensions[key]) is not None
        if 0.0 < share < QUESTIONABLE and value.source != RECORDING and (printed >= PLAIN or ceramic):
            found.append(f"{key} {printed:.4g} with loss {abs(value.value.imag) / factor:.3g}: {share:.1e} of it")
    if found:
        warnings.warn(
            f"{material.name}: losses a thousand times below published ones ({'; '.join(found)}). A loss is the "
            "imaginary part in the unit of its number; write loss_tangent if the source prints tan delta, or q",
            LossWarning, stacklevel=6)


def _loss_tolerances(form: Form, numbers: _Numbers, values: Mapping[str, Value]) -> dict[str, float]:
    """First-order bound on the imaginary part of each field. It follows from the bounds of the printed numbers."""
    exact = form.convert(numbers)
    bounds = dict.fromkeys(exact, 0.0)
    for key in form.dimensions:
        if values[key].loss_tolerance:
            moved = form.convert({**numbers, key: numbers[key] + 1j * values[key].loss_tolerance})
            for field in bounds:
                bounds[field] += abs((moved[field] - exact[field]).imag)
    return bounds
