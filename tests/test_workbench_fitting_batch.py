"""Batches: the file that lists them, outliers, summaries."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import quadratic

from materials import Registry
from workbench.files.errors import InputError
from workbench.fitting.batch import BatchMember, Job, Settings, content_key, finished, outlying, read_batch, summarise
from workbench.report.fit_batch import summary_record

GOOD = """
[batch]
name = "discs"

[[recordings]]
name = "disc 1"
file = "one.csv"
chip = "disc.toml"
kind = "pzt"
free = ["default", "bench.series_resistance"]
band = ["0.91 MHz", "1.15 MHz"]
save = "pzt4/one"

[[recordings]]
name = "disc 2"
file = "one.csv"
chip = "disc.toml"
kind = "pzt"

[[recordings]]
name = "with sample"
file = "one.csv"
chip = "disc.toml"
kind = "polymer"

[[joint]]
name = "both"
recordings = ["disc 2", "with sample"]
own = ["transducer.thickness"]
"""


@pytest.fixture
def listed(tmp_path: Path) -> Path:
    (tmp_path / "one.csv").write_text("recording")
    (tmp_path / "disc.toml").write_text("chip")
    path = tmp_path / "batch.toml"
    path.write_text(GOOD)
    return path


def test_a_file_becomes_jobs(listed: Path) -> None:
    found = read_batch(listed)
    assert found.name == "discs"
    assert [job.name for job in found.jobs] == ["disc 1", "both"]  # what is in a group is not fitted by itself
    alone, both = found.jobs
    assert alone.members[0].free == ("default", "bench.series_resistance")
    assert alone.members[0].band == (0.91e6, 1.15e6)
    assert alone.members[0].recording == listed.parent / "one.csv"
    assert alone.save == "pzt4/one"
    assert [m.kind for m in both.members] == ["pzt", "polymer"]
    assert both.own == ("transducer.thickness",)


@pytest.mark.parametrize(
    ("old", "new", "field", "said"),
    [
        ('kind = "polymer"', 'kind = "polymers"', "recordings[2].kind", "polymer"),
        ('name = "disc 2"', 'name = "disc 1"', "recordings[1].name", "of its own"),
        ('file = "one.csv"', 'file = "two.csv"', "recordings[0].file", "a recording that is there"),
        ('name = "disc 1"', 'name = "../disc"', "recordings[0].name", "folder"),
        ("0.91 MHz", "1.91 MHz", "recordings[0].band", "rising"),
        ('"disc 2", "with sample"', '"disc 2", "with samples"', "joint[0].recordings", "with sample"),
        ('"disc 2", "with sample"', '"disc 2", "disc 2"', "joint[0].recordings", "one group"),
        ('"disc 2", "with sample"', '"disc 2"', "joint[0].recordings", "two"),
        ('name = "both"', 'name = "disc 1"', "joint.name", "no recording"),
        ("save =", "saves =", "recordings[0].saves", "save"),
    ],
)
def test_mistakes_in_the_file_are_named(listed: Path, old: str, new: str, field: str, said: str) -> None:
    assert old in GOOD
    listed.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_batch(listed)
    assert error.value.field == field
    assert said in str(error.value)


def job(path: Path, name: str = "one", **changes: Any) -> Job:
    return Job(name, (BatchMember(name, path / "one.csv", path / "disc.toml", "pzt", **changes),))


def test_the_key_knows_all_that_decides(listed: Path) -> None:
    folder, material = listed.parent, Registry().load("pzt4/acevedo_2026_initial")
    filling = [{"transducer": material}]
    keys = [content_key(job(folder), Settings(), filling)]
    assert keys == [content_key(job(folder), Settings(), filling)]
    keys.append(content_key(job(folder, free=("c33",)), Settings(), filling))
    keys.append(content_key(job(folder), Settings(accuracy=quadratic(8.0)), filling))
    keys.append(content_key(job(folder), Settings(), [{"transducer": Registry().load("pzt5a/erturk_2011")}]))
    (folder / "one.csv").write_text("another recording")
    keys.append(content_key(job(folder), Settings(), filling))
    (folder / "disc.toml").write_text("another chip")
    keys.append(content_key(job(folder), Settings(), filling))
    assert len(set(keys)) == len(keys)


def test_only_a_whole_result_of_the_same_key_is_finished(tmp_path: Path) -> None:
    assert finished(tmp_path, "k") is None
    (tmp_path / "fit.json").write_text('{"key": "k", "x"')
    assert finished(tmp_path, "k") is None
    (tmp_path / "fit.json").write_text('{"key": "k"}')
    assert finished(tmp_path, "k") == {"key": "k"}
    assert finished(tmp_path, "other") is None


def test_outliers_are_judged_robustly() -> None:
    values = np.array([10.0, 10.1, 9.9, 10.05, 12.0])
    # Median 10.05, absolute deviations 0.05 0.05 0.15 0 1.95: sigma 0.074, and 0.15 is two of them.
    assert outlying(values).tolist() == [False, False, False, False, True]
    # The standard deviation of all five, 0.88, would excuse the odd one.
    assert abs(values[-1] - values.mean()) < 3.5 * values.std(ddof=1)
    assert not outlying(np.array([1.0, 1.0, 5.0])).any()  # nobody can say which
    assert outlying(np.array([1.0, 1.0, 1.0, 1.0, 1.0 + 1e-6])).tolist() == [False] * 4 + [True]


def record(c33: float, *, own: float | None = None) -> dict[str, Any]:
    def row(name: str, value: float, unit: str, recordings: list[str]) -> dict[str, Any]:
        return {"name": name, "value": value, "low": value - 1.0, "high": value + 1.0, "unit": unit,
                "recordings": recordings}

    rows = [row("pzt4/x.c33", c33, "Pa", [])]
    if own is not None:
        rows += [row("transducer.thickness", own + i, "m", [name]) for i, name in enumerate(("a", "b"))]
    return {"parameters": rows, "recordings": [{"name": "r", "figures": {"measured": {"f0_hz": 1e6 + c33}}}],
            "derived": [], "accepted": True, "refusals": [], "mape_percent": 1.0, "rms_log_residual": 0.01,
            "wall_seconds": 1.0, "full_solves": 5, "saved_as": None}


def test_a_summary_sets_the_same_parameter_side_by_side() -> None:
    records = {f"disc {i}": record(c33) for i, c33 in enumerate((100.0, 102.0, 101.0, 120.0))}
    found = {c.name: c for c in summarise(records)}
    assert found["c33"].mean == pytest.approx(105.75)
    assert found["c33"].deviation == pytest.approx(np.std([100, 102, 101, 120], ddof=1))
    assert found["c33"].dispersion_percent == pytest.approx(100.0 * 20.0 / 105.75)
    assert found["c33"].outliers == ("disc 3",)
    assert found["c33"].low.tolist() == [99.0, 101.0, 100.0, 119.0]
    assert found["measured f0"].values[0] == 1e6 + 100.0
    told = summary_record("discs", tuple(found.values()), records, {"disc 9": "why"})
    assert json.loads(json.dumps(told))["failed"] == {"disc 9": "why"}


def test_what_each_recording_of_a_group_has_for_itself_is_a_device_each() -> None:
    found = {c.name: c for c in summarise({"group": record(100.0, own=2.0)})}
    assert found["transducer.thickness"].devices == ("group: a", "group: b")
    assert "c33" not in found  # one number has no dispersion
