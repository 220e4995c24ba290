"""Inhomogeneity of the parts in the generator of concealed-effect trials, and first-order changes of its devices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from concealed import section
from concealed.design import Design, random_design
from concealed.device import FILLINGS, State, body
from concealed.fields import KINDS, SMOOTH, Cosines, Inhomogeneity, random_inhomogeneity
from concealed.media import Liquid, Medium, Piezo, Solid, Viscous
from concealed.response import Device
from concealed.section import Body, Box, grid
from concealed.solver import assemble, reduce
from numpy.typing import NDArray

DISC, EMPTY, FILLED = FILLINGS[:3]
STIFFER, HEAVIER, LOSSIER = 0.02, -0.013, 0.3

PZT = Piezo(7600.0, 137e9 - 3e8j, 77.8e9 + 0j, 77.5e9 + 0j, 121e9 - 4e8j, 22.5e9 - 1e8j, -5.2, 16.2, 13.0, 762.0,
            750.0 + 2j)
WALL = Solid.isotropic(1150.0, 3.6e9 - 4e7j, 1e9 - 4.5e7j)
GEL = Liquid(1020.0, 1480.0)
WATER = Viscous(997.0, 1497.0, 1e-3, 0.0)


def stack(pzt: Medium, gel: Medium, wall: Medium, water: Medium) -> Body:
    """A small chip: a ceramic, gel, a wall with a cavity, a lid."""
    return Body((Box(0.0, 2e-3, 0.0, 1e-3, pzt, "ceramic"), Box(0.0, 1.9e-3, 1e-3, 1.03e-3, gel, "gel"),
                 Box(0.0, 2e-3, 1.03e-3, 2e-3, wall, "wall"), Box(0.0, 1e-3, 1.2e-3, 1.7e-3, water, "water")),
                (1e-3, 0.0, 2e-3), (0.0, 0.0, 2e-3))


def spectrum(of: Body, uneven: Inhomogeneity | None = None) -> NDArray[np.complex128]:
    frequency = np.linspace(1.5e6, 2.2e6, 15)
    model = assemble(of, grid(of, 2.2e6, per_wavelength=1.0), order=4, uneven=uneven)
    return reduce(model, frequency, tolerance=1e-9).impedance(frequency)


def scaled(medium: Medium) -> Medium:
    """A medium with constants, density and losses of its own that are changed alike."""
    def modulus(value: complex) -> complex:
        return (1.0 + STIFFER) * complex(value.real, (1.0 + LOSSIER) * value.imag)

    density = (1.0 + HEAVIER) * medium.density
    if isinstance(medium, Solid | Piezo):
        return replace(medium, density=density, **{name: modulus(complex(getattr(medium, name)))
                                                   for name in ("c11", "c12", "c13", "c33", "c44")})
    speed = medium.sound_speed * math.sqrt((1.0 + STIFFER) / (1.0 + HEAVIER))
    if isinstance(medium, Viscous):
        viscosity = (1.0 + LOSSIER) * medium.shear_viscosity
        return replace(medium, density=density, sound_speed=speed, shear_viscosity=viscosity)
    return replace(medium, density=density, sound_speed=speed)


def test_a_field_that_is_the_same_everywhere_is_another_material() -> None:
    plain = stack(PZT, GEL, WALL, WATER)
    flat = Cosines(np.zeros(1, dtype=int), np.zeros(1, dtype=int), np.ones(1))
    factors = np.array([[STIFFER], [HEAVIER], [LOSSIER]])
    uneven = Inhomogeneity(1.0, dict.fromkeys(plain.extents(), flat), dict.fromkeys(plain.extents(), factors))
    found = spectrum(plain, uneven)
    expected = spectrum(stack(*(scaled(medium) for medium in (PZT, GEL, WALL, WATER))))
    assert np.abs(np.log(expected / spectrum(plain))).max() > 0.1
    # Two reduced models, each to 1e-9.
    assert np.abs(np.log(found / expected)).max() < 1e-7


def test_fields_have_the_size_and_the_correlation_they_are_said_to_have() -> None:
    width, height, length = 10e-3, 2e-3, 0.5e-3
    cosines, rng = Cosines.of(width, height, length), np.random.default_rng(1)
    apart = 1.0 * length
    r = np.array([4.7e-3, 4.7e-3 + apart]) / width
    fields = np.array([cosines.at(r, np.array([0.3, 0.3])) @ rng.standard_normal(cosines.amplitude.size)
                       for _ in range(4000)])
    # exp(-d^2 / 2 l^2), but for what reflects at the faces; 4000 draws tell a correlation to 0.016.
    assert np.corrcoef(fields.T)[0, 1] == pytest.approx(math.exp(-0.5), abs=0.06)
    at = (np.arange(200) + 0.5) / 200
    everywhere = cosines.at(np.repeat(at, 200), np.tile(at, 200))
    assert np.sum(np.mean(everywhere**2, axis=0)) == pytest.approx(1.0, rel=1e-3)
    assert Cosines.of(4e-3, 20e-6, 0.7e-3).along_z.max() == 0, "across a layer there is nothing to vary"


def test_parts_draw_fields_of_their_own() -> None:
    design = random_design(np.random.default_rng(3))
    made = [random_inhomogeneity(np.random.default_rng(k), body(design.nominal, {}, EMPTY), 1e6) for k in range(200)]
    assert set(made[0].factors) == {"transducer", "couplant", "substrate", "sidewall", "bond", "superstrate"}
    sizes = np.array([each.rms for each in made])
    assert SMOOTH[0] <= sizes.min() < 1.2 * SMOOTH[0]
    assert 0.8 * SMOOTH[1] < sizes.max() <= SMOOTH[1]
    assert np.median(sizes) == pytest.approx(math.sqrt(SMOOTH[0] * SMOOTH[1]), rel=0.3)


@pytest.fixture(scope="module")
def design() -> Design:
    """One whose chip ends where its transducer does, and whose couplant does."""
    found = (random_design(np.random.default_rng(k), points=25) for k in range(1000))
    return next(each for each in found if len(each.tied) == 2)


@pytest.fixture(scope="module")
def _coarse() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(section, "CELLS", 1.0)
        yield


@pytest.fixture(scope="module")
def device(design: Design, _coarse: None) -> Device:
    uneven = random_inhomogeneity(np.random.default_rng(1), body(design.nominal, {}, EMPTY), 1e6)
    return Device(design, uneven, order=3, tolerance=1e-10)


@pytest.fixture(scope="module")
def point(device: Device, design: Design) -> Any:
    """The filled chip of the device as it is stated."""
    return device.point(design.nominal, {}, FILLED)


@pytest.mark.usefixtures("_coarse")
@pytest.mark.parametrize("state", [DISC, FILLED], ids=lambda s: s.name)
def test_the_tangents_of_fields_are_what_small_fields_do(design: Design, state: State) -> None:
    drawn = random_inhomogeneity(np.random.default_rng(1), body(design.nominal, {}, EMPTY), 1e6)
    values = {**design.nominal, "bench.series_resistance": 0.4, "bench.parallel_capacitance": 2e-12}
    none = {part: np.zeros_like(factors) for part, factors in drawn.factors.items()}

    def made(factors: dict[str, NDArray[np.float64]]) -> Device:
        return Device(design, replace(drawn, rms=1e-5, factors=factors), order=3, tolerance=1e-10)

    still = made(none)
    tangents = still.uneven_tangents(still.point(values, {}, state))
    assert {part for part, _ in tangents} == set(body(design.nominal, {}, state).extents())
    for kind in range(len(KINDS)):
        moved = [made({part: sign * factors * (np.arange(3) == kind)[:, None]
                         for part, factors in drawn.factors.items()}).spectrum(values, {}, state)
                 for sign in (1.0, -1.0)]
        found = sum(tangents[part, KINDS[kind]] @ drawn.factors[part][kind] for part in drawn.factors
                    if (part, KINDS[kind]) in tangents)
        change = 0.5 * np.log(moved[0] / moved[1])
        # Third order in 1e-5 of a resonance of Q 100, and the reduction's 1e-10 of both.
        assert np.abs(found - change).max() < 1e-3 * np.abs(change).max(), KINDS[kind]


@pytest.mark.usefixtures("_coarse")
@pytest.mark.parametrize("name", [
    "pzt/trial.c33", "pzt/trial.c33.loss", "pla/trial.density", "water/iapws_2011.sound_speed", "transducer.thickness",
    "transducer.radius", "couplant.thickness", "cavity.radius", "superstrate.thickness", "bench.gain", "bench.clock",
    "bench.series_inductance"])
def test_a_tangent_is_what_a_small_change_does(design: Design, device: Device, point: Any, name: str) -> None:
    size = 5e-6 if name == "bench.clock" else design.prior[name]
    found = device.tangent(point, design.nominal, {}, FILLED, name, size)
    step = 1e-2
    moved = [device.spectrum(design.moved(design.nominal, {name: sign * step * size}), {}, FILLED)
             for sign in (1.0, -1.0)]
    change = np.log(moved[0] / moved[1]) / (2.0 * step)
    # Third order in a hundredth of an uncertainty, and the tangent's own step of a thousandth.
    assert np.abs(found - change).max() < 1e-3 * np.abs(change).max()
