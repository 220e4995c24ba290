"""The hypotheses of a device: which there are, that each changes nothing yet, and that it can act."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.catalogue import catalogue
from workbench.catalogue.catalogue import effects
from workbench.catalogue.effect import Device, Effect
from workbench.diagnosis.device import lines_of_nodes
from workbench.files.errors import InputError
from workbench.model.numbers import ParameterKind, ParameterName
from workbench.model.problem import Problem, build
from workbench.physics.open_bond import OpenBond
from workbench.physics.softening import DRIVE_SQUARED
from workbench.physics.term import FreeParameter

ROOT = Path(__file__).resolve().parent.parent
TRIAL = ROOT / "tests" / "data" / "trials" / "0000" / "campaign.toml"
SMALL = ROOT / "geometry" / "chips" / "small_campaign" / "campaign.toml"

#: Per device of a transducer, gel, printed polymer and lid, and water.
ALWAYS = {
    "fluid absorption": "cavity", "small bubbles in the cavity": "cavity", "resonant bubbles in the cavity": "cavity",
    "fluid temperature": "cavity", "cavity not full": "cavity", "cavity filled up to a height": "cavity",
    "bubble under the lid": "cavity", "glycerol in the cavity": "cavity", "substrate held at its rim": "substrate",
    "superstrate held at its rim": "superstrate", "sidewall of petg": "sidewall", "substrate of abs": "substrate",
    "superstrate of borosilicate glass": "superstrate", "fluid sound speed": "cavity", "port necks": "cavity",
    "load on the superstrate": "superstrate", "shear through the couplant": "couplant",
    "couplant missing at its rim": "couplant", "bubbles in the couplant": "couplant",
    "dielectric loss": "transducer", "complex piezoelectric constant": "transducer",
    "density that the constants were fitted with": "transducer", "electrode mass": "transducer",
    "rim of the transducer without piezoelectricity": "transducer", "electrode that ends before the rim": "transducer",
    "load on the face of the transducer": "transducer",
}


def device(campaign: Campaign, **changes: object) -> Device:
    return replace(Device(campaign.states, campaign.known, campaign.fixed, campaign.registry), **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def trial() -> Campaign:
    return read_campaign(TRIAL)


@pytest.fixture(scope="module")
def found(trial: Campaign) -> Mapping[str, Effect]:
    return {effect.name: effect for effect in effects(device(trial))}


def test_a_device_has_the_hypotheses_of_its_parts(trial: Campaign, found: Mapping[str, Effect]) -> None:
    assert len(found) == 96 == len(effects(device(trial)))
    with_a_bond = {"imperfect bond at the sidewall", "imperfect bond at the superstrate",
                   "superstrate bonded on a part of its radius", "superstrate loose around the cavity"}
    assert {name: found[name].region for name in ALWAYS} == ALWAYS
    assert {found[name].region for name in with_a_bond} == {"bond"}
    assert "softening with the drive" in found  # three drives
    small = read_campaign(SMALL)
    other = {effect.name: effect for effect in effects(device(small))}
    assert set(other) >= set(ALWAYS)
    assert not set(other) & {"imperfect bond at the sidewall", "softening with the drive"}
    # Without a bond, the superstrate's own face.
    assert other["superstrate bonded on a part of its radius"].region == "superstrate"
    (name, *_) = small.known
    assert all(name not in effect.names for effect in effects(device(small, fixed=(name,))))


def test_what_is_known_is_released_and_what_is_not_is_brought_in(trial: Campaign, found: Mapping[str, Effect]) -> None:
    unknown = {effect.name: effect for effect in effects(device(trial, known={}))}
    assert found["c33 of the transducer"].freed == ("pzt/trial.c33",)
    assert not found["c33 of the transducer"].parameters
    (own,) = unknown["c33 of the transducer"].parameters
    assert (own.name, own.low / own.start, own.high / own.start) == ("pzt/trial.c33", 0.7, 1.3)
    both = found["complex piezoelectric constant"]
    assert (both.freed, [p.name for p in both.parameters]) == (("pzt/trial.eps33.loss",), ["pzt/trial.e33.loss"])


def test_every_number_has_bounds_that_hold_its_start_and_a_source(found: Mapping[str, Effect]) -> None:
    for effect in found.values():
        assert set(effect.admissible) == set(effect.names), effect.name
        for limit in effect.admissible.values():
            assert limit.lowest < limit.highest, effect.name
            assert limit.source, effect.name
            assert limit.unit, effect.name
        for parameter in effect.parameters:
            limit = effect.admissible[parameter.name]
            assert parameter.prior is None
            assert (parameter.low, parameter.high) == (min(limit.lowest, parameter.start),
                                                       max(limit.highest, parameter.start))
            assert parameter.unit == limit.unit


def test_what_terms_say_is_free_of_them_is_what_their_hypothesis_moves(found: Mapping[str, Effect]) -> None:
    told = 0
    for effect in found.values():
        for state, terms in effect.terms.items():
            free: dict[str, FreeParameter] = {each.name: each for term in terms for each in term.free()}
            told += len(free)
            if free:
                assert list(free) == [p.name for p in effect.parameters], effect.name
                assert [each.neutral for each in free.values()] == [p.start for p in effect.parameters], effect.name
            needed = {n for term in terms for i in term.integrals() for n in i.coefficient.parameters}
            assert set(effect.values[state]) <= needed, effect.name
    assert told > 50


@pytest.fixture(scope="module")
def problems(trial: Campaign, found: Mapping[str, Effect]) -> Mapping[str, Problem]:
    """The disc and the filled chip, meshed coarsely with the skins that terms need."""
    made = {}
    for state in (s for s in trial.states if s.name in ("disc", "filled")):
        skins, _, levels = lines_of_nodes(
            state, [term for effect in found.values() for term in effect.terms.get(state.name, ())])
        made[state.name] = build(state.device, accuracy=5e-2, skins=skins, levels=sorted(levels))
    return made


@pytest.mark.parametrize("state", ["disc", "filled"])
def test_each_fits_into_the_model_and_changes_nothing_yet(
    state: str, problems: Mapping[str, Problem], found: Mapping[str, Effect]
) -> None:
    base, omega = problems[state], 2.0 * np.pi * np.array([0.95e6, 1.1e6])
    for effect in found.values():
        if state not in effect.terms:
            continue
        values = {n: complex(v) for n, v in effect.values[state].items() if n not in base.values}
        model = base.with_terms(effect.terms[state], values)
        added = [i.coefficient for term in effect.terms[state] for i in term.integrals()]
        assert all((g(omega, model.values) == 0.0).all() for g in added), effect.name
        # Away from there it acts.
        moved = dict(model.values)
        for p in effect.parameters:
            key = ParameterName.parse(p.name).key
            step = 0.1 * ((p.high if p.high > p.start else p.low) - p.start)
            moved[key] = complex(moved[key]) + (1j if p.is_loss else 1.0) * step
        assert any((g(omega, moved) != 0.0).any() for g in added), effect.name


def test_terms_take_lengths_and_drive_from_their_state(trial: Campaign, found: Mapping[str, Effect]) -> None:
    drives = {state.name: state.drive for state in trial.states}
    assert {name: values[DRIVE_SQUARED] for name, values in found["softening with the drive"].values.items()} == {
        name: pytest.approx(drive**2) for name, drive in drives.items() if drive is not None}
    assert found["shear through the couplant"].values["empty"]["couplant.thickness"] == pytest.approx(35e-6)
    assert "disc" not in found["imperfect bond at the sidewall"].terms


def test_what_is_open_lies_between_the_cavity_and_the_rim_of_what_holds(found: Mapping[str, Effect]) -> None:
    hole = 2.3 / 4.2
    (rims,), (inside,) = (found[name].terms["filled"] for name in (
        "superstrate bonded on a part of its radius", "superstrate loose around the cavity"))
    assert isinstance(rims, OpenBond)
    assert isinstance(inside, OpenBond)
    # The last edges that leave a tenth of the joint: something goes on holding.
    for each, begin, outwards, limit in ((rims, 1.0, False, 0.38), (inside, hole, True, 0.95 - hole)):
        assert (each.annulus.begin, each.annulus.outwards) == (pytest.approx(begin), outwards)
        assert each.annulus.limit == pytest.approx(limit)
        assert each.annulus.limit <= 0.9 * (1.0 - hole)
        assert hole <= min(each.annulus.edges) < max(each.annulus.edges) <= 1.0


def test_the_gauge_scales_what_a_fit_of_a_disc_cannot_tell(found: Mapping[str, Effect]) -> None:
    effect = found["density that the constants were fitted with"]
    (gauge,) = effect.parameters
    assert (effect.kind, gauge.name, gauge.parsed.kind) == ("mass", "transducer.gauge", ParameterKind.TERM)
    assert (gauge.start, gauge.low, gauge.high) == (0.0, -0.08, 0.08)
    powers = dict(gauge.powers)
    assert powers.keys() == {f"pzt/trial.{name}" for name in (
        "density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15")}
    assert {powers[f"pzt/trial.{name}"] for name in ("e31", "e33", "e15")} == {0.5}


def test_hypotheses_that_cannot_be_made_are_told_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of an input, or of a range that holds nothing; a defect of the program is none of these."""
    small = device(read_campaign(SMALL))
    plain = effects(small)

    def spoilt(_device: Device) -> Iterator[Effect]:
        yield plain[0]
        raise InputError("chip.toml", "layers", "odd", "an even one")

    def defect(_device: Device) -> Iterator[Effect]:
        raise KeyError("c33")
        yield

    every = catalogue.SOURCES
    monkeypatch.setattr(catalogue, "SOURCES", (*every, spoilt))
    found, others = catalogue.effects_and_others(small)
    monkeypatch.setattr(catalogue, "SOURCES", every)
    assert len(found) == len(plain) + 1
    assert others == ("further hypotheses about spoilt, because chip.toml: layers: received 'odd'; expected an even "
                      "one",)
    monkeypatch.setattr(catalogue, "SOURCES", (*every, defect))
    with pytest.raises(KeyError, match="c33"):
        catalogue.effects_and_others(small)
