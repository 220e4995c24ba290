"""The ``workbench`` command.

Exit status: 0 success, 1 the computation failed or a check found a problem, 2 a mistake in the command or in a file, 3
not finished in the allowed time (`diagnose --minutes`). An interrupted command reports the files on disk: 130 after
Ctrl-C, 143 after SIGTERM, 129 after SIGHUP. Too little memory gives one line and status 1. A defect of the program
gives Python's traceback, status 1.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from pathlib import Path
    from types import ModuleType
    from typing import TextIO

    from rich.console import Console

    from workbench.jobs.interruption import Interruption

#: Packages of this program. If one of their modules cannot be imported, the program has a defect.
OWN = {"workbench", "geometry", "materials"}
REPAIR = "install it by ./setup or pip; `workbench doctor` lists all faults of the installation"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    The default of `arguments` is ``sys.argv``.

    Raises:
        SystemExit: as argparse does, status 2 for a faulty command and 0 after ``--help``.
    """
    from workbench.jobs import interruption, memory

    own = arguments is None
    if own and memory.address_limit() is not None and (status := memory.supervised()) is not None:
        return status
    with interruption.heeded(stays=own) as interrupted:
        try:
            status = _main(arguments, interrupted)
        except KeyboardInterrupt:
            status = interrupted.status  # between two steps, when everything is written
    if own and interrupted.requested:
        interruption.leave(status)  # a thread may still be in native code
    return status


def _main(arguments: Sequence[str] | None, interrupted: Interruption) -> int:
    # Modules are imported when needed, so that help and errors in options do not wait for the numerical libraries.
    from workbench.commands.options import command_parser

    options = command_parser().parse_args(arguments)
    if options.command == "doctor":
        # It finds faults of the libraries that the other commands load first.
        from workbench.commands.doctor import run_doctor

        return run_doctor(options)
    interrupted.output = str(getattr(options, "output", None) or "")
    if not getattr(options, "no_scripts", False):
        return _checked(options, interrupted)
    from geometry.scripts import no_scripts

    with no_scripts():
        return _checked(options, interrupted)


def _checked(options: argparse.Namespace, interrupted: Interruption) -> int:
    """Check the files in the options, and run the command."""
    from workbench.commands.console import error_console

    console = error_console()
    import importlib

    from workbench.commands.early_checks import check_early
    from workbench.files.errors import InputError
    from workbench.jobs import interruption, memory

    try:
        memory.reserve_buffers()
        check_early(options)
        command = importlib.import_module(f"workbench.commands.{options.command}")
        return _run(command, options, console, interrupted)
    except InputError as error:
        _complain(console, "error", str(error))
        return 2
    except Exception as error:
        if not (memory.is_shortage(error) or memory.is_exhausted()):
            raise
        # The frames of the error keep arrays in memory. Libraries may lack memory to print, so they are not used.
        text = memory.shortage_text(error.with_traceback(None), _estimated(options))
        interruption.say("; ".join([text, *interruption.saved(error)]))
        return 1


def _estimated(options: argparse.Namespace) -> str:
    """The estimated memory of the largest state of the chip, or ""."""
    from contextlib import suppress

    # Without memory, no further libraries are loaded.
    if hasattr(options, "full") and hasattr(options, "chip") and "workbench.commands.states" in sys.modules:
        with suppress(Exception):  # memory may be short again
            from geometry.chip import read_chip
            from workbench.commands.parsed_options import model_options
            from workbench.commands.states import state_sizes
            from workbench.jobs.memory import shown_memory

            chip = read_chip(options.chip)
            sizes = state_sizes(chip, [state.name for state in chip.states], model_options(options, chip))
            return f"; the model of a state takes about {shown_memory(max(sizes))} beside the program (estimated)"
    return ""


