"""How wide the intervals of learnt slips can get, and how far ground speeds may then be off.

An observer intersects what windows of the last N = 1, 2, .. periods say of a wheel's slip
(`jaxtube.plant.slip_observer`, which has the identities). Over everything that is certified the
travel of a window is known within

    noise_N = n_x (2 + (N - 1) (1 - H cot H)) + 2 N n_y H + n_th (2 a + (N - 1) a') + N r
    a  = b/2 + E_y + l sin(E_th) / (2 sinc H),     a' = E_y + l sin(E_th) / sinc H

E the caps of the measured error, n its noise, H a bound on half the turn of a period, l on the
reference's way and r on second derivatives: the sums of the greatest derivatives at every instant.
With rolled travels T v_k, k = 0 for the last period, the slip of the next one lies within

    (noise_N + c T sum (k + 1) v_k) / (T sum v_k)

of the mean measured, where no slip changes by more than c a period. In each v_k this is a quotient
of linear functions whose slope has the sign of (k + 1) c less the quotient, so that it is largest
where the oldest travels are the greatest possible and the others the least: N + 1 cases.

`radius[a]` bounds half the width of the interval `a` periods after the first measurement, the last
one at all later times. The controller compensates the centre i_m, and the ground speed errs by
d = (i - i_m) / (1 - i_m). The interval lies in [least, greatest], so |d| <= r / (1 - greatest + r),
r the radius. Ground speeds g_k = v_k (1 - i_m,k) are bounded whatever slip is compensated, and
centres of the same slip differ little: with q_k = (1 - i_m) / (1 - i_m,k), |i_m - i_m,k| <= r +
r_k + (k + 1) c,

    |d| <= (noise_N + c T / (1 - greatest) sum (k + 1) g_k q_k) / (T sum g_k q_k)

as well, and the smaller bound counts.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

ROUNDING = 1e-9
"""What an observer's interval is wider by on either side (`jaxtube.plant.slip_observer`)."""
MOST_HALF_TURN = 0.5
"""Half turn of a period, rad, up to which an observer learns."""


class Learning(NamedTuple):
    """What slips are learnt from.

    Attributes:
        slips: ends of the intervals (least, greatest) by (right, left).
        change: c, greatest change of a slip from one period to the next.
        periods: that the observer looks back at.
        errors: half widths of the measured errors, (m, m, rad).
        noise: of their error in the robot's frame, (m, m, rad).
        speeds: ground speeds commanded (least, greatest) by (right, left), m/s.
        yaw_rate: greatest yaw rate commanded, rad/s.
        reference_speed: greatest of the reference, m/s.
        dt: period, s.
        track_width: m.
    """

    slips: Float[np.ndarray, "2 2"]
    change: float
    periods: int
    errors: Float[np.ndarray, "3"]
    noise: Float[np.ndarray, "3"]
    speeds: Float[np.ndarray, "2 2"]
    yaw_rate: float
    reference_speed: float
    dt: float
    track_width: float


class LearntSlips(NamedTuple):
    """Bounds by the periods since the first measurement, the last one for all later times.

    Attributes:
        radius: greatest distance of the true slips (right, left) from those compensated.
        wheel_errors: greatest |d| of the ground speeds (right, left).
    """

    radius: Float[np.ndarray, "ages 2"]
    wheel_errors: Float[np.ndarray, "ages 2"]


def bound_learnt_slips(learning: Learning) -> LearntSlips:
    """Return how wide the intervals of learnt slips can get while noise and slips keep their
    bounds; where the wheels may stand still nothing can be learnt, and the bounds are those of the
    intervals given."""
    least, greatest = learning.slips
    half_width = (greatest - least) / 2
    noise = _bound_noise(learning)
    slowest, fastest = learning.speeds
    fastest_wheels = np.stack([slowest / (1 - least), fastest / (1 - greatest)])
    radius = [half_width]
    errors = [half_width / (1 - greatest + half_width)]
    for age in range(1, learning.periods + 1):
        windows = noise[:age]
        by_rolling = _find_reach(learning, windows, [fastest_wheels] * age, np.ones(2))
        wide = np.minimum(by_rolling + ROUNDING, radius[-1] + learning.change)
        radius.append(_round_up(np.minimum(wide, half_width)))
        wide = radius[-1] / (1 - greatest + radius[-1])
        shares = [_find_least_share(learning, radius, age, back) for back in range(age)]
        by_speed = _find_reach(
            learning,
            windows,
            [np.stack([slowest * share, fastest / share]) for share in shares],
            1 - greatest,
        )
        by_speed = by_speed + ROUNDING / (1 - greatest)
        errors.append(_round_up(np.minimum(by_speed, wide)))
    return LearntSlips(np.array(radius), np.array(errors))


