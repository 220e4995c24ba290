"""What each command of ``workbench`` does with its options. The parser and the exit status are in `cli`."""

from __future__ import annotations

import argparse
import hashlib
import math
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import materials as registry_package
from geometry.chip import Chip, read_chip
from geometry.mesh import elements_per_wavelength, user_cache
from inputs import InputError, choose, parse_quantity, write_atomic
from materials.kinds import Material
from materials.registry import Registry
from workbench.drive import Drive, parse_drive
from workbench.operators import ModelError
from workbench.particles import TrapReport, focus_time
from workbench.problem import build, chip_materials, mesh_speeds
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
from workbench.simulate import Simulation, Snapshot, snapshot, state_name
from workbench.simulate import simulate as simulate_state
from workbench.spectrum import Origin, write_csv

if TYPE_CHECKING:
    from rich.console import Console

#: Called with a state, what is being done for it, and the fraction of it that is done.
Show = Callable[[str, str, float], None]

#: What a computation may fail with through no defect of the program: our own errors are RuntimeErrors apart from this.
FAILURES: tuple[type[Exception], ...] = (RuntimeError, ModelError, OSError)

#: Share of the progress bar of a state that is the simulation; the pictures are the rest.
_SIMULATED = 0.9


def simulate(options: argparse.Namespace, console: Console) -> int:
    """``workbench simulate``: every state of a chip, its pictures, its CAD, and the report."""
    from workbench.render.gallery import draw_chip, draw_state

    chip = read_chip(options.chip)
    asked = _asked(options, chip)
    chosen = options.state or [state.name for state in chip.states]
    # Each once; and every state's materials are read before the first state is solved.
    states = list(dict.fromkeys(chip.state(name).name for name in chosen))
    for name in states:
        chip_materials(chip, name, asked.registry)
    folder = _folder(options.output)
    runs: list[Simulation] = []
    pictures: dict[str, list[Picture]] = {}
    unfinished = {name: folder / f"unfinished_{name}.csv" for name in states} if options.full else {}
    with _solid_model(options.chip, folder, wanted=not options.no_cad) as parts, _progress(console) as show:
        for name in states:
            run = _run_state(chip, name, asked, show, unfinished=unfinished.get(name))
            write_csv(run.spectrum, folder / f"spectrum_{name}.csv")
            show(name, "pictures", _SIMULATED)
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
    # Not sooner: a run interrupted in its second state must not solve the first one again.
    for path in unfinished.values():
        path.unlink(missing_ok=True)
    _print_table(chip.name, _figures_table(chip, runs))
    for note in _without_resonance(runs):
        console.print(note.text, style="yellow", markup=False)
    return 0


def compare(options: argparse.Namespace, console: Console) -> int:
    """``workbench compare``: a recording beside the simulation of a chip."""
    from workbench.compare import compare as compare_spectra
    from workbench.readers import read, read_column_map
    from workbench.render import plots

    columns = None if options.columns is None else read_column_map(options.columns)
    reading = read(options.recording, columns=columns, format=options.format)
    if options.correction:
        reading = reading.corrected(options.correction)
    measured = reading.spectrum
    chip = read_chip(options.chip)
    asked = _asked(options, chip)
    asked = replace(asked, band=_common_band(options, asked.band, measured.frequency),
                    points=max(asked.points, 2 * len(measured.frequency) - 1))
    folder = _folder(options.output)
    with _progress(console) as show:
        run = _run_state(chip, options.state, asked, show)
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
    _print_table(f"{chip.name}, {run.state}", rows)
    _print_table("", summary)
    for finding in reading.findings:
        console.print(f"finding: {finding.message}", style="yellow", markup=False)
    return 0


def _common_band(
    options: argparse.Namespace, band: tuple[float, float], recorded: NDArray[np.float64]
) -> tuple[float, float]:
    """Where the band asked for and the recording overlap (Hz): simulating more would have nothing to be compared with.

    Raises:
        InputError: fewer than two recorded points lie in the band.
    """
    inside = recorded[(recorded >= band[0]) & (recorded <= band[1])]
    if inside.size < 2:
        raise InputError(
            str(options.recording), "frequency", f"{recorded[0]:g} to {recorded[-1]:g} Hz",
            f"2 points or more in the band of {options.chip}, {band[0]:g} to {band[1]:g} Hz; --from and --to set "
            "another band")
    return max(band[0], float(recorded[0])), min(band[1], float(recorded[-1]))


