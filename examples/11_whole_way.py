"""The whole way
=============

The whole way, from the command line alone: the bench, a transducer, a polymer, a chip, and what it does not explain.

    python examples/11_whole_way.py [-o out/whole_way]

The bench is the simulated one, with leads, probes, gains that are off, 8 bit and noise. What it holds is in
``whole_way/truth``, which no other command sees: the constants of the disc and of the printed PLA differ from the
nominal ones, and the gel below the sample and below the chip is not as thick as their files say. Everything else knows
what somebody at a bench would: dimensions, densities, data sheets.

    1. open, short and load are recorded
    2. the disc is measured, and its constants are fitted and saved
    3. the disc with a sample on it is measured, and the moduli of the sample are fitted and saved
    4. the chip is predicted with both, measured empty and filled, and compared
    5. where the two differ is diagnosed

Every command is printed, and the constants found are at the end set beside those that the bench was given. Each stage
leaves a report below the output folder. The materials that are saved are there too: your own are not touched. About
ten minutes on two busy cores.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from simulated_bench import GEL, HIDDEN, Bench, measured_materials

import workbench as wb

#: Relative error of the simulated generator's clock, by default.
CLOCK = 5e-6


def whole_way(folder: Path) -> None:
    """All stages; everything they leave is below `folder`, which must not exist."""
    bench = Bench(folder)
    measured_materials(bench)
    bench.run("materials", "list")
    bench.run("simulate", "chip.toml", "-o", "chip")
    for state in ("empty", "filled"):
        bench.measure(f"chip_{state}", "truth/chip.toml", "--state", state, *HIDDEN)
        bench.run("compare", f"chip_{state}.csv", "chip.toml", "--state", state, "-o", f"compare_{state}")
    if bench.has("diagnose"):
        bench.run("diagnose", "campaign.toml", "-o", "diagnosis")

    print("\nWhat was found beside what the bench held:")
    outcome(folder)
    print("\nReports:", *sorted(str(path) for path in folder.rglob("*.html")), sep="\n  ")


def outcome(folder: Path) -> None:
    """Print every fitted parameter with its interval beside the truth, and whether the one holds the other."""
    print(f"{'':18}{'found':>14}{'95 % interval':>32}{'truth':>14}{'off (%)':>10}")
    registry, held = wb.Registry((folder / "truth",)), 0
    found = [(name, one) for fit, name in (("fit_disc", "pzt_bench/disc"), ("fit_sample", "pla_bench/print"))
             for one in json.loads((folder / fit / "fit.json").read_text(encoding="utf-8"))["parameters"]]
    for material, one in found:
        truth = true_value(one["name"], registry, material)
        value, low, high = one["value"], one["low"], one["high"]
        inside = low <= truth <= high
        held += inside
        name = one["name"].rpartition("/")[2].partition(".")[2] if "/" in one["name"] else one["name"]
        print(f"{name:18}{value:14.7g}{low:15.7g} to{high:14.7g}{truth:14.7g}{100.0 * (value / truth - 1.0):+10.3f}  "
              f"{'inside' if inside else 'OUTSIDE'}")
    print(f"{held} of {len(found)} intervals hold the truth")


def true_value(parameter: str, registry: wb.Registry, material: str) -> float:
    """What the bench was given, in SI: a coefficient of a material, its loss, the gel's thickness, or the clock."""
    if parameter == "bench.clock":
        return CLOCK
    if parameter == "couplant.thickness":
        return GEL["disc_on_pla.toml"]
    coefficient = parameter.rpartition("/")[2].partition(".")[2]
    value = registry.load(material).parameters()[coefficient.removesuffix(".loss")]
    return value.imag if coefficient.endswith(".loss") else value.real


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/whole_way"), help="a folder that does not exist")
    options = parser.parse_args()
    if options.output.exists():
        parser.error(f"{options.output} exists already; name another folder with -o, or remove it")
    whole_way(options.output.resolve())


if __name__ == "__main__":
    main()
