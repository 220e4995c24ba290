"""Output of a command: results to standard output, progress to the console."""

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

#: Called with a state, its present activity, and the finished fraction of it.
Show = Callable[[str, str, float], None]


@contextmanager
def progress_bars(console: Console) -> Iterator[Show]:
    """Progress bars, one for each state."""
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
    """A progress that shows "part: activity" in the row of the part."""
    def progress(text: str, share: float) -> None:
        part, _, activity = text.rpartition(": ")
        show(part, activity, share)

    return progress


def say_finding(text: str, console: Console) -> None:
    """Print a finding to the error console."""
    console.print(f"finding: {text}", style="yellow", markup=False)


def print_line(text: str) -> None:
    """Print a line of results to standard output."""
    sys.stdout.write(visible(text, keep=KEPT) + "\n")


def print_paragraph(text: str) -> None:
    """Print a result in sentences, wrapped to the terminal. It has 80 columns without a terminal."""
    print_line(textwrap.fill(text, shutil.get_terminal_size((80, 24)).columns, break_long_words=False,
                             break_on_hyphens=False))


def print_table(title: str, table: TextTable) -> None:
    """Print a table of results to standard output. It is at most as wide as the terminal, 80 columns without one."""
    from rich.console import Console

    console = Console(highlight=False)
    heads, *rows = (tuple(visible(cell, keep=KEPT) for cell in row) for row in (table.columns, *table.rows))
    shown = TextTable(heads, tuple(rows))
    console.print(*table_parts(visible(title, keep=KEPT), shown, width=console.width), sep="\n")


def table_parts(title: str, table: TextTable, *, width: int) -> list[RenderableType]:
    """A title and a table for `rich` in `width` cells.

    Words are not broken. `rich` alone takes the missing width from the widest columns, and breaks their words; so the
    widths are set here. Headings and cells that are too long are wrapped between words, then after the dots and slashes
    of names ("transducer.thickness", "pla/acevedo_2026"; never within a number). If that is not enough, the columns are
    folded into several tables, each with the columns that identify the rows, and at last every row becomes a list of
    headings and values. Only a word that is longer than a whole line is broken.
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
    """Column widths of a table in `width` cells, or None. None if its words would be broken."""
    from rich.cells import cell_len

    room = width - (3 * len(table.columns) + 1)
    columns = list(zip(table.columns, *table.rows, strict=True))
    wanted = [max(1, *map(cell_len, column)) for column in columns]
    if sum(wanted) <= room:
        return wanted
    for split in (str.split, _pieces):
        found = [max((cell_len(piece) for text in column for piece in split(text)), default=1) for column in columns]
        if sum(found) <= room:
            # The remaining width goes to the most crowded column, one character after the other.
            for _ in range(room - sum(found)):
                found[max(range(len(found)), key=lambda column: wanted[column] / found[column])] += 1
            return found
    return None


def _folded(table: TextTable, width: int) -> list[TextTable] | None:
    """Tables that fit in `width`, each with identifying columns, or None."""
    # The first columns that identify every row; the first one, if all of them do not.
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
    heads, *rows = (tuple(row[column] for column in columns) for row in (table.columns, *table.rows))
    return TextTable(heads, tuple(rows))


def _as_list(table: TextTable, width: int) -> RenderableType:
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


#: Breaks of a name: after a dot or slash before a letter.
_JOINT = re.compile(r"(?<=[^\W_][./])(?=[^\W\d_])")


def _pieces(text: str) -> list[str]:
    """The parts of names at which a text may be broken."""
    return [piece for word in text.split() for piece in _JOINT.split(word)]


def _breakable(text: str, width: int) -> str:
    """The text with line breaks within words wider than `width` cells."""
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
