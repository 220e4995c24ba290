"""The runner of concealed-effect trials: its schedule, its processes, its scores."""

from __future__ import annotations

import json
import math
import re
import time
from collections import Counter
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import trials
from concealed import scoring
from concealed.mechanisms import CATALOGUED, CLASHING, OUTSIDE, SHAPES
from concealed.running import work
from fake_trials import SAID, stands_in, written_late


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(4):
        (tmp_path / "trials" / f"{number:04d}").mkdir(parents=True)
    return tmp_path


def found(folder: Path, commit: str) -> dict[str, dict[str, Any]]:
    return {path.stem: json.loads(path.read_text()) for path in (folder / "found" / commit).glob("*.json")}


def test_a_round_holds_what_is_asked_for() -> None:
    drawn = list(islice(trials.schedule(1), 300))
    count = Counter(name for names in drawn if len(names) == 1 for name in names)
    pairs = [set(names) for names in drawn if len(names) == 2]
    assert count["none"] >= 40
    assert len(pairs) >= 30
    # Three of 465 pairs clash: of these 2000 draws some would.
    assert not any(set(names) in CLASHING for names in islice(trials.schedule(1), 20000))
    assert all(count[name] >= 6 for name in CATALOGUED)
    assert all(count[name] >= 6 for name in OUTSIDE)
    assert {name for pair in CLASHING for name in pair} <= set(CATALOGUED)
    assert drawn == list(islice(trials.schedule(1), 300))
    assert drawn != list(islice(trials.schedule(2), 300))


def test_shapes_have_rounds_of_their_own() -> None:
    drawn = [name for (name,) in islice(trials.schedule(1, shapes=True), 20)]
    assert Counter(drawn) == dict.fromkeys(("none", *SHAPES), 4)
    assert not {*SHAPES} & {name for names in islice(trials.schedule(1), 300) for name in names}


def test_one_thing_may_be_concealed_in_all() -> None:
    assert set(islice(trials.schedule(1, conceal="meniscus"), 5)) == {("meniscus",)}


def test_a_run_survives_what_fails_and_what_hangs_and_goes_on_where_it_was(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    started = time.monotonic()
    trials.run(folder, 2, 0.05, diagnosing=stands_in, commit=lambda: "abc")
    assert time.monotonic() - started < 30.0
    first = found(folder, "abc")
    assert {name: said["verdict"] for name, said in first.items()} == {
        "0000": "below_detection", "0001": "failed", "0002": "failed", "0003": "below_detection"}
    assert first["0001"]["reason"] == "ValueError: a radius came too close to another"
    assert first["0002"]["reason"] == "no answer within 0.05 min"
    assert first["0002"]["wall_seconds"] == pytest.approx(3.0, abs=2.0)
    assert all(0.0 < said["cpu_seconds"] < said["wall_seconds"] + 1.0 and said["commit"] == "abc"
               for said in first.values())
    assert "0002 failed no answer within 0.05 min" in capsys.readouterr().out
    (folder / "found" / "abc" / "0001.json").unlink()
    trials.run(folder, 2, 0.05, diagnosing=stands_in, commit=lambda: "abc")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["0001"]


def test_outcomes_are_kept_by_commit(folder: Path) -> None:
    with pytest.raises(SystemExit, match="abc-dirty: outcomes are those of a commit"):
        trials.run(folder, 1, 0.05, diagnosing=stands_in, commit=lambda: "abc-dirty")
    moving = iter(["abc", "abc", "abd"])
    with pytest.raises(SystemExit, match="moved from abc to abd"):
        trials.run(folder, 1, 0.05, diagnosing=stands_in, commit=lambda: next(moving))
    assert set(found(folder, "abc")) == {"0000"}
    (folder / "trials" / "0002").rmdir()
    trials.run(folder, 2, 0.05, diagnosing=stands_in, commit=lambda: "abd")
    assert set(found(folder, "abc")) == {"0000"}
    assert set(found(folder, "abd")) == {"0000", "0001", "0003"}


def test_whoever_stops_leaves_nothing_running(tmp_path: Path) -> None:
    mark = tmp_path / "written"
    running = work([("late", partial(written_late, mark)), ("soon", str)], 2, 60.0)
    assert next(running).name == "soon"
    running.close()  # type: ignore[attr-defined]
    time.sleep(4.0)
    assert not mark.exists()


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
                 "wall time of a diagnosis: median 70 s, 90 % quantile 70 s, largest 70 s"):
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
    assert all(o.some == o.first for o in kept)
