"""A small chip with a cavity, meshed coarsely, for tests of the live view: a session of it answers within seconds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from support import layer_text

from geometry.chip import Chip, read_chip
from materials.registry import Registry
from workbench.app.session import Session
from workbench.jobs.process import Send
from workbench.model.discretisation import Discretisation
from workbench.results.spectrum import Spectrum

TEXT = """
[chip]
name = "little chip"
band = ["0.9 MHz", "1.1 MHz"]
""" + "".join((
    layer_text("transducer", "pic255/plutho", thickness="2 mm", radius="3 mm", electrodes='{ live = "top" }'),
    layer_text("substrate", "pla/acevedo_2026", thickness='{ value = "0.8 mm", tolerance = "20 um" }', radius="3 mm"),
    layer_text("sidewall", "pla/acevedo_2026", thickness="0.7 mm", radius="3 mm", cavity_radius="1.5 mm"),
    layer_text("superstrate", "soda_lime_glass/independent_reference", thickness="0.5 mm", radius="3 mm"),
)) + """[states.filled]
cavity = "water"
temperature = "20 degC"
"""
PLA = "pla/acevedo_2026"
#: What can be moved, and how far: little, so that models are small.
WANTED = ("substrate.thickness=0.78mm..0.82mm", "cavity.radius=1.48mm..1.52mm", f"{PLA}.shear_modulus=0.92GPa..0.94GPa")
COARSE = Discretisation(3, 1.0, corner_refinement=0.5)
POINTS = 61


def little_chip(folder: Path) -> Chip:
    path = folder / "little.toml"
    path.write_text(TEXT)
    return read_chip(path)


def session(folder: Path, recording: Spectrum | None = None) -> Session:
    return Session(little_chip(folder), None, WANTED, registry=Registry(), points=POINTS, accuracy=COARSE,
                   recording=recording)


#: A disc on gel and a polymer; nobody says how thick the gel is.
FILM_TEXT = """
[chip]
name = "disc on gel"
band = ["0.9 MHz", "1.1 MHz"]
""" + "".join((
    layer_text("transducer", "pic255/plutho", thickness="2 mm", radius="3 mm"),
    layer_text("couplant", "coupling_gel/acevedo_2026", thickness="20 um", radius="3 mm"),
    layer_text("substrate", "pla/acevedo_2026", thickness="0.8 mm", radius="3 mm"),
)) + """[states.assembled]
"""
GEL = "couplant.thickness"
#: Its resonances are too sharp for a mesh that is coarser.
LOOSE = 5e-3


def film_session(folder: Path, wanted: Sequence[str] = (GEL,), recording: Spectrum | None = None) -> Session:
    path = folder / "film.toml"
    path.write_text(FILM_TEXT)
    return Session(read_chip(path), None, wanted, registry=Registry(), points=POINTS, accuracy=LOOSE,
                   recording=recording)


def diagnosing(send: Send, *, campaign: Path, folder: Path) -> None:
    """What stands for ``workbench diagnose``: it says a word, and sends a status."""
    print(f"error: no state in {campaign.name}", file=sys.stderr)
    send(0 if campaign.stem == "good" else 2)
