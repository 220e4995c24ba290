"""Campaign files: what they mean, and what every mistake in one is answered with."""

import cmath
from pathlib import Path

import numpy as np
import pytest

from workbench.campaign.campaign import read_campaign
from workbench.diagnosis.device import device_model
from workbench.files.errors import InputError
from workbench.results.spectrum import Spectrum, scatter, write_spectrum

LAYER = """
[[layers]]
role = "{role}"
material = "{material}"
thickness = "{thickness}"
radius = "4 mm"
{more}
"""
HEAD = '[chip]\nname = "small"\nband = ["0.88 MHz", "1.12 MHz"]\n'
DISC = HEAD + LAYER.format(role="transducer", material="pic255", thickness="2 mm", more='electrodes = { live = "top" }')
STACK = (DISC + LAYER.format(role="couplant", material="coupling_gel", thickness="20 um", more="")
         + LAYER.format(role="substrate", material="pla", thickness="1 mm", more="")
         + LAYER.format(role="sidewall", material="pla", thickness="0.7 mm", more='cavity_radius = "2 mm"')
         + LAYER.format(role="superstrate", material="soda_lime_glass", thickness="1 mm", more="")
         + '[states.empty]\ncavity = "vacuum"\n[states.filled]\ncavity = "water"\ntemperature = "25 degC"\n')
CAMPAIGN = """
[campaign]
name = "device"
[states.disc]
chip = "disc.toml"
recording = "disc.csv"
drive = "2 Vpp"
[states.filled]
chip = "chip.toml"
state = "filled"
recording = "filled.csv"
drive = "2 Vpp"
noise = "0.5 %"
[states.empty]
chip = "chip.toml"
state = "empty"
recording = "empty.csv"
held_out = true
[known]
"pic255.c33" = "2 %"
"pla.shear_modulus" = "30 MPa"
"water.sound_speed" = "0.2 %"
"couplant.thickness" = "3 um"
"bench.series_resistance" = "50 mohm"
"bench.gain" = "0.5 %"
[fixed]
names = ["transducer.density"]
"""


def circuit(resonance: float, capacitance: float = 2.2e-10) -> Spectrum:
    """A resonance of a disc of this size: a motional branch beside its capacitance."""
    frequency = np.linspace(0.9e6, 1.1e6, 81)
    omega = 2.0 * np.pi * frequency
    inductance = 1e-3
    motion = 30.0 + 1j * omega * inductance + (2.0 * np.pi * resonance) ** 2 * inductance / (1j * omega)
    impedance = 1.0 / (1j * omega * capacitance + 1.0 / motion)
    return Spectrum(frequency, impedance)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "disc.toml").write_text(DISC)
    (tmp_path / "chip.toml").write_text(STACK)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    for name in ("disc", "filled", "empty"):
        spectrum = circuit(0.99e6)
        if name == "disc":
            spectrum = Spectrum(spectrum.frequency, spectrum.impedance, 0.01 * spectrum.magnitude)
        write_spectrum(spectrum, tmp_path / f"{name}.csv")
    return tmp_path


def test_a_campaign_says_what_is_known_in_si(folder: Path) -> None:
    found = read_campaign(folder / "campaign.toml")
    assert [s.name for s in found.fitted] == ["disc", "filled"]
    assert [s.name for s in found.held_out] == ["empty"]
    assert found.states[0].drive == 1.0  # amplitude of 2 V peak to peak
    assert found.known == pytest.approx({
        "pic255/plutho.c33": 0.02 * 117e9, "pla/acevedo_2026.shear_modulus": 30e6,
        "water/iapws_2011.sound_speed": 0.002 * 1496.7, "couplant.thickness": 3e-6, "bench.series_resistance": 0.05,
        "bench.gain": 0.005, "water/iapws_2011.density": 0.02}, rel=1e-4, abs=0.0)  # to the digits written here
    assert found.fixed == ("pic255/plutho.density",)
    assert found.states[0].noise == pytest.approx(0.01)
    assert found.states[1].noise == pytest.approx(0.005)
    assert found.states[0].stated
    assert not found.states[2].stated


