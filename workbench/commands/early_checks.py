"""Checks before the numerical libraries are loaded.

They find missing files, and mistakes in chip files and quantities, without delay.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote

from geometry.operating_point import parse_operating_point
from workbench.files.errors import InputError, file_error, nearest_files
from workbench.files.quantities import parse_quantity
from workbench.files.tables import read_toml

#: Options that name an input file, of any command.
FILES = ("chip", "recording", "campaign", "goal", "study", "bench", "columns", "device", "file", "uncertainties",
         "diagnosed")

#: Options with a quantity, as on the command line, and its dimension.
QUANTITIES: Mapping[str, tuple[str, str]] = {
    "low": ("--from", "frequency"), "high": ("--to", "frequency"),
    "accuracy": ("--accuracy", "share"), "noise": ("--noise", "share"), "window": ("--window", "length"),
    "particle_radius": ("--particle-radius", "length"), "shortest": ("--shortest", "length"),
}

#: Options of `diagnose` for one recording, as on the command line; a campaign file has keys for them.
OF_ONE_RECORDING: Mapping[str, str] = {
    "chip": "--chip", "state": "--state", "columns": "--columns", "format": "--format", "correction": "--correction",
    "without_outliers": "--without-outliers", "noise": "--noise", "low": "--from", "high": "--to"}

#: Tables of a chip file that a campaign file lacks; a recording is not TOML.
OF_CHIPS = ("chip", "layers")


def _of_kind(path: Path) -> Callable[[Path], bool]:
    """A test of files for the suffix of `path`, ignoring case."""
    return lambda each: each.suffix.lower() == path.suffix.lower()


def check_early(options: argparse.Namespace) -> None:
    """Check the files and quantities in the options.

    Raises:
        InputError: as the command itself would raise.
    """
    for key in FILES:
        path = getattr(options, key, None)
        if key == "campaign" and hasattr(options, "chip"):
            continue  # an option of the live view, which names it
        if isinstance(path, Path) and not path.exists():
            raise file_error(path, "an existing file", nearest_files(path, _of_kind(path)))
        if isinstance(path, Path) and not (path.is_file() or path.is_dir()):
            raise file_error(path, "a file; this is a pipe or a device, which can be read only once: save its content")
    for key, (field, dimension) in QUANTITIES.items():
        text = getattr(options, key, None)
        if isinstance(text, str):
            parse_quantity(text, dimension, source="command line", field=field)
    if isinstance(getattr(options, "at", None), str):
        parse_operating_point(options.at)
    jobs = getattr(options, "jobs", None)
    if jobs is not None:
        from workbench.jobs.workers import check_jobs

        check_jobs(jobs, source="command line", field="--jobs", elsewhere=getattr(options, "dask", None) is not None)
    chip, recording = getattr(options, "chip", None), getattr(options, "recording", None)
    if isinstance(chip, Path) and isinstance(recording, Path):
        check_order(recording, chip)
    if hasattr(options, "diagnosed"):
        check_diagnosed(options)
    if options.command == "particles":
        check_motion(options)
    if isinstance(chip, Path):
        import warnings

        from geometry.chip import read_chip

        with warnings.catch_warnings():
            # The command reads the file again, and its warnings are shown.
            warnings.simplefilter("ignore")
            read_chip(chip)


def check_motion(options: argparse.Namespace) -> None:
    """Check the options of `particles`.

    They are a drive, a time, a number of particles and a seed, sizes and convection above zero, and ways for heat to
    leave only if there is heat.

    Raises:
        InputError: anything else.
    """
    if options.drive is None:
        raise InputError("command line", "--drive", None, 'the drive, such as "10 Vpp", "10 Vpp @ 50 ohm" or '
                         '"0.1 W": how far particles come in a time depends on it')
    if not 0.0 < options.minutes < float("inf"):
        raise InputError("command line", "--minutes", options.minutes, "a time above zero, such as 30")
    if options.count < 1:
        raise InputError("command line", "--count", options.count, "at least one particle, such as 200")
    if options.seed < 0:
        raise InputError("command line", "--seed", options.seed, "a whole number of 0 or more, such as 0")
    for field, text in (("--holder", options.holder), ("--convection", options.convection)):
        if text is not None and options.cold and options.flow != "heat":
            raise InputError("command line", field, text, f"no {field[2:]} beside --cold and --flow {options.flow}, "
                             "which leave heat out; or --flow heat")
    for field, text, dimension, example in (
            ("--window", options.window, "length", ""), ("--particle-radius", options.particle_radius, "length", ""),
            ("--convection", options.convection, "heat transfer coefficient", ', such as "10 W/(m^2 K)"')):
        if text is not None and not parse_quantity(text, dimension, source="command line", field=field) > 0.0:
            raise InputError("command line", field, text, f"a {dimension} above zero{example}")


def check_diagnosed(options: argparse.Namespace) -> None:
    """Check that `diagnose` has a campaign, or a recording and its chip.

    Raises:
        InputError: anything else.
    """
    given, chip = options.diagnosed, options.chip
    if _is_chip_file(given):
        if chip is not None:
            check_order(given, chip)
        raise InputError("command line", "recording", str(given), "a campaign file, or a recording; this is a chip "
                         f"file: `workbench diagnose RECORDING --chip {quote(str(given))}`")
    if not _is_toml(given):
        if chip is None:
            raise InputError("command line", "--chip", None, f"the chip file that {given} is a recording of, "
                             "--chip CHIP.toml; or, in place of the recording, a campaign file, which is TOML")
        if _is_toml(chip) and not _is_chip_file(chip):
            raise InputError("command line", "--chip", str(chip), "a chip file; a campaign file, which names its "
                             f"recordings, stands alone: `workbench diagnose {quote(str(chip))}`")
        return
    for key, option in OF_ONE_RECORDING.items():
        value = getattr(options, key)
        if value not in (None, False):
            raise InputError("command line", option, str(value), f"nothing beside the campaign file {given}, which "
                             "states it for each of its states; or a recording in its place")


def check_order(recording: Path, chip: Path) -> None:
    """Check that a recording and a chip file are not swapped.

    Raises:
        InputError: the recording is a TOML file, as chip files are.
    """
    if _is_toml(recording) and chip.is_file() and not _is_toml(chip):
        raise InputError("command line", "recording", str(recording), f"a recording of impedance; it is swapped with "
                         f"the chip file: {chip} is the recording, {recording} the chip file")
    if _is_toml(recording):
        raise InputError("command line", "recording", str(recording),
                         "a recording of impedance; this is a TOML file, as chip files are")


def _is_toml(path: Path) -> bool:
    """Whether a file has keys of TOML, or at least its suffix."""
    try:
        return bool(read_toml(path))
    except InputError:
        return path.suffix.lower() == ".toml"


def _is_chip_file(path: Path) -> bool:
    try:
        return any(key in OF_CHIPS for key in read_toml(path))
    except InputError:
        return False
