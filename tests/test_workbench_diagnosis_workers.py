"""Workers of a search, on sums."""

from __future__ import annotations

import os
from typing import Any

import pytest

from workbench.diagnosis.workers import Task, Workers


class Adder:
    """Adds what it was made with."""

    def __init__(self, number: int) -> None:
        self.number = number

    def add(self, other: int) -> tuple[int, int]:
        return self.number + other, os.getpid()

    def refuse(self, text: str) -> None:
        raise ValueError(text)

    def vanish(self) -> None:
        os._exit(3)


def mapped(workers: Workers, tasks: list[Task], **given: Any) -> dict[int, Any]:
    results: dict[int, Any] = {}
    workers.map(Adder(10), tasks, results, **given)
    return results


def test_the_tasks_are_shared() -> None:
    with Workers(1, Adder, (10,)) as workers:
        found = mapped(workers, [("add", (k,)) for k in range(40)])
    assert {index: each[0] for index, each in found.items()} == {k: 10 + k for k in range(40)}
    assert {each[1] for each in found.values()} >= {os.getpid()}


def test_what_is_over_is_not_begun() -> None:
    with Workers(1, Adder, (10,)) as workers:
        found = mapped(workers, [("add", (k,)) for k in range(10)], is_over=lambda index: index >= 4)
    assert sorted(found) == [0, 1, 2, 3]


def test_what_a_worker_raises_is_raised_here() -> None:
    with Workers(1, Adder, (0,)) as workers, pytest.raises(ValueError, match="no such sum"):
        mapped(workers, [("refuse", ("no such sum",))])


def test_a_worker_that_ends_is_told() -> None:
    with Workers(1, Adder, (0,)) as workers, pytest.raises(RuntimeError, match="ended without a result"):
        mapped(workers, [("vanish", ())])
