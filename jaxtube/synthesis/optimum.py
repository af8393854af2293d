"""What a search for caps and gains has found: the scenario with them, and what binds there.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.error_box import error_vector, noise_bounds
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.descent import AnyEstimate, Descent, find_pressures
from jaxtube.synthesis.estimate import CAP_ROWS, LIMIT_ROWS
from jaxtube.synthesis.starts import with_caps_and_gains

LIMIT_ROOM = 1.001
"""Use of a limit up to which the estimate says that it is kept: what is designed is rounded down,
and judged by rigorous bounds."""
PRESSING = 0.05
"""Pressure from which on a limit is told."""
SHOWN = 2
"""Limits that are told at most."""


@dataclass(frozen=True)
class Optimum:
    """The scenario with the best caps and gains, and what holds there as far as estimated.

    Attributes:
        scenario: with these caps and gains.
        ratio: largest share of a cap that the tube fills.
        excess: largest use of a limit by caps, start and wheels.
        shares: of caps filled and of limits used, by row.
        pressures: by row, as of `descent.find_pressures`.
        cap_rows, limit_rows: names of the rows; of several bands those of each.
    """

    scenario: Scenario
    ratio: float
    excess: float
    shares: dict[str, float]
    pressures: dict[str, float]
    cap_rows: tuple[str, ...] = CAP_ROWS
    limit_rows: tuple[str, ...] = LIMIT_ROWS

    @property
    def keeps_limits(self) -> bool:
        """Whether caps, start and wheels keep their limits."""
        return self.excess <= LIMIT_ROOM

    @property
    def holds(self) -> bool:
        """Whether the caps hold the tube, too."""
        return self.ratio <= 1 and self.keeps_limits

    @property
    def pressing(self) -> list[str]:
        """The limits that hold the caps down, the most pressing first."""
        limits = sorted(self.limit_rows, key=lambda row: -self.pressures[row])
        return [row for row in limits if self.pressures[row] > PRESSING]

    @property
    def binding(self) -> str:
        """The row that binds most: a limit that holds the caps down, where there is one."""
        return max(self.pressing[:1] or self.cap_rows, key=lambda row: self.pressures[row])

    def describe_binding(self) -> str:
        """Return what binds, in words: the limit that is passed, or the cap that is filled most and
        the limits that hold the caps down."""
        if not self.keeps_limits:
            worst = max(self.limit_rows, key=lambda row: self.pressures[row])
            return f"every choice of caps passes a limit, {worst} by {self.excess - 1:.1%} at best"
        cap = max(self.cap_rows, key=lambda row: self.pressures[row])
        shown = self.pressing[:SHOWN]
        verb = "hold" if len(shown) > 1 else "holds"
        held = f"; {' and '.join(shown)} {verb} the caps down" if shown else ""
        return f"the tube fills {self.ratio:.1%} of its caps, above all of the {cap}{held}"


def describe(descent: Descent, asked: AnyEstimate | None = None) -> Optimum:
    """Return what a search has found, judged by the estimate of what was asked for; the search may
    have been stricter."""
    judge = descent.estimate if asked is None else asked.shaped_like(descent.point)
    shares = judge.shares(descent.point)
    assert shares is not None
    values = np.concatenate([shares.caps[0], shares.limits[0]])
    pressures = find_pressures(descent)
    rows = (*judge.cap_rows, *judge.limit_rows)
    return Optimum(
        _with_values(judge.problem.scenario, judge.to_values(descent.point)),
        float(shares.caps.max()),
        float(shares.limits.max()),
        dict(zip(rows, map(float, values), strict=True)),
        dict(zip(rows, map(float, pressures), strict=True)),
        judge.cap_rows,
        judge.limit_rows,
    )


def _with_values(scenario: Scenario, values: Float[np.ndarray, " k"]) -> Scenario:
    """Return the scenario with these caps and gains, rounded to what one would write."""
    limits = error_vector(scenario.constraints) - noise_bounds(scenario)
    limits[2] = np.rad2deg(limits[2])
    rounded = [_round_down(value) for value in (*np.minimum(values[:3], limits), *values[3:])]
    return with_caps_and_gains(scenario, rounded)


def _round_down(value: float) -> float:
    """Return a number of four significant digits, never larger in size."""
    unit = 10.0 ** (np.floor(np.log10(abs(value))) - 3)
    shortened = np.trunc(value / unit) * unit
    text = np.format_float_positional(shortened, 4, unique=False, fractional=False)
    return float(text)
