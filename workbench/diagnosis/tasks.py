"""Tasks of a search for any process, and errors of one task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MethodType
from typing import Any, cast

import numpy as np

from workbench.diagnosis.evidence import WrongEvidence
from workbench.fitting.search import NO_END

#: Errors that end one hypothesis: nothing can be predicted or is admissible there, a matrix is singular, or the
#: evidence is invalid. Any other error is a defect of the program, and ends the search.
EXPECTED: tuple[type[Exception], ...] = (*NO_END, np.linalg.LinAlgError, ArithmeticError)


@dataclass(frozen=True)
class Refusal:
    """The expected error that ended a task, in place of its result."""

    error: Exception

    @property
    def reason(self) -> str:
        text = str(self.error).rstrip(".") or type(self.error).__name__
        return f"its evidence could not be computed: {text}" if isinstance(self.error, WrongEvidence) else text


@dataclass(frozen=True, eq=False)
class SearchTask:
    """A piece of a search: ``name``, ``method`` of searches, and ``arguments``."""

    name: str
    method: Callable[..., Any]
    arguments: tuple[Any, ...]

    @classmethod
    def of(cls, name: str, method: Callable[..., Any], *arguments: Any) -> SearchTask:
        """The task that calls a bound `method` on any search."""
        return cls(name, cast(MethodType, method).__func__, arguments)

    def __call__(self, search: Any) -> Any:
        """The result of the task on a search, or the refusal."""
        return search.attempt(self)
