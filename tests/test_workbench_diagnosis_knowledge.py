"""What is known of a device, of all its states and of each: from campaigns, and from files of chips and materials."""

import math
from pathlib import Path

import numpy as np
import pytest

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.diagnosis.device import device_model
from workbench.files.errors import InputError
from workbench.fitting.parameter import Parameter
from workbench.results.spectrum import Spectrum, write_spectrum

LAYER = '[[layers]]\nrole = "{role}"\nmaterial = "{material}"\nthickness = {thickness}\nradius = "4 mm"\n{more}\n'
HEAD = '[chip]\nname = "small"\nband = ["0.88 MHz", "1.12 MHz"]\n'
DISC = HEAD + LAYER.format(role="transducer", material="pic255", thickness='{ value = "2 mm", tolerance = "10 um" }',
                           more='electrodes = { live = "top" }')
STACK = (HEAD + LAYER.format(role="transducer", material="pic255", thickness='"2 mm"',
                             more='electrodes = { live = "top" }')
         + LAYER.format(role="couplant", material="coupling_gel", thickness='"20 um"', more="")
         + LAYER.format(role="substrate", material="bench_pla", thickness='{ value = "1 mm", tolerance = "0 um" }',
                        more="")
         + LAYER.format(role="sidewall", material="bench_pla", thickness='"0.7 mm"', more='cavity_radius = "2 mm"')
         + LAYER.format(role="superstrate", material="soda_lime_glass", thickness='"1 mm"', more="")
         + '[states.empty]\ncavity = "vacuum"\n[states.filled]\ncavity = "water"\ntemperature = "25 degC"\n'
         + '[states.warm]\ncavity = "water"\ntemperature = "35 degC"\n')
STATES = """
[states.disc]
chip = "disc.toml"
recording = "disc.csv"
[states.empty]
chip = "chip.toml"
state = "empty"
recording = "empty.csv"
[states.filled]
chip = "chip.toml"
state = "filled"
recording = "filled.csv"
[states.warm]
chip = "chip.toml"
state = "warm"
recording = "warm.csv"
"""
#: A polymer whose moduli a fit left correlated, and uncertain.
PLA = """
kind = "isotropic solid"
title = "PLA of a test"
source = "test"
conditions = "at rest"
[density]
value = 1250.0
unit = "kg/m^3"
[bulk_modulus]
value = 3.4
loss = -0.05
unit = "GPa"
uncertainty = 0.1
[shear_modulus]
value = 1.2
loss = -0.03
unit = "GPa"
uncertainty = 0.03
loss_uncertainty = 0.01
"""
FIT = """
[fit.correlation]
names = ["bulk_modulus", "shear_modulus", "shear_modulus loss"]
rows = [[1.0, 0.6, 0.0], [0.6, 1.0, -0.2], [0.0, -0.2, 1.0]]
[fit]
recordings = [{ path = "sample.csv", sha256 = "SUM", chip = "sample.toml" }]
algorithm = "joint"
software = "acoustofluidic-chip-workbench 0.1.0"
band = ["910000 Hz", "1155000 Hz"]
mape_percent = 0.41
rms_log_residual = 0.0052
confidence = 0.95
free = ["bulk_modulus", "shear_modulus", "shear_modulus loss"]
date = "2026-11-21T14:40:00+00:00"
""".replace("SUM", 64 * "0")
BULK, SHEAR, SPEED = "bench_pla/test.bulk_modulus", "bench_pla/test.shear_modulus", "water/iapws_2011.sound_speed"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "materials" / "bench_pla").mkdir(parents=True)
    (tmp_path / "materials" / "bench_pla" / "test.toml").write_text(PLA)
    (tmp_path / "materials" / "references.bib").write_text("@misc{test, title = {A test}}\n")
    (tmp_path / "disc.toml").write_text(DISC)
    (tmp_path / "chip.toml").write_text(STACK)
    frequency = np.linspace(0.9e6, 1.1e6, 41)
    omega = 2.0 * np.pi * frequency
    motion = 30.0 + 1j * omega * 1e-3 + (2.0 * np.pi * 0.99e6) ** 2 * 1e-3 / (1j * omega)
    for name in ("disc", "empty", "filled", "warm"):
        write_spectrum(Spectrum(frequency, 1.0 / (1j * omega * 2.2e-10 + 1.0 / motion)), tmp_path / f"{name}.csv")
    return tmp_path


