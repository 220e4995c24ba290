"""The live view on the page: what is asked there goes to the session, what it answers goes there.

Answers are worked out in threads, one spectrum and one picture at a time; while one is, the newest question waits and
older ones are dropped. So the page follows a slider as fast as the model answers, and never queues up.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from workbench.app import guard, plot
from workbench.app.background import FAILURES, Background
from workbench.app.page import lay_out
from workbench.app.panels import Drawn, curve, described, embedded, figure_cards, picture
from workbench.app.section_fields import SectionFields
from workbench.app.session import NotReady, Session
from workbench.app.spectrum_view import SpectrumView
from workbench.app.works import KINDS, REPORT, Works
from workbench.files.errors import InputError, choose
from workbench.ranges import OutOfRange

#: Seconds after which a number that was moved is taken to rest: it is then one step that can be undone.
RESTS = 0.5

#: Steps of a slider.
_STEPS = 200


@dataclass(frozen=True)
class Drawing:
    """How fields are drawn: their ``section``, and the chip cut open in ``space`` (PNG)."""

    section: Callable[[SectionFields], Sequence[Drawn]]
    space: Callable[[SectionFields], bytes]


class LiveView:
    """A session on a page of its own server. Serve it by :meth:`serve`; ``address`` opens the page."""

    def __init__(self, session: Session, drawing: Drawing, folder: Path, *, campaign: Path | None = None) -> None:
        """Chip files and reports go to `folder`, which is made when it is needed; `campaign` is what a diagnosis is of,
        instead of the one recording."""
        from trame.app import get_server

        self.session, self.drawing, self.folder = session, drawing, folder
        self.token, self.address = guard.new_token(), ""
        self.works = Works(session, folder, campaign)
        self._background = Background(self._heard)
        self._names = [each.name for each in session.controls]
        self._frequency: float | None = None
        self._view: SpectrumView | None = None
        self._dots: tuple[Mapping[str, float], list[tuple[float, complex]]] = ({}, [])
        self._saved: set[Path] = set()
        # What is to be answered: the spectrum, then the fields, then what makes the next answer faster.
        self._asked = asyncio.Event()
        self._moved = self._picked = self._idle = False
        self._rest: asyncio.TimerHandle | None = None
        self._grow_again, self._waiting = False, ""
        # Its own options are none of the command's.
        os.environ.setdefault("TRAME_ARGS", "--server --nosignalhandlers")
        os.environ["WSLINK_READY_MSG"] = ""
        self._server = get_server(self.token, client_type="vue3")
        self._state = self._server.state
        self._begin()
        lay_out(self._server, len(self._names))
        self._listen()

    # ----------------------------------------------------------------------------------------------------------------
    # Serving.

    async def serve(self, port: int = 0, ready: Callable[[str], None] = lambda _address: None) -> None:
        """Serve the page on this computer alone until cancelled; `ready` is called with its address.

        `port` 0 is any that is free.

        Raises:
            OSError: the port is taken.
        """
        self._loop = asyncio.get_running_loop()
        answers = ThreadPoolExecutor(1)
        self._server.controller.on_server_bind.add(self._bind)

        def started(**_state: object) -> None:
            self.address = guard.address(self._server.port, self.token)
            ready(self.address)

        self._server.controller.on_server_ready.add(started)
        served = self._server.start(port=port, host=guard.HOST, timeout=0, open_browser=False, exec_mode="coroutine",
                                    show_connection_info=False, disable_logging=True)
        serving = asyncio.ensure_future(served)
        answering = asyncio.ensure_future(self._answering(answers))
        self._grow()
        try:
            await asyncio.shield(serving)
        finally:
            if self._rest is not None:
                self._rest.cancel()
            answering.cancel()
            await asyncio.gather(answering, return_exceptions=True)
            await self._server.stop()
            await serving
            self.works.close()
            await asyncio.to_thread(self._background.close)
            answers.shutdown()

    def _bind(self, wslink: Any) -> None:
        from aiohttp import web

        async def report(_request: web.Request) -> web.StreamResponse:
            path = self.works.report
            if not path.is_file():
                raise web.HTTPNotFound
            return web.FileResponse(path)

        guard.protect(wslink.app, self.token)
        wslink.app.router.add_get(f"/{REPORT}", report)

    # ----------------------------------------------------------------------------------------------------------------
    # What the page says.

    def _listen(self) -> None:
        for name, act in {"undo": self._undo, "redo": self._redo, "reset": self._reset, "tolerate": self._tolerate,
                          "free": self._free, "pick": self._pick, "follow": self._follow, "save": self._save,
                          "space": self._space}.items():
            self._server.trigger(name)(act)
        for kind in ("full", "fit", "diagnose"):
            self._server.trigger(kind)(lambda kind=kind: self._start_or_stop(kind))
        for index in range(len(self._names)):
            self._state.change(f"x_{index}")(lambda index=index, **_state: self._move(index))

    def _move(self, index: int) -> None:
        control, told = self.session.controls[index], self._state[f"x_{index}"]
        try:
            if told == _rounded(self.session.values[control.name] * control.factor):
                return
            self.session.move(control.name, float(told) / control.factor)
        except (InputError, TypeError, ValueError) as error:
            self._complain(error)
            self._show_numbers()
            return
        self._say("")
        self._touch()
        if self._rest is not None:
            self._rest.cancel()
        self._rest = self._loop.call_later(RESTS, self._rested)

    def _rested(self) -> None:
        """A number rests: one step more that can be undone, and ranges that hold it."""
        self.session.settle()
        with self._state:
            names = self.session.widen()
            if names:
                self._grow()
            self._show_rows()
        if not names:
            self._background.start("check", lambda say, stopped: self.works.check(self._shown()))

    def _undo(self) -> None:
        self.session.undo()
        self._changed()

    def _redo(self) -> None:
        self.session.redo()
        self._changed()

    def _reset(self, name: str) -> None:
        self.session.reset(name or None)
        self._changed()

    def _tolerate(self, name: str, text: str) -> None:
        try:
            known = {each.name: each.factor for each in self.session.controls}
            factor = known[choose(name, known, source="live view", field="tolerance")]
            self.session.tolerate(name, float(text) / factor if str(text).strip() else None)
        except ValueError as error:
            self._complain(error)
        self._changed()

    def _free(self, name: str, wanted: bool) -> None:
        (self.works.free.add if wanted and name in self._names else self.works.free.discard)(name)
        self._show_rows()

    def _pick(self, share: float) -> None:
        self._frequency = self._scale().frequency_at(float(share))
        self._show_frequency()
        self._picked = True
        self._asked.set()

    def _follow(self) -> None:
        self._frequency = None
        self._show_frequency()
        self._picked = True
        self._asked.set()

    def _space(self) -> None:
        self._state.in_space = not self._state.in_space
        self._state.space = ""
        self._picked = True
        self._asked.set()

    def _save(self, name: str) -> None:
        """Save the chip under a plain name in the folder; nothing that was there before is overwritten."""
        path = self.folder / str(name)
        try:
            if path.name != name or path.suffix != ".toml" or name.startswith("."):
                raise InputError("live view", "file", name, 'a plain name that ends in ".toml"')
            if path.exists() and path not in self._saved:
                raise InputError("live view", "file", name, f"a new name: {path} exists")
            self.folder.mkdir(parents=True, exist_ok=True)
            self.session.save(path)
        except (InputError, OSError) as error:
            self._complain(error)
            return
        self._saved.add(path)
        constants = self.session.moved_constants()
        self._say(f"saved as {path}" + ("; constants of materials are told in its description only"
                                        if constants else ""))

    def _start_or_stop(self, kind: str) -> None:
        if kind in self._background.running():
            self._background.stop(kind)
            return
        if kind == "full":
            self._dots = (self.session.values, [])
            self._show_dots()
            self._background.start(kind, lambda say, stopped: self.works.full(say, stopped, self._dot))
        else:
            self._background.start(kind, getattr(self.works, kind))

    def _grow(self) -> None:
        """A model of the present ranges; where one is being made of others, after that."""
        if self._background.start("model", self.works.model) is None:
            self._grow_again = True
            self._background.stop("model")

    # ----------------------------------------------------------------------------------------------------------------
    # What happens in the background; called from its threads.

    def _heard(self, kind: str, text: str, running: bool) -> None:
        self._loop.call_soon_threadsafe(self._tell, kind, text, running)

    def _dot(self, frequency: float, impedance: complex) -> None:
        def add() -> None:
            self._dots[1].append((frequency, impedance))
            with self._state:
                self._show_dots()

        self._loop.call_soon_threadsafe(add)

    def _tell(self, kind: str, text: str, running: bool) -> None:
        with self._state:
            if kind in KINDS:
                report = REPORT if kind == "diagnose" and not running and self.works.report.is_file() else ""
                told = {"name": KINDS[kind], "text": text, "running": running, "report": report}
                self._state.works = {**self._state.works, kind: told}
            if kind == "model":
                self._touch()
            if kind == "fit" and not running:
                self._changed()
        if kind == "model" and not running and self._grow_again:
            self._grow_again = False
            self._grow()

    # ----------------------------------------------------------------------------------------------------------------
    # What the page shows.

    def _begin(self) -> None:
        session, state = self.session, self._state
        state.trame__title = f"{session.chip.name} - live view"
        state.heading, state.subheading = session.chip.name, f"{session.state}, driven by {session.drive}"
        state.has_recording = session.recording is not None
        state.can_diagnose = session.recording is not None or self.works.campaign is not None
        state.file = f"{Path(session.chip.file).stem}_moved.toml"
        state.update({"can_undo": False, "can_redo": False, "message": "", "message_is_error": False, "works": {},
                      "figures": [], "full_dots": [], "pictures": [], "space": "", "in_space": False, "fields_at": "",
                      "pointed": "", "shown": {"x": 0.0, "text": "", "follows": True}, "recorded": {"magnitude": ""},
                      "curve": {"magnitude": "", "phase": "", "tolerance": "", "ticks": {"x": [], "y": [], "phase": []},
                                "read": {"frequency": [], "magnitude": [], "phase": []}}})
        state.client_only("pointed")
        self._show_rows()
        self._show_numbers()

    def _touch(self) -> None:
        self._moved = True
        self._asked.set()

    def _changed(self) -> None:
        """Numbers are others than the page shows."""
        with self._state:
            self._show_rows()
            self._show_numbers()
        self._touch()
        if self.session.outside():
            self._rested()

    def _show_numbers(self) -> None:
        values = self.session.values
        for index, each in enumerate(self.session.controls):
            self._state[f"x_{index}"] = _rounded(values[each.name] * each.factor)

    def _show_rows(self) -> None:
        outside, rows = self.session.outside(), []
        for index, each in enumerate(self.session.controls):
            low, high = each.low * each.factor, each.high * each.factor
            tolerance = "" if each.tolerance is None else f"{each.tolerance * each.factor:.4g}"
            rows.append({"index": index, "name": each.name, "label": each.label, "unit": each.unit, "low": low,
                         "high": high, "step": (high - low) / _STEPS, "value": each.told(each.value),
                         "tolerance": tolerance, "free": each.name in self.works.free,
                         "outside": each.name in outside})
        self._state.rows = rows
        self._state.can_undo, self._state.can_redo = self.session.can_undo, self.session.can_redo

    def _say(self, text: str, *, error: bool = False) -> None:
        self._state.message, self._state.message_is_error = text, error

    def _complain(self, error: Exception) -> None:
        self._say(str(error), error=True)

    def _scale(self) -> plot.Scale:
        shown = [] if self._view is None else [self._view.spectrum.magnitude]
        if self.session.recording is not None:
            shown.append(self.session.recording.magnitude)
        return plot.Scale.of(self.session.band, shown or [np.array([1.0, 1e3])])

    def _shown(self) -> float:
        """The frequency (Hz) of the fields: the one that was clicked, or else f0, or else the middle of the band."""
        if self._frequency is not None:
            return self._frequency
        if self._view is not None and "f0" in self._view.figures:
            return self._view.figures["f0"]
        return 0.5 * sum(self.session.band)

    def _show_frequency(self) -> None:
        frequency = self._shown()
        self._state.shown = {"x": round(float(self._scale().x(frequency)), 1), "text": f"{frequency / 1e6:.4f} MHz",
                             "follows": self._frequency is None}

    def _show_dots(self) -> None:
        values, found = self._dots
        if values != self.session.values:
            self._state.full_dots = []
            return
        frequency, impedance = (np.array([each[k] for each in found]) for k in (0, 1))
        self._state.full_dots = plot.dots(self._scale(), frequency.real, impedance) if found else []

    async def _answering(self, pool: ThreadPoolExecutor) -> None:
        """Answer what is asked, in one thread of its own, whatever is most urgent first."""
        while True:
            await self._asked.wait()
            try:
                if self._moved:
                    self._moved = False
                    await self._answer_spectrum(pool)
                elif self._picked:
                    self._picked = False
                    await self._answer_fields(pool)
                elif self._idle:
                    # Until there is nothing left to make ready.
                    self._idle = await self._loop.run_in_executor(pool, self.session.prepare, self._is_moved)
                else:
                    self._asked.clear()
            except (NotReady, OutOfRange) as waiting:
                self._waiting = str(waiting)
                with self._state:
                    # What was refused stays to be read.
                    if not self._state.message_is_error:
                        self._say(self._waiting)
            except FAILURES as error:
                with self._state:
                    self._complain(error)

    def _is_moved(self) -> bool:
        return self._moved

    async def _answer_spectrum(self, pool: ThreadPoolExecutor) -> None:
        view = await self._loop.run_in_executor(pool, self.session.spectrum)
        self._view = view
        shown, cards = await self._loop.run_in_executor(pool, _shown, view, self._scale())
        with self._state:
            if self._state.message == self._waiting:
                self._say("")
            self._state.curve, self._state.figures = shown, cards
            self._state.can_undo, self._state.can_redo = self.session.can_undo, self.session.can_redo
            self._show_recording()
            self._show_frequency()
            self._show_dots()
        self._picked = self._idle = True

    async def _answer_fields(self, pool: ThreadPoolExecutor) -> None:
        found = await self._loop.run_in_executor(pool, self._drawn, self._shown(), self._state.in_space)
        with self._state:
            for name, shown in found.items():
                self._state[name] = shown

    def _show_recording(self) -> None:
        recording = self.session.recording
        if recording is None:
            return
        low, high = self.session.band
        with contextlib.suppress(ValueError):
            inside = recording.restricted(low, high)
            self._state.recorded = {**plot.curves(self._scale(), inside), "name": self.session.recording_name}

    def _drawn(self, frequency: float, in_space: bool) -> dict[str, Any]:
        section = self.session.section(frequency)
        told: dict[str, Any] = {"fields_at": described(section, stated=self.session.particle_stated)}
        if in_space:
            return told | {"space": embedded(self.drawing.space(section))}
        return told | {"pictures": [picture(each) for each in self.drawing.section(section)]}


def _shown(view: SpectrumView, scale: plot.Scale) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """A spectrum as the page shows it: lines, and cards of figures."""
    return curve(view, scale), figure_cards(view)


def _rounded(number: float) -> float:
    """A number as a slider has it: to seven digits."""
    return float(f"{number:.7g}")
