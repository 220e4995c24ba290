"""TOML files and the tables in them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from workbench.files.errors import InputError, nearest_names


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: the file does not exist, is not text, or is not TOML (the parser's line and column are kept).
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        folder = path.parent if path.parent.is_dir() else Path()
        near = nearest_names(path.name, (p.name for p in folder.iterdir() if p.suffix == ".toml"))
        raise InputError(str(path), "file", path.name, "an existing file", near) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "file", path.name, f"a readable text file ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), "TOML syntax", str(error), "valid TOML") from None


def refuse_unknown_keys(table: Mapping[str, object], allowed: Iterable[str], *, source: str, field: str) -> None:
    """Raise an :class:`InputError` at the first key of `table` that is not in `allowed`."""
    names = sorted(allowed)
    for key in table:
        if key not in names:
            raise InputError(source, f"{field}.{key}" if field else key, key, "one of " + ", ".join(names),
                             nearest_names(key, names))
