"""Checks of the project's version, the machine, and the folders."""

from __future__ import annotations

import math
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import workbench
from workbench.files.output import ROOM
from workbench.files.writing import REMEDIES
from workbench.installation.check import Defect, in_own_process
from workbench.jobs.memory import GROUPS, ONE_THREAD, free_memory, shown_memory

#: The checkout, or the folder of installed packages.
ROOT = Path(workbench.__file__).parent.parent

#: Free bytes that a command needs beside its model, without and with pictures (`docs/model.md`). Doubled, machines with
#: enough memory get a fault, or a warning.
LEAST_MEMORY, PICTURES_MEMORY = 0.7e9, 2e9

#: Beginnings of the names of environment variables that change how the workbench runs.
VARIABLES = ("DISPLAY", "MALLOC_", "MPL", "PYTHONPATH", "VTK_", "WORKBENCH_", "XDG_CACHE_HOME", "XDG_DATA_HOME",
             *ONE_THREAD)


def version() -> str:
    """The version of the project, and the commit of a checkout."""
    commit = ""
    if (ROOT / ".git").exists():
        with suppress(OSError):  # git may be missing
            commit = subprocess.run(["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"],
                                    capture_output=True, text=True, check=False).stdout.strip()
    return f"{workbench.__version__}, commit {commit or 'unknown'}"


def system() -> str:
    """Python, the operating system, and the number of processors."""
    return (f"Python {platform.python_version()}, {platform.platform()}, {processors()} of {os.cpu_count()} processors "
            "for this process")


def environment() -> str:
    """The environment variables of :data:`VARIABLES`."""
    found = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith(VARIABLES)]
    return " ".join(found) or "no variable of the workbench or its libraries"


def processors() -> int:
    """The number of processors by affinity and control group."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with suppress(OSError, ValueError):  # without a limit, the quota is "max"
        quota, period = (GROUPS / "cpu.max").read_text(encoding="ascii").split()
        count = min(count, math.ceil(int(quota) / int(period)))
    return count


def memory() -> str:
    """The free memory by its tightest limit. A Defect if it is too small for a command, or for pictures."""
    room, every = free_memory(), float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    words = f"{shown_memory(room.size)}, {room.limit}; {shown_memory(every)} in the machine"
    advice = "end other programs, or raise the limit of the container, the batch job or ulimit -v"
    if room.size < LEAST_MEMORY:
        raise Defect(f"{words}; a command needs {shown_memory(LEAST_MEMORY)} beside its model", advice)
    if room.size < PICTURES_MEMORY:
        raise Defect(f"{words}; pictures need {shown_memory(PICTURES_MEMORY)}", advice, "warning")
    return words


def linear_algebra() -> str:
    """The libraries of linear algebra with their threads. A Defect if there are too many."""
    words = in_own_process(
        "import scipy.linalg; from threadpoolctl import threadpool_info; print(', '.join("
        "'{internal_api} {version}, threads: {num_threads}'.format(**each) for each in threadpool_info()))",
        "run ./setup")
    count = processors()
    wrong = [f"{name}={value}" for name in ONE_THREAD if (value := os.environ.get(name)) is not None
             and not (value.isdigit() and 1 <= int(value) <= count)]
    # A library does not know the limit of a control group.
    if wrong or any(int(number) > count for number in re.findall(r"threads: (\d+)", words)):
        names = [each.partition("=")[0] for each in wrong] or [*ONE_THREAD]
        raise Defect(", ".join([words, *wrong]) + f" on {count} processors", f"set {', '.join(names)} to 1", "warning")
    return words


def folder(find: Callable[[], Path], otherwise: str) -> str:
    """A folder, and the free space on its disk. Its nearest parent is checked if it does not exist.

    A Defect if it cannot be written to or has less than :data:`ROOM`; its remedy ends with `otherwise`.
    """
    path = find()
    there = next(each for each in (path, *path.parents) if os.path.exists(each))
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(b"workbench")
        free = shutil.disk_usage(there).free
    except OSError as error:
        advice = REMEDIES.get(error.errno or 0, "choose another folder")
        raise Defect(f"{path} cannot be written to: {error.strerror}", f"{advice}, or {otherwise}") from None
    if free < ROOM:
        raise Defect(f"{path}: its disk has {shown_memory(free)} free; a command needs {shown_memory(ROOM)}",
                      f"make room on the disk, or {otherwise}")
    return f"{path} can be written to, {shown_memory(free)} free"


def data_folder() -> Path:
    """The folder of the user's materials."""
    from materials.registry import user_folder

    return user_folder()


def cache_folder() -> Path:
    """The folder in which matplotlib stores its list of fonts."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("MPLCONFIGDIR") or Path(cache) / "matplotlib")
