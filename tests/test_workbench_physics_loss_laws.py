"""Loss laws against the Kramers-Kronig integral, a stack with a dispersive layer, and the base model's own forms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from support import plate_below_a_layer

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import IsotropicSolid, Piezoelectric
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import problem
from workbench.physics import solid
from workbench.physics.loss_laws import ADMISSIBLE, SERIES_BELOW, FractionalLoss

REFERENCE = 1e6
FRACTIONAL = FractionalLoss("substrate", "pla")
EXPONENTS = (0.0, 0.5 * SERIES_BELOW, 0.2, 0.5, 0.8, 1.0)


def law(exponent: float, shear: complex = 1.0, bulk: complex = 0.0) -> dict[str, complex]:
    return {"pla.shear_fractional_loss": shear, "pla.bulk_fractional_loss": bulk, "pla.loss_exponent": exponent,
            "pla.loss_frequency": REFERENCE}


def modulus(exponent: float, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    """F at frequencies (n,) in Hz."""
    _, shear = FRACTIONAL.integrals()
    return shear.coefficient(2.0 * np.pi * frequency, law(exponent))


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_loss_is_one_at_the_reference_where_the_stiffness_stays(exponent: float) -> None:
    assert modulus(exponent, np.array([REFERENCE]))[0] == pytest.approx(-1j, abs=1e-12)
    # The loss goes with the power a of the frequency.
    assert -modulus(exponent, np.array([10.0 * REFERENCE]))[0].imag == pytest.approx(10.0**exponent, rel=1e-6)


@pytest.mark.parametrize("exponent", EXPONENTS[:-1])
@pytest.mark.parametrize("ratio", [0.2, 0.9, 3.0])
def test_the_stiffness_is_the_kramers_kronig_integral_of_the_loss(exponent: float, ratio: float) -> None:
    # Analytic in the upper half of w for e^{-i w t}:
    # M'(w) - M'(w0) = (2 / pi) P int_0^inf M''(s) [w^2 / (s (s^2 - w^2)) - w0^2 / (s (s^2 - w0^2))] ds, M'' = Im M.
    # The pole is taken out with P int_e^inf w^2 / (s (s^2 - w^2)) ds = -ln(w / e).
    lowest, highest = 1e-12, 1e14

    def loss(s: float) -> float:
        return float(modulus(exponent, np.array([s * REFERENCE]))[0].imag)

    def part(w: float) -> float:
        def integrand(x: float) -> float:
            s = np.exp(x)
            # A step of 1e-6 off the removable pole changes the integral by as much.
            s = s if abs(s / w - 1.0) > 1e-6 else w * (1.0 + 1e-6)
            return (loss(s) - loss(w)) * w**2 / (s**2 - w**2)

        ends = np.log([lowest, 1e-3, w, 1e3, highest])
        smooth = sum(quad(integrand, a, b, limit=200, epsabs=1e-9)[0] for a, b in pairwise(ends))
        return 2.0 / np.pi * (smooth - loss(w) * np.log(w / lowest))

    expected = part(ratio) - part(1.0)
    found = float(modulus(exponent, np.array([ratio * REFERENCE]))[0].real)
    print(f"a = {exponent}: stiffness at {ratio} f_0 {found:.6f}, Kramers-Kronig {expected:.6f}")
    # What lies above the highest frequency is highest^(a - 2), below the lowest lowest^2.
    assert found == pytest.approx(expected, abs=1e-5)


def test_a_loss_without_exponent_stiffens_by_the_rule_of_thumb() -> None:
    # dM' / M' = 2 / (pi Q) ln(f / f0).
    found = modulus(0.0, np.array([0.5, 1.0, 2.0]) * REFERENCE)
    assert found.real == pytest.approx(2.0 / np.pi * np.log([0.5, 1.0, 2.0]))
    assert found.imag == pytest.approx(-1.0)


def test_the_series_for_small_exponents_continues_the_closed_form() -> None:
    frequency = np.array([1e3, 0.3e6, 1e6, 20e6])
    below, above = (modulus(SERIES_BELOW * (1.0 + side * 1e-9), frequency) for side in (-1.0, 1.0))
    # The series' next term, a^3 m^4 / 24 with m = 7.
    assert np.abs(above - below).max() < 2e-7
    shear = FRACTIONAL.integrals()[1].coefficient
    slopes = [shear.derivative(2.0 * np.pi * frequency, law(SERIES_BELOW * (1.0 + side * 1e-9)), "pla.loss_exponent")
              for side in (-1.0, 1.0)]
    assert np.abs(slopes[1] - slopes[0]).max() < 3e-4  # its derivative


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_laws_are_passive_and_have_their_derivatives(exponent: float) -> None:
    omega = 2.0 * np.pi * np.geomspace(1e3, 1e8, 21)
    values = law(exponent, 3e7, 1e8)
    for integral in FRACTIONAL.integrals():
        g = integral.coefficient
        assert (g(omega, values).imag < 0.0).all()
        for name in g.parameters:
            step = 1e-6 * (values[name] if values[name] else 1.0)
            moved = [g(omega, {**values, name: values[name] + side * step}) for side in (-1.0, 1.0)]
            found, exact = (moved[1] - moved[0]) / (2.0 * step), g.derivative(omega, values, name)
            # The square of the step, and what rounding (and the closed form's cancellation) leaves of g.
            left = 1e-12 * np.abs(g(omega, values)).max() / step
            assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max() + left


def test_the_forms_are_those_of_the_base_model() -> None:
    bulk, shear, _ = solid.ElasticSolid("substrate", "pla").integrals()
    for integral, base in zip(FRACTIONAL.integrals(), (bulk, shear), strict=True):
        assert (integral.place, integral.products) == (base.place, base.products)


def test_an_exponent_of_one_is_a_dashpot() -> None:
    omega = 2.0 * np.pi * np.array([0.3e6, 1e6, 4e6])
    for pot, loss in zip(FRACTIONAL.integrals(), (1e8, 3e7), strict=True):
        viscosity = loss / (2.0 * np.pi * REFERENCE)
        assert pot.coefficient(omega, law(1.0, 3e7, 1e8)) == pytest.approx(-1j * omega * viscosity, rel=1e-12)


# --------------------------------------------------------------------------------------------------------------------
# A stack that vibrates along z alone: the wave equation with a modulus that depends on frequency

RADIUS, DISC, SAMPLE = 0.1e-3, 2e-3, 1e-3
FREQUENCY = np.linspace(0.31e6, 1.19e6, 9)
OMEGA = 2.0 * np.pi * FREQUENCY
#: No Poisson's ratio: the bulk modulus and its loss are two thirds of the shear's.
POLYMER = IsotropicSolid(name="pla", density=1130.0, bulk_modulus=2 / 3 * (1.6e9 - 10e6j), shear_modulus=1.6e9 - 10e6j)


def impedance(material: Piezoelectric, stiffness: complex | NDArray[np.complex128]) -> NDArray[np.complex128]:
    return plate_below_a_layer(material, DISC, POLYMER, SAMPLE, RADIUS, FREQUENCY, stiffness)


def test_a_stack_with_each_law_is_the_closed_form(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    plain_ceramic: Piezoelectric,
) -> None:
    chip = stacked([("transducer", DISC, RADIUS, None), ("substrate", SAMPLE, RADIUS, None)], band=(0.3e6, 1.2e6))
    base = problem(uniform_mesh(chip, 50e-6), {"transducer": plain_ceramic, "substrate": POLYMER}, chip.band)
    constant = 2.0 * POLYMER.shear_modulus
    loss = 80e6
    without = impedance(plain_ceramic, constant)
    for exponent in (0.0, 0.4, 1.0):
        added = 2.0 * loss * modulus(exponent, FREQUENCY)
        model = base.with_terms((FRACTIONAL,), law(exponent, loss, 2 / 3 * loss))
        found = solve_full(assemble(model.mesh, model.terms), FREQUENCY, model.values).impedance
        expected = impedance(plain_ceramic, constant + added)
        print(f"exponent {exponent}: effect {np.abs(expected / without - 1.0).max():.2f}, "
              f"error {np.abs(found / expected - 1.0).max():.1e} of Z")
        assert np.abs(expected / without - 1.0).max() > 0.05
        # Twenty elements or more on a wavelength, (k h)^4 / 1440 = 1e-5, on the flank of a resonance.
        assert np.abs(found / expected - 1.0).max() < 2e-4


def test_the_limits_are_the_loss_of_the_papers_epoxy_at_the_stiffness_of_its_pla() -> None:
    epoxy, pla = (Registry().load(name).parameters() for name in ("epoxy", "pla"))
    factor = -epoxy["shear_modulus"].imag / epoxy["shear_modulus"].real
    for kind in ("shear", "bulk"):
        loss = factor * pla[f"{kind}_modulus"].real
        assert ADMISSIBLE[f"{kind}_fractional_loss"].highest == pytest.approx(loss, rel=0.03)
