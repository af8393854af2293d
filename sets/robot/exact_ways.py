"""What lag and delay do to a period of a slipping robot, enclosed on integers.

The bounds of `sets.robot.committed` and `sets.robot.late_ways` derived once more; the notation is
the one there. Wheels travel n(t) - delta(t), n nominally, delta being lost; A(t) is the arc at the
speeds c - ell, ell = delta(T) / T, from the committed pose on.

Headings. n(t) relaxes to where the committed pose drives: what is nominal turns by (T + tau) |w|
from end to end, and what losses add keeps all headings within `turn` of that at the end.

Order. Let the areas between both nominal ways be S in all, and R in all magnitudes, met within
s = (T + tau) |w| / 2 of some heading. An integral over signed areas is at most the middle of the
integrand times S and half its range times R, hence ahead and sideways

    x_0 = sin(turn) S + sin(s) R,    y_0 = S + sin(turn) sin(s) R,    first = S + 2 sin(s / 2) R

at most, and so at every instant. Lost. Let them grow as lambda delta from 0 to 1. With p_A(t) and
p(t) on the arc and on the way, by parts

    d/dlambda (the ends' distance, seen from there)
        = (terms i e^{i h}, of size `across`) - i integral of (p_A - p)(t) d delta_theta(t)

where p_A - p is the motion still ahead at t, latency times a commanded speed, and a rest Y(t) that
begins like the ends' distance, and as the travels differ there by the strays of delta

    |dY/dlambda| <= grows + 2 swing |Y|,    grows = across + stray + swing latency |v|

with swing, the variation of delta_theta. So |Y| stays below last = (first + grows) / (1 - 2 swing)
and below the line from first to last. The motion ahead is the lever's but for `miss`; what is left
is (x, y) of `enclose_box`.

Source: new.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import NamedTuple

import numpy as np

from sets.exact import Row, dot, exact_row
from sets.exact_interval import ExactInterval, enclose_numbers
from sets.interval import cos, sin
from sets.robot.exact_travel import (
    Taken,
    enclose_one,
    enclose_taken,
    enclose_travel,
    fade,
    find_largest,
    find_smallest,
    take,
)
from sets.robot.late_ways import Driving
from sets.robot.operation import Operation


class LateDriving(NamedTuple):
    """Period, track and nominal lag and delay, s and m; ends of what is commanded, m/s and rad/s,
    of the wheels (right, left), and greatest changes of the wheels' speeds, None for no limit."""

    operation: Operation
    dt: Fraction
    track: Fraction
    lag: Fraction
    delay: Fraction
    wheels: tuple[Row, Row]
    speeds: Row
    yaw_rates: Row
    steps: Row | None

    @property
    def latency(self) -> Fraction:
        return self.lag + self.delay

    @property
    def speed(self) -> Fraction:
        """Greatest speed of the body."""
        return max(map(abs, self.speeds))

    @property
    def yaw_rate(self) -> Fraction:
        """Greatest yaw rate."""
        return max(map(abs, self.yaw_rates))

    @property
    def of_body(self) -> ExactInterval:
        """What a wheel's travel makes of the body's way and turn, 1 and 1/m."""
        return enclose_numbers([Fraction(1, 2), 1 / self.track])

    @property
    def arrives(self) -> Fraction:
        """When in a period a command arrives."""
        return self.delay % self.dt


class Losses(NamedTuple):
    """What is lost in a period: least and greatest speed that slip takes from the wheels (right,
    left), m/s; and of (way m, turn rad) what unknown lag and delay take, what slip does, both
    together, their variation, and how far they stray from an even loss, at most and in the mean."""

    least: ExactInterval
    most: ExactInterval
    unknown: ExactInterval
    slipped: ExactInterval
    total: ExactInterval
    variation: ExactInterval
    strays: ExactInterval
    mean_strays: ExactInterval


