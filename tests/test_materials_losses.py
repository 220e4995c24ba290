"""Losses as data sheets print them, and the loss that a lossless ceramic is assumed to have."""

from __future__ import annotations

import cmath
import math
import warnings
from dataclasses import replace
from pathlib import Path

import pytest

from materials import (
    ASSUMED,
    Fit,
    Fluid,
    IsotropicSolid,
    LossWarning,
    Material,
    PassivityWarning,
    Piezoelectric,
    RecordingSource,
    Registry,
    Value,
    describe,
    fitted,
    passivity,
    save_fit,
    with_assumed_loss,
)
from materials.assumed import lossless_polymer
from workbench.files.errors import InputError

HEAD = 'title = "thing"\nsource = "somebody_2020"\nconditions = "1 MHz"\n'
OF_SOLID = 'kind = "isotropic solid"\n' + HEAD + 'density = { value = 1200, unit = "kg/m^3" }\n'
OF_FLUID = 'kind = "fluid"\n' + HEAD + 'density = { value = 1000, unit = "kg/m^3" }\n'
SPEEDS = OF_SOLID.replace("{", "{{").replace("}", "}}") + (
    'longitudinal_speed = {{ value = 2500, unit = "m/s", {0} }}\n'
    'shear_speed = {{ value = 1100, unit = "m/s", {1} }}\n')
CERAMIC = 'kind = "piezoelectric"\n' + HEAD + """density = { value = 7750, unit = "kg/m^3" }
s11 = { value = 16.4, unit = "1/TPa" }
s12 = { value = -5.74, unit = "1/TPa" }
s13 = { value = -7.22, unit = "1/TPa" }
s33 = { value = 18.8, unit = "1/TPa" }
s44 = { value = 47.5, unit = "1/TPa" }
d31 = { value = -171, unit = "pm/V" }
d33 = { value = 374, unit = "pm/V" }
d15 = { value = 584, unit = "pm/V" }
free_eps11 = { value = 1730, unit = "1" }
free_eps33 = { value = 1700, unit = "1" }
"""
OMEGA = 2.0 * math.pi * 1e6


def registry(folder: Path, content: str) -> Registry:
    (folder / "thing").mkdir(exist_ok=True)
    (folder / "thing" / "somebody_2020.toml").write_text(content, encoding="utf-8")
    (folder / "references.bib").write_text("@misc{somebody_2020,\n title = {T},\n}\n", encoding="utf-8")
    return Registry((folder,))


def load(folder: Path, content: str) -> Material:
    return registry(folder, content).load("thing")


def solid(folder: Path, content: str) -> IsotropicSolid:
    found = load(folder, content)
    assert isinstance(found, IsotropicSolid)
    return found


@pytest.mark.parametrize("loss", ['loss = "5 %"', "loss_tangent = 0.05", 'loss_tangent = "5 %"', "q = 20",
                                  "loss = -0.175"])
def test_one_loss_factor_in_five_forms(tmp_path: Path, loss: str) -> None:
    # With a real Poisson ratio every modulus has the loss tangent of Young's.
    found = solid(tmp_path, OF_SOLID + f'youngs_modulus = {{ value = 3.5, unit = "GPa", {loss} }}\n'
                  'poisson_ratio = { value = 0.36, unit = "1" }\n')
    for modulus in (found.bulk_modulus, found.shear_modulus):
        assert -complex(modulus).imag / complex(modulus).real == pytest.approx(0.05, rel=1e-12)


@pytest.mark.parametrize("stated", [
    ('attenuation = "3 dB/cm", frequency = "1 MHz"', 'attenuation = "9 dB/cm", frequency = "1 MHz"'),
    ('attenuation = "3 dB/cm at 1 MHz"', 'attenuation = "900 dB/m at 1 MHz"'),
    ('attenuation = "0.3 dB/mm", frequency = "1000 kHz"', 'attenuation = "9 dB/(cm MHz)"'),
    ('attenuation = "6 dB/cm", frequency = "2 MHz"', 'attenuation = "9 dB/cm/MHz"'),
    ('attenuation = "3 dB/cm MHz", frequency = "1 MHz"', f'attenuation = "{9 * math.log(10) * 5} Np/m at 1 MHz"'),
])  # fmt: skip
def test_attenuation_is_that_of_the_wave(tmp_path: Path, stated: tuple[str, str]) -> None:
    found = solid(tmp_path, SPEEDS.format(*stated))
    longitudinal = complex(found.bulk_modulus + 4 * found.shear_modulus / 3)
    # k = w sqrt(rho / M) exactly: its real part is the printed phase speed, its imaginary part the attenuation.
    for modulus, speed, decibels in ((longitudinal, 2500.0, 300.0), (complex(found.shear_modulus), 1100.0, 900.0)):
        number = OMEGA * cmath.sqrt(1200.0 / modulus)
        assert OMEGA / number.real == pytest.approx(speed, rel=1e-12)
        assert number.imag == pytest.approx(decibels * math.log(10.0) / 20.0, rel=1e-12)


