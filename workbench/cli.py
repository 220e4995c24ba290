"""The ``workbench`` command.

Exit status: 0 done, 1 the computation failed or a check found something, 2 a mistake in the command or in a file,
130 interrupted (what was finished is on disk). A defect of the program itself ends in Python's traceback, status 1.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from inputs import InputError

if TYPE_CHECKING:
    from rich.console import Console

#: Shown by every command that has a drive.
DRIVE_HELP = ('"10 Vpp" at the electrodes (default), "10 Vpp @ 50 ohm" a generator of that open-circuit voltage, '
              '"0.1 W" constant input power')


OUTPUT_HELP = "folder for the results, made if need be"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` unless `arguments` are given); the return value is the exit status.

    Raises:
        SystemExit: as argparse does, status 2 for a faulty command and 0 after ``--help``.
    """
    options = _parser().parse_args(arguments)
    # Not before: whoever asks for help, or mistypes an option, need not wait for the numerical libraries.
    from rich.console import Console

    from workbench import commands

    console = Console(stderr=True, soft_wrap=True, highlight=False)
    run = {"simulate": commands.simulate, "compare": commands.compare, "mesh": commands.mesh,
           "export": commands.export, "render": commands.render, "materials": commands.materials}[options.command]
    started = time.perf_counter()
    with warnings.catch_warnings():
        _show_warnings(console)
        try:
            status = run(options, console)
        except InputError as error:
            _complain(console, "error", error)
            return 2
        except KeyboardInterrupt:
            console.print("interrupted; what was finished is on disk", style="yellow")
            return 130
        except commands.FAILURES as error:
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
    ours = tuple(str(root / name) for name in ("inputs.py", "geometry", "materials", "workbench"))
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="workbench", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Simulate an acoustofluidic chip, compare it with a recording, look at its fields.",
        epilog="exit status: 0 done, 1 computation failed, 2 mistake in the command or a file, 130 interrupted",
    )
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        return subparsers.add_parser(name, help=text, description=text)

    def with_materials(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--materials", type=Path, action="append", default=[], metavar="DIR",
                         help="a further folder of materials, material/source.toml (may be repeated; default none)")

    def with_state(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--state", metavar="NAME", help="state of the chip (default: the last of its file)")

    def with_model(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--from", dest="low", metavar="FREQ",
                         help='lower end of the band, such as "0.91 MHz" (default: of the chip)')
        sub.add_argument("--to", dest="high", metavar="FREQ", help="upper end of the band (default: of the chip)")
        sub.add_argument("--elements-per-wavelength", type=float, default=10.0, metavar="N",
                         help="quadratic elements per slowest wavelength (default 10)")
        with_materials(sub)
        # For the commands without these options.
        sub.set_defaults(points=481, at=None, full=False, tolerance=1e-5, drive="10 Vpp")

    simulate = command("simulate", "spectrum, figures of merit, fields, traps, CAD and report of a chip")
    simulate.add_argument("chip", type=Path, metavar="CHIP.toml")
    simulate.add_argument("--state", action="append", metavar="NAME",
                          help="only this state (may be repeated; default all)")
    with_model(simulate)
    simulate.add_argument("--points", type=int, default=481, metavar="N", help="frequencies in the band (default 481)")
    simulate.add_argument("--full", action="store_true",
                          help="solve every frequency instead of a reduced model (default); may be interrupted and "
                          "continued")
    simulate.add_argument("--at", metavar="FREQ", help="frequency of the fields (default f0)")
    simulate.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    simulate.add_argument("--tolerance", type=float, default=1e-5, metavar="ERROR",
                          help="relative error of the reduced model's impedance (default 1e-5)")
    simulate.add_argument("--no-cad", action="store_true", help="leave out the solid model (default: STEP, STL, view)")
    simulate.add_argument("--vtu", action="store_true", help="write the fields for ParaView too (default: not)")
    simulate.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)

    compare = command("compare", "compare a recorded impedance with the simulation of a chip")
    compare.add_argument("recording", type=Path, metavar="RECORDING")
    compare.add_argument("chip", type=Path, metavar="CHIP.toml")
    with_state(compare)
    compare.add_argument("--columns", type=Path, metavar="MAP.toml",
                         help="which columns of the recording are what, for a table of another instrument")
    compare.add_argument("--format", metavar="NAME",
                         help="format of the recording: workbench, e4990a, 4294a or touchstone (default: found out)")
    compare.add_argument("--correction", choices=("negate", "conjugate"),
                         help="put a wrong phase right, on your word (default: as recorded)")
    with_model(compare)
    compare.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)

    mesh = command("mesh", "mesh a chip; with --converge the change of f0 and Z_min between refinements")
    mesh.add_argument("chip", type=Path, metavar="CHIP.toml")
    with_state(mesh)
    with_model(mesh)
    mesh.add_argument("--converge", action="store_true", help="refine until f0 and Z_min change by less than --limit")
    mesh.add_argument("--limit", type=float, default=3.0, metavar="PERCENT", help="default 3, as in the paper")
    mesh.add_argument("--refinements", type=int, default=4, metavar="N", help="at most this many meshes (default 4)")
    mesh.add_argument("-o", "--output", type=Path, metavar="DIR",
                      help="folder for the report of the refinement (default: none is written)")

    export = command("export", "write the solids of a chip as STEP and STL")
    export.add_argument("chip", type=Path, metavar="CHIP.toml")
    export.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)

    render = command("render", "draw the fields of a chip at one frequency")
    render.add_argument("chip", type=Path, metavar="CHIP.toml")
    with_state(render)
    with_model(render)
    render.add_argument("--at", metavar="FREQ", required=True, help="frequency of the fields")
    render.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    render.add_argument("--field", action="append", metavar="NAME", help="displacement, pressure, gorkov, cutaway, "
                        "losses or mesh (may be repeated; default all)")
    render.add_argument("--vtu", action="store_true", help="write the fields for ParaView too (default: not)")
    render.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)

    materials = command("materials", "list, show or check the materials")
    materials.add_argument("action", choices=("list", "show", "check"))
    materials.add_argument("name", nargs="?", help="material, or material/source (default for check: all)")
    materials.add_argument("--temperature", metavar="TEMP",
                           help='such as "25 degC" (default: the reference temperature of the material)')
    with_materials(materials)
    return parser


if __name__ == "__main__":
    sys.exit(main())
