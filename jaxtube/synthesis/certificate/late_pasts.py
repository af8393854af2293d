"""Extreme pasts of robots whose wheels lag, drawn by their index: what a witness plays.

A past is what was asked for in each period, along which reference, and what slips and delays did
with it; for ever before, that of the first period. It goes on beyond the instant 0 for as long as
the robot is late. Commands jump between extremes of all that may be asked for or, where the wheels'
acceleration is limited, go there on a straight line as fast as command and reference may.

Source: new.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.acceleration import find_command_steps, find_reference_steps
from jaxtube.synthesis.certificate.demands import Demands, find_demands
from jaxtube.synthesis.certificate.period import pair_slips
from jaxtube.synthesis.certificate.period_cases import Numbers
from jaxtube.synthesis.disturbance import find_actuation
from jaxtube.synthesis.problem import Problem

COUNT = 400
"""Pasts that are played."""
REMEMBERED = 5.0
"""Time constants after which a command is as good as forgotten."""
SWITCHING = (0.0, 0.3, 1.0)
"""Chances that what a past has in a period is drawn anew."""


@dataclass(frozen=True, eq=False)
class LatePasts:
    """Pasts, one row each, by period.

    Attributes:
        begins: of the periods, when their commands are given, s; the instant is 0.
        asked: wheel speeds (right, left) over ground under the slip that is compensated, m/s.
        wheels: of the reference (right, left), m/s.
        slip: true slips (right, left).
        measured_slip: those that are compensated.
        sideslip: lateral speed of the body, by its forward speed.
        delay: of each command, s.
        lag: of the wheels, s.
    """

    begins: Float[np.ndarray, " periods"]
    asked: Float[np.ndarray, "n periods 2"]
    wheels: Float[np.ndarray, "n periods 2"]
    slip: Float[np.ndarray, "n periods 2"]
    measured_slip: Float[np.ndarray, "n periods 2"]
    sideslip: Float[np.ndarray, "n periods"]
    delay: Float[np.ndarray, "n periods"]
    lag: Numbers

    @property
    def told(self) -> Float[np.ndarray, "n periods 2"]:
        """Speeds that the wheels are told, m/s."""
        return self.asked / (1 - self.measured_slip)


class _Picks(NamedTuple):
    """Which of the extremes a past has in each period, and which end of the lag; of several pasts,
    one row each."""

    corner: Int[np.ndarray, "... periods"]
    demand: Int[np.ndarray, "... periods"]
    slip: Int[np.ndarray, "... periods"]
    side: Int[np.ndarray, "... periods"]
    delay: Int[np.ndarray, "... periods"]
    lag: int | Int[np.ndarray, " n"]


def draw_pasts(problem: Problem) -> LatePasts:
    """Return COUNT extreme pasts."""
    actuation = find_actuation(problem.scenario)
    demands = find_demands(problem)
    slips = pair_slips(problem)
    begins = _find_begins(problem)
    sizes = (*demands.asked.shape[:2], len(slips))
    drawn = [_pick(index, sizes, len(begins)) for index in range(COUNT)]
    picks = _Picks(*(np.array(part) for part in zip(*drawn, strict=True)))
    true, measured = np.moveaxis(slips[picks.slip], 2, 0)
    asked, wheels = _follow(problem, demands, picks)
    return LatePasts(
        begins=begins,
        asked=asked,
        wheels=wheels,
        slip=true,
        measured_slip=measured,
        sideslip=problem.scenario.slip.sideslip * (2.0 * picks.side - 1),
        delay=np.array(actuation.delay)[picks.delay],
        lag=np.array(actuation.lag)[picks.lag],
    )


def _find_begins(problem: Problem) -> Float[np.ndarray, " periods"]:
    """Return when periods begin, from as long ago as wheels remember to a latency later, s."""
    T = problem.model.dt
    actuation = find_actuation(problem.scenario)
    before = int(np.ceil((actuation.delay[1] + REMEMBERED * actuation.lag[1]) / T)) + 2
    after = int(np.ceil(actuation.nominal(T).latency / T))
    return T * np.arange(-before, after)


def _pick(index: int, sizes: tuple[int, int, int], periods: int) -> _Picks:
    random = np.random.default_rng(index)
    corner, demand, slip, side, delay = _hold(random, (*sizes, 2, 2), periods)
    return _Picks(corner, demand, slip, side, delay, int(random.integers(2)))


def _hold(
    random: np.random.Generator, sizes: tuple[int, ...], periods: int
) -> Iterator[Int[np.ndarray, " periods"]]:
    """Yield numbers below each size, held from period to period until they are drawn anew."""
    for size in sizes:
        is_new = random.random(periods) < random.choice(SWITCHING)
        last_drawn = np.maximum.accumulate(np.where(is_new, np.arange(periods), 0))
        yield random.integers(size, size=periods)[last_drawn]


def _follow(
    problem: Problem, demands: Demands, picks: _Picks
) -> tuple[Float[np.ndarray, "n periods 2"], Float[np.ndarray, "n periods 2"]]:
    """Return what is asked for and the reference's wheel speeds, period by period."""
    asked = demands.asked[picks.corner, picks.demand]
    wheels = demands.wheels[picks.corner]
    most = find_command_steps(problem)
    if most is None:
        return asked, wheels
    limits = np.concatenate([most, find_reference_steps(problem)])
    targets = np.concatenate([asked, wheels], axis=-1)
    for period in range(1, targets.shape[1]):
        steps = targets[:, period] - targets[:, period - 1]
        # Of a reference that never changes, limits and steps may both be 0.
        shares = limits / np.maximum(np.maximum(np.abs(steps), limits), np.finfo(float).tiny)
        targets[:, period] = targets[:, period - 1] + steps * shares.min(axis=1, keepdims=True)
    return targets[..., :2], targets[..., 2:]
