"""Materials by name: ``material/source``, each an entry file under a data folder.

    data/pzt4/acevedo_2026_fitted.toml   ->   "pzt4/acevedo_2026_fitted"
    data/references.bib                  ->   the sources that entries may cite

The package's own folder always comes first; a user's folders have the same layout and may add materials, entries and a
``references.bib``. An entry is read when it is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import inputs
from inputs import InputError
from materials.entry import read_entry
from materials.kinds import Material

PACKAGE_DATA = Path(__file__).parent / "data"
_BIBLIOGRAPHY_KEY = re.compile(r"^\s*@\w+\s*\{\s*([^,\s]+)\s*,", re.MULTILINE)


def bibliography_keys(path: Path) -> frozenset[str]:
    """The keys of the entries of a BibTeX file; none if there is no such file.

    Raises:
        InputError: the same key twice.
    """
    if not path.is_file():
        return frozenset()
    keys = _BIBLIOGRAPHY_KEY.findall(path.read_text(encoding="utf-8"))
    for key in keys:
        if keys.count(key) > 1:
            raise InputError(str(path), "key", key, "each key once")
    return frozenset(keys)


@dataclass(frozen=True)
class Registry:
    """The materials of the package and of any further `folders`."""

    folders: tuple[Path, ...] = ()

    def names(self) -> tuple[str, ...]:
        """Every ``material/source`` name, sorted."""
        return tuple(sorted(self._files()))

    def load(self, name: str, *, temperature: float | None = None) -> Material:
        """The material called `name`, read and checked.

        Args:
            name: ``material/source``, or ``material`` alone if it has one entry or one that is declared the default.
            temperature: in K, for a material whose numbers depend on it. None: the reference temperature its entry
                states, which the result carries in its ``temperature``.

        Raises:
            InputError: no such name (the nearest ones are named), a material with several entries and no default, a
                temperature that the entry has no laws for or that lies outside them, or a faulty entry.

        Warns:
            materials.PassivityWarning: the entry is active by no more than its own rounding.
        """
        files = self._files()
        chosen = name if "/" in name else self._default(name, files)
        if chosen not in files:
            siblings = [known for known in files if known.split("/")[0] == name.split("/")[0]]
            near = tuple(siblings) or inputs.nearest_names(name, files)
            raise InputError("materials", "name", name, "one of " + ", ".join(sorted(files)), near)
        references = frozenset().union(*(bibliography_keys(folder / "references.bib") for folder in self._folders()))
        return read_entry(files[chosen], chosen, references=references, temperature=temperature)

    def _folders(self) -> tuple[Path, ...]:
        return (PACKAGE_DATA, *self.folders)

    def _files(self) -> Mapping[str, Path]:
        files: dict[str, Path] = {}
        for folder in self._folders():
            if not folder.is_dir():
                raise InputError("materials", "folder", str(folder), "an existing folder of materials")
            for path in sorted(folder.glob("*/*.toml")):
                name = f"{path.parent.name}/{path.stem}"
                if name in files:
                    raise InputError(str(path), "name", name, f"a name of its own: {files[name]} has this one")
                files[name] = path
        return files

    def _default(self, material: str, files: Mapping[str, Path]) -> str:
        """The full name meant by a material's name alone."""
        entries = [name for name in files if name.split("/")[0] == material]
        if not entries:
            known = {name.split("/")[0] for name in files}
            raise InputError("materials", "name", material, "one of " + ", ".join(sorted(known)),
                             inputs.nearest_names(material, known))
        if len(entries) == 1:
            return entries[0]
        declared = [name for name in entries if inputs.read_toml(files[name]).get("default") is True]
        if len(declared) != 1:
            count = "none is" if not declared else f"{len(declared)} are"
            raise InputError("materials", "name", material,
                             f"one of {', '.join(sorted(entries))} ({count} declared the default)")
        return declared[0]
