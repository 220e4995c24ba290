"""The main job in Python: reduced against full, resumption, what may be chosen, and what is warned of."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support import quadratic

from geometry.chip import Chip, parse_chip
from workbench.design.model import full_evaluation
from workbench.fem.solve import NotConverged, System
from workbench.files.errors import InputError
from workbench.model.drive import PowerDrive
from workbench.simulation.run import MeshTooCoarse, Simulation, simulate, snapshot
from workbench.simulation.solved_spectrum import frequency_grid

POINTS, ELEMENTS = 41, 3.0
DISC = {"role": "transducer", "material": "pzt4/acevedo_2026_initial", "thickness": "2 mm", "radius": "3 mm"}


def chip_of(*layers: dict[str, str], band: tuple[str, str] = ("300 kHz", "450 kHz"), **content: Any) -> Chip:
    return parse_chip({"chip": {"name": "test", "band": list(band)}, "layers": list(layers), **content}, source="test")


@pytest.fixture(scope="module")
def disc() -> Chip:
    return chip_of(DISC)


@pytest.fixture(scope="module")
def cell() -> Chip:
    pla = {"material": "pla", "radius": "3 mm"}
    return chip_of(
        DISC, {"role": "substrate", "thickness": "0.85 mm", **pla},
        {"role": "sidewall", "thickness": "0.72 mm", "cavity_radius": "1.5 mm", **pla},
        {"role": "superstrate", "thickness": "1 mm", **pla},
        states={"empty": {"cavity": "vacuum"},
                "filled": {"cavity": "water", "particle": "polystyrene", "particle_radius": "5 um"}},
    )


@pytest.fixture(scope="module")
def reduced(cell: Chip) -> Simulation:
    return simulate(cell, points=POINTS, accuracy=quadratic(ELEMENTS))


@pytest.fixture(scope="module")
def full(cell: Chip) -> Simulation:
    return simulate(cell, points=POINTS, accuracy=quadratic(ELEMENTS), full=True)


def test_the_reduced_spectrum_is_the_full_one_within_its_tolerance(reduced: Simulation, full: Simulation) -> None:
    assert full.unknowns == reduced.unknowns
    difference = np.abs(reduced.spectrum.impedance / full.spectrum.impedance - 1.0)
    # The tolerance asked for, by default 1e-5; the estimate may be up to four times larger (see `reduce`).
    assert difference.max() < 1e-5
    assert reduced.error < 4e-5
    assert full.error == 0.0
    assert full.solves == POINTS + 1 > reduced.solves
    assert max(full.residual, reduced.residual) < 1e-10
    assert full.figures is not None
    assert reduced.figures is not None
    assert reduced.figures.f0 == pytest.approx(full.figures.f0, rel=1e-6)


def test_a_spectrum_is_passive_and_says_where_it_is_from(reduced: Simulation, full: Simulation) -> None:
    assert (full.spectrum.impedance.real > 0.0).all()
    # e^{+j w t}: below its resonances the device is a capacitor.
    assert full.spectrum.impedance[0].imag < 0.0
    assert reduced.spectrum.origin.kind == "simulated"
    assert reduced.spectrum.origin.settings["material of cavity"] == "water/iapws_2011"
    assert full.spectrum.origin.settings["method"] == "full solves"


def test_the_fields_are_those_of_the_operating_point_and_the_losses_close(reduced: Simulation) -> None:
    assert reduced.figures is not None
    assert reduced.fields.frequency == reduced.operating.frequency == reduced.operating.peaks[0].frequency
    assert reduced.closure < 1e-9
    assert sum(reduced.losses.values()) == pytest.approx(reduced.fields.power, rel=1e-9)
    assert reduced.traps is not None
    assert reduced.traps.excitation.frequency == reduced.operating.frequency
    assert abs(reduced.fields.voltage) == 5.0
    # The spectrum and the fields, solved apart, are one model: V / I is Z, here taken off the interpolant.
    assert abs(reduced.fields.voltage / reduced.fields.current) == pytest.approx(
        abs(reduced.spectrum.interpolant()(np.array([reduced.operating.frequency]))[0]), rel=1e-3)


def test_the_last_state_is_the_default_and_an_empty_cavity_has_no_traps(cell: Chip, reduced: Simulation) -> None:
    assert reduced.state == "filled" == cell.state(None).name
    empty = snapshot(cell, "empty", 400e3, accuracy=quadratic(ELEMENTS))
    assert empty.traps is None
    assert "cavity" not in empty.problem.materials


def test_a_snapshot_is_the_simulation_at_its_frequency(cell: Chip, reduced: Simulation) -> None:
    shot = snapshot(cell, None, reduced.fields.frequency, accuracy=quadratic(ELEMENTS))
    np.testing.assert_array_equal(shot.fields.displacement, reduced.fields.displacement)
    assert shot.losses == reduced.losses


def test_a_known_point_is_not_solved_again(disc: Chip) -> None:
    points: dict[float, complex] = {}
    whole = simulate(disc, points=13, accuracy=quadratic(ELEMENTS), full=True, on_point=points.__setitem__)
    np.testing.assert_array_equal(list(points), whole.spectrum.frequency)
    np.testing.assert_array_equal(list(points.values()), whole.spectrum.impedance)
    again: dict[float, complex] = {}
    known = dict(list(points.items())[:4])
    continued = simulate(disc, points=13, accuracy=quadratic(ELEMENTS), full=True, known=known,
                         on_point=again.__setitem__)
    assert list(again) == list(points)[4:]
    assert continued.solves == 9 + 1
    np.testing.assert_array_equal(continued.spectrum.impedance, whole.spectrum.impedance)


def test_the_field_frequency_band_and_drive_may_be_chosen(disc: Chip) -> None:
    run = simulate(disc, band=(400e3, 500e3), points=11, at=450e3, accuracy=quadratic(ELEMENTS),
                   drive=PowerDrive(0.2))
    assert (run.spectrum.frequency[0], run.spectrum.frequency[-1]) == (400e3, 500e3)
    assert run.problem.band == (400e3, 500e3)
    assert run.fields.frequency == 450e3
    assert run.fields.power == pytest.approx(0.2, rel=1e-12)


def test_without_a_resonance_the_fields_are_those_of_the_middle(disc: Chip) -> None:
    run = simulate(disc, band=(20e3, 40e3), points=11, accuracy=quadratic(ELEMENTS))
    assert run.figures is None
    assert "edge of the band" in run.no_resonance
    assert run.fields.frequency == 30e3


def test_a_mesh_too_coarse_for_the_frequency_asked_for_is_warned_of_once(disc: Chip) -> None:
    with pytest.warns(MeshTooCoarse) as caught:
        simulate(disc, points=13, at=2.4e6, accuracy=quadratic(ELEMENTS))
    assert len(caught) == 1
    # Rows of whole cells: the count is three or a little more of them at the top of the band, hence fewer at 2.4 MHz.
    assert "2.4 MHz" in str(caught[0].message)
    assert "in transducer; wanted 3" in str(caught[0].message)


def test_progress_goes_on_and_ends(disc: Chip) -> None:
    seen: list[tuple[str, float]] = []
    simulate(disc, points=13, accuracy=quadratic(ELEMENTS), progress=lambda what, part: seen.append((what, part)))
    assert seen[0] == ("mesh", 0.0)
    assert seen[-1] == ("fields", 1.0)
    assert all(0.0 <= part <= 1.0 for _, part in seen)


@pytest.mark.parametrize(("band", "points", "field"), [
    ((4e5, 5e5), 4, "points"), ((5e5, 4e5), 11, "band"), ((0.0, 4e5), 11, "band"), ((4e5, math.inf), 11, "band"),
    ((math.nan, 4e5), 11, "band"),
])
def test_a_grid_of_frequencies_rises_from_above_zero(band: tuple[float, float], points: int, field: str) -> None:
    with pytest.raises(InputError) as caught:
        frequency_grid(band, points, source="simulate")
    assert caught.value.field == field


def test_what_cannot_be_simulated_is_refused(disc: Chip, cell: Chip) -> None:
    with pytest.raises(InputError, match="did you mean 'filled'"):
        simulate(cell, "filed")
    with pytest.raises(InputError, match=r"simulate: relative_error: received 0\.0"):
        simulate(disc, relative_error=0.0)
    given: Any = "5 Vpp"
    with pytest.raises(InputError, match=r"drive: received '5 Vpp'; expected a drive, such as wb\.parse_drive"):
        snapshot(cell, "filled", 400e3, drive=given)
    given = "0.5 %"
    with pytest.raises(InputError, match=r"accuracy: received '0\.5 %'; expected a relative error of Z of 0\.0001"):
        snapshot(cell, "filled", 400e3, accuracy=given)
    for frequency, meant in ((0.4, "400000 Hz"), (-4e5, "400000 Hz"), (4e8, "400000 Hz")):
        with pytest.raises(InputError, match=r"frequency: received .*; expected a frequency in Hz") as caught:
            snapshot(cell, "filled", frequency)
        assert caught.value.nearest == (meant,)
    with pytest.raises(InputError, match=r"simulate: at: received 0\.4"):
        simulate(cell, "filled", at=0.4)
    states = tuple(replace(state, particle="pzt5a") if state.particle else state for state in cell.states)
    with pytest.raises(InputError, match=r"states\.filled\.particle: received 'pzt5a'; expected an isotropic solid"):
        snapshot(replace(cell, states=states), None, 400e3, accuracy=quadratic(ELEMENTS))


def test_a_mesh_that_is_not_as_accurate_as_asked_is_warned_of(disc: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    run = simulate(disc, points=13, accuracy=5e-3)
    assert run.mesh_error is not None
    assert 0.0 < run.mesh_error.rms < 5e-3
    worse = replace(run.mesh_error, log_impedance=run.mesh_error.log_impedance * 6e-3 / run.mesh_error.rms)
    monkeypatch.setattr("workbench.simulation.run.mesh_error", lambda *_arguments: worse)
    with pytest.warns(MeshTooCoarse, match=r"estimated error of 0\.6 % rms in Z, above the 0\.5 % that it was made "
                      r"for; --accuracy \"0\.1 %\" \(in Python accuracy=0\.001\)"):
        simulate(disc, points=13, accuracy=5e-3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for share in (1.0, 1.02):
            other = replace(worse, log_impedance=worse.log_impedance * share)
            monkeypatch.setattr("workbench.simulation.run.mesh_error", lambda *_arguments, other=other: other)
            simulate(disc, points=13 + (share > 1.0), accuracy=5e-3)
    assert len(caught) == 1, "a chip simulated again with nearly the same error"
    monkeypatch.setattr("workbench.simulation.run.mesh_error", lambda *_arguments: worse)
    # Whoever gives a discretisation has asked for no accuracy.
    assert simulate(disc, points=13, accuracy=quadratic(ELEMENTS)).mesh_error is worse
    assert simulate(disc, points=13, accuracy=quadratic(ELEMENTS), full=True).mesh_error is None


# --- ceramics without loss -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lossless() -> Chip:
    return chip_of({**DISC, "material": "pzt5a"})


def test_a_lossless_ceramic_is_simulated_with_the_assumed_loss(lossless: Chip) -> None:
    found = simulate(lossless, points=POINTS, accuracy=quadratic(ELEMENTS))
    (said,) = beside_the_grid(found)
    assert said.startswith("pzt5a/erturk_2011 states no loss; the assumed loss is that of a soft ceramic, Q_m 75")
    assert found.left_out == ()
    assert found.figures is not None
    # The radial mode of a disc: the losses of the dielectric add to the mechanical ones of 1 / 75.
    assert found.figures.q == pytest.approx(75.0, rel=0.15)
    assert found.losses["transducer"] > 0.0
    assert ("finding", said) in found.summary().rows


def test_without_it_the_undamped_resonance_is_stepped_beside(lossless: Chip) -> None:
    found = simulate(lossless, points=POINTS, accuracy=quadratic(ELEMENTS), assumed_losses=False)
    assert found.spectrum.frequency.size == POINTS
    assert not any(number.imag for number in found.problem.values.values())
    # At the pole itself nothing converges: the fields are of 10 ppm beside it, and that is said.
    assert found.figures is not None
    assert found.fields.frequency == pytest.approx(found.figures.f0, rel=1e-4)
    (said,) = beside_the_grid(found)
    assert "did not converge. A resonance without loss has no height: state a loss of pzt5a/erturk_2011" in said
    damped = simulate(lossless, points=POINTS, accuracy=quadratic(ELEMENTS))
    assert damped.figures is not None
    assert found.figures.f0 == pytest.approx(damped.figures.f0, rel=2e-3)


def beside_the_grid(found: Simulation) -> list[str]:
    """The findings of a simulation but for that of a grid that is too coarse for its resonance, as in these tests."""
    return [text for text in found.findings if "lie within the resonance" not in text]


def test_a_resonance_that_few_frequencies_lie_in_is_said(disc: Chip) -> None:
    coarse = simulate(disc, points=5, accuracy=quadratic(ELEMENTS))
    assert coarse.figures is not None
    assert coarse.figures.count_within(coarse.spectrum.frequency) < 2
    (said,) = set(coarse.findings) - set(beside_the_grid(coarse))
    assert "of the 5 frequencies lie within the resonance" in said
    # The advice, taken.
    enough = int(said.split("far off; ")[1].split(" points")[0])
    fine = simulate(disc, points=enough, accuracy=quadratic(ELEMENTS))
    assert fine.figures is not None
    assert fine.figures.count_within(fine.spectrum.frequency) >= 2
    assert list(fine.findings) == beside_the_grid(fine)


def singular_at(monkeypatch: pytest.MonkeyPatch, *frequencies: float) -> None:
    """Let solves at these frequencies (Hz) not converge."""
    real = System.neighbours

    def neighbours(self: System, frequency: float, count: int, **options: Any) -> Any:
        if frequency in frequencies:
            raise NotConverged(frequency, 1e-6, np.zeros(1, dtype=complex))
        return real(self, frequency, count, **options)

    monkeypatch.setattr(System, "neighbours", neighbours)


@pytest.mark.parametrize("full", [False, True])
def test_a_singular_frequency_is_left_out_and_named(disc: Chip, monkeypatch: pytest.MonkeyPatch, full: bool) -> None:
    plain = simulate(disc, points=21, accuracy=quadratic(ELEMENTS), full=full)
    # Every second one is a frequency that a reduced model is solved at or might be.
    singular = [float(f) for f in plain.spectrum.frequency[[0, 10]]]
    singular_at(monkeypatch, *singular)
    found = simulate(disc, points=21, accuracy=quadratic(ELEMENTS), full=full)
    assert found.left_out
    assert set(found.left_out) <= set(singular)
    kept = ~np.isin(plain.spectrum.frequency, found.left_out)
    np.testing.assert_array_equal(found.spectrum.frequency, plain.spectrum.frequency[kept])
    np.testing.assert_allclose(found.spectrum.impedance, plain.spectrum.impedance[kept], rtol=1e-4)
    (said,) = beside_the_grid(found)
    assert f"{len(found.left_out)} of 21 frequencies are left out" in said
    assert f"{found.left_out[0] / 1e6:.6g}" in said


def test_a_model_that_is_singular_everywhere_is_an_error(disc: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.fem.solve.RESIDUAL_LIMIT", 0.0)
    for full in (False, True):
        with pytest.raises(NotConverged):
            simulate(disc, points=21, accuracy=quadratic(ELEMENTS), full=full)


def test_a_chip_whose_full_solve_fails_has_no_figures_and_a_reason(disc: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = full_evaluation(disc, None, {}, figures=("f0", "q"), points=21, accuracy=quadratic(ELEMENTS))
    assert plain.figures["f0"] > 0.0

    def fails(*_: Any, **__: Any) -> Any:
        raise NotConverged(4e5, 1e-6, np.zeros(1, dtype=complex))

    monkeypatch.setattr("workbench.design.model.answer", fails)
    found = full_evaluation(disc, None, {}, figures=("f0", "q"), points=21, accuracy=quadratic(ELEMENTS))
    assert math.isnan(found.figures["f0"])
    assert "the solve at 0.4 MHz has a scaled residual" in found.missing["q"]
