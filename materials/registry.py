"""Materials by name: ``material/source``, each an entry file in a data folder.

::

    data/pzt4/acevedo_2026_fitted.toml   ->   "pzt4/acevedo_2026_fitted"
    data/references.bib                  ->   the sources that entries may cite

The package's folder comes first; a user's folders have the same layout and may add materials, entries and a
``references.bib``. Entries are read on request.

A saved fit is an entry with versions, ``pzt4/disc_7@1``, ``pzt4/disc_7@2``: ``pzt4/disc_7`` is the newest one that is
not withdrawn. A material's name alone does not refer to a saved fit if there is another entry, so saving a fit does not
change the meaning of an existing chip file.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from materials.completion import Library
from materials.entry import read_entry
from materials.kinds import Material
from materials.versions import (
    WithdrawnWarning,
    entry_name,
    read_withdrawal,
    split_version,
    versions_of,
    withdrawal_file,
)
from workbench.files.errors import InputError, nearest_names, one_of
from workbench.files.names import MARKS, check_name
from workbench.files.tables import read_toml

PACKAGE_DATA = Path(__file__).parent / "data"
#: The expectation about a material that is in none of the folders.
_KNOWN = ("one of the names that `workbench materials list` shows, or one of a folder of your own, given by "
          "--materials DIR (in Python registry=wb.Registry(DIR))")
_BIBLIOGRAPHY_KEY = re.compile(r"^\s*@\w+\s*\{\s*([^,\s]+)\s*,", re.MULTILINE)


def bibliography_keys(path: Path) -> frozenset[str]:
    """The keys of a BibTeX file; empty without the file.

    Raises:
        InputError: a key that occurs twice.
    """
    if not path.is_file():
        return frozenset()
    keys = _BIBLIOGRAPHY_KEY.findall(path.read_text(encoding="utf-8"))
    for key in keys:
        if keys.count(key) > 1:
            raise InputError(str(path), "key", key, "each key once")
    return frozenset(keys)


def user_folder() -> Path:
    """The folder of the user's materials, which may not exist. It is in ``$XDG_DATA_HOME`` or ``~/.local/share``."""
    root = os.environ.get("XDG_DATA_HOME")
    return (Path(root) if root else Path.home() / ".local" / "share") / "acoustofluidic-chip-workbench" / "materials"


