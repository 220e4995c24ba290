"""Tolerances of a real (small) disc: its samples and sensitivities against full solves, the command, its mistakes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from support import DISC, chip_from, standard_json

from geometry.chip import Chip
from workbench.cli import main
from workbench.design.evaluation import Evaluation
from workbench.design.input_uncertainty import numbers_of
from workbench.design.model import full_evaluation
from workbench.design.tolerance import Tolerance, tolerance
from workbench.design.yields import Tightening
from workbench.files.errors import InputError
from workbench.model.problem import fill
from workbench.report.tolerance import tightening_table, unclear_tightenings

PZT = "pzt4/acevedo_2026_initial"
#: A coarse mesh, the same on both sides of every comparison.
ACCURACY = 5e-3
REQUIRED = ("f0 within 3 kHz", "q >= 390", "power <= 0.5 W at 10 Vpp", "voltage >= 2 Vpp at 20 mW")
UNCERTAIN = ("pzt4.c33 = 1 %", f"{PZT}.c33.loss = 20 %")


def disc() -> Chip:
    return chip_from(DISC, "disc.toml")


def solved(values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
    return full_evaluation(disc(), None, values, figures=("f0", "z_min", "q", "power"), accuracy=ACCURACY,
                           gradient=gradient)


@pytest.fixture(scope="module")
def found() -> Tolerance:
    return tolerance(disc(), None, REQUIRED, uncertainty=UNCERTAIN, samples=150, sobol_points=8, seed=1,
                     accuracy=ACCURACY)


def test_samples_are_what_full_solves_say(found: Tolerance) -> None:
    assert found.outcomes is not None
    for index in range(0, 150, 30):
        full = solved(found.uncertainty.values(found.outcomes.points[index]))
        for name in ("f0", "z_min", "q", "power"):
            # The tolerance of the model is 1e-3 of Z; its full solves have confirmed it.
            value = found.outcomes.column(name)[index]
            assert value == pytest.approx(full.figures[name], rel=2e-3), name
        # f0 is better known than |Z|, by about Q.
        assert found.outcomes.column("f0")[index] == pytest.approx(full.figures["f0"], rel=1e-5)


def test_sensitivities_are_differences_of_full_solves() -> None:
    names = ("transducer.thickness", "transducer.radius", f"{PZT}.c33", f"{PZT}.c33.loss", f"{PZT}.e33")
    known = numbers_of(fill(disc()))
    values = {name: known[name] for name in names} | {f"{PZT}.c33.loss": -1e8}
    exact = solved(values, gradient=True)
    assert exact.gradient is not None
    for index, name in enumerate(names):
        # Fourth order: a step of 2e-3 leaves 3e-5 at most (observed), of which half is what solves repeat Q to, 1e-7;
        # cells stay the same in number, so that every mesh is the first one stretched.
        step = 2e-3 * abs(values[name])
        moved = {k: solved({**values, name: values[name] + k * step}) for k in (-2, -1, 1, 2)}
        for figure, slopes in exact.gradient.items():
            found = sum(w * moved[k].figures[figure] for k, w in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12.0 * step)
            # Relative to the figure's own scale, as the acceptance of these derivatives has it.
            scale = max(abs(found), abs(exact.figures[figure] / values[name]))
            assert slopes[index] == pytest.approx(found, abs=1e-4 * scale), (name, figure)


def test_yields_tell_what_their_samples_do(found: Tolerance) -> None:
    assert found.yields is not None
    assert found.outcomes is not None
    f0 = found.outcomes.column("f0")
    nominal = found.sensitivities.figures["f0"]
    assert found.yields.each[0].sampled.passed == int((np.abs(f0 - nominal) <= 3e3).sum())
    # A requirement at another drive is about a figure of its own.
    labels = [each.bound.label for each in found.yields.each if each.bound is not None]
    assert labels == ["f0", "q", "power", "voltage at 0.02 W of electrical input power"]
    assert found.yields.together.sampled.passed <= min(each.sampled.passed for each in found.yields.each)
    assert {each.name for each in found.yields.tightenings} == set(found.uncertainty.names)
    assert "uncertainty" in found.findings[-1]


def test_what_moves_f0_most_causes_most_of_its_variance(found: Tolerance) -> None:
    assert found.sobol is not None
    most = found.sensitivities.names[found.sensitivities.ranked("f0")[0]]
    assert most == found.sobol.names[int(np.argmax(found.sobol.total[0]))] == f"{PZT}.c33"


def test_a_drive_that_stays_is_at_f0_of_the_chip_as_stated() -> None:
    fixed = tolerance(disc(), None, ["power <= 1 W"], uncertainty=["pzt4.c33 = 1 %"], samples=60, tracking=False,
                      accuracy=ACCURACY)
    assert fixed.frequency == pytest.approx(fixed.sensitivities.figures["f0"], rel=1e-9)
    assert fixed.outcomes is not None
    assert not any("as stated does not meet" in text for text in fixed.findings)
    # Whoever stays beside the resonance takes up less power than whoever follows it.
    assert np.median(fixed.outcomes.column("power")) < 0.5 * fixed.sensitivities.figures["power"]


def test_nothing_but_sensitivities_needs_no_requirement() -> None:
    plain = chip_from(DISC.replace(', tolerance = "10 um"', ""), "disc.toml")
    found = tolerance(plain, accuracy=ACCURACY)
    assert found.yields is None
    assert found.outcomes is None
    assert set(found.sensitivities.names) == set(numbers_of(fill(plain)))
    assert not any(found.sensitivities.stated)


def test_a_result_is_told_in_a_notebook(found: Tolerance) -> None:
    page = found._repr_html_()
    assert "tighten first" in page
    assert "f0 within 3 kHz" in page


@pytest.mark.parametrize(("requirements", "options", "words"), [
    (["trap_offset within 50 um"], {}, "a chip that as stated has the figure trap_offset"),
    (["heating <= 5 K"], {}, "no thermal resistance is stated"),
    (["f0 within 3 kHz"], {"uncertainty": ["transducer.thickness = exact"]}, "something uncertain"),
    (["f0 within 3 kHz"], {"samples": 0}, "one sample at least"),
    (["f0 within 3 kHz"], {"sobol_points": 100}, "a power of two"),
    (["f0 within 3 furlong"], {}, "a frequency in one of"),
    ([], {"figures": ["f1"]}, "did you mean 'f0'"),
])
def test_a_mistake_is_told_before_much_is_solved(requirements: list[str], options: dict[str, object], words: str
                                                 ) -> None:
    with pytest.raises(InputError) as told:
        tolerance(disc(), None, requirements, accuracy=ACCURACY, **options)  # type: ignore[arg-type]
    assert words in str(told.value)


# --------------------------------------------------------------------------------------------------------------------
# The command.


@pytest.fixture
def chip_file(tmp_path: Path) -> Path:
    path = tmp_path / "disc.toml"
    path.write_text(DISC, encoding="utf-8")
    return path


def test_the_command_leaves_numbers_samples_and_a_report(
    chip_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["tolerance", str(chip_file), "--accuracy", "0.5 %", "--samples", "80", "--sobol", "4", "-o", str(out),
             "--uncertainty", "pzt4.c33 = 1 %", "--figure", "heating", "--thermal-resistance", "10 K/W"]
    for text in ("f0 within 3 kHz", "heating <= 5 K"):
        words += ["--require", text]
    assert main(words) == 0
    record = standard_json(out / "tolerance.json")
    together = record["yield"]["together"]
    assert together["low"] <= together["yield"] <= together["high"]
    assert record["uncertainty"]["inputs"][0]["law"] == "uniform"
    table = parquet.read_table(out / "tolerance.parquet")
    assert table.num_rows == together["samples"] == 80
    assert table.schema.field("transducer.thickness").metadata == {b"unit": b"m"}
    met = np.array(table["met: f0 within 3 kHz"]) & np.array(table["met: heating <= 5 K"])
    assert met.sum() == together["passed"]
    said = capsys.readouterr().out
    assert {"yield", "sensitivities", "uncertainties to halve"} <= set(said.splitlines())
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == 3
    assert "Uncertainties to halve" in page


@pytest.mark.parametrize(("options", "words"), [
    (["--require", "f0 within 5"], "a frequency in one of Hz, kHz, MHz"),
    (["--uncertainty", "transducer.thicknes = 5 um"], "did you mean 'transducer.thickness'"),
    (["--require", "q >= 5", "--uncertainty", "transducer.thickness = exact"], "something uncertain"),
    (["--require", "q >= 5", "--samples", "0"], "--samples"),
    (["--sobol", "100"], "'64' or '128'"),
    (["--figure", "f1"], "did you mean 'f0'"),
    (["--thermal-resistance", "transduce = 10 K/W"], "did you mean 'transducer'"),
    (["--thermal-resistance", "0 K/W"], "a resistance above zero"),
    (["--thermal-resistance", "10"], "a thermal resistance in one of K/W"),
    (["--posterior", "none.json"], "a fit.json of workbench fit"),
    (["--uncertainties", "none.toml"], "an existing file"),
    (["--drive", "10 V"], '"10 Vpp"'),
])
def test_a_mistake_on_the_command_line_is_told(
    chip_file: Path, tmp_path: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["tolerance", str(chip_file), *options, "-o", str(out)]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_a_chip_that_fails_as_stated_is_told_so() -> None:
    found = tolerance(disc(), None, ["q <= 10"], samples=5, accuracy=ACCURACY)
    assert "the chip as stated does not meet 'q <= 10' itself" in found.findings
    assert found.yields is not None
    assert found.yields.together.sampled.passed == 0


def test_what_is_noise_is_not_offered_as_advice(found: Tolerance) -> None:
    assert found.yields is not None
    tightenings = (Tightening("transducer.thickness", 0.12, 0.02, 0.1), Tightening("water.density", 0.021, 0.014, 0.0),
                   Tightening("pla.density", -0.021, 0.014, 0.0))
    named = replace(found.uncertainty, inputs=tuple(replace(found.uncertainty.inputs[0], name=each.name)
                                                    for each in tightenings))
    made = replace(found, yields=replace(found.yields, tightenings=tightenings), uncertainty=named)
    assert [row[0] for row in tightening_table(made).rows] == ["transducer.thickness"]
    assert unclear_tightenings(made).endswith("twice its standard error: water.density, pla.density.")
    assert unclear_tightenings(replace(made, yields=replace(found.yields, tightenings=tightenings[:1]))) == ""