def test_the_loss_tangent_of_a_speed_is_that_of_its_modulus(tmp_path: Path) -> None:
    found = solid(tmp_path, SPEEDS.format('loss_tangent = "4 %"', "q = 12.5"))
    longitudinal = complex(found.bulk_modulus + 4 * found.shear_modulus / 3)
    assert -longitudinal.imag / longitudinal.real == pytest.approx(0.04, rel=1e-12)
    assert -complex(found.shear_modulus).imag / complex(found.shear_modulus).real == pytest.approx(0.08, rel=1e-12)
    assert found.values["longitudinal_speed"].value.real == 2500.0  # as printed
    # Half of it is the imaginary part of the speed: c (1 - i tan / 2).
    assert found.values["longitudinal_speed"].value.imag == pytest.approx(-2500.0 * 0.02, rel=1e-3)
    percent = solid(tmp_path, SPEEDS.format('loss = "2 %"', 'loss = "4 %"'))
    assert percent.bulk_modulus == pytest.approx(found.bulk_modulus, rel=2e-3)
    assert solid(tmp_path, SPEEDS.format("loss = -50", "loss = -44")).bulk_modulus == percent.bulk_modulus


def test_uncertainties_are_stated_as_the_loss_is(tmp_path: Path) -> None:
    content = OF_SOLID + ('youngs_modulus = { value = 3.5, unit = "GPa", rounding = 0.05, loss_tangent = 0.05, '
                          'loss_uncertainty = "1 %" }\npoisson_ratio = { value = 0.36, unit = "1" }\n')
    value = load(tmp_path, content).values["youngs_modulus"]
    assert value.loss_uncertainty == pytest.approx(0.035e9, rel=1e-6)
    assert value.loss_tolerance == pytest.approx(0.035e9 + 0.05 * 0.05e9, rel=1e-6)
    quality = content.replace('loss_tangent = 0.05, loss_uncertainty = "1 %"', "q = 20, loss_uncertainty = 4")
    assert load(tmp_path, quality).values["youngs_modulus"].loss_uncertainty == pytest.approx(3.5e9 * 4 / 400, rel=1e-6)
    waves = SPEEDS.format('attenuation = "3 dB/cm at 1 MHz", loss_uncertainty = "0.3 dB/cm"', "loss_tangent = 0.01")
    wave = load(tmp_path, waves).values["longitudinal_speed"]
    assert wave.loss_uncertainty == pytest.approx(0.1 * abs(wave.value.imag), rel=1e-6)
    assert "attenuation 3 dB/cm at 1 MHz" in wave.loss_stated


def test_a_ceramic_states_q_and_tan_delta_once(tmp_path: Path) -> None:
    once = load(tmp_path, CERAMIC + "mechanical_q = 75\ndielectric_loss_tangent = 0.02\n")
    each = CERAMIC
    for name in ("16.4", "-5.74", "-7.22", "18.8", "47.5"):
        each = each.replace(f"value = {name},", f"value = {name}, q = 75,")
    for name in ("1730", "1700"):
        each = each.replace(f"value = {name},", f'value = {name}, loss_tangent = "2 %",')
    assert once == load(tmp_path, each)
    assert isinstance(once, Piezoelectric)
    assert once.values["s12"].value == pytest.approx(-5.74e-12 * (1 + 1j / 75), rel=1e-12)
    assert once.c44.imag / once.c44.real == pytest.approx(-1 / 75, rel=1e-12)
    assert once.values["free_eps33"].value.imag == pytest.approx(34.0, rel=1e-12)
    assert passivity.smallest_dissipation(once) > 0
    assert "; q 75; " in describe(load(tmp_path, STIFF.replace("loss = 0.02", "loss_tangent = 0.02")))


