"""What a command shows: results on standard output, so that they can be piped; progress on the error console."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from workbench.report import Table

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


def print_line(text: str) -> None:
    """A result, to standard output so that it can be piped; all that is said on the way goes to the error console."""
    sys.stdout.write(text + "\n")


def print_table(title: str, table: Table) -> None:
    """A table of results, to standard output."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table as RichTable

    shown = RichTable(*map(escape, table.columns), title=escape(title))
    for row in table.rows:
        shown.add_row(*map(escape, row))
    Console(highlight=False).print(shown)
