"""Algorithm 2 and the polymer fit of Acevedo-Espinosa et al. (RP-UEIS).

Sections 3.4 and 3.5, as printed, for comparison; `workbench.fitting.joint` is the fit to use. Nelder and Mead's simplex
has the defaults of ``fminsearch``: a first simplex of 5 %, both tolerances 1e-4, 200 steps and spectra per variable. A
point that is not admissible has an infinite cost, as in ``fminsearchcon``. Variables are relative to their values at
the start of their block, since the paper does not give the unit of the tolerance on them.

Choices and corrections where the printed text is ambiguous or wrong:

- C_ref is set before any window is chosen. It is the cost in the window of the later iterations, to which section 3.4
  restricts all data. The cost of the first iteration, in its narrow window, is compared with it as printed, so the 5 %
  rule is meaningful only from the third iteration on.
- The metric of block B is not named: that of block A. ln|Y| = -ln|Z|, so that the impedance metric of blocks A and B
  and the admittance metric of block C and of polymers are the same cost anyway (eq. 26).
- Eq. 13 is imposed in block C only. Blocks A and B have no constraint: a parameter with little effect in the window may
  run off while the cost still falls (:attr:`PaperFit.strayed`).
- The loss of c13 has no sign of its own. It starts positive, as Table 3 prints it; the other two start negative.
- No limit of iterations is printed; there is one here.
- The window of a polymer is +-10 % (section 3.5 and Table 4; section 4.3 has 12 %) about f0. Table 4 has it "centered
  at 1.033 MHz", the resonance of the disc alone; here it is the resonance of the fitted recording, as in Algorithm 2,
  to which section 3.5 refers.
- The text wants all moduli of a polymer "strictly positive"; with e^{-i w t}, and in Table 4, a loss is negative.
- Poisson's ratio, the real part of the complex one, is to be "within a realistic range", which is not given:
  `admissible.POISSON_RATIO` is used. The starting moduli are not given either: those of the problem are used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geometry.names import TRANSDUCER
from materials.conversions import young_and_poisson
from materials.kinds import IsotropicSolid, Piezoelectric
from workbench.fem.solve import NotConverged
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import frequency_text
from workbench.fitting.admissible import POISSON_RATIO, inequalities
from workbench.fitting.objective import FitRecording
from workbench.fitting.parameter import CERAMIC_LOSS, POLYMER_FOUR, TRANSDUCER_TEN, Parameter, parameters
from workbench.jobs.progress import Progress
from workbench.model.numbers import LOSS, ParameterName, placed
from workbench.model.problem import Problem
from workbench.reduced.at_point import NotEnriched
from workbench.reduced.predictor import Predictor
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The first constraint that values by full name violate, in words; empty if none.
Broken = Callable[[Mapping[str, float]], str]

#: Blocks of Algorithm 2.
BLOCKS: Mapping[str, tuple[str, ...]] = {
    "A": ("c11", "c13", "c33", "c44"), "B": ("e15", "e33", "eps33"), "C": ("c11.loss", "c13.loss", "c33.loss"),
}

#: Half windows about the measured resonance, relative: Algorithm 2 in its first iteration and after it; section 3.5.
FIRST_WINDOW, WINDOW, POLYMER_WINDOW = 0.03, 0.12, 0.10

#: Algorithm 2 ends when the cost changes by less than this (relative) from one iteration to the next.
STOP = 0.05

#: fminsearch: first simplex, relative; tolerances on variables and on the cost, absolute; steps and spectra per
#: variable.
SIMPLEX, SIMPLEX_AT_ZERO, TOLERANCE, STEPS = 0.05, 0.00025, 1e-4, 200

#: Relative change from the start above which a real part has run off: no data sheet has such an error.
STRAYED = 0.5

#: Relative rounding error of an eigenvalue that is zero.
ROUNDING = 1e-12

CONVERGED = "the simplex met both tolerances"


@dataclass(frozen=True)
class SimplexRun:
    """One run of the simplex. ``window`` is in Hz with ``points`` in it; ``start`` and ``cost`` are the costs at its
    start and end; ``reason`` is that of its end."""

    name: str
    iteration: int
    window: tuple[float, float]
    points: int
    start: float
    cost: float
    spectra: int
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class PaperFit(Brief):
    """The result of an algorithm of the paper.

    ``values`` and ``start`` are by full parameter name, SI, losses e^{-i w t}; ``resonance`` (Hz) is the measured
    minimum of |Z|; ``frequency`` (n,) Hz and ``impedance`` (n,) ohm, e^{+j w t}, are the spectrum of ``values`` in the
    last window; ``mape_percent`` is the error of its |Z|; ``costs`` are C_ref and the cost after every iteration,
    ``changes`` the err of every iteration; ``spectra`` is the number of spectra and ``solves`` that of full solves for
    them; ``inadmissible`` and ``unpredicted`` count points of infinite cost, due to a constraint or without a spectrum
    of the model.
    """

    values: Mapping[str, float]
    start: Mapping[str, float]
    resonance: float
    frequency: Real
    impedance: Complex
    mape_percent: float
    blocks: tuple[SimplexRun, ...]
    costs: tuple[float, ...]
    changes: tuple[float, ...]
    spectra: int
    solves: int
    inadmissible: int
    unpredicted: int
    seconds: float
    converged: bool
    reason: str

    @property
    def strayed(self) -> tuple[str, ...]:
        """Real parts that ended more than :data:`STRAYED` from their start."""
        return tuple(name for name, value in self.values.items() if not ParameterName.parse(name).is_loss
                     and abs(value - self.start[name]) > STRAYED * abs(self.start[name]))


def fit_transducer(
    recording: FitRecording,
    *,
    start: Mapping[str, float] | None = None,
    relative_error: float = 1e-3,
    limit: int = 20,
    progress: Progress | None = None,
) -> PaperFit:
    """Algorithm 2: ten parameters of the transducer, block by block.

    All losses except the three of block C are set to zero, all other real parts stay as they are in the problem. Ctrl-C
    ends the fit with the best point so far, once there is one; ``reason`` reports it.

    Args:
        start: real numbers by name (``c33``, ``c33.loss``) in place of those of the problem's material. A loss of zero
            is unknown and starts at a thousandth of the real part (section 4.2).
        relative_error: of the reduced model's impedance.
        limit: iterations; the paper sets none.
        progress: may raise KeyboardInterrupt.

    Raises:
        InputError: the problem has no transducer, the recording shows no resonance or too few points about it, or the
            start has an unknown name or makes energy.
        NotEnriched: the reduced model did not reach its error at the start.
    """
    problem = recording.problem
    found = problem.materials.get(TRANSDUCER)
    if not isinstance(found, Piezoelectric):
        raise InputError("fit", "problem", problem.name, "a problem with a transducer")
    material = found.name
    coefficients = [f"{material}.{name}" for name in found.parameters()]
    lossless = problem.with_values({name: complex(problem.values[name].real) for name in coefficients})
    free = parameters(problem, None, material, TRANSDUCER_TEN)
    begin = _started(free, material, start or {})
    coupling = f"{material}.c13"
    if begin[coupling + LOSS] == 0.0:
        # `parameters` does not know its sign.
        begin[coupling + LOSS] = CERAMIC_LOSS * begin[coupling]
    losses = [p for p in free if p.is_loss]
    search = _Search(recording, lossless, begin, _passive(lossless, losses), relative_error, progress)
    costs: list[float] = []
    changes: list[float] = []
    reason, converged = f"the limit of {limit} iterations was reached", False
    try:
        search.look_at(WINDOW)
        costs.append(search.cost())
        for iteration in range(1, limit + 1):
            search.look_at(FIRST_WINDOW if iteration == 1 else WINDOW)
            for name, members in BLOCKS.items():
                search.descend(name, iteration, [f"{material}.{member}" for member in members])
            costs.append(search.cost())
            changes.append(abs(costs[-1] - costs[-2]) / abs(costs[-2]) if costs[-2] else 0.0)
            if changes[-1] < STOP:
                reason, converged = f"the cost changed by {100.0 * changes[-1]:.2g} %, less than 5 %", True
                break
    except KeyboardInterrupt:
        if not costs:
            raise
        reason = f"stopped by the user, {search.place}"
    except (NotEnriched, NotConverged) as error:
        if not costs:
            raise
        reason = f"no spectrum {search.place}: {error}"
    return search.result(costs, changes, converged, reason)


def fit_polymer(
    recording: FitRecording,
    material: str,
    *,
    start: Mapping[str, float] | None = None,
    poisson: tuple[float, float] = POISSON_RATIO,
    relative_error: float = 1e-3,
    progress: Progress | None = None,
) -> PaperFit:
    """Section 3.5: bulk and shear modulus of a sample, with losses.

    All are fitted together, with a known transducer.

    Args:
        material: full name of the sample's material.
        start: real numbers by name (``bulk_modulus``, ``shear_modulus.loss``) in place of those of the problem.
        poisson: bounds of the real part of Poisson's ratio.
        relative_error, progress: see :func:`fit_transducer`, also for Ctrl-C.

    Raises:
        InputError: no such material or one that is no isotropic solid, a start outside the constraints, and see
            :func:`fit_transducer`.
        NotEnriched: the reduced model did not reach its error at the start.
    """
    problem = recording.problem
    solids = [m.name for m in problem.materials.values() if isinstance(m, IsotropicSolid)]
    if material not in solids:
        raise InputError("fit", "material", material,
                         f"an isotropic solid of the problem: {', '.join(solids) or 'there is none'}",
                         nearest_names(material, solids))
    if not -1.0 < poisson[0] < poisson[1] < 0.5:
        raise InputError("fit", "Poisson's ratio", f"{poisson[0]:g} to {poisson[1]:g}", "a range between -1 and 0.5")
    free = parameters(problem, None, material, POLYMER_FOUR)
    begin = _started(free, material, start or {})
    search = _Search(recording, problem, begin, _realistic(material, poisson), relative_error, progress)
    costs: list[float] = []
    reason, converged = "", False
    try:
        search.look_at(POLYMER_WINDOW)
        costs.append(search.cost())
        block = search.descend("polymer", 1, list(begin))
        costs.append(block.cost)
        reason, converged = block.reason, block.reason == CONVERGED
    except KeyboardInterrupt:
        if not costs:
            raise
        reason = f"stopped by the user, {search.place}"
    return search.result(costs, [], converged, reason)


def _started(free: Sequence[Parameter], material: str, start: Mapping[str, float]) -> dict[str, float]:
    known = {p.parsed.within(material): p for p in free}
    for name, value in start.items():
        if name not in known:
            raise InputError("fit", "start", name, f"one of {', '.join(known)}", nearest_names(name, known))
        if not np.isfinite(value):
            raise InputError("fit", f"start of {name}", value, "a finite number")
    return {p.name: float(start.get(name, p.start)) for name, p in known.items()}


def _passive(problem: Problem, losses: Sequence[Parameter]) -> Broken:
    """Eq. 13: the loss matrices have no negative eigenvalue."""
    conditions = inequalities([problem], losses)

    def broken(values: Mapping[str, float]) -> str:
        x = np.array([values[p.name] for p in losses])
        return next((c.name for c in conditions if c.margin(x) < -ROUNDING), "")

    return broken


def _realistic(material: str, poisson: tuple[float, float]) -> Broken:
    """The constraints of section 3.5 on moduli, losses and Poisson's ratio."""
    names = [f"{material}.{name}" for name in POLYMER_FOUR]

    def broken(values: Mapping[str, float]) -> str:
        for name in names:
            is_loss = ParameterName.parse(name).is_loss
            if not (values[name] < 0.0 if is_loss else values[name] > 0.0):
                return f"{name} {'below' if is_loss else 'above'} zero"
        bulk, shear = (complex(values[f"{material}.{name}"], values[f"{material}.{name}{LOSS}"])
                       for name in ("bulk_modulus", "shear_modulus"))
        ratio = young_and_poisson(bulk, shear)[1].real
        if ratio < poisson[0]:
            return f"Poisson's ratio above {poisson[0]:g}"
        return f"Poisson's ratio below {poisson[1]:g}" if ratio > poisson[1] else ""

    return broken


