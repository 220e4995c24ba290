"""The place of a part beside the axis of a disc, found in trials: what a search reaches, beside the truth.

    .venv/bin/python tests/benchmarks/feature_trials.py make FOLDER --seed 1 --trials 12
    .venv/bin/python tests/benchmarks/part_place.py FOLDER [--only 0004 0011]

It prints distance and mass, found and true, the reduced chi-square, and the fall of the cost by the part, for each
trial with a mass. No diagnosis uses this search yet.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from not_round.search import located  # noqa: E402

from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.device import device_model  # noqa: E402
from workbench.diagnosis.local_models import LocalModels  # noqa: E402
from workbench.fem.solve import one_thread  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[], metavar="NNNN")
    options = parser.parse_args()
    truths = json.loads((options.folder / "truth.json").read_text(encoding="utf-8"))
    print("trial  sigmas  distance (mm): true, found  mass (mg): true, found  chi-square  cost falls by  processor (s)")
    for name, truth in sorted(truths.items()):
        if not truth["effects"] or (options.only and name not in options.only):
            continue
        true, begun = truth["effects"][0]["parameters"], time.process_time()
        with one_thread():
            found = located(LocalModels(device_model(read_campaign(options.folder / name / "campaign.toml"))))
        print(f"{name}  {truth['detectability']:6.0f}  {1e3 * true['distance']:18.3f}, {1e3 * found.distance:5.3f}"
              f"{1e6 * true['mass']:17.2f}, {1e6 * found.mass:5.2f}  {found.reduced:10.2f}"
              f"  {found.before - found.cost:13.1f}  {time.process_time() - begun:13.0f}", flush=True)


if __name__ == "__main__":
    main()
