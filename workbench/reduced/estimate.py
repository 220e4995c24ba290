"""Error estimate of a reduced model: an energy norm and random projections.

Because the charge is a quadratic form of the state, its error is second order in the residual,

    Q - Q_r = e^T A e = r^T A^{-1} r .

A^{-1} is not available, but that of the energy is: R, the sum of elastic, kinetic, dielectric and acoustic energy, each
positive. The basis includes the resonances in the band, and for all other motions |A^{-1}| is about R^{-1}, so that

    |Q - Q_r| < SAFETY r^H R^{-1} r ,

in units of charge, at any frequency and parameter values, without a calibration factor. The norm is that of a few
random projections of the residual, which are fast for any parameter values (Balabanov and Nouy 2019, Adv. Comput. Math.
45, 2969: randomised linear algebra for model order reduction, part I; Smetana, Zahm and Patera 2019, SIAM J. Sci.
Comput. 41, A900: randomized residual-based error estimators for parametrized equations).

Terms of either sign cancel in Q - Q_r, not in the bound. Calibration on the filled reference chip
(`tests/benchmarks/error_estimate.py`, 419 points): the error exceeds its estimate at 0.5 % of the points, by a factor
of 1.1 at most; the median of the estimate is 12 times the error, and the largest estimate in a band is 2 to 54 times
the largest error there, 12 times in the median. :data:`SLACK` accounts for that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from workbench.fem.solve import NotConverged, System
from workbench.fem.sparsity import both_triangles, diagonal

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of random projections of the residual; their mean square is below half of its norm's with a probability of 2
#: %.
PROJECTIONS = 24

#: Factor by which an estimate may exceed the tolerance of the error, if that is far below the noise of the data. At 30
#: the median error is 2.5 times the tolerance; doubled, a model takes fewer solves and has twice the error.
SLACK = 30.0

#: Ratio of the estimate to the squared norm of the residual, for the scatter of its random projections.
SAFETY = 2.0


def random_probes(energy: sparse.csr_matrix, frequency: float) -> Real:
    """Random vectors t (size, PROJECTIONS) for the residual's norm.

    E |t^T r|^2 = r^H R^{-1} r with R the `energy` at a frequency.

    Raises:
        NotConverged: an unknown has no energy.
    """
    diagonal = energy.diagonal()
    if not (diagonal > 0.0).all():  # an unknown without any energy
        raise NotConverged(frequency, np.inf, np.zeros(diagonal.size, dtype=complex))
    scale = 1.0 / np.sqrt(diagonal)
    scaled = sparse.csc_matrix(sparse.diags_array(scale) @ energy @ sparse.diags_array(scale))
    factor = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    # R = L D L^T: the force L D^{1/2} w with white w has the covariance R, and its response R^{-1}.
    white = np.random.default_rng(0).standard_normal((scale.size, PROJECTIONS))
    force = factor.L @ (np.sqrt(np.abs(factor.U.diagonal()))[:, None] * white)
    moved = scale[:, None] * factor.solve(force[factor.perm_r])
    return np.vstack([moved, np.zeros((1, PROJECTIONS))])  # the row of the electrode is not an equation


def energy_matrix(system: System, frequency: float) -> sparse.csr_matrix:
    """R (size - 1, size - 1): all energies of `system`, positive.

    It is real, symmetric and positive, at fixed voltage. Each matrix of equal frequency dependence (stiffness, mass,
    compliance of fluids, ...) has one sign for displacements, for potentials and for pressures. Couplings between these
    are omitted.
    """
    pattern = system.operators.sparsity
    total = np.zeros(pattern.keys.size)
    for factor, group in zip(system.factors(np.array([frequency]))[:, 0], system.groups, strict=True):
        real, imaginary = np.zeros((2, total.size))
        group.add_to(real, imaginary, factor)
        sign = np.sign(diagonal(pattern.triangle(real)))
        row = sign[pattern.rows]
        total += np.where(row == sign[pattern.columns], row * real, 0.0)
    return both_triangles(pattern.triangle(total, pattern.size - 1))


def estimated_error(residual: Complex, charge: Complex) -> Real:
    """Estimated relative error (n,) of `charge` from the projected residual. The `residual` is (PROJECTIONS, n)."""
    return np.asarray(SAFETY * np.mean(np.abs(residual) ** 2, axis=0) / np.abs(charge))
