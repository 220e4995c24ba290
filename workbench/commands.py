"""What each command of ``workbench`` does with its options. The parser and the exit status are in `cli`."""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import materials as registry_package
from geometry.chip import Chip, read_chip
from inputs import InputError, choose, parse_quantity
from materials.registry import Registry
from workbench.drive import parse_drive
from workbench.report import (
    FIGURE_COLUMNS,
    Block,
    Note,
    Picture,
    Table,
    comparison_record,
    figures_record,
    figures_row,
    measured_figures,
    number,
    simulation_record,
    write_json,
    write_report,
)
from workbench.simulate import Simulation
from workbench.simulate import simulate as simulate_state
from workbench.spectrum import write_csv

Show = Callable[[str, str, float], None]


def simulate(options: argparse.Namespace, console: Any) -> int:
    """``workbench simulate``: every state of a chip, its pictures, its CAD, and the report."""
    from workbench.render.gallery import draw_chip, draw_state

    chip = read_chip(options.chip)
    states = [chip.state(name).name for name in options.state] if options.state else [s.name for s in chip.states]
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    runs: list[Simulation] = []
    pictures: dict[str, list[Picture]] = {}
    with _solid_model(chip, folder, wanted=not options.no_cad) as parts, _progress(console) as show:
        for name in states:
            run = _run_state(chip, name, options, show, unfinished=folder / f"unfinished_{name}.csv")
            write_csv(run.spectrum, folder / f"spectrum_{name}.csv")
            (folder / f"unfinished_{name}.csv").unlink(missing_ok=True)
            show(name, "pictures", 0.5)
            pictures[name] = draw_state(run, folder)
            if options.vtu:
                _write_vtu(run, folder)
            show(name, "done", 1.0)
            runs.append(run)
        solids = parts()
    # The last state is the one the device works in: the filled chip comes after the empty one.
    write_csv(runs[-1].spectrum, folder / "spectrum.csv")
    write_json(folder / "merit.json", {
        "chip": chip.name, "chip_file": str(options.chip), "spectrum_csv": runs[-1].state,
        "states": {run.state: simulation_record(run) for run in runs},
    })
    solid_view = [draw_chip(chip, solids, folder / "cad.png")] if solids else []
    _simulation_report(chip, runs, pictures, solid_view, folder)
    _print_table(console, chip.name, _figures_table(chip, runs))
    return 0


