"""What lag of the wheels and delay of commands do to the motion; part of `check_certificate`, of the
standard library alone.

A controller whose wheels lag keeps small the error of its committed pose q_k, where the commands
given so far take the robot by the nominal lag tau and delay D. From its pose p_k wheels first run
out, as if the body drove tau v ahead and then turned by tau w, at the speeds v, w which they are
expected to have; then it drives an arc for every command of the last D. A command c so moves the
committed pose by its whole arc, whatever the wheels do meanwhile, and `check_motion` holds of it, but
for what is derived here: what is lost between p_k and p_(k+1) happens before the way that is still
ahead, which it turns.

Travels s = (x_r + x_l)/2, h = (x_r - x_l)/b of the wheels lead along the integral of e^(ih) ds. Two
ways to the same travels lead apart by i times the integral of e^(ih) over the area between them, in
ds dh, with its sign (Green). All is seen from the end, from which no heading differs by more than

    turn = (T + tau + D) |w| + kick + swerve.

Order. Without losses, wheels that follow from the speeds (v, w) to (v', w'), and then run out, and
wheels that run out, and then obey, lead to the same travels. The area between them comes to
tau^2/2 (v - v') (w + w') in all; between the straight run-out and the curve that the lag makes of
it lie tau^2/2 (1 - e^(-t/tau)) |v w_c - w v_c|, t the time under the command, and triangles
tau^2/2 |v w| at either end. Let the sums over the commands of a period be S and R, and s =
(T + tau) |w| / 2 from some heading hold all there. With an integrand between two numbers, areas add
up to its middle times S and half its range times R at most. So the ends are apart by

    ahead_0 = sin(turn) S + sin(s) R,    side_0 = S + sin(turn) sin(s) R,    far_0 = S + 2 sin(s/2) R.

Losses. Wheels lose (d_s, d_h)(t) of their travel, and the arc is driven at the command less the mean
of that, from which the loss strays by (stray, swerve). Let losses grow as r d, r from 0 to 1, let M(t)
be the way that is still ahead of the robot at t, and Y(t) where it leads, seen from the arc. A loss
moves the end along the heading at its time, and turns all that follows. Integrated by parts,

    dY/dr = terms i e^(ih) of size `across`  -  i integral of (M + Y) d d_h,
    across = ((tau + D) |w| + swerve) |d d_s| + (T |w| + kick) mean stray + (T |v| + way lost) mean swerve.

In M lie (tau + D) v, by cosines of up to `turn` shorter, ahead: the kick moves the end sideways by
the `lever` times itself, and by that by which the two differ, `missed`. Before the end of the period
travels differ by the stray, too, so that with swing = |d d_h|, grows = across + stray + swing (tau +
D) |v|, all |Y| stay below the line from far_0 to far_1 = (far_0 + grows) / (1 - swing). Ahead, Y
grows by tilted parts of the same, and as its own direction turns. So the rest of the motion is

    ahead = ahead_0 + sin(turn) (across + swing (tau + D) |v|) + swing (far_0 + far_1) / 2,
    side  = side_0 + across + swing (missed + ahead_0 + (sin(turn) (across + swing (tau + D) |v|)
            + stray) / 2 + swing (2 far_0 + far_1) / 3).

Slip takes the share d of what a wheel does, in all its share of some speed in the range of commands,
or d c of every command where each compensates another slip, and so strays with it. Sideslip and the
lever arm move the robot sideways at headings between those above.

Source: Smith 1957 and Artstein 1982 predict where commands take a plant.
"""

from fractions import Fraction
from itertools import product
from typing import NamedTuple

from check_intervals import COSINE, SINE, pick, read_units, require, scale
from check_sets import list_slips, list_speeds
from check_travel import bound_unknown, decay, find_strays, find_travel

WHEELS = ("right", "left")


class Late(NamedTuple):
    """What lag and delay add to a motion: the ways that slip takes from the wheels (right, left),
    ranges, m; (way m, turn rad) that unknown lag and delay take; the kick, rad, less than all these
    together give; the lever of kicks, m/rad; and how far the rest moves the robot, (m, m)."""

    lost: list
    taken: tuple
    kick: Fraction
    lever: Fraction
    box: tuple


class Commands(NamedTuple):
    """What is commanded: ranges of the speeds of the wheels (right, left), of the body, and of its
    yaw rate."""

    wheels: list
    speeds: tuple
    yaw_rates: tuple

    @property
    def fastest(self):
        """Greatest speed of the body."""
        return max(map(abs, self.speeds))

    @property
    def turning(self):
        """Greatest yaw rate."""
        return max(map(abs, self.yaw_rates))


