"""A campaign: one device in several states, with recordings and priors.

    [campaign]
    name = "device"
    materials = "materials"         # a folder of materials beside the file
    known = "stated"                # priors also come from chip files and materials: lengths with a tolerance (the
                                    # limit of a uniform law), coefficients with an uncertainty; "named": only [known]

    [states.empty]
    chip = "chip.toml"              # path relative to the campaign's file
    state = "empty"                 # of that chip; optional if there is only one
    recording = "empty.csv"
    drive = "1 Vpp"                 # at the electrodes
    temperature = "25 degC"         # of the fluid in the cavity
    band = ["0.95 MHz", "1.05 MHz"] # of the recording; default: the chip's band
    noise = "0.5 %"                 # of a point, if the recording has no uncertainty
    held_out = true                 # never fitted, only predicted
    columns = "MAP.toml"            # of the recording, if its headings do not identify its columns
    without_outliers = true         # omits the points that the findings on the recording name

    [states.filled.observations]    # beside the impedance (`workbench.campaign.observation`)
    focusing_time = { value = "2.3 s", uncertainty = "10 %", drive = "10 Vpp", frequency = "1.0263 MHz" }

    [known]                         # standard uncertainties, one value in all states
    "pla/acevedo_2026.shear_modulus" = "3 %"
    "couplant.thickness" = "5 um"
    "bench.series_resistance" = "0.05 ohm"

    [states.empty.known]            # standard uncertainties of an offset in this state alone
    "couplant.thickness" = "2 um"

    [between]                       # standard uncertainties of an offset in every state with the parameter
    "bench.gain" = "0.2 %"
    "couplant.thickness" = "10 %"
    defaults = true                 # adds the changes of any bench to gain, series_resistance and clock, unless stated
                                    # above (`workbench.campaign.knowledge.BETWEEN_RECORDINGS`)

    [fixed]
    names = ["transducer.density"]  # exact parameters, which no hypothesis moves

    [model]
    inhomogeneity = "0.2 %"         # of the smooth relative changes of stiffness, mass and loss within parts that no
                                    # model gets right; "0" for none; left out, it is estimated from the recordings

One device: a name is one parameter in all states. Parameters without an uncertainty are exact. Percentages are of the
stated value; those of gain, phase and clock of the bench are of 1. Statements about one parameter are independent of
each other, with one exception: a statement in [known] replaces those of the chip and material files, and their
correlations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from geometry.names import TRANSDUCER
from geometry.stretch import canonical_names
from materials.assumed import is_lossless
from materials.kinds import Piezoelectric
from materials.registry import Registry, user_registry
from workbench.campaign.knowledge import read_knowledge
from workbench.campaign.state import DeviceState as DeviceState
from workbench.campaign.state import read_state
from workbench.files.errors import InputError, nearest_names
from workbench.files.names import check_name, check_title
from workbench.files.quantities import ProgramSource
from workbench.files.tables import FileTable
from workbench.model.numbers import Number, ParameterName, word_list
from workbench.results.brief import Brief

#: Values of ``known``: priors from the files of chip and materials too, or only from the campaign's tables.
STATED, NAMED = "stated", "named"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Campaign(Brief):
    """A device, its states, and the priors of its parameters.

    ``uncertain`` are parameters with a standard uncertainty and its source: first the shared ones, then the offsets in
    one state (``bench.gain[filled]``). ``fixed`` names exact parameters. Coinciding radii of a chip are one parameter,
    under the first of their names. ``correlations`` are coefficients between the names of two shared parameters, each
    pair once. ``inhomogeneity`` is the standard deviation of the smooth relative changes of stiffness, mass and loss
    within parts that no model gets right; None if it is estimated from the data.
    """

    name: str
    file: str
    states: tuple[DeviceState, ...]
    uncertain: tuple[Number, ...]
    fixed: tuple[str, ...]
    correlations: Mapping[tuple[str, str], float]
    registry: Registry
    inhomogeneity: float | None

    def __init__(
        self,
        states: Mapping[str, Mapping[str, Any]],
        *,
        known: Mapping[str, Any] | None = None,
        between: Mapping[str, Any] | None = None,
        fixed: Sequence[str] = (),
        inhomogeneity: float | str | None = None,
        from_files: bool = True,
        name: str = "device",
        registry: Registry | None = None,
        source: str = ProgramSource("Campaign"),
    ) -> None:
        """A campaign from the values of a campaign's file.

        Numbers may be in SI without units. `states`, `known` and `between` are the tables of the file
        (:mod:`workbench.campaign.campaign`); the ``chip`` of a state may be a chip, its ``recording`` a spectrum or a
        reading. No hypothesis moves the parameters named in `fixed`. With `from_files`, priors also come from chips and
        materials. Materials are from the user's registry by default.

        Raises:
            InputError: the values do not describe a campaign.
        """
        check_title(name, source=source, field="campaign.name")
        table = FileTable.made(source, {
            "states": states, "known": known, "between": between, "fixed": {"names": fixed},
            "model": {"inhomogeneity": inhomogeneity}})
        registry = user_registry() if registry is None else registry
        read = tuple(_states(table, Path(source).parent, registry))
        if not any(not state.held_out for state in read):
            raise InputError(source, "states", ", ".join(s.name for s in read) or "none",
                             "at least one state with a recording that is not held out")
        _check_one_device(read, source)
        found = read_knowledge(table, read, from_files=from_files)
        self.__dict__.update(
            name=name, file=source, states=read, uncertain=found.numbers, fixed=found.fixed,
            correlations=found.correlations, registry=registry, inhomogeneity=_inhomogeneity(table))

    @cached_property
    def known(self) -> Mapping[str, float]:
        """Standard uncertainties (SI) of the shared parameters, by name."""
        return {each.name: each.deviation for each in self.uncertain if not each.parsed.state}

    @cached_property
    def offsets(self) -> Mapping[str, float]:
        """Standard uncertainties (SI) of the offsets in one state, by name."""
        return {each.name: each.deviation for each in self.uncertain if each.parsed.state}

    @cached_property
    def is_exact(self) -> bool:
        """Whether no length and no coefficient of a solid has an uncertainty."""
        fluids = {state.fluid.name for state in self.states if state.fluid is not None}
        return all(each.parsed.is_bench or each.parsed.owner in fluids for each in self.uncertain)

    @cached_property
    def tied(self) -> Mapping[str, tuple[str, ...]]:
        """Further names of each parameter that is several coinciding radii."""
        first = canonical_names(*(state.chip for state in self.states))
        found: dict[str, tuple[str, ...]] = {}
        for name, chosen in first.items():
            if name != chosen:
                found[chosen] = (*found.get(chosen, ()), name)
        return found

    @property
    def findings(self) -> tuple[str, ...]:
        """Findings on parameters that count as exact, as zero, or as one."""
        result = []
        if self.is_exact:
            files = word_list(list(dict.fromkeys(state.chip.file for state in self.states)))
            result.append(
                "All lengths and solids count as exact, since no file states how exactly they are known: an error "
                f"of one of them may pass for missing physics. State a tolerance of each length in {files}, such as "
                'thickness = { value = "20 um", tolerance = "5 um" }, and an uncertainty of each coefficient in the '
                "file of its material, or both in [known] of a campaign file.")
        for name in dict.fromkeys(m.name for state in self.states for m in state.materials.values()
                                  if isinstance(m, Piezoelectric) and is_lossless(m)):
            result.append(
                f"{name} states no loss, and none is assumed here, unlike in a simulation: its resonances are "
                "narrower than any that is recorded. State mechanical_q and dielectric_loss_tangent in an entry of "
                "your own, or fit the disc.")
        tied = [f"{name} stands for {word_list(others)}" for name, others in self.tied.items() if name in self.known]
        return (*result, *([f"Radii that coincide are one parameter: {'; '.join(tied)}."] if tied else []))

    @cached_property
    def recorded(self) -> tuple[DeviceState, ...]:
        """The states with their recordings, followed by the states of their observations."""
        return (*self.states, *(each for state in self.states for each in state.observed))

    @cached_property
    def fitted(self) -> tuple[DeviceState, ...]:
        """States of :attr:`recorded` that are fitted."""
        return tuple(state for state in self.recorded if not state.held_out)

    @cached_property
    def held_out(self) -> tuple[DeviceState, ...]:
        """States of :attr:`recorded` that are only predicted."""
        return tuple(state for state in self.recorded if state.held_out)


def read_campaign(path: Path | str, *, materials: Sequence[Path | str] = ()) -> Campaign:
    """Read a campaign file, its chips and its recordings.

    `materials` are further folders of materials.

    Raises:
        InputError: a mistake in one of the files, a recording that cannot be of this device, a name that no state has,
            or contradictory statements about one parameter.
    """
    path = Path(path)
    table = FileTable.read(path).only(("campaign", "states", "known", "between", "fixed", "model"))
    head = table.table("campaign", expected="a table [campaign]").only(("name", "materials", "known"))
    fixed = table.table("fixed", expected="a table [fixed]").only(("names",))
    model = table.table("model", expected="a table [model]").only(("inhomogeneity",), renamed={
        "accuracy": "inhomogeneity"})
    return Campaign(
        table.content.get("states", {}), known=table.content.get("known"), between=table.content.get("between"),
        fixed=fixed.content.get("names", ()), inhomogeneity=model.content.get("inhomogeneity"),
        from_files=head.choice("known", (STATED, NAMED), STATED) == STATED,
        name=head.content.get("name", path.stem),
        registry=user_registry([*materials, *_own_materials(head, path.parent)]), source=table.source)


def _own_materials(head: FileTable, folder: Path) -> Iterator[Path]:
    if "materials" in head:
        own = folder / str(head.content["materials"])
        if not own.is_dir():
            raise head.error("materials", "a folder of materials beside the campaign's file")
        yield own


def _states(table: FileTable, folder: Path, registry: Registry) -> Iterator[DeviceState]:
    listed = table.table("states", expected="a table [states]")
    if not listed.content:
        raise table.error("states", "a table [states]")
    found = {name: listed.table(name, expected=f"a table [states.{name}]") for name in listed}
    whole = [name for name, each in found.items() if set(each) - {"known"}]
    for name, each in found.items():
        check_name(name, source=table.source, field=listed.field)
        if name not in whole and each.content:
            raise InputError(table.source, listed.at(name), name, "one of the states that have a chip and a recording: "
                             + ", ".join(whole), nearest_names(name, whole))
        yield read_state(name, each, folder, registry)


def _inhomogeneity(table: FileTable) -> float | None:
    model = table.table("model")
    found = model.optional_quantity("inhomogeneity", "share")
    if found is not None and not 0.0 <= found < 1.0:
        raise model.error("inhomogeneity", 'a relative deviation from 0 to below 1, such as "0.2 %"')
    return found


def _check_one_device(states: Sequence[DeviceState], source: str) -> None:
    """Raise if a length or the transducer's material differs between states."""
    for name, first, other in _pairs(states):
        a, b = first.chip.dimensions()[name].value, other.chip.dimensions()[name].value
        if abs(a - b) > 1e-9:
            raise InputError(source, f"states.{other.name}.chip", f"{name} of {1e3 * b:.6g} mm",
                             f"the {1e3 * a:.6g} mm of state {first.name!r}: the states are those of one device")
    transducers = {s.materials[TRANSDUCER].name for s in states}
    if len(transducers) > 1:
        raise InputError(source, "states", ", ".join(sorted(transducers)), "one transducer material: the states are "
                         "those of one device")


def _pairs(states: Sequence[DeviceState]) -> Iterator[tuple[str, DeviceState, DeviceState]]:
    first: dict[str, DeviceState] = {}
    for state in states:
        for name in state.chip.dimensions():
            # The gel below a sample and the gel below a chip are two layers, even under one name.
            if ParameterName.parse(name).owner == TRANSDUCER or _same_stack(first.get(name, state), state):
                if name in first:
                    yield name, first[name], state
                first.setdefault(name, state)


def _same_stack(one: DeviceState, other: DeviceState) -> bool:
    return [x.region for x in one.chip.layers] == [x.region for x in other.chip.layers]