def compare(options: argparse.Namespace, console: Any) -> int:
    """``workbench compare``: a recording beside the simulation of a chip."""
    from workbench.compare import compare as compare_spectra
    from workbench.readers import read
    from workbench.render import plots

    reading = read(options.recording, format=options.format)
    if options.correction:
        reading = reading.corrected(options.correction)
    measured = reading.spectrum
    chip = read_chip(options.chip)
    if options.low is None and options.high is None:
        options.low, options.high = f"{measured.frequency[0]!r} Hz", f"{measured.frequency[-1]!r} Hz"
    options.points = max(481, 2 * len(measured.frequency) - 1)
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    with _progress(console) as show:
        run = _run_state(chip, options.state, options, show)
        show(run.state, "done", 1.0)
    comparison = compare_spectra(measured, run.spectrum)
    write_csv(run.spectrum, folder / "spectrum.csv")
    spectra = {"measured": measured, "simulated": run.spectrum}
    residual = comparison.log_residual
    pictures = [
        Picture(plots.draw_spectra(spectra, folder / "impedance.png", measured=["measured"], title=chip.name),
                "impedance, measured and simulated"),
        Picture(plots.draw_residuals(
            comparison.measured.frequency,
            {"magnitude (%)": 100.0 * np.expm1(residual.real), "phase (degrees)": np.degrees(residual.imag)},
            folder / "residual.png", label="simulated against measured", title=chip.name,
        ), "residual: relative error of |Z| in per cent and error of phase in degrees"),
    ]
    merit, reason = measured_figures(measured)
    write_json(folder / "merit.json", {
        "chip": chip.name, "recording": str(options.recording), "state": run.state,
        "findings": [str(finding) for finding in reading.findings],
        "measured": figures_record(merit, reason), "simulated": simulation_record(run),
        "comparison": comparison_record(comparison),
    })
    rows = Table(("", "measured", "simulated", "difference (%)"), tuple(
        (row.metric, number(row.measured, 6), number(row.simulated, 6), f"{row.difference_percent:+.2f}")
        for row in comparison.rows))
    summary = Table(("over the common band", "value"), (
        ("MAPE of |Z| (%)", number(comparison.mape_percent)),
        ("rms of ln(Z_sim / Z_meas)", number(comparison.rms_log_residual)),
        ("mean, largest error of phase (degrees)",
         f"{comparison.phase_mean_deg:.2f}, {comparison.phase_max_deg:.2f}"),
        ("largest error of |Z| (%) and where", f"{comparison.worst_percent:.1f} at "
         f"{comparison.worst_frequency / 1e6:.4f} MHz"),
        ("measured points used", f"{100.0 * comparison.fraction_used:.1f} %"),
    ))
    notes: list[Block] = [Note(str(finding)) for finding in reading.findings]
    if comparison.rows_missing:
        notes.append(Note(comparison.rows_missing))
    materials_used = ", ".join(f"{region}: {m.name}" for region, m in run.problem.materials.items())
    write_report(folder / "report.html", f"{chip.name}: measured and simulated", [
        ("How far apart", [*notes, rows, summary, f"Nothing was fitted. Materials as filed: {materials_used}."]),
        ("Where in frequency", list(pictures)),
        ("The recording", [_origin_table(measured.origin)]),
        ("The model", [_model_table([run])]),
    ])
    _print_table(console, f"{chip.name}, {run.state}", rows)
    _print_table(console, "", summary)
    for finding in reading.findings:
        console.print(f"[yellow]finding:[/] {finding}", markup=True)
    return 0


def mesh(options: argparse.Namespace, console: Any) -> int:
    """``workbench mesh``: the mesh of a chip, and the paper's refinement study."""
    from geometry.mesh import elements_per_wavelength
    from workbench.problem import build, mesh_speeds

    chip = read_chip(options.chip)
    state = options.state or chip.states[-1].name
    registry, band = Registry(tuple(options.materials)), _band(options, chip)
    problem = build(chip, state, registry, band=band, elements_per_wavelength=options.elements_per_wavelength)
    speeds = {r: c for r, c in mesh_speeds(problem.mesh.section.regions, problem.materials).items() if math.isfinite(c)}
    counts = elements_per_wavelength(problem.mesh, speeds, band[1])
    cells = {region: len(problem.mesh.mesh.subdomains[region]) for region in problem.mesh.section.regions}
    table = Table(("region", "cells", "elements per wavelength"), tuple(
        (region, str(count), f"{counts[region]:.1f}" if region in counts else "empty")
        for region, count in cells.items()))
    _print_table(console, f"{chip.name}, {state}: {sum(cells.values())} cells at {band[1] / 1e6:.4g} MHz", table)
    if not options.converge:
        return 0
    return _converge(options, console, chip, state)


def _converge(options: argparse.Namespace, console: Any, chip: Chip, state: str) -> int:
    """Refine by sqrt(2) until f0 and Z_min change by less than the limit (Acevedo-Espinosa et al. (RP-UEIS), 3.2)."""
    rows: list[tuple[float, int, float, float, float]] = []
    status = 1
    with _progress(console) as show:
        for step in range(options.refinements):
            options.elements_per_wavelength = options.elements_per_wavelength * (math.sqrt(2.0) if step else 1.0)
            label = f"mesh {step + 1}"
            run = _run_state(chip, state, options, partial(_renamed, show, label))
            if run.figures is None:
                raise InputError(str(options.chip), "band", f"{options.low} to {options.high}",
                                 f"a band with a resonance in it ({run.no_resonance})")
            merit = run.figures
            rows.append((options.elements_per_wavelength, run.unknowns, merit.f0, merit.z_min, merit.q))
            if len(rows) > 1:
                last, now = rows[-2], rows[-1]
                change = 100.0 * max(abs(now[2] / last[2] - 1.0), abs(now[3] / last[3] - 1.0))
                if change < options.limit:
                    status = 0
                    break
    columns = ("elements per wavelength", "unknowns", "f0 (MHz)", "change (%)", "Z_min (ohm)", "change (%)", "Q")
    table = Table(columns, tuple(
        (f"{n:.1f}", str(size), f"{f0 / 1e6:.5f}", f"{100 * (f0 / rows[k - 1][2] - 1):+.4f}" if k else "",
         number(z), f"{100 * (z / rows[k - 1][3] - 1):+.3f}" if k else "", number(q))
        for k, (n, size, f0, z, q) in enumerate(rows)))
    _print_table(console, f"refinement of {chip.name}, {state}", table)
    console.print(f"{'converged' if status == 0 else 'NOT converged'}: limit {options.limit:g} % in f0 and Z_min")
    if options.output is not None:
        _write_convergence(options.output, chip, state, rows, table)
    return status


