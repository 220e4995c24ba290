"""Recorded focusing times or energy densities over frequency, and their peaks.

A focusing time is inversely proportional to the energy density, with a factor that depends on the particle, the liquid
and the start (Barnkob et al. 2010, Lab Chip 10, 563). Peaks are fitted to the rate, 1/t* or E_ac, over the square of
the voltage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, choose
from workbench.results.brief import Brief
from workbench.results.lorentzian import PeakFit, fit_peaks

Real = NDArray[np.float64]

FOCUSING_TIME, ENERGY_DENSITY = "focusing time", "energy density"

#: Fewest recorded frequencies: a peak has three parameters. With fewer, its intervals are nearly infinite.
FEWEST = 5


@dataclass(frozen=True, eq=False, repr=False)
class EnergyRecording(Brief):
    """Focusing times (s) or energy densities (J/m^3) at `frequency` (n,) Hz.

    They are sorted by frequency. ``kind`` is "focusing time" or "energy density", ``values`` (n,) are of that kind and
    positive, ``uncertainty`` (n,) their standard deviations, ``voltage`` (n,) Vpp at the electrodes (1 for energy
    densities per Vpp^2); None if not stated. ``read_as`` describes the columns of the file ``source``, ``findings`` are
    sentences about its rows.

    Raises:
        InputError: another kind, arrays of different lengths, a value that is not positive, or too few frequencies.
    """

    frequency: Real
    values: Real
    kind: str
    uncertainty: Real | None = None
    voltage: Real | None = None
    source: str = ""
    read_as: str = ""
    findings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        source = self.source or "EnergyRecording"
        choose(self.kind, (FOCUSING_TIME, ENERGY_DENSITY), source=source, field="kind")
        shape = np.shape(self.frequency)
        order = np.argsort(np.asarray(self.frequency, dtype=float), axis=0, kind="stable")
        for name in ("frequency", "values", "uncertainty", "voltage"):
            if getattr(self, name) is None:
                continue
            each = np.array(getattr(self, name), dtype=float)
            if each.shape != shape or each.ndim != 1:
                raise InputError(source, name, f"the shape {each.shape}", f"one number for each of {shape} frequencies")
            if not np.all(np.isfinite(each) & (each > 0.0)):
                raise InputError(source, name, each[~(np.isfinite(each) & (each > 0.0))][0], "positive finite numbers")
            each = each[order]
            each.flags.writeable = False
            object.__setattr__(self, name, each)
        if np.unique(self.frequency).size < FEWEST:
            raise InputError(source, "frequency", f"{np.unique(self.frequency).size} frequencies at which particles "
                             "focus", f"at least {FEWEST} for a peak and its width")

    @property
    def rate(self) -> Real:
        """1/t* (1/s) or E_ac (J/m^3) at every frequency (n,). It is per Vpp^2 if the voltage is stated."""
        rate = self.values if self.kind == ENERGY_DENSITY else 1.0 / self.values
        return rate if self.voltage is None else rate / self.voltage**2

    @property
    def is_absolute(self) -> bool:
        """Whether the rate is an energy density per Vpp^2. Otherwise it has an unknown factor."""
        return self.kind == ENERGY_DENSITY and self.voltage is not None

    @property
    def relative_uncertainty(self) -> Real | None:
        """The standard deviation of ln(rate) at every frequency (n,)."""
        return None if self.uncertainty is None else self.uncertainty / self.values

    def peaks(self) -> PeakFit:
        """One or two Lorentzian peaks through the rate."""
        return fit_peaks(self.frequency, self.rate, self.relative_uncertainty)
