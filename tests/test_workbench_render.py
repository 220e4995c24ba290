"""Pictures are drawn, are not blank, and have the right colours in the right places; files for ParaView read back."""

from __future__ import annotations

import ctypes.util
import math
import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import j0
from support import FluidState

from workbench.acoustics.forces import particle_forces
from workbench.acoustics.nodal import NodalMesh, interpolate, mesh_of
from workbench.acoustics.traps import TrapReport, find_traps
from workbench.model.particles import Particle
from workbench.render import canvas, plots, profiles, sections, solids, vtu

needs_graphics = pytest.mark.skipif(
    sys.platform == "linux" and not os.environ.get("DISPLAY") and ctypes.util.find_library("EGL") is None,
    reason="no display and no EGL library (libegl1)",
)

#: Region, and its r and z limits in mm: a disc, a thin gel, a base, a cavity in a ring, and a lid.
LAYOUT = (
    ("transducer", 0.0, 5.0, 0.0, 2.0), ("couplant", 0.0, 5.0, 2.0, 2.1), ("substrate", 0.0, 6.0, 2.1, 3.0),
    ("cavity", 0.0, 3.0, 3.0, 3.7), ("sidewall", 3.0, 6.0, 3.0, 3.7), ("superstrate", 0.0, 6.0, 3.7, 4.7),
)
WATER = FluidState(density=997.0, sound_speed=1497.0, shear_viscosity=0.89e-3)


def chip_mesh() -> NodalMesh:
    low: list[Any] = []
    high: list[Any] = []
    region: list[int] = []
    for index, (_, left, right, bottom, top) in enumerate(LAYOUT):
        lines = (1e-3 * np.linspace(left, right, round(right - left) + 1),
                 1e-3 * np.linspace(bottom, top, max(1, round((top - bottom) / 0.35)) + 1))
        for side, (r, z) in ((low, (lines[0][:-1], lines[1][:-1])), (high, (lines[0][1:], lines[1][1:]))):
            side.append(np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2))
        region.append(np.full(len(low[-1]), index))
    return mesh_of(np.concatenate(low), np.concatenate(high), np.concatenate(region), tuple(e[0] for e in LAYOUT),
                   order=4)


def made_fields() -> Any:
    """u_z = 50 nm everywhere in the solids, 30 degrees behind the voltage; one standing half wave in the cavity."""
    mesh = chip_mesh()
    r, z = mesh.points.T
    late = np.exp(1j * math.pi / 6)
    fluid = mesh.nodes_of(["cavity", "couplant"])
    displacement = np.stack([0.0 * r, np.full(len(r), 50e-9)], axis=1) * late
    omega = 2 * math.pi * 1.03e6
    velocity = -1j * omega * displacement
    displacement[fluid] = np.nan
    pressure = np.full(len(r), np.nan + 0j)
    wave = math.pi / 0.7e-3
    cavity, gel = mesh.nodes_of(["cavity"]), mesh.nodes_of(["couplant"])
    pressure[cavity] = (2e5 * j0(500.0 * r) * np.cos(wave * (z - 3e-3)) * late)[cavity]
    pressure[gel] = 1e5 * late
    slope = -wave * 2e5 * j0(500.0 * r) * np.sin(wave * (z - 3e-3)) * late
    velocity[cavity, 1] = slope[cavity] / (1j * omega * 997.0)
    energy = np.nan_to_num(np.abs(pressure)) ** 2 / 9e9
    return SimpleNamespace(
        mesh=mesh, frequency=1.03e6, voltage=5.0 + 0j, current=0.1 + 0j, power=0.25, displacement=displacement,
        potential=np.full(len(r), np.nan + 0j), pressure=pressure, velocity=velocity,
        stress=np.full((len(r), 4), np.nan + 0j), energy_density=energy, drive="10 Vpp at the electrodes",
    )


@pytest.fixture(scope="module")
def fields() -> Any:
    return made_fields()


