"""Where the robot itself is while its committed pose is controlled, by `check_lag`; part of
`check_certificate`, of the standard library alone.

M is the motion that is still ahead of the robot, to its committed pose, R that of the reference over
the latency tau + D before; e is the error of the robot against where the reference was a latency
before, and e~ that of the committed pose. As motions, one after the other, M e~ = e R. Hence

    th  = M_h + th~ - R_h,
    z   = M_z + e^(i M_h) z~ - e^(i th) R_z.

Noise. A pose that is measured n off has e~ off by n turned by M_h, and by R_z turned by n_th.

Now. Yaw rates of commands are those of the reference less u2; those of the reference count in M
by what of each command is still to come, and in R by the time in it, which differ by `shift`. Run
out, M goes straight ahead first, and then turns and drives for D. The heading of R grows evenly at
most, so that in the mean its sine is that of half of it.

A latency later. Wheels are by then, and were on their way, as far as the nominal ones but for what
slip and unknown lag and delay take. These have, with the speed v at x and m the mean of the
commands that arrived within tau before, travelled tau (m - v) more than M: means of the same
commands, which differ by their range over e at most, e = 2.718, and so less at first; but M turns
by tau w only when it has run out. From ways that differ by (short, turned) at their end, by no more
than (short, swerved) before, and slide, the robot is off by

    ahead = short + sin(turn) across,    side = sin(turned) short + across,
    across = short |turn of M| + swerved |way| + slide.
"""

from fractions import Fraction
from math import ceil

from check_intervals import pick, read_units, require
from check_lag import (
    WHEELS,
    bound_losses,
    find_cosine,
    find_sine,
    find_width,
    list_errors,
    list_products,
    read_commands,
)
from check_sets import list_speeds
from check_travel import FORGOTTEN, decay, find_travel
from check_words import is_of_robot

KNOWN = {"lag", "delay", "nominal", "lever", "noise", "wheels", "speeds"}


def check_lateness(certificate):
    """Require lag and delay as known here, and that the noise of the committed pose is no less than
    what is made of that of the pose."""
    late = certificate["lateness"]
    is_known = set(late) == KNOWN and "learning" not in certificate and is_of_robot(certificate)
    require(is_known, "UNCHECKED: lag and delay beside learnt slips, or of a model alone")
    require(len(certificate["bands"]) == 1, "UNCHECKED: lag and delay where caps change by band")
    for times, nominal in zip(pick(late, "lag", "delay"), late["nominal"], strict=True):
        require(0 <= times[0] <= nominal <= times[1], "lag or delay is in no interval of times")
    require(find_width(late["delay"]) <= certificate["period"], "a command may pass another")
    (band,) = certificate["bands"]
    ranges = [*pick(late["wheels"], *WHEELS), late["speeds"]]
    require(all(low <= high for low, high in ranges), "a range of commands is crossed")
    latency = sum(late["nominal"])
    x, y, heading = late["noise"]
    require(min(x, y, heading) >= 0, "noise is negative")
    tilt = find_sine(latency * read_commands(certificate, band).turning)
    swing = latency * max(map(abs, list_reference(certificate)[0])) * heading
    made = (x + tilt * y + swing, y + tilt * x + swing, heading)
    is_held = all(a <= b for a, b in zip(made, certificate["noise"], strict=True))
    require(is_held, "noise of the committed pose may be more than it is said to be")


def list_reference(certificate):
    """Return the ranges of speeds and yaw rates of the reference."""
    (band,) = certificate["bands"]
    corners = [corner for region in band["regions"] for corner in list_speeds(region)[1]]
    speeds = [(right + left) / 2 for right, left in corners]
    rates = [(right - left) / certificate["track"] for right, left in corners]
    return (min(speeds), max(speeds)), (min(rates), max(rates))


def bound_poses(certificate, committed):
    """Return the greatest errors of the pose, now and a latency later, by those of the committed
    pose."""
    (band,) = certificate["bands"]
    commands = read_commands(certificate, band)
    now = bound_now(certificate, committed, commands)
    later = bound_later(certificate, committed, commands)
    return tuple(map(max, now, later))


def bound_now(certificate, committed, commands):
    """Return the greatest errors of the pose where a period ends."""
    (band,) = certificate["bands"]
    lag, delay = certificate["lateness"]["nominal"]
    latency = lag + delay
    x, y, heading = committed
    speeds, rates = list_reference(certificate)
    turn = latency * commands.turning
    bend = latency * max(map(abs, rates))
    apart = latency * max(map(abs, band["u2"])) + find_width(rates) * find_shift(certificate)
    tilted = heading + apart
    ahead = list_products([latency * v for v in commands.speeds], (find_cosine(turn), 1))
    behind = list_products([latency * v for v in speeds], (find_cosine(bend), 1))
    seen = list_products(behind, (find_cosine(tilted), 1))
    aside = latency * max(map(abs, speeds)) * find_sine(bend / 2)
    across = delay * commands.fastest * find_sine(turn)
    far = max(map(abs, behind))
    return (
        x
        + find_sine(turn) * y
        + max(ahead[1] - seen[0], seen[1] - ahead[0])
        + find_sine(tilted) * aside,
        y + find_sine(turn) * x + find_sine(tilted) * far + aside + across,
        tilted,
    )


def find_shift(certificate):
    """Return how much of M, s, is of other periods than in R."""
    T = certificate["period"]
    lag, delay = certificate["lateness"]["nominal"]
    count = ceil((FORGOTTEN * lag + delay) / T) + 1
    ages = [T * i for i in range(count + 1)]
    shift = Fraction(0)
    for young, old in zip(ages, ages[1:], strict=False):
        least, most = (
            (old - young) - (find_made(old - delay, lag)[i] - find_made(young - delay, lag)[1 - i])
            for i in (1, 0)
        )
        share = min(old, lag + delay) - min(young, lag + delay)
        shift += max(most - share, share - least)
    return (shift + lag * read_units(decay(ages[-1] - delay, lag)[1])) / 2


def find_made(time, lag):
    """Return the travel (least, greatest) of a step of 1 a time after it arrived, 0 before."""
    return find_travel(time, lag) if time > 0 else (0, 0)


def bound_later(certificate, committed, commands):
    """Return the greatest errors of the pose a latency after the end of a period."""
    T, b = pick(certificate, "period", "track")
    lag, delay = certificate["lateness"]["nominal"]
    latency = lag + delay
    losses = bound_losses(certificate, commands)
    x, y, heading = committed
    slipped = latency * sum(
        max(map(abs, old)) * max(map(abs, speeds))
        for (_, old, _), speeds in zip(list_errors(certificate), commands.wheels, strict=True)
    )
    apart = read_units(decay(Fraction(1), Fraction(1))[1]) * lag
    way_lost, turn_lost = (
        share * slipped + ceil(latency / T) * taken
        for share, taken in zip((Fraction(1, 2), 1 / b), losses.taken, strict=True)
    )
    short = apart * find_width(commands.speeds) + way_lost
    turned = apart * find_width(commands.yaw_rates) + turn_lost
    swerved = max(turned, lag * commands.turning + turn_lost)
    way = latency * commands.fastest + way_lost
    turn = latency * commands.turning
    slide = certificate["sideslip"] * way
    slide += abs(certificate["lever_arm"]) * (turn + turn_lost)
    across = short * turn + swerved * way + slide
    return (
        x + find_sine(turned) * y + short + find_sine(turn + turned) * across,
        y + find_sine(turned) * x + find_sine(turned) * short + across,
        heading + turned,
    )
