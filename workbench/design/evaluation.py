"""Figures of a chip and their exact derivatives, from a model.

Every figure follows from one state, at the driven frequency, and from the states at the half-power frequencies. If the
drive follows f0, a change of a number moves the frequency too:

    d figure / d number = (at constant frequency) + (by frequency) d f0 / d number
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.names import parent_place
from geometry.operating_point import AT_ENERGY, AT_F0
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.design.cavity import OF_FLUID, Cavity, CavityField, cavity_field
from workbench.design.figures import LOSS_SHARE, QUOTIENTS, with_parts
from workbench.design.resonance import Energy, Impedance, Resonance, ResonantQuantity, Responding, find_resonance
from workbench.design.trapping import FoundTrap, NoTrap, find_trap, follows_flow, largest_square, trap_focus_time
from workbench.fem.dual import Dual
from workbench.fem.level import Level, drive_level
from workbench.fem.linearised import LinearisedState, by_frequency, difference_frequencies, slope_columns
from workbench.fem.solve import Solution
from workbench.model.drive import Drive, VoltageDrive, wired
from workbench.model.numbers import ParameterName
from workbench.model.problem import FilledChip
from workbench.results.brief import Brief
from workbench.results.merit import NoResonance

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Figures of the spectrum, those of the energy over frequency, and those that need no fluid.
OF_RESONANCE = ("f0", "z_min", "q")
OF_PEAK = ("peak_frequency", "peak_q")
ELECTRICAL = ("voltage", "power", "heating")
#: Figures of the particle's trap.
OF_TRAP = ("trap_height", "trap_offset", "trap_radius", "trap_depth", "axial_stiffness", "radial_stiffness",
           "focus_time")
#: Figures of the cavity's field, those of the trap among them.
OF_FIELD = ("p0", "e_ac", "mean_e_ac", *OF_TRAP)


@dataclass(frozen=True)
class Operation:
    """The operation of a chip: drive, frequency and thermal resistances.

    ``frequency`` is in Hz, or the word of `geometry.operating_point.OPERATING_POINTS` for the resonance that the drive
    follows, or None for that of the chip. ``thermal_resistance`` (K/W) is by region, for heating; the key "" stands for
    all regions not named.
    """

    drive: Drive = field(default_factory=VoltageDrive)
    frequency: float | str | None = None
    thermal_resistance: Mapping[str, float] = field(default_factory=dict)

    def of(self, device: FilledChip) -> Operation:
        """The operation of a chip in a state.

        If no frequency is stated, it is that of the chip file, or else the largest peak of the energy of sound in the
        cavity. In a cavity without a liquid the drive follows f0 instead of that peak. The drive is wired as the chip
        states.

        Raises:
            InputError: see `workbench.model.drive.wired`.
        """
        stated = device.chip.operating_point if self.frequency is None else self.frequency
        if stated is None or isinstance(stated, str):
            stated = AT_ENERGY if device.is_wet and stated != AT_F0 else AT_F0
        return replace(self.wired(device.chip), frequency=stated)

    def wired(self, chip: Chip) -> Operation:
        """The operation with the drive wired as the chip states.

        Raises:
            InputError: see `workbench.model.drive.wired`.
        """
        return replace(self, drive=wired(self.drive, chip))

    @property
    def words(self) -> str:
        """The frequency in words."""
        match self.frequency:
            case None:
                return "as the chip states"
            case str():
                return {AT_ENERGY: "follows the largest peak of the energy in the cavity", AT_F0: "follows f0"}[
                    self.frequency]
            case _:
                return f"{self.frequency / 1e6:.4f} MHz"

    @property
    def follows(self) -> ResonantQuantity | None:
        """The response whose resonance the drive follows, None at a stated frequency.

        Raises:
            ValueError: the operation is not yet that of a chip (:meth:`of`).
        """
        if self.frequency is None:
            raise ValueError("the frequency is that of a chip: ask for Operation.of(device) first")
        if self.frequency == AT_ENERGY:
            return Energy(self.drive)
        return Impedance() if self.frequency == AT_F0 else None


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Brief):
    """Figures of one chip.

    ``values`` are the numbers of the chip (SI, by parameter name). ``figures`` are SI, by name, NaN if one does not
    exist; ``missing`` then has the reason, by the figure's name. ``gradient`` is by figure, (len(values),) in the order
    of ``values``, None if not requested. ``frequency`` (Hz) is the driven one, and ``error`` the estimated relative
    error of Z there.
    """

    values: Mapping[str, float]
    figures: Mapping[str, float]
    missing: Mapping[str, str]
    frequency: float
    error: float
    gradient: Mapping[str, Real] | None = None


@dataclass(frozen=True, eq=False)
class Question:
    """A request for figures of a model whose parameters are set.

    ``figures`` are by name. ``names`` are the k real numbers for derivatives (none: no derivatives), ``values`` all
    complex parameters. ``pressure`` maps states (size, columns) to the pressure (n, m, columns) at the cavity's nodes.
    ``cavity`` is None without a fluid, and ``reason`` explains why. ``beyond`` is as in `trap_focus_time`, ``near`` as
    in `find_trap`.
    """

    figures: tuple[str, ...]
    names: tuple[str, ...]
    values: Mapping[str, complex]
    operation: Operation
    cavity: Cavity | None
    reason: str
    pressure: Callable[[Complex], Complex] | None
    beyond: float = 0.0
    near: float | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """The complex parameters (k,) that the numbers are parts of."""
        return tuple(ParameterName.parse(name).key for name in self.names)

    @property
    def turns(self) -> Complex:
        """The derivatives (k,) of the complex parameters by the numbers.

        Each is 1 or 1j.
        """
        return np.array([1j if ParameterName.parse(name).is_loss else 1.0 for name in self.names], dtype=complex)

    def unit(self, name: str) -> Real:
        """The unit vector (k,) of the number of that name."""
        return np.array([float(each == name) for each in self.names])

    def constant(self, value: float) -> Dual:
        """A value that does not depend on the k numbers."""
        return Dual(value, np.zeros(len(self.names)))


@dataclass(frozen=True, eq=False)
class FigureValues:
    """Figures with derivatives, reasons for missing ones, and the driven frequency (Hz)."""

    question: Question
    figures: Mapping[str, Dual]
    missing: Mapping[str, str]
    frequency: float
    state: LinearisedState | None

    def evaluation(self, values: Mapping[str, float], estimate: Callable[[Solution], float] | None) -> Evaluation:
        """The evaluation at the numbers `values`.

        `estimate` gives the estimated error of the state's charge; it is None for a full solve, whose error counts as
        0.
        """
        names = self.question.figures
        nothing = self.question.constant(1.0) * math.nan
        found = {name: self.figures.get(name, nothing) for name in names}
        error = math.nan if self.state is None else 0.0 if estimate is None else estimate(self.state.solution)
        return Evaluation(dict(values), {name: float(each.value) for name, each in found.items()}, self.missing,
                          self.frequency, error,
                          {name: each.gradient for name, each in found.items()} if self.question.names else None)


def responses(figures: Collection[str], *operations: Operation) -> tuple[ResonantQuantity, ...]:
    """The responses whose resonances the figures need at some operations, each once."""
    found = [each.follows for each in operations if each.follows is not None]
    if set(figures) & set(OF_RESONANCE):
        found.append(Impedance())
    if set(figures) & set(OF_PEAK):
        found += [Energy(each.drive) for each in operations]
    return tuple(dict.fromkeys(found))


#: Makes a rough model and its spectrum over the band, to locate resonances.
Sweep = Callable[[], tuple[Responding, Solution]]


def answer(
    question: Question, model: Responding, sweep: Sweep | None = None, final: Responding | None = None
) -> FigureValues:
    """Compute the requested figures.

    The resonances of `model` lie near those of the `sweep`. With `final`, `model` only locates the resonance, and the
    states are those of this better model.
    """
    found: dict[str, Dual] = {}
    resonances: dict[ResonantQuantity, Resonance] = {}
    operation, missing = question.operation, dict[str, str]()
    wanted = responses(question.figures, operation)
    rough = sweep() if wanted and sweep is not None else None
    for response in wanted:
        names: Sequence[str] = OF_RESONANCE if isinstance(response, Impedance) else OF_PEAK
        try:
            resonances[response] = _resonance(question, response, model, rough, final)
        except NoResonance as error:
            missing.update(dict.fromkeys(question.figures if response == operation.follows else names, error.reason))
            continue
        _of_resonance(resonances[response], response, found, missing)
    driven, state = question.constant(math.nan), None
    if operation.follows in resonances:
        driven, state = resonances[operation.follows].frequency, resonances[operation.follows].at
    elif isinstance(operation.frequency, int | float):
        driven = question.constant(operation.frequency)
        state = (final or model).system.linearised(operation.frequency, question.keys)
    if state is not None:
        operating = _Operating(question, state, driven, (final or model).sound)
        for group, compute in ((ELECTRICAL, operating.electrical), (OF_FIELD, operating.of_field)):
            wanted_names = [each for each in with_parts(question.figures) if each in group or
                            (group is ELECTRICAL and each.startswith(LOSS_SHARE))]
            if wanted_names:
                compute(wanted_names, found, missing)
    for name, parts in QUOTIENTS.items():
        if all(each in found for each in parts):
            found[name] = found[parts[0]] / found[parts[1]]
        elif any(each in missing for each in parts):
            missing[name] = next(missing[each] for each in parts if each in missing)
    kept = {name: found[name] for name in question.figures if name in found}
    return FigureValues(question, kept, {name: why for name, why in missing.items() if name in question.figures
                                         and name not in kept}, driven.value, state)


def _resonance(
    question: Question, response: ResonantQuantity, model: Responding, rough: tuple[Responding, Solution] | None,
    final: Responding | None,
) -> Resonance:
    """The resonance of a response.

    Raises:
        NoResonance: the band has none, or for the impedance only part of one.
    """
    if rough is None or (rough[0].sound is None and not isinstance(response, Impedance)):
        raise NoResonance("the cavity holds no liquid with sound in it", frequency=math.nan, impedance=math.nan)
    found = find_resonance(response, model, rough[1].frequency, response.sampled(*rough), question.keys, question.turns,
                           final)
    if isinstance(response, Impedance) and found.sides is None:
        raise NoResonance(found.reason, frequency=found.frequency.value, impedance=math.exp(found.least.value))
    return found


def _of_resonance(
    resonance: Resonance, response: ResonantQuantity, found: dict[str, Dual], missing: dict[str, str]
) -> None:
    """Add the figures of a resonance.

    They are f0, Z_min and Q of the impedance, or the peak's frequency and Q.
    """
    if isinstance(response, Impedance):
        z_min = math.exp(resonance.least.value)
        found.update(f0=resonance.frequency, z_min=Dual(z_min, z_min * resonance.least.gradient), q=resonance.q)
    else:
        found["peak_frequency"] = resonance.frequency
        if resonance.sides is None:
            missing["peak_q"] = resonance.reason
        else:
            found["peak_q"] = resonance.q


@dataclass(frozen=True, eq=False)
class _Operating:
    """A chip at its driven frequency.

    ``state`` is the state there, ``frequency`` has its derivatives, and ``sound`` is the energy of sound in the cavity,
    None without a fluid.
    """

    question: Question
    state: LinearisedState
    frequency: Dual
    sound: SoundEnergy | None

    @property
    def state_slopes(self) -> Complex:
        """The total derivatives (size, k) of the state by the numbers.

        They include the change of the driven frequency.
        """
        return (self.state.by_parameter * self.question.turns
                + np.outer(self.state.by_frequency, self.frequency.gradient))

    def _of_level(self, level: Level) -> Dual:
        """The response of a logarithmic level, with its total derivatives."""
        value = math.exp(level.value)
        return Dual(value, value * (level.by_number + level.slope * self.frequency.gradient))

    @property
    def square_of_voltage(self) -> Dual:
        """|V|^2 (V^2) of the amplitude at the electrodes."""
        return self._of_level(drive_level(self.question.operation.drive.amplitude, self.state, self.question.turns))

    def electrical(self, names: list[str], found: dict[str, Dual], missing: dict[str, str]) -> None:
        """Voltage, power, heating and shares of the losses."""
        square = self.square_of_voltage
        if "voltage" in names:
            found["voltage"] = square**0.5 * 2.0
        if names == ["voltage"]:
            return
        losses, regions = self._losses()
        total = np.ones(len(regions)) @ losses
        resistance = self.question.operation.thermal_resistance
        for name in names:
            if name == "power":
                found[name] = total * square
            elif name == "heating" and not resistance:
                missing[name] = "no thermal resistance is stated"
            elif name == "heating":
                found[name] = np.array([resistance.get(each, resistance.get("", 0.0)) for each in regions]
                                       ) @ losses * square
            elif name != "voltage":
                found[name] = np.array([float(LOSS_SHARE + each == name) for each in regions]) @ losses / total

    def _losses(self) -> tuple[Dual, list[str]]:
        """The power (n,) W lost in every integral, and their regions (n,).

        It is -w/2 Im(g_q) x^H A_q x at 1 V amplitude.
        """
        operators, question = self.state.solution.operators, self.question
        state, moved, frequency = self.state.state, self.state_slopes, self.frequency.value
        forms = operators.quadratic(np.conj(state)[:, None], state[:, None])[0].real
        both = np.repeat(np.conj(state)[:, None], moved.shape[1], axis=1)
        changes = 2.0 * operators.quadratic(both, moved).real if moved.shape[1] else np.zeros((0, forms.size))
        at = operators.coefficients(2.0 * np.pi * difference_frequencies(frequency), question.values)
        value, by_hertz, _ = by_frequency(at.T, frequency)
        slopes, _ = slope_columns(operators, frequency, question.values, question.keys)
        coefficients = Dual(value.imag, (slopes * question.turns).imag.T
                            + np.outer(self.frequency.gradient, by_hertz.imag))
        return (Dual(forms, changes) * coefficients * self.frequency * -math.pi,
                [parent_place(each.place) for each in operators.integrals])

    def of_field(self, names: list[str], found: dict[str, Dual], missing: dict[str, str]) -> None:
        """Figures of the cavity's field and of the trap in it."""
        cavity, square = self.question.cavity, self.square_of_voltage
        if "mean_e_ac" in names and self.sound is not None:
            found["mean_e_ac"] = square * self._of_level(
                self.sound.log_level(self.state, self.question.values, self.question.turns))
        rest = [each for each in names if each != "mean_e_ac" or self.sound is None]
        if cavity is None:
            missing.update(dict.fromkeys(rest, self.question.reason))
            return
        if not rest:
            return
        field_there = self._field(cavity)
        if {"p0", "e_ac"} & set(names):
            largest = largest_square(field_there) * square
            found["p0"] = largest**0.5
            found["e_ac"] = largest / (field_there.around["density"] * field_there.around["sound_speed"] ** 2.0) / 4.0
        of_trap = [name for name in names if name in OF_TRAP]
        if of_trap and cavity.particle is None:
            missing.update(dict.fromkeys(of_trap, "the state names no particle"))
        elif of_trap:
            try:
                _trap_figures(find_trap(field_there, self.question.near), square, found, missing, self.question.beyond)
            except NoTrap as error:
                missing.update(dict.fromkeys(of_trap, str(error)))

    def _field(self, cavity: Cavity) -> CavityField:
        question, pressure = self.question, self.question.pressure
        assert pressure is not None
        state = np.column_stack([self.state.state, self.state_slopes])
        at = pressure(state)
        moving = np.array([question.unit(name) for name in cavity.lengths]).reshape(len(cavity.lengths),
                                                                                     len(question.names))
        change = cavity.change(question.values)
        width, height = (each[-1] - each[0] for each in cavity.lines(change, moving))
        around = {"frequency": self.frequency, "width": width, "height": height}
        for name in OF_FLUID:
            key, stated = f"{cavity.fluid.name}.{name}", getattr(cavity.fluid, name)
            if stated is not None:
                around[name] = Dual(complex(question.values.get(key, stated)).real, question.unit(key))
        return cavity_field(cavity, at[:, :, 0], at[:, :, 1:], around, change, moving)


def _trap_figures(
    trap: FoundTrap, square: Dual, found: dict[str, Dual], missing: dict[str, str], beyond: float
) -> None:
    found["trap_height"], found["trap_radius"] = trap.height, trap.radius
    found["trap_offset"] = trap.height - trap.field.around["height"] * 0.5
    found["trap_depth"] = trap.depth * square
    found["axial_stiffness"], found["radial_stiffness"] = trap.axial * square, trap.radial * square
    circulating = follows_flow(trap)
    if circulating:
        missing["focus_time"] = circulating
        return
    try:
        found["focus_time"] = trap_focus_time(trap, square, beyond=beyond)
    except NoTrap as error:
        missing["focus_time"] = str(error)
