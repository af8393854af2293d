"""How the wheels follow their commands: dead time and first-order lag.

    tau w' = u(t - delta) - w,   u = c_1 v_c + c_2 omega_c     for each wheel

The gains c tell which wheel speeds the robot's own driver makes of a command, and with them the
track width it believes in, b = (c_2r - c_2l). Delta and tau are fitted robustly over the seconds
that follow a change of the command. A row shows a command later than it was given, by a row at
most, so that delta may come out negative.

The lag of single changes spreads about the common one, by what a single fit is off by and by what
the robot itself varies. Of the first each fit knows the size; the second is what is then still
needed for half of the lags to lie within the quartiles of a normal distribution. The interval of
the lag is the middle 90 % of what the robot varies, and of what the common lag is off by.

Source: new; variable projection as in Golub and Pereyra, SIAM J. Numer. Anal. 1973; loss soft L1 of
scipy.optimize.least_squares; the robot's own spread as in DerSimonian and Laird, Meta-analysis in
clinical trials, 1986, but by the median.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares, minimize, root_scalar

from jaxtube.recordings.log import Log
from jaxtube.recordings.spread import find_spread

BEFORE_S = 0.3
AFTER_S = 2.5
"""Around a change of the command, that are looked at."""

FEWEST_CHANGES = 4

SHORTEST_HOLD_S = 1.0
"""That a command must last for its wheels to settle."""

LONGEST_LAG_S = 1.0
LONGEST_DELAY_S = 1.0

SMALLEST_CHANGE = 0.2
"""Of the largest change of a wheel's speed: smaller ones tell no lag of their own."""

SMALLEST_SPREAD_MPS = 1e-4
"""Of wheel speeds about their response, as their files round them."""

SCALE_MPS = 0.02
"""Beyond which what is missed counts linearly."""

SHORTEST_SEEN = 0.25
"""Of the time between two rows, the lag up to which there may be none."""

STEP_S = 0.002
"""By which dead time and lag are moved to see what the wheels' speeds tell of them."""

OUTLIER = 3.0
"""Standard deviations beyond which what is missed counts linearly, in the fit of a single lag."""

QUARTILE = 0.6745
"""Of a normal distribution, in standard deviations: half of it lies no further from its middle."""
MIDDLE = 1.645
"""Standard deviations to either side that hold 90 % of a normal distribution."""


@dataclass(frozen=True)
class Response:
    """How the wheels follow commands.

    Attributes:
        lag: common time constant, s.
        lag_interval: 90 % of what it varies from change to change, and is off by, s.
        delay: dead time, s; negative down to the time between two rows.
        track_width: that the robot's own driver turns commands into wheel speeds with, m; None
            where commands do not turn.
        changes: of the command that were looked at.
        explained: share of the wheels' spread, by medians, that the response explains.
    """

    lag: float
    lag_interval: tuple[float, float]
    delay: float
    track_width: float | None
    changes: int
    explained: float


@dataclass(frozen=True, eq=False)
class _Changes:
    """The rows around changes of the command, and which of them belong to each change."""

    time: Float[np.ndarray, "n"]
    commands: Float[np.ndarray, "n 2"]
    wheels: Float[np.ndarray, "n 2"]
    rows: tuple[Int[np.ndarray, "k"], ...]


def find_response(log: Log) -> Response | None:
    """Fit dead time and lag of the wheels; None where a log has no commands or too few changes."""
    changes = _find_changes(log)
    if changes is None:
        return None
    delay, lag = _fit(changes)
    gains = _find_gains(changes, delay, lag)
    missed = float(np.median(np.abs(_miss(changes, delay, lag))))
    size = np.array([np.ptp(changes.wheels[rows], axis=0).max() for rows in changes.rows])
    large = np.flatnonzero(size > SMALLEST_CHANGE * size.max())
    single = np.array([_fit_lag(changes, changes.rows[k], delay, lag, gains) for k in large])
    least, greatest = _find_interval(lag, single[:, 0], single[:, 1])
    row = float(np.median(np.diff(changes.time)))
    width = float(gains[1, 0] - gains[1, 1])
    turns = bool(np.ptp(changes.commands[:, 1]) > 1e-3) and width > 0.0
    spread = float(np.median(np.abs(changes.wheels - np.median(changes.wheels, axis=0))))
    return Response(
        lag,
        (least if lag > SHORTEST_SEEN * row else 0.0, greatest),
        delay,
        width if turns else None,
        len(changes.rows),
        1.0 - missed / spread if spread > 0.0 else 0.0,
    )


