"""Resonances of a recording beside the modes of a model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from workbench.results.brief import Brief
from workbench.results.circuit import FittedResonance
from workbench.simulation.modes import ChipMode

#: Relative difference of frequencies, and ratio of coupling factors, that count equally.
DIFFERENCE, RATIO = 0.01, 3.0

#: Least Q k^2 of a mode without a partner that is listed: its peak of the conductance over w C_0. Modes of less are no
#: peaks of a recording.
VISIBLE = 0.1

#: Largest distance of a pair, in units of these. Doubled, modes 6 % apart are one.
FARTHEST = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class MatchedMode(Brief):
    """A resonance of a recording and the driven mode of the model.

    Either of them is None without a partner. ``beside`` is the mode nearest to a resonance without a partner, of any
    order; None if there is no mode within :data:`DIFFERENCE`.
    """

    recorded: FittedResonance | None
    mode: ChipMode | None
    beside: ChipMode | None = None

    @property
    def frequency(self) -> float:
        """That of the recording (Hz), or of the mode without one."""
        if self.recorded is not None:
            return self.recorded.frequency.value
        assert self.mode is not None
        return self.mode.frequency

    @property
    def difference(self) -> float | None:
        """Recorded over modelled frequency, less 1."""
        if self.recorded is None or self.mode is None:
            return None
        return self.recorded.frequency.value / self.mode.frequency - 1.0

    @property
    def q_ratio(self) -> float | None:
        """Recorded over modelled quality factor."""
        if self.recorded is None or self.mode is None:
            return None
        return self.recorded.q.value / self.mode.q

    @property
    def words(self) -> str:
        """The mode in words, or the reason for its absence."""
        if self.mode is not None:
            return self.mode.words if self.recorded is not None else f"not in the recording: {self.mode.words}"
        nearest = "" if self.beside is None else f"; nearest is {self.beside}"
        return f"no driven mode matches{nearest}"


def matched_modes(recorded: Sequence[FittedResonance], modes: Sequence[ChipMode]) -> tuple[MatchedMode, ...]:
    """Pairs of resonances and driven modes, by frequency.

    Those without a partner are listed too, modes only above :data:`VISIBLE`. The sum of squares of the distances of all
    pairs is smallest. A distance has the relative difference of frequencies over :data:`DIFFERENCE`, and the logarithm
    of the ratio of coupling factors over that of :data:`RATIO`.
    """
    driven = [mode for mode in modes if mode.is_driven]
    apart = np.array([[_distance(one, mode) for mode in driven] for one in recorded])
    apart = apart.reshape(len(recorded), len(driven))
    rows, columns = linear_sum_assignment(np.minimum(apart, FARTHEST) ** 2)
    partners = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if apart[i, j] < FARTHEST}
    found = [MatchedMode(one, driven[partners[i]]) if i in partners else MatchedMode(one, None, _beside(one, modes))
             for i, one in enumerate(recorded)]
    found += [MatchedMode(None, mode) for j, mode in enumerate(driven) if j not in partners.values()
              and mode.q * mode.k_eff**2 >= VISIBLE]
    return tuple(sorted(found, key=lambda each: each.frequency))


def _distance(recorded: FittedResonance, mode: ChipMode) -> float:
    """The distance of a pair.

    It is that of frequencies alone if the recorded coupling is within two standard errors of 0.
    """
    across = math.log(recorded.frequency.value / mode.frequency) / DIFFERENCE
    coupling = recorded.k_eff
    if not coupling.value > 2.0 * coupling.standard_error:
        return abs(across)
    return math.hypot(across, math.log(coupling.value / mode.k_eff) / math.log(RATIO))


def _beside(recorded: FittedResonance, modes: Sequence[ChipMode]) -> ChipMode | None:
    """The mode nearest in frequency, of any order."""
    at = recorded.frequency.value
    nearest = min(modes, key=lambda mode: abs(mode.frequency - at), default=None)
    return nearest if nearest is not None and abs(nearest.frequency / at - 1.0) <= DIFFERENCE else None
