"""Campaigns whose recordings are those of their own model, with noise and with something concealed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support import layer_text

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.diagnosis.device import device_model
from workbench.results.spectrum import Spectrum, write_spectrum

Real = NDArray[np.float64]

#: Lossy materials of no particular maker.
MATERIALS = Path(__file__).parent / "data" / "trials" / "0000" / "materials"

#: Relative standard deviation of a point.
NOISE = 3e-3

#: A disc between 0.88 and 1.12 MHz.
DISC = """
[chip]
name = "small"
band = ["0.88 MHz", "1.12 MHz"]
""" + layer_text("transducer", "pzt/trial", thickness="2 mm", radius="3 mm", electrodes='{ live = "top" }')
#: Its one recording; what is known of it follows.
DISC_RECORDED = """
[campaign]
known = "named"

[states.disc]
chip = "disc.toml"
recording = "disc.csv"
drive = "2 Vpp"
"""

#: Gel and a printed part with a cavity on it.
PRINTED = "".join((
    layer_text("couplant", "gel/trial", thickness="60 um", radius="3 mm"),
    layer_text("substrate", "pla/trial", thickness="0.8 mm", radius="3 mm"),
    layer_text("sidewall", "pla/trial", thickness="0.7 mm", radius="3 mm", cavity_radius="1.6 mm"),
))

#: A plate of a straight chip, and the stack on it.
PLATE = DISC.replace('radius = "3 mm"', 'width = "5 mm"').replace('name = "small"', '''name = "plate"
geometry = "straight"
length = "6 mm"''')
STACK = PLATE + "".join((
    layer_text("couplant", "gel/trial", thickness="60 um", half_width="2 mm"),
    layer_text("substrate", "pla/trial", thickness="0.8 mm", half_width="2 mm"),
    layer_text("sidewall", "pla/trial", thickness="0.7 mm", half_width="2 mm", cavity_width="0.8 mm"),
    layer_text("superstrate", "glass/trial", thickness="0.5 mm", half_width="2 mm"),
)) + """
[states.empty]
cavity = "vacuum"

[states.filled]
cavity = "water"
"""


def any_recordings(folder: Path, files: Mapping[str, str], recorded: Real) -> Campaign:
    """A campaign whose recordings, at the frequencies `recorded` (n,) Hz, are any resonance: it can be read.

    Args:
        files: the texts of the campaign, ``campaign.toml``, and of its chips, by the names of files; every state has
            its recording in the file that has its own name.
    """
    for name, text in files.items():
        (folder / name).write_text(text)
    omega = 2.0 * np.pi * recorded
    resonance = 100.0 + 0.01j * omega * (1.0 - (2.0 * np.pi * np.mean(recorded) / omega) ** 2)
    any_other = 1.0 / (1j * omega * 1e-10 + 1.0 / resonance)
    for line in files["campaign.toml"].splitlines():
        if line.startswith("recording = "):
            write_spectrum(Spectrum(recorded, any_other, NOISE * np.abs(any_other)), folder / line.split('"')[1])
    return read_campaign(folder / "campaign.toml", materials=[MATERIALS])


def conceal(
    folder: Path, files: Mapping[str, str], recorded: Real, values: Mapping[str, float], *, accuracy: float
) -> tuple[Campaign, Real]:
    """A campaign that was recorded with other values of some parameters of its own model, and all of these (p,).

    `files` and `recorded` as of :func:`any_recordings`; `accuracy` of the mesh that the recordings are made on.
    """
    device = device_model(any_recordings(folder, files, recorded), accuracy=accuracy)
    x = np.array([p.start for p in device.parameters])
    for name, value in values.items():
        x[device.index(name)] = value
    # On a mesh with lines of nodes at the edges of rims: nothing lies between two of them.
    own = device.of([effect for effect in device.effects if set(effect.names) & set(values)], x)
    near, rng = own.fitted.near(x, {}, 1e-5), np.random.default_rng(5)
    for index, recording in enumerate(near.recordings):
        clean, noise = near.predict(x, index, ())[0], rng.standard_normal((2, recorded.size))
        seen = clean * (1.0 + NOISE * (noise[0] + 1j * noise[1]))
        write_spectrum(Spectrum(recorded, seen, NOISE * np.abs(seen)), folder / f"{recording.name}.csv")
    return read_campaign(folder / "campaign.toml", materials=[MATERIALS]), x
