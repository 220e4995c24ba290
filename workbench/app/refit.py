"""A fit of free parameters in the live view to its recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from workbench.app.session import Present
from workbench.fitting import joint
from workbench.fitting.objective import FitRecording
from workbench.fitting.parameter import Parameter
from workbench.fitting.prepare import prepare
from workbench.jobs.process import Send
from workbench.model.numbers import Stated, placed
from workbench.results.spectrum import Spectrum

#: Largest number of further descents if the recording stays unexplained: an interactive fit should end within a minute.
#: A film reaches its third optimum to either side. ``workbench fit`` tries 32.
TRIES = 12
#: Largest distance of a constant from its start, in standard uncertainties, as in `workbench.fitting.parameter`.
_REACH = 5.0


@dataclass(frozen=True)
class Refit:
    """Result of a fit. ``values`` and standard ``errors`` (SI) are by name, ``before`` and ``after`` are mean errors of
    |Z| in per cent, ``findings`` are in words."""

    values: Mapping[str, float]
    errors: Mapping[str, float]
    before: float
    after: float
    findings: tuple[str, ...]


def refit(
    send: Send, *, present: Present, values: Mapping[str, float], uncertainties: Mapping[str, float],
    measured: Spectrum, name: str,
) -> None:
    """Fit parameters to a recording, from present and file values.

    The activity is sent in words, and at last a :class:`Refit`. The prior of a free length is its tolerance in the
    `present` chip, or the one assumed by its role; that of a free constant is the standard one among `uncertainties`
    (SI), or that of its material. `values` (SI) are the free ones; `name` is that of the recording.

    Raises:
        InputError: too few points in the band, or a recording that cannot be of this device.
        FitError: no start can be predicted.
    """
    prepared = prepare(present.chip, present.registry, kind="pzt", name=name, measured=measured, state=present.state,
                       free=tuple(values), band=present.band, accuracy=present.accuracy)
    free = tuple(known_to(each, uncertainties.get(each.name)) for each in prepared.parameters)

    def holding(recordings: tuple[FitRecording, ...]) -> tuple[FitRecording, ...]:
        return tuple(replace(each, problem=each.problem.with_values(placed(each.problem.values, present.constants)))
                     for each in recordings)

    # Common parameters of all points of the recording are free too, but are not part of the result.
    start = np.array([min(max(values.get(each.name, each.start), each.low), each.high) for each in free])
    found = joint.fit_parameters(holding(prepared.recordings), free, coarse=holding(prepared.coarse),
                                 starts={"live view": start}, tries=TRIES, bands=0,
                                 progress=lambda text, share: send(f"{text}, {100.0 * share:.0f} %"))
    (match,) = found.recordings
    requested = [each for each in found.estimates if each.parameter.name in values]
    send(Refit({each.parameter.name: each.value for each in requested},
               {each.parameter.name: each.standard_error for each in requested},
               match.before.mape_percent, match.after.mape_percent, found.findings))


def known_to(parameter: Parameter, uncertainty: float | None) -> Parameter:
    """A material's `parameter` with a standard `uncertainty` (SI), if given. Its range is five of them. A loss keeps
    its bounds, and no parameter changes its sign."""
    if uncertainty is None:
        return parameter
    start, low, high = parameter.start, parameter.low, parameter.high
    if not parameter.is_loss:
        least = min(start, low) if low > 0.0 else -np.inf
        low, high = max(least, min(low, start - _REACH * uncertainty)), max(high, start + _REACH * uncertainty)
    return replace(parameter, stated=Stated(uncertainty, origin="live view"), low=low, high=high)
