"""A diagnosis from the campaign to its report, on recordings made with another code (trial 0000)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from workbench.commands.diagnosis_report import write_diagnosis_report
from workbench.diagnosis.appraisal import diagnose
from workbench.diagnosis.campaign import read_campaign
from workbench.diagnosis.record import contributions, record

pytestmark = pytest.mark.slow

TRIAL = Path(__file__).parent / "data" / "trials" / "0000"


def test_softening_is_found_and_said(tmp_path: Path) -> None:
    found = diagnose(read_campaign(TRIAL / "campaign.toml"))
    truth = json.loads((TRIAL / "truth.json").read_text())["effects"][0]
    told = record(found)
    assert told["verdict"] == "missing_physics"
    (effect,) = told["effects"]
    assert (effect["name"], effect["region"], effect["admissible"]) == ("softening with the drive", "transducer", True)
    # What is left is noise to a per cent of its square; of 0.035^2 that is less than a hundredth of the mismatch.
    assert effect["share"] > 0.97
    assert found.headline.startswith("Softening with the drive: softening 0.00027")
    # The truth is that of the largest drive, 8 Vpp.
    softening, true = effect["parameters"]["pzt/trial.softening"], truth["parameters"]["softening.stiffness"] / 4.0**2
    assert softening["low"] < true < softening["high"]
    # As stated resonances are elsewhere; what was found predicts the state held out to noise.
    (held,) = told["held_out"].values()
    assert held["before"]["reduced_chi_square"] > 1.5
    assert held["after"]["reduced_chi_square"] < 1.2
    assert told["before"]["disc"]["rms_log_residual"] > 0.5
    assert 0.0085 < found.left.rms < 0.0105
    assert told["scores"][0]["effect"] == "softening with the drive"
    known = contributions(found)
    assert {row.effect for row in known} >= {"viscous boundary layer", "absorption of the fluid"}
    page = write_diagnosis_report(found, known, tmp_path).read_text()
    assert page.count("data:image/png") == 3
    assert "10^" in page  # odds
