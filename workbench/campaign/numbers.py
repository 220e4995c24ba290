"""The numbers of a device in all its states, by name: their stated values, and the states that have them."""

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

#: Relative difference from which on two stated values are two numbers: far above rounding.
SAME_NUMBER = 1e-9


def stated_number(name: str, states: Sequence[DeviceState]) -> float:
    """The value that the chip files and materials give a parameter, SI; zero for a bench element."""
    shared = ParameterName.parse(name).shared
    return next((state.numbers[shared].value for state in states if shared in state.numbers), 0.0)


def names(states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Every name that a parameter of the device may have, losses aside."""
    return tuple(dict.fromkeys(name for state in states for name in state.numbers if not name.endswith(LOSS)))


@dataclass(frozen=True, eq=False)
class DeviceNumbers:
    """The numbers of all ``states`` of one device; radii that coincide are one, under the first of their names."""

    states: tuple[DeviceState, ...]

    @cached_property
    def first(self) -> Mapping[str, str]:
        """The name that every radius goes by."""
        return canonical_names(*(state.chip for state in self.states))

    def named(self, written: str) -> str:
        """The name of the number that was `written` perhaps without its material's source, without the version of a
        saved material, or of one of tied radii."""
        full = full_names(written, (m.name for s in self.states for m in s.materials.values()))
        name = full[0] if len(full) == 1 else written
        return self.first.get(name, name)

    def together(self, name: str) -> tuple[str, ...]:
        """All names of the number that has this `name`."""
        return (name, *(other for other, chosen in self.first.items() if chosen == name and other != name))

    def having(self, name: str) -> tuple[DeviceState, ...]:
        """The states that have the number."""
        return tuple(s for s in self.states if any(each in s.numbers for each in self.together(name)))

    def number(self, name: str, state: DeviceState | None = None) -> Number:
        """The number of that `name` as the files of a `state` that has it state it: by default, of the first one."""
        together, there = self.together(name), state or self.having(name)[0]
        found = next(there.numbers[each] for each in together if each in there.numbers)
        return replace(found, name=name, tied=together[1:])

    def is_one(self, name: str) -> bool:
        """Whether it is the same number in all states that have it: a fluid at two temperatures differs by a factor,
        but the gel below a sample and that below a chip may be two layers."""
        having = self.having(name)
        owner = ParameterName.parse(name).owner
        if any(isinstance(m, Fluid) and m.name == owner for s in having for m in s.materials.values()):
            return True
        found = [self.number(name, state) for state in having]
        values, rounding = [each.value for each in found], SAME_LENGTH if found[0].is_dimension else 0.0
        return max(values) - min(values) <= rounding + SAME_NUMBER * max(map(abs, values))
