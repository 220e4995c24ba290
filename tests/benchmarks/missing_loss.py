"""Is the loss missing from the paper's model of its water-filled chip thermoviscous, as the paper says?

Table 5 of Acevedo-Espinosa et al. (RP-UEIS) leaves two gaps between measurement and model. With water in the cavity 1/Q
is 2.0e-3 higher than modelled (3e-5 when empty), and filling moves f0 by -1.0 kHz where the model says +2.0 kHz. The
paper's explanation of the first, boundary layers and other losses in the water, has known constants and nothing to fit:
it is switched on here, on the reproduced chip and on chips of other dimensions, for the paper prints few of them. The
short form with public names alone is `examples/12_missing_loss.py`.

    .venv/bin/python tests/benchmarks/missing_loss.py [--draws 64] [--about 9] [--seed 1]

leaves ``out/missing_loss/report.html`` and a table of all draws after some minutes. What it can show is a bound
over the dimensions drawn, not a proof: the chip itself is not known.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.stats import qmc

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from paper_chip import RANGES as UNPRINTED  # noqa: E402
from paper_chip import chip_with  # noqa: E402

import geometry  # noqa: E402
from geometry.chip import Chip, read_chip  # noqa: E402
from geometry.names import CAVITY  # noqa: E402
from materials.kinds import Fluid  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import Solution  # noqa: E402
from workbench.files.errors import InputError  # noqa: E402
from workbench.model.problem import Problem, build, fill  # noqa: E402
from workbench.physics.boundary_layer import ADMISSIBLE  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.reduced.model import ReducedModel  # noqa: E402
from workbench.results.merit import Figures, NoResonance, figures  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402
from workbench.simulation.run import loss_budget  # noqa: E402

Real = NDArray[np.float64]

CHIP = Path(geometry.__file__).parent / "chips" / "acevedo_2026_chip.toml"
STATES = ("empty", "filled")
FREQUENCIES = np.linspace(0.99e6, 1.06e6, 281)

#: What takes up energy in the fluid, and its parameter that switches it off when zero.
CAUSES = {"viscous layer": "shear_viscosity", "thermal layer": "thermal_conductivity",
          "bulk absorption": "diffusivity_of_sound"}

#: Ranges drawn (m): the gel beside what is searched elsewhere (the paper: 20 um).
RANGES = {"couplant.thickness": (5e-6, 50e-6), **UNPRINTED}
#: A second round is drawn about this many of the worst, within this share of every range to either side.
WORST, ABOUT = 4, 0.08
#: So many of the largest by either measure are solved again on the fine mesh.
CHECKED = 2
#: A drawn chip is like the measured one if its f0, filled, is as close (Hz) and its Q within this factor.
LIKE_F0, LIKE_Q = 6e3, 1.5
#: Accuracy of Z that the mesh is made for: of the draws, and what the chip as reproduced is checked with.
COARSE, FINE = 5e-3, 5e-4
#: Of the reduced model's impedance, relative. The estimate is some ten times the error, and differences see less of it.
TOLERANCE = 1e-3


# --------------------------------------------------------------------------------------------------------------------
# What there is to explain


@dataclass(frozen=True)
class Gaps:
    """Measurement less model in Table 5.

    ``inverse_q`` of 1/Q by state; ``measured_shift`` and ``model_shift`` of f0 on filling (Hz); ``z_min_ratio``
    measured over modelled Z_min when filled.
    """

    inverse_q: Mapping[str, float]
    measured_shift: float
    model_shift: float
    z_min_ratio: float

    @property
    def shift(self) -> float:
        """What the model's shift of f0 (Hz) lacks."""
        return self.measured_shift - self.model_shift


def gaps(chip: Chip) -> Gaps:
    """The gaps between the two columns that the chip file reports of both states: measured, then the paper's model."""
    columns = {state: chip.state(state).reported for state in STATES}
    measured_shift, model_shift = (columns["filled"][k].f0 - columns["empty"][k].f0 for k in (0, 1))
    return Gaps({state: 1.0 / measured.q - 1.0 / model.q for state, (measured, model) in columns.items()},
                measured_shift, model_shift, columns["filled"][0].z_min / columns["filled"][1].z_min)


