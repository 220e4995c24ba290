"""Hypotheses of the catalogue, made of terms or of stated parameters."""

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

    ``region`` is a region, ``<region>|<region>`` or "bench"; ``kind`` is stiffness, mass, loss, geometry, coupling or
    bench. ``parameters`` are new; ``freed`` names parameters of the model whose priors it removes. ``admissible``
    bounds its parameters, with the source. ``terms`` and ``values`` are by name of the state.
    """

    name: str
    region: str
    kind: str
    about: str
    parameters: tuple[Parameter, ...] = ()
    freed: tuple[str, ...] = ()
    admissible: Mapping[str, Admissible] = field(default_factory=dict)
    terms: Mapping[str, tuple[Term, ...]] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, complex]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all its free parameters."""
        return (*(p.name for p in self.parameters), *self.freed)

    @property
    def rims(self) -> tuple[str, ...]:
        """Names of the widths of annuli among its parameters."""
        return tuple(dict.fromkeys(term.annulus.number for terms in self.terms.values() for term in terms
                                   if isinstance(term, AnnulusTerm)))

    def with_rings(self, widths: Mapping[str, float]) -> Effect:
        """A copy with meshes refined about annuli of given `widths`, by name."""
        def own(term: Any) -> Term:
            known = isinstance(term, AnnulusTerm) and term.annulus.number in widths
            return replace(term, annulus=term.annulus.about(widths[term.annulus.number])) if known else term

        return replace(self, terms={state: tuple(map(own, terms)) for state, terms in self.terms.items()})


@dataclass(frozen=True, eq=False)
class Device:
    """The states, priors and materials that the catalogue uses."""

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
        """The materials of the registry that a name without a source identifies."""
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
        """States with a liquid in the cavity."""
        return tuple(s for s in self.states if s.fluid is not None and is_liquid(s.fluid))

    def materials(self) -> dict[str, tuple[Material, tuple[str, ...]]]:
        """Every material by name, and its regions in all states."""
        found: dict[str, tuple[Material, tuple[str, ...]]] = {}
        for state in self.states:
            for region, material in state.materials.items():
                _, regions = found.get(material.name, (material, ()))
                found[material.name] = (material, tuple(dict.fromkeys((*regions, region))))
        return found


def is_liquid(material: Material | None) -> bool:
    return isinstance(material, Fluid) and material.density > 100.0


def is_polymer(material: Material | None) -> bool:
    """Whether it is a solid with a shear modulus below 10 GPa."""
    return isinstance(material, IsotropicSolid) and abs(material.shear_modulus) <= 1e10


def filled_with(state: DeviceState, material: str) -> list[str]:
    """The regions of that material in a state."""
    return [region for region, found in state.materials.items() if found.name == material]


def neighbours(state: DeviceState, region: str) -> tuple[str, str]:
    """The layers below and above a layer, "" for none."""
    order = ["", *(layer.region for layer in state.chip.layers), ""]
    at = order.index(region)
    return order[at - 1], order[at + 1]


def with_terms(
    label: str, region: str, kind: str, about: str, states: Sequence[DeviceState],
    terms: Callable[[DeviceState], Iterable[Term]],
    values: Callable[[DeviceState], Mapping[str, complex]] = lambda _: {},
    *, free: tuple[FreeParameter, ...] | None = None,
) -> Effect:
    """The hypothesis that adds `terms` to `states`, at neutral values.

    `values` are further constants of the terms in a state; lengths of the chip and its drive are found here. `free`
    replaces the free parameters that the terms declare. States without a term are left out.
    """
    by_state = {state.name: made for state in states if (made := tuple(terms(state)))}
    numbers = {each.name: each for made in by_state.values() for term in made for each in term.free()}
    if free is not None:
        numbers = {each.name: each for each in free}
    own = {state.name: {
        **{each.name: each.neutral for each in numbers.values() if not each.name.endswith(LOSS)},
        **{name: value for term in by_state[state.name] for name, value in term.fixed().items()},
        **_stated(state, by_state[state.name]), **values(state)} for state in states if state.name in by_state}
    return Effect(label, region, kind, about, tuple(as_parameter(each) for each in numbers.values()),
                  admissible={name: each.admissible for name, each in numbers.items()}, terms=by_state, values=own)


def _stated(state: DeviceState, terms: Iterable[Term]) -> dict[str, float]:
    """The lengths (m) and the squared drive (V^2) of a state."""
    known = {name: length.value for name, length in state.chip.dimensions().items()}
    if state.drive is not None:
        known[DRIVE_SQUARED] = state.drive**2
    needed = {name for term in terms for integral in term.integrals() for name in integral.coefficient.parameters}
    return {name: value for name, value in known.items() if name in needed}


def as_parameter(free: FreeParameter) -> Parameter:
    """A parameter without a prior, within its admissible range."""
    limit, start = free.admissible, free.neutral
    return Parameter(free.name, start, min(limit.lowest, start), max(limit.highest, start), None, limit.unit)


def mistaken(name: str, value: float, share: float) -> dict[str, Admissible]:
    """The admissible range of a `value` (SI) within a relative error `share`."""
    return {name: Admissible((1.0 - share) * value, (1.0 + share) * value, ParameterName.parse(name).unit,
                             f"within {100 * share:g} % of the stated value: a mistake that goes unnoticed")}


def other_than_stated(
    device: Device, label: str, region: str, kind: str, about: str, limits: Mapping[str, Admissible], *,
    relative: bool = False,
) -> Effect:
    """The hypothesis that parameters of the model differ from their stated values."""
    parameters = []
    for name, limit in limits.items():
        start = 1.0 if relative else float(min(max(stated_number(name, device.states), limit.lowest), limit.highest))
        if name not in device.known:
            parameters.append(Parameter(name, start, limit.lowest, limit.highest, None, limit.unit, relative=relative))
    return Effect(label, region, kind, about, tuple(parameters), tuple(n for n in limits if n in device.known), limits)
