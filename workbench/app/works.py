"""Background work of the live view: models, full solves, fits, diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from geometry.chip_file import write_chip
from workbench.app.background import Report, Stopped
from workbench.app.refit import Refit, known_to, refit
from workbench.app.session import Present, Session
from workbench.campaign.campaign import NAMED
from workbench.files.errors import InputError
from workbench.files.output import begin
from workbench.files.ownership import Outputs
from workbench.files.toml import TomlEntry, toml_table
from workbench.files.writing import write_atomic
from workbench.fitting.parameter import parameters
from workbench.jobs.process import STAND_BACK, Send, stream
from workbench.jobs.workers import Processes
from workbench.results.spectrum import write_spectrum

#: Name of each kind of work on the page.
KINDS: Mapping[str, str] = {"model": "Model", "check": "Check", "full": "Full solve", "fit": "Fit",
                            "diagnose": "Diagnosis"}

#: Diagnoses a campaign into a folder, as ``workbench diagnose`` does, and sends the exit status.
Diagnosing = Callable[..., None]

#: Input files of a diagnosis of one recording.
INPUT = ("chip.toml", "recording.csv", "campaign.toml")

#: Path of the report of a diagnosis on the page.
REPORT = "diagnosis/report.html"

#: Number of frequencies of the band for full solves.
SOLVED = 41


class Works:
    """The works on a session; ``free`` names the parameters of a fit. A diagnosis is written to a folder within
    `folder`. It is of the `campaign` or, without one, of the session's recording; `diagnosing` runs it."""

    def __init__(self, session: Session, folder: Path, campaign: Path | None, diagnosing: Diagnosing) -> None:
        self._session, self._folder, self.campaign, self._diagnosing = session, folder, campaign, diagnosing
        self.free: set[str] = set()
        self._checks = Processes(1, nice=STAND_BACK)

    @property
    def report(self) -> Path:
        """The path of the report of a diagnosis."""
        return self._folder / REPORT

    def model(self, report: Report, stopped: Stopped) -> str:
        """Make models of the present ranges, until one is accurate."""
        last = "the model is there"
        report("a model is being made")
        for last in self._session.grow(stopped):
            report(last)
        return last

    def check(self, frequency: float) -> str:
        """Check the model by one full solve at the fields' frequency."""
        session = self._session
        reduced = session.impedance(frequency)
        full = self._checks.submit(partial(_impedance, session.present(), frequency)).result()
        return (f"a full solve at {frequency / 1e6:.4f} MHz on a mesh of its own: the model's error is "
                f"{100.0 * abs(reduced / full - 1.0):.2g} % there")

    def close(self) -> None:
        """End all work."""
        self._checks.close()

    def full(self, report: Report, stopped: Stopped, solved: Callable[[float, complex], None]) -> str:
        """Solve the whole band in full, on a new mesh. `solved` is called with every result."""
        report(f"0 of {SOLVED} frequencies")
        found: list[tuple[float, complex]] = []
        model = self._session.spectrum().spectrum.interpolant()
        wanted = np.linspace(*self._session.band, SOLVED).tolist()
        for frequency, impedance in stream(
                partial(_solve, present=self._session.present(), frequencies=wanted), stopped=stopped):
            found.append((frequency, impedance))
            solved(frequency, impedance)
            report(f"{len(found)} of {SOLVED} frequencies")
        if len(found) < SOLVED:
            return f"stopped after {len(found)} of {SOLVED} frequencies"
        frequencies, impedances = (np.array([each[k] for each in found]) for k in (0, 1))
        off = np.abs(model(frequencies.real) / impedances - 1.0)
        return (f"{SOLVED} frequencies on a mesh of its own: the model's error is {100.0 * off.max():.2g} % at most, "
                f"{100.0 * np.sqrt(np.mean(off**2)):.2g} % rms")

    def fit(self, report: Report, stopped: Stopped) -> str:
        """Fit the free parameters, from their present values, to the recording."""
        session = self._session
        recording, free = session.recording, [each.name for each in session.controls if each.name in self.free]
        if recording is None or not free:
            raise InputError("live view", "fit", "nothing free", "a recording, and the numbers ticked that may move")
        for each in session.controls:
            if each.name in free and each.tolerance == 0.0:
                raise InputError("live view", f"tolerance of {each.name}", "0, so that it is exact",
                                 "a tolerance above zero, or none, of a number that is fitted")
        moved = ", ".join(free)
        report(moved)
        values, found = session.values, None
        fixed = {name: number for name, number in values.items() if name not in free}
        task = partial(refit, present=session.present(fixed), values={name: values[name] for name in free},
                       uncertainties=session.typed_uncertainties(), measured=recording, name=session.recording_name)
        for found in stream(task, stopped=stopped):
            if isinstance(found, str):
                report(f"{moved}: {found}")
        if not isinstance(found, Refit):
            return "stopped"
        by_name = {each.name: each for each in session.controls}
        fitted = ", ".join(f"{by_name[name].parsed.in_words} {by_name[name].with_unit(number)} ± "
                           f"{by_name[name].with_unit(found.errors[name])}" for name, number in found.values.items())
        off = f"mean error {found.before:.3g} % before, {found.after:.3g} % now"
        result = f"{off}: {fitted}. {' '.join(found.findings)}".strip()
        try:
            session.put(found.values)
        except InputError as refused:
            # A result that took a minute is reported in any case.
            return f"{result} Not shown, since the sliders cannot follow: {refused}"
        return result

    def diagnose(self, report: Report, stopped: Stopped) -> str:
        """Run ``workbench diagnose`` in a process. It is of the campaign or of the one recording."""
        folder = self.report.parent
        campaign = self.one_recording(folder / "input") if self.campaign is None else self.campaign
        report(f"of {campaign}, in the background, for some minutes")
        diagnosing = partial(self._diagnosing, campaign=campaign, folder=folder)
        with TemporaryDirectory() as temporary:
            log = Path(temporary) / "log.txt"
            for status in stream(diagnosing, stopped=stopped, words=log):
                last = next(last_lines(log), "no words")
                return f"done, see {self.report}" if status == 0 else f"failed: {last}"
        return "stopped"

    def one_recording(self, folder: Path) -> Path:
        """A campaign of the one recording and the present chip.

        The ticked parameters are free, by default all.

        Raises:
            InputError: there is no recording.
        """
        session = self._session
        if session.recording is None:
            raise InputError("live view", "diagnose", None, "a recording, or a campaign (--campaign)")
        names = [each.name for each in session.controls
                 if (not self.free or each.name in self.free) and each.tolerance != 0.0]
        # Other parameters are exact, even if the chip's file states an uncertainty; the bench is not part of the chip.
        known: dict[str, TomlEntry] = {}
        typed = session.typed_uncertainties()
        for each in parameters(session.problem, session.stated_chip(), session.transducer, names):
            parameter = known_to(each, typed.get(each.name))
            if parameter.prior is not None:
                known[parameter.name] = f"{parameter.prior!r} {parameter.unit}"
        chip, recording, path = (folder / name for name in INPUT)
        with begin(folder, Outputs("app", INPUT), source="live view", field="diagnose"):
            write_chip(session.present_chip(), chip)
            write_spectrum(session.recording, recording)
            write_atomic(path, "\n".join([
                toml_table("[campaign]", {"known": NAMED}),
                toml_table("[states.recorded]", {"chip": chip.name, "state": session.state,
                                                 "recording": recording.name}),
                toml_table("[known]", known)]))
        return path


def _solve(send: Send, *, present: Present, frequencies: Sequence[float]) -> None:
    present.solve(send, frequencies)


def _impedance(present: Present, frequency: float) -> complex:
    found: list[tuple[float, complex]] = []
    present.solve(found.append, [frequency])
    return found[0][1]


def last_lines(log: Path) -> Iterator[str]:
    """The lines of a log that are not blank, last first."""
    for line in reversed(log.read_text(encoding="utf-8", errors="replace").splitlines()):
        if line.strip():
            yield line.strip()
