"""A study is run: its table is what the models say, whatever interrupts it, and whoever works it out."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import random
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_models import CHIP, FormulaModel, FormulaModels
from support import check_report, standard_json

from workbench.cli import main
from workbench.design.parts import parts_of
from workbench.design.plan import Study, read_study
from workbench.design.study import study
from workbench.design.study_result import StudyResult
from workbench.files.errors import InputError
from workbench.report.study import draw_study

pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

ROOT = Path(__file__).resolve().parent.parent

SOBOL = """
[study]
chip = "chip.toml"
states = ["empty", "filled"]
figures = ["f0", "z_min", "mean_e_ac"]
[sample]
method = "sobol"
points = 120
seed = 5
[vary]
substrate.thickness = { from = "0.8 mm", to = "0.9 mm" }
"cavity.radius" = { tolerance = "50 um" }
"pla.shear_modulus" = { tolerance = "5 %" }
"superstrate.material" = { materials = ["pmma", "soda_lime_glass/independent_reference"] }
"""
GRID = """
[study]
chip = "chip.toml"
states = ["empty", "filled"]
figures = ["f0", "z_min", "mean_e_ac"]
confirm = 2
[vary]
"superstrate.material" = { materials = ["pmma", "soda_lime_glass/independent_reference"] }
"substrate.thickness" = { from = "0.8 mm", to = "0.9 mm", points = 4 }
"pla.shear_modulus" = { tolerance = "5 %", points = 3 }
"""


def read(folder: Path, text: str) -> Study:
    (folder / "chip.toml").write_text(CHIP, encoding="utf-8")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return read_study(folder / "study.toml")


def run(plan: Study, folder: Path, *, models: Any = None, **asked: Any) -> StudyResult:
    """In threads of this process: fast, and the same code."""
    with ThreadPoolExecutor(2) as pool:
        return study(plan, folder, executor=pool, jobs=2, models=models or FormulaModels(), **asked)


def same(one: StudyResult, other: StudyResult) -> bool:
    """To the last bit, NaN included."""
    return one.columns.keys() == other.columns.keys() and all(
        one.columns[name].tobytes() == other.columns[name].tobytes() for name in one.columns)


def test_the_table_is_what_the_models_say(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    models = FormulaModels(without=0.85e-3)
    found = run(plan, tmp_path / "out", models=models)
    assert found.rows.index.tolist() == list(range(240))
    for part in parts_of(plan):
        model = models.formula(plan, part, 1e-6)
        for row, point in zip(part.rows, part.points, strict=True):
            said = model(dict(zip(model.names, map(float, point), strict=True)))
            # The same formula of the same numbers: the same bits.
            np.testing.assert_array_equal([found.columns[name][row] for name in plan.figures],
                                          [said.figures[name] for name in plan.figures])
            assert found.columns["superstrate.material"][row] == part.materials["superstrate"]
            assert found.columns["state"][row] == part.state
            assert bool(found.columns["missing"][row]) == (point[0] > 0.85e-3)
    assert set(found.columns["missing"]) == {"", "z_min: beyond the formula"}


def test_statistics_and_confirmations(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    found = run(plan, tmp_path / "out", models=FormulaModels(without=0.85e-3))
    for each in found.statistics:
        values = found.columns[each.figure][found.columns["state"] == each.state]
        assert (each.points, each.count) == (120, np.count_nonzero(np.isfinite(values)))
        assert each.median == np.nanmedian(values)
        assert found.columns[each.figure][each.lowest_row] == each.lowest == np.nanmin(values)
        assert found.columns["state"][each.highest_row] == each.state
    assert 0 < found.statistics[1].count < 120
    assert len(found.full.index) == 5
    # The formula is off by 1e-6, of a figure of up to 6 whose rounding is 1e-15.
    np.testing.assert_allclose([each.difference for each in found.confirmations], 1e-6, rtol=1e-8)
    record = standard_json(tmp_path / "out" / "study.json")
    assert len(record["confirmed"]) == len(found.confirmations)
    assert record["statistics"][0]["median"] == found.statistics[0].median


def test_a_grid_becomes_an_array_of_its_dimensions(tmp_path: Path) -> None:
    import xarray

    plan = read(tmp_path, GRID)
    found = run(plan, tmp_path / "out")
    with xarray.open_dataset(tmp_path / "out" / "study.nc", engine="h5netcdf") as read_back:
        whole = read_back.load()
    xarray.testing.assert_identical(whole["f0"], found.to_xarray()["f0"])
    assert dict(whole.sizes) == {"state": 2, "superstrate.material": 2, "substrate.thickness": 4,
                                 "pla_acevedo_2026.shear_modulus": 3}
    assert whole["f0"].attrs["units"] == "Hz"
    assert whole["substrate.thickness"].attrs["units"] == "m"
    assert whole["pla_acevedo_2026.shear_modulus"].attrs["long_name"] == "pla/acevedo_2026.shear_modulus"
    at = {"state": "filled", "superstrate.material": "pmma/acevedo_2026"}
    one = whole["z_min"].sel(at).isel({"substrate.thickness": 2, "pla_acevedo_2026.shear_modulus": 1})
    columns = found.columns
    (row,) = np.flatnonzero((columns["state"] == "filled") & (columns["superstrate.material"] == "pmma/acevedo_2026")
                            & (columns["substrate.thickness"] == float(one["substrate.thickness"]))
                            & (columns["pla/acevedo_2026.shear_modulus"] == plan.numbers[1].levels()[1]))
    assert float(one) == columns["z_min"][row]


def test_the_table_on_disk_is_the_table(tmp_path: Path) -> None:
    import pyarrow.parquet

    plan = read(tmp_path, SOBOL)
    found = run(plan, tmp_path / "out")
    table = pyarrow.parquet.read_table(tmp_path / "out" / "study.parquet")
    assert table.column_names == list(found.columns)
    for name, values in found.columns.items():
        np.testing.assert_array_equal(table[name].to_numpy(), values)
    assert table.schema.field("f0").metadata == {b"unit": b"Hz"}
    assert dict(found.to_xarray().sizes) == {"state": 2, "point": 120}


def test_what_is_finished_is_not_done_again(tmp_path: Path) -> None:
    plan, made = read(tmp_path, SOBOL), tmp_path / "made"
    made.mkdir()
    first = run(plan, tmp_path / "out", models=FormulaModels(made=str(made)))
    assert len(list(made.iterdir())) == 4
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "points").iterdir()}
    again = run(plan, tmp_path / "out", models=FormulaModels(made=str(made)))
    assert same(first, again)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "points").iterdir()} == before
    # Some points are lost: they alone are done again.
    lost = sorted(before)[3]
    lost.unlink()
    assert same(first, run(plan, tmp_path / "out", models=FormulaModels(made=str(made))))
    assert {path for path, at in before.items() if path.stat().st_mtime_ns != at} == {lost}
    assert len(list(made.iterdir())) == 4


def test_a_failure_keeps_what_is_finished_and_names_the_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = read(tmp_path, SOBOL)
    whole, called = FormulaModel.__call__, [0]

    def failing(self: FormulaModel, values: Any, **asked: Any) -> Any:
        called[0] += 1
        if called[0] == 100:
            raise ZeroDivisionError("no such sound")
        return whole(self, values, **asked)

    said = r"point \d+ \(substrate.thickness = 0\.000\d+, .*no such sound"
    with monkeypatch.context() as patched:
        patched.setattr(FormulaModel, "__call__", failing)
        with pytest.raises(RuntimeError, match=said):
            run(plan, tmp_path / "out")
    assert list((tmp_path / "out" / "points").iterdir())
    assert same(run(plan, tmp_path / "out"), run(plan, tmp_path / "other"))


@pytest.mark.parametrize(("old", "new", "field", "words"), [
    ("points = 120", "points = 64", "sample.points", "'120', with which the study in"),
    ('to = "0.9 mm"', 'to = "0.95 mm"', "vary.substrate.thickness", "'0.0008 to 0.0009 m'"),
    ('"z_min", ', "", "study.figures", "'f0, z_min, mean_e_ac'"),
])
def test_a_folder_of_another_study_is_refused(tmp_path: Path, old: str, new: str, field: str, words: str) -> None:
    run(read(tmp_path, SOBOL), tmp_path / "out")
    other = read(tmp_path, SOBOL.replace(old, new))
    with pytest.raises(InputError, match="--overwrite") as caught:
        run(other, tmp_path / "out")
    assert caught.value.field == field
    assert words in caught.value.expected
    found = run(other, tmp_path / "out", overwrite=True)
    assert same(found, run(other, tmp_path / "new"))


def test_a_study_of_an_older_version_is_refused_as_one(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    run(plan, tmp_path / "out")
    begun = tmp_path / "out" / "begun.json"
    # Before it had a digest.
    stored = {key: text for key, text in json.loads(begun.read_text()).items() if key != "digest"}
    begun.write_text(json.dumps(stored).replace("study.relative_error", "study.tolerance"))
    with pytest.raises(InputError, match=r"begun by an older version.*--overwrite"):
        run(plan, tmp_path / "out")
    run(plan, tmp_path / "out", overwrite=True)


def test_points_that_are_damaged_are_named_and_computed_again(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    first, points = run(plan, tmp_path / "out"), tmp_path / "out" / "points"
    one, other, full = (sorted(points.glob(pattern))[k] for pattern, k in (("0*", 1), ("0*", 3), ("full*", 2)))
    content = one.read_bytes()
    one.write_bytes(content[:200] + bytes([content[200] ^ 4]) + content[201:])
    other.write_bytes(other.read_bytes()[:-300])
    full.write_bytes(b"")
    with pytest.warns(UserWarning, match="its points are computed again") as caught:
        assert same(first, run(plan, tmp_path / "out"))
    named = [str(each.message) for each in caught]
    assert len(named) == 3
    assert all(any(str(path) in text for text in named) for path in (one, other, full))
    # Nothing is left of them.
    assert same(first, run(plan, tmp_path / "out"))


def test_files_that_are_nobodys_stay_where_they_are(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    first = run(plan, tmp_path / "out")
    strangers = [tmp_path / "out" / folder / name for folder in ("models", "points")
                 for name in (".DS_Store", "notes.txt")]
    for path in strangers:
        path.write_bytes(b"mine")
    assert same(first, run(plan, tmp_path / "out"))
    assert all(path.read_bytes() == b"mine" for path in strangers)


def test_a_damaged_record_of_a_study_is_named(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    run(plan, tmp_path / "out")
    begun = tmp_path / "out" / "begun.json"
    whole = begun.read_bytes()
    changed = [whole[:k] + bytes([whole[k] ^ 2]) + whole[k + 1:] for k in range(0, len(whole), 67)]
    for content in (*(whole[:k] for k in range(0, len(whole) - 2, 419)), *changed, b"[" * 5000, b"\xff\xfe"):
        begun.write_bytes(content)
        if content.split() == whole.split():
            continue  # a space turned into another
        with pytest.raises(InputError, match="--overwrite") as caught:
            run(plan, tmp_path / "out")
        assert str(begun) in str(caught.value) or caught.value.value == "nothing", content
    begun.write_bytes(whole)
    run(plan, tmp_path / "out")


def test_a_material_that_has_changed_is_another_study(tmp_path: Path) -> None:
    folder = tmp_path / "materials" / "pmma"
    folder.mkdir(parents=True)
    text = (ROOT / "materials/data/pmma/acevedo_2026.toml").read_text(encoding="utf-8")
    bibliography = (ROOT / "materials/data/references.bib").read_text(encoding="utf-8")
    (tmp_path / "materials" / "references.bib").write_text(
        "@" + bibliography.split("@")[1].replace("{", "{mine_", 1), encoding="utf-8")
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    (tmp_path / "chip.toml").write_text(CHIP.replace('"pmma"', '"pmma/mine"'), encoding="utf-8")
    (tmp_path / "study.toml").write_text(SOBOL.replace('"pmma", ', '"pmma/mine", '), encoding="utf-8")
    run(read_study(tmp_path / "study.toml", materials=[tmp_path / "materials"]), tmp_path / "out")
    value = next(line for line in text.splitlines() if line.startswith("density"))
    (folder / "mine.toml").write_text(text.replace(value, value.replace("1", "2", 1)), encoding="utf-8")
    with pytest.raises(InputError, match="materials of empty, pmma/mine"):
        run(read_study(tmp_path / "study.toml", materials=[tmp_path / "materials"]), tmp_path / "out")


def test_two_studies_at_once_in_one_folder_are_refused(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)

    def second(text: str, share: float) -> None:
        with pytest.raises(InputError, match="no other run is at work; process"):
            run(plan, tmp_path / "out")

    run(plan, tmp_path / "out", progress=second)


def test_jobs_below_one_and_a_file_in_the_way(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    for jobs in (0, 1.5, "2", True):
        with pytest.raises(InputError, match=f"jobs: received {jobs!r}; expected a whole number, one or more"):
            study(plan, tmp_path / "out", jobs=jobs)
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="a file is in the way"):
        run(plan, tmp_path / "study.toml")


#: A study in processes of its own, as a script runs it.
SCRIPT = """
import sys, warnings
warnings.simplefilter("ignore")
sys.path[:0] = [{root!r}, {tests!r}]
from fake_models import FormulaModels
from workbench.design.plan import read_study
from workbench.design.study import study
if __name__ == "__main__":
    study(read_study({folder!r} + "/study.toml"), {folder!r} + "/" + sys.argv[1], jobs=2,
          models=FormulaModels(pause=0.01))
