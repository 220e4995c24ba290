"""Whether the recordings of a campaign belong to their states and to one device, and what is in order alone."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.campaign import Campaign, DeviceState
from workbench.diagnosis.device import Model
from workbench.diagnosis.refit import Refit, StateFit, base_fit
from workbench.files.errors import InputError
from workbench.fitting.seen import log_ratio

Real = NDArray[np.float64]

#: Two recordings are exchanged where that leaves less than this share of the rms residual of either state.
EXCHANGED = 0.5

#: States are compared where their frequencies overlap by this share of either band.
OVERLAP = 0.8


def check_assignment(campaign: Campaign, stated: Sequence[StateFit]) -> None:
    """Refuse recordings that fit far better with the states of the two exchanged; `stated` are the states as stated.

    Raises:
        InputError: two are exchanged; it gives what both states leave, and what is left by exchanging them.
    """
    for one, other in itertools.combinations(zip(campaign.fitted, stated, strict=True), 2):
        # Of the recording of `other`, and of that of `one`.
        crossed = _rms(*one, other[0]), _rms(*other, one[0])
        if crossed[0] < EXCHANGED * other[1].rms and crossed[1] < EXCHANGED * one[1].rms:
            a, b = one[0].name, other[0].name
            raise InputError(
                campaign.file, f"states.{a}.recording", f"the one that states.{b} should have, it seems",
                f"recordings that are not exchanged: ln(Z / Z_measured) has an rms of {one[1].rms:.2g} in {a} and "
                f"{other[1].rms:.2g} in {b} as stated, but of {crossed[1]:.2g} and {crossed[0]:.2g} with the two "
                "exchanged")


def _rms(state: DeviceState, fit: StateFit, other: DeviceState) -> float:
    """Rms of ln(Z / Z_measured) of a state's prediction and another's recording; infinite where bands differ."""
    own, there = state.measured.frequency, other.measured.frequency
    low, high = max(own[0], there[0]), min(own[-1], there[-1])
    if high - low < OVERLAP * max(own[-1] - own[0], there[-1] - there[0]):
        return float(np.inf)
    inside = (there >= low) & (there <= high)
    predicted = np.interp(there[inside], own, fit.impedance)
    return float(np.sqrt(np.mean(np.abs(log_ratio(predicted, other.measured.impedance[inside])) ** 2)))


def cleared(model: Model) -> tuple[frozenset[str], Real | None]:
    """Regions of the chip files that lack regions of others, and whose states the known parameters explain alone.

    What is missing, if it is much, sits elsewhere: a free disc shows most of what a transducer may be.

    Returns:
        the regions, and the parameters (p,) that explain the largest of those chip files, None where there is none.
    """
    groups = [(states, frozenset(region for state in states for region in state.materials))
              for states in _by_chip(model).values()]
    device = frozenset().union(*(regions for _, regions in groups))
    alone = [(regions, _alone(model, states)) for states, regions in groups if regions < device]
    good = sorted(((regions, fit.x) for regions, fit in alone if fit.good), key=lambda each: len(each[0]))
    return frozenset().union(*(regions for regions, _ in good)), good[-1][1] if good else None


def each_alone(model: Model, base: Refit) -> str:
    """What it means where the known parameters explain the states of every chip file alone, but not all together.

    Empty where they do not, or explain all together, or where there is only one chip file.
    """
    groups = _by_chip(model)
    if base.good or len(groups) < 2:
        return ""
    left = []
    for states in groups.values():
        fit = _alone(model, states)
        if not fit.good:
            return ""
        left.append(f"{' and '.join(state.name for state in states)} ({fit.reduced:.3g})")
    return (f"The known parameters explain {', and '.join(left)} each alone, but not together ({base.reduced:.3g}): "
            "these may be recordings of different devices, or something changed between them.")


def _by_chip(model: Model) -> dict[str, list[DeviceState]]:
    """The fitted states of every chip file."""
    groups: dict[str, list[DeviceState]] = {}
    for state in model.campaign.fitted:
        groups.setdefault(state.chip.file, []).append(state)
    return groups


def _alone(model: Model, states: Sequence[DeviceState]) -> Refit:
    """The known parameters fitted to some states alone."""
    return base_fit(replace(model, campaign=replace(model.campaign, states=tuple(states)),
                            fitted=model.fitted.of([state.name for state in states]).apart(), held_out=None))[1]
