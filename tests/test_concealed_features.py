"""The generator of trials with a mass beside the axis: its solver against the workbench, itself and closed forms."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from concealed import feature_trial, response
from concealed.angle import Angle
from concealed.attached import TOLERANCE, Patch, PatchedDisc, Section, poles
from concealed.design import Design
from concealed.device import body
from concealed.feature_trial import ATTACHED_MASS, DISC, STATES, attached_mass, disc_design, make_feature_trial
from concealed.folder import write
from concealed.mechanisms import NONE
from concealed.section import Body, Grid, grid
from concealed.solver import node_positions
from feature_trials import Judged, judged
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from geometry.chip import read_chip
from materials.registry import Registry
from workbench.campaign.campaign import read_campaign
from workbench.fem import patch as theirs
from workbench.fem.operators import assemble as assemble_theirs
from workbench.fem.solve import System
from workbench.model.problem import build, fill
from workbench.simulation.features import RigidPart, charge_change, compliance_of, driven_displacements

BAND = np.linspace(200e3, 400e3, 41)
PATCH, MASS, CELLS = Patch(2e-3, 1.2e-3), 4e-6, 81

Complex = NDArray[np.complex128]


@pytest.fixture(scope="module")
def design() -> Design:
    return replace(disc_design(np.random.default_rng(1), is_radial=True), frequency=BAND)


@pytest.fixture(scope="module")
def section(design: Design) -> tuple[Body, Grid]:
    of_disc = body(design.nominal, {"patch.distance": PATCH.distance, "patch.diameter": PATCH.diameter}, DISC)
    return of_disc, grid(of_disc, float(BAND[-1]))


@pytest.fixture(scope="module")
def disc(section: tuple[Body, Grid]) -> PatchedDisc:
    return PatchedDisc.of(*section, PATCH, Angle(CELLS), BAND, order=5)


def test_a_mass_changes_the_disc_as_the_workbench_has_it(design: Design, disc: PatchedDisc, tmp_path: Path) -> None:
    write(tmp_path, design, STATES, dict.fromkeys((s.name for s in STATES), np.ones(BAND.size, dtype=complex)),
          np.random.default_rng(1))
    part = RigidPart(theirs.Patch("transducer", True, PATCH.distance, 0.5 * PATCH.diameter), mass=MASS)
    posed = build(fill(read_chip(tmp_path / "disc.toml"), None, Registry((tmp_path / "materials",))),
                  band=(float(BAND[0]), float(BAND[-1])), radii=part.patch.radii)
    found = System(assemble_theirs(posed.mesh, posed.terms), posed.values).solutions(BAND)
    between = compliance_of(posed, [part.patch], np.zeros(1), BAND)
    change = charge_change([part], BAND, driven_displacements(assemble_theirs(posed.mesh, posed.terms), [part],
                                                              found.states), between.total)
    expected = -np.log1p(change / found.charge)
    assert np.abs(expected).max() > 0.3
    off = np.abs(np.log(disc.impedance_ratio(BAND, MASS)) - expected).max() / np.abs(expected).max()
    print(f"change of ln Z up to {np.abs(expected).max():.2f}, off by {off:.2%} of it, {between.orders} orders there")
    # The workbench's compliance is good for 1e-3, and modes of the loaded disc amplify that by their quality.
    assert off < 5e-3


def test_no_mass_changes_nothing(disc: PatchedDisc) -> None:
    assert np.array_equal(disc.impedance_ratio(BAND, 0.0), np.ones(BAND.size))


def test_more_cells_around_the_axis_change_less(section: tuple[Body, Grid]) -> None:
    few, some, fine = (np.log(PatchedDisc.of(*section, PATCH, Angle(cells), BAND[::8], order=3).impedance_ratio(
        BAND[::8], MASS)) for cells in (11, 33, CELLS))
    off = [np.abs(each - fine).max() / np.abs(fine).max() for each in (few, some)]
    print(f"11 and 33 cells: off from {CELLS} by {off[0]:.1e} and {off[1]:.1e} of the largest change")
    # The error is the square of what is left out of the traction, which ends at the edge of the patch: second order.
    assert off[0] > 9.0 * off[1]
    assert off[1] < 3e-3


def test_a_response_is_that_of_direct_solves(section: tuple[Body, Grid]) -> None:
    whole, angle = Section.of(*section, 5, None), Angle(CELLS)
    forms, (_, first, second) = whole.patch(PATCH, angle), angle.factors
    for order in (0, 1, 5):
        free = whole.unknowns(order)
        parts, mass = [(free.T @ each @ free).tocsc() for each in whole.stiffness], (free.T @ whole.mass @ free).tocsc()
        stiffness = (parts[0] + first[order] * parts[1] + second[order] * parts[2]).tocsc()
        loads = (free.T @ forms[order]).astype(complex)
        found = poles(stiffness, mass, loads, BAND, TOLERANCE)(BAND[[3, 36]])
        for at, own in zip((3, 36), found, strict=True):
            matrix = (stiffness - (2.0 * np.pi * BAND[at]) ** 2 * mass).tocsc()
            exact = loads.T @ splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(loads)
            print(f"order {order}: off by {np.abs(own - exact).max() / np.abs(exact).max():.1e}")
            # The basis converges as the square of its fields, and losses slow that down.
            assert np.abs(own - exact).max() < TOLERANCE * np.abs(exact).max()


def test_splines_around_the_axis_tend_to_cosines() -> None:
    half, errors = 0.4, []
    for cells in (25, 51):
        angle = Angle(cells)
        m = angle.orders[1:6]
        square, first, second = (each[1:6] for each in angle.factors)
        up, across, turned = angle.within(half)[:, 1:6] / np.sqrt(square)
        plus, minus = np.sin((m + 1.0) * half) / (m + 1.0), half * np.sinc((m - 1.0) * half / np.pi)
        errors.append([np.abs(each).max() for each in (
            first / m - 1.0, second / m**2 - 1.0, up - 2.0 * np.sin(m * half) / m, across - plus - minus,
            turned - minus + plus)])
    coarse, fine = np.array(errors)
    # The slopes are of sixth order in energy and the splines themselves of fourth.
    assert (coarse[:2] > 40.0 * fine[:2]).all()
    assert (coarse[2:] > 8.0 * fine[2:]).all()
    assert fine.max() < 1e-3


def test_a_rigid_motion_strains_nothing_and_moves_the_patch(section: tuple[Body, Grid]) -> None:
    whole, angle = Section.of(*section, 5, None), Angle(CELLS)
    _, cells = section
    r, z = (each.ravel() for each in np.meshgrid(*(node_positions(lines, 5) for lines in (cells.r, cells.z)),
                                                  indexing="ij"))
    none, one = np.zeros(r.size), np.ones(r.size)
    top = z.max()
    # Fields u_r, u_z, phi, u_s of the order, and the motion of the patch away from the axis and upwards.
    for order, fields, expected in (
        (0, (none, one, none, none), (0.0, 1.0)), (1, (one, none, none, -one), (1.0, 0.0)),
        (1, (z - top, -r, none, top - z), (0.0, -PATCH.distance)),
    ):
        state = np.concatenate(fields)
        stiffness = sum(order**power * each for power, each in enumerate(whole.stiffness))
        size = np.abs(state) @ (abs(stiffness) @ np.abs(state))
        assert abs(state @ (stiffness @ state)) < 1e-12 * size
        moved = whole.patch(PATCH, angle)[order].T @ state / np.sqrt(angle.factors[0][order])
        # Of fourth order in the width of a cell.
        assert moved == pytest.approx(expected, abs=1e-6)


def test_a_folder_tells_nothing_but_by_its_spectra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(response, "ORDER", 3)
    monkeypatch.setattr(feature_trial, "RADIAL_BAND", np.linspace(150e3, 300e3, 41))
    monkeypatch.setattr(feature_trial, "ORDERS", 2.0)
    truths = {name: make_feature_trial(1, (name,), tmp_path / name) for name in (NONE, ATTACHED_MASS)}
    files = sorted(p.relative_to(tmp_path / NONE) for p in (tmp_path / NONE).rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(tmp_path / ATTACHED_MASS) for p in (tmp_path / ATTACHED_MASS).rglob("*")
                           if p.is_file())
    for file in files:
        plain, loaded = ((tmp_path / name / file).read_text(encoding="utf-8") for name in (NONE, ATTACHED_MASS))
        assert (plain == loaded) == (file.suffix != ".csv")
        assert not any(word in loaded for word in ("attached", "mass", "patch", "conceal", "seed"))
    campaign = read_campaign(tmp_path / ATTACHED_MASS / "campaign.toml")
    assert [s.held_out for s in campaign.states] == [False, True]
    assert '"pzt/trial.c12" = "2 %"' in (tmp_path / NONE / "campaign.toml").read_text(encoding="utf-8")
    assert truths[NONE].effects == ()
    assert truths[NONE].values == truths[ATTACHED_MASS].values
    (told,) = json.loads(json.dumps(truths[ATTACHED_MASS].to_dict()))["effects"]
    assert (told["name"], told["region"], set(told["parameters"])) == (
        "attached mass", "transducer", {"mass", "distance", "diameter"})
    assert told["detectability"] == truths[ATTACHED_MASS].detectability > 0.0


def test_a_round_has_one_disc_without_a_mass_and_places_are_on_the_face() -> None:
    rounds = np.array([name == NONE for (name,) in islice(feature_trial.mechanisms(3), 60)]).reshape(10, 6)
    assert (rounds.sum(axis=1) == 1).all()
    assert len(set(rounds.argmax(axis=1).tolist())) > 2
    rng = np.random.default_rng(1)
    for _ in range(200):
        told = attached_mass(rng, {"transducer.radius": 4e-3}).parameters
        assert 0.3e-6 <= told["mass"] <= 20e-6
        assert 0.2 <= told["distance"] / (4e-3 - 0.5 * told["diameter"]) <= 0.95


def test_an_answer_is_judged_by_the_place_of_the_mass() -> None:
    truth = {"detectability": 9.0, "effects": [{"parameters": {"mass": 2e-6, "distance": 2e-3, "diameter": 1e-3}}]}

    def answer(distance: float | None, *named: str) -> Judged:
        said = {"verdict": "missing_physics", "effects": [{"name": name} for name in named]}
        place = {} if distance is None else {
            "not_round": [{"distance": distance, "mass": 1e-6, "named": True}]}
        return judged("0001", truth, said | place)

    assert answer(2.1e-3).is_near
    assert not answer(1.7e-3).is_near
    assert answer(None, "dielectric loss").is_other
    assert not answer(2e-3, "dielectric loss").is_other
    assert not answer(None, "series resistance").is_other
    # A part that is not the verdict is not named.
    assert answer(None).not_round is None
    assert not judged("0001", {"detectability": 0.0, "effects": []},
                      {"verdict": "no_mismatch", "effects": [],
                       "not_round": [{"distance": 2e-3, "mass": 1e-6, "named": False}]}).is_near