def mesh(options: argparse.Namespace, console: Console) -> int:
    """``workbench mesh``: the mesh of a chip, and the paper's refinement study."""
    chip = read_chip(options.chip)
    asked, state, band = _asked(options, chip), state_name(chip, options.state), _band(options, chip)
    if options.converge and options.refinements < 2:
        raise InputError("command line", "--refinements", options.refinements, "at least 2 meshes to compare")
    if options.converge and not options.limit > 0.0:
        raise InputError("command line", "--limit", options.limit, "a change in per cent above zero")
    problem = build(chip, state, asked.registry, band=band, elements_per_wavelength=asked.elements_per_wavelength,
                    cache=user_cache())
    speeds = {r: c for r, c in mesh_speeds(problem.mesh.section.regions, problem.materials).items() if math.isfinite(c)}
    counts = elements_per_wavelength(problem.mesh, speeds, band[1])
    cells = {region: len(problem.mesh.mesh.subdomains[region]) for region in problem.mesh.section.regions}
    table = Table(("region", "cells", "elements per wavelength"), tuple(
        (region, str(count), f"{counts[region]:.1f}" if region in counts else "empty")
        for region, count in cells.items()))
    _print_table(f"{chip.name}, {state}: {sum(cells.values())} cells at {band[1] / 1e6:.4g} MHz", table)
    if not options.converge:
        return 0
    return _converge(options, console, chip, state, asked)


def _converge(options: argparse.Namespace, console: Console, chip: Chip, state: str, asked: _Asked) -> int:
    """Refine by sqrt(2) until f0 and Z_min change by less than the limit (Acevedo-Espinosa et al. (RP-UEIS), 3.2)."""
    rows: list[tuple[float, int, float, float, float]] = []
    status = 1
    with _progress(console) as show:
        for step in range(options.refinements):
            finer = replace(asked, elements_per_wavelength=asked.elements_per_wavelength * math.sqrt(2.0) ** step)
            label = f"mesh {step + 1}"
            run = _run_state(chip, state, finer, partial(_renamed, show, label))
            show(label, "done", 1.0)
            if run.figures is None:
                raise InputError(str(options.chip), "band", f"{asked.band[0]:g} to {asked.band[1]:g} Hz",
                                 f"a band with a resonance in it ({run.no_resonance})")
            merit = run.figures
            rows.append((finer.elements_per_wavelength, run.unknowns, merit.f0, merit.z_min, merit.q))
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
    _print_table(f"refinement of {chip.name}, {state}", table)
    _print(f"{'converged' if status == 0 else 'NOT converged'}: limit {options.limit:g} % in f0 and Z_min")
    if options.output is not None:
        _write_convergence(_folder(options.output), chip, state, rows, table)
    return status


def _renamed(show: Show, label: str, _state: str, activity: str, fraction: float) -> None:
    show(label, activity, fraction)


def _write_convergence(
    folder: Path, chip: Chip, state: str, rows: list[tuple[float, int, float, float, float]], table: Table
) -> None:
    from workbench.render.plots import draw_convergence

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


def export(options: argparse.Namespace, _console: Console) -> int:
    """``workbench export``: STEP of the assembly, STL of every part."""
    from geometry.export import export_step, export_stl

    chip, folder = read_chip(options.chip), _folder(options.output)
    for path in (export_step(chip, folder / "chip.step"), *export_stl(chip, folder).values()):
        _print(str(path))
    return 0


def render(options: argparse.Namespace, console: Console) -> int:
    """``workbench render``: the fields at one frequency."""
    from workbench.render.gallery import FIELDS, draw_state

    for name in options.field or []:
        choose(name, FIELDS, source="command line", field="--field")
    chip = read_chip(options.chip)
    asked, name, folder = _asked(options, chip), state_name(chip, options.state), _folder(options.output)
    if asked.at is None:
        raise InputError("command line", "--at", None, "the frequency of the fields")
    with _progress(console) as show:
        shot = snapshot(chip, name, asked.at, registry=asked.registry, band=asked.band, drive=asked.drive,
                        elements_per_wavelength=asked.elements_per_wavelength, mesh_cache=user_cache(),
                        progress=partial(_simulated, show, name))
        show(name, "pictures", _SIMULATED)
        paths = [picture.path for picture in draw_state(shot, folder, only=options.field)]
        if options.vtu:
            paths.append(_write_vtu(shot, folder))
        show(name, "done", 1.0)
    for path in paths:
        _print(str(path))
    if shot.traps is not None:
        _print(str(shot.traps))
    return 0


