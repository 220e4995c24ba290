"""Straight chips as solids: their volumes by the measure, their places, their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cadquery
import pytest
from test_geometry_straight import CHIP, chip

from geometry import solid
from geometry.chip import Chip
from geometry.export import export_step, export_stl
from geometry.kernel import SolidError
from geometry.measure import Measure, Parity, Straight
from geometry.parts import Layer
from geometry.solid import chip_solids, part_volumes, parts, volume
from workbench.render.gallery import draw_chip

#: Walls of another material than the base: parts of their own.
WALL = 'role = "sidewall"\nmaterial = '
OF_TWO = CHIP.replace(WALL + '"soda_lime_glass/ono_2020"', WALL + '"pmma"')


def walls_of_pmma(symmetry: str = "even") -> Chip:
    return chip(OF_TWO.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"').replace(
        '"even"', f'"{symmetry}"'))


@pytest.mark.parametrize("symmetry", ["even", "odd", "none"])
def test_solids_are_the_whole_chip_with_the_volumes_of_the_measure(symmetry: str) -> None:
    there = walls_of_pmma(symmetry)
    made, expected = chip_solids(there), part_volumes(there)
    assert set(made) == set(expected) == {*parts(there), "cavity"}
    for name, shape in made.items():
        assert volume(shape) == pytest.approx(expected[name], rel=1e-12)
    assert volume(made["sidewall"]) == pytest.approx((3e-3 - 380e-6) * 160e-6 * 0.02, rel=1e-12)
    box = made["sidewall"].BoundingBox()
    assert (box.xmin, box.xmax, box.ymin, box.ymax) == pytest.approx((-1.5, 1.5, -10.0, 10.0), abs=1e-6)
    assert len(made["sidewall"].Solids()) == 2


def test_a_channel_etched_into_the_base_is_one_solid() -> None:
    base = chip_solids(chip())["substrate"]
    assert base.ShapeType() == "Solid"
    # Floor, ends and sides of a trough: two rims, two walls, its floor, two sides, two ends, the lower face.
    assert len(base.Faces()) == 10
    assert volume(base) == pytest.approx((3e-3 * 0.66e-3 - 380e-6 * 160e-6) * 0.02, rel=1e-12)


def test_a_half_cell_of_a_row_has_one_wall() -> None:
    cell = replace(chip(OF_TWO), measure=Straight(0.02, Parity.EVEN, Parity.EVEN))
    made = chip_solids(cell)
    assert len(made["sidewall"].Solids()) == 1
    assert volume(made["cavity"]) == pytest.approx(190e-6 * 160e-6 * 0.02, rel=1e-12)
    assert cell.measure.device_volume(0.0, 190e-6, 160e-6) == pytest.approx(volume(made["cavity"]), rel=1e-12)


def test_walls_that_are_not_two_solids_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    there = walls_of_pmma()
    whole = solid._ring

    def sliced(cadquery: ModuleType, layer: Layer, measure: Measure) -> Any:
        slit = cadquery.Solid.makeBox(0.1, 100.0, 1.0, cadquery.Vector(1.0, -50.0, 1e3 * layer.z_bottom - 0.1))
        return whole(cadquery, layer, measure).cut(slit) if layer.inner_radius else whole(cadquery, layer, measure)

    monkeypatch.setattr(solid, "_ring", sliced)
    with pytest.raises(SolidError, match="'sidewall' should be 2 valid solids and is 3"):
        chip_solids(there)


def test_files_hold_both_walls_and_are_drawn(tmp_path: Path) -> None:
    there = walls_of_pmma()
    path = export_step(there, tmp_path / "chip.step")
    read = cadquery.importers.importStep(str(path)).solids().vals()
    expected = part_volumes(there)
    assert len(read) == len(expected) + 1
    assert sum(map(volume, read)) == pytest.approx(sum(expected.values()), rel=1e-12)
    written = export_stl(there, tmp_path / "stl")
    assert set(written) == set(expected)
    assert draw_chip(there, written, tmp_path / "cad.png").path.stat().st_size > 0
