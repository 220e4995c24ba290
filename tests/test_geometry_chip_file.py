"""Chip files that are written: what is read back is the same chip, to the last digit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.chip import Chip, parse_chip, read_chip
from geometry.chip_file import chip_text, write_chip
from geometry.dimension import Dimension
from geometry.parts import ElectrodeDisc, Electrodes, Ports
from workbench.files.quantities import format_quantity, parse_quantity
from workbench.files.tables import read_toml

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"


def same(path: Path, chip: Chip) -> bool:
    """Whether the chip written to `path` is read back as `chip`, in all but the name of its file."""
    return read_chip(write_chip(chip, path)) == replace(chip, file=str(path))


@pytest.mark.parametrize("path", sorted(CHIPS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_chip_of_the_package_comes_back(path: Path, tmp_path: Path) -> None:
    assert same(tmp_path / "chip.toml", read_chip(path))


def test_what_no_chip_of_the_package_has_comes_back(tmp_path: Path) -> None:
    chip = read_chip(CHIPS / "reference_chip.toml")
    first, *rest = chip.layers
    low = 1.234567890123e-5
    changed = replace(
        chip, name='a "quoted" name', description='lines\nand a \\ backslash\n', source="",
        layers=(replace(first, z_bottom=low, thickness=Dimension(first.thickness.value, 20e-6, True, "caliper, \"A\"")),
                *(replace(each, z_bottom=each.z_bottom + low) for each in rest)),
        electrodes=Electrodes("bottom", ElectrodeDisc(Dimension(9e-3, 1e-4)), ElectrodeDisc(None, Dimension(1e-3))),
        ports=Ports(Dimension(0.3e-3), Dimension(0.31e-3, None, True), 3),
        states=(*chip.states, replace(chip.states[-1], name="odd name.1", temperature=296.4, particle="polystyrene",
                                      particle_radius=5e-6, materials={"substrate": "pla/wet"})))
    assert same(tmp_path / "chip.toml", changed)


def test_lengths_of_any_digits_come_back(tmp_path: Path) -> None:
    # What an optimiser or a slider leaves is not a round number.
    chip, random = read_chip(CHIPS / "reference_chip.toml"), np.random.default_rng(0)
    for _ in range(20):
        lengths = {f"{region}.thickness": float(random.uniform(1e-6, 5e-4)) for region in ("couplant", "bond")}
        assert same(tmp_path / "chip.toml", chip.with_dimensions(lengths))


def test_a_chip_file_reads_as_people_write_it() -> None:
    text = chip_text(read_chip(CHIPS / "reference_chip.toml"))
    assert 'thickness = { value = "2.02 mm", note = "section 3.1" }' in text
    assert 'band = ["0.91 MHz", "1.155 MHz"]' in text
    assert 'temperature = "20 degC"' in text
    # Keys in the order of docs/chip_file.md, one line each; the description has three.
    assert text.count("\n") < 80


def test_the_text_alone_is_a_chip() -> None:
    chip = read_chip(CHIPS / "acevedo_2026_chip.toml")
    import tomllib

    assert parse_chip(tomllib.loads(chip_text(chip)), source=chip.file) == chip
    assert list(tomllib.loads(chip_text(chip))) == list(read_toml(CHIPS / "acevedo_2026_chip.toml"))


@pytest.mark.parametrize(("value", "dimension", "units", "text"), [
    (2.02e-3, "length", ("mm", "m"), "2.02 mm"), (20 * 1e-6, "length", ("um", "mm", "m"), "20 um"),
    (293.15, "temperature", ("degC", "K"), "20 degC"), (1155000.0, "frequency", ("MHz", "Hz"), "1.155 MHz"),
    (7500.0, "density", ("kg/m^3",), "7500 kg/m^3"), (0.0, "length", ("mm", "m"), "0 mm"),
])
def test_a_quantity_is_written_in_few_digits(value: float, dimension: str, units: tuple[str, ...], text: str) -> None:
    assert format_quantity(value, dimension, units) == text


def test_a_quantity_is_read_back_to_the_last_digit() -> None:
    for value in np.random.default_rng(1).uniform(1e-6, 1e-2, 2000):
        text = format_quantity(float(value), "length", ("mm", "m"))
        assert parse_quantity(text, "length", source="", field="") == value
    with pytest.raises(ValueError, match="not the SI unit"):
        format_quantity(1.0, "length", ("m", "mm"))
