"""The memory of this process, and the errors of a shortage.

Three limits hold at a time: the free memory of the machine, that of the control groups around the process (a container,
a batch system), and the address space of each process (``ulimit -v``, RLIMIT_AS).
"""

from __future__ import annotations

import errno
import mmap
import os
import re
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock

from workbench.jobs.interruption import ENDS, say

#: Environment variable with the bytes of the machine's memory that are for this process, one of several workers.
PROCESS_VARIABLE = "WORKBENCH_MEMORY_OF_PROCESS"

#: One thread of linear algebra: processes share the machine by their number, not by their threads.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

#: Buffers of each linear algebra library: one for each thread that calls it at a time.
BUFFERS = 3

#: Bytes of address space that must be free for a buffer (of 34 MB). Doubled, limits below 0.7 GB are refused.
BUFFER = 64e6

#: Bytes of address space that must be free to load numpy and scipy, or loading hangs. Doubled, limits below 0.9 GB are
#: refused.
LOADED = 420e6

#: Files of a memory control group, of version 2 and 1: limits, memory in use, the key of its reclaimable part in
#: `memory.stat`.
GROUP_FILES = (
    (("memory.max", "memory.high"), "memory.current", "inactive_file"),
    (("memory.limit_in_bytes",), "memory.usage_in_bytes", "total_inactive_file"),
)

#: Words by which libraries report that an allocation failed, where their exception is no MemoryError.
FAILED = re.compile(r"malloc|bad_alloc|bad allocation|out of ?memory|not enough memory|cannot allocate memory"
                    r"|can't start new thread|failed to map segment", re.IGNORECASE)

#: Bytes of address space below which it is nearly used up. Doubled, a defect of the program is more often taken for a
#: lack of memory under a limit.
EXHAUSTED = 100e6

#: Characters of the reason of a failure that are shown, its last ones. Doubled, the advice of numpy is shown too.
SHOWN = 200

#: Option of the system's call `prctl`: the signal that a process gets when its parent ends.
PR_SET_PDEATHSIG = 1

#: Folders in which the system shows its processes and its control groups.
PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")

#: Locked while the limit of the address space is another one.
_CONFINED = Lock()


@dataclass(frozen=True)
class Room:
    """Free memory in bytes, and the ``limit`` behind it in words."""

    size: float
    limit: str


def address_limit() -> float | None:
    """The limit of this process' address space (bytes), None without one."""
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else float(soft)


def free_memory() -> Room:
    """The free memory of this process, by its tightest limit."""
    rooms, limit = [*_shared()], address_limit()
    if limit is not None:
        rooms.append(Room(max(limit - _mapped(), 0.0), f"the rest of the {shown_memory(limit)} of address space "
                          "that ulimit -v allows a process"))
    return min(rooms, key=lambda room: room.size)


def shared_memory() -> float:
    """Bytes that are free for all processes together."""
    return min(room.size for room in _shared())


def _shared() -> Iterator[Room]:
    """The share of a worker; or machine and control groups."""
    if (stated := os.environ.get(PROCESS_VARIABLE)) is not None:
        yield Room(float(stated), "a process' share of the memory that is free here, less with more --jobs")
        return
    free = _number_in(PROC / "meminfo", "MemAvailable:")
    # Without /proc it is all the memory of the machine.
    every = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    yield Room(every if free is None else 1024.0 * free, "the memory that is free here")
    for folder in _groups():
        for limits, used, reclaimed in GROUP_FILES:
            taken = _number_in(folder / used)
            most = min((size for name in limits if (size := _number_in(folder / name)) is not None), default=None)
            if most is not None and taken is not None:
                # The system takes back files that it keeps in memory for as long as nobody needs it.
                back = _number_in(folder / "memory.stat", reclaimed) or 0.0
                yield Room(max(most - max(taken - back, 0.0), 0.0), "the memory that is free in this control "
                           f"group (cgroup), which may take {shown_memory(most)}")


def _groups() -> list[Path]:
    """Folders of the memory control groups around this process."""
    own = [("", "/"), ("memory", "/")]  # A container may show the path that only its host knows.
    with suppress(OSError):
        for line in (PROC / "self" / "cgroup").read_text(encoding="utf-8").splitlines():
            number, kinds, path = line.split(":", 2)
            if number == "0" or "memory" in kinds.split(","):
                own.append(("" if number == "0" else "memory", path))
    return list(dict.fromkeys(GROUPS / kind / at for kind, path in own
                              for at in (Path(path.lstrip("/")), *Path(path.lstrip("/")).parents)))