def _renamed(show: Show, label: str, _state: str, activity: str, fraction: float) -> None:
    show(label, activity, fraction)


def _write_convergence(
    folder: Path, chip: Chip, state: str, rows: list[tuple[float, int, float, float, float]], table: Table
) -> None:
    from workbench.render.plots import draw_convergence

    folder.mkdir(parents=True, exist_ok=True)
    blocks: list[Block] = [table]
    if len(rows) > 1:
        figures_of = np.array(rows)
        errors = {"f0": np.abs(figures_of[:-1, 2] / figures_of[-1, 2] - 1.0),
                  "Z_min": np.abs(figures_of[:-1, 3] / figures_of[-1, 3] - 1.0)}
        path = draw_convergence(1.0 / figures_of[:-1, 0], errors, folder / "convergence.png",
                                title=f"{chip.name}, {state}: difference from the finest mesh")
        blocks.append(Picture(path, "element size in wavelengths against the difference from the finest mesh"))
    columns = ["elements_per_wavelength", "unknowns", "f0_hz", "z_min_ohm", "q"]
    write_json(folder / "convergence.json", {"columns": columns, "rows": [list(row) for row in rows]})
    write_report(folder / "report.html", f"{chip.name}, {state}: mesh refinement", [("Refinement", blocks)])


def export(options: argparse.Namespace, console: Any) -> int:
    """``workbench export``: STEP of the assembly, STL of every part."""
    chip = read_chip(options.chip)
    options.output.mkdir(parents=True, exist_ok=True)
    for path in _write_solids(chip, options.output).values():
        console.print(str(path))
    return 0


def render(options: argparse.Namespace, console: Any) -> int:
    """``workbench render``: the fields at one frequency."""
    from workbench.render.gallery import FIELDS, draw_state

    only = options.field or list(FIELDS)
    for name in only:
        choose(name, FIELDS, source="command line", field="--field")
    chip = read_chip(options.chip)
    options.output.mkdir(parents=True, exist_ok=True)
    options.points = 5
    with _progress(console) as show:
        run = _run_state(chip, options.state, options, show)
    for picture in draw_state(run, options.output, only=only):
        console.print(str(picture.path))
    if options.vtu:
        console.print(str(_write_vtu(run, options.output)))
    if run.traps is not None:
        console.print(str(run.traps), markup=False)
    return 0


def materials(options: argparse.Namespace, console: Any) -> int:
    """``workbench materials list | show | check``."""
    registry = Registry(tuple(options.materials))
    temperature = None
    if options.temperature is not None:
        temperature = parse_quantity(options.temperature, "temperature", source="command line", field="--temperature")
    match options.action:
        case "list":
            rows = []
            for name in registry.names():
                material = _load_quietly(registry, name)
                rows.append((name, type(material).__name__, f"{material.density:.6g}"))
            _print_table(console, "materials", Table(("name", "kind", "density (kg/m^3)"), tuple(rows)))
        case "show":
            if options.name is None:
                raise InputError("command line", "NAME", None, "the name of a material; see `workbench materials list`")
            console.print(registry_package.describe(registry.load(options.name, temperature=temperature)), markup=False)
        case "check":
            names = registry.names() if options.name is None else [options.name]
            failed = 0
            for name in names:
                try:
                    with warnings.catch_warnings(record=True) as caught:
                        warnings.simplefilter("always")
                        registry.load(name, temperature=temperature)
                    console.print(f"{name}: ok" + "".join(f"\n  {w.message}" for w in caught), markup=False)
                except InputError as error:
                    failed += 1
                    console.print(f"{name}: {error}", markup=False)
            return 1 if failed else 0
    return 0


