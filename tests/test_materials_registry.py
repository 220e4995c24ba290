"""The registry: every data file, names, temperatures, and what is refused in a file a person wrote."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import pytest

import materials
from materials import Fluid, IsotropicSolid, Material, PassivityWarning, Piezoelectric, Registry, Value, conversions
from materials.registry import PACKAGE_DATA, bibliography_keys
from workbench.files.errors import InputError

NAMES = Registry().names()
REFERENCES = bibliography_keys(PACKAGE_DATA / "references.bib")
#: Solids that hardly resist shear.
RUBBERS = {"pdms/onda_sylgard184"}


def _load(name: str, *, temperature: float | None = None) -> Material:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PassivityWarning)
        return Registry().load(name, temperature=temperature)


def _fluid(name: str, temperature: float | None = None) -> Fluid:
    material = _load(name, temperature=temperature)
    assert isinstance(material, Fluid)
    return material


# --- every data file -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_every_number_has_a_source_conditions_and_a_unit(name: str) -> None:
    material = _load(name)
    assert material.name == name
    assert material.source in REFERENCES
    assert material.values
    for value in material.values.values():
        assert value.source in REFERENCES
        assert value.conditions
        assert value.unit


@pytest.mark.parametrize("name", NAMES)
def test_every_entry_is_of_a_plausible_size(name: str) -> None:
    # Wide enough for any real substance of the kind, narrow enough to catch a unit or a power of ten.
    material = _load(name)
    if isinstance(material, Fluid):
        dense = material.density > 100
        assert 500 < material.density < 2000 if dense else 0.5 < material.density < 3
        assert 900 < material.sound_speed < 2500 if dense else 250 < material.sound_speed < 500
        assert material.slowest_wave_speed() == material.sound_speed
        return
    assert 800 < material.density < 9000
    # The shear wave of a rubber is slow: the only solid that has less than 500 m/s.
    assert (10 if name in RUBBERS else 500) < material.slowest_wave_speed() < 6000
    for modulus in ("bulk_modulus", "shear_modulus", "c11", "c33", "c44"):
        if modulus in material.parameters():
            lowest = 1e5 if name in RUBBERS and modulus == "shear_modulus" else 5e8
            assert lowest < material.parameters()[modulus].real < 3e11
    # From rubber to silicon in W/(m K), from steel to polymers in J/(kg K), from silica to PDMS in 1/K.
    for constant, (low, high) in {"thermal_conductivity": (0.1, 400), "heat_capacity": (300, 2000),
                                  "thermal_expansion": (3e-7, 4e-4)}.items():
        if constant in material.thermal():
            assert low < material.thermal()[constant].real < high
    if isinstance(material, Piezoelectric):
        assert material.e31.real < 0 < material.e33.real  # poled along +z
        assert 5 < material.e33.real < 30
        assert 5 < material.e15.real < 30
        assert 300 < material.eps11.real < 4000
        assert 300 < material.eps33.real < 4000
        # Thickness coupling of a poled lead zirconate titanate: 0.4 to 0.6.
        stiffened = material.c33.real + material.e33.real**2 / material.absolute_eps33.real
        assert 0.4 < math.sqrt(1 - material.c33.real / stiffened) < 0.6


@pytest.mark.parametrize("name", NAMES)
def test_every_entry_survives_pickling(name: str) -> None:
    # Fits run in several processes.
    material = _load(name)
    assert pickle.loads(pickle.dumps(material)) == material


def test_only_the_fitted_pzt4_is_active_within_its_rounding() -> None:
    warned = []
    for name in NAMES:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            Registry().load(name)
        warned += [name for _ in caught]
    assert warned == ["pzt4/acevedo_2026_fitted"]


def test_every_reference_is_used_and_every_folder_has_an_entry() -> None:
    used = {value.source for name in NAMES for value in _load(name).values.values()} | {_load(n).source for n in NAMES}
    assert used == REFERENCES
    assert {p.name for p in PACKAGE_DATA.iterdir() if p.is_dir()} == {name.split("/")[0] for name in NAMES}


def test_pzt4_is_as_printed() -> None:
    fitted = _load("pzt4/acevedo_2026_fitted")
    assert fitted.parameters() == pytest.approx({
        "density": 7862, "c11": 137.00e9 - 0.08e9j, "c12": 77.84e9, "c13": 77.46e9 + 0.11e9j, "c33": 121.67e9 - 0.30e9j,
        "c44": 22.00e9, "e31": -5.2, "e33": 16.56, "e15": 13.05, "eps11": 762.5, "eps33": 753.87,
    })  # fmt: skip
    nominal, initial = _load("pzt4/comsol_nominal"), _load("pzt4/acevedo_2026_initial")
    assert not any(number.imag for number in nominal.parameters().values())
    difference = {key: initial.parameters()[key] - nominal.parameters()[key] for key in nominal.parameters()}
    assert {key: d for key, d in difference.items() if d} == {"c11": -0.14e9j, "c13": 0.07e9j, "c33": -0.12e9j}


# Longitudinal and shear speeds (m/s) of Table 4; 0.4 % is what rounding G to 0.01 GPa can do (ABS, 0.67 GPa).
@pytest.mark.parametrize(
    ("name", "longitudinal", "shear"),
    [("pla", 2062.2, 907.5), ("abs", 1939.7, 854.6), ("petg", 2420.6, 800.4), ("pmma", 2698.7, 1147.0),
     ("epoxy", 2373.9, 931.8)],
)  # fmt: skip
def test_polymers_have_the_wave_speeds_of_their_table(name: str, longitudinal: float, shear: float) -> None:
    solid = _load(name)
    assert isinstance(solid, IsotropicSolid)
    speeds = conversions.wave_speeds(solid.bulk_modulus, solid.shear_modulus, density=solid.density)
    assert speeds == pytest.approx((longitudinal, shear), rel=4e-3)


def test_polystyrene_meets_a_wave_as_the_particle_literature_says() -> None:
    # Compressibility 249 1/TPa printed beside its speeds (Muller et al. 2012); half a unit of its last digit.
    bead = _load("polystyrene")
    assert isinstance(bead, IsotropicSolid)
    assert bead.compressibility * 1e12 == pytest.approx(249, abs=0.5)


@pytest.mark.parametrize("name", NAMES)
def test_every_solid_has_a_loss_or_says_that_there_is_none(name: str) -> None:
    material = _load(name)
    if not isinstance(material, Fluid):
        lossy = any(number.imag for number in material.parameters().values())
        said = "lossless" in material.values["density"].conditions
        assert lossy != said


def test_silicon_is_the_hill_average_of_its_cubic_constants() -> None:
    # C11, C12, C44 in GPa as the note of the entry states them; half a unit of the last printed digit.
    c11, c12, c44 = 165.64, 63.94, 79.51
    voigt = (c11 - c12 + 3 * c44) / 5
    reuss = 5 * (c11 - c12) * c44 / (4 * c44 + 3 * (c11 - c12))
    silicon = _load("silicon")
    assert isinstance(silicon, IsotropicSolid)
    assert silicon.bulk_modulus.real / 1e9 == pytest.approx((c11 + 2 * c12) / 3, abs=0.005)
    assert silicon.shear_modulus.real / 1e9 == pytest.approx((voigt + reuss) / 2, abs=0.005)
    assert silicon.values["shear_modulus"].uncertainty == pytest.approx((voigt - reuss) / 2 * 1e9, abs=0.005e9)
    # 160 GPa and 0.22 are what is used for polycrystalline silicon (Sharpe et al. 1997 and later); 2 % is their spread.
    young, poisson = conversions.young_and_poisson(silicon.bulk_modulus, silicon.shear_modulus)
    assert young.real == pytest.approx(160e9, rel=0.02)
    assert poisson.real == pytest.approx(0.22, abs=0.005)
    wafer = _load("silicon/wafer_100")
    assert isinstance(wafer, IsotropicSolid)
    assert (wafer.bulk_modulus + 4 * wafer.shear_modulus / 3).real / 1e9 == pytest.approx(c11, abs=0.01)
    assert wafer.bulk_modulus == silicon.bulk_modulus
    # Eight atoms in the cube of 543.102 pm.
    assert silicon.density == pytest.approx(8 * 28.0855 * 1.66053907e-27 / 543.102e-12**3, rel=5e-5)


# Against a second published pair of wave speeds (m/s), None where there is none, and the tolerance that two lots of the
# same substance deserve.
@pytest.mark.parametrize(
    ("name", "longitudinal", "shear", "tolerance"),
    [
        ("fused_silica", 5914, 3729, 0.01),  # Chen et al. 2023, lambda 15.781 and mu 30.635 GPa at 2203 kg/m^3
        ("stainless_steel", 5660, 3120, 0.02),  # type 302, tables of Olympus
        ("aluminium", 6339, 3170, 0.01),  # EN AW-6061-T6, lambda 54.308 and mu 27.174 GPa at 2704 kg/m^3 (GEWtool)
        ("brass", 4479, 2205, 0.03),  # CuZn37, lambda 87.22 and mu 41.045 GPa at 8440 kg/m^3 (GEWtool)
        ("polycarbonate", 2270, None, 0.01),  # makers' tables
        ("pmma/hartmann_1974", 2700, 1330, 0.01),  # ElasticMatrix
        ("borosilicate_glass", 5640, 3280, 0.06),  # Pyrex (ElasticMatrix); its shear speed is 5 % below the static one
        ("soda_lime_glass/ono_2020", 5840, 3460, 0.02),  # plate glass of handbooks
        ("pdms", 1030, None, 0.05),  # silicone rubbers: 960 to 1110 m/s (Folds 1974)
        ("photopolymer", 2474.5, None, 0.001),  # the speed that was measured, through the moduli
        ("silicon", 8945, 5341, 0.001),  # the averages of its note
    ],
)
def test_solids_have_the_wave_speeds_of_a_second_source(
    name: str, longitudinal: float, shear: float | None, tolerance: float
) -> None:
    solid = _load(name)
    assert isinstance(solid, IsotropicSolid)
    speeds = conversions.wave_speeds(solid.bulk_modulus, solid.shear_modulus, density=solid.density)
    assert speeds[0] == pytest.approx(longitudinal, rel=tolerance)
    if shear is not None:
        assert speeds[1] == pytest.approx(shear, rel=tolerance)


# Attenuation (Np) per wavelength of both waves is pi tan delta; 1 % is the rounding of the losses to three digits.
@pytest.mark.parametrize(
    ("name", "longitudinal", "shear"),
    [("stainless_steel", 0.014034, 0.006182), ("aluminium", 0.010527, 0.009247), ("brass", 0.013553, 0.009161),
     ("polycarbonate", 0.165268, 0.200831), ("soda_lime_glass/ono_2020", 0.005870, 0.006528),
     # 1.4 and 4.3 dB/cm at 2 MHz times the wavelengths 1.345 and 0.670 mm; 3.696 dB/cm at 1 MHz times 2.4745 mm.
     ("pmma/hartmann_1974", 0.021679, 0.033169), ("photopolymer", 0.105295, 0.105295)],
)  # fmt: skip
def test_losses_are_the_attenuations_they_were_computed_from(name: str, longitudinal: float, shear: float) -> None:
    solid = _load(name)
    assert isinstance(solid, IsotropicSolid)
    tangents = conversions.loss_tangents(solid.bulk_modulus, solid.shear_modulus)
    assert tangents == pytest.approx((longitudinal / math.pi, shear / math.pi), rel=0.01)


# Stress-charge constants (GPa, C/m^2, relative) that others print for the same compositions: the models of
# acoustofluidic chips of Skov et al. (AIMS Mathematics 4, 2019) and Auld's table for PZT-5H. 3 % is what rounding the
# compliances to three digits does to a stiffness, through the small determinant; permittivities differ by 2 %.
@pytest.mark.parametrize(
    ("name", "published", "quality", "tangent"),
    [
        ("pz26", (168, 110, 99.9, 123, 30.1, -2.8, 14.7, 9.86, 828, 700), 1000, 0.003),
        ("pzt5h/morgan_tp226", (126, 79.5, 84.1, 117, 23.0, -6.5, 23.3, 17.0, 1700, 1470), 65, 0.02),
    ],
)
def test_ceramics_agree_with_a_second_source_and_lose_as_their_sheets_say(
    name: str, published: tuple[float, ...], quality: float, tangent: float
) -> None:
    ceramic = _load(name)
    assert isinstance(ceramic, Piezoelectric)
    numbers = {key: number.real for key, number in ceramic.parameters().items() if key != "density"}
    found = [number / 1e9 if key.startswith("c") else number for key, number in numbers.items()]
    assert found == pytest.approx(published, rel=0.03)
    for key in ("s11", "s12", "s13", "s33", "s44"):
        stated = ceramic.values[key].value
        assert stated.real / stated.imag == pytest.approx(quality, rel=0.005)
    for key in ("free_eps11", "free_eps33"):
        stated = ceramic.values[key].value
        assert stated.imag / stated.real == pytest.approx(tangent, rel=0.001)
    # What was stated for a compliance is the same for the thickness mode: the sign came through the inversion.
    assert -ceramic.c33.imag / ceramic.c33.real == pytest.approx(1 / quality, rel=0.01)


# Glycerol and its mixtures against tables other than the formulas used: density at 20 degC (Bosart and Snoddy 1927),
# where 5 K are 0.1 to 0.3 %; viscosity (Segur and Oberstar 1951), the geometric mean of 20 and 30 degC, which is what
# an exponential law gives at 25.
@pytest.mark.parametrize(
    ("name", "density", "viscosity"),
    [("glycerol_water_20", 1046.9, 1.541e-3), ("glycerol_water_50", 1126.3, 5.026e-3),
     ("glycerol_water_80", 1208.5, 45.14e-3), ("glycerol", 1261.1, 929e-3)],
)  # fmt: skip
def test_glycerol_and_water_against_tables(name: str, density: float, viscosity: float) -> None:
    mixture = _fluid(name)
    assert mixture.density == pytest.approx(density, rel=0.004)
    assert mixture.density < density
    assert mixture.shear_viscosity == pytest.approx(viscosity, rel=0.03)


@pytest.mark.parametrize("percent", [20, 50, 80])
def test_the_sound_speed_of_a_mixture_is_by_the_rule_it_names(percent: int) -> None:
    # Nomoto's rule from the entries of the pure liquids: R = (M / rho) c^(1/3) adds by moles. 1 m/s is the rounding.
    water, glycerol, mixture = _fluid("water"), _fluid("glycerol"), _fluid(f"glycerol_water_{percent}")
    moles = {"glycerol": percent / 92.094, "water": (100 - percent) / 18.0153}
    whole = sum(moles.values())
    mass = (moles["glycerol"] * 92.094 + moles["water"] * 18.0153) / whole
    sound = (moles["glycerol"] * 92.094 / glycerol.density * glycerol.sound_speed ** (1 / 3)
             + moles["water"] * 18.0153 / water.density * water.sound_speed ** (1 / 3)) / whole
    assert mixture.sound_speed == pytest.approx((sound * mixture.density / mass) ** 3, abs=1.5)
    assert water.sound_speed < mixture.sound_speed < glycerol.sound_speed


def test_particles_of_the_literature_have_its_compressibility() -> None:
    # 1/TPa: MCF-7 as measured; red cells between 314 (from the speed) and 340 of earlier work, 10 %; silica hardly any.
    assert _fluid("mcf7_cell").compressibility * 1e12 == pytest.approx(422, abs=0.5)
    assert _fluid("red_blood_cell").compressibility * 1e12 == pytest.approx(330, rel=0.1)
    beads = _load("silica_beads")
    assert isinstance(beads, IsotropicSolid)
    assert beads.compressibility * 1e12 == pytest.approx(27.1, abs=0.05)
    assert _fluid("olive_oil").sound_speed == pytest.approx(1440 - 2.8 * 3, abs=2)  # Kaye and Laby: 1440 at 22 degC


@pytest.mark.parametrize("name", NAMES)
def test_every_solid_conducts_heat_by_numbers_with_a_source(name: str) -> None:
    material = _load(name)
    if isinstance(material, Fluid):
        return
    for constant in ("thermal_conductivity", "heat_capacity"):
        assert getattr(material, constant) is not None
        assert material.values[constant].source in REFERENCES
    # From rubber to aluminium, 1 to 4 MJ/(m^3 K): heat capacities by volume differ little.
    assert material.heat_capacity is not None
    assert 1.0e6 < material.density * material.heat_capacity < 4.1e6


def test_thermal_constants_keep_their_source_and_are_no_parameters() -> None:
    glass = _load("borosilicate_glass")
    assert isinstance(glass, IsotropicSolid)
    assert glass.thermal_conductivity == 1.2
    assert glass.thermal_expansion == pytest.approx(3.3e-6)
    resin = _load("photopolymer")
    assert isinstance(resin, IsotropicSolid)
    assert resin.thermal_expansion is None
    assert set(glass.parameters()) == {"density", "bulk_modulus", "shear_modulus"}
    assert glass.values["thermal_conductivity"].conditions == "20 degC"
    assert "thermal_conductivity   1.2" in materials.describe(glass)
    warmer = replace(glass, thermal_conductivity=1.3)
    assert set(glass.values) - set(warmer.values) == {"thermal_conductivity"}
    assert "thermal_conductivity" not in replace(glass, thermal_conductivity=None).values


def test_b270_shear_modulus_is_the_one_of_its_sheet() -> None:
    glass = _load("b270_glass")
    assert glass.parameters()["shear_modulus"].real == pytest.approx(29e9, abs=0.5e9)


# --- temperature -----------------------------------------------------------------------------------------------------


def test_water_at_25_degrees() -> None:
    # Oracle: density 997, sound speed 1497, viscosity 0.890 mPa s as used in the particle literature; half a unit of
    # the last digit each.
    water = _fluid("water", 298.15)
    assert water.density == pytest.approx(997, abs=0.5)
    assert water.sound_speed == pytest.approx(1497, abs=0.5)
    assert water.shear_viscosity == pytest.approx(0.890e-3, abs=0.0005e-3)
    assert water.compressibility == pytest.approx(447.6e-12, abs=0.4e-12)  # 1 m/s in c is 0.6 1/TPa
    assert water.temperature == 298.15
    assert water == _fluid("water")  # 25 degC is also what the entry serves unasked


# Values of an independent implementation of the whole formulation IAPWS SR6-08(2011) (the iapws package, 1.5.5). The
# tolerances: 0.02 kg/m^3 and 0.1 m/s are the distances of the Kell and Marczak correlations from it, half a unit of the
# last digit for the formulas taken from it, 0.2 J/(kg K) for the fitted heat capacity.
@pytest.mark.parametrize(
    ("temperature", "density", "sound_speed", "viscosity", "conductivity", "heat_capacity"),
    [
        (283.15, 999.702, 1447.270, 1305.902e-6, 0.578787, 4195.14),
        (298.15, 997.047, 1496.699, 889.997e-6, 0.606502, 4181.45),
        (313.15, 992.216, 1528.902, 652.733e-6, 0.628480, 4179.36),
    ],
)
def test_water_against_iapws(
    temperature: float, density: float, sound_speed: float, viscosity: float, conductivity: float, heat_capacity: float
) -> None:
    water = _fluid("water", temperature)
    assert water.density == pytest.approx(density, abs=0.02)
    assert water.sound_speed == pytest.approx(sound_speed, abs=0.1)
    assert water.shear_viscosity == pytest.approx(viscosity, abs=0.0005e-6)
    assert water.thermal_conductivity == pytest.approx(conductivity, abs=0.0000005)
    assert water.heat_capacity == pytest.approx(heat_capacity, abs=0.2)


@pytest.mark.parametrize("temperature", [281.15, 293.15, 298.15, 310.15, 322.15])
def test_water_is_thermodynamically_consistent(temperature: float) -> None:
    # gamma = 1 + T alpha^2 c^2 / c_p ties five numbers from three sources. Tolerance: alpha comes from a central
    # difference of Kell's density, whose slope is good to about 2e-3 / K^2 of a unit; 1e-4 in gamma.
    water = _fluid("water", temperature)
    warmer, cooler = _fluid("water", temperature + 0.5), _fluid("water", temperature - 0.5)
    expansion = -(warmer.density - cooler.density) / water.density
    assert water.heat_capacity is not None
    assert water.heat_capacity_ratio is not None
    identity = 1 + temperature * expansion**2 * water.sound_speed**2 / water.heat_capacity
    assert water.heat_capacity_ratio == pytest.approx(identity, abs=1e-4)


def test_bulk_viscosity_of_water_is_the_stated_multiple() -> None:
    for temperature in (285.15, 298.15, 320.15):
        water = _fluid("water", temperature)
        assert water.bulk_viscosity is not None
        assert water.shear_viscosity is not None
        assert water.bulk_viscosity / water.shear_viscosity == pytest.approx(2.79, rel=1e-9)


def test_air_is_an_ideal_gas() -> None:
    # US Standard Atmosphere 1976 at 288.15 K: 1.2250 kg/m^3, 340.294 m/s, 1.7894e-5 Pa s (as tabulated).
    air = _fluid("air", 288.15)
    assert air.density == pytest.approx(1.2250, abs=0.00005)
    assert air.sound_speed == pytest.approx(340.294, abs=0.0005)
    assert air.shear_viscosity == pytest.approx(1.7894e-5, abs=0.00005e-5)
    assert air.thermal_conductivity == pytest.approx(0.02533, rel=0.02)  # that source's own table; Sutherland's 2 %
    # gamma R / M = c^2 / T and c_p = gamma / (gamma - 1) R / M: one gas constant behind three numbers.
    assert air.heat_capacity is not None
    assert air.sound_speed**2 / 288.15 == pytest.approx(0.4 * air.heat_capacity, rel=1e-6)


def test_values_carry_the_temperature() -> None:
    assert "310.15 K" in _load("water", temperature=310.15).values["density"].conditions


@pytest.mark.parametrize("temperature", [279.0, 330.0, -10.0, math.nan])
def test_outside_its_range_a_law_refuses_to_extrapolate(temperature: float) -> None:
    with pytest.raises(InputError, match=r"bulk_viscosity.*280\.15 to 323\.15 K.*extrapolated|density.*extrapolated"):
        Registry().load("water", temperature=temperature)


def test_a_temperature_for_a_material_without_laws() -> None:
    with pytest.raises(InputError, match=r"pla.*temperature: received '298\.15 K'; expected no temperature"):
        Registry().load("pla", temperature=298.15)


# --- names -----------------------------------------------------------------------------------------------------------


def test_a_material_alone_means_its_only_entry_or_its_default() -> None:
    assert _load("pla").name == "pla/acevedo_2026"
    assert _load("pzt4").name == "pzt4/acevedo_2026_fitted"


@pytest.mark.parametrize(
    ("wrong", "near"),
    [("pzt4/acevedo_2026_fited", "pzt4/acevedo_2026_fitted"), ("watr", "water"), ("PZT4", "pzt4"), ("pla/", "pla")],
)
def test_a_wrong_name_is_answered_with_near_ones(wrong: str, near: str) -> None:
    with pytest.raises(InputError, match=f"received '{wrong}'") as caught:
        Registry().load(wrong)
    assert any(name.startswith(near) for name in caught.value.nearest)


# --- overriding ------------------------------------------------------------------------------------------------------


def test_an_overridden_number_loses_its_source_and_nothing_else() -> None:
    disc = _load("pzt4")
    lighter = replace(disc, density=7500.0)
    assert lighter.parameters() == {**disc.parameters(), "density": 7500.0}
    assert set(disc.values) - set(lighter.values) == {"density"}
    assert disc.values["density"].value == 7862
    assert isinstance(lighter, Piezoelectric)
    # c44 = 22.00 is slower than c66 = (137.00 - 77.84) / 2.
    assert lighter.slowest_wave_speed() == pytest.approx(math.sqrt(22.00e9 / 7500))


def test_a_fluid_number_set_to_none_loses_its_source() -> None:
    inviscid = replace(_fluid("water"), shear_viscosity=None)
    assert "shear_viscosity" not in inviscid.values
    assert "shear_viscosity" not in inviscid.parameters()
    assert "density" in inviscid.values


# --- files people write ----------------------------------------------------------------------------------------------

SOLID = """
kind = "isotropic solid"
title = "a solid"
source = "somebody_2020"
conditions = "1 MHz"
density = { value = 1.2, unit = "g/cm^3" }
bulk_modulus = { value = 3.0, loss = -0.02, unit = "GPa", uncertainty = 0.1, loss_uncertainty = 0.01, rounding = 0.05 }
shear_modulus = { value = 1.0, loss = -0.05, unit = "GPa" }
"""


def _folder(tmp_path: Path, content: str, *, name: str = "thing/somebody_2020") -> Registry:
    path = tmp_path / f"{name}.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(content, encoding="utf-8")
    (tmp_path / "references.bib").write_text("@article{somebody_2020,\n title = {T},\n}\n", encoding="utf-8")
    return Registry(folders=(tmp_path,))


def test_a_folder_of_ones_own(tmp_path: Path) -> None:
    registry = _folder(tmp_path, SOLID)
    assert set(registry.names()) == {*NAMES, "thing/somebody_2020"}
    thing = registry.load("thing")
    assert isinstance(thing, IsotropicSolid)
    assert (thing.density, thing.bulk_modulus, thing.shear_modulus) == (1200.0, 3e9 - 2e7j, 1e9 - 5e7j)
    assert thing.values["bulk_modulus"] == Value(
        value=3e9 - 2e7j, unit="GPa", source="somebody_2020", conditions="1 MHz", uncertainty=1e8, loss_uncertainty=1e7,
        rounding=0.05 * 1e9, loss_tolerance=0.05 * 1e9 + 0.01 * 1e9,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (', unit = "g/cm^3"', "", "density.unit: missing; expected a unit of density"),
        ('"g/cm^3"', '"GPa"', "density.unit: received 'GPa'; expected a unit of density"),
        ('"g/cm^3"', '"g/cm3"', "did you mean 'g/cm\\^3'"),
        ("value = 1.2", "value = '1.2'", "density.value: received '1.2'; expected a finite number"),
        ("value = 1.2", "value = nan", "density.value: received nan"),
        ("value = 1.2, ", "", "density.value: missing"),
        ("value = 1.2", "value = -1.2", "density: received -1200.0; expected a positive number"),
        ("density =", "densty =", "densty: received 'densty'.*did you mean 'density'"),
        ('density = { value = 1.2, unit = "g/cm^3" }', "density = 1200", "density: received 1200; expected a table"),
        ('density = { value = 1.2, unit = "g/cm^3" }', "", "density: missing"),
        ("value = 1.2,", "value = 1.2, loss = 0.1,", "density.loss: received 'loss'"),
        ("value = 1.2,", "value = 1.2, rounding = -1,", "density.rounding: received -1.0; expected a number not below"),
        ("value = 1.2,", "value = 1.2, source = 'somebdy_2020',", "density.source.*did you mean 'somebody_2020'"),
        ('source = "somebody_2020"', "", "source: missing; expected a text"),
        ('conditions = "1 MHz"', "", "conditions: missing"),
        ('kind = "isotropic solid"', 'kind = "isotropic"', "kind.*did you mean 'isotropic solid'"),
        ("title =", "heat_capacity = { value = -1, unit = 'J/(kg K)' }\ntitle =", "heat_capacity: received -1.0"),
        ("title =", "thermal_expansion = { value = 9, unit = 'ppm' }\ntitle =", "did you mean 'ppm/K'"),
        ("title =", "default = 'yes'\ntitle =", "default: received 'yes'; expected true or false"),
        ("shear_modulus", "poisson_ratio", "missing; expected this number of the isotropic solid"),
        ("loss = -0.05", "loss = 0.05", "shear_modulus.*e\\^\\{-i w t\\}"),
        ("loss = -0.02", "loss = 0.07", "bulk_modulus.*e\\^\\{-i w t\\}"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SOLID
    registry = _folder(tmp_path, SOLID.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        registry.load("thing")
    assert "somebody_2020.toml" in caught.value.source


def test_active_within_the_declared_uncertainty_warns(tmp_path: Path) -> None:
    # rounding 0.05 and loss_uncertainty 0.01 GPa: a gain of 0.05 is within 0.06 (and 0.07 is refused above).
    with pytest.warns(PassivityWarning, match="0.05 GPa .* 0.06 GPa"):
        _folder(tmp_path, SOLID.replace("loss = -0.02", "loss = 0.05")).load("thing")


def test_rounding_is_carried_through_a_conversion(tmp_path: Path) -> None:
    # In terms of E and nu the rounding of both losses reaches K'' = Im(E / (3 - 6 nu)): with E = 3 + 0.02i GPa and
    # nu = 0.4, K'' = 5 / 3 x 0.02 = +0.033 GPa and G'' = 0.0071; rounding 0.05 of E explains it, 0.005 does not.
    content = SOLID.replace("bulk_modulus", "youngs_modulus").replace("loss = -0.02", "loss = 0.02")
    content = content.replace('shear_modulus = { value = 1.0, loss = -0.05, unit = "GPa" }',
                              'poisson_ratio = { value = 0.4, unit = "1" }')
    with pytest.warns(PassivityWarning, match=r"0\.0333 GPa .* 0\.1 GPa"):
        _folder(tmp_path, content).load("thing")
    with pytest.raises(InputError, match="bulk_modulus"):
        _folder(tmp_path, content.replace("rounding = 0.05", "rounding = 0.0005")
                .replace("loss_uncertainty = 0.01", "loss_uncertainty = 0.0")).load("thing")


def test_surplus_numbers_are_refused(tmp_path: Path) -> None:
    registry = _folder(tmp_path, SOLID + 'poisson_ratio = { value = 0.3, unit = "1" }\n')
    with pytest.raises(InputError, match="poisson_ratio: received 'a number that the others already give'"):
        registry.load("thing")


def test_wave_speeds_give_the_same_solid(tmp_path: Path) -> None:
    content = SOLID[: SOLID.index("bulk_modulus")] + (
        'longitudinal_speed = { value = 2.0, unit = "mm/us" }\nshear_speed = { value = 1000, unit = "m/s" }\n'
    )
    thing = _folder(tmp_path, content).load("thing")
    assert thing.parameters() == {"density": 1200, "bulk_modulus": pytest.approx(3.2e9), "shear_modulus": 1.2e9}


def test_a_solid_may_depend_on_temperature(tmp_path: Path) -> None:
    law = '{ origin = "20 degC", scale = "1 K", coefficients = [1.0, -0.002], powers = [0, 1], '
    law += 'range = ["10 degC", "40 degC"] }'
    content = SOLID[: SOLID.index("density")] + 'temperature = "20 degC"\n' + "".join(
        f'{name} = {{ unit = "{unit}", law = {law} }}\n'
        for name, unit in (("density", "g/cm^3"), ("bulk_modulus", "GPa"), ("shear_modulus", "GPa"))
    )
    thing = _folder(tmp_path, content).load("thing", temperature=303.15)
    assert thing.temperature == 303.15
    assert thing.parameters() == pytest.approx({"density": 980.0, "bulk_modulus": 0.98e9, "shear_modulus": 0.98e9})


FLUID = """
kind = "fluid"
title = "a fluid"
source = "somebody_2020"
conditions = "1 bar"
temperature = "20 degC"
[density]
unit = "g/cm^3"
law = { origin = "0 degC", scale = "10 K", coefficients = [1.0, -0.01], powers = [0, 1], range = ["0 degC", "50 degC"] }
[sound_speed]
unit = "m/s"
law = { origin = "0 K", scale = "1 K", coefficients = [1400.0], powers = [0], range = ["0 degC", "50 degC"] }
"""


def test_a_law_of_ones_own(tmp_path: Path) -> None:
    registry = _folder(tmp_path, FLUID)
    assert registry.load("thing").parameters() == {"density": pytest.approx(980.0), "sound_speed": 1400.0}
    assert registry.load("thing", temperature=283.15).parameters()["density"] == pytest.approx(990.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('temperature = "20 degC"', "", "temperature: missing"),
        ('temperature = "20 degC"', 'temperature = "60 degC"', "extrapolated"),
        ('temperature = "20 degC"', 'temperature = "20"', "temperature: received '20'"),
        ("powers = [0, 1]", "powers = [0]", "density.law.powers.*expected 2 powers"),
        ("powers = [0, 1]", "powers = [0, 'a']", "density.law.powers.*a list of numbers"),
        ('scale = "10 K"', 'scale = "10 degC"', "density.law.scale.*a temperature difference in K"),
        ('scale = "10 K", ', "", "density.law.scale: missing"),
        ('["0 degC", "50 degC"] }\n[sound', '["50 degC", "0 degC"] }\n[sound', "density.law.range.*below the highest"),
        ('["0 degC", "50 degC"] }\n[sound', '["0 degC"] }\n[sound', "density.law.range.*two temperatures"),
        ("origin = ", "orign = ", "density.law.orign.*did you mean 'origin'"),
        ('unit = "g/cm^3"', 'unit = "g/cm^3"\nvalue = 1.0', "density.*expected a law alone"),
        ('law = { origin = "0 K"', 'value = 1400.0\nlaw_ = { origin = "0 K"', "sound_speed.*expected a law alone"),
    ],
)
def test_mistakes_in_laws_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in FLUID
    with pytest.raises(InputError, match=message):
        _folder(tmp_path, FLUID.replace(old, new, 1)).load("thing")


def test_a_reference_temperature_without_laws_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="temperature: received '20 degC'; expected no temperature"):
        _folder(tmp_path, SOLID.replace("density =", 'temperature = "20 degC"\ndensity =')).load("thing")


def test_two_entries_without_one_default(tmp_path: Path) -> None:
    _folder(tmp_path, SOLID)
    registry = _folder(tmp_path, SOLID, name="thing/other")
    with pytest.raises(InputError, match=r"thing/other, thing/somebody_2020 \(none is declared the default"):
        registry.load("thing")
    for name in ("other", "somebody_2020"):
        (tmp_path / f"thing/{name}.toml").write_text("default = true\n" + SOLID, encoding="utf-8")
    with pytest.raises(InputError, match="2 are declared the default"):
        registry.load("thing")
    (tmp_path / "thing/other.toml").write_text(SOLID, encoding="utf-8")
    assert registry.load("thing").name == "thing/somebody_2020"


def test_a_folder_cannot_shadow_the_package(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a unique name"):
        _folder(tmp_path, SOLID, name="pla/acevedo_2026").names()


def test_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="an existing folder"):
        Registry(folders=(tmp_path / "nowhere",)).names()


def test_a_key_twice_in_a_bibliography(tmp_path: Path) -> None:
    path = tmp_path / "references.bib"
    path.write_text("@book{a, title={x}}\n@misc{ a ,}\n", encoding="utf-8")
    with pytest.raises(InputError, match="each key once"):
        bibliography_keys(path)


def test_importing_defines_and_reads_nothing_heavy() -> None:
    # numpy comes with the first material loaded, TOML and the data files with the material itself.
    script = "import sys, materials; print(sorted({'numpy', 'scipy', 'matplotlib'} & set(sys.modules)))"
    root = Path(materials.__file__).parent.parent
    done = subprocess.run([sys.executable, "-c", script], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
