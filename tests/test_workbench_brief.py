"""What a prompt shows of results: a few lines, whatever they hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from test_workbench_barriers import NEUTRAL, half_wave

import workbench as wb
from workbench.acoustics.traps import find_traps
from workbench.fem.solve import Solution
from workbench.fitting.joint import FitResult
from workbench.readers import Reading
from workbench.results.brief import TEXT_COLUMNS, TEXT_LINES, Brief
from workbench.results.circuit import bvd_impedance
from workbench.results.comparison import compare
from workbench.results.merit import figures
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Spectrum, spectrum_of

FREQUENCY = np.linspace(0.95e6, 1.13e6, 401)
SPECTRUM = Spectrum(FREQUENCY, bvd_impedance(
    FREQUENCY, motional_resistance=5.9, motional_inductance=152e-6, motional_capacitance=168e-12,
    static_capacitance=800e-12))


def check(text: str) -> None:
    lines = text.splitlines()
    assert 1 <= len(lines) <= TEXT_LINES
    assert max(map(len, lines)) <= TEXT_COLUMNS <= 120
    assert TEXT_LINES <= 12


@dataclass(frozen=True, eq=False, repr=False)
class Long(Shown):
    rows: int

    def summary(self) -> Summary:
        return Summary("much", tuple(("row", "x" * 300) for _ in range(self.rows)))


@pytest.mark.parametrize("result", [
    SPECTRUM, Reading(SPECTRUM, ()), compare(SPECTRUM, SPECTRUM), find_traps(half_wave(NEUTRAL)), half_wave(NEUTRAL),
    half_wave(NEUTRAL).mesh, Long(3), Long(300),
], ids=lambda value: type(value).__name__)
def test_the_text_of_a_result_is_short(result: object) -> None:
    check(repr(result))
    assert str(result) == repr(result) or "MHz" in str(result)


def test_a_summary_is_shown_in_words_and_cut_with_a_word() -> None:
    assert "points: 401" in repr(SPECTRUM)
    assert "more lines" in repr(Long(300))


def test_arrays_are_shown_by_their_shapes() -> None:
    text = repr(half_wave(NEUTRAL))
    assert "float64>" in text
    assert "region='cavity'" in text


def test_no_public_result_has_the_text_that_a_dataclass_makes() -> None:
    results = (wb.Simulation, wb.Snapshot, wb.Comparison, wb.Reading, wb.Spectrum, wb.Diagnosis, wb.Tolerance,
               wb.Design, wb.StudyResult, wb.DesignModel, wb.Evaluation, wb.RangeModel, wb.MaterialFit, wb.Campaign,
               wb.Posterior, Solution, FitResult)
    for each in results:
        assert issubclass(each, Brief), each
        assert "__repr__" not in vars(each) or each is Shown, each


def test_compare_and_figures_take_what_has_a_spectrum() -> None:
    reading = Reading(SPECTRUM, ())
    assert figures(reading) == figures(SPECTRUM)
    assert compare(reading, reading).mape_percent < 1e-9
    assert spectrum_of(reading) is SPECTRUM
    with pytest.raises(TypeError, match="received a str; expected a Spectrum"):
        figures("recording.csv")  # type: ignore[arg-type]
