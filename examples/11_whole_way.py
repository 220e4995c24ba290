"""The whole way
=============

The whole way, from the command line alone: the bench, a transducer, a polymer, a chip, and what it does not explain.

    python examples/11_whole_way.py [-o out/whole_way]

The bench is the simulated one, with leads, probes, gains that are off, 8 bit and noise. What it holds is in
``whole_way/truth``, which no other command sees: the constants of the disc and of the printed PLA differ from the
nominal ones, and the gel below the sample and below the chip is not as thick as their files say. Everything else knows
what somebody at a bench would: dimensions, densities, data sheets.

    1. open, short and load are recorded
    2. the disc is measured, and its constants are fitted and saved
    3. the disc with a sample on it is measured, and the moduli of the sample are fitted and saved
    4. the chip is predicted with both, measured empty and filled, and compared
    5. where the two differ is diagnosed

Every command is printed, and the constants found are at the end set beside those that the bench was given. Each stage
leaves a report below the output folder. The materials that are saved are there too: your own are not touched. About
ten minutes on two busy cores.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import workbench as wb

FILES = Path(__file__).resolve().parent / "whole_way"
WORKBENCH = (sys.executable, "-P", "-m", "workbench.cli")

#: The bench's mesh is finer than those of the fits and of the diagnosis, so that these have to do with an error of
#: their own mesh.
FINER = ("--accuracy", "0.02 %")

#: Of the converter, in steps: what recordings of real oscilloscopes of the series show.
NOISE = ("--noise", "0.6")

#: What lies on the disc, and how thick (m) the gel below it really is; the files say 20 um.
GEL = {"disc_on_pla.toml": 24e-6, "chip.toml": 15e-6}

#: By how much the simulated generator's clock is off, relative: what `workbench.instruments.simulated` has by default.
CLOCK = 5e-6

COMPENSATION = """
[compensation]
open = "open.h5"
short = "short.h5"
load = "load.h5"
load_resistance = "50 ohm"
load_tolerance = "0.1 %"
"""


class Bench:
    """A folder in which commands are run: what is seen there, and what only the simulated bench sees."""

    def __init__(self, folder: Path) -> None:
        shutil.copytree(FILES, folder)
        self.folder = folder
        for name, thickness in GEL.items():
            text = (folder / name).read_text(encoding="utf-8")
            (folder / "truth" / name).write_text(text.replace('"20 um"', f'"{1e6 * thickness:g} um"'), encoding="utf-8")
        shutil.copy(folder / "disc.toml", folder / "truth")
        self._seed = 0

    def run(self, *command: str) -> None:
        """Run a command to its end."""
        print(f"\n$ workbench {shlex.join(command)}", flush=True)
        done = subprocess.run((*WORKBENCH, *command), cwd=self.folder, env=self._environment("data"))
        if done.returncode:
            raise SystemExit(f"workbench {command[0]} ended with status {done.returncode}")

    def has(self, command: str) -> bool:
        """Whether there is such a command."""
        return subprocess.run((*WORKBENCH, command, "--help"), capture_output=True).returncode == 0

    def measure(self, name: str, *held: str, compensated: bool = True) -> None:
        """Let the simulated bench hold something, and measure it into NAME.h5, NAME.csv and NAME.html."""
        text = (self.folder / "bench.toml").read_text(encoding="utf-8") + COMPENSATION * compensated
        (self.folder / f"bench_{name}.toml").write_text(f'{text}\n[device]\nname = "{name}"\n', encoding="utf-8")
        with self._served(*held):
            self.run("measure", f"bench_{name}.toml", "-o", f"{name}.h5")

    @contextmanager
    def _served(self, *held: str) -> Iterator[None]:
        self._seed += 1
        ports = self.folder / "ports"
        command = ("bench", "simulate", *held, "--ports", "ports", "--reference", "10 ohm", *NOISE,
                   "--seed", str(self._seed))
        print(f"\n$ workbench {shlex.join(command)} &", flush=True)
        with subprocess.Popen((*WORKBENCH, *command), cwd=self.folder, env=self._environment("truth_data"),
                              stdout=subprocess.DEVNULL) as served:
            try:
                while not all((ports / name).exists() for name in ("generator", "oscilloscope")):
                    if served.poll() is not None:
                        raise SystemExit(f"the simulated bench ended with status {served.returncode}")
                    time.sleep(0.1)
                yield
            finally:
                served.terminate()

    def _environment(self, data: str) -> dict[str, str]:
        return {**os.environ, "XDG_DATA_HOME": str(self.folder / data), "XDG_CACHE_HOME": str(self.folder / "cache"),
                "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


#: What only the simulated bench is told.
HIDDEN = ("--materials", "truth", *FINER)


def measured_materials(bench: Bench) -> None:
    """The disc and the printed sample, measured, fitted and saved."""
    for name, held in (("open", "open"), ("short", "short"), ("load", "50 ohm")):
        bench.measure(name, "--connect", held, compensated=False)

    bench.measure("disc", "truth/disc.toml", *HIDDEN)
    bench.run("fit", "pzt", "disc.csv", "--chip", "disc.toml", "--material", "pzt4/comsol_nominal",
              "--free", "default,bench.clock", "--save", "pzt_bench/disc", "-o", "fit_disc")

    bench.measure("sample", "truth/disc_on_pla.toml", *HIDDEN)
    bench.run("fit", "polymer", "sample.csv", "--chip", "disc_on_pla.toml", "--material", "pla/acevedo_2026",
              "--free", "default,couplant.thickness,bench.clock", "--save", "pla_bench/print", "-o", "fit_sample")


def whole_way(folder: Path) -> None:
    """All stages; everything they leave is below `folder`, which must not exist."""
    bench = Bench(folder)
    measured_materials(bench)
    bench.run("materials", "list")
    bench.run("simulate", "chip.toml", "-o", "chip")
    for state in ("empty", "filled"):
        bench.measure(f"chip_{state}", "truth/chip.toml", "--state", state, *HIDDEN)
        bench.run("compare", f"chip_{state}.csv", "chip.toml", "--state", state, "-o", f"compare_{state}")
    if bench.has("diagnose"):
        bench.run("diagnose", "campaign.toml", "-o", "diagnosis")

    print("\nWhat was found beside what the bench held:")
    outcome(folder)
    print("\nReports:", *sorted(str(path) for path in folder.rglob("*.html")), sep="\n  ")


def outcome(folder: Path) -> None:
    """Print every fitted parameter with its interval beside the truth, and whether the one holds the other."""
    print(f"{'':18}{'found':>14}{'95 % interval':>32}{'truth':>14}{'off (%)':>10}")
    registry, held = wb.Registry((folder / "truth",)), 0
    found = [(name, one) for fit, name in (("fit_disc", "pzt_bench/disc"), ("fit_sample", "pla_bench/print"))
             for one in json.loads((folder / fit / "fit.json").read_text(encoding="utf-8"))["parameters"]]
    for material, one in found:
        truth = true_value(one["name"], registry, material)
        value, low, high = one["value"], one["low"], one["high"]
        inside = low <= truth <= high
        held += inside
        name = one["name"].rpartition("/")[2].partition(".")[2] if "/" in one["name"] else one["name"]
        print(f"{name:18}{value:14.7g}{low:15.7g} to{high:14.7g}{truth:14.7g}{100.0 * (value / truth - 1.0):+10.3f}  "
              f"{'inside' if inside else 'OUTSIDE'}")
    print(f"{held} of {len(found)} intervals hold the truth")


def true_value(parameter: str, registry: wb.Registry, material: str) -> float:
    """What the bench was given, in SI: a coefficient of a material, its loss, the gel's thickness, or the clock."""
    if parameter == "bench.clock":
        return CLOCK
    if parameter == "couplant.thickness":
        return GEL["disc_on_pla.toml"]
    coefficient = parameter.rpartition("/")[2].partition(".")[2]
    value = registry.load(material).parameters()[coefficient.removesuffix(".loss")]
    return value.imag if coefficient.endswith(".loss") else value.real


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/whole_way"), help="a folder that does not exist")
    options = parser.parse_args()
    if options.output.exists():
        parser.error(f"{options.output} exists already; name another folder with -o, or remove it")
    whole_way(options.output.resolve())


if __name__ == "__main__":
    main()