class Losses(NamedTuple):
    """What is lost in a period, (way, turn): by slip, by unknown lag and delay, in all, up and down,
    and beside an even loss, at most and in the mean."""

    slipped: tuple
    taken: tuple
    total: tuple
    variation: tuple
    stray: tuple
    mean_stray: tuple


def find_width(ends):
    """Return the width of a range."""
    return ends[1] - ends[0]


def find_sine(angle):
    """Return the greatest sine of angles up to one."""
    return read_units(SINE.value(scale(angle))[1])


def find_cosine(angle):
    """Return the least cosine of angles up to one."""
    return read_units(COSINE.value(scale(angle))[0])


def read_commands(certificate, band):
    """Return what may be commanded. Wheels and body are proved by `check_motion`; yaw rates are
    those of the reference less u2."""
    late = certificate["lateness"]
    corners = [corner for region in band["regions"] for corner in list_speeds(region)[1]]
    rates = [(right - left) / certificate["track"] for right, left in corners]
    low, high = band["u2"]
    return Commands(
        pick(late["wheels"], *WHEELS), late["speeds"], (min(rates) - high, max(rates) - low)
    )


def find_late(certificate, band):
    """Return what lag and delay add to the motion of a band; None of wheels that obey at once."""
    if "lateness" not in certificate:
        return None
    T, b = pick(certificate, "period", "track")
    commands = read_commands(certificate, band)
    ranges = list_lost(certificate, commands)
    losses = bound_losses(certificate, commands)
    by_wheels = max(ranges[0][1] - ranges[1][0], ranges[1][1] - ranges[0][0]) / b
    ahead, side = bound_rest(certificate, commands, losses)
    way, turn = losses.slipped
    slide = certificate["sideslip"] * (T * commands.fastest + way)
    slide += abs(certificate["lever_arm"]) * (T * commands.turning + turn)
    tilt = find_sine(find_turn(certificate, commands, losses))
    return Late(
        lost=ranges,
        taken=losses.taken,
        kick=min(turn, by_wheels) + losses.taken[1],
        lever=certificate["lateness"]["lever"],
        box=(ahead + tilt * slide, side + slide),
    )


def narrow_levels(certificate, levels, late):
    """Return by name and sign up to which bound motions are to be proved, what lag and delay add
    besides taken off, and commands within those that are said to be given."""
    T = certificate["period"]
    asked = {**certificate["lateness"]["wheels"], "way": certificate["lateness"]["speeds"]}
    of_x, of_y = late.box
    beside = {"x": of_x, "y": of_y, "y of the model": of_y}
    narrowed = {key: level - beside.get(key[0], 0) for key, level in levels.items()}
    for sign in (1, -1):
        require(late.kick <= narrowed.pop(("kick", sign)), "lag may turn the robot by more than W")
        for name, ends in asked.items():
            level = T * (ends[1] if sign > 0 else -ends[0])
            narrowed[name, sign] = min(level, narrowed.get((name, sign), level))
    return narrowed


def list_errors(certificate):
    """Return by wheel ranges of d, of which the wheel loses the share: under the command of the
    period, and under those before it; and whether all of them compensate one slip."""
    errors = []
    for wheel in WHEELS:
        pairs = list_slips(certificate, wheel)
        seen = {compensated for _, compensated in pairs}
        fresh = [(true - slip) / (1 - slip) for true, slip in pairs]
        old = [(true - slip) / (1 - slip) for true, _ in pairs for slip in seen]
        errors.append(((min(fresh), max(fresh)), (min(old), max(old)), len(seen) == 1))
    return errors


def mix(certificate, fresh, old):
    """Return the greatest loss of a period, from the greatest under its command and under those
    before it, by the least share that the former has."""
    T = certificate["period"]
    lags, delays = pick(certificate["lateness"], "lag", "delay")
    share = max(find_travel(max(T - delays[1], Fraction(0)), lags[1])[0], 0) / T
    return share * fresh + (1 - share) * old


def list_products(first, second):
    """Return the ends of products of two ranges."""
    products = [a * b for a, b in product(first, second)]
    return min(products), max(products)


def list_lost(certificate, commands):
    """Return the ranges of the ways that slip takes from the wheels."""
    T = certificate["period"]
    ranges = []
    for (fresh, old, _), speeds in zip(list_errors(certificate), commands.wheels, strict=True):
        least, most = list_products(fresh, speeds)
        old_least, old_most = list_products(old, speeds)
        low = -T * mix(certificate, -least, -old_least)
        ranges.append((low, T * mix(certificate, most, old_most)))
    return ranges


