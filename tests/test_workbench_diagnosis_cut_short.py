"""A search whose time is over, that is interrupted, or of which a hypothesis cannot be tried: on made-up ends."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem

from workbench.campaign.state import state_fit
from workbench.catalogue.effect import Effect
from workbench.cli import main
from workbench.commands import diagnose as command
from workbench.diagnosis import inference
from workbench.diagnosis.conclusion import conclude
from workbench.diagnosis.conclusion import not_finished as cut_short
from workbench.diagnosis.decision import MISSING
from workbench.diagnosis.evidence import WrongEvidence
from workbench.diagnosis.findings import Candidate, Found, InitialOptimum, NotTried, Refitted
from workbench.diagnosis.inference import DiagnosisSearch
from workbench.diagnosis.likelihood import Hypothesis, LaplaceApproximation
from workbench.diagnosis.ranking import Score
from workbench.diagnosis.tasks import SearchTask
from workbench.diagnosis.weighting import Weighting
from workbench.fem.solve import NotConverged
from workbench.files.errors import InputError
from workbench.fitting.parameter import Parameter
from workbench.jobs.workers import Processes

SMALL, LARGE = (Effect(name, "bench", "bench", "", (Parameter(name, 0.0, -1.0, 1.0, None, "1"),))
                for name in ("small", "large"))
PARAMETERS = (*SMALL.parameters, *LARGE.parameters)
#: The one state: twenty points of unit noise, ten times as far off as stated.
STATE: Any = SimpleNamespace(name="disc", noise=np.ones(20), observation=None, data=2)
STATED = (state_fit("disc", np.full(20, 10.0 + 0j), np.ones(20, complex), STATE.noise),)
MODEL: Any = SimpleNamespace(
    effects=(SMALL, LARGE), parameters=PARAMETERS, known=0, hypotheses=4, index=[p.name for p in PARAMETERS].index,
    campaign=SimpleNamespace(fitted=(STATE,), held_out=()), free=lambda _effects: ([0, 1], []),
    bounds=lambda indices: (-np.ones(len(indices)), np.ones(len(indices))))
PLACE = np.zeros(2)
SMALL_CAMPAIGN = Path(__file__).parents[1] / "geometry" / "chips" / "small_campaign" / "campaign.toml"

#: Tasks before the one that fits the device as it is stated.
FITTED = 2

#: The reduced chi-square that each hypothesis leaves: only the large one explains, which no score promises.
LEFT = {"nothing": 10.0, "small": 9.9, "large": 0.1, "large and small": 0.1}


class Made(DiagnosisSearch):
    """A search that ends where it is told, whose time is over after `tasks`, or that is interrupted there where it
    `stops`; some methods `fail`, by their names and those of hypotheses."""

    tasks: float = math.inf
    stops = False
    fail: dict[tuple[str, str], Exception]
    done: list[str]

    #: Nothing is ever predicted.
    models: Any = SimpleNamespace(stated_rms=math.inf, stated=STATED)

    @property
    def is_over(self) -> bool:
        return self.interrupted or (not self.stops and len(self.done) >= self.tasks)

    @property
    def least_evidence(self) -> float:
        return 0.0

    def attempt(self, task: SearchTask) -> Any:
        if self.stops and not self.interrupted and len(self.done) >= self.tasks:
            raise KeyboardInterrupt
        self.done.append(task.method.__name__)
        return super().attempt(task)

    def initial_optima(self) -> tuple[list[InitialOptimum], Candidate]:
        self.run_tasks([SearchTask.of("a start", self.a_start)] * 2, must=1)
        return [InitialOptimum(PLACE, 1.0, PLACE)], candidate()

    def a_start(self) -> None:
        self._end("a_start", "nothing")

    def tangents(self, x: Any) -> Any:
        return ()

    def scored(self, refitted: Refitted, tangents: Any) -> Refitted:
        further = () if tangents is None or SMALL in refitted.hypothesis.effects else (
            Score(SMALL, 4.0, 2.0, np.array([0.5]), np.array([0.1])),)
        return replace(refitted, scores=further)

    def by_size(self, tangents: Any) -> list[Candidate]:
        self.run_tasks([SearchTask.of("large of any size", self.scan_effect, "large", "disc")])
        return self.searched([(SMALL, [PLACE]), (LARGE, [PLACE])])

    def scan_effect(self, name: str, state: str) -> list[InitialOptimum]:
        return []

    def candidate(self, name: str, starts: Sequence[Any]) -> Candidate:
        self._end("candidate", name)
        return candidate(next(effect for effect in MODEL.effects if effect.name == name))

    def with_own_inhomogeneity(self, refitted: Refitted) -> Refitted:
        return refitted

    def refit(self, candidate: Candidate, parts: Any = None, is_rough: bool = False) -> Refitted:
        hypothesis = candidate.hypothesis
        self._end("refit", hypothesis.name)
        # The small one has no size beside the large one.
        x = np.array([float(hypothesis.effects == (SMALL,)), float(LARGE in hypothesis.effects)])
        left, sign = LEFT[hypothesis.name], np.where(np.arange(20) % 2, 1.0, -1.0)
        local = made_problem(np.full(40, math.sqrt(left)), np.zeros((40, 2)), np.full(2, 100.0))
        log_ratio = (math.sqrt(2.0 * left) * sign + 0j,)
        found = made_explanation(local, x, hypothesis=hypothesis, states=(STATE,), log_ratio=log_ratio)
        return Refitted(found.weighted(Weighting.left((STATE,), log_ratio)))

    def _end(self, method: str, name: str) -> None:
        if (method, name) in self.fail:
            raise self.fail[method, name]


def candidate(*effects: Effect) -> Candidate:
    hypothesis = Hypothesis(effects)
    worth = -20.0 * LEFT[hypothesis.name]
    return Candidate(hypothesis, (LaplaceApproximation(PLACE, worth, PLACE, 9.0, 0.0),))


def searched(tasks: float = math.inf, *, stop: bool = False, fail: dict[tuple[str, str], Exception] | None = None
             ) -> tuple[Found, int]:
    """What a search of so many `tasks` comes to, and how many it did; the last begins with Ctrl-C where `stop`."""
    made = Made(MODEL)
    made.tasks, made.stops, made.fail, made.done = tasks, stop, fail or {}, []
    return made.run(), len(made.done)


def test_no_effect_is_added_to_an_explanation_that_has_as_many_as_are_looked_for(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search that only left such explanations out would ask for the next ones for ever."""
    monkeypatch.setattr(inference, "MOST_EFFECTS", 1)
    made = Made(MODEL)
    # Its time is over, so that nothing would be looked at that it wants to.
    made.tasks, made.fail, made.done = 0, {}, []
    found = [made.refit(candidate()), made.refit(candidate(LARGE))]
    assert made.with_further_effects(found) == found
    assert made.undone == []


