"""What a job is said to take before it starts, against what it takes: unknowns, solves, memory and processor time.

    python tests/benchmarks/job_size.py              # ten jobs, each in a process of its own (4 minutes)
    python tests/benchmarks/job_size.py --only disc  # those whose name holds this

The constants of `workbench.model.job_size` are chosen on these rows. Memory is the peak of the process less what it has
when all libraries are loaded; time that of the processor. The last line is the estimate of the band with a lost point,
which is never run.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.model.discretisation import Discretisation, discretisation  # noqa: E402
from workbench.model.job_size import JobSize, job_size, shown_memory, shown_time  # noqa: E402
from workbench.model.problem import fill  # noqa: E402

CHIPS = ROOT / "geometry/chips"


@dataclass(frozen=True)
class Job:
    """A chip in a state, an accuracy, elements smaller by ``finer``, a band (Hz; that of the chip if None)."""

    chip: str
    state: str
    accuracy: float
    finer: float = 1.0
    band: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """For the table."""
        band = "" if self.band is None else f" {self.band[0] / 1e6:g}-{self.band[1] / 1e6:g} MHz"
        return f"{self.chip} {100.0 * self.accuracy:g} %{'' if self.finer == 1.0 else f' / {self.finer:g}'}{band}"

    @property
    def made(self) -> Discretisation:
        """Of its mesh."""
        found = discretisation(self.accuracy)
        return found if self.finer == 1.0 else found.refined(self.finer)

    def estimated(self) -> JobSize:
        """What it is said to take."""
        chip = read_chip(CHIPS / f"{self.chip}.toml")
        device = fill(chip, self.state, Registry())
        return job_size(device.section, device.materials, self.made, self.band or chip.band)


JOBS = (
    Job("disc_20x2", "default", 5e-3), Job("disc_20x2", "default", 5e-4), Job("disc_gel_pla", "default", 5e-4),
    Job("reference_chip", "filled", 5e-3), Job("reference_chip", "filled", 5e-4), Job("reference_chip", "filled", 1e-4),
    Job("reference_chip", "filled", 5e-4, 1.5), Job("reference_chip", "filled", 5e-4, 2.0),
    Job("disc_20x2", "default", 5e-3, band=(0.3e6, 3e6)), Job("disc_20x2", "default", 5e-3, band=(0.2e6, 5e6)),
)

LOST_POINT = Job("reference_chip", "filled", 5e-4, band=(0.95e6, 108e6))


def run(job: Job) -> None:
    """Run a job and print what it took, in a process of its own."""
    import resource

    from workbench.simulation.run import simulate

    warnings.simplefilter("ignore")
    if importlib.util.find_spec("rslab") is not None:
        importlib.import_module("rslab")
    chip = read_chip(CHIPS / f"{job.chip}.toml")
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    found = simulate(chip, job.state, accuracy=job.made, band=job.band or chip.band)
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(json.dumps([found.unknowns, found.solves, 1024.0 * taken, time.process_time() - began]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="jobs whose name holds this")
    parser.add_argument("--run", type=int, help=argparse.SUPPRESS)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    if arguments.run is not None:
        run(JOBS[arguments.run])
        return
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    print(f"{'job':36}{'unknowns':>18}{'solves':>10}{'memory, MB':>14}{'seconds':>14}   (said / measured)")
    for number, job in enumerate(JOBS):
        if arguments.only not in job.name:
            continue
        said = job.estimated()
        done = subprocess.run([sys.executable, __file__, "--run", str(number)], capture_output=True, text=True,
                              check=True, env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"})
        unknowns, solves, memory, seconds = json.loads(done.stdout)
        print(f"{job.name:36}{said.unknowns:9.0f}/{unknowns:8.0f}{said.solves:6.1f}/{solves:3d}"
              f"{said.memory / 1e6:8.0f}/{memory / 1e6:5.0f}{said.seconds:8.1f}/{seconds:5.1f}", flush=True)
        for figure, ratio in (("unknowns", said.unknowns / unknowns), ("memory", said.memory / memory),
                              ("seconds", said.seconds / seconds)):
            kept.add(f"{job.name}, {figure}, said over measured", ratio, "1")
    began = time.perf_counter()
    lost = LOST_POINT.estimated()
    print(f"{LOST_POINT.name}: {lost.unknowns / 1e6:.3g} million unknowns, {shown_memory(lost.memory)}, "
          f"{shown_time(lost.seconds)}; estimated in {time.perf_counter() - began:.3f} s")


if __name__ == "__main__":
    main()
