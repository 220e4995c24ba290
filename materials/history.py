"""The versions of a saved fit, and their withdrawal. Nothing is ever changed or removed."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

from materials.kinds import Material
from materials.passivity import PassivityWarning
from materials.registry import Registry
from materials.value import date_text
from materials.versions import (
    Withdrawal,
    WithdrawnWarning,
    put,
    read_withdrawal,
    split_version,
    versions_of,
    withdrawal_file,
    withdrawal_text,
)
from workbench.files.errors import InputError
from workbench.files.tables import FileTable


@dataclass(frozen=True)
class Version:
    """One version of a saved fit; ``fault`` describes a damaged file. ``material`` is then None."""

    name: str
    material: Material | None
    withdrawal: Withdrawal | None
    fault: str = ""


def history(registry: Registry, name: str) -> tuple[Version, ...]:
    """Every version of a saved fit ``material/name``, the oldest first.

    A damaged version has a ``fault``.

    Raises:
        InputError: no saved fit of that name.
    """
    versions = versions_of(name, registry.names())
    if not versions:
        registry.find(name)  # Raises with the known entries if the name is unknown.
        raise InputError("materials", "name", name, "a saved fit; this entry has no versions")
    return tuple(_version(registry, version) for version in versions)


def _version(registry: Registry, name: str) -> Version:
    withdrawal = None
    try:
        withdrawal = read_withdrawal(registry.find(name)[1])
        return Version(name, load_quietly(registry, name), withdrawal)
    except InputError as error:
        return Version(name, None, withdrawal, str(error))


def load_quietly(registry: Registry, name: str) -> Material:
    """Load a material for display, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PassivityWarning)
        warnings.simplefilter("ignore", WithdrawnWarning)
        return registry.load(name)


def withdraw(registry: Registry, name: str, *, reason: str, date: str) -> None:
    """Withdraw a version: only its full name reads it, with a warning.

    Args:
        registry: the registry with the version.
        name: in full, such as ``pzt4/disc_7@2``.
        reason: for its users.
        date: in ISO 8601.

    Raises:
        InputError: not the full name of a version, no reason, or withdrawn already.
    """
    full, path = registry.find(name)
    if split_version(name) is None:
        expected = f"the full name of a version, such as {full}" if split_version(full) else "a version of a saved fit"
        raise InputError("materials", "name", name, expected)
    if not reason.strip():
        raise InputError("materials", "reason", reason, "the reason for the withdrawal")
    date_text(FileTable("materials", "", {"date": date}), "date")
    try:
        put(withdrawal_text(Withdrawal(date, reason)).encode("utf-8"), [withdrawal_file(path)])
    except FileExistsError:
        there = read_withdrawal(path)
        known = "" if there is None else f": on {there.date}, {there.reason}"
        raise InputError("materials", "name", name, f"a version not withdrawn yet (it was{known})") from None
