"""Numbers of the files of a set of commands at two commits, compared.

    .venv/bin/python tests/benchmarks/records_agree.py BEFORE AFTER --into FOLDER [--only simulate_reference]

Each command runs with the program as it was at each commit, into FOLDER/COMMIT/NAME; a finished one is not run again.
Numbers of JSON, Parquet and CSV files under the same keys are compared, and the largest relative difference of each
command is printed with its key, with the numbers of keys on one side alone. Times are left out.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import shlex
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pyarrow.parquet import read_table

ROOT = Path(__file__).resolve().parents[2]

#: The commands, by name of their folder. Paths are those of the checkout.
COMMANDS = {
    "simulate_reference": "simulate geometry/chips/reference_chip.toml --no-cad",
    "simulate_silicon": "simulate geometry/chips/silicon_glass_channel.toml --no-cad",
    "simulate_disc": "simulate geometry/chips/free_disc_25x2.toml --no-cad",
    "study": "study examples/small_study/study.toml",
    "compare": "compare tests/data/reference/chip_filled.csv geometry/chips/reference_chip.toml",
    "fit_pzt": "fit pzt tests/data/reference/free_disc_fitted_rho7862.csv --chip geometry/chips/free_disc_25x2.toml",
    "fit_polymer": "fit polymer tests/data/reference/disc_gel_PLA.csv --chip geometry/chips/disc_gel_pla.toml",
    "tolerance": "tolerance examples/small_study/chip.toml --accuracy '2 %' --require 'f0 within 5 kHz'",
    "sensitivity": "sensitivity geometry/chips/disc_20x2.toml",
    "design": "design examples/design/half_wave_chip.toml --no-cad",
    "particles": "particles examples/small_study/chip.toml --accuracy '2 %' --drive '8 Vpp' --minutes 5",
}

#: Parts of keys whose numbers are times, or depend on the machine.
LEFT_OUT = ("seconds", "wall", "memory", "time_s", "created", "version")

#: Relative difference above which a key is printed.
AGREE = 1e-6


def program(commit: str, into: Path) -> Path:
    """The folder of the program at a commit."""
    folder = into / commit / "program"
    if not folder.exists():
        folder.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True)
        packed = into / commit / "program.tar"
        packed.write_bytes(archive.stdout)
        with tarfile.open(packed) as files:
            files.extractall(folder, filter="data")
        packed.unlink()
    return folder


def run(name: str, commit: str, into: Path) -> Path:
    """The folder of the results of a command at a commit."""
    folder, output = program(commit, into), into / commit / name
    if not (output / "done").exists():
        words = shlex.split(COMMANDS[name])
        code = f"import sys; sys.path.insert(0, {str(folder)!r}); from workbench.cli import main; sys.exit(main())"
        environment = os.environ | {"PYTHONPATH": str(folder)}
        done = subprocess.run([sys.executable, "-c", code, *words, "-o", str(output)], cwd=folder, env=environment,
                              capture_output=True, text=True)
        output.mkdir(exist_ok=True)
        (output / "said").write_text(done.stdout + done.stderr)
        (output / "done").write_text(f"{done.returncode}\n")
    return output


def numbers(folder: Path) -> dict[str, float]:
    """All numbers of JSON, Parquet and CSV files of a folder, by file and key."""
    found: dict[str, float] = {}
    for path in sorted(folder.rglob("*.json")):
        found |= {f"{path.relative_to(folder)}:{key}": value for key, value in _leaves(json.loads(path.read_text()))}
    for path in sorted(folder.rglob("*.parquet")):
        found |= {f"{path.relative_to(folder)}:{key}": value for key, value in _leaves(read_table(path).to_pylist())}
    for path in sorted(folder.rglob("*.csv")):
        with path.open(newline="") as lines:
            for row, cells in enumerate(csv.reader(line for line in lines if not line.startswith("#"))):
                for column, cell in enumerate(cells):
                    try:
                        found[f"{path.relative_to(folder)}:{row}.{column}"] = float(cell)
                    except ValueError:
                        continue
    return {key: value for key, value in found.items() if not any(each in key for each in LEFT_OUT)}


def _leaves(content: Any, key: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(content, dict):
        for name, value in content.items():
            yield from _leaves(value, f"{key}.{name}")
    elif isinstance(content, list):
        for index, value in enumerate(content):
            yield from _leaves(value, f"{key}[{index}]")
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield key, float(content)


def differences(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    """Relative differences of the numbers under equal keys."""
    return {key: abs(after[key] - value) / max(abs(value), abs(after[key]), 1e-300)
            for key, value in before.items() if key in after and not (math.isnan(value) and math.isnan(after[key]))
            and after[key] != value}


def main() -> None:
    """Run the commands at both commits, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("--into", type=Path, required=True)
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    options = parser.parse_args()
    for name in options.only:
        folders = [run(name, commit, options.into.resolve()) for commit in (options.before, options.after)]
        status = [(folder / "done").read_text().strip() for folder in folders]
        before, after = map(numbers, folders)
        off = differences(before, after)
        worst = sorted(off, key=lambda key: -off[key])
        print(f"{name}: status {' and '.join(status)}, {len(before.keys() & after.keys())} numbers compared, "
              f"{len(before.keys() - after.keys())} before alone, {len(after.keys() - before.keys())} after alone, "
              f"{sum(value > AGREE for value in off.values())} differ by more than {AGREE:g}"
              + (f", the largest by {off[worst[0]]:.2g}: {worst[0]}" if worst else ""), flush=True)


if __name__ == "__main__":
    main()