@pytest.fixture(scope="module")
def report(fields: Any) -> TrapReport:
    particle = Particle(name="polystyrene", radius=5e-6, density=1050.0, compressibility=2.49e-10)
    return find_traps(particle_forces(fields, particle, fluid=WATER, region="cavity"))


def pixels(path: Path) -> np.ndarray:
    """(height, width, 3) in 0 to 1."""
    from matplotlib.image import imread

    return np.asarray(imread(path))[:, :, :3]


def at(picture: np.ndarray, r: float, z: float, *, span: tuple[float, float, float, float]) -> np.ndarray:
    """The colour at r, z (mm) in a picture of a section whose drawn region spans r, -r and z (mm)."""
    left, right, bottom, top = span
    margin = 0.015 * max(right - left, top - bottom)
    dots = 160.0
    inner = 13.0 - 0.75 - 0.25
    scale = inner / (right - left + 2 * margin)
    x = (0.75 + (r - left + margin) * scale) * dots
    y = (1.3 + (z - bottom + margin) * scale) * dots
    return picture[picture.shape[0] - round(y), round(x)]


SECTION = (-6.0, 6.0, 0.0, 4.7)


@needs_graphics
def test_displacement_fills_the_solids_and_leaves_the_fluids_white(fields: Any, tmp_path: Path) -> None:
    path = sections.draw_axial_displacement(fields, tmp_path / "new folder" / "uz.png")
    picture = pixels(path)
    # RdBu_r: its last colour at the largest positive value, on both sides of the axis.
    for r, z in ((0.5, 1.0), (-0.5, 1.0), (4.5, 3.35), (-4.5, 3.35), (2.0, 4.5)):
        np.testing.assert_allclose(at(picture, r, z, span=SECTION), [0.404, 0.0, 0.122], atol=0.02)
    for r, z in ((0.5, 3.35), (-2.0, 3.35), (5.6, 1.0), (2.0, 2.05)):
        np.testing.assert_allclose(at(picture, r, z, span=SECTION), 1.0, atol=0.02)
    assert [p.name for p in path.parent.iterdir()] == ["uz.png"]


@needs_graphics
def test_pressure_is_red_below_and_blue_above_and_only_in_fluids(fields: Any, tmp_path: Path) -> None:
    picture = pixels(sections.draw_pressure(fields, tmp_path / "p.png"))
    below, above = at(picture, 0.2, 3.1, span=SECTION), at(picture, 0.2, 3.6, span=SECTION)
    assert below[0] > 2 * below[2]
    assert above[2] > 2 * above[0]
    # The node plane at mid-height is as white as the solids, but for the 10 um that a dot is high.
    for z in (3.35, 1.0, 2.6):
        np.testing.assert_allclose(at(picture, 0.2, z, span=SECTION), 1.0, atol=0.1)
    close = pixels(sections.draw_pressure(fields, tmp_path / "close.png", region="cavity"))
    assert at(close, 0.2, 3.02, span=(-3.0, 3.0, 3.0, 3.7))[2] < 0.3


@needs_graphics
def test_gorkov_potential_is_dark_at_the_trap_and_bright_at_the_wall(report: TrapReport, tmp_path: Path) -> None:
    assert report.traps[0].height == pytest.approx(3.35e-3, abs=1e-6)
    picture = pixels(sections.draw_gorkov_potential(report, tmp_path / "u.png"))
    span = (-3.0, 3.0, 3.0, 3.7)
    # viridis: (0.27, 0.00, 0.33) to (0.99, 0.91, 0.14).
    np.testing.assert_allclose(at(picture, 0.15, 3.35, span=span), [0.27, 0.0, 0.33], atol=0.06)
    np.testing.assert_allclose(at(picture, 0.03, 3.01, span=span), [0.99, 0.91, 0.14], atol=0.06)


