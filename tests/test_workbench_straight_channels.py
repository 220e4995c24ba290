"""Several equal channels side by side: their places, a row of them, halves and whole, flow in each, and mistakes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import moved_onto, quadratic
from test_geometry_straight import CHIP, chip

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import region_volumes, volumes
from geometry.measure import Parity, Straight
from geometry.section import cut_section
from geometry.solid import chip_solids, volume
from workbench.acoustics.captures import Window, light_curve
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised
from workbench.model.drive import parse_drive
from workbench.model.problem import build, fill
from workbench.simulation.beads import trajectories
from workbench.simulation.channel import channel_figures
from workbench.simulation.run import Snapshot, snapshot
from workbench.simulation.streaming import streaming

COARSE = quadratic(3.0)
WIDTH = 'cavity_width = "380 um"'


def channels(count: int, pitch: str = "0.8 mm", symmetry: str = "even", more: str = "") -> Chip:
    return chip(CHIP.replace(WIDTH, f'{WIDTH}\nchannels = {count}\npitch = "{pitch}"\n{more}').replace(
        '"even"', f'"{symmetry}"'))


def shot_of(found: Chip) -> Snapshot:
    beads = replace(found.states[0], particle="polystyrene", particle_radius=2.5e-6)
    return snapshot(replace(found, states=(beads,)), None, 1.94e6, drive=parse_drive("1 Vpp"), accuracy=COARSE)


@pytest.mark.parametrize("more", ["", 'draft = "10 deg"'])
@pytest.mark.parametrize("count", [2, 3])
def test_channels_lie_about_the_middle_and_are_volumes_of_their_own(count: int, more: str, tmp_path: Path) -> None:
    half, whole = (channels(count, symmetry=each, more=more) for each in ("even", "none"))
    assert read_chip(write_chip(half, tmp_path / "chip.toml")).layers == half.layers
    assert [0.5 * (left + right) for left, right in half.layer("sidewall").holes] == pytest.approx(
        [0.8e-3 * (k - 0.5 * (count - 1)) for k in range(count)], abs=1e-18)
    one = (380e-6 + 160e-6 * np.tan(np.radians(10.0 if more else 0.0))) * 160e-6 * 0.02
    for each in (half, whole):
        assert volumes(each)["cavity"] == pytest.approx(count * one, rel=1e-9)
        assert volumes(each)["sidewall"] == pytest.approx(3e-3 * 160e-6 * 0.02 - count * one, rel=1e-9)
        assert region_volumes(each) == pytest.approx(volumes(each), rel=1e-9)
        made = chip_solids(each)
        assert len(made["cavity"].Solids()) == count
        assert volume(made["cavity"]) == pytest.approx(count * one, rel=1e-9)
    pieces = [piece for piece in cut_section(whole).rectangles if piece.region == "sidewall"]
    assert len(pieces) == count + 1


def test_two_channels_of_a_row_are_two_times_one() -> None:
    """Between planes of symmetry, from the middle of a channel or of the wall between two on."""
    row = Straight(0.02, Parity.EVEN, Parity.EVEN)
    full = CHIP.replace(', ground_half_width = "2 mm"', "").replace('{ value = "5 mm", tolerance = "40 um" }', '"3 mm"')
    one = chip(full.replace('width = "3 mm"', 'width = "1.5 mm"').replace('half_width = "1.5 mm"',
                                                                          'half_width = "0.75 mm"'))
    two = chip(full.replace(WIDTH, f'{WIDTH}\nchannels = 2\npitch = "1.5 mm"'))
    single, double = (shot_of(replace(each, measure=row)) for each in (one, two))
    off = abs(double.fields.current / single.fields.current / 2.0 - 1.0)
    print(f"two of a row: current off by {off:.1e}")
    # Elements of the two are mirror images, so that rounding is left.
    assert off < 1e-9
    figures = [channel_figures(each) for each in (single, double)]
    assert figures[0].energy_density == pytest.approx(figures[1].energy_density, rel=2e-2)
    assert len(figures[1].channels) == 1


@pytest.mark.parametrize("count", [2, 3])
def test_halves_equal_the_whole_and_every_channel_has_its_energy_and_its_flow(count: int) -> None:
    half, whole = (shot_of(channels(count, symmetry=each)) for each in ("even", "none"))
    assert half.fields.current == pytest.approx(whole.fields.current, rel=1e-9)
    found, both = (channel_figures(each) for each in (half, whole))
    energies = [each.energy_density for each in both.channels]
    assert len(energies) == count
    assert energies == pytest.approx(energies[::-1], rel=1e-6)
    # Fields are recovered over both sides of the middle in the whole section, and from one side in the half.
    assert [each.energy_density for each in found.channels] == pytest.approx(energies[count // 2:], rel=2e-2)
    assert both.energy_density == pytest.approx(np.mean(energies), rel=1e-6)
    walls = [each for pair in whole.chip.layer("sidewall").holes for each in pair]
    for line in both.lines:
        assert any(left - 1e-9 <= line.place <= right + 1e-9 for left, right in zip(walls[::2], walls[1::2],
                                                                                    strict=True))
    assert [line.time for line in found.lines] == pytest.approx(
        [line.time for line in both.lines if line.place > -1e-9], rel=5e-2)
    flow = streaming(whole)
    assert flow.net_flux < 1e-10
    x, speed = flow.mesh.points[:, 0], np.hypot(*flow.velocity.T)
    largest = [speed[(x > left) & (x < right)].max() for left, right in whole.chip.layer("sidewall").holes]
    assert largest == pytest.approx(largest[::-1], rel=1e-3)


@pytest.mark.parametrize(("new", "words"), [
    ("channels = 3", r"layers\[3\]\.pitch: .*distance between the middles of neighbouring channels"),
    ('pitch = "1 mm"', r"none for one channel; channels = 2 or more"),
    ('channels = 2\npitch = "0.3 mm"', "do not touch: more than their width, 0.38 mm"),
    ('channels = 4\npitch = "0.9 mm"', "4 channels within their layer: .* take 3.08 mm of its 3 mm"),
    ('channels = 3\npitch = "450 um"\ndraft = "30 deg"', "0.035 mm beside each, which they reach at 12.34 deg"),
    ('channels = 0\npitch = "1 mm"', "channels: received 0"),
])
def test_channels_that_cannot_be_are_told(new: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        chip(CHIP.replace(WIDTH, f"{WIDTH}\n{new}"))


def test_a_window_is_about_the_middle_of_every_channel() -> None:
    found = trajectories(shot_of(channels(2, symmetry="none")), 1.0, particles=40, seed=1)
    middles = np.array([-0.4e-3, 0.4e-3])
    distance = np.abs(found.positions[:, :, :1] - middles).min(axis=2)
    assert light_curve(found, Window(outer=60e-6)) == pytest.approx((distance <= 60e-6).mean(axis=0))
    assert light_curve(found, Window(outer=190e-6)) == pytest.approx(1.0)


def test_channels_need_a_width() -> None:
    with pytest.raises(InputError, match=r"layers\[4\]\.channels: .*none without the cavity_width"):
        chip(CHIP.replace("[states.filled]", 'channels = 3\n[states.filled]'))


@pytest.mark.parametrize("symmetry", ["even", "none"])
@pytest.mark.parametrize("count", [2, 3])
def test_the_width_of_several_channels_is_an_exact_parameter(count: int, symmetry: str) -> None:
    there = channels(count, symmetry=symmetry)
    problem = build(fill(there), accuracy=COARSE)
    free = parametrised(problem, there, ["cavity.half_width"])
    moved = replace(problem, mesh=moved_onto(problem.mesh, there.with_dimensions({"cavity.half_width": 2.1e-4})))
    found, expected = (solve_full(assemble(each.mesh, each.terms), np.array([1.94e6]), each.values).impedance[0]
                       for each in (free.with_values({"cavity.half_width": 2.1e-4 + 0j}), moved))
    assert found == pytest.approx(expected, rel=1e-8)
