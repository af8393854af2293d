"""Where a robot itself is whose committed pose is controlled, as `check_lag` has it; part of
`check_certificate`, of the standard library alone.

Let M be the motion still ahead of the robot, to its committed pose, and R that of the reference
over the latency tau + D before; e the error of the robot against where the reference was a latency
before, e~ that of the committed pose against where it is. One after the other these motions lead to
the same place, M e~ = e R, so that

    th = M_h + th~ - R_h,    z = M_z + e^(i M_h) z~ - e^(i th) R_z.

Noise. Of a pose that is measured n off, e~ is off by n, turned by M_h, and by R_z, turned by n_th.

Now. Commanded yaw rates are those of the reference less u2. In M counts what of each command is
still to come, in R the time that it was given in; that the two weigh periods differently makes
`shift` of it. M leads straight ahead until the wheels have run out; only its arcs lead aside. The
headings of R grow no faster than evenly, so that the mean of their sines is at most that of half.

A latency later. The wheels have by then travelled, and on their way, as much as M says but for what
slip and unknown lag and delay take, and but for tau (m - v): m is the mean of the commands that
arrived in the last tau, v the speed, a mean of commands, too, that forgets with tau. The two differ
by 1/e of the range of commands at most, e = 2.718, and by less before tau; but M turns by tau w
only where its wheels have run out. Two ways whose travels differ by (short, turned) at the end, and
by (short, swerved) before, end by that much apart along the heading of M, and sideways by

    across = short |turn of M| + swerved |way of the robot| + slide.
"""

from fractions import Fraction
from itertools import pairwise
from math import ceil

from check_intervals import pick, read_units, require, scale, size, subtract
from check_lag import find_cosine, find_sine
from check_losses import (
    WHEELS,
    bound_losses,
    find_size,
    find_width,
    list_products,
    list_reference,
    list_shares,
    read_commands,
)
from check_travel import FORGOTTEN, decay, list_missed
from check_words import is_of_robot

MOST_PERIODS = 20  # of a lag or a delay: longer ones would take long to check
KNOWN = {"lag", "delay", "nominal", "lever", "noise", "wheels", "speeds"}


def check_lateness(certificate):
    """Require lag and delay as known here, and that the committed pose is not measured worse than
    it is said to be."""
    late = certificate["lateness"]
    is_known = set(late) == KNOWN and set(late["wheels"]) == set(WHEELS)
    require(is_known, "lag and delay are not described as known")
    is_known = "learning" not in certificate and is_of_robot(certificate)
    require(is_known, "UNCHECKED: lag and delay beside learnt slips, or of a model alone")
    require(len(certificate["bands"]) == 1, "UNCHECKED: lag and delay where caps change by band")
    for times, nominal in zip(pick(late, "lag", "delay"), late["nominal"], strict=True):
        low, high = times
        require(0 <= low <= nominal <= high, "lag or delay is in no interval of times")
        is_short = high <= MOST_PERIODS * certificate["period"]
        require(is_short, f"UNCHECKED: a lag or a delay of more than {MOST_PERIODS} periods")
    require(certificate["sideslip"] >= 0, "the sideslip is negative")
    require(find_width(late["delay"]) <= certificate["period"], "a command may overtake another")
    ranges = [*pick(late["wheels"], *WHEELS), late["speeds"]]
    require(all(low <= high for low, high in ranges), "a range of commands is crossed")
    made = commit_noise(certificate, late["noise"])
    is_held = all(most <= said for most, said in zip(made, certificate["noise"], strict=True))
    require(is_held, "the committed pose may be measured worse than it is said to be")


def commit_noise(certificate, noise):
    """Return what noise of the pose makes of the committed pose at most."""
    require(min(noise) >= 0, "noise is negative")
    (band,) = certificate["bands"]
    latency = sum(certificate["lateness"]["nominal"])
    x, y, heading = noise
    tilt = find_sine(latency * read_commands(certificate, band).turning)
    swing = latency * find_size(list_reference(certificate, band)[0]) * heading
    return x + tilt * y + swing, y + tilt * x + swing, heading


