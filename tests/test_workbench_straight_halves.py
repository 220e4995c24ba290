"""Split electrodes of straight chips: signs of their halves, wirings, and the length and symmetry nobody stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import quadratic
from test_geometry_straight import CHIP, OFF, chip
from test_workbench_straight_shapes import COARSE as ROUND
from test_workbench_straight_shapes import ETCHED, WALLS

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from geometry.measure import Parity
from geometry.parts import Electrodes
from geometry.straight import straight_findings
from materials.kinds import Piezoelectric
from workbench.acoustics.nodal import integrate
from workbench.cli import main
from workbench.design.evaluation import Operation
from workbench.design.model import full_evaluation
from workbench.fem.capacitance import clamped_capacitance
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.fitting.prepare import _capacitances
from workbench.model.dimensions import parametrised
from workbench.model.discretisation import Discretisation
from workbench.model.drive import parse_drive
from workbench.model.problem import build, fill
from workbench.simulation.channel import channel_figures
from workbench.simulation.run import Snapshot, energy_spectrum, simulate, snapshot

COARSE = quadratic(3.0)
FREQUENCY = 1.97e6
BEADS = 'cavity = "water"\nparticle = "polystyrene"\nparticle_radius = "2.5 um"'


def split(symmetry: str, halves: str = "", wiring: str = "", text: str = CHIP) -> Chip:
    """A chip with a gap of 0.6 mm in its live electrode; `halves` are two signs."""
    more = f', halves = ["{halves[0]}", "{halves[1]}"]' if halves else ""
    more += f', wiring = "{wiring}"' if wiring else ""
    return chip(text.replace('"even"', f'"{symmetry}"').replace('"bottom"', '"bottom", live_inner_half_width = '
                                                                f'"0.3 mm"{more}').replace('cavity = "water"', BEADS))


def shot_of(found: Chip, drive: str = "10 Vpp", accuracy: Discretisation = COARSE) -> Snapshot:
    return snapshot(found, None, FREQUENCY, drive=parse_drive(drive), accuracy=accuracy)


def energy(shot: Snapshot) -> float:
    """Mean energy density (J/m^3) in the cavity."""
    return channel_figures(shot).energy_density


def impedance(shot: Snapshot) -> complex:
    return complex(shot.fields.voltage / shot.fields.current)


@pytest.fixture(scope="module")
def whole() -> dict[str, Snapshot]:
    return {halves: shot_of(split("none", halves)) for halves in ("+-", "++", "+0")}


def test_a_whole_chip_with_opposite_halves_is_the_odd_half_chip(whole: dict[str, Snapshot]) -> None:
    odd, both = shot_of(split("odd")), whole["+-"]
    assert both.closure < 1e-9
    # Identities of the discrete system on mirrored meshes.
    assert impedance(both) == pytest.approx(impedance(odd), rel=1e-9)
    assert both.losses == pytest.approx(odd.losses, rel=1e-8)
    # Gradients are recovered over both sides of the middle in the whole, and from one side in the half.
    assert energy(both) == pytest.approx(energy(odd), rel=5e-3)
    assert channel_figures(both).focus_time == pytest.approx(channel_figures(odd).focus_time, rel=1e-2)
    assert energy(both) > 20.0 * energy(whole["++"])
    # The left half is at +V, as stated; the odd half chip is the right one.
    for shot, low, high in ((both, -5.0, 5.0), (shot_of(split("odd", "+-")), -5.0, 0.5)):
        potential = shot.fields.potential[shot.fields.mesh.nodes_of(["transducer"])].real
        assert potential.min() == pytest.approx(low, abs=1e-9)
        assert potential.max() == pytest.approx(high, abs=0.5)


def test_one_live_half_is_half_of_the_even_and_half_of_the_odd_drive(whole: dict[str, Snapshot]) -> None:
    one, even, odd = (whole[halves].fields for halves in ("+0", "++", "+-"))
    for name in ("pressure", "potential", "displacement"):
        found, expected = getattr(one, name), 0.5 * (getattr(even, name) + getattr(odd, name))
        there = ~np.isnan(found)
        assert np.abs(found - expected)[there].max() < 1e-10 * np.abs(expected[there]).max()
    # The live half draws half the current of both at equal and half of that at opposite voltages.
    assert one.current == pytest.approx(0.25 * (even.current + odd.current), rel=1e-10)


def test_a_chip_off_its_middle_has_halves_of_its_own(tmp_path: Path) -> None:
    found = split("none", "+-", "transformer", OFF)
    file = write_chip(replace(found, file=str(tmp_path / "chip.toml")), tmp_path / "chip.toml")
    assert read_chip(file).electrodes == found.electrodes == replace(found.electrodes, halves=("+", "-"),
                                                                     wiring="transformer")
    shot = shot_of(found)
    assert shot.closure < 1e-9
    mesh = shot.problem.mesh.mesh
    reversed_part = mesh.p[0, mesh.facets[:, mesh.boundaries["electrode_reversed"]]]
    # The transducer is 5 mm wide about x = -0.3 mm, with a gap of 0.6 mm in its electrode.
    assert (reversed_part.min(), reversed_part.max()) == (pytest.approx(0.0, abs=1e-9), pytest.approx(2.2e-3))


def test_an_etched_chip_has_halves_too() -> None:
    half, both = (shot_of(split(symmetry, "+-", text=CHIP.replace(WALLS, ETCHED)), accuracy=ROUND)
                  for symmetry in ("odd", "none"))
    # gmsh fills the rest around a fillet, which is not the mirror image of itself in the whole.
    assert impedance(both) == pytest.approx(impedance(half), rel=1e-3)


def test_wirings_say_what_a_meter_reads_and_what_a_generator_leaves(whole: dict[str, Snapshot]) -> None:
    z = impedance(whole["+-"])
    bridge = shot_of(split("none", "+-", "between the halves"))
    assert bridge.closure < 1e-9
    assert impedance(bridge) == pytest.approx(4.0 * z, rel=1e-9)
    # The half chip has the same wiring.
    assert impedance(shot_of(split("odd", wiring="between the halves"))) == pytest.approx(4.0 * z, rel=1e-9)
    assert energy(bridge) == pytest.approx(0.25 * energy(whole["+-"]), rel=1e-9)
    reference, drive = energy(whole["+-"]), "10 Vpp @ 50 ohm"
    of_power = reference * 0.1 / whole["+-"].fields.power
    # Voltage of a half against ground over the open-circuit voltage.
    for wiring, share in (("transformer", z / (z + 50.0)), ("two amplifiers", 2.0 * z / (2.0 * z + 50.0)),
                          ("between the halves", 0.5 * 4.0 * z / (4.0 * z + 50.0))):
        driven = split("none", "+-", wiring)
        assert energy(shot_of(driven, drive)) == pytest.approx(reference * abs(share) ** 2, rel=1e-9)
        # A power is that of the device, whatever gives it.
        assert energy(shot_of(driven, "0.1 W")) == pytest.approx(of_power, rel=1e-9)
    assert "each of 2 amplifiers" in shot_of(split("odd", wiring="two amplifiers"), drive).fields.drive


def test_spectra_of_the_energy_and_figures_follow_the_wiring() -> None:
    drive = parse_drive("10 Vpp @ 50 ohm")
    two, one = (split("odd", wiring=wiring) for wiring in ("two amplifiers", "transformer"))
    spectra = [energy_spectrum(found, band=(1.9e6, 2.05e6), points=21, accuracy=COARSE) for found in (two, one)]
    z = spectra[0].impedance
    ratio = np.abs((2.0 * z / (2.0 * z + 50.0)) / (z / (z + 50.0))) ** 2
    np.testing.assert_allclose(spectra[0].under(drive) / spectra[1].under(drive), ratio, rtol=1e-6)
    at = Operation(drive, FREQUENCY)
    found = full_evaluation(two, None, {}, figures=("mean_e_ac",), operation=at, band=(1.9e6, 2.05e6), points=21,
                            accuracy=COARSE)
    assert found.figures["mean_e_ac"] == pytest.approx(energy(shot_of(two, "10 Vpp @ 50 ohm")), rel=2e-2)


def test_half_widths_are_exact_parameters_of_a_chip_with_halves() -> None:
    there = split("none", "+0")
    problem = parametrised(build(fill(there), accuracy=COARSE), there, ["electrode_live.inner_half_width"])
    moved = problem.with_values({"electrode_live.inner_half_width": 0.32e-3})
    stretched, expected = (
        solve_full(assemble(each.mesh, each.terms), np.array([FREQUENCY]), each.values).impedance[0]
        for each in (moved, build(fill(there.with_dimensions({"electrode_live.inner_half_width": 0.32e-3})),
                                  accuracy=COARSE)))
    assert stretched == pytest.approx(expected, rel=1e-3)


def test_products_and_forms_of_a_model_with_halves_are_those_of_its_matrix() -> None:
    problem = build(fill(split("none", "+-", "between the halves")), accuracy=COARSE)
    operators = assemble(problem.mesh, problem.terms)
    g = operators.coefficients(np.array([2.0 * np.pi * FREQUENCY]), problem.values)[0]
    parts = np.random.default_rng(1).normal(size=(2, operators.size))
    x, matrix = parts[0] + 1j * parts[1], operators.matrix(g)
    # The row of the shared voltage is the one that has the shares of the halves.
    image = operators.images(x, g[:, None])[:, 0]
    assert image[-1] == pytest.approx((matrix @ x)[-1], rel=1e-9)
    electrode = np.zeros((operators.size, 1), dtype=complex)
    electrode[-1] = 1.0
    form = operators.quadratic(electrode, electrode) @ g
    assert form[0] == pytest.approx(matrix[[operators.size - 1], [operators.size - 1]][0], rel=1e-9)


def test_the_error_of_a_mesh_with_halves_is_that_of_the_half_chip() -> None:
    # For the band of the file, the mesh of the whole is the half one and its mirror image.
    both, half = (simulate(found, points=21, accuracy=COARSE) for found in (split("none", "+-"), split("odd")))
    assert both.mesh_error is not None
    assert half.mesh_error is not None
    assert both.mesh_error.rms == pytest.approx(half.mesh_error.rms, rel=0.02)
    assert both.capacitance.clamped == pytest.approx(half.capacitance.clamped, rel=1e-9)


@pytest.mark.parametrize(("halves", "wiring"), [("+0", ""), ("+-", ""), ("+-", "between the halves")])
def test_the_capacitance_that_a_recording_is_checked_with_is_that_of_the_halves(halves: str, wiring: str) -> None:
    found = split("none", halves, wiring)
    problem = build(fill(found), accuracy=COARSE)
    ceramic = problem.materials["transducer"]
    assert isinstance(ceramic, Piezoelectric)
    exact = clamped_capacitance(assemble(problem.mesh, problem.terms), problem.values, 1e3)
    # Fringes about electrodes 2 mm wide on a plate 1 mm thick add 26 to 40 %; a wrong sign or share is a factor of 2.
    assert exact / _capacitances(found, ceramic)[0] == pytest.approx(1.33, rel=0.08)


SIGNED = CHIP.replace('"bottom"', '"bottom", live_inner_half_width = "0.3 mm", halves = ["+", "-"]')


@pytest.mark.parametrize(("old", "new", "words"), [
    ("", "", r'electrodes\.halves: .*even symmetry, or symmetry = "odd" or symmetry = "none"'),
    ('["+", "-"]', '["+", "0"]', r'two signs with even symmetry, or symmetry = "none" under \[chip\]'),
    ('["+", "-"]', '["+"]', r'the signs of the left and of the right half, each "\+", "-" or "0"'),
    ('["+", "-"]', '["+", "x"]', r"the signs of the left"),
    ('["+", "-"]', '["0", "0"]', "nothing drives the chip"),
    ('live_inner_half_width = "0.3 mm", ', "", r"live_inner_half_width: .*half of the gap between the two halves"),
    ('halves = ["+", "-"]', 'halves = ["+", "+"], wiring = "transformer"', r"electrodes\.wiring: .*opposite voltages"),
    ('halves = ["+", "-"]', 'wiring = "transformr"', "did you mean 'transformer'"),
])
def test_halves_that_a_chip_cannot_have_are_told(old: str, new: str, words: str) -> None:
    assert old in SIGNED
    with pytest.raises(InputError, match="(?s)" + words):
        chip(SIGNED.replace(old, new))


def test_wirings_off_the_middle_and_halves_of_round_chips_are_told(small_chip: Chip) -> None:
    with pytest.raises(InputError, match=r"'transducer' is off the middle.*different currents"):
        split("none", "+-", "two amplifiers", OFF)
    with pytest.raises(InputError, match="no halves in a round chip"):
        replace(small_chip, electrodes=Electrodes(halves=("+", "-")))


@pytest.mark.parametrize(("symmetry", "halves", "said"), [
    ("odd", "", 0), ("even", "", 1), ("none", "", 1), ("none", "+-", 0), ("none", "+0", 0)])
def test_a_gap_between_halves_of_one_voltage_is_said(symmetry: str, halves: str, said: int) -> None:
    found = split(symmetry, halves)
    assert sum("both halves of the live electrode have the same voltage" in text
               for text in straight_findings(found.measure, found.electrodes)) == said


def test_a_length_and_a_symmetry_that_nobody_stated_are_said_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stated = 'length = "20 mm"\nsymmetry = "even"\n'
    open_chip = chip(CHIP.replace(stated, ""))
    symmetry, length = straight_findings(open_chip.measure, open_chip.electrodes)
    assert "no half-wave modes across the channel" in symmetry
    assert "Z, currents, powers and heat are for 1 m of it" in length
    assert straight_findings(chip().measure, chip().electrodes) == ()
    assert fill(open_chip).findings[:2] == (symmetry, length)
    # A chip of one metre that says so.
    assert len(straight_findings(chip(CHIP.replace("20 mm", "1 m")).measure, Electrodes())) == 0
    # A written file states neither.
    file = write_chip(replace(open_chip, file=str(tmp_path / "chip.toml")), tmp_path / "chip.toml")
    assert "length" not in file.read_text()
    assert "symmetry" not in file.read_text()
    assert read_chip(file).measure.left is Parity.EVEN
    asked = ["simulate", str(file), "--points", "41", "--accuracy", "2 %", "--no-cad", "--no-pictures", "-o",
             str(tmp_path / "out")]
    assert main(asked) == 0
    said = capsys.readouterr().err
    assert said.index("states no symmetry") < said.index("states no length")
    assert said.count("states no symmetry") == 1
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert report.index("states no length") < report.index("Figures of merit")
    assert report.count("states no length") == 1


def test_a_generator_a_power_and_a_recording_ask_for_the_length(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    open_chip = chip(CHIP.replace('length = "20 mm"\n', ""))
    assert shot_of(open_chip).fields.voltage == 5.0
    for drive in ("10 Vpp @ 50 ohm", "0.1 W"):
        with pytest.raises(InputError, match=r"chip\.length: .*the length of the chip along its channel"):
            shot_of(open_chip, drive)
    file = write_chip(replace(open_chip, file=str(tmp_path / "chip.toml")), tmp_path / "chip.toml")
    assert main(["simulate", str(file), "--drive", "0.1 W", "-o", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()
    (tmp_path / "recording.csv").write_text("frequency_hz,re_ohm,im_ohm\n" + "".join(
        f"{1.8e6 + 1e4 * k},5.0,-60.0\n" for k in range(20)))
    assert main(["compare", str(tmp_path / "recording.csv"), str(file), "-o", str(tmp_path / "out")]) == 2
    assert "chip.length" in capsys.readouterr().err


def test_energies_at_a_stated_voltage_do_not_depend_on_the_length() -> None:
    shots = [shot_of(split("odd", text=CHIP.replace("20 mm", length))) for length in ("20 mm", "1 m")]
    assert energy(shots[0]) == pytest.approx(energy(shots[1]), rel=1e-9)
    mesh = shots[0].fields.mesh
    assert integrate(mesh, np.ones(len(mesh.points)), ["cavity"]) == pytest.approx(380e-6 * 160e-6 * 0.02)
