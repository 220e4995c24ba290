"""The lower bounds of the requirements are read from pyproject.toml, and the lock satisfies them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dependencies import lower_bounds

ROOT = Path(__file__).resolve().parent.parent


def numbers(version: str) -> tuple[int, ...]:
    """A version as numbers that compare as versions do."""
    return tuple(int(each) for each in re.findall(r"\d+", version))


def test_each_locked_version_satisfies_its_lower_bound() -> None:
    locked = dict(re.findall(r"^([\w-]+)==([\w.]+)", (ROOT / "requirements.lock").read_text(encoding="utf-8"), re.M))
    bounds = lower_bounds(ROOT / "pyproject.toml")
    compared = {name: (numbers(locked[name]), numbers(bound)) for name, bound in bounds.items() if name in locked}
    assert {"numpy", "setuptools", "pytest"} <= set(compared)
    # The lock has all but the drivers of VISA.
    assert set(bounds) - set(compared) == {"pyvisa", "pyvisa-py", "pyusb"}
    assert [name for name, (lock, bound) in compared.items() if lock < bound] == []


def test_a_requirement_without_a_lower_bound_is_an_error(tmp_path: Path) -> None:
    project = tmp_path / "pyproject.toml"
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project.write_text(re.sub(r'"numpy>=.*"', '"numpy"', text), encoding="utf-8")
    with pytest.raises(ValueError, match=r"pyproject\.toml: received the requirement 'numpy'; expected NAME>=VERSION"):
        lower_bounds(project)
