"""Exact re-check of gains by speed: the loops and gains of a band of wheel speeds.

A band is the part of a box of wheel speeds (V_r, V_l) in which their mean lies between two ends.
Phi is affine in p, q = T V_r t, T V_l t, t = tan(x)/x, x = T Om/2 (`exact_tube`), and t lies
between its values at the least and the greatest |x| of the band; so (p, q) lies in the hull of the
band's corners times both.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from sets.exact import Matrix, Numbers, Row, exact_row
from sets.robot.exact_tube import make_loop, tangent_ratio

Ends = tuple[float, float]
"""Mean wheel speeds at which a band begins and ends, m/s."""


def band_corners(low: Row, high: Row, ends: Ends) -> list[Row]:
    """Return the corners of a band, (right, left) in m/s, of the box from `low` to `high`."""
    slowest, fastest = exact_row(ends)
    box = [(right, left) for right in (low[0], high[0]) for left in (low[1], high[1])]
    inside = [point for point in box if slowest <= (point[0] + point[1]) / 2 <= fastest]
    crossings = []
    for mean in (slowest, fastest):
        crossings += [(right, 2 * mean - right) for right in (low[0], high[0])]
        crossings += [(2 * mean - left, left) for left in (low[1], high[1])]
    on_edges = [
        point
        for point in crossings
        if all(a <= speed <= b for a, speed, b in zip(low, point, high, strict=True))
    ]
    return list(dict.fromkeys([*inside, *on_edges]))


def room_in_band(wheels: Row, low: Row, high: Row, ends: Ends) -> Fraction:
    """Return by how much wheel speeds lie inside a band, m/s; negative outside."""
    slowest, fastest = exact_row(ends)
    mean = sum(wheels, Fraction(0)) / 2
    above = [speed - least for speed, least in zip(wheels, low, strict=True)]
    below = [most - speed for speed, most in zip(wheels, high, strict=True)]
    return min(*above, *below, mean - slowest, fastest - mean)


def exact_polygon_loops(
    gains: Numbers, corners: Sequence[Row], dt: float, track_width: float
) -> list[Matrix]:
    """Return loops whose hull holds Phi(th) at every th in the hull of the corners; `gains`: k1 in
    1/s, k2 in rad/s/m, k3 in 1/s.

    Raises:
        ValueError: the robot turns too far in a period.
    """
    k = exact_row(gains, "gains")
    T = Fraction(dt)
    b = Fraction(track_width)
    turns = [T * rate / 2 for rate in _find_yaw_rates(corners, b)]
    sizes = [abs(turn) for turn in turns]
    least = Fraction(0) if min(turns) < 0 < max(turns) else min(sizes)
    ratios = (tangent_ratio(least)[0], tangent_ratio(max(sizes))[1])
    ways = [(T * ratio * right, T * ratio * left) for right, left in corners for ratio in ratios]
    return [make_loop(k, (p - q) / (2 * b), (p + q) / 2, T) for p, q in ways]


def exact_polygon_feedbacks(
    gains: Numbers, corners: Sequence[Row], track_width: float
) -> list[Matrix]:
    """Return K at the least and the greatest yaw rate of the hull of the corners."""
    k1, k2, k3 = exact_row(gains, "gains")
    zero = Fraction(0)
    rates = _find_yaw_rates(corners, Fraction(track_width))
    return [
        ((-k1, -rate, zero), (zero, -k2, -k3)) for rate in dict.fromkeys((min(rates), max(rates)))
    ]


def _find_yaw_rates(corners: Sequence[Row], track_width: Fraction) -> list[Fraction]:
    """Return Om at the corners, rad/s."""
    return [(right - left) / track_width for right, left in corners]
