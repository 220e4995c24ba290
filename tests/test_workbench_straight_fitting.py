"""Fits of straight chips: the constants of a plate's cross-section, and what plane strain cannot know."""

from __future__ import annotations

import numpy as np
import pytest
from support import chip_from, quadratic

from geometry.chip import Chip
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.fitting.prepare import _frequencies, check_device, prepare
from workbench.fitting.recordings import fit
from workbench.model.hidden import hidden_coefficients
from workbench.model.problem import build, fill
from workbench.results.comparison import compare
from workbench.results.spectrum import Origin, Spectrum
from workbench.simulation.run import simulate

#: The published losses of the ceramic are rounded.
pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

PZT = "pzt4/acevedo_2026_fitted"
PLATE = f"""
[chip]
name = "plate"
band = ["280 kHz", "1.2 MHz"]
geometry = "straight"
length = "40 mm"

[[layers]]
role = "transducer"
material = "{PZT}"
thickness = {{ value = "2 mm", tolerance = "10 um" }}
width = "5 mm"
"""
COARSE = quadratic(4.0)


def plate(text: str = PLATE) -> Chip:
    return chip_from(text, "plate.toml")


def recorded(points: int = 121, **factors: float) -> Spectrum:
    """A spectrum of the plate with some constants times a factor, on the mesh that a fit has."""
    problem = build(fill(plate()), accuracy=COARSE)
    values = dict(problem.values)
    for name, factor in factors.items():
        values[f"{PZT}.{name}"] *= factor
    frequency = np.linspace(*plate().band, points)
    found = solve_full(assemble(problem.mesh, problem.terms), frequency, values).impedance
    return Spectrum(frequency, np.conj(found), origin=Origin("simulated"))


def test_constants_of_a_plate_are_found_from_its_cross_section() -> None:
    truth = {"c33": 1.02, "c11": 0.97, "e33": 1.03, "eps33": 0.95}
    found = fit(recorded(**truth), plate(), free=tuple(truth), accuracy=COARSE, tries=0)
    own = fill(plate()).materials["transducer"].parameters()
    off = {each.parameter.parsed.local: each.value / (own[each.parameter.parsed.local].real
                                                     * truth[each.parameter.parsed.local]) - 1.0
           for each in found.result.estimates}
    print(f"constants off by {off}, {found.result.seconds:.1f} s")
    # The same mesh, no noise: the reduced model, 1e-4, and the prior are what is left.
    assert max(map(abs, off.values())) < 1e-3
    assert any("plane strain" in text and f"{PZT}.c12" in text for text in found.findings)


def test_plane_strain_hides_c12_alone() -> None:
    problem = build(fill(plate()), accuracy=COARSE)
    assert hidden_coefficients(problem) == (f"{PZT}.c12",)
    operators, frequency = assemble(problem.mesh, problem.terms), np.array([0.6e6])
    base = solve_full(operators, frequency, problem.values).impedance
    for name, value in problem.values.items():
        moved = solve_full(operators, frequency, {**problem.values, name: 1.01 * value}).impedance
        assert (np.abs(moved / base - 1.0).max() < 1e-12) == (name == f"{PZT}.c12"), name


def test_what_plane_strain_hides_is_not_fitted() -> None:
    with pytest.raises(InputError, match=r"c12.*plane strain shows") as caught:
        prepare(plate(), Registry(), kind="pzt", name="plate", measured=recorded(60), free=("c33", "c12"),
                accuracy=COARSE)
    assert "a disc of the material shows it" in str(caught.value)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('length = "40 mm"', 'length = "2 mm"', "pF.*thickness 2 mm and half width 2.5 mm"),
    ('value = "2 mm"', 'value = "7 mm"', "along the half width"),
])
def test_a_recording_of_another_plate_is_refused(old: str, new: str, words: str) -> None:
    there = plate(PLATE.replace(old, new).replace("280 kHz", "100 kHz"))
    measured = recorded()
    materials = fill(there).materials
    check_device(measured, plate(), fill(plate()).materials, name="plate")
    with pytest.raises(InputError, match="(?s)" + words):
        check_device(measured, there, materials, name="plate")


def test_the_first_mode_across_a_thin_plate_is_where_the_check_of_a_recording_looks() -> None:
    text = PLATE.replace('value = "2 mm"', 'value = "0.4 mm"').replace('width = "5 mm"', 'width = "20 mm"')
    thin = plate(text.replace('["280 kHz", "1.2 MHz"]', '["65 kHz", "110 kHz"]'))
    run = simulate(thin, points=81, accuracy=quadratic(2.0))
    material = fill(thin).materials["transducer"]
    _, across = _frequencies(thin, material)
    print(f"first mode across {across:.6g} Hz, simulated {run.figures.f0:.6g} Hz")
    # Poisson's ratio times the thickness over the width, squared, is what a thin plate leaves out: 1e-4.
    assert run.figures.f0 == pytest.approx(across, rel=1e-3)


def test_a_straight_chip_is_compared_with_its_recording() -> None:
    run = simulate(plate(), points=121, accuracy=COARSE)
    found = compare(recorded(), run.spectrum)
    print(f"{found.mape_percent:.2g} % between the simulation and solves of the same mesh")
    assert found.mape_percent < 0.1
