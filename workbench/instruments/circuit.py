"""The circuit of the bench: generator, device and reference resistor in series.

Z = (V_total - V_reference) / V_reference * R (Acevedo-Espinosa et al. (RP-UEIS), eq. 25) is exact if the parasitic
elements of leads, probes and resistor in :class:`Circuit` are zero. Everything is in e^{+j w t}.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from workbench.results.spectrum import Spectrum

#: The connected device: impedance (ohm, e^{+j w t}) at a frequency (Hz).
Device = Callable[[float], complex]

#: Impedance (ohm) between open clips, in place of infinity.
OPEN_RESISTANCE = 1e12


@dataclass(frozen=True)
class Circuit:
    """The bench's circuit beside the device, in SI units.

    ``reference_inductance`` is in series with the reference resistance. ``lead_inductance`` and ``lead_resistance`` are
    in series with the device, ``lead_capacitance`` across it. ``probe_capacitance`` is across the points of each probe.
    ``gain_total`` and ``gain_reference`` are those of the channels, ``delay_reference`` (s) is the delay of the
    reference channel's samples. The defaults are for half a metre of twisted leads and two probes.
    """

    source_resistance: float = 50.0
    reference_resistance: float = 0.5
    reference_inductance: float = 5e-9
    lead_inductance: float = 0.2e-6
    lead_resistance: float = 0.02
    lead_capacitance: float = 20e-12
    probe_capacitance: float = 15e-12
    gain_total: float = 1.01
    gain_reference: float = 0.99
    delay_reference: float = 0.5e-9

    def __post_init__(self) -> None:
        if self.source_resistance <= 0.0 or self.reference_resistance <= 0.0:
            raise ValueError(f"source resistance {self.source_resistance!r} and reference resistance "
                             f"{self.reference_resistance!r} ohm; expected both above zero")

    def responses(self, frequency: float, device: complex) -> tuple[complex, complex]:
        """Volts of both channels per volt of the open circuit. They are complex, the total channel first; `device` is
        in ohm."""
        s = 2j * pi * frequency
        reference = self.reference_resistance + s * self.reference_inductance
        reference = reference / (1.0 + s * self.probe_capacitance * reference)
        clipped_on = device / (1.0 + s * self.lead_capacitance * device)
        total = clipped_on + self.lead_resistance + s * self.lead_inductance + reference
        loaded = total / (1.0 + s * self.probe_capacitance * total)
        at_total = loaded / (loaded + self.source_resistance)
        at_reference = at_total * reference / total
        return self.gain_total * at_total, self.gain_reference * at_reference * np.exp(s * self.delay_reference)


#: A circuit for which eq. 25 is exact.
IDEAL = Circuit(reference_inductance=0.0, lead_inductance=0.0, lead_resistance=0.0, lead_capacitance=0.0,
                probe_capacitance=0.0, gain_total=1.0, gain_reference=1.0, delay_reference=0.0)

TYPICAL = Circuit()


def resistor(resistance: float) -> Device:
    """An ideal resistance (ohm), zero for a short circuit."""
    return lambda frequency: complex(resistance)


def open_circuit() -> Device:
    """Open clips."""
    return resistor(OPEN_RESISTANCE)


def device_of(spectrum: Spectrum) -> Device:
    """A device with this impedance. Outside the band, it is that of the nearer end, since a bench may be set there
    too."""
    impedance = spectrum.interpolant()
    low, high = float(spectrum.frequency[0]), float(spectrum.frequency[-1])
    return lambda frequency: complex(impedance(min(max(frequency, low), high)))
