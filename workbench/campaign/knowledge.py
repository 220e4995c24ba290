"""Priors of a device's parameters, shared by all states or of one.

Standard uncertainties come from the campaign's tables, from the files of the chip and its materials (a tolerance is the
limit of a uniform law, `workbench.design.uncertainty`), and from changes of any bench between two recordings
(:data:`BETWEEN_RECORDINGS`). Independent statements about one parameter add their variances.
`workbench.campaign.campaign` describes the tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from workbench.campaign.numbers import SAME_NUMBER, DeviceNumbers, names, stated_number
from workbench.campaign.state import DeviceState
from workbench.design.input_uncertainty import uncertainty_of_files
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable
from workbench.model.device_numbers import ASSUMED, assumed_by_role
from workbench.model.numbers import BENCH, STATE, STATE_END, Number, ParameterName, Stated

#: Changes of any bench between two recordings, as standard uncertainties in SI, with their reasons. An instrument
#: repeats a reading to about 0.2 % after its cables were moved. The contact resistance of clips changes by about
#: 20 mohm when they are attached again. Data sheets of generators state 1 to 50 ppm for the clock; most of it is a
#: constant offset, and about 5 ppm changes with temperature and age. If doubled, differences of this size between
#: states have half the weight.
BETWEEN_RECORDINGS: Mapping[str, tuple[float, str]] = {
    "gain": (2e-3, "repeatability of instruments"),
    "series_resistance": (0.02, "contact resistance of clips"),
    "clock": (5e-6, "drift of generators' clocks"),
}

#: The key of [between] that disables these.
DEFAULTS = "defaults"

#: Maps a name to groups of states that a statement applies to; each has the name of its only state, or "" for all.
Groups = Callable[[str], Sequence[tuple[str, Sequence[DeviceState]]]]


@dataclass(frozen=True)
class Knowledge:
    """The priors of a device, and the names of its exact parameters.

    ``numbers`` are first the shared parameters, then the offsets in one state (``bench.gain[filled]``), each with its
    standard uncertainty and the source; ``fixed`` are names of shared ones. ``correlations`` are coefficients between
    the names of two shared parameters, each pair once.
    """

    numbers: tuple[Number, ...]
    fixed: tuple[str, ...]
    correlations: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class _Statement:
    """One standard uncertainty of a parameter. It applies to one ``state``, or to all (""). ``field`` is its place in
    the campaign's file, "" for other sources."""

    name: str
    state: str
    stated: Stated
    field: str = ""


def read_knowledge(campaign: FileTable, states: tuple[DeviceState, ...], *, from_files: bool = True) -> Knowledge:
    """The priors in a `campaign` and, with `from_files`, its states' files.

    Raises:
        InputError: a name that no state has, an invalid uncertainty, or contradictory statements.
    """
    numbers = DeviceNumbers(states)
    fixed = tuple(_fixed(campaign.table("fixed", expected="a table [fixed]"), numbers))
    shared = list(_stated(campaign.table("known", expected="a table [known]"), numbers, lambda _: (("", states),)))
    for each in shared:
        if not numbers.is_one(each.name):
            raise InputError(campaign.source, each.field, each.name, "a number that is the same in all states, which "
                             f"this is not; state it for each in [between] or [states.{states[0].name}.known]")
    own = [each for state in states for each in _of_state(campaign, state, numbers)]
    between = campaign.table("between", expected="a table [between]")
    varying = list(_stated(FileTable(between.source, between.field, {k: v for k, v in between.content.items()
                                                                     if k != DEFAULTS}), numbers,
                           lambda name: [(state.name, (state,)) for state in numbers.having(name)]))
    for each in (*shared, *own, *varying):
        if each.name in fixed:
            raise InputError(campaign.source, "fixed.names", each.name, f"a name that {each.field} does not free with "
                             f"an uncertainty of {each.stated.deviation:g}: it either may move or may not")
    closed = {*fixed, *(each.name for each in varying)}
    if between.flag(DEFAULTS, default=True):
        varying += [_Statement(BENCH + element, state.name, Stated(size, origin=f"[between] by default: {reason}"))
                    for element, (size, reason) in BETWEEN_RECORDINGS.items() if BENCH + element not in closed
                    for state in states]
    found, correlations = _harvested(numbers, {*fixed, *(each.name for each in shared)}) if from_files else ([], {})
    return _together(numbers, (*shared, *found, *own, *varying), fixed, correlations)


def _of_state(campaign: FileTable, state: DeviceState, numbers: DeviceNumbers) -> Iterator[_Statement]:
    table = campaign.table("states").table(state.name).table("known", expected=f"a table [states.{state.name}.known]")
    yield from _stated(table, numbers, lambda _: ((state.name, (state,)),), of=(state,))


def _stated(
    table: FileTable, numbers: DeviceNumbers, groups: Groups, *, of: Sequence[DeviceState] = ()
) -> Iterator[_Statement]:
    """The statements of a table about parameters, or about those `of` states. Coinciding radii are one parameter:
    several names may state the same uncertainty."""
    known, written_as = of or numbers.states, dict[str, tuple[str, float]]()
    for written in table:
        name, field = numbers.named(written), table.at(written)
        if STATE in written:
            shared, _, state = written.removesuffix(STATE_END).partition(STATE)
            raise InputError(table.source, field, written, f'"{shared}" in the table [states.{state}.known], which '
                             "states the offsets of one state")
        if not any(state in known for state in numbers.having(name)):
            raise InputError(table.source, field, written, "the name of a material's coefficient, a dimension of a "
                             f"chip or a bench element that {'this' if of else 'a'} state has",
                             nearest_names(written, names(known)))
        _check_inexact(table, written, name, numbers)
        found = [_Statement(name, state, Stated(_uncertainty(table, written, name, numbers, states),
                                                origin=f"{table.source}: [{table.field}]"), field)
                 for state, states in groups(name)]
        before, size = written_as.get(name), found[0].stated.deviation
        if before is not None and name not in numbers.first:
            raise InputError(table.source, field, written, f"each parameter once ({name})")
        if before is not None and abs(size - before[1]) > SAME_NUMBER * size:
            raise table.error(written, f"the uncertainty that {table.at(before[0])} has: the two radii coincide, so "
                              "they are one parameter")
        if before is None:
            written_as[name] = (written, size)
            yield from found


