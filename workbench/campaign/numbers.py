"""The parameters of a device by name, over all its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from geometry.dimension import SAME_LENGTH
from geometry.stretch import canonical_names
from materials.kinds import Fluid
from workbench.campaign.state import DeviceState
from workbench.model.device_numbers import full_names
from workbench.model.numbers import LOSS, Number, ParameterName

#: Relative difference above which two stated values are two parameters: far above rounding.
SAME_NUMBER = 1e-9


def stated_number(name: str, states: Sequence[DeviceState]) -> float:
    """The stated value of a parameter, SI; zero for a bench element."""
    shared = ParameterName.parse(name).shared
    return next((state.numbers[shared].value for state in states if shared in state.numbers), 0.0)


def names(states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Names of all parameters of the device, except losses."""
    return tuple(dict.fromkeys(name for state in states for name in state.numbers if not name.endswith(LOSS)))


@dataclass(frozen=True, eq=False)
class DeviceNumbers:
    """The parameters of all ``states`` of a device. Coinciding radii are one parameter, under the first of their
    names."""

    states: tuple[DeviceState, ...]

    @cached_property
    def first(self) -> Mapping[str, str]:
        """The name of the parameter of each radius."""
        return canonical_names(*(state.chip for state in self.states))

    def named(self, written: str) -> str:
        """The full name of a parameter from its name in a file. A file may omit the source of a material and the
        version of a saved material, or name any of several coinciding radii."""
        full = full_names(written, (m.name for s in self.states for m in s.materials.values()))
        name = full[0] if len(full) == 1 else written
        return self.first.get(name, name)

    def together(self, name: str) -> tuple[str, ...]:
        """All names of the parameter `name`."""
        return (name, *(other for other, chosen in self.first.items() if chosen == name and other != name))

    def having(self, name: str) -> tuple[DeviceState, ...]:
        """The states with the parameter."""
        return tuple(s for s in self.states if any(each in s.numbers for each in self.together(name)))

    def number(self, name: str, state: DeviceState | None = None) -> Number:
        """The parameter `name` in `state`; default: the first state that has it."""
        together, there = self.together(name), state or self.having(name)[0]
        found = next(there.numbers[each] for each in together if each in there.numbers)
        return replace(found, name=name, tied=together[1:])

    def is_one(self, name: str) -> bool:
        """Whether it is one parameter in all states. A fluid at two temperatures differs by a factor, which is shared;
        the gel below a sample and the gel below a chip may be two layers."""
        having = self.having(name)
        owner = ParameterName.parse(name).owner
        if any(isinstance(m, Fluid) and m.name == owner for s in having for m in s.materials.values()):
            return True
        found = [self.number(name, state) for state in having]
        values, rounding = [each.value for each in found], SAME_LENGTH if found[0].is_dimension else 0.0
        return max(values) - min(values) <= rounding + SAME_NUMBER * max(map(abs, values))
