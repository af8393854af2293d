"""Where a robot works: what its disturbances are bounded over, as boxes of the variables of
`sets.robot.plant`, cut where errors and inputs are coupled.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import NO_LAG, Actuation
from sets.robot.late_ways import Ground
from sets.robot.plant import Late, Period

FINE = 5e-9
"""Gap of a bound that is good enough anyway: rad, or a share of the speed or of the way that the
reference's faster wheel goes in a period."""
COARSE = 1e-4
"""The same of bounds that are told and decide nothing."""
NEGLIGIBLE = 1e-12
"""Magnitudes above minus this, m, m, rad or a share, are zeros that rounding made negative."""


class TurnRange(NamedTuple):
    """Yaw rate deficits u2 from `low` to `high`, rad/s, where the longitudinal error lies within
    reach + slope u2 of its middle, m."""

    low: float
    high: float
    reach: float
    slope: float


@dataclass(frozen=True, eq=False)
class Operation:
    """Where the robot works; lower ends first, points allowed.

    Attributes:
        errors: measured (longitudinal m, lateral m, heading rad), boxes as (lower, upper), as
            below.
        inputs: (speed deficit m/s, yaw rate deficit rad/s).
        schedules: reference wheel speeds (right, left), m/s: boxes any of which may apply, each
            (lower, upper).
        wheel_errors: relative errors d of the ground speeds (right, left), d = (i - i_m) / (1 -
            i_m), a box (lower, upper).
        noise: largest pose noise (m, m, rad).
        dt: period, s.
        track_width: m.
        sideslip: greatest lateral velocity of the body, by its forward speed.
        lever_arm: r of the lateral velocity -r w, m.
        coupling: (a m, b rad/s) where |longitudinal error| / a + |yaw rate deficit| / b <= 1 holds
            as well, else None.
        gain: L, the share of its innovation that an estimate of the error takes over, in (0, 1];
            1 is the measured error itself.
        estimate_error: S, the largest error of the estimate (m, m, rad), `errors` being the
            estimated ones; None for `noise`.
        actuation: lag of the wheels and delay of the commands; where there is any, errors are those
            of the committed pose (`sets.robot.committed`), and commands were within the operation
            at all times before.
        stale_errors: wheel errors under commands given before, where each compensates another slip;
            None where they are the same.
        command_steps: greatest change of what the wheels (right, left) are told from one period to
            the next, m/s over ground under the compensated slip; None for no limit.
        late: what wheels that lag add, where the committed pose is taken for that of a robot that
            obeys at once; wheel errors then are speeds that the wheels lose, m/s.
    """

    errors: Float[np.ndarray, "2 3"]
    inputs: Float[np.ndarray, "2 2"]
    schedules: Float[np.ndarray, "boxes 2 2"]
    wheel_errors: Float[np.ndarray, "2 2"]
    noise: Float[np.ndarray, "3"]
    dt: float
    track_width: float
    sideslip: float = 0.0
    lever_arm: float = 0.0
    coupling: tuple[float, float] | None = None
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    estimate_error: Float[np.ndarray, "3"] | None = None
    actuation: Actuation = NO_LAG
    stale_errors: Float[np.ndarray, "2 2"] | None = None
    command_steps: Float[np.ndarray, "2"] | None = None
    late: Late | None = None

    def __post_init__(self):
        if self.estimate_error is None:
            object.__setattr__(self, "estimate_error", self.noise)
        boxes = len(np.atleast_1d(self.schedules))
        shapes = {
            "errors": (2, 3),
            "inputs": (2, 2),
            "schedules": (boxes, 2, 2),
            "wheel_errors": (2, 2),
            "noise": (3,),
            "estimate_error": (3,),
        }
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all() or not value.size:
                raise ValueError(
                    f"{name}: {value.tolist()} is not an array {shape} of finite numbers; give one"
                )
            if len(shape) > 1 and (value[..., 0, :] > value[..., 1, :]).any():
                raise ValueError(
                    f"{name}: {value.tolist()} has crossed ends; give lower ends first"
                )
            if len(shape) == 1:
                value[(value < 0) & (value >= -NEGLIGIBLE)] = 0.0
                if (value < 0).any():
                    raise ValueError(
                        f"{name}: {value.tolist()} has a negative entry; give magnitudes"
                    )
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        for name in ("dt", "track_width"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(
                    f"{name}: {getattr(self, name)} is not positive and finite; give s or m"
                )
        if not 0 <= self.sideslip < 1:
            raise ValueError(
                f"sideslip: {self.sideslip} is not in [0, 1); give a share such as 0.05"
            )
        if not np.isfinite(self.lever_arm):
            raise ValueError(f"lever_arm: {self.lever_arm} is not finite; give m")
        if len(self.gain) != 3 or not all(0 < share <= 1 for share in self.gain):
            raise ValueError(f"gain: {self.gain} is not three numbers in (0, 1]; give such shares")
        if self.coupling is None:
            return
        lower, upper = self.errors[:, 0]
        if min(self.coupling) <= 0 or lower != -upper:
            raise ValueError(
                f"coupling: {self.coupling} with longitudinal errors {[lower, upper]}: "
                "give positive numbers and symmetric errors"
            )

    @property
    def period(self) -> Period:
        """Period, track width, g_y, the lateral part of a yaw kick, and lever arm."""
        lower, upper = self.box[:, 5:7]
        lateral_per_yaw = float(self.dt * (lower + upper).mean() / 4)
        if self.late is not None:
            lateral_per_yaw += self.late.lever
        return Period(self.dt, self.track_width, lateral_per_yaw, self.lever_arm, self.late)

    @property
    def speed(self) -> float:
        """The greatest reference wheel speed, m/s, by its size."""
        return float(np.abs(self.schedules).max())

    @property
    def travel(self) -> float:
        """How far the reference's faster wheel goes in a period, m."""
        return self.dt * self.speed

    @property
    def kick_per_yaw(self) -> float:
        """How far a yaw kick moves the estimate sideways, by how far it turns it, m/rad."""
        _, of_y, of_heading = self.gain
        return self.period.lateral_per_yaw * (of_y / of_heading)

    @property
    def wheel_change(self) -> Float[np.ndarray, "2"]:
        """Greatest change of what the wheels (right, left) are told in a period, m/s."""
        return np.full(2, np.inf) if self.command_steps is None else self.command_steps

    @property
    def body_change(self) -> Float[np.ndarray, "2"]:
        """Greatest change of the body's (speed m/s, yaw rate rad/s) that the wheels are told."""
        return self.wheel_change.sum() * np.array([0.5, 1 / self.track_width])

    @property
    def ground(self) -> Ground:
        """What the ground does."""
        return Ground(self.wheel_errors, self.stale_errors, self.sideslip, self.lever_arm)

    def without_disturbances(self) -> Operation:
        """Return the operation of a robot that neither slips nor slides, measured exactly."""
        nothing = {name: np.zeros(3) for name in ("noise", "estimate_error")}
        still = np.zeros((2, 2))
        return replace(self, **nothing, wheel_errors=still, sideslip=0.0, lever_arm=0.0)

    @property
    def box(self) -> Float[np.ndarray, "2 variables"]:
        """Ends of the variables of `split_disturbance`, the coupling left aside."""
        assert self.estimate_error is not None
        taken = () if self.late is None else (self.late.speed, self.late.yaw_rate)
        magnitudes = np.concatenate([[self.sideslip], self.estimate_error, taken])
        symmetric = np.stack([-magnitudes, magnitudes])
        schedule = np.stack([self.schedules[:, 0].min(axis=0), self.schedules[:, 1].max(axis=0)])
        return np.hstack([self.errors, self.inputs, schedule, self.wheel_errors, symmetric])

    def pieces(self) -> Float[np.ndarray, "2 variables pieces"]:
        """Return boxes in which the longitudinal error runs over the whole operation,

            x = middle + share (reach + slope u2),    |share| <= 1.

        Variables: share in the place of the longitudinal error, the others, and reach and
        slope, of equal ends. The coupling is cut where its edges meet the caps, so that it is
        linear in u2 on each piece.
        """
        pieces = []
        for turns in self._cut_turns():
            for schedule in self.schedules:
                ends = self.box
                ends[:, 0] = (-1.0, 1.0)
                ends[:, 4] = (turns.low, turns.high)
                ends[:, 5:7] = schedule
                pieces.append(np.hstack([ends, [[turns.reach, turns.slope]] * 2]))
        return np.stack(pieces, axis=2)

    def _cut_turns(self) -> list[TurnRange]:
        """Return the ranges of u2 in which the coupling is linear."""
        half = (self.errors[1, 0] - self.errors[0, 0]) / 2
        lower, upper = self.inputs[:, 1]
        if self.coupling is None:
            return [TurnRange(lower, upper, half, 0.0)]
        a, b = self.coupling
        uncut = max(b * (1 - half / a), 0.0)
        turns = np.array([lower, upper, 0.0, uncut, -uncut])
        turns = np.unique(np.clip(turns, max(lower, -b), min(upper, b)))
        pieces = []
        for low, high in pairwise(turns):
            if max(abs(low), abs(high)) > uncut:
                # Outwards, so that no error that the coupling allows is left out.
                slope = np.nextafter(a / b, 0.0)
                pieces.append(TurnRange(low, high, a, -np.copysign(slope, low + high)))
            else:
                pieces.append(TurnRange(low, high, half, 0.0))
        return pieces

    @property
    def _middle(self) -> float:
        return (self.errors[0, 0] + self.errors[1, 0]) / 2

    def variables(self, piece) -> list:
        """Return the variables of `split_disturbance` from those of a piece."""
        share, *others, reach, slope = piece
        return [share * (reach + slope * others[3]) + self._middle, *others]
