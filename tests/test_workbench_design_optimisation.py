"""Optima of goals: on functions whose optimum is known, with bounds whose multipliers are known, on steps and stock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import STACK, with_fields

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from workbench.design.descent import descend, evolve, round_to_grid
from workbench.design.evaluation import Evaluation
from workbench.design.goal import DesignObjective, Goal, Robust, SearchOptions, read_goal
from workbench.design.modelling import box_about, sides_within
from workbench.design.nonlinear_programme import NonlinearProgramme, ScenarioSample
from workbench.design.optimisation import optimise
from workbench.design.requirement import parse_bounds
from workbench.design.search import attempt, front, optima, search_all
from workbench.design.variables import MaterialChoice, VariedNumber, changed
from workbench.files.errors import InputError
from workbench.files.quantities import ProgramSource
from workbench.jobs.progress import Progress
from workbench.jobs.workers import Workers
from workbench.model.drive import VoltageDrive
from workbench.reduced.ranges import NotCovered

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
#: Millimetres of three lengths at which the made-up energy density is largest.
TOP = {"substrate.thickness": 0.83, "sidewall.thickness": 0.74, "superstrate.thickness": 1.04}
SUBSTRATE, SIDEWALL, SUPERSTRATE = TOP


def figures_at(
    lengths: Mapping[str, float], *, gain: float = 1.0
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Made-up figures of lengths (m), and their derivatives (1/m) by name.

    ln e_ac falls with the square of the distance from TOP, in 0.1 mm; f0 falls with the substrate, the heating rises
    with e_ac's square root; a trap's offset is the sidewall's distance from 0.72 mm.
    """
    off = {name: (lengths.get(name, 1e-3 * top) - 1e-3 * top) / 1e-4 for name, top in TOP.items()}
    e_ac = gain * 100.0 * math.exp(-sum(each**2 for each in off.values()))
    slopes = {name: -2.0 * each / 1e-4 for name, each in off.items()}
    substrate, sidewall = lengths.get(SUBSTRATE, 0.85e-3), lengths.get(SIDEWALL, 0.72e-3)
    figures = {"e_ac": e_ac, "f0": 1e6 * 0.85e-3 / substrate, "trap_offset": sidewall - 0.72e-3,
               "heating": math.sqrt(e_ac)}
    return figures, {"e_ac": {n: e_ac * s for n, s in slopes.items()}, "f0": {SUBSTRATE: -figures["f0"] / substrate},
                     "trap_offset": {SIDEWALL: 1.0}, "heating": {n: 0.5 * figures["heating"] * s
                                                                 for n, s in slopes.items()}}


@dataclass(frozen=True)
class Hill:
    """An evaluator of the made-up figures, lengths not given being those of ``base`` (m); nothing is known of
    substrates above ``nothing_above`` (m), and ``jump`` adds to ln e_ac where the sidewall is above 0.7 mm."""

    names: tuple[str, ...] = tuple(TOP)
    base: Mapping[str, float] = field(default_factory=dict)
    nothing_above: float = math.inf
    jump: float = 0.0
    gain: float = 1.0
    figures: tuple[str, ...] = ("e_ac", "f0", "trap_offset", "heating")

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        figures, slopes = figures_at({**self.base, **values}, gain=self.gain)
        factor = math.exp(self.jump) if values.get(SIDEWALL, 0.0) > 0.7e-3 else 1.0
        figures["e_ac"] *= factor
        slopes["e_ac"] = {name: factor * each for name, each in slopes["e_ac"].items()}
        missing = {}
        if values.get(SUBSTRATE, 0.0) > self.nothing_above:
            figures, missing = dict.fromkeys(figures, math.nan), dict.fromkeys(figures, "no resonance")
        table = {name: np.array([slopes[name].get(each, 0.0) for each in self.names]) for name in figures}
        return Evaluation(dict(values), figures, missing, figures["f0"], 0.0, table if gradient else None)


