"""The ``workbench`` command.

Exit status: 0 done, 1 the computation failed or a check found something, 2 a mistake in the command or in a file,
130 interrupted (what was finished is on disk).
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from inputs import InputError
from workbench import commands

#: Shown by every command that simulates.
DRIVE_HELP = '"10 Vpp" at the electrodes (default), "10 Vpp @ 50 ohm" a generator, "0.1 W" constant input power'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the return value is the exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    from rich.console import Console

    console = Console(stderr=True, soft_wrap=True)
    started = time.perf_counter()
    with warnings.catch_warnings():
        _show_warnings(console)
        try:
            status = int(options.run(options, console))
        except InputError as error:
            console.print(f"[bold red]error:[/] {_escaped(str(error))}")
            return 2
        except KeyboardInterrupt:
            console.print("[yellow]interrupted; what was finished is on disk[/]")
            return 130
        except (RuntimeError, ValueError, KeyError, OSError) as error:
            if options.traceback:
                raise
            console.print(f"[bold red]{type(error).__name__}:[/] {_escaped(str(error))}")
            return 1
    if status == 0 and getattr(options, "output", None) is not None:
        console.print(f"done in {time.perf_counter() - started:.1f} s; see [bold]{_escaped(str(options.output))}[/]")
    return status


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)


def _show_warnings(console: Any) -> None:
    """Print each warning once, as one line."""
    seen: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = f"{category.__name__}: {message}"
        if text not in seen:
            seen.add(text)
            console.print(f"[yellow]warning:[/] {_escaped(text)}")

    warnings.simplefilter("always")
    warnings.showwarning = show


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="workbench", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Simulate an acoustofluidic chip, compare it with a recording, look at its fields.",
        epilog="exit status: 0 done, 1 computation failed, 2 mistake in the command or a file, 130 interrupted",
    )
    parser.add_argument("--traceback", action="store_true", help="show where an unexpected error came from")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace, Any], int], text: str) -> argparse.ArgumentParser:
        sub = subparsers.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    def with_model(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--from", dest="low", metavar="FREQ", help='lower end of the band, such as "0.91 MHz"')
        sub.add_argument("--to", dest="high", metavar="FREQ", help="upper end of the band")
        sub.add_argument("--elements-per-wavelength", type=float, default=10.0, metavar="N",
                         help="quadratic elements per slowest wavelength (default 10)")
        sub.add_argument("--materials", type=Path, action="append", default=[], metavar="DIR",
                         help="a further folder of materials")

    simulate = command("simulate", commands.simulate,
                       "spectrum, figures of merit, fields, traps, CAD and report of a chip")
    simulate.add_argument("chip", type=Path, metavar="CHIP.toml")
    simulate.add_argument("--state", action="append", metavar="NAME", help="only this state (may be repeated)")
    with_model(simulate)
    simulate.add_argument("--points", type=int, default=481, help="frequencies in the band (default 481)")
    simulate.add_argument("--full", action="store_true", help="solve every frequency instead of the reduced model")
    simulate.add_argument("--at", metavar="FREQ", help="frequency of the fields (default f0)")
    simulate.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    simulate.add_argument("--tolerance", type=float, default=1e-5, help="relative error of the reduced model")
    simulate.add_argument("--no-cad", action="store_true", help="leave out the solid model")
    simulate.add_argument("--vtu", action="store_true", help="write the fields for ParaView too")
    simulate.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")

    compare = command("compare", commands.compare, "compare a recorded impedance with the simulation of a chip")
    compare.add_argument("recording", type=Path, metavar="RECORDING")
    compare.add_argument("chip", type=Path, metavar="CHIP.toml")
    compare.add_argument("--state", metavar="NAME")
    compare.add_argument("--format", help="file format of the recording (default: found out)")
    compare.add_argument("--correction", choices=("negate", "conjugate"), help="put a wrong phase right, on your word")
    with_model(compare)
    compare.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")

    mesh = command("mesh", commands.mesh, "mesh a chip; with --converge the change of f0 and Z_min between refinements")
    mesh.add_argument("chip", type=Path, metavar="CHIP.toml")
    mesh.add_argument("--state", metavar="NAME")
    with_model(mesh)
    mesh.add_argument("--converge", action="store_true", help="refine until f0 and Z_min change by less than --limit")
    mesh.add_argument("--limit", type=float, default=3.0, metavar="PERCENT", help="default 3, as in the paper")
    mesh.add_argument("--refinements", type=int, default=4, help="at most this many meshes (default 4)")
    mesh.add_argument("-o", "--output", type=Path, metavar="DIR")

    export = command("export", commands.export, "write the solids of a chip as STEP and STL")
    export.add_argument("chip", type=Path, metavar="CHIP.toml")
    export.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")

    render = command("render", commands.render, "draw the fields of a chip at one frequency")
    render.add_argument("chip", type=Path, metavar="CHIP.toml")
    render.add_argument("--state", metavar="NAME")
    with_model(render)
    render.add_argument("--at", metavar="FREQ", required=True, help="frequency of the fields")
    render.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    render.add_argument("--field", action="append", metavar="NAME", help="displacement, pressure, gorkov, cutaway, "
                        "losses or mesh (may be repeated; default all)")
    render.add_argument("--vtu", action="store_true", help="write the fields for ParaView too")
    render.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")

    materials = command("materials", commands.materials, "list, show or check the materials")
    materials.add_argument("action", choices=("list", "show", "check"))
    materials.add_argument("name", nargs="?", help="material, or material/source")
    materials.add_argument("--temperature", help='such as "25 degC"')
    materials.add_argument("--materials", type=Path, action="append", default=[], metavar="DIR",
                           help="a further folder of materials")
    return parser
