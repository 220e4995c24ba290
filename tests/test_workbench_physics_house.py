"""What every effect of the catalogue has to be: passive, balanced in power, and with its exact derivatives.

An effect is tried on the disc and on the filled chip of a trial, each once, at its start and at two places within its
bounds. That nothing is added at the start is a test of the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry.names import parent_place
from workbench.campaign.campaign import Campaign, read_campaign
from workbench.catalogue.catalogue import effects
from workbench.catalogue.effect import Device, Effect
from workbench.diagnosis.device import lines_of_nodes
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, solve_full
from workbench.model.numbers import ParameterName
from workbench.model.problem import Problem, build
from workbench.physics.surface_load import SurfaceLoad, SurfaceSpring

TRIAL = Path(__file__).resolve().parent / "data" / "trials" / "0000" / "campaign.toml"
FREQUENCY = np.array([0.97e6, 1.05e6])
#: Shares of the way from the start of every number to the end of its bounds at which an effect is tried.
PLACES = (0.3, 1.0)


@cache
def campaign() -> Campaign:
    return read_campaign(TRIAL)


@cache
def catalogue() -> Mapping[str, Effect]:
    """The effects of the trial's device that bring terms of their own."""
    known = campaign()
    device = Device(known.states, known.known, known.fixed, known.registry)
    return {effect.name: effect for effect in effects(device) if effect.terms and effect.parameters}


@cache
def base(state: str) -> Problem:
    """The disc or the filled chip, meshed coarsely with the skins that the effects need."""
    (found,) = (each for each in campaign().states if each.name == state)
    terms = [term for effect in catalogue().values() for term in effect.terms.get(state, ())]
    skins, _, levels = lines_of_nodes(found, terms)
    return build(found.device, accuracy=5e-2, skins=skins, levels=sorted(levels))


def model_of(effect: Effect) -> Problem:
    """The filled chip, or the disc where it has no such term, with the effect at its start."""
    state = "filled" if "filled" in effect.terms else "disc" if "disc" in effect.terms else next(iter(effect.terms))
    problem = base(state)
    values = {n: complex(v) for n, v in effect.values[state].items() if n not in problem.values}
    # What lies on top of a layer and at its side alike is loaded and held here: only a mesh that is moved tells them
    # apart.
    terms = tuple(replace(term, boundary=parent_place(term.boundary)) if isinstance(
        term, SurfaceLoad | SurfaceSpring) else term
                  for term in effect.terms[state])
    return problem.with_terms(terms, values)


def at(effect: Effect, model: Problem, share: float) -> dict[str, complex]:
    """The values with every number of the effect so far on its way to the end of its bounds."""
    values = {name: complex(value) for name, value in model.values.items()}
    for p in effect.parameters:
        end = p.high if p.high > p.start else p.low
        values[ParameterName.parse(p.name).key] += (1j if p.is_loss else 1.0) * share * (end - p.start)
    return values


def check_slopes(
    operators: FullOperators, solution: Solution, values: Mapping[str, complex], effect: Effect, point: int
) -> int:
    """The derivatives of Z at a frequency are those of differences, to the side within the bounds; how many are not
    zero."""
    frequency, impedance = FREQUENCY[[point]], solution.impedance[[point]]
    moved = 0
    for p in effect.parameters:
        key = ParameterName.parse(p.name).key
        unit = (1j if p.is_loss else 1.0) * (1.0 if p.high > p.start else -1.0)
        slope = solution.parameter_gradient(values, (key,))[[point], 0] * unit
        size = float(np.abs(slope / impedance)[0])
        if size == 0.0:
            continue
        moved += 1
        # A change of Z of 1e-6: rounding of Z, 1e-11, is far below it, the curvature too.
        step = min(1e-6 / size, 1e-3 * (p.high - p.low))
        one, two = (solve_full(operators, frequency, {**values, key: values[key] + k * step * unit}).impedance
                    for k in (1, 2))
        found = (4.0 * one - 3.0 * impedance - two) / (2.0 * step)
        assert np.abs(found - slope).max() < 2e-3 * np.abs(slope).max(), p.name
    return moved


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_an_effect_is_passive_balanced_and_differentiable(name: str) -> None:
    effect = catalogue()[name]
    model = model_of(effect)
    operators = assemble(model.mesh, model.terms)
    start = at(effect, model, 0.0)
    assert check_slopes(operators, solve_full(operators, FREQUENCY[:1], start), start, effect, 0)
    for share in PLACES:
        values = at(effect, model, share)
        solution = solve_full(operators, FREQUENCY, values)
        power, losses = solution.input_power(), solution.dissipation()
        assert (power > 0.0).all()
        assert np.abs(losses.sum(axis=1) / power - 1.0).max() < 1e-8
        for place in {integral.place for integral in operators.integrals}:
            mine = [q for q, integral in enumerate(operators.integrals) if integral.place == place]
            assert (losses[:, mine].sum(axis=1) > -1e-9 * power).all(), (share, place)
        if share < 1.0:
            check_slopes(operators, solution, values, effect, 1)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_coefficients_have_their_derivatives(name: str) -> None:
    effect = catalogue()[name]
    model = model_of(effect)
    omega, values = 2.0 * np.pi * FREQUENCY, at(effect, model, 0.3)
    state = "filled" if "filled" in effect.terms else "disc"
    for g in (i.coefficient for term in effect.terms.get(state, ()) for i in term.integrals()):
        for key in g.parameters:
            step = 1e-5 * (abs(values[key]) or 1.0)
            found = (g(omega, {**values, key: values[key] + step}) - g(omega, {**values, key: values[key] - step}))
            exact = g.derivative(omega, values, key)
            scale = max(float(np.abs(exact).max()), float(np.abs(g(omega, values)).max()) / (abs(values[key]) or 1.0))
            assert np.abs(found / (2.0 * step) - exact).max() <= 1e-5 * scale, key
