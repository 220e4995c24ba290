"""``workbench materials``."""

from __future__ import annotations

import argparse
import datetime
import warnings
from typing import TYPE_CHECKING

from materials import (
    Registry,
    describe,
    export_entries,
    history,
    import_entries,
    user_registry,
    withdraw,
)
from materials.history import load_quietly
from workbench.commands.parsed_options import saving_folder
from workbench.commands.terminal import print_line, print_table
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.tables import read_toml
from workbench.report.materials import differences_table, materials_table, versions_table

if TYPE_CHECKING:
    from rich.console import Console


def run_materials(options: argparse.Namespace, _console: Console) -> int:
    """``workbench materials``: list, show, check and keep materials."""
    if options.action == "import":
        for imported in import_entries(options.file, folder=saving_folder(options.materials)):
            print_line(f"{imported.name}: {'imported' if imported.new else 'was there already'}")
        return 0
    registry = user_registry(options.materials)
    match options.action:
        case "list":
            print_table("materials", materials_table(registry))
        case "show":
            if options.name is None:
                raise InputError("command line", "NAME", None, "the name of a material; see `workbench materials list`")
            print_line(describe(registry.load(options.name, temperature=_temperature(options))))
            _print_remarks(registry, options.name)
        case "check":
            return _check(registry, options)
        case "diff":
            first, second = (load_quietly(registry, name) for name in (options.first, options.second))
            print_table("", differences_table(first, second))
        case "history":
            print_table(options.name, versions_table(history(registry, options.name)))
        case "withdraw":
            now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            withdraw(registry, options.name, reason=options.reason, date=now)
            print_line(f"{options.name}: withdrawn")
        case "export":
            for name in export_entries(registry, options.names, path=options.output):
                print_line(name)
    return 0


def _print_remarks(registry: Registry, name: str) -> None:
    content = read_toml(registry.find(name)[1])
    for key in ("title", "conditions", "note"):
        if key in content:
            print_line(f"  {key:<22} {' '.join(str(content[key]).split())}")


def _temperature(options: argparse.Namespace) -> float | None:
    if options.temperature is None:
        return None
    return parse_quantity(options.temperature, "temperature", source="command line", field="--temperature")


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
