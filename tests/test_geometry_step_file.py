"""Names of the solids in STEP files: none is lost, and each can be asked for as people write it."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.step_file import step_part, step_parts
from workbench.files.errors import InputError

cadquery = pytest.importorskip("cadquery")


@pytest.fixture(scope="module")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Two discs called NAME and plate, one above the other."""
    path = tmp_path_factory.mktemp("step") / "chip.step"
    lower, upper = (cadquery.Workplane().workplane(offset=k).circle(10).extrude(1 + k) for k in (0, 1))
    cadquery.Assembly(name="chip").add(lower, name="NAME").add(upper, name="plate").export(str(path))
    return path.read_bytes()


def names(folder: Path, content: bytes) -> list[str]:
    path = folder / "chip.step"
    path.write_bytes(content)
    return list(step_parts(path, 1e-3, str(hash(content))))


@pytest.mark.parametrize(("written", "name"), [
    (b"transducer_part", "transducer_part"), (b"_part", "_part"), ("Träger".encode(), "Träger"),
    ("Träger".encode("latin-1"), "Träger"), ("Träger".encode().decode("latin-1").encode(), "Träger"),
    ("Träger".encode().decode("latin-1").encode().decode("latin-1").encode(), "Träger"),
    ("Tra\u0308ger".encode(), "Träger"), (b"Tr\\X2\\00E4\\X0\\ger", "Träger"), (b"Tr\\X\\E4ger", "Träger"),
    (b"Tr\\S\\dger", "Träger"), (b"20 \\X2\\00B5\\X0\\m", "20 µm"), (b"\\X2\\538B75357247\\X0\\", "压电片"),
    (b"it''s", "it's"), (b"a/b", "a/b"), (b"", "part 1"), (b"NAUO1", "part 1"), (b"SOLID", "part 1"),
])
def test_every_solid_is_listed_by_its_name(written: bytes, name: str, assembly: bytes, tmp_path: Path) -> None:
    content = assembly.replace(b"NAME", written)
    assert names(tmp_path, content) == [name, "plate"]
    path = tmp_path / "chip.step"
    for asked in (name, "part 1"):
        assert step_part(path, 1e-3, str(hash(content)), asked).BoundingBox().zmin == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(InputError, match=r"part: received 'plates'; expected one of .*, plate; did you mean 'plate'"):
        step_part(path, 1e-3, str(hash(content)), "plates")


def test_a_name_that_was_encoded_twice_may_be_asked_for_as_it_is_written(assembly: bytes, tmp_path: Path) -> None:
    content = assembly.replace(b"NAME", "Träger".encode().decode("latin-1").encode())
    assert names(tmp_path, content)[0] == "Träger"
    assert step_part(tmp_path / "chip.step", 1e-3, str(hash(content)), "TrÃ¤ger").isValid()


def test_one_name_twice_is_numbered_and_never_guessed(assembly: bytes, tmp_path: Path) -> None:
    content = assembly.replace(b"NAME", b"plate")
    assert names(tmp_path, content) == ["plate (1)", "plate (2)"]
    with pytest.raises(InputError, match=r"one of plate \(1\) \(z = .* to 1 mm\), plate \(2\) \(z = 1 to 3 mm\)"):
        step_part(tmp_path / "chip.step", 1e-3, str(hash(content)), "plate")


def test_nested_assemblies_and_compounds(tmp_path: Path) -> None:
    """An assembly within the assembly, moved as a whole, and a compound without names, one within it."""
    disc, other, third = (cadquery.Workplane().circle(10).extrude(1) for _ in range(3))
    inner = cadquery.Assembly(name="stack").add(disc, name="lower")
    inner.add(other, name="upper", loc=cadquery.Location((0, 0, 2)))
    outer = cadquery.Assembly(name="chip").add(inner, loc=cadquery.Location((0, 0, 5))).add(third, name="base_part")
    path = tmp_path / "nested.step"
    outer.export(str(path))
    found = step_parts(path, 1e-3, "nested")
    assert {name: round(solid.BoundingBox().zmin, 4) for name, solid in found.items()} == {
        "lower": 5.0, "upper": 7.0, "base_part": 0.0}
    assert step_part(path, 1e-3, "nested", "stack/upper").BoundingBox().zmin == pytest.approx(7.0)
    compound = cadquery.Compound.makeCompound([disc.val(), disc.val().translate((0, 0, 3)),
                                               cadquery.Compound.makeCompound([disc.val().translate((0, 0, 6))])])
    path = tmp_path / "compound.step"
    cadquery.exporters.export(cadquery.Workplane(obj=compound), str(path))
    found = step_parts(path, 1e-3, "compound")
    assert {name: round(solid.BoundingBox().zmin, 4) for name, solid in found.items()} == {
        "part 1": 0.0, "part 2": 3.0, "part 3": 6.0}


def test_an_assembly_with_an_object_of_its_own(tmp_path: Path) -> None:
    """CadQuery writes the object as X_part in X."""
    disc = cadquery.Workplane().circle(10).extrude(1)
    path = tmp_path / "own.step"
    cadquery.Assembly(disc, name="base").add(disc.translate((0, 0, 1)), name="lid").export(str(path))
    assert len(step_parts(path, 1e-3, "own")) == 2
    assert step_part(path, 1e-3, "own", "base").BoundingBox().zmax == pytest.approx(1.0, abs=1e-6)
    assert step_part(path, 1e-3, "own", "lid").BoundingBox().zmax == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("content", [b"hello", b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n"])
def test_no_solids(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a STEP file of solids"):
        names(tmp_path, content)
