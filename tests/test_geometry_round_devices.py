"""Rings, stacks of transducers and wells: how files state them, and what is made of them."""

from __future__ import annotations

import math

import pytest
from support import chip_from

from geometry.chip import Chip
from geometry.chip_file import chip_text
from geometry.names import ELECTRODE_GROUND, ELECTRODE_LIVE
from geometry.section import Electrode, cut_section
from workbench.files.errors import InputError

HEAD = '[chip]\nname = "device"\nband = ["0.9 MHz", "1.1 MHz"]\n'


def layer(role: str, thickness: str, more: str = "", *, radius: str = "8 mm", material: str = "pmma") -> str:
    return (f'[[layers]]\nrole = "{role}"\nmaterial = "{material}"\nthickness = "{thickness}"\nradius = "{radius}"\n'
            f"{more}\n")


def transducer(thickness: str, more: str = "") -> str:
    return layer("transducer", thickness, more, material="pic255")


def read(*parts: str) -> Chip:
    return chip_from(HEAD + "".join(parts), "device.toml")


def again(chip: Chip) -> Chip:
    return chip_from(chip_text(chip), chip.file)


RING = read(transducer("2 mm", 'inner_diameter = "6 mm"'), layer("backing", "1 mm"))
STACK = read(transducer("2 mm"), transducer("1 mm", 'poled = "down"\nelectrodes = { live = "bottom" }'),
             layer("bond", "20 um"), transducer("1 mm", 'electrodes = { live = "top" }'))
WELL = read(transducer("2 mm"), layer("substrate", "1 mm"), layer("sidewall", "5 mm", 'cavity_radius = "3 mm"'),
            '[cavity]\nfill = "2 mm"\n[states.filled]\ncavity = "water"\n')


@pytest.mark.parametrize("chip", [RING, STACK, WELL], ids=["ring", "stack", "well"])
def test_what_is_written_is_read_again(chip: Chip) -> None:
    assert again(chip) == chip


def test_a_ring_has_electrodes_on_its_faces_and_nothing_in_its_bore() -> None:
    section = cut_section(RING)
    assert {(each.r_inner, each.r_outer) for each in section.electrodes} == {(3e-3, 8e-3)}
    assert section.volume("transducer") == pytest.approx(math.pi * (64.0 - 9.0) * 2.0 * 1e-9)
    assert set(section.boundary_names()) >= {"backing|transducer", "backing|outside", "transducer|outside"}
    assert RING.dimensions()["transducer.inner_radius"].value == 3e-3
    assert RING.with_dimensions({"transducer.inner_radius": 2e-3}).transducer.inner_radius == 2e-3


def test_transducers_of_a_stack_have_a_live_face_each() -> None:
    electrodes = {(each.name, round(each.z * 1e3, 6)) for each in cut_section(STACK).electrodes}
    assert electrodes == {(ELECTRODE_GROUND, 0.0), (ELECTRODE_LIVE, 2.0), (ELECTRODE_GROUND, 3.0),
                          (ELECTRODE_GROUND, 3.02), (ELECTRODE_LIVE, 4.02)}
    assert [layer.poled for layer in STACK.layers] == ["up", "down", "up", "up"]
    assert isinstance(cut_section(STACK).electrodes[0], Electrode)


def test_the_depth_of_a_well_is_a_thickness() -> None:
    assert WELL.regions == ("transducer", "substrate", "sidewall", "sidewall_2", "cavity")
    assert [each.region for each in WELL.holes] == ["sidewall"]
    section = cut_section(WELL)
    assert section.volume("cavity") == pytest.approx(math.pi * 9.0 * 2.0 * 1e-9)
    assert "cavity|outside" in section.boundary_names()
    deeper = WELL.with_dimensions({"sidewall.thickness": 2.5e-3, "sidewall_2.thickness": 2.5e-3})
    assert cut_section(deeper).volume("cavity") == pytest.approx(math.pi * 9.0 * 2.5 * 1e-9)
    assert deeper.layer("sidewall_2").z_top == pytest.approx(8e-3)


