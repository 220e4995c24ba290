"""Which parameters a spectrum depends on: Algorithm 1 of Acevedo-Espinosa et al. (RP-UEIS), section 3.3, as printed.

Every real and every imaginary part is scaled from 0.7 to 1.3 of itself, one at a time; the cost is the sum of squares
of ln|Z| against the spectrum of the baseline (eq. 28), the index of a part the steepest slope of its cost (eq. 30).

The algorithm's two metrics, ln|Z| for real and ln|Y| for imaginary parts (eq. 26), are one: ln|Y| = -ln|Z|, so the
costs are identical. A part that is zero in the baseline stays zero however it is scaled, so its index is zero by
construction and says nothing: the losses of c12, c44 and eps33 in the paper's own baseline. Give a baseline with losses
to rank them.

A change of 30 % carries many radial overtones through the band. A reduced model made at the baseline knows nothing of
them; one made at both ends of a part's range as well serves what lies between (:class:`_Ranged`), and is then narrowed
to what the spectra in between need. Every spectrum comes with its error estimate, and is enriched where that is too
large.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.names import TRANSDUCER
from inputs import InputError, nearest_names
from materials.kinds import Piezoelectric
from workbench.fit.parameter import LOSS
from workbench.operators import FullOperators, assemble
from workbench.problem import Problem
from workbench.reduce import ReducedModel, narrowed, reduce
from workbench.solve import Solution

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Values = Mapping[str, complex]

#: The sixteen of Table 1: five stiffnesses and their losses, three piezoelectric constants, two permittivities, and the
#: loss of the axial one.
TABLE_ONE = ("c11", "c12", "c13", "c33", "c44", "c11.loss", "c12.loss", "c13.loss", "c33.loss", "c44.loss",
             "e31", "e33", "e15", "eps11", "eps33", "eps33.loss")

#: Table 2: normalised slopes. The last row is printed as a permittivity and means the shear piezoelectric constant.
TABLE_TWO: Mapping[str, float] = {
    "c33": 1.000, "c11": 0.564, "c13": 0.462, "c44": 0.331, "e33": 0.305, "eps33": 0.178, "e15": 0.121,
    "c33.loss": 1.000, "c11.loss": 0.539, "c13.loss": 0.442,
}

#: Parts whose normalised slope is below are dropped: section 3.3.
REAL_THRESHOLD, LOSS_THRESHOLD = 0.1, 0.3

#: Points of a part's range whose states decide what its narrowed basis keeps, and how small a share it drops.
SAMPLES, UNNEEDED = 7, 1e-7


@dataclass(frozen=True)
class Rank:
    """One row of the ranking: a part's full name, its slope over the largest of its kind, and whether it is kept."""

    name: str
    slope: float
    kept: bool


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What Algorithm 1 found.

    ``names`` (p) full names of the parts, ``.loss`` for imaginary ones; ``baseline`` (p,) SI; ``scalings`` (s,);
    ``costs`` (p, s), eq. 28; ``local`` (p,) the norm over the band of d ln|Z| / d ln(part) at the baseline, from the
    exact gradient; ``spectra`` computed beside the reference and full ``solves`` spent; ``seconds``; ``error`` the
    largest estimated relative error of any of the spectra's impedances.
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
        return np.array([name.endswith(LOSS) for name in self.names])

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parts that are zero in the baseline: no scaling moves them, so their index of zero says nothing."""
        return tuple(name for name, value in zip(self.names, self.baseline, strict=True) if value == 0.0)

    def slopes(self, *, reach: float = np.inf) -> Real:
        """s_i of eq. 30 (p,): the steepest slope of the cost between neighbouring scalings.

        The equation takes all scalings; the caption of Table 2 says "near zero variation". With `reach`, only those
        intervals count whose middle is within it of 1.
        """
        steep = np.abs(np.diff(self.costs, axis=1) / np.diff(self.scalings))
        middle = 0.5 * (self.scalings[1:] + self.scalings[:-1])
        near = np.abs(middle - 1.0) <= reach
        if not near.any():
            spacing = float(np.diff(self.scalings).max())
            raise ValueError(f"no interval of scalings within {reach:g} of 1; they are {spacing:.3g} apart")
        return np.asarray(steep[:, near].max(axis=1))

    def normalised(self, index: Real) -> Real:
        """An index (p,) over the largest of the real and of the imaginary parts; zero where all of a kind are zero."""
        result = np.zeros(index.size)
        for kind in (self.is_loss, ~self.is_loss):
            if kind.any() and index[kind].max() > 0.0:
                result[kind] = index[kind] / index[kind].max()
        return result

    def ranking(
        self, *, reach: float = np.inf, real_threshold: float = REAL_THRESHOLD, loss_threshold: float = LOSS_THRESHOLD
    ) -> tuple[Rank, ...]:
        """Table 2: real parts in order of their slope, then imaginary parts in order of theirs."""
        slopes = self.normalised(self.slopes(reach=reach))
        rows = [Rank(name, float(slope), bool(slope >= (loss_threshold if loss else real_threshold)))
                for name, slope, loss in zip(self.names, slopes, self.is_loss, strict=True)]
        return tuple(sorted(rows, key=lambda row: (row.name.endswith(LOSS), -row.slope)))

    def kept(self, *, reach: float = np.inf) -> tuple[str, ...]:
        """The parts above the printed thresholds, in the order of the ranking."""
        return tuple(row.name for row in self.ranking(reach=reach) if row.kept)


def sensitivity(
    problem: Problem,
    frequencies: Real,
    *,
    names: Sequence[str] = TABLE_ONE,
    baseline: Mapping[str, complex] | None = None,
    scalings: int = 50,
    low: float = 0.7,
    high: float = 1.3,
    tolerance: float = 1e-3,
    progress: Callable[[str, float], None] | None = None,
) -> Sensitivity:
    """Algorithm 1 for the transducer of a problem at `frequencies` (n,) Hz.

    Args:
        names: coefficients of the transducer's material, ``.loss`` for imaginary parts.
        baseline: complex values by full name, e^{-i w t}, in place of the problem's own.
        scalings: N_s, equally spaced from `low` to `high`.
        tolerance: bound on the estimated relative error of every impedance.
        progress: called with the part's name and the share done.

    The printed loops run over both parts of sixteen parameters, 1600 spectra; the sixteen are themselves real and
    imaginary parts, so 800 are distinct and 800 are computed.

    Raises:
        InputError: a name that is no coefficient of the transducer, or one given twice; fewer than two scalings; a
            range that does not hold 1.
        NotEnriched: the reduced model did not reach the tolerance.
    """
    started = time.perf_counter()
    full_names = _full_names(problem, names)
    if scalings < 2:
        raise InputError("sensitivity", "scalings", scalings, "two or more")
    if not low < 1.0 < high:
        raise InputError("sensitivity", "range", f"{low:g} to {high:g}", "a range with 1 inside")
    if not 0.0 < tolerance < 1.0:
        raise InputError("sensitivity", "tolerance", tolerance, "a relative error between 0 and 1")
    values = problem.with_values(baseline or {}).values
    frequencies = np.asarray(frequencies, dtype=float)
    scaling = np.linspace(low, high, scalings)
    operators = assemble(problem.mesh, problem.terms)
    nominal = reduce(operators, frequencies, values, tolerance=0.5 * tolerance)
    reference = nominal.solve(frequencies, values)
    coefficients = tuple(dict.fromkeys(name.removesuffix(LOSS) for name in full_names))
    gradient = reference.parameter_gradient(values, coefficients) / reference.impedance[:, None]
    parts = np.array([_part(values, name) for name in full_names])
    local = np.zeros(parts.size)
    costs = np.zeros((parts.size, scalings))
    error, solves = float(nominal.error(reference).max()), nominal.solves
    for i, name in enumerate(full_names):
        if progress is not None:
            progress(name, i / len(full_names))
        slope = gradient[:, coefficients.index(name.removesuffix(LOSS))]
        # By the imaginary part d ln Z is i times that by the coefficient, and ln|Z| is the real part of ln Z.
        local[i] = float(np.linalg.norm(parts[i] * (1j * slope if name.endswith(LOSS) else slope).real))
        model = _Ranged(nominal, operators, frequencies, values, name, (low, high), tolerance)
        for j, factor in enumerate(scaling):
            solution, estimate = model(float(factor))
            difference = np.log(np.abs(reference.impedance)) - np.log(np.abs(solution.impedance))
            costs[i, j] = float(difference @ difference)
            error = max(error, estimate)
        solves += model.solves
    return Sensitivity(full_names, parts, scaling, costs, local, costs.size, solves,
                       time.perf_counter() - started, error)


class _Ranged:
    """Spectra of one part scaled within a range: a narrow model, behind it the wide one, behind that full solves."""

    def __init__(
        self, nominal: ReducedModel, operators: FullOperators, frequencies: Real, values: Values, name: str,
        ends: tuple[float, float], tolerance: float,
    ) -> None:
        self.operators, self.frequencies, self.values, self.name = operators, frequencies, values, name
        self.tolerance, self._first = tolerance, nominal.solves
        self.wide = self.narrow = nominal
        # What the nominal model holds at both ends it holds in between: losses, and whatever hardly matters.
        if not all(self._fits(self._of(nominal, end)) for end in ends):
            for end in ends:
                if not self._fits(self._of(self.wide, end)):
                    self._enrich(end)
            samples = [self._of(self.wide, float(at))[0].states for at in np.linspace(*ends, SAMPLES)]
            self.narrow, _ = narrowed(self.wide, np.concatenate(samples, axis=1), UNNEEDED)

    @property
    def solves(self) -> int:
        return self.wide.solves - self._first

    def __call__(self, factor: float) -> tuple[Solution, float]:
        """The spectrum with the part at `factor` times itself, and its largest estimated relative error."""
        found = self._of(self.narrow, factor)
        if not self._fits(found):
            found = self._of(self.wide, factor)
        if not self._fits(found):
            self._enrich(factor)
            found = self._of(self.wide, factor)
        return found

    def _of(self, model: ReducedModel, factor: float) -> tuple[Solution, float]:
        solution = model.solve(self.frequencies, _scaled(self.values, self.name, factor))
        return solution, float(model.error(solution).max())

    def _fits(self, found: tuple[Solution, float]) -> bool:
        return found[1] <= self.tolerance

    def _enrich(self, factor: float) -> None:
        # A tangent keeps the basis whole, besides being of use on the way to the other end.
        self.wide = reduce(self.operators, self.frequencies, _scaled(self.values, self.name, factor),
                           tolerance=0.5 * self.tolerance, tangents=(self.name.removesuffix(LOSS),), start=self.wide)


def _full_names(problem: Problem, names: Sequence[str]) -> tuple[str, ...]:
    material = problem.materials.get(TRANSDUCER)
    if not isinstance(material, Piezoelectric):
        raise InputError("sensitivity", "problem", problem.name, "a problem with a transducer")
    known = [key.removeprefix(f"{material.name}.") for key in problem.values if key.startswith(f"{material.name}.")]
    if not names:
        raise InputError("sensitivity", "names", "none", f"at least one of {', '.join(known)}")
    for name in names:
        if name.removesuffix(LOSS) not in known:
            raise InputError("sensitivity", "names", name,
                             f"a coefficient of {material.name}: {', '.join(known)}, each also with {LOSS!r}",
                             nearest_names(name.removesuffix(LOSS), known))
        if list(names).count(name) > 1:
            raise InputError("sensitivity", "names", name, "each part once")
    return tuple(f"{material.name}.{name}" for name in names)


def _part(values: Values, name: str) -> float:
    value = complex(values[name.removesuffix(LOSS)])
    return value.imag if name.endswith(LOSS) else value.real


def _scaled(values: Values, name: str, factor: float) -> Values:
    """`values` with one part at `factor` times itself: eq. 29."""
    coefficient = name.removesuffix(LOSS)
    old = complex(values[coefficient])
    new = complex(old.real, factor * old.imag) if name.endswith(LOSS) else complex(factor * old.real, old.imag)
    return {**values, coefficient: new}
