"""Values of the options of a command, checked."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.chip import Chip
from geometry.chip_section import outer_boundaries
from geometry.operating_point import parse_operating_point
from geometry.plausible import check_band, meant_band
from materials.registry import Registry, user_folder, user_registry
from workbench.acoustics.heat import STILL_AIR
from workbench.files.errors import InputError, choose
from workbench.files.output import ROOM, begin
from workbench.files.ownership import Outputs
from workbench.files.quantities import frequency_text, in_another_unit, parse_quantity
from workbench.model.discretisation import Discretisation, discretisation
from workbench.model.drive import Drive, parse_drive, wired
from workbench.model.job_size import check_points
from workbench.simulation.warm import WarmUp

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from workbench.readers import Reading


@dataclass(frozen=True)
class ModelOptions:
    """The model of the options. Frequencies are in Hz, the rest as in `workbench.simulation.run.simulate`."""

    registry: Registry
    band: tuple[float, float]
    points: int
    at: float | str | None
    full: bool
    relative_error: float
    drive: Drive
    accuracy: float | Discretisation
    warm: WarmUp | None
    assumed_losses: bool


def model_options(options: argparse.Namespace, chip: Chip) -> ModelOptions:
    """The model of the options.

    Raises:
        InputError: a band that does not rise, a frequency outside it, a number of frequencies without room in memory,
            an accuracy without a mesh, or an invalid drive.
    """
    band = band_option(options, chip)
    check_points(options.points, source="command line", field="--points")
    at = None if options.at is None else parse_operating_point(options.at)
    if isinstance(at, float) and not band[0] <= at <= band[1]:
        raise InputError("command line", "--at", options.at, f"a frequency within the band the mesh is made for, "
                         f"{frequency_text(*band)}, or a wider band by --from and --to", in_another_unit(band, at))
    return ModelOptions(
        registry=user_registry(options.materials, inviscid=options.inviscid), band=band, points=options.points, at=at,
        full=options.full, relative_error=relative_error_option(options), drive=wired(parse_drive(options.drive), chip),
        accuracy=accuracy_option(options), warm=warm_option(options, chip),
        assumed_losses=options.assumed_losses,
    )


def warm_option(options: argparse.Namespace, chip: Chip) -> WarmUp | None:
    """The ways for the heat of the drive to leave.

    None for a liquid kept at its stated temperature.

    Raises:
        InputError: a drive that follows the peak of a liquid kept at its temperature, an unknown boundary, or a
            convection that is not positive.
    """
    if options.cold and options.follow:
        raise InputError("command line", "--follow", "--follow and --cold", "one of both: the peak of a chip "
                         "at a constant temperature does not move")
    convection = STILL_AIR if options.convection is None else parse_quantity(
        options.convection, "heat transfer coefficient", source="command line", field="--convection")
    if not convection > 0.0:
        raise InputError("command line", "--convection", options.convection, "a heat transfer coefficient above zero, "
                         'such as "10 W/(m^2 K)"')
    if options.holder is not None:
        choose(options.holder, outer_boundaries(chip), source="command line", field="--holder")
    return None if options.cold else WarmUp(convection, options.holder, options.follow)


def relative_error_option(options: argparse.Namespace) -> float:
    """The relative error of the reduced model, in per cent or plain.

    Raises:
        InputError: neither.
    """
    try:
        return float(options.relative_error)
    except ValueError:
        return parse_quantity(options.relative_error, "share", source="command line", field="--relative-error")


def accuracy_option(options: argparse.Namespace) -> float:
    """The relative accuracy of Z.

    Raises:
        InputError: no number or per cent, or an accuracy without a mesh.
    """
    accuracy = parse_quantity(options.accuracy, "share", source="command line", field="--accuracy")
    try:
        discretisation(accuracy)
    except InputError as error:
        raise InputError("command line", "--accuracy", options.accuracy, error.expected) from None
    return accuracy


@contextmanager
def executor_option(options: argparse.Namespace) -> Iterator[tuple[Executor | None, int]]:
    """The executor of the cluster, if any, and the number of tasks.

    Raises:
        InputError, RuntimeError, WorkerEnded: see `workbench.jobs.cluster`.
    """
    if options.dask is None:
        yield None, options.jobs or os.cpu_count() or 1
        return
    from workbench.jobs.cluster import dask_cluster

    with dask_cluster(options.dask) as (executor, threads):
        yield executor, options.jobs or threads


def band_option(options: argparse.Namespace, chip: Chip) -> tuple[float, float]:
    """The band (Hz); open ends are those of the chip.

    Raises:
        InputError: a band that does not rise, or is implausible for the chip.
    """
    def end(text: str | None, default: float, field: str) -> float:
        return default if text is None else parse_quantity(text, "frequency", source="command line", field=field)

    band = end(options.low, chip.band[0], "--from"), end(options.high, chip.band[1], "--to")
    if not 0.0 < band[0] < band[1]:
        raise InputError("command line", "--from, --to", frequency_text(*band), "a rising band",
                         meant_band(band, chip.layers))
    if "band" not in chip.unusual:
        check_band(chip.layers, band, "command line", "--from, --to")
    return band


def reading_option(options: argparse.Namespace, recording: Path, console: Console) -> Reading:
    """Read the recording by its options, and print its columns' meaning.

    Raises:
        InputError: a recording that cannot be read, or --columns and --format together.
    """
    from workbench.readers import read_column_map, read_recording

    if options.columns is not None and options.format is not None:
        raise InputError("command line", "--format", options.format, "--columns or --format, not both")
    columns = None if options.columns is None else read_column_map(options.columns)
    reading = read_recording(recording, columns=columns, format=options.format, correction=options.correction,
                             without_outliers=options.without_outliers)
    say_read_as(reading.read_as, recording.name, console)
    return reading


def common_band(
    options: argparse.Namespace, band: tuple[float, float], recorded: NDArray[np.float64]
) -> tuple[float, float]:
    """The overlap (Hz) of the requested band and a recording.

    `recorded` (n,) are its frequencies (Hz).

    Raises:
        InputError: fewer than two of them are in the band.
    """
    inside = recorded[(recorded >= band[0]) & (recorded <= band[1])]
    if inside.size < 2:
        raise InputError(
            str(options.recording), "frequency", frequency_text(*recorded[[0, -1]]),
            f"2 points or more in the band of {options.chip}, {frequency_text(*band)}; --from and --to set "
            "another band", in_another_unit(band, *recorded[[0, -1]]))
    return max(band[0], float(recorded[0])), min(band[1], float(recorded[-1]))


def say_read_as(read_as: str, name: str, console: Console) -> None:
    """Print the meaning of the columns of a table, if known."""
    if read_as:
        console.print(f"{name}: read {read_as}", markup=False)


def saving_folder(folders: Sequence[Path]) -> Path:
    """The folder for saved materials, created if needed.

    It is the last of `folders`, or else the user's own.

    Raises:
        InputError: a file is where the folder should be.
    """
    if not folders:
        return user_folder()
    try:
        folders[-1].mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError("command line", "--materials", str(folders[-1]), "a folder to save materials in; a file is in "
                         "the way") from None
    return folders[-1]


def output_folder(
    options: argparse.Namespace, outputs: Outputs, *, room: float = ROOM, inputs: Sequence[Path | str] = ()
) -> Path:
    """The output folder of the options, locked until the command ends.

    It is ``options.run_folder``. Files named in the options, and further `inputs`, are neither replaced nor removed.

    Raises:
        InputError: see `workbench.files.output.begin`.
    """
    named = [each for value in vars(options).values() for each in (value if isinstance(value, list) else [value])]
    read = [each for each in (*named, *map(Path, inputs)) if isinstance(each, Path) and each.is_file()]
    options.run_folder = begin(options.output, outputs, source="command line", field="--output", room=room, inputs=read)
    return options.run_folder.path
