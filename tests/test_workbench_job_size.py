"""The size of a job is estimated without a mesh and refused where the machine has no room for it, with what fits."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import pytest

import workbench as wb
from geometry.chip import Chip, read_chip
from workbench.cli import main
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.jobs.memory import Room, free_memory
from workbench.model import job_size
from workbench.model.discretisation import ROWS, discretisation
from workbench.model.job_size import check_points, check_size, memory_to_use, of_unknowns
from workbench.model.problem import build, fill

ROOT = Path(__file__).resolve().parent.parent
DISC, SMALL = ROOT / "geometry/chips/disc_20x2.toml", ROOT / "geometry/chips/small_campaign/chip.toml"


@pytest.fixture
def chip() -> Chip:
    return read_chip(SMALL)


@pytest.mark.parametrize("accuracy", ROWS)
def test_unknowns_are_estimated_without_a_mesh(chip: Chip, accuracy: float) -> None:
    device = fill(chip, "filled")
    made = discretisation(accuracy)
    found = job_size.job_size(device.section, device.materials, made, chip.band)
    problem = build(device, accuracy=accuracy)
    # What regions share along their boundaries is counted twice: 5 % at most.
    assert found.unknowns == pytest.approx(assemble(problem.mesh, problem.terms).size, rel=0.08)


def test_memory_and_time_grow_as_nested_dissection_does() -> None:
    small, large = of_unknowns(1e5, 4, 50.0), of_unknowns(1e8, 4, 50.0)
    # N log N and N^1.5, each above what is linear in N.
    assert 1e3 < large.memory / small.memory < 1.2e3
    assert 1e4 < large.seconds / small.seconds < 10.0**4.5
    # Measured on the reference chip (tests/benchmarks/job_size.py): 2.6 GB and 35 s for 102 000 unknowns.
    assert of_unknowns(102e3, 4, 54.0).memory == pytest.approx(2.67e9, rel=0.2)
    assert of_unknowns(102e3, 4, 54.0).seconds == pytest.approx(35.0, rel=0.5)


def test_a_lost_point_in_the_band_is_refused_at_once(chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    wide = replace(chip, band=(0.95e6, 108e6), unusual=("band",))

    def never(*_arguments: object) -> None:
        raise AssertionError("a mesh was made")

    monkeypatch.setattr("workbench.model.problem.meshed", never)
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "16 GB")
    wb.simulate, wb.range_model  # noqa: B018 - loaded before the clock starts
    began = time.process_time()
    for make in (lambda: wb.simulate(wide), lambda: wb.snapshot(wide, None, 1e6),
                 lambda: wb.range_model(wide, None, {"couplant.thickness": (10e-6, 30e-6)})):
        with pytest.raises(InputError, match=r"million unknowns.* TB of memory.*expected at most 16 GB.*"
                                             r"a band that ends at [\d.]+ MHz would fit") as caught:
            make()
        assert caught.value.nearest == ("0.95 to 1.08 MHz",)
    assert time.process_time() - began < 1.0
    # What is said to fit does.
    ends = re.search(r"ends at ([\d.]+) MHz", str(caught.value))
    assert ends is not None
    device = fill(wide, "filled")
    check_size(device.section, device.materials, discretisation(5e-4), (0.95e6, 1e6 * float(ends.group(1))), source="x")


def test_a_coarser_accuracy_is_proposed_where_that_fits(chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "500 MB")
    with pytest.raises(InputError, match=r"at most 500 MB, .*: the accuracy 0\.05 %"):
        wb.simulate(chip, "filled", accuracy=1e-4)
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "20 MB")
    with pytest.raises(InputError, match="neither another accuracy nor a lower band would fit"):
        wb.simulate(chip, "filled")


@pytest.mark.parametrize("command", [
    ["simulate", str(DISC), "-o"], ["render", str(DISC), "--at", "1 MHz", "-o"],
    ["mesh", str(DISC), "--converge", "-o"],
    ["study", str(ROOT / "examples/small_study/study.toml"), "--jobs", "1", "-o"],
    ["diagnose", str(ROOT / "geometry/chips/small_campaign/campaign.toml"), "--jobs", "1", "-o"],
])
def test_every_command_refuses(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "20 MB")
    assert main([*command, str(tmp_path / "out")]) == 2
    assert "20 MB, the memory in WORKBENCH_MEMORY" in " ".join(capsys.readouterr().err.split())
    assert not list((tmp_path / "out").rglob("*.csv"))


def test_points_that_do_not_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "1 GB")
    check_points(100_000, source="simulate")
    with pytest.raises(InputError, match=r"points: received 1000000000; expected at most 200 000: every frequency"):
        wb.simulate(read_chip(DISC), points=1_000_000_000)


def test_the_memory_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 1e6 < free_memory().size < 1e15
    monkeypatch.setenv(job_size.MEMORY_VARIABLE, "12 GB")
    assert memory_to_use() == Room(12e9, "the memory in WORKBENCH_MEMORY")
    for wrong in ("12", "-1 GB", "much"):
        monkeypatch.setenv(job_size.MEMORY_VARIABLE, wrong)
        with pytest.raises(InputError, match=job_size.MEMORY_VARIABLE):
            memory_to_use()
