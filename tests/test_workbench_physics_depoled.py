"""A rim without poling against a capacitor, and a poled and a depoled plate side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import Basis

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from materials.kinds import Material, Piezoelectric
from workbench.fem.elements import Lagrange
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics.annulus import Annulus
from workbench.physics.depoled import DepoledAnnulus
from workbench.physics.term import Integral, ModelError

WIDTH, EXCESS = "rim.width", "rim.permittivity_excess"


def rimmed(base: Problem, beyond: float, excess: complex = 0.0) -> Problem:
    """`base` without poling beyond a radius (m)."""
    width = 1.0 - beyond / base.mesh.mesh.p[0].max()
    term = DepoledAnnulus("transducer", "pzt", Annulus("rim", limit=width))
    return base.with_terms((term,), {WIDTH: width, EXCESS: excess})


def impedance(model: Problem, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance


def test_a_disc_without_poling_is_a_capacitor(small_disc: Problem) -> None:
    frequency = np.linspace(310e3, 690e3, 5)
    found = impedance(rimmed(small_disc, 0.0, 0.1), frequency)
    permittivity = 1.1 * small_disc.values["pzt.eps33"] * 8.8541878128e-12
    expected = 1.0 / (-2j * np.pi * frequency * permittivity * np.pi * 3e-3**2 / 2e-3)
    assert found == pytest.approx(expected, rel=1e-9)


def test_a_poled_and_a_depoled_plate_lie_side_by_side(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh],
    reference_materials: Callable[[str], dict[str, Material]],
) -> None:
    # Without what couples one radius to another (c13, c44, e31, e15, eps11) every ring is a plate of its own: the
    # admittances of the inner plate, e^{-i w t}, and of a capacitor add up. Only the nodes between the two are shared.
    pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(pzt, Piezoelectric)
    pzt = replace(pzt, c13=0.0, c44=0.0, e31=0.0, e15=0.0, eps11=0.0)
    thickness, radius, inner = 2e-3, 0.8e-3, 0.6e-3
    frequency = np.linspace(0.3e6, 1.5e6, 7)
    omega = 2.0 * np.pi * frequency
    kt2 = pzt.e33**2 / pzt.absolute_eps33 / (pzt.c33 + pzt.e33**2 / pzt.absolute_eps33)
    half = 0.5 * omega * thickness * np.sqrt(pzt.density / (pzt.c33 + pzt.e33**2 / pzt.absolute_eps33))
    capacitance = pzt.absolute_eps33 * np.pi / thickness * np.array([[inner**2], [radius**2 - inner**2]])
    poled, depoled = -1j * omega * capacitance / np.array([1.0 - kt2 * np.tan(half) / half, np.ones(omega.size)])
    whole = poled * radius**2 / inner**2
    chip = stacked([("transducer", thickness, radius, None)], band=(0.3e6, 1.5e6))
    errors = []
    for edge in (0.1e-3, 0.05e-3):
        base = problem(uniform_mesh(chip, edge), {"transducer": pzt}, chip.band)
        assert np.abs(impedance(base, frequency) * whole - 1.0).max() < 1e-3
        found = 1.0 / impedance(rimmed(base, inner), frequency)
        errors.append(np.abs(found - (poled + depoled)).max() / np.abs(whole - (poled + depoled)).max())
    print(f"plates side by side: errors {errors} of the effect")
    assert errors[-1] < 0.025  # of the effect; a share of one column of elements
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("beyond", [1.9e-3, 2e-3, 2.96e-3])
def test_the_rim_begins_where_it_is_said_to(small_disc: Problem, beyond: float) -> None:
    term = DepoledAnnulus("transducer", "pzt", Annulus("rim", limit=1.0 - beyond / small_disc.mesh.mesh.p[0].max()))
    operators = assemble(small_disc.mesh, (*small_disc.terms, term))
    rim = operators.places[term.integrals()[0].domain]
    disc, (r, z) = operators.places["transducer"], small_disc.mesh.mesh.p
    assert rim.weights.sum() == pytest.approx(np.pi * (r.max() ** 2 - beyond**2) * np.ptp(z), rel=1e-12)
    outer = r[small_disc.mesh.mesh.t].max(axis=0)
    assert sorted(rim.elements) == np.flatnonzero(outer > beyond).tolist()
    assert 0 < rim.elements.size < disc.elements.size
    # A field of the elements' own order is integrated exactly there: u_r = r^2, whose strain about the axis is r.
    state = np.zeros((operators.size, 1))
    numbers, nodes = operators.numbering["u_r"], Basis(small_disc.mesh.mesh, Lagrange(small_disc.mesh.order)).doflocs
    state[numbers[numbers >= 0], 0] = nodes[0, numbers >= 0] ** 2
    strain = operators.evaluate(rim, ["strain_tt"], state)["strain_tt"][:, :, 0]
    expected = 2.0 * np.pi * np.ptp(z) * (r.max() ** 4 - beyond**4) / 4.0
    assert float((strain**2 * rim.weights).sum()) == pytest.approx(expected, rel=1e-10)


def test_a_rim_outside_of_the_disc_is_refused(small_disc: Problem) -> None:
    class Outside(DepoledAnnulus):
        def integrals(self) -> tuple[Integral, ...]:
            return tuple(replace(each, radius_fraction=1.2) for each in super().integrals())

    with pytest.raises(ModelError, match=r"'transducer' beyond 1\.2 of its outer radius: expected a share below 1"):
        assemble(small_disc.mesh, (*small_disc.terms, Outside("transducer", "pzt", Annulus("rim"))))
