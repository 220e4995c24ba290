"""Robust by measurement
=====================

From recordings to a design that is best over what the bench left uncertain, and what a nominal design would have lost.

    python examples/20_robust_by_measurement.py [-o out/robust_by_measurement]

The bench is the simulated one of ``11_whole_way.py``: leads, gains that are off, 8 bit and noise. A disc is measured
and fitted, then the disc with a printed sample on it, and the moduli of the print are fitted; its recording leaves the
gel below the sample and the moduli of the print open to some extent, together (``fit_sample/fit.json``). Then two chips
are designed for the strongest field with the trap within 30 um of mid-height: one as if the fit were the truth, and one
for the field and the trap that 95 % of the chips reach which the recording allows. Both are judged by the same samples
of that posterior, which neither search has seen.

Every command is printed. About ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import importlib
import json
import shutil
from pathlib import Path

FILES = Path(__file__).resolve().parent / "robust_by_measurement"
#: Of the judgement: not those of the searches.
SEED = 7
REQUIRED = ("trap_offset within 30 um of 0 um",)
POSTERIOR = "fit_sample/fit.json"


def robust_by_measurement(folder: Path) -> None:
    """All stages; everything they leave is below `folder`, which must not exist."""
    whole_way = importlib.import_module("11_whole_way")
    bench = whole_way.Bench(folder)
    whole_way.measured_materials(bench)
    for path in FILES.glob("*.toml"):
        shutil.copy(path, folder)
    for name in ("nominal", "robust"):
        bench.run("design", f"{name}.toml", "--no-cad", "-o", name)
        bench.run("tolerance", f"{name}/best.toml", "--state", "filled", "--posterior", POSTERIOR,
                  "--figure", "mean_e_ac", *(word for text in REQUIRED for word in ("--require", text)),
                  "--seed", str(SEED), "--samples", "1000", "-o", f"{name}_judged")
    print("\nOver what the recording leaves open:")
    outcome(folder)


def outcome(folder: Path) -> None:
    """Print, of both designs, the field that 95 % of the chips reach and the share whose trap is where it should be."""
    import pandas

    print(f"{'design':10}{'as fitted':>16}{'reached by 95 %':>20}{'trap in place':>18}")
    for name in ("nominal", "robust"):
        judged = json.loads((folder / f"{name}_judged" / "tolerance.json").read_text(encoding="utf-8"))
        samples = pandas.read_parquet(folder / f"{name}_judged" / "samples.parquet")
        field = samples["mean_e_ac"].dropna()
        print(name, judged["yield"], field.quantile(0.05), len(samples))


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
