"""``workbench materials``."""

from __future__ import annotations

import argparse
import datetime
import warnings
from typing import TYPE_CHECKING

from materials import (
    Fluid,
    Registry,
    describe,
    differences,
    export_entries,
    history,
    import_entries,
    user_registry,
    withdraw,
)
from materials.history import load_quietly
from materials.versions import read_withdrawal
from workbench.commands.asked import saving_folder
from workbench.commands.terminal import print_line, print_table
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.tables import read_toml
from workbench.report.page import TextTable

if TYPE_CHECKING:
    from rich.console import Console


def run_materials(options: argparse.Namespace, _console: Console) -> int:
    """``workbench materials``: look at them, and keep the saved fits."""
    if options.action == "import":
        for imported in import_entries(options.file, folder=saving_folder(options.materials)):
            print_line(f"{imported.name}: {'imported' if imported.new else 'was there already'}")
        return 0
    registry = user_registry(options.materials)
    match options.action:
        case "list":
            print_table("materials", TextTable(("name", "kind", "density (kg/m^3)", "remarks"), tuple(
                _list_row(registry, name) for name in registry.names())))
        case "show":
            if options.name is None:
                raise InputError("command line", "NAME", None, "the name of a material; see `workbench materials list`")
            print_line(describe(registry.load(options.name, temperature=_temperature(options))))
            _print_remarks(registry, options.name)
        case "check":
            return _check(registry, options)
        case "diff":
            _diff(registry, options)
        case "history":
            rows = []
            for version in history(registry, options.name):
                fit = None if version.material is None else version.material.fit
                figures = ("", "", "") if fit is None else (fit.date, f"{fit.mape_percent:.3g}", fit.algorithm)
                withdrawn = version.withdrawal
                remark = version.fault if withdrawn is None else f"withdrawn on {withdrawn.date}: {withdrawn.reason}"
                rows.append((version.name, *figures, remark))
            print_table(options.name, TextTable(("version", "fitted on", "MAPE (%)", "algorithm", "remarks"),
                                                tuple(rows)))
        case "withdraw":
            now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            withdraw(registry, options.name, reason=options.reason, date=now)
            print_line(f"{options.name}: withdrawn")
        case "export":
            for name in export_entries(registry, options.names, path=options.output):
                print_line(name)
    return 0


def _print_remarks(registry: Registry, name: str) -> None:
    """Print the title, the conditions and the note of an entry."""
    content = read_toml(registry.find(name)[1])
    for key in ("title", "conditions", "note"):
        if key in content:
            print_line(f"  {key:<22} {' '.join(str(content[key]).split())}")


def _temperature(options: argparse.Namespace) -> float | None:
    if options.temperature is None:
        return None
    return parse_quantity(options.temperature, "temperature", source="command line", field="--temperature")


def _list_row(registry: Registry, name: str) -> tuple[str, str, str, str]:
    """One spoiled file does not hide the others."""
    try:
        material, withdrawn = load_quietly(registry, name), read_withdrawal(registry.find(name)[1])
    except InputError:
        return name, "faulty", "", "see `workbench materials check`"
    remarks = []
    if material.fit is not None:
        low, high = material.fit.band
        remarks.append(f"fitted, {low / 1e6:.4g} to {high / 1e6:.4g} MHz")
    if withdrawn is not None:
        remarks.append("withdrawn")
    if not isinstance(material, Fluid) and not any(number.imag for number in material.parameters().values()):
        remarks.append("lossless")
    return name, type(material).__name__, f"{material.density:.6g}", "; ".join(remarks)


def _check(registry: Registry, options: argparse.Namespace) -> int:
    names = registry.names() if options.name is None else [options.name]
    failed, temperature = 0, _temperature(options)
    for name in names:
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                registry.load(name, temperature=temperature)
            print_line(f"{name}: ok" + "".join(f"\n  {w.message}" for w in caught))
        except InputError as error:
            failed += 1
            print_line(f"{name}: {error}")
    return 1 if failed else 0


def _diff(registry: Registry, options: argparse.Namespace) -> None:
    first, second = load_quietly(registry, options.first), load_quietly(registry, options.second)
    columns = ("SI", first.name, second.name, "difference (%)", "in standard uncertainties")
    print_table("", TextTable(columns, tuple(
        (row.parameter, f"{row.first:.6g}", f"{row.second:.6g}",
         "" if row.percent is None else f"{row.percent:+.3f}",
         "" if row.deviations is None else f"{row.deviations:+.2f}")
        for row in differences(first, second))))
