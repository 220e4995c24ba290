"""What a study costs: points over six dimensions of a chip as a newcomer writes it, killed and resumed, and on Dask.

    .venv/bin/python tests/benchmarks/study.py [--points 10000] [--jobs 2] [--kills 20] [--dask]

The chip is that of `examples/03_your_own_chip.py`, all its thicknesses and the radius of its cavity within the
tolerances of a printer. Prints the seconds for the model, the points, the full solves and the files, then what a point
takes alone and the share of processor time that is not spent on points. With --kills the command is killed with
SIGKILL so many times at random moments, and resumed; with --dask two workers on loopback do it again. Both tables are
compared with the first, byte by byte.
"""

from __future__ import annotations

import argparse
import os
import pickle
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402
from support import with_fields  # noqa: E402

from workbench.design.parts import ReducedModels, numbers_by_name, parts_of  # noqa: E402
from workbench.design.plan import Study, read_study  # noqa: E402
from workbench.design.study import study  # noqa: E402
from workbench.files.quantities import parse_quantity  # noqa: E402
from workbench.jobs.cluster import dask_cluster  # noqa: E402
from workbench.jobs.progress import no_progress  # noqa: E402

STUDY = """
[study]
chip = "chip.toml"
figures = ["f0", "z_min", "q", "mean_e_ac", "p0", "trap_offset", "axial_stiffness"]
[sample]
method = "sobol"
points = {points}
seed = 1
[vary]
transducer.thickness = {{ tolerance = "20 um" }}
couplant.thickness = {{ tolerance = "10 um" }}
substrate.thickness = {{ tolerance = "50 um" }}
sidewall.thickness = {{ tolerance = "30 um" }}
superstrate.thickness = {{ tolerance = "50 um" }}
"cavity.radius" = {{ tolerance = "100 um" }}
"""


def chip_text() -> str:
    """The chip file that the example writes."""
    text = (ROOT / "examples/03_your_own_chip.py").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    exec(text[text.index("LAYERS ="):text.index("with tempfile")], names)  # the example's own lines
    return str(names["text"])


def timed(plan: Study, folder: Path, jobs: int, kept: Measurements) -> bytes:
    """One run without an interruption; the bytes of its table."""
    reached: dict[str, float] = {}

    def show(text: str, share: float) -> None:
        reached[text.rpartition(": ")[2]] = time.perf_counter()

    begun = time.perf_counter()
    found = study(plan, folder, jobs=jobs, progress=show)
    ended = time.perf_counter()
    stages = {"model": reached["model"] - begun, "points": reached["points"] - reached["model"],
              "full solves": reached["full solves"] - reached["points"], "files": ended - reached["full solves"],
              "whole": ended - begun}
    for name, seconds in stages.items():
        kept.add(name, seconds, "s")
    print(f"{plan.size} points: " + ", ".join(f"{name} {seconds:.1f} s" for name, seconds in stages.items()))
    overhead(plan, folder, jobs, kept)
    for name in plan.figures:
        off = [abs(each.difference) for each in found.confirmations if each.figure == name]
        extent = next(s.highest - s.lowest for s in found.statistics if s.figure == name)
        print(f"  {name}: off from {len(off)} full solves by {100.0 * max(off) / extent:.2g} % of its range at most")
    return (folder / "study.parquet").read_bytes()


def overhead(plan: Study, folder: Path, jobs: int, kept: Measurements) -> None:
    """Processor time of all points again, the model being on the disk, against that of points alone."""
    (part,) = parts_of(plan)
    model = ReducedModels().model(plan, part, folder / "models" / "0.npz", no_progress)
    few = part.points[:200]
    begun = time.process_time()
    for point in few:
        model(numbers_by_name(plan, point))
    alone = (time.process_time() - begun) / len(few)
    first = (folder / "study.parquet").read_bytes()
    shutil.rmtree(folder / "points")
    (folder / "points").mkdir()
    spent = -processor_time()
    study(with_fields(plan, confirmed=0), folder, jobs=jobs)
    spent += processor_time()
    share = 1.0 - plan.size * alone / spent
    kept.add("a point alone, processor time", alone, "s")
    kept.add("share of processor time that is not spent on points", share, "1")
    size = len(pickle.dumps(model)) / 1e6
    same = (folder / "study.parquet").read_bytes() == first
    print(f"a point alone {1e3 * alone:.1f} ms, model {size:.0f} MB; {100.0 * share:.1f} % of the processor time is "
          f"not spent on points, the start of {jobs} processes and the files included; the table is "
          f"{'the same' if same else 'ANOTHER ONE'}")


def processor_time() -> float:
    """Seconds of this process and of those it has begun and that have ended."""
    return sum(each.ru_utime + each.ru_stime for each in map(resource.getrusage, (
        resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def killed(folder: Path, jobs: int, kills: int, seconds: float) -> bytes:
    """`workbench study` killed so many times, at moments up to `seconds` after its begin, then left alone."""
    command = [sys.executable, "-P", "-m", "workbench.cli", "study", str(folder / "study.toml"), "--jobs", str(jobs),
               "-o", str(folder / "killed")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    draw = random.Random(1)
    for number in range(kills):
        with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                              cwd=folder) as process:
            time.sleep(seconds * draw.random())
            process.send_signal(signal.SIGKILL)
        points = len(list((folder / "killed" / "points").glob("[0-9]*.npz")))
        print(f"  kill {number + 1}: {points} files of points", flush=True)
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                   cwd=folder)
    return (folder / "killed" / "study.parquet").read_bytes()


def on_dask(plan: Study, folder: Path) -> bytes:
    """The same by a cluster of two workers on loopback."""
    from distributed import LocalCluster

    os.environ["PYTHONPATH"] = str(ROOT)
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", protocol="tcp",
                      dashboard_address=None) as cluster, dask_cluster(cluster.scheduler_address) as (pool, threads):
        begun = time.perf_counter()
        study(plan, folder / "dask", executor=pool, jobs=threads)
        print(f"two Dask workers: {time.perf_counter() - begun:.1f} s")
    return (folder / "dask" / "study.parquet").read_bytes()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--within", default="13 s", help="a kill comes at most so long after the begin "
                        "(default 13 s, for a study of a minute)")
    parser.add_argument("--dask", action="store_true")
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name, measurements(arguments.json) as kept:
        folder = Path(name)
        (folder / "chip.toml").write_text(chip_text(), encoding="utf-8")
        (folder / "study.toml").write_text(STUDY.format(points=arguments.points), encoding="utf-8")
        plan = read_study(folder / "study.toml")
        first = timed(plan, folder / "whole", arguments.jobs, kept)
        if arguments.kills:
            within = parse_quantity(arguments.within, "time", source="command line", field="--within")
            same = killed(folder, arguments.jobs, arguments.kills, within) == first
            print(f"killed {arguments.kills} times: the table is {'the same' if same else 'ANOTHER ONE'}")
        if arguments.dask:
            print(f"on Dask: the table is {'the same' if on_dask(plan, folder) == first else 'ANOTHER ONE'}")


if __name__ == "__main__":
    main()
