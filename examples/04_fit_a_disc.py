"""Fit the material of a disc
===========================

The constants of a transducer from its impedance. The recording is a spectrum of an independent solver whose constants
are known; noise of 0.5 % is put on it here. The fit starts from a data sheet and finds all constants that the recording
shows, each with an interval.

Reference number: the disc has c33 = 121.67 GPa (``tests/data/reference/free_disc_fitted_rho7500.json``).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import workbench as wb

ROOT = Path(wb.__file__).resolve().parent.parent

recorded = wb.read_recording(ROOT / "tests" / "data" / "reference" / "free_disc_fitted_rho7500.csv").spectrum
real, imaginary = np.random.default_rng(1).standard_normal((2, recorded.frequency.size))
noisy = wb.Spectrum(recorded.frequency, recorded.impedance * np.exp(0.005 * (real + 1j * imaginary)))

# The density of a part that was weighed stands in the chip; this disc has 7500 kg/m^3.
disc = wb.read_chip(ROOT / "geometry" / "chips" / "free_disc_25x2.toml")
disc = replace(disc, layers=(replace(disc.transducer, density=7500.0),))

found = wb.fit(noisy, disc, "pzt", material="pzt4/comsol_nominal")
for estimate in found.result.estimates:
    print(f"{estimate.parameter.name:28}{estimate.value:12.5g}   95 %: {estimate.low:.5g} to {estimate.high:.5g}")
print(*found.findings, sep="\n")

out = Path("out")
out.mkdir(exist_ok=True)
print(wb.draw_spectra({"recorded": noisy, "fitted": found.spectrum}, out / "fit_a_disc.png", measured=["recorded"],
                      title="a disc of 25 x 2 mm"))
