"""Modes of a chip against the poles of its spectrum; their energies, couplings and pictures; bad input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from PIL import Image, ImageSequence
from support import layer_text

import workbench as wb
from workbench.cli import main
from workbench.fem.energy import by_place
from workbench.fem.modes import ModesNotConverged, ReducedModes, _Projected, eigenmodes
from workbench.fem.operators import assemble
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.model.problem import build, fill
from workbench.physics.term import Integral, Monomial
from workbench.render.mode_above import draw_mode_above, has_view_above
from workbench.render.sections import animate_mode
from workbench.results.circuit import FittedNumber, FittedResonance
from workbench.simulation.matched_modes import matched_modes
from workbench.simulation.peak_modes import mode_of_conductance

DISC = """
[chip]
name = "disc"
band = ["0.95 MHz", "1.08 MHz"]
""" + layer_text("transducer", "pz26/ferroperm", thickness="2 mm", radius="5 mm", electrodes='{ live = "top" }')

@pytest.fixture
def disc(tmp_path: Path) -> wb.Chip:
    (tmp_path / "disc.toml").write_text(DISC, encoding="utf-8")
    return wb.read_chip(tmp_path / "disc.toml")


def test_the_modes_are_the_poles_of_the_spectrum(disc: wb.Chip) -> None:
    """The circuit is fitted to a spectrum that a reduced model gives to 1e-6, and stands for real couplings."""
    found = wb.modes(disc)
    fitted = wb.simulate(disc, points=2001, relative_error=1e-6).resonances
    assert fitted is not None
    assert len(fitted.resonances) >= 2
    for each in fitted.resonances:
        mode = found.near(each.frequency.value)
        assert mode is not None
        assert mode.frequency == pytest.approx(each.frequency.value, rel=2e-5)
        assert mode.q == pytest.approx(each.q.value, rel=1e-2)
        assert mode.capacitance == pytest.approx(each.capacitance.value, rel=2e-2)


def test_the_coupling_of_a_mode_does_not_depend_on_the_band(disc: wb.Chip) -> None:
    whole = max(wb.modes(disc, accuracy=1e-2).modes, key=lambda mode: mode.k_eff)
    near = (whole.frequency - 100.0, whole.frequency + 100.0)
    (alone,) = wb.modes(disc, accuracy=1e-2, band=near).modes
    assert alone.k_eff == pytest.approx(whole.k_eff, rel=1e-5)
    assert alone.is_driven


def test_modes_over_many_octaves_are_found(tmp_path: Path) -> None:
    """Flexure of a thin disc, 3171 Hz and three further ones below 60 kHz by finer meshes; none depends on the band."""
    text = DISC.replace('"0.95 MHz", "1.08 MHz"]', '"2 kHz", "60 kHz"]\nunusual = ["band"]')
    (tmp_path / "thin.toml").write_text(text.replace('"2 mm"', '"0.3 mm"').replace('"5 mm"', '"12.5 mm"'))
    chip = wb.read_chip(tmp_path / "thin.toml")
    counts = [wb.modes(chip, band=band, accuracy=1e-3).modes for band in ((2e3, 60e3), (2.1e3, 60e3), (2e3, 6e3))]
    assert len(counts[0]) == len(counts[1]) == 4
    assert len(counts[2]) == 1


def test_very_high_orders_have_no_modes(disc: wb.Chip) -> None:
    assert not wb.modes(disc, orders=(500,), accuracy=1e-2).modes


def test_a_mode_leaves_no_residual_and_all_are_found(disc: wb.Chip) -> None:
    """The admittance of the full model close to a complex pole is that of its residue; the count does not depend on the
    frequencies of the factorisations."""
    posed = build(fill(disc), accuracy=1e-2)
    system = System(assemble(posed.mesh, posed.terms), posed.values)
    whole = eigenmodes(system, (0.95e6, 1.08e6))
    halves = [eigenmodes(system, band).omega for band in ((0.95e6, 1.0e6), (1.0e6, 1.08e6))]
    assert np.concatenate(halves) == pytest.approx(whole.omega, rel=1e-7)
    assert whole.changes.max() < 1e-6
    # At a real frequency near a mode of high Q, one term of the sum over modes makes the change of the charge.
    driven = wb.modes(disc, accuracy=1e-2)
    best = max(driven.modes, key=lambda mode: mode.k_eff)
    k = int(np.argmin(np.abs(whole.frequency - best.frequency)))
    around = best.frequency + np.array([-2.0, 0.0, 2.0]) * best.frequency / best.q
    charges = system.solutions(around).charge
    electrode = np.zeros((whole.operators.size, 1), dtype=complex)
    electrode[-1] = 1.0
    drive = (whole.operators.coefficients(whole.omega[[k]].real, posed.values)
             * whole.operators.quadratic(electrode, whole.states[:, [k]])).sum()
    poles = drive**2 / (whole.omega[k] ** 2 - (2.0 * np.pi * around) ** 2)
    rest = charges - poles
    # What is left is smooth: its curvature is that of all other modes.
    assert abs(rest[1] - 0.5 * (rest[0] + rest[2])) < 0.02 * abs(poles[1])


def test_shares_add_up_and_higher_orders_are_not_driven(disc: wb.Chip) -> None:
    found = wb.modes(disc, orders=(0, 1, 2), accuracy=1e-2)
    assert {mode.order for mode in found.modes} == {0, 1, 2}
    for mode in found.modes:
        assert sum(mode.energy.values()) == pytest.approx(1.0)
        assert sum(mode.loss.values()) == pytest.approx(1.0)
        assert 0.0 <= mode.k_eff < 1.0
        assert mode.order == 0 or mode.k_eff == 0.0
        assert np.nanmax(np.abs(mode.shape)) == pytest.approx(1.0)
    assert max(mode.k_eff for mode in found.modes) > 0.2
    assert "order 1" in str(next(mode for mode in found.modes if mode.order == 1))
    assert [mode.frequency for mode in found.modes] == sorted(mode.frequency for mode in found.modes)
    assert "MHz" in repr(found)


def test_losses_count_for_the_region_that_a_part_lies_in() -> None:
    places = ("cavity", "cavity@sidewall", "cavity|substrate", "cavity@sidewall#0", "substrate")
    integrals = [Integral(Monomial(1.0, 0), place, ()) for place in places]
    found = by_place(integrals, np.array([[1.0, 2.0, 4.0, 8.0, 0.0], [0.0, 1.0, 0.0, 1.0, 0.0]]))
    assert {place: each.tolist() for place, each in found.items()} == {
        "cavity": [11.0, 2.0], "cavity|substrate": [4.0, 0.0]}


@pytest.mark.usefixtures("disc")
def test_the_command_writes_a_table_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert main(["modes", str(tmp_path / "disc.toml"), "--orders", "0,1", "--accuracy", "1 %", "--draw", "1",
                 "-o", str(folder)]) == 0
    record = json.loads((folder / "modes.json").read_text(encoding="utf-8"))
    assert record["chip"] == "disc"
    assert {mode["order"] for mode in record["modes"]} == {0.0, 1.0}
    (picture,) = folder.glob("mode_*_MHz_order_0.png")
    assert picture.stat().st_size > 10_000
    assert f"{len(record['modes'])} modes" in capsys.readouterr().out
    assert main(["modes", str(tmp_path / "disc.toml"), "--orders", "-1", "-o", str(folder)]) == 2
    assert "whole numbers of waves" in capsys.readouterr().err


@pytest.mark.parametrize(("arguments", "field", "expected"), [
    ({"orders": (1.5,)}, "orders", "whole numbers"), ({"orders": (-1,)}, "orders", "0 or more"),
    ({"wavelengths": (1e-3,)}, "wavelengths", "orders around the axis"),
    ({"least_q": 0.0}, "least_q", "a half or more"), ({"least_q": "20"}, "least_q", "a half or more"),
    ({"orders": 2}, "orders", "a sequence"), ({"orders": ()}, "orders", "an order"),
    ({"band": (math.nan, 1e6)}, "band", "rising")])
def test_bad_input_is_refused(disc: wb.Chip, arguments: dict[str, object], field: str, expected: str) -> None:
    with pytest.raises(InputError, match=f"{field}.*{expected}"):
        wb.modes(disc, **arguments)  # type: ignore[arg-type]


def test_an_error_keeps_the_frequencies() -> None:
    error = ModesNotConverged(np.array([1e6 + 1e3j]), np.array([1e-3]))
    assert "at 1 MHz" in str(error)
    assert math.isclose(error.changes[0], 1e-3)


def test_the_peaks_of_a_spectrum_are_named_by_the_poles_of_the_reduced_model(disc: wb.Chip) -> None:
    """The reduced model, exact to 1e-6 in Z, has the modes of the full one."""
    run = wb.simulate(disc, points=401, relative_error=1e-6, accuracy=1e-2)
    known = wb.modes(disc, accuracy=1e-2)
    assert [peak.quantity for peak in run.peak_modes] == ["conductance"] * 2
    for peak in run.peak_modes:
        mode = known.near(peak.frequency)
        assert mode is not None
        assert peak.mode.frequency == pytest.approx(mode.frequency, rel=1e-6)
        assert peak.mode.q == pytest.approx(mode.q, rel=1e-4)
        assert peak.mode.k_eff == pytest.approx(mode.k_eff, rel=1e-3)
        assert peak.mode.energy == pytest.approx(dict(mode.energy), abs=1e-4)
        assert peak.mode.crossings == mode.crossings
        assert peak.share == pytest.approx(1.0, abs=0.15)
        # The height is that between the samples.
        samples = run.spectrum.interpolant()(peak.frequency * (1.0 + np.array([-1e-4, 0.0, 1e-4])))
        assert np.argmax((1.0 / samples).real) == 1
    assert wb.simulate(disc, points=9, full=True, accuracy=1e-2).peak_modes == ()
    assert wb.simulate(disc, points=9, band=(0.985e6, 0.99e6), accuracy=1e-2).peak_modes == ()


def test_a_peak_of_the_energy_is_that_of_a_mode_with_energy_in_the_liquid() -> None:
    chip = wb.read_chip("geometry/chips/glass_channel.toml")
    run = wb.simulate(chip, accuracy=2e-2, points=241, warm=None)
    peaks = [peak for peak in run.peak_modes if peak.quantity == "energy in the cavity"]
    assert [peak.frequency for peak in peaks] == sorted(peak.frequency for peak in run.operating.peaks)
    highest = next(peak for peak in peaks if peak.frequency == run.operating.peaks[0].frequency)
    assert highest.mode.liquid > 0.3
    assert np.nanmax(np.abs(highest.mode.pressure)) == pytest.approx(1.0)
    assert np.array_equal(np.isnan(highest.mode.pressure), np.isfinite(highest.mode.shape[0]))
    assert abs(highest.mode.frequency / highest.frequency - 1.0) < 1.0 / highest.mode.q


@pytest.mark.usefixtures("disc")
def test_the_report_names_the_mode_of_each_peak(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert main(["simulate", str(tmp_path / "disc.toml"), "--accuracy", "1 %", "--no-pictures", "--no-cad",
                 "-o", str(folder)]) == 0
    (state,) = json.loads((folder / "merit.json").read_text(encoding="utf-8"))["states"].values()
    first, second = state["peak_modes"]
    assert 0.95e6 < first["frequency_hz"] < second["frequency_hz"] < 1.08e6
    assert first["mode"]["k_eff"] > 0.1
    assert sum(first["mode"]["energy"].values()) == pytest.approx(1.0)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "What is each peak?" in page
    assert first["mode"]["words"] in page


@pytest.fixture
def recording(disc: wb.Chip, tmp_path: Path) -> Path:
    """The spectrum of a disc 1 % thinner, with a side peak at its mode of order 1 of highest Q."""
    thinner = DISC.replace('"2 mm"', '"1.98 mm"').replace('"0.95 MHz", "1.08 MHz"', '"0.96 MHz", "1.09 MHz"')
    (tmp_path / "thinner.toml").write_text(thinner, encoding="utf-8")
    spectrum = wb.simulate(wb.read_chip(tmp_path / "thinner.toml"), points=1001, accuracy=1e-2).spectrum
    u = spectrum.frequency / SIDE_PEAK
    side = 2j * np.pi * spectrum.frequency * 0.4e-12 / (1.0 - u**2 + 1j * u / 400.0)
    path = tmp_path / "recording.csv"
    wb.write_spectrum(replace(spectrum, impedance=1.0 / (spectrum.admittance + side)), path)
    return path


#: Frequency (Hz) of a further peak of the recording, without a driven mode.
SIDE_PEAK = 1.0255e6


def test_a_recording_beside_the_modes(
    disc: wb.Chip, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    assert main(["modes", str(tmp_path / "disc.toml"), "--orders", "0,1", "--accuracy", "1 %", "--draw", "0",
                 "--recording", str(recording), "-o", str(folder)]) == 0
    record = json.loads((folder / "modes.json").read_text(encoding="utf-8"))
    assert record["band_hz"] == [0.96e6, 1.08e6]
    rows = record["recording"]["resonances"]
    known = wb.modes(disc, band=(0.96e6, 1.08e6), accuracy=1e-2)
    pairs = [row for row in rows if row["recorded"] and row["mode"]]
    assert [row["mode"]["frequency_hz"] for row in pairs] == pytest.approx(
        [mode.frequency for mode in known.modes if mode.is_driven])
    for row in pairs:
        assert 0.0 < row["relative_difference_of_frequency"] < 0.011
        assert row["recorded"]["frequency_hz"][0] == pytest.approx(
            row["mode"]["frequency_hz"] * (1.0 + row["relative_difference_of_frequency"]))
        assert row["q_ratio"] == pytest.approx(1.0, abs=0.1)
    (alone,) = [row for row in rows if row["mode"] is None]
    assert alone["recorded"]["frequency_hz"][0] == pytest.approx(SIDE_PEAK, rel=1e-4)
    assert alone["nearest"]["order"] == 1
    printed = capsys.readouterr().out
    assert "recording.csv beside them" in printed
    assert "no driven mode matches" in printed


def test_pairs_are_the_nearest_ones_and_a_mode_may_have_no_partner() -> None:
    """Frequencies shifted by 0.8 %, the spacing of two modes: couplings decide."""
    def resonance(frequency: float, k_eff: float) -> FittedResonance:
        frequencies, couplings, one = (FittedNumber(each, 0.0) for each in (frequency, k_eff, 1.0))
        return FittedResonance(frequencies, one, couplings, one, one, one, one)

    def mode(frequency: float, k_eff: float) -> wb.ChipMode:
        return wb.ChipMode(0, math.inf, frequency, 100.0, 0.0, k_eff, {"transducer": 1.0}, {}, 0, False,
                           np.zeros((3, 0)), np.zeros(0))

    strong, weak, far = mode(1.000e6, 0.4), mode(1.008e6, 0.05), mode(1.1e6, 0.2)
    found = matched_modes([resonance(1.016e6, 0.05), resonance(1.008e6, 0.4)], [strong, weak, far, mode(1.016e6, 0.0)])
    assert [each.mode for each in found] == [strong, weak, far]
    assert found[2].recorded is None
    assert found[2].difference is None
    assert found[2].words.startswith("not in the recording")
    (pair,) = (each for each in matched_modes([resonance(1.008e6, 0.4)], [strong, weak]) if each.recorded)
    assert pair.mode is strong
    (alone,) = matched_modes([resonance(1.2e6, math.nan)], [])
    assert alone.mode is None
    assert alone.words == "no driven mode matches"
    assert alone.q_ratio is None
    (unseen,) = matched_modes([], [far, mode(1.0e6, 0.01)])  # the other one is no peak
    assert unseen.mode is far
    (near,) = matched_modes([resonance(1.101e6, math.nan)], [far])
    assert near.mode is far


@pytest.mark.parametrize("symmetry", ["even", "odd"])
def test_a_half_has_the_zeros_of_the_whole_width(tmp_path: Path, symmetry: str) -> None:
    text = DISC.replace("[[layers]]", f'geometry = "straight"\nlength = "10 mm"\nsymmetry = "{symmetry}"\n[[layers]]')
    text = text.replace('radius = "5 mm"', 'width = "7 mm"').replace('live = "top"', LIVE[symmetry])
    found = []
    for name, content in (("half", text), ("whole", text.replace(f'"{symmetry}"', '"none"'))):
        (tmp_path / f"{name}.toml").write_text(content, encoding="utf-8")
        found.append(wb.modes(wb.read_chip(tmp_path / f"{name}.toml"), accuracy=1e-2).modes)
    half, whole = found
    assert len(half) >= 2
    assert len(whole) > len(half)
    for mode in half:
        same = min(whole, key=lambda other: abs(other.frequency - mode.frequency))
        assert same.frequency == pytest.approx(mode.frequency, rel=1e-4)  # the meshes differ
        assert mode.crossings == same.crossings
        assert mode.words.startswith(f"uniform along the channel, {same.crossings} zero")
        assert "along the width of the transducer" in mode.words


#: Electrodes of a straight plate by its symmetry.
LIVE = {"even": 'live = "top"', "odd": 'live = "top", live_inner_half_width = "0.2 mm"'}


def test_pictures_from_above_and_of_a_cycle(tmp_path: Path) -> None:
    """The half of a plate that is drawn is mirrored; a cycle has its largest displacement at the beginning."""
    (tmp_path / "disc.toml").write_text(DISC, encoding="utf-8")
    found = wb.modes(wb.read_chip(tmp_path / "disc.toml"), orders=(1, 2), accuracy=1e-2)
    for order, sign in ((1, -1.0), (2, 1.0)):
        mode = next(each for each in found.modes if each.order == order)
        assert has_view_above(mode)
        picture = draw_mode_above(found.nodes, mode, tmp_path / f"above_{order}.png")
        # Red less blue, within the circle.
        red = _dots(picture)[330:700, 350:740]
        assert np.corrcoef(red.ravel(), (sign * red[:, ::-1]).ravel())[0, 1] > 0.98
    cycle = animate_mode(found.nodes, mode, tmp_path / "cycle.gif")
    with Image.open(cycle) as moving:
        pictures = [np.asarray(frame.convert("RGB"), dtype=float) for frame in ImageSequence.Iterator(moving)]
    frames = [(rgb[..., 0] - rgb[..., 2])[60:200, 80:1000] for rgb in pictures]
    assert len(frames) == 16
    strength = [float(np.abs(frame).sum()) for frame in frames]
    assert strength[4] < 0.05 * strength[0]
    assert np.corrcoef(frames[0].ravel(), -frames[8].ravel())[0, 1] > 0.9


def _dots(picture: Path) -> np.ndarray:
    """Red less blue of a picture."""
    rgb = np.asarray(Image.open(picture).convert("RGB"), dtype=float)
    return rgb[..., 0] - rgb[..., 2]


def test_a_weak_mode_is_behind_its_peak_on_the_flank_of_a_strong_one() -> None:
    omega = 2.0 * np.pi * 1e6 * np.array([1.0 - 0.5j / 40.0, 1.08 - 0.5j / 900.0])
    found = ReducedModes(omega, np.array([1.0, 0.02], dtype=complex), np.zeros((0, 2), dtype=complex))
    at = omega[1].real / (2.0 * np.pi)
    amplitudes = found.drive**2 / (omega**2 - omega[1].real**2)
    parts = (-1j * amplitudes).real
    assert parts[0] > 2.0 * parts[1]
    assert mode_of_conductance(found, at) == 1
    assert mode_of_conductance(found, 1.0e6) == 0


def test_a_start_at_an_exact_eigenfrequency_is_its_mode() -> None:
    """Two springs of masses one: the matrix at w = 1 is singular to the last digit."""
    laws = [Chebyshev([1.0]), Chebyshev([0.5, 0.0, 0.5])]  # 1 and w^2
    model = _Projected(laws, np.array([np.diag([1.0, 4.0]), -np.eye(2)], dtype=complex))
    found = model.mode_near(1.0 + 0.0j, np.array([0.6, 0.8], dtype=complex))
    assert found is not None
    omega, state = found
    assert omega == 1.0
    assert np.abs(state) == pytest.approx([1.0, 0.0], abs=1e-15)  # exact, but for rounding
