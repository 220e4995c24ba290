"""``workbench measure``."""

from __future__ import annotations

import argparse
import math
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.bench.compensation import Compensation
from workbench.bench.run_file import Run, exists, read_run, write_run
from workbench.bench.setup import BenchSetup, read_bench
from workbench.bench.spectra import LevelSpectrum, level_spectra, read_compensation, results
from workbench.bench.sweep import Progress, measure
from workbench.commands.tables import origin_table
from workbench.commands.terminal import print_table
from workbench.files.errors import InputError
from workbench.report.figures import FIGURE_COLUMNS, figures_row, measured_figures
from workbench.report.page import Block, Note, Picture, TextTable, Verbatim, number_text, write_report
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

#: Columns and rows of the sketch of the spectrum so far.
_WIDTH, _HEIGHT = 64, 10


def run_measure(options: argparse.Namespace, console: Console) -> int:
    """``workbench measure``: sweep, run file, spectrum as CSV, report."""
    setup = read_bench(options.bench)
    # Before the sweep, so that a recording that is missing is not found out after it.
    compensation = read_compensation(setup.standards)
    path: Path = options.output
    path.parent.mkdir(parents=True, exist_ok=True)
    before = exists(path)
    try:
        with _ended_in_order(), _live(console) as show:
            measure(setup, path, resume=options.resume, show=show)
    except InputError:
        raise  # a mistake in the command or in BENCH.toml: what is at the path is another run
    except BaseException:
        if exists(path) and (options.resume or not before):
            _write_results(setup, read_run(path), compensation, path, console)
        raise
    _write_results(setup, read_run(path), compensation, path, console)
    return 0


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Let a request to terminate, or a terminal that is closed, do what Ctrl-C does: drive off, points kept."""
    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    ends = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(end, interrupt) for end in ends]
    try:
        yield
    finally:
        for end, handler in zip(ends, before, strict=True):
            signal.signal(end, handler)


class _live:
    """The spectrum so far on the console: call with every :class:`Progress`."""

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self._live = Live(console=console, refresh_per_second=4, transient=True)

    def __enter__(self) -> _live:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def __call__(self, progress: Progress) -> None:
        from rich.text import Text

        points = progress.run.points
        last = points[-1]
        lines = [f"{len(points)} of at most {progress.expected} points; last {last.frequency / 1e6:.6f} MHz at "
                 f"{last.amplitude:g} Vpp: {abs(last.impedance):.4g} ohm +- {last.uncertainty:.2g}, "
                 f"{math.degrees(math.atan2(last.impedance.imag, last.impedance.real)):.1f} degrees",
                 *last.flags]
        level = [point for point in points if point.level == last.level]
        lines += sketch(np.array([p.frequency for p in level]), np.array([abs(p.impedance) for p in level]))
        self._live.update(Text("\n".join(lines)))


def sketch(frequency: NDArray[np.float64], magnitude: NDArray[np.float64]) -> list[str]:
    """|Z| (n,) ohm, logarithmic, over frequency (n,) Hz as lines of text; empty until there are two frequencies."""
    low, high = frequency.min(), frequency.max()
    if not high > low:
        return []
    height = np.log(magnitude)
    bottom, top = height.min(), height.max()
    columns = np.minimum((frequency - low) / (high - low) * _WIDTH, _WIDTH - 1).astype(int)
    rows = np.minimum((height - bottom) / max(top - bottom, 1e-12) * _HEIGHT, _HEIGHT - 1).astype(int)
    cells = [[" "] * _WIDTH for _ in range(_HEIGHT)]
    for column, row in zip(columns, rows, strict=True):
        cells[_HEIGHT - 1 - row][column] = "•"
    ends = {0: f"{magnitude.max():.3g} ohm", _HEIGHT - 1: f"{magnitude.min():.3g} ohm"}
    lines = [f"{ends.get(index, ''):>12} │{''.join(row)}" for index, row in enumerate(cells)]
    scale = f"{low / 1e6:.4f} MHz"
    return [*lines, f"{'':>12} └{'─' * _WIDTH}", f"{'':>14}{scale}{high / 1e6:>{_WIDTH - len(scale) - 4}.4f} MHz"]


def _write_results(
    setup: BenchSetup, run: Run, compensation: Compensation, path: Path, console: Console
) -> None:
    """RUN.csv (RUN_5Vpp.csv and so on for several levels), RUN.html and the results in RUN.h5, of what there is."""
    levels = level_spectra(run, setup, compensation)
    if not levels:
        return
    write_run(run, path, results=results(levels, compensation))
    for found in levels:
        end = "" if len(setup.levels) == 1 else f"_{found.level:g}Vpp"
        write_spectrum(found.spectrum, path.with_name(path.stem + end + ".csv"))
    write_measurement(setup, run, levels, path.with_suffix(".html"))
    print_table(path.name, _figures(levels))
    for found in levels:
        for flag in found.flags:
            console.print(f"{found.level:g} Vpp: {flag}", style="yellow", markup=False)


def _figures(levels: tuple[LevelSpectrum, ...]) -> TextTable:
    return TextTable(FIGURE_COLUMNS, tuple(
        figures_row(f"{found.level:g} Vpp", measured_figures(found.spectrum)[0]) for found in levels))


def write_measurement(setup: BenchSetup, run: Run, levels: tuple[LevelSpectrum, ...], path: Path) -> Path:
    """The report of a run: spectrum, uncertainty, what is doubtful, how it was made."""
    from workbench.render.plots import draw_residuals, draw_spectra

    title = setup.metadata.get("name", path.stem)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        spectra = draw_spectra({f"{found.level:g} Vpp": found.spectrum for found in levels}, folder / "impedance.png",
                               measured=[f"{found.level:g} Vpp" for found in levels], title=title)
        blocks: list[Block] = [Note(f"{found.level:g} Vpp: {flag}") for found in levels for flag in found.flags]
        sections: list[tuple[str, list[Block]]] = [
            ("What was measured", [*blocks, _figures(levels), Picture(spectra, "impedance")])]
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
