"""The compliance of high orders, whose waves are so short that a face is like that of an elastic half-space.

For a wave number k the compliance of a half-space is c_0 / k, and with inertia c_0 / k + c_2 / k^3. The mean of
J_m(k r) cos(m t) over a disc of radius a is J_m(k R) W(k) with its centre at R and W = 2 J_1(k a) / (k a) (addition
theorem of Graf). So order m of the compliance between two patches is the sum over p = 0, 1 of

    c_2p h_p ,    h_p = e_m int J_m(k R_1) J_m(k R_2) W_1 W_2 k^(-2 p) dk ,    e_0 = 1, e_m = 2.

All orders with their factors cos(m t) add up to J_0(k d) in place of the product, with the distance d of the centres.
"""

from __future__ import annotations

from collections.abc import Sequence

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


class HalfSpace:
    """The compliances h_p (2, k, k) of some patches at angles (k,), order by order.

    Patches on different faces do not act on each other by short waves.
    """

    def __init__(self, patches: Sequence[Patch], angles: Real) -> None:
        self._distance, radius = (np.array([getattr(patch, name) for patch in patches])
                                  for name in ("distance", "radius"))
        self._turn = angles[:, None] - angles
        faces = [(patch.region, patch.is_upper) for patch in patches]
        self._same = np.array([[one == other for other in faces] for one in faces])
        step = STEP / self._distance.max()
        # Orders from FITTED on do not reach below; there, the second weight has a pole.
        self._waves = np.arange(0.5 * FITTED / STEP, LARGEST / radius.min() / step) * step
        shape = 2.0 * j1(self._waves * radius[:, None]) / (self._waves * radius[:, None])
        self._weights = step * np.stack([np.ones(self._waves.size), (self._waves[0] / self._waves) ** 2])
        self._shapes = shape
        points = self._distance * np.exp(1j * angles)
        apart = np.abs(points[:, None] - points)
        #: The total of all orders (2, k, k).
        self.total = self._integrated(j0(apart[:, :, None] * self._waves))

    def order(self, order: int) -> Real:
        """The compliances (2, k, k) of one order, without the factor of the angles."""
        waves = jv(order, self._distance[:, None] * self._waves)
        return (1.0 if order == 0 else 2.0) * self._integrated(waves[:, None] * waves)

    def turned(self, order: int) -> Real:
        """The compliances of one order with the factor of the angles."""
        return self.order(order) * np.cos(order * self._turn)

    def _integrated(self, products: Real) -> Real:
        """Integrals (2, k, k) of products (k, k, q) with the weights, on one face."""
        weighted = products * self._shapes[:, None] * self._shapes
        return np.where(self._same, np.einsum("ijq,pq->pij", weighted, self._weights), 0.0)


def fitted(compliances: Complex, orders: Real) -> Complex:
    """Constants c_2p (2, n, k) of compliances (m, n, k) of the last orders.

    `orders` (m, 2, k) are h_p of the same orders.
    """
    count = compliances.shape[2]
    return np.stack([np.linalg.lstsq(orders[:, :, i], compliances[:, :, i], rcond=None)[0] for i in range(count)],
                    axis=2)