class _Search:
    """The present point of the algorithm, its window and its spectra."""

    def __init__(
        self, recording: FitRecording, problem: Problem, start: Mapping[str, float], broken: Broken,
        relative_error: float, progress: Progress | None,
    ) -> None:
        self.began = time.perf_counter()
        self.problem, self.measured = problem, recording.measured
        self.start, self.broken, self.relative_error, self.progress = dict(start), broken, relative_error, progress
        if why := broken(start):
            raise InputError("fit", "start", ", ".join(f"{k} = {v:.4g}" for k, v in start.items()),
                             f"admissible values: {why}")
        magnitude = np.abs(self.measured.impedance)
        lowest = int(np.argmin(magnitude))
        self.resonance = float(self.measured.frequency[lowest])
        if lowest in (0, magnitude.size - 1):
            raise InputError("fit", "recording", f"{recording.name}: the least |Z| at "
                             f"{frequency_text(self.resonance)}, its end", "a recording with the resonance inside")
        self.values = dict(start)
        self.spectra = self.inadmissible = self.unpredicted = 0
        self.blocks: list[SimplexRun] = []
        self.place = "before the first block"
        self._models: dict[float, Predictor] = {}
        self._window = 0.0
        self._seen: tuple[Real, Complex] | None = None

    def look_at(self, window: float) -> None:
        """Use the measured points within `window` (relative) of the resonance."""
        self._window = window
        if window not in self._models:
            frequency = self.measured.frequency[self._points]
            if frequency.size < len(self.start):
                raise InputError("fit", "recording", f"{frequency.size} points within {100.0 * window:g} % of "
                                 f"{frequency_text(self.resonance)}",
                                 f"at least as many as parameters, {len(self.start)}")
            moved = tuple(dict.fromkeys(ParameterName.parse(name).key for name in self.start))
            self._models[window] = Predictor(self.problem, frequency, tangents=moved, tolerance=self.relative_error)

    @property
    def _points(self) -> NDArray[np.bool_]:
        return np.abs(self.measured.frequency / self.resonance - 1.0) <= self._window

    def spectrum(self, values: Mapping[str, float]) -> Complex:
        prediction = self._models[self._window](placed(self.problem.values, values))
        self._models[self._window] = self._models[self._window].holding(prediction.model)
        return prediction.impedance

    def cost(self) -> float:
        """Eq. 28 at the present values."""
        self.spectra += 1
        impedance = self.spectrum(self.values)
        self._seen = (self.measured.frequency[self._points], impedance)
        return self._cost_of(impedance)

    def _cost_of(self, impedance: Complex) -> float:
        difference = np.log(np.abs(self.measured.impedance[self._points])) - np.log(np.abs(impedance))
        return float(difference @ difference)

    def descend(self, name: str, iteration: int, names: Sequence[str]) -> SimplexRun:
        """Run the simplex over `names` from the present values."""
        self.place = f"in block {name} of iteration {iteration}"
        unit = np.array([abs(self.values[n]) or 1.0 for n in names])
        first = np.array([self.values[n] for n in names]) / unit
        spectra, before = self.spectra, self.cost()
        base, best = dict(self.values), before

        def function(x: Real) -> float:
            nonlocal best
            values = {**base, **dict(zip(names, map(float, x * unit), strict=True))}
            if self.broken(values):
                self.inadmissible += 1
                return np.inf
            self.spectra += 1
            try:
                impedance = self.spectrum(values)
            except (NotEnriched, NotConverged):
                self.unpredicted += 1
                return np.inf
            cost = self._cost_of(impedance)
            if cost < best:
                # Stored at once, so that a stop does not lose it.
                self.values, best = values, cost
                self._seen = (self.measured.frequency[self._points], impedance)
            if self.progress is not None:
                self.progress(self.place, best)
            return cost

        found = minimize(function, first, method="Nelder-Mead", options={
            "initial_simplex": simplex(first), "xatol": TOLERANCE, "fatol": TOLERANCE,
            "maxiter": STEPS * first.size, "maxfev": STEPS * first.size})
        window = self.measured.frequency[self._points]
        block = SimplexRun(name, iteration, (float(window[0]), float(window[-1])), window.size, before, best,
                           self.spectra - spectra, CONVERGED if found.success else "the limit of spectra was reached")
        self.blocks.append(block)
        return block

    def result(self, costs: Sequence[float], changes: Sequence[float], converged: bool, reason: str) -> PaperFit:
        frequency, impedance = self._seen or (np.zeros(0), np.zeros(0, dtype=complex))
        measured = self.measured.impedance[np.isin(self.measured.frequency, frequency)]
        ratio = np.abs(impedance) / np.abs(measured)
        mape = 100.0 * float(np.mean(np.abs(ratio - 1.0))) if frequency.size else np.nan
        return PaperFit(
            self.values, self.start, self.resonance, frequency, impedance, mape, tuple(self.blocks), tuple(costs),
            tuple(changes), self.spectra, sum(m.solves for m in self._models.values()), self.inadmissible,
            self.unpredicted, time.perf_counter() - self.began, converged, reason)


def simplex(start: Real) -> Real:
    """The first simplex (n + 1, n) of ``fminsearch``. It has the start, and then each variable 5 % larger."""
    corners = np.tile(start, (start.size + 1, 1))
    for i, value in enumerate(start):
        corners[i + 1, i] = (1.0 + SIMPLEX) * value if value != 0.0 else SIMPLEX_AT_ZERO
    return corners
