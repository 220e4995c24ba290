"""Files written whole or not at all, and tables whose every mistake is named with its file, field and remedy."""

from __future__ import annotations

import errno
import math
import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest

from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text, parse_quantity
from workbench.files.tables import FileTable
from workbench.files.writing import remedy, replacing, write_atomic


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", "old")
    write_atomic(tmp_path / "a.txt", b"new")
    assert (tmp_path / "a.txt").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_atomic(tmp_path / "a.txt", "old")

    def failing(_descriptor: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(OSError, match="no space"):
        write_atomic(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_an_interruption_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", "old")

    def interrupted() -> None:
        with replacing(tmp_path / "a.txt") as whole:
            whole.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    write_atomic(pipe, "spectrum")
    reader.join(timeout=10.0)
    assert read == ["spectrum"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


TEXT = """
name = "disc 1"
empty = ""
count = 3
share = 0.25
yes = true
thickness = "2.02 mm"
band = ["0.9 MHz", "1.1 MHz"]
free = ["c33", ""]
[inner]
kind = "pzt"
[[rows]]
name = "one"
[[rows]]
name = 2
"""


@pytest.fixture
def table(tmp_path: Path) -> FileTable:
    path = tmp_path / "a.toml"
    path.write_text(TEXT, encoding="utf-8")
    return FileTable.read(path)


def test_a_table_gives_values_in_si(table: FileTable) -> None:
    assert table.text("name") == table.optional_text("name") == "disc 1"
    assert table.text("empty", "a") == ""
    assert table.texts("free") == ("c33", "")
    assert table.quantity("thickness", "length") == table.optional_quantity("thickness", "length") == 2.02e-3
    assert table.quantities("band", "frequency", expected="two") == (0.9e6, 1.1e6)
    assert table.optional_number("share") == 0.25
    assert table.whole("count", low=1, high=3) == 3
    assert table.flag("yes") is True
    assert table.table("inner").choice("kind", ("pzt", "polymer")) == "pzt"
    assert table.tables("rows", expected="tables [[rows]]")[0].text("name") == "one"
    assert "name" in table
    assert list(table.table("inner")) == ["kind"]


def test_a_default_stands_in_for_what_a_table_lacks(table: FileTable) -> None:
    assert table.text("x", "a") == "a"
    assert table.texts("x", ("a",)) == ("a",)
    assert table.quantity("x", "length", 1.0) == 1.0
    assert table.whole("x", 2, low=1, high=3) == 2
    assert table.flag("x", default=True) is True
    assert table.choice("x", ("a", "b"), "b") == "b"
    assert table.table("x").content == {}
    assert table.tables("x", expected="tables") == ()
    assert (table.optional_text("x"), table.optional_quantity("x", "length"), table.optional_number("x")) == (None,) * 3


@pytest.mark.parametrize(("take", "field", "value", "expected"), [
    (lambda t: t.text("count"), "count", 3, "a text"),
    (lambda t: t.text("empty"), "empty", "", "a text"),
    (lambda t: t.text("x"), "x", None, "a text"),
    (lambda t: t.optional_text("empty"), "empty", "", "a text"),
    (lambda t: t.texts("x"), "x", None, "a list of texts"),
    (lambda t: t.texts("count", ()), "count", 3, "a list of texts"),
    (lambda t: t.quantity("x", "length"), "x", None, "a length with its unit"),
    (lambda t: t.quantity("share", "length"), "share", 0.25, "a length with its unit"),
    (lambda t: t.quantities("free", "length", expected="two", numbered=True), "free[0]", "c33", "a length"),
    (lambda t: t.quantities("free", "length", expected="two"), "free", "c33", "a length"),
    (lambda t: t.quantities("count", "length", expected="two lengths"), "count", 3, "two lengths"),
    (lambda t: t.optional_number("yes"), "yes", True, "a finite number"),
    (lambda t: t.whole("count", low=1, high=2), "count", 3, "a whole number from 1 to 2"),
    (lambda t: t.whole("yes", low=0, high=2), "yes", True, "a whole number from 0 to 2"),
    (lambda t: t.flag("name"), "name", "disc 1", "true or false"),
    (lambda t: t.choice("name", ("disc 2", "ring")), "name", "disc 1", "one of disc 2, ring; did you mean 'disc 2'"),
    (lambda t: t.table("name"), "name", "disc 1", "a table"),
    (lambda t: t.table("inner").text("name"), "inner.name", None, "a text"),
    (lambda t: t.tables("inner", expected="tables [[inner]]"), "inner", {"kind": "pzt"}, "tables [[inner]]"),
    (lambda t: t.tables("rows", expected="tables")[1].text("name"), "rows[1].name", 2, "a text"),
    (lambda t: t.required("nam", "a name"), "nam", None, "a name"),
    (lambda t: t.table("inner").only(("name", "king")), "inner.kind", "kind", "one of king, name; did you mean 'king'"),
    (lambda t: t.only(("size",), renamed={"name": "size"}), "name", "name", "one of size; 'name' was renamed to"),
    (lambda t: FileTable.of(3, source=t.source, field="fit"), "fit", 3, "a table"),
])
def test_a_mistake_in_a_table_is_named(
    take: Callable[[FileTable], object], field: str, value: object, expected: str, table: FileTable
) -> None:
    with pytest.raises(InputError) as caught:
        take(table)
    error = caught.value
    assert (error.source, error.field, error.value) == (table.source, field, value)
    assert expected in str(error)


def test_a_missing_key_is_named_as_missing() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: distance: missing; expected a length$"):
        FileTable.made("a.toml", {"diameter": "2 mm"}).required("distance", "a length")


def test_a_full_disk_is_an_error_with_file_and_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_atomic(tmp_path / "a.csv", "old")

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomic(tmp_path / "a.csv", "new")
    assert remedy(caught.value) == (f"{tmp_path / 'a.csv'}: No space left on device; the disk is full: make room, or "
                                    "choose a folder on another disk")
    assert (tmp_path / "a.csv").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_what_a_device_does_not_take_is_said_of_it() -> None:
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomic(Path("/dev/full"), "x")
    assert remedy(caught.value).startswith("/dev/full: No space left on device; the disk is full")


def test_what_a_library_wraps_is_known_by_its_number(tmp_path: Path) -> None:
    def failing() -> None:
        with replacing(tmp_path / "run.h5"):
            raise OSError("Can't write data (file write failed: errno = 28, error message = 'No space left on device')")

    with pytest.raises(OSError, match="No space left") as caught:
        failing()
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(tmp_path / "run.h5"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("text", "value"), [("0.5 %", 0.005), ("0.5%", 0.005), ("5 ppm", 5e-6), ("0.005 1", 0.005),
                                             ("0", 0.0), (0, 0.0), ("1e-3 %", 1e-5)])
def test_a_share_has_its_sign(text: object, value: float) -> None:
    assert parse_quantity(text, "share", source="file", field="noise") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("text", "asked"), [("0.5", ': "0.5 %" or "50 %"?'), (0.5, ': "0.5 %" or "50 %"?'),
                                             (5, ': "5 %"?'), ("200", 'such as "0.2 %"'), (-0.5, 'such as "0.2 %"')])
def test_a_share_without_its_sign_is_asked_about(text: object, asked: str) -> None:
    """Half a per cent, or a half? What it proposes can be read."""
    with pytest.raises(InputError) as caught:
        parse_quantity(text, "share", source="file", field="noise")
    assert str(caught.value).endswith(asked)
    for proposed in re.findall(r'"([^"]* %)"', str(caught.value)):
        assert 0.0 < parse_quantity(proposed, "share", source="file", field="noise") < 1.0


@pytest.mark.parametrize(("frequencies", "text"), [
    ((1.9e6,), "1.9 MHz"), ((1e5,), "0.1 MHz"), ((99e3,), "99 kHz"), ((2500.0,), "2.5 kHz"), ((50.0,), "50 Hz"),
    ((0.91e6, 1.155e6), "0.91 to 1.155 MHz"), ((20e3, 2e6), "20 kHz to 2 MHz"), ((0.0, math.inf), "0 Hz to inf MHz"),
    ((1_234_567.891,), "1.23456789 MHz"), ((math.nan,), "nan Hz"),
])
def test_a_frequency_has_a_readable_unit(frequencies: tuple[float, ...], text: str) -> None:
    assert frequency_text(*frequencies) == text


def test_messages_have_no_frequencies_in_plain_hertz() -> None:
    """A number such as 1.9e+06 Hz. Files that are read back, and those of instruments, have exact ones in Hz."""
    exact = {"geometry/plausible.py", "materials/saving.py", "workbench/design/study_folder.py",
             "workbench/instruments/feeltech.py", "workbench/readers/makers.py", "workbench/results/pole.py"}
    root = Path(__file__).parent.parent
    found = {path.relative_to(root).as_posix() for package in ("geometry", "materials", "workbench")
             for path in (root / package).rglob("*.py") if re.search(r"(g|!r)\} Hz", path.read_text(encoding="utf-8"))}
    assert found == exact