def programme(*texts: str, step: float | None = None, hill: Hill | None = None, **ranges: tuple[float, float]
              ) -> NonlinearProgramme:
    """The made-up hill over substrate and sidewall, 0.7 to 0.9 mm and 0.65 to 0.8 mm unless told otherwise."""
    chip = read_chip(CHIPS / "reference_chip.toml")
    lengths = {name: each.value for name, each in chip.dimensions().items()}
    own_names = {each: each for each in lengths}
    bounds = tuple(bound for text in texts for bound in parse_bounds(
        text, own_names, chip.regions, VoltageDrive(), source="test", field="bound"))
    low, high = ranges.get("substrate", (0.7, 0.9))
    variables = (VariedNumber(SUBSTRATE, 1e-3 * low, 1e-3 * high, step),
                 VariedNumber(SIDEWALL, 0.65e-3, 0.8e-3, step))
    return NonlinearProgramme(hill or Hill(), variables, DesignObjective("e_ac", maximise=True), bounds, lengths)


#: The transducer of the reference chip makes a little energy, within the rounding of its losses, and says so.
pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

# ---------------------------------------------------------------------------------------------------------------------


def test_a_descent_ends_at_the_top() -> None:
    one = programme()
    found = descend(one, np.array([0.05, 0.95]), evaluations=60)
    assert found.stationary
    # The objective is quadratic: its last change of 1e-6 leaves 1e-3 of the width of the hill, 0.1 mm.
    for name in (SUBSTRATE, SIDEWALL):
        assert 1e3 * found.point.lengths[name] == pytest.approx(TOP[name], abs=1e-4)


def test_the_multiplier_of_a_bound_is_what_its_relaxation_buys() -> None:
    # f0 >= 1.1 MHz keeps the substrate below 0.7727 mm. There ln e_ac = -((0.7727 - 0.83) / 0.1)^2 + ..., and one
    # scale of the bound, 1.1 MHz, moves the substrate by its own length: the multiplier is 2 * 0.573 * 7.727.
    substrate = 0.85 / 1.1
    found = descend(programme("f0 >= 1.1 MHz"), np.array([0.1, 0.1]), evaluations=60)
    assert found.feasible
    assert found.stationary
    assert 1e3 * found.point.lengths[SUBSTRATE] == pytest.approx(substrate, abs=1e-5)
    expected = 2.0 * (0.83 - substrate) / 0.1 * substrate / 0.1
    assert found.multipliers.bounds == pytest.approx([expected], rel=1e-3)
    # And it is what it says: the limit one thousandth lower.
    relaxed = descend(programme("f0 >= 1.0989 MHz"), np.array([0.1, 0.1]), evaluations=60)
    assert found.point.objective - relaxed.point.objective == pytest.approx(1e-3 * expected, rel=0.02)


def test_the_multiplier_of_the_end_of_a_range() -> None:
    found = descend(programme(substrate=(0.7, 0.8)), np.array([0.5, 0.5]), evaluations=60)
    assert found.point.x[0] == pytest.approx(1.0, abs=1e-9)
    # 0.1 mm from end to end, 0.03 mm from the top.
    assert found.multipliers.high == pytest.approx([2.0 * 0.3, 0.0], rel=1e-3)
    assert not found.multipliers.low.any()


def test_lengths_are_bounded_by_sums_of_them() -> None:
    found = descend(programme("substrate.thickness + sidewall.thickness <= 1.5 mm"), np.array([0.2, 0.2]),
                    evaluations=60)
    # From (0.83, 0.74) straight back by 0.07 mm in all.
    assert 1e3 * found.point.lengths[SUBSTRATE] == pytest.approx(0.795, abs=1e-4)
    assert 1e3 * found.point.lengths[SIDEWALL] == pytest.approx(0.705, abs=1e-4)


def test_a_descent_comes_back_from_where_there_are_no_figures() -> None:
    # The hill's top is not there: the best point is at the edge of what is known, and no multiplier holds it.
    found = descend(programme(hill=Hill(nothing_above=0.80e-3)), np.array([0.1, 0.5]), evaluations=100)
    assert found.point.exists
    assert 0.79e-3 < found.point.lengths[SUBSTRATE] <= 0.80e-3
    assert not found.stationary


def test_a_descent_crosses_a_jump_and_goes_on() -> None:
    found = descend(programme(hill=Hill(jump=0.5)), np.array([0.5, 0.05]), evaluations=100)
    assert 1e3 * found.point.lengths[SIDEWALL] == pytest.approx(0.74, abs=1e-3)


