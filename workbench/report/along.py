"""A chip between its ends as a table and a record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.report.page import TextTable, table
from workbench.report.record import plain
from workbench.simulation.finite_length import EnergyProfile, FiniteLength


def along_table(found: FiniteLength, profiles: Sequence[EnergyProfile]) -> TextTable:
    """The maxima of the energy along the channel, by frequency."""
    return table(
        "f (MHz):.6f | mean E_ac (J/m^3 per Vpp^2) | without ends | maxima | distance (mm) | largest over mean:.3g",
        [(each.frequency, *_energies(found, each), str(each.spots.size), each.spacing, each.contrast)
         for each in profiles])


def along_record(found: FiniteLength, profiles: Sequence[EnergyProfile]) -> dict[str, Any]:
    """The content of ``along.json``; impedances are e^{+j w t}."""
    shown = [{"frequency_hz": each.frequency, "energy_j_m3_per_vpp2": _energies(found, each)[0],
              "without_ends_j_m3_per_vpp2": _energies(found, each)[1], "maxima_m": each.spots,
              "distance_of_maxima_m": each.spacing, "largest_over_mean": each.contrast, "place_m": each.place,
              "energy_along_j_m3_per_vpp2": each.energy_density / 4.0} for each in profiles]
    record: dict[str, Any] = plain({
        "chip": found.chip.name, "state": found.state, "length_m": found.length,
        "wave_numbers_1_m": [part.wave_number for part in found.parts], "last_relative_change_of_charge": found.moved,
        "frequency_hz": found.frequency,
        "impedance_ohm": {"real": found.impedance.real, "imaginary": found.impedance.imag},
        "impedance_without_ends_ohm": {"real": found.without_ends.real, "imaginary": found.without_ends.imag},
        "energy_j_m3_per_vpp2": found.energy_density / 4.0,
        "energy_without_ends_j_m3_per_vpp2": found.energy_without_ends / 4.0, "profiles": shown})
    return record


def _energies(found: FiniteLength, profile: EnergyProfile) -> tuple[float, float]:
    """Mean energy densities at the frequency of a profile.

    They are in J/m^3 per Vpp^2, with and without ends.
    """
    index = int(np.argmin(np.abs(found.frequency - profile.frequency)))
    return float(found.energy_density[index]) / 4.0, float(found.energy_without_ends[index]) / 4.0
