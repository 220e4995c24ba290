"""Names of parameters: what they are taken apart into, and which number among complex values they mean."""

from __future__ import annotations

import pytest

from materials.registry import Registry
from workbench.files.quantities import parse_quantity
from workbench.model.numbers import ParameterKind, ParameterName, placed, real_part


@pytest.mark.parametrize(("text", "expected"), [
    ("pzt4/a.c33", ParameterName("pzt4/a", "c33", False, ParameterKind.MATERIAL)),
    ("pzt4/a.c33.loss", ParameterName("pzt4/a", "c33", True, ParameterKind.MATERIAL)),
    # Misspelt: the material is told all the same.
    ("pzt4/a.c33.los", ParameterName("pzt4/a", "c33.los", False, ParameterKind.MATERIAL)),
    ("transducer.thickness", ParameterName("transducer", "thickness", False, ParameterKind.DIMENSION)),
    ("cavity.radius", ParameterName("cavity", "radius", False, ParameterKind.DIMENSION)),
    ("bench.gain", ParameterName("bench", "gain", False, ParameterKind.BENCH)),
    # No element of the bench has a loss: told apart, it would pass for one that there is.
    ("bench.gain.loss", ParameterName("bench", "gain.loss", False, ParameterKind.BENCH)),
    ("couplant.rim_1.width", ParameterName("couplant.rim_1", "width", False, ParameterKind.TERM)),
    ("transducer.thickness.loss", ParameterName("transducer", "thickness", True, ParameterKind.TERM)),
    ("pla.bulk_modulus.loss", ParameterName("pla", "bulk_modulus", True, ParameterKind.TERM)),
    ("c33.loss", ParameterName("", "c33", True, ParameterKind.TERM)),
    ("c33", ParameterName("", "c33", False, ParameterKind.TERM)),
    ("loss", ParameterName("", "loss", False, ParameterKind.TERM)),
    ("bench.gain[filled]", ParameterName("bench", "gain", False, ParameterKind.BENCH, "filled")),
    ("pzt4/a.c33.loss[disc]", ParameterName("pzt4/a", "c33", True, ParameterKind.MATERIAL, "disc")),
    ("transducer.thickness[a.b/c]", ParameterName("transducer", "thickness", False, ParameterKind.DIMENSION, "a.b/c")),
    ("gel.density[a@b]", ParameterName("gel", "density", False, ParameterKind.TERM, "a@b")),
    ("gel.density[a[b]]", ParameterName("gel", "density", False, ParameterKind.TERM, "a[b]")),
    # The number of a version is the material's: no state is told.
    ("pzt/disc@1.c33", ParameterName("pzt/disc@1", "c33", False, ParameterKind.MATERIAL)),
    ("pzt/disc@12.c33.loss[a.b/c@1]", ParameterName("pzt/disc@12", "c33", True, ParameterKind.MATERIAL, "a.b/c@1")),
])
def test_a_name_is_taken_apart_and_put_together_again(text: str, expected: ParameterName) -> None:
    found = ParameterName.parse(text)
    assert found == expected
    assert str(found) == text


def test_a_name_is_told_of_its_owner_without_it() -> None:
    name = ParameterName.parse("pzt4/a.c33.loss")
    assert (name.key, name.local) == ("pzt4/a.c33", "c33.loss")
    assert (name.within("pzt4/a"), name.within("pzt4/b")) == ("c33.loss", "pzt4/a.c33.loss")


def test_what_a_state_adds_belongs_to_the_number_that_all_have() -> None:
    shared = ParameterName.parse("pzt4/a.c33.loss")
    own = shared.of_state("filled")
    assert str(own) == "pzt4/a.c33.loss[filled]"
    assert (own.shared, own.key, own.local) == ("pzt4/a.c33.loss", "pzt4/a.c33", "c33.loss")
    assert shared.shared == str(shared)
    assert real_part({"pzt4/a.c33": 2.0 - 1.0j}, str(own)) == -1.0


@pytest.mark.parametrize(("text", "radius", "thickness"), [
    ("cavity.radius", True, False), ("ring.inner_radius", True, False), ("gel.thickness", False, True),
    ("port.height", False, False), ("gel.density", False, False), ("radius.loss", False, False),
])
def test_lengths_along_and_across_are_told_apart(text: str, radius: bool, thickness: bool) -> None:
    found = ParameterName.parse(text)
    assert (found.is_radius, found.is_thickness) == (radius, thickness)


def test_numbers_are_parts_of_complex_values() -> None:
    values = {"gel.shear_modulus": 2.0 - 1.0j, "gel.thickness": 3.0 + 0.0j}
    assert (real_part(values, "gel.shear_modulus"), real_part(values, "gel.shear_modulus.loss")) == (2.0, -1.0)
    assert placed(values, {"gel.shear_modulus.loss": -4.0, "gel.thickness": 5.0}) == {
        "gel.shear_modulus": 2.0 - 4.0j, "gel.thickness": 5.0 + 0.0j}
    assert values["gel.shear_modulus"] == 2.0 - 1.0j


@pytest.mark.parametrize(("text", "quantity", "unit", "words"), [
    ("pzt4/a.c33.loss", "pressure", "Pa", "pzt4 c33 loss"),
    ("pzt/disc@2.eps33", "permittivity", "1", "pzt eps33"),
    ("water/a.shear_viscosity", "viscosity", "Pa s", "water shear viscosity"),
    ("water/a.diffusivity_of_sound", "diffusivity", "m^2/s", "water diffusivity of sound"),
    ("transducer.thickness[empty]", "length", "m", "transducer thickness in the state empty"),
    ("sidewall.draft", "angle", "rad", "sidewall draft"),
    ("bench.series_resistance", "resistance", "ohm", "bench series resistance"),
    ("bench.gain", "share", "1", "bench gain"),
    ("bench.colour", "", "", "bench colour"),
    ("couplant.rim_1.width", "", "", "couplant rim 1 width"),
    ("softening", "", "", "softening"),
])
def test_a_name_tells_its_quantity_unit_and_words(text: str, quantity: str, unit: str, words: str) -> None:
    name = ParameterName.parse(text)
    assert (name.quantity, name.unit, name.in_words) == (quantity, unit, words)


def test_every_coefficient_of_a_material_has_a_unit() -> None:
    registry = Registry()
    found = {key for name in registry.names() for key in registry.load(name, notes=[]).parameters()}
    assert found
    assert [key for key in sorted(found) if not ParameterName.parse(f"m/a.{key}").unit] == []


def test_a_permittivity_needs_no_unit() -> None:
    for text in ("830", 830, "830 1"):
        assert parse_quantity(text, "permittivity", source="", field="") == 830.0