def test_a_start_without_any_figures_says_so() -> None:
    found = descend(programme(hill=Hill(nothing_above=0.0)), np.array([0.5, 0.5]), evaluations=20)
    assert not found.point.exists
    assert found.point.missing == "e_ac: no resonance"
    assert found.point.violation == math.inf
    assert not found.stationary


def test_slopes_are_differences() -> None:
    for one in (programme("f0 >= 1 MHz", "trap_offset within 50 um of 0 um"),
                replace(programme("heating <= 5 K"), scenarios=ScenarioSample(
                    tuple({SUBSTRATE: 1e-5 * k, SIDEWALL: -2e-6 * k} for k in range(-4, 6)), 0.25))):
        x, step = np.array([0.4, 0.3]), 1e-6
        point = one(x)
        for k, unit in enumerate(np.eye(2)):
            ahead, behind = one(x + step * unit), one(x - step * unit)
            # Central differences: rounding of 1e-16 over a step of 1e-6.
            assert point.slope[k] == pytest.approx((ahead.objective - behind.objective) / (2 * step), rel=1e-6)
            assert point.jacobian[:, k] == pytest.approx((ahead.margins - behind.margins) / (2 * step), rel=1e-6)


# ---------------------------------------------------------------------------------------------------------------------


def test_all_starts_find_the_one_optimum() -> None:
    one, search = programme("f0 >= 1.1 MHz"), SearchOptions(starts=10)
    found = optima(search_all(one, search, one.unknowns({SUBSTRATE: 0.85e-3, SIDEWALL: 0.72e-3}),
                              workers=Workers()))
    assert len(found[0].starts) == 10


def test_two_optima_are_told_apart_and_counted() -> None:
    @dataclass(frozen=True)
    class Two(Hill):
        """Two hills, the lower one at the other end of the substrate's range."""

        def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
            mirrored = {**values, SUBSTRATE: 1.56e-3 - values[SUBSTRATE]}
            one, other = Hill()(values, gradient=True), Hill(gain=0.8)(mirrored, gradient=True)
            if other.figures["e_ac"] <= one.figures["e_ac"]:
                return one
            turned = {name: each * np.array([-1.0, 1.0, 1.0]) for name, each in other.gradient.items()}
            return replace(other, gradient=turned)

    one = programme(hill=Two())
    found = optima(search_all(one, SearchOptions(starts=6, looked_at=1, descended=1), np.array([0.5, 0.5]),
                              workers=Workers()))
    assert len(found) == 2
    assert sorted([*found[0].starts, *found[1].starts]) == list(range(6))
    # The glass of 1 mm is 0.04 mm from the top.
    assert found[0].point.evaluation.figures["e_ac"] == pytest.approx(100.0 * math.exp(-0.16), rel=1e-4)
    assert found[1].point.evaluation.figures["e_ac"] == pytest.approx(80.0 * math.exp(-0.16), rel=1e-4)


def test_a_start_depends_on_its_number_and_the_seed_alone() -> None:
    one = programme()
    first, again = (attempt(one, SearchOptions(seed=3, looked_at=4), 5) for _ in range(2))
    assert np.array_equal(first.best.start, again.best.start)
    assert not np.array_equal(first.best.start, attempt(one, SearchOptions(seed=3, looked_at=4), 6).best.start)


@pytest.mark.parametrize("texts", [(), ("f0 >= 1.05 MHz",), ("substrate.thickness + sidewall.thickness <= 1.51 mm",)])
def test_steps_are_those_of_brute_force(texts: tuple[str, ...]) -> None:
    step = 0.04e-3
    one = programme(*texts, step=step)
    _, found = round_to_grid(one, descend(one, np.array([0.5, 0.5]), evaluations=60), evaluations=60)
    grid = [np.arange(math.ceil(each.low / step - 1e-9), math.floor(each.high / step + 1e-9) + 1) * step
            for each in one.variables]
    every = [one.holding({SUBSTRATE: float(a), SIDEWALL: float(b)})(np.zeros(0)) for a, b in product(*grid)]
    best = min(every, key=lambda each: each.rank)
    assert found.point.rank == pytest.approx(best.rank, abs=1e-9)


