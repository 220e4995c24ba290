"""An output folder has one owner: what belongs to the user stays, byte for byte, or the run is refused."""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workbench.files.errors import InputError
from workbench.files.output import MARK, Leftovers, OutputFolder, begin
from workbench.files.ownership import LOCK, MANIFEST, NEW, STATE, Outputs, discard, in_the_way, matches
from workbench.files.writing import remedy, replacing, write_atomic

ROOT = Path(__file__).resolve().parent.parent
OUTPUTS = Outputs("simulate", names=("report.html", "spectrum_*.csv", "points/*", "front/*.toml"), kept=("points/*",))


def hold(path: Path, outputs: Outputs = OUTPUTS, **options: float) -> OutputFolder:
    return begin(path, outputs, source="command line", field="--output", **options)


def contents(folder: Path) -> dict[str, bytes | str]:
    """Every entry below a folder by its path, with its content; the state of the workbench apart."""
    return {path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink() else
            path.read_bytes() if path.is_file() else "folder"
            for path in folder.rglob("*") if STATE not in path.relative_to(folder).parts}


@pytest.mark.parametrize(("name", "is_written"), [
    ("report.html", True), ("spectrum_a.csv", True), ("points/a", True), ("spectrum.csv", False),
    ("a/report.html", False), ("points", False), ("points/a/b", False), ("spectrum_/a.csv", False),
])
def test_a_star_stands_for_part_of_one_name(name: str, is_written: bool) -> None:
    assert matches(name, OUTPUTS.names) == is_written


