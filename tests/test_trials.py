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
from collections import Counter
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trials
from concealed import scoring
from concealed.design import random_design
from concealed.mechanisms import CATALOGUED, CLASHING, OUTSIDE
from concealed.tasks import add_truth, claimed, diagnose_into
from fake_trials import SAID, stands_in

ROOT = Path(__file__).resolve().parent.parent

#: What a process needs to find the modules of the tests.
PYTHONPATH = os.pathsep.join(str(ROOT / each) for each in (".", "tests", "tests/benchmarks"))

#: What shapes of layers and labs add to the catalogue.
LATER = {"wall_draft", "wall_barrel", "lid_bow", "disc_dome", "meniscus", "partial_filling", "lid_bubble",
         "other_liquid", "wall_material", "held_rim"}

#: Minutes of a trial: several times what its process takes to load the diagnosis.
SHORT = 0.15


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(4):
        (tmp_path / f"{number:04d}").mkdir()
        (tmp_path / f"{number:04d}" / "campaign.toml").touch()
    return tmp_path


def found(folder: Path) -> dict[str, dict[str, Any]]:
    return {path.stem: json.loads(path.read_text()) for path in (folder / "found").glob("*.json")}


def run(folder: Path, jobs: int, *only: str) -> None:
    trials.diagnose_all(folder, folder / "found", only=only, jobs=jobs, minutes=SHORT, diagnosing=stands_in)


def test_a_round_holds_everything() -> None:
    drawn = list(islice(trials.schedule(1), 150))
    for one in (drawn[:75], drawn[75:]):
        count = Counter(name for names in one if len(names) == 1 for name in names)
        foreign = {name: count.pop(name) for name in OUTSIDE}
        assert count == {**dict.fromkeys(CATALOGUED, 1), "none": 13}
        assert sum(foreign.values()) == 13
        assert set(foreign.values()) == {2, 3}
        assert sum(len(names) == 2 for names in one) == 8
    assert set(CATALOGUED) >= LATER
    assert len(OUTSIDE) >= 4
    pairs = [set(names) for names in islice(trials.schedule(1), 20000) if len(names) == 2]
    assert not any(pair in CLASHING for pair in pairs)
    assert any(pair & LATER for pair in pairs)
    assert {name for pair in CLASHING for name in pair} <= set(CATALOGUED)
    assert drawn == list(islice(trials.schedule(1), 150))
    assert drawn != list(islice(trials.schedule(2), 150))