@pytest.mark.parametrize("stop", [False, True])
def test_a_search_that_is_cut_short_has_not_looked_at_something_wherever_it_ends(stop: bool) -> None:
    """At every number of tasks: nothing is undone only where all was done that a whole search does."""
    whole, count = searched()
    assert (whole.undone, whole.interrupted) == ((), False)
    assert conclude(MODEL, whole).verdict == MISSING
    assert conclude(MODEL, whole).chosen.name == "large"
    assert searched(count)[0].undone == ()
    for tasks in range(count):
        if stop and tasks in (0, FITTED):
            # The device as stated is being fitted: nothing is known yet.
            with pytest.raises(KeyboardInterrupt):
                searched(tasks, stop=stop)
            continue
        found, _ = searched(tasks, stop=stop)
        assert found.undone, tasks
        assert found.interrupted == stop
        cut = cut_short(MODEL, found, conclude(MODEL, found))
        assert (cut.verdict, cut.chosen.name, cut.rivals) == ("not_finished", found.base.hypothesis.name, ())
        assert cut.chosen.is_null


def test_what_would_have_been_looked_at_after_the_end_is_told() -> None:
    steps = {found.undone[-1] for tasks in range(1, 10) for found in [searched(tasks)[0]]}
    assert "hypotheses of any size" in steps


