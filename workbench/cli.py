"""The ``workbench`` command.

Exit status: 0 done, 1 the computation failed or a check found something, 2 a mistake in the command or in a file,
3 not finished in the time it was given (`diagnose --minutes`), 130 interrupted (it says what is on disk). A defect of
the program itself ends in Python's traceback, status 1.
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` unless `arguments` are given); the return value is the exit status.

    Raises:
        SystemExit: as argparse does, status 2 for a faulty command and 0 after ``--help``.
    """
    from workbench.jobs import interruption

    own = arguments is None
    with interruption.heeded(stays=own) as interrupted:
        try:
            status = _main(arguments, interrupted)
        except KeyboardInterrupt:
            status = interruption.STATUS  # between two steps, where everything is written
    return interruption.finish(status) if own and interrupted.requested else status


def _main(arguments: Sequence[str] | None, interrupted: Interruption) -> int:
    # Nothing is imported sooner than it is needed: whoever asks for help, or mistypes an option or the name of a file,
    # need not wait for the numerical libraries.
    from workbench.commands.options import command_parser

    options = command_parser().parse_args(arguments)
    interrupted.output = str(getattr(options, "output", None) or "")
    if not getattr(options, "no_scripts", False):
        return _checked(options, interrupted)
    from geometry.scripts import no_scripts

    with no_scripts():
        return _checked(options, interrupted)


def _checked(options: argparse.Namespace, interrupted: Interruption) -> int:
    """Run the command that the options name, unless what they name has mistakes."""
    from workbench.commands.console import error_console

    console = error_console()
    from workbench.commands.early_checks import check_early
    from workbench.files.errors import InputError

    try:
        check_early(options)
    except InputError as error:
        _complain(console, "error", error)
        return 2
    import importlib

    command = importlib.import_module(f"workbench.commands.{options.command}")
    return _run(command, options, console, interrupted)


def _run(command: ModuleType, options: argparse.Namespace, console: Console, interrupted: Interruption) -> int:
    import time
    import warnings
    from contextlib import suppress

    from workbench.files.errors import InputError
    from workbench.files.writing import remedy
    from workbench.jobs import interruption
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
            held = getattr(options, "held", None)
            leftovers = str(held.tidy()) if held is not None and complete else ""
        except BaseException as error:
            interrupted.stage = "closing"
            if interrupted.requested or isinstance(error, KeyboardInterrupt):
                # Some libraries make other exceptions of it.
                return _interrupted(output, console, interrupted)
            match error:
                case InputError():
                    _complain(console, "error", error)
                    return 2
                case OSError():
                    _complain(console, "error", remedy(error, output))
                    return 1
                case RuntimeError() | ModelError():
                    # Through no defect of the program: our own errors are RuntimeErrors apart from this one.
                    _complain(console, type(error).__name__, error)
                    return 1
            raise
        finally:
            held = getattr(options, "held", None)
            # Threads in native code that were interrupted may still write: the folder is held until the program ends.
            if held is not None and (complete or interruption.wait()):
                with suppress(OSError):
                    held.finish(complete=complete)
    if interrupted.requested and output is not None:
        # The command made its report of what it knew by then.
        return _interrupted(output, console, interrupted)
    if leftovers:
        console.print(leftovers, markup=False)
    if status == 0 and output is not None:
        console.print(f"done in {time.perf_counter() - started:.1f} s; see {output}", markup=False)
    return status


def _interrupted(output: Path | None, console: Console, interrupted: Interruption) -> int:
    """Say what is on disk, once nothing is written any more; the exit status."""
    from workbench.jobs import interruption

    interruption.wait()
    console.print(interruption.on_disk(output, interrupted.since), style="yellow", markup=False)
    return interruption.STATUS


def _complain(console: Console, label: str, error: Exception | str) -> None:
    console.print(f"{label}:", style="bold red", end=" ")
    console.print(str(error), markup=False)


def _show_warnings(console: Console) -> None:
    """Print each warning of our own once, as one line; what other libraries say to programmers is not for the user.

    A lost imaginary part is a defect, never a warning.
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
