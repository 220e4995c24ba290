"""One step of a stiff integrator for many small systems. Each system has its own step.

RODAS (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd edition 1996, section IV.10): a Rosenbrock
method of order 4 with an embedded one of order 3, L-stable, six values of the right side and one exact Jacobian a step.
Fast motion that has decayed does not limit the step, so seconds of levitation and minutes of gathering cost the same.
The stiff integrators of scipy take about as long for particles that nothing stops (`tests/benchmarks/beads.py`), but
have one step and one history for all, which end whenever one particle reaches a wall.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from workbench.acoustics.nodal import FloatArray

#: Order of the embedded solution plus one: the error is proportional to this power of the step.
ERROR_ORDER = 4
#: Safety factor of the step, and smallest and largest change of a step. With doubled changes more steps fail.
SAFETY, LEAST_CHANGE, LARGEST_CHANGE = 0.9, 0.2, 6.0

_GAMMA = 0.25
_A = ((1.544,),
      (0.9466785280815826, 0.2557011698983284),
      (3.314825187068521, 2.896124015972201, 0.9986419139977817),
      (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950))
_C = ((-5.6688,),
      (-2.430093356833875, -0.2063599157091915),
      (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
      (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
      (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054))


def rosenbrock_step(
    right: Callable[[FloatArray], FloatArray], place: FloatArray, slope: FloatArray, jacobian: FloatArray,
    step: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The places (K, n) after a step, and their errors. The `step` is (K,), the estimated errors are (K, n). The system
    is dx/dt = right(x) from `place` (K, n); `slope` (K, n) and `jacobian` (K, n, n) are those of `right` there."""
    count = place.shape[1]
    inverse = np.linalg.inv(np.eye(count) / (step * _GAMMA)[:, None, None] - jacobian)

    def solved(value: FloatArray) -> FloatArray:
        return np.asarray((inverse @ value[:, :, None])[:, :, 0])

    stages = [solved(slope)]
    for a, c in zip(_A, _C, strict=False):
        at = place + sum(weight * stage for weight, stage in zip(a, stages, strict=True))
        stages.append(solved(right(at) + sum(w * stage for w, stage in zip(c, stages, strict=True)) / step[:, None]))
    # The last two stages differ only by the embedded solution (stiffly accurate).
    at = at + stages[-1]
    error = solved(right(at) + sum(w * stage for w, stage in zip(_C[-1], stages, strict=True)) / step[:, None])
    return at + error, error


def next_step(step: FloatArray, error: FloatArray) -> FloatArray:
    """The step (K,) after one with a relative `error` (K,)."""
    with np.errstate(divide="ignore"):
        change = SAFETY * error ** (-1.0 / ERROR_ORDER)
    return np.asarray(step * np.clip(np.nan_to_num(change, nan=LEAST_CHANGE), LEAST_CHANGE, LARGEST_CHANGE))
