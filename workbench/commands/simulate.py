"""``workbench simulate``."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from geometry.chip import Chip, read_chip
from geometry.straight import straight_findings
from workbench.commands.export import export_solids, solid_names
from workbench.commands.parsed_options import ModelOptions, model_options, output_folder
from workbench.commands.states import SIMULATED, field_files, run_state, state_sizes, write_fields
from workbench.commands.terminal import Show, print_paragraph, print_table, progress_bars, say_finding
from workbench.fem.solve import NotConverged
from workbench.files.ownership import Outputs, discard
from workbench.files.writing import write_json
from workbench.jobs.workers import Processes
from workbench.model.job_size import memory_to_use
from workbench.model.problem import fill
from workbench.reduced.at_point import NotEnriched
from workbench.render import gallery
from workbench.render.canvas import Picture
from workbench.report.resonances import resonance_notes, resonances_table
from workbench.report.simulation import (
    ENERGY_PICTURE,
    gathering_record,
    simulated_figures_table,
    simulation_record,
    without_resonance,
    write_simulation_report,
)
from workbench.report.warm import WARMTH_PICTURE
from workbench.results.spectrum import write_spectrum
from workbench.simulation.gathering import Gathering, gathering
from workbench.simulation.run import DrawnState, Simulation

if TYPE_CHECKING:
    from rich.console import Console


def run_simulate(options: argparse.Namespace, console: Console) -> int:
    """``workbench simulate``: every state of a chip, with pictures, CAD and report."""
    chip = read_chip(options.chip)
    model = model_options(options, chip)
    chosen = options.state or [state.name for state in chip.states]
    # Each state once. The materials of every state are read before the first state is solved.
    states = list(dict.fromkeys(chip.state(name).name for name in chosen))
    for name in states:
        fill(chip, name, model.registry)
    folder = output_folder(options, simulation_outputs(chip, states))
    runs, failed = list[Simulation](), dict[str, RuntimeError]()
    wants = WantedFiles(cad=not options.no_cad, pictures=not options.no_pictures)
    unfinished = {name: folder / f"unfinished_{name}.csv" for name in states} if options.full else {}
    with _DrawingProcess(chip, folder, wants) as drawing, progress_bars(console) as show:
        for run in _simulated(chip, states, model, show, folder, unfinished, wants, failed):
            runs.append(run)
            if options.vtu:
                write_fields(run, folder)
            if wants.pictures:
                show(run.state, "pictures", SIMULATED)
                drawing.draw(run, is_last=len(runs) == len(states))
            show(run.state, "done", 1.0)
        if not runs:
            raise _of_state(failed)
        pictures, solid_view = drawing.pictures(), drawing.solid_view()
    # The last state is the working one: the filled chip comes after the empty one.
    write_spectrum(runs[-1].spectrum, folder / "spectrum.csv")
    answers = [found for run in runs
               if (found := gathering(run, registry=model.registry, kept=options.cold)) is not None]
    write_json(folder / "merit.json", {
        "chip": chip.name, "chip_file": str(options.chip), "spectrum_csv": runs[-1].state,
        "states": {run.state: simulation_record(run) for run in runs},
        "gathering": gathering_record(answers),
    })
    write_simulation_report(chip, runs, answers, pictures, solid_view, folder)
    # At the end, so that a run interrupted in its second state does not solve the first one again.
    for path in unfinished.values():
        discard(path)
    _print_results(chip, runs, answers, console, is_stated=options.at is not None)
    if failed:
        raise _of_state(failed)
    return 0


def _print_results(
    chip: Chip, runs: Sequence[Simulation], answers: Sequence[Gathering], console: Console, *, is_stated: bool
) -> None:
    """Print the results, the last state's first. The frequency of a dry state is printed if it `is_stated`."""
    first = straight_findings(chip.measure, chip.electrodes)
    for text in first:
        say_finding(text, console)
    print_table(chip.name, simulated_figures_table(chip, runs))
    circuits = {run.state: run.resonances for run in runs}
    print_table("", resonances_table(circuits))
    for text in resonance_notes(circuits):
        print_paragraph(text)
    for run in reversed(runs):
        if run.energy is not None or is_stated:
            print_paragraph(f"State {run.state}: {run.operating}")
        if run.warm is not None:
            print_paragraph(str(run.warm))
    for answer in reversed(answers):
        print_paragraph(str(answer))
    for text in dict.fromkeys(text for run in runs for text in run.findings if text not in first):
        say_finding(text, console)
    for text in without_resonance(runs):
        console.print(text, style="yellow", markup=False)


def _of_state(failed: Mapping[str, RuntimeError]) -> RuntimeError:
    name, error = next(iter(failed.items()))
    return RuntimeError(f"state {name}: {error}")