def bound_losses(certificate, commands):
    """Return bounds of what is lost in a period."""
    T, b = pick(certificate, "period", "track")
    late = certificate["lateness"]
    unknown = bound_unknown(T, late["lag"], late["delay"], late["nominal"])
    most, mean = find_strays(T, *late["nominal"])
    errors = list_errors(certificate)
    sizes = [[max(map(abs, of_wheel[i])) for of_wheel in errors] for i in (0, 1)]
    fastest = [max(map(abs, ends)) for ends in commands.wheels]
    by_wheel = [sum(map(Fraction.__mul__, each, fastest)) for each in sizes]
    # Speeds of the wheels add up to 2 |v| or b |w|, whichever is more.
    of_both = max(2 * commands.fastest, b * commands.turning)
    by_body = [max(each) * of_both for each in sizes]
    slipped = T * min(mix(certificate, *by_wheel), mix(certificate, *by_body))
    width = 0
    for (_, old, is_one), speeds in zip(errors, commands.wheels, strict=True):
        width += (
            max(map(abs, old)) * find_width(speeds)
            if is_one
            else find_width(list_products(old, speeds))
        )
    of_body = (Fraction(1, 2), 1 / b)
    spans = (find_width(commands.speeds), find_width(commands.yaw_rates))
    each = list(zip(of_body, spans, strict=True))
    uneven = [share * width * unknown.uneven + span * unknown.uneven for share, span in each]
    return Losses(
        slipped=tuple(share * slipped for share in of_body),
        taken=tuple(span * unknown.total for span in spans),
        total=tuple(share * slipped + span * unknown.total for share, span in each),
        variation=tuple(share * slipped + span * unknown.variation for share, span in each),
        stray=tuple(s * width * most + more for s, more in zip(of_body, uneven, strict=True)),
        mean_stray=tuple(s * width * mean + more for s, more in zip(of_body, uneven, strict=True)),
    )


def find_turn(certificate, commands, losses):
    """Return by how much headings differ from that at the end at most."""
    latency = sum(certificate["lateness"]["nominal"])
    nominal = (certificate["period"] + latency) * commands.turning
    return nominal + losses.total[1] + losses.stray[1]


def bound_order(certificate, commands):
    """Return S, R and s of the order of motions."""
    T, b = pick(certificate, "period", "track")
    lag, delay = certificate["lateness"]["nominal"]
    arrives = delay % T
    times = [time for time in (arrives, T - arrives) if time]
    closed = sum(1 - read_units(decay(time, lag)[0]) for time in times)
    crossed = [
        max(abs(a * q - c * p) for a, c, p, q in product(first, first, second, second))
        for first, second in ((commands.speeds, commands.yaw_rates), commands.wheels)
    ]
    square = lag**2
    signed = square * closed * find_width(commands.speeds) * commands.turning
    sizes = closed * min(crossed[0], crossed[1] / b) / 2 + commands.fastest * commands.turning
    return signed, square * sizes, (T + lag) * commands.turning / 2


def bound_rest(certificate, commands, losses):
    """Return how far lag and delay move the robot ahead and sideways, beside the lever of kicks."""
    T = certificate["period"]
    latency = sum(certificate["lateness"]["nominal"])
    signed, sizes, spread = bound_order(certificate, commands)
    turn = find_turn(certificate, commands, losses)
    tilt = find_sine(turn)
    ahead_first = tilt * signed + find_sine(spread) * sizes
    side_first = signed + tilt * find_sine(spread) * sizes
    far_first = signed + 2 * find_sine(spread / 2) * sizes
    way, swing = losses.variation
    across = (latency * commands.turning + losses.stray[1]) * way
    across += (T * commands.turning + losses.total[1]) * losses.mean_stray[0]
    across += (T * commands.fastest + losses.total[0]) * losses.mean_stray[1]
    turned = swing * latency * commands.fastest
    require(swing < 1, "losses may turn the robot by a radian in a period")
    far_last = (far_first + across + losses.stray[0] + turned) / (1 - swing)
    tilted = tilt * (across + turned)
    grown = (tilted + losses.stray[0]) / 2 + swing * (2 * far_first + far_last) / 3
    lever = certificate["lateness"]["lever"]
    ways = [latency * v * c for v in commands.speeds for c in (1, find_cosine(turn))]
    missed = max(abs(each - lever) for each in ways)
    ahead = ahead_first + tilted + swing * (far_first + far_last) / 2
    return ahead, side_first + across + swing * (missed + ahead_first + grown)
