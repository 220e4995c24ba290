"""Work beside: tasks in processes, what they share, how they end, and what is said of it."""

from __future__ import annotations

import operator
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from workbench.jobs.process import Send, WorkerEnded, stream
from workbench.jobs.workers import Processes, Workers, begin_workers, itself

ROOT = Path(__file__).resolve().parent.parent


class Counter:
    """Counts how often it was used, by a process."""

    def __init__(self, first: int) -> None:
        self.number = first

    def next(self) -> tuple[int, int]:
        self.number += 1
        return os.getpid(), self.number


def after(seconds: float, result: object = None) -> object:
    time.sleep(seconds)
    return result


def not_made() -> None:
    raise ValueError("no such state")


@pytest.fixture(scope="module")
def two() -> Iterator[Processes]:
    with closing(Processes(2)) as workers:
        yield workers


def gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def test_results_are_those_of_the_tasks_and_in_their_order(two: Processes) -> None:
    late_first = [partial(after, 0.05 * (3 - k), k) for k in range(4)]
    for workers in (Workers(), two):
        assert workers.map(late_first) == [0, 1, 2, 3]
    with ThreadPoolExecutor(2) as pool, begin_workers(2, pool) as workers:
        assert workers.map(late_first) == [0, 1, 2, 3]
        workers.share(itself, 7)
        assert workers.map([partial(operator.add, 1)]) == [8]
    with ThreadPoolExecutor(1) as pool, begin_workers(1, pool) as workers:
        for _ in range(2):
            workers.share(Counter, 0)  # Once in the thread, and anew each time that it is shared.
            assert [number for _, number in workers.map([Counter.next] * 3)] == [1, 2, 3]
        workers.share(None)
        assert workers.map([os.getpid]) == [os.getpid()]


def test_they_come_as_they_end(two: Processes) -> None:
    found = two.completed([("late", partial(after, 0.5)), ("soon", partial(after, 0.0))])
    assert [key for key, _ in found] == ["soon", "late"]


def test_one_job_is_done_in_this_process_as_it_is_asked_for() -> None:
    with begin_workers(1) as workers:
        done: list[int] = []
        found = workers.completed((k, partial(done.append, k)) for k in range(3))
        next(found)
        assert done == [0]
        assert workers.map([os.getpid]) == [os.getpid()]


def test_what_is_shared_is_made_once_in_every_process(two: Processes) -> None:
    two.share(Counter, 10)
    found = two.map([Counter.next] * 20)
    for pid in {pid for pid, _ in found}:
        mine = [number for one, number in found if one == pid]
        assert sorted(mine) == list(range(11, 11 + len(mine)))
    assert os.getpid() not in {pid for pid, _ in found}
    two.share(None)
    assert len(two.map([os.getpid])) == 1


def test_this_process_works_too_with_a_state_of_its_own(two: Processes) -> None:
    two.share(Counter, 10)
    found = dict(two.completed(((k, Counter.next) for k in range(60)), own=Counter(100)))
    here = [done.result()[1] for done in found.values() if done.result()[0] == os.getpid()]
    assert sorted(found) == list(range(60))
    assert here == list(range(101, 101 + len(here)))
    assert here
    two.share(None)


def test_what_there_is_to_do_may_be_decided_late(two: Processes) -> None:
    ended: list[int] = []
    tasks = ((k, partial(after, 0.01)) for k in range(100) if len(ended) < 4)
    for key, _ in two.completed(tasks):
        ended.append(key)
    assert 4 <= len(ended) <= 6


@pytest.mark.parametrize("workers", ["two", "here"])
def test_what_a_task_raises_is_raised_here(two: Processes, workers: str) -> None:
    with pytest.raises(ZeroDivisionError) as error:
        (two if workers == "two" else Workers()).map([partial(operator.truediv, 1, 0)])
    assert workers == "here" or "In a worker process:" in error.value.__notes__[0]


def test_what_a_state_or_a_result_fails_by_is_said(two: Processes) -> None:
    two.share(not_made)
    with pytest.raises(ValueError, match="no such state"):
        two.map([after])
    two.share(None)
    with pytest.raises(RuntimeError, match="a worker cannot send <unlocked"):
        two.map([threading.Lock])


def test_what_is_printed_does_not_disturb() -> None:
    with closing(Processes(1)) as workers:
        assert workers.map([partial(print, "word"), partial(os.write, 1, b"word")]) == [None, 4]


def test_a_process_that_ends_is_said_and_replaced() -> None:
    with closing(Processes(1)) as workers:
        workers.share(Counter, 0)
        tasks: list[tuple[str, Callable[[Counter], object]]] = [
            ("one", Counter.next), ("dead", partial(_exit, 3)), ("two", Counter.next)]
        found = {key: done.exception() or done.result()[1] for key, done in workers.completed(tasks)}
    assert isinstance(found["dead"], WorkerEnded)
    assert str(found["dead"]) == ("a worker process ended before its work was done (status 3): it was killed, or the "
                                  "memory was not enough")
    # The second process has made the state anew.
    assert (found["one"], found["two"]) == (1, 1)


