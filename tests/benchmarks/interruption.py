"""Ctrl-C and kills at many moments of a command.

    python tests/benchmarks/interruption.py                          # 20 moments of four commands (some 15 minutes)
    python tests/benchmarks/interruption.py --command study --moments 6
    python tests/benchmarks/interruption.py --kills 200 --beside 50  # kills over all commands (some 40 minutes)

After Ctrl-C there is no traceback, the status is 130, and the sentence names the files on disk. After a kill every file
is whole and in the manifest, the mark is there unless the run had ended, files of the user are as they were, finished
points stay, and the same command completes the folder. A second command beside the first one is refused.

Every command runs in a session of its own and is interrupted as a terminal does it: the whole group of processes at
once. The moments lie between 0.25 s, in the middle of the loading of libraries, and the whole time that the command
takes, closer together at first; before, Python itself is still beginning (on a busy machine it takes longer), and what
it prints then is its own. A moment at which the command had finished is not counted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from workbench.files.output import MARK  # noqa: E402
from workbench.files.ownership import NEW, RUN, STATE, Manifest  # noqa: E402

DISC, CAMPAIGN = ROOT / "geometry/chips/disc_20x2.toml", ROOT / "geometry/chips/small_campaign"

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


# --------------------------------------------------------------------------------------------------------------------
# Kills.

#: All commands that write into a folder, at settings that take seconds; {inputs} holds chips and recordings.
KILLED = {
    "simulate": "simulate {inputs}/chip.toml --accuracy 2% --points 41",
    "simulate --full": "simulate {inputs}/disc.toml --accuracy 2% --points 41 --full --no-cad --no-pictures",
    "compare": "compare {inputs}/empty.csv {inputs}/chip.toml --state empty --accuracy 2%",
    "render": "render {inputs}/chip.toml --at 1.02MHz --accuracy 2%",
    "mesh": "mesh {inputs}/disc.toml --converge --accuracy 2%",
    "export": "export {inputs}/chip.toml",
    "particles": "particles {inputs}/chip.toml --particle polystyrene --particle-radius 5um --drive 1Vpp --minutes 1 "
                 "--count 20 --accuracy 2% --no-animation",
    "sensitivity": "sensitivity {inputs}/disc.toml --accuracy 2% --points 21 --scalings 3",
    "tolerance": "tolerance {inputs}/disc.toml --figure f0 --accuracy 2% --samples 64",
    "fit": "fit polymer {inputs}/empty.csv --chip {inputs}/chip.toml --state empty --region substrate --free "
           "shear_modulus --accuracy 2% --tries 0 --force --save mine/k --materials {folder}-registry",
    "fit batch": "fit batch {inputs}/batch.toml --accuracy 2% --tries 0 --force --jobs 2",
    "diagnose": "diagnose {inputs}/empty.csv --chip {inputs}/chip.toml --state empty --accuracy 2% --minutes 0.2",
    "study": "study {inputs}/study.toml --jobs 2",
    "design": "design {inputs}/goal.toml --accuracy 2% --no-cad --jobs 1",
}

#: Files of the user that lie in every folder; no command writes their names.
MINE = {"notes.txt": b"mine", "models of mine/chip.step": b"ISO-10303-21; mine", ".hidden": b"mine"}

BATCH = """
[[recordings]]
name = "one"
kind = "polymer"
file = "empty.csv"
chip = "chip.toml"
state = "empty"
region = "substrate"
free = ["shear_modulus"]
[[recordings]]
name = "two"
kind = "polymer"
file = "empty.csv"
chip = "chip.toml"
state = "empty"
region = "substrate"
free = ["bulk_modulus"]
"""

GOAL = """
[goal]
chip = "disc.toml"
maximise = "q"
[variables]
transducer.thickness = { from = "1.95 mm", to = "2.05 mm", step = "0.01 mm" }
"""


def inputs_in(folder: Path) -> None:
    """The files that the commands are given."""
    folder.mkdir()
    for name in ("chip.toml", "empty.csv"):
        shutil.copy(CAMPAIGN / name, folder / name)
    shutil.copy(DISC, folder / "disc.toml")
    study = (ROOT / "examples/small_study/study.toml").read_text().replace("points = 64", "points = 100")
    (folder / "study.toml").write_text(study.replace('"chip.toml"', '"study_chip.toml"'))
    shutil.copy(ROOT / "examples/small_study/chip.toml", folder / "study_chip.toml")
    (folder / "batch.toml").write_text(BATCH)
    (folder / "goal.toml").write_text(GOAL)


def begun(name: str, inputs: Path, folder: Path) -> subprocess.Popen[str]:
    """A command that writes into a folder, in a session of its own."""
    words = [word.format(inputs=inputs, folder=folder) for word in KILLED[name].split()]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "1000", "TERM": "dumb", "OMP_NUM_THREADS": "1",
                                "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, "-m", "workbench", *words, "-o", str(folder)], stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT, text=True, env=environment, start_new_session=True)


def not_whole(path: Path) -> str:
    """The error of reading a result of any kind; nothing if it is whole."""
    try:
        match path.suffix:
            case ".json":
                json.loads(path.read_text())
            case ".toml":
                tomllib.loads(path.read_text())
            case ".png" | ".gif":
                from PIL import Image

                with Image.open(path) as image:
                    image.load()
            case ".npz":
                with zipfile.ZipFile(path) as archive:
                    if archive.testzip():
                        return "CRC"
            case ".parquet":
                from pyarrow import parquet

                parquet.read_table(path)
            case ".nc":
                import h5py

                with h5py.File(path) as file:
                    file.visit(lambda _name: None)
            case ".html":
                return "" if path.read_text().rstrip().endswith("</html>") else "no end"
            case ".step":
                return "" if path.read_text().rstrip().endswith("END-ISO-10303-21;") else "no end"
            case ".csv":
                return "" if path.read_bytes().endswith(b"\n") else "no line end"
    except Exception as error:
        return repr(error)
    return ""


def visible_files(folder: Path) -> dict[str, bytes]:
    """Contents of the results in a folder, those of the user and the mark apart."""
    return {name: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
            and not (name := path.relative_to(folder).as_posix()).startswith(".")
            and name not in MINE and name != MARK}


def faults_in(folder: Path, *, ended: bool | None) -> list[str]:
    """Faults of a folder after a kill, or after a run that ended; None where either may be."""
    found = [f"{name} is not as it was" for name, content in MINE.items() if (folder / name).read_bytes() != content]
    manifest = Manifest(folder)
    results = visible_files(folder)
    found += [f"{name}: {fault}" for name in results if (fault := not_whole(folder / name))]
    found += [f"{name} is not in the manifest" for name in results if not manifest.owns(name)]
    if ended and (folder / MARK).exists():
        found.append("a mark on complete results")
    if ended is False and results and not (folder / MARK).exists():
        found.append("no mark on incomplete results")
    return found


def kills(arguments: argparse.Namespace, kept: Measurements) -> None:
    """Kill commands at random moments; complete every fourth folder by the same command."""
    random = np.random.default_rng(arguments.seed)
    names = [name for name in KILLED if arguments.command is None or name.split()[0] in arguments.command]
    faults, refused, late, completed = [], 0, 0, 0
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        inputs_in(root / "inputs")
        seconds: dict[str, float] = {}
        for name in names:
            began = time.perf_counter()
            process = begun(name, root / "inputs", root / f"whole {name}")
            said = process.communicate()[0]
            seconds[name] = time.perf_counter() - began
            print(f"{name:16} {seconds[name]:6.1f} s, status {process.returncode}", flush=True)
            if process.returncode not in (0, 1, 3) or "Traceback" in said:
                faults.append(f"{name}, not killed: status {process.returncode}: {said[-300:]}")
                print(f"    {faults[-1]}")
        for number in range(arguments.kills):
            name = names[number % len(names)]
            folder = root / f"killed {number}"
            for mine, content in MINE.items():
                (folder / mine).parent.mkdir(parents=True, exist_ok=True)
                (folder / mine).write_bytes(content)
            process = begun(name, root / "inputs", folder)
            moment = float(random.uniform(0.3, 1.05 * seconds[name]))
            beside = number * arguments.beside // arguments.kills < (number + 1) * arguments.beside // arguments.kills
            until = time.perf_counter() + moment
            if beside:
                time.sleep(0.5 * moment)
                at_work = (folder / STATE / RUN).exists() and process.poll() is None
                other = begun(names[int(random.integers(len(names)))], root / "inputs", folder)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    other.wait(timeout=max(0.1, until - time.perf_counter()))
                ended_by_itself = other.poll() is not None
                if not ended_by_itself:
                    os.killpg(other.pid, signal.SIGKILL)
                said = other.communicate()[0]
                refused += "holds it" in said
                if at_work and ended_by_itself and process.poll() is None and "holds it" not in said:
                    faults.append(f"{number} {name}: the second command was not refused: {said[-300:]}")
                    print(f"    {faults[-1]}", flush=True)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=max(0.0, until - time.perf_counter()))
            ended = process.poll() is not None
            if not ended:
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            late += ended
            complete = ended and process.returncode in (0, 1, 3)
            if not ended and not (folder / MARK).exists():
                # Killed on its way out: all that an undisturbed run writes is there.
                complete = set(visible_files(root / f"whole {name}")) <= set(visible_files(folder))
            # A second command that began after the first one had ended, and was killed, leaves a mark of its own.
            found = faults_in(folder, ended=None if beside and not ended_by_itself else complete)
            points = {file: content for file, content in visible_files(folder).items() if file.startswith("points/")}
            if number % 4 == 0 and not found:
                again = begun(name, root / "inputs", folder)
                said = again.communicate()[0]
                completed += 1
                if again.returncode not in (0, 1, 3) or "Traceback" in said:
                    found.append(f"not completed: status {again.returncode}: {said[-300:]}")
                found += faults_in(folder, ended=True)
                here = visible_files(folder)
                found += [f"{file} was finished and is lost" for file, content in points.items()
                          if here.get(file) != content]
                whole = visible_files(root / f"whole {name}")
                found += [f"{file} is not that of an undisturbed run" for file in ("study.parquet", "chip.step")
                          if file == "study.parquet" and here.get(file) != whole.get(file)]
                if list((folder / STATE).glob(f"{NEW}*")):
                    found.append("begun files were not cleared")
            faults += [f"{number} {name} at {moment:.2f} s: {fault}" for fault in found]
            for fault in found:
                print(f"    {number} {name} at {moment:.2f} s{' (two)' if beside else ''}: {fault}", flush=True)
            shutil.rmtree(folder)
            if number % 20 == 19:
                print(f"{number + 1} kills, {late} after the end, {refused} second commands refused, {completed} "
                      f"completed, {len(faults)} faults", flush=True)
    print(f"{arguments.kills} kills, {late} after the end, {refused} second commands refused, {completed} completed, "
          f"{len(faults)} faults")
    kept.add(f"faults of {arguments.kills} kills", len(faults), "1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--command", choices=sorted({*COMMANDS, *(name.split()[0] for name in KILLED)}),
                        action="append", help="only this one (default: all)")
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="kill N times instead (default: Ctrl-C)")
    parser.add_argument("--beside", type=int, default=0, metavar="N", help="of these, N with a second command beside")
    parser.add_argument("--seed", type=int, default=0, help="of the moments of kills (default 0)")
    with_json(parser)
    arguments = parser.parse_args()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # What a shell in the background ignores, commands would inherit.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    with measurements(arguments.json) as kept:
        if arguments.kills:
            kills(arguments, kept)
        else:
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
