"""Trajectories of particles: tables, record, data files and page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.acoustics.captures import (
    CaptureStatistics,
    Window,
    arrived_share,
    capture_statistics,
    light_curve,
    rise_time,
)
from workbench.acoustics.trajectories import Fate, Trajectories
from workbench.files.writing import replacing, write_atomic
from workbench.model.particles import drag_coefficient, net_weight
from workbench.report.page import Picture, TextTable, table, write_report
from workbench.report.record import record
from workbench.report.simulation import field_table, gathering_record
from workbench.report.warm import warm_blocks
from workbench.simulation.gathering import Gathering
from workbench.simulation.liquid_motion import LiquidMotion
from workbench.simulation.run import Snapshot


def captures_table(statistics: Sequence[CaptureStatistics]) -> TextTable:
    """Particles by final place, with times of arrival and their spread."""
    def seconds(each: float | None) -> str:
        return "" if each is None else f"{float(f'{each:.3g}'):g}"

    return table("particles | number | of all (%) | 10 % by (s) | 50 % by (s) | 90 % by (s) | 10 to 90 % (s)", (
        (row.name, row.count, _spread(100.0 * row.share, 100.0 * row.share_spread), seconds(row.ten),
         seconds(row.half), seconds(row.ninety), _spread(row.focusing_time, row.focusing_spread))
        for number, row in enumerate(statistics) if row.count or not number))


def _spread(value: float | None, spread: float | None) -> str:
    """A number and its standard deviation, to two digits of that."""
    if value is None or spread is None:
        return ""
    digits = 1 if not spread > 0.0 else max(0, 1 - math.floor(math.log10(spread)))
    return f"{value:.{digits}f} ± {spread:.{digits}f}"


def rest_table(found: Trajectories) -> TextTable:
    """Traps of the sound alone, with the place of rest near each."""
    rows, measure = [], found.report.forces.mesh.measure
    symbol, digits = measure.symbol, measure.decimals + 1
    for number, (trap, rest) in enumerate(zip(found.report.traps, found.rest, strict=True), start=1):
        holds = np.isfinite(rest).all()
        alone, resting = (f"{symbol} {1e3 * r:.{digits}f}, z {1e3 * z:.{digits}f}" for r, z in (
            (trap.radius, trap.height), rest))
        place = resting if holds else "on a wall" if trap.on_wall else "none"
        rows.append((number, alone, place, int((found.trap == number - 1).sum())))
    return table("trap | of the sound alone (mm) | place of rest (mm) | particles there", rows)


def motion_record(found: Trajectories, window: Window, answer: Gathering) -> dict[str, Any]:
    """The motion of the particles in particles.json."""
    forces, curve = found.forces, light_curve(found, window)
    return record(
        found, "particle=forces.particle.name radius_m=forces.particle.radius particles=count "
               "frequency_hz=forces.excitation.frequency drive=forces.excitation.description voltage_factor "
               "energy_density_j_m3=forces.excitation.energy_density "
               "contrast_factor=forces.scattering.contrast_factor rest_m") | {
        "seconds": float(found.times[-1]),
        "settling_speed_m_s": net_weight(forces.particle, forces.fluid) / drag_coefficient(
            forces.particle, forces.fluid),
        "fate": {fate.words: int((found.fate == fate).sum()) for fate in Fate},
        "captures": record(
            capture_statistics(found), "name count share share_spread ten_percent_s=ten half_s ninety_percent_s=ninety "
                                       "focusing_time_s focusing_spread_s"),
        "gathering": gathering_record([answer])[answer.state],
        "window_m": record(window, "inner outer bottom top"),
        "window_share": {"begin": float(curve[0]), "end": float(curve[-1]),
                         "ten_to_ninety_percent_s": rise_time(found.times, curve)}}


def write_trajectories(found: Trajectories, path: Path) -> Path:
    """Write times, positions and fates as an npz archive, in SI."""
    with replacing(path) as whole:
        np.savez_compressed(
            whole, times_s=found.times, positions_m=found.positions, azimuths_rad=found.azimuths, fate=found.fate,
            fate_words=np.array([fate.words for fate in Fate]), trap=found.trap, rest_m=found.rest,
            levitated_at_s=found.levitated_at, focused_at_s=found.focused_at, trapped_at_s=found.trapped_at,
            stopped_at_s=found.stopped_at)
    return path


def write_light_curve(found: Trajectories, window: Window, path: Path) -> Path:
    """Write the shares of the light curve at every time as CSV."""
    columns = np.stack([found.times, light_curve(found, window), *(arrived_share(found, at) for at in (
        found.levitated_at, found.trapped_at, found.stopped_at))], axis=1)
    rows = ["time_s,in_window,came_to_levitate,came_to_their_trap,stopped_by_a_wall",
            *(",".join(f"{value:.9g}" for value in row) for row in columns)]
    write_atomic(path, "\n".join(rows) + "\n")
    return path


def flow_answer(moving: LiquidMotion) -> str:
    """Sentences on the motion of the liquid."""
    flow, heat = moving.streaming, moving.heat
    if flow is None:
        return "The liquid is taken to be at rest."
    parts = ", ".join(f"{name} {1e6 * flow.rms_of(each):.2g}" for name, each in flow.causes.items())
    text = (f"The liquid carries them with {1e6 * flow.rms_speed:.3g} um/s rms, {1e6 * flow.largest_speed:.3g} um/s at "
            f"most ({parts} um/s rms alone)")
    if heat is not None:
        text += (f"; driven steadily the chip is up to {heat.peak:.3g} K above ambient, its liquid "
                 f"{heat.parts[flow.region].mean:.3g} K, with a time constant of {heat.time_constant:.3g} s")
    return f"{text}. {moving.left_out}".rstrip()


def flow_record(moving: LiquidMotion) -> dict[str, Any]:
    """The motion of the liquid in particles.json; empty at rest."""
    flow, heat = moving.streaming, moving.heat
    found: dict[str, Any] = {}
    if flow is not None:
        found |= record(flow, "rms_m_s=rms_speed largest_m_s=largest_speed peclet") | {
            "causes_rms_m_s": {name: flow.rms_of(each) for name, each in flow.causes.items()}}
    if heat is not None:
        found |= record(heat, "power_w peak_k time_constant_s") | {
            "mean_k": {name: part.mean for name, part in heat.parts.items()}}
    return found


def write_particles_report(
    shot: Snapshot, found: Trajectories, moving: LiquidMotion, answer: Gathering, pictures: Sequence[Picture],
    files: Mapping[str, Path], folder: Path
) -> Path:
    """Write ``report.html``: answer, numbers, pictures, field and model.

    `files` are further files by their content.
    """
    return write_report(folder / "report.html", f"{shot.chip.name}: particles", module=__name__, values={
        "shot": shot, "found": found, "moving": moving, "answer": answer, "pictures": pictures, "files": files,
        "warm": warm_blocks(shot), "statistics": capture_statistics(found), "field": field_table(found.report)})
