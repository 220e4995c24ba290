"""The fixed parameters of a fit: their sensitivities, and their uncertainty's effect.

The uncertainty of a fixed parameter is the stated one, or for a constant of the fitted material that of its kind
(`parameter`). An error dh of it moves the optimum of the others by dx = -(J^T J + P)^-1 J^T J_h dh, with the
sensitivities J and J_h of both and the precisions P of the priors. The covariance of a fit includes these moves
(Schmidt 1966, Application of state-space methods to navigation problems).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from materials.kinds import IsotropicSolid, Material, Piezoelectric
from workbench.fitting.noise import REPEATED, Noise
from workbench.fitting.objective import FitRecording, Objective, Residual
from workbench.fitting.parameter import Parameter, dimension_parameter, material_parameter
from workbench.model.device_numbers import coefficient_number
from workbench.model.hidden import hidden_coefficients
from workbench.model.numbers import LOSS, real_part
from workbench.model.problem import Problem

Real = NDArray[np.float64]

#: A number is determined, or shown, if the data narrow its prior by this factor or more.
NARROWED = 2.0

#: Relative error of the reduced model that sensitivities are taken from.
STARTING = 1e-2

#: Least share of the residual's square for which a refusal proposes to free a fixed parameter.
ABSORBED = 0.1

#: Losses without which a loss of a coupling constant would make energy.
_NEEDED = {"c12": ("c11",), "c13": ("c11", "c33"), "e31": ("c11", "eps33"), "e33": ("c33", "eps33"),
           "e15": ("c44", "eps11")}


@dataclass(frozen=True)
class HeldNumber:
    """A fixed ``parameter`` of a fit, with its value and standard uncertainty.

    ``moved`` names the estimate that its uncertainty moves most, by the ``part`` of the standard error. To first order
    freeing it alone removes a ``share`` of the residual's square, and freeing it beside the parameters proposed before
    it removes ``taken``, 0 if it is not proposed.
    """

    parameter: Parameter
    moved: str
    part: float
    share: float
    taken: float


def constants(problem: Problem, material: Material) -> tuple[Parameter, ...]:
    """The constants of a solid, except density: real parts, then losses."""
    hidden = hidden_coefficients(problem)
    names = [key for key, value in material.parameters().items()
             if key != "density" and (full := f"{material.name}.{key}") in problem.values and full not in hidden
             and value.real != 0.0]
    return tuple(material_parameter(problem, material.name, name + part) for part in ("", LOSS) for name in names)


def shown(recording: FitRecording, candidates: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """The candidates whose prior a recording would narrow by :data:`NARROWED`, each alone.

    If it shows only a combination of some, all of them are among these. They are at their start.
    """
    objective = Objective.of([recording], (), tolerance=STARTING).with_parameters(candidates)
    noise = Noise.of(recording.measured)
    deviation = [noise.shape if noise.stated else REPEATED]
    slopes = objective(np.array([p.start for p in candidates]), deviation=deviation).jacobian
    gains = 1.0 + np.sum((slopes * np.array([p.scale for p in candidates])) ** 2, axis=0)
    names = {p.parsed.local for p, gain in zip(candidates, gains, strict=True) if gain >= NARROWED**2}
    needed = {key + LOSS for name in names if name.endswith(LOSS) for key in _NEEDED.get(name.removesuffix(LOSS), ())}
    return tuple(p for p in candidates if p.parsed.local in names | needed)


def held_numbers(recordings: Sequence[FitRecording], free: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """All uncertain parameters that a fit keeps fixed, each once.

    For a solid with a free constant these are all others, except a density that the chip states as weighed; for all
    others, lengths included, those with an uncertainty stated in a file.
    """
    names = {name for p in free for name in p.names}
    fitted = {p.parsed.owner for p in free if p.is_material}
    by_name: dict[str, Parameter] = {}
    for recording in recordings:
        for material in {m.name: m for m in recording.problem.materials.values()}.values():
            for p in _constants_of(recording, material, is_fitted=material.name in fitted):
                by_name.setdefault(p.name, p)
        chip = recording.chip
        lengths = [] if chip is None else [dimension_parameter(chip, name) for name, dimension
                                           in chip.dimensions().items() if dimension.tolerance]
        for p in lengths:
            by_name.setdefault(p.name, p)
    return tuple(p for p in by_name.values() if names.isdisjoint(p.names))


def _constants_of(recording: FitRecording, material: Material, *, is_fitted: bool) -> Iterator[Parameter]:
    problem, made = recording.problem, list[Parameter]()
    if is_fitted and isinstance(material, Piezoelectric | IsotropicSolid):
        made += constants(problem, material)
        regions = [region for region, m in problem.materials.items() if m.name == material.name]
        if recording.chip is None or not any(layer.density is not None for layer in recording.chip.layers
                                             if layer.region in regions):
            made.append(material_parameter(problem, material.name, "density"))
    else:
        made += [material_parameter(problem, material.name, name) for key in material.parameters()
                 for name in (key, key + LOSS)
                 if f"{material.name}.{key}" in problem.values and coefficient_number(material, name).stated]
    for p in made:
        # An unstated loss starts above zero if it is free, and is zero if it is fixed.
        value = real_part(problem.values, p.name)
        yield replace(p, value=value, low=min(p.low, value), high=max(p.high, value))


def held_moves(
    objective: Objective, x: Real, held: Sequence[Parameter], deviation: Sequence[Real], data: Residual,
    covariance: Real,
) -> tuple[Real, Real]:
    """Moves of residual and optimum by the uncertainty of fixed parameters. They are (2 n, h) and (p, h).

    Args:
        data: the residual at the optimum, with points of that `deviation`.
        covariance: (p, p) of the data and the priors.
    """
    is_length = np.array([p.is_dimension for p in held], dtype=bool)
    # Recordings may have different values of one name: a sensitivity is to an offset from each value.
    others = [replace(p, offset=True) for p in held if not p.is_dimension]
    lengths = [p for p in held if p.is_dimension]
    result = np.zeros((data.vector.size, len(held)))
    if others:
        there = objective.with_parameters(others)(np.append(x, np.zeros(len(others))), deviation=deviation)
        result[:, ~is_length] = there.jacobian[:, x.size:]
    if lengths:
        # The model has no way to move them: one of meshes that give way is made for this point.
        giving = Objective.of(objective.recordings, (*objective.parameters, *lengths), tolerance=STARTING)
        result[:, is_length] = giving(np.append(x, [p.start for p in lengths]),
                                      deviation=deviation).jacobian[:, x.size:]
    result *= np.array([p.scale for p in held])
    return result, np.asarray(-covariance @ (data.jacobian.T @ result))


def judge_held(
    data: Residual, moves: Real, by_held: Real, errors: Real, free: Sequence[Parameter], held: Sequence[Parameter]
) -> tuple[HeldNumber, ...]:
    """The fixed parameters, by their effect on the residual, largest first.

    `moves` (p, h) and standard `errors` (p,) are of the `free` parameters. Parameters are proposed one after the other,
    each beside those before it, while one absorbs :data:`ABSORBED` of the residual's square.
    """
    left = by_held + data.jacobian @ moves
    matrix, slopes = np.eye(len(held)) + left.T @ left, left.T @ data.vector
    whole = float(data.vector @ data.vector) or 1.0
    alone = slopes**2 / np.diag(matrix) / whole
    taken = np.zeros(len(held))
    for _ in held:
        gains = np.divide(slopes**2, whole * np.diag(matrix), out=np.zeros(len(held)), where=taken == 0.0)
        best = int(np.argmax(gains))
        if gains[best] < ABSORBED:
            break
        taken[best] = gains[best]
        # The unknown is eliminated: its own row and column become zero.
        slopes = slopes - matrix[best] * slopes[best] / matrix[best, best]
        matrix = matrix - np.outer(matrix[best], matrix[best]) / matrix[best, best]
    result = []
    for i in np.argsort(-alone, kind="stable"):
        # A parameter at its bound has no error to divide by.
        parts = np.divide(np.abs(moves[:, i]), errors, out=np.zeros(errors.size), where=errors > 0.0)
        worst = int(np.argmax(parts))
        result.append(HeldNumber(held[i], free[worst].name, float(parts[worst]), float(alone[i]), float(taken[i])))
    return tuple(result)
