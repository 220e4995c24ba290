"""Figures of benchmarks in a file that a program reads, and two such files side by side.

    .venv/bin/python tests/benchmarks/range_model.py --json before.json     (and again with another commit: after.json)
    .venv/bin/python tests/benchmarks/measurements.py before.json after.json
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Measurements:
    """Named figures with their units, in the order they were measured."""

    figures: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, name: str, value: float, unit: str) -> None:
        """Keep one figure; a name that is there already is measured again."""
        self.figures[name] = {"value": float(value), "unit": unit}


def with_json(parser: argparse.ArgumentParser) -> None:
    """Give a benchmark the option ``--json FILE``."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file too")


@contextmanager
def measurements(path: Path | None) -> Iterator[Measurements]:
    """Figures to add to, written to `path` at the end, with the commit and the command; also after an interruption."""
    found = Measurements()
    try:
        yield found
    finally:
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({
                "command": [Path(sys.argv[0]).name, *sys.argv[1:]], "commit": _commit(),
                "python": platform.python_version(), "processors": os.cpu_count(), "figures": found.figures,
            }, indent=2) + "\n", encoding="utf-8")


def alone(function: Callable[..., Any], *arguments: object) -> Any:
    """What a function returns in a process of its own: programs that are compared bring libraries of the same name."""
    with ProcessPoolExecutor(max_workers=1, mp_context=multiprocessing.get_context("spawn"),
                             initializer=warnings.simplefilter, initargs=("ignore",)) as process:
        return process.submit(function, *arguments).result()


def _commit() -> str:
    """The commit that is checked out, with a star where files differ from it."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    return git("rev-parse", "--short", "HEAD") + ("*" if git("status", "--porcelain") else "")


def compared(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of a table: name, unit, both figures and their ratio; a figure that one of them lacks is left blank."""
    rows: list[tuple[str, ...]] = [("", "unit", before["commit"], after["commit"], "ratio")]
    for name in dict.fromkeys([*before["figures"], *after["figures"]]):
        one, other = (each["figures"].get(name) for each in (before, after))
        ratio = f"{other['value'] / one['value']:.3g}" if one and other and one["value"] else ""
        rows.append((name, (one or other)["unit"], *("" if each is None else f"{each['value']:.4g}"
                                                     for each in (one, other)), ratio))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    options = parser.parse_args()
    rows = compared(*(json.loads(path.read_text(encoding="utf-8")) for path in (options.before, options.after)))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    for row in rows:
        print("  ".join(cell.ljust(width) if k < 2 else cell.rjust(width)
                        for k, (cell, width) in enumerate(zip(row, widths, strict=True))))


if __name__ == "__main__":
    main()