def simulation_outputs(chip: Chip, states: Sequence[str]) -> Outputs:
    """The files of `simulate` for some states of a chip."""
    return Outputs("simulate", working=("unfinished_*.csv",), names=(
        "report.html", "merit.json", "spectrum.csv", "impedance.png", ENERGY_PICTURE, WARMTH_PICTURE, "cad.png",
        *solid_names(chip),
        *(name for state in states for name in (f"spectrum_{state}.csv", f"unfinished_{state}.csv",
                                                *field_files(state)))))


def _simulated(
    chip: Chip, states: Sequence[str], model: ModelOptions, show: Show, folder: Path, unfinished: Mapping[str, Path],
    wants: WantedFiles, failed: dict[str, RuntimeError],
) -> Iterator[Simulation]:
    """The simulation of every state in turn. Its spectrum is in the `folder` as soon as it is known. The next state is
    computed while this one is drawn, if there is memory for both. `failed` gets the errors of states that cannot be
    solved; the others are finished. Full spectra are computed one after the other: they take long, and must stop when
    they are interrupted."""
    files = {name: folder / f"spectrum_{name}.csv" for name in states}
    if unfinished:
        for name in states:
            yield run_state(chip, name, model, show, unfinished=unfinished[name], spectrum=files[name])
        return
    stopped = Event()

    def report(state: str, activity: str, fraction: float) -> None:
        if stopped.is_set():
            raise KeyboardInterrupt
        show(state, activity, fraction)

    def solved(name: str) -> Simulation:
        run = run_state(chip, name, model, report, spectrum=files[name])
        _ = run.resonances  # fitted now, in parallel to the other state
        return run

    pool = ThreadPoolExecutor(max_workers=_at_a_time(chip, states, model))
    try:
        jobs = [pool.submit(solved, name) for name in states]
        if wants.pictures:
            gallery.load_libraries()
        for name, job in zip(states, jobs, strict=True):
            try:
                run = job.result()
            except (NotConverged, NotEnriched) as error:
                failed[name] = error
                continue
            yield run
    finally:
        # No waiting: native code stops at its next report of progress.
        stopped.set()
        pool.shutdown(wait=False, cancel_futures=True)


def _at_a_time(chip: Chip, states: Sequence[str], model: ModelOptions) -> int:
    """Two states at a time if the memory is sufficient, else one."""
    return 2 if sum(state_sizes(chip, states, model)[-2:]) <= memory_to_use().size else 1


@dataclass(frozen=True)
class WantedFiles:
    """The requested files: solid model, and pictures."""

    cad: bool
    pictures: bool


class _DrawingProcess:
    """A process for the solid model, and then for pictures of states.

    It works in parallel to this one, which solves and draws too.

    Raises:
        RuntimeError: the export failed.
    """

    def __init__(self, chip: Chip, folder: Path, wants: WantedFiles) -> None:
        self._folder, self._wants = folder, wants
        self._drawn: dict[str, Future[list[Picture]]] = {}
        self._own: dict[str, list[Picture]] = {}
        self._solids: Future[list[Picture]] | None = None
        if wants.cad or wants.pictures:
            self._worker = Processes(1, words=Path(os.devnull))
            self._solids = self._worker.submit(partial(_solid_model, chip, folder, wants))

    def __enter__(self) -> _DrawingProcess:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._solids is not None:
            self._worker.close()

    def draw(self, run: Simulation, *, is_last: bool) -> None:
        """Draw a state in the process; the last one half here."""
        halfway = len(gallery.FIELDS) // 2 if is_last else 0
        self._drawn[run.state] = self._worker.submit(
            partial(_drawn, run.drawn, self._folder, gallery.FIELDS[halfway:]))
        self._own[run.state] = gallery.draw_state(run, self._folder, of=gallery.FIELDS[:halfway])

    def pictures(self) -> dict[str, list[Picture]]:
        return {state: [*self._own[state], *drawn.result()] for state, drawn in self._drawn.items()}

    def solid_view(self) -> list[Picture]:
        try:
            return [] if self._solids is None else self._solids.result()
        except Exception as error:
            raise RuntimeError(f"the solid model was not made; --no-cad leaves it out ({error})") from error


def _solid_model(chip: Chip, folder: Path, wants: WantedFiles) -> list[Picture]:
    solids = export_solids(chip, folder)[1] if wants.cad else {}
    if not wants.pictures:
        return []
    gallery.load_libraries()
    return [gallery.draw_chip(chip, solids, folder / "cad.png")] if solids else []


def _drawn(state: DrawnState, folder: Path, fields: Sequence[str]) -> list[Picture]:
    return gallery.draw_state(state, folder, of=fields)
