"""The compliance of high orders, as of an elastic half-space.

Their waves are so short that the rest of the body does not matter. For a wave number k the compliance of a half-space
is c_0 / k, and with inertia c_0 / k + c_2 / k^3. The mean of
J_m(k r) cos(m t) over a disc of radius a is J_m(k R) W(k) with its centre at R and W = 2 J_1(k a) / (k a) (addition
theorem of Graf). So order m of the compliance between two patches is the sum over p = 0, 1 of

    c_2p h_p ,    h_p = e_m int J_m(k R_1) J_m(k R_2) W_1 W_2 k^(-2 p) dk ,    e_0 = 1, e_m = 2.

All orders with their factors cos(m t) add up to J_0(k d) in place of the product, with the distance d of the centres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1, jv

from workbench.fem.patch import Patch

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of the last orders to which the constants are fitted.
FITTED = 6

#: Largest k times the radius of a patch: the part of a total beyond is 1e-4. Step of k times the largest distance from
#: the axis: a sixth of a period of the products.
LARGEST, STEP = 100.0, 0.5


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The compliances h_p of patches on plane faces, summed over orders.

    The patches are at ``angles`` (k,), the sum is the ``total`` (2, k, k). Patches on
    different faces do not act on each other by short waves.
    """

    patches: Sequence[Patch]
    angles: Real
    total: Real

    @classmethod
    def of(cls, patches: Sequence[Patch], angles: Real) -> HalfSpace:
        """The half-space with all orders. Not all patches are on the axis."""
        empty = cls(patches, angles, np.zeros(0))
        points = empty._distance * np.exp(1j * angles)
        apart = np.abs(points[:, None] - points)
        return replace(empty, total=empty._integrated(j0(apart[:, :, None] * empty._waves)))

    def order(self, order: int) -> Real:
        """The compliances (2, k, k) of one order, at equal angles."""
        waves = jv(order, self._distance[:, None] * self._waves)
        return (1.0 if order == 0 else 2.0) * self._integrated(waves[:, None] * waves)

    def without(self, order: int) -> HalfSpace:
        """The half-space without an order."""
        turn = order * (self.angles[:, None] - self.angles)
        return replace(self, total=self.total - self.order(order) * np.cos(turn))

    @cached_property
    def _distance(self) -> Real:
        return np.array([patch.distance for patch in self.patches])

    @cached_property
    def _waves(self) -> Real:
        """Wave numbers (q,) in 1/m. Orders from FITTED on do not reach below; there, the second weight has a pole."""
        step, smallest = STEP / self._distance.max(), min(patch.radius for patch in self.patches)
        return np.arange(0.5 * FITTED / STEP, LARGEST / smallest / step) * step

    def _integrated(self, products: Real) -> Real:
        """Integrals (2, k, k) of products (k, k, q) with the weights.

        They are zero between patches of different faces.
        """
        waves = self._waves
        reach = waves * np.array([patch.radius for patch in self.patches])[:, None]
        shape = 2.0 * j1(reach) / reach
        weights = (waves[1] - waves[0]) * np.stack([np.ones(waves.size), (waves[0] / waves) ** 2])
        faces = [(patch.region, patch.is_upper) for patch in self.patches]
        same = [[one == other for other in faces] for one in faces]
        return np.where(same, np.einsum("ijq,pq->pij", products * shape[:, None] * shape, weights), 0.0)


def half_space_constants(compliances: Complex, orders: Real) -> Complex:
    """Constants c_2p (2, n, k) of the compliances of orders.

    The compliances are (m, n, k), and `orders` (m, 2, k) are the h_p of the same orders.
    """
    count = compliances.shape[2]
    return np.stack([np.linalg.lstsq(orders[:, :, i], compliances[:, :, i], rcond=None)[0] for i in range(count)],
                    axis=2)
