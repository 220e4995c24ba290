"""Simulation of a state by the options of a command."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from geometry.chip import Chip
from workbench.commands.parsed_options import ModelOptions
from workbench.commands.terminal import Show
from workbench.files.writing import write_atomic
from workbench.model.discretisation import discretisation
from workbench.model.job_size import job_size
from workbench.model.problem import fill
from workbench.results.spectrum import write_spectrum
from workbench.simulation.run import Simulation, Snapshot
from workbench.simulation.run import simulate as simulate_state

#: Share of the simulation in the progress bar of a state; the rest is for pictures.
SIMULATED = 0.9


def run_state(
    chip: Chip, state: str | None, model: ModelOptions, show: Show, *, unfinished: Path | None = None,
    spectrum: Path | None = None,
) -> Simulation:
    """The simulation of a state, by default the last one. A full spectrum continues from the file `unfinished`. The
    spectrum is written to the file `spectrum` as soon as it is known, in case of an interruption."""
    name = chip.state(state).name
    points = None if unfinished is None else _UnfinishedSpectrum(unfinished, chip, name, model)
    return simulate_state(
        chip, name, registry=model.registry, band=model.band, points=model.points, at=model.at, full=model.full,
        relative_error=model.relative_error, drive=model.drive, accuracy=model.accuracy, warm=model.warm,
        assumed_losses=model.assumed_losses,
        on_point=points.add if points else None, known=points.known if points else None,
        on_spectrum=(lambda _found: None) if spectrum is None else partial(write_spectrum, path=spectrum),
        progress=partial(simulated, show, name),
    )


def state_sizes(chip: Chip, states: Sequence[str], model: ModelOptions) -> list[float]:
    """Estimated memory (bytes) of the models of states, ascending."""
    made = discretisation(model.accuracy)
    devices = [fill(chip, name, model.registry) for name in states]
    return sorted(job_size(each.section, each.materials, made, model.band).memory for each in devices)


def simulated(show: Show, state: str, activity: str, fraction: float) -> None:
    """Show the progress of a simulation as its part of the bar."""
    show(state, activity, SIMULATED * fraction)


class _UnfinishedSpectrum:
    """Points of a full spectrum on disk, for a continued run. The first line is a digest of all inputs of the
    impedance: the chip, its materials with their values, and the mesh. Points with another digest are not used. Numbers
    are hexadecimal, hence exact."""

    def __init__(self, path: Path, chip: Chip, state: str, model: ModelOptions) -> None:
        filling = fill(chip, state, replace(model.registry, assumed_losses=model.assumed_losses)).materials
        deciding = repr((chip, state, sorted(filling.items()), model.band[1], discretisation(model.accuracy)))
        self.path, self.known = path, dict[float, complex]()
        key = hashlib.sha256(deciding.encode()).hexdigest()
        # Text after the last line end is incomplete after a kill: a number may lack its last digits.
        first, *rows = path.read_text().split("\n")[:-1] if path.exists() else [""]
        for row in rows if first == key else []:
            frequency, real, imaginary = (float.fromhex(number) for number in row.split(","))
            self.known[frequency] = complex(real, imaginary)
        self._lines = [key, *(_hexadecimal(f, z) for f, z in self.known.items())]

    def add(self, frequency: float, impedance: complex) -> None:
        """Add one point; it is on disk when this returns."""
        self._lines.append(_hexadecimal(frequency, impedance))
        write_atomic(self.path, "".join(f"{line}\n" for line in self._lines))


def _hexadecimal(frequency: float, impedance: complex) -> str:
    return ",".join(number.hex() for number in (frequency, impedance.real, impedance.imag))


def field_files(state: str) -> tuple[str, ...]:
    """Names of the files of the fields of a state. They are pictures (`workbench.render.gallery`) and a file for
    ParaView."""
    pictures = ("displacement", "pressure", "gorkov", "profiles", "cutaway", "losses", "mesh", "features",
                "pattern")
    return (f"fields_{state}.vtu", *(f"{name}_{state}.png" for name in pictures))


def write_fields(run: Snapshot, folder: Path) -> Path:
    """Write the fields of a state for ParaView."""
    from workbench.render.vtu import write_vtu

    return write_vtu(run.fields, folder / f"fields_{run.state}.vtu")
