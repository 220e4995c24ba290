"""Solids and the files made of them."""

import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip, Dimension, read_chip
from geometry.export import export_step, export_stl
from geometry.kernel import SolidError
from geometry.parts import Ports
from geometry.section import cut_section
from geometry.solid import chip_solids, part_volumes, parts, ports_volume, volume
from workbench.files.errors import InputError

cadquery = pytest.importorskip("cadquery", reason="solids need CadQuery, the extra 'cad'")

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
DRILLED = read_chip(CHIPS / "reference_chip.toml")
PLAIN = replace(DRILLED, ports=None)


@pytest.mark.parametrize("path", sorted(CHIPS.glob("*.toml")), ids=lambda path: path.stem)
def test_solids_without_ports_are_the_revolved_section(path: Path) -> None:
    chip = replace(read_chip(path), ports=None)
    section = cut_section(chip)
    made = chip_solids(chip)
    for name, layers in parts(chip).items():
        # Cylinders are integrated to rounding.
        assert volume(made[name]) == pytest.approx(sum(section.volume(layer.region) for layer in layers), rel=1e-12)
    assert ("cavity" in made) == bool(chip.holes)


def test_the_printed_part_is_one_solid_with_a_pocket() -> None:
    assert list(chip_solids(PLAIN)) == ["transducer", "couplant", "substrate", "bond", "superstrate", "cavity"]
    expected = math.pi * (13e-3**2 * (0.85e-3 + 0.72e-3) - 4e-3**2 * 0.72e-3)
    assert volume(chip_solids(PLAIN)["substrate"]) == pytest.approx(expected, rel=1e-12)
    # Lid face, floor of the pocket, its wall, rim on top, outer surface; no seam where the layers met.
    assert len(chip_solids(PLAIN)["substrate"].Faces()) == 5


def test_a_wall_of_another_material_is_a_part_of_its_own() -> None:
    layers = tuple(replace(layer, material="pmma") if layer.role == "sidewall" else layer for layer in PLAIN.layers)
    assert list(parts(replace(PLAIN, layers=layers))) == [layer.region for layer in layers]


def test_solids_are_where_the_chip_says_in_millimetres() -> None:
    for name, solid in chip_solids(DRILLED).items():
        box = solid.BoundingBox()
        low, high = box.zmin, box.zmax
        if name == "cavity":
            bottom, top, radius = 2.89, 3.71, 4.0
        else:
            layers = parts(DRILLED)[name]
            bottom, top, radius = (
                1e3 * value for value in (layers[0].z_bottom, layers[-1].z_top, layers[0].outer_radius)
            )
        # The kernel widens bounding boxes by its tolerance, 1e-7 mm, and by the curve approximations near the ports.
        assert (low, high, box.xmax) == pytest.approx((bottom, top, radius), abs=1e-3), name


def test_parts_do_not_overlap() -> None:
    made = list(chip_solids(DRILLED).values())
    for i, one in enumerate(made):
        for other in made[:i]:
            assert one.intersect(other).Volume() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_ports_remove_the_volume_of_their_channels(count: int) -> None:
    chip = replace(DRILLED, ports=Ports(Dimension(0.4e-3), None, count))
    removed = volume(chip_solids(PLAIN)["substrate"]) - volume(chip_solids(chip)["substrate"])
    # Edges are splines within 1e-7 mm of the true curve: measured 1e-8 of the channel.
    assert removed == pytest.approx(ports_volume(chip), rel=1e-7)
    # A straight plug from wall to wall is 9 mm long on the axis, and about (radius / wall radius)^2 more beside it.
    assert ports_volume(chip) == pytest.approx(count * math.pi * 0.2e-3**2 * 9e-3, rel=1e-3)