# --------------------------------------------------------------------------------------------------------------------
# What the fluid's known losses do


@dataclass(frozen=True, eq=False)
class Model:
    """A problem, and its reduced model over `frequencies` (Hz)."""

    problem: Problem
    reduced: ReducedModel
    frequencies: Real

    def figures(self, changed: Mapping[str, complex]) -> Figures:
        """f0, Z_min and Q with some parameters of the cavity's fluid changed.

        Raises:
            NoResonance: none in the band.
        """
        solution = self.reduced.solve(self.frequencies, self._values(changed))
        return figures(Spectrum.from_solver(self.frequencies, solution.impedance))

    def solution(self, frequency: float) -> Solution:
        """The reduced solution at one frequency (Hz)."""
        return self.reduced.solve(np.array([frequency]), self.problem.values)

    def _values(self, changed: Mapping[str, complex]) -> dict[str, complex]:
        name = self.problem.materials[CAVITY].name
        return {**self.problem.values, **{f"{name}.{key}": value for key, value in changed.items()}}


def reduced(problem: Problem, frequencies: Real = FREQUENCIES) -> Model:
    """The reduced model of a problem as it stands."""
    operators = assemble(problem.mesh, problem.terms)
    return Model(problem, reduce(operators, frequencies, problem.values, tolerance=TOLERANCE, first=2,
                                 confirmed=False), frequencies)


def model_of(chip: Chip, state: str, *, accuracy: float, changed: Mapping[str, complex] | None = None
             ) -> Model:
    """The model of a chip with boundary layers in its cavity, some parameters of the fluid `changed`."""
    problem = build(fill(chip, state, Registry()), band=(float(FREQUENCIES[0]), float(FREQUENCIES[-1])),
                    accuracy=accuracy)
    name = problem.materials[CAVITY].name
    return reduced(problem.with_values({f"{name}.{key}": value for key, value in (changed or {}).items()}))


@dataclass(frozen=True)
class Part:
    """What one cause does to a resonance.

    ``f0`` (Hz) and ``inverse_q``: by how much it moves the figures of the spectrum. ``dissipated`` its share of the
    dissipated power at f0 times 1/Q: the same 1/Q where the resonance stands alone, and never negative. Where others
    are close by, a loss may even narrow it.
    """

    f0: float
    inverse_q: float
    dissipated: float

    @property
    def largest(self) -> float:
        """The larger size of the two measures of 1/Q."""
        return max(abs(self.inverse_q), self.dissipated)


@dataclass(frozen=True)
class Breakdown:
    """The figures with all causes on, what each of them does, and the share of the chip's energy the fluid holds."""

    figures: Figures
    parts: Mapping[str, Part]
    fluid_share: float


def break_down(model: Model) -> Breakdown:
    """Switch the causes off, one at a time.

    Raises:
        NoResonance: none in the band.
    """
    on = model.figures({})
    solution = model.solution(on.f0)
    power = solution.dissipation()[0]
    total = float(solution.input_power()[0])
    fluid = fluid_of(model.problem)
    parts = {}
    for cause, key in CAUSES.items():
        off = model.figures({key: 0.0})
        own = [f"{fluid.name}.{key}" in integral.coefficient.parameters for integral in solution.operators.integrals]
        parts[cause] = Part(on.f0 - off.f0, 1.0 / on.q - 1.0 / off.q, float(power[own].sum()) / total / on.q)
    # The bulk absorbs w (loss tangent) 2 <W_pot>, the whole chip loses (w / Q) 2 <W_pot>.
    share = parts["bulk absorption"].dissipated / loss_tangent(fluid, on.f0)
    return Breakdown(on, parts, share)


