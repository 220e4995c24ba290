"""The liquids that come along: their laws of temperature, their absorption, and the softening of polymers."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from materials import Fluid, IsotropicSolid, Registry
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.model.fluid_slopes import fluid_slopes
from workbench.model.problem import absorption_known

#: Fluids that are particles, or a layer of gel that its source assumes.
NO_LIQUIDS = ("mcf7_cell/hartono_2011", "red_blood_cell/dukhin_2006", "coupling_gel/acevedo_2026")
LIQUIDS = tuple(name for name in Registry().names() if name not in NO_LIQUIDS
                and isinstance(held := Registry().load(name, notes=[]), Fluid) and not held.is_gas)


def _fluid(name: str, degrees: float | None = None) -> Fluid:
    found = Registry().load(name, temperature=None if degrees is None else degrees + 273.15)
    assert isinstance(found, Fluid)
    return found


@pytest.mark.parametrize("name", LIQUIDS)
def test_every_liquid_has_all_that_a_warm_flow_needs(name: str) -> None:
    liquid = _fluid(name)
    assert liquid.temperature == pytest.approx(298.15)
    for number in ("shear_viscosity", "thermal_conductivity", "heat_capacity", "heat_capacity_ratio"):
        assert getattr(liquid, number) is not None
    slopes = fluid_slopes(liquid, lambda temperature: _fluid(name, temperature - 273.15))
    assert slopes is not None
    assert -1e-3 < slopes[f"{name}.density_slope"] < -2e-4
    # gamma - 1 = T alpha^2 c^2 / c_p, from other numbers of the entry.
    expansion = -slopes[f"{name}.density_slope"]
    assert liquid.heat_capacity is not None
    assert liquid.heat_capacity_ratio == pytest.approx(
        1.0 + 298.15 * (expansion * liquid.sound_speed) ** 2 / liquid.heat_capacity, abs=2e-3)


def test_laws_against_tables_that_they_were_not_made_from() -> None:
    # Segur and Oberstar 1951 (mPa s at 20, 40 and 60 degC): Cheng's formula is good to 5 %.
    for name, viscosities in (("glycerol", (1410, 284, 81.3)), ("glycerol_water_50", (6.00, 3.07, 1.85)),
                              ("glycerol_water_80", (60.1, 20.8, 9.42)), ("glycerol_water_20", (1.76, 1.07, 0.731))):
        found = [1e3 * (_fluid(name, degrees).shear_viscosity or 0.0) for degrees in (20, 40, 60)]
        assert found == pytest.approx(viscosities, rel=0.06)
    # Kaye and Laby: 1440 m/s at 22 degC, -2.8 m/s per K.
    assert _fluid("olive_oil", 22).sound_speed == pytest.approx(1440, abs=2)
    assert _fluid("olive_oil", 20).shear_viscosity == pytest.approx(0.084, rel=0.005)
    assert _fluid("glycerol", 26).sound_speed - _fluid("glycerol").sound_speed == pytest.approx(-2.2)
    # Water's slope is positive and glycerol's negative: that of their mixtures falls with the share of glycerol.
    slopes = [_fluid(f"glycerol_water_{percent}", 26).sound_speed - _fluid(f"glycerol_water_{percent}").sound_speed
              for percent in (20, 50, 80)]
    assert 2.0 > slopes[0] > slopes[1] > 0.0 > slopes[2] > -2.2


@pytest.mark.parametrize("name", LIQUIDS)
def test_a_law_ends_where_its_range_does(name: str) -> None:
    with pytest.raises(InputError, match=r"received '423\.15 K'; expected .* \(outside, the value would be"):
        _fluid(name, 150.0)


@pytest.mark.parametrize(("megahertz", "quality"), [(1.0, 600), (2.0, 300)])
def test_shear_alone_bounds_the_absorption_of_glycerol(megahertz: float, quality: float) -> None:
    glycerol = _fluid("glycerol")
    shear = 4.0 * 0.906 / (3.0 * 1258.0)
    assert glycerol.absorbs_more
    # Conduction of heat adds 1e-5 of it.
    assert glycerol.diffusivity_of_sound == pytest.approx(shear, rel=1e-3)
    found = glycerol.sound_speed**2 / (2e6 * math.pi * megahertz * shear)
    assert found == pytest.approx(quality, rel=0.01)
    said = absorption_known("cavity", glycerol, (0.9e6 * megahertz, 1.1e6 * megahertz))
    assert "is a lower bound: its bulk_viscosity is not stated" in said
    assert f"a quality factor of {quality} at {megahertz:g} MHz" in said


def test_only_a_lower_bound_or_no_absorption_is_said() -> None:
    band = (1e6, 2e6)
    assert absorption_known("cavity", _fluid("water"), band) == ""
    assert not _fluid("water").absorbs_more
    assert "does not absorb sound in its bulk" in absorption_known("cavity", _fluid("coupling_gel"), band)


def test_polymers_state_where_they_soften(tmp_path: Path) -> None:
    degrees = {"pla": 60, "pmma": 105, "abs": 105, "polycarbonate": 145, "epoxy": 45, "petg": 75, "coc": 138}
    for name, softening in degrees.items():
        solid = Registry().load(name, notes=[])
        assert isinstance(solid, IsotropicSolid)
        assert solid.softening_temperature == pytest.approx(softening + 273.15)
        assert solid.values["softening_temperature"].conditions
        assert "softening_temperature" not in solid.parameters()
    glass = Registry().load("soda_lime_glass")
    assert isinstance(glass, IsotropicSolid)
    assert glass.softening_temperature is None
    (tmp_path / "glue").mkdir()
    own = Path(Registry().find("pla")[1]).read_text(encoding="utf-8")
    (tmp_path / "glue" / "own.toml").write_text(own.replace('value = 60, unit = "degC"', 'value = 60, unit = "C"'))
    with pytest.raises(InputError, match=r"softening_temperature\.unit: received 'C'; expected a unit of temperature"):
        Registry(tmp_path).load("glue")


def test_a_heat_capacity_by_the_gram_is_a_thousand_times_that_by_the_kilogram() -> None:
    assert parse_quantity("4.18 J/(g K)", "heat capacity", source="", field="") == pytest.approx(4180.0)


def test_a_missing_material_names_the_nearest_and_the_folder() -> None:
    with pytest.raises(InputError) as caught:
        Registry().load("glycerin")
    assert caught.value.nearest[0] == "glycerol"
    assert "--materials DIR" in caught.value.expected
    assert len(str(caught.value)) < 350
    with pytest.raises(InputError, match="one of the names that `workbench materials list` shows"):
        Registry().load("nothing/alike")