def test_the_volume_of_a_port_is_the_integral_of_its_chord() -> None:
    # Independent of the substitution in the code: adaptive quadrature over y of chord times circle height.
    from scipy.integrate import quad

    chip = replace(DRILLED, ports=Ports(Dimension(0.7e-3), Dimension(0.36e-3), 1))
    a, b, c = 0.35, 4.0, 13.0
    integral, _ = quad(
        lambda y: 2 * math.sqrt(a**2 - y**2) * (math.sqrt(c**2 - y**2) - math.sqrt(b**2 - y**2)), -a, a, epsabs=1e-13
    )
    assert ports_volume(chip) == pytest.approx(1e-9 * integral, rel=1e-10)
    assert part_volumes(PLAIN)["substrate"] - part_volumes(chip)["substrate"] == pytest.approx(
        1e-9 * integral, rel=1e-9
    )
    chip_solids(chip)  # a channel almost as wide as the wall is high still has its volume
    with pytest.raises(InputError, match="ports"):
        ports_volume(PLAIN)


def test_ports_are_open_to_cavity_and_outside() -> None:
    substrate = chip_solids(DRILLED)["substrate"]
    height = 2.89 + 0.36
    for x in (4.05, 8.0, 12.95, -4.05, -12.95):
        assert not substrate.isInside(cadquery.Vector(x, 0.0, height), 1e-6)
        assert substrate.isInside(cadquery.Vector(0.0, x, height), 1e-6), "two ports, on opposite sides"
        assert substrate.isInside(cadquery.Vector(x, 0.0, height + 0.25), 1e-6)


def test_a_solid_of_another_volume_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong: dict[str, float] = {name: 1.00001 * value for name, value in part_volumes(PLAIN).items()}
    monkeypatch.setattr("geometry.solid.part_volumes", lambda chip: wrong)
    with pytest.raises(SolidError, match="volume of the solid 'transducer'"):
        chip_solids(PLAIN)


def test_a_part_in_two_pieces_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("geometry.solid._fused", cadquery.Compound.makeCompound)  # the printed layers side by side
    with pytest.raises(SolidError, match="'substrate' should be one valid solid and is 2"):
        chip_solids(PLAIN)


# ---- files


def test_a_step_file_comes_back_with_names_and_volumes(tmp_path: Path) -> None:
    path = export_step(DRILLED, tmp_path / "out" / "chip.step")
    read = cadquery.importers.importStep(str(path)).solids().vals()
    # Lengths are written with some 15 digits; splines of the port edges are integrated anew.
    assert sorted(volume(solid) for solid in read) == pytest.approx(sorted(part_volumes(DRILLED).values()), rel=1e-9)
    text = path.read_text(encoding="utf-8")
    assert all(f"'{name}'" in text for name in part_volumes(DRILLED))
    assert [each.name for each in path.parent.iterdir()] == ["chip.step"], "no draft is left"


def test_a_failed_export_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "chip.step"
    path.write_text("old", encoding="utf-8")

    def fail(chip: Chip) -> None:
        raise SolidError("broken")

    monkeypatch.setattr("geometry.export.chip_solids", fail)
    with pytest.raises(SolidError, match="broken"):
        export_step(DRILLED, path)
    assert path.read_text(encoding="utf-8") == "old"


def triangles(path: Path) -> NDArray[np.float32]:
    """(n, 3, 3) corners of the triangles of an STL file, binary or text."""
    content = path.read_bytes()
    if content.startswith(b"solid"):
        corners = [line.split()[1:] for line in content.decode().splitlines() if line.split()[:1] == ["vertex"]]
        return np.array(corners, dtype=np.float32).reshape(-1, 3, 3)
    (count,) = struct.unpack_from("<I", content, 80)
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(content, kind, count, 84)["corners"]


def test_stl_files_enclose_the_volume_of_their_parts(tmp_path: Path) -> None:
    written = export_stl(PLAIN, tmp_path, deviation=2e-6)
    assert {path.stem for path in tmp_path.iterdir()} == set(written) == set(part_volumes(PLAIN))
    for name, path in written.items():
        a, b, c = np.moveaxis(triangles(path).astype(float), 1, 0)
        enclosed = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        # Chords within 2 um of circles of 4 mm or more take away at most 2 * 2 / 4000 of a disc. The pocket wall's 4 mm
        # counts against a ring nine times as large, and with the other sign.
        assert 1e-9 * enclosed == pytest.approx(part_volumes(PLAIN)[name], rel=1.5e-3)
    coarse = export_stl(PLAIN, tmp_path / "coarse", deviation=1e-4)
    assert len(triangles(coarse["cavity"])) < len(triangles(written["cavity"]))
