"""One picture for every verdict of a diagnosis: `python docs/verdict_pictures.py FOLDER [NAME ...]`.

The device is a bare disc. Each recording is simulated with one stated difference from the disc of the campaign, and
diagnosed without knowledge of it. NAME is one of :data:`CASES`; all of them take about a minute. The build of the
documentation draws them. A case with another verdict than its own is an error: the page would show a wrong picture.
"""

from __future__ import annotations

import math
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import workbench as wb
from geometry.chip import Chip, read_chip
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fitting.measurement_model import log_ratio, through_bench
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduce
from workbench.render.canvas import new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, tidy
from workbench.results.spectrum import Spectrum

CERAMIC = "pz26/ferroperm"
C33, RESISTANCE = f"{CERAMIC}.c33", "bench.series_resistance"
DISC = f"""
[chip]
name = "disc"
band = ["0.92 MHz", "1.12 MHz"]
[[layers]]
role = "transducer"
material = "{CERAMIC}"
thickness = "2 mm"
radius = "5 mm"
electrodes = {{ live = "top" }}
"""
#: The priors of the campaign, as its file would state them.
KNOWN = {C33: "1 %", f"{CERAMIC}.e33": "1 %", f"{CERAMIC}.eps33": "1 %", f"{C33}.loss": "20 %", RESISTANCE: "50 mohm"}
FREQUENCIES = np.linspace(0.96e6, 1.06e6, 161)
#: Relative standard deviation of a point, and error of Z that the meshes are made for.
NOISE, ACCURACY = 0.005, 5e-4
#: Frequency (Hz) and quality of a resonator beside the disc; size of a picture (inches); least difference drawn (%).
RESONANCE, QUALITY, WIDTH, HEIGHT, LEAST = 1.03e6, 200.0, 7.6, 5.2, 0.1


@dataclass(frozen=True)
class Case:
    """A disc that differs from the stated one, and the verdict on its recording.

    ``difference`` states how, in words; ``factors`` multiply parameters of the model, ``bench`` holds elements of the
    bench (SI), ``resonator`` is the capacitance (F) of a resonator beside the disc, and ``minutes`` a time limit.
    """

    verdict: str
    difference: str
    factors: Mapping[str, float] = field(default_factory=dict)
    bench: Mapping[str, float] = field(default_factory=dict)
    resonator: float = 0.0
    minutes: float | None = None


CASES = {
    "no_mismatch": Case("no_mismatch", "nothing"),
    "parameters_explain": Case("parameters_explain", "c33 of the ceramic +1.5 %", {C33: 1.015}),
    "parameters_at_odds": Case("parameters_at_odds", "c33 of the ceramic +3.8 %", {C33: 1.038}),
    "below_detection": Case("below_detection", "0.33 ohm of contacts", bench={RESISTANCE: 0.33}),
    "missing_physics": Case("missing_physics", "1.5 ohm of contacts", bench={RESISTANCE: 1.5}),
    "alike": Case("missing_physics", "a phase of 1.72 deg between the channels", bench={"bench.phase": 0.03}),
    "besides": Case("missing_physics", "a stray capacitance of 30 pF, and a weak resonator at 1.03 MHz", {},
                    {"bench.parallel_capacitance": 3e-11}, 1e-13),
    "ambiguous": Case("ambiguous", "0.4 ohm of contacts", bench={RESISTANCE: 0.4}),
    "unexplained": Case("unexplained", "a resonator at 1.03 MHz", resonator=1.5e-13),
    "not_finished": Case("not_finished", "1.5 ohm of contacts", bench={RESISTANCE: 1.5}, minutes=1e-3),
}


