"""What a decision comes to in words, shares, a record and a report, without a solver."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem

from workbench.campaign.state import StateFit, state_fit
from workbench.catalogue.effect import Effect
from workbench.commands.diagnose import print_diagnosis
from workbench.diagnosis.conclusion import evidence, explained_share
from workbench.diagnosis.decision import VERDICTS, Decision, Evidence
from workbench.diagnosis.estimates import Established, FoundNumber, interval
from workbench.diagnosis.findings import Alternative, Found, NotTried, Refitted, StatePrediction
from workbench.diagnosis.likelihood import Explanation, Hypothesis
from workbench.diagnosis.modes import Mode
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.outcome import Diagnosis, Remainder
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import Number, Stated
from workbench.physics.term import Admissible
from workbench.report.diagnosis import diagnosis_record, established_table, write_diagnosis_report
from workbench.results.spectrum import Spectrum

FREQUENCY = np.linspace(0.9e6, 1.1e6, 201)
NOISE = np.full(201, 0.002)
LEADS = Effect("leads", "bench", "bench", "leads that are longer than stated", (
    Parameter("bench.series_resistance", 0.0, -0.3, 5.0, None, "ohm"),
    Parameter("bench.series_inductance", 0.0, -1e-7, 2e-6, None, "H")))
GLASS = Effect("shear modulus of glass", "superstrate", "stiffness", "another glass", (
    Parameter("glass.shear_modulus", 26e9, 20e9, 30e9, Stated(1e9), "Pa"),),
    admissible={"glass.shear_modulus": Admissible(20e9, 30e9, "Pa", "any glass")})
PARAMETERS = (*LEADS.parameters, *GLASS.parameters)
NOTHING = Evidence("nothing", 0.0)


def impedance(off: float = 0.0) -> Any:
    """A resonator of Q 100 at 1 MHz, times exp(off)."""
    detuned = FREQUENCY / 1e6 - 1e6 / FREQUENCY
    return math.exp(off) * 10.0 * (1.0 + 100j * detuned)


def state(name: str) -> Any:
    return SimpleNamespace(name=name, measured=Spectrum(FREQUENCY, impedance()), noise=NOISE, observation=None, data=2,
                           findings=(),
                           materials={})


def explanation(*effects: Effect, off: float = 0.0, region: str = "") -> Explanation:
    """One that leaves the same `off` of ln Z at every point of the one fitted state."""
    log = np.full(FREQUENCY.size, off + 0j)
    local = made_problem(np.full(402, off / 0.002), np.zeros((402, 3)), 1.0 / np.array([0.01, 2e-9, 1e8]))
    return made_explanation(local, np.array([0.15, 60e-9, 25e9]), hypothesis=Hypothesis(effects, region),
                            states=(state("empty"),), log_ratio=(log,), impedances=(impedance(off),))


def settled(*effects: Effect, off: float = 0.0, region: str = "") -> Refitted:
    return Refitted(explanation(*effects, off=off, region=region),
                    predicted=(StatePrediction(state("filled"), impedance(off), 1.0),))


def stated_fits(off: float = 0.05) -> tuple[StateFit, ...]:
    """The states where each point is `off` as stated."""
    return tuple(state_fit(name, np.log(impedance(off) / impedance()), impedance(off), NOISE)
                 for name in ("empty", "filled"))


def found_of(*final: Refitted) -> Found:
    """A search that ended with these explanations, the null hypothesis last."""
    return Found(final[-1], final, stated_fits())


def campaign() -> Any:
    gel = Number("couplant.thickness", 20e-6, stated=Stated(1e-6, origin="campaign.toml"), unit="m")
    return SimpleNamespace(name="device", fitted=(state("empty"),), held_out=(state("filled"),), findings=(),
                           uncertain=(gel,))


def model() -> Any:
    return SimpleNamespace(campaign=campaign(), parameters=PARAMETERS, known=0, others=(), effects=(LEADS, GLASS),
                           whole=SimpleNamespace(solves=7), index=[p.name for p in PARAMETERS].index,
                           free=lambda effects: ([0, 1, 2], [2] if GLASS in effects else []),
                           refusals=[], fitted=SimpleNamespace(recordings=()))


def estimate(name: str, value: float, unit: str, stated: float = 0.0, sigmas: float | None = None) -> FoundNumber:
    return FoundNumber(name, value, 0.9 * value, 1.1 * value, unit, stated, sigmas)


TOLD = Established(LEADS, (estimate("bench.series_resistance", 0.15, "ohm"),
                           estimate("bench.series_inductance", 60e-9, "H")), True, 0.97)


def diagnosis(verdict: str, chosen: Evidence = NOTHING, rivals: tuple[Evidence, ...] = (), **changed: Any) -> Diagnosis:
    """One of made-up results; any of those that follow from a search may be `changed` too."""
    beside = (Alternative(Hypothesis(region="bond"), 0.5, np.zeros((402, 0))),)
    base = replace(settled(off=0.04), alternatives=beside)
    named = replace(settled(LEADS, off=0.003), alternatives=beside)
    log_odds = {"nothing": 0.0, "leads": 6.0, **{each.name: 5.0 for each in rivals}, **changed.pop("log_odds", {})}
    every = (named, settled(GLASS), settled(region="bond")) if changed.pop("tried", True) else ()
    final = (*(each for each in every if each.hypothesis.name in log_odds), base)
    found = Found(base, final, stated_fits(0.3), undone=changed.pop("undone", ()),
                  not_tried=changed.pop("not_tried", ()))
    remaining = tuple(Evidence(name, odds, (name,)) for name, odds in log_odds.items() if name != "nothing")
    decision = Decision(verdict, chosen, rivals, log_odds, is_explained=changed.pop("is_explained", True),
                        remaining=changed.pop("remaining", remaining))
    fields = {key: changed.pop(key) for key in ("provisional", "criteria") if key in changed}
    return made(replace(Diagnosis(model(), found, decision, Criteria(), 12.0), **fields), **{
        "established": (TOLD,) if chosen.effects else (), "remainder": Remainder(0.003, 0.0028, 1.1, 0.001, ""),
        "known": (estimate("pla.density", 1180.0, "kg/m^3", 1150.0, 2.5),), **changed})


def made(found: Diagnosis, **changed: Any) -> Diagnosis:
    """A diagnosis with made-up values of properties that follow from a search."""
    copy = replace(found)
    vars(copy).update({**vars(found), **changed})
    return copy


def test_every_verdict_has_a_headline() -> None:
    """With the numbers and the share of what is named, its rivals, and what is left."""
    leads, glass = Evidence("leads", 9.0, ("leads",)), Evidence("shear modulus of glass", 8.0, (GLASS.name,))
    left = "the residual is 0.3 % of Z (rms of both parts; noise floor 0.28 %)"
    named = "Leads: series resistance 0.15 ohm and series inductance 60 nH; this explains 97 % of the residual"
    moved = (estimate("pla.density", 1180.0, "kg/m^3", 1150.0, -4.2),)
    said: dict[str, tuple[Diagnosis, Sequence[str]]] = {
        "missing_physics": (diagnosis("missing_physics", leads), [named]),
        "ambiguous": (diagnosis("ambiguous", leads, (glass,)), [named, "shear modulus of glass would too"]),
        "no_mismatch": (diagnosis("no_mismatch"), ["model as stated explains", left]),
        "parameters_explain": (diagnosis("parameters_explain"), [left, "pla density moves most, by +2.5 sigma"]),
        "parameters_at_odds": (diagnosis("parameters_at_odds", known=moved), [
            "more than 3.5 sigma from the stated value: pla density (-4.2)", left]),
        "below_detection": (diagnosis("below_detection", log_odds={"leads": math.log(5.0)}), ["leads", "odds of 5:"]),
        "unexplained": (diagnosis("unexplained", Evidence("something in the bond", 9.0, outside=True),
                                  log_odds={"something in the bond": 9.0}), [left, "like something in the bond"]),
        "not_finished": (diagnosis("not_finished", undone=("leads",)), ["leads"])}
    assert set(said) == set(VERDICTS)
    for found, parts in said.values():
        assert all(part in found.headline for part in parts), found.headline
    with pytest.raises(ValueError, match="verdict 'guilty': expected one of no_mismatch"):
        _ = diagnosis("guilty").headline


def test_a_hint_is_no_excluded_hypothesis() -> None:
    """A hypothesis that the held-out states refute may have larger odds than the hint."""
    hint = diagnosis("below_detection", log_odds={"leads": math.log(5.0), GLASS.name: 9.0},
                     remaining=(Evidence("leads", math.log(5.0), ("leads",)),))
    assert "leads most likely, with odds of 5:" in hint.headline.lower()
    assert [each.hypothesis.name for each, _ in hint.alive] == ["nothing", "leads"]


def test_a_residual_that_nothing_explains_has_a_place_or_a_reason_for_none() -> None:
    """With every verdict that leaves one: by evidence of e^3 = 20 for a region, or by the reason that there is none."""
    def beside(*gains: tuple[str, float]) -> tuple[Alternative, ...]:
        return tuple(Alternative(Hypothesis(region=region), gain, np.zeros((402, 0))) for region, gain in gains)

    def of(alternatives: tuple[Alternative, ...], inflation: float = 4.0) -> Diagnosis:
        found = diagnosis("unexplained")
        base = replace(found.found.base, alternatives=alternatives)
        found = replace(found, found=Found(base, (base,), found.found.stated))
        return made(found, remainder=replace(found.remainder, inflation=inflation))

    assert "; it looks like something in the bond." in of(beside(("bond", 3.1), ("lid", 1.0))).headline
    assert of(beside(("bond", 3.1))).remainder.region == "bond"
    assert ("it has no place: of the changes within one region and the further modes, a change in the lid adds most, a "
            "log evidence of 2.0 where 3.0 is needed." in of(beside(("lid", 2.0))).headline)
    assert "its place was not searched for" in of(()).headline
    assert "since no noise scale factor is above 1.2" in of((), inflation=1.1).headline
    text = diagnosis("missing_physics", Evidence("leads", 9.0, ("leads",)), is_explained=False).headline
    assert "With this, the residual is 0.3 % of Z" in text
    assert "it has no place" in text


def test_a_loss_is_told_against_the_stated_one() -> None:
    """Of a material that states one: an added loss of a polymer at one frequency, or another loss."""
    name = "glass.shear_fractional_loss"
    added = Effect("fractional loss of glass", "superstrate", "loss", "", (
        Parameter(name, 0.0, 0.0, 3e8, None, "Pa"), Parameter("glass.loss_exponent", 0.3, 0.0, 1.0, None, "1")),
        terms={"empty": (SimpleNamespace(region="superstrate"),)})  # type: ignore[dict-item]
    stated = Parameter("glass.shear_modulus.loss", -2e8, -1e9, 0.0, None, "Pa")
    parameters = (*added.parameters, stated)
    device: Any = SimpleNamespace(parameters=parameters, known=0, index=[p.name for p in parameters].index,
                                  free=lambda _effects: ([0, 1], []))
    local = made_problem(np.zeros(402), np.zeros((402, 2)), np.array([1e-6, 1e-2]))
    found = made_explanation(local, np.array([2e8, 0.7, -2e8]), hypothesis=Hypothesis((added,)), free=(0, 1))
    told = Established.of(device, found, added, 0.9)
    assert told.in_words == "glass has twice the stated loss (shear loss 0.4 GPa, stated 0.2)"
    # The exponent of a term is stated nowhere.
    assert [each.is_stated for each in told.estimates] == [False, False]
    without = replace(told, losses=(0.0, 0.0)).in_words
    assert without == "fractional loss of glass: shear fractional loss 0.2 GPa and loss exponent 0.7"


def test_findings_name_rivals_odds_with_what_is_known_and_what_was_not_looked_at() -> None:
    glass = Evidence("shear modulus of glass", 8.0, (GLASS.name,))
    found = diagnosis("ambiguous", Evidence("leads", 9.0, ("leads",)), (glass,), not_tried=(
        NotTried("pairs", "none is left"),), known=(
        estimate("pla.density", 1180.0, "kg/m^3", 1150.0, -3.6), estimate("bond.thickness", 9e-6, "m", 1e-5, 3.4)),
        established=(replace(TOLD, admissible=False),), remainder=Remainder(0.004, 0.0028, 1.4, 0.001, "bond"))
    text = "\n".join(found.findings)
    assert "it looks like something in the bond." in text
    assert "A parameter of leads is at the end of its admissible range, or outside" in text
    assert "The recordings cannot rule out shear modulus of glass: odds of 2.72 against it." in text
    assert "Known parameters more than 3.5 sigma from the stated value: pla density (-3.6)." in text
    assert "filled, held out: a reduced chi-square of 200 by the known parameters, 1.12 by the established" in text
    assert text.endswith("Not tried: pairs, because none is left.")
    # Twice as far is asked for: nothing is at odds.
    assert not made(found, criteria=Criteria(at_odds=7.0)).at_odds
    # A headline that lists them is not repeated.
    assert "sigma from" not in "\n".join(diagnosis("parameters_at_odds", known=found.known).findings)


def test_nothing_is_said_of_a_mismatch_by_a_search_that_was_cut_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its first sentence is what was not looked at; what it found so far is provisional, and no picture shows it."""
    monkeypatch.setattr("workbench.report.diagnosis._pictures", lambda *_of: [])
    monkeypatch.setattr("workbench.report.diagnosis.origin_table", lambda _origin: "")
    undone = ("leads of any size", *[f"thickness {k}" for k in range(7)], "thickness 0")
    so_far = diagnosis("missing_physics", Evidence("leads", 9.0, ("leads",)), undone=undone)
    found = diagnosis("not_finished", undone=undone, provisional=so_far)
    assert found.headline == ("Not finished: still to be looked at: leads of any size, thickness 0 (2 times), "
                              "thickness 1, thickness 2, thickness 3, thickness 4 and 2 more.")
    page = write_diagnosis_report(found, [], tmp_path).read_text()
    said = diagnosis_record(found)
    print_diagnosis(found)
    printed = " ".join(capsys.readouterr().out.split())
    assert said["effects"] == []
    assert said["provisional"]["effects"][0]["name"] == "leads"
    assert "<h1>Diagnosis, not finished: device</h1>" in page
    assert "Verdict: not finished." in page
    assert page.index(found.headline) < page.index("<h2>Provisional</h2>")
    assert "Not looked at: leads of any size, thickness 0, thickness 1, " in printed
    for text in (page, printed, json.dumps(said)):
        assert "Provisional: of the tried hypotheses (leads), best so far is leads: series resistance 0.15 ohm" in text
        assert "explains 97 %" not in text
        assert "explain the recordings" not in text
        assert "explains the recordings" not in text
    nothing = diagnosis("not_finished", undone=("scores of the hypotheses",), tried=False)
    assert nothing.headline == ("Not finished: none of the 2 hypotheses has been tried; still to be looked at: scores "
                                "of the hypotheses.")
    assert not nothing.next_measurement


