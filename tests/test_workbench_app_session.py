"""The live view without its page: numbers that are moved, what they give, and how long each answer holds."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import live_chip
import numpy as np
import pytest
from live_chip import GEL, PLA

from geometry.chip import read_chip
from geometry.names import CAVITY
from workbench.app.background import Background
from workbench.app.controls import controls
from workbench.app.entry import typed_number, typed_tolerance
from workbench.app.growth import growing_elsewhere
from workbench.app.history import History
from workbench.app.local import along, local_model, local_ranges
from workbench.app.panels import figure_cards, picture
from workbench.app.plot import HEIGHT, LEFT, RIGHT, PlotScale, curves, ticks
from workbench.app.refit import known_to
from workbench.app.session import NotReady, Session
from workbench.app.works import Works
from workbench.campaign.campaign import read_campaign
from workbench.cli import main
from workbench.files.errors import InputError
from workbench.fitting.parameter import dimension_parameter, material_parameter
from workbench.model.problem import build, fill
from workbench.reduced.ranges import OutOfRange, RangeModel, RangeRequest
from workbench.render.live import LivePicture
from workbench.results.spectrum import Spectrum
from workbench.simulation.run import simulate

THICKNESS, RADIUS, MODULUS = "substrate.thickness", f"{CAVITY}.radius", f"{PLA}.shear_modulus"
MOVED = {THICKNESS: 0.791e-3, RADIUS: 1.51e-3, MODULUS: 0.935e9}
#: What the models are made for, times three: they were checked where estimates were largest, not everywhere.
CLOSE = 3e-2


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """One with a model that is within its tolerance; tests put its numbers back."""
    session = live_chip.session(tmp_path_factory.mktemp("grown"))
    assert "model ready" in list(session.grow())[-1]
    return session


@pytest.fixture
def session(grown: Session) -> Iterator[Session]:
    yield grown
    grown.reset()


def test_nothing_is_answered_before_there_is_a_model(tmp_path: Path) -> None:
    with pytest.raises(NotReady):
        live_chip.session(tmp_path).spectrum()


def test_the_first_model_answers_in_the_middle_and_the_last_everywhere(tmp_path: Path, session: Session) -> None:
    early = live_chip.session(tmp_path)
    growing = early.grow()
    assert "first model" in next(growing)
    growing.close()
    assert early.spectrum().error == np.inf
    # Both stand for the same full model there, and were made for a relative error of 1e-2.
    assert np.abs(early.spectrum().response.impedance / session.spectrum().response.impedance - 1.0).max() < CLOSE
    session.put({THICKNESS: 0.8199e-3, RADIUS: 1.4801e-3})
    solved: list[tuple[float, complex]] = []
    session.present().solve(solved.append, np.linspace(*session.band, 7).tolist())
    exact = dict(solved)
    at = session.spectrum().spectrum.interpolant()
    # On a mesh of its own, whose elements are as coarse but elsewhere.
    assert max(abs(at(f) / z - 1.0) for f, z in exact.items()) < 2.0 * CLOSE


def test_figures_are_those_of_a_simulation_of_the_saved_chip(tmp_path: Path, session: Session) -> None:
    session.put({THICKNESS: MOVED[THICKNESS], RADIUS: MOVED[RADIUS]})
    session.save(tmp_path / "saved.toml")
    run = simulate(read_chip(tmp_path / "saved.toml"), accuracy=live_chip.COARSE, points=241)
    assert run.figures is not None
    found = session.spectrum().figures
    # One per cent of the impedance is some 1e-4 of the resonance's frequency at a quality factor of 250.
    assert found["f0"] == pytest.approx(run.figures.f0, rel=3e-4)
    assert found["z_min"] == pytest.approx(run.figures.z_min, rel=CLOSE)
    assert found["q"] == pytest.approx(run.figures.q, rel=CLOSE)
    peak, expected = session.spectrum().peak, run.operating.peaks[0]
    assert peak is not None
    assert peak.frequency == pytest.approx(expected.frequency, rel=3e-4)
    # The pressure is of first order in the error of the impedance.
    assert peak.per_square_volt == pytest.approx(expected.per_square_volt, rel=10.0 * CLOSE)


def test_a_moved_length_keeps_its_tolerance_in_the_saved_file(tmp_path: Path, session: Session) -> None:
    before = session.control(THICKNESS).tolerance
    session.tolerate(THICKNESS, 1.2e-5)
    session.put({THICKNESS: MOVED[THICKNESS]})
    session.save(tmp_path / "saved.toml")
    saved = read_chip(tmp_path / "saved.toml").dimensions()[THICKNESS]
    assert (saved.value, saved.tolerance) == (pytest.approx(MOVED[THICKNESS], rel=1e-5), pytest.approx(1.2e-5))
    session.tolerate(THICKNESS, before)


def test_fields_are_those_of_a_full_solve_of_the_moved_chip(tmp_path: Path, session: Session) -> None:
    session.put({THICKNESS: MOVED[THICKNESS], RADIUS: MOVED[RADIUS]})
    frequency = 0.97e6
    found = session.section(frequency)
    run = simulate(session.present_chip(), accuracy=live_chip.COARSE, at=frequency)
    for name in ("displacement", "pressure"):
        one, other = (np.nanmax(np.abs(getattr(each, name))) for each in (found.fields, run.fields))
        assert one == pytest.approx(other, rel=CLOSE)
    assert found.fields.mesh.points[:, 1].max() == pytest.approx(run.fields.mesh.points[:, 1].max(), rel=1e-12)
    # The chip names no particle, so that the live view takes one of its own, and says so.
    assert found.traps is not None
    assert not session.particle_stated
    assert found.traps.excitation.pressure_amplitude == pytest.approx(
        float(np.nanmax(np.abs(run.fields.pressure))), rel=CLOSE)


def test_the_spread_is_that_of_differences(session: Session) -> None:
    # A uniform law of 20 um to either side; the other numbers have none, but for what the materials state.
    for each in session.controls:
        if each.name != THICKNESS:
            session.tolerate(each.name, 0.0)
    view = session.spectrum()
    assert view.spread is not None
    step = 1e-7
    magnitudes, resonances = [], []
    for sign in (1.0, -1.0):
        session.put({THICKNESS: 0.8e-3 + sign * step})
        moved = session.spectrum()
        magnitudes.append(moved.spectrum.magnitude)
        resonances.append(moved.figures["f0"])
    deviation = 20e-6 / np.sqrt(3.0)
    slope = np.log(magnitudes[0] / magnitudes[1]) / (2.0 * step)
    # Central differences of 1e-7 m leave 1e-6 of the slope where that is large.
    assert view.spread == pytest.approx(np.abs(slope) * deviation, rel=1e-3, abs=1e-4 * view.spread.max())
    by_difference = abs(resonances[0] - resonances[1]) / (2.0 * step) * deviation
    assert view.deviations["f0"] == pytest.approx(by_difference, rel=1e-3)


def test_a_hurried_spectrum_is_the_whole_one_without_tolerances(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workbench.app.session.SMALL_RANK", 0)
    session.put({THICKNESS: 0.793e-3, RADIUS: 1.507e-3})
    hurried = session.spectrum(hurried=True)
    whole = session._best(session.values)(session.values)
    # Sums in another order.
    assert hurried.response.impedance == pytest.approx(whole.impedance, rel=1e-9)
    assert (hurried.complete, hurried.spread, hurried.deviations) == (False, None, {})
    completed = session.completed(hurried)
    assert completed.complete
    assert completed.spread is not None
    assert completed.response.gradient() == pytest.approx(whole.gradient(), rel=1e-6, abs=1e-9)
    assert completed.deviations.keys() == completed.figures.keys() == hurried.figures.keys()


def test_local_models_are_the_model_and_hold_for_one_number_at_a_time(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workbench.app.local.SMALL_RANK", 0)
    session.move(THICKNESS, 0.805e-3)
    centre = session.values
    model = session._best(centre)
    line, star = (local_model(model, centre, reach) for reach in (along(model, THICKNESS), local_ranges(model, centre)))
    assert line is not None
    assert star is not None
    far, near, beside = centre | {THICKNESS: 0.783e-3}, centre | {THICKNESS: 0.804e-3}, centre | {RADIUS: 1.502e-3}
    assert [each.holds(model, values) for each in (line, star) for values in (far, near, beside)] == [
        True, True, False, False, True, True]
    assert not star.holds(model, near | {RADIUS: 1.502e-3})
    for local, values in ((line, far), (line, near), (star, near), (star, beside)):
        assert np.abs(local(values).impedance / model(values).impedance - 1.0).max() < model.relative_error
    assert local_model(model, centre, local_ranges(model, centre), lambda: True) is None
    # First near all numbers, then for the one that moves; then nothing is left to do.
    assert [session.prepare() for _ in range(3)] == [True, True, False]
    assert session.spectrum().response.prediction.model is not model.compact


def test_steps_can_be_undone_and_done_again(session: Session) -> None:
    begin = session.values
    session.move(THICKNESS, 0.805e-3)
    session.move(THICKNESS, 0.81e-3)
    session.settle()
    session.put({RADIUS: 1.49e-3})
    session.undo()
    assert session.values == begin | {THICKNESS: 0.81e-3}
    session.undo()
    assert session.values == begin
    session.redo()
    session.redo()
    assert session.values == begin | {THICKNESS: 0.81e-3, RADIUS: 1.49e-3}
    assert not session.can_redo
    # What was moved but does not rest yet is a step of its own.
    session.move(MODULUS, 0.931e9)
    session.undo()
    assert session.values[MODULUS] == begin[MODULUS]
    session.reset(RADIUS)
    assert session.values == begin | {THICKNESS: 0.81e-3}


def test_history_ends_at_both_ends() -> None:
    history = History({"a": 1.0}).then({"a": 2.0})
    assert history.then({"a": 2.0}) is history
    assert history.redone() is history
    assert history.undone().undone() == history.undone()
    assert history.undone().then({"a": 3.0}).redone().present == {"a": 3.0}


def test_outside_the_ranges_a_wider_model_is_made(tmp_path: Path) -> None:
    session = live_chip.session(tmp_path)
    list(session.grow())
    session.move(THICKNESS, 0.83e-3)
    with pytest.raises(OutOfRange, match=THICKNESS):
        session.spectrum()
    assert session.widen() == (THICKNESS,)
    growing = session.grow()
    assert "first model" in next(growing)
    assert session.spectrum().error == np.inf
    session.reset()
    # Where the narrow one was checked, it answers until the wide one is known to be as good.
    assert session.spectrum().error < CLOSE
    assert "model ready" in list(growing)[-1]
    # Both are checked by few full solves: which is better is a matter of digits.
    *narrow, wide = session._models
    assert all(each.error < wide.error <= CLOSE for each in narrow)
    session.move(THICKNESS, 0.83e-3)
    assert session.spectrum().error < np.inf


def test_another_process_makes_the_same_model(tmp_path: Path, session: Session) -> None:
    ranges = {each.name: (each.low, each.high) for each in session.controls}
    wanted = RangeRequest(session.chip, session.state, ranges, session.registry, session.band, live_chip.POINTS, 1e-2,
                          live_chip.COARSE)
    growing = growing_elsewhere(wanted)
    models: list[RangeModel] = list(growing)
    assert models[-1].error <= 1e-2
    here, there = (model(session.values).impedance for model in (session._best(session.values), models[-1]))
    # The same solves and the same arithmetic, but for the order of sums.
    assert there == pytest.approx(here, rel=1e-9)


def test_a_mistake_in_the_other_process_is_told_here(session: Session) -> None:
    wanted = RangeRequest(session.chip, session.state, {"substrate.thicknes": (1e-4, 2e-4)}, session.registry,
                          session.band, live_chip.POINTS, 1e-2, live_chip.COARSE)
    with pytest.raises(InputError, match=r"substrate\.thickness"):
        list(growing_elsewhere(wanted))


@pytest.mark.parametrize(("text", "said"), [
    ("substrate.thicknes", "substrate.thickness"),
    ("substrate.thickness=0.9mm..0.7mm", "a lower number"),
    ("substrate.thickness=0.9mm..1mm", "between"),
    ("substrate.thickness=0.7mm", "two numbers"),
    ("substrate.thickness=0.7..0.9", "a length in one of"),
    (f"{PLA}.shear_modulus=0.9mm..1mm", "GPa"),
    ("cavity.radius=1mm..3.5mm", "cavity.radius"),
])
def test_mistakes_in_what_can_be_moved(tmp_path: Path, text: str, said: str) -> None:
    chip = live_chip.little_chip(tmp_path)
    problem = build(fill(chip), accuracy=live_chip.COARSE)
    with pytest.raises(InputError, match=said):
        controls(chip, problem, [text])


def test_one_number_is_moved_once(tmp_path: Path) -> None:
    chip = live_chip.little_chip(tmp_path)
    problem = build(fill(chip), accuracy=live_chip.COARSE)
    # The three solid discs are equally wide.
    with pytest.raises(InputError, match="once"):
        controls(chip, problem, ["substrate.radius", "superstrate.radius"])
    names = [each.name for each in controls(chip, problem)]
    assert names == ["transducer.thickness", "substrate.thickness", "sidewall.thickness", "superstrate.thickness",
                     "cavity.radius", "water/iapws_2011.sound_speed", f"{PLA}.shear_modulus"]


def test_numbers_that_no_chip_can_have_are_refused(session: Session) -> None:
    before = session.values
    for name, number in ((THICKNESS, -1e-3), (THICKNESS, np.nan), ("thickness", 1e-3), (RADIUS, 4e-3)):
        with pytest.raises(InputError):
            session.move(name, number)
    with pytest.raises(InputError, match="not below zero"):
        session.tolerate(THICKNESS, -1.0)
    assert session.values == before


def test_moved_constants_are_told_in_the_saved_file(tmp_path: Path, session: Session) -> None:
    session.put({MODULUS: 0.935e9})
    session.save(tmp_path / "saved.toml")
    assert f"{MODULUS} = 0.935 GPa" in read_chip(tmp_path / "saved.toml").description


def test_a_fit_of_the_freed_numbers_finds_what_was_recorded(tmp_path: Path) -> None:
    truth = 0.805e-3
    made = live_chip.session(tmp_path)
    chip = made.chip.with_dimensions({THICKNESS: truth})
    recording = simulate(chip, accuracy=live_chip.COARSE, points=101).spectrum
    recording = dataclasses.replace(recording, origin=dataclasses.replace(recording.origin, source="recorded.csv"))
    session = live_chip.session(tmp_path, recording)
    list(session.grow())
    works = Works(session, tmp_path, None, live_chip.diagnosing)
    with pytest.raises(InputError, match="ticked"):
        works.fit(lambda text: None, lambda: False)
    works.free.add(THICKNESS)
    assert works.fit(lambda text: None, lambda: True) == "stopped"
    assert session.values[THICKNESS] == 0.8e-3
    before = session.spectrum().comparison
    assert "now" in works.fit(lambda text: None, lambda: False)
    # Without noise; on one mesh stretched, against one made for the length, both coarse: 1e-4 of it.
    assert session.values[THICKNESS] == pytest.approx(truth, rel=1e-4)
    after = session.spectrum().comparison
    assert before is not None
    assert after is not None
    assert after.mape_percent < 0.2 * before.mape_percent
    session.undo()
    assert session.values[THICKNESS] == 0.8e-3


def test_works_are_done_beside_and_tell_how_they_ended(tmp_path: Path, session: Session) -> None:
    works = Works(session, tmp_path, tmp_path / "good.toml", live_chip.diagnosing)
    assert works.diagnose(lambda text: None, lambda: False) == f"done, see {works.report}"
    works.campaign = tmp_path / "bad.toml"
    assert works.diagnose(lambda text: None, lambda: False) == "failed: error: no state in bad.toml"
    assert works.diagnose(lambda text: None, lambda: True) == "stopped"
    dots: list[float] = []
    said = works.full(lambda text: None, lambda: len(dots) > 2, lambda frequency, _impedance: dots.append(frequency))
    assert said == "stopped after 3 of 41 frequencies"
    assert dots == sorted(dots)
    assert "% there" in works.check(1e6)
    works.close()


def test_a_diagnosis_of_one_recording_is_of_the_present_chip(tmp_path: Path, session: Session) -> None:
    works = Works(session, tmp_path, None, live_chip.diagnosing)
    with pytest.raises(InputError, match="--campaign"):
        works.one_recording(tmp_path)
    session.put({THICKNESS: 0.79e-3})
    recording = simulate(session.present_chip(), accuracy=live_chip.COARSE, points=41).spectrum
    recorded = live_chip.session(tmp_path, recording)
    recorded.put({THICKNESS: 0.79e-3})
    works = Works(recorded, tmp_path, None, live_chip.diagnosing)
    works.free |= {THICKNESS, MODULUS}
    campaign = read_campaign(works.one_recording(tmp_path))
    (state,) = campaign.states
    assert state.chip.dimensions()[THICKNESS].value == 0.79e-3
    assert np.array_equal(state.measured.impedance, recording.impedance)
    # What the file states of the length, as limits of a uniform law.
    assert campaign.known[THICKNESS] == pytest.approx(20e-6 / np.sqrt(3.0), rel=1e-12)
    # No more of the chip than is ticked; of the bench what every bench does.
    assert {name for name in campaign.known if not name.startswith("bench.")} == {THICKNESS, MODULUS}


@pytest.mark.parametrize(("options", "said"), [
    (["--port", "80"], "--port"), (["--campaign", "nowhere.toml"], "--campaign"), (["--vary", "thickness"], "--vary"),
    (["--recording", "nowhere.csv"], "nowhere.csv"), (["--state", "emty"], "filled"), (["--drive", "10"], "--drive"),
])
def test_mistakes_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    live_chip.little_chip(tmp_path)
    assert main(["app", str(tmp_path / "little.toml"), "--no-browser", *options]) == 2
    assert said in capsys.readouterr().err


def test_background_work_says_what_it_does_and_is_one_of_a_kind() -> None:
    heard: list[tuple[str, str, bool]] = []
    background = Background(lambda *said: heard.append(said))

    def work(say: object, stopped: object) -> str:
        say("working")  # type: ignore[operator]
        while not stopped():  # type: ignore[operator]
            pass
        raise InputError("work", "field", 1, "2")

    first = background.start("fit", work)
    assert first is not None
    assert background.start("fit", work) is None
    background.stop("fit")
    first.result(timeout=30)
    assert heard == [("fit", "working", True), ("fit", "InputError: work: field: received 1; expected 2", False)]
    background.close()


def test_lines_of_the_spectrum_are_where_the_scale_says() -> None:
    frequency = np.linspace(1e6, 2e6, 11)
    spectrum = Spectrum(frequency, np.geomspace(1.0, 100.0, 11) * np.exp(-0.5j * np.pi))
    scale = PlotScale.of((1e6, 2e6), [spectrum.magnitude])
    assert scale.frequency_at(LEFT / 920.0) == 1e6
    assert scale.frequency_at(0.0) == 1e6
    assert scale.frequency_at(float(scale.x(1.25e6)) / 920.0) == pytest.approx(1.25e6)
    drawn = curves(scale, spectrum)
    assert drawn["magnitude"].startswith(f"M{LEFT:.1f} ")
    assert drawn["magnitude"].rsplit("L", 1)[-1].startswith(f"{RIGHT:.1f} ")
    marks = ticks(scale)
    assert [each["text"] for each in marks["y"]] == ["1", "2", "5", "10", "20", "50", "100"]
    assert [each["text"] for each in marks["x"]] == ["1.0", "1.2", "1.4", "1.6", "1.8", "2.0"]
    assert all(0.0 <= each["at"] <= HEIGHT for each in [*marks["y"], *marks["phase"]])


def test_a_length_without_a_tolerance_is_known_by_its_role(tmp_path: Path) -> None:
    session = live_chip.film_session(tmp_path, [GEL, "substrate.thickness", "transducer.thickness"])
    gel, printed, turned = session.controls
    # A film to a factor of three, printed layers to 50 um, turned parts to 1 %; the slider reaches as far at least.
    assert (gel.low, gel.high) == pytest.approx((20e-6 / 3.0, 60e-6))
    assert (printed.low, printed.high) == pytest.approx((0.75e-3, 0.85e-3))
    assert (turned.low, turned.high) == pytest.approx((1.9e-3, 2.1e-3))
    assert [each.shown_tolerance for each in session.controls] == ["×3", "0.05", "0.02"]
    assert all(each.assumed for each in session.controls)
    assert gel.deviation == pytest.approx(20e-6 * np.log(3.0) / np.sqrt(3.0))
    assert printed.deviation == pytest.approx(50e-6 / np.sqrt(3.0))
    # What a fit may find can be shown: it searches a film from a tenth to five times its thickness.
    assert gel.farthest == pytest.approx((2e-6, 100e-6))
    session.tolerate(GEL, 15e-6)
    assert session.control(GEL).shown_tolerance == "15"
    assert session.control(GEL).assumed == ""
    assert session.control(GEL).deviation == pytest.approx(15e-6 / np.sqrt(3.0))
    session.tolerate(GEL, None)
    assert session.control(GEL) == gel


def test_a_range_that_cannot_hold_what_is_known_is_told(tmp_path: Path) -> None:
    # A rim 20 um beside another radius, of printed parts that are known to 50 um.
    path = tmp_path / "near.toml"
    path.write_text(live_chip.TEXT.replace('cavity_radius = "1.5 mm"', 'cavity_radius = "2.98 mm"'))
    chip = read_chip(path)
    (found,) = controls(chip, build(fill(chip), accuracy=live_chip.COARSE), ["cavity.radius"])
    assert found.high == pytest.approx(2.998e-3)
    assert "2.93 to 3.03 mm" in found.narrowed


def test_wide_ranges_are_modelled_in_stages(tmp_path: Path) -> None:
    session = live_chip.film_session(tmp_path, [GEL, "transducer.thickness=1.99mm..2.01mm"])
    wanted: list[dict[str, tuple[float, float]]] = []

    def growing(asked: RangeRequest) -> Iterator[RangeModel]:
        wanted.append(dict(asked.ranges))
        yield from ()

    session._growing = growing  # type: ignore[assignment]
    assert list(session.grow()) == []
    near, whole = wanted
    assert near[GEL] == pytest.approx((19e-6, 21e-6))
    assert whole[GEL] == pytest.approx((20e-6 / 3.0, 60e-6))
    assert near["transducer.thickness"] == whole["transducer.thickness"]
    # Elsewhere the first stage would answer nothing.
    session.put({GEL: 35e-6})
    list(session.grow())
    assert wanted[2:] == [whole]


def test_a_typed_tolerance_is_that_of_the_fit_and_of_a_diagnosis(tmp_path: Path) -> None:
    session = live_chip.film_session(tmp_path, [GEL, f"{PLA}.shear_modulus"])
    before = dimension_parameter(session.stated_chip(), GEL)
    assert before.assumed
    session.tolerate(GEL, 15e-6)
    session.tolerate(f"{PLA}.shear_modulus", 0.3e9)
    found = dimension_parameter(session.present({}).chip, GEL)
    assert found.prior == pytest.approx(15e-6 / np.sqrt(3.0))
    # Three tolerances, as far as a mesh can be stretched.
    assert (found.low, found.high) == pytest.approx((2e-6, 65e-6))
    assert found.assumed == ""
    assert session.typed_uncertainties() == {f"{PLA}.shear_modulus": 0.3e9}
    modulus = material_parameter(session.problem, PLA, "shear_modulus")
    typed = known_to(modulus, 0.3e9)
    assert (typed.prior, typed.high) == (0.3e9, pytest.approx(modulus.start + 1.5e9))
    assert 0.0 < typed.low <= modulus.low
    assert known_to(modulus, None) is modulus
    # Radii of one length are known alike.
    radii = live_chip.film_session(tmp_path, ["transducer.radius"])
    radii.tolerate("transducer.radius", 1e-5)
    assert dimension_parameter(radii.stated_chip(), "substrate.radius").prior == pytest.approx(1e-5 / np.sqrt(3.0))


@pytest.mark.slow
def test_the_fit_finds_a_gel_far_from_what_is_stated(tmp_path: Path) -> None:
    truth = 35e-6
    plain = live_chip.film_session(tmp_path)
    recording = simulate(plain.chip.with_dimensions({GEL: truth}), accuracy=live_chip.LOOSE, points=61).spectrum
    session = live_chip.film_session(tmp_path, recording=recording)
    session.tolerate(GEL, 15e-6)
    works = Works(session, tmp_path, None, live_chip.diagnosing)
    works.free.add(GEL)
    said = works.fit(lambda text: None, lambda: False)
    # Meshes of half a per cent of Z, one stretched from 20 um: 1 % of the gel.
    assert session.values[GEL] == pytest.approx(truth, rel=0.02), said
    session.tolerate(GEL, 0.0)
    with pytest.raises(InputError, match="above zero"):
        works.fit(lambda text: None, lambda: False)
    works.close()


@pytest.mark.parametrize(("typed", "metres"), [
    ("20.5", 20.5e-6), ("0.0205 mm", 20.5e-6), (" 21um", 21e-6), (22, 22e-6),
])
def test_numbers_are_typed_in_the_unit_shown_or_their_own(tmp_path: Path, typed: object, metres: float) -> None:
    gel = live_chip.film_session(tmp_path).control(GEL)
    assert typed_number(typed, gel, GEL) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(("typed", "said"), [
    ("20,5", r"'20,5'; expected a decimal point, not a comma: 20\.5\?"), ("20,5 um", r"not a comma: 20\.5 um\?"),
    ("abc", "a number in µm, for example 20"), ("", "a number in µm"), ("nan", "finite"), ("20 mum", "um"),
    ("1e999", "finite"), (None, "a number in µm"), ([1], "a number in µm"),
])
def test_what_is_no_number_is_answered_with_what_is(tmp_path: Path, typed: object, said: str) -> None:
    gel = live_chip.film_session(tmp_path).control(GEL)
    with pytest.raises(InputError, match=said):
        typed_number(typed, gel, GEL)


def test_an_empty_tolerance_is_what_is_stated_or_assumed(tmp_path: Path) -> None:
    gel = live_chip.film_session(tmp_path).control(GEL)
    assert typed_tolerance(" ", gel) is None
    assert typed_tolerance(gel.shown_tolerance, gel) is None
    assert typed_tolerance("7.5", gel) == pytest.approx(7.5e-6)
    with pytest.raises(InputError, match=r"tolerance of couplant\.thickness.*7\.5"):
        typed_tolerance("7,5", gel)


def test_saved_lengths_are_rounded(tmp_path: Path) -> None:
    session = live_chip.film_session(tmp_path, [GEL, "substrate.thickness"])
    session.put({GEL: 20.194697870846237e-6, "substrate.thickness": 0.8123456789e-3})
    session.save(tmp_path / "saved.toml")
    written = (tmp_path / "saved.toml").read_text()
    assert 'thickness = "20.1947 um"' in written
    assert 'thickness = "0.812346 mm"' in written


def test_deviations_have_their_unit(session: Session) -> None:
    cards = {each["id"]: each["note"] for each in figure_cards(session.spectrum())}
    assert re.match(r"± [\d.]+ (m|k|)Hz by the tolerances", cards["f0"])
    assert re.match(r"± [\d.]+ (µ|m|)Ω by the tolerances", cards["z_min"])


@pytest.mark.parametrize("height", [0.2, 2.0, 8.0, 30.0])
@pytest.mark.parametrize("tall", [1.0, 2.0])
def test_letters_at_pictures_keep_their_size(height: float, tall: float) -> None:
    drawn = LivePicture("pressure", "pressure", b"", (-4.0, 4.0, 0.0, height), 0.0, 1.0, "Pa", "", (), (), tall)
    shown = picture(drawn)
    tallest = float(shown["tallest"].removesuffix("px"))
    scale = min(1.0, tallest / (shown["height"] + shown["strip"]))
    assert shown["letters"] * scale == pytest.approx(11.0, rel=0.02)
    places = [each["at"] for each in shown["ticks"]]
    assert all(after - before >= 3.0 * shown["letters"] for before, after in pairwise(places))
