"""The compliance of high orders, as of an elastic half-space.

Their waves are so short that the rest of the body does not matter. For a wave number k the compliance of a half-space
is c_0 / k, and with inertia c_0 / k + c_2 / k^3. The mean of
J_m(k r) cos(m t) over a disc of radius a is J_m(k R) W(k) with its centre at R and W = 2 J_1(k a) / (k a) (addition
theorem of Graf). So order m of the compliance between two patches is the sum over p = 0, 1 of

    c_2p h_p ,    h_p = e_m int J_m(k R_1) J_m(k R_2) W_1 W_2 k^(-2 p) dk ,    e_0 = 1, e_m = 2.

All orders with their factors cos(m t) add up to J_0(k d) in place of the product, with the distance d of the centres.

The charges of a gap over its potentials (`workbench.fem.gap`) are c_0 k, and with inertia c_0 k + c_2 / k. So its
weight is k times the Hankel transform. A function that varies with cos(q t) or sin(q t) about the centre of its patch
has (J_(m-q) + (-1)^q J_(m+q)) / 2 or (J_(m-q) - (-1)^q J_(m+q)) / 2 in place of J_m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1, jv, spherical_jn

from workbench.fem.gap import UNIT, Gap
from workbench.fem.patch import Patch

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of the last orders to which the constants are fitted.
FITTED = 6

#: Largest k times the radius of a patch: the part of a total beyond is 1e-4. Step of k times the largest distance from
#: the axis: a sixth of a period of the products.
LARGEST, STEP = 100.0, 0.5

#: Largest k times the radius of a gap. The integrand falls with k^-2: the part of a total beyond is 5e-3, and is added.
LARGEST_OF_GAP = 200.0


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The compliances h_p of patches on plane faces, summed over orders.

    The patches are at ``angles``, the sum is the ``total`` (2, k, k). A rigid patch has one row, a gap one for each of
    its functions. Patches on different faces do not act on each other by short waves.
    """

    patches: Sequence[Patch]
    angles: Real
    total: Real

    @classmethod
    def of(cls, patches: Sequence[Patch], angles: Real) -> HalfSpace:
        """The half-space with all orders. Not all patches are on the axis."""
        empty = cls(patches, angles, np.zeros(0))
        points = empty._distance * np.exp(1j * empty._angles)
        apart = points[:, None] - points
        # The mean over the directions of plane waves, of both functions and the shift of their centres.
        turned, signs = empty._waves * empty._angles + 0.5 * np.pi * empty.is_odd, np.where(empty._waves % 2, -1.0, 1.0)
        products = np.zeros((*apart.shape, empty._numbers.size))
        for other, sign in ((-1, signs[:, None] * signs), (1, signs[:, None])):
            wave = empty._waves[:, None] + other * empty._waves
            angular = np.cos(wave * np.angle(apart) - turned[:, None] - other * turned)
            products = products + 0.5 * (sign * angular)[:, :, None] * jv(
                wave[:, :, None], np.abs(apart)[:, :, None] * empty._numbers)
        total: Real = empty._integrated(products) + empty._beyond(products[:, :, -1])
        return replace(empty, total=total)

    def order(self, order: int) -> Real:
        """The compliances (2, k, k) of one order, at equal angles."""
        pairs = [[(own, order + sign * wave) for own, wave in zip(self._distance, self._waves, strict=True)]
                 for sign in (-1, 1)]
        known = {pair: jv(pair[1], pair[0] * self._numbers) for pair in {*pairs[0], *pairs[1]}}
        before, after = (np.stack([known[pair] for pair in own]) for own in pairs)
        waves = 0.5 * (before + np.where((self._waves % 2) ^ self.is_odd, -1.0, 1.0)[:, None] * after)
        return (1.0 if order == 0 else 2.0) * self._integrated(waves[:, None] * waves)

    def without(self, order: int) -> HalfSpace:
        """The half-space without an order."""
        return replace(self, total=self.total - self.order(order) * order_factors(order, self._angles, self.is_odd))

    @cached_property
    def _rows(self) -> list[tuple[Patch, float, int, int, bool]]:
        """Patch, angle and function of every row.

        A rigid patch has the degree 0.
        """
        return [(patch, angle, *function) for patch, angle in zip(self.patches, self.angles, strict=True)
                for function in (patch.functions if isinstance(patch, Gap) else [(0, 0, False)])]

    @cached_property
    def is_odd(self) -> NDArray[np.bool_]:
        """Whether each row (k,) varies with the sine."""
        return np.array([row[4] for row in self._rows])

    @cached_property
    def _waves(self) -> NDArray[np.int64]:
        return np.array([row[3] for row in self._rows])

    @cached_property
    def _angles(self) -> Real:
        return np.array([row[1] for row in self._rows])

    @cached_property
    def _distance(self) -> Real:
        return np.array([row[0].distance for row in self._rows])

    @cached_property
    def _numbers(self) -> Real:
        """Wave numbers (n,) in 1/m. Orders from FITTED on do not reach below; there, the second weight has a pole."""
        farthest = self._distance.max()
        last = max((LARGEST_OF_GAP if isinstance(patch, Gap) else LARGEST) / patch.radius for patch in self.patches)
        step = STEP / max(farthest, *(patch.radius for patch in self.patches if isinstance(patch, Gap)), 0.0)
        return np.arange(0.5 * FITTED / farthest, last, step)

    @cached_property
    def _shapes(self) -> Real:
        """Weights (k, n) of the wave numbers."""
        return np.stack([UNIT * spherical_jn(degree, patch.radius * self._numbers) if degree
                         else 2.0 * j1(patch.radius * self._numbers) / (patch.radius * self._numbers)
                         for patch, _, degree, _, _ in self._rows])

    def _integrated(self, products: Real) -> Real:
        """Integrals (2, k, k) of products (k, k, n) with the weights.

        They are zero between patches of different faces, and between a gap and a part.
        """
        waves = self._numbers
        weights = (waves[1] - waves[0]) * np.stack([np.ones(waves.size), (waves[0] / waves) ** 2])
        faces = [(patch.region, patch.is_upper, degree > 0) for patch, _, degree, _, _ in self._rows]
        same = [[one == other for other in faces] for one in faces]
        return np.where(same, np.einsum("ijq,pq->pij", products * self._shapes[:, None] * self._shapes, weights), 0.0)

    def _beyond(self, products: Real) -> Real:
        """The integrals (2, k, k) beyond the last wave number.

        They are those within each gap: there, j_l is nearly a sine.
        """
        degrees, sizes = np.array([[degree, patch.radius] for patch, _, degree, _, _ in self._rows]).T
        owners = np.array([id(patch) for patch, *_ in self._rows])
        is_same = (owners[:, None] == owners) & (degrees > 0)
        means = 0.5 * UNIT**2 / sizes**2 / self._numbers[-1] * np.cos(0.5 * np.pi * (degrees[:, None] - degrees))
        return np.stack([np.where(is_same, products * means, 0.0), np.zeros(products.shape)])


def order_factors(order: int, angles: Real, is_odd: NDArray[np.bool_]) -> Real:
    """Factors (k, k) of the compliances of an order.

    They depend on the angles (k,). Fields of the other parity, ``is_odd`` (k,), vary with sin(m t) where the others
    vary with cos(m t).
    """
    turn = order * (angles[:, None] - angles)
    return np.where(is_odd[:, None] == is_odd, np.cos(turn), np.where(is_odd, 1.0, -1.0) * np.sin(turn))


def half_space_constants(compliances: Complex, orders: Real) -> Complex:
    """Constants c_2p (2, n, k) of the compliances of orders.

    The compliances are (m, n, k), and `orders` (m, 2, k) are the h_p of the same orders.
    """
    count = compliances.shape[2]
    return np.stack([np.linalg.lstsq(orders[:, :, i], compliances[:, :, i], rcond=None)[0] for i in range(count)],
                    axis=2)