def _find_changes(log: Log) -> _Changes | None:
    """Find the changes of command that were held long enough; None where there are too few."""
    if log.commands is None:
        return None
    changed = np.flatnonzero(np.any(np.diff(log.commands, axis=0) != 0.0, axis=1)) + 1
    end = np.append(log.time[changed[1:]], log.time[-1]) if len(changed) else log.time[:0]
    start = log.time[changed]
    rows = [
        np.arange(*np.searchsorted(log.time, [first - BEFORE_S, min(first + AFTER_S, last)]))
        for first, last in zip(start, end, strict=True)
        if last - first > SHORTEST_HOLD_S
    ]
    if len(rows) < FEWEST_CHANGES:
        return None
    used = np.unique(np.concatenate(rows))
    placed = tuple(np.searchsorted(used, part) for part in rows)
    return _Changes(log.time[used], log.commands[used], log.wheels[used], placed)


def _fit(changes: _Changes) -> tuple[float, float]:
    """Return dead time and lag that miss the wheels least."""
    row = float(np.median(np.diff(changes.time)))

    def cost(values: Float[np.ndarray, "2"]) -> float:
        missed = _miss(changes, values[0], values[1])
        return float(np.mean(np.sqrt(1.0 + (missed / SCALE_MPS) ** 2)))

    starts = [np.array([delay, lag]) for delay in (0.0, 0.1, 0.3) for lag in (0.03, 0.1, 0.3)]
    best = min(starts, key=cost)
    bounds = [(-row, LONGEST_DELAY_S), (0.0, LONGEST_LAG_S)]
    options = {"xatol": 1e-4, "fatol": 1e-9}
    fit = minimize(cost, best, method="Nelder-Mead", bounds=bounds, options=options)
    return float(fit.x[0]), float(fit.x[1])


def _fit_lag(
    changes: _Changes,
    rows: Int[np.ndarray, "k"],
    delay: float,
    lag: float,
    gains: Float[np.ndarray, "2 2"],
) -> tuple[float, float]:
    """Return the lag of the rows of one change, before which the wheels had settled, and its
    standard deviation, s.

    Gains are given; the dead time is the common one but for the wait until the next row, which is
    any part of the time between two rows.
    """
    time = changes.time[rows]
    commands = changes.commands[rows]
    row = float(np.median(np.diff(changes.time)))
    wait = row / np.sqrt(12.0)

    def miss(own_delay: float, own_lag: float) -> Float[np.ndarray, "k"]:
        expected = follow_commands(time, commands, own_delay, own_lag) @ gains
        return (changes.wheels[rows] - expected).ravel()

    spread = max(find_spread(miss(delay, lag)), SMALLEST_SPREAD_MPS)

    def residuals(values: Float[np.ndarray, "2"]) -> Float[np.ndarray, "k+1"]:
        return np.append(miss(*values.tolist()) / spread, (values[0] - delay) / wait)

    fit = least_squares(
        residuals,
        [delay, min(max(lag, STEP_S), 0.9 * LONGEST_LAG_S)],
        bounds=([delay - row, 0.0], [delay + row, LONGEST_LAG_S]),
        loss="soft_l1",
        f_scale=OUTLIER,
        diff_step=1e-2,
        x_scale=[wait, max(lag, STEP_S)],
    )
    slopes = np.column_stack([residuals(fit.x + step) for step in STEP_S * np.eye(2)])
    slopes = (slopes - residuals(fit.x)[:, None]) / STEP_S
    of_delay, of_lag = slopes.T
    information = of_lag @ of_lag - (of_lag @ of_delay) ** 2 / (of_delay @ of_delay)
    return float(fit.x[1]), max(float(information), row**-2.0) ** -0.5


