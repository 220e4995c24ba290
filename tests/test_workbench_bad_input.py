"""What people get wrong, each through the command line: status 2; the message names file, field, value and remedy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support import CAVITY_LAYERS

from workbench.cli import main
from workbench.model.discretisation import ROWS
from workbench.results.spectrum import Spectrum, write_spectrum

CHIP = """
[chip]
name = "cell"
band = ["300 kHz", "450 kHz"]

[[layers]]
role = "transducer"
material = "pzt4/acevedo_2026_initial"
density = "7500 kg/m^3"
thickness = "2 mm"
radius = "3 mm"
electrodes = { live = "top" }
""" + CAVITY_LAYERS + """
[states.filled]
cavity = "water"
temperature = "20 degC"
particle = "polystyrene"
particle_radius = "5 um"
"""
CERAMIC = """
kind = "piezoelectric"
title = "a ceramic of one's own"
source = "measured"
conditions = "room temperature"
density = { value = 7500, unit = "kg/m^3" }
c11 = { value = 139.0, loss = -0.14, unit = "GPa" }
c12 = { value = 77.8, unit = "GPa" }
c13 = { value = 74.3, unit = "GPa" }
c33 = { value = 115.4, loss = -0.12, unit = "GPa" }
c44 = { value = 25.6, loss = -0.02, unit = "GPa" }
e31 = { value = -5.2, unit = "C/m^2" }
e33 = { value = 15.1, unit = "C/m^2" }
e15 = { value = 12.7, unit = "C/m^2" }
eps11 = { value = 762.5, unit = "1" }
eps33 = { value = 663.2, unit = "1" }
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a good chip file and a good recording in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    (tmp_path / "chip.toml").write_text(CHIP)
    frequency = np.linspace(300e3, 450e3, 31)
    recorded = Spectrum(frequency, 5.0 - 1j / (2 * np.pi * frequency * 1e-9))
    write_spectrum(recorded, tmp_path / "disc.csv")
    write_spectrum(Spectrum(frequency, recorded.impedance, 0.01 * recorded.magnitude), tmp_path / "sure.csv")
    (tmp_path / "campaign.toml").write_text('[states.filled]\nchip = "chip.toml"\nrecording = "disc.csv"\n')
    (tmp_path / "spoilt.toml").write_text("[states.filled\n")
    return tmp_path


def said(command: list[str], capsys: pytest.CaptureFixture[str], *, status: int = 2) -> str:
    """The one line of the complaint."""
    assert main(command) == status
    found = " ".join(capsys.readouterr().err.split())
    assert "Traceback" not in found
    return found


def expect(message: str, *parts: str) -> None:
    assert message.startswith("error: ")
    for part in parts:
        assert part in message, (part, message)


def test_the_good_files_are_good(folder: Path) -> None:
    assert main(["mesh", "chip.toml", "--accuracy", "0.5 %"]) == 0


SECOND = '\n[[layers]]\nrole = "transducer"\nmaterial = "pzt5h"\nthickness = "1 mm"\nradius = "3 mm"\n'

