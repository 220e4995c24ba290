"""A face bare at its rim against the disc whose electrode ends there, and against capacitors side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip, Dimension
from geometry.mesh import SectionMesh
from geometry.parts import ElectrodeDisc, Electrodes
from materials.kinds import Material, Piezoelectric
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.problem import Problem, problem
from workbench.physics.annulus import Annulus
from workbench.physics.partial_electrode import HALFWAY, SKIN, PartialElectrode
from workbench.physics.term import ModelError

RADIUS, THICKNESS, BAND = 3e-3, 2e-3, (300e3, 700e3)
FREQUENCY = np.linspace(310e3, 690e3, 9)

Disc = Callable[..., Problem]


@pytest.fixture(scope="module")
def disc(stacked: Callable[..., Chip], uniform_mesh: Callable[..., SectionMesh],
         reference_materials: Callable[[str], dict[str, Material]]) -> Disc:
    """A disc with a skin at either face, whose live electrode, on its `face`, ends at `radius` (None: covers it)."""
    def made(radius: float | None = None, face: str = "top", **constants: float) -> Problem:
        pzt = reference_materials("free_disc_fitted_rho7500")["transducer"]
        assert isinstance(pzt, Piezoelectric)
        plain = stacked([("transducer", THICKNESS, RADIUS, None)], band=BAND)
        live = ElectrodeDisc(None if radius is None else Dimension(radius))
        chip = replace(plain, electrodes=Electrodes("top" if face == "top" else "bottom", live))
        mesh = uniform_mesh(chip, 0.15e-3, {"transducer": SKIN})
        return problem(mesh, {"transducer": replace(pzt, **constants)}, BAND)

    return made


def bared(base: Problem, beyond: complex, *rings: float, upper: bool = True) -> Problem:
    """A disc bare beyond a radius (m), of rings that begin at some (m), the first of them the innermost."""
    widths = tuple(1.0 - ring / RADIUS for ring in rings or (beyond.real,))
    rim = Annulus("rim", limit=widths[0], widths=widths[1:])
    return base.with_terms((PartialElectrode("transducer", "pzt", rim, upper),), {rim.number: 1.0 - beyond / RADIUS})


def impedance(model: Problem, frequency: NDArray[np.float64] = FREQUENCY) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance


def test_a_face_bare_in_part_is_capacitors_in_series(disc: Disc) -> None:
    # Without coupling, and without permittivity along r, every ring is a skin and the rest, one after the other.
    base = disc(e31=0.0, e33=0.0, e15=0.0, eps11=0.0)
    frequency = np.array([310e3, 690e3])
    edge = (0.45 * 3e-3**2 + 0.55 * 1.5e-3**2) ** 0.5
    found = impedance(bared(base, edge, 1.5e-3), frequency)
    covered = np.array([1.0, 0.45])
    skin = HALFWAY * covered / (1.0 - (1.0 - HALFWAY) * covered)
    area = np.pi * np.diff(np.square([0.0, 1.5e-3, 3e-3]))
    permittivity = VACUUM_PERMITTIVITY * base.values["pzt.eps33"].real
    capacitance = float((permittivity * area / THICKNESS / (1.0 - SKIN + SKIN / skin)).sum())
    # On the lines between two rings the nodes below the skin have one potential.
    assert found == pytest.approx(1.0 / (-2j * np.pi * frequency * capacitance), rel=2e-3)


@pytest.mark.parametrize("face", ["top", "bottom"])
@pytest.mark.parametrize("edge", [2.4e-3, 2.85e-3])
def test_a_bare_ring_is_an_electrode_that_ends_a_little_further_in(disc: Disc, edge: float, face: str) -> None:
    full, expected = impedance(disc(face=face)), impedance(disc(edge, face))
    # Field that leaves the edge crosses the skin below it: the ring begins 1.2 thicknesses of the skin further out.
    found = impedance(bared(disc(face=face), edge + 1.2 * SKIN * THICKNESS, upper=face == "top"))
    effect = np.abs(expected / full - 1.0).max()
    miss = np.abs(found - expected).max() / np.abs(expected - full).max()
    print(f"electrode up to {edge * 1e3:g} mm of 3 mm, {face}: {effect:.2f} of Z, off by {miss:.2g}")
    assert effect > 0.03
    # At the worst frequency, on the flank of a resonance. The skin is a seventh of the narrower ring, which would be
    # off by a third of the effect without the shift.
    assert miss < 0.1


def test_a_mesh_without_the_skin_is_refused(small_disc: Problem) -> None:
    model = bared(small_disc, 1.5e-3)
    with pytest.raises(ModelError, match=r"no row of elements for 'transducer beyond 0\.5 skin 0\.01'"):
        assemble(model.mesh, model.terms)
