"""Algorithm 1 of Acevedo-Espinosa et al. (RP-UEIS), section 3.3: sensitivities.

Every real and every imaginary part is scaled from 0.7 to 1.3 of itself, one at a time; the cost is the sum of squares
of ln|Z| against the spectrum of the baseline (eq. 28), the index of a part the steepest slope of its cost (eq. 30).

Choices and corrections where the printed text is ambiguous or wrong:

- The two metrics, ln|Z| for real and ln|Y| for imaginary parts (eq. 26), are one: ln|Y| = -ln|Z|, so the costs are
  identical.
- The loops run over both parts of "N_p = 16 parameters", 1600 spectra. Table 1 counts real and imaginary parts among
  the sixteen, so 800 are distinct; these are computed.
- Eq. 30 takes the steepest slope of all scalings, the caption of Table 2 "the slope of the cost function near zero
  variation": see :meth:`Sensitivity.slopes`. Table 2 is normalised, separately for real and imaginary parts; the
  algorithm does not mention this.
- Imaginary parts are "not available" in Table 1, the baseline; only those of Table 3 (section 4.2) exist. A part that
  is zero in the baseline is zero at every scaling, so its index is zero and has no meaning: the losses of c12, c44 and
  eps33 in the paper's own baseline. Use a baseline with losses to rank them.

A change of 30 % moves many radial overtones through the band. The model of the baseline is extended for every part by
the spectra at both ends of its range (`predict.Predictor`), which mostly suffices in between. Every spectrum has an
error estimate, and the model is extended again where that is too large.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.names import TRANSDUCER
from materials.kinds import Piezoelectric
from workbench.fem.solve import one_thread
from workbench.files.errors import InputError, nearest_names
from workbench.fitting.parameter import coefficients_of
from workbench.model.numbers import LOSS, ParameterName, placed, real_part
from workbench.model.problem import Problem
from workbench.reduced.predictor import Predictor
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Values = Mapping[str, complex]

#: The parameters of Table 1: five stiffnesses and their losses, three piezoelectric constants, two permittivities, and
#: the loss of the axial one.
TABLE_ONE = ("c11", "c12", "c13", "c33", "c44", "c11.loss", "c12.loss", "c13.loss", "c33.loss", "c44.loss",
             "e31", "e33", "e15", "eps11", "eps33", "eps33.loss")

#: Table 2: normalised slopes. The last row is printed as a permittivity and means the shear piezoelectric constant.
TABLE_TWO: Mapping[str, float] = {
    "c33": 1.000, "c11": 0.564, "c13": 0.462, "c44": 0.331, "e33": 0.305, "eps33": 0.178, "e15": 0.121,
    "c33.loss": 1.000, "c11.loss": 0.539, "c13.loss": 0.442,
}

#: Least normalised slope of a part that is fitted: section 3.3.
REAL_THRESHOLD, LOSS_THRESHOLD = 0.1, 0.3


@dataclass(frozen=True)
class Rank:
    """One row of the ranking. ``slope`` is relative to the largest of its kind; ``kept`` is whether the part is
    fitted."""

    name: str
    slope: float
    kept: bool


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Brief):
    """The result of Algorithm 1.

    ``names`` (p) are full names of the parts, ``.loss`` for imaginary ones; ``baseline`` (p,) is in SI; ``scalings``
    (s,); ``costs`` (p, s) are eq. 28; ``local`` (p,) is the norm over the band of d ln|Z| / d ln(part) at the baseline,
    from the exact gradient; ``spectra`` is their number beside the reference and ``solves`` that of full solves;
    ``error`` is the largest estimated relative error of the impedances.
    """

    names: tuple[str, ...]
    baseline: Real
    scalings: Real
    costs: Real
    local: Real
    spectra: int
    solves: int
    seconds: float
    error: float

    @property
    def is_loss(self) -> NDArray[np.bool_]:
        return np.array([ParameterName.parse(name).is_loss for name in self.names])

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parts that are zero in the baseline, whose index has no meaning."""
        return tuple(name for name, value in zip(self.names, self.baseline, strict=True) if value == 0.0)

    def slopes(self, *, reach: float = np.inf) -> Real:
        """s_i of eq. 30 (p,): the steepest slope between neighbouring scalings.

        The equation takes all scalings; the caption of Table 2 has "near zero variation". With `reach`, only intervals
        whose middle is within it of 1 are used.
        """
        steep = np.abs(np.diff(self.costs, axis=1) / np.diff(self.scalings))
        middle = 0.5 * (self.scalings[1:] + self.scalings[:-1])
        near = np.abs(middle - 1.0) <= reach
        if not near.any():
            spacing = float(np.diff(self.scalings).max())
            raise ValueError(f"no interval of scalings within {reach:g} of 1; they are {spacing:.3g} apart")
        return np.asarray(steep[:, near].max(axis=1))

    def normalised(self, index: Real) -> Real:
        """An index (p,) over the largest of its kind, real or imaginary. It is zero if all of a kind are zero."""
        result = np.zeros(index.size)
        for kind in (self.is_loss, ~self.is_loss):
            if kind.any() and index[kind].max() > 0.0:
                result[kind] = index[kind] / index[kind].max()
        return result

    def ranking(
        self, *, reach: float = np.inf, real_threshold: float = REAL_THRESHOLD, loss_threshold: float = LOSS_THRESHOLD
    ) -> tuple[Rank, ...]:
        """Table 2: real parts, then imaginary parts, each ordered by slope."""
        slopes = self.normalised(self.slopes(reach=reach))
        rows = [Rank(name, float(slope), bool(slope >= (loss_threshold if loss else real_threshold)))
                for name, slope, loss in zip(self.names, slopes, self.is_loss, strict=True)]
        return tuple(sorted(rows, key=lambda row: (ParameterName.parse(row.name).is_loss, -row.slope)))

    def kept(self, *, reach: float = np.inf) -> tuple[str, ...]:
        """The parts above the printed thresholds, in the ranking's order."""
        return tuple(row.name for row in self.ranking(reach=reach) if row.kept)