#: What is replaced in the good file, by what, and what the answer must name.
CHIP_MISTAKES = {
    "overlapping layers": (
        'role = "substrate"', 'role = "substrate"\nbottom = "1.9 mm"',
        ["layers[1].bottom", "'1.9 mm'", "2 mm, the top of 'transducer'", "overlaps by 0.1 mm", "leave 'bottom' out"]),
    "gap between layers": (
        'role = "substrate"', 'role = "substrate"\nbottom = "2.1 mm"', ["layers[1].bottom", "leaves a gap", "0.1 mm"]),
    "role of the layer": ('"0.85 mm"', '"0 mm"', ["chip.toml: substrate, layers[1].thickness: received"]),
    "degrees Celsius": ('"20 degC"', '"20 C"', ["'20 C'", "did you mean '20 degC'"]),
    "degree sign": ('"20 degC"', '"20 °C"', ["did you mean '20 degC'"]),
    "fluid mistyped": ('cavity = "water"', 'cavity = "watr"', ["did you mean 'water' or 'air'?"]),
    "zero thickness": ('"0.85 mm"', '"0 mm"', ["layers[1].thickness", "'0 mm'", "a length above zero"]),
    "negative thickness": ('"0.85 mm"', '"-0.85 mm"', ["layers[1].thickness", "'-0.85 mm'", "a length above zero"]),
    "infinite thickness": ('"0.85 mm"', '"1e999 mm"', ["layers[1].thickness", "'1e999 mm'", "a finite number"]),
    "number without unit": ('"0.85 mm"', "0.85", ["layers[1].thickness", "0.85", "with its unit"]),
    "text without unit": ('"0.85 mm"', '"0.85"', ["layers[1].thickness", "'0.85'", "mm"]),
    "unknown unit": ('"0.85 mm"', '"0.85 mn"', ["layers[1].thickness", "'0.85 mn'", "mm", "did you mean"]),
    "unit of something else": ('"0.85 mm"', '"0.85 MHz"', ["layers[1].thickness", "a length in one of m, cm, mm"]),
    "decimal comma": ('"0.85 mm"', '"0,85 mm"', ["layers[1].thickness", "'0,85 mm'"]),
    "unknown key": ('thickness = "0.85 mm"', 'thicknes = "0.85 mm"',
                    ["layers[1].thicknes", "did you mean 'thickness'"]),
    "missing key": ('thickness = "0.85 mm"\n', "", ["layers[1].thickness", "missing; expected a length with its unit"]),
    "unknown role": ('"substrate"', '"substrat"', ["layers[1].role", "'substrat'", "did you mean 'substrate'"]),
    "unknown section": ("[states.filled]", "[state.filled]", ["state", "did you mean 'states'"]),
    "unknown material": ('material = "pmma"', 'material = "pmna"', ["'pmna'", "did you mean 'pmma'"]),
    "unknown source of a material": ('"pzt4/acevedo_2026_initial"', '"pzt4/acevedo"',
                                     ["'pzt4/acevedo'", "'pzt4/acevedo_2026_initial'"]),
    "no transducer": ('role = "transducer"', 'role = "backing"', ["layers[0].electrodes", "received 'electrodes'"]),
    "no transducer at all": ('role = "transducer"\nmaterial = "pzt4/acevedo_2026_initial"\ndensity = "7500 kg/m^3"\n'
                             'thickness = "2 mm"\nradius = "3 mm"\nelectrodes = { live = "top" }',
                             'role = "backing"\nmaterial = "pla"\nthickness = "2 mm"\nradius = "3 mm"',
                             ["layers", "no layer with role 'transducer'", "expected one or more"]),
    "two transducers": ("\n[states.filled]", SECOND + "\n[states.filled]",
                        ["layers[4].electrodes", 'electrodes = { live = "top" }', "wired in parallel"]),
    "transducer of a plastic": ('"pzt4/acevedo_2026_initial"', '"pla"',
                                ["material of transducer", "'pla'", "a piezoelectric material"]),
    "ceramic as a substrate": ('role = "substrate"\nmaterial = "pla"', 'role = "substrate"\nmaterial = "pzt5h"',
                               ["material of substrate", "'pzt5h", "not on the live electrode", "electrodes.live"]),
    "cavity wider than its layer": ('"1.5 mm"', '"3.5 mm"', ["layers[2].cavity_radius", "'3.5 mm'", "below 3 mm"]),
    "cavity wider than the substrate": (
        'thickness = "0.85 mm"\nradius = "3 mm"', 'thickness = "0.85 mm"\nradius = "1.2 mm"',
        ["layers[2].cavity_radius", "'1.5 mm'", "'substrate' below reaches only 1.2 mm"]),
    "open cavity": ('role = "superstrate"\nmaterial = "pmma"\nthickness = "1 mm"\nradius = "3 mm"',
                    'role = "superstrate"\nmaterial = "pmma"\nthickness = "1 mm"\nradius = "3 mm"\n'
                    'cavity_radius = "1 mm"',
                    ["layers[3].cavity_radius", "a closed cavity: a layer above 'superstrate'"]),
    "electrode wider than the disc": ('live = "top"', 'live = "top", live_radius = "4 mm"',
                                      ["electrodes.live_radius", "'4 mm'", "at most the transducer's radius, 3 mm"]),
    "electrode on the side": ('live = "top"', 'live = "side"', ["electrodes.live", "'side'", "bottom, top"]),
    "band reversed": ('["300 kHz", "450 kHz"]', '["450 kHz", "300 kHz"]', ["chip.band", "the lower one first"]),
    "band of one": ('["300 kHz", "450 kHz"]', '"450 kHz"', ["chip.band", "'450 kHz'", "two frequencies"]),
    "temperature outside the laws": ('"20 degC"', '"120 degC"', ["temperature", "393.15 K", "extrapolated"]),
    "temperature of a fluid without laws": ('cavity = "water"', 'cavity = "coupling_gel"',
                                            ["293.15 K", "no laws for it"]),
    "cavity without filling": ('cavity = "water"\n', "", ["states.filled.cavity", 'a material or "vacuum"']),
    "particle larger than the cavity": ('"5 um"', '"0.5 mm"', ["states.filled.particle_radius", "'0.5 mm'", "0.36 mm"]),
    "particle without a size": ('particle_radius = "5 um"\n', "", ["states.filled.particle_radius", "both"]),
    "particle in a vacuum": ('cavity = "water"\ntemperature = "20 degC"', 'cavity = "vacuum"',
                             ["states.filled.particle", "'polystyrene'", "no particle without a fluid"]),
    "one material of two densities": ('thickness = "0.72 mm"', 'thickness = "0.72 mm"\ndensity = "1000 kg/m^3"',
                                      ["density of sidewall", "1000.0", "of the same material"]),
    "syntax": ('thickness = "0.85 mm"', "thickness = 0.85 mm", [
        "TOML syntax", "line " + str(1 + CHIP.partition('"0.85 mm"')[0].count("\n"))]),
}