def materials(options: argparse.Namespace, _console: Console) -> int:
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
            _print_table("materials", Table(("name", "kind", "density (kg/m^3)"), tuple(rows)))
        case "show":
            if options.name is None:
                raise InputError("command line", "NAME", None, "the name of a material; see `workbench materials list`")
            _print(registry_package.describe(registry.load(options.name, temperature=temperature)))
        case "check":
            names = registry.names() if options.name is None else [options.name]
            failed = 0
            for name in names:
                try:
                    with warnings.catch_warnings(record=True) as caught:
                        warnings.simplefilter("always")
                        registry.load(name, temperature=temperature)
                    _print(f"{name}: ok" + "".join(f"\n  {w.message}" for w in caught))
                except InputError as error:
                    failed += 1
                    _print(f"{name}: {error}")
            return 1 if failed else 0
    return 0


def _load_quietly(registry: Registry, name: str) -> Material:
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


@dataclass(frozen=True)
class _Asked:
    """What the options say about a model: frequencies in Hz, the rest as :func:`workbench.simulate.simulate` has it."""

    registry: Registry
    band: tuple[float, float]
    points: int
    at: float | None
    full: bool
    tolerance: float
    drive: Drive
    elements_per_wavelength: float


def _asked(options: argparse.Namespace, chip: Chip) -> _Asked:
    band = _band(options, chip)
    at = None if options.at is None else parse_quantity(options.at, "frequency", source="command line", field="--at")
    if at is not None and not band[0] <= at <= band[1]:
        raise InputError("command line", "--at", options.at, f"a frequency within the band the mesh is made for, "
                         f"{band[0]:g} to {band[1]:g} Hz, or a wider band by --from and --to")
    if not (math.isfinite(options.elements_per_wavelength) and options.elements_per_wavelength > 0.0):
        raise InputError("command line", "--elements-per-wavelength", options.elements_per_wavelength,
                         "a number above zero; 10 is usual")
    return _Asked(
        registry=Registry(tuple(options.materials)), band=band, points=options.points, at=at, full=options.full,
        tolerance=options.tolerance, drive=parse_drive(options.drive),
        elements_per_wavelength=options.elements_per_wavelength,
    )


