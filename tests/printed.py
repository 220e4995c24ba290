"""Programs and commands that pages of the documentation print."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
#: The first line of a block that needs the one before it.
GOES_ON = "# goes on"
#: Fields that say where a value comes from.
ORIGIN = {"file", "source", "origin", "path", "material_folders"}


def blocks(language: str) -> Iterator[tuple[str, str]]:
    """(page and number, text) of the fenced blocks of a language."""
    for page in PAGES:
        found = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        for number, text in enumerate(found, 1):
            yield f"{page.stem}-{number}", text


def programs() -> list[tuple[str, str]]:
    """(page and number, text) of the Python programs: a block that goes on from the one before is part of it."""
    whole: list[tuple[str, str]] = []
    for name, text in blocks("python"):
        whole.append((name, whole.pop()[1] + text if text.startswith(GOES_ON) else text))
    return whole


def content(value: Any) -> Any:
    """A value as one that can be compared and hashed, without its origin."""
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value) if field.name not in ORIGIN]
        return type(value).__name__, *(content(getattr(value, name)) for name in names)
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, Mapping):
        return tuple((key, content(each)) for key, each in value.items())
    if isinstance(value, list | tuple):
        return tuple(map(content, value))
    return value


def of_arguments(*arguments: Any, **options: Any) -> Any:
    """The key of a call: all of its arguments."""
    return content(arguments), content(options)


def of_plan(plan: Any, *_folder: Any, **_options: Any) -> Any:
    """The key of a study: its plan alone, for its folder changes nothing of the table."""
    return content(plan)


def of_campaign(campaign: Any, **options: Any) -> Any:
    """The key of a diagnosis: chips, priors, and recordings to a thousandth, which other processors repeat."""
    states = [(state.name, state.device, np.log(state.measured.impedance).round(3)) for state in campaign.states]
    return content((states, campaign.uncertain)), content(options)


#: Slow functions of `workbench` whose answers programs share, and the keys of their calls.
SHARED: dict[str, Callable[..., Any]] = {
    "simulate": of_arguments, "energy_spectrum": of_arguments, "fit": of_arguments, "study": of_plan,
    "diagnose": of_campaign}


def remembered(function: Callable[..., Any], key: Callable[..., Any], answers: dict[Any, Any]) -> Callable[..., Any]:
    """The function, which takes an answer that is known from `answers`."""
    def call(*arguments: Any, **options: Any) -> Any:
        own = function.__name__, key(*arguments, **options)
        if own not in answers:
            answers[own] = function(*arguments, **options)
        return answers[own]

    return call