def bound_poses(certificate, committed):
    """Return the greatest errors of the pose, now and a latency later, by those of the committed
    pose, or of wheels that obey at once, which has both in the same place."""
    if "lateness" not in certificate:
        return committed
    (band,) = certificate["bands"]
    commands = read_commands(certificate, band)
    now = bound_now(certificate, committed, commands)
    later = bound_later(certificate, committed, commands)
    return tuple(map(max, now, later))


def bound_now(certificate, committed, commands):
    """Return the greatest errors of the pose where a period ends."""
    (band,) = certificate["bands"]
    latency = sum(certificate["lateness"]["nominal"])
    speeds, rates = list_reference(certificate, band)
    turn = latency * commands.turning
    bend = latency * find_size(rates)
    x, y, heading = committed
    apart = latency * find_size(band["u2"]) + find_width(rates) * find_shift(certificate)
    tilted = heading + apart
    ahead = list_products([latency * speed for speed in commands.speeds], (find_cosine(turn), 1))
    behind = list_products([latency * speed for speed in speeds], (find_cosine(bend), 1))
    seen = list_products(behind, (find_cosine(tilted), 1))
    aside = latency * find_size(speeds) * find_sine(bend / 2)
    _, delay = certificate["lateness"]["nominal"]
    across = delay * commands.fastest * find_sine(turn) + aside
    along = max(ahead[1] - seen[0], seen[1] - ahead[0]) + find_sine(tilted) * aside
    return (
        x + find_sine(turn) * y + along,
        y + find_sine(turn) * x + find_sine(tilted) * find_size(behind) + across,
        tilted,
    )


def find_shift(certificate):
    """Return how much of M, s, belongs to other periods than in R: half of what they differ by."""
    T = certificate["period"]
    lag, delay = certificate["lateness"]["nominal"]
    count = ceil((FORGOTTEN * lag + delay) / T) + 1
    # Of commands up to an age M has D or all of them, and what was missed since they arrived.
    driven = [min(T * m, lag + delay) - min(T * m, delay) for m in range(count + 1)]
    missed = list_missed(lag, -delay, T, count)
    units = 0
    for parts, ends in zip(pairwise(missed), pairwise(driven), strict=True):
        in_motion = subtract(parts[1], parts[0])
        units += size(subtract(in_motion, scale(ends[1] - ends[0])))
    left = lag * read_units(decay(count * T - delay, lag)[1])
    return (read_units(units) + left) / 2


def bound_later(certificate, committed, commands):
    """Return the greatest errors of the pose a latency after the end of a period."""
    lag, delay = certificate["lateness"]["nominal"]
    latency = lag + delay
    way_lost, turn_lost = bound_lost_by(certificate, commands, latency)
    # 1/e of a lag.
    apart = lag * read_units(decay(Fraction(1), Fraction(1))[1])
    short = apart * find_width(commands.speeds) + way_lost
    turned = apart * find_width(commands.yaw_rates) + turn_lost
    swerved = max(turned, lag * commands.turning + turn_lost)
    way = latency * commands.fastest + way_lost
    turn = latency * commands.turning
    slide = certificate["sideslip"] * way + abs(certificate["lever_arm"]) * (turn + turn_lost)
    across = short * turn + swerved * way + slide
    swing = find_sine(turned)
    x, y, heading = committed
    return (
        x + swing * y + short + find_sine(turn + turned) * across,
        y + swing * x + swing * short + across,
        heading + turned,
    )


def bound_lost_by(certificate, commands, time):
    """Return the (way m, turn rad) that slip and unknown lag and delay take within a time."""
    T, b = pick(certificate, "period", "track")
    shares = [find_size(each.old) for each in list_shares(certificate)]
    sizes = [find_size(speeds) for speeds in commands.wheels]
    spent = time * sum(share * speed for share, speed in zip(shares, sizes, strict=True))
    way, turn = bound_losses(certificate, commands).taken
    periods = ceil(time / T)
    return spent / 2 + periods * way, spent / b + periods * turn