def read(folder: Path, tables: str, *, head: str = "", states: str = STATES) -> Campaign:
    path = folder / "campaign.toml"
    path.write_text(f'[campaign]\nmaterials = "materials"\n{head}\n{states}\n{tables}')
    return read_campaign(path)


def only(states: str, *kept: str) -> str:
    """The tables of some states."""
    return "".join(f"[states.{part}" for part in states.split("[states.")[1:] if part.split("]")[0] in kept)


# --------------------------------------------------------------------------------------------------------------------
# Between states


def test_what_varies_is_an_offset_of_every_state_that_has_it(folder: Path) -> None:
    found = read(folder, f"""
[known]
"couplant.thickness" = "3 um"
[between]
"couplant.thickness" = "10 %"
"bench.gain" = "1 %"
"{SPEED}" = "0.1 %"
[states.filled.known]
"couplant.thickness" = "1.5 um"
"bench.phase" = "0.002 rad"
""")
    assert found.known["couplant.thickness"] == 3e-6
    assert found.offsets["couplant.thickness[empty]"] == pytest.approx(2e-6)
    # Independent of each other.
    assert found.offsets["couplant.thickness[filled]"] == pytest.approx(math.hypot(2e-6, 1.5e-6))
    assert "couplant.thickness[disc]" not in found.offsets
    assert found.offsets["bench.phase[filled]"] == 0.002
    assert [name for name in found.offsets if name.startswith("bench.gain")] == [
        f"bench.gain[{state}]" for state in ("disc", "empty", "filled", "warm")]
    assert found.offsets["bench.gain[warm]"] == pytest.approx(0.01)
    # Of the value that each state has.
    assert found.offsets[f"{SPEED}[warm]"] == pytest.approx(1e-3 * 1519.8, rel=1e-4)
    assert found.offsets[f"{SPEED}[filled]"] == pytest.approx(1e-3 * 1496.7, rel=1e-4)


def test_a_bench_differs_between_states_unless_the_campaign_says_how(folder: Path) -> None:
    found = read(folder, '[between]\n"bench.gain" = "1 %"\n')
    assert (found.offsets["bench.gain[disc]"], found.offsets["bench.series_resistance[disc]"],
            found.offsets["bench.clock[disc]"]) == (0.01, 0.02, 5e-6)
    assert not [name for name in read(folder, "[between]\ndefaults = false\n").offsets if "bench" in name]
    assert not [name for name in read(folder, '[fixed]\nnames = ["bench.clock"]\n').offsets if "clock" in name]


def test_what_one_state_alone_has_is_one_number(folder: Path) -> None:
    states = only(STATES, "empty", "filled")
    tables = (f'[known]\n"{SPEED}" = "3 m/s"\n[between]\n"{SPEED}" = "4 m/s"\n'
              f'[states.filled.known]\n"water.sound_speed" = "12 m/s"\n"water.density" = "1 kg/m^3"\n')
    found = read(folder, tables, states=states)
    assert found.known[SPEED] == pytest.approx(13.0)
    assert not [name for name in found.offsets if "water" in name]
    # What its file says, and what the state adds.
    assert found.known["water/iapws_2011.density"] == pytest.approx(math.hypot(1.0, 0.02))
    # A campaign of one state has one bench.
    alone = read(folder, '[known]\n"bench.gain" = "0.3 %"\n', states=only(STATES, "disc"))
    assert alone.offsets == {}
    assert alone.known["bench.gain"] == pytest.approx(math.hypot(3e-3, 2e-3))
    assert alone.known["bench.clock"] == 5e-6


