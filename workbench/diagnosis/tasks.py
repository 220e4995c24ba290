"""Pieces of a search, which any process can do that has a search of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MethodType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SearchTask:
    """A piece of a search: its ``name``, a ``method`` of searches, and the arguments it is ``given``.

    ``places`` (p,) are those that the models of the search have to reach.
    """

    name: str
    method: Callable[..., Any]
    given: tuple[Any, ...]
    places: tuple[Real, ...] = ()

    @classmethod
    def of(cls, name: str, method: Callable[..., Any], *given: Any) -> SearchTask:
        """The task that does on any search what a bound `method` does on its own."""
        return cls(name, cast(MethodType, method).__func__, given)

    def __call__(self, search: Any) -> Any:
        """The result of the task on a search, or why it has none."""
        return search.attempted(self)
