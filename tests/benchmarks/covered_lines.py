"""Lines of each package that the tests run, at some commits.

    .venv/bin/python -m pip install --target FOLDER/tools slipcover
    .venv/bin/python tests/benchmarks/covered_lines.py BEFORE AFTER --into FOLDER [arguments of pytest]

Each file of tests runs in a process of its own with the program as it was at the commit, two at a time; a finished one
is not run again. Lines that only other processes run (commands, workers) do not count. For each commit it prints the
share of lines of `workbench`, `geometry` and `materials`, by package of the first level, and the tests that failed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from records_agree import program

SOURCES = ("workbench", "geometry", "materials")


def run(file: Path, folder: Path, tools: Path, output: Path, arguments: list[str]) -> None:
    """Run a file of tests of the program in a folder, and write the lines that it runs to `output`."""
    if output.exists():
        return
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (folder, tools))), "OPENBLAS_NUM_THREADS": "1",
                                "OMP_NUM_THREADS": "1", "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    unfinished = output.with_suffix(".unfinished")
    done = subprocess.run([sys.executable, "-m", "slipcover", "--source", ",".join(SOURCES), "--json", "--out",
                           str(unfinished), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W",
                           "ignore::pytest.PytestAssertRewriteWarning", str(file), *arguments],
                          cwd=folder, env=environment, capture_output=True, text=True)
    output.with_suffix(".txt").write_text(done.stdout[-2000:] + done.stderr[-2000:], encoding="utf-8")
    if unfinished.exists():
        unfinished.rename(output)


def covered(folder: Path) -> dict[str, tuple[int, int]]:
    """Lines run and all lines, by package, of all files of results in a folder."""
    ran, every = defaultdict[str, set[int]](set), defaultdict[str, set[int]](set)
    for path in folder.glob("*.json"):
        for name, lines in json.loads(path.read_text(encoding="utf-8"))["files"].items():
            ran[name] |= set(lines["executed_lines"])
            every[name] |= {*lines["executed_lines"], *lines["missing_lines"]}
    counts = defaultdict[str, list[int]](lambda: [0, 0])
    for name, lines in every.items():
        parts = Path(name).parts
        start = next(k for k, part in enumerate(parts) if part in SOURCES)
        package = "/".join(parts[start:start + 2] if len(parts) > start + 2 else parts[start:start + 1])
        counts[package][0] += len(ran[name])
        counts[package][1] += len(lines)
    return {package: (some, total) for package, (some, total) in sorted(counts.items())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="+")
    parser.add_argument("--into", type=Path, required=True)
    options, arguments = parser.parse_known_args()
    into = options.into.resolve()
    for commit in options.commits:
        folder, results = program(commit, into), into / commit / "covered"
        results.mkdir(exist_ok=True)
        files = sorted((folder / "tests").rglob("test_*.py"))
        with ThreadPoolExecutor(2) as pool:
            for file in files:
                name = "-".join(file.relative_to(folder / "tests").with_suffix(".json").parts)
                pool.submit(run, file, folder, into / "tools", results / name, arguments)
        print(f"{commit}: {len(list(results.glob('*.json')))} of {len(files)} files of tests")
        for package, (some, total) in covered(results).items():
            print(f"  {package:28} {100.0 * some / total:5.1f} % of {total} lines")
        for path in sorted(results.glob("*.txt")):
            if " failed" in (said := path.read_text(encoding="utf-8")):
                print(f"  {path.stem}: {said.strip().splitlines()[-1]}")


if __name__ == "__main__":
    main()
