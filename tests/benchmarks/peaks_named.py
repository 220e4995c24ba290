"""The peaks of the shipped chips, each with the mode behind it and its share of the conductance.

    .venv/bin/python tests/benchmarks/peaks_named.py [CHIP.toml ...]

A peak of the conductance rises by :data:`workbench.simulation.peak_modes.HEIGHT` on both sides. Its mode explains it if
the peak is within the half width f / (2 Q) of the mode.
"""

from __future__ import annotations

import sys
from pathlib import Path

import workbench as wb

CHIPS = Path(__file__).resolve().parents[2] / "geometry" / "chips"
SHIPPED = ("acevedo_2026_chip", "reference_chip", "disc_gel_pla", "glass_channel", "polymer_channel",
           "silicon_glass_channel")


def main() -> None:
    """Print a line for each peak, and the number of those that one mode explains."""
    explained, every = 0, 0
    for path in [*map(Path, sys.argv[1:])] or [CHIPS / f"{name}.toml" for name in SHIPPED]:
        run = wb.simulate(wb.read_chip(path))
        every += len(run.peak_modes)
        for peak in run.peak_modes:
            is_explained = abs(peak.frequency / peak.mode.frequency - 1.0) < 0.5 / peak.mode.q
            explained += is_explained
            share = "" if peak.share is None else f"{100.0 * peak.share:.0f} % "
            print(f"{path.stem}, {run.state}: {peak.frequency / 1e6:.6f} MHz, {peak.quantity}, {share}"
                  f"{peak.mode.frequency / 1e6:.6f} MHz, {peak.mode.words}{'' if is_explained else ', NOT EXPLAINED'}")
    print(f"{explained} of {every} peaks")


if __name__ == "__main__":
    main()
