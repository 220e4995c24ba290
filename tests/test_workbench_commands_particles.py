"""``workbench particles`` and `wb.trajectories` end to end on a small device, and particles that cannot be."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import CELL, check_report, standard_json, visible

import workbench as wb
from workbench.acoustics.trajectories import Fate
from workbench.cli import main
from workbench.files.errors import InputError
from workbench.model.problem import fill
from workbench.render import beads
from workbench.simulation.beads import carrier_of, trajectories, with_particle

pytestmark = pytest.mark.usefixtures("tables_fit")


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "400")


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return path


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> wb.Snapshot:
    path = tmp_path_factory.mktemp("chip") / "cell.toml"
    path.write_text(CELL)
    return wb.snapshot(wb.read_chip(path), "filled", 1e6, accuracy=5e-3)


def test_the_command_writes_trajectories_pictures_and_a_report(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beads, "animate_beads", partial(beads.animate_beads, frames=3))
    out = tmp_path / "out"
    command = ["particles", str(cell), "--at", "1 MHz", "--drive", "10 Vpp", "--minutes", "2", "--count", "30",
               "--accuracy", "0.5 %", "-o", str(out)]
    assert main(command) == 0
    assert set(visible(out)) == {
        "above_start.png", "above_end.png", "overlay_end.png", "side.png", "light_curve.png", "light_curve.csv",
        "particles.gif", "particles.json", "trajectories.npz", "report.html", "streaming.png"}
    with np.load(out / "trajectories.npz") as kept:
        assert kept["positions_m"].shape == (30, kept["times_s"].size, 2)
        assert kept["times_s"][-1] == 120.0
        words = [str(kept["fate_words"][each]) for each in kept["fate"]]
    record = standard_json(out / "particles.json")
    assert set(record["liquid"]["causes_rms_m_s"]) == {"walls", "absorption", "heat", "buoyancy"}
    assert 0.0 < record["liquid"]["mean_k"]["cavity"] < record["liquid"]["peak_k"]
    assert sum(record["fate"].values()) == 30
    assert record["fate"][Fate.SEDIMENTED.words] == words.count(Fate.SEDIMENTED.words)
    assert record["captures"][0]["name"] == "came to levitate"
    header, *rows = (out / "light_curve.csv").read_text().splitlines()
    assert header.startswith("time_s,in_window,")
    assert len(rows) == 181
    text = check_report(out / "report.html")
    assert "Where are the particles?" in text
    assert "particles.gif, the animation" in text
    assert "Left out: forces between particles" in text
    shown = capsys.readouterr().out
    assert "After 2 min at 1.0000 MHz and 10 Vpp, of 30 evenly spread polystyrene spheres of 10 um" in shown
    assert "came to levitate" in shown


def test_without_a_frequency_the_field_is_that_of_f0_and_pictures_can_be_left_out(cell: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["particles", str(cell), "--drive", "0.01 W", "--minutes", "0.1", "--count", "5", "--no-pictures",
                 "--particle", "mcf7_cell", "--particle-radius", "8 um", "--accuracy", "2 %", "-o", str(out)]) == 0
    record = standard_json(out / "particles.json")
    assert 0.9e6 <= record["frequency_hz"] <= 1.1e6
    assert (record["particle"], record["radius_m"]) == ("mcf7_cell/hartono_2011", pytest.approx(8e-6))
    assert not list(out.glob("*.png"))


@pytest.mark.parametrize(("options", "words"), [
    ([], "--drive: missing; expected the drive, such as"),
    (["--drive", "10 V"], "--drive: received '10 V'; expected"),
    (["--drive", "10 Vpp", "--minutes", "0"], "--minutes: received 0.0; expected a time above zero"),
    (["--drive", "10 Vpp", "--minutes", "nan"], "--minutes: received nan"),
    (["--drive", "10 Vpp", "--count", "0"], "--count: received 0; expected at least one particle"),
    (["--drive", "10 Vpp", "--seed", "-1"], "--seed: received -1; expected a whole number of 0 or more"),
    (["--drive", "10 Vpp", "--holder", "substrate|outside", "--flow", "none", "--cold"],
     "--holder: received 'substrate|outside'; expected no holder beside --cold and --flow none"),
    (["--drive", "10 Vpp", "--convection", "5 W/(m^2 K)", "--flow", "sound", "--cold"],
     "--convection: received '5 W/(m^2 K)'; expected no convection beside --cold and --flow sound"),
    (["--drive", "10 Vpp", "--holder", "cavity|substrate"], "--holder: received 'cavity|substrate'; expected one of"),
    (["--drive", "10 Vpp", "--window", "0 mm"], "--window: received '0 mm'; expected a length above zero"),
    (["--drive", "10 Vpp", "--window", "5"], "--window: received '5'; expected a length in one of"),
    (["--drive", "10 Vpp", "--particle", "polystyren"], "did you mean 'polystyrene'"),
    (["--drive", "10 Vpp", "--particle", "pzt4"], "expected an isotropic solid (a bead), a fluid"),
    (["--drive", "10 Vpp", "--particle-radius", "0.4 mm"], "expected above zero and below 0.36 mm, or it does not fit"),
    (["--drive", "10 Vpp", "--particle-radius", "0.3 mm"], "Gor'kov's formula holds for spheres much smaller"),
    (["--drive", "10 Vpp", "--convection", "10"], "--convection: received '10'; expected"),
    (["--drive", "10 Vpp", "--convection", "0 W/(m^2 K)"], "expected a heat transfer coefficient above zero"),
    (["--drive", "10 Vpp", "--holder", "substrate|outsid"], "did you mean 'substrate|outside'"),
    (["--drive", "10 Vpp", "--state", "fille"], "state: received 'fille'; expected one of filled"),
])
def test_mistakes_are_told_before_anything_is_solved(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    options: list[str], words: str,
) -> None:
    def solved(*_: Any, **__: Any) -> None:
        raise AssertionError("solved")

    monkeypatch.setattr("workbench.simulation.run.solution_near", solved)
    assert main(["particles", str(cell), "--at", "1 MHz", *options, "-o", str(tmp_path / "out")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_a_drive_that_boils_the_liquid_is_refused_with_the_one_that_does_not(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["particles", str(cell), "--at", "1 MHz", "--accuracy", "2 %", "--drive", "60 Vpp", "-o",
               str(tmp_path / "out")]
    assert main(command) == 2
    words = " ".join(capsys.readouterr().err.split())
    assert "60 Vpp at the electrodes'; expected at most" in words
    assert "--flow sound" in words


def with_lines(text: str, *lines: str) -> str:
    kept = [line for line in text.splitlines() if not line.startswith("particle")]
    return "\n".join([*kept, *lines]) + "\n"


@pytest.mark.parametrize(("lines", "words"), [
    (('particle = "polystyrene"',), "particle_radius"),
    (('particle_radius = "5 um"',), "both 'particle' and 'particle_radius', or neither"),
    (('particle = "polystyrene"', 'particle_radius = "0.4 mm"'), "or it does not fit the cavity"),
])
def test_a_chip_file_with_a_particle_that_cannot_be_is_not_read(
    tmp_path: Path, lines: tuple[str, ...], words: str
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(with_lines(CELL, *lines))
    with pytest.raises(InputError, match=words):
        wb.read_chip(path)


def test_a_particle_of_no_known_material_or_in_no_fluid_is_refused_without_a_mesh(cell: Path) -> None:
    chip = wb.read_chip(cell)
    with pytest.raises(InputError, match="did you mean 'silica_beads'"):
        fill(with_particle(chip, None, particle="silica_bead", radius=None))
    state = replace(chip.state(), cavity="pmma", temperature=None)
    with pytest.raises(InputError, match="no particle without a fluid to carry it; the cavity contains an isotropic"):
        fill(replace(chip, states=(state,)))
    bare = replace(chip, states=(replace(chip.state(), particle=None, particle_radius=None),))
    with pytest.raises(InputError, match="expected a particle to follow"):
        carrier_of(bare, None)


def test_a_cell_of_ones_own_is_given_by_density_and_compressibility(cell: Path, tmp_path: Path) -> None:
    folder = tmp_path / "own"
    (folder / "my_cell").mkdir(parents=True)
    (folder / "references.bib").write_text("@misc{bench_2024,\n  title = {Notebook}\n}\n")
    (folder / "my_cell" / "bench_2024.toml").write_text("""
