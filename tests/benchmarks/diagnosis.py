"""What a diagnosis costs: a campaign of two states beside one full-order spectrum, and the score test beside refits.

    .venv/bin/python tests/benchmarks/diagnosis.py [--effects water_uptake gel_bubbles] [--seed 7] [--points 25]

All times are of one run on one core. The campaign is a trial (`trials.py`) with two effects concealed, so that pairs
are tried, cut down to its empty and its filled state of 481 frequencies. The full-order spectrum is that of the filled
chip as `workbench simulate` meshes it, extrapolated from so many of its frequencies.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.trial import make_trial  # noqa: E402
from measurements import Measurements, measurements, with_json  # noqa: E402
from workbench.diagnosis.criteria import gain  # noqa: E402
from workbench.diagnosis.procedure import diagnose  # noqa: E402
from workbench.diagnosis.refit import refit  # noqa: E402
from workbench.diagnosis.score import score  # noqa: E402

from workbench.diagnosis.campaign import read_campaign  # noqa: E402
from workbench.operators import assemble  # noqa: E402
from workbench.problem import build  # noqa: E402
from workbench.solve import sweep  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="+", default=["water_uptake", "gel_bubbles"])
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--points", type=int, default=25, help="full solves that are measured")
    with_json(parser)
    options = parser.parse_args()
    with measurements(options.json) as kept:
        measure(options, kept)


def measure(options: argparse.Namespace, kept: Measurements) -> None:
    with tempfile.TemporaryDirectory() as name, threadpool_limits(limits=1):
        folder = Path(name) / "trial"
        truth = make_trial(options.seed, tuple(options.effects), folder, points=481)
        print("concealed:", ", ".join(f"{e.name} ({e.detectability:.0f} sigmas)" for e in truth.effects))
        campaign = read_campaign(folder / "campaign.toml")
        campaign = replace(campaign, states=tuple(s for s in campaign.states if s.name in ("empty", "filled")))
        started = time.perf_counter()
        found = diagnose(campaign)
        whole = time.perf_counter() - started
        print(f"found: {found.verdict}, {' and '.join(e.name for e in found.effects) or 'no effect'}; "
              f"{len(found.model.effects)} hypotheses, {len(found.singles)} refitted alone, {len(found.pairs)} pairs")

        filled = campaign.states[-1]
        problem = build(filled.device,
                        band=(float(filled.measured.frequency[0]), float(filled.measured.frequency[-1])))
        operators = assemble(problem.mesh, problem.terms)
        frequencies = filled.measured.frequency[np.linspace(0, 480, options.points).astype(int)]
        started = time.perf_counter()
        for _ in sweep(operators, frequencies, problem.values):
            pass
        full = (time.perf_counter() - started) * 481 / options.points
        print(f"full-order spectrum, {operators.size} unknowns, 481 frequencies (from {options.points}): {full:.0f} s")
        print(f"diagnosis of two states: {whole:.0f} s, {whole / full:.2f} of it")

        base = found.base
        here = base.search.evaluate(base.x, found.model.deviations())
        started = time.perf_counter()
        tangents = base.tangents()
        scores = [score(found.model, base.x, here, tangents, effect) for effect in found.model.effects]
        scored = time.perf_counter() - started
        for name, value in (("diagnosis of two states", whole), ("full-order spectrum", full), ("scores", scored)):
            kept.add(name, value, "s")
        started = time.perf_counter()
        refits = [(s.effect.name, refit(found.model, (s.effect,), base.x, [s])) for s in scores]
        refitted = time.perf_counter() - started
        best = max((fit for _, fit in refits if fit is not None), key=lambda fit: gain(base, fit))
        first = max(scores, key=lambda s: s.evidence).effect.name
        print(f"scores of {len(scores)} hypotheses: {scored:.2f} s; their refits: {refitted:.0f} s; ratio "
              f"{scored / refitted:.4f}; best by either: {first}, {best.name}")


if __name__ == "__main__":
    main()