"""


@pytest.mark.slow
def test_killed_again_and_again_it_ends_with_the_same_table(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL)
    script = tmp_path / "run.py"
    script.write_text(SCRIPT.format(root=str(ROOT), tests=str(ROOT / "tests"), folder=str(tmp_path)), encoding="utf-8")
    whole = run(plan, tmp_path / "whole")
    points, workers, draw_number = tmp_path / "out" / "points", set[int](), random.Random(0)
    for _ in range(2):
        with subprocess.Popen([sys.executable, str(script), "out"], stderr=subprocess.PIPE, text=True) as process:
            # At any moment after the first new points: until there are any, a kill would only repeat the start.
            before = len(list(points.glob("*.npz")))
            while process.poll() is None and len(list(points.glob("*.npz"))) == before:
                time.sleep(0.01)
            time.sleep(0.2 * draw_number.random())
            workers |= children(process.pid)
            process.send_signal(signal.SIGKILL)
            process.wait()
    finished = len(run_rows(tmp_path / "out"))
    assert 0 < finished < 240, "the study must be killed while it is at work"
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < deadline, "workers must end with the process that began them"
        time.sleep(0.05)
    assert workers
    assert same(whole, run(plan, tmp_path / "out"))
    # The files too: Parquet holds no date.
    assert (tmp_path / "out/study.parquet").read_bytes() == (tmp_path / "whole/study.parquet").read_bytes()
    assert not list(points.glob(".*"))


def children(pid: int) -> set[int]:
    found: set[int] = set()
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # as a thread may end meanwhile
            found |= set(map(int, (thread / "children").read_text().split()))
    return found


def run_rows(folder: Path) -> set[int]:
    found: set[int] = set()
    for path in (folder / "points").glob("[0-9]*.npz"):
        with np.load(path) as archive:
            found |= set(map(int, archive["index"]))
    return found


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_table(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    from workbench.jobs.cluster import dask_cluster

    plan = read(tmp_path, SOBOL)
    environment = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}
    with warnings.catch_warnings():
        # Dask's own, of ports that are taken, sockets and event loops; not ours to mend.
        warnings.simplefilter("ignore")
        os.environ.update(PYTHONPATH=environment["PYTHONPATH"])
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
                                      protocol="tcp") as cluster, dask_cluster(cluster.scheduler_address) as found:
            executor, threads = found
            assert threads == 2
            heavy = FormulaModels(ballast=2_000_000)
            table = study(plan, tmp_path / "dask", executor=executor, jobs=threads, models=heavy)
    assert same(table, run(plan, tmp_path / "threads"))


@pytest.mark.parametrize("command", [
    "study {folder}/study.toml", "tolerance {root}/geometry/chips/disc_20x2.toml --accuracy 2%",
    "design {root}/examples/design/half_wave_chip.toml", "diagnose {root}/geometry/chips/small_campaign/campaign.toml",
    "fit batch {folder}/batch.toml"])
def test_a_cluster_that_does_not_answer_is_a_clear_error(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    monkeypatch.setattr("workbench.jobs.cluster.PATIENCE", 0.2)
    read(tmp_path, SOBOL)
    campaign = ROOT / "geometry" / "chips" / "small_campaign"
    (tmp_path / "batch.toml").write_text(
        f'[[recordings]]\nname = "one"\nkind = "polymer"\nfile = "{campaign / "empty.csv"}"\n'
        f'chip = "{campaign / "chip.toml"}"\nstate = "empty"\nregion = "substrate"\n')
    address = "tcp://127.0.0.1:1"
    words = command.format(folder=tmp_path, root=ROOT).split()
    assert main([*words, "--dask", address, "-o", str(tmp_path / "out")]) == 2
    assert f"--dask: received '{address}'" in capsys.readouterr().err


def test_no_jobs_and_another_study_are_mistakes_of_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(read(tmp_path, SOBOL), tmp_path / "out")
    asked = ["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out")]
    assert main([*asked, "--jobs", "0"]) == 2
    assert "--jobs: received 0" in capsys.readouterr().err
    read(tmp_path, SOBOL.replace("seed = 5", "seed = 6"))
    assert main(asked) == 2
    assert "sample.seed: received '6'; expected '5', with which the study in" in capsys.readouterr().err


def test_pictures_of_every_state(tmp_path: Path) -> None:
    plan = read(tmp_path, SOBOL.replace('["f0", "z_min", "mean_e_ac"]', '["f0", "z_min"]').replace(
        '"superstrate.material"', '"couplant.thickness" = { values = ["10 um", "20 um"] }\n"superstrate.material"'))
    found = run(plan, tmp_path / "out", models=FormulaModels(without=0.5e-3))
    pictures = draw_study(found, tmp_path / "out")
    # The second figure is missing everywhere: nothing is drawn of it.
    assert {each.path.name for each in pictures} == {
        f"{kind}_{state}{figure}.png" for state in plan.states
        for kind, figure in (("parallel", ""), ("slices", "_f0"), ("maps", "_f0"))}
    assert all(each.path.stat().st_size > 5_000 for each in pictures)


@pytest.mark.slow
def test_the_command_on_a_real_chip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read(tmp_path, """
[study]
chip = "chip.toml"
figures = ["f0", "z_min"]
accuracy = "1 %"
relative_error = "1 %"
confirm = 1
[vary]
"substrate.thickness" = { from = "0.83 mm", to = "0.87 mm", points = 4 }
""")
    asked = ["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--jobs", "1"]
    assert main(asked) == 0
    text = check_report(tmp_path / "out" / "report.html")
    assert "Full solves" in text
    record = json.loads((tmp_path / "out" / "study.json").read_text())
    (f0,) = (each for each in record["confirmed"] if each["figure"] == "f0")
    # Both meshes are off by the 1 % asked of Z, of which a tenth at most is left in f0.
    assert abs(f0["difference"]) < 1e-3 * f0["full"]
    first = (tmp_path / "out" / "study.parquet").read_bytes()
    for path in (tmp_path / "out" / "points").iterdir():
        path.unlink()
    assert main(asked) == 0
    # The model comes from the disk, and says the same to the last bit.
    assert (tmp_path / "out" / "study.parquet").read_bytes() == first
    output = capsys.readouterr()
    assert "f0" in output.out
    assert "warning" not in output.err
    # A model that is damaged, or somebody's pickle, is named and made again; nothing runs.
    poison = pickle.dumps(Poison(tmp_path / "EXECUTED"))
    for name in ("0.npz", "0.pickle", "0.spectra.npz"):
        (tmp_path / "out" / "models" / name).write_bytes(poison)
    for path in (tmp_path / "out" / "points").iterdir():
        path.unlink()
    assert main(asked) == 0
    output = capsys.readouterr().err.replace("\n", "")
    assert output.count("it is made again") == 2
    assert "models/0.npz" in output
    assert "models/0.spectra.npz" in output
    assert not (tmp_path / "EXECUTED").exists()


@dataclass(frozen=True)
class Poison:
    """Leaves a file where it is unpickled."""

    mark: Path

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))
