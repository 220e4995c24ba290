"""The steady state of a chip that its drive has warmed.

A liquid's speed of sound depends on its temperature, and so does the resonance at the drive's frequency. Temperature
and field are therefore a fixed point (`workbench.simulation.fixed_point`), of which there may be several or none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.heat import STILL_AIR
from workbench.model.drive import Drive, drive_up_to
from workbench.model.problem import Problem
from workbench.results.brief import Brief

Real = NDArray[np.float64]

#: Relative change of the energy on the way to the steady temperature above which the fields are those of the warm chip.
#: Doubled, the energy may have an error of 6 % due to the temperature.
CHANGE = 0.03

#: Relative shift of the frequency by `follow` above which the fields are those of the followed one.
FOLLOWED = 1e-5

#: Ratio to the energy of the warm chip above which a larger peak is reported.
LARGER = 1.1


@dataclass(frozen=True)
class WarmUp:
    """The ways for the heat of a driven chip to leave.

    ``convection`` and ``holder`` are as of `wb.heating`. With ``follow`` the frequency of the drive stays at the peak
    of the energy in the cavity while the chip warms up. The surroundings are at the stated temperature of the liquid.
    """

    convection: float | Mapping[str, float] = STILL_AIR
    holder: str | Mapping[str, float] | None = None
    follow: bool = False


@dataclass(frozen=True)
class SteadyPoint:
    """A temperature in equilibrium with the losses.

    ``rise`` (K) is the mean of the liquid above its stated temperature; ``frequency`` is in Hz; ``energy_density``
    (J/m^3) is the mean in the cavity; ``voltage`` (Vpp) is at the electrodes; ``power`` (W) is electrical input. A
    point that is not ``stable`` changes after the smallest disturbance.
    """

    rise: float
    frequency: float
    energy_density: float
    voltage: float
    power: float
    stable: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class WarmCurve(Brief):
    """A warm chip over its drive. ``factor`` (n,) of the drive's voltage keeps the liquid ``rise`` (n,) K warmer.
    ``frequency`` (n,) Hz and ``energy_density`` (n,) J/m^3 are at that factor; NaN if no drive does."""

    rise: Real
    factor: Real
    frequency: Real
    energy_density: Real


@dataclass(frozen=True, eq=False, repr=False)
class WarmState(Brief):
    """A chip driven steadily, at the temperature due to its losses.

    ``cold`` is the point of a chip whose liquid is kept at its ``stated`` temperature (K), with the rise due to its
    losses; ``points`` are the steady ones by rise, of which a drive that is switched on reaches the first.
    ``energy_per_kelvin`` is the relative change of the energy by the first kelvin at the cold chip's frequency, and
    ``peak_per_kelvin`` (Hz) that of the frequency of its peak, None without a peak nearby. ``largest_change`` is the
    relative change of the energy on the way to the first point. ``largest`` is the factor of the voltage up to which
    the liquid, at its warmest place, stays within its law, ``highest`` (K) that law's end. ``laws`` names the materials
    that change with the temperature; ``up`` are the ways for the heat to leave; ``problem`` is the chip at its stated
    temperature. ``evaluate`` gives the energy density (n,) J/m^3 under the drive at a rise (K) and frequencies (n,) Hz
    near the drive's. ``peak`` is the frequency (Hz) of the largest peak of the energy at the warm chip's temperature,
    and its energy density.
    """

    liquid: str
    stated: float
    drive: Drive
    up: WarmUp
    cold: SteadyPoint
    points: tuple[SteadyPoint, ...]
    energy_per_kelvin: float
    peak_per_kelvin: float | None
    largest_change: float
    highest: float
    largest: float
    curve: WarmCurve
    laws: tuple[str, ...]
    problem: Problem
    evaluate: Callable[[float, Real], Real]
    peak: tuple[float, float] | None = None

    @property
    def follow(self) -> bool:
        """Whether the drive follows the peak of the energy."""
        return self.up.follow

    @property
    def here(self) -> SteadyPoint | None:
        """The point after switching on; None if beyond the liquid's law."""
        return self.points[0] if self.points else None

    @property
    def matters(self) -> bool:
        """Whether fields must be those of the warm chip."""
        return bool(self.points) and (self.largest_change > CHANGE or self.is_followed)

    @property
    def is_followed(self) -> bool:
        """Whether the drive has followed the peak to another frequency."""
        return self.here is not None and abs(self.here.frequency / self.cold.frequency - 1.0) > FOLLOWED

    @property
    def rise(self) -> float:
        """The rise (K) of the liquid in the fields; 0 if negligible."""
        return self.points[0].rise if self.matters else 0.0

    @property
    def highest_drive(self) -> str:
        """The largest drive within the liquid's law, in words."""
        most = drive_up_to(self.drive, self.largest) if self.largest > 0.0 else None
        return f"{_short(self.largest)} times the voltage" if most is None else str(most)

    @property
    def slopes(self) -> str:
        """The effect of a kelvin on the field, as a sentence."""
        moved = ("it is near no peak of the energy" if self.peak_per_kelvin is None else
                 f"the peak of the energy moves by {1e-3 * self.peak_per_kelvin:+.2g} kHz per K")
        return (f"The first kelvin changes E_ac by {100.0 * self.energy_per_kelvin:+.2g} % at "
                f"{self.cold.frequency / 1e6:.4f} MHz: {moved}.")

    @property
    def sentences(self) -> tuple[str, ...]:
        """The rise, its effect, other steady states, and the largest drive."""
        return (*self._state(), *self._others(), self.slopes, *self._limit())

    def __str__(self) -> str:
        return " ".join(self.sentences)

    def _state(self) -> tuple[str, ...]:
        here, stated = self.here, f"{self.stated - 273.15:.3g} degC"
        if here is None:
            return (f"Driven steadily by {self.drive}, the {self.liquid} has no steady temperature up to the "
                    f"{self.highest - 273.15:.3g} degC where its law ends, by boiling or for want of data. The fields "
                    f"are those of a chip kept at {stated}, by a Peltier element or short bursts.",)
        lead = f"Driven steadily by {self.drive}, the {self.liquid} is {here.rise:.3g} K warmer than its {stated}"
        if not self.matters:
            return (f"{lead}. That changes E_ac by at most {_short(100.0 * self.largest_change)} %, and the fields are "
                    f"those at {stated}.",)
        followed = "" if not self.follow else (f", and the drive follows the peak of the energy from "
                                               f"{self.cold.frequency / 1e6:.4f} to {here.frequency / 1e6:.4f} MHz")
        sentences = [f"{lead}{followed}. Mean E_ac is then {here.energy_density:.3g} J/m^3, "
                     f"{_short(here.energy_density / self.cold.energy_density)} times that of a chip kept at {stated}, "
                     "and the fields are those of the warm chip."]
        if self.peak is not None and self.peak[1] > LARGER * here.energy_density:
            sentences.append(f"At this temperature the largest peak of the energy is at {self.peak[0] / 1e6:.4f} MHz, "
                             f"{_short(self.peak[1] / here.energy_density)} times as large.")
        return tuple(sentences)

    def _others(self) -> tuple[str, ...]:
        others = [point for point in self.points[1:] if point.stable]
        if not others:
            return ()
        listed = " or ".join(f"{point.rise:.3g} K warmer, with mean E_ac {point.energy_density:.3g} J/m^3"
                             for point in others)
        if not self.peak_per_kelvin:
            return (f"The chip is bistable: under the same drive it can also stay {listed}.",)
        way, back = ("up", "down") if self.peak_per_kelvin > 0.0 else ("down", "up")
        return (f"The chip is bistable: under the same drive it can also stay {listed}. A sweep of the frequency {way} "
                f"takes the peak along and leads to the warmest state; a sweep {back}, or a drive that is switched on, "
                "leads to the coldest.",)

    def _limit(self) -> tuple[str, ...]:
        if not self.largest > 0.0:
            return ()
        return (f"Up to {self.highest_drive} the warmest place of the liquid stays within its law, which ends at "
                f"{self.highest - 273.15:.3g} degC.",)


def _short(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