def test_of_two_effects_each_takes_what_it_adds_to_those_before_it() -> None:
    base, single, pair = settled(off=0.05), settled(LEADS, off=0.02), settled(LEADS, GLASS, off=0.01)
    decision = Decision("missing_physics", Evidence(pair.hypothesis.name, 9.0, ("leads", GLASS.name)), (), {})
    found = Diagnosis(model(), found_of(pair, single, base), decision, Criteria()).established
    # Of chi-square less what noise makes of it: real parts are off, and both parts have noise.
    whole = 0.05**2 - 2.0 * 0.002**2
    assert [each.effect.name for each in found] == ["leads", GLASS.name]
    assert [each.share for each in found] == [pytest.approx((0.05**2 - 0.02**2) / whole, rel=1e-12),
                                              pytest.approx((0.02**2 - 0.01**2) / whole, rel=1e-12)]
    assert found[1].estimates[0] == FoundNumber("glass.shear_modulus", 25e9, pytest.approx(25e9 - 1.96e8),
                                                pytest.approx(25e9 + 1.96e8), "Pa", 26e9, None)
    assert found[1].admissible
    limits = {"glass.shear_modulus": Admissible(26e9, 30e9, "Pa", "this glass")}
    outside = replace(GLASS, admissible=limits)
    assert not Established.of(model(), explanation(outside), outside, 0.9).admissible


