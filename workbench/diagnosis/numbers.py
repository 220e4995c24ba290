"""The numbers of a device by the names that parameters have: their units, their stated values, the states with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from geometry.dimension import SAME_LENGTH
from geometry.stretch import tied
from materials.kinds import Fluid
from materials.versions import split_version
from workbench.diagnosis.state import DeviceState
from workbench.model.numbers import BENCH, BENCH_ELEMENTS, ParameterKind, ParameterName

#: Relative difference from which on two stated values are two numbers: far above rounding.
SAME_NUMBER = 1e-9


def unit_of(name: str, states: Sequence[DeviceState]) -> str:
    """SI unit of a parameter; empty if there is no such parameter."""
    parsed = ParameterName.parse(name)
    if parsed.is_bench:
        return parsed.unit
    if parsed.is_dimension:
        return parsed.unit if any(parsed.shared in s.chip.dimensions() for s in states) else ""
    materials = [m for s in states for m in s.materials.values()]
    if any(m.name == parsed.owner and parsed.coefficient in m.parameters() for m in materials):
        return parsed.unit
    return ""


def stated_number(name: str, states: Sequence[DeviceState]) -> float:
    """The value that the chip files and materials give a parameter, SI; zero for a bench element."""
    parsed = ParameterName.parse(name)
    for state in states:
        known = state.chip.dimensions()
        if parsed.shared in known:
            return known[parsed.shared].value
        for found in state.materials.values():
            if found.name == parsed.owner:
                return parsed.part_of(found.parameters()[parsed.coefficient])
    return 0.0


def names(states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Every name that a parameter of the device may have."""
    found = [*(BENCH + key for key in BENCH_ELEMENTS)]
    for state in states:
        found += state.chip.dimensions()
        for material in state.materials.values():
            found += [f"{material.name}.{key}" for key in material.parameters()]
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True, eq=False)
class DeviceNumbers:
    """The numbers of all ``states`` of one device; radii that coincide are one, under the first of their names."""

    states: tuple[DeviceState, ...]

    @cached_property
    def first(self) -> Mapping[str, str]:
        """The name that every radius goes by."""
        return tied(*(state.chip for state in self.states))

    def named(self, written: str) -> str:
        """The name of the number that was `written` perhaps without its material's source, without the version of a
        saved material, or of one of tied radii."""
        parsed = ParameterName.parse(written)
        full = {m.name for s in self.states for m in s.materials.values()
                if parsed.owner in (m.name.split("/")[0], (split_version(m.name) or ("",))[0])}
        name = f"{full.pop()}.{parsed.local}" if len(full) == 1 else written
        return self.first.get(name, name)

    def together(self, name: str) -> tuple[str, ...]:
        """The names of what is one number under that `name`."""
        return (name, *(other for other, chosen in self.first.items() if chosen == name and other != name))

    def having(self, name: str) -> tuple[DeviceState, ...]:
        """The states that have the number."""
        return tuple(s for s in self.states if any(unit_of(each, [s]) for each in self.together(name)))

    def value(self, name: str, state: DeviceState) -> float:
        """What the files of a `state` that has it state of the number, SI; zero for a bench element."""
        return stated_number(next(each for each in self.together(name) if unit_of(each, [state])), [state])

    def is_one(self, name: str) -> bool:
        """Whether it is the same number in all states that have it: a fluid at two temperatures differs by a factor,
        but the gel below a sample and that below a chip may be two layers."""
        having = self.having(name)
        owner = ParameterName.parse(name).owner
        if any(isinstance(m, Fluid) and m.name == owner for s in having for m in s.materials.values()):
            return True
        values = [self.value(name, state) for state in having]
        rounding = SAME_LENGTH if ParameterName.parse(name).kind is ParameterKind.DIMENSION else 0.0
        return max(values) - min(values) <= rounding + SAME_NUMBER * max(map(abs, values))