# --------------------------------------------------------------------------------------------------------------------
# From files


def test_what_files_state_is_known_unless_the_campaign_says_otherwise(folder: Path) -> None:
    found = read(folder, "[between]\ndefaults = false\n")
    assert found.known == pytest.approx({
        "transducer.thickness": 10e-6 / math.sqrt(3.0), BULK: 0.1e9, SHEAR: 0.03e9, f"{SHEAR}.loss": 0.01e9,
        "water/iapws_2011.density": 0.02, SPEED: 0.1}, rel=1e-12)
    taken = {each.name: each for each in found.uncertain}
    assert set(taken) == set(found.known)
    assert taken["transducer.thickness"].origin == f"{folder / 'disc.toml'}: tolerance"
    assert (taken[BULK].origin, taken[BULK].unit) == ("bench_pla/test: uncertainty", "Pa")
    other = read(folder, f'[known]\n"{BULK}" = "1 %"\n[fixed]\nnames = ["{SHEAR}", "transducer.thickness"]\n')
    assert other.known[BULK] == pytest.approx(0.034e9)
    assert not {SHEAR, "transducer.thickness"} & set(other.known)
    assert f"{SHEAR}.loss" in other.known
    assert {each.name: each.origin for each in other.uncertain}[BULK] == f"{folder / 'campaign.toml'}: [known]"
    assert read(folder, "[between]\ndefaults = false\n", head='known = "named"').known == {}


def test_correlations_of_a_fit_come_along(folder: Path) -> None:
    (folder / "materials" / "bench_pla" / "test.toml").write_text(PLA + FIT)
    found = read(folder, "")
    assert found.correlations == pytest.approx({(BULK, SHEAR): 0.6, (SHEAR, f"{SHEAR}.loss"): -0.2})
    # Another number takes the place of all that the fit said of it; what is exact correlates with nothing.
    assert read(folder, f'[known]\n"{BULK}" = "1 %"\n').correlations == pytest.approx({(SHEAR, f"{SHEAR}.loss"): -0.2})
    assert read(folder, f'[fixed]\nnames = ["{SHEAR}"]\n').correlations == {}
    # An independent addition leaves the covariance as it is.
    alone = read(folder, f'[between]\n"{BULK}" = "0.1 GPa"\n', states=only(STATES, "empty"))
    assert alone.known[BULK] == pytest.approx(math.sqrt(2.0) * 0.1e9)
    assert alone.correlations[BULK, SHEAR] == pytest.approx(0.6 / math.sqrt(2.0))


def test_two_chip_files_must_not_give_one_length_two_tolerances(folder: Path) -> None:
    text = STACK.replace('thickness = "2 mm"', 'thickness = { value = "2 mm", tolerance = "20 um" }')
    (folder / "chip.toml").write_text(text)
    with pytest.raises(InputError, match=r"chip.toml: transducer.thickness.tolerance: .*2e-05 m.*1e-05 m"):
        read(folder, "")
    assert read(folder, '[known]\n"transducer.thickness" = "7 um"\n').known["transducer.thickness"] == 7e-6


def test_a_length_that_differs_between_stacks_is_known_in_each(folder: Path) -> None:
    """The gel below a sample is not that below a chip."""
    (folder / "disc.toml").write_text(DISC + LAYER.format(
        role="couplant", material="coupling_gel", thickness='{ value = "30 um", tolerance = "3 um" }', more=""))
    found = read(folder, "")
    assert found.offsets["couplant.thickness[disc]"] == pytest.approx(3e-6 / math.sqrt(3.0))
    assert "couplant.thickness" not in found.known
    with pytest.raises(InputError, match=r"known.couplant.thickness: .*same in all states"):
        read(folder, '[known]\n"couplant.thickness" = "1 um"\n')


# --------------------------------------------------------------------------------------------------------------------
# The model's accuracy


@pytest.mark.parametrize(("text", "inhomogeneity"), [
    ("", None), ("[model]\n", None), ('[model]\ninhomogeneity = "0.2 %"\n', 0.002),
    ('[model]\ninhomogeneity = "0"\n', 0.0)])
