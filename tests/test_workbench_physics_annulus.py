"""The rings of a rim: their areas, and what a law of the share that is affected adds up to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from workbench.physics.annulus import SHARE, WIDTHS, Annulus

RIMS = (Annulus("rim"), Annulus("joint", 0.9, 0.23), Annulus("hole", 0.4, 0.3, outwards=True))


def bent(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """A law that is zero with nothing affected."""
    f, c = v[SHARE], v["c"]
    return c * f / (2.0 - f), {SHARE: 2.0 * c / (2.0 - f) ** 2, "c": f / (2.0 - f)}


@pytest.mark.parametrize("rim", RIMS, ids=lambda rim: rim.name)
def test_what_lies_within_the_width_is_affected(rim: Annulus) -> None:
    edges = np.array(rim.edges)
    assert (np.diff(edges) > 0.0).all()
    assert np.ptp(edges) == pytest.approx(rim.limit)
    for width in (0.0, 0.001, WIDTHS[3], 0.123, rim.limit):
        shares = np.array([rim.affected(ring, width)[0] for ring in range(edges.size - 1)])
        edge = rim.begin + width if rim.outwards else rim.begin - width
        assert shares @ np.diff(edges**2) == pytest.approx(abs(edge**2 - rim.begin**2), abs=1e-15)
        assert np.count_nonzero((shares > 1e-9) & (shares < 1.0 - 1e-9)) <= 1
        # More of the width is more of its area, from the ring that the edge goes on in.
        grows = np.array([rim.affected(ring, width)[1] for ring in range(edges.size - 1)]) @ np.diff(edges**2)
        assert grows == pytest.approx(2.0 * edge if width < rim.limit else 0.0)


@pytest.mark.parametrize("rim", RIMS, ids=lambda rim: rim.name)
def test_what_is_integrated_beyond_edges_is_the_law_of_every_ring(rim: Annulus) -> None:
    steps = list(rim.coefficients(bent, (("c", "glue.stiffness"),)))
    values = {rim.number: 0.137, "glue.stiffness": 3.0 - 1.0j}
    assert [edge for edge, _ in steps] == [edge for edge in rim.edges if edge < 1.0]
    there = np.cumsum([each.constant(values) for _, each in steps])
    shares = [rim.affected(ring, 0.137)[0] for ring in range(len(rim.edges) - 1)]
    expected = [bent({SHARE: share, "c": 3.0 - 1.0j})[0] for share in shares]
    assert there[: len(expected)] == pytest.approx(expected, abs=1e-14)
    # Beyond the last ring nothing is affected.
    assert np.abs(there[len(expected):]).max(initial=0.0) < 1e-14


@pytest.mark.parametrize("rim", RIMS, ids=lambda rim: rim.name)
@pytest.mark.parametrize("name", ["width", "glue.stiffness"])
def test_derivatives_are_those_of_the_coefficients(rim: Annulus, name: str) -> None:
    name = rim.number if name == "width" else name
    values, step = {rim.number: 0.137, "glue.stiffness": 3.0 - 1.0j}, 1e-6
    moved = 0
    for _, each in rim.coefficients(bent, (("c", "glue.stiffness"),)):
        above, below = (each.constant({**values, name: values[name] + s}) for s in (step, -step))
        assert (above - below) / (2.0 * step) == pytest.approx(
            each.constant_derivative(values, name), rel=1e-8, abs=1e-7)
        moved += abs(each.constant_derivative(values, name)) > 1e-6
    assert moved >= 2
    # Comparable, as a key of what is stored: two of the same are one.
    assert set(rim.coefficients(bent, ())) == set(rim.coefficients(bent, ()))


@pytest.mark.parametrize(("begin", "limit", "outwards"), [(1.2, 0.1, False), (0.3, 0.5, False), (0.9, 0.2, True),
                                                          (1.0, 0.0, False)])
def test_a_rim_beyond_the_layer_is_refused(begin: float, limit: float, outwards: bool) -> None:
    with pytest.raises(ValueError, match=r"annulus 'rim' from .* expected two shares of 0 to 1"):
        Annulus("rim", begin, limit, outwards)
