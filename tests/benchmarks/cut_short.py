"""Diagnoses cut short at ten times, of three campaigns: does any say what the whole run contradicts?

    .venv/bin/python tests/benchmarks/cut_short.py FOLDER [--replay] [--jobs 1] [--accuracy "0.5 %"]

Every run is one command, ``workbench diagnose --minutes``, with its record in FOLDER; what is there is not done again,
so the command may be stopped and given again. The whole run of a campaign comes first; the budgets are shares of its
time. With --replay the whole run is done once, here, and its tasks and their times are kept; what a run of a budget
would have done is then made of them, by a clock that tells these times, in seconds.
The campaigns are the one in geometry/chips/small_campaign (water 3 K warmer than stated), and the same chip with a gel
of 35 um that is stated as 20, and with both losses of its PLA doubled. Times are of the wall clock.

A run that was not finished contradicts whatever claims anything of the recordings as its verdict; a finished one whose
verdict, or effects, are not those of the whole run.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

from geometry.chip import Chip, read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.commands.parsed_options import accuracy_option  # noqa: E402
from workbench.diagnosis.appraisal import appraised  # noqa: E402
from workbench.diagnosis.device import Model, device_model  # noqa: E402
from workbench.diagnosis.findings import Candidate, InitialOptimum  # noqa: E402
from workbench.diagnosis.inference import DiagnosisSearch  # noqa: E402
from workbench.diagnosis.local_models import LocalModels  # noqa: E402
from workbench.diagnosis.tasks import SearchTask  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import one_thread  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.readers import read_recording  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.report.diagnosis import diagnosis_record  # noqa: E402
from workbench.results.spectrum import Spectrum, write_spectrum  # noqa: E402

EXAMPLE = ROOT / "geometry" / "chips" / "small_campaign"

#: Budgets, as shares of the time that the whole run takes.
SHARES = (0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 0.95)

#: Relative standard deviation of a point that is simulated, as the campaign states it.
NOISE = 0.005

#: What is said of recordings that are explained, or of a cause: never by a run that was not finished.
CLAIMS = ("explains the recordings", "explain the recordings", "of the residual as stated", "nothing in the catalogue",
          "most likely")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--accuracy", default="0.5 %")
    parser.add_argument("--replay", action="store_true", help="one whole run of each campaign, cut where it would be")
    options = parser.parse_args()
    contradicted = 0
    for name, campaign in campaigns(options.folder).items():
        replay = Replay(campaign, options) if options.replay else None
        whole = run(campaign, options.folder / name / "whole", options, None, replay)
        print(f"\n{name}: whole run {whole['wall_seconds']:.0f} s, {told(whole)}\n  {whole['headline']}")
        for share in SHARES:
            minutes = share * whole["wall_seconds"] / 60.0
            found = run(campaign, options.folder / name / f"{share:g}", options, minutes, replay)
            wrong = contradicts(found, whole)
            contradicted += wrong
            print(f"  {minutes:5.2f} min {found['wall_seconds']:5.0f} s  {told(found):28} "
                  f"{'CONTRADICTED' if wrong else 'right'}  {found['headline'][:150]}", flush=True)
    print(f"\n{contradicted} of {3 * len(SHARES)} contradicted by the whole run")
    return 1 if contradicted else 0


def told(found: Mapping[str, Any]) -> str:
    return " ".join([found["verdict"], *(effect["name"] for effect in found["effects"])])


def contradicts(found: Mapping[str, Any], whole: Mapping[str, Any]) -> bool:
    """Whether a run says what the whole one does not."""
    if found["verdict"] == "not_finished":
        said = [found["headline"], *(text for text in found["findings"] if not text.startswith("Provisional: "))]
        return bool(found["effects"]) or any(claim in text for text in said for claim in CLAIMS)
    return told(found) != told(whole)


@dataclass
class Kept:
    """What a task came to: what it returned, or its error, and the seconds that took."""

    result: Any
    seconds: float


class Replayed(DiagnosisSearch):
    """A search whose tasks are done once, by all that have the same ``kept``, and whose time is that of its tasks."""

    kept: dict[tuple[str, str], Kept]
    clock, budget = 0.0, math.inf

    @property
    def is_over(self) -> bool:
        return self.clock > self.budget

    def attempt(self, task: SearchTask) -> Any:
        key = (task.method.__name__, hashlib.sha256(repr([named(x) for x in task.arguments]).encode()).hexdigest())
        if key not in self.kept:
            started = time.perf_counter()
            self.kept[key] = Kept(super().attempt(task), time.perf_counter() - started)
        self.clock += self.kept[key].seconds
        return self.kept[key].result


def named(value: Any) -> Any:
    """What tells an argument of a task from others: of ends the places, of hypotheses the names."""
    match value:
        case np.ndarray():
            return value.tobytes()
        case tuple() | list():
            return [named(each) for each in value]
        case Candidate():
            return [value.hypothesis.name, *(each.x.tobytes() for each in value.ends)]
        case InitialOptimum():
            return value.x.tobytes()
        case _:
            return repr(value)


class Replay:
    """All runs of one campaign."""

    def __init__(self, campaign: Path, options: argparse.Namespace) -> None:
        self._given = campaign, accuracy_option(options)
        self._kept: dict[tuple[str, str], Kept] = {}
        self._model: Model | None = None

    def __call__(self, minutes: float | None) -> dict[str, Any]:
        started = time.perf_counter()
        with one_thread():
            if self._model is None:
                self._model = device_model(read_campaign(self._given[0]), accuracy=self._given[1])
                self._models = LocalModels(self._model)
            search = Replayed(self._model)
            search.kept, search.budget = self._kept, math.inf if minutes is None else 60.0 * minutes
            search.__dict__["models"] = self._models
            found = appraised(self._model, search.run(), started=started)
        return {**diagnosis_record(found), "wall_seconds": search.clock,
                "status": 0 if found.provisional is None else 3}


def run(
    campaign: Path, folder: Path, options: argparse.Namespace, minutes: float | None, replay: Replay | None
) -> dict[str, Any]:
    """The record of one run, made unless it is there."""
    kept = folder / "kept.json"
    if not kept.exists() and replay is not None:
        folder.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(replay(minutes)), encoding="utf-8")
    if not kept.exists():
        command = [sys.executable, "-P", "-m", "workbench.cli", "diagnose", str(campaign), "-o", str(folder), "--jobs",
                   str(options.jobs), "--accuracy", options.accuracy]
        command += [] if minutes is None else ["--minutes", f"{minutes:.4f}"]
        started = time.perf_counter()
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        taken = time.perf_counter() - started
        if ended.returncode not in (0, 3):
            raise SystemExit(f"{' '.join(command)}: status {ended.returncode}\n{ended.stderr[-2000:]}")
        found = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        kept.write_text(json.dumps({**found, "wall_seconds": taken, "status": ended.returncode}), encoding="utf-8")
    return dict(json.loads(kept.read_text(encoding="utf-8")))


def campaigns(folder: Path) -> dict[str, Path]:
    """The campaign files by name, made unless they are there."""
    found = {"example": EXAMPLE / "campaign.toml"}
    pla = "pla/acevedo_2026"
    losses = {f"{pla}.shear_modulus": 2.0, f"{pla}.bulk_modulus": 2.0}
    for name, gel, factors in (("thick gel", 35e-6, {}), ("lossy PLA", None, losses)):
        own = folder / name / "campaign"
        found[name] = own / "campaign.toml"
        if not found[name].exists():
            own.mkdir(parents=True, exist_ok=True)
            chip = read_chip(EXAMPLE / "chip.toml")
            record_states(chip if gel is None else chip.with_dimensions({"couplant.thickness": gel}), factors, own)
            shutil.copy(EXAMPLE / "chip.toml", own)
            shutil.copy(EXAMPLE / "campaign.toml", own)
    return found


def record_states(chip: Chip, factors: Mapping[str, float], folder: Path) -> None:
    """Recordings of all states of a chip, whose materials lose more by `factors`."""
    random = np.random.default_rng(1)
    for state in ("empty", "filled"):
        frequency = read_recording(EXAMPLE / f"{state}.csv").spectrum.frequency
        problem = build(fill(chip, state, Registry()))
        values = {**problem.values, **{key: complex(problem.values[key].real, factor * problem.values[key].imag)
                                       for key, factor in factors.items()}}
        solved = reduce(assemble(problem.mesh, problem.terms), frequency, values).solve(frequency, values)
        noise = random.standard_normal((2, frequency.size))
        seen = np.conj(solved.impedance) * (1.0 + NOISE * (noise[0] + 1j * noise[1]))
        write_spectrum(Spectrum(frequency, seen), folder / f"{state}.csv")


if __name__ == "__main__":
    sys.exit(main())
