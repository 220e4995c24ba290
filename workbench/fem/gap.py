"""A round gap in an electrode: potentials of its patch, by order.

Within the gap the potential is free and the normal displacement is zero, without the field in the air. Beside the
electrode's own potential it is a sum of few functions, about the centre of the patch, with its radius a,

    P_l^q(z) cos(q t) / N  or  P_l^q(z) sin(q t) / N,    z = (1 - rho^2 / a^2)^(1/2),    q < l,  l - q odd.

They are the potentials of a gap between electrode and half-space: each makes a charge density along itself over z, so
the potential in a uniform static field is the first one, z. For N = (l + q) (-1)^((l - q - 1) / 2) P_(l-1)^q(0) their
Hankel transforms are a^2 j_l(k a) / (k a).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import lpmv
from skfem import Basis

from geometry.names import ELECTRODE_GROUND, ELECTRODE_LIVE
from workbench.fem.elements import Lagrange
from workbench.fem.operators import FullOperators
from workbench.fem.patch import Patch

Real = NDArray[np.float64]

#: Largest l of the functions. The change of the charge by a gap as wide as a shear wave is off by 0.4 % or less, with 3
#: by 3 %. Below a fifth of the wavelength 1 is enough.
DEGREE = 4

#: Unit of the potentials times the radius of the patch (V m): charges over them are about as large as displacements
#: over forces (in SI units) of a ceramic. Doubled, sums of a part and a gap have other errors, within their tolerance.
UNIT = 0.03

#: Distances of further lines of nodes on both sides of the edge and below the face, over its radius. Lines that are too
#: close for the section are left out, but not the first ones.
BESIDE_EDGE = (0.3, 0.1)

#: Points of the Gauss rule along a circle in the patch, beside a point for each wave.
AROUND = 24


@dataclass(frozen=True)
class Gap(Patch):
    """A gap in the electrode on the patch.

    Its functions have l up to a ``degree``.
    """

    degree: int = DEGREE

    @property
    def functions(self) -> list[tuple[int, int, bool]]:
        """The functions: l, q, and whether they vary with the sine. Those with the cosine are first."""
        return [(degree, wave, is_sine) for is_sine in (False, True) for degree in range(1, self.degree + 1)
                for wave in range(degree) if (degree - wave) % 2 and (wave or not is_sine)]

    def edges(self, least: float) -> list[float]:
        """Radii (m) of further lines of nodes about the edge.

        They are more than `least` (m) away from it.
        """
        ends = [1.0 + sign * share for share in BESIDE_EDGE if share * self.radius > least for sign in (-1.0, 1.0)]
        return sorted({abs(self.distance + side * end * self.radius) for side in (-1.0, 1.0) for end in ends} - {0.0})

    def potentials(self, radii: Real, order: int) -> Real:
        """Amplitudes (n, k) of the functions, of cos(m t) or sin(m t).

        They are those at `radii` (n,) above zero in m.
        """
        half = self.half_angle(radii)
        # The root at the ends of a chord is smooth in the variable s, t = half sin(s).
        nodes, weights = leggauss(AROUND + int(order * half.max(initial=0.0)))
        turn = 0.25 * np.pi * (nodes + 1.0)
        angle = half[:, None] * np.sin(turn)
        weights = half[:, None] * np.cos(turn) * weights * (0.5 if order else 0.25)
        place = (radii[:, None] * np.exp(1j * angle) - self.distance) / self.radius
        root, around = np.sqrt(np.maximum(1.0 - np.abs(place) ** 2, 0.0)), np.angle(place)
        amplitudes = []
        for degree, wave, is_sine in self.functions:
            norm = (degree + wave) * (-1.0) ** ((degree - wave - 1) // 2) * lpmv(wave, degree - 1, 0.0)
            turned = np.sin if is_sine else np.cos
            shape = UNIT / self.radius / norm * lpmv(wave, degree, root) * turned(wave * around)
            amplitudes.append((weights * shape * turned(order * angle)).sum(axis=1))
        return np.stack(amplitudes, axis=1)


def electrode_dofs(operators: FullOperators, gap: Gap) -> tuple[NDArray[np.int64], Real]:
    """The dofs (n,) of the electrode on the circles of a gap.

    Their radii (n,) in m follow.
    """
    mesh = operators.mesh
    heights = mesh.mesh.p[1, mesh.mesh.t[:, mesh.mesh.subdomains[gap.region]]]
    face = heights.max() if gap.is_upper else heights.min()
    basis = Basis(mesh.mesh, Lagrange(mesh.order), intorder=1)
    facets = np.concatenate([mesh.mesh.boundaries[name] for name in (ELECTRODE_LIVE, ELECTRODE_GROUND)])
    dofs = np.unique(basis.get_dofs(facets).flatten())
    radii, height = basis.doflocs[:, dofs]
    inside = (np.abs(height - face) < 1e-9 * np.abs(heights).max()) & (np.abs(radii - gap.distance) < gap.radius)
    return dofs[inside], np.maximum(radii[inside], 1e-9 * gap.radius)


def prescribing(operators: FullOperators, patches: list[Gap]) -> FullOperators:
    """The operators with given potentials on all circles of gaps."""
    dofs = [electrode_dofs(operators, gap)[0] for gap in patches]
    return operators.prescribing(np.unique(np.concatenate(dofs))) if dofs else operators


def gap_forms(operators: FullOperators, gap: Gap, order: int) -> Real:
    """The prescribed values (size, k) of the functions of a gap."""
    dofs, radii = electrode_dofs(operators, gap)
    values = np.zeros((operators.size, len(gap.functions)))
    values[operators.numbering["phi"][dofs]] = gap.potentials(radii, order)
    return values
