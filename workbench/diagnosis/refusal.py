"""Errors that end one hypothesis of a search without ending the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.evidence import WrongEvidence
from workbench.fitting.search import NO_END

#: Errors that refuse a hypothesis without ending the others: nothing can be predicted or is admissible where it leads,
#: a matrix of it is singular, or its evidence is none. Anything else is a defect of the program, and ends all.
EXPECTED: tuple[type[Exception], ...] = (*NO_END, np.linalg.LinAlgError, ArithmeticError)


@dataclass(frozen=True)
class Refusal:
    """The expected error that ended a task, in place of its result."""

    error: Exception

    @property
    def reason(self) -> str:
        text = str(self.error).rstrip(".") or type(self.error).__name__
        return f"its evidence could not be computed: {text}" if isinstance(self.error, WrongEvidence) else text
