"""The reference that a governor has under its hand: what is committed, what is asked for instead,
and the way from the one to the other.

The reference drives wheel speeds within the certified box, `ahead` of which the first N are
committed. What is asked for, the target, is a path, or wheel speeds that are wished for, which then
count as a path that goes on with the last of them. The reference is

    on it      `ahead` is that of the target, perhaps some periods late
    joining    `ahead` leads onto the target (`jaxtube.paths.joining`)
    off it     a revision has not been accepted as a whole; a way onto the target is sought from the
               end of what is committed once that is not revised again

Source: new.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxtube.paths.joining import MET, along, extend, find_gap, find_joining
from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.reference import Reference, drive


class Route:
    """A reference between its past and what is asked for.

    Attributes:
        pose: of the reference now (x m, y m, heading rad).
        late: periods by which the target is followed, or will be once it is joined.
        joins: periods until the reference is on the target, None where it is off it.
    """

    def __init__(self, target: Reference, limits: WheelLimits, horizon: int):
        """Begin on a path.

        Args:
            target: whose wheel speeds keep the limits.
            limits: the certified box.
            horizon: N.
        """
        self._limits = limits
        self._horizon = horizon
        self._ask(target)
        self.pose = target.poses[0]
        self._ahead = target.wheels
        self.joins: int | None = 0

    def _ask(self, target: Reference) -> None:
        self._target = target
        self._clock = 0  # the period of the target that begins now
        self._is_wish = False
        self.late = 0

    def _rest(self, first: int) -> Reference:
        """Return the target from a period of it on, with a pair of wheel speeds at least; beyond
        its end it goes on with its last ones."""
        target = self._target
        missing = first + self._horizon - len(target.wheels)
        if missing > 0:
            wheels = _hold_last(target.wheels, missing)
            target = along(target.poses[0], wheels, target.dt, self._limits.track_width)
            self._target = dataclasses.replace(target, steps=self._target.steps)
        target = self._target
        return Reference(target.wheels[first:], target.poses[first:], target.dt, target.steps)

    @property
    def place(self) -> int:
        """The period of the target that is driven now, or would be were it joined."""
        return max(self._clock - self.late, 0)

    @property
    def has_ended(self) -> bool:
        """Whether all periods of a path have been driven; wheel speeds wished for have no end."""
        return not self._is_wish and self.joins == 0 and self.place >= self._target.steps

    @property
    def distance(self) -> float:
        """How far the reference is from where the target is, m."""
        gap = find_gap(self.pose, self._rest(self.place).poses[0])
        return float(np.hypot(gap[0], gap[1]))

    @property
    def committed(self) -> Float[np.ndarray, "horizon 2"]:
        """Wheel speeds of the periods that begin now, m/s."""
        self._ahead = _hold_last(self._ahead, self._horizon - len(self._ahead))
        return self._ahead[: self._horizon]

    def list_windows(self, count: int) -> Float[np.ndarray, "count horizon 2"]:
        """Return the windows that will be committed in so many periods, as far as is known now."""
        missing = self._horizon + count - 1 - len(self._ahead)
        ahead = _hold_last(self._ahead, missing)
        windows = np.lib.stride_tricks.sliding_window_view(ahead, self._horizon, axis=0)
        return windows[:count].swapaxes(1, 2)

    @property
    def wished(self) -> Float[np.ndarray, "horizon 2"]:
        """Wheel speeds asked for in these periods: what is committed unless the reference is off
        its target."""
        if self.joins is not None:
            return self.committed
        return self._rest(self._clock).wheels[: self._horizon]

    def follow(self, target: Reference) -> None:
        """Ask for a path, whose first period begins now; it is joined from the end of what is
        committed."""
        self._ask(target)
        self._find_way()

    def wish(self, wheels: Float[np.ndarray, "horizon 2"]) -> None:
        """Ask for wheel speeds for the periods that begin now, m/s."""
        expected = self._rest(self._clock).wheels[: self._horizon]
        is_known = self._is_wish and np.array_equal(wheels[:-1], expected[:-1])
        if not is_known:
            self._revise(wheels)
        elif not np.array_equal(wheels[-1], expected[-1]):
            self._go_on(wheels[-1])
        elif self.joins is None:
            self._find_way()

    def _revise(self, wheels: Float[np.ndarray, "horizon 2"]) -> None:
        """Ask for other wheel speeds than were known, from where the target is."""
        here = self._rest(self._clock).poses[0] if self._is_wish else self.pose
        dt = self._target.dt
        self._ask(along(here, wheels, dt, self._limits.track_width))
        self._is_wish = True
        self.joins = None

    def _go_on(self, newest: Float[np.ndarray, "2"]) -> None:
        """Ask for another pair at the end of those that are known."""
        target = self._target
        known = target.wheels[: self._clock + self._horizon - 1]
        wheels = np.concatenate([known, newest[None]])
        self._target = along(target.poses[0], wheels, target.dt, self._limits.track_width)
        if self.joins == 0:
            self._ahead = self._rest(self.place).wheels
        else:
            self._find_way()

    def _find_way(self) -> None:
        """Join the target from the end of what is committed; stay off it where there is no way."""
        committed = self.committed
        dt = self._target.dt
        end = along(self.pose, committed, dt, self._limits.track_width).poses[-1]
        self._join(end, committed, self._clock + len(committed))

    @property
    def past(self) -> Float[np.ndarray, "periods+1 3"]:
        """The poses of the target from its begin up to where it is now, were it not late."""
        return self._rest(0).poses[: self._clock + 1]

    def wait(self, place: int) -> None:
        """Put the reference where the target was at a period, and follow it so late."""
        rest = self._rest(place)
        self.pose = rest.poses[0]
        self._ahead = rest.wheels
        self.late = self._clock - place
        self.joins = 0

    def begin_anew(self, pose: Float[np.ndarray, "3"]) -> None:
        """Put the reference elsewhere, and join the target from there."""
        self.pose = pose
        self._ahead = self._rest(self._clock).wheels
        self._join(pose, self._ahead[:0], self._clock)

    def _join(
        self,
        start: Float[np.ndarray, "3"],
        before: Float[np.ndarray, "k 2"],
        first: int,
    ) -> None:
        """Join the target from a pose that the reference will have after some wheel speeds, when
        the target is at its period `first`."""
        asked = extend(self._rest(first), start, self._limits)
        joining = find_joining(start, asked, self._limits)
        if joining is None:
            self.joins = None
            return
        self._ahead = np.concatenate([before, joining.wheels, asked.wheels[joining.joins :]])
        self.joins = len(before) + len(joining.wheels)
        self.late = joining.late

    def advance(self, share: float, window: Float[np.ndarray, "horizon 2"]) -> None:
        """Drive the first pair of a window, in which a share of what was wished for was
        accepted."""
        if self.joins is None:
            rest = self._rest(self._clock)
            is_on_target = np.max(np.abs(find_gap(self.pose, rest.poses[0]))) <= MET
            newest = rest.wheels[self._horizon - 1 :]
            self._ahead = np.concatenate([window, newest[1:2]])
            if share == 1.0 and is_on_target:
                self._ahead = rest.wheels
                self.joins = 0
        self.pose = drive(self.pose, window[0], self._target.dt, self._limits.track_width)
        self._ahead = self._ahead[1:]
        self._clock += 1
        if self.joins:
            self.joins -= 1


def _hold_last(wheels: Float[np.ndarray, "n 2"], periods: int) -> Float[np.ndarray, "k 2"]:
    """Return wheel speeds that go on with the last of them for some periods, 0 or more."""
    return np.concatenate([wheels, np.repeat(wheels[-1:], max(periods, 0), axis=0)])
