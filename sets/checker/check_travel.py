"""How far wheels travel that lag, and what of it is not known; part of `check_certificate`, of the
standard library alone.

A command c_k, given at k T, arrives after a delay D and is followed with a lag tau, v' = (c - v) /
tau. Of a step of 1 that arrived x ago a wheel still misses e^(-x/tau), and has missed

    K(x) = tau (1 - e^(-x/tau)) for x > 0, else 0,    in all tau.

By superposition over steps d_k = c_k - c_(k-1) what holds of a signal whose commands lie in a range
of width 1, hence |d| <= 1, holds of wheels, body and losses by their widths. A controller counts on
tau_0, D_0. The true lag is constant, the delay of each command another, both in intervals.

The lag. Under the delay D_0 a step loses, beside what is expected, phi(x) = |e^(-x/tau) -
e^(-x/tau_0)|, which has one peak and grows with the distance of tau from tau_0. Let A_i be its
integral over the i-th period since the step arrived, and A_i(f) that over the share f of it. Then

* sum d A = sum c (A_i - A_(i-1)), whose factors add up to 0: at most half the variation of A, which
  has one peak, too, as averages of phi have. So a period loses at most max A_i;
* at any time it likewise loses at most max phi, and d phi in all at most |tau - tau_0|, the area
  below phi: the smaller of T max phi and |tau - tau_0| is lost up and down;
* beside a loss at constant speed, at the share f, sum |A_i(f) - f A_i| at most, each between what
  it is at the ends of a cell of tau and f, for A_i(f) and f A_i grow with both.

The delay. A step that comes later than expected, or sooner, misses in a period a travel of one sign
that grows with time and with its distance from D_0; all periods add up to the width of the interval
of delays at most. The travel of a period falls with the lag, so cells of it hold all lags.

Steps of long ago are summed up by what is still missing of them.
"""

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import ceil, factorial
from typing import NamedTuple

from check_intervals import (
    BITS,
    ONE,
    ZERO,
    Function,
    multiply,
    read_units,
    scale,
    subtract,
)

COSH = Function(lambda j: Fraction((j + 1) % 2, factorial(j)))
SINH = Function(lambda j: Fraction(j % 2, factorial(j)))
CELLS = 128  # of the lag, on either side of the nominal one
SHARES = 32  # of a period
FORGOTTEN = 40  # lags after which a step is one of long ago
HALVINGS = 48  # of the time at which phi has its peak


class Unknown(NamedTuple):
    """What unknown lag and delay take from a signal within a period at most, s, by the width of its
    range: in all, up and down, and beside a loss at constant speed."""

    total: Fraction
    variation: Fraction
    uneven: Fraction


def decay(time, lag):
    """Return the interval of e^(-time/lag), of what is missing of a step; 0 of wheels that do not
    lag."""
    if not lag:
        return ZERO
    units = scale(time / lag)[1]
    halvings = max(units.bit_length() - BITS, 0)
    part = ((units >> halvings) - 1, -(-units >> halvings))
    value = subtract(COSH.value(part), SINH.value(part))
    for _ in range(halvings):
        value = multiply(value, value)
    return value


