"""Scripts that draw a layer: the only content of a chip file that is executed.

A chip file that names a script is a program. So reading one warns of the script, by path and digest, before it runs;
the script lies beside the chip file or below; the environment variable :data:`NO_SCRIPTS` refuses all scripts; and only
the content that was there when the chip file was read runs.
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
    """A chip file names a script, which runs when the chip is built."""


@dataclass(frozen=True)
class Script:
    """A function of a Python file that draws the layer with CadQuery; ``content`` is the digest (sha256) of the file.
    """

    path: Path
    function: str
    content: str


@contextmanager
def no_scripts() -> Iterator[None]:
    """Refuse scripts while this block runs, in this process and in processes that it begins."""
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
    """Raise unless the script at `path`, called `name` in the chip file `source`, may run.

    Raises:
        InputError: `scripts` or the environment refuse it, or it does not lie beside the chip file or below.
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
    """Name a script that the chip file `source` runs, before it does."""
    warnings.warn(ScriptWarning(f"{source} runs the script {script.path} (sha256 {script.content[:12]}), a program "
                                "with all your rights; --no-scripts refuses it"), stacklevel=2)


def script_bytes(script: Script) -> bytes:
    """The content of a script, unchanged since the chip file was read.

    Raises:
        InputError: it is another one, or cannot be read.
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
    """The result of a script's function for some sizes (m, rad), which it gets in millimetres and degrees.

    Raises:
        InputError: the script has changed since its chip file was read, does not run, has no such function, or the
            function asks for an unknown size, or not for one of those that its profile has `stated`.
    """
    data = script_bytes(script)
    scope: dict[str, Any] = {"__name__": script.path.stem, "__file__": str(script.path)}
    try:
        exec(compile(data, str(script.path), "exec"), scope)
    except (Exception, SystemExit) as error:
        raise InputError(str(script.path), _line(error, script.path, "script"), _said(error),
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
        raise InputError(str(script.path), _line(error, script.path, f"{script.function}({shown})"), _said(error),
                         "a solid") from error


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _line(error: BaseException, path: Path, what: str) -> str:
    """The line of the script that failed, with `what` was run: the last line of that file in the traceback."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    if isinstance(error, SyntaxError) and error.filename == str(path):
        lines.append(error.lineno)
    return f"line {lines[-1]}, {what}" if lines and lines[-1] is not None else what