def fluid_of(problem: Problem) -> Fluid:
    """What fills the cavity.

    Raises:
        InputError: no fluid.
    """
    fluid = problem.materials.get(CAVITY)
    if not isinstance(fluid, Fluid):
        raise InputError(problem.name, "cavity", "no fluid", "a cavity that holds a fluid")
    return fluid


def loss_tangent(fluid: Fluid, frequency: float) -> float:
    """Loss tangent of the fluid's compressibility at a frequency (Hz): w delta / c^2, delta the diffusivity of sound.

    Raises:
        InputError: a fluid without viscosities.
    """
    if fluid.diffusivity_of_sound is None:
        raise InputError(fluid.name, "shear_viscosity, bulk_viscosity", None, "a fluid whose viscosities are known")
    return 2.0 * math.pi * frequency * fluid.diffusivity_of_sound / fluid.sound_speed**2


def uniform_slip(chip: Chip, fluid: Fluid, frequency: float) -> float:
    """1/Q of the fluid alone if it slid along all walls as fast as it moves on average: (delta / 2) S / V.

    For scale, before the fluid's share of the energy. `delta` of `boundary_layer.ViscousBoundaryLayer`.
    """
    if fluid.shear_viscosity is None:
        raise InputError(fluid.name, "shear_viscosity", None, "a fluid whose viscosity is known")
    delta = math.sqrt(fluid.shear_viscosity / (math.pi * frequency * fluid.density))
    lengths = chip.dimensions()
    height = sum(layer.thickness.value for layer in chip.holes)
    return 0.5 * delta * (2.0 / height + 2.0 / lengths["cavity.radius"].value)


# --------------------------------------------------------------------------------------------------------------------
# What would do it instead


@dataclass(frozen=True)
class Instead:
    """What is changed until a gap is closed: by how much, and the figures of both states with it."""

    what: str
    amounts: tuple[float, ...]
    empty: Figures
    filled: Figures


