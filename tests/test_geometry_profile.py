"""Layers of any shape in chip files: what is read and written, and every mistake named with its place."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from support import layer_text

import geometry
from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import chip_section, volumes
from geometry.dimension import Dimension
from geometry.export import export_step
from geometry.free_section import FreeSection
from workbench.files.errors import InputError
from workbench.model.problem import LeftOutWarning, build, fill

pytest.importorskip("cadquery")

pytestmark = pytest.mark.usefixtures("kernel_here")

CHIP = """
[chip]
name = "ring of any shape"
band = ["0.9 MHz", "1.1 MHz"]
""" + "".join((
    layer_text("transducer", "pzt4/acevedo_2026_fitted", thickness="2 mm", radius="12.5 mm"),
    layer_text("substrate", "pla/acevedo_2026", thickness="0.85 mm", radius="13 mm"),
    layer_text("sidewall", "pla/acevedo_2026", thickness="0.72 mm", radius="13 mm", cavity_radius="4 mm",
               profile='{ PROFILE }'),
    layer_text("superstrate", "soda_lime_glass/independent_reference", thickness="1 mm", radius="13 mm"),
)) + """
[states.filled]
cavity = "water"
"""

SCRIPT = '''"""Rings of several makes, right ones and wrong ones."""
import cadquery as cq


def ring(thickness, radius, cavity_radius):
    return cq.Workplane().circle(radius).circle(cavity_radius).extrude(thickness)


def cone(thickness, radius, cavity_radius, opening):
    """The wall leans outwards by an angle in degrees."""
    import math
    top = cavity_radius + thickness * math.tan(math.radians(opening))
    return cq.Workplane("XZ").polyline([(cavity_radius, 0), (radius, 0), (radius, thickness), (top, thickness)]).close()


def line(thickness, radius, cavity_radius):
    return cq.Workplane("XZ").moveTo(cavity_radius, 0).lineTo(radius, 0).lineTo(radius, thickness)


def listed(thickness, radius, cavity_radius):
    return [ring(thickness, radius, cavity_radius)]


def beside(thickness, radius, cavity_radius):
    return ring(thickness, radius, cavity_radius).translate((1, 0, 0))


def square(thickness, radius, cavity_radius):
    return cq.Workplane().rect(2 * radius, 2 * radius).circle(cavity_radius).extrude(thickness)


def drilled(thickness, radius, cavity_radius):
    return ring(thickness, radius, cavity_radius).faces(">Z").workplane().center(8, 0).hole(1)


def twice(thickness, radius, cavity_radius):
    return cq.Compound.makeCompound([ring(thickness, radius, r).val() for r in (cavity_radius, radius - 1)])


def level(thickness, radius, cavity_radius):
    points = [cq.Vector(x, y, 0) for x, y in ((0, 0), (1, 0), (1, 1))]
    return cq.Face.makeFromWires(cq.Wire.makePolygon(points, close=True))


def metres(thickness, radius, cavity_radius):
    return ring(thickness / 1e3, radius / 1e3, cavity_radius / 1e3)


def hanging(thickness, radius, cavity_radius):
    return ring(thickness, radius, cavity_radius).translate((0, 0, -thickness))


def broken(thickness):
    return 1 / 0


def deep(thickness, depth):
    return ring(thickness, depth, 4)


def high(thickness, radius, cavity_radius):
    return ring(1.2 * thickness, radius, cavity_radius)
'''


def points(*corners: tuple[str, str]) -> str:
    return "points = [" + ", ".join(f'["{r}", "{z}"]' for r, z in corners) + "]"


#: Floor of the ring, both ends of its outer side, and the upper end of its hole.
A, B, C, D = ("4 mm", "0 mm"), ("13 mm", "0 mm"), ("13 mm", "0.72 mm"), ("4 mm", "0.72 mm")

#: Volume (m^3) of the plain ring.
RING = math.pi * (13e-3**2 - 4e-3**2) * 0.72e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script, and STEP files in millimetres and of numbers that are metres."""
    import cadquery

    there = tmp_path_factory.mktemp("profiles")
    (there / "rings.py").write_text(SCRIPT, encoding="utf-8")
    for name, scale in (("ring.step", 1.0), ("metres.step", 1e-3)):
        ring = cadquery.Workplane().circle(13 * scale).circle(4 * scale).extrude(0.72 * scale)
        disc = cadquery.Workplane().circle(13 * scale).extrude(1 * scale).translate((0, 0, 3.57 * scale))
        assembly = cadquery.Assembly(name="chip").add(ring.translate((0, 0, 2.85 * scale)), name="ring")
        assembly.add(disc, name="lid").export(str(there / name))
    (there / "text.step").write_text("hello", encoding="utf-8")
    return there


