"""Check that each recording is assigned to the right state."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from workbench.campaign.campaign import Campaign
from workbench.campaign.state import DeviceState, StateFit
from workbench.files.errors import InputError
from workbench.fitting.measurement_model import log_ratio, rms

#: Two recordings count as exchanged if exchanging them reduces the rms residual of both states below this share.
EXCHANGED = 0.5

#: Two states are compared if their overlap is at least this share of either band.
OVERLAP = 0.8


def check_assignment(campaign: Campaign, stated: Sequence[StateFit]) -> None:
    """Raise if two recordings fit far better when they are exchanged.

    Args:
        campaign: its states with their recordings.
        stated: the fit of each state to the recording that the campaign assigns to it.

    Raises:
        InputError: two are exchanged; it gives the residuals of both states, as stated and exchanged.
    """
    recordings = [each for each in zip(campaign.fitted, stated, strict=True) if each[0].observation is None]
    for one, other in itertools.combinations(recordings, 2):
        # Residuals in the recording of `other` and in that of `one`.
        crossed = _rms(*one, other[0]), _rms(*other, one[0])
        if crossed[0] < EXCHANGED * other[1].rms and crossed[1] < EXCHANGED * one[1].rms:
            a, b = one[0].name, other[0].name
            raise InputError(
                campaign.file, f"states.{a}.recording", f"the one that states.{b} should have, it seems",
                f"recordings that are not exchanged: ln(Z / Z_measured) has an rms of {one[1].rms:.2g} in {a} and "
                f"{other[1].rms:.2g} in {b} as stated, but of {crossed[1]:.2g} and {crossed[0]:.2g} with the two "
                "exchanged")


def _rms(state: DeviceState, fit: StateFit, other: DeviceState) -> float:
    """Rms of ln(Z / Z_measured) in another recording; infinite for different bands."""
    own, there = state.measured.frequency, other.measured.frequency
    low, high = max(own[0], there[0]), min(own[-1], there[-1])
    if high - low < OVERLAP * max(own[-1] - own[0], there[-1] - there[0]):
        return float(np.inf)
    inside = (there >= low) & (there <= high)
    predicted = np.interp(there[inside], own, fit.impedance)
    return rms(log_ratio(predicted, other.measured.impedance[inside]))
