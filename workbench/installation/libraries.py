"""Checks of the libraries: versions, loading, drawing, and a solved disc."""

from __future__ import annotations

import math
import re
import tomllib
from importlib import metadata

from workbench.installation.check import Defect, in_own_process
from workbench.installation.machine import ROOT

#: Modules whose names differ from those of their packages.
MODULES = {"pyserial": "serial", "scikit-fem": "skfem", "vtk": "vtkmodules.vtkRenderingOpenGL2"}

#: Impedance (ohm, e^{+j w t}) of a disc of PZT at five frequencies from 0.91 to 1.155 MHz, by ``workbench simulate
#: geometry/chips/free_disc_25x2.toml --accuracy "0.5 %" --points 5 --full -o DIR``.
REFERENCE = (
    0.925414907280767 - 46.82246295540585j, 15.488426612521938 - 4.413875252042011j,
    17.912048765326276 + 57.76381354649907j, 263.5486448937386 + 637.7474500990438j,
    11.832272708779229 - 364.5771246162971j)

#: Largest relative difference from it, as root of the sum of squares. Linear algebra for other processors gives 4e-13.
#: Doubled, the self-test does not find an error of 1.5e-8.
AGREEMENT = 1e-8


def required() -> dict[str, str]:
    """The lowest version of each required package, "" if any."""
    file = ROOT / "pyproject.toml"
    stated = (tomllib.loads(file.read_text(encoding="utf-8"))["project"]["dependencies"] if file.is_file() else
              [each for each in metadata.requires("acoustofluidic-chip-workbench") or [] if "extra ==" not in each])
    return dict(found for each in (*stated, "vtk>=") for found in re.findall(r"^([\w-]+)>=([\d.]*)", each))


def package(name: str, least: str) -> str:
    """The version of a package. A Defect if it cannot be loaded, or is older than `least`."""
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        version = ""
    again = f"run ./setup, or pip install '{name}{least and '>=' + least}'"
    in_own_process(f"import {MODULES.get(name, name.replace('-', '_'))}", again)
    if version and _numbers(version) < _numbers(least):
        raise Defect(f"{version} is older than {least}", again)
    return version or "of unknown version"


def off_screen() -> str:
    """The class of the window in which VTK draws off screen."""
    return in_own_process("from workbench.render.off_screen import drawn_window; print(drawn_window())",
                          "install libegl1 and libgl1 (./setup does), and set "
                          "VTK_DEFAULT_OPENGL_WINDOW=vtkEGLRenderWindow")


def font() -> str:
    """The font of figures."""
    return in_own_process("from matplotlib.font_manager import FontProperties, findfont; "
                          "print(findfont(FontProperties(), fallback_to_default=False))",
                          "remove the cache of matplotlib, or install matplotlib again: it contains fonts")


def solved_disc() -> str:
    """The difference of a disc's impedance from :data:`REFERENCE`. A Defect above :data:`AGREEMENT`."""
    again = "run ./setup; if the fault stays, report it"
    *found, seconds = in_own_process(
        "import geometry, time, workbench as wb; wb.simulate; begun = time.perf_counter(); "
        "chip = wb.read_chip(geometry.__path__[0] + '/chips/free_disc_25x2.toml'); "
        "run = wb.simulate(chip, accuracy=5e-3, points=5, full=True); "
        "print(*map(complex, run.spectrum.impedance), time.perf_counter() - begun)", again).split()
    # NaN of any frequency stays NaN.
    difference = math.hypot(*(abs(complex(here) / there - 1.0) for here, there in zip(found, REFERENCE, strict=True)))
    words = f"relative difference {difference:.1e} at {len(REFERENCE)} frequencies, {float(seconds):.2g} s"
    if not difference <= AGREEMENT:
        raise Defect(f"{words}; expected at most {AGREEMENT:g}", again)
    return words


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)]
