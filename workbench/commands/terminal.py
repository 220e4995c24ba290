"""Output of a command: results on standard output, so that they can be piped; progress on the error console."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from workbench.commands.console import KEPT
from workbench.files.names import visible
from workbench.jobs.progress import Progress
from workbench.report.page import TextTable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

#: Called with a state, what is being done for it, and the fraction of it that is done.
Show = Callable[[str, str, float], None]


@contextmanager
def progress_bars(console: Console) -> Iterator[Show]:
    """Progress bars, one for each state: called with the state, what is being done, and the fraction of it."""
    from rich import progress

    bars = progress.Progress(
        progress.TextColumn("{task.fields[state]:>12}", markup=False),
        progress.TextColumn("{task.description:<14}", markup=False),
        progress.BarColumn(), progress.TimeElapsedColumn(), console=console)
    tasks: dict[str, progress.TaskID] = {}
    with bars:
        def show(state: str, activity: str, fraction: float) -> None:
            if state not in tasks:
                tasks[state] = bars.add_task("", total=1.0, state=visible(state))
            bars.update(tasks[state], description=visible(activity), completed=fraction)

        yield show


def by_rows(show: Show) -> Progress:
    """Shows "part: what is done" in the row of the part."""
    def told(text: str, share: float) -> None:
        part, _, activity = text.rpartition(": ")
        show(part, activity, share)

    return told


def say_finding(text: str, console: Console) -> None:
    """A finding, beside the results."""
    console.print(f"finding: {text}", style="yellow", markup=False)


def print_line(text: str) -> None:
    """A result, to standard output so that it can be piped; all that is said on the way goes to the error console."""
    sys.stdout.write(visible(text, keep=KEPT) + "\n")


def print_paragraph(text: str) -> None:
    """A result in sentences, on lines as wide as the terminal (80 columns where there is none)."""
    print_line(textwrap.fill(text, shutil.get_terminal_size((80, 24)).columns, break_long_words=False,
                             break_on_hyphens=False))


def print_table(title: str, table: TextTable) -> None:
    """A table of results, to standard output, as wide as the terminal at most (80 columns where there is none)."""
    from rich.console import Console

    console = Console(highlight=False)
    heads, *rows = (tuple(visible(cell, keep=KEPT) for cell in row) for row in (table.columns, *table.rows))
    shown = TextTable(heads, tuple(rows))
    console.print(*table_parts(visible(title, keep=KEPT), shown, width=console.width), sep="\n")


def table_parts(title: str, table: TextTable, *, width: int) -> list[RenderableType]:
    """A title and a table as `rich` draws them in `width` cells of a terminal; no word is cut.

    `rich` alone takes the width that is wanting from the widest columns, and cuts their words; so the widths are set
    here. Headings and cells that are too long are wrapped between words, then behind the dots and slashes of names
    ("transducer.thickness", "pla/acevedo_2026"; never within a number). If that is not enough, the columns are folded
    into several tables below one another, each with the columns that tell the rows apart, and at last every row
    becomes a list of headings and values. Only a word that is longer than a whole line is cut.
    """
    from rich.table import Table
    from rich.text import Text

    parts: list[RenderableType] = [Text(_breakable(title, width))] if title else []
    folded = [table] if _widths(table, width) is not None else _folded(table, width)
    if folded is None:
        return [*parts, _as_list(table, width)]
    for part in folded:
        widths = _widths(part, width)
        assert widths is not None
        drawn = Table()
        heads, *rows = ([Text(_breakable(text, size), overflow="fold") for text, size in zip(row, widths, strict=True)]
                        for row in (part.columns, *part.rows))
        for head, size in zip(heads, widths, strict=True):
            drawn.add_column(head, width=size)
        for row in rows:
            drawn.add_row(*row)
        parts.append(drawn)
    return parts


def _widths(table: TextTable, width: int) -> list[int] | None:
    """Cells for every column, so that the table fits in `width` and its words are whole; None if they are too long."""
    from rich.cells import cell_len

    room = width - (3 * len(table.columns) + 1)
    columns = list(zip(table.columns, *table.rows, strict=True))
    wanted = [max(1, *map(cell_len, column)) for column in columns]
    if sum(wanted) <= room:
        return wanted
    for split in (str.split, _pieces):
        found = [max((cell_len(piece) for text in column for piece in split(text)), default=1) for column in columns]
        if sum(found) <= room:
            # The rest of the room goes to the most crowded column, one character after the other.
            for _ in range(room - sum(found)):
                found[max(range(len(found)), key=lambda column: wanted[column] / found[column])] += 1
            return found
    return None


def _folded(table: TextTable, width: int) -> list[TextTable] | None:
    """Tables that fit in `width`, each with the columns that tell the rows apart; None if one column cannot."""
    # The first columns that tell every row from the others; the first one, if all of them do not.
    keys = next((count for count in range(1, len(table.columns))
                 if len({row[:count] for row in table.rows}) == len(table.rows)), 1)
    found: list[TextTable] = []
    group: list[int] = []
    for column in range(keys, len(table.columns)):
        longer, alone = (_chosen(table, [*range(keys), *more, column]) for more in (group, []))
        if group and _widths(longer, width) is not None:
            group.append(column)
            found[-1] = longer
        elif _widths(alone, width) is not None:
            group = [column]
            found.append(alone)
        else:
            return None
    return found or None


def _chosen(table: TextTable, columns: Sequence[int]) -> TextTable:
    """The table with these columns only."""
    heads, *rows = (tuple(row[column] for column in columns) for row in (table.columns, *table.rows))
    return TextTable(heads, tuple(rows))


def _as_list(table: TextTable, width: int) -> RenderableType:
    """Every row as a list of headings and values, with lines between the rows."""
    from rich.box import HORIZONTALS
    from rich.table import Table
    from rich.text import Text

    drawn = Table(box=HORIZONTALS, show_header=False, show_lines=True, show_edge=False, padding=0)
    drawn.add_column(width=width)
    for row in table.rows:
        drawn.add_row(Text("\n".join(
            _breakable(f"{heading}: {cell}" if heading else cell, width)
            for heading, cell in zip(table.columns, row, strict=True) if cell), overflow="fold"))
    return drawn


#: Where a name may be broken: behind a dot or slash that a letter follows.
_JOINT = re.compile(r"(?<=[^\W_][./])(?=[^\W\d_])")


def _pieces(text: str) -> list[str]:
    """The members of names that a text may be broken into."""
    return [piece for word in text.split() for piece in _JOINT.split(word)]


def _breakable(text: str, width: int) -> str:
    """The text with line ends at the joints of words longer than `width` cells, at which these must be broken."""
    from rich.cells import cell_len

    words = []
    for word in text.split():
        lines = [""]
        for piece in _JOINT.split(word) if cell_len(word) > width else [word]:
            if lines[-1] and cell_len(lines[-1] + piece) > width:
                lines.append("")
            lines[-1] += piece
        words.append("\n".join(lines))
    return " ".join(words)
