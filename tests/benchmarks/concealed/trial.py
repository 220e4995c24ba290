"""One trial: a folder with a campaign as somebody at a bench would have it, and the truth, which is only returned."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from concealed.design import draw, draw_own, random_design
from concealed.detection import COARSE, LOOSE, hidden, measured
from concealed.device import DRIVES, FILLINGS, STATES, State, body
from concealed.fields import random_inhomogeneity
from concealed.folder import write
from concealed.mechanisms import DRAWS, NONE, Draw, Effect
from concealed.response import Device
from threadpoolctl import threadpool_limits

#: In how many campaigns the filled chip is measured at two drives instead of the empty and the filled one.
AT_TWO_DRIVES = 1.0 / 3.0


@dataclass(frozen=True)
class Truth:
    """What is hidden in a trial. ``detectability`` is that of all effects together, in standard deviations: the change
    of ln Z over the fitted states that nothing unknown can imitate (:mod:`detection`). ``values`` are the true numbers
    that all states share, ``own`` what every state has on top of them, ``inhomogeneity`` the rms of its fields."""

    seed: int
    mechanism: tuple[str, ...]
    effects: tuple[Effect, ...]
    detectability: float
    noise: float
    inhomogeneity: float
    values: Mapping[str, float]
    own: Mapping[str, Mapping[str, float]]

    def to_dict(self) -> dict[str, Any]:
        """As JSON would have it."""
        found = dataclasses.asdict(self)
        for effect in found["effects"]:
            del effect["values"], effect["defects"]
        return found


def states_of(
    rng: np.random.Generator, chosen: tuple[str, ...], at_two_drives: float = AT_TWO_DRIVES
) -> tuple[State, ...]:
    """The states that are measured: with the probability `at_two_drives` filled at two drives, and where a campaign
    would be blind to what is chosen."""
    by_drive = bool(rng.random() < at_two_drives)
    if "softening" in chosen:
        return DRIVES
    # What a polymer has taken up is told from wrong constants by the chip before it was filled.
    return DRIVES if by_drive and "water_uptake" not in chosen else FILLINGS


def make_trial(
    seed: int, mechanism: str | tuple[str, ...], folder: Path, *, points: int = 321,
    draws: Mapping[str, Draw] = DRAWS, at_two_drives: float = AT_TWO_DRIVES,
) -> Truth:
    """Write the campaign of a random device with `mechanism` (a name of `draws`, or several) hidden in it.

    Raises:
        ValueError: no such mechanism.
    """
    chosen = (mechanism,) if isinstance(mechanism, str) else tuple(mechanism)
    for name in chosen:
        if name not in (NONE, *draws):
            raise ValueError(f"mechanism {name!r} is not one of {', '.join((NONE, *draws))}")
    # A seed is one device with one noise, whatever is hidden in it.
    of_device, of_effects, of_noise, of_states, of_parts = (np.random.default_rng([seed, k]) for k in range(5))
    design = random_design(of_device, points=points)
    plain, own = draw(of_device, design), draw_own(of_states, design, {s.name: s.filling for s in STATES})
    states = states_of(of_states, chosen, at_two_drives)
    effects = tuple(draws[name](of_effects, design, plain) for name in chosen if name != NONE)
    chip = next(s for s in STATES if s.filling == "empty")
    uneven = random_inhomogeneity(of_parts, body(design.nominal, {}, chip), float(np.mean(design.frequency)))
    with threadpool_limits(limits=1):
        device = Device(design, uneven)
        values, defects = hidden(plain, effects)
        spectra = {s.name: device.spectrum(design.moved(values, own[s.name]), defects, s) for s in states}
        coarse = Device(design, uneven, order=COARSE, tolerance=LOOSE)
        effects, total = measured(coarse, plain, effects, states, own)
    write(folder, design, states, spectra, of_noise)
    return Truth(seed, chosen, effects, total, design.noise, uneven.rms, values, {s.name: own[s.name] for s in states})
