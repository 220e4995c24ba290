"""Waves of stiffness and density along the radius of a ceramic, against other constants and changes by its parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Material, Piezoelectric
from workbench.diagnosis.inhomogeneity import cosine_keys, cosine_modes, inhomogeneity
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter
from workbench.model.problem import Problem
from workbench.physics.cosine_mode import CosineMode, VaryingProperty
from workbench.physics.piezoelectric import PiezoelectricSolid
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

PZT = "pzt/test"
RADIUS, THICKNESS = 3e-3, 1e-3
#: Two of the disc's radial resonances.
GRID = np.linspace(300e3, 1e6, 57)


@pytest.fixture(scope="module")
def disc(
    stacked: Callable[..., Chip], reference_materials: Callable[[str], Mapping[str, Material]],
    meshed: Callable[..., Problem],
) -> Problem:
    chip = stacked([("transducer", THICKNESS, RADIUS, None)], band=(GRID[0], GRID[-1]))
    material = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(material, Piezoelectric)
    # Losses of constants are not scaled: they are of second order.
    lossy = replace(material, name=PZT, **{name: complex(getattr(material, name)).real
                                          for name in ("c11", "c13", "c33", "c44")})
    return meshed(chip, {"transducer": lossy}, elements_per_wavelength=4.0)


@pytest.mark.parametrize(("varying", "scaled"), [
    (VaryingProperty.STIFFNESS, ("c11", "c12", "c13", "c33", "c44")), (VaryingProperty.DENSITY, ("density",))])
def test_no_half_wave_is_other_constants(varying: VaryingProperty, scaled: tuple[str, ...], disc: Problem) -> None:
    """The same everywhere: all stiffnesses, or the density, times 1 + a."""
    wave = CosineMode.of(PiezoelectricSolid("transducer", PZT).integrals(), varying, 0, RADIUS, disc.values)
    values = {name: complex(value).real if name == f"{PZT}.c12" else value for name, value in disc.values.items()}
    term = assemble(disc.mesh, (*disc.terms, wave))
    found = solve_full(term, GRID, values | {wave.amplitude: 0.01}).impedance
    expected = solve_full(assemble(disc.mesh, disc.terms), GRID, {
        **values, **{f"{PZT}.{name}": 1.01 * values[f"{PZT}.{name}"] for name in scaled}}).impedance
    bare = solve_full(assemble(disc.mesh, disc.terms), GRID, values).impedance
    # One system written in two ways; rounding grows by the condition of a mesh, some 1e6.
    assert np.abs(found / expected - 1.0).max() < 1e-8
    assert np.abs(bare / expected - 1.0).max() > 0.05


def test_slopes_are_the_changes_by_parts(disc: Problem) -> None:
    """Derivatives by the amplitudes, against the integrals of the states over cells, weighted cell by cell."""
    found = dict(cosine_modes(disc, float(np.mean(GRID[[0, -1]]))))
    assert {each.half_waves for each in found} == {0, 1, 2}
    problem = disc.with_terms(tuple(found), dict.fromkeys((each.amplitude for each in found), 0j))
    recording = FitRecording("disc", problem, Spectrum(GRID, np.ones(GRID.size, dtype=complex)))
    numbers = tuple(Parameter(each.amplitude, 0.0, -0.1, 0.1, None, "1") for each in found)
    objective = Objective.of([recording], numbers, tolerance=np.inf).near(np.zeros(len(found)), {}, 1e-7)
    slopes = objective.predict(np.zeros(len(found)), 0)[1] * np.array(list(found.values()))
    whole, beside = (inhomogeneity(objective, np.zeros(len(found)), keys).parts
                     for keys in ((), cosine_keys(found)))
    columns = whole[:GRID.size] + 1j * whole[GRID.size:]
    assert whole.shape[1] - beside.shape[1] == len(found)
    for wave, slope in zip(found, slopes.T, strict=True):
        # Cosines are those at the middles of cells there: a quarter wave has four of them, (pi / 8)^2 / 6 = 2.6 %.
        nearest = np.linalg.norm(columns - slope[:, None], axis=0).min() / np.linalg.norm(slope)
        assert nearest < (1e-6 if wave.half_waves == 0 else 0.03), wave
