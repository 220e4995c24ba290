"""Softening with the drive: the same as a ceramic whose c33 is that of the drive."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem
from workbench.physics.softening import DRIVE_SQUARED, Softening

FREQUENCIES = np.array([350e3, 480e3, 610e3])


@pytest.mark.parametrize("drive", [0.5, 2.0, 8.0])
def test_it_is_another_c33(small_disc: Problem, drive: float) -> None:
    names = {"pzt.softening": 3e-4, "pzt.drive_loss": 1e-4, DRIVE_SQUARED: drive**2}
    soft = small_disc.with_terms((Softening("transducer", "pzt"),), {k: complex(v) for k, v in names.items()})
    factor = 1.0 - (3e-4 + 1e-4j) * drive**2
    other = small_disc.with_values({"pzt.c33": factor * small_disc.values["pzt.c33"]})
    found, expected = (solve_full(assemble(p.mesh, p.terms), FREQUENCIES, p.values).impedance for p in (soft, other))
    # The same matrix but for rounding, which a resonance magnifies.
    assert np.allclose(found, expected, rtol=1e-9, atol=0.0)


def test_driven_harder_a_disc_resonates_lower_and_loses_more(small_disc: Problem) -> None:
    frequencies = np.linspace(300e3, 700e3, 81)

    def admittance(drive: float) -> np.ndarray:
        values = {"pzt.softening": 1e-3, "pzt.drive_loss": 5e-4, DRIVE_SQUARED: drive**2}
        soft = small_disc.with_terms((Softening("transducer", "pzt"),), {k: complex(v) for k, v in values.items()})
        return np.asarray(solve_full(assemble(soft.mesh, soft.terms), frequencies, soft.values).admittance.real)

    gentle, hard = admittance(0.1), admittance(8.0)
    assert frequencies[hard.argmax()] < frequencies[gentle.argmax()]
    assert hard.max() < gentle.max()