def written(folder: Path, profile: str) -> Chip:
    file = folder / "chip.toml"
    file.write_text(CHIP.replace("PROFILE", profile), encoding="utf-8")
    return read_chip(file)


@pytest.mark.parametrize(("profile", "message"), [
    (points(A, B), r"layers\[2\].profile.points: .*three or more points"),
    (points(("4", "0 mm"), B, C), r"points\[0\]\[0\]: received '4'; expected a length in one of"),
    (points(A, ("radios", "0 mm"), C), r"points\[1\]\[0\]: received 'radios'.*did you mean 'radius'"),
    (points(A, C, B, D), r"points: received '\(8.5 mm, 0.36 mm\)'.*does not cross itself"),
    (points(("-4 mm", "0 mm"), B, C, ("-4 mm", "0.72 mm")), r"received 'r = -4 mm'.*beyond the axis"),
    (points(("4 mm", "-0.1 mm"), B, C, D),
     r"substrate and sidewall: received 'an overlap of 0.45 mm\^2 about \(7 mm, 2.817 mm\)"),
    (points(("4 mm", "0.1 mm"), ("13 mm", "0.1 mm"), C, D), r"layer sidewall: received 'a gap of 0.1 mm below it"),
    (points(A, ("6 mm", "0.1 mm"), ("7 mm", "0 mm"), B, C, D),
     r"substrate, sidewall: received 'a gap of 0.15 mm\^2 about \(5.667 mm, 2.883 mm\)'"),
    (points(A, B, ("13 mm", "0.6 mm"), ("4 mm", "0.6 mm")), r"layer superstrate: received 'a gap of 0.12 mm below it"),
    (points(A, B, B, C, D), r"points\[2\]: received '\(13 mm, 0 mm\)'; expected another place"),
    ('points = [["4 mm", "0 mm"], ["13 mm", "0 mm"], ["13 mm", "0.72 mm"], '
     '{ at = ["4 mm", "0.72 mm"], fillet = "2 mm" }]',
     r"points\[3\].fillet: received '2 mm'; expected a radius that fits .* \(4 mm, 0.72 mm\)"),
    ('points = [["4 mm", "0 mm"], { at = ["13 mm", "0 mm"], arc = ["9 mm", "0 mm"] }, ["13 mm", "0.72 mm"]]',
     r"points\[1\].arc: received '\(9 mm, 0 mm\)'; expected a point beside the line"),
    ('points = [["4 mm", "0 mm"], { at = ["13 mm", "0 mm"], bend = 1 }, ["13 mm", "0.72 mm"]]', r"bend.*one of"),
    ('script = "rings.py", function = "ring", points = []', r"received \['points', 'script'\]; expected one of points"),
    ('parameters = { a = "1 mm" }', r"profile: missing; expected one of points, script, step"),
    ('scrip = "rings.py"', r"profile.scrip.*did you mean 'script'"),
    ('script = "rings.py", function = "ring", parameters = { radius = "1 mm" }', r"parameters.radius.*no key of"),
    ('script = "rings.py", function = "ring", parameters = { fill = "1 mm" }', r"expected one called 'fill'"),
    ('script = "ring.py", function = "ring"', r"profile.script: received 'ring.py'.*did you mean 'rings.py'"),
    ('script = "rings.py", function = "rings"', r"rings.py: function: received 'rings'.*did you mean 'ring'"),
    ('script = "rings.py", function = "line"', r"a wire from \(4 mm, 0 mm\) to \(13 mm, 0.72 mm\).*closed one"),
    ('script = "rings.py", function = "listed"', r"rings.py: listed: received 'list'; expected a CadQuery solid"),
    ('script = "rings.py", function = "twice"', r"twice: received '2 solids'; expected one solid"),
    ('script = "rings.py", function = "beside"', r"beside: received 'a body of revolution about z through x = 1 mm'; "
     r'.*origin = \["1 mm", "0 mm", "0 mm"\]'),
    ('script = "rings.py", function = "square"',
     r"square: received '19.8 % of its volume.*axisymmetric only: .* a disc of its thickness and area"),
    ('script = "rings.py", function = "metres"', r"metres: received 'a solid 0.026 mm wide'; .*are in millimetres"),
    ('script = "rings.py", function = "hanging"', r"hanging: received 'a body upside down, from z = -0.72 to 0 mm'"),
    ('script = "rings.py", function = "line", axis = "y"', r"line: received 'no solid'; expected a solid: axis,"),
    ('script = "rings.py", function = "ring", axis = "up"', r"axis: received 'up'; expected one of x, y, z, -x,"),
    ('script = "rings.py", function = "ring", origin = ["1 mm"]', r"origin: .*a point on the axis"),
    ('script = "rings.py", function = "ring", sector = "0 deg"', r"sector: received '0 deg'; expected an angle"),
    (points(A, B, C, D) + ', axis = "y"', r"profile.axis: received 'y'; expected none for points"),
    ('script = "rings.py", function = "drilled"',
     r"received '0.164 % of its volume \(0.5655 mm\^3 in 1 places\) .*most at r = 8 mm, z = 0.36 mm"),
    ('script = "rings.py", function = "level"', r"received 'a face from y = 0 to 1 mm'"),
    ('script = "rings.py", function = "broken"', r"line 54, broken\(thickness = 0.72\): received 'ZeroDivisionError"),
    ('script = "rings.py", function = "deep"', r"parameter of deep: received 'depth'; expected one of cavity_radius"),
    ('script = "rings.py", function = "high"', r"sidewall and superstrate: received 'an overlap of 1.296 mm\^2"),
    ('step = "ring.step", part = "rang"', r"ring.step: part: received 'rang'.*did you mean 'ring'"),
    ('step = "metres.step", part = "ring"', r"'parts that are 0.026 mm wide together'.*scale = \"1 m\""),
    ('step = "text.step", part = "ring"', r"text.step: STEP file: .*expected a STEP file of solids"),
])
def test_mistakes_are_named_with_their_place(profile: str, message: str, folder: Path) -> None:
    with pytest.raises(InputError, match=message):
        chip_section(written(folder, profile))