def test_the_rest_is_optimal_beside_a_step() -> None:
    one = programme()
    one = replace(one, variables=(replace(one.variables[0], step=0.05e-3), one.variables[1]))
    held, found = round_to_grid(one, descend(one, np.array([0.5, 0.5]), evaluations=60), evaluations=60)
    assert held.fixed[SUBSTRATE] == pytest.approx(0.85e-3, abs=1e-12)
    assert 1e3 * found.point.lengths[SIDEWALL] == pytest.approx(0.74, abs=1e-3)


def test_one_model_finds_the_stock_of_brute_force() -> None:
    values = (0.7e-3, 0.78e-3, 0.9e-3)
    one = programme("f0 >= 1.05 MHz", step=0.02e-3)
    one = replace(one, variables=(VariedNumber(SUBSTRATE, values[0], values[-1]), one.variables[1]))
    found = search_all(one, SearchOptions(), np.array([0.5, 0.5]), workers=Workers(),
                       stock=[{SUBSTRATE: each} for each in values])
    best = min((each.best for each in found), key=lambda each: each.point.rank)
    assert len(found) == 3
    assert best.point.lengths[SUBSTRATE] == 0.78e-3
    # The top of the hill is on a step.
    held, _ = round_to_grid(one.holding({SUBSTRATE: 0.78e-3}), best, evaluations=60)
    assert held.held[SIDEWALL] == pytest.approx(0.74e-3, abs=1e-9)


def test_an_evolution_without_slopes_finds_the_top_on_its_steps() -> None:
    one = programme("f0 >= 1.05 MHz", step=0.02e-3)
    found = evolve(one, np.array([0.1, 0.1]), population=16, generations=12, seed=0)
    assert found.lengths == pytest.approx({SUBSTRATE: 0.8e-3, SIDEWALL: 0.74e-3}, abs=1e-9)


def test_a_front_lies_between_its_two_optima() -> None:
    # Largest e_ac against smallest heating, its square root: every chip is on the front. Against f0, only those of a
    # substrate above the hill's top are.
    one = programme(substrate=(0.75, 0.95))
    objectives = (one.objective, DesignObjective("f0", maximise=False))
    found = [each.point for _, each in front(one, objectives, SearchOptions(), np.array([0.5, 0.5]), 16,
                                             workers=Workers())]
    substrates = np.array([each.lengths[SUBSTRATE] for each in found])
    assert len(found) == 16
    # By the first objective: from the hill's top on, thicker and thicker.
    assert np.all(np.diff(substrates) > 0.0)
    assert substrates[[0, -1]] == pytest.approx([0.83e-3, 0.95e-3], abs=1e-7)
    assert np.all([abs(each.lengths[SIDEWALL] - 0.74e-3) < 0.03e-3 for each in found])


# ---------------------------------------------------------------------------------------------------------------------


def test_boxes_keep_to_the_bounds() -> None:
    variables = (VariedNumber("a", 1.0, 2.0), VariedNumber("b", 1.0, 1.1))
    half_widths = {"a": 0.3, "b": 0.21}
    box = box_about({"a": 1.2, "b": 1.05}, half_widths, variables)
    assert box["a"] == pytest.approx((1.0, 1.6))
    assert box["b"] == pytest.approx((1.0, 1.1))
    box = box_about({"a": 1.5, "b": 1.0}, half_widths, variables)
    assert box["a"] == pytest.approx((1.2, 1.8))
    assert box["b"] == pytest.approx((1.0, 1.1))
    assert sides_within({"a": 1.8, "b": 1.1}, box, variables) == ("a",)


def lengths_of(chip: Chip) -> dict[str, float]:
    return {name: each.value for name, each in chip.dimensions().items()}


@dataclass(frozen=True)
class FakeSolver:
    """Models and full solves of the made-up figures; full ones give ``off`` times the energy density, and models whose
    ranges are wider than ``widest`` (m) are not covered. Glass of borosilicate is better."""

    off: float = 1.0
    widest: float = math.inf

    def model(self, chip: Chip, ranges: Mapping[str, tuple[float, float]], progress: object) -> Hill:
        if max(high - low for low, high in ranges.values()) > self.widest:
            raise NotCovered(FakeModel())
        for name, (low, high) in ranges.items():
            assert low <= chip.dimensions()[name].value <= high
        return Hill(tuple(ranges), lengths_of(chip), gain=self.gain(chip))

    def full(self, chip: Chip) -> Evaluation:
        figures, _ = figures_at(lengths_of(chip), gain=self.off * self.gain(chip))
        return Evaluation({}, figures, {}, figures["f0"], 0.0)

    @staticmethod
    def gain(chip: Chip) -> float:
        return 1.3 if chip.layer("superstrate").material.startswith("borosilicate") else 1.0


