"""Saving of a fit as a new version of a user's entry."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from materials.entry import KINDS, EntryKind, parse_entry
from materials.fit import Fit
from materials.kinds import Fluid, Material
from materials.registry import PACKAGE_DATA, bibliography_keys
from materials.value import RECORDING, UNITS, Value
from materials.versions import (
    check_saved_name,
    entry_file,
    entry_name,
    put,
    split_version,
    versions_of,
    withdrawal_file,
)
from workbench.files.errors import InputError
from workbench.files.quantities import SOLID_DENSITIES
from workbench.files.tables import parse_toml
from workbench.files.toml import TomlEntry, toml_lines, toml_table


def fitted(start: Material, estimates: Mapping[str, Value], *, fit: Fit) -> Material:
    """The material `start` with the fitted numbers, ready to be saved.

    Args:
        start: the initial material of the fit, with the density of the fit.
        estimates: by field name; each :class:`Value` has the number, uncertainties, intervals, status and note (SI). A
            number without an estimate was fixed and keeps its source.
        fit: the description of the fit; its ``density`` is set here.

    Raises:
        KeyError: an estimate of a number that the material does not have.
    """
    numbers = start.parameters()
    unknown = sorted(set(estimates) - set(numbers))
    if unknown:
        raise KeyError(f"estimates of {', '.join(unknown)}; {start.name} has {', '.join(numbers)}")
    kind = _kind(start)
    lossy = kind.lossy_fields
    # A source that prints other constants (wave speeds, compliances) has no Value for the fields.
    converted = bool(set(start.values) - set(numbers) - set(_thermal(start)))
    values: dict[str, Value] = {}
    for name, number in (numbers | _thermal(start)).items():
        known = start.values.get(name)
        if name in estimates:
            value = replace(estimates[name], source=RECORDING, conditions=_conditions(fit), rounding=0.0)
        elif known is not None and known.source != RECORDING:
            value = replace(known, conditions=known.conditions or "not stated")
        else:
            source, conditions = RECORDING, "stated with the chip"
            if known is not None:
                conditions = f"as in {start.name}"
            elif converted:
                source, conditions = start.source, "converted from the printed constants"
            value = Value(number, "", source, conditions)
        if name in numbers and name not in estimates:
            value = replace(value, status="fixed", loss_status="fixed" if name in lossy else "")
        stated = _loss_is_stated(value)
        values[name] = replace(
            value, unit=_unit(kind, name), loss_stated="",
            loss_tolerance=value.rounding + (value.loss_uncertainty or 0.0) if stated else 0.0)
    found: dict[str, Any] = {
        name: complex(value.value) if name in lossy else complex(value.value).real for name, value in values.items()}
    return replace(start, **found, values=values, source=RECORDING, temperature=None,
                   fit=replace(fit, density=found["density"]))


def save_fit(material: Material, name: str, *, folder: Path) -> str:
    """Save a fitted material as the next version of `name`. Return its full name.

    If the newest version is equal except for the date, nothing is saved, and its name is returned. No existing file
    changes. Any number of runs may save at once, and a killed run leaves no partial entry (see
    :mod:`materials.versions`). The entry is read back with all checks before it gets its name.

    Args:
        material: from :func:`fitted`.
        name: ``material/name``, without a version.
        folder: of materials, such as :func:`materials.registry.user_folder`; made if needed.

    Raises:
        InputError: an invalid name, or one of an entry without versions; a material that is not passive, or that
            differs when read back.
        ValueError: the material has no fit, or a number without a :class:`Value`.
        OSError: the folder cannot be written.

    Warns:
        materials.PassivityWarning: active by no more than its uncertainty.
    """
    check_saved_name(name)
    for place in (PACKAGE_DATA, folder):
        if entry_file(place, name).exists():
            raise InputError("materials", "name", name, f"another name: {entry_file(place, name)} has no versions")
    content = entry_text(material)
    references = bibliography_keys(PACKAGE_DATA / "references.bib") | bibliography_keys(folder / "references.bib")
    label = f"{name} (not saved)"
    try:
        encoded = content.encode("utf-8")
        read = parse_entry(parse_toml(content, source=label), material.name, file=label, references=references)
    except UnicodeEncodeError as error:
        raise InputError(label, "text", error.object[error.start:error.end], "text that can be encoded") from None
    for field in fields(material):
        mine, theirs = getattr(material, field.name), getattr(read, field.name)
        if mine != theirs:
            raise InputError(label, field.name, mine, f"a value that can be read back; this becomes {theirs!r}")
    there = saved_versions(name, folder)
    if there and _is_same(entry_file(folder, there[-1]), content):
        return there[-1]
    last = split_version(there[-1]) if there else None
    path = entry_file(folder, name)

    def free() -> Iterator[Path]:
        nonlocal path
        for number in itertools.count(1 if last is None else last[1] + 1):
            path = entry_file(folder, f"{name}@{number}")
            yield path
            if _is_same(path, content):
                return  # Another run has saved the same content.

    try:
        return entry_name(put(encoded, free()))
    except FileExistsError:
        if not _is_same(path, content):
            raise
        return entry_name(path)


def saved_versions(name: str, folder: Path) -> list[str]:
    """The versions of `name` in a folder of materials, the oldest first."""
    return versions_of(name, map(entry_name, entry_file(folder, name).parent.glob("*.toml")))


def _is_same(path: Path, content: str) -> bool:
    """Whether a file has this entry, date apart, and is not withdrawn."""
    if withdrawal_file(path).exists() or not path.is_file():
        return False
    mine, theirs = (text.rstrip("\n").rpartition("\n")[0]
                    for text in (content, path.read_bytes().decode("utf-8", "replace")))
    return mine == theirs


def entry_text(material: Material) -> str:
    """The entry file of a fitted material as text. Numbers are exact and in SI.

    Raises:
        ValueError: the material has no fit, or a number without a :class:`Value`.
    """
    fit, kind = material.fit, _kind(material)
    stated = material.parameters() | _thermal(material)
    missing = sorted(set(stated) - set(material.values))
    if fit is None or missing:
        raise ValueError(f"{material.name}: no fit, or no value of {missing}; materials.fitted makes both")
    head: dict[str, TomlEntry] = {
        "kind": next(name for name, known in KINDS.items() if known is kind),
        "title": f"fitted to {', '.join(recording.path for recording in fit.recordings)}",
        "source": material.source,
        "conditions": _conditions(fit),
        **{key: text for key in kind.words if (text := getattr(material, key))},
    }
    if not isinstance(material, Fluid) and not SOLID_DENSITIES[0] <= material.density <= SOLID_DENSITIES[1]:
        head["unusual"] = ["density"]
    numbers = {name: _value_table(material.values[name], head) for name in stated}
    return "\n".join([*toml_lines(head), "", *toml_lines(numbers), "", *_fit_tables(fit)])


def _conditions(fit: Fit) -> str:
    temperature = "" if fit.temperature is None else f", {fit.temperature:g} K"
    return f"{fit.band[0] / 1e6:g} to {fit.band[1] / 1e6:g} MHz{temperature}"


def _thermal(material: Material) -> dict[str, complex]:
    """The thermal constants of a solid. A fluid has them as parameters."""
    return {} if isinstance(material, Fluid) else material.thermal()


def _kind(material: Material) -> EntryKind:
    return next(kind for kind in KINDS.values() if kind.build is type(material))


def _unit(kind: EntryKind, name: str) -> str:
    """The SI unit of a field, in which it is written."""
    dimensions = {**kind.required, **kind.optional, **(kind.forms[0].dimensions if kind.forms else {})}
    return next(unit for unit, factor in UNITS[dimensions[name]].items() if factor == 1.0)


def _loss_is_stated(value: Value) -> bool:
    known = (value.loss_uncertainty, value.loss_low, value.loss_high)
    return complex(value.value).imag != 0.0 or value.loss_tolerance != 0.0 or any(end is not None for end in known)


def _value_table(value: Value, head: Mapping[str, TomlEntry]) -> dict[str, TomlEntry]:
    number = complex(value.value)
    found: dict[str, TomlEntry] = {"value": number.real}
    if _loss_is_stated(value):
        found["loss"] = number.imag
    found["unit"] = value.unit
    for key in ("uncertainty", "low", "high", "loss_uncertainty", "loss_low", "loss_high"):
        known = getattr(value, key)
        if known is not None:
            found[key] = float(known)
    if value.rounding:
        found["rounding"] = float(value.rounding)
    for key in ("status", "loss_status", "source", "conditions", "note"):
        text = getattr(value, key)
        if text and text != head.get(key):
            found[key] = text
    return found


def _fit_tables(fit: Fit) -> list[str]:
    """``[fit]`` after its tables, with ``date`` last to reveal a truncated file."""
    tables = []
    if fit.sample:
        tables.append(toml_table("[fit.sample]", fit.sample))
    if fit.correlation is not None:
        rows = [list(map(float, row)) for row in fit.correlation.rows]
        tables.append(toml_table("[fit.correlation]", {"names": fit.correlation.names, "rows": rows}))
    found: dict[str, TomlEntry] = {
        "recordings": [{field.name: getattr(recording, field.name) for field in fields(recording)}
                       for recording in fit.recordings],
        "algorithm": fit.algorithm, "software": fit.software}
    if fit.start:
        found["start"] = fit.start
    found["band"] = [f"{float(end)!r} Hz" for end in fit.band]
    if fit.temperature is not None:
        found["temperature"] = f"{float(fit.temperature)!r} K"
    found |= {key: float(getattr(fit, key)) for key in ("mape_percent", "rms_log_residual", "confidence")}
    found |= {key: getattr(fit, key) for key in ("free", "fixed", "notes")}
    return [*tables, toml_table("[fit]", {**found, "forced": fit.forced, "date": fit.date})]