@needs_graphics
def test_regions_have_the_colours_of_their_roles(fields: Any, tmp_path: Path) -> None:
    picture = pixels(sections.draw_regions(fields.mesh, tmp_path / "regions.png", show_cells=False))
    for name, left, right, bottom, top in LAYOUT:
        wanted = [int(canvas.ROLE_COLOURS[name][k:k + 2], 16) / 255 for k in (1, 3, 5)]
        seen = at(picture, (left + right) / 2, (bottom + top) / 2, span=SECTION)
        np.testing.assert_allclose(seen, wanted, atol=0.03, err_msg=name)
    with_cells = pixels(sections.draw_regions(fields.mesh, tmp_path / "cells.png"))
    assert np.abs(with_cells - picture).mean() > 1e-3


@needs_graphics
def test_the_revolved_chip_shows_field_and_water(fields: Any, tmp_path: Path) -> None:
    picture = pixels(solids.draw_revolved(fields, tmp_path / "revolved.png"))
    flat = picture[130:-180].reshape(-1, 3)
    dark_red = (np.abs(flat - [0.404, 0.0, 0.122]) < 0.03).all(axis=1).mean()
    water = (np.abs(flat - [0.749, 0.890, 0.949]) < 0.03).all(axis=1).mean()
    # The unlit cut faces alone are a tenth of the picture; the cavity's is some per cent of it.
    assert dark_red > 0.05
    assert water > 0.005
    assert (flat > 0.99).all(axis=1).mean() > 0.2
    # Upright: one looks into the cut from above, so the water at the axis is higher in the picture than at the rim.
    rows, columns = np.nonzero((np.abs(picture[130:-180] - [0.749, 0.890, 0.949]) < 0.03).all(axis=2))
    middle = np.abs(columns - columns.mean()) < 0.1 * np.ptp(columns)
    rim = np.abs(columns - columns.mean()) > 0.4 * np.ptp(columns)
    assert rows[middle].mean() < rows[rim].mean() - 50


def test_a_swept_surface_turns_every_node_by_the_same_angles(fields: Any) -> None:
    mesh = fields.mesh
    edges = mesh.cells[:3, -1, :]
    points, quads, nodes = solids._swept(mesh, edges, degrees=250.0)
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), mesh.points[nodes, 0], rtol=1e-12)
    np.testing.assert_array_equal(points[:, 2], mesh.points[nodes, 1])
    # Four quadrilaterals an edge of order 4, and one more turn of points than of quadrilaterals.
    assert len(quads) == 3 * 4 * (len(points) // len(np.unique(edges)) - 1)
    turned = np.degrees(np.arctan2(points[quads, 1], points[quads, 0])) % 360.0
    np.testing.assert_allclose(np.ptp(turned, axis=1), 2.0, rtol=1e-9)


@needs_graphics
def test_solids_from_stl_files(tmp_path: Path) -> None:
    # Two tetrahedra as ASCII STL in millimetres.
    corners = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], dtype=float)
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    loaded = []
    for name, lift in (("substrate", 0.0), ("transducer", 12.0)):
        text = [f"solid {name}"]
        for face in faces:
            vertices = "\n".join("vertex {:g} {:g} {:g}".format(*(corners[k] + [0, 0, lift])) for k in face)
            text.append(f"facet normal 0 0 0\nouter loop\n{vertices}\nendloop\nendfacet")
        (tmp_path / f"{name}.stl").write_text("\n".join([*text, f"endsolid {name}"]))
        loaded.append(solids.read_stl(tmp_path / f"{name}.stl", metres_per_unit=1e-3))
    assert [solid.name for solid in loaded] == ["substrate", "transducer"]
    np.testing.assert_allclose(np.ptp(loaded[0].vertices, axis=0), 0.01, rtol=1e-6)
    picture = pixels(solids.draw_solids(loaded, tmp_path / "cad.png", title="two", explode=2e-3))
    assert picture[100:-50, :1000].std() > 0.05
    with pytest.raises(ValueError, match="no solids"):
        solids.draw_solids([], tmp_path / "none.png", title="none")
    with pytest.raises(FileNotFoundError, match=r"no STL file at .*absent\.stl"):
        solids.read_stl(tmp_path / "absent.stl", metres_per_unit=1e-3)