def test_a_number_at_the_end_of_what_is_admissible_is_a_sign_unless_it_is_neutral() -> None:
    ending = replace(GLASS, admissible={"glass.shear_modulus": Admissible(25e9, 30e9, "Pa", "this glass")})
    assert not Established.of(model(), explanation(ending), ending, 0.9).admissible
    neutral = replace(GLASS, admissible={"glass.shear_modulus": Admissible(26e9, 30e9, "Pa", "this glass")})
    stays = replace(explanation(neutral), x=np.array([0.15, 60e-9, 26e9]))
    assert Established.of(model(), stays, neutral, 0.9).admissible


def test_the_number_of_a_term_is_no_better_known_than_the_term() -> None:
    """A lead that is a term is right to 2 % of its resistance; the modulus of a glass is one of the model."""
    term: Any = SimpleNamespace()
    found = explanation(replace(LEADS, terms={"empty": (term,)}), GLASS)
    value, low, high = interval(model(), found, "bench.series_resistance")
    assert (value, high - value) == (0.15, pytest.approx(1.96 * math.hypot(0.01, 0.02 * 0.15)))
    assert low == pytest.approx(2.0 * value - high)
    assert interval(model(), found, "glass.shear_modulus")[2] == pytest.approx(25e9 + 1.96e8)


