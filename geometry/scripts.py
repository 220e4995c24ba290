"""Scripts that draw a layer: the executed content of chip files.

Reading a chip file that names a script warns with its path and digest before it runs. The script must be in the folder
of the chip file or below. The environment variable :data:`NO_SCRIPTS` refuses all scripts. A script that has changed
since the chip file was read does not run.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import os
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.files.errors import InputError, choose, nearest_names

#: Environment variable that refuses all scripts, unless it is empty or "0".
NO_SCRIPTS = "WORKBENCH_NO_SCRIPTS"


class ScriptWarning(UserWarning):
    """A chip file names a script, which runs with the chip."""


@dataclass(frozen=True)
class Script:
    """A function of a Python file that draws the layer with CadQuery. ``content`` is the digest (sha256) of the
    file."""

    path: Path
    function: str
    content: str


@contextmanager
def no_scripts() -> Iterator[None]:
    """Refuse scripts in a block, in this process and its child processes."""
    before = os.environ.get(NO_SCRIPTS)
    os.environ[NO_SCRIPTS] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[NO_SCRIPTS]
        else:
            os.environ[NO_SCRIPTS] = before


def check_script(name: str, path: Path, *, source: str, field: str, scripts: bool) -> None:
    """Raise unless the script `name` at `path` may run.

    Raises:
        InputError: `scripts` or the environment refuse it, or it is outside the folder of the chip file.
    """
    if not scripts or os.environ.get(NO_SCRIPTS, "") not in ("", "0"):
        raise InputError(source, field, name, f"no script: scripts are refused (--no-scripts, {NO_SCRIPTS}=1 or "
                         "scripts=False); allow it once you have read it, or state points or a part of a STEP file")
    folder = Path(source).parent
    if not lies_below(path, folder):
        raise InputError(source, field, name, "a script beside the chip file or in a folder below it, links followed: "
                         f"copy {path.name} to {folder}")


def lies_below(path: Path, folder: Path) -> bool:
    """Whether a file lies in a folder or below it, links followed."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def warn_of(script: Script, source: str) -> None:
    """Warn that the chip file `source` runs a script."""
    warnings.warn(ScriptWarning(f"{source} runs the script {script.path} (sha256 {script.content[:12]}), a program "
                                "with all your rights; --no-scripts refuses it"), stacklevel=2)


def script_bytes(script: Script) -> bytes:
    """The content of a script.

    Raises:
        InputError: the file has changed since the chip file was read, or cannot be read.
    """
    try:
        data = script.path.read_bytes()
    except OSError as error:
        raise InputError(str(script.path), "script", script.path.name,
                         f"a readable file ({error.strerror or error})") from None
    digest = hashlib.sha256(data).hexdigest()
    if digest != script.content:
        raise InputError(str(script.path), "script", f"sha256 {digest[:12]}", f"{script.content[:12]}, the script when "
                         "the chip file was read: it has changed since, read the chip file again")
    return data


def called(script: Script, sizes: Mapping[str, float], angles: frozenset[str], stated: Sequence[str]) -> Any:
    """The result of a script's function for sizes (m, rad). The function gets millimetres and degrees.

    Raises:
        InputError: the script has changed since its chip file was read, fails, or lacks the function; the function has
            an unknown parameter, or lacks one of those `stated` in the profile.
    """
    data = script_bytes(script)
    scope: dict[str, Any] = {"__name__": script.path.stem, "__file__": str(script.path)}
    try:
        exec(compile(data, str(script.path), "exec"), scope)
    except (Exception, SystemExit) as error:
        raise InputError(str(script.path), _line(error, script.path, "script"), _error_text(error),
                         "a script that runs") from error
    functions = {name: each for name, each in scope.items() if inspect.isfunction(each)}
    function: Callable[..., Any] = functions[choose(script.function, functions, source=str(script.path),
                                                    field="function")]
    wanted = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name in sizes:
            wanted[name] = math.degrees(sizes[name]) if name in angles else 1e3 * sizes[name]
        elif parameter.default is inspect.Parameter.empty:
            choose(name, sizes, source=str(script.path), field=f"parameter of {script.function}")
    unused = sorted(set(stated) - set(wanted))
    if unused:
        raise InputError(str(script.path), f"parameters of {script.function}", ", ".join(wanted) or None,
                         f"one called {unused[0]!r}, which the chip file states", nearest_names(unused[0], wanted))
    try:
        return function(**wanted)
    except (Exception, SystemExit) as error:
        shown = ", ".join(f"{name} = {value:.6g}" for name, value in wanted.items())
        raise InputError(str(script.path), _line(error, script.path, f"{script.function}({shown})"), _error_text(error),
                         "a solid") from error


def _error_text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _line(error: BaseException, path: Path, call: str) -> str:
    """The failed line of the script, and the call."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    if isinstance(error, SyntaxError) and error.filename == str(path):
        lines.append(error.lineno)
    return f"line {lines[-1]}, {call}" if lines and lines[-1] is not None else call
