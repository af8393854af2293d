"""What lag of the wheels and delay of commands do to the motion; part of `check_certificate`, of
the standard library alone.

A controller whose wheels lag keeps small the error of its committed pose q_k, to which the commands
given so far lead by the nominal lag tau and delay D. From the robot's pose p_k the wheels first run
out, as if the body drove tau v ahead and then turned by tau w at the speeds v, w that they are
expected to have; then the body drives an arc for each command of the last D. So a command c_k moves
the committed pose by its whole arc, and `check_motion` holds of it, but for the order of motions,
and for what is lost between p_k and p_(k+1), before the way that is still ahead.

Travels s = (x_r + x_l)/2, h = (x_r - x_l)/b of the wheels lead along the integral of e^(ih) ds. Two
ways to the same travels lead apart by i times the integral of e^(ih) over the signed area between
them in s and h (Green). All is seen from the end. No heading differs from the one there by more
than

    turn = (T + tau + D) |w| + turn lost + swerve.

Order. Wheels that follow a command from the speeds (v, w) to (v', w') and then run out, and wheels
that run out and then obey, reach the same travels. The area between them is tau^2/2 (v - v')
(w + w') in all. It is made of triangles tau^2/2 |v w| at either end, and, between the straight run-
out and the curve that the lag makes of it, of tau^2/2 (1 - e^(-t/tau)) |v w_c - w v_c|, after a
time t under the command (v_c, w_c). Let S and R be the sums of these over the commands that act in
a period. All headings there are within g = (T + tau) |w| / 2 of one. Where an integrand lies
between two numbers, signed areas add up to its middle times S and half its range times R at most:

    ahead_0 = sin(turn) S + sin(g) R,    side_0 = S + sin(turn) sin(g) R,
    far_0 = S + 2 sin(g/2) R.

Losses. Let d(t) = (d_s, d_h) be the travel lost until t, beside an even loss by (stray, swerve);
the arc is driven at what the even loss leaves of the command. Let losses grow as r d, 0 <= r <= 1.
A loss moves the end along the heading at its time, and turns what follows. With M(t) the way still
ahead of the robot at t, and Y(t) how far it leads from the arc, by parts

    dY/dr = terms i e^(ih), `across` in all  -  i integral of (M + Y) d d_h,
    across = ((tau + D) |w| + swerve) |way lost|, up and down, + (T |w| + turn lost) mean stray
             + (T |v| + way lost) mean swerve.

Ahead, M is (tau + D) v, or shorter by the cosine of `turn`; so a kick moves the end sideways by
`lever` times itself, and by the difference of the two, `missed`. With `swing` the turn lost up and
down, and turned = swing (tau + D) |v|, Y is below the line from far_0 to

    far_1 = (far_0 + across + stray + turned) / (1 - swing),

the stray for times before the end. Ahead it begins with ahead_0, and grows by sin(turn) (across +
turned), by the stray, and by Y as it turns, twice: once in the integral, once with the end. Hence

    ahead = ahead_0 + sin(turn) (across + turned) + swing (far_0 + far_1) / 2,
    side  = side_0 + across + swing (missed + ahead_0 + (sin(turn) (across + turned) + stray) / 2
                                     + swing (2 far_0 + far_1) / 3).

Sideslip and lever arm move the robot sideways, too, at headings within `turn`.

Source: predicting where commands lead a plant goes back to Smith 1957 and Artstein 1982.
"""

from fractions import Fraction
from itertools import product
from typing import NamedTuple

from check_estimate import read_estimate
from check_intervals import COSINE, SINE, pick, read_units, require, scale
from check_losses import bound_losses, find_width, list_lost, read_commands
from check_travel import decay


class Late(NamedTuple):
    """What lag and delay make of a period: the ranges of the ways, m, that slip takes from the
    wheels (right, left); the (way m, turn rad) that unknown lag and delay take; the kick, rad, less
    than these together give; its lever, m; and the (m, m) by which the robot is moved besides,
    ahead and sideways, in either direction."""

    lost: list
    taken: tuple
    kick: Fraction
    lever: Fraction
    rest: tuple


def find_sine(angle):
    """Return the greatest sine of angles up to one."""
    return read_units(SINE.value(scale(angle))[1])


def find_cosine(angle):
    """Return the least cosine of angles up to one."""
    return read_units(COSINE.value(scale(angle))[0])


def find_late(certificate, band):
    """Return what lag and delay make of the motion of a band; None of wheels that obey at once."""
    if "lateness" not in certificate:
        return None
    T, b, lever_arm = pick(certificate, "period", "track", "lever_arm")
    commands = read_commands(certificate, band)
    losses = bound_losses(certificate, commands)
    lost = list_lost(certificate, commands)
    right, left = lost
    by_wheels = max(right[1] - left[0], left[1] - right[0]) / b
    way, turn = losses.slipped
    slide = certificate["sideslip"] * (T * commands.fastest + way)
    slide += abs(lever_arm) * (T * commands.turning + turn)
    tilt = find_sine(find_turn(certificate, commands, losses))
    ahead, side = bound_rest(certificate, commands, losses)
    return Late(
        lost=lost,
        taken=losses.taken,
        kick=min(turn, by_wheels) + losses.taken[1],
        lever=certificate["lateness"]["lever"],
        rest=(ahead + tilt * slide, side + slide),
    )


