"""Conditions on the free parameters of a material: it stores energy, and never makes any."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from materials.kinds import IsotropicSolid, Piezoelectric
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import LOSS
from workbench.model.problem import Problem
from workbench.search.constrained import Inequality

Real = NDArray[np.float64]

#: Poisson's ratio of a polymer sample, as Acevedo-Espinosa et al. (RP-UEIS), section 3.5, keeps it "within a realistic
#: range"; rubber approaches the upper end.
POISSON_RATIO = (0.1, 0.495)

#: One entry of a matrix: sum of (factor, coefficient).
_Sum = tuple[tuple[float, str], ...]


def inequalities(
    problems: Sequence[Problem], parameters: Sequence[Parameter], *, poisson: tuple[float, float] = POISSON_RATIO,
    recordings: Sequence[str] = (),
) -> tuple[Inequality, ...]:
    """Every condition on the free parameters that bounds alone do not state.

    Materials must be materials in each of the `recordings`, of which the `problems` are, with what is added there; and
    a number with what is added to it must keep to its own bounds.

    For a transversely isotropic piezoelectric solid the 9 x 9 matrices of stored energy and of dissipation fall apart
    into blocks of the motions that do not mix: plane dilatation with thickness and axial field, shear along the poling
    with transverse field, and shear across the poling.

    Raises:
        InputError: a coupling loss is free while a loss it needs is fixed at zero, which no passive solid can have.
    """
    result: list[Inequality] = []
    done: set[tuple[str, frozenset[str]]] = set()
    for problem, recording in zip(problems, recordings or [""] * len(problems), strict=True):
        acting = [p if p.acts_in(recording) else None for p in parameters]
        for material in problem.materials.values():
            added = frozenset(p.name for p in acting if p and p.offset and p.parsed.owner == material.name)
            if (material.name, added) in done:
                continue
            done.add((material.name, added))
            match material:
                case Piezoelectric():
                    found = _piezoelectric(problem, material.name, acting)
                case IsotropicSolid():
                    found = _isotropic(problem, material.name, acting, poisson)
                case _:
                    found = []
            result += [replace(each, name=f"{each.name} in {recording}") for each in found] if added else found
    return (*result, *_totals(parameters))


#: Parameters by their places; None for those that do not act in the recording.
_Acting = Sequence[Parameter | None]


def _totals(parameters: Sequence[Parameter]) -> Iterator[Inequality]:
    """The bounds of numbers with what one recording adds; those of the bench end nowhere in particular."""
    places = {p.name: i for i, p in enumerate(parameters) if not p.offset}
    for i, p in enumerate(parameters):
        if not p.offset or p.is_bench or p.parsed.shared not in places:
            continue
        k = places[p.parsed.shared]
        shared = parameters[k]
        slopes = np.zeros((len(parameters), 1, 1))
        slopes[[i, k]] = 1.0 / (shared.high - shared.low)
        for end, sign, text in ((shared.low, 1.0, "above"), (shared.high, -1.0, "below")):
            constant = np.array([[-sign * end / (shared.high - shared.low)]])
            yield Inequality(f"{shared.name} with {p.name} {text} {end:g}", constant, sign * slopes)


def _piezoelectric(problem: Problem, name: str, parameters: _Acting) -> list[Inequality]:
    size = complex(problem.values[f"{name}.c33"]).real
    root = math.sqrt(2.0)
    # The axial field in units that make its energy as large as that of the strain, as in `materials.passivity`.
    field = math.sqrt(size / (VACUUM_PERMITTIVITY * complex(problem.values[f"{name}.eps33"]).real))
    squared = VACUUM_PERMITTIVITY * field**2
    dilatation: list[list[_Sum]] = [
        [((1.0, "c11"), (1.0, "c12")), ((root, "c13"),)],
        [((root, "c13"),), ((1.0, "c33"),)],
    ]
    losses: list[list[_Sum]] = [
        [((-1.0, "c11"), (-1.0, "c12")), ((-root, "c13"),), ((root * field, "e31"),)],
        [((-root, "c13"),), ((-1.0, "c33"),), ((field, "e33"),)],
        [((root * field, "e31"),), ((field, "e33"),), ((squared, "eps33"),)],
    ]
    shear: list[list[_Sum]] = [
        [((-1.0, "c44"),), ((field, "e15"),)],
        [((field, "e15"),), ((squared, "eps11"),)],
    ]
    across: _Sum = ((1.0, "c11"), (-1.0, "c12"))
    blocks = [
        _block(problem, name, parameters, dilatation, "", size, "stored energy"),
        _block(problem, name, parameters, [[across]], "", size, "stored energy of shear across the poling"),
        _block(problem, name, parameters, losses, LOSS, size, "passivity"),
        _block(problem, name, parameters, shear, LOSS, size, "passivity of shear along the poling"),
        _block(problem, name, parameters, [[((-1.0, "c11"), (1.0, "c12"))]], LOSS, size,
               "passivity of shear across the poling"),
    ]
    return [block for block in blocks if block is not None]


def _block(
    problem: Problem, material: str, parameters: _Acting, entries: list[list[_Sum]], part: str,
    size: float, text: str,
) -> Inequality | None:
    """The matrix of `entries` over `size` as a function of the free parameters; None if none of them is in it."""
    count = len(entries)
    constant = np.zeros((count, count))
    slopes = np.zeros((len(parameters), count, count))
    for row in range(count):
        for column in range(count):
            for factor, coefficient in entries[row][column]:
                name = f"{material}.{coefficient}{part}"
                found = [(i, p.offset) for i, p in enumerate(parameters) if p and p.parsed.shared == name]
                for i, _ in found:
                    slopes[i, row, column] += factor / size
                if all(offset for _, offset in found):
                    value = complex(problem.values[f"{material}.{coefficient}"])
                    constant[row, column] += factor * (value.imag if part else value.real) / size
    if not slopes.any():
        return None
    # A motion that neither loses nor may lose: nothing of its row may be there.
    idle = [i for i in range(count) if constant[i, i] == 0.0 and not slopes[:, i, i].any()]
    for i in idle:
        if slopes[:, i].any() or constant[i].any():
            free = next((p.name for k, p in enumerate(parameters) if p and slopes[k, i].any()), material)
            needed = next(c for _, c in entries[i][i])
            raise InputError("fit", "free", free, f"{needed}{part} free or not zero: a loss of the coupling alone "
                             "would make energy")
    kept = [i for i in range(count) if i not in idle]
    return Inequality(f"{text} of {material}", constant[np.ix_(kept, kept)], slopes[:, kept][:, :, kept])


def _isotropic(
    problem: Problem, name: str, parameters: _Acting, poisson: tuple[float, float]
) -> list[Inequality]:
    size = complex(problem.values[f"{name}.bulk_modulus"]).real
    result = []
    for ratio, sign in ((poisson[0], 1.0), (poisson[1], -1.0)):
        # nu = (3 K - 2 G) / (2 (3 K + G)) above `ratio`: 3 K (1 - 2 ratio) - 2 G (1 + ratio) >= 0
        entry: _Sum = ((sign * 3.0 * (1.0 - 2.0 * ratio), "bulk_modulus"),
                       (-sign * 2.0 * (1.0 + ratio), "shear_modulus"))
        block = _block(problem, name, parameters, [[entry]], "", size,
                       f"Poisson's ratio {'above' if sign > 0 else 'below'} {ratio:g}")
        if block is not None:
            result.append(block)
    return result
