"""Straight chips whose channels are etched: sloping and rounded walls as shapes and outlines, halves and whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import jnp_zeros
from support import fluid_modes
from test_geometry_straight import CHIP, chip

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import chip_section, volumes
from geometry.free_mesh import moved_free
from geometry.free_section import FreeSection
from geometry.shapes import with_shapes
from geometry.solid import chip_solids
from materials.kinds import Fluid
from workbench.fem.linearised import FullSystem
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised_within
from workbench.model.discretisation import Discretisation
from workbench.model.drive import parse_drive
from workbench.model.problem import Problem, build, fill
from workbench.model.shaped_mesh import shaped
from workbench.simulation.channel import channel_figures
from workbench.simulation.run import Snapshot, snapshot

COARSE = Discretisation(4, 1.4, corner_refinement=0.3, growth=4.0)
FREQUENCY = 1.94e6
#: The base and the walls of the channel, and the two in one piece, into which it is etched.
WALLS = CHIP[CHIP.index('[[layers]]\nrole = "substrate"'):CHIP.index('[[layers]]\nrole = "superstrate"')]
ETCHED = """[[layers]]
role = "substrate"
material = "soda_lime_glass/ono_2020"
thickness = "0.66 mm"
half_width = "1.5 mm"
cavity_width = "380 um"
profile = { parameters = { floor = "0.5 mm", rounding = "80 um" }, points = [
    ["0 mm", "0 mm"], ["half_width", "0 mm"], ["half_width", "thickness"], ["cavity_half_width", "thickness"],
    { at = ["cavity_half_width", "floor"], fillet = "rounding" }, ["0 mm", "floor"]] }

"""
#: A shape of every kind, with ranges.
SHAPES = {"sidewall.draft": (0.2, 0.4), "sidewall.barrel": (-20e-6, 40e-6), "superstrate.bow": (0.0, 6e-6),
          "transducer.dome": (-4e-6, 4e-6)}
SIZES = {"sidewall.draft": 0.3, "sidewall.barrel": 20e-6, "superstrate.bow": 3e-6, "transducer.dome": 2e-6}


def etched(symmetry: str = "even", old: str = "", new: str = "") -> Chip:
    """A channel with a flat floor and rounded corners, as acid etches glass."""
    return chip(CHIP.replace(WALLS, ETCHED.replace(old, new)).replace('"even"', f'"{symmetry}"'))


def sloping(symmetry: str = "even") -> Chip:
    """A stack in which every kind of shape is stated."""
    found = with_shapes(chip(CHIP.replace('"even"', f'"{symmetry}"')), list(SHAPES))
    return found.with_dimensions(SIZES)


def shot_of(found: Chip, accuracy: Discretisation = COARSE) -> Snapshot:
    beads = replace(found.states[0], particle="polystyrene", particle_radius=2.5e-6)
    return snapshot(replace(found, states=(beads,)), None, FREQUENCY, drive=parse_drive("1 Vpp"), accuracy=accuracy)


@pytest.mark.parametrize("made", [etched, sloping])
def test_halves_equal_the_whole_and_so_do_their_solids(made: Callable[[str], Chip]) -> None:
    half, whole = made("even"), made("none")
    for region, volume in volumes(half).items():
        assert volumes(whole)[region] == pytest.approx(volume, rel=1e-12)
    solids = [chip_solids(each) for each in (half, whole)]
    assert all(len(each.Solids()) == 1 for part in solids for name, each in part.items() if name != "sidewall")
    one, both = (shot_of(each) for each in (half, whole))
    off = abs(one.fields.current / both.fields.current - 1.0)
    print(f"{made.__name__}: current of the half off by {off:.1e}")
    # gmsh fills the rest around a fillet, which is not the mirror image of itself in the whole.
    assert off < (1e-4 if made is etched else 1e-11)


def test_a_wall_that_slopes_is_the_same_as_a_shape_and_as_an_outline() -> None:
    slope = 'cavity_width = "380 um"'
    drafted = chip(CHIP.replace(slope, slope + '\ndraft = "20 deg"'))
    grown = 190e-6 + 160e-6 * np.tan(np.radians(20.0))
    drawn = chip(CHIP.replace(slope, slope + f"""
