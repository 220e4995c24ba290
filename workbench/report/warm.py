"""The warmth of a driven chip: blocks of a report, and record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from workbench.render.warmth import draw_warmth
from workbench.report.page import Answer, Block, Picture, table
from workbench.report.record import record
from workbench.simulation.run import Snapshot

#: Name of the picture of energy over drive and temperature, of the last state with a liquid.
WARMTH_PICTURE = "warmth.png"


def warm_blocks(shot: Snapshot) -> list[Block]:
    """The warmth of a driven chip and its steady states, if known."""
    if shot.warm is None:
        return []
    steady = [("driven steadily" if number == 0 else "also steady" if point.stable else "unstable", point.rise, point)
              for number, point in enumerate(shot.warm.points)]
    return [Answer(shot.warm), table(
        "chip | liquid warmer by (K):.3g | frequency (MHz):.4f | mean E_ac (J/m^3):.3g | voltage (Vpp):.3g | "
        "power (W):.3g",
        ((name, rise, point.frequency, point.energy_density, point.voltage, point.power)
         for name, rise, point in (("kept at the stated temperature", 0.0, shot.warm.cold), *steady)))]


def warm_section(title: str, shots: Sequence[Snapshot], folder: Path) -> list[Block]:
    """The blocks of all states, the last state first, and its picture."""
    warm = [shot for shot in reversed(shots) if shot.warm is not None]
    blocks: list[Block] = [block for shot in warm for block in warm_blocks(shot)]
    if warm and warm[0].warm is not None:
        picture = draw_warmth(warm[0].warm, folder / WARMTH_PICTURE, title=f"{title}, {warm[0].state}")
        blocks.append(Picture(picture, "mean energy density in the cavity: over the drive, of a chip kept at its "
                              "stated temperature and of one that is driven steadily; over frequency, at several "
                              "temperatures of the liquid"))
    return blocks


def warm_record(shot: Snapshot) -> dict[str, Any]:
    """The warmth of a driven chip in JSON files, if known."""
    if shot.warm is None:
        return {}
    point = "{ rise_k frequency_hz mean_energy_density_j_m3=energy_density voltage_vpp power_w stable }"
    found = record(
        shot.warm, "sentences fields_are_warm=matters liquid stated_temperature_k=stated law_ends_at_k=highest "
                   f"kept_at_stated_temperature=cold {point} steady=points {point} energy_per_kelvin "
                   "peak_per_kelvin_hz highest_drive")
    peak = shot.warm.peak
    return {"warm": found | {"largest_peak_when_warm": peak and {
        "frequency_hz": peak[0], "mean_energy_density_j_m3": peak[1]}}}