def _find_least_share(
    learning: Learning, radius: list[Float[np.ndarray, "2"]], age: int, back: int
) -> Float[np.ndarray, "2"]:
    """Return the least q_k = (1 - i_m) / (1 - i_m,k), 1 / q_k being as small at least."""
    least, greatest = learning.slips
    apart = radius[age] + radius[age - 1 - back] + (back + 1) * learning.change
    apart = np.minimum(apart, greatest - least)
    left = 1 - greatest
    return left / (left + apart)


def _find_reach(
    learning: Learning,
    noise: Float[np.ndarray, " windows"],
    speeds: list[Float[np.ndarray, "2 2"]],
    left: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """Return the least over some windows of the greatest reach from their means; infinite without
    travel.

    Args:
        learning: change and period.
        noise: of the windows of 1, 2, .. periods, m.
        speeds: (least, greatest) of every period back, m/s.
        left: what a change of the slip is divided by.
    """
    if np.any(speeds[0][0] <= 0) or not np.all(np.isfinite(noise)):
        return np.full(2, np.inf)
    best = np.full(2, np.inf)
    for size in range(1, len(noise) + 1):
        backs = np.arange(size)
        by_back = np.array(speeds[:size])
        worst = np.zeros(2)
        for newest in range(size + 1):
            is_old = (backs >= newest)[:, None]
            way = learning.dt * np.where(is_old, by_back[:, 1], by_back[:, 0])
            drift = learning.change * ((backs + 1) @ way) / left
            worst = np.maximum(worst, (noise[size - 1] + drift) / way.sum(axis=0))
        best = np.minimum(best, worst)
    return best


def _bound_noise(learning: Learning) -> Float[np.ndarray, " periods"]:
    """Return within what the travel of a window of 1, 2, .. periods is known, m; infinite where a
    period may turn too far."""
    along, lateral, heading = learning.errors
    of_x, of_y, of_heading = learning.noise
    least, greatest = learning.slips
    half_width = (greatest - least) / 2
    kick = (
        learning.dt
        * np.sum(learning.speeds[1] * half_width / (1 - greatest + half_width))
        / learning.track_width
    )
    half_turn = (learning.dt * learning.yaw_rate + kick) / 2 + 2 * of_heading
    if half_turn > MOST_HALF_TURN or heading > np.pi / 2:
        return np.full(learning.periods, np.inf)
    shortening = np.sinc(half_turn / np.pi)
    # H cot H, written so that nothing is divided by zero where the robot goes straight.
    stretch = np.cos(half_turn) / shortening
    way = learning.dt * learning.reference_speed
    swing = way * np.sin(heading) / shortening
    at_ends = learning.track_width / 2 + lateral + swing / 2
    inside = lateral + swing
    rest = half_turn * (1.4 * along + 0.36 * way) * of_heading
    rest += (0.75 * (along + of_x) + 0.905 * way) * of_heading**2
    rest += (0.7 * of_x + 2 * of_y) * of_heading
    sizes = np.arange(1, learning.periods + 1)
    noise = of_x * (2 + (sizes - 1) * (1 - stretch)) + 2 * sizes * of_y * half_turn
    noise = noise + of_heading * (2 * at_ends + (sizes - 1) * inside) + sizes * rest
    return _round_up(noise)


def _round_up(numbers: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return numbers above those that were rounded some hundred times."""
    return np.nextafter(numbers * (1 + 1e-13), np.inf)
