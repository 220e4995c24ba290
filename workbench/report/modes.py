"""The modes of a chip as a table and a record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.report.page import TextTable, table
from workbench.report.record import record
from workbench.simulation.dispersion import GuidedWaves
from workbench.simulation.matched_modes import MatchedMode
from workbench.simulation.modes import ChipModes


def modes_table(found: ChipModes) -> TextTable:
    """Every mode with its quality factor, its coupling and its description."""
    return table("f (MHz):.6f=frequency | Q=q | k_eff:.3f=k_eff | liquid (%):.3g=liquid | mode=words", found.modes)


def modes_record(found: ChipModes) -> dict[str, Any]:
    """The content of ``modes.json``; a wavelength is null if there is none."""
    keys = "order wavelength_m frequency_hz q capacitance_f k_eff energy loss zeros=crossings"
    return record(found, f"chip=chip.name state band_hz least_q modes {{ {keys} }}")


def dispersion_table(found: GuidedWaves) -> TextTable:
    """Every branch, its largest group velocity and share in the liquid."""
    return table(
        "k from (1/m) | to (1/m) | f from (MHz):.6f | to (MHz):.6f | least Q | largest group velocity (m/s) | "
        "liquid (%):.3g",
        [(each.wave_number[0], each.wave_number[-1], each.frequency[0], each.frequency[-1], each.q.min(),
          float(np.abs(each.group_velocity).max()), each.liquid.max()) for each in found.branches])


def dispersion_record(found: GuidedWaves) -> dict[str, Any]:
    """The waves along the channel, of ``modes.json``."""
    keys = "wave_number_1_m=wave_number frequency_hz q group_velocity_m_s liquid decay_length_m"
    return record(found, f"band_hz least_q wave_numbers_1_m=wave_numbers branches {{ {keys} }}")


def matched_table(matched: Sequence[MatchedMode]) -> TextTable:
    """The resonances of a recording beside the modes of the model."""
    return table(
        "recorded f (MHz):.6f=recorded.frequency.value | Q=recorded.q.value | k_eff:.3f=recorded.k_eff.value | "
        "model f (MHz):.6f=mode.frequency | Q=mode.q | k_eff:.3f=mode.k_eff | "
        "difference of f (%):.3f=difference | ratio of Q:.3g=q_ratio | mode=words", matched)


def matched_record(matched: Sequence[MatchedMode]) -> list[dict[str, Any]]:
    """The resonances of a recording beside the modes of the model.

    The recorded numbers have standard errors. A partner that is missing is null.
    """
    mode = "{ order frequency_hz q k_eff words }"
    found: list[dict[str, Any]] = record(
        tuple(matched), "recorded { frequency_hz q k_eff } relative_difference_of_frequency=difference q_ratio "
                        f"mode {mode} nearest=beside {mode} words")
    return found