def test_a_number_that_the_end_of_its_range_holds_has_moved() -> None:
    free = settled(LEADS, off=0.003)
    local = made_problem(np.zeros(402), np.zeros((402, 2)), np.array([5e8, 1e-8]))
    held = replace(free, explanation=replace(free.explanation, free=(1, 2), local=local))
    assert evidence(model(), free, stated_fits(), Criteria()).z_scores == pytest.approx(
        {"bench.series_resistance": 15.0, "bench.series_inductance": 30.0})
    assert evidence(model(), held, stated_fits(), Criteria()).z_scores["bench.series_resistance"] == math.inf
    stays = replace(held, explanation=replace(held.explanation, x=np.array([0.0, 60e-9, 25e9])))
    assert evidence(model(), stays, stated_fits(), Criteria()).z_scores["bench.series_resistance"] == 0.0


def test_two_losses_of_one_material_have_one_share() -> None:
    """Which of them takes how much depends on which is asked first."""
    shear, bulk = (Effect(f"{each} loss of pla/acevedo_2026", "substrate", "loss", "", (
        Parameter(f"pla/acevedo_2026.{each}.loss", -5e7, -1e9, 0.0, None, "Pa"),)) for each in (
            "shear_modulus", "bulk_modulus"))
    every = (Established(shear, (estimate(shear.names[0], -1e8, "Pa", -5e7),), True, 0.947),
             Established(bulk, (estimate(bulk.names[0], -6e7, "Pa", -3e7),), True, 0.05))
    found = diagnosis("missing_physics", Evidence("leads", 9.0, ("a", "b")), established=every)
    assert found.headline == ("Pla has twice the stated loss (shear loss 0.1 GPa, stated 0.05); pla has twice the "
                              "stated loss (bulk loss 0.06 GPa, stated 0.03); this explains 99.7 % of the residual as "
                              "stated.")
    assert not [text for text in found.findings if "explain" in text]
    rows = established_table(found).rows
    assert [row[:2] for row in rows] == [("shear modulus loss of pla", "99.7 %, together"),
                                         ("bulk modulus loss of pla", "")]
    # An effect on another thing has a share of its own.
    found = made(found, established=(*every, replace(TOLD, share=0.002)))
    assert [share for _, share in found.shares] == [pytest.approx(0.997), 0.002]
    assert [row[1] for row in established_table(found).rows if row[1]] == ["99.7 %, together", "0.2 %"]