def root(missing: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where `missing` is zero between `low` and `high`; NaN where it has the same sign at both ends."""
    if missing(low) * missing(high) > 0.0:
        return math.nan
    return float(scipy.optimize.brentq(missing, low, high, xtol=tolerance))


def instead(chip: Chip, wanted: Gaps, start: Mapping[str, Figures]) -> Iterator[Instead]:
    """What closes a gap: a loss of the water, a height of the cavity, a sound speed, and both of the liquid together.

    `start` holds the figures of both states with nothing changed. What closes no gap within its range is left out.
    """
    height = chip.dimensions()["sidewall.thickness"].value
    fluid = fluid_of(build(fill(chip, "filled", Registry()), accuracy=COARSE))
    omega = 2.0 * math.pi * start["filled"].f0

    @cache
    def higher(state: str, amount: float) -> Figures:
        made = chip.with_dimensions({"sidewall.thickness": height + amount})
        return model_of(made, state, accuracy=COARSE).figures({})

    @cache
    def liquid(faster: float, loss: float) -> Figures:
        changed = {"sound_speed": complex(fluid.sound_speed * (1.0 + faster)), "diffusivity_of_sound": complex(
            (loss_tangent(fluid, start["filled"].f0) + loss) * fluid.sound_speed**2 / omega)}
        return model_of(chip, "filled", accuracy=COARSE, changed=changed).figures({})

    def shift_missing(filled: Figures, empty: Figures) -> float:
        return filled.f0 - empty.f0 - (start["filled"].f0 - start["empty"].f0 + wanted.shift)

    def loss_missing(filled: Figures) -> float:
        return 1.0 / filled.q - 1.0 / start["filled"].q - wanted.inverse_q["filled"]

    loss = root(lambda x: loss_missing(liquid(0.0, x)), 0.0, 0.2, 5e-4)
    if math.isfinite(loss):
        yield Instead("Q: loss tangent of the water", (loss,), start["empty"], liquid(0.0, loss))
    rise = root(lambda x: shift_missing(higher("filled", x), higher("empty", x)), 0.0, 0.2 * height, 1e-6)
    if math.isfinite(rise):
        yield Instead("f0: height of the cavity (m)", (rise,), higher("empty", rise), higher("filled", rise))
    faster = root(lambda x: shift_missing(liquid(x, 0.0), start["empty"]), -0.1, 0.0, 1e-3)
    if math.isfinite(faster):
        yield Instead("f0: sound speed of the water (share)", (faster,), start["empty"], liquid(faster, 0.0))
    if not (math.isfinite(loss) and math.isfinite(faster)):
        return

    def both_missing(x: Real) -> list[float]:
        found = liquid(float(x[0]) * faster, float(x[1]) * loss)
        return [shift_missing(found, start["empty"]) / wanted.shift, loss_missing(found) / wanted.inverse_q["filled"]]

    both = scipy.optimize.root(both_missing, np.array([1.0, 1.5]), options={"eps": 1e-2, "xtol": 1e-2})
    if both.success and max(map(abs, both.fun)) < 0.05:
        amounts = (float(both.x[0]) * faster, float(both.x[1]) * loss)
        yield Instead("both: sound speed (share) and loss tangent of the water", amounts, start["empty"],
                      liquid(*amounts))


# --------------------------------------------------------------------------------------------------------------------
# The dimensions that are not known


def layers_of(found: Breakdown) -> tuple[float, float]:
    """1/Q of both boundary layers together, by the spectrum and by the dissipated power."""
    parts = [found.parts[cause] for cause in ("viscous layer", "thermal layer")]
    return sum(part.inverse_q for part in parts), sum(part.dissipated for part in parts)


@dataclass(frozen=True)
class Draw:
    """One chip drawn: its place in :data:`RANGES` (m), and what the water's losses do in it, None without a resonance.

    ``slip`` is :func:`uniform_slip`; ``second`` whether it was drawn about the worst of the first round.
    """

    lengths: Mapping[str, float]
    found: Breakdown | None
    slip: float
    second: bool

    @property
    def layers(self) -> float:
        """The larger measure of 1/Q of both boundary layers together (0 without a resonance)."""
        return 0.0 if self.found is None else max(map(abs, layers_of(self.found)))


def draw(chip: Chip, point: Real, *, second: bool, accuracy: float = COARSE) -> Draw:
    """The chip at a `point` (7,) of the unit cube over :data:`RANGES`."""
    low, high = np.array(list(RANGES.values())).T
    lengths = {name: float(x) for name, x in zip(RANGES, low + point * (high - low), strict=True)}
    made = chip_with(chip, lengths)
    model = model_of(made, "filled", accuracy=accuracy)
    try:
        found = break_down(model)
    except NoResonance:
        return Draw(lengths, None, 0.0, second)
    return Draw(lengths, found, uniform_slip(made, fluid_of(model.problem), found.figures.f0), second)


def draws(chip: Chip, *, count: int, about: int, seed: int) -> Iterator[Draw]:
    """`count` draws spread evenly, then `about` more about each of the :data:`WORST`: a bound is to be attacked."""
    sampler = qmc.Sobol(len(RANGES), seed=seed)
    points = sampler.random(count)
    first = []
    for point in points:
        first.append(draw(chip, point, second=False))
        yield first[-1]
    generator = np.random.default_rng(seed)
    for index in sorted(range(count), key=lambda k: -first[k].layers)[:WORST]:
        for _ in range(about):
            moved = points[index] + ABOUT * generator.uniform(-1.0, 1.0, len(RANGES))
            yield draw(chip, np.clip(moved, 0.0, 1.0), second=True)


def is_like(chip: Chip, found: Figures) -> bool:
    """Whether f0 and Q, filled, are about what was measured (:data:`LIKE_F0`, :data:`LIKE_Q`)."""
    measured = chip.state("filled").reported[0]
    return abs(found.f0 - measured.f0) <= LIKE_F0 and abs(math.log(found.q / measured.q)) <= math.log(LIKE_Q)


# --------------------------------------------------------------------------------------------------------------------


def spread(values: Sequence[float]) -> str:
    """Median, 95th percentile and largest size, as a table shows them."""
    sizes = np.abs(values)
    return f"{np.median(sizes):.1e} / {np.percentile(sizes, 95):.1e} / {sizes.max():.1e}"


def say(line: str) -> str:
    """Print a line and return it."""
    print(line, flush=True)
    return line


def reproduced(chip: Chip, wanted: Gaps) -> tuple[list[str], list[tuple[str, ...]], dict[str, float]]:
    """The chip as its file has it: lines, rows of the table of causes, losses (W) by place when filled, at 10 Vpp."""
    lines: list[str] = []
    rows: list[tuple[str, ...]] = []
    budget: dict[str, float] = {}
    for state, accuracy in (("filled", COARSE), ("filled", FINE), ("empty", COARSE)):
        model = model_of(chip, state, accuracy=accuracy)
        found = break_down(model)
        merit = found.figures
        for cause, part in found.parts.items():
            rows.append((state, f"{100 * accuracy:g} %", cause, f"{part.f0:+.2f}", f"{part.inverse_q:+.2e}",
                         f"{part.dissipated:.2e}", f"{100 * part.largest / wanted.inverse_q['filled']:.3f} %"))
            say("  ".join(rows[-1]))
        lines.append(say(f"{state}, mesh of {100 * accuracy:g} %: f0 {merit.f0 / 1e3:.2f} kHz, Z_min "
                         f"{merit.z_min:.2f} ohm, Q {merit.q:.1f}; the fluid holds "
                         f"{100 * found.fluid_share:.2g} % of the energy"))
        if (state, accuracy) == ("filled", FINE):
            budget, closure = loss_budget(model.solution(merit.f0), 5.0)
            total = sum(budget.values())
            ranked = sorted(budget.items(), key=lambda item: -item[1])
            lines.append(say("losses: " + ", ".join(f"{place} {100 * power / total:.2g} %" for place, power in ranked)
                             + f" (closed to {closure:.0e})"))
            lines.append(say("if the water slid along all walls as fast as it moves on average, before its share of "
                             f"the energy: 1/Q {uniform_slip(chip, fluid_of(model.problem), merit.f0):.1e}"))
            thickest = ADMISSIBLE["shear_viscosity"].highest
            more = 1.0 / model.figures({"shear_viscosity": thickest}).q - 1.0 / merit.q
            lines.append(say(f"viscous layer of the most viscous water there is ({thickest * 1e3:g} mPa s): 1/Q "
                             f"{more + found.parts['viscous layer'].inverse_q:+.2e}"))
    return lines, rows, budget


def closing_rows(chip: Chip, wanted: Gaps) -> list[tuple[str, ...]]:
    """What closes one gap each, and what that does to the figures of both states."""
    start = {state: model_of(chip, state, accuracy=COARSE).figures({}) for state in STATES}
    rows = []
    for one in instead(chip, wanted, start):
        cells = []
        for state, merit in (("empty", one.empty), ("filled", one.filled)):
            old = start[state]
            cells.append(f"f0 {(merit.f0 - old.f0) / 1e3:+.2f} kHz, Z_min "
                         f"{100 * (merit.z_min / old.z_min - 1):+.0f} %, 1/Q {1 / merit.q - 1 / old.q:+.1e}")
        rows.append((one.what, ", ".join(f"{amount:+.3g}" for amount in one.amounts), *cells))
        say("would close it: " + "  ".join(rows[-1]))
    return rows


def bound(chip: Chip, results: Sequence[Draw], wanted: Gaps) -> tuple[str, list[str], list[tuple[str, ...]]]:
    """What the draws say: the answer, further lines, and a row for each group of draws."""
    gap = wanted.inverse_q["filled"]
    resonant = [(d, d.found) for d in results if d.found is not None]
    rows = []
    for name, group in (
        ("spread evenly", [f for d, f in resonant if not d.second]),
        ("about the worst", [f for d, f in resonant if d.second]),
        ("of all, like the measured chip", [f for _, f in resonant if is_like(chip, f.figures)]),
    ):
        if group:
            rows.append((name, str(len(group)), *group_row(group, gap)))
            say("  ".join(rows[-1]))
    lines: list[str] = []
    largest = [0.0, 0.0]
    for measure, text in enumerate(("the spectrum", "the dissipated power")):
        order = np.argsort([-abs(layers_of(found)[measure]) for _, found in resonant])
        for one, found in (resonant[k] for k in order[:CHECKED]):
            fine = break_down(model_of(chip_with(chip, one.lengths), "filled", accuracy=FINE))
            largest[measure] = max(largest[measure], *(abs(layers_of(f)[measure]) for f in (found, fine)))
            lines.append(say(
                f"largest by {text}: f0 {found.figures.f0 / 1e3:.1f} kHz, Z_min {found.figures.z_min:.1f} ohm, Q "
                f"{found.figures.q:.0f}, layers {layers_of(found)[measure]:+.1e}; on the fine mesh f0 "
                f"{fine.figures.f0 / 1e3:.1f} kHz, Q {fine.figures.q:.0f}, {layers_of(fine)[measure]:+.1e}; "
                + ", ".join(f"{name} {value * 1e3:.3f} mm" for name, value in one.lengths.items())))
    shift = max(abs(sum(part.f0 for part in f.parts.values())) for _, f in resonant)
    like = [abs(x) for _, f in resonant if is_like(chip, f.figures) for x in layers_of(f)]
    dissipated, seen = 100 * largest[1] / gap, 100 * largest[0] / gap
    alike = f" (in chips like the measured one, by either measure: {100 * max(like) / gap:.0f} %)" if like else ""
    answer = say(f"In none of {len(resonant)} chips drawn do the boundary layers dissipate over {dissipated:.0f} % "
                 f"of the missing 1/Q of {gap:.1e}. By what they do to the spectrum it is at most {seen:.0f} %, where "
                 f"a neighbouring resonance comes up to the half-power points{alike}. The losses of the water move f0 "
                 f"by at most {shift:.0f} of the {abs(wanted.shift):.0f} Hz missing. A bound over these dimensions, "
                 f"not a proof.")
    lines.append(say(f"{len(results) - len(resonant)} of {len(results)} draws have no resonance in the band"))
    return answer, lines, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=64, help="draws spread over all dimensions; a power of two")
    parser.add_argument("--about", type=int, default=9, help=f"draws about each of the {WORST} worst of these")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/missing_loss"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    chip = replace(read_chip(CHIP), ports=None)
    wanted = gaps(chip)
    head = say(f"Table 5, measured less model: 1/Q {wanted.inverse_q['filled']:.2e} filled, "
               f"{wanted.inverse_q['empty']:.1e} empty; f0 on filling {wanted.measured_shift / 1e3:+.1f} kHz measured, "
               f"{wanted.model_shift / 1e3:+.1f} kHz modelled; Z_min filled {100 * (wanted.z_min_ratio - 1):+.1f} %")
    lines, rows, budget = reproduced(chip, wanted)
    closing = closing_rows(chip, wanted)
    results = list(draws(chip, count=arguments.draws, about=arguments.about, seed=arguments.seed))
    write_table(arguments.out / "draws.csv", chip, results)
    answer, more, table = bound(chip, results, wanted)
    report(arguments.out, answer, [head, *lines, *more], rows=rows, closing=closing, table=table, budget=budget,
           results=results, gap=wanted.inverse_q["filled"])


#: Columns of :func:`group_row` after the group's name and size.
GROUP_COLUMNS = ("layers, 1/Q dissipated (median / 95 % / largest)", "layers, 1/Q of the spectrum",
                 "bulk, 1/Q dissipated", "f0 by all, Hz", "energy in the water",
                 "loss tangent of the water that would do it (5 to 95 %)")


def group_row(group: Sequence[Breakdown], gap: float) -> tuple[str, ...]:
    """The cells of :data:`GROUP_COLUMNS` for some draws with a resonance."""
    shares = np.array([found.fluid_share for found in group])
    needed = np.percentile(gap / shares, (5, 95))
    return (spread([layers_of(found)[1] for found in group]), spread([layers_of(found)[0] for found in group]),
            spread([found.parts["bulk absorption"].dissipated for found in group]),
            spread([sum(part.f0 for part in found.parts.values()) for found in group]),
            f"{100 * np.median(shares):.2g} % (up to {100 * shares.max():.2g} %)",
            f"{needed[0]:.1e} to {needed[1]:.1e}")


def write_table(path: Path, chip: Chip, results: Sequence[Draw]) -> None:
    """Every draw on a line, SI units in the names."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([*(f"{name}_m" for name in RANGES), "second_round", "like", "f0_hz", "z_min_ohm", "q",
                         *(f"{cause} {what}" for cause in CAUSES for what in ("f0_hz", "inverse_q", "dissipated")),
                         "fluid_share", "uniform_slip"])
        for one in results:
            row: list[object] = [*(f"{x:.6e}" for x in one.lengths.values()), int(one.second)]
            if one.found is not None:
                merit = one.found.figures
                row += [int(is_like(chip, merit)), f"{merit.f0:.2f}", f"{merit.z_min:.4f}", f"{merit.q:.3f}"]
                row += [f"{x:.4e}" for p in one.found.parts.values() for x in (p.f0, p.inverse_q, p.dissipated)]
                row += [f"{one.found.fluid_share:.4e}", f"{one.slip:.4e}"]
            writer.writerow(row)


