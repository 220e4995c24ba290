"""Trials of a bare disc that carries a small rigid mass beside its axis, or nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from concealed.angle import Angle
from concealed.attached import Patch, PatchedDisc
from concealed.design import Design, draw, draw_own, random_design
from concealed.detection import COARSE, LOOSE, Bystander
from concealed.device import PZT, State, Values, body, seen, swept
from concealed.fields import random_inhomogeneity
from concealed.folder import write
from concealed.mechanisms import NONE, Effect, conceal
from concealed.response import Device
from concealed.trial import Truth
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ATTACHED_MASS = "attached_mass"

#: Trials in a round, one of them with nothing.
ROUND = 6

DISC = State("disc", "disc")
STATES = (DISC, State("disc_again", "disc", temperature=308.15, drive=5.0, held_out=True))

#: Frequencies (Hz) of the first radial modes, for every other trial; the others have the band of the corpus.
RADIAL_BAND = np.linspace(150e3, 700e3, 401)

#: Relative uncertainty of c12, which sets where the modes of an order lie.
C12 = 0.02

#: Mass (kg), diameter (m) of its patch, and distance from the axis over the largest one, from and to.
MASS, DIAMETER, PLACE = (0.3e-6, 20e-6), (0.8e-3, 1.5e-3), (0.2, 0.95)

#: Discrete orders for one wave around the circle through the patch's centre as long as its radius, over 2 pi: twice as
#: many change the compliance by 5e-4.
ORDERS = 12.0


def mechanisms(seed: int) -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round."""
    rng = np.random.default_rng(seed)
    while True:
        nothing = int(rng.integers(ROUND))
        yield from ((NONE if k == nothing else ATTACHED_MASS,) for k in range(ROUND))


def disc_design(rng: np.random.Generator, *, is_radial: bool) -> Design:
    """A bare disc, for the radial band or that of the thickness resonance."""
    chip = random_design(rng)
    prior = {**chip.prior, f"{PZT}.c12": C12 * chip.nominal[f"{PZT}.c12"]}
    kept = {name: size for name, size in prior.items() if name.startswith((f"{PZT}.", "transducer.", "bench."))}
    return replace(chip, prior=kept, frequency=RADIAL_BAND if is_radial else chip.frequency, tied=(), remounted=False)


def attached_mass(rng: np.random.Generator, truth: Values) -> Effect:
    """A mass at a random place of a disc."""
    mass = math.exp(rng.uniform(*np.log(MASS)))
    diameter = rng.uniform(*DIAMETER)
    distance = rng.uniform(*PLACE) * (truth["transducer.radius"] - 0.5 * diameter)
    return conceal("attached mass", "transducer", "mass", {"patch.distance": distance, "patch.diameter": diameter},
                   told={"mass": mass, "distance": distance, "diameter": diameter}, catalogued=False)


def ratios(device: Device, values: Values, own: dict[str, dict[str, float]], effect: Effect) -> dict[str, Complex]:
    """Impedance (n,) of the disc with its mass over that without it, by state, e^{-i w t}."""
    told, solved = effect.parameters, device.solved(values, effect.defects, DISC)
    cells = 2 * math.ceil(ORDERS * max(1.0, 2.0 * told["distance"] / told["diameter"])) + 1
    disc = PatchedDisc.of(solved.body, solved.cells, Patch(told["distance"], told["diameter"]), Angle(cells),
                          device.design.frequency, order=device.order, uneven=device.uneven)
    return {s.name: disc.impedance_ratio(_asked(device, values, own, s), told["mass"]) for s in STATES}


def _asked(device: Device, values: Values, own: dict[str, dict[str, float]], state: State) -> Real:
    return swept(device.design.moved(values, own[state.name]), {}, state, device.design.frequency)


def spectrum(device: Device, values: Values, own: dict[str, dict[str, float]], defects: Values, state: State,
             ratio: Complex | float) -> Complex:
    """Impedance (n,) as the bench sees it without noise, e^{+j w t}; that of the device itself has another `ratio`."""
    frequency, there = _asked(device, values, own, state), device.design.moved(values, own[state.name])
    impedance = device.solved(there, defects, state).reduced.impedance(frequency) * ratio
    return seen(there, defects, state, frequency, np.conj(impedance))


def make_feature_trial(seed: int, mechanism: tuple[str, ...], folder: Path) -> Truth:
    """Write the campaign of a random disc with a mass on it, or with nothing; odd seeds have the radial band."""
    of_device, of_effects, of_noise, of_states, of_parts = (np.random.default_rng([seed, k]) for k in range(5))
    design = disc_design(of_device, is_radial=bool(seed % 2))
    values, own = draw(of_device, design), draw_own(of_states, design, {s.name: s.filling for s in STATES})
    uneven = random_inhomogeneity(of_parts, body(design.nominal, {}, DISC), float(np.mean(design.frequency)))
    effects, detectability = (), 0.0
    change: dict[str, Complex | float] = dict.fromkeys((s.name for s in STATES), 1.0)
    defects: Values = {}
    with threadpool_limits(limits=1):
        device = Device(design, uneven)
        if mechanism == (ATTACHED_MASS,):
            effect = attached_mass(of_effects, values)
            defects, change = effect.defects, {**ratios(device, values, own, effect)}
            coarse = Device(design, uneven, order=COARSE, tolerance=LOOSE)
            measured = spectrum(coarse, values, own, defects, DISC, change[DISC.name])
            detectability = Bystander(coarse, values, defects, (DISC,), own).detectability({DISC.name: measured})
            effects = (replace(effect, detectability=detectability),)
        spectra = {s.name: spectrum(device, values, own, defects, s, change[s.name]) for s in STATES}
    write(folder, design, STATES, spectra, of_noise)
    return Truth(seed, mechanism, effects, detectability, design.noise, uneven.rms, values,
                 {s.name: own[s.name] for s in STATES})
