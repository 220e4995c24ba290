"""Conditions on the free parameters of a passive material with positive energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from materials.kinds import IsotropicSolid, Piezoelectric
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.fitting.parameter import Parameter, coefficients_of
from workbench.model.numbers import LOSS
from workbench.model.problem import Problem
from workbench.search.constrained import Inequality

Real = NDArray[np.float64]

#: Poisson's ratio of a polymer sample, as Acevedo-Espinosa et al. (RP-UEIS), section 3.5, keeps it "within a realistic
#: range"; rubber approaches the upper end.
POISSON_RATIO = (0.1, 0.495)

#: Parameters by their columns; None for those that do not act in the recording.
_Acting = Sequence[Parameter | None]

#: Matrices by the name of their condition, linear in the coefficients of a material.
_Matrices = Callable[[Mapping[str, float]], dict[str, list[list[float]]]]


def inequalities(
    problems: Sequence[Problem], parameters: Sequence[Parameter], *, poisson: tuple[float, float] = POISSON_RATIO,
    recordings: Sequence[str] = (),
) -> tuple[Inequality, ...]:
    """Every condition on the free parameters that bounds alone do not state.

    Materials are admissible in each of the `recordings` of the `problems`, offsets included, and a number with its
    offset keeps to its own bounds. The 9 x 9 matrices of stored energy and of dissipation of a transversely isotropic
    piezoelectric solid fall apart into the blocks of motions that do not mix: plane dilatation with thickness and axial
    field, shear along the poling with transverse field, and shear across the poling.

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
            for each in _conditions(problem, material.name, acting, poisson):
                result.append(replace(each, name=f"{each.name} in {recording}") if added else each)
    return (*result, *_totals(parameters))


def _totals(parameters: Sequence[Parameter]) -> Iterator[Inequality]:
    """The bounds of parameters with their offsets in one recording. Bench elements have none."""
    columns = {p.name: i for i, p in enumerate(parameters) if not p.offset}
    for i, p in enumerate(parameters):
        if not p.offset or p.is_bench or p.parsed.shared not in columns:
            continue
        k = columns[p.parsed.shared]
        shared = parameters[k]
        slopes = np.zeros((len(parameters), 1, 1))
        slopes[[i, k]] = 1.0 / (shared.high - shared.low)
        for end, sign, text in ((shared.low, 1.0, "above"), (shared.high, -1.0, "below")):
            constant = np.array([[-sign * end / (shared.high - shared.low)]])
            yield Inequality(f"{shared.name} with {p.name} {text} {end:g}", constant, sign * slopes)


def _conditions(
    problem: Problem, name: str, parameters: _Acting, poisson: tuple[float, float]
) -> Iterator[Inequality]:
    """The conditions on the material of that name; none on a liquid."""
    def real(coefficient: str) -> float:
        return complex(problem.values[f"{name}.{coefficient}"]).real

    def stored(c: Mapping[str, float]) -> dict[str, list[list[float]]]:
        plane, mixed = c["c11"] + c["c12"], math.sqrt(2.0) * c["c13"]
        return {"stored energy": [[plane, mixed], [mixed, c["c33"]]],
                "stored energy of shear across the poling": [[c["c11"] - c["c12"]]]}

    def dissipated(c: Mapping[str, float]) -> dict[str, list[list[float]]]:
        plane, mixed = -c["c11"] - c["c12"], -math.sqrt(2.0) * c["c13"]
        # The axial field in units that make its energy as large as that of the strain, as in `materials.passivity`.
        field = math.sqrt(real("c33") / (VACUUM_PERMITTIVITY * real("eps33")))
        e31, e33, e15 = math.sqrt(2.0) * field * c["e31"], field * c["e33"], field * c["e15"]
        eps33, eps11 = (VACUUM_PERMITTIVITY * field**2 * c[key] for key in ("eps33", "eps11"))
        return {"passivity": [[plane, mixed, e31], [mixed, -c["c33"], e33], [e31, e33, eps33]],
                "passivity of shear along the poling": [[-c["c44"], e15], [e15, eps11]],
                "passivity of shear across the poling": [[c["c12"] - c["c11"]]]}

    def ratios(c: Mapping[str, float]) -> dict[str, list[list[float]]]:
        # nu = (3 K - 2 G) / (2 (3 K + G)) above `ratio`: 3 K (1 - 2 ratio) - 2 G (1 + ratio) >= 0
        above, below = (3.0 * (1.0 - 2.0 * ratio) * c["bulk_modulus"] - 2.0 * (1.0 + ratio) * c["shear_modulus"]
                        for ratio in poisson)
        return {f"Poisson's ratio above {poisson[0]:g}": [[above]], f"Poisson's ratio below {poisson[1]:g}": [[-below]]}

    match next(m for m in problem.materials.values() if m.name == name):
        case Piezoelectric():
            yield from _blocks(problem, name, parameters, stored, "", real("c33"))
            yield from _blocks(problem, name, parameters, dissipated, LOSS, real("c33"))
        case IsotropicSolid():
            yield from _blocks(problem, name, parameters, ratios, "", real("bulk_modulus"))


def _blocks(
    problem: Problem, material: str, parameters: _Acting, matrices: _Matrices, part: str, size: float
) -> Iterator[Inequality]:
    """The conditions of `matrices`, over `size`, on free parameters, by their `part`."""
    own = [p if p and p.parsed.owner == material and p.is_loss == bool(part) else None for p in parameters]
    replaced = {p.parsed.coefficient for p in own if p and not p.offset}
    none = dict.fromkeys(coefficients_of(problem, material), 0.0)
    values = {key: complex(problem.values[f"{material}.{key}"]) for key in none}
    fixed = matrices({key: 0.0 if key in replaced else value.imag if part else value.real
                      for key, value in values.items()})
    by_parameter = [matrices({**none, p.parsed.coefficient: 1.0} if p else none) for p in own]
    for text, matrix in fixed.items():
        constant, slopes = np.array(matrix) / size, np.array([each[text] for each in by_parameter]) / size
        if not slopes.any():
            continue
        # A motion that neither loses nor may lose: nothing of its row may be there.
        idle = [i for i in range(len(matrix)) if constant[i, i] == 0.0 and not slopes[:, i, i].any()]
        for i in idle:
            if slopes[:, i].any() or constant[i].any():
                free = next((p.name for k, p in enumerate(own) if p and slopes[k, i].any()), material)
                needed = next(key for key in none if matrices({**none, key: 1.0})[text][i][i])
                raise InputError("fit", "free", free, f"{needed}{part} free or not zero: a loss of the coupling alone "
                                 "would make energy")
        kept = [i for i in range(len(matrix)) if i not in idle]
        yield Inequality(f"{text} of {material}", constant[np.ix_(kept, kept)], slopes[:, kept][:, :, kept])