def report(
    out: Path, answer: str, lines: Sequence[str], *, rows: Sequence[tuple[str, ...]],
    closing: Sequence[tuple[str, ...]], table: Sequence[tuple[str, ...]], budget: Mapping[str, float],
    results: Sequence[Draw], gap: float,
) -> None:
    """Draw the pictures and write ``report.html``."""
    from workbench.render.canvas import Picture, new_figure, save_figure
    from workbench.render.plots import draw_loss_budget
    from workbench.report.page import Note, TextTable, write_report

    figure = new_figure(7.5, 4.0)
    axes = figure.subplots()
    edges = np.geomspace(1e-8, 1e-2, 49).tolist()
    for second, label, colour in ((False, "drawn evenly", "#4477aa"), (True, "drawn about the worst", "#cc6677")):
        axes.hist([d.layers for d in results if d.found is not None and d.second == second], edges, label=label,
                  color=colour, alpha=0.7)
    axes.axvline(gap, color="black", label=f"missing: {gap:.1e}")
    axes.set_xscale("log")
    axes.set_xlabel("1/Q of the chip by the boundary layers of the water")
    axes.set_ylabel("chips")
    axes.legend()
    figure.tight_layout()
    histogram = save_figure(figure, out / "layers.png")
    losses = draw_loss_budget(budget, out / "losses.png", title="filled chip, 10 Vpp at the electrodes, at f0")
    page = write_report(out / "report.html", "Is the missing loss thermoviscous?", [
        ("Answer", [Note(answer), Picture(histogram, "Contribution of the boundary layers in every chip drawn.")]),
        ("The chip as reproduced", [
            TextTable(("state", "accuracy of the mesh", "cause", "f0 (Hz)", "1/Q, spectrum", "1/Q, dissipated",
                       "of the gap"), tuple(rows)),
            Picture(losses, "Where the power goes, from a solution at f0.")]),
        ("What would close a gap", [TextTable(("changed", "by", "empty", "filled"), tuple(closing))]),
        ("Dimensions drawn", [TextTable(("chips", "number", *GROUP_COLUMNS), tuple(table))]),
        ("All lines", ["\n".join(lines)]),
    ])
    print(page)


if __name__ == "__main__":
    main()
