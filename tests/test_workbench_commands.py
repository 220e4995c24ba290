"""The commands end to end on small devices: files, tables, interruption and resumption."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import CAVITY_LAYERS, DISC, check_report, quadratic, standard_json, visible

from geometry.chip import read_chip
from geometry.chip_section import volumes
from materials import Fit, Material, RecordingSource, Registry, Value, fitted, save_fit, user_folder
from materials.registry import PACKAGE_DATA
from workbench.cli import main
from workbench.commands import mesh, states
from workbench.commands.chips import SHIPPED
from workbench.model.discretisation import ROWS
from workbench.readers import read_recording
from workbench.results.spectrum import Spectrum, write_spectrum
from workbench.simulation.run import simulate as simulate_state

pytestmark = pytest.mark.usefixtures("tables_fit")

CELL = DISC.replace("small disc", "small cell") + CAVITY_LAYERS + """
[states.empty]
cavity = "vacuum"

[states.filled]
cavity = "water"
temperature = "20 degC"
particle = "polystyrene"
particle_radius = "5 um"
"""
SMALL = ["--accuracy", "0.5 %"]


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return path


@pytest.fixture
def disc(tmp_path: Path) -> Path:
    path = tmp_path / "disc.toml"
    path.write_text(DISC)
    return path


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "400")  # or tables fold the names


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the pictures of fields, for tests of something else."""
    monkeypatch.setattr("workbench.render.gallery.draw_state", lambda *_, **__: [])


