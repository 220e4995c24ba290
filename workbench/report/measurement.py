"""Tables and page of a run of the bench; imported waveforms."""

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
from workbench.report.page import Block, Note, Picture, TextTable, Value, Verbatim, table, write_report
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
    """Write the report of a run: spectrum, uncertainty, doubtful points, settings."""
    title = setup.metadata.get("name", path.stem)
    events = table("time (UTC) | event", (
        (datetime.fromtimestamp(event.time, tz=UTC).isoformat(sep=" ", timespec="seconds"), event.text)
        for event in run.events))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        spectra = draw_spectra({f"{found.level:g} Vpp": found.spectrum for found in levels}, folder / "impedance.png",
                               measured=[f"{found.level:g} Vpp" for found in levels], title=title)
        flags = [Note(f"{found.level:g} Vpp: {flag}") for found in levels for flag in found.flags]
        return write_report(path, title, [
            ("Measurement", [*flags, *map(Note, weak_resonances(levels)), measured_figures_table(levels),
                                   Picture(spectra, "impedance")]),
            *((f"Uncertainty at {found.level:g} Vpp", _uncertainty(found, folder)) for found in levels),
            ("The recording", [origin_table(levels[0].spectrum.origin), events]),
            ("BENCH.toml", [Verbatim(run.setup_text)])])


def _uncertainty(found: LevelSpectrum, folder: Path) -> list[Block]:
    """The uncertainty at one level of drive, and the doubtful points."""
    relative, whole = 100.0 * found.noise / found.spectrum.magnitude, found.spectrum.uncertainty
    curves = {"noise": relative}
    if whole is not None:
        curves["with the part common to all points"] = 100.0 * whole / found.spectrum.magnitude
    rows: list[tuple[str, Value]] = [
        ("points", len(found.spectrum.frequency)),
        ("noise, median and largest (% of |Z|)", f"{np.median(relative):.2g}, {np.max(relative):.2g}"),
        ("shared by all points (% of Z)", 100.0 * found.common)]
    if not math.isnan(found.drift):
        rows.append(("disagreement of repeated points over their noise", found.drift))
    picture = draw_residuals(found.spectrum.frequency, curves, folder / f"uncertainty_{found.level:g}.png",
                             label="standard uncertainty (% of |Z|)")
    doubtful = [table("frequency (MHz):.6f | doubtful", found.point_flags)] if found.point_flags else []
    return [table("standard uncertainty | value:.2g", rows),
            Picture(picture, "of the real and of the imaginary part, each"), *doubtful]


def pairs_table(pairs: Sequence[WaveformPair], values: Sequence[PointImpedance] | None) -> TextTable:
    """The ratio of every pair of waveforms, and the impedance if known."""
    columns = "pair | frequency (Hz):.6g | ratio:.5g | phase (degrees):.2f | uncertainty (%):.2g"
    rows: list[tuple[Value, ...]] = [
        (p.name, p.fit.frequency, abs(p.ratio), degrees(p.ratio), p.relative) for p in pairs]
    if values is None:
        return table(columns, rows)
    return table(f"{columns} | |Z| (ohm):.5g | phase of Z (degrees):.2f", (
        (*row, abs(v.value), degrees(v.value)) for row, v in zip(rows, values, strict=True)))
