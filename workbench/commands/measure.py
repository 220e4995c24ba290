"""``workbench measure``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.bench.compensation import Compensation
from workbench.bench.pairs import degrees
from workbench.bench.plan import expected_points
from workbench.bench.rig import marker_path
from workbench.bench.run_file import Run, exists, journal_path, read_run, write_run
from workbench.bench.setup import BenchSetup, read_bench
from workbench.bench.spectra import level_spectra, read_compensation, results
from workbench.bench.sweep import measure
from workbench.commands.terminal import print_table
from workbench.files.errors import InputError
from workbench.files.output import begin
from workbench.files.ownership import Outputs
from workbench.report.measurement import measured_figures_table, weak_resonances, write_measurement
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

#: Columns and rows of the sketch of the spectrum so far.
_WIDTH, _HEIGHT = 64, 10


def run_measure(options: argparse.Namespace, console: Console) -> int:
    """``workbench measure``: sweep, run file, spectrum as CSV, report."""
    setup = read_bench(options.bench)
    # Before the sweep, so that a missing recording is found early.
    compensation = read_compensation(setup.standards)
    path: Path = options.output
    if path.suffix in (".csv", ".html"):
        raise InputError("command line", "--output", str(path), f"a run file, such as {path.stem}.h5; {path.stem}.csv "
                         f"and {path.stem}.html are written beside it")
    options.run_folder = begin(path.parent, Outputs(
        "measure", (f"{path.stem}.csv", f"{path.stem}_*Vpp.csv", f"{path.stem}.html"), kept=("*",), marked=False,
        named=(path.name, journal_path(path).name, marker_path(path).name)), source="command line", field="--output",
        inputs=[options.bench])
    before = exists(path)
    try:
        with _live(console, expected_points(setup)) as show:
            measure(setup, path, resume=options.resume, on_point=show)
    except InputError:
        raise  # a mistake in the command or in BENCH.toml: the file at the path is another run
    except BaseException:
        if exists(path) and (options.resume or not before):
            _write_results(setup, read_run(path), compensation, path, console)
        raise
    _write_results(setup, read_run(path), compensation, path, console)
    return 0


class _live:
    """The spectrum so far on the console; call it after every point."""

    def __init__(self, console: Console, expected: int) -> None:
        from rich.live import Live

        self._expected = expected
        self._live = Live(console=console, refresh_per_second=4, transient=True)

    def __enter__(self) -> _live:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def __call__(self, run: Run) -> None:
        from rich.text import Text

        points = run.points
        last = points[-1]
        lines = [f"{len(points)} of at most {self._expected} points; last {last.frequency / 1e6:.6f} MHz at "
                 f"{last.amplitude:g} Vpp: {abs(last.impedance):.4g} ohm +- {last.uncertainty:.2g}, "
                 f"{degrees(last.impedance):.1f} degrees",
                 *last.flags]
        level = [point for point in points if point.level == last.level]
        lines += sketch(np.array([p.frequency for p in level]), np.array([abs(p.impedance) for p in level]))
        self._live.update(Text("\n".join(lines)))


def sketch(frequency: NDArray[np.float64], magnitude: NDArray[np.float64]) -> list[str]:
    """|Z| (n,) ohm, logarithmic, over frequency (n,) Hz as lines of text. Empty for less than two frequencies."""
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
    """Write RUN.csv, RUN.html and the results in RUN.h5. Several levels have RUN_5Vpp.csv and so on."""
    levels = level_spectra(run, setup, compensation)
    if not levels:
        return
    write_run(run, path, results=results(levels, compensation))
    for found in levels:
        end = "" if len(setup.levels) == 1 else f"_{found.level:g}Vpp"
        write_spectrum(found.spectrum, path.with_name(path.stem + end + ".csv"))
    write_measurement(setup, run, levels, path.with_suffix(".html"))
    print_table(path.name, measured_figures_table(levels))
    for found in levels:
        for flag in found.flags:
            console.print(f"{found.level:g} Vpp: {flag}", style="yellow", markup=False)
    for text in weak_resonances(levels):
        console.print(text, style="yellow", markup=False)


