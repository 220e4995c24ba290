"""Ctrl-C at many moments of a command: no traceback, status 130, and the sentence names what is on disk.

    python tests/benchmarks/interruption.py                          # 20 moments of four commands (some 15 minutes)
    python tests/benchmarks/interruption.py --command study --moments 6

Every command runs in a session of its own and is interrupted as a terminal does it: the whole group of processes at
once. The moments lie between 0.25 s, in the middle of the loading of libraries, and the whole time that the command
takes, closer together at first; before, Python itself is still beginning (on a busy machine it takes longer), and what
it prints then is its own. A moment at which the command had finished is not counted.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

DISC, CAMPAIGN = ROOT / "geometry/chips/disc_20x2.toml", ROOT / "examples/small_campaign"

#: The commands, each without its folder of results.
COMMANDS = {
    "simulate": ["simulate", str(CAMPAIGN / "chip.toml"), "--accuracy", "0.5 %"],
    "fit": ["fit", "polymer", str(CAMPAIGN / "empty.csv"), "--chip", str(CAMPAIGN / "chip.toml"), "--state", "empty",
            "--region", "substrate", "--free", "shear_modulus,couplant.thickness", "--accuracy", "0.5 %",
            "--tries", "2"],
    "diagnose": ["diagnose", str(CAMPAIGN / "campaign.toml"), "--accuracy", "0.5 %", "--minutes", "1"],
    "study": ["study", str(ROOT / "examples/small_study/study.toml")],
}

#: Seconds after which a command that was interrupted counts as hanging.
PATIENCE = 120.0


@dataclass(frozen=True)
class Ended:
    """How a command ended that was interrupted after so many ``seconds``: its ``status``, what it ``said``, the files
    it ``left`` by then, and how long it took to ``end``. ``status`` 0 or 1 where it had finished before."""

    seconds: float
    status: int
    said: str
    left: frozenset[str]
    end: float

    @property
    def faults(self) -> list[str]:
        """What is not as it should be."""
        found = ["traceback"] if "Traceback" in self.said else []
        found += [] if self.status == 130 else [f"status {self.status}"]
        return found if self.folder_as_said else [*found, "folder is not as said"]

    @property
    def folder_as_said(self) -> bool:
        """Whether the sentence names all that is on disk, and nothing else."""
        if re.search("interrupted: (nothing was begun|.* holds nothing)", self.said):
            return not self.left
        listed = re.search(r"^interrupted: \S+ holds (.*?)(?: and (\d+) more files)?(?:; |$)", self.said, re.MULTILINE)
        if listed is None:
            return False
        names = set(listed.group(1).split(", "))
        return names <= self.left and len(self.left) == len(names) + int(listed.group(2) or 0)


def interrupted(command: list[str], seconds: float, folder: Path) -> Ended:
    """One run, interrupted after so many seconds."""
    whole = [sys.executable, "-m", "workbench", *command, "-o", str(folder)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "1000", "TERM": "dumb"}
    with subprocess.Popen(whole, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment,
                          start_new_session=True) as process:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=seconds)
        began = time.perf_counter()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        end = time.perf_counter() - began
    left = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    visible = frozenset(name for name in left if name != "INCOMPLETE.txt" and not name.startswith(".")
                        and "/." not in name)
    return Ended(seconds, process.returncode, said, visible, end)


def moments(command: list[str], count: int) -> list[float]:
    """When to interrupt a command (s): from its beginning to its end, which one whole run tells."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        subprocess.run([sys.executable, "-m", "workbench", *command, "-o", str(Path(folder) / "out")],
                       env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, check=False)
        whole = time.perf_counter() - began
    return [float(each) for each in np.geomspace(0.25, 0.95 * whole, count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--command", choices=COMMANDS, action="append", help="only this one (default: all)")
    parser.add_argument("--moments", type=int, default=20)
    with_json(parser)
    arguments = parser.parse_args()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # What a shell in the background ignores, commands would inherit.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    print(f"{'command':10}{'moments':>8}{'from, to s':>14}{'finished':>9}{'faults':>7}"
          f"{'ends after, median, worst s':>29}")
    for name in arguments.command or COMMANDS:
        runs = []
        for seconds in moments(COMMANDS[name], arguments.moments):
            with tempfile.TemporaryDirectory() as folder:
                runs.append(interrupted(COMMANDS[name], seconds, Path(folder) / "out"))
        cut = [each for each in runs if each.status not in (0, 1) or "Traceback" in each.said]
        ends = [each.end for each in cut]
        faults = [each for each in cut if each.faults]
        print(f"{name:10}{len(runs):8d}{runs[0].seconds:7.1f}{runs[-1].seconds:7.1f}{len(runs) - len(cut):9d}"
              f"{len(faults):7d}{np.median(ends):22.2f}{max(ends):7.2f}", flush=True)
        for each in faults:
            print(f"    {each.seconds:.2f} s: {', '.join(each.faults)}: {each.said[-400:]!r}; left {sorted(each.left)}")
        kept.add(f"{name}, faults of {len(cut)} interruptions", len(faults), "1")
        kept.add(f"{name}, longest end", max(ends), "s")


if __name__ == "__main__":
    main()