def narrow_levels(certificate, levels, late):
    """Return by name and sign up to which bound motions are to be proved: W less the rest, and
    commands within those that the certificate says."""
    T = certificate["period"]
    asked = {**certificate["lateness"]["wheels"], "way": certificate["lateness"]["speeds"]}
    ahead, side = late.rest
    (_, gain, _), _ = read_estimate(certificate)
    beside = {"x": ahead, "y": gain * side, "y of the model": gain * side, "unpredicted y": side}
    narrowed = {key: level - beside.get(key[0], 0) for key, level in levels.items()}
    for sign in (1, -1):
        require(late.kick <= narrowed.pop(("kick", sign)), "lag may turn the robot further than W")
        for name, ends in asked.items():
            level = T * (ends[1] if sign > 0 else -ends[0])
            narrowed[name, sign] = min(level, narrowed.get((name, sign), level))
    return narrowed


def find_turn(certificate, commands, losses):
    """Return by how much headings differ from the one at the end at most, rad."""
    latency = sum(certificate["lateness"]["nominal"])
    nominal = (certificate["period"] + latency) * commands.turning
    return nominal + losses.total[1] + losses.stray[1]


def bound_order(certificate, commands):
    """Return S and R, m, and g, rad, of the order of motions."""
    T, b = pick(certificate, "period", "track")
    lag, delay = certificate["lateness"]["nominal"]
    arrives = delay % T
    closed = sum(1 - read_units(decay(time, lag)[0]) for time in (arrives, T - arrives) if time)
    of_body = find_greatest_cross(commands.speeds, commands.yaw_rates)
    of_wheels = find_greatest_cross(*commands.wheels) / b
    in_all = lag**2 * closed * find_width(commands.speeds) * commands.turning
    sizes = closed * min(of_body, of_wheels) / 2 + commands.fastest * commands.turning
    return in_all, lag**2 * sizes, (T + lag) * commands.turning / 2


def find_greatest_cross(first, second):
    """Return the greatest |a q - c p| of a, c in one range and p, q in another."""
    return max(abs(a * q - c * p) for a, c, p, q in product(first, first, second, second))


def bound_rest(certificate, commands, losses):
    """Return how far lag and delay move the robot ahead and sideways, m, beside the lever times a
    kick."""
    latency = sum(certificate["lateness"]["nominal"])
    in_all, sizes, spread = bound_order(certificate, commands)
    turn = find_turn(certificate, commands, losses)
    tilt = find_sine(turn)
    ahead_first = tilt * in_all + find_sine(spread) * sizes
    side_first = in_all + tilt * find_sine(spread) * sizes
    far_first = in_all + 2 * find_sine(spread / 2) * sizes
    stray = losses.stray[0]
    swing = losses.variation[1]
    across = bound_across(certificate, commands, losses)
    turned = swing * latency * commands.fastest
    far_last = grow(far_first, across + stray + turned, swing)
    tilted = tilt * (across + turned)
    ahead = ahead_first + tilted + swing * (far_first + far_last) / 2
    drift = ahead_first + (tilted + stray) / 2 + swing * (2 * far_first + far_last) / 3
    missed = find_miss(certificate, commands, turn)
    return ahead, side_first + across + swing * (missed + drift)


def grow(first, steady, rate):
    """Return how large a number is at last that grows by something steady and a rate of itself, for
    a time of one: it is no larger before."""
    require(rate < 1, "losses may turn the robot by a radian in a period")
    return (first + steady) / (1 - rate)


def bound_across(certificate, commands, losses):
    """Return how far losses lead aside because they come at other headings and unevenly, m."""
    T = certificate["period"]
    latency = sum(certificate["lateness"]["nominal"])
    way_lost, turn_lost = losses.total
    mean_stray, mean_swerve = losses.mean_stray
    across = (latency * commands.turning + losses.stray[1]) * losses.variation[0]
    across += (T * commands.turning + turn_lost) * mean_stray
    across += (T * commands.fastest + way_lost) * mean_swerve
    return across


def find_miss(certificate, commands, turn):
    """Return how far the way still ahead, seen from the end, differs from the lever, m."""
    late = certificate["lateness"]
    ways = [sum(late["nominal"]) * speed for speed in commands.speeds]
    seen = [factor * way for way in ways for factor in (1, find_cosine(turn))]
    return max(abs(each - late["lever"]) for each in seen)
