"""Where the commands already given will take a robot: its committed pose, by nominal lag and delay.

    q = p + tau v ahead, then a turn by tau w + arcs of the commands on their way, in order

p is the pose, v and w are the speed and the yaw rate that the wheels have by the nominal lag tau.
A controller that counts on this steers q; the error of q is that of p, with the motion M to q
undone before it and the reference's motion R over the latency tau + D behind it: e~ = M^-1 + e + R.
So the pose follows the reference by the latency later.

Speeds are those over ground under the slips that were compensated.

Source: `sets.robot.committed`, where what this leaves to the disturbance is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.plant.motions import Motion, arc_of_travel, join, undo

INSTANT = 1e-9
"""Share of a period by which a time may differ from a whole number of them by rounding."""


def count_whole_periods(time: float, dt: float) -> int:
    """Return how many whole periods a time holds."""
    return int(np.floor(time / dt + INSTANT))


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["lag", "late", "latency", "track_width", "dt"],
    meta_fields=["whole", "past"],
)
@dataclass(frozen=True)
class Forecast:
    """The committed pose.

    Attributes:
        lag: nominal time constant of the wheels, s.
        late: what the nominal delay has beyond whole periods, s.
        latency: nominal lag and delay together, s.
        track_width: m.
        dt: period, s.
        whole: whole periods of the nominal delay.
        past: whole periods of the latency.
    """

    lag: Float[Array, ""] | float
    late: Float[Array, ""] | float
    latency: Float[Array, ""] | float
    track_width: Float[Array, ""] | float
    dt: Float[Array, ""] | float
    whole: int
    past: int

    @classmethod
    def of(cls, lag: float, delay: float, track_width: float, dt: float) -> Forecast:
        """Return the forecast by a nominal lag and delay, s."""
        whole = count_whole_periods(delay, dt)
        late = max(delay - whole * dt, 0.0)
        latency = lag + delay
        return cls(lag, late, latency, track_width, dt, whole, count_whole_periods(latency, dt))

    @property
    def memory(self) -> int:
        """How many commands must be remembered, the newest included."""
        return self.whole + 2

    def motion_ahead(
        self, speeds: Float[Array, "batch 2"], commands: Float[Array, "n batch 2"]
    ) -> Motion:
        """Return the motion M from the pose to the committed one.

        Args:
            speeds: expected of the wheels, m/s.
            commands: given, the newest last, m/s.
        """
        first = commands[-1 - self.whole] * self.late
        ahead = join(self._run_out(speeds * self.lag), self._arc(first))
        for command in commands[len(commands) - self.whole :]:
            ahead = join(ahead, self._arc(command * self.dt))
        return ahead

    def speeds_after(
        self, speeds: Float[Array, "batch 2"], commands: Float[Array, "n batch 2"]
    ) -> Float[Array, "batch 2"]:
        """Return the speeds expected a period later, m/s, the last of `commands` being its own."""
        earlier = commands[-2 - self.whole]
        later = commands[-1 - self.whole]
        reached = self._close(speeds, earlier, self.late)
        return self._close(reached, later, self.dt - self.late)

    def reference_behind(self, reference_wheels: Float[Array, "steps 2"], step) -> Motion:
        """Return the motion R of the reference over the latency before an instant; before its start
        it goes on as it begins."""
        rest = self.latency - self.past * self.dt
        behind = self._arc(reference_wheels[jnp.maximum(step - 1 - self.past, 0)] * rest)
        for back in range(self.past, 0, -1):
            wheels = reference_wheels[jnp.maximum(step - back, 0)]
            behind = join(behind, self._arc(wheels * self.dt))
        return behind

    def _run_out(self, travel: Float[Array, "... 2"]) -> Motion:
        """Return the motion of wheels that run out, as a way ahead and then a turn."""
        turn = (travel[..., 0] - travel[..., 1]) / self.track_width
        way = (travel[..., 0] + travel[..., 1]) / 2.0
        return jnp.stack([way, jnp.zeros_like(way), turn], axis=-1)

    def _arc(self, travel: Float[Array, "... 2"]) -> Motion:
        return arc_of_travel(travel, self.track_width)

    def _close(self, speeds, command, time) -> Float[Array, "batch 2"]:
        """Return the speeds after some time under a command."""
        left = jnp.exp(-time / jnp.maximum(self.lag, jnp.finfo(speeds.dtype).tiny))
        return command + (speeds - command) * left


def commit(errors: Motion, ahead: Motion, behind: Motion) -> Motion:
    """Return the errors of committed poses from those of the poses."""
    return join(join(undo(ahead), errors), behind)


def withdraw(committed: Motion, ahead: Motion, behind: Motion) -> Motion:
    """Return the errors of poses from those of the committed ones."""
    return join(join(ahead, committed), undo(behind))
