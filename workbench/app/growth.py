"""Range models that grow, in this process or in another one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any

from workbench.fem.operators import assemble
from workbench.jobs.process import Send, stream
from workbench.model.problem import build, fill
from workbench.reduced.ranges import NotCovered, RangeModel, RangeRequest, fingerprint, growing_model, with_ranges

#: A generator of growing models; closing it ends the work.
Growing = Callable[[RangeRequest], Generator[RangeModel, None, None]]


def growing_elsewhere(request: RangeRequest) -> Generator[RangeModel, None, None]:
    """Growing models from another process, which ends with this iterator.

    The models cannot grow here. They have the compact form for answers: the constant parts summed up, a tenth of the
    whole.

    Raises:
        InputError, NotCovered: as in `workbench.reduced.ranges.growing_model`.
        WorkerEnded: the process ended by itself.
    """
    plain = build(fill(request.chip, request.state, request.registry), band=request.band or request.chip.band,
                  accuracy=request.accuracy)
    problem, _ = with_ranges(plain, request.chip, request.ranges)
    operators, known = assemble(problem.mesh, problem.terms), fingerprint(problem)
    with contextlib.closing(stream(partial(_grow, request=request))) as models:
        for model, of in models:
            if of != known:
                raise RuntimeError("the process that makes the model has another mesh of the chip")
            yield replace(model, problem=problem, reduced=replace(model.reduced, full=operators))


def _grow(send: Send, *, request: RangeRequest) -> None:
    """Send every model with the fingerprint of its problem."""
    try:
        for model in growing_model(request):
            send((_sendable(model), fingerprint(model.problem)))
    except NotCovered as reached:
        raise NotCovered(_sendable(reached.model)) from None


def _sendable(model: RangeModel) -> RangeModel:
    """The compact `model` without the parts that the receiver has."""
    nothing: Any = None
    return replace(model, problem=nothing, reduced=replace(model.compact, full=nothing))
