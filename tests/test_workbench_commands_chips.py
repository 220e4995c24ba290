"""The chip files of the package: listed, copied, and never over a file of the user."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.chip import read_chip
from workbench.cli import main
from workbench.commands.chips import SHIPPED


def test_every_shipped_chip_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["chips", "list"]) == 0
    shown = capsys.readouterr().out
    assert all(path.stem in shown for path in SHIPPED.glob("*.toml"))


def test_a_copy_is_the_same_chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["chips", "copy", "glass_channel"]) == 0
    assert main(["chips", "copy", "reference_chip", "-o", str(tmp_path / "mine.toml")]) == 0
    (tmp_path / "folder").mkdir()
    assert main(["chips", "copy", "glass_channel", "-o", "folder"]) == 0
    assert main(["chips", "copy", "glass_channel", "-o", "new/folder/channel.toml"]) == 0
    assert main(["chips", "copy", "glass_channel", "-o", "another/"]) == 0
    assert main(["chips", "copy", "reference_chip", "-o", "another/"]) == 0
    for name, file in (("glass_channel", "glass_channel.toml"), ("reference_chip", "mine.toml"),
                       ("glass_channel", "folder/glass_channel.toml"), ("glass_channel", "new/folder/channel.toml"),
                       ("glass_channel", "another/glass_channel.toml"),
                       ("reference_chip", "another/reference_chip.toml")):
        assert read_chip(tmp_path / file).layers == read_chip(SHIPPED / f"{name}.toml").layers


def test_a_file_stays_and_a_wrong_name_is_answered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text("mine", encoding="utf-8")
    assert main(["chips", "copy", "glass_channel", "-o", str(mine)]) == 2
    assert mine.read_text(encoding="utf-8") == "mine"
    assert main(["chips", "copy", "glass_channel", "-o", str(mine / "folder" / "x.toml")]) == 2
    assert "-o: received" in (message := capsys.readouterr().err)
    assert "expected a file that can be written; a file is in the way" in " ".join(message.split())
    assert main(["chips", "copy", "glas_channel"]) == 2
    assert "glass_channel" in capsys.readouterr().err


def test_a_campaign_is_copied_with_its_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["chips", "copy", "small_campaign"]) == 0
    assert main(["chips", "copy", "small_campaign", "-o", "new/mine"]) == 0
    original = SHIPPED / "small_campaign"
    for name in ("campaign.toml", "chip.toml", "empty.csv", "filled.csv"):
        for copy in ("small_campaign", "new/mine"):
            assert (tmp_path / copy / name).read_bytes() == (original / name).read_bytes()
    capsys.readouterr()
    (tmp_path / "new/mine/chip.toml").write_text("mine", encoding="utf-8")
    assert main(["chips", "copy", "small_campaign"]) == 2
    assert "expected a path that does not exist yet" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "new/mine/chip.toml").read_text(encoding="utf-8") == "mine"
