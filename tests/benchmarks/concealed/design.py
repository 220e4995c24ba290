"""Random chip designs: what the files say, how sure that is, and the true numbers drawn from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from concealed.device import EPOXY, GEL, GLASS, PIEZO_CONSTANTS, PLA, PZT, REFERENCE_TEMPERATURE, WATER, water
from numpy.typing import NDArray

#: Relative standard uncertainty of what is free, by name.
RELATIVE: Mapping[str, float] = {
    **{f"{PZT}.{name}": size for name, size in (
        ("density", 0.002), ("c11", 0.015), ("c13", 0.02), ("c33", 0.015), ("c44", 0.02), ("e33", 0.015),
        ("e15", 0.03), ("eps33", 0.015), ("c11.loss", 0.3), ("c33.loss", 0.3), ("eps33.loss", 0.2))},
    **{f"{PLA}.{name}": size for name, size in (
        ("density", 0.005), ("bulk_modulus", 0.03), ("shear_modulus", 0.03), ("bulk_modulus.loss", 0.2),
        ("shear_modulus.loss", 0.2))},
    **{f"{EPOXY}.{name}": size for name, size in (
        ("bulk_modulus", 0.03), ("shear_modulus", 0.03), ("shear_modulus.loss", 0.2))},
    **{f"{GLASS}.{name}": 0.02 for name in ("bulk_modulus", "shear_modulus")},
    f"{WATER}.sound_speed": 0.002,
    "transducer.thickness": 0.0025, "transducer.radius": 0.001, "substrate.thickness": 0.0075,
    "sidewall.thickness": 0.0075, "superstrate.thickness": 0.005, "cavity.radius": 0.003,
}

#: Absolute standard uncertainty (SI) and the unit it is written in.
ABSOLUTE: Mapping[str, tuple[float, str]] = {
    "couplant.thickness": (3e-6, "m"), "bond.thickness": (4e-6, "m"),
    "bench.series_resistance": (0.05, "ohm"), "bench.series_inductance": (2e-8, "H"),
    "bench.parallel_capacitance": (5e-13, "F"), "bench.gain": (0.005, "1"), "bench.phase": (0.0087, "rad"),
    "bench.delay": (5e-10, "s"),
}


#: Standard deviations (SI) by which states differ, on top of what they share: every bench has these.
BETWEEN: Mapping[str, float] = {"bench.gain": 0.002, "bench.series_resistance": 0.02, "bench.clock": 5e-6}

#: The gel below a chip, where it is mounted anew for every state: in how many devices, and by which share of its
#: thickness the states then differ.
REMOUNTED, REMOUNTED_BY = 0.3, 0.1

#: In how many devices the couplant ends where the transducer does, and in how many the chip does.
FLUSH_COUPLANT, FLUSH_CHIP = 0.25, 0.2

#: Least thickness (m) of the wall beside the cavity above the transducer: grids have lines at every radius.
WALL = 0.7e-3

COUPLANT, SUBSTRATE, TRANSDUCER = "couplant.radius", "substrate.radius", "transducer.radius"


@dataclass(frozen=True)
class Design:
    """``nominal`` numbers as the files state them, ``prior`` standard uncertainties (SI) of those that are free, the
    ``frequency`` (n,) Hz of the recordings and the relative ``noise`` of a point; ``tied`` are the names of lengths
    that are one with the transducer's radius, ``remounted`` tells whether every state has a gel of its own."""

    nominal: Mapping[str, float]
    prior: Mapping[str, float]
    frequency: NDArray[np.float64]
    noise: float
    tied: tuple[str, ...] = ()
    remounted: bool = False

    def moved(self, values: Mapping[str, float], by: Mapping[str, float]) -> dict[str, float]:
        """Values some of which are moved by so much (SI), with what is one with them."""
        return {**values, **{name: values.get(name, 0.0) + shift for name, shift in by.items()},
                **{name: values[name] + by[TRANSDUCER] for name in self.tied if TRANSDUCER in by}}

    def between(self, filling: str) -> dict[str, float]:
        """Standard deviations (SI) of what a state of that filling has of its own."""
        gel = REMOUNTED_BY * self.nominal["couplant.thickness"]
        return {**BETWEEN, **({"couplant.thickness": gel} if self.remounted and filling != "disc" else {})}


