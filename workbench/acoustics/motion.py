"""Motion of particles in a velocity field, with individual time steps.

It ends after a time or at a wall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import FloatArray, IntArray
from workbench.acoustics.rosenbrock import next_step, rosenbrock_step
from workbench.acoustics.walls import Walls
from workbench.jobs.progress import Progress

#: First step, as a share of the fastest time scale at the start. Doubled, more first steps fail.
FIRST_STEP = 0.1
#: Most steps of one particle, accepted or not; above, its motion fails. The stiffest chips need a tenth.
MOST_ATTEMPTS = 100_000
#: Iterations of the search for the time of an arrival, which needs four or five.
CROSSING_STEPS = 12


class Motion:
    """The motion of particles of one `radius` (m) in a `velocity` field.

    They move from `starts` (P, 2) over `times` (n,). ``positions`` (P, n, 2) are those at `times`, the first is the
    start. ``levitated_at``, ``focused_at`` (P,) and ``trapped_at`` (P, T) are the times (s) from which the particle
    stays `within` a distance (m) of the height where it neither rises nor falls, of the place across a channel where it
    moves to neither side, and of each of the places `rest` (T, 2); a particle that passes has not arrived.
    ``stopped_at`` (P,) is the time at which its surface touched a wall. They are NaN otherwise. ``away`` (P, 2) is the
    unit vector from that wall. `tolerance` (m) bounds the estimated error of every step.
    """

    def __init__(
        self, velocity: Interpolant, walls: Walls, starts: FloatArray, times: FloatArray, *, radius: float,
        rest: FloatArray, within: float, tolerance: float,
    ) -> None:
        self.velocity, self.walls, self.times = velocity, walls, times
        self.radius, self.rest, self.within, self.tolerance = radius, rest, within, tolerance
        count = len(starts)
        self.positions = np.repeat(starts[:, None], len(times), axis=1)
        self.focused_at, self.levitated_at, self.stopped_at = np.full((3, count), np.nan)
        self.trapped_at = np.full((count, len(rest)), np.nan)
        self._home = np.full((count, 2), np.nan)  # the last place of balance along each direction
        self.away = np.zeros((count, 2))
        self.attempts = 0
        # Places may be beyond a mirror line: rounding moves particles there and back.
        self.place, self.time = starts.copy(), np.zeros(count)
        self._cell = np.maximum(velocity.cells_at(starts), 0)
        self.speed, self.slope, _ = velocity(starts, self._cell, slopes=True)
        rate = np.abs(self.slope).max(axis=(1, 2))
        self._step = FIRST_STEP / np.maximum(rate, 1.0 / times[-1])
        self._room = walls.nearest(starts)[0] - radius
        self._next = np.ones(count, dtype=np.int64)
        still = _Path(starts, starts, np.zeros_like(starts), np.zeros_like(starts), np.zeros(count))
        self._arrive(np.arange(count), still, self.time)

    def run(self, progress: Progress) -> None:
        """Move all particles to the end.

        Raises:
            ArithmeticError: a particle needs more than :data:`MOST_ATTEMPTS` steps.
        """
        while (moving := np.flatnonzero(self._next < len(self.times))).size:
            if self.attempts >= MOST_ATTEMPTS:
                one = moving[0]
                r, z = 1e3 * self.place[one]
                raise ArithmeticError(
                    f"a particle at {self.velocity.mesh.measure.symbol} = {r:.4g} mm, z = {z:.4g} mm needs "
                    f"more than {MOST_ATTEMPTS} steps: at {self.time[one]:.4g} s its step is {self._step[one]:.2g} s")
            self.attempts += 1
            self._attempt(moving)
            progress("trajectories", float((self._next / len(self.times)).mean()))

    def balanced(self, which: IntArray, axis: int) -> tuple[NDArray[np.bool_], FloatArray]:
        """Mask (K,) of particles in balance along a direction. The place (K,) of balance is returned too. `axis` is 0
        across, 1 up; the place is in m. A place too near a wall does not count."""
        drawn, speed = self.slope[which, axis, axis], self.speed[which, axis]
        stable = drawn < 0.0
        goal = self.place[which, axis] - np.where(stable, speed / np.where(stable, drawn, 1.0), np.inf)
        there = stable & (np.abs(goal - self.place[which, axis]) <= self.within)
        close = np.flatnonzero(there)
        if close.size:
            place = self.place[which[close]]
            place[:, axis] = goal[close]
            there[close] = self._clearance(place, self._cell[which[close]]) > 0.0
        return there, goal

    def _attempt(self, moving: IntArray) -> None:
        """Try one step of the particles `moving`, and accept accurate ones."""
        target = self.times[self._next[moving]]
        left = target - self.time[moving]
        step, cell = np.minimum(self._step[moving], left), self._cell[moving]
        place, error = rosenbrock_step(lambda at: self.velocity(at, cell)[0], self.place[moving], self.speed[moving],
                                       self.slope[moving], step)
        size = np.nan_to_num(np.abs(error).max(axis=1) / self.tolerance, nan=np.inf)
        good, proposed = size <= 1.0, next_step(step, size)
        # A step cut short at a recorded time does not limit the next one.
        short = good & (step < self._step[moving])
        self._step[moving] = np.where(short, np.maximum(self._step[moving], proposed), proposed)
        which, place, step = moving[good], place[good], step[good]
        if not which.size:
            return
        start, speed = self.time[which], self.speed[which]
        path = _Path(self.place[which], place, speed, np.empty_like(speed), step)
        path.last, self.slope[which], found = self.velocity(place, cell[good], slopes=True)
        self.place[which], self.speed[which] = place, path.last
        self._cell[which] = np.where(found >= 0, found, cell[good])
        self.time[which] = np.where(step < left[good], start + step, target[good])
        touching = self._touching(which, found >= 0, path)
        if touching.any():
            self._stop(which[touching], path.of(touching), start[touching])
        free = ~touching
        self._arrive(which[free], path.of(free), start[free])
        reached = which[free & (step >= left[good])]
        self.positions[reached, self._next[reached]] = self._mirrored(self.place[reached])
        self._next[reached] += 1

    def _touching(self, which: IntArray, inside: NDArray[np.bool_], path: _Path) -> NDArray[np.bool_]:
        """Whether the surface of each particle has touched a wall."""
        self._room[which] -= np.linalg.norm(path.end - path.begin, axis=1)
        # Only particles that may have reached a wall since the last measurement are measured again.
        near = which[(self._room[which] <= 0.0) | ~inside]
        if near.size:
            self._room[near] = self._clearance(self.place[near], self._cell[near])
        return np.asarray(self._room[which] < 0.0)

    def _clearance(self, place: FloatArray, cell: IntArray) -> FloatArray:
        """The gap (K,) in m between walls and particle surfaces, negative beyond. The particles are at `place` (K, 2)
        in or near `cell` (K,)."""
        points = self._mirrored(place)
        distance = self.walls.nearest(points)[0]
        inside = self.velocity.cells_at(points, cell) >= 0
        return np.asarray(np.where(inside, distance, -distance) - self.radius)

    def _stop(self, which: IntArray, path: _Path, start: FloatArray) -> None:
        """Stop the particles `which` at the wall on their `path`. The step began at the time `start`."""
        share = _crossing(lambda at: self._clearance(path.at(at), self._cell[which]), len(which))
        self.place[which] = self._mirrored(path.at(share))
        self.stopped_at[which] = self.time[which] = start + share * path.step
        self.away[which] = self.walls.nearest(self.place[which])[1]
        # On a wall nothing levitates; a focus line across a channel extends down to its floor.
        self.levitated_at[which] = np.nan
        self.focused_at[which[~(np.abs(self.place[which, 0] - self._home[which, 0]) <= self.within)]] = np.nan
        for one in which:
            self.positions[one, self._next[one]:] = self.place[one]
        self._next[which] = len(self.times)

    def _arrive(self, which: IntArray, path: _Path, start: FloatArray) -> None:
        """Record arrivals and departures of the particles `which` on their `path`. The step began at the time
        `start`."""
        for axis in self.velocity.mesh.measure.focusing:
            self._balance(which, path, start, axis)
        for number, rest in enumerate(self.rest):
            apart = np.linalg.norm(self._mirrored(path.end) - rest, axis=1)
            self.trapped_at[which[apart > self.within], number] = np.nan
            new = (apart <= self.within) & np.isnan(self.trapped_at[which, number])
            if new.any():
                share = self._trapped(path.of(new), rest)
                self.trapped_at[which[new], number] = start[new] + share * path.step[new]

    def _balance(self, which: IntArray, path: _Path, start: FloatArray, axis: int) -> None:
        """Record particles that have reached or lost their balance along a direction."""
        arrived, home = (self.focused_at, self.levitated_at)[axis], self._home[:, axis]
        looking = np.flatnonzero(~(np.abs(path.end[:, axis] - home[which]) <= self.within))
        there, goals = self.balanced(which[looking], axis)
        arrived[which[looking[~there]]] = np.nan
        home[which[looking]] = np.where(there, goals, np.nan)
        first = there & np.isnan(arrived[which[looking]])
        if first.any():
            new = looking[first]
            some, goal = path.of(new), goals[first]
            share = _crossing(lambda at: np.abs(some.at(at)[:, axis] - goal) - self.within, len(new))
            arrived[which[new]] = start[new] + share * some.step

    def _trapped(self, path: _Path, rest: FloatArray) -> FloatArray:
        """Shares (K,) of the step until particles reach a place."""
        def gap(share: FloatArray) -> FloatArray:
            return np.asarray(np.linalg.norm(self._mirrored(path.at(share)) - rest, axis=1) - self.within)

        return _crossing(gap, len(path.step))

    def _mirrored(self, place: FloatArray) -> FloatArray:
        """Places (K, 2) folded into the section."""
        return self.velocity.mesh.mirrors.folded(place)[0]


@dataclass(eq=False)
class _Path:
    """Cubic paths of particles during a `step` (K,) in s. They go from `begin` to `end` (K, 2) with the speeds
    there."""

    begin: FloatArray
    end: FloatArray
    first: FloatArray
    last: FloatArray
    step: FloatArray

    def at(self, share: FloatArray) -> FloatArray:
        """Places (K, 2) after a `share` (K,) of the step."""
        s, step = share[:, None], self.step[:, None]
        return ((1.0 + 2.0 * s) * (1.0 - s) ** 2 * self.begin + s**2 * (3.0 - 2.0 * s) * self.end
                + s * (1.0 - s) * step * ((1.0 - s) * self.first - s * self.last))

    def of(self, which: NDArray[np.bool_] | IntArray) -> _Path:
        """The paths of some particles."""
        return _Path(self.begin[which], self.end[which], self.first[which], self.last[which], self.step[which])


def _crossing(gap: Callable[[FloatArray], FloatArray], count: int) -> FloatArray:
    """Shares (count,) of a step at which `gap` falls to zero. The method is Illinois; 0 if it starts there, 1 if it
    does not reach zero."""
    low, high = np.zeros(count), np.ones(count)
    above, below = gap(low), gap(high)
    found = np.where(above <= 0.0, 0.0, 1.0)
    crossed = (above > 0.0) & (below < 0.0)
    side = np.zeros(count)
    for _ in range(CROSSING_STEPS):
        if not crossed.any():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(crossed, low + (high - low) * above / (above - below), found)
        value = gap(share)
        positive = value > 0.0
        below = np.where(positive, np.where(side > 0.0, 0.5 * below, below), value)
        above = np.where(positive, value, np.where(side < 0.0, 0.5 * above, above))
        low, high = np.where(positive, share, low), np.where(positive, high, share)
        side = np.where(positive, 1.0, -1.0)
        found = np.where(crossed, share, found)
    return found