def read_late(operation: Operation, driving: Driving) -> LateDriving:
    """Return the numbers of an operation as rationals."""
    lag, delay = map(Fraction, operation.actuation.nominal(operation.dt))
    steps = operation.command_steps
    return LateDriving(
        operation,
        Fraction(operation.dt),
        Fraction(operation.track_width),
        lag,
        delay,
        (exact_row(driving.wheels[:, 0]), exact_row(driving.wheels[:, 1])),
        exact_row(driving.speed),
        exact_row(driving.yaw_rate),
        None if steps is None else exact_row(steps),
    )


def enclose_lost(late: LateDriving) -> Losses:
    """Enclose what is lost in a period."""
    errors = _read_errors(late.operation.wheel_errors)
    stale = late.operation.stale_errors
    old = errors if stale is None else _read_errors(stale)
    share = _enclose_fresh_share(late)
    products = [_find_products(ends, late.wheels) for ends in (errors, old)]
    (least, most), (old_least, old_most) = products
    largest = [[max(map(abs, ends)) for ends in each] for each in (errors, old)]
    slipped = late.of_body * late.dt * _enclose_slip(late, share, *largest)
    unknown = _enclose_unknown(late, largest[0], None if stale is None else products[1])
    if stale is None:
        span = sum(d * _width(ends) for d, ends in zip(largest[0], late.wheels, strict=True))
    else:
        span = sum(old_most) - sum(old_least)
    stray, mean_stray = _enclose_strays(late)
    stray = late.of_body * span * stray
    mean_stray = late.of_body * span * mean_stray
    return Losses(
        least=_mix(share, least, old_least),
        most=_mix(share, most, old_most),
        unknown=unknown.total,
        slipped=slipped,
        total=slipped + unknown.total,
        variation=slipped + unknown.variation,
        strays=stray + unknown.unevenness,
        mean_strays=mean_stray + unknown.unevenness,
    )


def _read_errors(errors: np.ndarray) -> tuple[Row, Row]:
    """Return the least and the greatest error of each wheel."""
    return exact_row(errors[:, 0]), exact_row(errors[:, 1])


def _width(ends: Row) -> Fraction:
    return ends[1] - ends[0]


def _find_products(errors: tuple[Row, Row], wheels: tuple[Row, Row]) -> tuple[Row, Row]:
    """Return the least and the greatest products of errors and speeds of each wheel."""
    each = [
        [error * speed for error, speed in product(*pair)]
        for pair in zip(errors, wheels, strict=True)
    ]
    return tuple(map(min, each)), tuple(map(max, each))


def _mix(share: ExactInterval, fresh: Row, old: Row) -> ExactInterval:
    """Return what of a wheel's travel is under the command of the period, and the rest."""
    return share * enclose_numbers(fresh) + (1 - share) * enclose_numbers(old)


def _enclose_fresh_share(late: LateDriving) -> ExactInterval:
    """Enclose the least share of a period's travel that is under the command of the period: errors
    of older commands range at least as far."""
    actuation = late.operation.actuation
    left = max(late.dt - Fraction(actuation.delay[1]), Fraction(0))
    return enclose_travel(left, Fraction(actuation.lag[1])) * (1 / late.dt)


def _enclose_slip(
    late: LateDriving, share: ExactInterval, fresh: list[Fraction], old: list[Fraction]
) -> ExactInterval:
    """Enclose the speed that slip takes from both wheels together: their speeds add up to 2 |v| or
    b |w|, whichever is more."""
    fastest = [max(map(abs, ends)) for ends in late.wheels]
    of_body = max(2 * late.speed, late.track * late.yaw_rate)
    by_wheel = [(dot(each, fastest),) for each in (fresh, old)]
    by_body = [(max(each) * of_body,) for each in (fresh, old)]
    return find_smallest(_mix(share, *by_wheel), _mix(share, *by_body))