@dataclass(frozen=True)
class FakeModel:
    """What is told of a range model that did not do."""

    error: float = 1.0
    rank: int = 1
    relative_error: float = 1e-3
    solves: int = 1

    @property
    def reduced(self) -> FakeModel:
        return self


def goal(*variables: VariedNumber | MaterialChoice, texts: tuple[str, ...] = (), **changes: object) -> Goal:
    chip = read_chip(CHIPS / "reference_chip.toml")
    own = {SUBSTRATE: {"from": 0.76e-3, "to": 0.9e-3, "step": 20e-6}, SIDEWALL: {"from": 0.65e-3, "to": 0.8e-3}}
    found = Goal(chip, own, maximise="e_ac", constraints=texts, state="filled", frequency="f0",
                 source=ProgramSource("goal.toml"),
                 search={"starts": 4, "looked_at": 4, "descended": 1})
    return with_fields(found, **({"variables": variables} if variables else {}), **changes)


def test_a_goal_ends_in_a_confirmed_chip(tmp_path: Path) -> None:
    said: list[str] = []
    report: Progress = lambda text, share: said.append(text)  # noqa: E731
    kept: list[float] = []
    found = optimise(goal(texts=("f0 >= 1.05 MHz",)), solver=FakeSolver(), progress=report,
                     keep=lambda chip, point: kept.append(point.objective))
    assert found.best is not None
    assert found.best.accepted
    chip = found.best.chip
    # Multiples of 20 um below 0.8095 mm.
    assert chip.layer("substrate").thickness.value == pytest.approx(0.80e-3, abs=1e-12)
    assert 1e3 * chip.layer("sidewall").thickness.value == pytest.approx(TOP[SIDEWALL], abs=1e-3)
    assert chip.layer("substrate").thickness.note == "by goal.toml"
    assert found.best.after.figures["f0"] >= 1.05e6 > found.before.figures["f0"]
    assert found.chosen.at_best == 4
    assert [each.text for each in found.best.candidate.active] == ["f0 >= 1.05 MHz"]
    assert {"model", "starts", "steps", "full solve"} <= {text.rpartition(": ")[2] for text in said}
    assert kept == sorted(kept, reverse=True)
    assert read_chip(write_chip(chip, tmp_path / "best.toml")).layers == chip.layers


def test_an_optimum_that_a_full_solve_contradicts_is_rejected() -> None:
    found = optimise(goal(), solver=FakeSolver(off=1.02))
    assert found.best is None
    assert found.why_not == "rejected: the full solve and the model differ by 2 % in e_ac"
    assert optimise(goal(), solver=FakeSolver(off=1.005)).best is not None


def test_what_cannot_be_kept_is_said() -> None:
    found = optimise(goal(texts=("f0 >= 2 MHz",)), solver=FakeSolver())
    assert found.best is None
    assert found.why_not == "no point keeps all constraints; the nearest one breaks f0 >= 2 MHz"


def test_models_move_to_where_the_optimum_is() -> None:
    # Bounds from 0.5 to 0.85 mm of a sidewall of 0.72 mm, models of 2 % to either side: the top is at 0.74 mm.
    task = goal(VariedNumber(SUBSTRATE, 0.5e-3, 1.2e-3), VariedNumber(SIDEWALL, 0.5e-3, 0.85e-3))
    task = with_fields(task, search=replace(task.search, reach=0.02, moves=5))
    found = optimise(task, solver=FakeSolver())
    assert found.searched[0].models > 1
    assert not found.searched[0].open_sides
    assert 1e3 * found.best.chip.layer("sidewall").thickness.value == pytest.approx(TOP[SIDEWALL], abs=1e-3)
    # Without moves it says where it stopped.
    stopped = optimise(with_fields(task, search=replace(task.search, moves=0)), solver=FakeSolver())
    assert stopped.searched[0].open_sides == (SUBSTRATE, SIDEWALL)
    assert any("that a model covered" in each.text for each in stopped.best.candidate.active)


