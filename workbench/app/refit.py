"""A fit of the numbers that were freed in the live view, to its one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.app.background import Say, Stopped
from workbench.app.section_fields import moved_chip
from workbench.app.session import Session
from workbench.fitting import joint
from workbench.fitting.objective import Recording
from workbench.fitting.prepare import prepare
from workbench.parameter_names import Kind, ParameterName, placed
from workbench.spectrum import Spectrum

#: Further descents at most, where the recording stays unexplained: a fit that somebody waits for is to end within some
#: tens of seconds. ``workbench fit`` tries 32.
TRIES = 4


class _Stopped(Exception):
    """Raised through a fit that is to stop."""


@dataclass(frozen=True)
class Refit:
    """What a fit found: ``values`` and standard ``errors`` (SI) by name, the mean error of |Z| (per cent) ``before``
    and ``after``, and ``findings`` in words."""

    values: Mapping[str, float]
    errors: Mapping[str, float]
    before: float
    after: float
    findings: tuple[str, ...]


def refit(
    session: Session, measured: Spectrum, free: Sequence[str], values: Mapping[str, float], say: Say, stopped: Stopped
) -> Refit | None:
    """Fit the numbers `free` of a session to a recording, from the chip's own numbers and from `values` (SI); the
    others rest at `values`. None where it was stopped.

    What was known before of a free number is what the chip's file and its materials say.

    Raises:
        InputError: too few points in the band, or a recording that cannot be of this device.
        FitError: no start can be predicted.
    """
    held = {name: number for name, number in values.items() if name not in free}
    constants = {name: number for name, number in held.items()
                 if ParameterName.parse(name).kind is not Kind.DIMENSION}
    chip = moved_chip(session.chip, {name: number for name, number in held.items() if name not in constants})
    prepared = prepare(chip, session.registry, kind="pzt", name=session.recording_name, measured=measured,
                       state=session.state, free=free, band=session.band, accuracy=session.accuracy)

    def holding(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
        return tuple(replace(each, problem=each.problem.with_values(placed(each.problem.values, constants)))
                     for each in recordings)

    def progress(text: str, share: float) -> None:
        if stopped():
            raise _Stopped
        say(f"{', '.join(free)}: {text}, {100.0 * share:.0f} %")

    start = np.array([min(max(values[each.name], each.low), each.high) for each in prepared.parameters])
    try:
        found = joint.fit(holding(prepared.recordings), prepared.parameters, coarse=holding(prepared.coarse),
                          starts={"live view": start}, tries=TRIES, bands=0, progress=progress)
    except _Stopped:
        return None
    (match,) = found.recordings
    return Refit({each.parameter.name: each.value for each in found.estimates},
                 {each.parameter.name: each.standard_error for each in found.estimates},
                 match.before.mape_percent, match.after.mape_percent, found.findings)
