"""Which parameters a spectrum depends on: Algorithm 1 of Acevedo-Espinosa et al. (RP-UEIS), section 3.3, as printed.

Every real and every imaginary part is scaled from 0.7 to 1.3 of itself, one at a time; the cost is the sum of squares
of ln|Z| against the spectrum of the baseline (eq. 28), the index of a part the steepest slope of its cost (eq. 30).

Where the printed text leaves a choice or errs:

- The two metrics, ln|Z| for real and ln|Y| for imaginary parts (eq. 26), are one: ln|Y| = -ln|Z|, so the costs are
  identical.
- The loops run over both parts of "N_p = 16 parameters", 1600 spectra. Table 1 counts real and imaginary parts among
  the sixteen, so that 800 are distinct; these are computed.
- Eq. 30 takes the steepest slope of all scalings, the caption of Table 2 "the slope of the cost function near zero
  variation": see :meth:`Sensitivity.slopes`. Table 2 is normalised, which the algorithm does not say, for real and
  imaginary parts apart.
- Imaginary parts are "not available" in Table 1, the baseline; those of Table 3 (section 4.2) are what there is. A part
  that is zero in the baseline stays zero however it is scaled, so its index is zero by construction and says nothing:
  the losses of c12, c44 and eps33 in the paper's own baseline. Give a baseline with losses to rank them.

A change of 30 % carries many radial overtones through the band. A reduced model made at the baseline knows nothing of
them; with a full solve or two at either end of a part's range in its basis it serves what lies between, since the model
is affine in the one part that moves. It is then narrowed to what the spectra in between need. Every spectrum comes with
its error estimate, and is enriched where that is too large.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from geometry.names import TRANSDUCER
from inputs import InputError, nearest_names
from materials.kinds import Piezoelectric
from workbench.fit.parameter import LOSS, part, placed
from workbench.operators import FullOperators, assemble, frequency_groups
from workbench.problem import Problem
from workbench.reduce import NotEnriched, estimated_error, needed, new_directions, reduce
from workbench.solve import System, one_thread, solve_dense

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

#: Vectors taken from each factorisation at a scaled part: they cost a twentieth of it, and have to span the band.
DEPTH = 24

#: Full solves for one part, or for one spectrum of it that the basis of its range does not hold.
LIMIT = 40

#: Points of a part's range whose states decide what its narrowed basis keeps, and how small a share it drops.
SAMPLES, UNNEEDED = 7, 1e-6


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
    nominal = _Nominal(assemble(problem.mesh, problem.terms), frequencies, values, tolerance)
    coefficients = tuple(dict.fromkeys(name.removesuffix(LOSS) for name in full_names))
    gradient = nominal.reference.parameter_gradient(values, coefficients) / nominal.reference.impedance[:, None]
    parts = np.array([part(values, name) for name in full_names])
    local = np.zeros(parts.size)
    costs = np.zeros((parts.size, scalings))
    # |Z| = 1 / (w |Q|), so that ln|Q| serves for ln|Z|.
    reference = np.log(np.abs(nominal.reference.charge))
    error, solves = nominal.error, nominal.model.solves
    for i, name in enumerate(full_names):
        if progress is not None:
            progress(name, i / len(full_names))
        slope = gradient[:, coefficients.index(name.removesuffix(LOSS))]
        # By the imaginary part d ln Z is i times that by the coefficient, and ln|Z| is the real part of ln Z.
        local[i] = float(np.linalg.norm(parts[i] * (1j * slope if name.endswith(LOSS) else slope).real))
        spectrum = _Range(nominal, name, (low, high))
        for j, factor in enumerate(scaling):
            charge, estimate = spectrum(float(factor))
            difference = np.log(np.abs(charge)) - reference
            costs[i, j] = float(difference @ difference)
            error = max(error, estimate)
        solves += spectrum.solves
    return Sensitivity(full_names, parts, scaling, costs, local, costs.size, solves,
                       time.perf_counter() - started, error)


@dataclass(frozen=True, eq=False)
class _Line:
    """A reduced model along one part: A(w, s) = sum_g h_g(w) (fixed_g + (s - 1) moving_g), s the scaling of the part.

    ``factors`` h_g(w) (groups, n); ``basis`` (size, r), its lift last; ``fixed`` and ``moving`` (groups, r +
    PROJECTIONS, r) with rows for the basis and below them for the random projections of the residual.
    """

    factors: Complex
    basis: Real
    fixed: Complex
    moving: Complex

    def __call__(self, scaling: float) -> tuple[Complex, Complex, Real]:
        """States (r, n) at a scaling, charge (n,) for 1 V, and its estimated relative error (n,)."""
        whole = self.fixed + (scaling - 1.0) * self.moving
        rank = whole.shape[2]
        states, _ = solve_dense(self.factors, whole[:, :rank])
        image = np.einsum("gn,gin->in", self.factors, whole @ states)
        charge = -np.sum(states * image[:rank], axis=0)
        return states, charge, estimated_error(image[rank:], charge)

    def narrowed(self, states: Complex) -> _Line:
        """On the directions of the basis that `states` (r, n) need."""
        within, rank = needed(states, UNNEEDED), len(states)

        def inside(matrices: Complex) -> Complex:
            matrices = matrices @ within
            return np.concatenate([within.T @ matrices[:, :rank], matrices[:, rank:]], axis=1)

        return replace(self, basis=self.basis @ within, fixed=inside(self.fixed), moving=inside(self.moving))

    def extended(
        self, new: Real, test: Real, fixed: Sequence[csc_matrix], moving: Sequence[csc_matrix | None]
    ) -> _Line:
        """With columns `new` (size, k) before the lift; `fixed` and `moving` by group, None for a matrix of zeros."""
        rank, count = self.basis.shape[1], new.shape[1]
        order = np.concatenate([np.arange(rank - 1), rank + np.arange(count), [rank - 1]])

        def grown(known: Complex, matrix: csc_matrix | None) -> Complex:
            result = np.zeros((len(known) + count, rank + count), dtype=complex)
            image = np.zeros(new.shape, dtype=complex) if matrix is None else matrix @ new
            cross = self.basis.T @ image
            result[:rank, :rank], result[rank + count:, :rank] = known[:rank], known[rank:]
            result[:rank, rank:], result[rank:rank + count, :rank] = cross, cross.T
            result[rank:rank + count, rank:], result[rank + count:, rank:] = new.T @ image, test.T @ image
            return result[np.concatenate([order, np.arange(rank + count, len(result))])][:, order]

        return replace(
            self, basis=np.column_stack([self.basis, new])[:, order],
            fixed=np.stack([grown(k, m) for k, m in zip(self.fixed, fixed, strict=True)]),
            moving=np.stack([grown(k, m) for k, m in zip(self.moving, moving, strict=True)]))


class _Nominal:
    """The reduced model at the baseline, from which every part is moved.

    ``reference`` its spectrum, ``error`` the largest estimated relative error of it; ``test`` (size, PROJECTIONS) what
    residuals are projected on, as in `reduce`, with every unknown in the unit of ``weights`` (size,).
    """

    def __init__(self, operators: FullOperators, frequencies: Real, values: Values, tolerance: float) -> None:
        self.operators, self.frequencies, self.values, self.tolerance = operators, frequencies, values, tolerance
        # Well within the tolerance, so that what hardly moves the spectrum needs no solve of its own.
        self.model = reduce(operators, frequencies, values, tolerance=0.2 * tolerance)
        self.reference = self.model.solve(frequencies, values)
        self.error = float(self.model.error(self.reference).max())
        self.weights, self.test = self.model.weights, self.model.test
        self._rows = np.concatenate([self.model.operators.matrices, self.model.sketch], axis=1)

    @cached_property
    def system(self) -> System:
        return System(self.operators, self.values)

    def line(self, name: str) -> _Line:
        """The reduced model of the baseline with one part free to move."""
        groups = frequency_groups(self.operators.integrals, 2.0 * np.pi * self.frequencies, self.values)
        doubled = frequency_groups(self.operators.integrals, np.ones(1), _scaled(self.values, name, 2.0))
        fixed = np.stack([constants for _, constants in groups])
        moving = np.stack([constants for _, constants in doubled]) - fixed
        return _Line(np.stack([h for h, _ in groups]), self.model.basis, np.tensordot(fixed, self._rows, axes=1),
                     np.tensordot(moving, self._rows, axes=1))


class _Range:
    """Spectra of one part scaled within a range: a narrow model, behind it the wide one, behind that full solves.

    ``solves`` counts the full solves spent on it.
    """

    def __init__(self, nominal: _Nominal, name: str, ends: tuple[float, float]) -> None:
        self.nominal, self.name, self.solves = nominal, name, 0
        self.wide = self.narrow = nominal.line(name)
        self._systems: dict[float, System] = {}
        self._enrich(ends)
        if self.solves:
            states = [self.wide(float(at))[0] for at in np.linspace(*ends, SAMPLES)]
            self.narrow = self.wide.narrowed(np.concatenate(states, axis=1))

    def __call__(self, scaling: float) -> tuple[Complex, float]:
        """The charge (n,) with the part at `scaling` times itself, and its largest estimated relative error."""
        for line in (self.narrow, self.wide):
            _, charge, error = line(scaling)
            if error.max() <= self.nominal.tolerance:
                return charge, float(error.max())
        self._enrich((scaling,))
        _, charge, error = self.wide(scaling)
        return charge, float(error.max())

    def _enrich(self, scalings: Sequence[float]) -> None:
        """Full solves, each where the estimate is largest of all `scalings` and frequencies, until it is small enough.

        What the basis holds at both ends of a range it mostly holds in between.
        """
        for _ in range(LIMIT):
            found = [self.wide(scaling) for scaling in scalings]
            worst = int(np.argmax([error.max() for _, _, error in found]))
            error = found[worst][2]
            index = int(np.argmax(error))
            if error[index] <= self.nominal.tolerance:
                return
            self._solve(scalings[worst], index)
        raise NotEnriched(float(error.max()), self.nominal.tolerance, self.solves)

    def _solve(self, scaling: float, index: int) -> None:
        """Take a full solve with its neighbours into the basis."""
        nominal, coefficient = self.nominal, self.name.removesuffix(LOSS)
        frequency = float(nominal.frequencies[index])
        if scaling not in self._systems:
            self._systems[scaling] = System(nominal.operators, _scaled(nominal.values, self.name, scaling))
        system = self._systems[scaling]
        states, _ = system.krylov(frequency, DEPTH, tangents=(coefficient,))
        self.solves += 1
        fixed = nominal.system.group_matrices()
        # The model is affine in every coefficient of the transducer: two points make the line.
        moving = [None if np.array_equal(there, here) else (far - near) / (scaling - 1.0)
                  for there, here, far, near in zip(system.constants, nominal.system.constants,
                                                    system.group_matrices(), fixed, strict=True)]
        new = new_directions(self.wide.basis, states, nominal.weights)
        self.wide = self.wide.extended(new, nominal.test, fixed, moving)


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


def _scaled(values: Values, name: str, factor: float) -> Values:
    """`values` with one part at `factor` times itself: eq. 29."""
    return placed(values, {name: factor * part(values, name)})