kind = "fluid"
title = "A cell"
source = "bench_2024"
conditions = "room temperature"

density = { value = 1068, unit = "kg/m^3" }
compressibility = { value = 422, unit = "1/TPa" }
""")
    chip = with_particle(wb.read_chip(cell), "filled", particle="my_cell", radius=8e-6)
    device = carrier_of(chip, "filled", wb.Registry((folder,)))
    assert device.particle is not None
    assert device.particle.compressibility == pytest.approx(422e-12, rel=1e-12)
    assert device.particle.density == 1068.0


def test_trajectories_of_a_simulated_state(shot: wb.Snapshot) -> None:
    found = wb.trajectories(shot, 60.0, particles=20, seed=3)
    assert isinstance(found, wb.Trajectories)
    assert found.positions.shape == (20, 181, 2)
    assert shot.traps is not None
    # A flow may be at the nodes of the fields or of the forces.
    mesh, fields = shot.traps.forces.mesh, shot.fields.mesh
    cavity = np.full((len(fields.points), 2), np.nan)
    cavity[fields.nodes_of(["cavity"])] = [0.0, 2e-6]
    both = [trajectories(shot, 60.0, particles=20, seed=3, flow=flow) for flow in (
        cavity, np.broadcast_to([0.0, 2e-6], (len(mesh.points), 2)))]
    np.testing.assert_allclose(both[0].positions, both[1].positions, atol=1e-12)
    assert np.abs(both[0].positions - found.positions).max() > 1e-7
    assert set(both[0].fate) <= set(map(int, Fate))


def test_without_f0_the_middle_of_the_band_is_said(cell: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    # A band between two resonances.
    assert main(["particles", str(cell), "--drive", "1 Vpp", "--minutes", "0.1", "--count", "5", "--no-pictures",
                 "--flow", "none", "--from", "700 kHz", "--to", "702 kHz", "--accuracy", "5 %", "-o", str(out)]) == 0
    record = standard_json(out / "particles.json")
    assert record["frequency_hz"] == pytest.approx(701e3)
    assert "the field is that of 0.701 MHz, the middle of the band, because there is no f0" in record["findings"][0]


def test_another_voltage_labels_its_results(shot: wb.Snapshot) -> None:
    found = wb.trajectories(shot, 1.0, particles=2, voltage_factor=0.5)
    assert shot.traps is not None
    once, half = shot.traps.excitation, found.forces.excitation
    assert half.description == "5 Vpp at the electrodes"
    assert (half.voltage, half.energy_density) == pytest.approx((0.5 * once.voltage, 0.25 * once.energy_density))
    assert "5 Vpp at the electrodes" in str(found)
    with pytest.raises(InputError, match=r"voltage_factor: received 300\.0; expected at most 200, .* 2000"):
        wb.trajectories(shot, 1.0, voltage_factor=300.0)


def test_the_result_in_place_of_its_array_and_texts_in_place_of_numbers_are_refused(shot: wb.Snapshot) -> None:
    flow: Any = wb.streaming(shot)
    with pytest.raises(InputError, match=r"flow: received 'Streaming'; expected .*flow\.carried_on\(shot"):
        trajectories(shot, 10.0, flow=flow)
    motion: Any = wb.liquid_motion(shot, by="none")
    with pytest.raises(InputError, match=r"flow: received 'LiquidMotion'; expected .*flow\.velocity"):
        trajectories(shot, 10.0, flow=motion)
    text: Any = "30 s"
    with pytest.raises(InputError, match=r"duration: received '30 s'; expected a positive time in s, such as 30\.0"):
        trajectories(shot, text)
    with pytest.raises(InputError, match=r"seed: received -1; expected a whole number of 0 or more"):
        trajectories(shot, 10.0, seed=-1)
    text = "1 mm"
    with pytest.raises(InputError, match=r"Window: outer: received '1 mm'; expected a length in m, such as 1e-3"):
        wb.Window(outer=text)


def test_what_no_trajectories_can_be_made_of_is_refused(shot: wb.Snapshot) -> None:
    with pytest.raises(InputError, match="expected a state with a particle in a liquid"):
        trajectories(replace(shot, traps=None), 60.0)
    for duration in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match=r"duration: received .*; expected a positive time in s"):
            trajectories(shot, duration)
    with pytest.raises(InputError, match="times that end at 60 s"):
        trajectories(shot, 60.0, times=np.array([0.0, 30.0]))
    with pytest.raises(InputError, match=r"flow: received 'an array of shape \(3, 2\)'"):
        trajectories(shot, 60.0, flow=np.zeros((3, 2)))
    with pytest.raises(InputError, match="expected a velocity at every node of the cavity"):
        trajectories(shot, 60.0, flow=np.full((len(shot.fields.mesh.points), 2), np.nan))