def recording(chip: Chip, case: Case) -> Spectrum:
    """The spectrum of the disc of a case, with noise."""
    problem = build(fill(chip, chip.states[0].name, Registry()), accuracy=ACCURACY)
    values = {**problem.values, **{name: problem.values[name] * factor for name, factor in case.factors.items()}}
    solution = reduce(assemble(problem.mesh, problem.terms), FREQUENCIES, values).solve(FREQUENCIES, values)
    omega, relative = 2.0 * np.pi * FREQUENCIES, FREQUENCIES / RESONANCE
    # The solver has e^{-i w t}, a recording e^{+j w t}.
    admittance = 1.0 / np.conj(solution.impedance) + 1j * omega * case.resonator / (
        1.0 - relative**2 + 1j * relative / QUALITY)
    seen = through_bench(1.0 / admittance, omega, case.bench)[0]
    real, imaginary = np.random.default_rng(1).standard_normal((2, seen.size))
    return Spectrum(FREQUENCIES, seen * np.exp(NOISE * (real + 1j * imaginary)))


def diagnosed(case: Case) -> wb.Diagnosis:
    """The diagnosis of the recording of a case. Raises ValueError if it has another verdict than the case."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "disc.toml"
        path.write_text(DISC, encoding="utf-8")
        chip = read_chip(path)
    states = {"disc": {"chip": chip, "recording": recording(chip, case), "noise": NOISE}}
    found = wb.diagnose(wb.Campaign(states, known=KNOWN, from_files=False), accuracy=ACCURACY, minutes=case.minutes)
    if found.verdict != case.verdict:
        raise ValueError(f"{case.difference}: verdict {found.verdict!r}; expected {case.verdict!r}")
    return found


def draw(found: wb.Diagnosis, case: Case, path: Path) -> Path:
    """Draw |Z| as recorded, as stated and as found, above the difference of both models from the recording."""
    lines = [f"{case.verdict}. Concealed: {case.difference}.", *textwrap.wrap(found.headline, 105)]
    figure = new_figure(WIDTH, HEIGHT)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(4, 3))
    measured, megahertz = found.campaign.fitted[0].measured.impedance, FREQUENCIES / 1e6
    handles = upper.plot(megahertz, np.abs(measured), "o", markersize=2.5, color="#555555", alpha=0.6)
    fits = found.stated[0], found.best[0]
    for fit, colour, width, alpha in zip(fits, LINE_COLOURS, (3.5, 1.2), (0.45, 1.0), strict=False):
        handles += upper.plot(megahertz, np.abs(fit.impedance), color=colour, linewidth=width, alpha=alpha)
        difference = 100.0 * np.abs(log_ratio(fit.impedance, measured))
        lower.plot(megahertz, np.maximum(difference, LEAST), color=colour, linewidth=0.7 * width, alpha=alpha)
    handles.append(lower.axhspan(0.0, 200.0 * math.sqrt(2.0) * NOISE, facecolor="#dddddd", zorder=0))
    after = "with the effect that was found" if found.established else "with the known parameters fitted"
    is_far = fits[0].rms > 10.0 * fits[1].rms
    lower.set(yscale="log" if is_far else "linear", xlabel="frequency (MHz)", ylabel="difference (% of |Z|)")
    lower.set_ylim(bottom=LEAST if is_far else 0.0)
    lower.yaxis.set_major_formatter("{x:g}")
    upper.set(yscale="log", ylabel="|Z| (Ω)")
    for axes in (upper, lower):
        tidy(axes)
    figure.text(0.02, 1.0 - 0.1 / HEIGHT, "\n".join(lines), va="top", fontsize=9, linespacing=1.3)
    top = 1.0 - (0.15 + 0.18 * len(lines)) / HEIGHT
    figure.legend(handles, ["recording", "model as stated", f"model {after}", "noise, two sigma"], loc="upper left",
                  bbox_to_anchor=(0.01, top), ncols=4, frameon=False, fontsize=8, columnspacing=1.2)
    figure.subplots_adjust(left=0.1, right=0.98, top=top - 0.32 / HEIGHT, bottom=0.1, hspace=0.1)
    return save_figure(figure, path, dots_per_inch=100)


def pictures(folder: Path, names: Sequence[str] = ()) -> Iterator[Path]:
    """Draw the pictures of some cases, of all by default, into ``verdict_NAME.png`` of a folder."""
    for name in names or CASES:
        yield draw(diagnosed(CASES[name]), CASES[name], folder / f"verdict_{name}.png")


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    for picture in pictures(Path(sys.argv[1]), sys.argv[2:]):
        print(picture)