def test_a_material_is_marked_wherever_it_is() -> None:
    loss = Effect("shear_modulus loss of pla/acevedo_2026", "substrate", "loss", "", (
        Parameter("pla/acevedo_2026.shear_modulus.loss", -5e7, -1e9, 0.0, None, "Pa"),))
    found = diagnosis("missing_physics", Evidence("leads", 9.0, ("loss",)),
                      established=(Established(loss, (), True, 0.9),))
    pla, glass = SimpleNamespace(name="pla/acevedo_2026"), SimpleNamespace(name="glass/maker")
    states: Any = found.states
    for each in states:
        each.materials = {"substrate": pla, "sidewall": pla, "superstrate": glass}
    assert found.where == ("substrate", "sidewall")
    # A term acts in its own regions only.
    term: Any = SimpleNamespace(region="sidewall")
    found = made(found, established=(Established(replace(loss, terms={"empty": (term,)}), (), True, 0.9),))
    assert found.where == ("sidewall",)
    assert made(found, established=(TOLD,)).where == ("bench",)


def test_a_share_is_of_the_mismatch_as_stated() -> None:
    """Whatever the known parameters take of it; and one that they take by leaving their priors is still one."""
    found, points = explanation(off=0.01), 402
    before, after = points * stated_fits()[0].reduced, 0.5 * points * 25.0
    pulled = replace(found, local=replace(found.local, offset=np.array([0.0, 0.0, 1e9])))
    for each, square in ((found, 0.0), (pulled, 100.0)):
        assert explained_share(model(), stated_fits(), each) == pytest.approx(
            (before - after - square) / (before - points), rel=1e-9)
    assert explained_share(model(), stated_fits(0.001), found) == 0.0