def list_missed(lag, first, step, count):
    """Return the intervals of K at first + m step, m = 0, 1 .. count."""
    waiting = max(-first // step + 1, 0)
    missing = decay(first + waiting * step, lag)
    ratio = decay(step, lag)
    missed = [ZERO] * waiting
    for _ in range(waiting, count + 1):
        missed.append(multiply(scale(lag), subtract((ONE, ONE), missing)))
        missing = multiply(missing, ratio)
    return missed


def find_travel(time, lag):
    """Return the travel (least, greatest) of a step of 1 within a time since it arrived."""
    low, high = multiply(scale(lag), subtract((ONE, ONE), decay(time, lag)))
    return time - read_units(high), time - read_units(low)


def find_strays(period, lag, delay):
    """Return how far an expected travel is from one at constant speed, at most and in the mean over
    a period, by the width of the range of commands.

    Beside the first command of a period, wheels that still follow the one before have K of their
    difference; one that arrives meanwhile brings t - K. Of slopes from 0 to 1 and of one bend, with
    m in the mean, neither is farther from its chord than T m (1 - m), and it stays on one side.
    """
    travelled = find_travel(period, lag)
    low = 1 - travelled[1] / period
    high = 1 - travelled[0] / period
    most = period * high * (1 - low)
    mean = lag * (1 - low) - low * period / 2
    left = period - delay % period
    if left < period:
        least, travel = find_travel(left, lag)
        most += travel * (1 - least / period)
        mean += travel / 2 - (left**2 / 2 - lag * travel) / period
    return most, mean


def bound_unknown(period, lags, delays, nominal):
    """Return what lags and delays in intervals take that are not the nominal ones."""
    lag, delay = nominal
    sides = [bound_lag(period, lag, end, delay % period) for end in lags if end != lag]
    late = bound_delay(period, tuple(lags), tuple(delays), delay)
    return Unknown(*(max(parts) + late for parts in zip(*sides, (0, 0, 0), strict=True)))


@cache
def bound_lag(period, lag, end, arrives):
    """Return what lags from the nominal one to an end of their interval take."""
    far = max(lag, end)
    count = ceil(FORGOTTEN * far / period) + 1
    step = period / SHARES
    times = (-arrives, step, count * SHARES)
    expected = list_missed(lag, *times)
    left = multiply(scale(far), decay(count * period - arrives, far))[1]
    nearer = [ZERO] * len(expected)
    uneven = 0
    for cell in range(1, CELLS + 1):
        missed = list_missed(lag + (end - lag) * cell / CELLS, *times)
        pairs = zip(missed, expected, strict=True)
        lost = [subtract(*(pair if end > lag else pair[::-1])) for pair in pairs]
        farther = lost
        uneven = max(uneven, add_up_uneven(nearer, farther, count))
        nearer = farther
    whole = [subtract(after, before)[1] for before, after in pairwise(nearer[::SHARES])]
    apart = abs(end - lag)
    return Unknown(
        min(read_units(max(*whole, left)), apart),
        min(period * find_peak(*sorted((lag, end))), apart),
        Fraction(uneven, SHARES * ONE) + read_units(left),
    )


def add_up_uneven(nearer, farther, count):
    """Return the greatest sum of |A_i(f) - f A_i| over the cells of f between two lags, in units
    and shares, from the integrals of phi up to all shares of all periods."""
    sums = [0] * SHARES
    for begin in range(0, count * SHARES, SHARES):
        least = [subtract(each, nearer[begin])[0] for each in nearer[begin : begin + SHARES + 1]]
        most = [subtract(each, farther[begin])[1] for each in farther[begin : begin + SHARES + 1]]
        for j in range(SHARES):
            more = SHARES * most[j + 1] - j * least[-1]
            less = (j + 1) * most[-1] - SHARES * least[j]
            sums[j] += max(more, less)
    return max(sums)


def find_peak(small, large):
    """Return the greatest phi, e^(-x/large) - e^(-x/small), which is where it ceases to rise: at
    x = large at last, as log y <= y - 1, and between two times that are moved towards it."""
    if not small:
        return Fraction(1)
    before = Fraction(0)
    after = large
    for _ in range(HALVINGS):
        time = read_units(scale((before + after) / 2)[0])
        falls = multiply(scale(1 / large), decay(time, large))
        rises = multiply(scale(1 / small), decay(time, small))
        if rises[0] > falls[1]:
            before = time
        elif rises[1] < falls[0]:
            after = time
        else:
            break
    return read_units(subtract(decay(before, large), decay(after, small))[1])


@cache
def bound_delay(period, lags, delays, delay):
    """Return what delays take that are not the nominal one, under any lag."""
    sooner, later = delays
    if sooner == later:
        return Fraction(0)
    least, most = lags
    count = ceil((FORGOTTEN * most + later) / period) + 1
    cells = CELLS if least < most else 1
    by_lag = [
        [
            list_travels(least + (most - least) * cell / cells, each, period, count)
            for each in (sooner, delay, later)
        ]
        for cell in range(cells + 1)
    ]
    worst = 0
    for (early, expected, _), (_, slower, late) in pairwise(by_lag):
        gained = [subtract(*pair)[1] for pair in zip(early, slower, strict=True)]
        lost = [subtract(*pair)[1] for pair in zip(expected, late, strict=True)]
        worst = max(worst, sum(map(max, gained, lost)))
    left = (later - sooner) * read_units(decay(count * period - later, most)[1])
    return min(read_units(worst) + left, later - sooner)


def list_travels(lag, delay, period, count):
    """Return the travel of a step of 1 within each period since it was given, intervals."""
    missed = list_missed(lag, -delay, period, count)
    times = [scale(max(m * period - delay, 0)) for m in range(count + 1)]
    made = [subtract(*pair) for pair in zip(times, missed, strict=True)]
    return [subtract(after, before) for before, after in pairwise(made)]
