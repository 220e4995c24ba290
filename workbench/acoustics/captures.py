"""Statistics of trajectories: capture fractions, focusing times, light curves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np

from workbench.acoustics.channel import channel_sides
from workbench.acoustics.nodal import FloatArray, IntArray
from workbench.acoustics.trajectories import Fate, Trajectories
from workbench.files.errors import InputError

#: Number of bootstrap samples of start points for the spread of a time. Doubled, the spread is known to 5 % and not to
#: 7.
RESAMPLES = 100
#: Shares of the arrivals that limit a focusing time: 10 to 90 %.
FROM, UNTIL = 0.1, 0.9


@dataclass(frozen=True, kw_only=True)
class CaptureStatistics:
    """Particles with one fate, and the times (s) of their arrival.

    ``share`` of all particles, with the standard deviation ``share_spread`` over as many random start points. At
    ``ten``, ``half`` and ``ninety`` 10, 50 and 90 % of the arrivals have occurred; ``focusing_time`` is from 10 to 90
    %, with its standard deviation ``focusing_spread`` over random start points (bootstrap). None with fewer than two
    arrivals.
    """

    name: str
    count: int
    share: float
    share_spread: float
    ten: float | None = None
    half: float | None = None
    ninety: float | None = None
    focusing_time: float | None = None
    focusing_spread: float | None = None


@dataclass(frozen=True, kw_only=True)
class Window:
    """The observed part of a cavity, by default all of it.

    It extends over radii (of channels, distances from their middles to either side) from ``inner`` to ``outer`` and
    heights from ``bottom`` to ``top``, in m.

    Raises:
        InputError: not a number, or limits out of order.
    """

    inner: float = 0.0
    outer: float = math.inf
    bottom: float = -math.inf
    top: float = math.inf

    def __post_init__(self) -> None:
        for name in ("inner", "outer", "bottom", "top"):
            value = getattr(self, name)
            if not isinstance(value, Real):
                raise InputError("Window", name, value, "a length in m, such as 1e-3")
        if not (0.0 <= self.inner < self.outer and self.bottom < self.top):
            raise InputError("Window", "inner, outer, bottom, top", f"{self.inner:g} to {self.outer:g} m along r and "
                             f"{self.bottom:g} to {self.top:g} m along z", "radii of 0 or more and ascending heights")


def light_curve(found: Trajectories, window: Window) -> FloatArray:
    """Share (n,) of the particles in the `window` at each recorded time."""
    r, z = np.moveaxis(found.positions, 2, 0)
    mesh = found.report.forces.mesh
    # A channel with a plane of symmetry at its left side has its middle there, and so has a round cavity.
    middles = [left if mesh.mirrors.on(np.array(left)) else 0.5 * (left + right)
               for left, right in channel_sides(mesh, found.report.forces.region)]
    distance = np.min([np.abs(r - middle) for middle in middles], axis=0)
    inside = (distance >= window.inner) & (distance <= window.outer) & (z >= window.bottom) & (z <= window.top)
    return np.asarray(inside.mean(axis=0))


def rise_time(times: FloatArray, curve: FloatArray) -> float | None:
    """Rise time (s) of a `curve` (n,) from 10 to 90 %. Each level is crossed for the first time, at `times` (n,). None
    for a curve that ends at its first value."""
    change = curve[-1] - curve[0]
    if change == 0.0:
        return None
    level = (curve - curve[0]) / change
    begin, end = (_first_crossing(times, level, share) for share in (FROM, UNTIL))
    return end - begin


def arrived_share(found: Trajectories, at: FloatArray) -> FloatArray:
    """Share (n,) of all particles that have arrived by each recorded time. `at` (P,) are the arrivals in s, NaN for
    none."""
    arrived = np.sort(at[np.isfinite(at)])
    return np.asarray(np.searchsorted(arrived, found.times, side="right") / found.count)


def capture_statistics(found: Trajectories, *, seed: int = 0) -> tuple[CaptureStatistics, ...]:
    """Statistics of focusing, levitation, every trap, and every other fate.

    Levitation counts particles that stay at the height where they neither rise nor fall, those in traps included. In a
    channel, focusing across counts particles that stay where they move to neither side, on the floor or at the lid too.
    A particle that only passes does not count.
    """
    random = np.random.default_rng(seed)

    def of(name: str, which: IntArray, at: FloatArray) -> CaptureStatistics:
        share = which.size / found.count
        spread = math.sqrt(share * (1.0 - share) / found.count)
        times = at[which]
        if which.size < 2 or not np.isfinite(times).all():
            return CaptureStatistics(name=name, count=which.size, share=share, share_spread=spread)
        ten, half, ninety = (float(each) for each in np.quantile(times, (FROM, 0.5, UNTIL)))
        drawn = np.quantile(random.choice(times, (RESAMPLES, times.size)), (FROM, UNTIL), axis=1)
        return CaptureStatistics(name=name, count=which.size, share=share, share_spread=spread, ten=ten, half=half,
                                 ninety=ninety, focusing_time=ninety - ten,
                                 focusing_spread=float((drawn[1] - drawn[0]).std(ddof=1)))

    def ending(fate: Fate) -> IntArray:
        return np.flatnonzero(found.fate == fate)

    measure = found.report.forces.mesh.measure
    rows = [of("focused across the channel", np.flatnonzero(np.isfinite(found.focused_at)), found.focused_at)] \
        if 0 in measure.focusing else []
    rows += [of("came to levitate", np.flatnonzero(np.isfinite(found.levitated_at)), found.levitated_at)]
    rows += [of(f"in trap {number}, {measure.symbol} {1e3 * r:.{measure.decimals}f} mm, z "
                f"{1e3 * z:.{measure.decimals}f} mm", np.flatnonzero(found.trap == number - 1),
                found.trapped_at) for number, (r, z) in enumerate(found.rest, start=1) if np.isfinite(r)]
    no_time = np.full(found.count, np.nan)
    rows += [of("levitated, in no trap", ending(Fate.LEVITATED), no_time),
             *(of(fate.words + place_across(found, ending(fate)), ending(fate), found.stopped_at)
               for fate in (Fate.AT_WALL, Fate.AT_LID, Fate.SEDIMENTED)),
             of("still moving", ending(Fate.MOVING), no_time)]
    return tuple(rows)


def place_across(found: Trajectories, which: IntArray) -> str:
    """The common final place of the particles `which` (K,), as text. In a straight channel it is ", in the middle of
    the channel" or another place of at least nine tenths of them; empty otherwise."""
    mesh = found.velocity.mesh
    if 0 not in mesh.measure.focusing or not which.size:
        return ""
    ends = mesh.mirrors.folded(found.positions[which, -1])[0][:, 0]
    middle = float(np.median(ends))
    middle = next((place for place in (0.0, *mesh.mirrors.places) if abs(middle - place) <= found.within), middle)
    there = float((np.abs(ends - middle) <= found.within).mean())
    if there < UNTIL:
        return ""
    return f", {'' if there == 1.0 else 'nine tenths of them '}{mesh.measure.place_words(middle)}"


def _first_crossing(times: FloatArray, level: FloatArray, share: float) -> float:
    """The time (s) at which a level first reaches a share. The level (n,) is linear between `times`."""
    after = int(np.argmax(level >= share))
    if after == 0:
        return float(times[0])
    part = (share - level[after - 1]) / (level[after] - level[after - 1])
    return float(times[after - 1] + part * (times[after] - times[after - 1]))