def test_suspect_places_are_what_would_improve_an_explanation() -> None:
    nothing = np.zeros((402, 0))
    mode = Mode((0,), 1.234e6, 80.0, 5)
    outside = (Alternative(Hypothesis(region="cavity"), 8.0, nothing),
               Alternative(Hypothesis(modes=(mode,)), 2.0, nothing),
               Alternative(Hypothesis(region="bond"), -1.0, nothing))
    assert [each.record for each in outside] == [
        {"region": "cavity", "kind": "anything", "sigmas": 4.0, "modes": [], "evidence": 8.0},
        {"region": "mode", "kind": "mode", "sigmas": 2.0, "modes": ["1.2340 MHz, Q about 80"], "evidence": 2.0},
        {"region": "bond", "kind": "anything", "sigmas": 0.0, "modes": [], "evidence": -1.0}]


def test_the_record_keeps_its_keys_and_is_json() -> None:
    glass = Evidence("shear modulus of glass", 8.0, (GLASS.name,))
    found = diagnosis_record(diagnosis("ambiguous", Evidence("leads", 9.0, ("leads",)), (glass,)))
    assert set(found) >= {
        "campaign", "verdict", "effects", "moved_parameters", "rivals", "location", "before", "known_parameters_only",
        "after", "held_out", "next_measurement", "detection_limits", "scores", "refits", "findings", "seconds",
        "left", "taken", "undone", "headline"}
    again = json.loads(json.dumps(found, allow_nan=False))
    assert again["effects"][0]["share"] == 0.97
    assert again["effects"][0]["parameters"]["bench.series_inductance"]["unit"] == "H"
    assert again["rivals"] == [{"effects": [GLASS.name], "name": GLASS.name, "behind": 1.0, "parameters": {
        "glass.shear_modulus": [25e9, pytest.approx(25e9 - 1.96e8), pytest.approx(25e9 + 1.96e8)]}}]
    held = again["held_out"]["filled"]["after"]
    assert held["reduced_chi_square"] == pytest.approx(0.003**2 / 0.002**2 / 2, rel=1e-9)
    assert again["before"]["empty"]["rms_log_residual"] == pytest.approx(0.3, rel=1e-9)
    assert again["taken"][0]["source"] == "campaign.toml"
    assert again["left"] == {"rms": 0.003, "noise": 0.0028, "inflation": 1.1, "inhomogeneity": 0.001, "region": ""}


def test_summary_and_dataset_hold_what_was_found() -> None:
    found = diagnosis("missing_physics", Evidence("leads", 9.0, ("leads",)))
    rows = {row[0]: row[1] for row in found.summary().rows}
    assert (rows["verdict"], rows["bench.series_inductance"]) == ("missing physics", "60 (54 to 66) nH")
    data = found.to_xarray()
    assert data["rms_log_residual"].sel(stage="effects", state="filled").item() == pytest.approx(0.003, rel=1e-9)
    assert data.attrs == {"verdict": "missing_physics", "effects": "leads"}


@pytest.mark.parametrize("chosen", [NOTHING, Evidence("leads", 9.0, ("leads",))])
def test_a_diagnosis_is_read_at_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, chosen: Evidence
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    found = diagnosis("missing_physics" if chosen.effects else "parameters_explain", chosen)
    print_diagnosis(found)
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    assert " ".join(said.split()).startswith(found.headline)
    assert ("0.97" in said or "97 %" in said) == bool(chosen.effects)


def test_the_report_begins_with_the_headline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.report.diagnosis._pictures", lambda *_of: [])
    monkeypatch.setattr("workbench.report.diagnosis.origin_table", lambda _origin: "")
    found = diagnosis("missing_physics", Evidence("leads", 9.0, ("leads",)))
    page = write_diagnosis_report(found, [], tmp_path).read_text()
    assert page.index(found.headline) < page.index("<table>")
    # The odds of every hypothesis, from their logarithm, and what was taken as known.
    assert f"<td>{math.exp(6.0):.3g}</td>" in page
    assert "<td>couplant.thickness</td><td>0.001</td><td>mm</td><td>campaign.toml</td>" in page
