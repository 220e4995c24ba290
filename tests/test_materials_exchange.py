"""Materials in one file: exported, imported elsewhere, refused where they would change something."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from materials import (
    Fit,
    Imported,
    Material,
    RecordingSource,
    Registry,
    WithdrawnWarning,
    export_entries,
    fitted,
    import_entries,
    save_fit,
    withdraw,
)
from workbench.files.errors import InputError

FIT = Fit(
    recordings=(RecordingSource("disc.csv", "0" * 64, "disc.toml"),), algorithm="joint", software="x 1",
    date="2026-11-21T14:40:00+00:00", band=(910e3, 1155e3), mape_percent=0.41, rms_log_residual=0.005, confidence=0.95,
    free=("c33",), notes=("gemessen in Zürich",),
)  # fmt: skip


def _found(mape_percent: float) -> Material:
    return fitted(Registry().load("pzt5a/erturk_2011"), {}, fit=replace(FIT, mape_percent=mape_percent))


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    """A folder with two versions, the first one withdrawn."""
    folder = tmp_path / "ours"
    for mape_percent in (1.0, 2.0):
        save_fit(_found(mape_percent), "pzt4/disc_7", folder=folder)
    withdraw(Registry((folder,)), "pzt4/disc_7@1", reason="slipped", date="2026-11-22")
    return folder


def _exported(ours: Path, *names: str) -> Path:
    path = ours.parent / "out" / "discs.json"
    export_entries(Registry((ours,)), names or ("pzt4/disc_7@1", "pzt4/disc_7"), path=path)
    return path


def test_what_is_imported_is_what_was_exported_to_the_letter(ours: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    path = _exported(ours)
    both = (Imported("pzt4/disc_7@1", True), Imported("pzt4/disc_7@2", True))
    assert import_entries(path, folder=theirs) == both
    assert {p.relative_to(theirs): p.read_bytes() for p in theirs.rglob("*.*")} == {
        p.relative_to(ours): p.read_bytes() for p in ours.rglob("*.*")}
    registry = Registry((theirs,))
    assert registry.load("pzt4/disc_7").fit == replace(FIT, mape_percent=2.0, density=_found(2.0).density)
    with pytest.warns(WithdrawnWarning, match="slipped"):
        registry.load("pzt4/disc_7@1")
    # Once more changes nothing.
    before = {p: p.stat().st_mtime_ns for p in theirs.rglob("*.*")}
    assert import_entries(path, folder=theirs) == tuple(Imported(entry.name, False) for entry in both)
    assert {p: p.stat().st_mtime_ns for p in theirs.rglob("*.*")} == before
    # And the next fit goes on from there.
    assert save_fit(_found(3.0), "pzt4/disc_7", folder=theirs) == "pzt4/disc_7@3"


def test_a_name_means_in_an_export_what_it_means_elsewhere(ours: Path) -> None:
    path = ours.parent / "one.json"
    assert export_entries(Registry((ours,)), ["pzt4/disc_7", "pzt4/disc_7@2"], path=path) == ("pzt4/disc_7@2",)


def test_a_withdrawal_follows_an_entry_that_is_there_already(ours: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    import_entries(_exported(ours), folder=theirs)
    withdraw(Registry((ours,)), "pzt4/disc_7@2", reason="slipped too", date="2026-11-23")
    import_entries(_exported(ours, "pzt4/disc_7@2"), folder=theirs)
    with pytest.warns(WithdrawnWarning, match="slipped too"):
        Registry((theirs,)).load("pzt4/disc_7@2")


def test_entries_written_by_hand_keep_their_line_ends(tmp_path: Path) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    (ours / "liquid").mkdir(parents=True)
    (ours / "liquid" / "mine.toml").write_bytes(
        b'kind = "fluid"\r\ntitle = "x"\r\nsource = "iapws_2011"\r\nconditions = "y"\r\n'
        b'density = { value = 1.0, unit = "g/cm^3" }\r\nsound_speed = { value = 1500.0, unit = "m/s" }\r\n')
    export_entries(Registry((ours,)), ["liquid"], path=tmp_path / "one.json")
    assert import_entries(tmp_path / "one.json", folder=theirs) == (Imported("liquid/mine", True),)
    assert (theirs / "liquid" / "mine.toml").read_bytes() == (ours / "liquid" / "mine.toml").read_bytes()


def test_another_content_under_a_name_is_refused_and_nothing_is_imported(ours: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    # The second entry of the file is the one in the way.
    save_fit(_found(9.0), "pzt4/disc_7", folder=theirs)
    path = theirs / "pzt4" / "disc_7@1.toml"
    path.rename(path.with_name("disc_7@2.toml"))
    before = {p: p.read_bytes() for p in theirs.rglob("*.toml")}
    with pytest.raises(InputError, match=r"discs\.json: pzt4/disc_7@2: received 'content .*never overwritten"):
        import_entries(_exported(ours), folder=theirs)
    assert {p: p.read_bytes() for p in theirs.rglob("*.toml")} == before


def _entry(change: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], object]:
    return lambda data: change(data["entries"][0])


def _rewritten(entry: dict[str, Any], old: str, new: str) -> None:
    """Changed with its digest: as somebody would who knows how."""
    import hashlib

    assert old in entry["content"]
    entry["content"] = entry["content"].replace(old, new)
    entry["sha256"] = hashlib.sha256(entry["content"].encode()).hexdigest()


@pytest.mark.parametrize(("change", "message"), [
    (lambda d: d.update(format="else"), "format: received 'else'"),
    (lambda d: d.update(entries=3), "entries: received 3"),
    (lambda d: d["entries"].append("x"), r"entries\[2\]: received 'x'"),
    (_entry(lambda e: e.update(content=e["content"] + "#")), r"entries\[0\]\.sha256.*pzt4/disc_7@1 was changed"),
    (_entry(lambda e: e.update(content="\ud800")), "was changed"),
    (_entry(lambda e: e.pop("sha256")), r"entries\[0\]\.sha256: missing"),
    (_entry(lambda e: e.update(name="../../disc@1")), r"name: received '\.\./\.\./disc@1'|material/name in letters"),
    (_entry(lambda e: e.update(name="pzt4/..")), "material/name in letters"),
    (_entry(lambda e: e.update(name="pla/acevedo_2026")), "a name that the package does not have"),
    (_entry(lambda e: e.update(withdrawal=1)), "withdrawal: received 1"),
    (_entry(lambda e: e["withdrawal"].pop("reason")), r"withdrawal\.reason: missing"),
    (_entry(lambda e: _rewritten(e, "[fit]", "[fit")), r"pzt4/disc_7@1: received .*line \d+.*valid TOML"),
    (_entry(lambda e: _rewritten(e, "mape_percent = 1", "mape_percent = -1")), r"disc_7@1: fit\.mape_percent.*-1\.0"),
    (_entry(lambda e: _rewritten(e, '"erturk_2011"', '"unheard_of"')), r"'unheard_of'; expected a key of references"),
])  # fmt: skip
def test_a_faulty_file_is_refused_whole(
    change: Callable[[dict[str, Any]], object], message: str, ours: Path, tmp_path: Path
) -> None:
    path = _exported(ours)
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        import_entries(path, folder=tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()
    assert not (tmp_path / "disc@1.toml").exists()


def test_a_truncated_file_is_named_with_its_line(ours: Path, tmp_path: Path) -> None:
    path = _exported(ours)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"discs\.json: JSON syntax: received .*line \d+ column \d+"):
        import_entries(path, folder=tmp_path / "theirs")
    with pytest.raises(InputError, match="an existing file"):
        import_entries(tmp_path / "none.json", folder=tmp_path)
    with pytest.raises(InputError, match="a readable text file"):
        import_entries(tmp_path, folder=tmp_path)


def test_what_is_not_exported(ours: Path, tmp_path: Path) -> None:
    registry = Registry((ours,))
    with pytest.raises(InputError, match=r"pla/acevedo_2026.*every installation has this one"):
        export_entries(registry, ["pla"], path=tmp_path / "x.json")
    with pytest.raises(InputError, match="'pzt4/disc_8'"):
        export_entries(registry, ["pzt4/disc_7", "pzt4/disc_8"], path=tmp_path / "x.json")
    (ours / "pzt4" / "disc_7@2.toml").write_text("kind = 1")
    with pytest.raises(InputError, match=r"disc_7@2\.toml, line 1: kind"):
        export_entries(registry, ["pzt4/disc_7"], path=tmp_path / "x.json")
    assert not (tmp_path / "x.json").exists()
