"""Diagnose a campaign
====================

A campaign is one device in several states, each with its recording, and what is known of the device. Here the
recordings are simulated, and one thing is not as the campaign says: the water is at 28 degC instead of 25 degC. The
diagnosis is told nothing of that.

Reference number: the temperature is off by +3 K; the interval that is found must hold it. The verdict is
"missing_physics"; a liquid that carries sound faster is the same finding by another name, and the headline says so.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import workbench as wb

LAYERS = (("transducer", "pic255", "2 mm", ""), ("couplant", "coupling_gel", "20 um", ""),
          ("substrate", "pla", "1 mm", ""), ("sidewall", "pla", "0.7 mm", 'cavity_radius = "2 mm"\n'),
          ("superstrate", "soda_lime_glass", "1 mm", ""))
CHIP = '[chip]\nname = "small chip"\nband = ["0.95 MHz", "1.08 MHz"]\n[states.empty]\ncavity = "vacuum"\n' + (
    '[states.filled]\ncavity = "water"\ntemperature = "25 degC"\n') + "".join(
    f'[[layers]]\nrole = "{role}"\nmaterial = "{material}"\nthickness = "{thickness}"\nradius = "4 mm"\n{hole}'
    for role, material, thickness, hole in LAYERS)
CAMPAIGN = "".join(f'[states.{name}]\nchip = "chip.toml"\nstate = "{name}"\nrecording = "{name}.csv"\nnoise = "0.5 %"\n'
                   for name in ("empty", "filled")) + """
[known]
"couplant.thickness" = "1 um"
"pla.shear_modulus" = "1 %"
"pla.bulk_modulus" = "1 %"
"bench.series_resistance" = "50 mohm"
"""

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    (folder / "chip.toml").write_text(CHIP, encoding="utf-8")
    (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    chip = wb.read_chip(folder / "chip.toml")
    warmer = replace(chip, states=(chip.states[0], replace(chip.states[1], temperature=273.15 + 28.0)))
    for state in ("empty", "filled"):
        # The entry of the ceramic states no loss, and the diagnosis takes it as it is.
        clean = wb.simulate(warmer, state, points=121, assumed_losses=False).spectrum
        real, imaginary = np.random.default_rng(1).standard_normal((2, clean.frequency.size))
        noisy = clean.impedance * np.exp(0.005 * (real + 1j * imaginary))
        np.savetxt(folder / f"{state}.csv", np.transpose([clean.frequency, noisy.real, noisy.imag]), delimiter=",",
                   header="frequency_hz,z_real_ohm,z_imag_ohm", comments="")
    found = wb.diagnose(wb.read_campaign(folder / "campaign.toml"))

print(found.verdict, *(effect.name for effect in found.effects))
print(found.headline)
print(*found.findings, sep="\n")
print(found.next_measurement)