@needs_graphics
@pytest.mark.parametrize("size", [(4e-3, 4e-3, 20e-3), (25e-3, 25e-3, 0.2e-3), (3e-3, 3e-3, 3e-3)])
def test_a_photograph_holds_all_of_any_shape(size: tuple[float, float, float]) -> None:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (2.0, 3.0)]) * size
    sides = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    black = canvas.DrawnShape(corners, sides, "black")
    picture = canvas.photograph([black], azimuth=-75.0, elevation=24.0, width=300, height=200)
    rows, columns = np.nonzero((picture < 128).all(axis=2))
    # The margin is 3 % of what it is as large as: nothing at an edge, and one direction filled.
    assert rows.min() > 0
    assert rows.max() < 199
    assert columns.min() > 0
    assert columns.max() < 299
    assert max(np.ptp(rows) / 200, np.ptp(columns) / 300) == pytest.approx(1.0 / 1.03, abs=0.02)


def test_a_flat_section_is_drawn_stretched_and_says_so() -> None:
    flat, whole = (sections._window(np.array([[0.0, 0.0], [radius, height]]))
                   for radius, height in ((9e-3, 0.25e-3), (13e-3, 5e-3)))
    assert whole.tall == 1.0
    # 8 % of 18 mm is six times 0.25 mm.
    assert flat.tall == 6.0
    figure, axes, _ = sections._frame(flat, title="pressure")
    assert axes.get_title().endswith("heights are drawn 6 times as large as widths")
    assert axes.get_aspect() == 6.0
    width, height = sections._dots(flat)
    assert height / width == pytest.approx(6.0 * (flat.top - flat.bottom) / (flat.right - flat.left), rel=0.01)
    assert figure.get_figheight() > 2.0


def test_a_line_is_drawn_through_its_interpolant_and_dots_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from workbench.results.spectrum import Spectrum

    made = spectrum(1.0e6)
    few = Spectrum(np.asarray(made.frequency)[::10], np.asarray(made.impedance)[::10])
    drawn: list[int] = []
    monkeypatch.setattr(plots, "save_impedance", lambda _figure, magnitude, *_, **__: drawn.extend(
        len(line.get_xdata()) for line in magnitude.lines))
    plots.draw_spectra({"a": few, "b": few}, tmp_path / "a.png", measured=["b"])
    count = len(few.frequency)
    assert drawn == [(count - 1) * plots.BETWEEN + 1, count]


@pytest.mark.parametrize(("low", "high", "label"), [(30.0, 80.0, "40"), (2e4, 6e4, "40000"), (5.0, 5e3, r"10^{2}")])
def test_a_logarithmic_axis_within_a_decade_has_plain_numbers(low: float, high: float, label: str) -> None:
    axes = plots.new_figure(4.0, 3.0).subplots()
    axes.plot([0.0, 1.0], [low, high])
    plots.logarithmic(axes)
    axes.figure.canvas.draw()
    labels = [text.get_text() for text in (*axes.get_yticklabels(), *axes.get_yticklabels(minor=True))]
    assert any(label in text for text in labels), labels
    assert (high > 10.0 * low) == any("10^" in text for text in labels)


def test_a_lossless_region_has_its_bar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(plots, "save_figure",
                        lambda figure, _: said.extend(text.get_text() for text in figure.axes[0].texts))
    plots.draw_loss_budget({"couplant": 0.0, "substrate": 3e-3, "transducer": 1e-3}, tmp_path / "a.png", title="t")
    assert said == ["lossless", "25 %", "75 %"]


def spectrum(resonance: float) -> Any:
    frequency = np.linspace(0.95e6, 1.1e6, 200)
    detuning = 1j * 80 * (frequency / resonance - resonance / frequency)
    admittance = 2j * np.pi * frequency * 2e-9 + 1 / (3 * (1 + detuning))
    return SimpleNamespace(frequency=frequency, impedance=1 / admittance)


