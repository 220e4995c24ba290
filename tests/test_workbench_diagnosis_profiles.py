"""Chips with profiles are diagnosed as others are; what does not fit a layer's shape is left out and named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from own_recordings import DISC, PRINTED, any_recordings, conceal
from support import layer_text

from workbench.catalogue.catalogue import effects_and_others
from workbench.catalogue.effect import Device
from workbench.diagnosis.appraisal import diagnose
from workbench.model.discretisation import ACCURACY

pytest.importorskip("cadquery")
pytestmark = pytest.mark.slow

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 61)

#: A lid of glass with a shallow cone below, on a printed wall.
CHIP = DISC + PRINTED + layer_text("superstrate", "glass/trial", thickness="0.5 mm", radius="3 mm") + """
[layers.profile]
parameters = { hollow = "0.05 mm", rim = "1.6 mm" }
points = [["0 mm", "hollow"], ["rim", "0 mm"], ["radius", "0 mm"], ["radius", "thickness"], ["0 mm", "thickness"]]

[states.filled]
cavity = "water"
temperature = "25 degC"
"""
CAMPAIGN = """
[states.chip]
chip = "chip.toml"
state = "filled"
recording = "chip.csv"
drive = "2 Vpp"

[known]
"pzt/trial.c33" = "1 %"
"pla/trial.shear_modulus" = "2 %"
"pla/trial.shear_modulus.loss" = "20 %"
"couplant.thickness" = "3 um"
"superstrate.hollow" = "1 um"
"""
FILES = {"chip.toml": CHIP, "campaign.toml": CAMPAIGN}


def test_a_gel_that_is_half_again_as_thick_is_named(tmp_path: Path) -> None:
    """Ten of its uncertainties, further than a mesh could be moved at one go."""
    campaign, _ = conceal(tmp_path, FILES, FREQUENCIES, {"couplant.thickness": 90e-6}, accuracy=ACCURACY)
    found = diagnose(campaign)
    print(f"{found.seconds:.0f} s: {found.headline}")
    (named,) = found.established
    assert named.effect.name == "thickness of the couplant"
    (told,) = named.estimates
    assert abs(told.value - 90e-6) < told.high - told.low
    assert max(state.reduced for state in found.best) < 1.4
    (left_out,) = (text for text in found.findings if text.startswith("Not looked at: "))
    assert ("superstrate bonded on a part of its radius, because it acts on a part of the superstrate, whose outline "
            "is a profile") in left_out


def test_what_acts_on_a_part_of_a_profile_is_left_out(tmp_path: Path) -> None:
    campaign = any_recordings(tmp_path, FILES, FREQUENCIES)
    found, others = effects_and_others(Device(campaign.states, campaign.known, campaign.fixed, campaign.registry))
    assert [text.split(",")[0] for text in others] == [
        "cavity not full", "cavity filled up to a height", "bubble under the lid",
        "superstrate bonded on a part of its radius", "superstrate loose around the cavity"]
    names = {effect.name for effect in found}
    assert {"hollow of the superstrate", "thickness of the couplant", "couplant missing at its rim"} <= names
    assert not names & {text.split(",")[0] for text in others}
