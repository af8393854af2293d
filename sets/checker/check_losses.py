"""What wheels that lag may be asked for, and what they lose of it within a period; part of
`check_certificate`, of the standard library alone.

Wheels always are at some mean of commands, so that what bounds those bounds what wheels do. Slip
takes the share d of it from a wheel: the same share throughout a period where one slip is always
compensated, another share of every command where each compensates another slip. Of the share
of travel under the command of the period d is that of `check_motion`; in the rest any true slip may
meet any slip that was compensated. Both wheels together lose at most what each may lose alone, and
at most the greater d of 2 |v| or b |w|, whichever is more, the sum of their speeds.

Unknown lag and delay take from the body what `check_travel` bounds by the width of the ranges of v
and w. A loss strays from an even one as far as what it is a share of: the expected travel by the
widths of the ranges of losses, and unknown lag and delay besides.
"""

from fractions import Fraction
from itertools import product
from operator import mul
from typing import NamedTuple

from check_intervals import pick
from check_sets import list_slips, list_speeds
from check_travel import bound_unknown, find_strays, find_travel

WHEELS = ("right", "left")


class Commands(NamedTuple):
    """What is commanded: ranges of the speeds of the wheels (right, left) and of the body, and of
    its yaw rate."""

    wheels: list
    speeds: tuple
    yaw_rates: tuple

    @property
    def fastest(self):
        """Greatest speed of the body."""
        return find_size(self.speeds)

    @property
    def turning(self):
        """Greatest yaw rate."""
        return find_size(self.yaw_rates)


class Losses(NamedTuple):
    """What is lost in a period, (way m, turn rad): by slip, by unknown lag and delay, by both; up
    and down; and beside an even loss, at most and in the mean."""

    slipped: tuple
    taken: tuple
    total: tuple
    variation: tuple
    stray: tuple
    mean_stray: tuple


class Shares(NamedTuple):
    """Ranges of d of a wheel, under the command of the period and under older ones, and whether all
    of them compensate one slip."""

    fresh: tuple
    old: tuple
    is_one: bool


def find_size(ends):
    """Return the greatest magnitude in a range."""
    return max(map(abs, ends))


def find_width(ends):
    """Return the width of a range."""
    return ends[1] - ends[0]


def list_products(first, second):
    """Return the ends of the products of two ranges."""
    products = [a * b for a, b in product(first, second)]
    return min(products), max(products)


def list_reference(certificate, band):
    """Return the ranges of the speeds and of the yaw rates of the reference."""
    corners = [corner for region in band["regions"] for corner in list_speeds(region)[1]]
    speeds = [(right + left) / 2 for right, left in corners]
    rates = [(right - left) / certificate["track"] for right, left in corners]
    return (min(speeds), max(speeds)), (min(rates), max(rates))


def read_commands(certificate, band):
    """Return what may be commanded. Speeds are as the certificate says, and proved as W is; yaw
    rates are those of the reference less u2."""
    late = certificate["lateness"]
    _, (slowest, fastest) = list_reference(certificate, band)
    low, high = band["u2"]
    return Commands(pick(late["wheels"], *WHEELS), late["speeds"], (slowest - high, fastest - low))


def list_shares(certificate):
    """Return what slip may take from the wheels (right, left)."""
    shares = []
    for wheel in WHEELS:
        pairs = list_slips(certificate, wheel)
        seen = {compensated for _, compensated in pairs}
        fresh = [(true - slip) / (1 - slip) for true, slip in pairs]
        old = [(true - slip) / (1 - slip) for true, _ in pairs for slip in seen]
        shares.append(Shares((min(fresh), max(fresh)), (min(old), max(old)), len(seen) == 1))
    return shares


def mix(certificate, fresh, old):
    """Return the greatest loss in the mean of a period, from the greatest under its own command and
    the greatest, which is no less, under older ones."""
    T = certificate["period"]
    lags, delays = pick(certificate["lateness"], "lag", "delay")
    share = max(find_travel(max(T - delays[1], Fraction(0)), lags[1])[0], 0) / T
    return share * fresh + (1 - share) * old


def list_lost(certificate, commands):
    """Return the ranges of the ways, m, that slip takes from the wheels (right, left)."""
    T = certificate["period"]
    ranges = []
    for shares, speeds in zip(list_shares(certificate), commands.wheels, strict=True):
        least, most = list_products(shares.fresh, speeds)
        old_least, old_most = list_products(shares.old, speeds)
        gained = mix(certificate, -least, -old_least)
        ranges.append((-T * gained, T * mix(certificate, most, old_most)))
    return ranges


def bound_slipped(certificate, commands):
    """Return the way that slip takes from both wheels together at most, m."""
    T, b = pick(certificate, "period", "track")
    shares = list_shares(certificate)
    of_body = max(2 * commands.fastest, b * commands.turning)
    of_wheels = [find_size(speeds) for speeds in commands.wheels]
    sizes = [[find_size(each.fresh) for each in shares], [find_size(each.old) for each in shares]]
    by_wheels = [sum(map(mul, each, of_wheels)) for each in sizes]
    by_body = [max(each) * of_body for each in sizes]
    return T * min(mix(certificate, *by_wheels), mix(certificate, *by_body))


def find_uneven_width(certificate, commands):
    """Return the widths of the ranges of losses, of both wheels together, m/s."""
    widths = [
        find_size(shares.old) * find_width(speeds)
        if shares.is_one
        else find_width(list_products(shares.old, speeds))
        for shares, speeds in zip(list_shares(certificate), commands.wheels, strict=True)
    ]
    return sum(widths)


def bound_losses(certificate, commands):
    """Return bounds of what is lost in a period."""
    T = certificate["period"]
    late = certificate["lateness"]
    unknown = bound_unknown(T, late["lag"], late["delay"], late["nominal"])
    strays = [stray + unknown.uneven for stray in find_strays(T, *late["nominal"])]
    spent = bound_slipped(certificate, commands)
    width = find_uneven_width(certificate, commands)
    parts = []
    ranges = (commands.speeds, commands.yaw_rates)
    for share, ends in zip((Fraction(1, 2), 1 / certificate["track"]), ranges, strict=True):
        slipped = share * spent
        span = find_width(ends)
        taken = span * unknown.total
        variation = slipped + span * unknown.variation
        uneven = [share * width * stray + span * unknown.uneven for stray in strays]
        parts.append((slipped, taken, slipped + taken, variation, *uneven))
    return Losses(*zip(*parts, strict=True))
