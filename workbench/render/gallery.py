"""All pictures of one simulated state, and of a chip as a solid: what the command line draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from geometry.chip import Chip
from workbench.report import Picture
from workbench.simulate import Simulation

#: Fields that can be asked for by name.
FIELDS = ("displacement", "pressure", "gorkov", "cutaway", "losses", "mesh")


def draw_state(run: Simulation, folder: Path, *, only: Sequence[str] = FIELDS) -> list[Picture]:
    """The pictures of a state that exist for it, among `only`, written to `folder`."""
    from workbench.render import plots, sections, solids

    fields, state, pictures = run.fields, run.state, []
    drive = fields.drive
    place = f"{fields.frequency / 1e6:.4f} MHz, {drive}"

    def add(path: Path, caption: str) -> None:
        pictures.append(Picture(path, f"{state}: {caption}"))

    if "displacement" in only:
        add(sections.draw_axial_displacement(fields, folder / f"displacement_{state}.png", drive=drive),
            f"axial displacement in the solids at {place}; fluids are white")
    filled = "cavity" in fields.fluid_regions
    if "pressure" in only and fields.fluid_regions:
        add(sections.draw_pressure(fields, folder / f"pressure_{state}.png", drive=drive,
                                   region="cavity" if filled else None), f"pressure at {place}")
    if "gorkov" in only and run.traps is not None:
        add(sections.draw_gorkov_potential(run.traps, folder / f"gorkov_{state}.png"),
            f"Gor'kov potential and traps; {run.traps.excitation}")
        if run.traps.traps:
            add(plots.draw_potential_profiles(run.traps, folder / f"profiles_{state}.png"),
                "Gor'kov potential along the axis and along the radius through the deepest trap")
    if "cutaway" in only:
        add(solids.draw_revolved(fields, folder / f"cutaway_{state}.png", drive=drive),
            f"the chip cut open, coloured by the axial displacement at {place}")
    if "losses" in only and run.losses:
        add(plots.draw_loss_budget(run.losses, folder / f"losses_{state}.png", title=f"where the power goes, {state}"),
            f"power lost by region at {place}; closes against the electrical input to {run.closure:.0e}")
    if "mesh" in only:
        add(sections.draw_regions(fields.mesh, folder / f"mesh_{state}.png"), "regions and cells")
    return pictures


def draw_chip(chip: Chip, parts: Mapping[str, Path], path: Path) -> Picture:
    """The CAD view from the STL files of a chip's parts, pulled apart along z."""
    from workbench.render import solids

    height = chip.layers[-1].z_top
    shapes = [solids.read_stl(file, metres_per_unit=1e-3) for name, file in parts.items() if name != "cavity"]
    solids.draw_solids(shapes, path, title=chip.name, explode=0.5 * height)
    return Picture(path, "the solids of the chip, pulled apart")
