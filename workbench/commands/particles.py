"""``workbench particles``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.chip import Chip, read_chip
from workbench.acoustics.captures import Window, capture_statistics
from workbench.acoustics.trajectories import Trajectories
from workbench.commands.parsed_options import ModelOptions, model_options, output_folder
from workbench.commands.states import run_state, simulated
from workbench.commands.terminal import Show, print_paragraph, print_table, progress_bars, say_finding
from workbench.files.ownership import Outputs
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_json
from workbench.report.page import Picture
from workbench.report.particles import (
    captures_table,
    flow_answer,
    flow_record,
    motion_record,
    write_light_curve,
    write_particles_report,
    write_trajectories,
)
from workbench.report.warm import warm_record
from workbench.simulation.beads import carrier_of, trajectories, with_particle
from workbench.simulation.gathering import statement
from workbench.simulation.heating import softening_words
from workbench.simulation.liquid_motion import FlowCause, LiquidMotion, liquid_motion
from workbench.simulation.run import Simulation, Snapshot, snapshot
from workbench.simulation.warm import WarmUp

if TYPE_CHECKING:
    from rich.console import Console

#: Default radius of the window of the light curve, relative to the cavity's. It contains a sixteenth of evenly spread
#: particles, a quarter in a channel; doubled, the curve is flat for annuli near the axis.
WINDOW = 0.25

#: Files of `particles`.
OUTPUTS = Outputs("particles", names=(
    "report.html", "particles.json", "trajectories.npz", "light_curve.csv", "light_curve.png", "above_start.png",
    "above_end.png", "side.png", "streaming.png", "overlay_end.png", "particles.gif"))


def run_particles(options: argparse.Namespace, console: Console) -> int:
    """``workbench particles``: trajectories, pictures, and the report."""
    radius = _quantity(options.particle_radius, "length", "--particle-radius")
    chip = with_particle(read_chip(options.chip), options.state, particle=options.particle, radius=radius)
    model = model_options(options, chip)
    device = carrier_of(chip, options.state, model.registry)
    outer = _quantity(options.window, "length", "--window") or WINDOW * min(hole.inner_radius for hole in chip.holes)
    window, name, folder = Window(outer=outer), device.state.name, output_folder(options, OUTPUTS)
    with progress_bars(console) as show:
        shot = _field(chip, name, model, show)
        # A liquid that is kept at its temperature has no flow by heat.
        cause = FlowCause.SOUND if options.cold and options.flow == FlowCause.HEAT else options.flow
        up = model.warm or WarmUp()
        moving = liquid_motion(shot, by=cause, registry=model.registry, convection=up.convection, holder=up.holder)
        found = trajectories(shot, 60.0 * options.minutes, particles=options.count, seed=options.seed,
                             flow=moving.velocity, start=options.start, progress=partial(simulated, show, name))
        pictures, files = _drawn(found, moving, window, folder, animated=not options.no_animation) \
            if not options.no_pictures else ([], {})
        show(name, "done", 1.0)
    answer = statement(name, found.report, moving, found)
    answer = replace(answer, sentences=(*softening_words(shot, moving.heat), *answer.sentences))
    files = {**files, "all positions, times and fates": write_trajectories(found, folder / "trajectories.npz"),
             "the light curve": write_light_curve(found, window, folder / "light_curve.csv")}
    write_json(folder / "particles.json", {"chip": chip.name, "chip_file": str(options.chip), "state": name,
                                           **motion_record(found, window, answer), **warm_record(shot),
                                           "liquid": flow_record(moving), "findings": list(shot.findings)})
    write_particles_report(shot, found, moving, answer, pictures, files, folder)
    print_table(chip.name, captures_table(capture_statistics(found)))
    if isinstance(shot, Simulation):
        print_paragraph(str(shot.operating))
    if shot.warm is not None:
        print_paragraph(str(shot.warm))
    print_paragraph(str(answer))
    print_paragraph(flow_answer(moving))
    for text in shot.findings:
        say_finding(text, console)
    return 0


def _field(chip: Chip, name: str, model: ModelOptions, show: Show) -> Snapshot:
    """The field at the requested frequency, or at the operating point. A finding reports an operating point that is
    only the middle of the band."""
    if not isinstance(model.at, float):
        run = run_state(chip, name, model, show)
        return run if run.figures is not None or run.operating.peaks else replace(run, findings=(
            f"the field is that of {run.fields.frequency / 1e6:.6g} MHz, the middle of the band, because there is no "
            f"f0: {run.no_resonance}. State the frequency of the generator by --at", *run.findings))
    return snapshot(chip, name, model.at, registry=model.registry, band=model.band, drive=model.drive,
                    accuracy=model.accuracy, warm=model.warm, progress=partial(simulated, show, name))


def _quantity(text: str | None, dimension: str, field: str) -> float | None:
    return None if text is None else parse_quantity(text, dimension, source="command line", field=field)


def _drawn(
    found: Trajectories, moving: LiquidMotion, window: Window, folder: Path, *, animated: bool
) -> tuple[list[Picture], dict[str, Path]]:
    """The pictures of the report, and further files by description."""
    from workbench.render import beads
    from workbench.render.sections import draw_streaming

    end = float(found.times[-1])
    # A moment of each stage: levitation in seconds, gathering in minutes.
    stages = (0.0, *(float(found.times[i]) for i in (len(found.times) // 12, len(found.times) // 3)), end)
    measure = found.velocity.mesh.measure
    inside = measure.within_words(window.outer)
    pictures = [
        Picture(beads.draw_from_above(found, folder / "above_start.png", at=0.0), "from above, at the start"),
        Picture(beads.draw_from_above(found, folder / "above_end.png", at=end),
                f"from above, after {beads.time_text(end)}; a dot smaller than {beads.LEAST_DOT:.1%} of the picture is "
                "drawn as large as that"),
        Picture(beads.draw_from_side(found, folder / "side.png", at=stages),
                f"from the side{', every particle in one half' if measure.mirror else ''}, on the Gor'kov potential "
                "(without weight)"),
        Picture(beads.draw_light_curves(found, [(inside, window)],
                                        folder / "light_curve.png"), f"shares over time; window: {inside}"),
    ]
    if moving.streaming is not None:
        flow = draw_streaming(moving.streaming, folder / "streaming.png")
        pictures.append(Picture(flow, "the flow of the liquid that carries them, Stokes drift included"))
    overlay = beads.draw_from_above(found, folder / "overlay_end.png", at=end, transparent=True)
    files = {"the picture from above without background, to lay over a micrograph of the cavity's width": overlay}
    if animated:
        files["the animation"] = beads.animate_beads(found, folder / "particles.gif")
    return pictures, files

