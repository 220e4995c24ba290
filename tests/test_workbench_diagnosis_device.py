"""Lean models of a campaign: those of some hypotheses predict what the one of all hypotheses does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from own_recordings import DISC, DISC_RECORDED, PRINTED, any_recordings
from support import layer_text

from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import KEPT, Model, device_model
from workbench.diagnosis.known_physics import UNNEEDED
from workbench.diagnosis.likelihood import Likelihood

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 41)

CAMPAIGN = DISC_RECORDED + """
[known]
"pzt/trial.c33" = "0.5 %"
"pzt/trial.eps33" = "1 %"
"""

#: Error of Z that meshes are made for: two of them differ by a tenth of it.
ACCURACY = 1e-3

WIDTH = "bare rim.width"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """The model of a disc in which no hypothesis acts."""
    folder = tmp_path_factory.mktemp("disc")
    return device_model(any_recordings(folder, {"disc.toml": DISC, "campaign.toml": CAMPAIGN}, FREQUENCIES),
                        accuracy=ACCURACY)


def impedance(model: Model, x: Real) -> Complex:
    """Z (n,) ohm as predicted at x (p,)."""
    return model.fitted.near(x, {}, 1e-8, only=(), enriches=False).predict(x, 0, ())[0]


def moved(model: Model, effect: Effect, share: float = 0.3) -> Real:
    """The stated values (p,) with the numbers of an effect that share of the way to the far ends of their ranges."""
    x = model.stated
    for name in effect.names:
        p = model.parameters[model.index(name)]
        far = p.high if p.high - p.start >= p.start - p.low else p.low
        x[model.index(name)] += share * (far - p.start)
    return x


@pytest.mark.parametrize("name", [
    "electrode that ends before the rim", "load on the face of the transducer", "resistance of leads and contacts",
    "thickness of the transducer"])
def test_a_lean_model_predicts_what_that_of_all_hypotheses_does(model: Model, name: str) -> None:
    effect = model.effect(name)
    x = moved(model, effect)
    lean = model.of([effect], x)
    assert [each.name for each in lean.acting] == [name]
    every = impedance(model.of(model.effects, x), x)
    assert np.abs(impedance(lean, x) / every - 1.0).max() < ACCURACY
    # It acts: there is something to predict.
    assert np.abs(impedance(model, model.stated) / every - 1.0).max() > 10.0 * ACCURACY


def test_parameters_of_hypotheses_that_do_not_act_change_nothing(model: Model) -> None:
    effect = model.effect("load on the face of the transducer")
    lean, x = model.of([effect]), moved(model, effect)
    other = x.copy()
    idle = [i for i, p in enumerate(model.parameters) if i >= model.known
            and p.name not in effect.names and i not in model.uneven]
    assert idle
    for i in idle:
        other[i] = model.parameters[i].start + 0.3 * (model.parameters[i].high - model.parameters[i].start)
    assert (impedance(lean, other) == impedance(lean, x)).all()
    found = lean.fitted.near(x, {}, 1e-6).with_every(x)(x, deviation=[0.01])
    assert not found.jacobian[:, idle].any()
    assert found.jacobian[:, [model.index(name) for name in effect.names]].any()
    # The full model has them all.
    every = model.of(model.effects)
    assert every.fitted.near(x, {}, 1e-6).with_every(x)(x, deviation=[0.01]).jacobian[:, idle].any(axis=0).sum() > 5


def test_all_lean_models_have_one_vector_of_parameters(model: Model) -> None:
    every = model.of(model.effects)
    assert [(p.name, p.start, p.low, p.high) for p in every.parameters] == [
        (p.name, p.start, p.low, p.high) for p in model.parameters]
    assert (every.known, every.effects, every.accuracy) == (model.known, model.effects, model.accuracy)
    assert every.refusals is model.refusals


def test_a_model_that_was_made_serves_again(model: Model) -> None:
    rim, load = model.effect("electrode that ends before the rim"), model.effect("load on the face of the transducer")
    assert model.of([]) is model
    first = model.of([load])
    assert model.of([load], model.stated) is first
    assert first.of([load]) is first
    assert first.of([]).acting == ()
    x = model.stated
    x[model.index(WIDTH)] = 0.1
    narrow = model.of([rim], x)
    assert narrow.widths == {WIDTH: 0.1}
    assert model.of([rim], x) is narrow
    x[model.index(WIDTH)] = 0.2
    assert model.of([rim], x) is not narrow
    # Those last made are kept, and no more.
    for size in np.linspace(0.21, 0.3, KEPT):
        x[model.index(WIDTH)] = size
        last = model.of([rim], x)
    assert model.of([rim], x) is last
    x[model.index(WIDTH)] = 0.1
    assert model.of([rim], x) is not narrow


CHIP = DISC + PRINTED + layer_text("superstrate", "glass/trial", thickness="0.5 mm", radius="3 mm") + """
[states.filled]
cavity = "water"
temperature = "25 degC"
"""
FILLED = """
[states.filled]
chip = "chip.toml"
state = "filled"
recording = "filled.csv"
drive = "2 Vpp"
temperature = "25 degC"

[known]
"transducer.radius" = "0.1 %"
"pzt/trial.c33" = "1 %"
"pla/trial.shear_modulus" = "2 %"
"couplant.thickness" = "3 um"
"""


def test_what_no_free_parameter_needs_is_left_out(tmp_path: Path) -> None:
    """The same residuals and slopes by the known parameters, and no others, on bases about what is stated."""
    campaign = any_recordings(tmp_path, {"chip.toml": CHIP, "campaign.toml": FILLED}, FREQUENCIES)
    lean = device_model(campaign, accuracy=5e-3)
    every = lean.of(lean.effects)
    fitted, x, known = every.fitted.near(every.stated, {}, UNNEEDED), every.stated, every.known
    x[every.index("transducer.radius")] *= 1.004
    deviation = Likelihood(every, fitted).point_deviations()
    whole, part = fitted(x, deviation=deviation), fitted(x, deviation=deviation, free=range(known))
    assert whole.jacobian[:, known:].any()
    # The same numbers in another order of summation, times the quality.
    assert part.vector == pytest.approx(whole.vector, rel=1e-8, abs=1e-8 * np.abs(whole.vector).max())
    assert (part.jacobian[:, known:] == 0.0).all()
    size = np.abs(whole.jacobian[:, :known]).max(axis=0)
    assert (np.abs(part.jacobian - whole.jacobian)[:, :known] <= 1e-7 * size).all()
