"""Concealed effects in a straight chip, its plate alone, empty and filled: how many a diagnosis names.

    .venv/bin/python tests/benchmarks/straight_trials.py [--trials 10] [--seed 1]

The recordings are the model's own with 0.3 % of noise, of known numbers drawn within their uncertainties; of ten trials
two conceal nothing. Sizes are drawn evenly within the range of each effect.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from own_recordings import MATERIALS, NOISE, PLATE, STACK, any_recordings  # noqa: E402

from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.diagnosis.device import device_model  # noqa: E402
from workbench.results.spectrum import Spectrum, write_spectrum  # noqa: E402

CAMPAIGN = '[campaign]\nknown = "named"\n' + "".join(
    f'\n[states.{name}]\nchip = "{chip}.toml"\n{state}recording = "{name}.csv"\n' for name, chip, state in (
        ("plate", "plate", ""), ("empty", "stack", 'state = "empty"\n'), ("filled", "stack", 'state = "filled"\n'))
) + """
[known]
"pzt/trial.c11" = "0.5 %"
"pzt/trial.c33" = "0.5 %"
"pzt/trial.e33" = "0.5 %"
"pzt/trial.eps33" = "1 %"
"pla/trial.shear_modulus" = "2 %"
"pla/trial.bulk_modulus" = "2 %"
"couplant.thickness" = "2 um"
"substrate.thickness" = "5 um"
"sidewall.thickness" = "5 um"
"cavity.half_width" = "5 um"
"bench.series_resistance" = "0.05 ohm"

[model]
inhomogeneity = "0"
"""
#: The hypothesis that is right, its parameter, and the range (SI, or relative) that it is drawn from.
CASES = (("", "", 0.0, 0.0),
         ("thickness of the couplant", "couplant.thickness", 75e-6, 120e-6),
         ("shear through the couplant", "gel/trial.gel_viscosity_root", 0.8, 2.0),
         ("dielectric loss", "pzt/trial.eps33.loss", 6.0, 20.0),
         ("shear_modulus loss of pla/trial", "pla/trial.shear_modulus.loss", -180e6, -120e6),
         ("fluid sound speed", "water/iapws_2011.sound_speed", 1.02, 1.05),
         ("", "", 0.0, 0.0),
         ("inductance of the leads", "bench.series_inductance", 1e-6, 2e-6),
         ("stray and probe capacitance", "bench.parallel_capacitance", 1e-11, 5e-11),
         ("load on the superstrate", "load on the superstrate.normal_impedance", 0.3e6, 1.5e6))
FREQUENCIES = np.linspace(0.9e6, 1.1e6, 161)
#: Error of Z that meshes are made for: the recordings' and the diagnosis' own.
ACCURACY = 5e-3


def trial(folder: Path, number: int, seed: int) -> tuple[str, str]:
    """The hypothesis that is right, and what is named; "" is nothing."""
    draw = np.random.default_rng([seed, number])
    name, parameter, low, high = CASES[number % len(CASES)]
    made = device_model(any_recordings(folder, {"plate.toml": PLATE, "stack.toml": STACK, "campaign.toml": CAMPAIGN},
                                       FREQUENCIES), accuracy=ACCURACY)
    x = made.stated
    for i, known in enumerate(made.parameters[:made.known]):
        x[i] += (known.prior or 0.0) * np.clip(draw.standard_normal(), -2.0, 2.0)
    if name:
        x[made.index(parameter)] = draw.uniform(low, high)
    own = made.of([made.effect(name)] if name else [], x)
    near = own.fitted.near(x, {}, 1e-5)
    for index, recording in enumerate(near.recordings):
        clean = near.predict(x, index, ())[0]
        real, imaginary = draw.standard_normal((2, clean.size))
        seen = clean * (1.0 + NOISE * (real + 1j * imaginary))
        write_spectrum(Spectrum(FREQUENCIES, seen, NOISE * np.abs(seen)), folder / f"{recording.name}.csv")
    began = time.process_time()
    found = diagnose(read_campaign(folder / "campaign.toml", materials=[MATERIALS]), accuracy=ACCURACY)
    named = " and ".join(each.name for each in found.effects)
    size = f" {x[made.index(parameter)]:.4g}" if name else ""
    print(f"{number}: {name or 'nothing'}{size}: {found.verdict}, {named or 'nothing'}, "
          f"{time.process_time() - began:.0f} s of processor time", flush=True)
    return name, named


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    found = []
    for number in range(options.trials):
        with tempfile.TemporaryDirectory() as name:
            found.append(trial(Path(name), number, options.seed))
    print(f"named rightly {sum(truth == named for truth, named in found)} of {len(found)}")


if __name__ == "__main__":
    main()