@pytest.mark.parametrize(("old", "new", "field", "said"), [
    ('recording = "disc.csv"', 'recording = "disk.csv"', "", "disk.csv"),
    ('chip = "disc.toml"', 'chip = "disk.toml"', "file", "existing file"),
    ('state = "filled"', 'state = "full"', "state", "filled"),
    ('state = "filled"\n', "", "states.filled.state", "empty, filled"),
    ('drive = "2 Vpp"', 'drive = "2 m"', "states.disc.drive", "peak-to-peak"),
    ("[known]\n", '[model]\naccuracy = "1 %"\n[known]\n', "model.accuracy", "renamed to 'inhomogeneity'"),
    ('drive = "2 Vpp"', 'voltage = "2 Vpp"', "states.disc.voltage", "drive"),
    ('noise = "0.5 %"', 'noise = "-1 %"', "states.filled.noise", "above zero"),
    ('noise = "0.5 %"', 'noise = "0.5"', "states.filled.noise", 'such as "0.2 %": "0.5 %" or "50 %"?'),
    ('noise = "0.5 %"', 'noise = 0.005', "states.filled.noise", '"0.005 %" or "0.5 %"?'),
    ('noise = "0.5 %"', 'noise = 5', "states.filled.noise", '"5 %"?'),
    ('noise = "0.5 %"', 'noise = true', "states.filled.noise", "a share with its unit"),
    ('noise = "0.5 %"', 'noise = "50 %"', "states.filled.noise", 'of 20 % at most: one that is larger explains any'),
    ('noise = "0.5 %"', 'band = ["1 MHz", "0.9 MHz"]', "states.filled.band", "lower"),
    ('noise = "0.5 %"', 'band = "1 MHz"', "states.filled.band", "two frequencies"),
    ('noise = "0.5 %"', 'band = ["1 mm", "2 mm"]', "states.filled.band", "frequency"),
    ("held_out = true", 'held_out = "yes"', "states.empty.held_out", "true or false"),
    ('"pic255.c33" = "2 %"', '"pic255.c34" = "2 %"', "known.pic255.c34", "c33"),
    ('"pic255.c33" = "2 %"', '"pic255.c33" = "0 %"', "known.pic255.c33", "above zero"),
    ('"pic255.c33" = "2 %"', '"pic255.c33.loss" = "20 %"', "known.pic255.c33.loss", "percentage"),
    ('"pic255.c33" = "2 %"', '"pic255.c33" = "2 mm"', "known.pic255.c33", "pressure"),
    ('"couplant.thickness" = "3 um"', '"gel.thickness" = "3 um"', "known.gel.thickness", "dimension"),
    ('"pic255.c33" = "2 %"', '"pic255.c33" = "2 %"\n"pic255/plutho.c33" = "3 %"', "known.pic255/plutho.c33", "once"),
    ('names = ["transducer.density"]', 'names = ["pic255.c33"]', "fixed.names", "may move or may not"),
    ('names = ["transducer.density"]', 'names = "all"', "fixed.names", "a list"),
    ("[fixed]", "[fixes]", "fixes", "fixed"),
])
def test_a_mistake_is_named(folder: Path, old: str, new: str, field: str, said: str) -> None:
    text = CAMPAIGN.replace(old, new, 1)
    assert text != CAMPAIGN
    (folder / "campaign.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_campaign(folder / "campaign.toml")
    assert field in caught.value.field
    assert said in str(caught.value)


def test_all_states_held_out_leave_nothing_to_diagnose(folder: Path) -> None:
    text = CAMPAIGN.replace('drive = "2 Vpp"', 'drive = "2 Vpp"\nheld_out = true')
    (folder / "campaign.toml").write_text(text)
    with pytest.raises(InputError, match="not held out"):
        read_campaign(folder / "campaign.toml")


def test_states_of_two_devices_are_told_apart(folder: Path) -> None:
    (folder / "disc.toml").write_text(DISC.replace("2 mm", "2.1 mm"))
    with pytest.raises(InputError, match="one device"):
        read_campaign(folder / "campaign.toml")


def test_a_recording_of_another_disc_is_refused(folder: Path) -> None:
    write_spectrum(circuit(0.99e6, capacitance=5e-9), folder / "disc.csv")
    with pytest.raises(InputError, match="not of this device"):
        read_campaign(folder / "campaign.toml")


def test_a_tolerance_of_zero_contradicts_an_uncertainty(folder: Path) -> None:
    (folder / "chip.toml").write_text(STACK.replace('thickness = "20 um"', 'thickness = { value = "20 um", tolerance '
                                                    '= "0 um" }'))
    with pytest.raises(InputError, match="exact"):
        read_campaign(folder / "campaign.toml")


def test_two_temperatures_for_one_state_contradict(folder: Path) -> None:
    text = CAMPAIGN.replace('noise = "0.5 %"', 'noise = "0.5 %"\ntemperature = "40 degC"')
    (folder / "campaign.toml").write_text(text)
    with pytest.raises(InputError, match="25"):
        read_campaign(folder / "campaign.toml")


def test_scatter_is_the_noise_of_a_smooth_spectrum() -> None:
    spectrum, random = circuit(0.99e6), np.random.default_rng(3)
    noise = 0.01 * (random.standard_normal(81) + 1j * random.standard_normal(81))
    # 156 third differences, correlated over four: the median of their size is known to some 10 %.
    assert scatter(Spectrum(spectrum.frequency, spectrum.impedance * np.exp(noise))) == pytest.approx(0.01, rel=0.3)


def test_a_recording_is_read_by_its_headings_or_by_the_map_that_is_named(folder: Path) -> None:
    spectrum = circuit(0.99e6)
    rows = "\n".join(f"{f!r},{abs(z)!r},{cmath.phase(z)!r}" for f, z in zip(
        spectrum.frequency.tolist(), spectrum.impedance.tolist(), strict=True))
    for headings, clear in (("f (Hz),|Z| (Ohm),theta (rad)", True), ("f (Hz),|Z| (Ohm),theta", False)):
        (folder / "filled.csv").write_text(f"{headings}\n{rows}\n")
        if not clear:
            with pytest.raises(InputError, match="in degrees or in radians") as caught:
                read_campaign(folder / "campaign.toml")
            (folder / "map.toml").write_text(str(caught.value).split("\n\n")[1].replace('"deg"', '"rad"'))
            (folder / "campaign.toml").write_text(CAMPAIGN.replace(
                'recording = "filled.csv"', 'recording = "filled.csv"\ncolumns = "map.toml"'))
        measured = read_campaign(folder / "campaign.toml").states[1].measured
        np.testing.assert_allclose(measured.impedance, spectrum.impedance, rtol=1e-12)
        assert "is the phase of Z in rad" in measured.origin.settings["read as"]


#: The radii of the layers of the stack that are as long as one another, all of the transducer's.
RADII = ("transducer.radius", "couplant.radius", "substrate.radius", "sidewall.radius", "superstrate.radius")


@pytest.mark.parametrize("named", [RADII, RADII[2:3], RADII[::-2]])
def test_radii_that_coincide_are_one_parameter_however_they_are_named(folder: Path, named: tuple[str, ...]) -> None:
    lines = "".join(f'"{name}" = "20 um"\n' for name in named)
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN.replace("[known]\n", f"[known]\n{lines}"))
    campaign = read_campaign(path)
    # One name and one uncertainty: what follows from the campaign cannot tell how many of them were written.
    assert {name: value for name, value in campaign.known.items() if name.endswith("radius")} == {
        RADII[0]: pytest.approx(2e-5)}
    assert campaign.tied[RADII[0]] == RADII[1:]
    free = device_model(campaign, accuracy=2e-2).parameters
    assert [parameter.name for parameter in free if parameter.name.endswith("radius")].count(RADII[0]) == 1
    path.write_text(CAMPAIGN.replace("[known]\n", f'[known]\n"{RADII[1]}" = "10 um"\n"{RADII[2]}" = "20 um"\n'))
    with pytest.raises(InputError, match="radi"):
        read_campaign(path)
