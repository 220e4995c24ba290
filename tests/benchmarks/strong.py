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
from test_workbench_diagnosis_fooled import CONSTANTS, PLA, Bench, heavier  # noqa: E402
from test_workbench_diagnosis_named import BOND, concealed  # noqa: E402

from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.diagnosis.outcome import Diagnosis  # noqa: E402

#: Parameters of the model, SI.
CASES: Mapping[str, Mapping[str, float]] = {
    "gel missing beyond 84 % of its radius": {"couplant rim.width": 0.16},
    "weak bond": BOND,
    "gel that gas makes three times slower": {"couplant bubbles.void_fraction": 5e-4},
    "cavity 4 % higher": {"sidewall.thickness": 1.04 * 0.7e-3},
    "cavity filled to 80 %": {"free surface.depth": 0.2},
    "bubble under 30 % of the lid": {"bubble under the lid.area": 0.3},
    "walls of PETG": {"sidewall of petg.share": 1.0},
    "glycerol in the water": {"glycerol water 20 in the cavity.share": 1.0},
    "lid in a holder": {"superstrate held at its rim.stiffness": 1e13},
}

#: The same in a disc by itself and with a polymer on it: constants that were fitted with a density that is too low.
DENSITY, FACTOR = "density 4.8 % higher than that of the fit", 1.048


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", default=[*CASES, DENSITY],
                        help="of: " + ", ".join([*CASES, DENSITY]))
    parser.add_argument("--jobs", type=int, default=1)
    with_json(parser)
    options = parser.parse_args()
    with measurements(options.json) as kept:
        for effect in options.effects:
            with tempfile.TemporaryDirectory() as name:
                if effect == DENSITY:
                    found, told = density(Path(name)), f"transducer.gauge {FACTOR - 1.0:g}"
                else:
                    found = diagnose(concealed(Path(name), CASES[effect]), jobs=options.jobs)
                    told = ", ".join(f"{key} {value:g}" for key, value in CASES[effect].items())
            print(f"{effect} ({told}), {found.seconds:.0f} s:")
            print(f"    {found.headline}")
            for each in (one for established in found.established for one in established.estimates):
                print(f"    {each.name} {each.value:.4g}, {each.low:.4g} to {each.high:.4g}")
            kept.add(effect, found.seconds, "s")


def density(folder: Path) -> Diagnosis:
    """Of a disc and the same disc with a polymer on it; without the effect, the polymer takes the blame."""
    bench = Bench(folder)
    for name, chip in (("disc", "disc"), ("loaded", "sample")):
        bench.record(name, chip, factors=heavier(FACTOR))
    found = bench.diagnosed(CONSTANTS | {f"{PLA}.{name}": "10 %" for name in ("shear_modulus", "bulk_modulus")})
    moduli = [found.model.index(f"{PLA}.{name}") for name in ("shear_modulus", "bulk_modulus")]
    without, left = ([abs(each.explanation.x[i] / found.model.parameters[i].start - 1.0) for i in moduli]
                     for each in (found.found.base, found.chosen))
    print(f"    moduli of the polymer are off by {max(without):.2g} without the effect, by {max(left):.2g} with it")
    return found


if __name__ == "__main__":
    main()