def _find_interval(
    lag: float, single: Float[np.ndarray, "k"], errors: Float[np.ndarray, "k"]
) -> tuple[float, float]:
    """Return the interval of the lag, s.

    Args:
        lag: the common one, s; their mean may differ from it, as they have dead times of their own.
        single: of single changes, s.
        errors: their standard deviations, s.
    """
    away = np.abs(single - lag)

    def exceed(spread: float) -> float:
        return float(np.median(away / np.hypot(errors, spread))) - QUARTILE

    varies = 0.0
    if exceed(0.0) > 0.0:
        most = 2.0 * float(away.max()) / QUARTILE
        varies = float(root_scalar(exceed, bracket=(0.0, most)).root)
    weights = np.hypot(errors, varies) ** -2.0
    mean = float(weights @ single / weights.sum())
    reach = MIDDLE * float(np.hypot(varies, weights.sum() ** -0.5))
    return max(min(lag, mean) - reach, 0.0), max(lag, mean) + reach


def _miss(changes: _Changes, delay: float, lag: float) -> Float[np.ndarray, "k 2"]:
    """Return what the wheels differ from the best response with a dead time and a lag."""
    followed = follow_commands(changes.time, changes.commands, delay, lag)
    return changes.wheels - followed @ _find_gains(changes, delay, lag)


def _find_gains(changes: _Changes, delay: float, lag: float) -> Float[np.ndarray, "2 2"]:
    """Return the gains from (speed, yaw rate) to the wheels (right, left), by least squares that
    are weighted anew by what they miss."""
    followed = follow_commands(changes.time, changes.commands, delay, lag)
    weight = np.ones(len(followed))
    gains = np.zeros((2, 2))
    for _ in range(3):
        weighted = (followed * weight[:, None]).T
        gains = np.linalg.lstsq(weighted @ followed, weighted @ changes.wheels, rcond=None)[0]
        missed = np.linalg.norm(changes.wheels - followed @ gains, axis=1)
        weight = (1.0 + (missed / SCALE_MPS) ** 2) ** -0.5
    return gains


def follow_commands(
    time: Float[np.ndarray, "n"], commands: Float[np.ndarray, "n k"], delay: float, lag: float
) -> Float[np.ndarray, "n k"]:
    """Return the response to commands that are each held up to the next row, exact between rows.

    Args:
        time: of the rows, s, increasing.
        commands: at the rows.
        delay: s, of either sign.
        lag: time constant, s; 0 for none.
    """
    shifted = time - delay
    change = np.concatenate(
        [[0], np.flatnonzero(np.any(np.diff(commands, axis=0) != 0.0, axis=1)) + 1]
    )
    response = np.empty_like(commands, dtype=float)
    state = commands[0].astype(float)
    bounds = [*time[change[1:]].tolist(), np.inf]
    first = 0
    for row, end in zip(change, bounds, strict=True):
        last = int(np.searchsorted(shifted, end))
        start = time[row] if row else shifted[0]
        elapsed = np.maximum(shifted[first:last] - start, 0.0)
        decay = _decay(elapsed, lag)[:, None]
        response[first:last] = commands[row] + (state - commands[row]) * decay
        state = commands[row] + (state - commands[row]) * _decay(np.array(end - start), lag)
        first = last
    return response


def _decay(elapsed: np.ndarray, lag: float) -> np.ndarray:
    """Return exp(-elapsed / lag), 0 without a lag."""
    if lag < 1e-9:
        return np.zeros_like(elapsed)
    return np.exp(-elapsed / lag)