def _load_quietly(registry: Registry, name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", registry_package.PassivityWarning)
        return registry.load(name)


# What several commands share ----------------------------------------------------------------------------------------


def _band(options: argparse.Namespace, chip: Chip) -> tuple[float, float]:
    def end(text: str | None, default: float, field: str) -> float:
        return default if text is None else parse_quantity(text, "frequency", source="command line", field=field)

    band = end(options.low, chip.band[0], "--from"), end(options.high, chip.band[1], "--to")
    if not 0.0 < band[0] < band[1]:
        raise InputError("command line", "--from, --to", f"{band[0]:g} Hz to {band[1]:g} Hz", "a rising band")
    return band


def _run_state(
    chip: Chip, state: str | None, options: argparse.Namespace, show: Show, *, unfinished: Path | None = None
) -> Simulation:
    """Simulate a state as the options say; those a command does not have take the values of `simulate_state`."""
    from geometry.mesh import user_cache

    given = vars(options)
    at = given.get("at")
    band = _band(options, chip)
    frequency = None if at is None else parse_quantity(at, "frequency", source="command line", field="--at")
    if frequency is not None and not band[0] <= frequency <= band[1]:
        raise InputError("command line", "--at", at, f"a frequency within the band the mesh is made for, {band[0]:g} "
                         f"to {band[1]:g} Hz, or a wider band by --from and --to")
    name = chip.states[-1].name if state is None else chip.state(state).name
    full = bool(given.get("full", False))
    points = _UnfinishedSpectrum(unfinished, options) if full and unfinished is not None else None
    return simulate_state(
        chip, name, registry=Registry(tuple(options.materials)), band=band, points=given.get("points", 481),
        at=frequency, full=full, tolerance=given.get("tolerance", 1e-5), drive=parse_drive(given.get("drive", "10 Vpp")),
        elements_per_wavelength=options.elements_per_wavelength, mesh_cache=user_cache(),
        on_point=points.add if points else None, known=points.known if points else None,
        progress=lambda activity, fraction: show(name, activity, fraction),
    )


class _UnfinishedSpectrum:
    """Points of a full spectrum, on disk as soon as each is known, so that an interrupted run goes on from there.

    The first line is a digest of the chip file and of every option that changes the result; points of another chip or
    mesh are not taken over.
    """

    def __init__(self, path: Path, options: argparse.Namespace) -> None:
        deciding = ("state", "low", "high", "elements_per_wavelength", "materials")
        relevant = {key: str(vars(options)[key]) for key in deciding}
        content = Path(options.chip).read_bytes() + json.dumps(relevant).encode()
        self.path, self.key = path, hashlib.sha256(content).hexdigest()
        self.known: dict[float, complex] = {}
        if path.exists():
            with path.open(newline="") as stream:
                first, *rows = list(csv.reader(stream)) or [[]]
            if first == [self.key]:
                # A line cut short by a kill has fewer than three fields, or one that is no number: it is solved again.
                for row in rows:
                    try:
                        frequency, real, imaginary = (float.fromhex(x) for x in row)
                    except ValueError:
                        continue
                    self.known[frequency] = complex(real, imaginary)
        if not self.known:
            path.write_text(self.key + "\n")

    def add(self, frequency: float, impedance: complex) -> None:
        """Append one point and flush it."""
        with self.path.open("a", newline="") as stream:
            csv.writer(stream).writerow([x.hex() for x in (frequency, impedance.real, impedance.imag)])


@contextmanager
def _progress(console: Any) -> Iterator[Show]:
    """Progress bars, one for each state: called with the state, what is being done, and the fraction of it."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bars = Progress(TextColumn("{task.fields[state]:>12}"), TextColumn("{task.description:<14}"), BarColumn(),
                    TimeElapsedColumn(), console=console)
    tasks: dict[str, Any] = {}
    with bars:
        def show(state: str, activity: str, fraction: float) -> None:
            if state not in tasks:
                tasks[state] = bars.add_task(activity, total=1.0, state=state)
            bars.update(tasks[state], description=activity, completed=fraction)

        yield show


def _write_solids(chip: Chip, folder: Path) -> dict[str, Path]:
    """STEP of the assembly and STL of every part; the STL paths by part."""
    from geometry.export import export_step, export_stl

    export_step(chip, folder / "chip.step")
    return export_stl(chip, folder)


@contextmanager
def _solid_model(chip: Chip, folder: Path, *, wanted: bool) -> Iterator[Callable[[], Mapping[str, Path]]]:
    """The solid model made on the second core while the first one solves; call the result to wait for its files."""
    if not wanted:
        yield dict
        return
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        job = pool.submit(_write_solids, chip, folder)
        try:
            yield job.result
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _write_vtu(run: Simulation, folder: Path) -> Path:
    from workbench.render.vtu import write_vtu

    return write_vtu(run.fields, folder / f"fields_{run.state}.vtu")


def _figures_table(chip: Chip, runs: list[Simulation]) -> Table:
    rows = []
    for run in runs:
        rows.append(figures_row(f"{run.state}, simulated", run.figures, run.no_resonance))
        rows += [(f"{run.state}, {r.label}", f"{r.f0 / 1e6:.4f}", number(r.z_min), number(r.q), "", "")
                 for r in chip.state(run.state).reported]
    return Table(FIGURE_COLUMNS, tuple(rows))


def _model_table(runs: list[Simulation]) -> Table:
    columns = ("state", "unknowns", "full solves", "estimated error of Z", "residual", "energy closure", "time (s)")
    return Table(columns, tuple(
        (run.state, str(run.unknowns), str(run.solves), f"{run.error:.1e}", f"{run.residual:.1e}", f"{run.closure:.1e}",
         f"{sum(run.seconds.values()):.1f}") for run in runs))


def _origin_table(origin: Any) -> Table:
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return Table(("recording", ""), tuple((name, value) for name, value in rows if value))


def _simulation_report(
    chip: Chip, runs: list[Simulation], pictures: Mapping[str, list[Picture]], solid_view: list[Picture], folder: Path
) -> None:
    from workbench.render.plots import draw_spectra

    spectra = draw_spectra({run.state: run.spectrum for run in runs}, folder / "impedance.png", title=chip.name)
    dimensions = Table(("dimension", "value (mm)", "tolerance (um)", ""), tuple(
        (name, f"{d.value * 1e3:.4g}", "" if d.tolerance is None else f"{d.tolerance * 1e6:.3g}",
         ("assumed. " if d.assumed else "") + d.note) for name, d in chip.dimensions().items()))
    sections: list[tuple[str, list[Block]]] = [
        ("Figures of merit", [chip.description, _figures_table(chip, runs), Picture(spectra, "impedance"),
                              *([Note(f"Source: {chip.source}")] if chip.source else [])]),
    ]
    for run in runs:
        blocks: list[Block] = list(pictures[run.state])
        if run.traps is not None:
            blocks.insert(0, str(run.traps))
        sections.append((f"State {run.state} at {run.fields.frequency / 1e6:.4f} MHz, {run.fields.drive}", blocks))
    used = Table(("state", "region", "material", "source"), tuple(
        (run.state, region, m.name, m.source) for run in runs for region, m in run.problem.materials.items()))
    sections += [("The chip", [*solid_view, dimensions, used]), ("The model", [_model_table(runs)])]
    write_report(folder / "report.html", chip.name, sections)


def _print_table(console: Any, title: str, table: Table) -> None:
    from rich.table import Table as RichTable

    shown = RichTable(*table.columns, title=title)
    for row in table.rows:
        shown.add_row(*row)
    console.print(shown)