STIFF = 'kind = "piezoelectric"\nmechanical_q = 75\n' + HEAD + """density = { value = 7500, unit = "kg/m^3" }
c11 = { value = 139, unit = "GPa" }
c12 = { value = 77.8, unit = "GPa" }
c13 = { value = 74.3, unit = "GPa" }
c33 = { value = 115, unit = "GPa" }
c44 = { value = 25.6, unit = "GPa" }
e31 = { value = 0, unit = "C/m^2" }
e33 = { value = 0, unit = "C/m^2" }
e15 = { value = 0, unit = "C/m^2" }
eps11 = { value = 762.5, unit = "1", loss = 0.02 }
eps33 = { value = 663.2, unit = "1", loss = 0.02 }
"""


@pytest.mark.parametrize(("stated", "message"), [
    ("loss_tangent = 0.02, q = 50", "q: received 'a second loss, beside loss_tangent'"),
    ('loss = -50, attenuation = "3 dB/cm at 1 MHz"', "attenuation: received 'a second loss, beside loss'"),
    ('attenuation = "3 dB/cm"', 'attenuation: received .*its frequency beside it, such as frequency = "1 MHz"'),
    ('attenuation = "3 dB/cm at 1 MHz", frequency = "1 MHz"', "the frequency once"),
    ('attenuation = "3 cm", frequency = "1 MHz"', "did you mean .*dB/cm"),
    ('attenuation = "-3 dB/cm", frequency = "1 MHz"', "not below zero"),
    ('attenuation = 3, frequency = "1 MHz"', "attenuation: received 3; expected an attenuation such as"),
    ('attenuation = "3 dB/cm at 1 MHz", loss_uncertainty = 0.1', "in the unit of the loss"),
    ("loss_tangent = 2", 'from 0 to below 1, such as 0.02 or "2 %"'),
    ("loss_tangent = -0.02", "from 0 to below 1"),
    ("q = 0.5", "a quality factor above 1"),
    ('q = "75"', "a number without unit"),
    ('loss = "0.05"', "a percentage of it such as"),
    ("loss = 50", "a number not above zero"),
    ('loss_tangent = 0.02, frequency = "1 kHz"', "only an attenuation has one"),
    ("loss_tangents = 0.02", "did you mean 'loss_tangent'"),
])  # fmt: skip
def test_losses_that_are_refused(tmp_path: Path, stated: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path, SPEEDS.format(stated, "loss_tangent = 0.01"))
    assert "line 6" in caught.value.source


def test_losses_that_contradict_others_are_refused(tmp_path: Path) -> None:
    # 4/3 (1100 / 2500)^2 of the loss of shear is in the longitudinal wave: 0.0129 of 0.05.
    with pytest.raises(InputError, match=r"one of 0.0129 at least, the part of the shear loss"):
        load(tmp_path, SPEEDS.format("loss_tangent = 0.012", "loss_tangent = 0.05"))
    with pytest.raises(InputError, match="mechanical_q: received 'a second loss of s11, which states loss'"):
        load(tmp_path, CERAMIC.replace("value = 16.4,", "value = 16.4, loss = 0.2,") + "mechanical_q = 75\n")
    with pytest.raises(InputError, match=r"mechanical_q: received 0.01; expected a quality factor above 1"):
        load(tmp_path, CERAMIC + "mechanical_q = 0.01\n")
    with pytest.raises(InputError, match=r"e33.q: received 75; expected the loss as loss: passivity does not fix its"):
        load(tmp_path, STIFF.replace('e33 = { value = 0,', 'e33 = { value = 15, q = 75,'))
    with pytest.raises(InputError, match=r"attenuation: .*only a wave speed has an attenuation"):
        load(tmp_path, STIFF.replace("mechanical_q = 75\n", "")
             .replace("value = 115,", 'value = 115, attenuation = "3 dB/cm at 1 MHz",'))
    with pytest.raises(InputError, match="ceramic: received 'weak'; expected one of hard, soft"):
        load(tmp_path, CERAMIC + 'ceramic = "weak"\n')


