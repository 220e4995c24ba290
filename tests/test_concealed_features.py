"""The generator of trials with a mass beside the axis: its solver against the workbench, itself and closed forms."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from concealed import feature_trial
from concealed.angle import Angle
from concealed.attached import Patch, PatchedDisc, Section, poles
from concealed.design import Design
from concealed.device import body
from concealed.feature_trial import ATTACHED_MASS, DISC, STATES, attached_mass, disc_design, make_feature_trial
from concealed.folder import write
from concealed.mechanisms import NONE
from concealed.section import Body, Grid, grid
from concealed.solver import assemble, solve
from feature_trials import judged
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

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
    assert off < 0.02
