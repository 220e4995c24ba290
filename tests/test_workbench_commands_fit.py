"""``workbench fit`` and ``workbench sensitivity`` end to end on a disc the size of a pea."""

from __future__ import annotations

import html
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import DISC, STACK, check_report, standard_json

from geometry.chip import read_chip
from materials import Registry, user_registry
from workbench.cli import main
from workbench.commands import fit_job
from workbench.fem.operators import assemble
from workbench.fitting import uncertainty
from workbench.fitting.joint import FitResult
from workbench.fitting.search import FitSearch
from workbench.model.problem import build, fill
from workbench.readers import read_recording
from workbench.reduced.at_point import reduce
from workbench.report.fit import shown_estimate
from workbench.results.spectrum import Spectrum, write_spectrum

pytestmark = pytest.mark.usefixtures("tables_fit")

MATERIAL = "pzt4/acevedo_2026_initial"
SMALL = ["--accuracy", "0.5 %", "--tries", "0"]


def record_of(path: Path, changes: dict[str, float], name: str, *, points: int = 41) -> Path:
    """A recording of the chip whose coefficients are off by factors, beside its file."""
    chip = read_chip(path)
    problem = build(fill(chip, "default", Registry()), accuracy=5e-3)
    values = {**problem.values, **{key: factor * problem.values[key] for key, factor in changes.items()}}
    frequency = np.linspace(300e3, 450e3, points)
    solution = reduce(assemble(problem.mesh, problem.terms), frequency, values, tolerance=1e-6).solve(frequency, values)
    spectrum = Spectrum.from_solver(frequency, solution.impedance)
    write_spectrum(spectrum, path.with_name(name))
    return path.with_name(name)


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("devices")
    (found / "disc.toml").write_text(DISC)
    (found / "stack.toml").write_text(STACK)
    record_of(found / "disc.toml", {f"{MATERIAL}.c33": 1.05}, "disc.csv")
    return found


def fit(folder: Path, *more: str, out: Path, kind: str = "pzt", recording: str = "disc.csv") -> int:
    return main(["fit", kind, str(folder / recording), "--chip", str(folder / f"{more[0]}.toml"), *SMALL, *more[1:],
                 "-o", str(out)])


def test_a_transducer_is_fitted_reported_and_saved(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    assert fit(folder, "disc", "--free", "c33, c33.loss", "--start", "pzt5a/erturk_2011", "--save", "pzt4/pea",
               "--materials", str(mine), out=tmp_path / "out") == 0
    record = standard_json(tmp_path / "out" / "fit.json")
    assert record["parameters"][0]["value"] == pytest.approx(1.05 * 115.41e9, rel=1e-3)
    assert [s["label"] for s in record["starts"]] == ["start", "pzt5a/erturk_2011"]
    assert record["saved_as"] == "pzt4/pea@1"
    assert Registry((mine,)).load("pzt4/pea").c33.real == record["parameters"][0]["value"]
    text = check_report(tmp_path / "out" / "report.html")
    order = [text.index(f"<h2>{heading}") for heading in
             ("Result", "Pictures", "Starts and effort", "Bands left out", "Noise", "The recordings")]
    assert order == sorted(order)
    for name in ("fit_disc.png", "intervals.png", "correlation.png", "disc_fitted.csv", "disc_start.csv"):
        assert (tmp_path / "out" / name).exists()
    said = capsys.readouterr()
    assert "saved as pzt4/pea@1" in said.out
    assert re.search(r"c33 +│ 115.41 +│ 121\.\d+", said.out)
    assert "same optimum" in said.err


def test_a_fit_interrupted_after_saving_says_so_and_is_not_saved_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_arguments: object, **_named: object) -> None:
        signal.raise_signal(signal.SIGTERM)

    job = ("disc", "--free", "c33", "--save", "pzt_mine/pea")
    with monkeypatch.context() as patch:
        patch.setattr(fit_job, "write_fit_report", interrupted)
        assert fit(folder, *job, out=tmp_path / "out") == 143
    assert re.search(r"interrupted: .* holds disc_fitted\.csv.*; pzt_mine/pea@1 is saved$",
                     " ".join(capsys.readouterr().err.split()))
    assert fit(folder, *job, out=tmp_path / "out") == 0
    assert "pzt_mine/pea@1 has the same content already: not saved again" in capsys.readouterr().out
    assert standard_json(tmp_path / "out" / "fit.json")["saved_as"] == "pzt_mine/pea@1"
    assert [name for name in user_registry([]).names() if "pea" in name] == ["pzt_mine/pea@1"]


