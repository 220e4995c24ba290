"""A run of the bench as tables and as a page; imported pairs of waveforms as a table."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from workbench.bench.impedance import PointImpedance
from workbench.bench.pairs import WaveformPair, degrees
from workbench.bench.run_file import Run
from workbench.bench.setup import BenchSetup
from workbench.bench.spectra import LevelSpectrum
from workbench.render.plots import draw_residuals, draw_spectra
from workbench.report.figures import figures_rows, figures_table, origin_table
from workbench.report.page import Block, Note, Picture, TextTable, Verbatim, number_text, write_report
from workbench.results.merit import measured_figures


def measured_figures_table(levels: Sequence[LevelSpectrum]) -> TextTable:
    """Figures of merit at every level of drive."""
    return figures_table([row for found in levels for row in figures_rows(
        f"{found.level:g} Vpp", measured_figures(found.spectrum)[0])])


def weak_resonances(levels: Sequence[LevelSpectrum]) -> list[str]:
    """A sentence on the weak resonance of every level that has one."""
    found = ((each.level, measured_figures(each.spectrum)[0]) for each in levels)
    return [f"{level:g} Vpp: {merit.weakness}" for level, merit in found if merit is not None and merit.is_weak]


def write_measurement(setup: BenchSetup, run: Run, levels: Sequence[LevelSpectrum], path: Path) -> Path:
    """The report of a run: spectrum, uncertainty, doubtful points, and the settings."""
    title = setup.metadata.get("name", path.stem)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        spectra = draw_spectra({f"{found.level:g} Vpp": found.spectrum for found in levels}, folder / "impedance.png",
                               measured=[f"{found.level:g} Vpp" for found in levels], title=title)
        blocks: list[Block] = [Note(f"{found.level:g} Vpp: {flag}") for found in levels for flag in found.flags]
        blocks += map(Note, weak_resonances(levels))
        sections: list[tuple[str, list[Block]]] = [
            ("What was measured", [*blocks, measured_figures_table(levels), Picture(spectra, "impedance")])]
        for found in levels:
            shown: list[Block] = [_uncertainty_table(found)]
            noise = 100.0 * found.noise / found.spectrum.magnitude
            whole = found.spectrum.uncertainty
            curves = {"noise": noise}
            if whole is not None:
                curves["with what all points share"] = 100.0 * whole / found.spectrum.magnitude
            shown.append(Picture(draw_residuals(
                found.spectrum.frequency, curves, folder / f"uncertainty_{found.level:g}.png",
                label="standard uncertainty (% of |Z|)"), "of the real and of the imaginary part, each"))
            if found.point_flags:
                shown.append(TextTable(("frequency (MHz)", "doubtful"), tuple(
                    (f"{at / 1e6:.6f}", flag) for at, flag in found.point_flags)))
            sections.append((f"Uncertainty at {found.level:g} Vpp", shown))
        sections += [
            ("The recording", [origin_table(levels[0].spectrum.origin), TextTable(("time (UTC)", "what happened"),
                                                                                  tuple(
                (datetime.fromtimestamp(event.time, tz=UTC).isoformat(sep=" ", timespec="seconds"), event.text)
                for event in run.events))]),
            ("BENCH.toml", [Verbatim(run.setup_text)]),
        ]
        return write_report(path, title, sections)


def _uncertainty_table(found: LevelSpectrum) -> TextTable:
    relative = 100.0 * found.noise / found.spectrum.magnitude
    rows = [("points", str(len(found.spectrum.frequency))),
            ("noise, median and largest (% of |Z|)", f"{np.median(relative):.2g}, {np.max(relative):.2g}"),
            ("shared by all points (% of Z)", number_text(100.0 * found.common, 2))]
    if not math.isnan(found.drift):
        rows.append(("disagreement of repeated points over their noise", number_text(found.drift, 2)))
    return TextTable(("standard uncertainty", "value"), tuple(rows))


def pairs_table(pairs: Sequence[WaveformPair], values: Sequence[PointImpedance] | None) -> TextTable:
    """The ratio of every pair of waveforms, and the impedance where a resistor gives one."""
    columns = ("pair", "frequency (Hz)", "ratio", "phase (degrees)", "uncertainty (%)")
    rows = [(p.name, f"{p.fit.frequency:.6g}", f"{abs(p.ratio):.5g}", f"{degrees(p.ratio):.2f}",
             f"{100.0 * p.relative:.2g}") for p in pairs]
    if values is None:
        return TextTable(columns, tuple(rows))
    return TextTable((*columns, "|Z| (ohm)", "phase of Z (degrees)"), tuple(
        (*row, f"{abs(v.value):.5g}", f"{degrees(v.value):.2f}") for row, v in zip(rows, values, strict=True)))
