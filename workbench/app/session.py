"""The present values of a chip's parameters, and their results.

    session = Session(read_chip("chip.toml"), "filled", controls(chip, problem))
    for report in session.grow():
        print(report)
    session.move("substrate.thickness", 0.83e-3)
    session.spectrum().figures

Results are spectrum, figures, fields, and accuracy, from reduced models. The first model needs a few full solves and is
accurate in the middle of the ranges only; larger ones replace it (:meth:`Session.grow`, to be run in the background).
Any number of threads may request answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock
from types import MappingProxyType

import numpy as np

from geometry.chip import Chip
from geometry.chip_file import write_chip
from geometry.names import TRANSDUCER
from geometry.stretch import admissible_range, moving_together
from materials.registry import Registry
from workbench.app.controls import RELATIVE_REACH, Control, controls, is_inside, wraps
from workbench.app.growth import Growing
from workbench.app.history import History
from workbench.app.local import SMALL_RANK, LocalModel, along, in_halves, local_model, local_ranges
from workbench.app.operating import EnergyPeaks
from workbench.app.section_fields import SectionFields, moved_chip, section_fields, usual_bead
from workbench.app.spectrum_view import SpectrumView, spectrum_view
from workbench.fem.operators import assemble
from workbench.fem.solve import sweep
from workbench.files.errors import InputError, choose
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.drive import Drive, wired
from workbench.model.numbers import Stated, placed
from workbench.model.problem import build, fill
from workbench.reduced.ranges import (
    LIMIT,
    NotCovered,
    OutOfRange,
    RangeModel,
    RangeRequest,
    Ranges,
    growing_model,
)
from workbench.results.spectrum import Spectrum

#: Number of frequencies of the band in an answered spectrum; twice as many take twice as long.
SPECTRUM_POINTS = 121
#: Relative error of the impedance of the models: less than the width of its line on the page.
MODEL_TOLERANCE = 1e-2
#: Ratio of the ends of a range above which it is modelled in stages: first for `RELATIVE_REACH` to either side of the
#: file's value, as for other ranges, then whole. Doubled, a film with a prior of a factor of 1.7 has no first stage.
WIDE = 1.5
#: Largest number of full solves of a model of a whole wide range; its error is then displayed. Doubled, the model of a
#: large chip takes some five minutes.
WIDE_LIMIT = 150
#: Stages of models, in words.
NEAR, WHOLE = "near the numbers of the file", "all ranges"


class NotReady(RuntimeError):
    """There is no model yet."""


@dataclass(frozen=True)
class Present:
    """A chip with its lengths, and changed ``constants`` (SI) of materials."""

    chip: Chip
    state: str
    constants: Mapping[str, float]
    registry: Registry
    band: tuple[float, float]
    accuracy: float | Discretisation

    def solve(self, send: Callable[[tuple[float, complex]], None], frequencies: Sequence[float]) -> None:
        """Send frequencies (Hz) and impedances (ohm, e^{+j w t}) by full solves. They are on a mesh of this chip, and
        each is sent as soon as it is solved."""
        problem = build(fill(self.chip, self.state, self.registry), band=self.band, accuracy=self.accuracy)
        operators = assemble(problem.mesh, problem.terms)
        for solution in sweep(operators, np.array(frequencies), placed(problem.values, self.constants)):
            send((float(solution.frequency[0]), complex(np.conj(solution.impedance[0]))))


class Session:
    """A chip in one of its states with adjustable parameters.

    ``controls`` are these parameters, with their ranges; ``problem`` is that of the chip in its file; ``particle`` is
    that of the potential, ``particle_stated`` whether the file names it.
    """

    def __init__(
        self,
        chip: Chip,
        state: str | None,
        wanted: Sequence[str] = (),
        *,
        registry: Registry | None = None,
        band: tuple[float, float] | None = None,
        points: int = SPECTRUM_POINTS,
        tolerance: float = MODEL_TOLERANCE,
        accuracy: float | Discretisation = ACCURACY,
        drive: Drive | None = None,
        recording: Spectrum | None = None,
        recording_name: str = "recording",
        growing: Growing = growing_model,
    ) -> None:
        """Prepare a session of `chip` in `state`, by default its last one.

        The parameters `wanted` are adjustable (`workbench.app.controls.controls`); `growing` makes its models.

        Raises:
            InputError: a mistake in the chip, its materials, or the wanted names.
        """
        self.chip, self.state = chip, chip.state(state).name
        # A simulation of the saved chip gives the same results.
        self.registry = replace(Registry() if registry is None else registry, assumed_losses=True)
        self.band = chip.band if band is None else band
        self.drive: Drive = wired(drive, chip)
        self.recording, self.recording_name = recording, recording_name
        self._growing = growing
        self._points, self._tolerance, self.accuracy = points, tolerance, accuracy
        device = fill(chip, self.state, self.registry)
        self.problem = build(device, band=self.band, accuracy=accuracy)
        self._peaks = EnergyPeaks(device, self.drive)
        self.particle, self.particle_stated = device.particle or usual_bead(self.registry), device.particle is not None
        self._lock = RLock()
        self._controls = {each.name: each for each in controls(chip, self.problem, wanted)}
        self._stated = dict(self._controls)
        self._values = {name: each.value for name, each in self._controls.items()}
        self._history = History(dict(self._values))
        self._last_moved = ""
        self._models: tuple[RangeModel, ...] = ()
        self._local: tuple[LocalModel, ...] = ()

    # ----------------------------------------------------------------------------------------------------------------
    # The values.

    @property
    def transducer(self) -> str:
        """Name of the transducer's material."""
        return self.problem.materials[TRANSDUCER].name

    @property
    def controls(self) -> tuple[Control, ...]:
        with self._lock:
            return tuple(self._controls.values())

    @property
    def values(self) -> dict[str, float]:
        """The present values (SI) by name."""
        with self._lock:
            return dict(self._values)

    @property
    def can_undo(self) -> bool:
        with self._lock:
            return bool(self._history.past) or self._values != self._history.present

    @property
    def can_redo(self) -> bool:
        with self._lock:
            return bool(self._history.future)

    def move(self, name: str, number: float) -> None:
        """Set one value (SI) that is moving; :meth:`settle` ends the move.

        Raises:
            InputError: no such parameter, or an impossible value.
        """
        with self._lock:
            self._check({name: number})
            self._values[name] = float(number)
            self._last_moved = name

    def settle(self) -> None:
        """Store the present values as one step of undo."""
        with self._lock:
            self._history = self._history.then(self._values)

    def put(self, values: Mapping[str, float]) -> None:
        """Set several values (SI) as one step.

        Raises:
            InputError: as in :meth:`move`.
        """
        with self._lock:
            self._check(values)
            self._values |= {name: float(number) for name, number in values.items()}
            self.settle()

    def undo(self) -> None:
        """Go back to the values of the previous step."""
        with self._lock:
            self.settle()
            self._history = self._history.undone()
            self._values = dict(self._history.present)

    def redo(self) -> None:
        """Go forward to the values of the last undone step."""
        with self._lock:
            self._history = self._history.redone()
            self._values = dict(self._history.present)

    def reset(self, name: str | None = None) -> None:
        """Set one parameter, or all, to the values of the chip's file."""
        with self._lock:
            self.put({each.name: each.value for each in self.controls if name in (None, each.name)})

    def tolerate(self, name: str, tolerance: float | None) -> None:
        """Set the tolerance (SI) of one parameter.

        With None, the tolerance of the file or the assumed one of the role applies; 0 is exact.

        Raises:
            InputError: no such parameter, or a tolerance below zero.
        """
        with self._lock:
            control, stated = self.control(name, "tolerance"), self._stated[name].stated
            if tolerance is not None and tolerance != self._stated[name].tolerance:
                if not 0.0 <= tolerance < np.inf:
                    raise InputError("live view", f"tolerance of {name}", control.with_unit(tolerance),
                                     "a number that is not below zero")
                stated = Stated(tolerance, "uniform" if control.is_dimension else "normal", "live view")
            self._controls[name] = replace(control, stated=stated)

    def control(self, name: str, field: str = "number") -> Control:
        """The control of that name; errors name `field`.

        Raises:
            InputError: no such parameter.
        """
        with self._lock:
            return self._controls[choose(name, self._controls, source="live view", field=field)]

    def stated_chip(self, values: Mapping[str, float] = MappingProxyType({})) -> Chip:
        """The chip with lengths among `values` (SI) and present tolerances. Tolerances are stated in its file or typed.
        Coinciding radii share theirs."""
        with self._lock:
            stated = {name: each.tolerance for name, each in self._controls.items()
                      if each.is_dimension and each.tolerance is not None}
        return moved_chip(self.chip, values).with_tolerances({
            other: tolerance for name, tolerance in stated.items() for other in moving_together(self.chip, name)})

    def typed_uncertainties(self) -> dict[str, float]:
        """Typed standard uncertainties (SI) of constants, by name."""
        with self._lock:
            return {name: each.deviation for name, each in self._controls.items()
                    if not each.is_dimension and each.stated != self._stated[name].stated}

    def present_chip(self) -> Chip:
        """The chip with its present lengths."""
        return self.stated_chip(self.values)

    def moved_constants(self) -> dict[str, float]:
        """The changed constants of materials (SI), which a chip file lacks."""
        with self._lock:
            return {name: self._values[name] for name, each in self._controls.items()
                    if not each.is_dimension and self._values[name] != each.value}

    def save(self, path: Path) -> None:
        """Write the chip with its present lengths, rounded (`Control.saved`).

        The description of the chip file lists changed constants, since they belong to the materials.

        Raises:
            OSError: it cannot be written.
        """
        values = {name: number if number == each.value or not each.is_dimension else each.saved(number)
                  for name, number in self.values.items() for each in (self.control(name),)}
        chip, constants = self.stated_chip(values), self.moved_constants()
        if constants:
            listed = ", ".join(f"{name} = {self._controls[name].with_unit(number)}"
                               for name, number in constants.items())
            words = f"{chip.description.rstrip()}\nConstants moved in the live view, not part of this file: {listed}.\n"
            chip = replace(chip, description=words.lstrip())
        write_chip(chip, path)

    def _check(self, values: Mapping[str, float]) -> None:
        for name, number in values.items():
            control = self.control(name)
            if not np.isfinite(number):
                raise InputError("live view", name, number, f"a finite number in {control.shown_unit or 'no unit'}")
            low, high = control.farthest
            if control.is_dimension:
                low, high = admissible_range(self.chip, name, low, high)
            if not low <= number <= high:
                raise InputError("live view", name, control.with_unit(number), f"{control.with_unit(low)} to "
                                 f"{control.with_unit(high)}, to which the mesh can be stretched")
        # It raises for lengths that do not make a chip.
        moved_chip(self.chip, {**self._values, **values})

    # ----------------------------------------------------------------------------------------------------------------
    # The models.

    def outside(self) -> tuple[str, ...]:
        """Names of the parameters outside their ranges."""
        with self._lock:
            return tuple(name for name, each in self._controls.items()
                         if not each.low <= self._values[name] <= each.high)

    def widen(self) -> tuple[str, ...]:
        """Widen the ranges of parameters outside them; returns their names. :meth:`grow` then makes a model of them."""
        with self._lock:
            names = self.outside()
            for name in names:
                wider = self._controls[name].reaching(self._values[name])
                if wider.is_dimension:
                    low, high = admissible_range(self.chip, name, wider.low, wider.high)
                    wider = replace(wider, low=low, high=high)
                self._controls[name] = wider
            return names

    def grow(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[str]:
        """Make models of the present ranges, each larger than the last.

        It ends when one is within the tolerance. :data:`WIDE` ranges are modelled in stages: first near the values of
        the file, then each one whole, then all whole, if needed. A stage that excludes the present values, or that a
        model covers already, is skipped or abandoned; all are whole only if no other stage suffices. It yields a
        description of each model, and ends before the next one once `stopped`.

        Raises:
            InputError: an impossible range.
        """
        stages = self._stages()
        for title, ranges in stages.items():
            values, others = self.values, [each for name, each in stages.items() if name not in (title, NEAR)]
            if self._has(ranges) or not is_inside(ranges, values) or (
                    title == WHOLE and any(is_inside(each, values) for each in others)):
                continue
            for words in self._grown(ranges, stopped, LIMIT if title == NEAR or len(stages) == 1 else WIDE_LIMIT):
                yield words if len(stages) == 1 else f"{title}: {words}"
            if stopped():
                return

    def _stages(self) -> dict[str, Ranges]:
        """The ranges of models in the order of their making, by description."""
        whole, near, wide = self._whole(), {}, []
        for each in self.controls:
            low, high = whole[each.name]
            if 0.0 < low * WIDE < high:
                wide.append(each)
                low = max(low, (1.0 - RELATIVE_REACH) * each.value)
                high = min(high, (1.0 + RELATIVE_REACH) * each.value)
            near[each.name] = (low, high)
        if not wide:
            return {WHOLE: whole}
        alone = {f"{each.parsed.in_words} {each.shown(each.low, 4)} to {each.with_unit(each.high, 4)}":
                 near | {each.name: whole[each.name]} for each in wide}
        return {NEAR: near, **alone, **({WHOLE: whole} if len(wide) > 1 else {})}

    def _whole(self) -> dict[str, tuple[float, float]]:
        return {each.name: (each.low, each.high) for each in self.controls}

    def is_covered(self) -> bool:
        """Whether a model covers the present values."""
        with self._lock:
            return any(is_inside(each.ranges, self._values) for each in self._models)

    def _has(self, ranges: Ranges) -> bool:
        """Whether a model within the tolerance covers these ranges."""
        with self._lock:
            return any(each.error <= each.relative_error and wraps(each.ranges, ranges) for each in self._models)

    def _grown(self, ranges: Ranges, stopped: Callable[[], bool], limit: int) -> Iterator[str]:
        """Make models of `ranges` from at most `limit` full solves. It yields descriptions, and ends once values are
        outside."""
        models = self._growing(RangeRequest(self.chip, self.state, ranges, self.registry, self.band, self._points,
                                            self._tolerance, self.accuracy, limit))
        try:
            for model in models:
                self._take(model)
                yield _model_words(model)
                if stopped() or not is_inside(ranges, self.values):
                    return
        except NotCovered as reached:
            # The last yielded model stays in use.
            yield f"{reached}"
        finally:
            models.close()

    def _take(self, model: RangeModel) -> None:
        """Use `model` where it is the best, and drop those it replaces."""
        # Computed now, not at the first request.
        _ = model.compact
        with self._lock:
            # A model of narrower ranges stays until this one is as accurate.
            kept = [each for each in self._models if each.ranges != model.ranges
                    and not (wraps(model.ranges, each.ranges) and model.error <= each.error)]
            self._models = (*kept, model)

    def _best(self, values: Mapping[str, float]) -> RangeModel:
        """The most accurate model that covers these `values`."""
        if not self._models:
            raise NotReady("the first model is being made")
        fit = [each for each in self._models if is_inside(each.ranges, values)]
        if not fit:
            wide = self._models[-1]
            beyond = [name for name, (low, high) in wide.ranges.items() if not low <= values[name] <= high]
            raise OutOfRange(f"{', '.join(beyond)}: beyond the present model; one of wider ranges is being made")
        return min(reversed(fit), key=lambda each: each.error)

    # ----------------------------------------------------------------------------------------------------------------
    # The answers.

    def spectrum(self, *, hurried: bool = False) -> SpectrumView:
        """The spectrum of the present values, and its figures of merit.

        With `hurried`, it may lack the effect of tolerances (:meth:`completed`).

        Raises:
            NotReady, OutOfRange: no model covers them yet.
        """
        with self._lock:
            values, deviations = self.values, {each.name: each.deviation for each in self.controls}
            model = self._best(values)
            local = next((each for each in self._local if each.holds(model, values)), None)
        if local is not None or model.rank <= SMALL_RANK:
            response = model(values) if local is None else local(values)
            return spectrum_view(response, deviations, model.error, self.recording, self._peaks)
        found = spectrum_view(in_halves(model, values), {} if hurried else deviations, model.error, self.recording,
                              self._peaks)
        return replace(found, complete=not hurried)

    def completed(self, view: SpectrumView) -> SpectrumView:
        """A hurried spectrum, with the effect of the tolerances."""
        deviations = {each.name: each.deviation for each in self.controls}
        return spectrum_view(view.response, deviations, view.error, self.recording, self._peaks)

    def section(self, frequency: float) -> SectionFields:
        """The fields of the present values at a `frequency` (Hz).

        Raises:
            NotReady, OutOfRange: no model covers them yet.
        """
        with self._lock:
            values = self.values
            model = self._best(values)
        return section_fields(self.chip, model, values, frequency, self.drive, self.particle)

    def prepare(self, stopped: Callable[[], bool] = lambda: False) -> bool:
        """Make a small model for the next answer; whether one was made. They are for any one parameter near the present
        values, and for the last moved one over its range. Abandoned once `stopped`, when a spectrum is requested."""
        with self._lock:
            values, name = self.values, self._last_moved
            if not self.is_covered():
                return False
            model = self._best(values)
            known = [each for each in self._local if each.holds(model, values)]
        wanted = [local_ranges(model, values), *([along(model, name)] if name in model.ranges else [])]
        for reach in wanted:
            if any(each.reach.keys() == reach.keys() and (len(reach) == 1 or each.centre == values) for each in known):
                continue
            found = local_model(model, values, reach, stopped)
            if found is not None:
                with self._lock:
                    self._local = (found, *(each for each in known if each.reach.keys() != reach.keys()))
                return True
        return False

    def impedance(self, frequency: float) -> complex:
        """The impedance (ohm, e^{+j w t}) at a `frequency` (Hz).

        The frequency is within the band.

        Raises:
            NotReady, OutOfRange: no model covers the present values yet.
        """
        with self._lock:
            values = self.values
            model = self._best(values)
        found = model.compact.solve(np.array([frequency]), placed(model.problem.values, values))
        return complex(np.conj(found.impedance[0]))

    def present(self, values: Mapping[str, float] | None = None) -> Present:
        """The chip with its present values, for another process. With `values` (SI), only these are set."""
        with self._lock:
            chosen = self.values if values is None else values
            constants = {name: number for name, number in chosen.items() if not self._controls[name].is_dimension}
            return Present(self.stated_chip(chosen), self.state, constants, self.registry, self.band, self.accuracy)


def _model_words(model: RangeModel) -> str:
    rank, solves = f"{model.rank} unknowns", f"{model.reduced.solves} full solves"
    if model.error <= model.relative_error:
        return f"model ready: {rank}, largest error {100.0 * model.error:.2g} % in checks by {solves}"
    if not np.isfinite(model.error):
        return f"first model: {rank}, accurate in the middle of the ranges; it grows"
    return f"model grows: {rank} after {solves}, last error {100.0 * model.error:.2g} %"