def is_whole(path: Path) -> bool:
    if path.suffix == ".svg":
        return path.read_text(encoding="utf-8").rstrip().endswith("</svg>")
    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    return data.endswith(b"IEND\xaeB`\x82") and width > 500 and height > 200 and float(pixels(path).std()) > 0.05


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_curves_are_drawn(suffix: str, report: TrapReport, tmp_path: Path) -> None:
    names = {"model": spectrum(1.0286e6), "measured": spectrum(1.0284e6)}
    draw: dict[str, Callable[[Path], Path]] = {
        "spectra": lambda path: plots.draw_spectra(names, path, measured=["measured"], title="empty"),
        "residuals": lambda path: plots.draw_residuals(np.linspace(1e6, 1.1e6, 9), {"fit": np.arange(9) - 4.0}, path,
                                                       label="residual / sigma", band=1.0),
        "profiles": lambda path: profiles.draw_potential_profiles(report, path),
        "losses": lambda path: plots.draw_loss_budget({"substrate": 0.06, "transducer": 0.03}, path, title="losses"),
        "convergence": lambda path: plots.draw_convergence(np.array([4e-4, 2e-4]), {"u": np.array([1e-3, 6e-5])}, path,
                                                           title="convergence", order=4.0),
    }
    for name, function in draw.items():
        path = tmp_path / (name + suffix)
        assert function(path) == path
        assert is_whole(path), name


