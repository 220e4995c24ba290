"""A campaign: one device in several states, each with its recording, and what is known about the device.

    [campaign]
    name = "device"
    materials = "materials"         # a folder of materials beside the file
    known = "stated"                # also known is what chip files and materials state: lengths with a tolerance (the
                                    # limit of a uniform law), coefficients with an uncertainty; "named": only [known]

    [states.empty]
    chip = "chip.toml"              # path relative to the campaign's file
    state = "empty"                 # of that chip; may be left out where there is one only
    recording = "empty.csv"
    drive = "1 Vpp"                 # at the electrodes
    temperature = "25 degC"         # of what fills the cavity
    band = ["0.95 MHz", "1.05 MHz"] # of the recording, where not all of the chip's band
    noise = "0.5 %"                 # of a point, where the recording brings no uncertainty
    held_out = true                 # never fitted, only predicted
    columns = "MAP.toml"            # of the recording, where its headings do not say what they are

    [known]                         # standard uncertainties, one number in all states
    "pla/acevedo_2026.shear_modulus" = "3 %"
    "couplant.thickness" = "5 um"
    "bench.series_resistance" = "0.05 ohm"

    [states.empty.known]            # likewise, of what this state alone adds
    "couplant.thickness" = "2 um"

    [between]                       # and of what every state adds that has the number
    "bench.gain" = "0.2 %"
    "couplant.thickness" = "10 %"
    defaults = true                 # the bench of each state adds to gain, series_resistance and clock what benches do,
                                    # where nothing above says so (`workbench.diagnosis.knowledge.BETWEEN_RECORDINGS`)

    [fixed]
    names = ["transducer.density"]  # what no hypothesis may move, and what is exact

    [model]
    accuracy = "0.2 %"              # of the smooth relative changes of stiffness, mass and loss within parts that no
                                    # model gets right; "0" for none, left out for what the recordings say of it

One device: a name stands for one number in all states. Numbers that are not named are exact. Percentages are of the
stated value, those of gain, phase and clock of the bench of one. Statements about one number are independent of each
other, except that a number in [known] goes before what its own file says of it, correlations included.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from geometry.names import TRANSDUCER
from geometry.stretch import canonical_names
from materials.registry import Registry, user_registry
from workbench.diagnosis.knowledge import Taken, read_knowledge
from workbench.diagnosis.numbers import stated_number as stated_number
from workbench.diagnosis.numbers import unit_of as unit_of
from workbench.diagnosis.state import DeviceState as DeviceState
from workbench.diagnosis.state import read_state
from workbench.files.errors import InputError, nearest_names
from workbench.files.tables import FileTable
from workbench.model.numbers import ParameterName
from workbench.results.brief import Brief

#: Knowledge beside the numbers that the campaign names: that of the files of chip and materials, or none.
STATED, NAMED = "stated", "named"


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Brief):
    """A device, its states, and what is known of it.

    ``known`` maps parameter names (see `workbench.fitting.parameter`) to standard uncertainties in SI, ``offsets`` the
    names of what one state adds (``bench.gain[filled]``); ``fixed`` names what may not move. Radii that coincide in a
    chip are one parameter, under the first of their names. ``correlations`` are coefficients between two names of
    ``known``, each pair once; ``taken`` says of every name where its uncertainty comes from. ``model_accuracy`` is the
    standard deviation of the smooth relative changes of stiffness, mass and loss within parts that no model gets right,
    None if the data are to say it.
    """

    name: str
    file: str
    states: tuple[DeviceState, ...]
    known: Mapping[str, float]
    offsets: Mapping[str, float]
    fixed: tuple[str, ...]
    correlations: Mapping[tuple[str, str], float]
    taken: tuple[Taken, ...]
    registry: Registry
    model_accuracy: float | None = None

    @cached_property
    def tied(self) -> Mapping[str, tuple[str, ...]]:
        """The other names of every radius that stands for several."""
        first = canonical_names(*(state.chip for state in self.states))
        found: dict[str, tuple[str, ...]] = {}
        for name, chosen in first.items():
            if name != chosen:
                found[chosen] = (*found.get(chosen, ()), name)
        return found

    @property
    def fitted(self) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if not state.held_out)

    @property
    def held_out(self) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if state.held_out)


def read_campaign(path: Path | str, *, materials: Sequence[Path | str] = ()) -> Campaign:
    """Read and check a campaign file, its chips and its recordings; `materials` are further folders of materials.

    Raises:
        InputError: a mistake in one of the files, a recording that cannot be of this device, a name that no state has,
            or two statements about one thing that contradict each other.
    """
    path = Path(path)
    table = FileTable.read(path).only(("campaign", "states", "known", "between", "fixed", "model"))
    source = table.source
    head = table.table("campaign", expected="a table [campaign]").only(("name", "materials", "known"))
    registry = user_registry([*materials, *_own_materials(head, path.parent)])
    states = tuple(_states(table, path.parent, registry))
    if not any(not state.held_out for state in states):
        raise InputError(source, "states", ", ".join(s.name for s in states) or "none",
                         "at least one state with a recording that is not held out")
    _check_one_device(states, source)
    found = read_knowledge(table, states, from_files=head.choice("known", (STATED, NAMED), STATED) == STATED)
    return Campaign(str(head.content.get("name", path.stem)), source, states, found.known, found.offsets, found.fixed,
                    found.correlations, found.taken, registry, _accuracy(table))


def _own_materials(head: FileTable, folder: Path) -> Iterator[Path]:
    """The folder of materials that a campaign brings along, if it does."""
    if "materials" in head:
        said = str(head.content["materials"])
        if not (folder / said).is_dir():
            raise head.error("materials", "a folder of materials beside the campaign's file")
        yield folder / said


def _states(table: FileTable, folder: Path, registry: Registry) -> Iterator[DeviceState]:
    listed = table.table("states", expected="a table [states]")
    if not listed.content:
        raise table.error("states", "a table [states]")
    found = {name: listed.table(name, expected=f"a table [states.{name}]") for name in listed}
    whole = [name for name, each in found.items() if set(each) - {"known"}]
    for name, each in found.items():
        if name not in whole and each.content:
            raise InputError(table.source, listed.at(name), name, "one of the states that have a chip and a recording: "
                             + ", ".join(whole), nearest_names(name, whole))
        yield read_state(name, each, folder, registry)


def _accuracy(table: FileTable) -> float | None:
    """The accuracy of the model, relative; None where nobody says."""
    model = table.table("model", expected="a table [model]").only(("accuracy",))
    found = model.optional_quantity("accuracy", "share")
    if found is not None and not 0.0 <= found < 1.0:
        raise model.error("accuracy", 'a relative deviation from 0 to below 1, such as "0.2 %"')
    return found


def _check_one_device(states: Sequence[DeviceState], source: str) -> None:
    """All states must agree on what they share: one name, one length."""
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
            # The gel below a sample and that below a chip are two layers, whatever they are called.
            if ParameterName.parse(name).owner == TRANSDUCER or _same_stack(first.get(name, state), state):
                if name in first:
                    yield name, first[name], state
                first.setdefault(name, state)


def _same_stack(one: DeviceState, other: DeviceState) -> bool:
    return [x.region for x in one.chip.layers] == [x.region for x in other.chip.layers]
