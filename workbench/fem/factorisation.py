"""Sparse factorisations of complex-symmetric matrices that share one pattern.

The ordering of the unknowns depends only on the pattern and is computed once. SuperLU, a part of scipy, is the
reference. If `rslab` is installed, as it is by default, its LDL^T replaces it: it keeps the symmetry, which halves the
work, and its analysis of the pattern. On these meshes it takes a half to a fifth of the time
(`tests/benchmarks/factorisation.py`). Matrices are scaled to unit diagonal: without that SuperLU's symmetric mode takes
a hundred times as long.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from workbench.fem.sparsity import both_triangles
from workbench.jobs.memory import address_limit, confined, require

Complex = NDArray[np.complex128]
Integers = NDArray[np.int32]

#: Environment variable that names the factorisation. Without it, the installed packages decide.
FACTORISATION_VARIABLE = "WORKBENCH_FACTORISATION"


#: Address space (bytes) for the analysis of a pattern, and for each of its stored entries (12 are used). Doubled, the
#: threads of `rslab` have larger stacks in a limited address space.
ANALYSIS, ANALYSIS_OF_ENTRY = 100e6, 100.0

#: Address space for a factorisation, relative to the memory that `rslab` plans. Doubled, a factorisation that fits into
#: a limited address space may be refused.
PLANNED = 1.3


class Factorisation(Protocol):
    """A pattern, ready to be factorised for several sets of values."""

    def __call__(self, data: Complex) -> Callable[[Complex], Complex]:
        """Factorise the symmetric matrix with these upper entries (nnz,).

        The result solves for right-hand sides (n,) or (n, k).

        Raises:
            RuntimeError: the matrix is singular.
        """


class SuperLU:
    """SuperLU with threshold pivoting (0.01) in a minimum-degree order."""

    def __init__(self, triangle: sparse.csc_array) -> None:
        number = sparse.csc_array((np.arange(1, triangle.nnz + 1), triangle.indices, triangle.indptr),
                                  shape=triangle.shape)
        #: Both triangles, with the index of each entry in the upper one, from one.
        self._pattern = both_triangles(number).tocsc()

    def __call__(self, data: Complex) -> Callable[[Complex], Complex]:
        order, entries, indices, indptr = self._ordered
        matrix = sparse.csc_matrix((data[entries], indices, indptr), shape=self._pattern.shape)
        factor = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.01, options={"SymmetricMode": True})

        def solve(right: Complex) -> Complex:
            result = np.empty(right.shape, dtype=complex)
            result[order] = factor.solve(np.asfortranarray(right[order]))
            return result

        return solve

    @cached_property
    def _ordered(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Integers, Integers]:
        """The elimination order, and the pattern in that order. The pattern has the index and the row of each stored
        entry, and the starts of columns."""
        pattern = self._pattern
        column = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        # Diagonally dominant values need no pivots.
        dominant = np.where(pattern.indices == column, float(pattern.shape[0]), 1.0)
        found = splu(sparse.csc_matrix((dominant, pattern.indices, pattern.indptr), shape=pattern.shape),
                     permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        order = np.argsort(found.perm_c)
        ordered = pattern[order][:, order].tocsc()
        ordered.sort_indices()
        return order, ordered.data - 1, ordered.indices, ordered.indptr


class Ldlt:
    """The LDL^T factorisation of `rslab`: Bunch-Kaufman pivots within supernodes, multifrontal."""

    def __init__(self, triangle: sparse.csc_array) -> None:
        rslab = _lasting_rslab()
        # The upper triangle by rows is the lower one by columns, which rslab requires.
        number = sparse.csc_array((np.arange(triangle.nnz), triangle.indices, triangle.indptr), shape=triangle.shape)
        lower = number.tocsr()
        self._lower = lower.data
        ones = sparse.csc_matrix((np.ones(lower.nnz), lower.indices, lower.indptr), shape=lower.shape)
        # Each of its threads reserves a stack of 1 or 2 GB if possible.
        with confined(ANALYSIS + 2.0 * ANALYSIS_OF_ENTRY * triangle.nnz):
            self._analysis = rslab.analyze(ones, path="ldlt", ordering="amd")
        self._peak = PLANNED * self._analysis.memory_plan(dtype="complex128", threads=1)["peak_bytes"]

    def __call__(self, data: Complex) -> Callable[[Complex], Complex]:
        require(self._peak, "a factorisation")  # rslab ends the program if an allocation fails.
        factor = self._analysis.factor(data[self._lower], threads=1, scaling="identity")

        def solve(right: Complex) -> Complex:
            right = np.asarray(right, dtype=complex)
            if right.ndim == 1:
                return np.asarray(factor.solve(np.ascontiguousarray(right)))
            return np.asarray(factor.solve_many(np.asfortranarray(right)))

        return solve


def _lasting_rslab() -> ModuleType:
    """Load `rslab` in a thread that never ends. Its allocator keeps memory of the thread that loads it, and every later
    thread reads that memory. If a worker thread loads it and ends, the next factorisation in a new thread crashes
    (rslab 1.7). In a limited address space it reserves less memory."""
    if address_limit() is not None:
        os.environ.setdefault("MIMALLOC_ARENA_RESERVE", "32768")  # kB of address space, not 1 GB
    if "rslab" not in sys.modules and threading.current_thread() is not threading.main_thread():
        loaded, forever = threading.Event(), threading.Event()

        def load() -> None:
            try:
                with suppress(ImportError):  # raised again below
                    importlib.import_module("rslab")
            finally:
                loaded.set()
            forever.wait()

        threading.Thread(target=load, name="rslab", daemon=True).start()
        loaded.wait()
    return importlib.import_module("rslab")


#: Classes by the name of the package that they use.
KNOWN: Mapping[str, Callable[[sparse.csc_array], Any]] = {"superlu": SuperLU, "rslab": Ldlt}


def chosen() -> str:
    """The name of the factorisation in use.

    Raises:
        ValueError: the environment names an unknown one.
    """
    name = os.environ.get(FACTORISATION_VARIABLE)
    if name is None:
        found = importlib.util.find_spec("rslab")
        # A folder of that name is found too, but has no origin.
        return "rslab" if found is not None and found.origin is not None else "superlu"
    if name not in KNOWN:
        raise ValueError(f"{FACTORISATION_VARIABLE} is {name!r}; expected one of {', '.join(KNOWN)}")
    return name


def factorisation(triangle: sparse.csc_array) -> Factorisation:
    """The factorisation in use, for the pattern of an upper triangle. `triangle` (n, n) has sorted indices."""
    found: Factorisation = KNOWN[chosen()](triangle)
    return found
