"""Range models that grow, in this process or in another one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from geometry.chip import Chip
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.jobs.process import Send, stream
from workbench.model.discretisation import Discretisation
from workbench.model.problem import build, fill
from workbench.reduced.ranges import LIMIT, NotCovered, RangeModel, Ranges, fingerprint, growing_model, with_ranges


@dataclass(frozen=True)
class Wanted:
    """The input of a model: see `workbench.reduced.ranges.range_model`."""

    chip: Chip
    state: str
    ranges: Ranges
    registry: Registry
    band: tuple[float, float]
    points: int
    tolerance: float
    accuracy: float | Discretisation
    limit: int = LIMIT


#: A generator of growing models; closing it ends the work.
Growing = Callable[[Wanted], Generator[RangeModel, None, None]]


def growing_here(wanted: Wanted) -> Generator[RangeModel, None, None]:
    """Growing models, each computed on request.

    Raises:
        InputError, NotCovered: as in `workbench.reduced.ranges.growing_model`.
    """
    yield from growing_model(
        wanted.chip, wanted.state, wanted.ranges, registry=wanted.registry, band=wanted.band, points=wanted.points,
        relative_error=wanted.tolerance, limit=wanted.limit, accuracy=wanted.accuracy)


def growing_elsewhere(wanted: Wanted) -> Generator[RangeModel, None, None]:
    """Growing models from another process, which ends with this iterator.

    The models cannot grow here. They have the compact form for answers: the constant parts summed up, a tenth of the
    whole.

    Raises:
        InputError, NotCovered: as in `workbench.reduced.ranges.growing_model`.
        WorkerEnded: the process ended by itself.
    """
    plain = build(fill(wanted.chip, wanted.state, wanted.registry), band=wanted.band, accuracy=wanted.accuracy)
    problem, _ = with_ranges(plain, wanted.chip, wanted.ranges)
    operators, known = assemble(problem.mesh, problem.terms), fingerprint(problem)
    with contextlib.closing(stream(partial(_grow, wanted=wanted))) as models:
        for model, of in models:
            if of != known:
                raise RuntimeError("the process that makes the model has another mesh of the chip")
            yield replace(model, problem=problem, reduced=replace(model.reduced, full=operators))


def _grow(send: Send, *, wanted: Wanted) -> None:
    """Send every model with the fingerprint of its problem."""
    try:
        for model in growing_here(wanted):
            send((_sendable(model), fingerprint(model.problem)))
    except NotCovered as reached:
        raise NotCovered(_sendable(reached.model)) from None


def _sendable(model: RangeModel) -> RangeModel:
    """The compact `model` without the parts that the receiver has."""
    nothing: Any = None
    return replace(model, problem=nothing, reduced=replace(model.compact, full=nothing))
