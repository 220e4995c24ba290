"""A study
=======

How far off may a print be? A study asks for figures of a chip at many points: here the height of the cavity and the
thickness of its floor vary within what a printer leaves, and the lid is of one glass or another. The drive follows f0,
as on a bench. What is finished is on the disk at once.

Reference number: each 10 um of height of the cavity lowers f0 by 1.4 to 1.5 kHz, below either glass. Water of 0.72 mm
is half a wavelength high at 1.03 MHz, and f0 is above that: a higher cavity pulls it down.
"""

from pathlib import Path

import numpy as np

import workbench as wb

ROOT = Path(wb.__file__).resolve().parent.parent


def main() -> None:
    """Run the study in two processes, and print what it tells."""
    plan = wb.read_study(ROOT / "examples" / "small_study" / "study.toml")
    # Without `overwrite` a run goes on where it was interrupted, and refuses the folder of another study.
    found = wb.study(plan, Path("out") / "study", jobs=2, overwrite=True)
    columns = found.columns
    for lid in np.unique(columns["superstrate.material"]):
        there = columns["superstrate.material"] == lid
        height, f0 = columns["sidewall.thickness"][there], columns["f0"][there]
        slope, _ = np.polyfit(height - height.mean(), f0, 1)
        energy = columns["mean_e_ac"][there]
        print(f"{lid}: f0 {1e-6 * f0.mean():.4f} MHz, {1e-8 * slope:.2f} kHz for 10 um of height; "
              f"{energy.min():.1f} to {energy.max():.1f} J/m^3")
    for each in found.confirmations:
        print(f"row {each.row}, {each.figure}: {each.reduced:.6g}, by a full solve {each.full:.6g}")
    print(found.to_xarray().sizes)


if __name__ == "__main__":
    main()
