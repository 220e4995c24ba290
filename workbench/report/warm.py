"""The warmth of a driven chip: blocks of a report, and its record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from workbench.render.warmth import draw_warmth
from workbench.report.page import Answer, Block, Picture, TextTable, number_text
from workbench.simulation.run import Snapshot
from workbench.simulation.warm import SteadyPoint

#: Name of the picture of energy over drive and temperature, of the last state with a liquid.
WARMTH_PICTURE = "warmth.png"


def warm_blocks(shot: Snapshot) -> list[Block]:
    """Sentences on the warmth of a driven chip, and a table of its steady states; nothing where that is not known."""
    if shot.warm is None:
        return []
    rows = [_row("kept at the stated temperature", shot.warm.cold)] + [
        _row("driven steadily" if number == 0 else "also steady" if point.stable else "unstable", point)
        for number, point in enumerate(shot.warm.points)]
    return [Answer(str(shot.warm)), TextTable(
        ("chip", "liquid warmer by (K)", "frequency (MHz)", "mean E_ac (J/m^3)", "voltage (Vpp)", "power (W)"),
        tuple(rows))]


def _row(name: str, point: SteadyPoint) -> tuple[str, ...]:
    rise = "0" if name.startswith("kept") else number_text(point.rise, 3)
    return (name, rise, f"{point.frequency / 1e6:.4f}", number_text(point.energy_density, 3),
            number_text(point.voltage, 3), number_text(point.power, 3))


def warm_section(title: str, shots: Sequence[Snapshot], folder: Path) -> list[Block]:
    """The blocks of all states, the last one first, and the picture of that."""
    warm = [shot for shot in reversed(shots) if shot.warm is not None]
    blocks: list[Block] = [block for shot in warm for block in warm_blocks(shot)]
    if warm and warm[0].warm is not None:
        picture = draw_warmth(warm[0].warm, folder / WARMTH_PICTURE, title=f"{title}, {warm[0].state}")
        blocks.append(Picture(picture, "mean energy density in the cavity: over the drive, of a chip kept at its "
                              "stated temperature and of one that is driven steadily; over frequency, at several "
                              "temperatures of the liquid"))
    return blocks


def warm_record(shot: Snapshot) -> dict[str, Any]:
    """The warmth of a driven chip as merit.json and particles.json hold it; empty where that is not known."""
    state = shot.warm
    if state is None:
        return {}
    return {"warm": {
        "sentences": list(state.sentences), "fields_are_warm": state.matters, "liquid": state.liquid,
        "stated_temperature_k": state.stated, "law_ends_at_k": state.highest,
        "kept_at_stated_temperature": _point_record(state.cold),
        "steady": [_point_record(point) for point in state.points],
        "energy_per_kelvin": state.energy_per_kelvin, "peak_per_kelvin_hz": state.peak_per_kelvin,
        "highest_drive": state.highest_drive, "largest_peak_when_warm": None if state.peak is None else {
            "frequency_hz": state.peak[0], "mean_energy_density_j_m3": state.peak[1]}}}


def _point_record(point: SteadyPoint) -> dict[str, Any]:
    return {"rise_k": point.rise, "frequency_hz": point.frequency, "mean_energy_density_j_m3": point.energy_density,
            "voltage_vpp": point.voltage, "power_w": point.power, "stable": point.stable}