def test_a_box_that_no_model_covers_is_halved() -> None:
    found = optimise(goal(), solver=FakeSolver(widest=0.08e-3))
    assert found.best is not None
    with pytest.raises(NotCovered):
        optimise(goal(), solver=FakeSolver(widest=1e-6))


def test_stock_and_materials_are_those_of_brute_force() -> None:
    glass = ("soda_lime_glass/independent_reference", "borosilicate_glass")
    stock = (0.5e-3, 1.0e-3, 1.1e-3)
    task = goal(VariedNumber(SIDEWALL, 0.65e-3, 0.8e-3), VariedNumber.listed(SUPERSTRATE, stock),
                MaterialChoice("superstrate", glass))
    found = optimise(task, solver=FakeSolver())
    assert len(found.searched) == 6
    solver = FakeSolver()
    every = {(thickness, name): solver.full(changed(task.chip, {SUPERSTRATE: thickness, SIDEWALL: 0.74e-3},
                                                    {"superstrate": name})).figures["e_ac"]
             for thickness, name in product(stock, glass)}
    thickness, name = max(every, key=lambda key: every[key])
    assert found.best.chip.layer("superstrate").thickness.value == thickness
    assert found.best.chip.layer("superstrate").material == name
    assert found.best.after.figures["e_ac"] == pytest.approx(max(every.values()), rel=1e-4)


def test_stock_alone_needs_no_model() -> None:
    found = optimise(goal(VariedNumber.listed(SUPERSTRATE, (0.5e-3, 1.0e-3, 1.1e-3))), solver=FakeSolver())
    assert found.best.candidate.lengths == {SUPERSTRATE: 1.0e-3}


def test_an_evolutionary_goal_takes_stock_on_one_model() -> None:
    task = goal(VariedNumber(SIDEWALL, 0.65e-3, 0.8e-3), VariedNumber.listed(SUPERSTRATE, (0.9e-3, 1.0e-3, 1.2e-3)))
    task = with_fields(task, search=replace(task.search, evolutionary=True, population=10, generations=8))
    found = optimise(task, solver=FakeSolver())
    assert len(found.searched) == 1
    assert found.best.candidate.lengths[SUPERSTRATE] == 1.0e-3
    # A descent follows the population.
    assert 1e3 * found.best.candidate.lengths[SIDEWALL] == pytest.approx(TOP[SIDEWALL], abs=1e-4)


def test_a_front_is_confirmed_at_its_ends_and_its_knee() -> None:
    task = goal(VariedNumber(SUBSTRATE, 0.76e-3, 0.95e-3), VariedNumber(SIDEWALL, 0.65e-3, 0.8e-3))
    task = with_fields(task, objectives=(*task.objectives, DesignObjective("f0", maximise=False)),
                   search=replace(task.search, evolutionary=True, population=12, generations=8))
    found = optimise(task, solver=FakeSolver())
    confirmed = [hasattr(each, "accepted") for each in found.front]
    assert confirmed[0]
    assert confirmed[-1]
    assert 2 <= sum(confirmed) <= 3
    # Its ends are the optima of each objective alone.
    first, last = found.front[0].candidate, found.front[-1].candidate
    assert 1e3 * first.lengths[SUBSTRATE] == pytest.approx(TOP[SUBSTRATE], abs=1e-3)
    assert last.lengths[SUBSTRATE] == pytest.approx(0.95e-3, abs=1e-7)
    assert found.best is not None


