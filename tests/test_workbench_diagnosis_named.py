"""A strong cause in a chip is named with an interval that holds it, and what there is no time for is said.

The recordings are the model's own, with noise: that the inference stands up to other physics is what
`tests/benchmarks/trials.py` is for. Further strong causes: `tests/benchmarks/strong.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from own_recordings import DISC, PRINTED, any_recordings, conceal
from support import layer_text

from workbench.campaign.campaign import Campaign
from workbench.catalogue.catalogue import effects
from workbench.catalogue.effect import Device
from workbench.diagnosis.appraisal import diagnose
from workbench.model.discretisation import ACCURACY

pytestmark = pytest.mark.slow

#: Springs of a weak bond (m/Pa).
BOND = {"bond at the superstrate.normal_compliance": 4e-13, "bond at the superstrate.tangential_compliance": 1e-12}

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 101)
#: Of Z, for benchmarks: an error of the recordings far below their noise.
FINER = 1e-4

CHIP = DISC + PRINTED + "".join((
    layer_text("bond", "epoxy/trial", thickness="60 um", radius="3 mm", cavity_radius="1.6 mm"),
    layer_text("superstrate", "glass/trial", thickness="0.5 mm", radius="3 mm"),
)) + """
[states.filled]
cavity = "water"
temperature = "25 degC"
"""
CAMPAIGN = """
[states.disc]
chip = "disc.toml"
recording = "disc.csv"
drive = "2 Vpp"

[states.chip]
chip = "chip.toml"
state = "filled"
recording = "chip.csv"
drive = "2 Vpp"

[known]
"pzt/trial.c11" = "1 %"
"pzt/trial.c13" = "1 %"
"pzt/trial.c33" = "1 %"
"pzt/trial.e33" = "1 %"
"pzt/trial.eps33" = "1 %"
"pzt/trial.c33.loss" = "20 %"
"pla/trial.shear_modulus" = "2 %"
"pla/trial.bulk_modulus" = "2 %"
"pla/trial.shear_modulus.loss" = "20 %"
"epoxy/trial.shear_modulus" = "3 %"
"sidewall.thickness" = "0.75 %"
"substrate.thickness" = "0.75 %"
"couplant.thickness" = "3 um"
"""


def concealed(folder: Path, values: Mapping[str, float], accuracy: float = FINER) -> Campaign:
    """The campaign of a chip that is not as stated."""
    files = {"disc.toml": DISC, "chip.toml": CHIP, "campaign.toml": CAMPAIGN}
    return conceal(folder, files, FREQUENCIES, values, accuracy=accuracy)[0]


def test_a_cavity_that_is_higher_than_stated_is_named(tmp_path: Path) -> None:
    """By 4 %, with a tolerance of 0.75 %."""
    found = diagnose(concealed(tmp_path, {"sidewall.thickness": 1.04 * 0.7e-3}, ACCURACY))
    print(f"{found.seconds:.0f} s: {found.headline}")
    (named,) = found.established
    assert named.effect.name == "thickness of the sidewall"
    (told,) = named.estimates
    # A 95 % interval misses one in twenty: here the value need only come within twice its half width.
    assert abs(told.value - 1.04 * 0.7e-3) < told.high - told.low
    # The known parameters explain the recordings too, five of its uncertainties away from what is known of the height.
    assert named.share > 0.9
    assert max(state.reduced for state in found.best) < 1.3


def test_a_joint_narrower_than_any_ring_may_come_off_but_for_a_tenth(tmp_path: Path) -> None:
    narrow = CHIP.replace('cavity_radius = "1.6 mm"', 'cavity_radius = "2.95 mm"')
    files = {"disc.toml": DISC, "chip.toml": narrow, "campaign.toml": CAMPAIGN}
    campaign = any_recordings(tmp_path, files, FREQUENCIES)
    found = effects(Device(campaign.states, campaign.known, campaign.fixed, campaign.registry))
    most = [limit.highest for each in found for name, limit in each.admissible.items() if name.startswith("bond open")]
    assert most == pytest.approx(2 * [0.9 * 0.05 / 3.0])


def test_a_diagnosis_whose_time_is_over_says_what_it_knows_and_what_it_did_not_look_at(tmp_path: Path) -> None:
    """A bond so weak that the known parameters leave half of Z: no time for any hypothesis but nothing."""
    found = diagnose(concealed(tmp_path, BOND, ACCURACY), minutes=1e-3)
    print(f"{found.seconds:.0f} s: {found.headline}")
    assert (found.verdict, found.found.interrupted) == ("not_finished", False)
    assert found.headline.startswith("Not finished: none of the ")
    assert "still to be looked at: " in found.headline
    assert "hypotheses of any size" in found.headline
    assert not found.established
    assert len(found.base) == len(found.states)
