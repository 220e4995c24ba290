"""Element matrices of a body by their media, and how they add up to one sparse matrix at any frequency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from concealed.fields import scales
from concealed.media import Anything
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Block:
    """Cells or edges of one medium: (cells, k) unknowns, -1 where zero, and a real matrix for each coefficient; the
    relative ``field`` (cells,) of every kind of :mod:`fields` where it is not homogeneous, and which cells of the grid
    these are (none: edges)."""

    medium: Anything
    unknowns: Integers
    matrices: Mapping[str, Real]
    field: Mapping[str, Real] | None = None
    cells: tuple[Integers, Integers] | None = None

    def scaled(self, name: str, coefficient: complex) -> Any:
        """The coefficient of every cell (cells, 1, 1), or of all."""
        if self.field is None:
            return coefficient
        real, imaginary = scales(name, self.field)
        return (coefficient.real * real + 1j * coefficient.imag * imaginary)[:, None, None]


@dataclass(frozen=True, eq=False)
class Model:
    """Blocks and the number of unknowns; the last one is the voltage of the live electrode."""

    blocks: tuple[Block, ...]
    size: int

    @cached_property
    def pattern(self) -> Pattern:
        kept, rows, columns = [], [], []
        for block in self.blocks:
            shape = (*block.unknowns.shape, block.unknowns.shape[1])
            row = np.broadcast_to(block.unknowns[:, :, None], shape)
            column = np.broadcast_to(block.unknowns[:, None, :], shape)
            kept.append((row >= 0) & (column >= 0))
            rows.append(row[kept[-1]])
            columns.append(column[kept[-1]])
        places, entry = np.unique(np.concatenate(columns) * self.size + np.concatenate(rows), return_inverse=True)
        return Pattern(tuple(kept), entry, places % self.size, places // self.size,
                       np.searchsorted(places, np.arange(self.size + 1) * self.size))

    @cached_property
    def fixed(self) -> Fixed:
        """What is the same at all frequencies, added up once."""
        data, size = np.zeros(self.pattern.row.size, dtype=complex), np.zeros(self.size + 1)
        varying = []
        start = 0
        for block, counted in zip(self.blocks, self.pattern.kept, strict=True):
            stop = start + np.count_nonzero(counted)
            places, entry = np.unique(self.pattern.entry[start:stop], return_inverse=True)
            start = stop
            # A coefficient that is one number is so at all frequencies.
            coefficients = block.medium.coefficients(np.ones(1))
            whole = np.zeros(counted.shape, dtype=complex)
            for name, matrix in block.matrices.items():
                diagonal = np.abs(np.einsum("cii->ci", matrix)).ravel()
                added = np.bincount(block.unknowns.ravel() % size.size, diagonal, size.size)
                if np.ndim(coefficients[name]) == 0:
                    scale = block.scaled(name, complex(coefficients[name]))
                    whole += scale * matrix
                    size += abs(coefficients[name]) * added
                else:
                    parts = [np.bincount(entry, (part * matrix)[counted]) for part in
                             (np.real(block.scaled(name, 1.0 + 0j)), np.imag(block.scaled(name, 1j)))]
                    varying.append(Varying(block, name, places, parts[0], parts[1], added))
            data[places] += np.bincount(entry, whole.real[counted]) + 1j * np.bincount(entry, whole.imag[counted])
        return Fixed(data, size, tuple(varying))


@dataclass(frozen=True, eq=False)
class Pattern:
    """Which entries of the element matrices count, where each goes among those of the csc matrix, and row, column and
    column starts of these."""

    kept: tuple[NDArray[np.bool_], ...]
    entry: Integers
    row: Integers
    column: Integers
    starts: Integers


@dataclass(frozen=True, eq=False)
class Varying:
    """One coefficient of a block that changes with the frequency: where its matrix goes among the entries of the csc
    matrix, what its real and its imaginary part are multiplied by there, and its share (size + 1,) of the scale."""

    block: Block
    name: str
    places: Integers
    real: Real
    imaginary: Real
    size: Real


@dataclass(frozen=True, eq=False)
class Fixed:
    """Entries of the csc matrix and scale (size + 1,) that are the same at all frequencies, and those that are not."""

    data: Complex
    size: Real
    varying: tuple[Varying, ...]
