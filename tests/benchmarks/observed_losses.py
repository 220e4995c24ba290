"""Concealed losses of the liquid or of a solid: in how many trials the right one is named by Z, and with a bead's time.

    .venv/bin/python tests/benchmarks/observed_losses.py [--trials 20] [--first 0]

A small chip with its cavity empty and filled is recorded with 0.5 % of noise, and with a loss that nobody states. The
recordings, and a focusing time with 10 % of noise, are the model's own. Each trial is diagnosed twice.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from own_recordings import MATERIALS, any_recordings  # noqa: E402

from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.diagnosis.device import device_model  # noqa: E402
from workbench.results.spectrum import Spectrum, write_spectrum  # noqa: E402

EXAMPLE = ROOT / "geometry" / "chips" / "small_campaign"
PLA, GLASS, WATER = "pla/acevedo_2026", "soda_lime_glass/en572_2012", "water/iapws_2011"
#: The hypothesis that is right, its parameter, and the range (SI) that it is drawn from, evenly in its logarithm. The
#: least of the liquid hardly shows in the impedance; less than the least of the glass shows in nothing.
CASES = (("fluid absorption", f"{WATER}.diffusivity_of_sound", 3e-4, 3e-3),
         (f"shear_modulus loss of {PLA}", f"{PLA}.shear_modulus.loss", -60e6, -100e6),
         (f"shear_modulus loss of {GLASS}", f"{GLASS}.shear_modulus.loss", -4e8, -2e9))
NOISE, UNCERTAINTY = 0.005, 0.1
FREQUENCIES = np.linspace(0.95e6, 1.08e6, 161)
#: Error of Z that meshes are made for: the recordings' and the diagnosis' own, so that it is the same on both sides.
ACCURACY = 5e-3


def with_entry(text: str) -> str:
    """A text of a file with the polymer's entry named, of which the tests' materials have another."""
    return text.replace('"pla"', f'"{PLA}"').replace('"pla.', f'"{PLA}.')


def campaign_text(seconds: float) -> str:
    """The campaign of the example with a focusing time; none where it is zero."""
    text = with_entry((EXAMPLE / "campaign.toml").read_text(encoding="utf-8")).replace('noise = "0.5 %"\n', "")
    if not seconds:
        return text
    return text + (f'[states.filled.observations]\nfocusing_time = {{ value = "{seconds:.6g} s", uncertainty = "10 %", '
                   'drive = "10 Vpp", frequency = "1.04 MHz" }\n')


def trial(folder: Path, number: int) -> tuple[str, list[str]]:
    """The hypothesis that is right, and the ones named by Z alone and with the focusing time."""
    draw = np.random.default_rng(number)
    name, parameter, low, high = CASES[number % len(CASES)]
    water = 'temperature = "25 degC"'
    chip = with_entry((EXAMPLE / "chip.toml").read_text(encoding="utf-8")).replace(
        water, f'{water}\nparticle = "polystyrene"\nparticle_radius = "5 um"')
    made = device_model(any_recordings(folder, {"chip.toml": chip, "campaign.toml": campaign_text(1.0)}, FREQUENCIES),
                        accuracy=ACCURACY)
    x = made.stated
    x[made.index(parameter)] = low * (high / low) ** draw.uniform()
    own = made.of([made.effect(name)], x)
    near, seconds = own.fitted.near(x, {}, 1e-5), 0.0
    for index, recording in enumerate(near.recordings):
        clean = near.predict(x, index, ())[0]
        if recording.observable is not None:
            seconds = float(clean[0].real * np.exp(UNCERTAINTY * draw.standard_normal()))
            continue
        real, imaginary = draw.standard_normal((2, clean.size))
        seen = clean * (1.0 + NOISE * (real + 1j * imaginary))
        write_spectrum(Spectrum(FREQUENCIES, seen, NOISE * np.abs(seen)), folder / f"{recording.name}.csv")
    named = []
    for told in (0.0, seconds):
        (folder / "campaign.toml").write_text(campaign_text(told), encoding="utf-8")
        found = diagnose(read_campaign(folder / "campaign.toml", materials=[MATERIALS]), accuracy=ACCURACY)
        named.append(" and ".join(each.name for each in found.effects) or "nothing")
        print(f"    {number}: {parameter} {x[made.index(parameter)]:.3g}, {'with' if told else 'without'} the time: "
              f"{found.verdict}, {named[-1]}, {found.seconds:.0f} s", flush=True)
    return name, named


def lossy(name: str) -> str:
    """What loses by a hypothesis: "the liquid", or the solid that its name ends with; others are themselves."""
    return "the liquid" if name == CASES[0][0] else name.split(" of ")[-1] if " loss of " in name else name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    right = np.zeros(2, dtype=int)
    for number in range(options.first, options.first + options.trials):
        with tempfile.TemporaryDirectory() as name:
            truth, named = trial(Path(name), number)
        right += [lossy(each) == lossy(truth) for each in named]
    print(f"what loses is named in {right[0]} of {options.trials} by Z alone, in {right[1]} with the focusing time")


if __name__ == "__main__":
    main()
