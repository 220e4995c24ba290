"""What a diagnosis says of strong effects in a chip, each concealed alone, and how long it takes.

    .venv/bin/python tests/benchmarks/strong.py [EFFECT ...] [--jobs 2]

The recordings are the model's own, of a finer mesh, with 0.3 % of noise: a disc and a chip with its cavity filled. Its
known parameters leave a third of Z and more in the first three cases.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "benchmarks")]

from measurements import measurements, with_json  # noqa: E402
from test_workbench_diagnosis_named import BOND, concealed  # noqa: E402

from workbench.diagnosis.appraisal import diagnose  # noqa: E402

#: Parameters of the model, SI.
CASES: Mapping[str, Mapping[str, float]] = {
    "gel missing beyond 84 % of its radius": {"couplant rim.width": 0.16},
    "weak bond": BOND,
    "gel that gas makes three times slower": {"couplant bubbles.void_fraction": 5e-4},
    "cavity 4 % higher": {"sidewall.thickness": 1.04 * 0.7e-3},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", default=list(CASES), help="of: " + ", ".join(CASES))
    parser.add_argument("--jobs", type=int, default=1)
    with_json(parser)
    options = parser.parse_args()
    with measurements(options.json) as kept:
        for effect in options.effects:
            values = CASES[effect]
            with tempfile.TemporaryDirectory() as name:
                found = diagnose(concealed(Path(name), values), jobs=options.jobs)
            told = ", ".join(f"{key} {value:g}" for key, value in values.items())
            print(f"{effect} ({told}), {found.seconds:.0f} s:")
            print(f"    {found.headline}")
            for each in (one for established in found.established for one in established.estimates):
                print(f"    {each.name} {each.value:.4g}, {each.low:.4g} to {each.high:.4g}")
            kept.add(effect, found.seconds, "s")


if __name__ == "__main__":
    main()
