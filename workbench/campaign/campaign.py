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
    without_outliers = true         # leaves out the points that the findings on the recording name

    [states.filled.observations]    # beside the impedance (`workbench.campaign.observation`)
    focusing_time = { value = "2.3 s", uncertainty = "10 %", drive = "10 Vpp", frequency = "1.0263 MHz" }

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
                                    # where nothing above says so (`workbench.campaign.knowledge.BETWEEN_RECORDINGS`)

    [fixed]
    names = ["transducer.density"]  # what no hypothesis may move, and what is exact

    [model]
    inhomogeneity = "0.2 %"         # of the smooth relative changes of stiffness, mass and loss within parts that no
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

#: Knowledge beside the numbers that the campaign names: that of the files of chip and materials, or none.
STATED, NAMED = "stated", "named"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Campaign(Brief):
    """A device, its states, and the knowledge of its numbers.

    ``taken`` are the numbers that are uncertain, each with its standard uncertainty and who states it: those that all
    states share, then what one state adds to them (``bench.gain[filled]``); ``fixed`` names what may not move. Radii
    that coincide in a chip are one number, under the first of their names. ``correlations`` are coefficients between
    the names of two shared numbers, each pair once. ``inhomogeneity`` is the standard deviation of the smooth relative
    changes of stiffness, mass and loss within parts that no model gets right, None if the data are to say it.
    """

    name: str
    file: str
    states: tuple[DeviceState, ...]
    taken: tuple[Number, ...]
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
        """A campaign from values as a campaign's file has them, where numbers may stand in SI without units.

        `states`, `known` and `between` are the tables of the file (:mod:`workbench.campaign.campaign`); the ``chip``
        of a state may be a chip, its ``recording`` a spectrum or a reading. `fixed` names what no hypothesis may move;
        `from_files` takes what chips and materials state too. Materials come from the user's registry unless another
        is given.

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
            name=name, file=source, states=read, taken=found.numbers, fixed=found.fixed,
            correlations=found.correlations, registry=registry, inhomogeneity=_inhomogeneity(table))

    @cached_property
    def known(self) -> Mapping[str, float]:
        """Standard uncertainties (SI) of the numbers that all states share, by name."""
        return {each.name: each.deviation for each in self.taken if not each.parsed.state}

    @cached_property
    def offsets(self) -> Mapping[str, float]:
        """Standard uncertainties (SI) of what one state adds, by name."""
        return {each.name: each.deviation for each in self.taken if each.parsed.state}

    @cached_property
    def is_exact(self) -> bool:
        """Whether nobody states an uncertainty of a length or of a solid's coefficient."""
        fluids = {state.fluid.name for state in self.states if state.fluid is not None}
        return all(each.parsed.is_bench or each.parsed.owner in fluids for each in self.taken)

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
    def findings(self) -> tuple[str, ...]:
        """Statements on numbers that count as exact, as zero, or as one."""
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
        """The states with their recordings, and after them those that stand for an observation of one of them."""
        return (*self.states, *(each for state in self.states for each in state.observed))

    @cached_property
    def fitted(self) -> tuple[DeviceState, ...]:
        """Those of :attr:`recorded` that are fitted."""
        return tuple(state for state in self.recorded if not state.held_out)

    @cached_property
    def held_out(self) -> tuple[DeviceState, ...]:
        """Those of :attr:`recorded` that are predicted only."""
        return tuple(state for state in self.recorded if state.held_out)


def read_campaign(path: Path | str, *, materials: Sequence[Path | str] = ()) -> Campaign:
    """Read and check a campaign file, its chips and its recordings; `materials` are further folders of materials.

    Raises:
        InputError: a mistake in one of the files, a recording that cannot be of this device, a name that no state has,
            or two statements about one thing that contradict each other.
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
        check_name(name, source=table.source, field=listed.field)
        if name not in whole and each.content:
            raise InputError(table.source, listed.at(name), name, "one of the states that have a chip and a recording: "
                             + ", ".join(whole), nearest_names(name, whole))
        yield read_state(name, each, folder, registry)


def _inhomogeneity(table: FileTable) -> float | None:
    """The relative inhomogeneity within parts; None where nobody says."""
    model = table.table("model")
    found = model.optional_quantity("inhomogeneity", "share")
    if found is not None and not 0.0 <= found < 1.0:
        raise model.error("inhomogeneity", 'a relative deviation from 0 to below 1, such as "0.2 %"')
    return found


def _check_one_device(states: Sequence[DeviceState], source: str) -> None:
    """Refuse states that differ in a length or a material of one name."""
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
