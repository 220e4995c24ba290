"""History of the values for undo and redo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Numbers = Mapping[str, float]


@dataclass(frozen=True)
class History:
    """The ``present`` values by name, with the ``past`` and ``future``. ``past`` is oldest first, ``future`` next
    first."""

    present: Numbers
    past: tuple[Numbers, ...] = ()
    future: tuple[Numbers, ...] = ()

    def then(self, numbers: Numbers) -> History:
        """The history after `numbers` were set, without a future. It is unchanged if they are the present ones."""
        if dict(numbers) == dict(self.present):
            return self
        return History(dict(numbers), (*self.past, self.present))

    def undone(self) -> History:
        """One step back, if there is one."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (self.present, *self.future))

    def redone(self) -> History:
        """One step forward, if there is one."""
        if not self.future:
            return self
        return History(self.future[0], (*self.past, self.present), self.future[1:])
