"""One definition of "the same optimum", for the ends of descents.

Two points are one optimum where every parameter agrees within :data:`ERRORS` of its standard errors, or within
:data:`SHARE` of its scale, whichever is more. Standard errors are those of the problem that the ends are optima of: its
data as they weigh there, and its priors. A direction without information ends anywhere along it. The scale is the prior
of a parameter, or the range of an unknown of a design.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
End = TypeVar("End")

#: Standard errors that ends of one optimum differ by at most. In the campaigns of the tests most ends that were taken
#: as one optimum are within 0.9, some are up to 3 apart. With twice as many, the optima of a film of gel, 8 % apart
#: where an error is 1 %, are nearly one.
ERRORS = 3.0

#: Share of its scale that a parameter differs by at most. It serves where nothing says how well the data determine it,
#: or far better than a descent goes. Ends of one optimum are within 1e-4 of the priors of a disc and 9e-4 of the ranges
#: of a design; with twice the share nothing known changes.
SHARE = 0.05

#: Information about a direction, relative to that about the one seen best, below which nothing is known of it.
UNSEEN = 1e-12


def separation(one: Real, other: Real, errors: Real, scale: Real | float) -> Real:
    """The distances (p,) of two points over those within one optimum.

    `errors` (p,) are standard errors, and `scale` (p,) is the prior or range; both are zero if there is none. A
    parameter that cannot move is at no distance.
    """
    most = np.maximum(ERRORS * errors, SHARE * np.asarray(scale))
    off = np.abs(one - other)
    return np.divide(off, most, out=np.where(off > 0.0, np.inf, 0.0), where=most > 0.0)


def is_same_optimum(one: Real, other: Real, errors: Real, scale: Real | float) -> bool:
    """Whether two points (p,) are one optimum; arguments as of :func:`separation`."""
    return bool((separation(one, other, errors, scale) <= 1.0).all())


def standard_errors(jacobian: Real, scale: Real) -> Real:
    """Standard errors (p,) of least squares by its `jacobian` (m, p).

    Rows of priors are included. Units are `scale` (p,) > 0: in SI the columns span forty orders of magnitude.
    """
    by_scale = jacobian * scale
    information, directions = np.linalg.eigh(by_scale.T @ by_scale)
    information = np.maximum(information, UNSEEN * information.max(initial=np.finfo(float).tiny))
    return np.asarray(scale * np.linalg.norm(directions / np.sqrt(information), axis=1))


def distinct(ends: Iterable[End], is_same: Callable[[End, End], bool], rank: Callable[[End], Any]) -> list[list[End]]:
    """The `ends` of each optimum, and the optima, both best first.

    `rank` sorts ends, least first; `is_same` compares an end with the best one of an optimum.
    """
    optima: list[list[End]] = []
    for end in sorted(ends, key=rank):
        optimum = next((each for each in optima if is_same(end, each[0])), None)
        if optimum is None:
            optima.append(optimum := [])
        optimum.append(end)
    return optima
