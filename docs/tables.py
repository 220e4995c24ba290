"""Write tables and programs that are made from the code into the pages, where a reader of the files sees them.

    .venv/bin/python docs/tables.py

A table stands between two comments, `<!-- NAME: made by docs/tables.py -->` and `<!-- end of NAME -->`. A test finds a
table that is not that of the code.
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

import chip_keys  # noqa: E402
import file_keys  # noqa: E402
import glossary_page  # noqa: E402
import material_table  # noqa: E402

from workbench.fitting import batch  # noqa: E402


def example(name: str) -> str:
    """The program of an example, without its docstring."""
    program = (HERE.parent / "examples" / f"{name}.py").read_text(encoding="utf-8").split('"""', 2)[2]
    return f"```py\n{program.strip()}\n```\n"


def batch_file() -> str:
    """The list of recordings in the docstring of its reader."""
    indented = re.search(r"(?:^ {4}.*\n|^\n)+", str(batch.__doc__), re.MULTILINE)
    assert indented is not None
    return f"```text\n{textwrap.dedent(indented[0]).strip()}\n```\n"


#: Functions that make the tables, in Markdown, by the names in the comments.
TABLES: Mapping[str, Callable[[], str]] = {
    "chip_keys": chip_keys.page, "plausible": chip_keys.plausible_page, "bench_keys": file_keys.bench_page,
    "campaign_keys": file_keys.campaign_page, "material_table": material_table.page, "glossary": glossary_page.page,
    "batch_file": batch_file,
    **{name: partial(example, name) for name in ("01_first_spectrum", "21_my_chip_my_recording")},
}

_PLACE = re.compile(r"(<!-- (\w+): made by docs/tables\.py -->\n).*?(<!-- end of (\w+) -->\n)", re.DOTALL)


def fresh(text: str) -> str:
    """A page with the tables as the code makes them now.

    Raises:
        ValueError: a comment names no table, or the comment after it ends another one.
    """
    def table(found: re.Match[str]) -> str:
        begin, name, end, ended = found.groups()
        if name not in TABLES or ended != name:
            raise ValueError(f"received a table {name!r} that ends as {ended!r}; expected one of "
                             f"{', '.join(TABLES)}, ended by its own name")
        return f"{begin}\n{TABLES[name]()}\n{end}"

    return _PLACE.sub(table, text)


def main() -> None:
    for path in sorted(HERE.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (now := fresh(text)) != text:
            path.write_text(now, encoding="utf-8")
            print(path.name)


if __name__ == "__main__":
    main()