def _run(command: ModuleType, options: argparse.Namespace, console: Console, interrupted: Interruption) -> int:
    import time
    import warnings
    from contextlib import suppress

    from workbench.files.errors import InputError
    from workbench.files.writing import remedy
    from workbench.jobs import interruption
    from workbench.jobs.interruption import saved
    from workbench.jobs.memory import is_shortage
    from workbench.physics.term import ModelError

    started = time.perf_counter()
    output = getattr(options, "output", None)
    complete = False
    with warnings.catch_warnings():
        _show_warnings(console)
        try:
            interrupted.stage = "working"
            status: int = getattr(command, f"run_{options.command}")(options, console)
            interrupted.stage = "closing"
            complete = not interrupted.requested
            folder = getattr(options, "run_folder", None)
            leftovers = str(folder.tidy()) if folder is not None and complete else ""
        except BaseException as error:
            interrupted.stage = "closing"
            if interrupted.requested or isinstance(error, KeyboardInterrupt):
                # Some libraries turn it into other exceptions.
                return _interrupted(output, console, interrupted, error)
            kept = "".join(f"; {words}" for words in saved(error))
            match error:
                case Exception() if is_shortage(error):
                    raise
                case InputError():
                    _complain(console, "error", f"{error}{kept}")
                    return 2
                case OSError():
                    _complain(console, "error", remedy(error, output) + kept)
                    return 1
                case ImportError() if (error.name or "").partition(".")[0] not in {*OWN, *sys.stdlib_module_names, ""}:
                    package = str(error.name).partition(".")[0]
                    _complain(console, "error", f"the package {package} cannot be loaded: {error}; {REPAIR}{kept}")
                    return 1
                case RuntimeError() | ModelError():
                    # Not a defect of the program: its own errors are RuntimeErrors or a ModelError.
                    _complain(console, type(error).__name__, f"{error}{kept}")
                    return 1
            raise
        finally:
            folder = getattr(options, "run_folder", None)
            # Interrupted threads in native code may still write, so the folder is locked until the program ends.
            if folder is not None and (complete or interruption.wait()):
                with suppress(OSError):
                    folder.finish(complete=complete)
    if interrupted.requested and output is not None:
        # The command has reported its partial results.
        return _interrupted(output, console, interrupted)
    if folder is not None and folder.has_mark:
        console.print(f"{output}: INCOMPLETE.txt stays: it is of another command's run, or was changed", style="yellow")
    if leftovers:
        console.print(leftovers, markup=False)
    if status == 0 and output is not None:
        console.print(f"done in {time.perf_counter() - started:.1f} s; see {output}", markup=False)
    return status


def _interrupted(
    output: Path | None, console: Console, interrupted: Interruption, error: BaseException | None = None
) -> int:
    """Print the files on disk and the saved entries; the exit status. It waits until nothing is written any more."""
    from workbench.jobs import interruption

    interruption.wait()
    words = [interruption.on_disk(output, interrupted.since), *interruption.saved(error)]
    console.print("; ".join(words), style="yellow", markup=False)
    return interrupted.status


def _complain(console: Console, label: str, text: str) -> None:
    console.print(f"{label}:", style="bold red", end=" ")
    console.print(text, markup=False)


def _show_warnings(console: Console) -> None:
    """Print each of our own warnings once, on one line.

    Warnings of other libraries are for programmers and are not printed. A lost imaginary part is an error.
    """
    import warnings
    from pathlib import Path

    from numpy.exceptions import ComplexWarning

    root = Path(__file__).parent.parent
    ours = tuple(str(root / name) for name in ("geometry", "materials", "workbench"))
    seen: set[str] = set()

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = str(message)
        if issubclass(category, UserWarning | RuntimeWarning) and filename.startswith(ours) and text not in seen:
            seen.add(text)
            console.print("warning:", style="yellow", end=" ")
            console.print(text, markup=False)

    warnings.simplefilter("always")
    warnings.simplefilter("error", ComplexWarning)
    warnings.showwarning = show


if __name__ == "__main__":
    sys.exit(main())