REASONS: list[tuple[Exception, str]] = [
    (InputError("fit", "free", "e33.loss", "c33.loss free or not zero"), "received 'e33.loss'; expected c33.loss free"),
    (NotConverged(1e6, 1.0, np.zeros(1, complex)), "the solve at 1 MHz"), (ValueError("not admissible"), "admiss"),
    (np.linalg.LinAlgError("Singular matrix"), "Singular matrix"),
    (WrongEvidence(2.2e248, -312.0), "its evidence could not be computed: a log evidence of 2.2e\\+248, where the log "
                                     "likelihood is -312 "),
]


@pytest.mark.parametrize(("error", "reason"), REASONS)
@pytest.mark.parametrize(("method", "name"), [("candidate", "small"), ("refit", "large and small")])
def test_a_hypothesis_that_cannot_be_tried_is_told_and_the_others_go_on(
    error: Exception, reason: str, method: str, name: str
) -> None:
    found, _ = searched(fail={(method, name): error})
    (told,) = found.not_tried
    assert told.name == name
    assert re.search(reason, told.reason)
    assert found.undone == ()
    assert {each.hypothesis.name for each in found.final} == {"large", "large and small", "nothing"} - {
        name if method == "refit" else ""}


def test_a_defect_of_the_program_still_ends_all() -> None:
    with pytest.raises(KeyError, match="c33"):
        searched(fail={("candidate", "small"): KeyError("c33")})


@pytest.mark.parametrize("task", [("a_start", "nothing"), ("refit", "nothing")])
def test_where_the_device_as_stated_cannot_be_predicted_there_is_no_diagnosis(task: tuple[str, str]) -> None:
    with pytest.raises(InputError, match="no such mesh"):
        searched(fail={task: InputError("chip", "layers", "1", "no such mesh")})


class Slow:
    """A search of a worker that answers late, with what it was asked."""

    def attempt(self, task: SearchTask) -> Any:
        time.sleep(0.05)
        return task.arguments[0]


class Stopped(Made):
    """A search that is interrupted at its first task."""

    def attempt(self, task: SearchTask) -> Any:
        raise KeyboardInterrupt


def test_what_workers_still_send_after_an_interruption_is_taken_for_nothing_else() -> None:
    """The answer to a task that was given up is not that of the next one."""
    with closing(Processes(1)) as workers:
        workers.share(Slow)
        made = Stopped(MODEL)
        made.done, made._workers = [], workers
        first, second, third = (SearchTask.of(name, made.scan_effect, name, "disc")
                                for name in ("first", "second", "third"))
        assert made.run_tasks([first, second]) == [None, None]
        assert made.interrupted
        assert workers.map([third]) == ["third"]


def test_what_was_not_tried_is_told_once() -> None:
    assert NotTried("a", "b") == NotTried("a", "b")
    found, _ = searched(fail={("candidate", name): ValueError("no") for name in ("small", "large")})
    assert [each.name for each in found.not_tried] == ["small", "large"]
    assert [each.explanation.hypothesis.name for each in found.final] == ["nothing"]


def _ended(*_given: object, **_named: object) -> Any:
    raise KeyboardInterrupt


def test_a_diagnosis_that_is_stopped_at_once_leaves_what_it_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "diagnose", _ended)
    assert main(["diagnose", str(SMALL_CAMPAIGN), "-o", str(tmp_path / "out")]) == 130
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert (said["verdict"], said["effects"], said["undone"]) == ("not_finished", [], ["everything"])
    assert said["headline"].startswith("Not finished: it was stopped before its first result")
    assert said["read"]["filled"]["points"] == 121
    assert {each["name"] for each in said["taken"]} >= {"couplant.thickness", "bench.gain[filled]"}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<h1>Diagnosis, not finished: small chip</h1>" in page
    assert "by_size" not in page


@pytest.mark.parametrize(("interrupted", "status"), [(False, 3), (True, 130)])
def test_the_status_says_that_it_is_no_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interrupted: bool, status: int
) -> None:
    found = SimpleNamespace(provisional=object(), found=SimpleNamespace(interrupted=interrupted))
    monkeypatch.setattr(command, "diagnose", lambda *_given, **_named: found)
    for name in ("diagnosis_record", "contributions", "write_diagnosis_report", "print_diagnosis"):
        monkeypatch.setattr(command, name, lambda *_given: {})
    assert main(["diagnose", str(SMALL_CAMPAIGN), "-o", str(tmp_path / "out")]) == status