profile = {{ parameters = {{ top = "{1e6 * grown:.9f} um" }}, points = [["cavity_half_width", "0 mm"],
    ["half_width", "0 mm"], ["half_width", "thickness"], ["top", "thickness"]] }}"""))
    for region, volume in volumes(drafted).items():
        assert volumes(drawn)[region] == pytest.approx(volume, rel=1e-8)
    one, other = (shot_of(each) for each in (drafted, drawn))
    off = abs(one.fields.current / other.fields.current - 1.0)
    print(f"a sloping wall as a shape and as an outline: {off:.1e}")
    # Elements of both end at the same lines, by blending of sides in the one and by their motion in the other.
    assert off < 1e-4
    upright = shot_of(chip()).fields.current
    assert abs(one.fields.current / upright - 1.0) > 1e-2


@pytest.mark.parametrize(("symmetry", "orders"), [("even", (0, 2, 4)), ("odd", (1, 3))])
def test_a_half_round_channel_has_the_modes_of_a_cylinder(
    symmetry: str, orders: tuple[int, ...], rows: Callable[..., NDArray[np.int64]]
) -> None:
    """Between rigid walls: cos(m t) J_m(k r) with J_m'(k R) = 0, t from the lid, m even about an even plane."""
    radius = 0.16e-3
    split = CHIP.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"')
    on_arc = f'["{160 * np.sqrt(0.5):.9f} um", "{660 - 160 * np.sqrt(0.5):.9f} um"]'
    half_round = ETCHED.replace("380 um", "320 um").replace(', rounding = "80 um"', "").replace(
        '{ at = ["cavity_half_width", "floor"], fillet = "rounding" }, ["0 mm", "floor"]',
        f'{{ at = ["0 mm", "floor"], arc = {on_arc} }}')
    found = chip(split.replace(WALLS, half_round).replace('"even"', f'"{symmetry}"'))
    assert volumes(found)["cavity"] == pytest.approx(0.5 * np.pi * radius**2 * 0.02, rel=1e-8)
    made = build(fill(found), accuracy=Discretisation(5, 1.0))
    operators = assemble(made.mesh, made.terms)
    water = made.materials["cavity"]
    assert isinstance(water, Fluid)
    lossless = dict.fromkeys((f"{water.name}.{each}" for each in (
        "shear_viscosity", "thermal_conductivity", "diffusivity_of_sound")), 1e-30)
    values = {**made.values, **lossless}
    modes = fluid_modes(operators, values, rows(operators, "cavity", "p"), 1e7)
    expected = sorted((water.sound_speed * root / radius) ** 2 for m in orders for root in jnp_zeros(m, 2))[:3]
    off = max(np.abs(modes[np.isfinite(modes)] / each - 1.0).min() for each in expected)
    print(f"half round, {symmetry}: w^2 off by {off:.1e}")
    # Order 4 leaves 3e-7, order 5 1.4e-9.
    assert off < 1e-8


def moved(made: Problem, there: Chip, name: str, value: float) -> Problem:
    """The problem on its mesh moved to another size of the chip."""
    if isinstance(made.mesh.section, FreeSection):
        section = chip_section(there.with_dimensions({name: value}), like=made.mesh.section)
        assert isinstance(section, FreeSection)
        return replace(made, mesh=moved_free(made.mesh, section))
    return replace(made, mesh=shaped(replace(made.mesh, coordinates=None), there.with_dimensions({name: value})))


@pytest.mark.parametrize(("made", "symmetry", "ranges"), [
    (sloping, "even", SHAPES),
    (sloping, "none", {name: SHAPES[name] for name in ("sidewall.draft", "transducer.dome")}),
    (etched, "even", {"substrate.floor": (0.495e-3, 0.505e-3), "substrate.rounding": (76e-6, 84e-6)}),
])
def test_derivatives_by_shapes_are_those_of_moved_meshes(
    made: Callable[[str], Chip], symmetry: str, ranges: dict[str, tuple[float, float]]
) -> None:
    there = made(symmetry)
    plain = build(fill(there), accuracy=COARSE)
    flexed = parametrised_within(plain, there, ranges)
    names = tuple(ranges)

    def ln_charge(problem: Problem) -> complex:
        return complex(np.log(FullSystem(assemble(problem.mesh, problem.terms), problem.values).linearised(
            FREQUENCY, ()).charge))

    state = FullSystem(assemble(flexed.mesh, flexed.terms), flexed.values).linearised(FREQUENCY, names)
    assert complex(np.log(state.charge)) == pytest.approx(ln_charge(plain), abs=1e-10)
    for name, found in zip(names, state.charge_by_parameter / state.charge, strict=True):
        here = there.dimensions()[name].value
        ends = [ln_charge(moved(plain, there, name, here * (1.0 + step))) for step in (1e-3, -1e-3)]
        expected = (ends[0] - ends[1]) / (2e-3 * here)
        print(f"{made.__name__}, {symmetry}: {name} off by {abs(found / expected - 1.0):.1e}")
        assert found == pytest.approx(expected, rel=1e-5)