def test_the_inhomogeneity_of_the_model(folder: Path, text: str, inhomogeneity: float | None) -> None:
    assert read(folder, text).inhomogeneity == inhomogeneity


# --------------------------------------------------------------------------------------------------------------------
# Mistakes


@pytest.mark.parametrize(("tables", "field", "value", "said"), [
    ('[between]\n"bench.gian" = "1 %"', "between.bench.gian", "bench.gian", "'bench.gain'"),
    ('[between]\n"gel.thickness" = "1 %"', "between.gel.thickness", "gel.thickness", "a state has"),
    ('[between]\n"bench.gain" = "0 %"', "between.bench.gain", "0 %", "above zero"),
    ('[between]\n"bench.gain" = "-1 %"', "between.bench.gain", "-1 %", "above zero"),
    ('[between]\n"bench.delay" = "1 %"', "between.bench.delay", "1 %", "is zero"),
    ('[between]\n"bench.delay" = "1 ohm"', "between.bench.delay", "1 ohm", "a time"),
    ('[between]\n"pic255.c33.loss" = "1 %"', "between.pic255.c33.loss", "1 %", "is zero"),
    ('[between]\n"bench.gain[disc]" = "1 %"', "between.bench.gain[disc]", "bench.gain[disc]",
     '"bench.gain" in the table [states.disc.known]'),
    ('[between]\ndefaults = "no"', "between.defaults", "no", "true or false"),
    ('[between]\n"water.density" = "1 %"\n"water/iapws_2011.density" = "2 %"', "between.water/iapws_2011.density",
     "water/iapws_2011.density", "once"),
    ('[between]\n"transducer.radius" = "1 %"\n"couplant.radius" = "2 %"', "between.couplant.radius", "2 %",
     "between.transducer.radius"),
    ('[between]\n"substrate.thickness" = "1 %"', "between.substrate.thickness", "1 %", "exact"),
    ('[between]\n"bench.gain" = "1 %"\n[fixed]\nnames = ["bench.gain"]', "fixed.names", "bench.gain",
     "may move or may not"),
    ('[states.disc.known]\n"couplant.thickness" = "1 um"', "states.disc.known.couplant.thickness", "couplant.thickness",
     "this state has"),
    ('[states.disc.known]\n"pic255.c33" = "1 %"\n[fixed]\nnames = ["pic255.c33"]', "fixed.names", "pic255/plutho.c33",
     "states.disc.known.pic255.c33"),
    ('[states.filed.known]\n"bench.gain" = "1 %"', "states.filed", "filed", "'filled'"),
    ('[known]\n"bench.gain[disc]" = "1 %"', "known.bench.gain[disc]", "bench.gain[disc]",
     '"bench.gain" in the table [states.disc.known]'),
    ('[fixed]\nnames = ["bench.gain[disc]"]', "fixed.names", "bench.gain[disc]", "a state has"),
    ('[between]\n"bench.gain" = "0.5"', "between.bench.gain", "0.5", '"0.5 %" or "50 %"?'),
    ('[known]\n"bench.clock" = 5e-6', "known.bench.clock", "5e-06", '"5e-06 %" or "0.0005 %"?'),
    ('[model]\ninhomogeneity = "0.002"', "model.inhomogeneity", "0.002", '"0.002 %" or "0.2 %"?'),
    ('[model]\ninhomogeneity = "-1 %"', "model.inhomogeneity", "-1 %", "from 0"),
    ('[model]\ninhomogeneity = "2"', "model.inhomogeneity", "2", "0.2 %"),
    ('[model]\ninhomogeneity = "1 mm"', "model.inhomogeneity", "1 mm", "a share in one of %"),
    ('[model]\ninhomogenity = "1 %"', "model.inhomogenity", "inhomogenity", "'inhomogeneity'"),
])
def test_a_mistake_is_named(folder: Path, tables: str, field: str, value: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(folder, tables)
    assert (caught.value.source, caught.value.field) == (str(folder / "campaign.toml"), field)
    assert str(caught.value.value) == value
    assert said in str(caught.value)


@pytest.mark.parametrize(("first", "states", "field"), [
    ("between = 3", STATES, "between"), ("model = 3", STATES, "model"),
    ("", STATES.replace("[states.disc]", '[states.disc]\nknown = "all"'), "states.disc.known")])
def test_what_should_be_a_table_is_one(folder: Path, first: str, states: str, field: str) -> None:
    (folder / "campaign.toml").write_text(f"{first}\n{states}".replace("bench_pla", "pla"))
    (folder / "chip.toml").write_text(STACK.replace("bench_pla", "pla"))
    with pytest.raises(InputError, match=r"expected a table \[") as caught:
        read_campaign(folder / "campaign.toml")
    assert caught.value.field == field


def test_what_else_is_known_is_one_of_two_words(folder: Path) -> None:
    with pytest.raises(InputError, match=r"campaign.known: received 'name'; expected one of named, stated"):
        read(folder, "", head='known = "name"')


# --------------------------------------------------------------------------------------------------------------------
# The model


def test_known_numbers_come_first_and_then_what_states_add(folder: Path) -> None:
    found = device_model(read(folder, f"""
[known]
"couplant.thickness" = "3 um"
"bench.gain" = "0.5 %"
"{SPEED}" = "0.2 %"
[between]
"couplant.thickness" = "30 %"
"transducer.radius" = "10 um"
"{SPEED}" = "1 m/s"
"{SHEAR}.loss" = "30 %"
"""), accuracy=2e-2)
    campaign = found.campaign
    names = [p.name for p in found.parameters]
    assert names[:found.known] == [*campaign.known, *campaign.offsets]
    assert all(p.prior is not None for p in found.parameters[:found.known])
    assert all(found.index(name) == i for i, name in enumerate(names))
    by_name: dict[str, Parameter] = dict(zip(names, found.parameters, strict=True))
    gel, speed, loss, radius, gain = (by_name[f"{name}[filled]"] for name in (
        "couplant.thickness", SPEED, f"{SHEAR}.loss", "transducer.radius", "bench.gain"))
    for each in (gel, speed, loss, radius, gain):
        assert (each.offset, each.recordings, each.start) == (True, ("filled",), 0.0)
    # Five uncertainties, as far as something is left of the layer; no loss is a gain.
    assert (gel.low, gel.high) == pytest.approx((-0.9 * 20e-6, 5 * 6e-6))
    assert (loss.low, loss.high) == pytest.approx((-5 * 9e6, 3e7))
    assert (gain.low, gain.high, gain.prior) == pytest.approx((-0.01, 0.01, 0.002))
    # A factor of what the state's own temperature gives, and added to the factor that all have.
    assert (speed.relative, speed.unit) == (True, "1")
    assert speed.prior == pytest.approx(1.0 / 1496.7, rel=1e-4)
    assert by_name[f"{SPEED}[warm]"].prior == pytest.approx(1.0 / 1519.8, rel=1e-4)
    # Radii that are one stay one; its cells stretch as far as it may be moved in any state.
    assert radius.tied == campaign.tied["transducer.radius"]
    x = np.array([p.start for p in found.parameters])
    x[[found.index("transducer.radius[warm]"), found.index("couplant.thickness[filled]")]] = 2e-5, 4e-6
    disc, empty, filled, warm = (found.fitted.settings(x, index)[0] for index in range(4))
    assert warm["transducer.radius"] - 4e-3 == pytest.approx(2e-5)
    assert "transducer.radius" not in filled or filled["transducer.radius"] == 4e-3
    assert filled["couplant.thickness"] - warm["couplant.thickness"] == pytest.approx(4e-6)
    # What they add is no reason to solve for states of one chip apart.
    assert found.fitted.predictors[2] is found.fitted.predictors[3]
    assert disc.keys() < empty.keys()
