"""Sparse factorisations of one pattern: the same answers from each, bit for bit every time."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.factorisation import (
    FACTORISATION_VARIABLE,
    KNOWN,
    Factorisation,
    Ldlt,
    SuperLU,
    chosen,
    factorisation,
)
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import NotConverged, System, factorise, solve_full
from workbench.model.problem import Problem

Complex = NDArray[np.complex128]

FREQUENCIES = (350e3, 400e3)
ROOT = Path(__file__).resolve().parent.parent


def names() -> list[object]:
    """Every factorisation, those that are not installed skipped."""
    def missing(name: str) -> bool:
        try:
            KNOWN[name](sparse.csc_array(np.eye(2)))
        except ImportError:
            return True
        return False

    reason = "rslab is not installed: only SuperLU can be tried"
    return [pytest.param(name, marks=pytest.mark.skipif(missing(name), reason=reason)) for name in KNOWN]


@pytest.fixture(params=names())
def kind(request: pytest.FixtureRequest) -> Callable[[sparse.csc_array], Factorisation]:
    found: Callable[[sparse.csc_array], Factorisation] = KNOWN[request.param]
    return found


def scaled(operators: FullOperators, problem: Problem, frequency: float) -> sparse.csc_matrix:
    """What a solve at a frequency (Hz) factorises: without the electrode, scaled to a diagonal of ones."""
    matrix = System(operators, problem.values).matrix(frequency)[:-1, :-1]
    scale = sparse.diags_array(1.0 / np.sqrt(np.abs(matrix.diagonal())))
    return sparse.csc_matrix(scale @ matrix @ scale)


@pytest.fixture(scope="module")
def matrices(filled: Problem, filled_operators: FullOperators) -> list[sparse.csc_matrix]:
    """Solids, fluids and a potential, at two frequencies: indefinite, and complex symmetric."""
    return [scaled(filled_operators, filled, frequency) for frequency in FREQUENCIES]


def upper(matrix: sparse.csc_matrix) -> sparse.csc_array:
    """The triangle that stands for a symmetric matrix."""
    return sparse.csc_array(sparse.triu(matrix, format="csc"))


def right_sides(size: int, count: int) -> Complex:
    real, imaginary = np.random.default_rng(6).standard_normal((2, size, count))
    return np.asarray(real + 1j * imaginary)


def test_one_pattern_serves_one_set_of_values_after_the_other(
    kind: Callable[[sparse.csc_array], Factorisation], matrices: list[sparse.csc_matrix]
) -> None:
    several = right_sides(matrices[0].shape[0], 3)
    known = kind(upper(matrices[0]))
    solves = [known(upper(matrix).data) for matrix in matrices]
    # The first still solves with its own values after the second was made.
    for matrix, solve in zip(matrices, solves, strict=True):
        for right in (several, several[:, 1]):
            found = solve(right)
            assert found.shape == right.shape
            # One solve without refinement: its backward error is the growth of the pivots times rounding.
            assert np.linalg.norm(matrix @ found - right) < 1e-10 * np.linalg.norm(right)
        assert solve(several)[:, 1] == pytest.approx(solve(several[:, 1]), rel=1e-9, abs=0.0)
    assert np.abs(solves[0](several) - solves[1](several)).max() > 0.1  # or this test says nothing


def test_any_layout_of_the_right_sides_is_taken(
    kind: Callable[[sparse.csc_array], Factorisation], matrices: list[sparse.csc_matrix]
) -> None:
    solve = kind(upper(matrices[0]))(upper(matrices[0]).data)
    several = right_sides(matrices[0].shape[0], 4)
    expected = solve(several)
    kept = several.copy()
    for other in (np.asfortranarray(several), np.repeat(several, 2, axis=1)[:, ::2]):
        assert np.array_equal(solve(other), expected)
    assert np.array_equal(several, kept)  # and is left alone
    assert np.array_equal(solve(several[:, 2]), solve(several[:, 2].copy()))


def test_it_is_reproducible_bit_for_bit(
    kind: Callable[[sparse.csc_array], Factorisation], matrices: list[sparse.csc_matrix]
) -> None:
    several = right_sides(matrices[0].shape[0], 2)
    triangles = [upper(matrix) for matrix in matrices]
    one, other = (kind(triangles[0]) for _ in range(2))
    first = one(triangles[0].data)(several)
    one(triangles[1].data)  # what comes between does not matter
    assert np.array_equal(one(triangles[0].data)(several), first)
    assert np.array_equal(other(triangles[0].data)(several), first)


def test_a_singular_matrix_is_not_solved_with(kind: Callable[[sparse.csc_array], Factorisation]) -> None:
    # A diagonal of ones, and yet two unknowns that are one: exactly, so that no rounding makes a pivot of it.
    whole = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], dtype=complex)
    triangle = sparse.csc_array(np.triu(whole))
    with pytest.raises(NotConverged):
        factorise(triangle, 1e5, kind(triangle)).solve(np.array([1.0, 2.0, 3.0]) + 0j)


def test_ldlt_and_superlu_agree(matrices: list[sparse.csc_matrix]) -> None:
    pytest.importorskip("rslab", reason="rslab is not installed: there is nothing to compare SuperLU with")
    several = right_sides(matrices[0].shape[0], 3)
    for matrix in matrices:
        one, other = (each(upper(matrix))(upper(matrix).data)(several) for each in (SuperLU, Ldlt))
        # Rounding times the condition of the scaled system, some 1e5 this far from a resonance.
        assert np.linalg.norm(one - other) < 1e-9 * np.linalg.norm(one)


def test_spectra_are_those_of_either(small_disc: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rslab", reason="rslab is not installed: there is nothing to compare SuperLU with")
    spectra = []
    for name in KNOWN:
        monkeypatch.setenv(FACTORISATION_VARIABLE, name)
        operators = assemble(small_disc.mesh, small_disc.terms)
        assert type(operators.factorisation) is KNOWN[name]
        spectra.append(solve_full(operators, np.array([350e3, 940e3]), small_disc.values).impedance)
    assert spectra[0] == pytest.approx(spectra[1], rel=1e-10, abs=0.0)


def test_the_environment_chooses_and_a_name_it_does_not_know_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FACTORISATION_VARIABLE, "superlu")
    assert chosen() == "superlu"
    assert isinstance(factorisation(sparse.csc_array(np.eye(3))), SuperLU)
    for wrong in ("SuperLU", "umfpack", ""):
        monkeypatch.setenv(FACTORISATION_VARIABLE, wrong)
        with pytest.raises(ValueError, match=rf"{FACTORISATION_VARIABLE} is '{wrong}'; expected one of superlu, rslab"):
            factorisation(sparse.csc_array(np.eye(3)))


def test_a_folder_that_happens_to_have_the_name_is_not_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(FACTORISATION_VARIABLE, raising=False)
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.delitem(sys.modules, "rslab", raising=False)
    assert chosen() == "superlu"
    (tmp_path / "rslab").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert chosen() == "superlu"
    (tmp_path / "rslab" / "__init__.py").touch()
    sys.path_importer_cache.clear()
    assert chosen() == "rslab"


@pytest.mark.skipif(importlib.util.find_spec("rslab") is None, reason="rslab is not installed")
def test_threads_that_come_and_go_may_all_factorise() -> None:
    # The library first loaded by a thread that ends; the next one crashed in its allocator.
    code = """
import threading
import numpy as np
from scipy import sparse
from workbench.fem.factorisation import Ldlt

def work():
    matrix = sparse.eye(500, format="csc", dtype=complex)
    Ldlt(matrix)(matrix.data)(np.ones(500))

for _ in range(3):
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
print("alive")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.returncode) == ("alive", 0)
