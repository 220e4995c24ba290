"""Growing models in a process of their own, so that neither page nor answers ever wait for them.

What comes over is all that answering needs: the model with what no number moves summed up, a tenth of the whole.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from geometry.chip import Chip
from materials.registry import Registry
from workbench.discretisation import Discretisation
from workbench.operators import assemble
from workbench.problem import build, fill
from workbench.ranges import NotCovered, RangeModel, Ranges, fingerprint, growing_model, with_ranges

#: How much such a process stands back for others, in the steps of ``nice``: the page is answered first.
_NICE = 10


@dataclass(frozen=True)
class Wanted:
    """What a model is made of: see `workbench.ranges.range_model`."""

    chip: Chip
    state: str
    ranges: Ranges
    registry: Registry
    band: tuple[float, float]
    points: int
    tolerance: float
    accuracy: float | Discretisation


#: What makes growing models of what is wanted; closing it ends the work.
Growing = Callable[[Wanted], Generator[RangeModel, None, None]]


def growing_here(wanted: Wanted) -> Generator[RangeModel, None, None]:
    """Growing models, made by whoever asks for the next one.

    Raises:
        InputError, NotCovered: as of `workbench.ranges.growing_model`.
    """
    yield from growing_model(
        wanted.chip, wanted.state, wanted.ranges, registry=wanted.registry, band=wanted.band, points=wanted.points,
        tolerance=wanted.tolerance, accuracy=wanted.accuracy)


def growing_elsewhere(wanted: Wanted) -> Generator[RangeModel, None, None]:
    """The same, made by another process, which is ended with this iterator. The models cannot grow here.

    Raises:
        InputError, NotCovered: as of `workbench.ranges.growing_model`.
        RuntimeError: the process ended without a word.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_grow, args=(there, wanted), daemon=True)
    process.start()
    there.close()
    try:
        plain = build(fill(wanted.chip, wanted.state, wanted.registry), band=wanted.band, accuracy=wanted.accuracy)
        problem, _ = with_ranges(plain, wanted.chip, wanted.ranges)
        operators, known = assemble(problem.mesh, problem.terms), fingerprint(problem)
        while True:
            try:
                found = here.recv()
            except EOFError:
                raise RuntimeError("the process that makes the model ended without a word") from None
            if found is None:
                return
            if isinstance(found, Exception):
                raise found
            model, of = found
            if of != known:
                raise RuntimeError("the process that makes the model has another mesh of the chip")
            yield replace(model, problem=problem, reduced=replace(model.reduced, full=operators))
    finally:
        process.terminate()
        process.join()
        here.close()


def _grow(there: Connection, wanted: Wanted) -> None:
    """What the process does: send every model with the fingerprint of its problem, and None or an error at the end."""
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    try:
        last: Any = None
        for model in growing_here(wanted):
            there.send((_sendable(model), fingerprint(model.problem)))
    except NotCovered as reached:
        last = NotCovered(_sendable(reached.model))
    except Exception as error:
        # Whatever it is, it is for who asked.
        last = error
    with contextlib.suppress(BrokenPipeError):
        there.send(last)


def _sendable(model: RangeModel) -> RangeModel:
    """`model` as it answers, without the full operators and the problem, which the receiver has."""
    nothing: Any = None
    return replace(model, problem=nothing, reduced=replace(model.compact, full=nothing))