def test_what_cannot_be_drawn_is_refused(report: TrapReport, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"the suffix is '.jpeg'; expected .png or .svg"):
        plots.draw_spectra({"a": spectrum(1e6)}, tmp_path / "a.jpeg")
    with pytest.raises(ValueError, match="measured spectrum 'b' is not one of a"):
        plots.draw_spectra({"a": spectrum(1e6)}, tmp_path / "a.png", measured=["b"])
    with pytest.raises(ValueError, match=r"the losses add up to 0\.0 W"):
        plots.draw_loss_budget({"substrate": 0.0}, tmp_path / "a.png", title="none")
    with pytest.raises(ValueError, match="no finite value to draw"):
        sections.at_largest(np.full(3, np.nan + 0j))
    with pytest.raises(ValueError, match="no trap in this field"):
        profiles.draw_potential_profiles(TrapReport(forces=report.forces, traps=()), tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_a_field_is_shown_when_it_is_largest() -> None:
    shown, phase = sections.at_largest(np.array([1.0 + 1.0j, np.nan, -2.0 - 2.0j, 1.0 - 1.0j]))
    # At the phase at which the largest is real and positive, the one opposite is negative, the one across is zero.
    np.testing.assert_allclose(shown, [-math.sqrt(2), np.nan, math.sqrt(8), 0.0], atol=1e-12)
    assert phase == pytest.approx(-135.0)


def test_the_title_says_how_late_the_field_is(fields: Any) -> None:
    _, phase = sections.at_largest(fields.displacement[:, 1])
    # e^{-i w t}: an amplitude with a phase of +30 degrees peaks 30 degrees after the voltage.
    assert "30° after that of the voltage" in sections.phase_title(fields, phase)
    assert "10 Vpp" in sections.phase_title(fields, phase)


@pytest.mark.parametrize(
    ("largest", "unit", "factor", "label"),
    [(5.4e-8, "m", 1e9, "nm"), (4e5, "Pa", 1e-3, "kPa"), (1.2e6, "Pa", 1e-6, "MPa"), (4.1e-15, "J", 1e15, "fJ"),
     (1e-12, "N", 1e12, "pN"), (0.0, "Pa", 1.0, "Pa")],
)
def test_units_get_the_prefix_that_suits_them(largest: float, unit: str, factor: float, label: str) -> None:
    found, text = canvas.prefixed(largest, unit)
    assert found == pytest.approx(factor, rel=1e-12)
    assert text == label


def test_a_repeated_role_keeps_its_colour() -> None:
    assert canvas.role_colour("bond_2") == canvas.role_colour("bond") == canvas.ROLE_COLOURS["bond"]
    assert canvas.role_colour("holder") == canvas.OTHER_COLOUR


def test_every_role_has_a_colour() -> None:
    from geometry import names

    known = next(value for value in vars(names).values()
                 if isinstance(value, tuple | frozenset) and "couplant" in value and "transducer" in value)
    assert set(known) <= set(canvas.ROLE_COLOURS)


def test_vtu_keeps_every_number(fields: Any, tmp_path: Path) -> None:
    import pyvista

    path = vtu.write_vtu(fields, tmp_path / "out" / "chip.vtu")
    assert [p.name for p in path.parent.iterdir()] == ["chip.vtu"]
    grid, mesh = pyvista.read(path), fields.mesh
    assert set(grid.celltypes) == {70}  # VTK_LAGRANGE_QUADRILATERAL
    cells = grid.cell_connectivity.reshape(len(mesh.cells), -1)
    assert cells.shape == (len(mesh.cells), 25)
    # Corners are where and what they were; the nodes between are equally spaced instead of Gauss-Lobatto's.
    corners = mesh.cells[:, [0, -1, -1, 0], [0, 0, -1, -1]]
    points = np.asarray(grid.points)[:, :2]
    np.testing.assert_array_equal(cells[:, :4], corners)
    np.testing.assert_allclose(points[corners], mesh.points[corners], rtol=1e-13, atol=1e-17)
    low, high = mesh.boxes
    np.testing.assert_allclose(points[cells[:, 4]], low + (high - low) * [0.25, 0.0], rtol=1e-12, atol=1e-16)
    np.testing.assert_array_equal(grid["region"], mesh.region)
    assert list(grid.field_data["region_names"]) == list(mesh.regions)
    assert float(grid.field_data["frequency"][0]) == fields.frequency
    assert "stress_real" not in grid.point_data  # it lives nowhere in these fields
    pressure = grid["pressure_real"] + 1j * grid["pressure_imag"]
    for index, name in enumerate(mesh.regions):
        # A point that two regions share belongs to each: every one keeps its own values, and NaN where it has none.
        own = cells[mesh.region == index].ravel()
        expected = interpolate(mesh, fields.pressure, points[own], [name])
        np.testing.assert_allclose(pressure[own], expected, rtol=1e-10, atol=1e-6)
        displacement = (grid["displacement_real"] + 1j * grid["displacement_imag"])[own]
        np.testing.assert_allclose(displacement[:, :2], interpolate(mesh, fields.displacement, points[own], [name]),
                                   rtol=1e-10, atol=1e-20)


def test_vtk_reads_between_the_nodes_what_the_fields_are_there(fields: Any, tmp_path: Path) -> None:
    import pyvista

    grid, mesh = pyvista.read(vtu.write_vtu(fields, tmp_path / "chip.vtu")), fields.mesh
    random = np.random.default_rng(6)
    points = np.stack([3e-3 * random.random(300), 3e-3 + 0.7e-3 * random.random(300)], axis=1)
    water = grid.extract_cells(np.flatnonzero(mesh.region == mesh.regions.index("cavity")))
    probed = pyvista.PolyData(np.column_stack([points, np.zeros(300)])).sample(water)
    assert probed["vtkValidPointMask"].all()
    expected = interpolate(mesh, fields.pressure, points, ["cavity"])
    # VTK inverts the map of a cell to 1e-6 of its size; of linear cells between the nodes 6 % would be expected.
    np.testing.assert_allclose(probed["pressure_real"] + 1j * probed["pressure_imag"], expected,
                               atol=1e-4 * np.abs(expected).max())


def test_vtu_refuses_another_suffix(fields: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"the suffix is '.vtk'; expected .vtu"):
        vtu.write_vtu(fields, tmp_path / "a.vtk")


def test_importing_render_loads_neither_vtk_nor_matplotlib() -> None:
    import subprocess

    code = ("import sys; from workbench.render import canvas, plots, profiles, sections, solids, vtu; "
            "print([m for m in ('pyvista', 'vtk', 'vtkmodules', 'matplotlib') if m in sys.modules])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          cwd=Path(__file__).resolve().parent.parent)
    assert done.stdout.strip() == "[]"
