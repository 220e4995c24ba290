"""The public names: what there is, what importing it costs, and what results offer."""

from __future__ import annotations

import inspect
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.results.spectrum import Origin

ROOT = Path(__file__).resolve().parent.parent
SPECTRUM = wb.Spectrum(np.linspace(1e6, 1.1e6, 11), np.linspace(10.0, 20.0, 11) - 5.0j, np.full(11, 0.1),
                       Origin("measured", "disc.csv"))


@pytest.mark.parametrize("name", wb.__all__)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    found = getattr(wb, name)
    assert found.__name__ == name
    assert inspect.getdoc(found)
    assert name in dir(wb)


def test_what_type_checkers_see_is_what_there_is() -> None:
    text = (ROOT / "workbench/__init__.py").read_text(encoding="utf-8")
    imports = [line for line in text.splitlines() if line.strip().startswith("from ") and " as " in line]
    assert {line.split()[-1] for line in imports} == set(wb.PUBLIC)
    for name, module in wb.PUBLIC.items():
        assert f"from {module} import {name} as {name}" in text


def test_an_unknown_name_is_answered_with_those_there_are() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'simulte'; public are .*simulate"):
        wb.simulte  # noqa: B018


def test_importing_loads_next_to_nothing() -> None:
    code = "import sys; before = set(sys.modules); import workbench; print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "skfem", "gmsh", "vtk", "pyvista", "cadquery", "OCP", "matplotlib", "xarray"}


def test_a_spectrum_becomes_a_data_set_that_can_be_written(tmp_path: Path) -> None:
    found = SPECTRUM.to_xarray()
    assert found.resistance.values == pytest.approx(SPECTRUM.impedance.real)
    assert found.reactance.attrs == {"units": "ohm"}
    assert found.frequency.attrs == {"units": "Hz"}
    assert found.uncertainty.values == pytest.approx(0.1)
    assert found.attrs["source"] == "disc.csv"


def test_a_comparison_becomes_a_data_set() -> None:
    other = wb.Spectrum(SPECTRUM.frequency, SPECTRUM.impedance * np.exp(0.01 + 0.02j))
    found = wb.compare(SPECTRUM, other).to_xarray()
    assert found.log_magnitude_ratio.values == pytest.approx(0.01)
    assert found.phase_difference.values == pytest.approx(0.02)
    assert found.simulated_resistance.values == pytest.approx(other.impedance.real)
    assert found.attrs["rms_log_residual"] == pytest.approx(np.hypot(0.01, 0.02))


def test_files_may_be_named_by_text(tmp_path: Path) -> None:
    assert wb.draw_spectra({"measured": SPECTRUM}, str(tmp_path / "disc.png")) == tmp_path / "disc.png"
    for reader in (wb.read_chip, wb.read_recording, wb.read_campaign, wb.read_bench):
        with pytest.raises(wb.InputError, match=r"nothing\.toml"):
            reader(str(tmp_path / "nothing.toml"))


def test_folders_and_files_to_write_may_be_named_by_text(tmp_path: Path) -> None:
    chip = wb.read_chip(str(ROOT / "geometry/chips/disc_20x2.toml"))
    assert wb.write_chip(chip, str(tmp_path / "w.toml")) == tmp_path / "w.toml"
    folder = tmp_path / "mats"
    (folder / "tap_water").mkdir(parents=True)
    text = (ROOT / "materials/data/water/iapws_2011.toml").read_text(encoding="utf-8")
    (folder / "tap_water" / "own_2024.toml").write_text(text.replace("default = true", ""), encoding="utf-8")
    for folders in (str(folder), folder, (str(folder),), [folder]):
        registry = wb.Registry(folders)
        assert registry.folders == (folder,)
        assert "tap_water/own_2024" in registry.names()
    study = wb.read_study(str(ROOT / "examples/small_study/study.toml"), materials=[str(folder)])
    assert folder in study.registry.folders
    with wb.SimulatedBench(lambda frequency: 50.0 + 0.0j, folder=str(tmp_path / "ports")) as bench:
        assert bench is not None


def test_what_a_prompt_lists_is_what_is_public() -> None:
    assert wb.__version__ == tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert {name for name in dir(wb) if not name.startswith("__")} == {*wb.PUBLIC, "PUBLIC"}


def test_a_notebook_shows_a_table_and_a_figure() -> None:
    other = wb.Spectrum(SPECTRUM.frequency, 1.01 * SPECTRUM.impedance)
    for shown, words in ((SPECTRUM, "1 to 1.1 MHz"), (wb.compare(SPECTRUM, other), "MAPE of |Z|")):
        text = shown._repr_html_()
        assert words in text
        assert "<table>" in text
        assert "src='data:image/png;base64,iVBOR" in text