def test_files_of_the_user_under_names_of_the_run_are_refused_by_name(tmp_path: Path) -> None:
    for name in ("report.html", "spectrum_x.csv", "notes.txt", "points/survey.csv", "front/a.step"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(InputError) as caught:
        hold(tmp_path)
    assert "wrote report.html, spectrum_x.csv, points/survey.csv as they are now: choose" in str(caught.value)
    assert contents(tmp_path) == before
    assert not (tmp_path / STATE).exists()


@pytest.mark.parametrize("name", ["report.html", "points", MARK])
def test_a_link_or_folder_under_a_name_of_the_run_is_refused(name: str, tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    (folder / name).symlink_to(elsewhere)
    with pytest.raises(InputError, match=name):
        hold(folder)
    (folder / name).unlink()
    if name == "points":
        (folder / name).write_text("a file where the run needs a folder")
    else:
        (folder / name).mkdir()
    with pytest.raises(InputError, match=name):
        hold(folder)


def test_a_run_replaces_its_own_files_and_removes_those_it_does_not_make_again(tmp_path: Path) -> None:
    written = ("report.html", "spectrum_a.csv", "points/1", "front/01.toml", "front/02.toml")
    with hold(tmp_path / "out") as folder:
        for name in written:
            write_atomic(folder.path / name, "first")
    (tmp_path / "out/notes.txt").write_text("mine")
    (tmp_path / "out/front/02.toml").write_text("changed by hand")
    with pytest.raises(InputError, match=r"wrote front/02\.toml as it is now: choose another folder, or move it away"):
        hold(tmp_path / "out")
    (tmp_path / "out/front/02.toml").unlink()
    folder = hold(tmp_path / "out")
    write_atomic(folder.path / "report.html", "second")
    assert folder.tidy() == Leftovers(("spectrum_a.csv", "front/01.toml"), ())
    folder.finish(complete=True)
    assert contents(tmp_path / "out") == {"report.html": b"second", "points": "folder", "points/1": b"first",
                                          "notes.txt": b"mine"}
    folder = hold(tmp_path / "out", Outputs("compare", names=("residual.png",)))
    leftovers = folder.tidy()
    folder.finish(complete=True)
    assert str(leftovers) == "report.html, points/1 are of an earlier `workbench simulate`"


def test_every_file_that_a_run_removed_is_named(tmp_path: Path) -> None:
    names = [f"spectrum_{number}.csv" for number in range(20)]
    with hold(tmp_path) as folder:
        for name in names:
            write_atomic(folder.path / name, "first")
    with hold(tmp_path) as folder:
        text = str(folder.tidy())
    assert all(f" {name}," in f"{text} ,".replace(" of an earlier run", ",") for name in names)
    assert "more files" not in text


def test_a_file_that_the_user_puts_there_meanwhile_is_not_replaced_either(tmp_path: Path) -> None:
    with hold(tmp_path) as folder:
        (tmp_path / "report.html").write_text("mine")
        (tmp_path / "undeclared.txt").write_text("mine")
        for name in ("report.html", "undeclared.txt"):
            with pytest.raises(OSError, match="no run of the workbench wrote") as caught:
                write_atomic(folder.path / name, "new")
            assert caught.value.errno == errno.EEXIST
            assert remedy(caught.value).startswith(str(tmp_path / name))
            with pytest.raises(OSError, match="no run of the workbench wrote"):
                discard(folder.path / name)
        (tmp_path / "points").symlink_to(tmp_path.parent)
        with pytest.raises(OSError, match="no run of the workbench wrote"):
            write_atomic(folder.path / "points/1", "new")
    assert contents(tmp_path)["report.html"] == contents(tmp_path)["undeclared.txt"] == b"mine"


def test_a_folder_is_marked_until_its_results_are_complete(tmp_path: Path) -> None:
    folder = hold(tmp_path / "out")
    assert "`workbench simulate` (process" in (folder.path / MARK).read_text()
    assert "not complete" in (folder.path / MARK).read_text()
    folder.finish(complete=False)
    assert not (tmp_path / "out").exists()  # nothing was written: nothing to warn of, and no folder left
    (tmp_path / "mine").mkdir()
    hold(tmp_path / "mine").finish(complete=False)
    assert not list((tmp_path / "mine").iterdir())
    with hold(tmp_path / "empty"):
        pass
    assert (tmp_path / "empty").is_dir()
    folder = hold(tmp_path / "out")
    write_atomic(folder.path / "report.html", "x")
    folder.finish(complete=False)
    assert sorted(contents(folder.path)) == [MARK, "report.html"]
    folder = hold(tmp_path / "out")
    folder.finish(complete=True)
    folder.finish(complete=True)
    assert sorted(contents(folder.path)) == ["report.html"]


@pytest.mark.parametrize("number", [1, 2**22 + 1])
def test_a_refused_run_leaves_the_mark_of_an_interrupted_one(number: int, tmp_path: Path) -> None:
    """Also a mark of the versions without a lock, whose process number may be that of another living process."""
    interrupted = f"{number} is the process that writes the results in this folder.\nThey are not complete.\n"
    (tmp_path / MARK).write_text(interrupted)
    for _ in range(2):
        folder = hold(tmp_path)
        assert f"process {os.getpid()}" in (tmp_path / MARK).read_text()
        folder.finish(complete=False)
        assert (tmp_path / MARK).read_text() == interrupted
    with hold(tmp_path):
        pass
    assert not contents(tmp_path)


def test_a_second_run_is_refused_with_the_process_that_holds_the_folder(tmp_path: Path) -> None:
    with hold(tmp_path) as folder:
        write_atomic(folder.path / "report.html", "first")
        before = contents(tmp_path)
        with pytest.raises(InputError, match=rf"process {os.getpid()} \(workbench simulate, begun 20.*\) holds it"):
            hold(tmp_path, Outputs("study"))
        assert contents(tmp_path) == before
    hold(tmp_path, Outputs("study")).finish(complete=True)


def test_a_damaged_working_file_is_a_runs_own_and_one_that_no_run_began_is_not(tmp_path: Path) -> None:
    outputs = Outputs("study", names=("points/*",), working=("points/*",))
    with hold(tmp_path / "out", outputs) as folder:
        write_atomic(folder.path / "points/1", "first")
    (tmp_path / "out/points/1").write_text("damaged")
    folder = hold(tmp_path / "out", outputs)
    write_atomic(folder.path / "points/1", "made again")
    assert folder.tidy() == Leftovers((), ())
    folder.finish(complete=True)
    (tmp_path / "out/points/2").write_text("mine")
    with pytest.raises(InputError, match="wrote points/2 as it is now"):
        hold(tmp_path / "out", outputs)


def test_what_another_process_writes_is_the_runs_too(tmp_path: Path) -> None:
    with hold(tmp_path / "out") as folder:
        code = ("from pathlib import Path; from workbench.files.writing import write_atomic; "
                f"write_atomic(Path({str(folder.path)!r}, 'report.html'), 'x')")
        subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    with hold(tmp_path / "out"):
        pass  # not refused


KILLED = """
import os, sys
from pathlib import Path
from workbench.files.output import begin
from workbench.files.ownership import Outputs
from workbench.files.writing import replacing, write_atomic
folder = begin(Path(sys.argv[1]), Outputs("simulate", names=("report.html", "spectrum_*.csv")), source="x", field="y")
write_atomic(folder.path / "report.html", "first")
with replacing(folder.path / "spectrum_a.csv") as whole:
    whole.write_text("half")
    os._exit(9)
"""


def test_a_killed_run_leaves_no_half_file_and_the_next_one_clears_up(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert subprocess.run([sys.executable, "-c", KILLED, str(out)], check=False, cwd=ROOT).returncode == 9
    assert sorted(contents(out)) == [MARK, "report.html"]
    assert list((out / STATE).glob(f"{NEW}*"))
    # A file of the user that came after the kill is the user's.
    (out / "spectrum_a.csv").write_text("mine")
    with pytest.raises(InputError, match=r"wrote spectrum_a\.csv as it is now"):
        hold(out)
    (out / "spectrum_a.csv").unlink()
    with hold(out):
        assert not list((out / STATE).glob(f"{NEW}*"))
    assert sorted(contents(out)) == ["report.html"]


@pytest.mark.parametrize("kind", ["link", "file", "other"])
def test_a_state_that_is_not_of_the_workbench_is_refused(kind: str, tmp_path: Path) -> None:
    notes, out = tmp_path / "notes.txt", tmp_path / "out"
    notes.write_text("mine")
    out.mkdir()
    if kind == "file":
        (out / STATE).write_text("mine")
    else:
        (out / STATE).mkdir()
        if kind == "link":
            (out / STATE / LOCK).symlink_to(notes)
        else:
            (out / STATE / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=rf"whose {STATE} is of the workbench; move"):
        hold(out)
    assert notes.read_text() == "mine"


def test_a_lock_that_is_linked_to_a_file_does_not_empty_it(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    (tmp_path / "out" / STATE).mkdir(parents=True)
    os.link(notes, tmp_path / "out" / STATE / LOCK)
    with pytest.raises(InputError, match="is of the workbench"):
        hold(tmp_path / "out")
    (tmp_path / "out" / STATE / LOCK).unlink()
    (tmp_path / "out" / ".lock").symlink_to(notes)
    with hold(tmp_path / "out"):
        pass
    assert notes.read_text() == "mine"


def test_a_manifest_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    out, notes = tmp_path / "out", tmp_path / "notes.txt"
    with hold(out) as folder:
        write_atomic(folder.path / "report.html", "x")
    notes.write_text("x")
    manifest = out / STATE / MANIFEST
    manifest.write_text(manifest.read_text().replace("report.html", "../notes.txt") + "{\"file\": half a line")
    (out / "report.html").unlink()
    folder = hold(out)
    folder.tidy()
    folder.finish(complete=True)
    assert notes.read_text() == "x"


def test_a_file_in_the_way_and_a_disk_without_room_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="a file is in the way"):
            hold(path)
    with pytest.raises(InputError, match=r"a folder on a disk with 1e\+12 MB of room .* make room"):
        hold(tmp_path / "new" / "out", room=1e18)
    assert contents(tmp_path) == {"file": b"x"}


@pytest.mark.parametrize(("number", "words"), [
    (errno.EROFS, "the disk can only be read: choose a folder on another one"),
    (errno.EACCES, "you may not write there"), (errno.ENOSPC, "the disk is full"), (errno.ENOLCK, "No locks available"),
])
def test_a_folder_that_cannot_be_written_to_is_refused_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    def refusing(*_arguments: object, **_named: object) -> None:
        raise OSError(number, os.strerror(number), "x")

    monkeypatch.setattr("workbench.files.output.fcntl.flock", refusing)
    with pytest.raises(InputError, match=words):
        hold(tmp_path / "out")
    assert not contents(tmp_path)


NAMES = st.sampled_from(["report.html", "spectrum_a.csv", "spectrum.csv", "points", "points/a", "points/b", "front",
                         "front/01.toml", "notes.txt", "a/report.html", ".hidden", MARK, STATE, f"{STATE}/{LOCK}",
                         f"{STATE}/{MANIFEST}", ".lock", "points/.DS_Store"])
ENTRIES = st.dictionaries(NAMES, st.sampled_from([b"mine", b"", "link", "folder"]), max_size=6)


def _put(folder: Path, entries: dict[str, bytes | str], target: Path) -> None:
    """Entries of the user, as far as one can stand beside the other."""
    for name, content in sorted(entries.items()):
        path = folder / name
        if not all(each.is_dir() and not each.is_symlink() for each in path.parents if each.exists()):
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(path):
            continue
        if content == "link":
            path.symlink_to(target)
        elif content == "folder":
            path.mkdir()
        else:
            path.write_bytes(content)


def _all(folder: Path) -> dict[str, bytes | str]:
    return {path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink() else
            path.read_bytes() if path.is_file() else "folder" for path in folder.rglob("*")}


def _runs(folder: Path, writes: list[str], ends: str) -> None:
    """A run that writes files and ends well, with an error, or by a kill, after which nothing is settled."""
    held = hold(folder)
    try:
        for name in writes:
            write_atomic(folder / name, f"result {name}")
        with replacing(folder / "report.html") as whole:
            whole.write_text("result")
            if ends == "killed":
                os.close(held._lock)
                raise KeyError
        if ends == "failed":
            raise ValueError
        held.tidy()
        held.finish(complete=True)
    except KeyError:
        pass
    except (ValueError, OSError):
        held.finish(complete=False)


@given(entries=ENTRIES, later=ENTRIES, runs=st.lists(st.tuples(
    st.lists(st.sampled_from(["report.html", "spectrum_a.csv", "points/a", "front/01.toml"]), max_size=3),
    st.sampled_from(["done", "failed", "killed"])), min_size=1, max_size=3))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_files_of_the_user_are_what_they_were_whatever_runs_do(
    tmp_path_factory: pytest.TempPathFactory, entries: dict[str, bytes | str], later: dict[str, bytes | str],
    runs: list[tuple[list[str], str]]
) -> None:
    root = tmp_path_factory.mktemp("user")
    folder, target = root / "out", root / "elsewhere"
    folder.mkdir()
    target.mkdir()
    _put(folder, entries, target)
    theirs = _all(root)
    for number, (writes, ends) in enumerate(runs):
        try:
            _runs(folder, writes, ends)
        except InputError:
            assert number or _all(root) == theirs  # the first refusal touches nothing at all
        here = _all(root)
        # An empty lock or manifest is nobody's; the rest stays.
        assert {name: here.get(name) for name, content in theirs.items()} == theirs
        if number == 0:
            before = set(here)
            _put(folder, later, target)
            theirs |= {name: content for name, content in _all(root).items() if name not in before}


def test_entries_are_looked_for_where_a_pattern_can_lead_only(tmp_path: Path) -> None:
    for name in ("deep/er/report.html", "points/a", "front/a.toml", "front/b.step", ".hidden/report.html"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    walked: list[str] = []

    def walk(top: Path, **options: bool) -> Iterator[tuple[str, list[str], list[str]]]:
        for step in real(top, **options):
            walked.append(Path(step[0]).name)
            yield step

    real = os.walk
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "walk", walk)
        assert list(in_the_way(tmp_path, OUTPUTS.names)) == ["front/a.toml", "points/a"]
    assert walked == [tmp_path.name, "front", "points"]


def test_a_file_behind_a_link_is_not_the_runs_whatever_the_manifest_says(tmp_path: Path) -> None:
    out, precious = tmp_path / "out", tmp_path / "precious"
    precious.mkdir()
    (precious / "notes.txt").write_text("mine")
    with hold(out):
        pass
    (out / "link").symlink_to(precious)
    digest = hashlib.sha256(b"mine").hexdigest()
    with (out / STATE / MANIFEST).open("a") as stream:
        stream.write(f'{{"file": "link/notes.txt", "sha256": "{digest}", "command": "simulate"}}\n')
        stream.write(100_000 * "[" + "\n")
    folder = hold(out)
    assert folder.tidy() == Leftovers((), ())
    folder.finish(complete=True)
    assert (precious / "notes.txt").read_text() == "mine"


def test_an_input_is_neither_replaced_nor_removed(tmp_path: Path) -> None:
    with hold(tmp_path) as folder:
        for name in ("report.html", "spectrum_a.csv"):
            write_atomic(folder.path / name, "a result")
    (tmp_path / "link.csv").symlink_to(tmp_path / "spectrum_a.csv")
    for path in ("spectrum_a.csv", "link.csv"):
        with pytest.raises(InputError, match=rf"reads \S*/{path}, and would write a result under its name"):
            begin(tmp_path, OUTPUTS, source="x", field="y", inputs=[tmp_path / path])
    folder = begin(tmp_path, Outputs("simulate", names=("report.html",)), source="x", field="y",
                   inputs=[tmp_path / "spectrum_a.csv"])
    assert folder.tidy() == Leftovers(("report.html",), ())
    folder.finish(complete=True)
    assert (tmp_path / "spectrum_a.csv").exists()


def test_another_command_leaves_the_mark_of_a_run_that_was_cut_short(tmp_path: Path) -> None:
    folder = hold(tmp_path)
    write_atomic(folder.path / "report.html", "x")
    folder.finish(complete=False)
    mark = (tmp_path / MARK).read_text()
    other = hold(tmp_path, Outputs("export", names=("chip.step",)))
    write_atomic(other.path / "chip.step", "x")
    other.finish(complete=True)
    assert other.has_mark
    assert (tmp_path / MARK).read_text() == mark
    folder = hold(tmp_path)
    folder.finish(complete=True)
    assert not folder.has_mark
    assert not (tmp_path / MARK).exists()


def test_a_mark_that_the_user_has_changed_stays(tmp_path: Path) -> None:
    folder = hold(tmp_path)
    (tmp_path / MARK).write_text("mine")
    folder.finish(complete=True)
    assert folder.has_mark
    assert (tmp_path / MARK).read_text() == "mine"


def test_the_state_of_a_folder_is_no_output_folder(tmp_path: Path) -> None:
    with hold(tmp_path):
        pass
    with pytest.raises(InputError, match="holds the manifest of a run"):
        hold(tmp_path / STATE)