@one_thread()
def sensitivity(
    problem: Problem,
    frequencies: Real,
    *,
    names: Sequence[str] = TABLE_ONE,
    baseline: Mapping[str, complex] | None = None,
    scalings: int = 50,
    low: float = 0.7,
    high: float = 1.3,
    relative_error: float = 1e-3,
    progress: Callable[[str, float], None] | None = None,
) -> Sensitivity:
    """Algorithm 1 for the transducer of a problem at `frequencies` (n,) Hz.

    Args:
        names: coefficients of the transducer's material, ``.loss`` for imaginary parts.
        baseline: complex values by full name, e^{-i w t}, in place of the problem's own.
        scalings: N_s, equally spaced from `low` to `high`.
        relative_error: bound on the estimated relative error of every impedance.
        progress: called with the name of the current step and the finished share.

    Raises:
        InputError: a name that is no coefficient of the transducer, or one given twice; fewer than two scalings; a
            range without 1.
        NotEnriched: the reduced model did not reach its error.
    """
    started = time.perf_counter()
    full_names = _full_names(problem, names)
    if scalings < 2:
        raise InputError("sensitivity", "scalings", scalings, "two or more")
    if not low < 1.0 < high:
        raise InputError("sensitivity", "range", f"{low:g} to {high:g}", "a range with 1 inside")
    if not 0.0 < relative_error < 1.0:
        raise InputError("sensitivity", "relative_error", relative_error, "a relative error between 0 and 1")
    values = problem.with_values(baseline or {}).values
    frequencies = np.asarray(frequencies, dtype=float)
    scaling = np.linspace(low, high, scalings)
    nominal = Predictor(problem, frequencies, tolerance=relative_error)
    # Well within that error, so that parts with a small effect need no further solve.
    reference = nominal.at(frequencies, 0.2 * relative_error)
    baseline_spectrum = reference(values)
    reference = reference.holding(baseline_spectrum.model)
    solves, error = reference.solves, float(baseline_spectrum.error.max())
    coefficients = tuple(dict.fromkeys(ParameterName.parse(name).key for name in full_names))
    gradient = baseline_spectrum.logarithmic_gradient(coefficients)
    parts = np.array([real_part(values, name) for name in full_names])
    local = np.zeros(parts.size)
    costs = np.zeros((parts.size, scalings))
    logarithm = np.log(np.abs(baseline_spectrum.impedance))
    for i, name in enumerate(full_names):
        if progress is not None:
            progress(name, i / len(full_names))
        parsed = ParameterName.parse(name)
        slope = gradient[:, coefficients.index(parsed.key)]
        # The derivative of ln Z by the imaginary part is i times that by the coefficient; ln|Z| is its real part.
        local[i] = float(np.linalg.norm(parts[i] * (1j * slope if parsed.is_loss else slope).real))
        spectra = reference.at(frequencies, relative_error)
        # From the ends inwards: a model that is accurate at both is mostly accurate in between.
        for j in sorted(range(scalings), key=lambda j: -abs(scaling[j] - 1.0)):
            spectrum = spectra(_scaled(values, name, float(scaling[j])))
            spectra = spectra.holding(spectrum.model)
            difference = np.log(np.abs(spectrum.impedance)) - logarithm
            costs[i, j] = float(difference @ difference)
            error = max(error, float(spectrum.error.max()))
        solves += spectra.solves
    return Sensitivity(full_names, parts, scaling, costs, local, costs.size, solves,
                       time.perf_counter() - started, error)


def _full_names(problem: Problem, names: Sequence[str]) -> tuple[str, ...]:
    material = problem.materials.get(TRANSDUCER)
    if not isinstance(material, Piezoelectric):
        raise InputError("sensitivity", "problem", problem.name, "a problem with a transducer")
    known = coefficients_of(problem, material.name)
    if not names:
        raise InputError("sensitivity", "names", "none", f"at least one of {', '.join(known)}")
    for name in names:
        coefficient = ParameterName.parse(name).key
        if coefficient not in known:
            raise InputError("sensitivity", "names", name,
                             f"a coefficient of {material.name}: {', '.join(known)}, each also with {LOSS!r}",
                             nearest_names(coefficient, known))
        if list(names).count(name) > 1:
            raise InputError("sensitivity", "names", name, "each part once")
    return tuple(f"{material.name}.{name}" for name in names)


def _scaled(values: Values, name: str, factor: float) -> Values:
    """`values` with one part multiplied by `factor`: eq. 29."""
    return placed(values, {name: factor * real_part(values, name)})
