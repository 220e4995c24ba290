"""The comparison of stored benchmarks: a slower stage is found, a step or a new stage is no reason."""

from __future__ import annotations

import json
from pathlib import Path

import history
import pytest

BASELINES = sorted((Path(__file__).parent / "data" / "benchmarks").glob("*.json"))


def figures(**values: float) -> dict[str, dict[str, float]]:
    return {name.replace("_memory", ", memory").replace("__", ": "): {"value": value} for name, value in values.items()}


def test_a_slower_or_larger_stage_is_found() -> None:
    before = figures(fit=20.0, fit_memory=1.0, gone=1.0, job__mesh=0.1)
    assert history.slower(before, figures(fit=23.9, fit_memory=1.19, new=9.0, job__mesh=0.9)) == []
    assert history.slower(before, figures(fit=26.0, fit_memory=1.3)) == [
        "fit: 20 before, 26 now", "fit, memory: 1 before, 1.3 now"]


def test_every_stage_has_a_stored_baseline(capsys: pytest.CaptureFixture[str]) -> None:
    assert BASELINES
    for file in BASELINES:
        stored = json.loads(file.read_text(encoding="utf-8"))["figures"]
        assert {name for name in stored if ":" not in name} == {
            *history.STAGES, *(f"{name}, memory" for name in history.STAGES if name != "import")}
    lines = history.table(BASELINES)
    assert len(lines) >= 2 * len(history.STAGES)
    assert len({line.count("|") for line in lines}) == 1


@pytest.mark.slow
def test_a_process_measures_a_stage_and_work_that_is_added() -> None:
    first, planted = (history.smallest("coarse spectrum", 1, added)["coarse spectrum"] for added in (0.0, 1.0))
    # Twice the work; other processes change the ratio by some per cent.
    assert 1.5 < planted / first < 2.7
