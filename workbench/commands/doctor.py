"""``workbench doctor``."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path

from workbench.files.names import visible
from workbench.installation import libraries, machine, ports
from workbench.installation.check import run_checks


def run_doctor(options: argparse.Namespace) -> int:
    """``workbench doctor``: check the installation; 1 if there is a fault.

    Neither the console nor the numerical libraries are needed.
    """
    found = run_checks(checks(), jobs=machine.processors(), waiting=partial(print, file=sys.stderr, flush=True))
    count = Counter(check.status for check in found)
    if options.json:
        print(json.dumps({"faults": count["fault"], "warnings": count["warning"],
                          "checks": [asdict(check) for check in found]}, indent=2))
        return min(count["fault"], 1)
    for check in found:
        print(visible(f"{check.status:<9}{check.name:<18}{check.words}"))
        if check.remedy:
            print(visible(f"{'':<9}{'remedy':<18}{check.remedy}"))
    print(f"{len(found)} checks, faults: {count['fault']}, warnings: {count['warning']}")
    return min(count["fault"], 1)


def checks() -> Mapping[str, Callable[[], str]]:
    """Every check by its name."""
    own = "to a folder of your own"
    return {
        "workbench": machine.version, "system": machine.system, "memory": machine.memory,
        "environment": machine.environment, "linear algebra": machine.linear_algebra,
        **{name: partial(libraries.package, name, least) for name, least in libraries.required().items()},
        "off screen": libraries.off_screen, "font": libraries.font, "ports": ports.serial_ports,
        "data folder": partial(machine.folder, machine.data_folder, f"set XDG_DATA_HOME {own}"),
        "cache folder": partial(machine.folder, machine.cache_folder, f"set MPLCONFIGDIR {own}"),
        "temporary folder": partial(machine.folder, lambda: Path(tempfile.gettempdir()), f"set TMPDIR {own}"),
        "current folder": partial(machine.folder, Path.cwd, "name another folder after -o"),
        "self-test": libraries.solved_disc,
    }
