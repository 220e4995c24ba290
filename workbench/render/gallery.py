"""All pictures of a state at one frequency, and of a chip."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from geometry.chip import Chip
from geometry.measure import Axisymmetric
from geometry.names import CAVITY, role_of
from materials.kinds import Fluid
from workbench.files.errors import InputError
from workbench.render.canvas import Picture
from workbench.simulation.run import DrawnState

#: Fields that can be requested by name.
FIELDS = ("displacement", "pressure", "gorkov", "cutaway", "losses", "mesh", "features", "pattern")

#: Thickness of a fluid, relative to the chip's height, below which it is only a line in a picture.
VISIBLE = 0.01

_Pictures = list[Picture]


def draw_state(
    shot: DrawnState, folder: Path | str, *, only: Sequence[str] | None = None, of: Sequence[str] = FIELDS
) -> list[Picture]:
    """Write the pictures of a state named by `only` to `folder`.

    By default, the useful ones `of` these names (:data:`FIELDS`) that exist: the pressure in a gas is left out.

    Raises:
        InputError: a requested picture that does not exist for the state, with the reason.
    """
    makers: Mapping[str, Callable[[DrawnState, Path], tuple[_Pictures, str]]] = {
        "displacement": _displacement, "pressure": _pressure, "gorkov": _gorkov, "cutaway": _cutaway,
        "losses": _losses, "mesh": _mesh, "features": _features,
        "pattern": _pattern,
    }
    pictures: _Pictures = []
    fluid = shot.problem.materials.get(CAVITY)
    empty = isinstance(fluid, Fluid) and fluid.is_gas
    for name in [name for name in of if not (empty and name == "pressure")] if only is None else only:
        made, missing = makers[name](shot, Path(folder))
        if missing and only is not None:
            raise InputError(f"{shot.chip.file}, state {shot.state}", "field", name, f"another field, since {missing}")
        pictures += made
    return pictures


def _place(shot: DrawnState) -> str:
    return f"{shot.fields.frequency / 1e6:.4f} MHz, {shot.fields.drive}"


def _displacement(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import sections

    path = sections.draw_axial_displacement(shot.fields, folder / f"displacement_{shot.state}.png")
    return [Picture(path, f"{shot.state}: axial displacement in the solids at {_place(shot)}; fluids are white")], ""


def _pressure(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    """The pressure in the cavity, or else in the thickest fluid."""
    from workbench.render import sections

    mesh = shot.fields.mesh
    thickness = {name: float(np.ptp(mesh.points[mesh.nodes_of([name]), 1])) for name in shot.fields.fluid_regions}
    seen = [name for name, size in thickness.items() if size >= VISIBLE * np.ptp(mesh.points[:, 1])]
    if not seen:
        return [], "no fluid is thick enough to be seen"
    region = CAVITY if CAVITY in seen else max(seen, key=lambda name: thickness[name])
    path = sections.draw_pressure(shot.fields, folder / f"pressure_{shot.state}.png", region=region)
    return [Picture(path, f"{shot.state}: pressure in the {region} at {_place(shot)}")], ""


def _gorkov(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import profiles, sections

    if shot.traps is None:
        return [], "the state has no particle in a fluid-filled cavity"
    path = sections.draw_gorkov_potential(shot.traps, folder / f"gorkov_{shot.state}.png")
    pictures = [Picture(path, f"{shot.state}: Gor'kov potential, traps marked; {shot.traps.excitation}")]
    if shot.traps.traps:
        path = profiles.draw_potential_profiles(shot.traps, folder / f"profiles_{shot.state}.png")
        pictures.append(Picture(path, f"{shot.state}: Gor'kov potential along the axis and along the radius, both "
                                "through the deepest trap"))
    return pictures, ""


def _cutaway(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import solids

    if not isinstance(shot.chip.measure, Axisymmetric):
        return [], "the chip is straight, and a cut-open view is one of a body that turns about an axis"
    path = solids.draw_revolved(shot.fields, folder / f"cutaway_{shot.state}.png")
    return [Picture(path, f"{shot.state}: the chip cut open, coloured by the axial displacement at {_place(shot)}")], ""


def _losses(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import plots

    if not sum(shot.losses.values()) > 0.0:
        return [], "no material of the state has a loss"
    # A region without a loss has a bar too, since its material states this.
    losses = {**dict.fromkeys(shot.problem.materials, 0.0), **shot.losses}
    path = plots.draw_loss_budget(losses, folder / f"losses_{shot.state}.png",
                                  title=f"dissipated power, {shot.state}")
    return [Picture(path, f"{shot.state}: power lost by region at {_place(shot)}; closes against the electrical input "
                    f"to {shot.closure:.0e}")], ""


def _mesh(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import sections

    path = sections.draw_regions(shot.fields.mesh, folder / f"mesh_{shot.state}.png")
    return [Picture(path, f"{shot.state}: regions and cells of the mesh")], ""


def _features(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import features

    if not shot.chip.features:
        return [], "the chip file has no features"
    path = features.draw_features(shot.chip, folder / f"features_{shot.state}.png")
    return [Picture(path, f"{shot.state}: features of the chip, from above")], ""


def _pattern(shot: DrawnState, folder: Path) -> tuple[_Pictures, str]:
    from workbench.render import pattern

    if shot.pattern is None:
        return [], "the chip file has no features, or the cavity no liquid"
    path = pattern.draw_pattern(shot.pattern, folder / f"pattern_{shot.state}.png")
    return [Picture(path, f"{shot.state}: the sound in the cavity with features, from above, at {_place(shot)}")], ""


def load_libraries() -> None:
    """Load the libraries for drawing, which takes a second."""
    from workbench.render import plots, profiles, sections, solids  # noqa: F401


def draw_chip(chip: Chip, parts: Mapping[str, Path], path: Path) -> Picture:
    """Draw the STL files of a chip's parts, cut open and exploded."""
    from workbench.render import solids

    shapes = [solids.read_stl(file, metres_per_unit=1e-3) for name, file in parts.items() if role_of(name) != CAVITY]
    solids.draw_solids(shapes, path, title=chip.name, explode=0.35 * chip.layers[-1].z_top, cut_open=True)
    return Picture(path, "the solids of the chip, cut open and pulled apart")
