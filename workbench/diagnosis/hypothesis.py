"""What a hypothesis is, what the functions of the catalogue look at, and how they make one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from materials.kinds import Fluid, Material
from materials.registry import Registry
from workbench.diagnosis.campaign import DeviceState, value_of
from workbench.fitting.parameter import Parameter
from workbench.physics.term import Admissible, Term

#: Rims that may lack something begin at these shares of the radius, one in the other: a sharp edge lies between two.
RIMS = (0.5, 0.7, 0.84, 0.92, 0.96, 0.985, 0.995)

#: How far a real coefficient may lie from what is stated.
MISTAKEN_STIFFNESS, MISTAKEN_DENSITY = 0.3, 0.15

#: Gives a state's terms of a hypothesis, and the values that those need.
Make = Callable[[DeviceState], tuple[tuple[Term, ...], Mapping[str, complex]]]


@dataclass(frozen=True, eq=False)
class Effect:
    """One hypothesis.

    ``region`` is where it sits: a region, ``<region>|<region>`` or "bench"; ``kind`` stiffness, mass, loss, geometry,
    coupling or bench. ``parameters`` are what it brings in; ``releases`` names known parameters that it lets go further
    than what is known of them. ``admissible`` bounds its parameters, with the source. ``terms`` and ``values`` are by
    the name of the state.
    """

    name: str
    region: str
    kind: str
    about: str
    parameters: tuple[Parameter, ...] = ()
    releases: tuple[str, ...] = ()
    admissible: Mapping[str, Admissible] = field(default_factory=dict)
    terms: Mapping[str, tuple[Term, ...]] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, complex]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that it moves."""
        return (*(p.name for p in self.parameters), *self.releases)


@dataclass(frozen=True, eq=False)
class Device:
    """What the catalogue looks at: the states of a device, what is known of it, and the materials there are."""

    states: tuple[DeviceState, ...]
    known: Mapping[str, float]
    fixed: tuple[str, ...]
    registry: Registry

    def load_fluid(self, name: str, temperature: float | None = None) -> Fluid:
        """A fluid of the registry; see `materials.registry.Registry.load`."""
        found = self.registry.load(name, temperature=temperature)
        assert isinstance(found, Fluid)
        return found

    def holding(self, region: str) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if region in state.materials)

    @property
    def filled(self) -> tuple[DeviceState, ...]:
        """States whose cavity holds a liquid."""
        return tuple(s for s in self.states if s.fluid is not None and is_liquid(s.fluid))

    def materials(self) -> dict[str, tuple[Material, tuple[str, ...]]]:
        """Every material by name, and the regions it fills in some state."""
        found: dict[str, tuple[Material, tuple[str, ...]]] = {}
        for state in self.states:
            for region, material in state.materials.items():
                _, regions = found.get(material.name, (material, ()))
                found[material.name] = (material, tuple(dict.fromkeys((*regions, region))))
        return found


def is_liquid(material: Material) -> bool:
    return isinstance(material, Fluid) and material.density > 100.0


def new_parameter(name: str, admissible: Admissible, start: float = 0.0) -> Parameter:
    """A parameter of a hypothesis: anywhere within what is admissible, without a prior."""
    return Parameter(name, start, admissible.lowest, admissible.highest, None, admissible.unit)


def terms_by_state(
    states: Iterable[DeviceState], make: Make
) -> tuple[dict[str, tuple[Term, ...]], dict[str, Mapping[str, complex]]]:
    """The terms that `make` gives every state, and the values that these need, by the state's name."""
    terms, values = {}, {}
    for state in states:
        terms[state.name], values[state.name] = make(state)
    return terms, values


def with_terms(
    label: str, region: str, kind: str, about: str, states: Iterable[DeviceState], make: Make,
    limits: Mapping[str, Admissible], starts: Mapping[str, float] | None = None,
) -> Effect:
    """The hypothesis that brings terms of its own into `states`, its parameters at nothing or where they start."""
    terms, values = terms_by_state(states, make)
    parameters = tuple(new_parameter(name, limit, (starts or {}).get(name, 0.0)) for name, limit in limits.items())
    return Effect(label, region, kind, about, parameters, admissible=limits, terms=terms, values=values)


def around(value: float, share: float, unit: str) -> Admissible:
    """What a stated value may be that was mistaken by up to a share of itself."""
    return Admissible((1.0 - share) * value, (1.0 + share) * value, unit,
                      f"within {100 * share:g} % of what is stated: a mistake that goes unnoticed")


def propose_value(
    device: Device, label: str, region: str, kind: str, name: str, limit: Admissible, about: str, *,
    relative: bool = False, start: float | None = None,
) -> Iterator[Effect]:
    """The hypothesis that a parameter the model has already is not what is known of it."""
    if name in device.known:
        yield Effect(label, region, kind, about, releases=(name,), admissible={name: limit})
        return
    if relative:
        parameter = Parameter(name, 1.0, limit.lowest, limit.highest, None, "1", relative=True)
    else:
        value = value_of(name, device.states) if start is None else start
        parameter = Parameter(name, float(min(max(value, limit.lowest), limit.highest)), limit.lowest, limit.highest,
                              None, limit.unit)
    yield Effect(label, region, kind, about, (parameter,), admissible={name: limit})


def rims_of(region: str) -> dict[str, float]:
    """Rims of a layer and where they begin, as shares of its radius."""
    return {f"{region} beyond {100 * share:g} %": share for share in RIMS}