def test_an_etched_channel_has_figures_and_is_written_and_read_back(tmp_path: Path) -> None:
    found = etched()
    assert read_chip(write_chip(found, tmp_path / "chip.toml")).layers == found.layers
    figures = channel_figures(shot_of(found))
    assert np.isfinite(figures.across).all()
    assert np.isfinite(figures.up).all()
    # At mid-height the wall is upright.
    assert figures.across[-1, 0] == pytest.approx(190e-6, rel=1e-9)
    assert figures.lines


@pytest.mark.parametrize(("old", "new", "words"), [
    ('["0 mm", "floor"]', '["-0.1 mm", "floor"]', r"x = -0\.1 mm.*no point beyond the middle: x of zero or more"),
    ("points = [", 'axis = "y", points = [', "points, or a script that draws a face, in a straight chip"),
    ('"half_width", "0 mm"', '"radius", "0 mm"', "did you mean 'half_width'|one of .*half_width"),
    ('floor = "0.5 mm"', 'floor = "0.5 deg"', "a length: that parameter is an angle"),
    ('["half_width", "thickness"]', '["half_width", "0.6 mm"]', "a contact in points alone"),
    ('["cavity_half_width", "thickness"]', '["cavity_half_width", "0.65 mm"]', "a contact in points alone"),
    ('["0 mm", "floor"]', '["50 um", "floor"], ["50 um", "thickness"], ["0 mm", "thickness"]', "leave no gap"),
])
def test_outlines_that_cannot_be_are_told(old: str, new: str, words: str) -> None:
    with pytest.raises(InputError, match="(?s)" + words):
        chip_section(etched("even", old, new))


@pytest.mark.parametrize("gap", ["0.19 mm", "0.25 mm"])
def test_walls_may_pass_lines_that_bound_nothing_beside_them(gap: str) -> None:
    """Silicon etched by KOH: the top of the wall is beyond the end of an electrode far below."""
    slope = 'cavity_width = "380 um"'
    found = chip(CHIP.replace(slope, slope + '\ndraft = "35.26 deg"').replace(
        'live = "bottom"', f'live = "bottom", live_inner_half_width = "{gap}"'))
    assert volumes(found)["cavity"] == pytest.approx(
        (380e-6 + 160e-6 * np.tan(np.radians(35.26))) * 160e-6 * 0.02, rel=1e-9)
    # A folded cell would be refused.
    assert shot_of(found).closure < 1e-9


def test_walls_of_a_channel_beside_the_middle_slope_and_bulge_and_have_no_outline() -> None:
    beside = 'cavity_width = "380 um"\ncavity_offset = "0.4 mm"\n'
    text = CHIP.replace('"even"', '"none"').replace('cavity_width = "380 um"', beside + 'draft = "9 deg"\n'
                                                    'barrel = "20 um"')
    found, mirrored = chip(text), chip(text.replace('"0.4 mm"', '"-0.4 mm"'))
    grown = 160e-6 * np.tan(np.radians(9.0))
    assert volumes(found)["cavity"] == pytest.approx((380e-6 + grown) * 160e-6 * 0.02, rel=1e-9)
    assert chip_solids(found)["substrate"].isValid()
    one, other = (shot_of(each).fields.current for each in (found, mirrored))
    assert one == pytest.approx(other, rel=1e-9)
    with pytest.raises(InputError, match="the middle of the layer, whose profile is equal to both sides"):
        chip(CHIP.replace('"even"', '"none"').replace(WALLS, ETCHED.replace('cavity_width = "380 um"\n', beside)))


def test_a_script_draws_the_cross_section(tmp_path: Path) -> None:
    (tmp_path / "walls.py").write_text("""
import cadquery as cq

def face(half_width, thickness):
    return cq.Workplane("XZ").moveTo(0.19, 0).lineTo(half_width, 0).lineTo(half_width, thickness).lineTo(
        0.25, thickness).close()

def block(half_width, thickness):
    return cq.Workplane("XY").box(half_width, 1, thickness)
""")
    slope = 'cavity_width = "380 um"'
    for name, words in (("face", ""), ("block", "cross-section of a straight chip: a face")):
        path = tmp_path / f"{name}.toml"
        path.write_text(CHIP.replace(slope, f'{slope}\nprofile = {{ script = "walls.py", function = "{name}" }}'))
        found = read_chip(path)
        if words:
            with pytest.raises(InputError, match=words):
                chip_section(found)
        else:
            assert volumes(found)["cavity"] == pytest.approx((0.38e-3 + 0.5e-3) / 2 * 0.16e-3 * 0.02, rel=1e-9)
