"""A film of gel or glue shows at several thicknesses: a fit finds the right one, or says that it did not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import chip_from, layer_text

from geometry.chip import Chip
from materials.registry import Registry
from workbench.fitting.joint import FitResult, fit_parameters
from workbench.fitting.objective import Objective
from workbench.fitting.prepare import Prepared, prepare
from workbench.fitting.record import refusals
from workbench.reduced.predictor import Predictor
from workbench.results.spectrum import Spectrum

#: A sample on a disc, whose gel was stated as 20 um and is another; nothing says how exact the 20 um are.
STACK = """
[chip]
name = "sample of PLA"
band = ["0.9 MHz", "1.17 MHz"]
""" + "".join((
    layer_text("transducer", "pzt4/acevedo_2026_initial", thickness="2 mm", radius="3 mm"),
    layer_text("couplant", "coupling_gel", thickness="20 um", radius="3 mm"),
    layer_text("sample", "pla/acevedo_2026", thickness="1 mm", radius="3 mm"),
))
GEL, BULK, SHEAR = "couplant.thickness", "pla/acevedo_2026.bulk_modulus", "pla/acevedo_2026.shear_modulus"
TRUTH = {GEL: 31e-6, BULK: 1.08, SHEAR: 0.94}
NOISE, FREQUENCIES = 1e-3, np.linspace(0.9e6, 1.17e6, 181)


@pytest.fixture(scope="module")
def chip() -> Chip:
    return chip_from(STACK)


@pytest.fixture(scope="module")
def prepared(chip: Chip) -> Prepared:
    free = ("default", GEL)
    begun = prepare(chip, Registry(), kind="polymer", name="pla", free=free, accuracy=0.02, check=False,
                    measured=Spectrum(FREQUENCIES, np.full(FREQUENCIES.size, 100.0 - 100.0j)))
    (recording,) = begun.recordings
    # On the mesh of the fit, whose error would otherwise be far above the noise that is to be reached.
    with_lengths = Objective.of([recording], begun.parameters, tolerance=1e-3).recordings[0].problem
    own = Predictor(with_lengths, FREQUENCIES, tolerance=1e-5)
    values = dict(own.problem.values)
    values |= {GEL: complex(TRUTH[GEL]), BULK: values[BULK] * TRUTH[BULK], SHEAR: values[SHEAR] * TRUTH[SHEAR]}
    real, imaginary = np.random.default_rng(3).standard_normal((2, FREQUENCIES.size))
    seen = own(values).impedance * (1.0 + NOISE * (real + 1j * imaginary))
    measured = Spectrum(FREQUENCIES, seen, NOISE * np.abs(seen))
    return replace(begun, recordings=(replace(recording, measured=measured),), coarse=(
        replace(begun.coarse[0], measured=measured),))


def _fitted(prepared: Prepared, tries: int) -> FitResult:
    return fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, tries=tries, bands=0,
                          profiles=False)


def test_a_search_goes_on_from_film_to_film_until_the_noise_is_reached(prepared: Prepared) -> None:
    found = _fitted(prepared, 32)
    numbers = {e.parameter.name: e.value for e in found.estimates}
    # The noise leaves 0.05 % of each; the next optima are 10 to 20 % beside.
    assert numbers[GEL] == pytest.approx(TRUTH[GEL], rel=5e-3)
    for name in (BULK, SHEAR):
        stated = next(p.start for p in prepared.parameters if p.name == name)
        assert numbers[name] == pytest.approx(TRUTH[name] * stated, rel=5e-3)
    assert found.recordings[0].noise.ratio < 1.2
    assert any(start.label.startswith("film couplant.thickness x 1.15") for start in found.starts)
    assert refusals(found) == ()
    assert "couplant.thickness was freed without a tolerance: assumed, a film of gel or glue is known to a factor of " \
           "3." in found.findings


def test_a_fit_that_leaves_several_times_the_noise_is_not_accepted(prepared: Prepared) -> None:
    found = _fitted(prepared, 0)
    gel = next(e.value for e in found.estimates if e.parameter.name == GEL)
    assert abs(gel / TRUTH[GEL] - 1.0) > 0.05, "the first descent ends in another optimum"
    assert found.recordings[0].noise.ratio > 2.0
    (reason,) = refusals(found)
    assert "times the noise that it states" in reason
    assert "another optimum or missing physics: try `workbench diagnose`" in reason
