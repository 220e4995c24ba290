"""The runner of concealed-effect trials: its schedule, its processes, its scores."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import trials
from concealed import scoring
from concealed.mechanisms import CATALOGUED, CLASHING, OUTSIDE
from concealed.tasks import claimed, diagnose_into
from fake_trials import SAID, quarter, stands_in

from workbench.files.errors import InputError

ROOT = Path(__file__).resolve().parent.parent

#: What a process needs to find the modules of the tests.
PYTHONPATH = os.pathsep.join(str(ROOT / each) for each in (".", "tests", "tests/benchmarks"))

SHAPES = {"wall_draft", "wall_barrel", "lid_bow", "disc_dome", "meniscus"}

#: Minutes of a trial: several times what its process takes to load the diagnosis.
SHORT = 0.15


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(4):
        (tmp_path / "trials" / f"{number:04d}").mkdir(parents=True)
    return tmp_path


def found(folder: Path, commit: str) -> dict[str, dict[str, Any]]:
    return {path.stem: json.loads(path.read_text()) for path in (folder / "found" / commit).glob("*.json")}


def run(folder: Path, jobs: int, address: str | None = None, *, commit: Callable[[], str] = lambda: "abc") -> None:
    with trials.workers_for(SHORT, jobs, address) as workers:
        trials.run(folder, workers, diagnosing=stands_in, timing=quarter, commit=commit)


def test_a_round_holds_everything() -> None:
    drawn = list(islice(trials.schedule(1), 150))
    for one in (drawn[:75], drawn[75:]):
        count = Counter(name for names in one if len(names) == 1 for name in names)
        assert count == {**dict.fromkeys(CATALOGUED, 1), **dict.fromkeys(OUTSIDE, 3), "none": 14}
        assert sum(len(names) == 2 for names in one) == 10
    assert set(CATALOGUED) >= SHAPES
    # Six of 630 pairs clash: of these 2700 draws some would.
    pairs = [set(names) for names in islice(trials.schedule(1), 20000) if len(names) == 2]
    assert not any(pair in CLASHING for pair in pairs)
    assert any(pair & SHAPES for pair in pairs)
    assert {name for pair in CLASHING for name in pair} <= set(CATALOGUED)
    assert drawn == list(islice(trials.schedule(1), 150))
    assert drawn != list(islice(trials.schedule(2), 150))


def test_one_thing_may_be_concealed_in_all() -> None:
    assert set(islice(trials.schedule(1, conceal="meniscus"), 5)) == {("meniscus",)}


def outcomes_are_right(folder: Path, words: str) -> None:
    """A run of :func:`stands_in` has survived what fails and what hangs."""
    first = found(folder, "abc")
    assert {name: said["verdict"] for name, said in first.items()} == {
        "0000": "below_detection", "0001": "failed", "0002": "failed", "0003": "below_detection"}
    assert first["0001"]["reason"] == "ValueError: a radius came too close to another"
    assert first["0002"]["reason"] == f"no answer within {SHORT} min"
    # From when it was handed in: a busy machine takes its time to begin.
    assert 60.0 * SHORT <= first["0002"]["wall_seconds"] < 60.0 * SHORT + 20.0
    assert all(0.0 < said["cpu_seconds"] < 60.0 * SHORT and said["commit"] == "abc" for said in first.values())
    assert [said.get("factorisation_seconds") for _, said in sorted(first.items())] == [0.25, 0.25, None, 0.25]
    assert f"0002 failed no answer within {SHORT} min" in words


def test_a_run_survives_what_fails_and_what_hangs_and_goes_on_where_it_was(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    started = time.monotonic()
    run(folder, 2)
    assert time.monotonic() - started < 60.0
    outcomes_are_right(folder, capsys.readouterr().out)
    (folder / "found" / "abc" / "0001.json").unlink()
    run(folder, 2)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["0001"]


def test_a_dask_cluster_does_the_same(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    with warnings.catch_warnings():
        # Dask's own, of ports that are taken, sockets and event loops; not ours to mend.
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(n_workers=1, threads_per_worker=2, host="127.0.0.1", dashboard_address=None,
                                      protocol="tcp") as cluster:
            run(folder, 2, cluster.scheduler_address)
    outcomes_are_right(folder, capsys.readouterr().out)


def test_no_jobs_are_a_mistake(folder: Path) -> None:
    with pytest.raises(InputError, match="--jobs: received 0"):
        run(folder, 0)


def test_outcomes_are_kept_by_commit(folder: Path) -> None:
    with pytest.raises(SystemExit, match="abc-dirty: outcomes are those of a commit"):
        run(folder, 1, commit=lambda: "abc-dirty")
    moving = iter(["abc", "abc", "abd"])
    with pytest.raises(SystemExit, match="moved from abc to abd"):
        run(folder, 1, commit=lambda: next(moving))
    assert set(found(folder, "abc")) == {"0000"}
    (folder / "trials" / "0002").rmdir()
    run(folder, 2, commit=lambda: "abd")
    assert set(found(folder, "abc")) == {"0000"}
    assert set(found(folder, "abd")) == {"0000", "0001", "0003"}


def test_several_runs_share_a_folder(folder: Path) -> None:
    result, mark = folder / "found" / "abc" / "0000.json", folder / "running" / "0000.lock"
    piece = partial(diagnose_into, result, mark, "abc", folder / "trials" / "0000", stands_in, quarter)
    with claimed(mark) as is_mine:
        assert is_mine
        # Each opening of the file stands for another process.
        assert piece() == ""
        assert not result.exists()
    assert piece().startswith("0000 below_detection")
    written = result.stat().st_mtime_ns
    assert piece() == ""
    assert result.stat().st_mtime_ns == written


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_whoever_stops_keeps_what_is_finished_and_leaves_nothing_running(tmp_path: Path, number: int) -> None:
    for name in ("0000", "0001", "0003"):
        (tmp_path / "trials" / name).mkdir(parents=True)
    (tmp_path / "stops.py").write_text(
        "import sys\nfrom functools import partial\nfrom pathlib import Path\nimport fake_trials, trials\n"
        "folder = Path(sys.argv[1])\n"
        "late = partial(fake_trials.late, folder / 'begun')\n"
        "trials.run = partial(trials.run, diagnosing=late, timing=fake_trials.quarter, commit=lambda: 'abc')\n"
        "sys.argv[1:] = ['run', str(folder), '--jobs', '1']\ntrials.main()\n")
    name = signal.Signals(number).name
    with subprocess.Popen([sys.executable, str(tmp_path / "stops.py"), str(tmp_path)], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": PYTHONPATH}) as program:
        assert program.stdout is not None
        assert program.stdout.readline().startswith("0000 below_detection")
        (tmp_path / "begun").unlink()
        until = time.monotonic() + 20.0
        while not (tmp_path / "begun").exists() and time.monotonic() < until:
            time.sleep(0.02)
        program.send_signal(number)
        assert program.wait(10.0) == 128 + number
        assert program.stderr is not None
        assert f"stopped by {name}: what is finished is kept" in program.stderr.read()
    time.sleep(3.0)
    assert set(found(tmp_path, "abc")) == {"0000"}


def effect(name: str, region: str, detectability: float = 20.0, **parameters: float) -> dict[str, Any]:
    return {"name": name, "region": region, "catalogued": True, "detectability": detectability,
            "parameters": parameters or {"x": 0.0}}


def truth(*effects: dict[str, Any]) -> dict[str, Any]:
    return {"mechanism": [e["name"] for e in effects] or ["none"], "effects": list(effects),
            "detectability": max((e["detectability"] for e in effects), default=0.0), "values": {}}


def said(*names: str, verdict: str = "missing_physics", **parameters: tuple[float, float]) -> dict[str, Any]:
    limits = {name.replace("__", "."): {"low": low, "high": high} for name, (low, high) in parameters.items()}
    return {**SAID, "verdict": verdict, "cpu_seconds": 60.0, "wall_seconds": 70.0, "commit": "abc",
            "effects": [{"name": name, "region": "bond", "parameters": limits if k == 0 else {}}
                        for k, name in enumerate(names)]}


BONDED, GAUGE = "superstrate bonded on a part of its radius", "density that the constants were fitted with"


def test_new_effects_have_their_names_in_the_catalogue() -> None:
    bond, gauge = effect("partial bond", "bond"), effect("density gauge", "transducer", **{"transducer.gauge": 0.02})
    assert scoring.outcome("0", truth(bond), said(BONDED)).first
    for limits, covered in (((0.01, 0.03), 1), ((0.03, 0.04), 0)):
        result = scoring.outcome("0", truth(gauge), said(GAUGE, transducer__gauge=limits))
        assert (result.first, result.intervals, result.covered) == (True, 1, covered)
    ports = effect("port necks", "cavity", **{"port necks.share": 0.1, "port necks.length": 4e-4})
    result = scoring.outcome("0", truth(ports), said("port necks", **{"port necks__share": (0.09, 0.12)}))
    assert (result.first, result.intervals, result.covered) == (True, 1, 1)


def test_one_of_two_is_told_from_both_and_from_a_false_one() -> None:
    pair = truth(effect("partial bond", "bond"), effect("density gauge", "transducer", **{"transducer.gauge": 0.02}))
    both, one, false, none = (scoring.outcome("0", pair, said(*names)) for names in (
        (BONDED, GAUGE), (BONDED,), (BONDED, "fluid absorption"), ("fluid absorption",)))
    assert [(o.first, o.some, o.wrong) for o in (both, one, false, none)] == [
        (True, True, 0), (False, True, 0), (False, True, 1), (False, False, 1)]
    assert {o.group for o in (both, one, false, none)} == {"pair"}


def test_what_lies_outside_is_where_the_first_place_says() -> None:
    outside = truth({**effect("substrate crack", "substrate"), "catalogued": False})
    for region, right in (("sidewall", True), ("bond", False)):
        where = [{"region": region}, {"region": "substrate"}]
        assert scoring.outcome("0", outside, {**said(verdict="outside"), "location": where}).region is right


def test_the_rates_are_those_of_what_was_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bond = effect("partial bond", "bond")
    cases = [(truth(bond), said(BONDED)), (truth(bond), said("fluid absorption")), (truth(), said(BONDED)),
             (truth(), {**said(verdict="failed"), "location": [], "held_out": {}, "scores": []}),
             (truth(effect("partial bond", "bond", 1.0)), said(verdict="below_detection"))]
    for number, (hidden, answer) in enumerate(cases):
        for name, content in (("truth", hidden), ("found/abc", answer)):
            (tmp_path / name).mkdir(parents=True, exist_ok=True)
            (tmp_path / name / f"{number:04d}.json").write_text(json.dumps(content))
    scoring.score(tmp_path, None, tmp_path / "outcomes.csv")
    text = capsys.readouterr().out
    for line in ("detectable: right effect first .* 1 of   2   50.0 %", "nothing concealed: false alarm .* 1 of   2 ",
                 "not detectable: claimed .* 0 of   1 ", "failed, or not done in time .* 1 of   5   20.0 %",
                 "wall time, s: all +5 +70 +70 +70$", "processor time, s: nothing +2 +60 +60 +60$"):
        assert Counter(bool(re.search(line, each)) for each in text.splitlines())[True] == 1, line
    kept = scoring.read_outcomes(tmp_path / "outcomes.csv")
    assert [o.number for o in kept] == [f"{k:04d}" for k in range(5)]
    assert math.isnan(kept[3].held_out)
    (tmp_path / "found" / "abd").mkdir()
    with pytest.raises(SystemExit, match="holds outcomes of abc, abd; expected one of these"):
        scoring.score(tmp_path, None, None)
    (tmp_path / "found" / "abd" / "0000.json").write_text(json.dumps({**cases[0][1], "commit": "abd"}))
    with pytest.raises(SystemExit, match="it holds outcomes of abc, these are of abd"):
        scoring.score(tmp_path, "abd", tmp_path / "outcomes.csv")


def test_outcomes_of_older_trials_are_still_read() -> None:
    kept = scoring.read_outcomes(Path(__file__).parent / "data" / "trials" / "seed_4.csv")
    assert len(kept) == 98
    assert all(math.isnan(o.wall) for o in kept)
    assert all(math.isnan(o.factorisation) for o in kept)
    assert all(o.some == o.first for o in kept)


def made_up() -> list[scoring.Outcome]:
    """Outcomes with known rates: their seconds are those of their kind, 30 more with one wrong effect named."""
    bond, crack = effect("partial bond", "bond"), {**effect("substrate crack", "substrate"), "catalogued": False}
    gauge = effect("density gauge", "transducer", **{"transducer.gauge": 0.02})
    right, none = said(BONDED), said(verdict="below_detection")
    where = {**said(verdict="unexplained"), "location": [{"region": "substrate"}]}
    cases = [
        *[(truth(bond), right)] * 37, *[(truth(bond), said("fluid absorption"))] * 2,
        (truth(bond), {**said("fluid absorption"), "rivals": [{"effects": [BONDED]}]}),
        (truth(gauge), said(GAUGE, transducer__gauge=(0.01, 0.03))),
        (truth(gauge), said(GAUGE, transducer__gauge=(0.03, 0.04))),
        *[(truth(), none)] * 24, (truth(), right),
        *[(truth(effect("partial bond", "bond", 1.0)), none)] * 9, (truth(effect("partial bond", "bond", 1.0)), right),
        *[(truth(crack), where)] * 8, (truth(crack), said("fluid absorption")), (truth(crack), none),
        *[(truth(bond, gauge), said(BONDED, GAUGE))] * 9, (truth(bond, gauge), said(BONDED, "fluid absorption")),
        (truth(bond), {**none, "verdict": "not_finished"}), (truth(bond), said("fluid absorption", "softening")),
    ]
    made = [scoring.outcome(f"{k:04d}", *case) for k, case in enumerate(cases)]
    # The mechanism is the generator's word, not the effect's name.
    seconds = {"nothing": 10.0, "one effect": 25.0, "outside": 40.0, "two effects": 50.0}
    words = {"partial bond": "delamination", "substrate crack": "substrate_crack"}
    made = [replace(o, mechanism=words.get(o.mechanism, o.mechanism)) for o in made]
    return [replace(o, seconds=seconds[o.kind] + (30.0 if o.said == "fluid absorption" else 0.0), factorisation=0.25)
            for o in made]


def test_the_table_has_every_figure_that_the_diagnosis_is_judged_by(capsys: pytest.CaptureFixture[str]) -> None:
    scoring.rates(made_up())
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "detectable: right effect first +39 of +44 +88.6 %", "detectable: right effect in the rival set +40 of +44 ",
        "detectable: 95 % intervals that cover the truth +1 of +2 +50.0 %", "detectable: right region +41 of +44 ",
        "nothing concealed: false alarm +1 of +25 +4.0 %", "not detectable: claimed +1 of +10 +10.0 %",
        "outside the catalogue: laid to an effect of the catalogue +1 of +10 +10.0 %",
        "outside the catalogue: right region +8 of +10 +80.0 %",
        "detectable, one or two: a second effect that is not there +2 of +54 +3.7 %",
        "failed, or not done in time +1 of +99 ",
        "processor time, s: nothing +25 +10 +10 +10$", "processor time, factorisations: nothing +25 +40 +40 +40$",
        "processor time, s: one effect +54 +25 +25 +55$",
        "processor time, factorisations: one effect +54 +100 +100 +220$",
        "processor time, s: outside +10 +40 +43 +70$", "processor time, s: two effects +10 +50 +50 +50$",
        "one factorisation: median 0.250 s, 0.250 to 0.250 s",
    ):
        assert Counter(bool(re.match(line, each)) for each in lines)[True] == 1, line


def test_an_effect_too_small_to_be_detected_is_there_nevertheless() -> None:
    small = truth(effect("partial bond", "bond"), effect("port necks", "cavity", 2.0))
    result = scoring.outcome("0", small, said(BONDED, "port necks"))
    assert (result.group, result.wrong, result.adds) == ("pair", 0, False)
    assert scoring.outcome("0", small, said(BONDED, "fluid absorption")).adds