def _number_in(path: Path, key: str = "") -> float | None:
    """The first number of a file, or after a `key`; else None."""
    with suppress(OSError, ValueError, LookupError):
        text = path.read_text(encoding="ascii")
        if key:
            text = dict(line.split(maxsplit=1) for line in text.splitlines())[key]
        return float(text.split()[0])
    return None


def _mapped() -> float:
    """Bytes of address space that this process takes."""
    return (_number_in(PROC / "self" / "statm") or 0.0) * mmap.PAGESIZE


@cache
def reserve_buffers() -> None:
    """Allocate the buffers of linear algebra in a limited address space.

    A library that is called first when the memory is used up would try forever (OpenBLAS 0.3.30).

    Raises:
        MemoryError: there is no room for them.
    """
    if address_limit() is None:
        return
    if "scipy.linalg" not in sys.modules:
        require(LOADED, "the libraries that every command loads")
    for name, number in ONE_THREAD.items():
        os.environ.setdefault(name, number)  # heard when the libraries are loaded
    import ctypes

    import scipy.linalg  # noqa: F401 - loads its library, and that of numpy
    from threadpoolctl import ThreadpoolController

    for library in ThreadpoolController().lib_controllers:
        if not hasattr(library.dynlib, "blas_memory_alloc"):  # as OpenBLAS has
            continue
        take, give = library.dynlib.blas_memory_alloc, library.dynlib.blas_memory_free
        take.restype, taken = ctypes.c_void_p, []
        for _ in range(BUFFERS):
            require(BUFFER, f"the buffers of {Path(library.filepath).name}")
            taken.append(ctypes.c_void_p(take(0)))
        for buffer in taken:
            give(buffer)


def require(size: float, user: str) -> None:
    """Raise MemoryError if a limited address space lacks bytes for a `user`."""
    if address_limit() is None:
        return
    try:
        mmap.mmap(-1, int(size)).close()
    except OSError:
        raise MemoryError(f"{shown_memory(size)} of address space were not there for {user}") from None


@contextmanager
def confined(size: float) -> Iterator[None]:
    """Further limit the limited address space to so many bytes more."""
    if address_limit() is None:
        yield
        return
    with _CONFINED:
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (min(soft, int(_mapped() + size)), hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def is_shortage(error: BaseException) -> bool:
    """Whether an error comes of a shortage of memory or threads."""
    return _behind(error) is not None


def is_exhausted() -> bool:
    """Whether the limited address space is nearly used up."""
    limit = address_limit()
    return limit is not None and limit - _mapped() < EXHAUSTED


def _behind(error: BaseException) -> BaseException | None:
    """The error of an allocation among an error and its causes."""
    # gmsh raises nothing more special than Exception.
    worded = isinstance(error, RuntimeError | ImportError | OSError) or type(error) is Exception
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM) or (
            worded and FAILED.search(str(error))):
        return error
    return None if error.__cause__ is None else _behind(error.__cause__)


def shortage_text(error: BaseException, needed: str = "") -> str:
    """One line on a shortage of memory: reason, limit, remedy.

    `needed` are words on the memory that the job needs.
    """
    reason = str(_behind(error) or error) or "an allocation failed"
    limit, room = address_limit(), free_memory()
    where = (f"{shown_memory(room.size)} are free" if limit is None else
             f"ulimit -v allows a process {shown_memory(limit)} of address space")
    return (f"memory was not enough: {' '.join(reason.split())[-SHOWN:]}{needed}; {where}. Fewer "
            "--jobs, a coarser --accuracy or a narrower band take less; otherwise give it more")


def supervised() -> int | None:
    """Fork: None in the child, its exit status in the parent.

    A library without memory may end its process (VTK, LLVM: SIGABRT, SIGSEGV). The parent then writes one line.
    """
    child = os.fork()
    if child == 0:
        if sys.platform == "linux":
            import ctypes

            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        return None
    for end in ENDS:
        if signal.getsignal(end) is not signal.SIG_IGN:
            signal.signal(end, lambda number, _frame: os.kill(child, number))
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status >= 0:
        return status
    say(shortage_text(MemoryError(f"signal {-status} ended the command, which most often is a library without memory")))
    return 1


def shown_memory(size: float) -> str:
    """Bytes as text for messages."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size / 1e6:.3g} MB"
