"""What benchmarks write for programs, and two such files side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from measurements import compared, measurements


def test_figures_are_written_also_after_an_interruption(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "figures.json"

    def interrupted() -> None:
        with measurements(path) as kept:
            kept.add("wall time", 2, "s")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["figures"] == {"wall time": {"value": 2.0, "unit": "s"}}
    assert {"command", "commit", "processors"} <= set(found)


def test_two_files_are_compared_figure_by_figure() -> None:
    before = {"commit": "a", "figures": {"time": {"value": 4.0, "unit": "s"}, "gone": {"value": 1.0, "unit": "1"}}}
    after = {"commit": "b", "figures": {"time": {"value": 1.0, "unit": "s"}, "new": {"value": 0.0, "unit": "%"}}}
    assert compared(before, after) == [
        ("", "unit", "a", "b", "ratio"), ("time", "s", "4", "1", "0.25"), ("gone", "1", "1", "", ""),
        ("new", "%", "", "0", "")]