#: Answered by the registry or the material's own file; the rest name the chip file.
@pytest.mark.parametrize("mistake", CHIP_MISTAKES)
def test_a_mistake_in_a_chip_file(mistake: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, parts = CHIP_MISTAKES[mistake]
    assert CHIP.count(old) >= 1
    (folder / "chip.toml").write_text(CHIP.replace(old, new, 1))
    message = said(["simulate", "chip.toml", "-o", "out", "--no-cad"], capsys)
    expect(message, "chip.toml", *parts)
    assert not (folder / "out" / "merit.json").exists()


#: What is replaced in the good material, by what, and what the answer must name.
MATERIAL_MISTAKES = {
    "loss of the wrong sign": ("loss = -0.12", "loss = 0.12", ["c33", "an imaginary part <= 0", "e^{-i w t}"]),
    "not passive": ('c12 = { value = 77.8,', 'c12 = { value = 77.8, loss = -0.5,',
                    ["dissipation matrix", "smallest eigenvalue -0.", "no eigenvalue below"]),
    "not stable": ("value = 77.8", "value = 177.8", ["stiffness matrix", "positive definite"]),
    "unit missing": ('e33 = { value = 15.1, unit = "C/m^2" }', "e33 = { value = 15.1 }", ["e33", "unit"]),
    "unit wrong": ('unit = "C/m^2" }\ne15', 'unit = "GPa" }\ne15', ["e33", "'GPa'", "C/m^2"]),
    "a constant missing": ('e33 = { value = 15.1, unit = "C/m^2" }\n', "", ["e33", "missing"]),
    "a constant mistyped": ("e33 =", "e3 =", ["'e3'", "did you mean"]),
    "kind mistyped": ('"piezoelectric"', '"piezo"', ["kind", "'piezo'", "did you mean 'piezoelectric'"]),
    "negative density": ("value = 7500", "value = -7500", ["density", "-7500", "a positive number"]),
    "no source": ('source = "measured"\n', "", ["source"]),
    "syntax": ("value = 7500", "value = 7,500", ["TOML syntax", "line 6"]),
}


@pytest.mark.parametrize("mistake", MATERIAL_MISTAKES)
def test_a_mistake_in_a_material_file(mistake: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, parts = MATERIAL_MISTAKES[mistake]
    assert CERAMIC.count(old) == 1
    own = folder / "own" / "ceramic"
    own.mkdir(parents=True)
    (own.parent / "references.bib").write_text("@misc{measured,\n title = {in our laboratory}\n}\n")
    (own / "mine.toml").write_text(CERAMIC.replace(old, new))
    (folder / "chip.toml").write_text(CHIP.replace("pzt4/acevedo_2026_initial", "ceramic/mine"))
    message = said(["mesh", "chip.toml", "--materials", "own", "--accuracy", "0.5 %"], capsys)
    expect(message, "mine.toml", *parts)


def test_a_good_material_of_ones_own_is_taken(folder: Path) -> None:
    own = folder / "own" / "ceramic"
    own.mkdir(parents=True)
    (own.parent / "references.bib").write_text("@misc{measured,\n title = {in our laboratory}\n}\n")
    (own / "mine.toml").write_text(CERAMIC)
    (folder / "chip.toml").write_text(CHIP.replace("pzt4/acevedo_2026_initial", "ceramic/mine"))
    assert main(["mesh", "chip.toml", "--materials", "own", "--accuracy", "0.5 %"]) == 0


def rows(*lines: str) -> str:
    return "\n".join(["frequency_hz,z_real_ohm,z_imag_ohm", *lines]) + "\n"


GOOD = ("300000,5,-500", "310000,5,-490", "320000,5,-480")
RECORDING_MISTAKES: dict[str, tuple[str, list[str]]] = {
    "NaN": (rows(GOOD[0], "nan,5,-490", GOOD[2]), ["line 3, column 1", "a finite frequency"]),
    "no values": (rows(GOOD[0], "310000,9.9E37,9.9E37", "320000,OVLD,OVLD"),
                  ["lines 3 to 4: no value", "at least 2 rows with values"]),
    "words": (rows(GOOD[0], "310000,five,-490"), ["line 3, column 2", "'five'", "a number"]),
    "cut short": (rows(*GOOD[:2]) + "320000,5", ["line 4", "'320000,5'", "3 columns; this row has 2"]),
    "only names": (rows(), ["0 rows of numbers", "cut short"]),
    "empty": ("", ["0 bytes", "this file is empty"]),
    "oscilloscope": ('Record Length,2.5e+03,"Points",-0.5,0.1\nSample Interval,1e-6,"s",-0.4,0.2\n',
                     ["format", "oscilloscope waveform"]),
    "binary": ("\x00\x01\x02 not text", ["a text file; this one is binary"]),
    "zero": (rows(GOOD[0], "310000,0,0"), ["line 3", "neither zero nor infinite"]),
    "negative frequency": (rows("-1,5,-500", *GOOD), ["line 2, column 1", "-1.0", "a frequency above zero"]),
    "another table": ("time,level\n1,2\n3,4\n", ["format", "'time,level'", "E4990A", "--columns MAP.toml"]),
    "semicolons": (rows("300000;5,0;-500,0"), ["line 2", "semicolons"]),
}


@pytest.mark.parametrize("mistake", RECORDING_MISTAKES)
def test_a_mistake_in_a_recording(mistake: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, parts = RECORDING_MISTAKES[mistake]
    (folder / "wrong.csv").write_text(content)
    expect(said(["compare", "wrong.csv", "chip.toml", "-o", "out"], capsys), "wrong.csv", *parts)


@pytest.mark.parametrize(("correction", "word"), [("negate", "180 degrees"), ("conjugate", "phase-sign error")])
def test_a_wrong_phase_is_a_finding_and_not_mended_silently(
    correction: str, word: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frequency = np.linspace(300e3, 450e3, 61)
    good = 5.0 - 1j / (2 * np.pi * frequency * 1e-9)
    wrong = -good if correction == "negate" else np.conj(good)
    write_spectrum(Spectrum(frequency, wrong), folder / "wrong.csv")
    command = ["compare", "wrong.csv", "chip.toml", "-o", "out", "--accuracy", "0.5 %"]
    message = said(command, capsys, status=0)
    assert word in message
    assert f"--correction {correction} " in message
    # The capacitor is no recording of this chip, which remains a finding.
    assert "--correction" not in said([*command, "--correction", correction], capsys, status=0)


#: The arguments, and what the answer must name.
COMMAND_MISTAKES: dict[str, tuple[list[str], list[str]]] = {
    "no such chip": (["mesh", "chp.toml"], ["chp.toml", "an existing file", "did you mean 'chip.toml'"]),
    "no such recording": (["compare", "disk.csv", "chip.toml", "-o", "out"], ["disk.csv", "did you mean 'disc.csv'"]),
    "unknown state": (["simulate", "chip.toml", "--state", "filed", "-o", "out"],
                      ["chip.toml", "state", "'filed'", "did you mean 'filled'"]),
    "field frequency outside the mesh's band": (
        ["render", "chip.toml", "--at", "2 MHz", "-o", "out"],
        ["--at", "'2 MHz'", "within the band the mesh is made for, 0.3 to 0.45 MHz", "--from and --to"]),
    "band reversed": (["simulate", "chip.toml", "--from", "450 kHz", "--to", "300 kHz", "-o", "out"],
                      ["--from, --to", "0.45 to 0.3 MHz", "a rising band"]),
    "band without unit": (["mesh", "chip.toml", "--from", "300000"], ["--from", "'300000'", "Hz, kHz, MHz"]),
    "drive without unit": (["simulate", "chip.toml", "--drive", "10", "-o", "out"], ["--drive", "'10'", '"10 Vpp"']),
    "drive of the wrong unit": (["simulate", "chip.toml", "--drive", "10 V", "-o", "out"],
                                ["--drive", "'10 V'", "Vpp"]),
    "too few points along": (["along", "chip.toml", "--points", "1", "-o", "out"],
                             ["command line: --points: received 1; expected at least 5 frequencies"]),
    "too few points": (["simulate", "chip.toml", "--points", "3", "-o", "out", "--no-cad"],
                       ["command line: --points: received 3; expected at least 5 frequencies"]),
    "too accurate": (["mesh", "chip.toml", "--accuracy", "0.001 %"],
                     ["--accuracy", "0.001 %", f"{100 * min(ROWS):g} %), the finest there is"]),
    "accuracy of nothing": (["diagnose", "disc.csv", "--chip", "chip.toml", "--accuracy", "0", "-o", "out"],
                            ["--accuracy", "'0'", "the finest there is"]),
    "accuracy in hertz": (["mesh", "chip.toml", "--accuracy", "5 Hz"], ["--accuracy", "5 Hz", "%, ppm, 1"]),
    "error of nothing": (["simulate", "chip.toml", "--relative-error", "0", "-o", "out", "--no-cad"],
                             ["relative_error", "0.0", "between 0 and 1"]),
    "unknown field": (["render", "chip.toml", "--at", "400 kHz", "--field", "presure", "-o", "out"],
                      ["--field", "'presure'", "did you mean 'pressure'"]),
    "output is a file": (["export", "chip.toml", "-o", "disc.csv"], ["--output", "'disc.csv'", "a file is in the way"]),
    "output below a file": (["export", "chip.toml", "-o", "disc.csv/out"], ["--output", "a file is in the way"]),
    "bands that do not overlap": (
        ["compare", "disc.csv", "chip.toml", "--from", "1 MHz", "--to", "2 MHz", "-o", "out"],
        ["disc.csv", "frequency", "0.3 to 0.45 MHz", "band of chip.toml, 1 to 2 MHz"]),
    "recording and chip swapped": (["compare", "chip.toml", "disc.csv", "-o", "out"],
                                   ["recording", "'chip.toml'", "swapped", "disc.csv is the recording"]),
    "a chip in place of a recording": (["compare", "chip.toml", "chip.toml", "-o", "out"],
                                       ["'chip.toml'", "a TOML file, as chip files are"]),
    "a recording without its chip": (["diagnose", "disc.csv", "-o", "out"],
                                     ["--chip", "disc.csv is a recording of, --chip CHIP.toml", "campaign file"]),
    "a chip in place of a campaign": (["diagnose", "chip.toml", "-o", "out"],
                                      ["recording", "'chip.toml'", "`workbench diagnose RECORDING --chip chip.toml`"]),
    "a chip in place of what is diagnosed": (["diagnose", "chip.toml", "--chip", "chip.toml", "-o", "out"],
                                             ["'chip.toml'", "a TOML file, as chip files are"]),
    "what is diagnosed and chip swapped": (["diagnose", "chip.toml", "--chip", "disc.csv", "-o", "out"],
                                           ["recording", "'chip.toml'", "swapped", "disc.csv is the recording"]),
    "a campaign in place of a chip": (["diagnose", "disc.csv", "--chip", "campaign.toml", "-o", "out"],
                                      ["--chip", "'campaign.toml'", "`workbench diagnose campaign.toml`"]),
    "a campaign with syntax nobody reads": (["diagnose", "spoilt.toml", "-o", "out"], ["spoilt.toml", "valid TOML"]),
    "noise without its sign": (["diagnose", "disc.csv", "--chip", "chip.toml", "--noise", "0.5", "-o", "out"],
                               ["command line: --noise", "'0.5'", '"0.5 %" or "50 %"?']),
    "noise that explains anything": (["diagnose", "disc.csv", "--chip", "chip.toml", "--noise", "30 %", "-o", "out"],
                                     ["command line: --noise", "'30 %'", "20 % at most"]),
    "noise beside an uncertainty": (["diagnose", "sure.csv", "--chip", "chip.toml", "--noise", "1 %", "-o", "out"],
                                    ["command line: --noise", "brings its own uncertainties"]),
    "a recording of no point in the band": (
        ["diagnose", "disc.csv", "--chip", "chip.toml", "--from", "1 MHz", "--to", "2 MHz", "-o", "out"],
        ["disc.csv: frequency", "0.3 to 0.45 MHz", "1 to 2 MHz"]),
    "a state that the recording's chip has not": (
        ["diagnose", "disc.csv", "--chip", "chip.toml", "--state", "filed", "-o", "out"],
        ["chip.toml", "state", "'filed'", "did you mean 'filled'"]),
    **{f"a campaign with {option}": (["diagnose", "campaign.toml", option, value, "-o", "out"],
                                     [f"command line: {option}", f"'{value}'", "the campaign file campaign.toml"])
       for option, value in (("--chip", "chip.toml"), ("--state", "filled"), ("--noise", "1 %"), ("--from", "1 MHz"),
                             ("--to", "1 MHz"), ("--columns", "disc.csv"), ("--format", "lines"),
                             ("--correction", "negate"))},
    "unknown format": (["compare", "disc.csv", "chip.toml", "--format", "e4990", "-o", "out"],
                       ["format", "'e4990'", "did you mean 'e4990a'"]),
    "no folder of materials": (["mesh", "chip.toml", "--materials", "nowhere"], ["'nowhere'", "an existing folder"]),
    "unknown material": (["materials", "show", "watr"], ["'watr'", "did you mean 'water'"]),
    "no material": (["materials", "show"], ["NAME", "workbench materials list"]),
    "difference of two kinds": (["materials", "diff", "pla", "water"],
                                ["IsotropicSolid pla/acevedo_2026, Fluid water/", "two materials of one kind"]),
    "history of no fit": (["materials", "history", "pla/acevedo_2026"], ["'pla/acevedo_2026'", "no versions"]),
    "withdrawal of no fit": (["materials", "withdraw", "water", "--reason", "x"],
                             ["'water'", "a version of a saved fit"]),
    "export of the package's": (["materials", "export", "pla", "-o", "x.json"], ["'pla/acevedo_2026'", "your own"]),
    "export of nothing known": (["materials", "export", "plo/mine", "-o", "x.json"], ["'plo/mine'", "one of"]),
    "import of nothing": (["materials", "import", "x.json"], ["x.json", "an existing file"]),
    "import of something else": (["materials", "import", "disc.csv"], ["disc.csv", "JSON syntax", "line 1 column 1"]),
    "temperature without unit": (["materials", "show", "water", "--temperature", "25"], ["--temperature", "degC"]),
    "chip is a folder": (["mesh", "."], ["received '.'; expected a readable text file; this is a folder",
                                         "did you mean 'chip.toml'"]),
    "recording is a folder": (["compare", ".", "chip.toml", "-o", "out"], ["received '.'; expected a readable file"]),
    "field frequency in the wrong unit": (["render", "chip.toml", "--at", "400 Hz", "-o", "out"],
                                          ["'400 Hz'", "did you mean '0.4 MHz'"]),
    "lower end in the wrong unit": (["mesh", "chip.toml", "--from", "300 MHz"], ["did you mean '0.3 to 0.45 MHz'"]),
}


@pytest.mark.parametrize(("old", "new"), [
    ('"water"', '"petgg"'), ('"pzt4/acevedo_2026_initial"', '"petgg"'), ('"pzt4/acevedo_2026_initial"', '"waterr"')])
def test_materials_of_another_kind_are_not_proposed(
    old: str, new: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "chip.toml").write_text(CHIP.replace(old, new, 1))
    assert "did you mean" not in said(["mesh", "chip.toml"], capsys)


def test_a_recording_in_the_wrong_unit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.csv").write_text("Frequency (kHz),R (ohm),X (ohm)\n" + "\n".join(GOOD) + "\n")
    assert "did you mean '0.3 to 0.32 MHz'" in said(["compare", "wrong.csv", "chip.toml", "-o", "out"], capsys)


@pytest.mark.parametrize(("command", "answer"), [
    (["simulat", "chip.toml"], "invalid choice: 'simulat'.*did you mean 'simulate'"),
    (["chips", "cpy"], "did you mean 'copy'"),
    (["mesh", "chip.toml", "--acuracy", "1 %"], "mesh: error: unrecognized argument: --acuracy; did you mean '--acc"),
    (["--versoin"], "workbench: error: unrecognized argument: --versoin; did you mean '--version'"),
    (["export", "chip.toml", "--ouput=out"], "--ouput=out; did you mean '--output'"),
])
def test_a_mistyped_word_of_the_command_line(
    command: list[str], answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(command)
    assert re.search(answer, capsys.readouterr().err)


@pytest.mark.parametrize("mistake", COMMAND_MISTAKES)
def test_a_mistake_in_the_command(mistake: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command, parts = COMMAND_MISTAKES[mistake]
    expect(said(command, capsys), *parts)


@pytest.mark.parametrize(("command", "part"), [
    (["simulat"], "invalid choice: 'simulat'"), (["simulate", "chip.toml"], "-o/--output"),
    (["simulate", "chip.toml", "-o", "out", "--points", "many"], "invalid int value: 'many'"),
    (["compare", "disc.csv", "chip.toml", "-o", "out", "--correction", "flip"], "'negate', 'conjugate'"),
    ([], "COMMAND"),
    (["materials"], "ACTION"), (["materials", "remove", "pla"], "invalid choice: 'remove'"),
    (["materials", "withdraw", "pzt4/disc_7@1"], "--reason"), (["materials", "export", "-o", "x.json"], "NAME"),
])
def test_what_argparse_refuses(command: list[str], part: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(command)
    assert caught.value.code == 2
    assert part in capsys.readouterr().err