def test_a_fluid_absorbs_as_its_attenuation_says(tmp_path: Path) -> None:
    stated = 'sound_speed = {{ value = 1500, unit = "m/s", {0} }}\n'
    viscous = 'shear_viscosity = { value = 1, unit = "mPa s" }\n'
    forms = ['attenuation = "0.2 dB/cm", frequency = "1 MHz", loss_uncertainty = "0.02 dB/cm"',
             'attenuation = "0.8 dB/cm", frequency = "2 MHz"', 'attenuation = "0.2 dB/(cm MHz^2)"']
    alpha = 20.0 * math.log(10.0) / 20.0
    for form in forms:
        for others in ("", viscous):
            found = load(tmp_path, OF_FLUID + stated.format(form) + others)
            assert isinstance(found, Fluid)
            assert found.diffusivity_of_sound is not None
            assert OMEGA**2 / (2.0 * 1500.0**3) * found.diffusivity_of_sound == pytest.approx(alpha, rel=1e-12)
    bulk = load(tmp_path, OF_FLUID + stated.format(forms[0]) + viscous).values["bulk_viscosity"]
    assert bulk.uncertainty == pytest.approx(0.1 * (bulk.value.real + 4e-3 / 3), rel=1e-9)
    tangent = load(tmp_path, OF_FLUID + stated.format('loss_tangent = 0.01, frequency = "1 MHz"'))
    assert isinstance(tangent, Fluid)
    assert tangent.diffusivity_of_sound is not None
    assert OMEGA * tangent.diffusivity_of_sound / 1500.0**2 == pytest.approx(0.01, rel=1e-4)
    for form, others, message in (
        ("loss = -3", "", "sound_speed.loss"),
        ("loss_tangent = 0.01", "", "its frequency beside it"),
        ('attenuation = "0.2 dB/(cm MHz)"', "", "its frequency beside it"),
        ('attenuation = "1e-4 dB/cm at 1 MHz"', viscous, "at least .* the part of shear viscosity"),
        (forms[1], 'bulk_viscosity = { value = 1, unit = "Pa s" }\n', "bulk_viscosity: received 'a second loss"),
    ):
        with pytest.raises(InputError, match=message):
            load(tmp_path, OF_FLUID + stated.format(form) + others)


def test_what_has_no_shear_is_given_by_its_compressibility(tmp_path: Path) -> None:
    fluid = load(tmp_path, OF_FLUID + 'compressibility = { value = 400, unit = "1/TPa" }\n')
    assert isinstance(fluid, Fluid)
    assert fluid.compressibility == pytest.approx(4e-10, rel=1e-12)
    assert fluid.sound_speed == pytest.approx(1 / math.sqrt(1000 * 4e-10), rel=1e-12)
    for shear in ("", 'shear_modulus = { value = 0, unit = "Pa" }\n'):
        cell = solid(tmp_path, OF_SOLID + 'compressibility = { value = 0.4, unit = "1/GPa" }\n' + shear)
        assert (cell.compressibility, cell.shear_modulus) == (pytest.approx(4e-10, rel=1e-12), 0)
    with pytest.raises(InputError, match=r"compressibility: received 0.0; expected a positive number"):
        load(tmp_path, OF_FLUID + 'compressibility = { value = 0, unit = "1/TPa" }\n')
    with pytest.raises(InputError, match="sound_speed: missing"):
        load(tmp_path, OF_FLUID)


def test_a_loss_tangent_typed_as_a_loss_is_asked_about(tmp_path: Path) -> None:
    with pytest.warns(LossWarning, match=r"eps11 762.5 with loss 0.02: 2.6e-05 of it; eps33 663.2.*write loss_tangent"):
        load(tmp_path, STIFF)
    with pytest.warns(LossWarning, match="bulk_modulus 350"):
        load(tmp_path, OF_SOLID + 'bulk_modulus = { value = 350, unit = "MPa", loss = -0.03 }\n'
             'shear_modulus = { value = 90, unit = "MPa" }\n')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(tmp_path, STIFF.replace("loss = 0.02", "loss_tangent = 0.02"))


def test_what_a_fit_saves_is_read_back_with_its_loss(tmp_path: Path) -> None:
    recording = RecordingSource(path="disc.csv", sha256="0" * 64, chip="disc.toml", chip_sha256="0" * 64)
    fit = Fit(recordings=(recording,), algorithm="a", software="s", date="2026-01-01T00:00:00+00:00",
              band=(0.9e6, 1.2e6), free=("c33",), fixed=(), mape_percent=1.0, rms_log_residual=0.01, confidence=0.95)
    start = load(tmp_path, STIFF.replace("loss = 0.02", "loss_tangent = 0.02") + 'ceramic = "soft"\n')
    found = fitted(start, {"c33": Value(1.2e11 - 1e9j, "Pa", "")}, fit=fit)
    own = Registry((tmp_path,))
    assert save_fit(found, "thing/disc", folder=tmp_path) == "thing/disc@1"
    again = own.load("thing/disc")
    assert isinstance(again, Piezoelectric)
    assert again.parameters() == found.parameters()
    assert (again.ceramic, again.eps33) == ("soft", 663.2 * (1 + 0.02j))
    assert again.c11 == pytest.approx(139e9 * (1 - 1j / 75), rel=1e-15)