@pytest.mark.parametrize(("fill", "regions"), [
    ("3 mm", ["transducer", "sidewall", "sidewall_2"]),
    ("1 mm", ["transducer", "sidewall", "sidewall_2", "sidewall_3"])])
def test_a_well_of_several_walls_is_cut_where_the_surface_is(fill: str, regions: list[str]) -> None:
    walls = [layer("sidewall", thickness, 'cavity_radius = "3 mm"') for thickness in ("3 mm", "2 mm")]
    chip = read(transducer("2 mm"), *walls, f'[cavity]\nfill = "{fill}"\n[states.filled]\ncavity = "water"\n')
    assert [each.region for each in chip.layers] == regions
    assert [each.bore is None for each in chip.layers] == [True, True] + [False] * (len(regions) - 2)


def test_solids_have_the_volumes_of_the_section() -> None:
    pytest.importorskip("cadquery", reason="solids need CadQuery, the extra 'cad'")
    from geometry.solid import chip_solids, parts, volume

    for chip in (RING, STACK, WELL):
        section, made = cut_section(chip), chip_solids(chip)
        for name, layers in parts(chip).items():
            expected = sum(section.volume(layer.region) for layer in layers)
            assert volume(made[name]) == pytest.approx(expected, rel=1e-12), name


FILLED = '[states.filled]\ncavity = "water"\n'
OPEN = (transducer("2 mm"), layer("sidewall", "5 mm", 'cavity_radius = "3 mm"'), layer("superstrate", "1 mm"))


@pytest.mark.parametrize("above", [
    layer("superstrate", "1 mm", 'inner_radius = "1 mm"'), layer("superstrate", "1 mm", radius="2 mm")])
def test_a_layer_that_leaves_some_of_the_surface_free_may_lie_on_an_open_cavity(above: str) -> None:
    assert read(*OPEN[:-1], above, '[cavity]\nopen = true\n', FILLED).is_open


def test_an_unusual_depth_may_be_insisted_on() -> None:
    assert again(read('unusual = ["fill"]\n', *OPEN[:-1], '[cavity]\nfill = "5 mm"\n', FILLED)).unusual == ("fill",)


@pytest.mark.parametrize(("parts", "field", "said"), [
    ((transducer("2 mm"), transducer("1 mm", 'electrodes = { live = "top" }')), "layers[1].electrodes.live",
     'upper face is live'),
    ((transducer("2 mm"), transducer("1 mm")), "layers[1].electrodes", "wired in parallel"),
    ((transducer("2 mm"), transducer("1 mm", 'electrodes = { live_radius = "2 mm" }')),
     "layers[1].electrodes.live_radius", "'live'"),
    ((transducer("2 mm", 'inner_radius = "8 mm"'),), "layers[0].inner_radius", "narrower"),
    ((transducer("2 mm", 'inner_radius = "3 mm"\nelectrodes = { live_inner_radius = "2 mm" }'),),
     "electrode_live.inner_radius", "at least the transducer's inner radius, 3 mm"),
    ((transducer("2 mm", 'inner_radius = "3 mm"\ninner_diameter = "6 mm"'),), "layers[0].inner_diameter", ""),
    ((transducer("2 mm", 'inner_diameter = "6 um"'),), "transducer.inner_radius", "did you mean '3 mm'"),
    ((transducer("2 mm", 'electrodes = { live_inner_radius = "0.5 um" }'),), "electrode_live.inner_radius", "gap"),
    ((*OPEN, '[cavity]\nopen = true\n', FILLED), "cavity.open", "'superstrate' covers the cavity"),
    ((*OPEN[:-1], '[cavity]\nfill = "2 um"\n', FILLED), "cavity.fill", "did you mean '2 mm'"),
    ((transducer("2 mm"), layer("layer", "1 mm", 'poled = "down"')), "layers[1].poled", "unknown"),
])
def test_a_mistake_is_named(parts: tuple[str, ...], field: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(*parts)
    assert caught.value.field == field
    assert said in str(caught.value) or said == "unknown"
