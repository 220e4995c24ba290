"""Workers of a search, on sums."""

from __future__ import annotations

import os

import pytest

from workbench.diagnosis.workers import Workers


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


def test_the_tasks_are_shared_and_come_back_in_order() -> None:
    told: list[int] = []
    with Workers(1, Adder, (10,)) as workers:
        found = workers.map(Adder(10), [("add", (k,)) for k in range(40)], told.append)
    assert [each[0] for each in found] == [10 + k for k in range(40)]
    assert sorted(told) == list(range(40))
    assert {each[1] for each in found} >= {os.getpid()}


def test_what_a_worker_raises_is_raised_here() -> None:
    with Workers(1, Adder, (0,)) as workers, pytest.raises(ValueError, match="no such sum"):
        workers.map(Adder(0), [("refuse", ("no such sum",))])


def test_a_worker_that_ends_is_told() -> None:
    with Workers(1, Adder, (0,)) as workers, pytest.raises(RuntimeError, match="ended without a result"):
        workers.map(Adder(0), [("vanish", ())])