@pytest.mark.parametrize(("corners", "message"), [
    ((("1 mm", "0 mm"), ("13 mm", "0 mm"), ("13 mm", "0.85 mm"), ("1 mm", "0.85 mm")),
     r"layers\[1\].profile: received 'r = 1 mm and more'; expected an outline that reaches the axis"),
    ((("0 mm", "0.1 mm"), ("3 mm", "0 mm"), ("13 mm", "0 mm"), ("13 mm", "0.85 mm"), ("0 mm", "0.85 mm")),
     r"layers transducer, substrate: received 'a gap of 0.15 mm\^2 about \("),
])
def test_what_leaves_the_axis_is_named(corners: tuple[tuple[str, str], ...], message: str, folder: Path) -> None:
    file = folder / "hollow.toml"
    text = CHIP.replace("profile = { PROFILE }\n", "")
    layer = 'thickness = "0.85 mm"\n'
    file.write_text(text.replace(layer, f"{layer}profile = {{ {points(*corners)} }}\n"), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        chip_section(read_chip(file))


def test_an_open_cavity_says_where(folder: Path) -> None:
    """The lid is held by a pillar at the axis, and the wall ends below it."""
    pillar = points(("0 mm", "0 mm"), ("13 mm", "0 mm"), ("13 mm", "0.85 mm"), ("1 mm", "0.85 mm"), ("1 mm", "1.57 mm"),
                    ("0 mm", "1.57 mm"))
    layer = 'thickness = "0.85 mm"\n'
    text = CHIP.replace(layer, f"{layer}profile = {{ {pillar} }}\n")
    file = folder / "open.toml"
    file.write_text(text.replace("PROFILE", points(A, B, ("13 mm", "0.7 mm"), ("4 mm", "0.7 mm"))), encoding="utf-8")
    with pytest.raises(InputError, match=r"cavity: received 'an opening between sidewall and superstrate, 0.02 mm"):
        chip_section(read_chip(file))
    file.write_text(text.replace("PROFILE", points(A, B, C, D)), encoding="utf-8")
    ring = math.pi * (4e-3**2 - 1e-3**2) * 0.72e-3
    assert volumes(read_chip(file))["cavity"] == pytest.approx(ring, rel=1e-12), "a cavity around a pillar is one"


@pytest.mark.parametrize("profile", [
    points(A, B, C, D),
    points(("cavity_radius", "0 mm"), ("radius", "0 mm"), ("radius", "thickness"), ("cavity_radius", "thickness")),
    'script = "rings.py", function = "ring"',
    'script = "rings.py", function = "cone", parameters = { opening = "0 deg" }',
    'step = "ring.step", part = "ring"',
    'step = "ring.step", part = "ring", scale = "1 mm"',
])
def test_one_ring_from_all_sources(profile: str, folder: Path) -> None:
    section = chip_section(written(folder, profile))
    assert isinstance(section, FreeSection)
    assert section.volume("sidewall") == pytest.approx(RING, rel=1e-12)
    assert section.volume("cavity") == pytest.approx(math.pi * 4e-3**2 * 0.72e-3, rel=1e-12)
    assert section.area("substrate") == pytest.approx(13e-3 * 0.85e-3, rel=1e-12)
    assert not section.notes


def test_what_does_not_turn_about_the_axis_is_left_out_and_said(folder: Path) -> None:
    section = chip_section(written(folder, 'script = "rings.py", function = "drilled", asymmetry = "1 %"'))
    assert isinstance(section, FreeSection)
    (note,) = section.notes
    assert note.startswith("sidewall: 0.164 % of its volume (0.5655 mm^3 in 1 places)")
    assert section.volume("sidewall") == pytest.approx(RING, rel=1e-12)


def test_parameters_are_dimensions(folder: Path) -> None:
    chip = written(folder, 'script = "rings.py", function = "cone", '
                           'parameters = { opening = { value = "5 deg", tolerance = "1 deg" } }')
    assert chip.dimensions()["sidewall.opening"] == Dimension(math.radians(5.0), math.radians(1.0))
    steep = chip.with_dimensions({"sidewall.opening": math.radians(10.0)})
    for each, degrees in ((chip, 5.0), (steep, 10.0)):
        top = 4e-3 + 0.72e-3 * math.tan(math.radians(degrees))
        cone = math.pi * 0.72e-3 / 3.0 * (4e-3**2 + 4e-3 * top + top**2)
        assert volumes(each)["cavity"] == pytest.approx(cone, rel=1e-12)


def test_a_fillet_takes_what_it_should(folder: Path) -> None:
    """Rounding a corner by the radius a takes (1 - pi / 4) a^2 of the area."""
    chip = written(folder, 'parameters = { fillet = "0.2 mm" }, points = [["4 mm", "0 mm"], ["13 mm", "0 mm"], '
                           '["13 mm", "0.72 mm"], { at = ["4 mm", "0.72 mm"], fillet = "fillet" }]')
    section = chip_section(chip)
    plain = 9e-3 * 0.72e-3
    assert section.area("sidewall") == pytest.approx(plain - (1.0 - math.pi / 4.0) * 0.2e-3**2, rel=1e-12)
    assert section.area("cavity") == pytest.approx(4e-3 * 0.72e-3 + (1.0 - math.pi / 4.0) * 0.2e-3**2, rel=1e-12)
    none = chip_section(chip.with_dimensions({"sidewall.fillet": 0.0}))
    assert none.area("sidewall") == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize("profile", [
    'asymmetry = 0.01, script = "rings.py", function = "drilled"',
    'script = "rings.py", function = "cone", parameters = { opening = { value = "5 deg", note = "measured" } }',
    'step = "ring.step", part = "ring", scale = "1 um"',
    'parameters = { fillet = "0.2 mm" }, points = [["4 mm", "0 mm"], '
    '{ at = ["13 mm", "0 mm"], arc = ["9 mm", "-1 mm"] }, ["13 mm", "thickness"], '
    '{ at = ["4 mm", "0.72 mm"], fillet = "fillet", through = [["8 mm", "0.8 mm"]] }]',
])
def test_profiles_survive_being_written(profile: str, folder: Path, tmp_path: Path) -> None:
    if "1 um" in profile:
        profile = profile.replace('"1 um"', '"2 mm"')
    chip = written(folder, profile)
    again = read_chip(write_chip(chip, tmp_path / "elsewhere.toml"))
    for one, other in zip(chip.layers, again.layers, strict=True):
        assert (one.profile is None) == (other.profile is None)
        if one.profile is not None and other.profile is not None:
            assert other.profile.parameters == one.profile.parameters
            assert other.profile.asymmetry == one.profile.asymmetry
            assert vars(other.profile.source).get("content") == vars(one.profile.source).get("content")
    assert again.dimensions() == chip.dimensions()


def test_shapes_and_profiles_are_not_mixed(folder: Path) -> None:
    file = folder / "mixed.toml"
    file.write_text(CHIP.replace("PROFILE", points(A, B, C, D)).replace(
        'thickness = "1 mm"\n', 'thickness = "1 mm"\nbow = "10 um"\n'), encoding="utf-8")
    with pytest.raises(InputError, match=r"layers\[3\].bow: .*none in a chip .* a layer has a profile"):
        read_chip(file)


def test_an_assembly_is_read_as_it_was_written(tmp_path: Path) -> None:
    """Solids of a stack of discs with ports, in one STEP file; the printed part is one piece."""
    stack = read_chip(Path(geometry.__file__).parent / "chips" / "reference_chip.toml")
    export_step(stack, tmp_path / "chip.step")
    text = '[chip]\nname = "assembly"\nband = ["0.91 MHz", "1.155 MHz"]\n'
    for region in ("transducer", "couplant", "substrate", "bond", "superstrate"):
        material = stack.layer(region).material.replace("_fitted", "_initial")
        text += f'\n[[layers]]\nrole = "{region}"\nmaterial = "{material}"\n'
        text += f'profile = {{ step = "chip.step", part = "{region}", asymmetry = "1 %" }}\n'
    file = tmp_path / "assembly.toml"
    file.write_text(text + '\n[states.filled]\ncavity = "water"\n', encoding="utf-8")
    read = read_chip(file)
    assert [layer.z_bottom for layer in read.layers] == pytest.approx([0.0, 2.02e-3, 2.04e-3, 3.61e-3, 3.71e-3])
    assert read.layer("bond").inner_radius == pytest.approx(4e-3, rel=1e-9)
    found, wanted = volumes(read), volumes(stack)
    assert found["substrate"] == pytest.approx(wanted["substrate"] + wanted["sidewall"], rel=1e-9)
    for region in ("transducer", "couplant", "bond", "superstrate", "cavity"):
        assert found[region] == pytest.approx(wanted[region], rel=1e-9)
    section = chip_section(read)
    assert isinstance(section, FreeSection)
    # Of two ports of 0.4 mm through 9 mm of wall.
    (note,) = section.notes
    assert re.match(r"substrate: 0.285 % of its volume \(2.262 mm\^3 in 2 places\)", note)
    with pytest.warns(LeftOutWarning, match=r"left out of substrate: 0.285 % of its volume"):
        build(fill(read), accuracy=5e-3)