@dataclass(frozen=True)
class Registry:
    """The materials of the package and of any further `folders`.

    ``assumed_losses`` gives the lossless ceramics of a chip the loss of :mod:`materials.assumed`. ``inviscid`` removes
    the boundary layers of its cavities. The registry itself loads every material as its entry states it.
    """

    folders: Sequence[Path | str] | Path | str = ()
    assumed_losses: bool = False
    inviscid: bool = False

    def __post_init__(self) -> None:
        # A text is a sequence of letters too.
        given = (self.folders,) if isinstance(self.folders, str | Path) else self.folders
        object.__setattr__(self, "folders", tuple(map(Path, given)))

    def with_folders(self, further: Iterable[Path]) -> Registry:
        """The registry with `further` folders that it does not have yet."""
        assert isinstance(self.folders, tuple)
        known = {Path(folder).resolve() for folder in self.folders}
        added = tuple(folder for folder in further if folder.resolve() not in known)
        return replace(self, folders=(*self.folders, *added)) if added else self

    def names(self) -> tuple[str, ...]:
        """Every ``material/source`` name, sorted, with all versions of saved fits."""
        return tuple(sorted(self._files(), key=lambda name: split_version(name) or (name, 0)))

    def names_of_kind(self, kinds: Iterable[str]) -> frozenset[str]:
        """Names, with and without source, of entries of these `kinds`."""
        wanted, found = set(kinds), set[str]()
        for name, path in self._files().items():
            with suppress(InputError):
                if read_toml(path).get("kind") in wanted:
                    found |= {*_unversioned([name]), name.split("/")[0]}
        return frozenset(found)

    def load(self, name: str, *, temperature: float | None = None, notes: list[str] | None = None) -> Material:
        """Read and check the material called `name`.

        Args:
            name: ``material/source``, or ``material`` alone if it has one entry or a default; for a saved fit,
                ``material/name`` or ``material/name@version``.
            temperature: in K, for a material whose numbers depend on it. None: the reference temperature of its entry,
                which the result has as its ``temperature``.
            notes: a list that collects a :class:`materials.PassivityWarning` and a :class:`materials.SheetWarning` as
                text, if given.

        Raises:
            InputError: unknown name (with the nearest ones), a material with several entries and no default, a
                temperature without a law or outside its range, or a faulty entry.

        Warns:
            materials.PassivityWarning: the entry is active by no more than its rounding.
            materials.SheetWarning: a ceramic's constants are derived or assumed, or its sheet contradicts itself.
            materials.WithdrawnWarning: the full name of a withdrawn version is used.
        """
        chosen, path = self.find(name)
        withdrawal = read_withdrawal(path)
        if withdrawal is not None:
            warnings.warn(f"{chosen} was withdrawn on {withdrawal.date}: {withdrawal.reason}", WithdrawnWarning,
                          stacklevel=2)
        return self._read(chosen, path, temperature=temperature, notes=notes, library=self.library)

    @property
    def library(self) -> Library:
        """The materials that an entry may name."""
        return Library(lambda name: self._read(*self.find(name), notes=[]),
                       lambda: (name for name in self._files() if split_version(name) is None))

    def _read(
        self, name: str, path: Path, *, temperature: float | None = None, notes: list[str] | None,
        library: Library | None = None,
    ) -> Material:
        references = frozenset().union(*(bibliography_keys(folder / "references.bib") for folder in self._folders()))
        return read_entry(path, name, references=references, temperature=temperature, notes=notes, library=library)

    def find(self, name: str) -> tuple[str, Path]:
        """The full name and the file of `name`; see :meth:`load`.

        Raises:
            InputError: unknown name, or one with several entries or only withdrawn ones.
        """
        files = self._files()
        chosen = name if "/" in name else self._default(name, files)
        if chosen not in files:
            chosen = self._newest(chosen, files)
        return chosen, files[chosen]

    def _folders(self) -> tuple[Path, ...]:
        assert isinstance(self.folders, tuple)
        return (PACKAGE_DATA, *map(Path, self.folders))

    def _files(self) -> Mapping[str, Path]:
        files: dict[str, Path] = {}
        for folder in self._folders():
            if not folder.is_dir():
                raise InputError("materials", "folder", str(folder), "an existing folder of materials")
            # Files of file managers and editors begin with a dot.
            for path in sorted(folder.glob("[!.]*/[!.]*.toml")):
                name = check_name(entry_name(path), source=str(path), field="name", form="material/source",
                                  marks=f"{MARKS}@")
                if name in files:
                    raise InputError(str(path), "name", name, f"a unique name: {files[name]} has this one")
                files[name] = path
        return files

    def _newest(self, name: str, files: Mapping[str, Path]) -> str:
        """The newest version of a saved fit that is not withdrawn."""
        versions = versions_of(name, files)
        valid = [version for version in versions if not withdrawal_file(files[version]).exists()]
        if valid:
            return valid[-1]
        if versions:
            raise InputError("materials", "name", name, f"a version by its full name, such as {versions[-1]}: all "
                             f"{len(versions)} are withdrawn", (versions[-1],))
        # One name represents all versions: there may be hundreds.
        label = name.split("@")[0]
        known = versions_of(label, files) or sorted(set(_unversioned(files)))
        siblings = [other for other in known if other.split("/")[0] == name.split("/")[0]]
        if siblings:
            near = tuple(siblings) if len(siblings) <= 3 else nearest_names(name, siblings)
            raise InputError("materials", "name", name, one_of(siblings, name), near)
        raise InputError("materials", "name", name, _KNOWN, nearest_names(name, known))

    def _default(self, material: str, files: Mapping[str, Path]) -> str:
        """The full name for a material's name alone."""
        entries = [name for name in files if name.split("/")[0] == material and split_version(name) is None]
        entries = entries or sorted(set(_unversioned(name for name in files if name.split("/")[0] == material)))
        if not entries:
            known = {name.split("/")[0] for name in files}
            raise InputError("materials", "name", material, _KNOWN, nearest_names(material, known))
        if len(entries) == 1:
            return entries[0]
        declared = [name for name in entries if name in files and read_toml(files[name]).get("default") is True]
        if len(declared) != 1:
            count = "none is" if not declared else f"{len(declared)} are"
            raise InputError("materials", "name", material,
                             f"one of {', '.join(sorted(entries))} ({count} declared the default)")
        return declared[0]


def user_registry(further: Iterable[Path | str] = (), *, inviscid: bool = False) -> Registry:
    """The registry of the package, the user's folder and `further` folders."""
    own = user_folder()
    given = [Path(folder) for folder in ((further,) if isinstance(further, str | Path) else further)]
    rest = [folder for folder in given if folder.resolve() != own.resolve()]
    return Registry((*([own] if own.is_dir() else []), *rest), inviscid=inviscid)


def _unversioned(names: Iterable[str]) -> list[str]:
    """The `names` without versions."""
    return [name if (split := split_version(name)) is None else split[0] for name in names]