def test_a_run_survives_what_fails_and_what_hangs_and_goes_on_where_it_was(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    started = time.monotonic()
    run(folder, 2)
    assert time.monotonic() - started < 60.0
    first = found(folder)
    assert {name: said["verdict"] for name, said in first.items()} == {
        "0000": "below_detection", "0001": "failed", "0002": "failed", "0003": "below_detection"}
    assert first["0001"]["reason"] == "ValueError: a radius came too close to another"
    assert first["0002"]["reason"] == f"no answer within {SHORT} min"
    # From when it was handed in: a busy machine takes its time to begin.
    assert 60.0 * SHORT <= first["0002"]["wall_seconds"] < 60.0 * SHORT + 20.0
    assert all(0.0 < said["cpu_seconds"] < 60.0 * SHORT for said in first.values())
    assert [said.get("peak_megabytes", 0.0) > 10.0 for _, said in sorted(first.items())] == [True, True, False, True]
    assert f"0002 failed no answer within {SHORT} min" in capsys.readouterr().out
    for name in ("0001", "0003"):
        (folder / "found" / f"{name}.json").unlink()
    run(folder, 2, "0001")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["0001"]
    assert set(found(folder)) == {"0000", "0001", "0002"}


def test_a_run_is_of_a_commit_whatever_the_checkout_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout = tmp_path / "checkout"
    for name in trials.PROGRAM:
        (checkout / name).mkdir(parents=True)
        (checkout / name / "file.py").write_text("before")
    for command in (["init", "--quiet"], ["add", "."],
                    ["-c", "user.name=x", "-c", "user.email=x@y", "commit", "--quiet", "--message", "before"]):
        subprocess.run(["git", *command], cwd=checkout, check=True)
    monkeypatch.setattr(trials, "ROOT", checkout)
    (checkout / "workbench" / "file.py").write_text("after")
    folder = trials.frozen("HEAD", tmp_path / "out")
    assert (folder / "program" / "workbench" / "file.py").read_text() == "before"
    assert sorted(path.name for path in folder.iterdir()) == ["program"]
    (folder / "program" / "mark").touch()
    assert trials.frozen(folder.name, tmp_path / "out") == folder
    assert (folder / "program" / "mark").exists()
    with pytest.raises(SystemExit, match="--commit nowhere: fatal"):
        trials.frozen("nowhere", tmp_path / "out")


def test_several_runs_share_the_work(folder: Path) -> None:
    result, mark = folder / "found" / "0000.json", folder / "running" / "0000"
    result.parent.mkdir()
    piece = partial(diagnose_into, result, mark, folder / "0000", stands_in)
    with claimed(mark) as is_mine:
        assert is_mine
        # Each opening of the file stands for another process.
        assert piece() == ""
        assert not result.exists()
    assert piece().startswith("0000 below_detection")
    written = result.stat().st_mtime_ns
    assert piece() == ""
    assert result.stat().st_mtime_ns == written


def test_truths_are_kept_together(tmp_path: Path) -> None:
    for name, size in (("0001", 1.0), ("0000", 2.0), ("0001", 3.0)):
        add_truth(tmp_path / "truth.json", name, {"size": size})
    assert json.loads((tmp_path / "truth.json").read_text()) == {"0000": {"size": 2.0}, "0001": {"size": 3.0}}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_whoever_stops_keeps_what_is_finished_and_leaves_nothing_running(tmp_path: Path, number: int) -> None:
    for name in ("0000", "0001", "0003"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "campaign.toml").touch()
    begun = tmp_path / "begun"
    begun.mkdir()
    (tmp_path / "stops.py").write_text(
        "import sys\nfrom functools import partial\nfrom pathlib import Path\nimport fake_trials, trials\n"
        "folder = Path(sys.argv[1])\n"
        "late = partial(fake_trials.late, folder / 'begun')\n"
        "trials.diagnose_all = partial(trials.diagnose_all, diagnosing=late)\n"
        "sys.argv[1:] = ['diagnose', str(folder), '--into', str(folder / 'found')]\ntrials.main()\n")
    name = signal.Signals(number).name
    with subprocess.Popen([sys.executable, str(tmp_path / "stops.py"), str(tmp_path)], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": PYTHONPATH}) as program:
        assert program.stdout is not None
        assert program.stdout.readline().startswith("0000 below_detection")
        for mark in begun.iterdir():
            mark.unlink()
        until = time.monotonic() + 60.0
        while not (marks := list(begun.iterdir())):
            assert time.monotonic() < until
            time.sleep(0.02)
        program.send_signal(number)
        assert program.wait(30.0) == 128 + number
        assert program.stderr is not None
        assert f"stopped by {name}: what is finished is kept" in program.stderr.read()
    while any(Path("/proc", mark.name).exists() for mark in marks):
        assert time.monotonic() < until
        time.sleep(0.02)
    assert set(found(tmp_path)) == {"0000"}


def effect(name: str, region: str, detectability: float = 20.0, **parameters: float) -> dict[str, Any]:
    return {"name": name, "region": region, "catalogued": True, "detectability": detectability,
            "parameters": parameters or {"x": 0.0}}


def truth(*effects: dict[str, Any]) -> dict[str, Any]:
    return {"mechanism": [e["name"] for e in effects] or ["none"], "effects": list(effects),
            "detectability": max((e["detectability"] for e in effects), default=0.0), "values": {}}


def said(*names: str, verdict: str = "missing_physics", **parameters: tuple[float, float]) -> dict[str, Any]:
    limits = {name.replace("__", "."): {"low": low, "high": high} for name, (low, high) in parameters.items()}
    return {**SAID, "verdict": verdict, "cpu_seconds": 60.0, "wall_seconds": 70.0,
            "effects": [{"name": name, "region": "bond", "parameters": limits if k == 0 else {}}
                        for k, name in enumerate(names)]}


def outcome(number: str, hidden: dict[str, Any], answer: dict[str, Any]) -> scoring.Outcome:
    return scoring.outcome(number, hidden, answer, "abc")


BONDED, GAUGE = "superstrate bonded on a part of its radius", "density that the constants were fitted with"


def test_new_effects_have_their_names_in_the_catalogue() -> None:
    bond, gauge = effect("partial bond", "bond"), effect("density gauge", "transducer", **{"transducer.gauge": 0.02})
    assert outcome("0", truth(bond), said(BONDED)).first
    for limits, covered in (((0.01, 0.03), 1), ((0.03, 0.04), 0)):
        result = outcome("0", truth(gauge), said(GAUGE, transducer__gauge=limits))
        assert (result.first, result.intervals, result.covered) == (True, 1, covered)
    ports = effect("port necks", "cavity", **{"port necks.share": 0.1, "port necks.length": 4e-4})
    result = outcome("0", truth(ports), said("port necks", **{"port necks__share": (0.09, 0.12)}))
    assert (result.first, result.intervals, result.covered) == (True, 1, 1)


def test_effects_that_labs_have_have_their_names_in_the_catalogue() -> None:
    design = random_design(np.random.default_rng(1))
    drawn = [CATALOGUED[name](np.random.default_rng(k), design, design.nominal) for k in range(30)
             for name in ("other_liquid", "wall_material", "held_rim")]
    known = set().union(*(scoring.right_names(asdict(each)) for each in drawn))
    assert known >= {"olive oil in the cavity", "glycerol water 50 in the cavity", "sidewall of petg",
                     "superstrate held at its rim", "substrate held at its rim"}
    for name, parameters, expected in (
        ("cavity filled to a height", {"fill.share": 0.7}, {"free surface.depth": pytest.approx(0.3)}),
        ("bubble under the lid", {"bubble.inner": 0.0, "bubble.outer": 1e-3}, {"bubble under the lid.area": 0.25}),
        ("bubble under the lid", {"bubble.inner": 1e-4, "bubble.outer": 1e-3}, {}),
        ("cavity holds olive_oil/rshydro", {"density": 911.0}, {"olive oil in the cavity.share": 1.0}),
    ):
        hidden = effect(name, "cavity", **parameters)
        assert scoring.true_values({"values": {"cavity.radius": 2e-3}}, hidden) == expected


def test_one_of_two_is_told_from_both_and_from_a_false_one() -> None:
    pair = truth(effect("partial bond", "bond"), effect("density gauge", "transducer", **{"transducer.gauge": 0.02}))
    both, one, false, none = (outcome("0", pair, said(*names)) for names in (
        (BONDED, GAUGE), (BONDED,), (BONDED, "fluid absorption"), ("fluid absorption",)))
    assert [(o.first, o.some, o.wrong) for o in (both, one, false, none)] == [
        (True, True, 0), (False, True, 0), (False, True, 1), (False, False, 1)]
    assert {o.group for o in (both, one, false, none)} == {"pair"}


def test_what_lies_outside_is_where_the_first_place_says() -> None:
    outside = truth({**effect("substrate crack", "substrate"), "catalogued": False})
    for region, right in (("sidewall", True), ("bond", False)):
        where = [{"region": region}, {"region": "substrate"}]
        assert outcome("0", outside, {**said(verdict="outside"), "location": where}).region is right


def test_the_rates_are_those_of_what_was_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bond = effect("partial bond", "bond")
    cases = [(truth(bond), said(BONDED)), (truth(bond), said("fluid absorption")), (truth(), said(BONDED)),
             (truth(), {**said(verdict="failed"), "location": [], "held_out": {}, "scores": []}),
             (truth(effect("partial bond", "bond", 1.0)), said(verdict="below_detection"))]
    hidden = {f"{number:04d}": {**each, "part": "old" if number < 3 else "fresh"}
              for number, (each, _) in enumerate(cases)}
    (tmp_path / "truth.json").write_text(json.dumps(hidden))
    folder = tmp_path / "abc"
    folder.mkdir()
    with pytest.raises(SystemExit, match="abc: no outcomes"):
        scoring.score(folder, tmp_path / "truth.json", None)
    for number, (_, answer) in enumerate(cases):
        (folder / f"{number:04d}.json").write_text(json.dumps(answer))
    scoring.score(folder, tmp_path / "truth.json", tmp_path / "outcomes.csv")
    text = capsys.readouterr().out
    for line in (r"% +old +fresh +all$", r"one effect, detectable: named first +1/2  50.0 \(9 to 91\) +- +1/2  50.0 ",
                 r"nothing concealed: false alarm +1/1 100.0 \(21 to 100\) +0/1   0.0 \(0 to 79\) +1/2 ",
                 r"not detectable: claimed +- +0/1 ", r"failed, or not done in time +0/3 .* 1/2 .* 1/5  20.0 ",
                 r"wall time, s +3: 70, 70 +2: 70, 70 +5: 70, 70$", "processor time, s: nothing .* 2: 60, 60$",
                 "commits: abc$"):
        assert Counter(bool(re.match(line, each)) for each in text.splitlines())[True] == 1, line
    kept = scoring.read_outcomes(tmp_path / "outcomes.csv")
    assert [o.number for o in kept] == [f"{k:04d}" for k in range(5)]
    assert math.isnan(kept[3].held_out)


def test_outcomes_of_older_trials_are_still_read() -> None:
    kept = scoring.read_outcomes(Path(__file__).parent / "data" / "trials" / "seed_4.csv")
    assert len(kept) == 98
    assert all(math.isnan(o.wall) for o in kept)
    assert all(math.isnan(o.memory) for o in kept)
    assert all(o.some == o.first for o in kept)


def made_up() -> list[scoring.Outcome]:
    """Outcomes with known rates: their seconds are those of their kind, 30 more with one wrong effect named."""
    bond, crack = effect("partial bond", "bond"), {**effect("substrate crack", "substrate"), "catalogued": False}
    gauge = effect("density gauge", "transducer", **{"transducer.gauge": 0.02})
    right, none = said(BONDED), said(verdict="below_detection")
    where = {**said(verdict="unexplained"), "location": [{"region": "substrate"}]}
    off = {**right, "held_out": {"again": {"after": {"reduced_chi_square": 1.5}}}}
    cases = [
        *[(truth(bond), right)] * 36, (truth(bond), off), *[(truth(bond), said("fluid absorption"))] * 2,
        (truth(bond), {**said("fluid absorption"), "rivals": [{"effects": [BONDED]}]}),
        (truth(gauge), said(GAUGE, transducer__gauge=(0.01, 0.03))),
        (truth(gauge), said(GAUGE, transducer__gauge=(0.03, 0.04))),
        *[(truth(), none)] * 23, (truth(), {**none, "verdict": "unexplained"}), (truth(), right),
        *[(truth(effect("partial bond", "bond", 1.0)), none)] * 9, (truth(effect("partial bond", "bond", 1.0)), right),
        *[(truth(crack), where)] * 8, (truth(crack), said("fluid absorption")), (truth(crack), none),
        *[(truth(bond, gauge), said(BONDED, GAUGE))] * 9, (truth(bond, gauge), said(BONDED, "fluid absorption")),
        (truth(bond), {**none, "verdict": "not_finished"}), (truth(bond), said("fluid absorption", "softening")),
    ]
    made = [outcome(f"{k:04d}", *case) for k, case in enumerate(cases)]
    # The mechanism is the generator's word, not the effect's name.
    seconds = {"nothing": 10.0, "one effect": 25.0, "outside": 40.0, "two effects": 50.0}
    words = {"partial bond": "delamination", "substrate crack": "substrate_crack"}
    made = [replace(o, mechanism=words.get(o.mechanism, o.mechanism)) for o in made]
    return [replace(o, seconds=seconds[o.kind] + (30.0 if o.said == "fluid absorption" else 0.0), memory=250.0 + k)
            for k, o in enumerate(made)]


def test_the_table_has_every_figure_that_the_diagnosis_is_judged_by(capsys: pytest.CaptureFixture[str]) -> None:
    scoring.table(made_up())
    lines = capsys.readouterr().out.splitlines()
    for line in (
        r"one effect, detectable: named first +39/44  88.6 \(76 to 95\)$",
        "one effect, detectable: in the set that is named +40/44 ", "one effect, detectable: right region +41/44 ",
        "two effects: all that is detectable named +9/10 ", "two effects: one or both named, and none .* +9/10 ",
        "one or two, detectable: an effect named that is not there +5/54 ",
        "nothing concealed: false alarm +1/25   4.0 ", "nothing concealed: unexplained +1/25 ",
        "not detectable: claimed +1/10 ",
        "outside, detectable: laid to an effect of the catalogue +1/10 ",
        "outside, detectable: not called explained +9/10 ", "outside, detectable: right region +8/10 ",
        "claimed: a held-out state beyond 1.3 +1/56 ", "failed, or not done in time +1/99 ",
        "95 % intervals of what is named that hold the truth +1/2  50.0 ",
        "processor time, s: nothing +25: 10, 10$", "processor time, s: one effect +54: 25, 55$",
        "processor time, s: outside +10: 40, 70$", "processor time, s: two effects +10: 50, 50$",
        "memory, MB +99: 299, 348$",
    ):
        assert Counter(bool(re.match(line, each)) for each in lines)[True] == 1, line


def test_an_interval_of_a_rate_is_that_of_its_definition() -> None:
    # |share - p| = 1.96 sqrt(p (1 - p) / n) at both ends.
    for count, total in ((3, 20), (19, 20), (50, 100)):
        for p in scoring.wilson(count, total):
            assert abs(count / total - p) == pytest.approx(1.959964 * math.sqrt(p * (1.0 - p) / total), rel=1e-9)
    assert scoring.wilson(0, 25)[0] == 0.0


def test_an_effect_too_small_to_be_detected_is_there_nevertheless() -> None:
    small = truth(effect("partial bond", "bond"), effect("port necks", "cavity", 2.0))
    both, one = (outcome("0", small, said(BONDED, name)) for name in ("port necks", "fluid absorption"))
    assert [(o.group, o.first, o.wrong) for o in (both, one)] == [("pair", True, 0), ("pair", True, 1)]