def test_a_fit_that_explains_nothing_is_a_verdict_and_is_saved_only_by_force(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # One permittivity cannot take the place of a stiffness: the resonance stays where it was.
    record_of(folder / "disc.toml", {f"{MATERIAL}.c11": 0.8, f"{MATERIAL}.c33": 0.8}, "softer.csv")
    spectrum = read_recording(folder / "softer.csv").spectrum
    np.savetxt(folder / "softer.csv", np.stack([spectrum.frequency, spectrum.magnitude, spectrum.phase_deg], axis=1),
               delimiter=",", header="Frequency (Hz),|Z| (Ohm),theta (deg)", comments="", fmt="%.17g")
    bad = ("disc", "--free", "eps11", "--save", "pzt4/pea", "--force")
    assert fit(folder, *bad[:-1], out=tmp_path / "out", recording="softer.csv") == 1
    record = standard_json(tmp_path / "out" / "fit.json")
    assert not record["accepted"]
    assert "another optimum or missing physics: try `workbench diagnose`" in record["refusals"][0]
    assert record["saved_as"] is None
    assert "pzt4/pea@1" not in Registry().names()
    said = capsys.readouterr().err
    assert "not accepted: softer: 3.7e+02 % of Z remains" in said
    assert 'softer: read by its headings, "Frequency (Hz)" is the frequency in Hz; "|Z| (Ohm)" is' in said
    page = html.unescape((tmp_path / "out" / "report.html").read_text())
    assert 'theta (deg)" is the phase of Z in deg' in page
    assert "not saved as pzt4/pea" in said
    assert "another optimum or missing physics" in page
    assert fit(folder, *bad, out=tmp_path / "forced", recording="softer.csv") == 1
    saved = Registry((tmp_path / "data" / "acoustofluidic-chip-workbench" / "materials",)).load("pzt4/pea@1")
    assert saved.fit is not None
    assert saved.fit.forced


def test_a_sample_is_fitted_with_its_gel(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record_of(folder / "stack.toml", {"pla/acevedo_2026.bulk_modulus": 1.1, "pla/acevedo_2026.shear_modulus": 0.95},
              "stack.csv")
    assert fit(folder, "stack", "--gel-study", "50um,100um", kind="polymer", recording="stack.csv",
               out=tmp_path / "out") == 0
    record = standard_json(tmp_path / "out" / "fit.json")
    moduli = {p["name"].split(".", 1)[1]: p["value"] for p in record["parameters"]}
    assert moduli["bulk_modulus"] == pytest.approx(1.1 * 3.57e9, rel=0.01)
    assert moduli["shear_modulus"] == pytest.approx(0.95 * 0.93e9, rel=0.01)
    speeds = {d["name"]: d for d in record["derived"]}
    expected = np.sqrt((moduli["bulk_modulus"] + 4 * moduli["shear_modulus"] / 3) / 1131.7)
    assert speeds["longitudinal speed"]["value"] == pytest.approx(expected)
    errors = {round(1e6 * c["thickness_m"]): c["mape_percent"] for c in record["gel_study"]}
    # The thickness it was recorded with fits, the other does not.
    assert errors[50] < 0.2 * errors[100]
    assert (tmp_path / "out" / "gel.png").exists()
    said = capsys.readouterr().out
    assert "longitudinal absorption" in said
    assert "thickness of the gel" in said


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["disc", "--free", "c34"], "coefficient"),
        (["disc", "--free", "c33,"], "commas"),
        (["disc", "--start", "pla"], "of the kind of"),
        (["disc", "--from", "335 kHz", "--to", "375 kHz"], "at least as many as free parameters, 1"),
        (["disc", "--from", "1 MHz", "--to", "2 MHz"], "2 points or more"),
        (["disc", "--save", "pzt4"], "material/name"),
        (["disc", "--gel-study", "5um"], "unrecognized argument: --gel-study"),
        (["disc", "--tries", "-1"], "0 for none"),
        (["ten_times_thicker"], "this recording is not of this device"),
        (["ten_times_wider"], "this recording is not of this device"),
    ],
)
def test_what_people_get_wrong(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # All of it before the search begins.
    monkeypatch.setattr(fit_job, "fit_parameters", None)
    (folder / "ten_times_thicker.toml").write_text(DISC.replace('"2 mm"', '"20 mm"'))
    (folder / "ten_times_wider.toml").write_text(DISC.replace('"3 mm"', '"30 mm"'))
    try:
        status = fit(folder, *more, out=tmp_path / "out")
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    assert status == 2
    assert said in capsys.readouterr().err


def test_a_gel_is_asked_for_where_there_is_none(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_job, "fit_parameters", None)
    assert fit(folder, "disc", "--region", "transducer", "--gel-study", "5um", kind="polymer", out=tmp_path) == 2
    assert "isotropic solid" in capsys.readouterr().err


def test_phases_that_are_no_numbers_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (folder / "disc.csv").read_text().splitlines()
    rows = [line if line[0] in "#f" else ",".join([*line.split(",")[:2], "nan"]) for line in lines]
    (folder / "nan.csv").write_text("\n".join(rows) + "\n")
    assert fit(folder, "disc", out=tmp_path, recording="nan.csv") == 2
    assert "nan" in capsys.readouterr().err


def test_an_interrupted_search_keeps_the_best_fit_so_far(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    record_of(folder / "disc.toml", {f"{MATERIAL}.c11": 0.9, f"{MATERIAL}.c33": 0.9}, "other.csv")
    begun: list[str] = []

    def descend(search: FitSearch, *arguments: Any, rival: Any = None, **named: Any) -> Any:
        if rival is not None:
            begun.append("a further descent")
            signal.raise_signal(signal.SIGINT)
        return whole(search, *arguments, rival=rival, **named)

    whole = FitSearch.descend
    monkeypatch.setattr(FitSearch, "descend", descend)
    job = ("disc", "--free", "c33", "--tries", "2", "--save", "pzt4/half")
    assert fit(folder, *job, out=tmp_path / "out", recording="other.csv") == 130
    assert begun == ["a further descent"]
    record = standard_json(tmp_path / "out" / "fit.json")
    assert (record["interrupted"], record["accepted"], record["saved_as"]) == (True, False, None)
    assert "Interrupted: the result is the best so far" in record["findings"][0]
    assert record["key"] is None
    assert record["bands_left_out"] == []
    said = " ".join(capsys.readouterr().err.split())
    assert "interrupted: " in said
    assert "fit.json" in said


def test_an_interruption_while_a_fit_is_judged_or_written_keeps_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, begun = uncertainty.leave_bands_out, list[str]()

    def interrupted(*_arguments: object, **_named: object) -> None:
        begun.append("a step")
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(uncertainty, "leave_bands_out", interrupted)
        assert fit(folder, "disc", "--free", "c33", out=tmp_path / "judged") == 130
    record = standard_json(tmp_path / "judged" / "fit.json")
    assert (record["interrupted"], record["accepted"]) == (True, True)
    assert record["parameters"][0]["value"] == pytest.approx(1.05 * 115.41e9, rel=1e-3)
    with monkeypatch.context() as patch:
        patch.setattr(fit_job, "write_spectrum", interrupted)
        assert fit(folder, "disc", "--free", "c33", out=tmp_path / "written") == 130
    record = standard_json(tmp_path / "written" / "fit.json")
    assert (record["key"], record["accepted"]) == (None, True)
    assert len(begun) == 2
    assert uncertainty.leave_bands_out is whole


def test_an_interruption_ends_with_its_status(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> FitResult:
        raise KeyboardInterrupt

    monkeypatch.setattr(fit_job, "fit_parameters", interrupted)
    assert fit(folder, "disc", "--free", "c33", out=tmp_path / "out") == 130


def test_a_batch_is_summarised_keeps_what_is_good_and_goes_on_where_it_was(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "wide.toml").write_text(DISC.replace('"3 mm"', '"30 mm"'))
    listed = folder / "batch.toml"
    listed.write_text('[batch]\nname = "pair"\n' + "".join(
        f'[[recordings]]\nname = "{name}"\nfile = "disc.csv"\nchip = "{chip}.toml"\nkind = "pzt"\nfree = ["c33"]\n'
        for name, chip in (("a", "disc"), ("b", "disc"), ("c", "disc"), ("wrong", "wide")))
        + '[[joint]]\nname = "both"\nrecordings = ["b", "c"]\nown = ["bench.gain"]\n')
    out = tmp_path / "out"
    command = ["fit", "batch", str(listed), *SMALL, "--jobs", "2", "-o", str(out)]
    assert main(command) == 1
    summary = standard_json(out / "summary.json")
    assert set(summary["devices"]) == {"a", "both"}
    assert "not of this device" in summary["failed"]["wrong"]
    assert "wrong: wrong: capacitance" in capsys.readouterr().err
    columns = {c["name"]: c for c in summary["parameters"]}
    assert columns["c33"]["mean"] == pytest.approx(1.05 * 115.41e9, rel=1e-3)
    assert set(columns["bench.gain"]["devices"]) == {"both: b", "both: c"}
    assert "both" in check_report(out / "report.html")
    assert (out / "batch.png").exists()
    assert all((out / name / file).exists() for name in ("a", "both") for file in ("fit.json", "report.html"))

    # The mistake is mended and nothing else changes: only that one is made.
    (folder / "wide.toml").write_text(DISC)
    before = {name: (out / name / "fit.json").stat().st_mtime_ns for name in ("a", "both")}
    assert main(command) == 0
    assert {name: (out / name / "fit.json").stat().st_mtime_ns for name in ("a", "both")} == before
    said = capsys.readouterr().err
    assert "a: finished before" in said
    assert "both: finished before" in said
    again = standard_json(out / "summary.json")
    assert set(again["devices"]) == {"a", "both", "wrong"}
    assert again["devices"]["a"] == summary["devices"]["a"]
    assert again["failed"] == {}


def test_the_ranking_stands_beside_the_published_one(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["sensitivity", str(folder / "disc.toml"), "--density", "7600 kg/m^3", "--points", "21", "--scalings",
                 "4", "--accuracy", "0.5 %", "-o", str(out)]) == 0
    record = standard_json(out / "sensitivity.json")
    assert record["density_kg_m3"] == 7600.0
    assert len(record["parameters"]) == 16
    rows = {p["name"]: p for p in record["parameters"]}
    assert rows["c33"]["published"] == 1.0
    assert max(p["slope"] for p in record["parameters"] if not p["name"].endswith("loss")) == 1.0
    assert len(rows["c33"]["costs"]) == 4
    assert rows["c44.loss"]["slope"] == 0.0
    said = capsys.readouterr()
    assert "c44.loss" in said.err  # zero in the baseline
    assert "published" in said.out
    text = check_report(out / "report.html")
    assert "Zero in the baseline" in text
    for name in ("ranking.png", "costs_real.png", "costs_imaginary.png"):
        assert (out / name).exists()


@pytest.mark.parametrize(("estimate", "unit", "said"), [
    ((1.2345678e11, 1.2e11, 1.27e11), "Pa", ("123.46", "120 to 127")),
    ((1.2345678e11, 1.23455e11, 1.23458e11), "Pa", ("123.4568", "123.455 to 123.458")),  # five digits hide it
    ((2.0, 2.0, 2.0), "1", ("2", "2 to 2")),
    ((2.0, np.nan, np.nan), "1", ("2", "")),
])
def test_an_estimate_is_shown_with_the_digits_its_interval_asks_for(
    estimate: tuple[float, float, float], unit: str, said: tuple[str, str]
) -> None:
    assert shown_estimate(*estimate, unit) == said
