"""The simulated bench of the examples 11 and 17: a folder of commands, and the devices that only the bench knows."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FILES = Path(__file__).resolve().parent / "whole_way"
WORKBENCH = (sys.executable, "-P", "-m", "workbench.cli")

#: The mesh of the bench is finer than those of fits and diagnosis, which therefore have an error of their own mesh.
FINER = ("--accuracy", "0.02 %")

#: Noise of the converter (steps), as in recordings of real oscilloscopes of the series.
NOISE = ("--noise", "0.6")

#: True thickness (m) of the gel of each chip file, which states 20 um.
GEL = {"disc_on_pla.toml": 24e-6, "chip.toml": 15e-6}

COMPENSATION = """
[compensation]
open = "open.h5"
short = "short.h5"
load = "load.h5"
load_resistance = "50 ohm"
load_tolerance = "0.1 %"
"""


class Bench:
    """A folder in which commands are run. Its subfolder ``truth`` is for the simulated bench alone."""

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
        """Whether the program has a command."""
        return subprocess.run((*WORKBENCH, command, "--help"), capture_output=True).returncode == 0

    def measure(self, name: str, *held: str, compensated: bool = True) -> None:
        """Connect a device to the simulated bench, and measure it into NAME.h5, NAME.csv and NAME.html."""
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


#: Options for the simulated bench alone.
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
