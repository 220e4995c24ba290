"""A hypothesis of the catalogue, the device it is about, and hypotheses made of terms or of stated numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from materials.kinds import Fluid, IsotropicSolid, Material
from materials.registry import Registry
from workbench.campaign.numbers import stated_number
from workbench.campaign.state import DeviceState
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import LOSS, ParameterName
from workbench.physics.annulus import AnnulusTerm
from workbench.physics.softening import DRIVE_SQUARED
from workbench.physics.term import Admissible, FreeParameter, Term

#: Largest relative error of a stated real coefficient.
MISTAKEN_STIFFNESS, MISTAKEN_DENSITY = 0.3, 0.15


@dataclass(frozen=True, eq=False)
class Effect:
    """One hypothesis.

    ``region`` is where it sits: a region, ``<region>|<region>`` or "bench"; ``kind`` stiffness, mass, loss, geometry,
    coupling or bench. ``parameters`` are new ones; ``releases`` names known parameters whose priors it releases.
    ``admissible`` bounds its parameters, with the source. ``terms`` and ``values`` are by the name of the state.
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

    @property
    def rims(self) -> tuple[str, ...]:
        """Names of the widths of rims among them."""
        return tuple(dict.fromkeys(term.annulus.number for held in self.terms.values() for term in held
                                   if isinstance(term, AnnulusTerm)))

    def with_rings(self, widths: Mapping[str, float]) -> Effect:
        """A copy with rings about the edges of those rims whose `widths` by name are given."""
        def own(term: Any) -> Term:
            known = isinstance(term, AnnulusTerm) and term.annulus.number in widths
            return replace(term, annulus=term.annulus.about(widths[term.annulus.number])) if known else term

        return replace(self, terms={state: tuple(map(own, held)) for state, held in self.terms.items()})


@dataclass(frozen=True, eq=False)
class Device:
    """The device as the catalogue sees it: its states, the uncertainties of its numbers, and the registry of materials.
    """

    states: tuple[DeviceState, ...]
    known: Mapping[str, float]
    fixed: tuple[str, ...]
    registry: Registry

    def load_fluid(self, name: str, temperature: float | None = None) -> Fluid:
        """A fluid of the registry; see `materials.registry.Registry.load`."""
        found = self.registry.load(name, temperature=temperature)
        assert isinstance(found, Fluid)
        return found

    @cached_property
    def by_name(self) -> tuple[Material, ...]:
        """The materials of the registry, each name by the entry that it means alone; without those that mean none."""
        found = []
        for name in dict.fromkeys(each.partition("/")[0] for each in self.registry.names()):
            try:
                found.append(self.registry.load(name, notes=[]))
            except ValueError:
                continue
        return tuple(found)

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


def is_liquid(material: Material | None) -> bool:
    return isinstance(material, Fluid) and material.density > 100.0


def is_polymer(material: Material | None) -> bool:
    """Whether it is a solid as soft as a polymer."""
    return isinstance(material, IsotropicSolid) and abs(material.shear_modulus) <= 1e10


def filled_with(state: DeviceState, material: str) -> list[str]:
    """The regions that the material of that name fills in a state."""
    return [region for region, found in state.materials.items() if found.name == material]


def neighbours(state: DeviceState, region: str) -> tuple[str, str]:
    """The layers below and above one, "" where there is none."""
    order = ["", *(layer.region for layer in state.chip.layers), ""]
    at = order.index(region)
    return order[at - 1], order[at + 1]


def with_terms(
    label: str, region: str, kind: str, about: str, states: Sequence[DeviceState],
    terms: Callable[[DeviceState], Iterable[Term]],
    values: Callable[[DeviceState], Mapping[str, complex]] = lambda _: {},
    *, free: tuple[FreeParameter, ...] | None = None,
) -> Effect:
    """The hypothesis that brings `terms` into `states`, with all numbers neutral at first.

    `values` are what the terms need beyond what they state themselves and what a state does (its lengths, its drive);
    `free` stands in place of what the terms say is free of them. States to which no term is given are left out.
    """
    held = {state.name: made for state in states if (made := tuple(terms(state)))}
    numbers = {each.name: each for made in held.values() for term in made for each in term.free()}
    if free is not None:
        numbers = {each.name: each for each in free}
    own = {state.name: {
        **{each.name: each.neutral for each in numbers.values() if not each.name.endswith(LOSS)},
        **{name: value for term in held[state.name] for name, value in term.fixed().items()},
        **_stated(state, held[state.name]), **values(state)} for state in states if state.name in held}
    return Effect(label, region, kind, about, tuple(as_parameter(each) for each in numbers.values()),
                  admissible={name: each.admissible for name, each in numbers.items()}, terms=held, values=own)


def _stated(state: DeviceState, terms: Iterable[Term]) -> dict[str, float]:
    """Those numbers of a state that terms need: lengths of its chip (m), and the square of its drive (V^2)."""
    known = {name: length.value for name, length in state.chip.dimensions().items()}
    if state.drive is not None:
        known[DRIVE_SQUARED] = state.drive**2
    needed = {name for term in terms for integral in term.integrals() for name in integral.coefficient.parameters}
    return {name: value for name, value in known.items() if name in needed}


def as_parameter(free: FreeParameter) -> Parameter:
    """A number as a parameter without a prior: anywhere within its admissible range, the neutral value included."""
    limit, start = free.admissible, free.neutral
    return Parameter(free.name, start, min(limit.lowest, start), max(limit.highest, start), None, limit.unit)


def mistaken(name: str, value: float, share: float) -> dict[str, Admissible]:
    """The admissible range of the number called `name`, its stated `value` (SI) being wrong by up to a `share`."""
    return {name: Admissible((1.0 - share) * value, (1.0 + share) * value, ParameterName.parse(name).unit,
                             f"within {100 * share:g} % of what is stated: a mistake that goes unnoticed")}


def other_than_stated(
    device: Device, label: str, region: str, kind: str, about: str, limits: Mapping[str, Admissible], *,
    relative: bool = False,
) -> Effect:
    """The hypothesis that numbers of the model differ from the stated ones; priors of known numbers are released."""
    parameters = []
    for name, limit in limits.items():
        start = 1.0 if relative else float(min(max(stated_number(name, device.states), limit.lowest), limit.highest))
        if name not in device.known:
            parameters.append(Parameter(name, start, limit.lowest, limit.highest, None, limit.unit, relative=relative))
    return Effect(label, region, kind, about, tuple(parameters), tuple(n for n in limits if n in device.known), limits)
