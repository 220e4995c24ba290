"""Deviations that go together, against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.fitting.covariance import Covariance, principal


@pytest.mark.parametrize("shape", [(40, 7), (12, 30)])
def test_whitening_is_a_root_of_the_inverse(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    columns = random.standard_normal(shape)
    whole = np.eye(shape[0]) + columns @ columns.T
    found = Covariance.of(columns)
    white = found.whitened(np.eye(shape[0]))
    # What is left out deviates by less than 3 % of the noise: a thousandth of a variance.
    assert white @ whole @ white.T == pytest.approx(np.eye(shape[0]), abs=2e-3)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1], abs=2e-3 * shape[0])
    vector = random.standard_normal(shape[0])
    assert found.whitened(vector) == pytest.approx(white @ vector, abs=1e-12)


def test_what_deviates_by_next_to_nothing_is_left_out() -> None:
    columns = np.zeros((10, 3))
    columns[0, 0], columns[1, 1], columns[2, 2] = 1.0, 0.031, 0.029
    assert Covariance.of(columns).variances == pytest.approx([0.031**2, 1.0])


def test_principal_directions_span_what_the_columns_do() -> None:
    columns = np.random.default_rng(1).standard_normal((20, 5)) @ np.diag([1.0, 1.0, 1e-6, 1.0, 1.0])
    directions, sizes = principal(columns, 1e-3)
    assert sizes.size == 4
    assert directions.T @ directions == pytest.approx(np.eye(4), abs=1e-10)
    assert (directions * sizes) @ (directions * sizes).T == pytest.approx(columns @ columns.T, abs=1e-5)