def random_design(rng: np.random.Generator, *, points: int = 321) -> Design:
    """A chip that could have been built."""
    def about(value: float, spread: float) -> float:
        return float(f"{value * (1.0 + spread * rng.uniform(-1.0, 1.0)):.4g}")

    def between(low: float, high: float, step: float) -> float:
        return round(float(rng.uniform(low, high)) / step) * step

    ceramic = dict(zip(PIEZO_CONSTANTS, (7600.0, 137e9, 77.8e9, 77.5e9, 121e9, 22.5e9, -5.2, 16.2, 13.0, 762.0, 750.0),
                       strict=True))
    nominal = {f"{PZT}.{name}": about(value, 0.02 if name == "density" else 0.05) for name, value in ceramic.items()}
    for name, low, high in (("c11", 1e-3, 4e-3), ("c33", 2e-3, 5e-3), ("c44", 2e-3, 6e-3)):
        nominal[f"{PZT}.{name}.loss"] = -float(f"{rng.uniform(low, high) * nominal[f'{PZT}.{name}']:.3g}")
    nominal[f"{PZT}.eps33.loss"] = float(f"{rng.uniform(2e-3, 5e-3) * nominal[f'{PZT}.eps33']:.3g}")
    nominal |= {
        f"{PLA}.density": about(1150.0, 0.05), f"{PLA}.bulk_modulus": about(3.6e9, 0.1),
        f"{PLA}.shear_modulus": about(1.0e9, 0.1), f"{PLA}.bulk_modulus.loss": -about(4e7, 0.4),
        f"{PLA}.shear_modulus.loss": -about(4.5e7, 0.4),
        f"{EPOXY}.density": about(1100.0, 0.08), f"{EPOXY}.bulk_modulus": about(4.6e9, 0.1),
        f"{EPOXY}.shear_modulus": about(1.0e9, 0.15), f"{EPOXY}.bulk_modulus.loss": -about(3e7, 0.4),
        f"{EPOXY}.shear_modulus.loss": -about(1e8, 0.5),
        f"{GLASS}.density": about(2500.0, 0.01), f"{GLASS}.bulk_modulus": about(41e9, 0.05),
        f"{GLASS}.shear_modulus": about(29e9, 0.05),
        f"{GEL}.density": about(1020.0, 0.02), f"{GEL}.sound_speed": about(1480.0, 0.02),
        f"{WATER}.sound_speed": water(REFERENCE_TEMPERATURE).sound_speed,
    }
    radius = between(3.5e-3, 5.2e-3, 1e-4)
    tied = tuple(name for name, share in ((COUPLANT, FLUSH_COUPLANT), (SUBSTRATE, FLUSH_CHIP)) if rng.random() < share)
    nominal |= {
        "transducer.thickness": between(1.8e-3, 2.2e-3, 1e-5), TRANSDUCER: radius,
        "couplant.thickness": between(10e-6, 50e-6, 1e-6),
        COUPLANT: radius - (0.0 if COUPLANT in tied else between(5e-5, 2e-4, 5e-5)),
        "substrate.thickness": between(0.7e-3, 1.3e-3, 1e-5),
        SUBSTRATE: radius + (0.0 if SUBSTRATE in tied else between(3e-4, 8e-4, 1e-4)),
        "sidewall.thickness": between(0.5e-3, 0.9e-3, 1e-5),
        "cavity.radius": between(1e-3, min(3e-3, radius - WALL), 5e-5),
        "bond.thickness": between(25e-6, 70e-6, 1e-6), "superstrate.thickness": between(0.2e-3, 1.2e-3, 1e-5),
    }
    prior = {name: share * abs(nominal[name]) for name, share in RELATIVE.items()}
    for name, (size, _) in ABSOLUTE.items():
        prior[name] = size
        if name.startswith("bench."):
            nominal[name] = 0.0
    c33, density = nominal[f"{PZT}.c33"], nominal[f"{PZT}.density"]
    stiffened = c33 + nominal[f"{PZT}.e33"] ** 2 / (nominal[f"{PZT}.eps33"] * 8.854e-12)
    # The coupled thickness resonance lies a tenth below half a wavelength of the stiffened wave.
    centre = 0.9 * 0.5 * math.sqrt(stiffened / density) / nominal["transducer.thickness"]
    low, high = 1e3 * round(0.88e-3 * centre), 1e3 * round(1.12e-3 * centre)
    return Design(nominal, prior, np.linspace(low, high, points), float(f"{rng.uniform(3e-3, 1e-2):.2g}"),
                  tied, bool(rng.random() < REMOUNTED))


def _normal(rng: np.random.Generator) -> float:
    """Normal, cut at two and a half standard deviations."""
    while True:
        found = float(rng.standard_normal())
        if abs(found) < 2.5:
            return found


def draw(rng: np.random.Generator, design: Design) -> dict[str, float]:
    """True numbers, normal about the nominal ones."""
    return design.moved(design.nominal, {name: size * _normal(rng) for name, size in design.prior.items()})


def draw_own(rng: np.random.Generator, design: Design, fillings: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """By how much (SI) the numbers of every state differ from those that they share; `fillings` by state."""
    return {state: {name: size * _normal(rng) for name, size in design.between(filling).items()}
            for state, filling in fillings.items()}
