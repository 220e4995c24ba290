"""A page of text, tables and pictures, one HTML file that opens offline; and records as JSON."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.files.writing import write_atomic

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: .8rem 0; }
th, td { padding: .25rem .7rem; text-align: right; }
th { background: #f3f3f3; } th:first-child, td:first-child { text-align: left; }
tr { border-bottom: 1px solid #e5e5e5; }
img { max-width: 100%; } figure { margin: 1rem 0; } figcaption { color: #555; font-size: .9rem; }
.note { background: #fff7e0; border-left: 4px solid #e0a800; padding: .4rem .8rem; }
"""


@dataclass(frozen=True)
class Table:
    """A table of text: a heading for every column, and rows of as many cells."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A PNG file and what it shows."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Note:
    """A sentence the reader must not miss."""

    text: str


Block = str | Table | Picture | Note


def write_report(path: Path, title: str, sections: Sequence[tuple[str, Sequence[Block]]]) -> Path:
    """Write an HTML page with every picture inside it. `sections` are (heading, blocks)."""
    parts = [f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>",
             f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>"]
    for heading, blocks in sections:
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts += [_html(block) for block in blocks]
    write_atomic(path, "\n".join(parts) + "\n")
    return path


def _html(block: Block) -> str:
    match block:
        case Table(columns, rows):
            head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
            body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
            return f"<table><tr>{head}</tr>{body}</table>"
        case Picture(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            text = html.escape(caption)
            image = f'<img src="data:image/png;base64,{data}" alt="{text}">'
            return f"<figure>{image}<figcaption>{text}</figcaption></figure>"
        case Note(text):
            return f'<p class="note">{html.escape(text)}</p>'
        case str():
            return "".join(f"<p>{html.escape(line)}</p>" for line in block.splitlines() if line)


def number(value: float, digits: int = 4) -> str:
    """A number for a table: `digits` significant digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else str(value)


def write_json(path: Path, record: Mapping[str, Any]) -> Path:
    """Write a record as JSON, whole or not at all."""
    write_atomic(path, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return path
