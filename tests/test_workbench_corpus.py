"""The corpus of trials: its files, and the diagnosis of a few small ones.

All of them: `tests/benchmarks/trials.py run tests/corpus`.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from concealed import commitment, scoring
from concealed.mechanisms import CATALOGUED, MECHANISMS, OUTSIDE
from concealed.tasks import TRUTH, diagnose_one

from workbench.campaign.campaign import read_campaign

CORPUS = Path(__file__).parent / "corpus"
TRIALS = sorted(path.parent for path in CORPUS.glob("*/campaign.toml"))
TRUTHS: dict[str, dict[str, Any]] = json.loads((CORPUS / TRUTH).read_text(encoding="utf-8"))

#: Trials whose truth is not published; each has a salted hash of it.
UNLABELLED = CORPUS / "unlabelled"

#: Trials that are diagnosed here, with nothing, an effect below detection and a detectable one: states kept (all five
#: or six take up to four minutes), verdict, effects named, and largest reduced chi-square of the held-out state. They
#: take 21, 18 and 60 s of processor time, and had 1.15, 1.73 and 1.03.
SMALL = {
    "0013": ("disc filled filled_again", "parameters_explain", "", 1.3),
    "0142": ("disc filled filled_again", "parameters_explain", "", 2.0),
    "0047": ("disc filled filled_again", "missing_physics", "fluid absorption", 1.3),
}


def test_every_trial_has_a_truth_and_a_part() -> None:
    assert [trial.name for trial in TRIALS] == list(TRUTHS) == [f"{number:04d}" for number in range(155)]
    assert [truth["part"] for truth in TRUTHS.values()] == ["old"] * 75 + ["seen"] * 5 + ["fresh"] * 75
    assert all(math.isfinite(truth["detectability"]) for truth in TRUTHS.values())
    newer = [tuple(truth["mechanism"]) for truth in TRUTHS.values() if truth["part"] != "old"]
    assert {name for (name, *others) in newer if not others} == {*CATALOGUED, *OUTSIDE, "none"}
    assert sum(path.stat().st_size for path in CORPUS.rglob("*") if path.is_file()) < 8e6


def test_folders_tell_nothing_but_by_their_recordings() -> None:
    words = {*MECHANISMS, "seed", "truth", "conceal"} - {"none"}
    for path in [*CORPUS.glob("*/*.toml"), *UNLABELLED.glob("*/*.toml")]:
        text = path.read_text(encoding="utf-8")
        assert not any(word in text for word in words), path


def test_unlabelled_trials_have_hashes_and_no_truth() -> None:
    hashes = json.loads((UNLABELLED / commitment.HASHES).read_text(encoding="utf-8"))
    assert sorted(hashes) == sorted(path.parent.name for path in UNLABELLED.glob("*/campaign.toml"))
    assert all(re.fullmatch("[0-9a-f]{64}", each) for each in hashes.values())
    assert len(hashes) >= 6
    assert not hashes.keys() & TRUTHS.keys()
    assert not (UNLABELLED / TRUTH).exists()
    assert sum(path.stat().st_size for path in UNLABELLED.rglob("*") if path.is_file()) < 5e5
    for name in hashes:
        campaign = read_campaign(UNLABELLED / name / "campaign.toml")
        assert [state.name for state in campaign.held_out] == ["filled_again"]


def test_a_sealed_truth_is_checked_entry_by_entry(tmp_path: Path) -> None:
    folder, truth = tmp_path / "new", tmp_path / "kept.json"
    folder.mkdir()
    shown = {name: TRUTHS[name] for name in ("0012", "0013")}
    (folder / TRUTH).write_text(json.dumps(shown), encoding="utf-8")
    commitment.seal(folder, truth)
    assert not (folder / TRUTH).exists()
    assert commitment.contradictions(folder, truth) == []
    entries = json.loads(truth.read_text(encoding="utf-8"))
    assert len({entry.pop("salt") for entry in entries.values()}) == 2
    assert entries == shown
    with pytest.raises(FileExistsError, match="other salts"):
        commitment.seal(folder, truth)
    changed = json.loads(truth.read_text(encoding="utf-8"))
    changed["0013"]["mechanism"] = ["lid_bow"]
    truth.write_text(json.dumps({"0013": changed["0013"]}), encoding="utf-8")
    assert commitment.contradictions(folder, truth) == ["0012", "0013"]


@pytest.mark.parametrize("trial", TRIALS[::15], ids=lambda trial: trial.name)
def test_a_recording_has_the_noise_that_the_campaign_states(trial: Path) -> None:
    campaign, noise = read_campaign(trial / "campaign.toml"), TRUTHS[trial.name]["noise"]
    assert [state.name for state in campaign.held_out] == ["filled_again"]
    assert all(state.noise == pytest.approx(noise) for state in campaign.recorded)
    # Third differences of white noise have 20 times its variance, of 300 or 600 numbers; the sharp resonances of a
    # bare disc add to them.
    thirds = (np.diff(np.log(state.measured.impedance), 3) for state in campaign.recorded)
    scatter = min(np.median(np.abs([third.real, third.imag])) / 0.6745 / math.sqrt(20.0) for third in thirds)
    assert scatter == pytest.approx(noise, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("number", SMALL)
def test_a_small_trial_is_diagnosed(number: str, tmp_path: Path) -> None:
    states, verdict, said, held_out = SMALL[number]
    shutil.copytree(CORPUS / number, tmp_path / number)
    campaign = tmp_path / number / "campaign.toml"
    text = campaign.read_text(encoding="utf-8")
    for state in set(re.findall(r"\[states\.(\w+)\]", text)) - set(states.split()):
        text = re.sub(rf"\[states\.{state}\].*?(?=\[)", "", text, flags=re.DOTALL)
    campaign.write_text(text, encoding="utf-8")
    found = scoring.outcome(number, TRUTHS[number], {
        **diagnose_one(campaign.parent), "cpu_seconds": 0.0, "wall_seconds": 0.0}, "")
    assert (found.verdict, found.said) == (verdict, said)
    assert found.region or not said
    assert found.held_out < held_out