def _folder(path: Path) -> Path:
    """The output folder, made if need be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError("command line", "--output", str(path), "a folder; a file is in the way") from None
    return path


def _run_state(
    chip: Chip, state: str | None, asked: _Asked, show: Show, *, unfinished: Path | None = None
) -> Simulation:
    name = state_name(chip, state)
    points = None if unfinished is None else _UnfinishedSpectrum(unfinished, chip, name, asked)
    return simulate_state(
        chip, name, registry=asked.registry, band=asked.band, points=asked.points, at=asked.at, full=asked.full,
        tolerance=asked.tolerance, drive=asked.drive, elements_per_wavelength=asked.elements_per_wavelength,
        mesh_cache=user_cache(), on_point=points.add if points else None, known=points.known if points else None,
        progress=partial(_simulated, show, name),
    )


def _simulated(show: Show, state: str, activity: str, fraction: float) -> None:
    show(state, activity, _SIMULATED * fraction)


class _UnfinishedSpectrum:
    """Points of a full spectrum, on disk as soon as each is known, so that an interrupted run goes on from there.

    The first line is a digest of all that decides an impedance: the chip, its materials with their values, and the
    mesh. Points with another digest are not taken over. Numbers are hexadecimal, hence exact.
    """

    def __init__(self, path: Path, chip: Chip, state: str, asked: _Asked) -> None:
        filling = chip_materials(chip, state, asked.registry)
        deciding = repr((chip, state, sorted(filling.items()), asked.band[1], asked.elements_per_wavelength))
        self.path, self.known = path, dict[float, complex]()
        key = hashlib.sha256(deciding.encode()).hexdigest()
        # What follows the last line end was cut short by a kill: a number there may lack its last digits.
        first, *rows = path.read_text().split("\n")[:-1] if path.exists() else [""]
        for row in rows if first == key else []:
            frequency, real, imaginary = (float.fromhex(number) for number in row.split(","))
            self.known[frequency] = complex(real, imaginary)
        write_atomic(path, "".join(f"{line}\n" for line in (key, *(_hexadecimal(f, z) for f, z in self.known.items()))))

    def add(self, frequency: float, impedance: complex) -> None:
        """Append one point; it is on disk when this returns."""
        with self.path.open("a", encoding="ascii") as stream:
            stream.write(_hexadecimal(frequency, impedance) + "\n")


def _hexadecimal(frequency: float, impedance: complex) -> str:
    return ",".join(number.hex() for number in (frequency, impedance.real, impedance.imag))


@contextmanager
def _progress(console: Console) -> Iterator[Show]:
    """Progress bars, one for each state: called with the state, what is being done, and the fraction of it."""
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    bars = Progress(TextColumn("{task.fields[state]:>12}"), TextColumn("{task.description:<14}"), BarColumn(),
                    TimeElapsedColumn(), console=console)
    tasks: dict[str, TaskID] = {}
    with bars:
        def show(state: str, activity: str, fraction: float) -> None:
            if state not in tasks:
                tasks[state] = bars.add_task(activity, total=1.0, state=state)
            bars.update(tasks[state], description=activity, completed=fraction)

        yield show


@contextmanager
def _solid_model(chip_file: Path, folder: Path, *, wanted: bool) -> Iterator[Callable[[], dict[str, Path]]]:
    """``workbench export`` run on the second core while the first one solves.

    Call the result to wait for it and get the STL files by part.

    Raises:
        RuntimeError: the export failed; its last words.
    """
    if not wanted:
        yield dict
        return
    # A process of its own rather than multiprocessing's, which would run the caller's script a second time. CadQuery's
    # own warnings stay in it.
    command = [sys.executable, "-P", "-W", "ignore", "-m", "workbench.cli", "export", str(chip_file), "-o", str(folder)]
    with tempfile.TemporaryFile("w+") as words, subprocess.Popen(command, stdout=words, stderr=words) as process:
        def wait() -> dict[str, Path]:
            status = process.wait()
            words.seek(0)
            said = words.read().strip()
            if status:
                raise RuntimeError(f"the solid model was not made; --no-cad leaves it out ({said[-500:]})")
            return {path.stem: path for path in map(Path, said.splitlines()) if path.suffix == ".stl"}

        try:
            yield wait
        finally:
            process.kill()


def _write_vtu(run: Snapshot, folder: Path) -> Path:
    from workbench.render.vtu import write_vtu

    return write_vtu(run.fields, folder / f"fields_{run.state}.vtu")


def _figures_table(chip: Chip, runs: list[Simulation]) -> Table:
    rows = []
    for run in runs:
        rows.append(figures_row(f"{run.state}, simulated", run.figures))
        rows += [(f"{run.state}, {r.label}", f"{r.f0 / 1e6:.4f}", number(r.z_min), number(r.q), "", "")
                 for r in chip.state(run.state).reported]
    return Table(FIGURE_COLUMNS, tuple(rows))


def _without_resonance(runs: list[Simulation]) -> list[Note]:
    return [Note(f"{run.state}: {run.no_resonance}") for run in runs if run.figures is None]


def _model_table(runs: list[Simulation]) -> Table:
    columns = ("state", "unknowns", "full solves", "estimated error of Z", "residual", "energy closure", "time (s)")
    return Table(columns, tuple(
        (run.state, str(run.unknowns), str(run.solves), f"{run.error:.1e}", f"{run.residual:.1e}", f"{run.closure:.1e}",
         f"{sum(run.seconds.values()):.1f}") for run in runs))


def _origin_table(origin: Origin) -> Table:
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
         ": ".join(filter(None, ("assumed" if d.assumed else "", d.note)))) for name, d in chip.dimensions().items()))
    sections: list[tuple[str, list[Block]]] = [
        ("Figures of merit", [chip.description, f"Source: {chip.source}" if chip.source else "",
                              _figures_table(chip, runs), *_without_resonance(runs), Picture(spectra, "impedance")]),
    ]
    for run in runs:
        blocks: list[Block] = list(pictures[run.state])
        if run.traps is not None:
            blocks.insert(0, _particles_text(run.traps))
        sections.append((f"State {run.state} at {run.fields.frequency / 1e6:.4f} MHz, {run.fields.drive}", blocks))
    used = Table(("state", "region", "material", "source"), tuple(
        (run.state, region, m.name, m.source) for run in runs for region, m in run.problem.materials.items()))
    sections += [("The chip", [*solid_view, dimensions, used]), ("The model", [_model_table(runs)])]
    write_report(folder / "report.html", chip.name, sections)


def _print(text: str) -> None:
    """A result, to standard output so that it can be piped; all that is said on the way goes to the error console."""
    sys.stdout.write(text + "\n")


def _particles_text(traps: TrapReport) -> str:
    """The traps, the forces with the field they belong to, and how long focusing takes."""
    seconds = focus_time(traps)
    if seconds is None:
        return f"{traps}\nA particle a quarter wavelength above the deepest trap does not get there."
    return f"{traps}\nFocusing time from 90 to 10 % of a quarter wavelength above the deepest trap: {seconds:.3g} s"


def _print_table(title: str, table: Table) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table as RichTable

    shown = RichTable(*map(escape, table.columns), title=escape(title))
    for row in table.rows:
        shown.add_row(*map(escape, row))
    Console(highlight=False).print(shown)