def _enclose_unknown(
    late: LateDriving, largest: list[Fraction], products: tuple[Row, Row] | None
) -> Taken:
    """Enclose what unknown lag and delay take from the body's (way, turn), and what slip makes of
    that: of each wheel its share, or, where d differs by command, that of a signal d c."""
    actuation = late.operation.actuation
    dt = late.operation.dt
    spans = (_width(late.speeds), _width(late.yaw_rates))
    sides = None
    if late.steps is not None:
        both = dot(late.steps, (Fraction(1), Fraction(1)))
        sides = (both / 2, both / late.track)
    of_body = enclose_taken(actuation, dt, spans, sides)
    if products is None:
        widths = tuple(map(_width, late.wheels))
        of_wheels = enclose_taken(actuation, dt, widths, late.steps)
        shares = enclose_numbers(largest)
    else:
        widths = tuple(most - least for least, most in zip(*products, strict=True))
        of_wheels = enclose_taken(actuation, dt, widths, None)
        shares = enclose_one(1)
    slips = [shares * part for part in of_wheels]
    slips = [late.of_body * (take(part, np.s_[:1]) + take(part, np.s_[1:])) for part in slips]
    return Taken(*(own + slip for own, slip in zip(of_body, slips, strict=True)))


def _enclose_strays(late: LateDriving) -> tuple[ExactInterval, ExactInterval]:
    """Enclose how far nominal travel strays from an even one, at most and in the mean, s, per width
    of the range of commands.

    Under one command it bends one way, with slopes from 0 to 1; so does what the next one adds that
    arrives within the period. A way of slopes 0 and 1 strays most, by T m (1 - m).
    """
    dt = late.dt
    held = late.lag * (1 - fade(dt, late.lag)) * (1 / dt)
    most = dt * held * (1 - held)
    mean = late.lag * (1 - held) - held * (dt / 2)
    left = dt - late.arrives
    if left < dt:
        travel = enclose_travel(left, late.lag)
        share = travel * (1 / dt)
        most = most + dt * share * (1 - share)
        mean = mean + travel * Fraction(1, 2) - (left**2 / 2 - late.lag * travel) * (1 / dt)
    return most, mean


class _Order(NamedTuple):
    """S, R and s of the module docstring, m and rad."""

    sideways: ExactInterval
    sizes: ExactInterval
    spread: Fraction


def _enclose_order(late: LateDriving) -> _Order:
    """Enclose what it does that nominal wheels run out before the period instead of after it.

    From the speed s to s', under a command c, the areas add up to tau^2 / 2 (v' - v) (w + w'), and
    between the straight run-out and the arc that it rounds off lies tau^2 / 2 (1 - e^{-t / tau})
    |s x c|; what body drives before it turns adds a triangle at either end.
    """
    pieces = {late.arrives, late.dt - late.arrives} - {Fraction(0)}
    closed = [1 - fade(piece, late.lag) for piece in pieces]
    closed = closed[0] * 2 if late.arrives * 2 == late.dt else sum(closed[1:], closed[0])
    slowest, fastest = late.speeds
    of_body = _find_greatest_cross(late.speeds, late.yaw_rates)
    of_wheels = _find_greatest_cross(*late.wheels) / late.track
    apart = enclose_one(fastest - slowest)
    if late.steps is not None:
        # A speed that follows steps is so far behind the last of them.
        behind = enclose_one(sum(late.steps) / 2) / (1 - fade(late.dt, late.lag))
        apart = find_smallest(apart, behind)
    square = late.lag**2
    return _Order(
        sideways=closed * apart * (square * late.yaw_rate),
        sizes=(closed * (min(of_body, of_wheels) / 2) + late.speed * late.yaw_rate) * square,
        spread=(late.dt + late.lag) * late.yaw_rate / 2,
    )


def _find_greatest_cross(first: Row, second: Row) -> Fraction:
    """Return the greatest |a q - b p| of a, b in one range and p, q in another."""
    return max(abs(a * q - b * p) for a, b, p, q in product(first, first, second, second))


