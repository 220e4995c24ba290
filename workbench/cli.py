"""The ``workbench`` command.

Exit status: 0 done, 1 the computation failed or a check found something, 2 a mistake in the command or in a file,
3 not finished in the time it was given (`diagnose --minutes`), 130 interrupted (what was finished is on disk). A defect
of the program itself ends in Python's traceback, status 1.
"""

from __future__ import annotations

import importlib
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from workbench.files.errors import InputError
from workbench.options import parser

if TYPE_CHECKING:
    from rich.console import Console


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` unless `arguments` are given); the return value is the exit status.

    Raises:
        SystemExit: as argparse does, status 2 for a faulty command and 0 after ``--help``.
    """
    options = parser().parse_args(arguments)
    # Not before: whoever asks for help, or mistypes an option, need not wait for the numerical libraries.
    from rich.console import Console

    from workbench.physics.term import ModelError

    command = importlib.import_module(f"workbench.commands.{options.command}")
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    started = time.perf_counter()
    with warnings.catch_warnings():
        _show_warnings(console)
        try:
            status: int = command.run(options, console)
        except InputError as error:
            _complain(console, "error", error)
            return 2
        except KeyboardInterrupt:
            console.print("interrupted; what was finished is on disk", style="yellow")
            return 130
        except (RuntimeError, ModelError, OSError) as error:
            # Through no defect of the program: our own errors are RuntimeErrors apart from this one.
            _complain(console, type(error).__name__, error)
            return 1
    if status == 0 and getattr(options, "output", None) is not None:
        console.print(f"done in {time.perf_counter() - started:.1f} s; see {options.output}", markup=False)
    return status


def _complain(console: Console, label: str, error: Exception) -> None:
    console.print(f"{label}:", style="bold red", end=" ")
    console.print(str(error), markup=False)


def _show_warnings(console: Console) -> None:
    """Print each warning of our own once, as one line; what other libraries say to programmers is not for the user.

    A lost imaginary part is a defect, never a warning.
    """
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
