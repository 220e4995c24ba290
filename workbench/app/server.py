"""The server of the live view: requests to the session, and answers.

Answers are computed in two threads. One answers with spectra: meanwhile the newest request waits and older ones are
dropped, so that the page follows a slider as fast as the model answers. The other draws fields, and prepares faster
answers, after :data:`PAUSE` without a move; it abandons unfinished work at the next move.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geometry.measure import Axisymmetric
from workbench.app import guard, plot
from workbench.app.background import FAILURES, Background
from workbench.app.entry import slider_number, typed_number, typed_tolerance
from workbench.app.operating import operating_frequency
from workbench.app.page import lay_out
from workbench.app.panels import DrawnField, curve, described, embedded, figure_cards, next_picture
from workbench.app.section_fields import SectionFields
from workbench.app.session import NotReady, Session
from workbench.app.spectrum_view import SpectrumView
from workbench.app.works import KINDS, REPORT, Diagnosing, Works
from workbench.files.errors import InputError
from workbench.reduced.ranges import OutOfRange

#: Seconds after which a moved parameter counts as at rest: it is then one step of undo.
RESTS = 0.5

#: Seconds without a move after which fields are drawn. Doubled, fields come later; at zero, each spectrum of a dragged
#: slider waits for its share of the processor.
PAUSE = 0.1

#: Steps of a slider.
_STEPS = 200


@dataclass(frozen=True)
class Drawing:
    """The functions that draw fields. ``section`` yields one picture after the other; ``space`` draws the chip in space
    (PNG)."""

    section: Callable[[SectionFields], Iterable[DrawnField]]
    space: Callable[[SectionFields], bytes]


class LiveView:
    """A session on a page of its own server, started by :meth:`serve`. ``address`` opens the page."""

    def __init__(self, session: Session, drawing: Drawing, folder: Path, diagnosing: Diagnosing, *,
                 campaign: Path | None = None) -> None:
        """Prepare the page of a session. Chip files and reports are written to `folder`, which is created when needed;
        `diagnosing` runs a diagnosis, of the `campaign` or of the one recording."""
        from trame.app import get_server

        self.session, self.drawing, self.folder = session, drawing, folder
        self.token, self.address = guard.new_token(), ""
        self.works = Works(session, folder, campaign, diagnosing)
        self._background = Background(self._work_changed)
        self._names = [each.name for each in session.controls]
        self._entries = Counter[str]()
        self._frequency: float | None = None
        self._view: SpectrumView | None = None
        self._dots: tuple[Mapping[str, float], list[tuple[float, complex]]] = ({}, [])
        self._saved: set[Path] = set()
        # Pending requests: the spectrum; later the fields, then preparations of faster answers.
        self._requested, self._later = asyncio.Event(), asyncio.Event()
        self._moved = self._picked = self._idle = False
        self._moved_at = 0.0
        self._rest: asyncio.TimerHandle | None = None
        self._grow_again, self._waiting = False, ""
        # The server must not read the options of the command.
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
        """Serve the page on this computer until cancelled.

        `ready` is called with its address. `port` 0 is any free one.

        Raises:
            OSError: the port is in use.
        """
        self._loop = asyncio.get_running_loop()
        answers, drawings = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._server.controller.on_server_bind.add(self._bind)

        def started(**_state: object) -> None:
            self.address = guard.address(self._server.port, self.token)
            ready(self.address)

        self._server.controller.on_server_ready.add(started)
        served = self._server.start(port=port, host=guard.HOST, timeout=0, open_browser=False, exec_mode="coroutine",
                                    show_connection_info=False, disable_logging=True)
        serving = asyncio.ensure_future(served)
        answering = [asyncio.ensure_future(self._answering(answers)), asyncio.ensure_future(self._drawing(drawings))]
        self._grow()
        try:
            await asyncio.shield(serving)
        finally:
            if self._rest is not None:
                self._rest.cancel()
            for each in answering:
                each.cancel()
            await asyncio.gather(*answering, return_exceptions=True)
            await self._server.stop()
            await serving
            self.works.close()
            await asyncio.to_thread(self._background.close)
            answers.shutdown()
            drawings.shutdown()

    def _bind(self, wslink: Any) -> None:
        from aiohttp import web

        async def report(_request: web.Request) -> web.StreamResponse:
            path = self.works.report
            if not path.is_file():
                raise web.HTTPNotFound
            return web.FileResponse(path)

        async def launched(request: web.Request) -> web.StreamResponse:
            return web.json_response({"sessionURL": f"ws://{request.host}/ws"})

        guard.protect(wslink.app, self.token)
        wslink.app.router.add_get(f"/{REPORT}", report)
        # The address at which trame's page first asks for its websocket.
        wslink.app.router.add_post("/paraview/", launched)

    # ----------------------------------------------------------------------------------------------------------------
    # Requests of the page.

    def _listen(self) -> None:
        for name, act in {"undo": self._undo, "redo": self._redo, "reset": self._reset, "enter": self._enter,
                          "tolerate": self._tolerate, "free": self._free, "pick": self._pick, "follow": self._follow,
                          "save": self._save, "space": self._space}.items():
            self._server.trigger(name)(act)
        for kind in ("full", "fit", "diagnose"):
            self._server.trigger(kind)(lambda kind=kind: self._start_or_stop(kind))
        for index in range(len(self._names)):
            self._state.change(f"x_{index}")(lambda index=index, **_state: self._move(index))

    def _move(self, index: int) -> None:
        control, entered = self.session.controls[index], self._state[f"x_{index}"]
        try:
            if entered == slider_number(self.session.values[control.name] * control.factor):
                return
            self.session.move(control.name, typed_number(entered, control, control.name))
        except InputError as error:
            self._complain(error)
            self._show_numbers()
            return
        self._follow_move()

    def _enter(self, name: str, text: str) -> None:
        self._entries[str(name)] += 1
        try:
            self.session.move(name, typed_number(text, self.session.control(name), name))
        except InputError as error:
            self._complain(error)
            self._show_rows()
            return
        self._show_numbers()
        self._show_rows()
        self._follow_move()

    def _follow_move(self) -> None:
        self._say("")
        self._touch()
        if self._rest is not None:
            self._rest.cancel()
        self._rest = self._loop.call_later(RESTS, self._rested)

    def _rested(self) -> None:
        """Handle a parameter at rest: a step of undo, and wider ranges."""
        self.session.settle()
        with self._state:
            names = self.session.widen()
            if names or not (self.session.is_covered() or "model" in self._background.running()):
                self._grow()
            self._show_rows()
        if self.session.is_covered():
            self._background.start("check", lambda report, stopped: self.works.check(self._shown()))

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
        self._entries[str(name)] += 1
        try:
            self.session.tolerate(name, typed_tolerance(text, self.session.control(name, "tolerance")))
        except InputError as error:
            self._complain(error)
        else:
            self._say("")
        self._changed()

    def _free(self, name: str, wanted: bool) -> None:
        (self.works.free.add if wanted and name in self._names else self.works.free.discard)(name)
        self._show_rows()

    def _pick(self, share: float) -> None:
        self._frequency = self._scale().frequency_at(float(share))
        self._show_frequency()
        self._draw()

    def _follow(self) -> None:
        self._frequency = None
        self._show_frequency()
        self._draw()

    def _space(self) -> None:
        self._state.in_space = not self._state.in_space
        self._state.space = ""
        self._draw()

    def _save(self, name: str) -> None:
        """Save the chip under a plain name in the folder. Older files are not overwritten."""
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
        self._say(f"saved as {path}" + ("; constants of materials are in its description only"
                                        if constants else ""))

    def _start_or_stop(self, kind: str) -> None:
        if kind in self._background.running():
            self._background.stop(kind)
            return
        if kind == "full":
            self._dots = (self.session.values, [])
            self._show_dots()
            self._background.start(kind, lambda report, stopped: self.works.full(report, stopped, self._dot))
        else:
            self._background.start(kind, getattr(self.works, kind))

    def _grow(self) -> None:
        """Make a model of the present ranges, after stopping another one."""
        if self._background.start("model", self.works.model) is None:
            self._grow_again = True
            self._background.stop("model")

    # ----------------------------------------------------------------------------------------------------------------
    # Reports of the background; called from its threads.

    def _work_changed(self, kind: str, text: str, running: bool) -> None:
        self._loop.call_soon_threadsafe(self._show_work, kind, text, running)

    def _dot(self, frequency: float, impedance: complex) -> None:
        def add() -> None:
            self._dots[1].append((frequency, impedance))
            with self._state:
                self._show_dots()

        self._loop.call_soon_threadsafe(add)

    def _show_work(self, kind: str, text: str, running: bool) -> None:
        with self._state:
            if kind in KINDS:
                report = REPORT if kind == "diagnose" and not running and self.works.report.is_file() else ""
                work = {"name": KINDS[kind], "text": text, "running": running, "report": report}
                self._state.works = {**self._state.works, kind: work}
            if kind == "model":
                self._touch()
            if kind == "fit" and not running:
                self._changed()
        if kind == "model" and not running and self._grow_again:
            self._grow_again = False
            self._grow()

    # ----------------------------------------------------------------------------------------------------------------
    # State of the page.

    def _begin(self) -> None:
        session, state = self.session, self._state
        state.trame__title = f"{session.chip.name} - live view"
        state.heading, state.subheading = session.chip.name, f"{session.state}, driven by {session.drive}"
        state.has_recording = session.recording is not None
        state.has_space = isinstance(session.chip.measure, Axisymmetric)  # the picture in space is a revolved section
        state.can_diagnose = session.recording is not None or self.works.campaign is not None
        state.file = f"{Path(session.chip.file).stem}_moved.toml"
        state.update({"can_undo": False, "can_redo": False, "message": "", "message_is_error": False, "works": {},
                      "figures": [], "full_dots": [], "pictures": [], "space": "", "in_space": False, "fields_at": "",
                      "pointed": "", "shown": {"x": 0.0, "text": "", "follows": True},
                      "recorded": {"magnitude": ""},
                      "curve": {"magnitude": "", "phase": "", "tolerance": "", "ticks": {"x": [], "y": [], "phase": []},
                                "read": {"frequency": [], "magnitude": [], "phase": []}}})
        state.client_only("pointed")
        narrowed = [f"{each.parsed.in_words} {each.narrowed}" for each in session.controls if each.narrowed]
        if narrowed:
            state.works = {"ranges": {"name": "Ranges", "text": "; ".join(narrowed), "running": False, "report": ""}}
        self._show_rows()
        self._show_numbers()

    def _touch(self) -> None:
        self._moved, self._moved_at = True, self._loop.time()
        self._requested.set()

    def _draw(self) -> None:
        self._picked = True
        self._later.set()

    def _changed(self) -> None:
        with self._state:
            self._show_rows()
            self._show_numbers()
        self._touch()
        if self.session.outside() or not self.session.is_covered():
            self._rested()

    def _show_numbers(self) -> None:
        values = self.session.values
        for index, each in enumerate(self.session.controls):
            self._state[f"x_{index}"] = slider_number(values[each.name] * each.factor)

    def _show_rows(self) -> None:
        outside, rows = self.session.outside(), []
        for index, each in enumerate(self.session.controls):
            low, high = each.low * each.factor, each.high * each.factor
            rows.append({"index": index, "name": each.name, "label": each.parsed.in_words, "unit": each.shown_unit,
                         "low": low, "high": high, "step": (high - low) / _STEPS, "value": each.with_unit(each.value),
                         "tolerance": each.shown_tolerance, "assumed": each.assumed,
                         "entries": self._entries[each.name], "free": each.name in self.works.free,
                         "outside": each.name in outside})
        self._state.rows = rows
        self._state.can_undo, self._state.can_redo = self.session.can_undo, self.session.can_redo

    def _say(self, text: str, *, error: bool = False) -> None:
        self._state.message, self._state.message_is_error = text, error

    def _complain(self, error: Exception) -> None:
        self._say(str(error), error=True)

    def _scale(self, view: SpectrumView | None = None) -> plot.PlotScale:
        """The scale of the curves, or of `view`."""
        view = self._view if view is None else view
        shown = [] if view is None else [view.spectrum.magnitude]
        if self.session.recording is not None:
            shown.append(self.session.recording.magnitude)
        return plot.PlotScale.of(self.session.band, shown or [np.array([1.0, 1e3])])

    def _shown(self) -> float:
        """The frequency (Hz) of the fields: clicked, or the operating point."""
        if self._frequency is not None:
            return self._frequency
        peak, merit = (None, {}) if self._view is None else (self._view.peak, self._view.figures)
        return operating_frequency(self.session.chip, peak, merit.get("f0"), self.session.band)

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
        """Answer with the newest requested spectrum."""
        while True:
            await self._requested.wait()
            self._requested.clear()
            await self._reported(self._answer_spectrum(pool))
            # Later moves still need an answer.
            self._moved = self._requested.is_set()
            self._later.set()

    async def _drawing(self, pool: ThreadPoolExecutor) -> None:
        """Draw the fields, then prepare faster answers, while nothing moves."""
        while True:
            await self._later.wait()
            pause = self._moved_at + PAUSE - self._loop.time()
            if self._moved:
                # The spectrum has priority, and sets the event again.
                self._later.clear()
            elif pause > 0.0:
                await asyncio.sleep(pause)
            elif self._picked:
                self._picked = False
                await self._reported(self._answer_fields(pool))
            elif self._idle:
                self._idle = False
                await self._reported(self._prepare(pool))
            else:
                self._later.clear()

    async def _reported(self, answer: Awaitable[None]) -> None:
        """Wait for an answer; the page shows a failure."""
        try:
            await answer
        except (NotReady, OutOfRange) as waiting:
            self._waiting = str(waiting)
            with self._state:
                # The reason of an error stays visible.
                if not self._state.message_is_error:
                    self._say(self._waiting)
        except FAILURES as error:
            with self._state:
                self._complain(error)

    def _is_moved(self) -> bool:
        return self._moved

    async def _answer_spectrum(self, pool: ThreadPoolExecutor) -> None:
        """Show the spectrum and its figures, then the effect of tolerances. The latter follows separately if it takes
        long."""
        view = await self._loop.run_in_executor(pool, partial(self.session.spectrum, hurried=True))
        await self._show_spectrum(pool, view)
        if not view.complete and not self._requested.is_set():
            await self._show_spectrum(pool, await self._loop.run_in_executor(pool, self.session.completed, view))
        self._picked = self._idle = True

    async def _show_spectrum(self, pool: ThreadPoolExecutor, view: SpectrumView) -> None:
        scale = self._scale(view)
        shown, cards = await self._loop.run_in_executor(pool, lambda: (curve(view, scale), figure_cards(view)))
        self._view = view
        with self._state:
            if self._state.message == self._waiting:
                self._say("")
            self._state.curve, self._state.figures = shown, cards
            self._state.can_undo, self._state.can_redo = self.session.can_undo, self.session.can_redo
            self._show_recording(scale)
            self._show_frequency()
            self._show_dots()

    async def _answer_fields(self, pool: ThreadPoolExecutor) -> None:
        """Draw the fields; a move abandons this. They are then requested again."""
        section = await self._loop.run_in_executor(pool, self.session.section, self._shown())
        shown: dict[str, Any] = {"fields_at": described(section, stated=self.session.particle_stated)}
        if self._moved:
            return
        if self._state.in_space:
            drawn = await self._loop.run_in_executor(pool, self.drawing.space, section)
            shown |= {"space": embedded(drawn)}
        else:
            pictures: list[dict[str, Any]] = []
            drawing = iter(self.drawing.section(section))
            while (found := await self._loop.run_in_executor(pool, next_picture, drawing)) is not None:
                pictures.append(found)
                if self._moved:
                    return
            shown |= {"pictures": pictures}
        with self._state:
            self._state.update(shown)

    async def _prepare(self, pool: ThreadPoolExecutor) -> None:
        """Prepare one faster answer, unless all are ready."""
        self._idle = await self._loop.run_in_executor(pool, self.session.prepare, self._is_moved)

    def _show_recording(self, scale: plot.PlotScale) -> None:
        recording = self.session.recording
        if recording is None:
            return
        low, high = self.session.band
        with contextlib.suppress(ValueError):
            inside = recording.restricted(low, high)
            self._state.recorded = {**plot.curves(scale, inside), "name": self.session.recording_name}
