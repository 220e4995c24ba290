"""The description of a mismatch that nothing explains: on made-up explanations, and energies against the fields'."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem

from workbench.acoustics.fields import fields
from workbench.acoustics.nodal import integrate
from workbench.campaign.state import state_fit
from workbench.catalogue.effect import Effect
from workbench.commands.diagnose import print_diagnosis
from workbench.diagnosis import description
from workbench.diagnosis.decision import Decision, Evidence
from workbench.diagnosis.description import (
    BANDS,
    Description,
    ModeOfModel,
    RemainderBand,
    StateRemainder,
    Taker,
    modes_of_spectrum,
    regions_by_energy,
    remainder_bands,
    remainder_description,
    states_that_show,
)
from workbench.diagnosis.findings import Found, Refitted, StatePrediction
from workbench.diagnosis.likelihood import Hypothesis
from workbench.diagnosis.next_measurement import recorded_next
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.outcome import Diagnosis, Remainder
from workbench.diagnosis.ranking import Score
from workbench.fem.operators import FullOperators
from workbench.fem.solve import solve_full
from workbench.fitting.parameter import Parameter
from workbench.model.drive import VoltageDrive
from workbench.model.numbers import Stated
from workbench.model.problem import Problem
from workbench.report.definitions import DEFINITIONS
from workbench.report.diagnosis import diagnosis_record, remainder_table, unexplained_tables, write_diagnosis_report
from workbench.report.page import TextTable
from workbench.results.spectrum import Spectrum

FREQUENCY = np.linspace(0.9e6, 1.1e6, 401)
NOISE = np.full(401, 0.002)
LEADS, LOAD, LOSS = (
    Effect(name, "bench", "bench", "", (Parameter(f"bench.{key}", 0.0, -1.0, 1.0, None, unit),))
    for name, key, unit in (("resistance of leads", "series_resistance", "ohm"), ("gain", "gain", "1"),
                            ("phase of the gain", "phase", "rad")))


def resonator(off: Any = 0.0) -> Any:
    """A motional branch of Q 100 at 1 MHz beside a capacitor, times exp(off)."""
    omega = 2.0 * np.pi * FREQUENCY
    branch = 20.0 * (1.0 + 100j * (FREQUENCY / 1e6 - 1e6 / FREQUENCY))
    return np.exp(off) / (1.0 / branch + 1j * omega * 1e-9)


def state(name: str, *regions: str, fluid: Any = None) -> Any:
    return SimpleNamespace(name=name, measured=Spectrum(FREQUENCY, resonator()), noise=NOISE, fluid=fluid, findings=(),
                           observation=None, data=2,
                           materials=dict.fromkeys(regions, SimpleNamespace(name="a")))


def bump(at: float, width: float = 2e3) -> Any:
    return np.exp(-0.5 * ((FREQUENCY - at) / width) ** 2)


def refitted(*effects: Effect, off: Any, outside: str = "", scores: tuple[Score, ...] = ()) -> Refitted:
    """A hypothesis that leaves `off` of ln Z in the state low, and as much everywhere in the state high, held out."""
    vector = np.concatenate([off / NOISE, np.zeros(off.size)])
    found = made_explanation(
        made_problem(vector, np.zeros((vector.size, 3)), np.ones(3)), np.zeros(3), states=(state("low"),),
        hypothesis=Hypothesis(effects, outside), log_ratio=(off + 0j,), impedances=(resonator(off),))
    return Refitted(found, predicted=(StatePrediction(state("high"), resonator(0.05), 1.0),), scores=scores)


def score(effect: Effect, gain: float, evidence: float = -3.0) -> Score:
    return Score(effect, evidence, gain, np.zeros(1), np.ones(1))


def model(*held_out: Any) -> Any:
    parameters = [each.parameters[0] for each in (LEADS, LOAD, LOSS)]
    return SimpleNamespace(
        campaign=SimpleNamespace(name="device", fitted=(state("low"),), held_out=held_out, findings=(), uncertain=(),
                                 states=(state("low", "transducer"),)),
        parameters=parameters, known=0, others=(), effects=(LEADS, LOAD, LOSS), hypotheses=3, refusals=[],
        stated=np.zeros(3), index=[p.name for p in parameters].index, free=lambda _: ([], []),
        fitted=SimpleNamespace(recordings=()))


@pytest.fixture
def without_a_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(description, "_solved", lambda *_of: (None, None))
    monkeypatch.setattr(description, "regions_by_energy", lambda *_of: (("transducer", 0.9), ("bond", 0.1)))


def concluded(
    base: Refitted, *others: Refitted, odds: Mapping[str, float] = MappingProxyType({})
) -> tuple[Found, Decision]:
    log_odds = {"nothing": 0.0, **odds}
    return (Found(base, (base, *others)),
            Decision("unexplained", Evidence("nothing", 0.0), (), log_odds))


def test_bands_are_where_the_square_lies_and_tails_belong_to_their_peak() -> None:
    log = 0.02 * bump(0.95e6) + 0.01 * bump(1.04e6) + 0j
    bands = remainder_bands([state("low"), state("high")], [log, 0.001 * bump(1e6) + 0j])
    assert [band.state for band in bands] == ["low", "low"]
    assert [band.peak for band in bands] == pytest.approx([0.95e6, 1.04e6], abs=500.0)
    # Squares of Gaussians of equal widths: 4 to 1.
    assert [band.share for band in bands] == pytest.approx([0.8, 0.2], abs=0.03)
    assert all(band.low < band.peak < band.high and band.high - band.low < 12e3 for band in bands)


def test_no_more_bands_are_listed_than_can_be_read_and_none_of_a_trace() -> None:
    many = sum(bump(at) for at in np.linspace(0.91e6, 1.09e6, 9)) * 0.02 + 0j
    bands = remainder_bands([state("low")], [many])
    assert len(bands) == BANDS
    assert all(0.05 < band.share < 0.2 for band in bands)
    # A band that begins with the recording, and alike points everywhere.
    edge, = remainder_bands([state("low")], [0.02 * bump(0.9e6) + 0j])
    flat, = remainder_bands([state("low")], [np.full(401, 0.01 + 0j)])
    assert (edge.low, edge.peak) == (0.9e6, pytest.approx(0.9e6, abs=2e3))
    assert (flat.low, flat.high, flat.share, flat.rms) == (0.9e6, 1.1e6, pytest.approx(1.0), pytest.approx(0.01))


def test_noise_does_not_break_a_band_up() -> None:
    noise = np.random.default_rng(3).normal(size=(401, 2)) @ [0.001, 0.001j]
    first, *_ = remainder_bands([state("low")], [0.02 * bump(0.95e6, 6e3) + noise])
    assert first.peak == pytest.approx(0.95e6, abs=3e3)
    assert first.share > 0.85


def test_modes_of_a_spectrum_are_its_resonance_and_its_antiresonance() -> None:
    found = {each.kind: each.frequency for each in modes_of_spectrum(FREQUENCY, resonator())}
    # C1 = 1 / (w Q R), against a capacitor of 1 nF.
    above = 1e6 * math.sqrt(1.0 + 1.0 / (2.0 * math.pi * 1e6 * 100.0 * 20.0) / 1e-9)
    assert found == {"resonance": pytest.approx(1e6, abs=600.0), "antiresonance": pytest.approx(above, abs=600.0)}
    assert not modes_of_spectrum(FREQUENCY[:100], resonator()[:100])


def test_energies_by_region_are_those_of_the_fields(filled: Problem, filled_operators: FullOperators) -> None:
    solution = solve_full(filled_operators, np.array([345e3]), filled.values)
    shares = dict(regions_by_energy(filled, solution))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    found = fields(filled, filled_operators, solution, VoltageDrive(1.0))
    energy = {region: float(integrate(found.mesh, found.energy_density, [region])) for region in shares}
    passive = [region for region in shares if region != "transducer"]
    # The field of a ceramic holds electric energy too, and nodal gradients are rougher than those in the cells.
    for region in passive:
        assert shares[region] / sum(shares[each] for each in passive) == pytest.approx(
            energy[region] / sum(energy[each] for each in passive), rel=0.1, abs=2e-3)


@pytest.mark.usefixtures("without_a_solver")
def test_a_mismatch_is_described_by_states_bands_and_hypotheses() -> None:
    base = refitted(off=0.1 * bump(1.002e6), scores=(
        score(LEADS, 50.0), score(LOSS, 90.0), score(LOAD, 70.0)))
    whole = base.explanation.local.best[2].chi_square
    half = refitted(LOAD, off=0.1 * bump(1.002e6) * math.sqrt(0.5))
    # A further effect that takes no more.
    both = refitted(LOAD, LEADS, off=0.1 * bump(1.002e6) * math.sqrt(0.49))
    odds = {"gain": -2.0, "gain and resistance of leads": -5.0}
    found = remainder_description(model(state("high")), *concluded(base, half, both, odds=odds), Criteria())
    assert found is not None
    log = base.explanation.log_ratio[0]
    assert (found.rms, found.times) == (pytest.approx(base.explanation.rms), pytest.approx(
        np.sqrt(np.mean(np.abs(log / 0.002) ** 2) / 2.0)))
    low, high = found.states
    assert (low.name, low.share, high.name, high.share) == ("low", 1.0, "high", None)
    assert (high.rms, high.times) == (pytest.approx(0.05), pytest.approx(0.05 / 0.002 / math.sqrt(2.0)))
    band, = found.bands
    assert band.mode is not None
    assert (band.mode.kind, band.regions) == ("resonance", (("transducer", 0.9), ("bond", 0.1)))
    assert [(each.name, each.predicted) for each in found.takers] == [
        ("gain", False), ("phase of the gain", True), ("resistance of leads", True)]
    assert [each.share for each in found.takers] == pytest.approx([0.5, 90.0 / whole, 50.0 / whole])
    # A score is too rough for odds.
    assert [each.log_odds for each in found.takers] == [pytest.approx(-2.0), None, None]


@pytest.mark.usefixtures("without_a_solver")
def test_noise_a_search_cut_short_and_a_hypothesis_that_takes_nothing_are_not_described() -> None:
    noise = refitted(off=np.full(401, 0.0025))
    assert remainder_description(model(state("high")), *concluded(noise), Criteria()) is None
    base = refitted(off=0.1 * bump(1e6))
    found, conclusion = concluded(base, refitted(LOAD, off=0.11 * bump(1e6)), odds={"gain": -9.0})
    cut = replace(found, undone=("leads",))
    assert remainder_description(model(state("high")), cut, conclusion, Criteria()) is None
    told = remainder_description(model(state("high")), found, conclusion, Criteria())
    assert told is not None
    assert not told.takers


@pytest.mark.usefixtures("without_a_solver")
def test_a_region_that_is_suspected_is_described_by_the_known_numbers_alone() -> None:
    base, region = refitted(off=0.1 * bump(1e6)), refitted(off=0.1 * bump(1e6), outside="bond")
    found, conclusion = concluded(base, region)
    suspected = replace(conclusion, chosen=Evidence("something in the bond", 9.0, outside=True))
    told = remainder_description(model(state("high")), found, suspected, Criteria())
    assert told == remainder_description(model(state("high")), found, conclusion, Criteria())


@pytest.mark.parametrize(("states", "says"), [
    ((state("filled", "transducer", "cavity", fluid="water"),), "Record the bare transducer, and add it"),
    ((state("disc", "transducer"), state("filled", "transducer", "cavity", fluid="water")),
     "Record the chip with its cavity empty"),
    ((state("disc", "transducer"), state("empty", "transducer", "sidewall"),
      state("filled", "transducer", "cavity", fluid="water")), "Record filled once more, taken from its clips"),
])
def test_the_next_recording_is_the_state_that_is_not_among_them(states: Any, says: str) -> None:
    assert recorded_next(states, "filled", ())[0].startswith(says)


def test_the_hypothesis_that_takes_most_is_measured_by_other_means() -> None:
    first, again = recorded_next(model().campaign.states, "low", [LEADS])
    assert first.startswith("Measure open, short and load at the clips")
    assert again.startswith("Record low once more")


def test_states_show_an_effect_by_its_change_of_their_spectra() -> None:
    tangents = np.zeros((1604, 2))
    tangents[:802, 1], tangents[802:, 1] = 3.0, 1.0
    two = SimpleNamespace(campaign=SimpleNamespace(fitted=(state("empty"), state("filled"))), stated=np.zeros(2),
                          index=["known", "bench.gain"].index)
    found = made_explanation(made_problem(np.zeros(1604), tangents, np.ones(2)), np.array([9.0, 0.1]),
                             hypothesis=Hypothesis((LOAD,)))
    assert states_that_show(two, found) == {"empty": pytest.approx(0.9), "filled": pytest.approx(0.1)}  # type: ignore[arg-type]
    # A region that changes one state alone, of a residual that both have.
    outside = np.zeros((1604, 1))
    outside[802:, 0] = 1.0
    region = made_explanation(made_problem(np.ones(1604), tangents, np.ones(2), outside=outside), np.zeros(2),
                              hypothesis=Hypothesis((), "bond"))
    assert states_that_show(two, found, Refitted(region)) == {  # type: ignore[arg-type]
        "empty": 0.0, "filled": pytest.approx(1.0)}


TOLD = Description(
    0.0122, 4.32, (StateRemainder("low", 0.0149, 5.27, 1.0), StateRemainder("high", 0.1, 36.0, None)),
    (RemainderBand("low", 1.0106e6, 1.029e6, 1.0156e6, 0.46, 0.0237, ModeOfModel("resonance", 1.0108e6),
                   (("transducer", 0.7), ("bond", 0.27), ("substrate", 0.03))),
     RemainderBand("low", 0.9e6, 0.91e6, 0.9e6, 0.2, 0.01)),
    (Taker("phase of the gain", 0.21, math.log(0.2), False),), "Record the bare transducer.")


def diagnosis(told: Description | None = TOLD) -> Diagnosis:
    base = refitted(off=0.02 * bump(1e6))
    found, conclusion = concluded(base)
    fits = tuple(state_fit(name, np.log(resonator(0.01) / resonator()), resonator(0.01), NOISE)
                 for name in ("low", "high"))
    made = Diagnosis(model(state("high")), replace(found, stated=fits), conclusion, Criteria(), 1.0, description=told)
    vars(made).update(base=fits, best=fits, remainder=Remainder(0.0122, 0.0028, 4.0, 0.001, ""))
    return made


def test_a_description_is_told_in_findings_table_record_and_next_measurement(
    capsys: pytest.CaptureFixture[str]
) -> None:
    found = diagnosis()
    assert found.findings[:2] == (
        "46 % of the residual lies in low from 1.0106 to 1.0290 MHz; the nearest resonance of the model is at 1.0108 "
        "MHz, with its energy in the transducer (70 %), bond (27 %).",
        "The hypothesis phase of the gain would explain most of it: 21 %, with odds of 0.2 against nothing further.")
    scored = replace(TOLD, takers=(Taker("gain", 0.999, None, True),))
    assert scored.in_words[1].endswith("gain would explain most of it: 99.9 % by its score, which is not a fit.")
    assert unexplained_tables(scored)[-1].rows == (("gain", "99.9", "not fitted", "its score"),)  # type: ignore[union-attr]
    assert found.next_measurement == "Record the bare transducer."
    record = json.loads(json.dumps(diagnosis_record(found)["unexplained"]))
    assert record["bands"][0]["mode"] == {"kind": "resonance", "frequency": 1.0108e6}
    assert record["bands"][0]["regions"][0] == ["transducer", 0.7]
    assert (record["bands"][1]["mode"], record["states"][1]["share"]) == (None, None)
    assert record["takers"][0]["share"] == 0.21
    states, bands, takers = (each for each in unexplained_tables(TOLD) if isinstance(each, TextTable))
    assert states.rows == (("low", "1.49", "5.27", "100"), ("high", "10", "36", "held out"))
    assert bands.rows[0][:6] == ("low", "1.0106", "1.0290", "1.0156", "2.37", "46")
    assert bands.rows[1][6:] == ("none in the recording", "")
    assert takers.rows == (("phase of the gain", "21", "0.2", "a fit"),)
    print_diagnosis(found)
    assert "46 % of the residual lies in low" in capsys.readouterr().out
    none = diagnosis(None)
    assert diagnosis_record(none)["unexplained"] is None
    assert not none.next_measurement
    assert "No hypothesis of the catalogue would explain any of it." in unexplained_tables(replace(TOLD, takers=()))


def test_the_report_describes_it_right_after_the_headline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.report.diagnosis._pictures", lambda *_of: [])
    monkeypatch.setattr("workbench.report.diagnosis.origin_table", lambda _origin: "")
    text = write_diagnosis_report(diagnosis(), [], tmp_path).read_text(encoding="utf-8")
    headings = [part.split("</h2>")[0] for part in text.split("<h2>")[1:]]
    assert headings[:3] == ["Result", "Unexplained residual", "Before and after"]
    assert DEFINITIONS["share of the residual"] in text
    # That of a trap is of another report.
    assert DEFINITIONS["share"] not in text
    assert "Unexplained residual" not in write_diagnosis_report(diagnosis(None), [], tmp_path).read_text()


def test_the_table_says_what_is_in_its_columns_and_marks_states_held_out() -> None:
    table = remainder_table(diagnosis())
    assert table.columns == ("state", "noise floor (%)", "as stated (%)",
                             "known parameters within 3.5 sigma (%)")
    assert table.rows == (("low", "0.283", "1", "1"), ("high, held out", "0.283", "1", "1"))


def test_a_column_does_not_claim_uncertainties_that_known_numbers_leave() -> None:
    found = diagnosis()
    gain = replace(LEADS.parameters[0], stated=Stated(0.01))
    x = np.array([9.0, 0.0, 0.0])
    told = made_problem(np.zeros(802), np.ones((802, 1)) * [1e3, 0.0, 0.0], np.array([100.0, 1.0, 1.0]))
    base = replace(found.found.base, explanation=replace(
        found.found.base.explanation, x=x, likeliest=x, local=told, free=(0, 1, 2)))
    moved: Any = SimpleNamespace(
        **{**vars(found.model), "known": 1, "parameters": [gain, *found.model.parameters[1:]]})
    beyond = replace(found, model=moved, found=replace(found.found, base=base))
    assert remainder_table(beyond).columns[-1] == "known parameters, some beyond 3.5 sigma (%)"
