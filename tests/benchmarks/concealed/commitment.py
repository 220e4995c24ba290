"""A withheld truth: its salted hashes are published first, the truth later, and everybody can compare the two."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from concealed.tasks import TRUTH

from workbench.files.writing import write_atomic

#: The file of hashes, in a folder of trials.
HASHES = "truth.sha256.json"


def digest(entry: Mapping[str, Any]) -> str:
    """SHA-256 (hexadecimal) of the entry of a trial: its JSON with sorted keys and without spaces, in UTF-8."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def seal(folder: Path, truth: Path) -> None:
    """Move the truth of a folder of trials to the file `truth`, and leave its hashes.

    Each entry gets a key ``salt`` of 128 random bits, so that no list of mechanisms leads from a hash to its entry.

    Raises:
        FileExistsError: `truth` exists.
    """
    if truth.exists():
        raise FileExistsError(f"{truth} exists: a second seal has other salts")
    entries = {name: {**entry, "salt": secrets.token_hex(16)}
               for name, entry in json.loads((folder / TRUTH).read_text(encoding="utf-8")).items()}
    write_atomic(truth, json.dumps(entries, indent=0) + "\n")
    write_atomic(folder / HASHES, json.dumps({name: digest(entry) for name, entry in entries.items()}, indent=1) + "\n")
    (folder / TRUTH).unlink()


def contradictions(folder: Path, truth: Path) -> list[str]:
    """Trials whose entry in the file `truth` is missing, or differs from the hash in the folder."""
    hashes = json.loads((folder / HASHES).read_text(encoding="utf-8"))
    entries = json.loads(truth.read_text(encoding="utf-8"))
    return [name for name, each in hashes.items() if name not in entries or digest(entries[name]) != each]
