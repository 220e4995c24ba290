"""What a diagnosis costs: a campaign of two states beside one full-order spectrum, and the scores beside it.

    .venv/bin/python tests/benchmarks/diagnosis.py [--effects water_uptake gel_bubbles] [--seed 7] [--points 25]

All times are of one run on one core. The campaign is a trial (`trials.py`) with two effects concealed, cut down to its
empty and its filled state of 481 frequencies. The full-order spectrum is that of the filled chip as `workbench`
simulates it, extrapolated from so many of its frequencies.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "benchmarks")]

from concealed.trial import make_trial  # noqa: E402
from measurements import Measurements, measurements, with_json  # noqa: E402
from support import with_fields  # noqa: E402

from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.diagnosis.levels import LEVELS  # noqa: E402
from workbench.diagnosis.local_models import LocalModels  # noqa: E402
from workbench.diagnosis.ranking import ranked_at_level  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import sweep  # noqa: E402
from workbench.model.problem import build  # noqa: E402


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
        campaign = with_fields(campaign, states=tuple(s for s in campaign.states if s.name in ("empty", "filled")))
        found = diagnose(campaign)
        print(f"found: {found.headline} {len(found.model.effects)} hypotheses, {len(found.found.final)} settled")

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
        print(f"diagnosis of two states: {found.seconds:.0f} s, {found.seconds / full:.2f} of it")

        models = LocalModels(found.model)
        x = models.prior.x
        started = time.perf_counter()
        scores = ranked_at_level(found.model, models.tangents(x), found.campaign.fitted, LEVELS[-1])
        scored = time.perf_counter() - started
        print(f"scores of {len(scores)} hypotheses: {scored:.2f} s; best {scores[0].effect.name}")
        for label, value in (("diagnosis of two states", found.seconds), ("full-order spectrum", full),
                             ("scores", scored)):
            kept.add(label, value, "s")


if __name__ == "__main__":
    main()