def test_a_lossless_ceramic_has_the_loss_of_its_class() -> None:
    plain = Registry().load("pzt5a")
    assert isinstance(plain, Piezoelectric)
    found, said = with_assumed_loss(plain)
    assert isinstance(found, Piezoelectric)
    assert (found.c33, found.e33) == (plain.c33 * (1 - 1j / 75), plain.e33)
    assert found.eps33 == plain.eps33 * (1 + 0.02j)
    assert passivity.smallest_dissipation(found) > 0
    assert ("pzt5a/erturk_2011 states no loss; the assumed loss is that of a soft ceramic, Q_m 75 and tan delta 0.02"
            in said)
    hard, _ = with_assumed_loss(Registry().load("pzt4/comsol_nominal"))
    assert isinstance(hard, Piezoelectric)
    assert -hard.c11.imag / hard.c11.real == pytest.approx(1 / ASSUMED["hard"].mechanical_q)
    _, unstated = with_assumed_loss(replace(plain, ceramic=""))
    assert "soft (its entry does not state it)" in unstated
    for name in ("pla", "water", "pzt4/acevedo_2026_initial"):
        assert with_assumed_loss(Registry().load(name)) == (Registry().load(name), "")


def test_a_polymer_without_a_loss_is_named() -> None:
    for name in ("coc", "pdms"):
        assert f"{Registry().load(name).name} is a polymer whose entry states no loss" in lossless_polymer(
            Registry().load(name))
    for name in ("petg", "soda_lime_glass/en572_2012", "silicon/wafer_100", "silicon/cubic_100_100", "water", "pzt5a"):
        assert lossless_polymer(Registry().load(name)) == ""


def test_a_density_of_no_solid_is_asked_about(tmp_path: Path) -> None:
    """As that of a layer is (`geometry.plausible`); a fluid may be a gas."""
    moduli = 'bulk_modulus = { value = 3.5, unit = "GPa" }\nshear_modulus = { value = 1, unit = "GPa" }\n'
    slip = OF_SOLID.replace("1200", "1.2")
    with pytest.raises(InputError, match=r"line 5: density: received '1.2 kg/m\^3'; expected 50 to 23000 kg/m\^3, the "
                       r"usual range of a solid; .* did you mean '1200 kg/m\^3'"):
        load(tmp_path, slip + moduli)
    with pytest.raises(InputError, match=r"did you mean '1200 kg/m\^3'"):
        load(tmp_path, OF_SOLID.replace("kg/m^3", "g/cm^3") + moduli)
    aerogel = load(tmp_path, 'unusual = ["density"]\n' + slip + moduli)
    assert aerogel.density == 1.2
    with pytest.raises(InputError, match="did you mean 'density'"):
        load(tmp_path, 'unusual = ["densty"]\n' + slip + moduli)
    gas = OF_FLUID.replace("1000", "1.2") + 'sound_speed = { value = 340, unit = "m/s" }\n'
    assert load(tmp_path, gas).density == 1.2
    recording = RecordingSource(path="disc.csv", sha256="0" * 64, chip="disc.toml", chip_sha256="0" * 64)
    fit = Fit(recordings=(recording,), algorithm="a", software="s", date="2026-01-01T00:00:00+00:00",
              band=(0.9e6, 1.2e6), free=("bulk_modulus",), fixed=(), mape_percent=1.0, rms_log_residual=0.01,
              confidence=0.95)
    found = fitted(aerogel, {"bulk_modulus": Value(3.4e9, "Pa", "")}, fit=fit)
    save_fit(found, "thing/light", folder=tmp_path)
    assert Registry((tmp_path,)).load("thing/light").density == 1.2


def test_losses_within_their_rounding_are_a_note_that_says_what_to_do() -> None:
    notes: list[str] = []
    material = Registry().load("pzt4/acevedo_2026_fitted", notes=notes)  # and no warning
    (note,) = notes
    assert note.startswith("pzt4/acevedo_2026_fitted: used as printed.")
    assert note.endswith("nothing to do")
    with pytest.warns(PassivityWarning, match="used as printed"):
        assert Registry().load("pzt4/acevedo_2026_fitted") == material