def test_a_robust_optimum_keeps_away_from_a_bound() -> None:
    # f0 >= 1.05 MHz holds for the substrate below 0.8095 mm; with 10 um of tolerance, uniform, 95 % of the chips keep
    # it 9 um below that.
    base = goal(texts=("f0 >= 1.05 MHz",))
    layers = tuple(replace(each, thickness=replace(each.thickness, tolerance=10e-6)) if each.region == "substrate"
                   else each for each in base.chip.layers)
    task = with_fields(base, chip=replace(base.chip, layers=layers), robust=Robust(0.05, samples=400),
                   variables=(VariedNumber(SUBSTRATE, 0.76e-3, 0.9e-3), VariedNumber(SIDEWALL, 0.65e-3, 0.8e-3)))
    nominal = optimise(with_fields(task, robust=None), solver=FakeSolver()).best.candidate.lengths[SUBSTRATE]
    robust = optimise(task, solver=FakeSolver()).best.candidate.lengths[SUBSTRATE]
    assert 1e3 * nominal == pytest.approx(0.85 / 1.05, abs=1e-4)
    # The quantile of 400 samples is known to a tenth of the tolerance.
    assert nominal - robust == pytest.approx(9e-6, abs=1e-6)
    with pytest.raises(InputError, match="a chip file with tolerances"):
        optimise(with_fields(task, chip=base.chip), solver=FakeSolver())


def test_the_quantile_is_the_one_of_numpy() -> None:
    losses: NDArray[np.float64] = np.random.default_rng(0).normal(size=33)
    for quantile in (0.05, 0.2, 0.5):
        spread = ScenarioSample(({"a": 0.0},) * 33, quantile)
        assert spread.weights(losses) @ losses == pytest.approx(np.quantile(losses, 1.0 - quantile), rel=1e-12)
    assert ScenarioSample(({"a": 0.0},) * 33, None).weights(losses) @ losses == pytest.approx(losses.mean())


@pytest.mark.slow
def test_a_real_stack_is_optimised_and_confirmed(tmp_path: Path) -> None:
    (tmp_path / "stack.toml").write_text(STACK, encoding="utf-8")
    (tmp_path / "goal.toml").write_text("""
        [goal]
        chip = "stack.toml"
        minimise = "z_min"
        constraints = ["f0 within [350 kHz, 420 kHz]"]
        [variables]
        sample.thickness = { from = "0.9 mm", to = "1.1 mm", step = "20 um" }
        [search]
        starts = 3
        looked_at = 4
        """, encoding="utf-8")
    found = optimise(read_goal(tmp_path / "goal.toml"), accuracy=5e-3)
    assert found.best is not None, found.why_not
    # What is confirmed to 1 % is right to the tolerance of the model, 0.1 %, a few times over.
    assert max(found.best.differences.values()) < 5e-3
    assert found.best.after.figures["z_min"] < found.before.figures["z_min"]
    assert found.chosen.at_best == 3


# ---------------------------------------------------------------------------------------------------------------------

GOAL = """
[goal]
chip = "chip.toml"
drive = "1 W"
maximise = "e_ac"
constraints = ["f0 within [0.95 MHz, 1.1 MHz]", "heating <= 5 K", "substrate.radius - cavity.radius >= 0.8 mm"]
[variables]
substrate.thickness = { from = "0.76 mm", to = "0.94 mm", step = "20 um" }
"sidewall.thickness" = { from = "0.65 mm", to = "0.80 mm" }
superstrate.thickness = { values = ["1.0 mm", "0.5 mm"] }
superstrate.material = { materials = ["soda_lime_glass", "borosilicate_glass"] }
sidewall.radius = { from = "12 mm", to = "14 mm" }
[thermal]
all = "12 K/W"
cavity = "3 K/W"
[robust]
quantile = "10 %"
[search]
starts = 4
"""


def written(text: str, folder: Path) -> Path:
    write_chip(read_chip(CHIPS / "reference_chip.toml"), folder / "chip.toml")
    path = folder / "goal.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_goal_is_read(tmp_path: Path) -> None:
    found = read_goal(written(GOAL, tmp_path))
    assert found.state == "filled"
    assert str(found.operation.drive).startswith("1 W")
    assert found.operation.thermal_resistance == {"": 12.0, "cavity": 3.0}
    assert [each.name for each in found.lengths] == [SUBSTRATE, SIDEWALL, "substrate.radius"]
    assert found.lengths[0].step == pytest.approx(20e-6)
    assert found.stock[0].values == pytest.approx((0.5e-3, 1.0e-3))
    assert found.figures == ("peak_frequency", "e_ac", "f0", "heating")
    assert found.operation.frequency == "energy"
    assert len(found.bounds) == 4
    assert found.robust == Robust(0.1)
    assert found.search.starts == 4


