"""Robust by measurement
=====================

From recordings to a design that is best over what the bench left uncertain, and what a nominal design would have lost.

    python examples/17_robust_by_measurement.py [-o out/robust_by_measurement]

The bench is the simulated one of ``11_whole_way.py``: leads, gains that are off, 8 bit and noise. A disc is measured
and fitted, then the disc with a printed sample on it, and the moduli of the print are fitted; both are kept with their
uncertainties and correlations. What no recording says is how thick the gel below the next chip will be: its file gives
20 um within 10 um. Two chips are designed for the strongest field with the trap within 30 um of mid-height: one as if
what is stated were the truth, and one for the field and the trap that 95 % of the chips reach that the bench allows.
Both are judged by the same samples, which neither search has seen.

Every command is printed. Some six minutes on two cores.

Reference number: 80 % of the chips of the nominal design have the trap in place, 95 % of those of the robust one, whose
field is 0.7 % weaker.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import pandas
from simulated_bench import Bench, measured_materials

import workbench as wb

FILES = Path(__file__).resolve().parent / "robust_by_measurement"
REQUIRED = "trap_offset within 30 um of 0 um"
#: Of the samples that judge; the searches have others.
SEED = 7


def robust_by_measurement(folder: Path) -> None:
    """All stages; everything they leave is below `folder`, which must not exist."""
    bench = Bench(folder)
    measured_materials(bench)
    for path in FILES.glob("*.toml"):
        shutil.copy(path, folder)
    for name in ("nominal", "robust"):
        bench.run("design", f"{name}.toml", "-o", name)
        bench.run("tolerance", f"{name}/best.toml", "--state", "filled", "--figure", "mean_e_ac", "--require", REQUIRED,
                  "--seed", str(SEED), "--samples", "1000", "-o", f"{name}_judged")
    print("\nOver what the bench leaves open:")
    outcome(folder)


def outcome(folder: Path) -> None:
    """Print, of both designs, the field as stated and as 95 % of the chips reach it, and the share with the trap in
    place."""
    print(f"{'':10}{'sidewall':>12}{'mean_e_ac':>16}{'reached by 95 %':>20}{'trap in place':>28}")
    for name in ("nominal", "robust"):
        judged = json.loads((folder / f"{name}_judged" / "tolerance.json").read_text(encoding="utf-8"))
        share = judged["yield"]["requirements"][0]
        samples = pandas.read_parquet(folder / f"{name}_judged" / "tolerance.parquet")
        chip = wb.read_chip(folder / name / "best.toml")
        wall = chip.dimensions()["sidewall.thickness"].value
        print(f"{name:10}{1e3 * wall:9.4f} mm{judged['figures']['mean_e_ac']['nominal']:10.3f} J/m^3"
              f"{samples['mean_e_ac'].quantile(0.05):14.3f} J/m^3"
              f"{100.0 * share['yield']:10.1f} % ({100.0 * share['low']:.1f} to {100.0 * share['high']:.1f} %)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/robust_by_measurement"),
                        help="a folder that does not exist")
    options = parser.parse_args()
    if options.output.exists():
        parser.error(f"{options.output} exists already; name another folder with -o, or remove it")
    robust_by_measurement(options.output.resolve())


if __name__ == "__main__":
    main()
