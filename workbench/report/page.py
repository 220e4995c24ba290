"""A page of text, tables and pictures, one HTML file that opens offline; and records as JSON."""

from __future__ import annotations

import base64
import html
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from workbench.files.names import visible
from workbench.files.writing import write_atomic
from workbench.render.canvas import Picture
from workbench.report.definitions import defined, definition

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: .8rem 0; }
th, td { padding: .25rem .7rem; text-align: right; }
th { background: #f3f3f3; } th:first-child, td:first-child { text-align: left; }
td.words { text-align: left; }
tr { border-bottom: 1px solid #e5e5e5; }
img { max-width: 100%; } figure { margin: 1rem 0; } figcaption { color: #555; font-size: .9rem; }
abbr { text-decoration: underline dotted; cursor: help; }
.legend { color: #555; font-size: .9rem; margin: .2rem 0 1.2rem; } .legend dt { font-weight: 600; float: left; }
.legend dt::after { content: ":\\00a0"; } .legend dd { margin: 0; }
.answer { font-size: 1.1rem; } pre { background: #f6f6f6; padding: .6rem .8rem; overflow-x: auto; font-size: .85rem; }
.note { background: #fff7e0; border-left: 4px solid #e0a800; padding: .4rem .8rem; }
"""


#: Characters above which a cell of a table is text, that stands at the left, rather than a number.
_WORDS = 24


@dataclass(frozen=True)
class TextTable:
    """A table of text: a heading for every column, and rows of as many cells.

    A heading, of a column or of a row, that `definitions` knows shows what it means, and a legend below the first table
    of a page that has it says so.

    Raises:
        ValueError: a column other than the first has no heading, or a row is of another length.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        if not all(self.columns[1:]):
            raise ValueError(f"a table with the headings {self.columns} has a column without one")
        wrong = [row for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(f"the row {wrong[0]} does not have the {len(self.columns)} cells of {self.columns}")


@dataclass(frozen=True)
class Note:
    """A sentence the reader must not miss."""

    text: str


@dataclass(frozen=True)
class Answer:
    """The sentences that answer the question of the report."""

    text: str


@dataclass(frozen=True)
class Verbatim:
    """Text as it stands in a file, its lines kept."""

    text: str


#: Of plain text, an empty line begins a new paragraph; other line ends are spaces.
Block = str | TextTable | Picture | Note | Answer | Verbatim


def write_report(path: Path, title: str, sections: Sequence[tuple[str, Sequence[Block]]]) -> Path:
    """Write an HTML page with every picture inside it. `sections` are (heading, blocks)."""
    parts = [f"<!doctype html><html lang=en><meta charset=utf-8><title>{_text(title)}</title>",
             f"<style>{_STYLE}</style><h1>{_text(title)}</h1>"]
    explained: set[str] = set()
    for heading, blocks in sections:
        parts.append(f"<h2>{_text(heading)}</h2>")
        parts += [_html(block, explained) for block in blocks]
    write_atomic(path, "\n".join([*parts, "</html>"]) + "\n")
    return path


def _html(block: Block, explained: set[str]) -> str:
    """HTML of a block; `explained` are the headings whose meanings the page has, to which those of a table are added.
    """
    match block:
        case TextTable(columns, rows):
            head = "".join(f"<th>{_heading(c)}</th>" for c in columns)
            cells = ("".join(_cell(c, first=k == 0) for k, c in enumerate(row)) for row in rows)
            body = "".join(f"<tr>{row}</tr>" for row in cells)
            new = {name: words for name, words in defined((*columns, *(row[0] for row in rows if row)))
                   if name not in explained}
            explained.update(new)
            return f"<table><tr>{head}</tr>{body}</table>{_legend(new)}"
        case Picture(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            text = _text(caption)
            image = f'<img src="data:image/png;base64,{data}" alt="{text}">'
            return f"<figure>{image}<figcaption>{text}</figcaption></figure>"
        case Note(text):
            return f'<p class="note">{_text(text)}</p>'
        case Answer(text):
            return f'<p class="answer">{_text(text)}</p>'
        case Verbatim(text):
            return f"<pre>{_text(text)}</pre>"
        case str():
            paragraphs = (" ".join(each.split()) for each in re.split(r"\n\s*\n", block))
            return "".join(f"<p>{_text(each)}</p>" for each in paragraphs if each)


def _text(text: str) -> str:
    """Text for HTML: nothing in it is a tag, and control characters are shown as escapes."""
    return html.escape(visible(text, keep="\n\t"))


def _heading(text: str) -> str:
    words = definition(text)
    return _text(text) if words is None else f'<abbr title="{_text(words)}">{_text(text)}</abbr>'


def _cell(text: str, *, first: bool) -> str:
    """A cell: a heading of its row, a number, or a sentence, which stands at the left."""
    if first:
        return f"<td>{_heading(text)}</td>"
    return f"<td{' class=words' if len(text) > _WORDS else ''}>{_text(text)}</td>"


def _legend(meanings: Mapping[str, str]) -> str:
    """HTML of the meanings of headings, below their table; empty where there are none."""
    rows = "".join(f"<dt>{_text(name)}</dt><dd>{_text(words)}</dd>" for name, words in meanings.items())
    return f'<dl class="legend">{rows}</dl>' if rows else ""


def number_text(value: float, digits: int = 4) -> str:
    """A number for a table: `digits` significant digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else str(value)


def with_unit(name: str, unit: str) -> str:
    """A heading: the name with its unit in brackets, if it has one."""
    return f"{name} ({unit})" if unit else name
