"""A fit of the numbers that were freed in the live view, to its one recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from workbench.app.elsewhere import Send
from workbench.app.session import Present
from workbench.fitting import joint
from workbench.fitting.objective import Recording
from workbench.fitting.prepare import prepare
from workbench.parameter_names import placed
from workbench.spectrum import Spectrum

#: Further descents at most, where the recording stays unexplained: a fit that somebody waits for is to end within some
#: tens of seconds. ``workbench fit`` tries 32.
TRIES = 4


@dataclass(frozen=True)
class Refit:
    """What a fit found: ``values`` and standard ``errors`` (SI) by name, the mean error of |Z| (per cent) ``before``
    and ``after``, and ``findings`` in words."""

    values: Mapping[str, float]
    errors: Mapping[str, float]
    before: float
    after: float
    findings: tuple[str, ...]


def refit(send: Send, present: Present, values: Mapping[str, float], measured: Spectrum, name: str) -> None:
    """Fit the numbers of which `values` (SI) are the present ones to a recording of that `name`, from these and from
    the chip's own; send what is being done, in words, and at last a :class:`Refit`.

    What was known before of a free number is what the `present` chip and its materials say.

    Raises:
        InputError: too few points in the band, or a recording that cannot be of this device.
        FitError: no start can be predicted.
    """
    prepared = prepare(present.chip, present.registry, kind="pzt", name=name, measured=measured, state=present.state,
                       free=tuple(values), band=present.band, accuracy=present.accuracy)

    def holding(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
        return tuple(replace(each, problem=each.problem.with_values(placed(each.problem.values, present.constants)))
                     for each in recordings)

    start = np.array([min(max(values[each.name], each.low), each.high) for each in prepared.parameters])
    found = joint.fit(holding(prepared.recordings), prepared.parameters, coarse=holding(prepared.coarse),
                      starts={"live view": start}, tries=TRIES, bands=0,
                      progress=lambda text, share: send(f"{text}, {100.0 * share:.0f} %"))
    (match,) = found.recordings
    send(Refit({each.parameter.name: each.value for each in found.estimates},
               {each.parameter.name: each.standard_error for each in found.estimates},
               match.before.mape_percent, match.after.mape_percent, found.findings))