@pytest.mark.parametrize(("old", "new", "field", "expected"), [
    ('"chip.toml"', '"chop.toml"', "goal.chip", "did you mean 'chip.toml'"),
    ('"e_ac"', '"e_av"', "goal.maximise", "did you mean 'e_ac'"),
    ('maximise = "e_ac"', 'maximise = "trap_offset"', "goal.maximise", "above zero; bound trap_offset"),
    ('maximise = "e_ac"', "", "goal", "two figures give a Pareto front"),
    ('maximise = "e_ac"', 'maximise = ["e_ac", "p0"]\nminimise = "heating"', "goal", "two figures"),
    ('"1 W"', '"1 w"', "goal.drive", '"10 Vpp @ 50 ohm"'),
    ("heating <= 5 K", "heating <= 5 mm", "heating <= 5 mm", "a temperature difference"),
    ("heating <= 5 K", "heatin <= 5 K", "goal.constraints[1]", "did you mean 'heating'"),
    ("heating <= 5 K", "f0 within 5 kHz", "goal.constraints[1]", 'a centre, "within ... of ..."'),
    ("heating <= 5 K", "e_ac >= 20 J/m^3 at 10 Vpp", "goal.constraints[1]", "the drive of the goal, 1 W"),
    ("heating <= 5 K", "trap_offset <= 0 um", "goal.constraints[1]", "within 50 um of 0 um"),
    ("[0.95 MHz, 1.1 MHz]", "[1.1 MHz, 0.95 MHz]", "goal.constraints[0]", "a lower end, then a higher one"),
    ("substrate.radius - cavity", "substrate.radius - cavty", "goal.constraints[2]", "did you mean 'cavity.radius'"),
    ("substrate.radius - cavity.radius", "substrate.radius * 2", "goal.constraints[2]", "lengths with + or -"),
    ('substrate.thickness =', 'substrat.thickness =', "variables.substrat.thickness", "'substrate.thickness'"),
    ('to = "0.94 mm"', 'to = "0.7 mm"', "variables.substrate.thickness.to", "above that of 'from', 0.76 mm"),
    ('step = "20 um"', 'step = "20"', "variables.substrate.thickness.step", "a length in one of"),
    ('step = "20 um"', 'step = "0.2 mm"', "variables.substrate.thickness.step", "at most 0.18 mm"),
    ('"1.0 mm", "0.5 mm"', '"1.0 mm"', "superstrate.thickness.values", "two or more different lengths"),
    ('"borosilicate_glass"', '"borosilikate_glass"', "superstrate.material.materials", "did you mean 'borosilicate"),
    ("sidewall.radius =", 'substrate.radius = { from = "12 mm", to = "14 mm" }\nsidewall.radius =',
     "variables.sidewall.radius", "they change together"),
    ('cavity = "3 K/W"', 'cavitty = "3 K/W"', "thermal.cavitty", "did you mean 'cavity'"),
    ('all = "12 K/W"', 'all = "-12 K/W"', "thermal.all", "zero or more"),
    ('all = "12 K/W"\ncavity = "3 K/W"', "", "thermal", "that \"heating\" needs"),
    ('quantile = "10 %"', 'quantile = "1 %"', "robust.quantile", "one of 32 samples"),
    ("starts = 4", 'tolerance = "1 %"', "search.tolerance", "renamed to 'relative_error'"),
    ("starts = 4", "starts = 0", "search.starts", "a whole number from 1 to 1000"),
    ("starts = 4", 'reach = "120 %"', "search.reach", "between 0 and 100 %"),
    ('maximise = "e_ac"', 'minimise = "focus_time"', "goal.state", "a state that names a particle"),
    ('"0.5 mm"]', '"0.5 mm", "0.6 mm", "0.7 mm", "0.8 mm", "0.9 mm", "1.1 mm"]', "variables", "at most 12"),
])
def test_mistakes_in_goals_are_named(old: str, new: str, field: str, expected: str, tmp_path: Path) -> None:
    assert old in GOAL
    with pytest.raises(InputError) as caught:
        read_goal(written(GOAL.replace(old, new), tmp_path))
    assert field in str(caught.value)
    assert expected in str(caught.value)
