"""Export of a user's entries to one file, and import from it.

The file is JSON: every entry with its name, its exact text, the SHA-256 of that text, and its withdrawal if it has one.
An imported file is identical to the exported one, provenance included.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from materials.entry import parse_entry
from materials.history import load_quietly
from materials.registry import PACKAGE_DATA, Registry, bibliography_keys
from materials.versions import (
    Withdrawal,
    check_saved_name,
    entry_file,
    put,
    read_withdrawal,
    split_version,
    withdrawal_file,
    withdrawal_text,
)
from workbench.files.errors import InputError, file_error
from workbench.files.tables import FileTable, parse_json, parse_toml
from workbench.files.writing import write_atomic

#: First line of the file, which identifies its format.
FORMAT = "acoustofluidic-chip-workbench materials 1"


@dataclass(frozen=True)
class Imported:
    """The name of an imported entry. ``new`` is False for an identical one."""

    name: str
    new: bool


@dataclass(frozen=True)
class _Entry:
    name: str
    content: str
    withdrawal: Withdrawal | None

    @property
    def exported(self) -> dict[str, object]:
        """The entry as it is written."""
        found: dict[str, object] = {"name": self.name, "sha256": _digest(self.content), "content": self.content}
        if self.withdrawal is not None:
            found["withdrawal"] = {"date": self.withdrawal.date, "reason": self.withdrawal.reason}
        return found


def export_entries(registry: Registry, names: Iterable[str], *, path: Path) -> tuple[str, ...]:
    """Write entries to the file `path`; return their full names.

    Raises:
        InputError: an unknown name, an entry of the package, or a damaged one; another file is at `path`.
    """
    found = [registry.find(name) for name in names]
    entries = []
    for name, file in dict(found).items():
        if PACKAGE_DATA in file.parents:
            raise InputError("materials", "name", name, "an entry of your own: every installation has this one")
        split = split_version(name)
        check_saved_name(name if split is None else split[0])
        load_quietly(registry, name)  # Raises for an unreadable entry.
        # Written as bytes: text mode would change line ends.
        content, withdrawal = file.read_bytes().decode("utf-8"), read_withdrawal(file)
        entries.append(_Entry(name, content, withdrawal).exported)
    if os.path.lexists(path) and (path.is_file() or path.is_symlink()) and not _is_exported(path):
        raise InputError("materials", "output", str(path), "a new name, or an unchanged file of exported "
                         "materials, which is replaced; this is another file, a changed one or a link")
    write_atomic(path, _exported_text(entries))
    return tuple(dict(found))


def import_entries(path: Path, *, folder: Path) -> tuple[Imported, ...]:
    """Copy the entries of an exported file into a folder of materials.

    All entries are checked before the first is written, each atomically. Existing entries stay; withdrawals are added.
    The folder is made if needed.

    Raises:
        InputError: not an exported file or a damaged one; an entry that cannot be read, or that cites a source unknown
            here; another content under an existing name.
    """
    entries = _read(path)
    references = bibliography_keys(PACKAGE_DATA / "references.bib") | bibliography_keys(folder / "references.bib")
    library = Registry(folder if folder.is_dir() else ()).library
    for entry in entries:
        # An entry with a name of the package would make both unreadable.
        if entry_file(PACKAGE_DATA, entry.name).exists():
            raise InputError(str(path), entry.name, entry.name, "a name that the package does not have")
        _refuse_other(path, entry, folder)
        table = parse_toml(entry.content, source=str(path), field=entry.name)
        parse_entry(table, entry.name, file=f"{path}, {entry.name}", references=references, notes=[], library=library)
    return tuple(Imported(entry.name, _place(path, entry, folder)) for entry in entries)


def _place(path: Path, entry: _Entry, folder: Path) -> bool:
    """Write an entry; whether it is new. Another run may have written it since the check."""
    target, new = entry_file(folder, entry.name), True
    try:
        put(entry.content.encode("utf-8"), [target])
    except FileExistsError:
        new = False
        _refuse_other(path, entry, folder)
    if entry.withdrawal is not None and not withdrawal_file(target).exists():
        # Another run may have withdrawn it meanwhile.
        with contextlib.suppress(FileExistsError):
            put(withdrawal_text(entry.withdrawal).encode("utf-8"), [withdrawal_file(target)])
    return new


def _refuse_other(path: Path, entry: _Entry, folder: Path) -> None:
    target = entry_file(folder, entry.name)
    if target.exists() and target.read_bytes() != entry.content.encode("utf-8"):
        there = hashlib.sha256(target.read_bytes()).hexdigest()
        raise InputError(str(path), entry.name, f"content {_digest(entry.content)[:12]}",
                         f"the content {there[:12]} of {target}, which is never overwritten; --materials DIR imports "
                         "into another folder")


def _digest(content: str) -> str:
    # Half a surrogate pair, which JSON allows, has no digest and matches none.
    return hashlib.sha256(content.encode("utf-8", "replace")).hexdigest()


def _is_exported(path: Path) -> bool:
    """Whether a file is an unchanged result of :func:`export_entries`."""
    try:
        entries = _read(path)
        content = path.read_text(encoding="utf-8")
    except (InputError, OSError):
        return False
    return not path.is_symlink() and content == _exported_text([each.exported for each in entries])


def _exported_text(entries: Sequence[Mapping[str, object]]) -> str:
    return json.dumps({"format": FORMAT, "entries": entries}, indent=1, ensure_ascii=False) + "\n"


def _read(path: Path) -> list[_Entry]:
    source = str(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise file_error(path, "an existing file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise file_error(path, f"a readable text file ({error})") from None
    data = parse_json(text, source=source, expected="a file of exported materials, whole")
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
        raise InputError(source, "format", found, FORMAT)
    entries = data.get("entries")
    if not isinstance(entries, list):
        raise InputError(source, "entries", entries, "a list of entries")
    return [_read_entry(entry, f"entries[{k}]", source=source) for k, entry in enumerate(entries)]


def _read_entry(entry: object, field: str, *, source: str) -> _Entry:
    table = FileTable.of(entry, source=source, field=field, expected="a name, a content and its sha256")
    name, content, digest = (table.text(key) for key in ("name", "content", "sha256"))
    split = split_version(name)
    # A name is a path in the folder.
    check_saved_name(name if split is None else split[0], source=source)
    if _digest(content) != digest:
        raise InputError(source, f"{field}.sha256", digest, f"{_digest(content)}, the digest of the content: {name} "
                         "was changed")
    if table.content.get("withdrawal") is None:
        return _Entry(name, content, None)
    withdrawal = table.table("withdrawal", expected="a date and a reason")
    return _Entry(name, content, Withdrawal(withdrawal.text("date"), withdrawal.text("reason")))
