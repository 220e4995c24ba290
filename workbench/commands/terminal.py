"""What a command shows: results on standard output, so that they can be piped; progress on the error console."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from workbench.report.page import TextTable

if TYPE_CHECKING:
    from rich.console import Console

#: Called with a state, what is being done for it, and the fraction of it that is done.
Show = Callable[[str, str, float], None]


@contextmanager
def progress_bars(console: Console) -> Iterator[Show]:
    """Progress bars, one for each state: called with the state, what is being done, and the fraction of it."""
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    bars = Progress(TextColumn("{task.fields[state]:>12}"), TextColumn("{task.description:<14}"), BarColumn(),
                    TimeElapsedColumn(), console=console)
    tasks: dict[str, TaskID] = {}
    with bars:
        def show(state: str, activity: str, fraction: float) -> None:
            if state not in tasks:
                tasks[state] = bars.add_task(activity, total=1.0, state=state)
            bars.update(tasks[state], description=activity, completed=fraction)

        yield show


def say_finding(text: str, console: Console) -> None:
    """A finding, beside the results."""
    console.print(f"finding: {text}", style="yellow", markup=False)


def print_line(text: str) -> None:
    """A result, to standard output so that it can be piped; all that is said on the way goes to the error console."""
    sys.stdout.write(text + "\n")


def print_paragraph(text: str) -> None:
    """A result in sentences, on lines as wide as the terminal (80 columns where there is none)."""
    print_line(textwrap.fill(text, shutil.get_terminal_size((80, 24)).columns, break_on_hyphens=False))


def print_table(title: str, table: TextTable) -> None:
    """A table of results, to standard output, as wide as the terminal at most (80 columns where there is none)."""
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    for line in table_lines(title, table, width=console.width):
        console.print(line.translate(_ASCII) if console.options.ascii_only else line, markup=False)


#: For a terminal that has no characters to draw with.
_ASCII = str.maketrans(dict.fromkeys("┏┳┓┡╇┩└┴┘", "+") | dict.fromkeys("━─", "-") | dict.fromkeys("┃│", "|"))


def table_lines(title: str, table: TextTable, *, width: int) -> list[str]:
    """A table as lines of at most `width` cells of the terminal; no word is cut.

    Headings and cells that are too long are wrapped between words, then behind the dots and slashes of names
    ("transducer.thickness", "pla/acevedo_2026"; never within a number). If that is not enough, the columns are folded
    into several tables below one another, each with the columns that tell the rows apart, and at last every row
    becomes a list of headings and values. Only a word that is longer than a whole line is broken elsewhere.
    """
    lines = [] if not title else _wrapped(title, width, at_joints=True)
    for at_joints in (False, True):
        widths = _widths(table, width, at_joints=at_joints)
        if widths is not None:
            return lines + _drawn(table, widths, at_joints=at_joints)
    folded = _folded(table, width)
    if not folded:
        return lines + _as_records(table, width)
    for part in folded:
        widths = _widths(part, width, at_joints=True)
        assert widths is not None
        lines += _drawn(part, widths, at_joints=True)
    return lines


def _widths(table: TextTable, width: int, *, at_joints: bool) -> list[int] | None:
    """The width of every column so that the table fits in `width`; None if its words are too long."""
    columns = list(zip(table.columns, *table.rows, strict=True))
    least = [max(max(map(cell_width, _pieces(text, at_joints=at_joints)), default=0) for text in column)
             for column in columns]
    wanted = [max(map(cell_width, column)) for column in columns]
    room = width - (3 * len(columns) + 1)
    if sum(max(one, 1) for one in least) > room:
        return None
    if sum(wanted) <= room:
        return wanted
    # What is left goes where it makes the most crowded column less crowded.
    found = [max(one, 1) for one in least]
    for _ in range(room - sum(found)):
        found[max(range(len(found)), key=lambda column: wanted[column] / found[column])] += 1
    return found


def _keys(table: TextTable) -> int:
    """How many of the first columns tell every row from the others; one, if all of them do not."""
    for count in range(1, len(table.columns)):
        if len({row[:count] for row in table.rows}) == len(table.rows):
            return count
    return 1


def _folded(table: TextTable, width: int) -> list[TextTable] | None:
    """Tables that fit in `width`, each with the columns that tell the rows apart; None if one column cannot."""
    keys = list(range(_keys(table)))
    found: list[TextTable] = []
    group: list[int] = []
    for column in range(len(keys), len(table.columns)):
        longer, alone = _chosen(table, [*keys, *group, column]), _chosen(table, [*keys, column])
        if group and _widths(longer, width, at_joints=True) is not None:
            group.append(column)
            found[-1] = longer
        elif _widths(alone, width, at_joints=True) is not None:
            group = [column]
            found.append(alone)
        else:
            return None
    return found


def _chosen(table: TextTable, columns: Sequence[int]) -> TextTable:
    """The table with these columns only."""
    heads, *rows = (tuple(row[column] for column in columns) for row in (table.columns, *table.rows))
    return TextTable(heads, tuple(rows))


def _drawn(table: TextTable, widths: list[int], *, at_joints: bool) -> list[str]:
    """The table with lines around it, its columns of the given widths."""
    def rule(left: str, line: str, middle: str, right: str) -> str:
        return left + middle.join(line * (width + 2) for width in widths) + right

    def row(cells: tuple[str, ...], edge: str) -> list[str]:
        wrapped = [_wrapped(text, width, at_joints=at_joints) for text, width in zip(cells, widths, strict=True)]
        return [edge + edge.join(f" {_padded(cell[at] if at < len(cell) else '', width)} "
                                 for cell, width in zip(wrapped, widths, strict=True)) + edge
                for at in range(max(map(len, wrapped)))]

    lines = [rule("┏", "━", "┳", "┓"), *row(table.columns, "┃"), rule("┡", "━", "╇", "┩")]
    for one in table.rows:
        lines += row(one, "│")
    return [*lines, rule("└", "─", "┴", "┘")]


def _as_records(table: TextTable, width: int) -> list[str]:
    """Every row as a list of headings and values."""
    lines = []
    for row in table.rows:
        lines.append("─" * width)
        for heading, cell in zip(table.columns, row, strict=True):
            if cell:
                lines += _wrapped(f"{heading}: {cell}" if heading else cell, width, at_joints=True)
    return [*lines, "─" * width]


def cell_width(text: str) -> int:
    """Cells of the terminal that a text takes."""
    from rich.cells import cell_len

    return cell_len(text)


def _padded(text: str, width: int) -> str:
    return text + " " * (width - cell_width(text))


#: Where a name may be broken: behind a dot or slash that a letter follows.
_JOINT = re.compile(r"(?<=[^\W_][./])(?=[^\W\d_])")


def _pieces(text: str, *, at_joints: bool) -> list[str]:
    """What a text may be broken into: words, or (`at_joints`) the members of names."""
    return [piece for word in text.split() for piece in (_JOINT.split(word) if at_joints else [word])]


def _wrapped(text: str, width: int, *, at_joints: bool) -> list[str]:
    """The text in lines of at most `width` cells, one at least."""
    lines = [""]
    for word in text.split():
        gap = " " if lines[-1] else ""
        if cell_width(lines[-1] + gap + word) <= width:
            lines[-1] += gap + word
            continue
        if cell_width(word) <= width:
            lines.append(word)
            continue
        for piece in _pieces(word, at_joints=at_joints):
            if cell_width(lines[-1] + gap + piece) <= width:
                lines[-1] += gap + piece
            else:
                # Longer than a line: only in a title or a list of values.
                while cell_width(piece) > width:
                    lines.append(piece[:width])
                    piece = piece[width:]
                lines.append(piece)
            gap = ""
    return lines[1:] if len(lines) > 1 and not lines[0] else lines
