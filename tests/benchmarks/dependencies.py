"""The tests of `./check` with the oldest or the newest version of each dependency.

    .venv/bin/python tests/benchmarks/dependencies.py oldest --into FOLDER [arguments of pytest]
    .venv/bin/python tests/benchmarks/dependencies.py newest --into FOLDER [arguments of pytest]

FOLDER becomes a virtual environment of the Python that runs this file (2.5 GB); later runs use it again. `oldest`
installs exactly the lower bound of each requirement in `pyproject.toml`: pip ends the command if a bound is not a
version, or if two bounds exclude each other. The packages that these require are the newest that fit. `newest` installs
the newest versions that fit together. The checkout is installed in place. The command prints the versions, then
`./check` runs its tests in this environment, without lint and types. The status is that of pip or `./check`.

Only benchmarks use the extra `oracle`, so it is not installed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = ("dask", "docs", "test", "visa")


def lower_bounds(project: Path) -> dict[str, str]:
    """The lower bound of each requirement in `project`, with those of the build and of EXTRAS.

    Raises
    ------
    ValueError
        A requirement is not of the form NAME>=VERSION.
    """
    stated = tomllib.loads(project.read_text(encoding="utf-8"))
    extras = stated["project"]["optional-dependencies"]
    bounds = {}
    for requirement in (*stated["build-system"]["requires"], *stated["project"]["dependencies"],
                        *(each for name in EXTRAS for each in extras[name])):
        parts = re.fullmatch(r"([\w-]+)>=([\d.]+)", requirement)
        if parts is None:
            raise ValueError(f"{project}: received the requirement {requirement!r}; expected NAME>=VERSION")
        bounds[parts[1]] = parts[2]
    return bounds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     allow_abbrev=False)
    parser.add_argument("which", choices=("oldest", "newest"))
    parser.add_argument("--into", type=Path, required=True, metavar="FOLDER", help="the virtual environment")
    options, arguments = parser.parse_known_args()
    folder, bounds = options.into.resolve(), lower_bounds(ROOT / "pyproject.toml")
    pip = (folder / "bin" / "python", "-m", "pip", "--disable-pip-version-check")
    if not pip[0].exists():
        venv.create(folder, with_pip=True, symlinks=True)
    versions = ["--upgrade", "--upgrade-strategy", "eager"]
    if options.which == "oldest":
        pinned = folder / "oldest.txt"
        pinned.write_text("".join(f"{name}=={bound}\n" for name, bound in bounds.items()), encoding="utf-8")
        versions = ["--constraint", str(pinned)]
    done = subprocess.run([*pip, "install", "--quiet", *versions, "setuptools", "--editable",
                           f"{ROOT}[{','.join(EXTRAS)}]"])
    if done.returncode:
        return done.returncode
    listed = json.loads(subprocess.run([*pip, "list", "--format", "json"], check=True, stdout=subprocess.PIPE).stdout)
    installed = {re.sub(r"[-_.]+", "-", package["name"]).lower(): package["version"] for package in listed}
    for name, bound in sorted(bounds.items()):
        print(f"{name} {installed[name]} (requirement: {bound} or later)")
    sys.stdout.flush()
    return subprocess.run([ROOT / "check", *arguments], env={**os.environ, "VENV": str(folder)}).returncode


if __name__ == "__main__":
    sys.exit(main())
