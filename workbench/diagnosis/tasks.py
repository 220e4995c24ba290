"""Pieces of a search, which any process can do that has a search of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MethodType
from typing import Any, cast


@dataclass(frozen=True, eq=False)
class SearchTask:
    """A piece of a search: its ``name``, a ``method`` of searches, and its ``arguments``."""

    name: str
    method: Callable[..., Any]
    arguments: tuple[Any, ...]

    @classmethod
    def of(cls, name: str, method: Callable[..., Any], *arguments: Any) -> SearchTask:
        """The task that calls a bound `method` of one search on any search."""
        return cls(name, cast(MethodType, method).__func__, arguments)

    def __call__(self, search: Any) -> Any:
        """The result of the task on a search, or the refusal that ended it."""
        return search.attempt(self)
