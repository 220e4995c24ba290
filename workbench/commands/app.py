"""``workbench app``."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import importlib.util
import signal
import tempfile
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.app.growth import growing_elsewhere
from workbench.app.section_fields import SectionFields
from workbench.app.server import Drawing, LiveView
from workbench.app.session import Session
from workbench.commands.parsed_options import model_options, reading_option
from workbench.commands.terminal import print_line, say_finding
from workbench.files.errors import InputError
from workbench.jobs.interruption import ENDS
from workbench.jobs.process import Send

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console

    from workbench.render.live import LivePicture

#: Ports that a program of a user may listen on; 0 is any that is free.
_PORTS = range(1024, 65536)


def run_app(options: argparse.Namespace, console: Console) -> int:
    """``workbench app``: serve the live view until interrupted."""
    if options.port and options.port not in _PORTS:
        raise InputError("command line", "--port", options.port, f"0, or {_PORTS[0]} to {_PORTS[-1]}")
    if importlib.util.find_spec("trame_vuetify") is None:
        raise RuntimeError("the live view needs trame and trame-vuetify (./setup installs them)")
    chip = read_chip(options.chip)
    model = model_options(options, chip)
    reading = None if options.recording is None else reading_option(options, options.recording, console)
    for finding in () if reading is None else reading.findings:
        say_finding(finding.message, console)
    if options.campaign is not None and not options.campaign.is_file():
        raise InputError("command line", "--campaign", str(options.campaign), "a file")
    session = Session(chip, options.state, options.vary, registry=model.registry, band=model.band,
                      accuracy=model.accuracy, drive=model.drive,
                      recording=None if reading is None else reading.spectrum,
                      recording_name="" if options.recording is None else options.recording.name,
                      growing=growing_elsewhere)
    view = LiveView(session, Drawing(_section, _space), options.folder, diagnose_as_command,
                    campaign=options.campaign)

    def ready(address: str) -> None:
        print_line(address)
        console.print("The live view is at this address, for this computer alone. Ctrl-C ends it.", markup=False)
        if not options.no_browser:
            webbrowser.open(address)

    # Ctrl-C is the usual end.
    with contextlib.suppress(KeyboardInterrupt), _cancelling():
        asyncio.run(view.serve(options.port, ready))
    return 0


def diagnose_as_command(send: Send, *, campaign: Path, folder: Path) -> None:
    """Run ``workbench diagnose`` in this process; send its exit status."""
    from workbench.cli import main

    send(main(["diagnose", str(campaign), "-o", str(folder)]))


@contextlib.contextmanager
def _cancelling() -> Iterator[None]:
    """Let Ctrl-C and other signals cancel `asyncio.run` in good order. asyncio cancels its main task, without an
    exception in it, if the handler of SIGINT is the interpreter's own. The other signals that interrupt a command raise
    SIGINT."""
    ours = threading.current_thread() is threading.main_thread()
    before = {end: handler for end in ENDS if ours and (handler := signal.getsignal(end)) is not signal.SIG_IGN}
    for end in before:
        signal.signal(end, signal.default_int_handler if end == signal.SIGINT else
                      lambda _number, _frame: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        for end, handler in before.items():
            signal.signal(end, handler)


def _section(found: SectionFields) -> Iterator[LivePicture]:
    from workbench.render.live import live_pictures

    return live_pictures(found.fields, found.traps)


def _space(found: SectionFields) -> bytes:
    from workbench.render.solids import draw_revolved

    with tempfile.TemporaryDirectory() as folder:
        return draw_revolved(found.fields, Path(folder) / "space.png").read_bytes()