def _uncertainty(
    table: FileTable, written: str, name: str, numbers: DeviceNumbers, states: Sequence[DeviceState]
) -> float:
    """A standard uncertainty in SI. A percentage is of the value in the first of `states` with the parameter."""
    entry, parsed = table.content[written], ParameterName.parse(name)
    if entry == ASSUMED and parsed.is_dimension:
        material = next((state.numbers[parsed.shared].material for state in states if parsed.shared in state.numbers),
                        "")
        return assumed_by_role(name, stated_number(name, states), material).deviation
    share = isinstance(entry, str) and entry.strip().endswith("%")
    # A bare number for the gain or the clock of a bench is an error: its percent sign may be missing.
    found = parse_quantity(entry, "dimensionless" if share else parsed.quantity, source=table.source,
                           field=table.at(written))
    if share:
        having = numbers.having(name)
        size = abs(numbers.number(name, next(state for state in states if state in having)).value)
        if parsed.is_bench and parsed.quantity in ("share", "angle"):
            size = 1.0
        if size == 0.0:
            raise table.error(written, f"an uncertainty in {parsed.unit}: {name} is zero, so a percentage of it says "
                              "nothing; the unit is needed")
        found *= size
    if not found > 0.0:
        raise table.error(written, "a standard uncertainty above zero; exact parameters are left out")
    return found


def _check_inexact(table: FileTable, written: str, name: str, numbers: DeviceNumbers) -> None:
    for state in numbers.states:
        for each in numbers.together(name):
            if each in state.numbers and state.numbers[each].tolerance == 0.0:
                raise table.error(written, f"nothing: {state.chip.file} states {each} as exact (a tolerance of 0)")


def _fixed(table: FileTable, numbers: DeviceNumbers) -> Iterator[str]:
    states = numbers.states
    for written in table.only(("names",)).texts("names", (), expected="a list of names"):
        parsed, name = ParameterName.parse(written), numbers.named(written)
        material = next((s.materials[parsed.owner].name for s in states if parsed.owner in s.materials), None)
        if parsed.local == "density" and material is not None:
            name = f"{material}.density"
        if STATE in written or not numbers.having(name):
            raise InputError(table.source, table.at("names"), written, "the name of a parameter that a state has",
                             nearest_names(written, names(states)))
        yield name


def _harvested(
    numbers: DeviceNumbers, closed: Iterable[str]
) -> tuple[list[_Statement], dict[tuple[str, str], float]]:
    """The statements of the states' files, without `closed` parameters, and correlations.

    Each state has its own statement for a parameter that differs between states.

    Raises:
        InputError: two chip files state different tolerances of one length.
    """
    found: dict[tuple[str, str], _Statement] = {}
    correlations: dict[tuple[str, str], float] = {}
    for state in numbers.states:
        stated = uncertainty_of_files(state.device)
        kept: list[tuple[int, str]] = []
        for k, each in enumerate(stated.inputs):
            name = numbers.first.get(each.name, each.name)
            if name in closed:
                continue
            key = (name, "" if numbers.is_one(name) else state.name)
            kind = "tolerance" if each.is_dimension else "uncertainty"
            assert each.stated is not None
            new = replace(each.stated, origin=f"{each.origin}: {kind}")
            before = found.setdefault(key, _Statement(*key, new)).stated
            if abs(before.amount - new.amount) > SAME_NUMBER * new.amount and before.origin != new.origin:
                raise InputError(state.chip.file, f"{each.name}.tolerance", f"{new.amount:g} m",
                                 f"the {before.amount:g} m that {before.origin} is: one length")
            kept += [(k, name)] if not key[1] else []
        correlations |= {(one, other): float(stated.correlation[i, j])
                         for i, one in kept for j, other in kept if i < j and stated.correlation[i, j] != 0.0}
    return list(found.values()), correlations


def _together(
    numbers: DeviceNumbers, statements: Iterable[_Statement], fixed: tuple[str, ...],
    correlations: Mapping[tuple[str, str], float],
) -> Knowledge:
    """One uncertainty for each shared parameter and each offset. A parameter that only one state has combines its
    shared uncertainty and that of its offset."""
    by_number: dict[tuple[str, str], list[_Statement]] = {}
    for each in statements:
        alone = len(numbers.having(each.name)) == 1
        by_number.setdefault((each.name, "" if alone else each.state), []).append(each)
    found: dict[tuple[str, str], Number] = {}
    for (name, state), own in sorted(by_number.items(), key=lambda item: bool(item[0][1])):
        stated = Stated(math.hypot(*(each.stated.deviation for each in own)),
                        origin="; ".join(dict.fromkeys(each.stated.origin for each in own)))
        number = numbers.number(name)
        found[name, state] = replace(number, stated=stated) if not state else Number(
            str(number.parsed.of_state(state)), 0.0, stated=stated, unit=number.unit, tied=number.tied)
    # The offset of a state is independent of other parameters, so it reduces the correlation.
    shares = {name: by_number[name, ""][0].stated.deviation / number.deviation
              for (name, state), number in found.items() if not state}
    return Knowledge(tuple(found.values()), fixed, {
        (one, other): value * shares[one] * shares[other] for (one, other), value in correlations.items()})