def enclose_turn(late: LateDriving, lost: Losses) -> ExactInterval:
    """Enclose by how much headings differ from that at the end at most, rad."""
    nominal = (late.dt + late.latency) * late.yaw_rate
    return take(lost.total, np.s_[1:]) + take(lost.strays, np.s_[1:]) + nominal


def enclose_box(
    late: LateDriving, lost: Losses, lever: Fraction
) -> tuple[ExactInterval, ExactInterval]:
    """Enclose half widths (m, m) of what lag and delay do beside a kick with a lever, m.

    Raises:
        ValueError: where the robot may turn, or its wheels lose, too much.
    """
    turn = enclose_turn(late, lost)
    tilt = sin(turn)
    sideways, sizes, spread = _enclose_order(late)
    spread_sine = sin(enclose_one(spread))
    ahead_first = tilt * sideways + spread_sine * sizes
    sideways_first = sideways + tilt * spread_sine * sizes
    first = sideways + sizes * sin(enclose_one(spread / 2)) * 2
    across = _enclose_across(late, lost)
    stray = take(lost.strays, np.s_[:1])
    swing = take(lost.variation, np.s_[1:])
    reach = swing * (late.latency * late.speed)
    left = 1 - swing * 2
    if left.lower[0] <= 0:
        raise ValueError("what the wheels lose may turn the robot by half a radian in a period")
    last = (first + across + stray + reach) / left
    ahead = ahead_first + tilt * (across + reach) + swing * (first + last) * Fraction(1, 2)
    # The mean of Y ahead while losses grow, Y itself between `first` and `last` and turned by them.
    grown = (tilt * (across + reach) + stray) * Fraction(1, 2)
    rest = ahead_first + grown + swing * (first + last * Fraction(1, 2))
    missed = _enclose_missed_lever(late, turn, lever)
    return ahead, sideways_first + across + swing * (missed + rest)


def _enclose_across(late: LateDriving, lost: Losses) -> ExactInterval:
    """Enclose what losses do at other headings and unevenly: as much way as they have in all, by
    how far the headings of the arc and of the robot differ, and strays of way and turn along the
    arc."""
    way, _ = _split(lost.variation)
    slowing, kick = _split(lost.total)
    _, swerve = _split(lost.strays)
    mean_stray, mean_swerve = _split(lost.mean_strays)
    turned = late.latency * late.yaw_rate + swerve
    of_arc = late.dt * late.yaw_rate + kick
    way_of_arc = late.dt * late.speed + slowing
    return turned * way + of_arc * mean_stray + way_of_arc * mean_swerve


def _split(values: ExactInterval) -> tuple[ExactInterval, ExactInterval]:
    """Return the way and the turn."""
    return take(values, np.s_[:1]), take(values, np.s_[1:])


def _enclose_missed_lever(late: LateDriving, turn: ExactInterval, lever: Fraction) -> ExactInterval:
    """Enclose how far the way still ahead, seen from the end, differs from a lever, m."""
    cosine = cos(turn)
    misses = []
    for speed in late.speeds:
        way = late.latency * speed
        misses += [enclose_one(way) - lever, cosine * way - lever]
    return find_largest(*misses, *(-miss for miss in misses))


def enclose_slide(late: LateDriving, lost: Losses) -> tuple[ExactInterval, ExactInterval]:
    """Enclose half widths (m, m) of what sideslip and lever arm do: wheels drive no further than
    commanded and slipped.

    Raises:
        ValueError: where the robot may turn by more than a quarter turn.
    """
    way, turn = _split(lost.slipped)
    of_way = (late.dt * late.speed + way) * Fraction(late.operation.sideslip)
    of_turn = (late.dt * late.yaw_rate + turn) * abs(Fraction(late.operation.lever_arm))
    slide = of_way + of_turn
    return slide * sin(enclose_turn(late, lost)), slide
