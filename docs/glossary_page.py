"""The glossary: words of the documentation (`glossary_words.txt`), and headings of the reports with their meanings."""

from __future__ import annotations

from pathlib import Path

from workbench.report.definitions import DEFINITIONS

WORDS = Path(__file__).resolve().parent / "glossary_words.txt"


def words() -> dict[str, str]:
    """Words of the documentation and what they mean."""
    entries = WORDS.read_text(encoding="utf-8").strip().split("\n\n")
    return dict(entry.split("\n: ", 1) for entry in entries)


def page() -> str:
    """All words in the order of the alphabet.

    Raises:
        ValueError: a word stands in both places.
    """
    own = words()
    if both := own.keys() & DEFINITIONS.keys():
        raise ValueError(f"{WORDS.name}: {', '.join(sorted(both))}: reports say what that means (report/definitions)")
    every = own | DEFINITIONS
    return "\n".join(f"{word}\n: {every[word]}\n" for word in sorted(every, key=str.casefold))