def _exit(status: int, _state: object) -> None:
    os._exit(status)


def test_a_task_that_takes_too_long_is_ended() -> None:
    began = time.monotonic()
    with begin_workers(2, seconds=3.0) as workers:
        tasks: list[tuple[str, Callable[[], object]]] = [
            ("late", partial(after, 60.0)), ("soon", os.getpid), ("next", os.getpid)]
        found = dict(workers.completed(tasks))
        with pytest.raises(WorkerEnded, match=r"no answer within 0\.05 min") as error:
            found["late"].result()
    assert 0.0 < error.value.processor < 1.0
    assert len({found["soon"].result(), found["next"].result(), os.getpid()}) == 3
    assert time.monotonic() - began < 20.0


def test_at_the_end_nothing_is_waited_for() -> None:
    began = time.monotonic()
    with closing(Processes(1)) as workers:
        (pid,) = workers.map([os.getpid])
        waiting, never = (workers.submit(partial(after, 60.0)) for _ in range(2))
        while not waiting.running():
            time.sleep(0.01)
    assert never.cancelled()
    assert time.monotonic() - began < 30.0
    assert gone(pid)
    assert isinstance(waiting.exception(), WorkerEnded)


def test_a_process_never_hears_of_ctrl_c_and_can_be_terminated() -> None:
    with closing(Processes(1)) as workers:
        (pid,) = workers.map([os.getpid])
        # A terminal interrupts its own session, to which the process does not belong from its first moment on.
        assert os.getsid(pid) == pid
        late = workers.submit(partial(after, 60.0))
        os.kill(pid, signal.SIGTERM)
        with pytest.raises(WorkerEnded, match="signal 15"):
            late.result(timeout=30.0)


# --------------------------------------------------------------------------------------------------------------------
# Several results of one task.


def count(send: Send, *, last: int, pause: float = 0.0) -> None:
    for number in range(last):
        send((number, os.getpid()))
        time.sleep(pause)


def broken(send: Send) -> None:
    send(1)
    print("what it says", file=sys.stderr)
    raise ValueError("no more")


def test_results_come_as_they_are_sent(tmp_path: Path) -> None:
    assert [number for number, _ in stream(partial(count, last=3))] == [0, 1, 2]
    words = tmp_path / "words.txt"
    found = stream(broken, words=words)
    assert next(found) == 1
    with pytest.raises(ValueError, match="no more"):
        next(found)
    assert words.read_text() == "what it says\n"
    with pytest.raises(WorkerEnded, match="status 3"):
        list(stream(partial(_exit, 3)))


def test_a_stream_ends_at_once_with_its_process() -> None:
    stopped = threading.Event()
    found = stream(partial(count, last=100, pause=60.0), stopped=stopped.is_set)
    _, pid = next(found)
    began = time.monotonic()
    threading.Timer(0.1, stopped.set).start()
    assert not list(found)
    assert time.monotonic() - began < 30.0
    assert gone(pid)
    found = stream(partial(count, last=100, pause=60.0))
    _, pid = next(found)
    found.close()
    assert gone(pid)


# --------------------------------------------------------------------------------------------------------------------
# Scripts: without a guard, interrupted, killed.

SCRIPT = f"""
import os, sys, time
from functools import partial
from pathlib import Path
sys.path.insert(0, {str(ROOT / "tests")!r})
from workbench.jobs.workers import begin_workers
from test_workbench_jobs import traced

folder = Path(sys.argv[1])
with (folder / "runs").open("a") as runs:
    runs.write("run\\n")
with begin_workers(2) as workers:
    try:
        for key, done in workers.completed((k, partial(traced, folder, k)) for k in (0, 1)):
            (folder / "finished").write_text(done.result())
    except KeyboardInterrupt:
        sys.exit(130)
"""


def traced(folder: Path, seconds: int) -> str:
    """Leaves a trace of its process and of the threads it may use, and takes a minute unless that is 0 s."""
    (folder / f"pid {seconds}").write_text(str(os.getpid()))
    time.sleep(60.0 * seconds)
    return os.environ["OPENBLAS_NUM_THREADS"]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_whatever_ends_a_script_its_processes_end_and_what_is_finished_stays(how: signal.Signals, tmp_path: Path
                                                                             ) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    process = subprocess.Popen([sys.executable, str(tmp_path / "script.py"), str(tmp_path)], stderr=subprocess.PIPE,
                               env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "7"}, text=True)
    deadline = time.monotonic() + 60.0
    while not all((tmp_path / name).exists() and (tmp_path / name).read_text() for name in ("pid 1", "finished")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(how)
    _, said = process.communicate(timeout=30.0)
    assert (process.returncode, said) == (130 if how == signal.SIGINT else -9, "")
    assert ((tmp_path / "finished").read_text(), (tmp_path / "runs").read_text()) == ("1", "run\n")
    while not gone(int((tmp_path / "pid 1").read_text())):
        assert time.monotonic() < deadline
        time.sleep(0.05)
