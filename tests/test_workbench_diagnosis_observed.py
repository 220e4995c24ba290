"""Observations beside the impedance: values against full solves, derivatives, weights, and what mistakes are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem
from numpy.typing import NDArray
from own_recordings import any_recordings

from geometry.chip_section import region_volumes, volumes
from workbench.acoustics.heat import conducted_heat
from workbench.acoustics.traps import focus_time
from workbench.campaign.campaign import Campaign
from workbench.campaign.observation import Cooling
from workbench.campaign.state import data_rows
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.next_measurement import options
from workbench.diagnosis.observed import NotObservable
from workbench.diagnosis.weighting import Weighting
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.fitting.objective import Objective
from workbench.model.drive import GeneratorDrive
from workbench.results.observed_value import ObservedValue
from workbench.simulation.run import snapshot

Real = NDArray[np.float64]

LAYER = """
[[layers]]
role = "{role}"
material = "{material}"
thickness = "{thickness}"
radius = "3 mm"
{more}
"""
CHIP = ('[chip]\nname = "small"\nband = ["0.95 MHz", "1.08 MHz"]\n'
        + LAYER.format(role="transducer", material="pic255", thickness="2 mm", more="")
        + LAYER.format(role="couplant", material="coupling_gel", thickness="20 um", more="")
        + LAYER.format(role="substrate", material="pla/acevedo_2026", thickness="1 mm", more="")
        + LAYER.format(role="sidewall", material="pla/acevedo_2026", thickness="0.7 mm",
                       more='cavity_radius = "1.6 mm"')
        + LAYER.format(role="superstrate", material="soda_lime_glass", thickness="1 mm", more="")
        + '[states.empty]\ncavity = "vacuum"\n[states.filled]\ncavity = "water"\ntemperature = "25 degC"\n'
          'particle = "polystyrene"\nparticle_radius = "5 um"\n')
FREQUENCY = 1.01e6
FOCUSING = 'focusing_time = { value = "2 s", uncertainty = "10 %", drive = "20 Vpp", frequency = "1.01 MHz" }'
WARMING = ('temperature_rate = { value = "50 mK/s", uncertainty = "20 %", drive = "20 Vpp @ 50 ohm", '
           'frequency = "1.01 MHz" }')
RISING = ('temperature_rise = { value = "4 K", uncertainty = "20 %", drive = "20 Vpp", frequency = "1.01 MHz", '
          'holder = "transducer|outside" }')
RINGS = 'ring_radii = { value = ["0.4 mm"], uncertainty = "3 %", frequency = "1.01 MHz" }'
CAMPAIGN = f"""
[states.filled]
chip = "chip.toml"
state = "filled"
recording = "filled.csv"
[states.filled.known]
"couplant.thickness" = "1 um"
[states.filled.observations]
{FOCUSING}
{WARMING}
{RISING}
{RINGS}
[known]
"couplant.thickness" = "1 um"
"sidewall.thickness" = "20 um"
"cavity.radius" = "20 um"
"substrate.thickness" = "10 um"
"transducer.radius" = "20 um"
"water.sound_speed" = "0.5 %"
"water.density" = "1 %"
"pla/acevedo_2026.shear_modulus" = "3 %"
"pla/acevedo_2026.shear_modulus.loss" = "10 MPa"
"pic255.c33" = "1 %"
"pic255.c33.loss" = "500 MPa"
"bench.gain" = "1 %"
[model]
inhomogeneity = "0"
"""
EMPTY = '''
[states.empty]
chip = "chip.toml"
state = "empty"
recording = "empty.csv"
[states.empty.known]
"couplant.thickness" = "1 um"
'''
OBSERVED = ("focusing time", "temperature rate", "temperature rise", "ring 1")
#: Error of Z that meshes are made for. Times on two of them differ by a few thousandths.
ACCURACY = 2e-3


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Campaign]:
    """The campaign of a text; its recordings are any resonance."""
    def made(text: str) -> Campaign:
        folder: Path = tmp_path_factory.mktemp("observed")
        return any_recordings(folder, {"chip.toml": CHIP, "campaign.toml": text}, np.linspace(0.98e6, 1.04e6, 31))

    return made


@pytest.fixture(scope="module")
def model(read: Callable[[str], Campaign]) -> Model:
    return device_model(read(CAMPAIGN), accuracy=ACCURACY)


@pytest.fixture(scope="module")
def point(model: Model) -> Real:
    """Somewhere beside what is stated (p,): lengths are not those of the mesh, and losses are there."""
    x = model.stated
    for i, p in enumerate(model.parameters[:model.known]):
        x[i] += 0.4 * (p.prior or 0.0) * (1.0 if p.is_dimension or p.name.endswith(".loss") else -1.0)
    return x


@pytest.fixture(scope="module")
def near(model: Model, point: Real) -> Objective:
    known = range(model.known)
    reach = {p.name: 1.0 * (p.prior or 0.0) for p in model.parameters[:model.known]}
    return model.fitted.near(point, reach, 1e-3, only=known, enriches=False)


def observed(objective: Objective, x: Real, index: int) -> float:
    return float(objective.predict(x, index, ())[0][0].real)


# --------------------------------------------------------------------------------------------------------------------
# Values and derivatives


def test_an_observation_is_one_more_recording_of_its_state(model: Model) -> None:
    campaign = model.campaign
    assert [state.name for state in campaign.states] == ["filled"]
    assert [state.name for state in campaign.fitted] == ["filled", *(f"filled, {each}" for each in OBSERVED)]
    time, rate, rise, ring = (each.observation for each in campaign.fitted[1:])
    assert time is not None
    assert rate is not None
    assert rise is not None
    assert ring is not None
    assert (time.value, time.uncertainty, time.frequency, time.unit) == (2.0, 0.1, FREQUENCY, "s")
    assert (rate.value, rate.unit, rate.drive) == (0.05, "K/s", GeneratorDrive(20.0, 50.0))
    assert (rise.value, rise.unit, rise.cooling) == (4.0, "K", Cooling("cavity", 10.0, "transducer|outside"))
    assert (ring.value, ring.unit, ring.number) == (0.4e-3, "m", 1)
    assert [each.name for each in model.whole.recordings] == [each.name for each in campaign.fitted]


def test_values_are_those_of_a_simulation(model: Model) -> None:
    """The time of a particle through the nodal force, by another rule and recovered gradients; the heat by parts."""
    stated, state = model.fitted.near(model.stated, {}, 1e-4, only=(), enriches=False), model.campaign.states[0]
    shot = snapshot(state.chip, "filled", FREQUENCY, drive=GeneratorDrive(20.0, 50.0), accuracy=ACCURACY,
                    assumed_losses=False)
    solution = solve_full(assemble(shot.problem.mesh, shot.problem.terms), np.array([FREQUENCY]), shot.problem.values)
    assert shot.traps is not None
    heat = conducted_heat(shot.problem, solution, shot.traps.excitation.voltage)
    capacity = sum(part.capacity for name, part in heat.parts.items())
    assert observed(stated, model.stated, 2) == pytest.approx(heat.power / capacity, rel=1e-3)
    direct = snapshot(state.chip, "filled", FREQUENCY, drive=state.observed[0].observation.drive,  # type: ignore[union-attr]
                      accuracy=ACCURACY, assumed_losses=False)
    assert direct.traps is not None
    # Gradients recovered on two meshes of this accuracy.
    assert observed(stated, model.stated, 1) == pytest.approx(focus_time(direct.traps), rel=0.01)
    assert observed(stated, model.stated, 4) == pytest.approx(direct.traps.traps[0].radius, rel=2e-3)
    warm = conducted_heat(direct.problem, direct.solution, abs(direct.fields.voltage), holder="transducer|outside")
    # Two meshes of this accuracy.
    assert observed(stated, model.stated, 3) == pytest.approx(warm.parts["cavity"].mean, rel=5e-3)


@pytest.mark.parametrize("index", [1, 2, 3, 4])
def test_derivatives_are_those_of_the_value(model: Model, near: Objective, point: Real, index: int) -> None:
    found = near.predict(point, index, range(model.known))[1][0]
    assert found.dtype == np.complex128
    assert not found.imag.any()
    moved = 0
    for i, p in enumerate(model.parameters[:model.known]):
        step = np.zeros(point.size)
        step[i] = 3e-4 * p.scale
        exact = np.log(observed(near, point + step, index) / observed(near, point - step, index)) / (2.0 * step[i])
        # The square of the step, of a part of an uncertainty that a ring's radius moves by a multiple of itself for.
        assert found[i].real * p.scale == pytest.approx(exact * p.scale, rel=1e-5, abs=1e-8), p.name
        moved += exact != 0.0
        # No bench is between a bead and its chip.
        assert (exact != 0.0) == (not p.is_bench), p.name
    assert moved > 10


@pytest.mark.parametrize("index", [1, 2, 3, 4])
def test_derivatives_are_those_of_full_solves(model: Model, near: Objective, point: Real, index: int) -> None:
    full = near.with_every(point)
    found = near.predict(point, index, range(model.known))
    exact = full.predict(point, index, range(model.known))
    assert found[0] == pytest.approx(exact[0], rel=1e-8)
    scale = np.array([p.scale for p in model.parameters])
    assert found[1][0] * scale == pytest.approx(exact[1][0] * scale, rel=1e-5, abs=1e-8)
    own = model.index("sidewall.thickness")
    step = np.zeros(point.size)
    step[own] = 1e-3 * scale[own]
    by_length = np.log(observed(full, point + step, index) / observed(full, point - step, index)) / (2.0 * step[own])
    assert exact[1][0, own].real == pytest.approx(by_length, rel=1e-5)


def test_what_one_state_adds_to_a_number_acts_in_its_observations(read: Callable[[str], Campaign]) -> None:
    two = device_model(read(CAMPAIGN + EMPTY), accuracy=0.02)
    near = two.fitted.near(two.stated, {p.name: p.prior or 0.0 for p in two.parameters[:two.known]}, 1e-3,
                           only=range(two.known), enriches=False)
    assert [each.name for each in near.recordings] == [
        "filled", "empty", *(f"filled, {each}" for each in OBSERVED)]
    slopes = near.predict(two.stated, 2, range(two.known))[1][0]
    assert slopes[two.index("couplant.thickness[filled]")] == slopes[two.index("couplant.thickness")] != 0.0
    assert slopes[two.index("couplant.thickness[empty]")] == 0.0


def test_a_reduced_model_reaches_as_far_as_parameters_are_expected_to_move(
    model: Model, near: Objective, point: Real
) -> None:
    """All numbers an uncertainty away together: the time is 2.4 times as long, to a tenth of what it is known to."""
    scale = np.array([p.prior or 0.0 if i < model.known else 0.0 for i, p in enumerate(model.parameters)])
    signs = np.random.default_rng(3).choice([-1.0, 1.0], scale.size)
    there = point + scale * signs
    full = near.with_every(there)
    for index in (1, 2, 3, 4):
        assert abs(observed(near, there, index) / observed(near, point, index) - 1.0) > 0.01
        assert observed(near, there, index) == pytest.approx(observed(full, there, index), rel=0.01)


def test_a_row_is_the_logarithm_over_the_stated_uncertainty(model: Model, near: Objective, point: Real) -> None:
    likelihood = Likelihood(model, near)
    found = likelihood.data(Hypothesis(), point)
    rows = data_rows(likelihood.states)[1]
    real, imaginary = found.vector[rows]
    assert real == pytest.approx(np.log(observed(near, point, 1) / 2.0) / 0.1, rel=1e-12)
    assert imaginary == 0.0
    assert not found.jacobian[rows][1].any()


def test_lengths_move_the_heat_capacity(model: Model) -> None:
    chip = model.campaign.states[0].chip
    for each in (chip, chip.with_dimensions({"sidewall.thickness": 0.75e-3, "cavity.radius": 1.5e-3})):
        found, exact = region_volumes(each), volumes(each)
        assert set(found) == set(exact)
        assert [found[name] for name in exact] == pytest.approx(list(exact.values()), rel=1e-9)


# --------------------------------------------------------------------------------------------------------------------
# Next measurements


def test_observations_that_are_not_there_yet_are_offered(read: Callable[[str], Campaign]) -> None:
    """The distance between two explanations is that of the logarithms of their times, over the uncertainty."""
    kept = CAMPAIGN.replace(RISING, "").replace(RINGS, "").replace(WARMING, "")
    without = device_model(read(kept.replace("[states.filled.observations]", "").replace(FOCUSING, "")), accuracy=0.02)
    state = without.campaign.fitted[0]
    lowest = state.measured.frequency[np.argmin(np.abs(state.measured.impedance))]
    at = f'"{lowest / 1e6:.12g} MHz"'
    known = device_model(read(kept.replace('"20 Vpp"', '"100 Vpp"').replace('"1.01 MHz"', at)), accuracy=0.02)
    own, rows = without.index("sidewall.thickness"), 2 * state.noise.size
    places = [without.stated, without.stated]
    places[1] = places[1] + 20e-6 * (np.arange(places[1].size) == own)
    alive = [made_explanation(made_problem(np.zeros(rows), np.zeros((rows, 1)), np.array([1e9])), x, free=(own,))
             for x in places]
    found = {each.name: each for each in options(without, [(each, 0.0) for each in alive], 20.0)}
    offered = found["time how beads focus in filled to 10%"]
    times = [observed(known.fitted.near(x, {}, 1e-3, only=(), enriches=False), x, 1) for x in places]
    distance = (np.log(times[1] / times[0]) / 0.1) ** 2
    assert distance > 0.1
    assert offered.share == pytest.approx((np.log(2.0) - np.log1p(np.exp(-distance / 8.0))) / np.log(2.0), rel=1e-3)
    assert "measure how warm the liquid gets in filled to 20%" in found
    # What is observed is not offered again.
    again = options(known, [(replace(each, local=made_problem(np.zeros(rows + 2), np.zeros((rows + 2, 1)), np.array(
        [1e9]))), 0.0) for each in alive], 20.0)
    assert not [each for each in again if each.name.startswith("time how")]


# --------------------------------------------------------------------------------------------------------------------
# Weights


def test_a_stated_uncertainty_neither_inflates_nor_counts_in_an_inflation(model: Model) -> None:
    """A time that is off by ten of its uncertainties says nothing of the noise of a spectrum, and keeps its own."""
    states = model.campaign.fitted
    noise = np.random.default_rng(0).standard_normal((2, states[0].noise.size))
    spectrum = states[0].noise * 3.0 * (noise[0] + 1j * noise[1])
    alone = Weighting.left(states[:1], [spectrum])
    for off in (0.0, 10.0):
        others = [np.asarray(off * state.noise, dtype=np.complex128) for state in states[1:]]
        found = Weighting.left(states, [spectrum, *others])
        assert [each.scale for each in found.noises] == pytest.approx([alone.noises[0].scale, 1.0, 1.0, 1.0, 1.0])
        assert [each.correlation for each in found.noises] == pytest.approx(
            [alone.noises[0].correlation, 1.0, 1.0, 1.0, 1.0])
    assert alone.noises[0].scale > 2.0


# --------------------------------------------------------------------------------------------------------------------
# Mistakes


@pytest.mark.parametrize(("old", "new", "field", "said"), [
    ("focusing_time =", "focussing_time =", "observations.focussing_time", "did you mean 'focusing_time'"),
    ('uncertainty = "10 %", ', "", "focusing_time.uncertainty", 'such as "10 %"'),
    ('drive = "20 Vpp", ', "", "focusing_time.drive", 'such as "10 Vpp"'),
    (', frequency = "1.01 MHz" }', " }", "focusing_time.frequency", 'such as "1 MHz"'),
    ('value = "2 s"', 'value = "2 um"', "focusing_time.value", "time"),
    ('value = "2 s"', 'value = "0 s"', "focusing_time.value", "above zero"),
    ('uncertainty = "10 %"', 'uncertainty = "80 %"', "focusing_time.uncertainty", "at most 50%"),
    ('drive = "20 Vpp"', 'drive = "20 V"', "focusing_time.drive", "10 Vpp"),
    ('frequency = "1.01 MHz"', 'frequency = "1.2 MHz"', "focusing_time.frequency", 'nearest is "1.04 MHz"'),
    ('value = "2 s"', 'value = "2 s", height = "1 mm"', "focusing_time.height", "unknown"),
    ('value = ["0.4 mm"]', 'value = "0.4 mm"', "ring_radii.value", 'such as ["1.6 mm", "3.1 mm"]'),
    ('value = ["0.4 mm"]', 'value = ["0.4 mm", "0.4 mm"]', "ring_radii.value", "each once"),
    ('value = ["0.4 mm"]', 'value = ["0.4 mm", "2 mm"]', "ring_radii.value", "below that of the cavity, 1.6 mm"),
    ('value = ["0.4 mm"]', 'value = ["0.4"]', "ring_radii.value[0]", "mm"),
    ('holder = "transducer|outside"', 'holder = "transducer|outsid"', "temperature_rise.holder", "transducer|outside"),
    ('holder = "transducer|outside"', 'holder = "electrode_live"', "temperature_rise.holder", "|outside"),
    ('holder = "transducer|outside"', 'part = "bond"', "temperature_rise.part", "substrate"),
    ('holder = "transducer|outside"', 'convection = "0 W/(m^2 K)"', "temperature_rise.convection", "above zero"),
])
def test_a_mistake_is_named(read: Callable[[str], Campaign], old: str, new: str, field: str, said: str) -> None:
    text = CAMPAIGN.replace(old, new, 1)
    assert text != CAMPAIGN
    with pytest.raises(InputError) as caught:
        read(text)
    assert field in caught.value.field
    assert said in str(caught.value) or said == "unknown"


def test_a_time_needs_a_particle(tmp_path: Path) -> None:
    lines = [line for line in CHIP.splitlines() if not line.startswith("particle")]
    with pytest.raises(InputError, match="a state that names its particle"):
        any_recordings(tmp_path, {"chip.toml": "\n".join(lines), "campaign.toml": CAMPAIGN},
                       np.linspace(0.98e6, 1.04e6, 31))


def test_a_field_that_does_not_lead_to_the_trap_is_no_observation(tmp_path: Path) -> None:
    """A droplet of oil, lighter than the water, rises from it in a field of 2 mV."""
    texts = {"chip.toml": CHIP.replace("polystyrene", "olive_oil"),
             "campaign.toml": CAMPAIGN.replace('drive = "20 Vpp", f', 'drive = "2 mVpp", f')}
    weak = device_model(any_recordings(tmp_path, texts, np.linspace(0.98e6, 1.04e6, 31)), accuracy=0.02)
    near = weak.fitted.near(weak.stated, {}, 1e-3, only=(), enriches=False)
    with pytest.raises(NotObservable, match="filled, focusing time: a "):
        near.predict(weak.stated, 1, ())


def test_states_held_out_hold_out_their_observations(read: Callable[[str], Campaign]) -> None:
    campaign = read((CAMPAIGN + EMPTY).replace('recording = "filled.csv"', 'recording = "filled.csv"\nheld_out = true'))
    assert [state.name for state in campaign.fitted] == ["empty"]
    assert [state.name for state in campaign.held_out] == [
        "filled", *(f"filled, {each}" for each in OBSERVED)]


@pytest.mark.parametrize(("frequency", "value"), [(1e6, -1.0), (1e6, 0.0), (np.inf, 1.0), (1e6, 1j), (1e6, [1.0, 2.0])])
def test_an_observed_value_is_positive(frequency: float, value: complex) -> None:
    with pytest.raises(ValueError, match="expected"):
        ObservedValue(np.array([frequency]), np.atleast_1d(value))
    good = ObservedValue(np.array([1e6]), np.array([2.0]))
    assert replace(good, impedance=np.array([3.0])).value == 3.0