def test_simulate_writes_everything_of_every_state(cell: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    assert main(["simulate", str(cell), "-o", str(out), "--points", "41", "--vtu", *SMALL]) == 0
    lines = (out / "spectrum.csv").read_text().splitlines()
    table = [line for line in lines if not line.startswith("#")]
    assert table[0] == "frequency_hz,z_real_ohm,z_imag_ohm"
    assert len(table) == 1 + 41
    assert lines.index(table[0]) == len(lines) - 42
    assert (out / "spectrum.csv").read_bytes() == (out / "spectrum_filled.csv").read_bytes()
    empty, filled = (read_recording(out / f"spectrum_{state}.csv").spectrum for state in ("empty", "filled"))
    assert not np.array_equal(empty.impedance, filled.impedance)
    record = standard_json(out / "merit.json")
    assert record["spectrum_csv"] == "filled"
    assert set(record["states"]) == {"empty", "filled"}
    state = record["states"]["filled"]
    lowest = filled.frequency[np.argmin(filled.magnitude)]
    assert abs(state["f0_hz"] - lowest) < 150e3 / 40
    # One of the states holds a liquid: it is driven where that has most energy.
    assert state["operating_point"]["frequency_hz"] == state["fields"]["frequency_hz"]
    assert state["energy_peaks"][0]["frequency_hz"] == state["fields"]["frequency_hz"]
    assert record["states"]["empty"]["energy_peaks"] == []
    assert state["particles"]["traps"]
    assert state["particles"]["pressure_amplitude_pa"] > 0.0
    assert sum(state["losses_w"].values()) == pytest.approx(state["fields"]["power_w"], rel=1e-9)
    pictures = {path.stem for path in out.glob("*.png")}
    assert pictures == {"cad", "impedance", "energy", "warmth", "pressure_filled", "gorkov_filled", "profiles_filled",
                        *(f"{kind}_{s}" for kind in ("displacement", "cutaway", "losses", "mesh")
                          for s in ("empty", "filled"))}
    text = check_report(out / "report.html")
    assert text.count("<img") == len(pictures)
    assert "water/iapws_2011" in text
    assert "Do particles gather?" in text
    assert "axial barrier" in text
    assert text.index("lift / weight") < text.index("deep traps of the section, by sound and weight alone")
    assert {path.suffix for path in out.glob("chip.*")} == {".step"}
    assert (out / "transducer.stl").stat().st_size > 1000
    assert (out / "fields_filled.vtu").is_file()
    assert not list(out.glob("unfinished*"))


def test_only_the_states_asked_for_are_simulated(cell: Path, tmp_path: Path, undrawn: None) -> None:
    out = tmp_path / "out"
    command = ["simulate", str(cell), "-o", str(out), "--points", "21", "--no-cad", *SMALL]
    assert main([*command, "--state", "empty", "--state", "empty"]) == 0
    assert set(standard_json(out / "merit.json")["states"]) == {"empty"}
    assert not (out / "spectrum_filled.csv").exists()
    assert not (out / "chip.step").exists()


def test_no_resonance_is_an_answer(
    disc: Path, tmp_path: Path, undrawn: None, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    band = ["--from", "20 kHz", "--to", "40 kHz", "--points", "11"]
    assert main(["simulate", str(disc), "-o", str(out), "--no-cad", *band, *SMALL]) == 0
    state = standard_json(out / "merit.json")["states"]["default"]
    assert state["f0_hz"] is None
    assert "edge of the band" in state["no_resonance"]
    assert state["fields"]["frequency_hz"] == 30e3
    assert "edge of the band" in capsys.readouterr().err
    assert "edge of the band" in (out / "report.html").read_text()


class Stop:
    """Simulates like the command does, and is interrupted after so many points."""

    def __init__(self, points: int) -> None:
        self.left, self.solved = points, 0

    def __call__(self, *arguments: Any, on_point: Callable[[float, complex], None], **settings: Any) -> Any:
        def counted(frequency: float, impedance: complex) -> None:
            on_point(frequency, impedance)
            self.solved, self.left = self.solved + 1, self.left - 1
            if self.left == 0:
                raise KeyboardInterrupt

        return simulate_state(*arguments, on_point=counted, **settings)


def test_an_interrupted_full_spectrum_goes_on_where_it_stopped(
    cell: Path, tmp_path: Path, undrawn: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["simulate", str(cell), "--full", "--points", "7", "--no-cad", *SMALL, "-o"]
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert main([*command, str(whole)]) == 0
    # In the second state: the first one is done, and must not be solved again either.
    first = Stop(7 + 3)
    monkeypatch.setattr(states, "simulate_state", first)
    assert main([*command, str(stopped)]) == 130
    assert "holds spectrum_empty.csv, unfinished_empty.csv" in capsys.readouterr().err
    unfinished = stopped / "unfinished_filled.csv"
    assert len(unfinished.read_text().splitlines()) == 1 + 3
    # A kill may leave a line that reads as a number but lacks its last digits.
    text = unfinished.read_text()
    unfinished.write_text(text[:-4])
    second = Stop(10**6)
    monkeypatch.setattr(states, "simulate_state", second)
    assert main([*command, str(stopped)]) == 0
    assert (first.solved, second.solved) == (10, 7 - 2)
    for state in ("empty", "filled"):
        name = f"spectrum_{state}.csv"
        assert (stopped / name).read_bytes() == (whole / name).read_bytes()
    assert not list(stopped.glob("unfinished*"))


@pytest.mark.parametrize("change", ["mesh", "chip", "material"])
def test_points_of_another_model_are_not_taken_over(
    change: str, disc: Path, tmp_path: Path, undrawn: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "own" / "ceramic"
    folder.mkdir(parents=True)
    package = PACKAGE_DATA / "pzt4" / "acevedo_2026_initial.toml"
    entry = folder / "mine.toml"
    entry.write_text(package.read_text())
    disc.write_text(DISC.replace("pzt4/acevedo_2026_initial", "ceramic/mine"))
    command = ["simulate", str(disc), "-o", str(tmp_path / "out"), "--full", "--points", "5", "--no-cad",
               "--materials", str(tmp_path / "own")]
    monkeypatch.setattr(states, "simulate_state", Stop(2))
    assert main([*command, *SMALL]) == 130
    if change == "chip":
        disc.write_text(disc.read_text().replace('radius = "3 mm"', 'radius = "3.001 mm"'))
    if change == "material":
        entry.write_text(entry.read_text().replace("value = 115.41", "value = 115.42"))
    again = Stop(10**6)
    monkeypatch.setattr(states, "simulate_state", again)
    assert main([*command, "--accuracy", "0.2 %" if change == "mesh" else "0.5 %"]) == 0
    assert again.solved == 5


def recorded(path: Path, chip: Path, *, scale: complex = 1.0) -> Spectrum:
    """A recording made of the simulation itself: every 750 Hz, times `scale`."""
    run = simulate_state(read_chip(chip), points=201, accuracy=5e-3)
    spectrum = Spectrum(run.spectrum.frequency, scale * run.spectrum.impedance)
    write_spectrum(spectrum, path)
    return spectrum


def test_compare_finds_what_was_put_in(disc: Path, tmp_path: Path) -> None:
    recorded(tmp_path / "disc.csv", disc, scale=1.0 / 1.1)
    out = tmp_path / "out"
    assert main(["compare", str(tmp_path / "disc.csv"), str(disc), "-o", str(out), *SMALL]) == 0
    record = standard_json(out / "merit.json")
    # The simulation is ten per cent too high everywhere; the spline between points adds 1e-4 at most.
    assert record["comparison"]["mape_percent"] == pytest.approx(10.0, abs=0.01)
    assert record["comparison"]["rms_log_residual"] == pytest.approx(math.log(1.1), abs=1e-4)
    assert record["comparison"]["phase_max_deg"] < 0.01
    assert record["comparison"]["fraction_used"] == 1.0
    assert record["comparison"]["figures"]["Z_min (ohm)"]["difference_percent"] == pytest.approx(10.0, abs=0.05)
    assert record["findings"] == []
    assert set(visible(out)) == {"spectrum.csv", "merit.json", "report.html", "impedance.png",
                                                     "residual.png"}
    text = check_report(out / "report.html")
    assert "Nothing was fitted" in text
    assert f"workbench diagnose {tmp_path / 'disc.csv'} --chip {disc} --state " in text


def test_compare_without_assumed_losses(tmp_path: Path) -> None:
    campaign = SHIPPED / "small_campaign"
    command = ["compare", str(campaign / "empty.csv"), str(campaign / "chip.toml"), "--state", "empty", *SMALL, "-o"]
    assert main([*command, str(tmp_path / "assumed")]) == 0
    assert main([*command, str(tmp_path / "without"), "--no-assumed-losses"]) == 0
    assumed, without = (standard_json(tmp_path / name / "merit.json") for name in ("assumed", "without"))
    assert assumed["comparison"]["mape_percent"] > 20.0 > 1.0 > without["comparison"]["mape_percent"]
    assert any("Likely cause: the assumed loss of pic255" in text for text in assumed["findings"])
    assert not any("Likely cause" in text for text in without["findings"])


def test_compare_uses_the_common_band(disc: Path, tmp_path: Path) -> None:
    spectrum = recorded(tmp_path / "disc.csv", disc)
    out = tmp_path / "out"
    band = ["--from", "320 kHz", "--to", "400 kHz"]
    assert main(["compare", str(tmp_path / "disc.csv"), str(disc), "-o", str(out), *band, *SMALL]) == 0
    inside = (spectrum.frequency >= 320e3) & (spectrum.frequency <= 400e3)
    fraction = standard_json(out / "merit.json")["comparison"]["fraction_used"]
    assert fraction == pytest.approx(inside.sum() / 201)


def test_compare_reports_findings_and_corrects_on_request(
    disc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded(tmp_path / "disc.csv", disc, scale=-1.0)
    command = ["compare", str(tmp_path / "disc.csv"), str(disc), "-o", str(tmp_path / "out"), *SMALL]
    assert main(command) == 0
    assert "finding: Re Z < 0 at 201 of 201 points" in " ".join(capsys.readouterr().err.split())
    assert len(standard_json(tmp_path / "out" / "merit.json")["findings"]) == 1
    assert main([*command, "--correction", "negate"]) == 0
    record = standard_json(tmp_path / "out" / "merit.json")
    assert record["findings"] == []
    assert record["comparison"]["mape_percent"] < 0.01


@pytest.mark.parametrize("with_map", [False, True])
def test_compare_says_what_it_took_the_columns_for(
    with_map: bool, disc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spectrum = recorded(tmp_path / "disc.csv", disc)
    headings = "u;v;w" if with_map else "Frequency [kHz];Rs [Ohm];Xs [Ohm]"
    rows = "\n".join(f"{f / 1e3!r};{z.real!r};{z.imag!r}" for f, z in zip(
        spectrum.frequency.tolist(), spectrum.impedance.tolist(), strict=True))
    (tmp_path / "table.csv").write_text(f"{headings}\n{rows}\n")
    (tmp_path / "MAP.toml").write_text(
        'frequency = "u"\nfirst = "v"\nsecond = "w"\nfrequency_unit = "kHz"\ndelimiter = ";"\n'
        'quantity = { kind = "impedance", form = "rectangular", unit = "ohm" }\n')
    out = tmp_path / "out"
    assert main(["compare", str(tmp_path / "table.csv"), str(disc), "-o", str(out), *SMALL,
                 *(["--columns", str(tmp_path / "MAP.toml")] if with_map else [])]) == 0
    record = standard_json(out / "merit.json")
    assert record["comparison"]["mape_percent"] < 0.01
    first, _, third = headings.split(";")
    words = f'"{first}" is the frequency in kHz'
    assert record["read_as"].startswith(f"{'by a column map' if with_map else 'by its headings'}, {words}; ")
    assert f"table.csv: read {record['read_as']}" in capsys.readouterr().err
    text = check_report(out / "report.html")
    assert words in html.unescape(text)
    assert f'"{third}" is the imaginary part of Z in ohm' in html.unescape(text)


def test_mesh_lists_regions_and_converges(
    disc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["mesh", str(disc), *SMALL]) == 0
    assert "transducer" in capsys.readouterr().out
    out = tmp_path / "out"
    study = ["mesh", str(disc), "--converge", *SMALL, "-o", str(out)]
    assert main(study) == 0
    record = standard_json(out / "convergence.json")
    columns = {name: [row[k] for row in record["rows"]] for k, name in enumerate(record["columns"])}
    assert columns["accuracy"] == [*sorted(ROWS, reverse=True), None]
    assert columns["unknowns"][-1] == max(columns["unknowns"])
    assert min(columns["estimated_rms_error"]) > 0.0
    assert columns["rms_error"][-1] == 0.0
    said = capsys.readouterr().out
    assert "accurate: " in said
    assert max(map(len, said.splitlines())) <= 80
    check_report(out / "report.html")
    # A mesh that is not as accurate as asked: the study says so by its status.
    monkeypatch.setattr(mesh, "discretisation", lambda accuracy: quadratic(3.0))
    assert main(study) == 1
    assert "NOT accurate" in capsys.readouterr().out


def test_export_writes_parts_of_the_chips_own_volume(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cadquery")
    import pyvista

    assert main(["export", str(cell), "-o", str(tmp_path / "cad")]) == 0
    listed = [Path(line) for line in capsys.readouterr().out.splitlines() if line.endswith((".stl", ".step"))]
    assert all(path.is_file() for path in listed)
    found = volumes(read_chip(cell))
    for part in ("transducer", "cavity", "superstrate"):
        # Facets inside a circle of n sides lose (2/3)(pi/n)^2 of its area, 0.6 % at 32 sides.
        measured = pyvista.read(tmp_path / "cad" / f"{part}.stl").volume * 1e-9
        assert measured == pytest.approx(found[part], rel=0.01)


def test_render_draws_the_fields_asked_for(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["render", str(cell), "-o", str(out), "--at", "359 kHz", "--drive", "0.1 W", *SMALL]
    assert main([*command, "--field", "gorkov", "--field", "losses"]) == 0
    assert set(visible(out)) == {"gorkov_filled.png", "profiles_filled.png", "losses_filled.png"}
    said = capsys.readouterr().out
    assert "polystyrene" in said
    assert "0.1 W of electrical input power" in said
    assert main([*command, "--state", "empty", "--field", "pressure"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "state empty: field: received 'pressure'; expected another field, since no fluid is thick enough" in said


def test_materials_are_listed_shown_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["materials", "list"]) == 0
    listed = capsys.readouterr().out
    assert "water/iapws_2011" in listed
    assert re.search(r"name +┃ kind +┃ density( \(kg/m\^3\))? +┃ remarks +┃", listed)
    assert re.search(r"pzt5h/erturk_2011 +│ Piezoelectric +│ 7500 +│ lossless", listed)
    assert re.search(r"pzt5h/morgan_tp226 +│ Piezoelectric +│ 7500 +│ +│", listed)
    assert main(["materials", "show", "water", "--temperature", "25 degC"]) == 0
    shown = capsys.readouterr().out
    assert "997" in shown
    assert "298.15" in shown
    assert main(["materials", "show", "silicon"]) == 0
    shown = capsys.readouterr().out
    assert "title                  Silicon, isotropic (Hill) average of the cubic crystal" in shown
    assert "An axisymmetric model cannot hold a cubic crystal" in shown
    assert "+- 1.58e+09" in shown
    assert main(["materials", "check"]) == 0
    checked = capsys.readouterr().out
    assert "water/iapws_2011: ok" in checked
    assert "pzt4/acevedo_2026_fitted: ok" in checked
    assert "used as printed. Its losses are rounded" in checked
    folder = tmp_path / "own" / "jelly"
    folder.mkdir(parents=True)
    (folder / "mine.toml").write_text('kind = "gelatine"\n')
    assert main(["materials", "check", "--materials", str(tmp_path / "own")]) == 1
    assert "jelly/mine" in capsys.readouterr().out


def saved_fit(c33: float) -> Material:
    """The ceramic of the disc above, as a fit would have left it."""
    fit = Fit(recordings=(RecordingSource("disc.csv", "0" * 64, "disc.toml"),), algorithm="joint", software="x 1",
              date="2026-11-21", band=(300e3, 450e3), mape_percent=0.41, rms_log_residual=0.005, confidence=0.95,
              free=("c33",))
    estimate = Value(c33 - 1.2e8j, "", "", uncertainty=3e8, low=c33 - 6e8, high=c33 + 6e8, status="fitted")
    return fitted(Registry().load("pzt4/acevedo_2026_initial"), {"c33": estimate}, fit=fit)


def test_saved_fits_are_kept_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def said(*command: str, status: int = 0) -> str:
        assert main(["materials", *command]) == status
        out, err = capsys.readouterr()
        return " ".join((out + err).split())

    for c33 in (115e9, 118e9):
        save_fit(saved_fit(c33), "pzt4/disc_7", folder=user_folder())
    listed = said("list")
    assert "pzt4/disc_7@2 │ Piezoelectric │ 7500 │ fitted, 0.3 to 0.45 MHz" in listed
    shown = said("show", "pzt4/disc_7")
    assert "pzt4/disc_7@2" in shown
    assert "+- 3e+08; 1.174e+11 to 1.186e+11; fitted" in shown
    assert f"disc.csv, SHA-256 {'0' * 64}" in shown
    compared = said("diff", "pzt4/disc_7@1", "pzt4/disc_7")
    # 3 GPa of 115, against sqrt(2) x 0.3 GPa.
    assert "c33 │ 1.15e+11 │ 1.18e+11 │ +2.609 │ +7.07" in compared
    assert "withdrawn" in said("withdraw", "pzt4/disc_7@2", "--reason", "glued on")
    versions = said("history", "pzt4/disc_7")
    assert re.search(r"disc_7@2 │ 2026-11-21 │ 0.41 │ joint │ withdrawn on 20\S+: glued on", versions)
    assert "pzt4/disc_7@2 │ Piezoelectric │ 7500 │ fitted, 0.3 to 0.45 MHz; withdrawn" in said("list")
    assert "pzt4/disc_7@1:" in said("show", "pzt4/disc_7")
    assert "warning: pzt4/disc_7@2 was withdrawn" in said("show", "pzt4/disc_7@2")
    assert "pzt4/disc_7@2: ok pzt4/disc_7@2 was withdrawn" in said("check", "pzt4/disc_7@2")
    exported = tmp_path / "new" / "discs.json"
    assert "pzt4/disc_7@1" in said("export", "pzt4/disc_7@1", "pzt4/disc_7@2", "-o", str(exported))
    # Into another folder, which need not exist; the user's own has them already.
    other = ["--materials", str(tmp_path / "other")]
    assert "pzt4/disc_7@1: imported pzt4/disc_7@2: imported" in said("import", str(exported), *other)
    assert "pzt4/disc_7@1: was there already" in said("import", str(exported))
    assert len(list((tmp_path / "other" / "pzt4").iterdir())) == 3
    spoiled = user_folder() / "pzt4" / "disc_7@1.toml"
    spoiled.write_text(spoiled.read_text().replace("mape_percent = 0.41", "mape_percent = -1"))
    (line,) = [k for k, row in enumerate(spoiled.read_text().splitlines(), start=1) if row.startswith("mape")]
    assert "pzt4/disc_7@1 │ faulty" in said("list")
    assert f"disc_7@1.toml, line {line}: fit.mape_percent" in said("history", "pzt4/disc_7")
    assert f"disc_7@1.toml, line {line}: fit.mape_percent" in said("check", status=1)


def test_a_chip_may_be_made_of_a_saved_fit(disc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Everything that reads a chip finds the user's own folder, without being told.
    disc.write_text(DISC.replace("pzt4/acevedo_2026_initial", "pzt4/disc_7"))
    assert main(["mesh", str(disc), *SMALL]) == 2
    assert "'pzt4/disc_7'" in capsys.readouterr().err
    save_fit(saved_fit(115e9), "pzt4/disc_7", folder=user_folder())
    assert main(["mesh", str(disc), *SMALL]) == 0
    save_fit(saved_fit(115e9), "pzt4/disc_8", folder=tmp_path / "other")
    disc.write_text(DISC.replace("pzt4/acevedo_2026_initial", "pzt4/disc_8"))
    assert main(["mesh", str(disc), "--materials", str(tmp_path / "other"), *SMALL]) == 0
