"""Finite-sample confidence intervals for the share of laps with an event and for the mean share of
steps in a lap.

    share p of laps, k of n with the event, K binomial(n, p):
        P(K >= k | low) = risk,   P(K <= k | high) = risk
    mean mu of X in [0, 1], one X a lap:
        |mean - mu| <= sqrt(2 V ln(2 / risk) / n) + 7 ln(2 / risk) / (3 (n - 1))

Laps are independent; the steps of one lap are not, so that laps alone are counted as trials.

Notation: a bound fails with probability `risk` at most, an interval with `delta` = 1 - confidence;
V is the sample variance, of divisor n - 1. Source: Clopper and Pearson, The use of confidence or
fiducial limits, Biometrika 1934; Maurer and Pontil, Empirical Bernstein bounds and sample variance
penalization, COLT 2009, theorem 11; Hoeffding, On the distribution of the number of successes in
independent trials, Annals of Mathematical Statistics 1956 (binomial bounds where trials differ).
"""

import math
import operator

import numpy as np
from jaxtyping import Int
from scipy import special

CONFIDENCE = 0.95
"""Confidence of every interval and bound that is reported."""


def share_interval(events: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Bound the probability of an event from both sides (Clopper-Pearson).

    Each bound fails with probability (1 - confidence) / 2 at most, whatever the probability and
    however many events there were: the interval covers it with the confidence at least. Where the
    event occurred never (always), low is 0 (high is 1). Exact to 1e-9 of each bound for as many as
    1e12 trials.

    Args:
        events: how often the event occurred.
        trials: independent trials, at least one.
        confidence: in (0, 1).

    Returns:
        The bounds, low and high.

    Raises:
        ValueError: for counts that do not fit, and for a confidence outside (0, 1).
    """
    events = operator.index(events)
    trials = operator.index(trials)
    if trials < 1:
        raise ValueError(f"trials: {trials}; give at least one")
    if not 0 <= events <= trials:
        raise ValueError(f"events: {events}; give 0 to trials, here {trials}")
    risk = compute_risk(confidence) / 2
    return least_share(events, trials, risk), largest_share(events, trials, risk)


def mean_interval(
    histogram: Int[np.ndarray, " values"], largest: int, confidence: float = CONFIDENCE
) -> tuple[float, float, float]:
    """Bound the expectation of the share of a lap's steps in which an event occurs.

    low <= expectation <= high with probability `confidence` at least, whatever the distribution, if
    the laps are independent. Where they are not alike, the expectation is the average of theirs.
    Four bounds, each of risk delta / 4, are intersected: the two of Maurer and Pontil, and the two
    that follow from P(a lap has the event) / largest <= expectation <= P(a lap has the event).

    The width of Maurer and Pontil is never below 7 ln(8 / delta) / (3 (n - 1)), so that their upper
    bound cannot fail for an expectation below that. Where the bound on P(a lap has the event) is,
    it therefore takes the risk of both, delta / 2: it equals the upper bound of `share_interval`.
    (Larger expectations: the event that it fails is one in which it fails with risk delta / 4.)

    Args:
        histogram: entry i counts the laps that had the event in i of their steps, i = 0 .. largest.
        largest: steps of a lap.
        confidence: in (0, 1).

    Returns:
        The mean over laps, low and high. One lap alone gives 0 and 1.

    Raises:
        ValueError: for a histogram of another length, with a negative count or without laps.
    """
    counts = check_counts(histogram, largest)
    laps = sum(counts)
    total = sum(i * count for i, count in enumerate(counts))
    squares = sum(i * i * count for i, count in enumerate(counts))
    mean = total / (laps * largest)
    risk = compute_risk(confidence) / 4
    if laps == 1:
        return mean, 0.0, 1.0
    variance = (laps * squares - total**2) / (laps * (laps - 1) * largest**2)
    least_width = 7 * math.log(2 / risk) / (3 * (laps - 1))
    width = math.sqrt(2 * variance * math.log(2 / risk) / laps) + least_width
    with_event = laps - counts[0]
    low = max(mean - width, least_share(with_event, laps, risk) / largest)
    high = largest_share(with_event, laps, risk)
    if high <= least_width:
        return mean, low, largest_share(with_event, laps, 2 * risk)
    return mean, low, min(mean + width, high)


def least_share(events: int, trials: int, risk: float) -> float:
    """Return the lower bound of Clopper and Pearson: it exceeds the probability with probability
    `risk` at most."""
    if events == 0:
        return 0.0
    if events == trials:
        return math.exp(math.log(risk) / trials)
    a = float(events)
    b = float(trials - events + 1)
    bound = float(special.betaincinv(a, b, risk))
    return bound - newton_step(a, b, bound, float(special.betainc(a, b, bound)) - risk)


def largest_share(events: int, trials: int, risk: float) -> float:
    """Return the upper bound of Clopper and Pearson: it is below the probability with probability
    `risk` at most."""
    if events == 0:
        return -math.expm1(math.log(risk) / trials)
    if events == trials:
        return 1.0
    a = float(events + 1)
    b = float(trials - events)
    bound = float(special.betainccinv(a, b, risk))
    return bound + newton_step(a, b, bound, float(special.betaincc(a, b, bound)) - risk)


def newton_step(a: float, b: float, x: float, excess: float) -> float:
    """Return excess / density of the beta distribution at x.

    The inverse incomplete beta function of SciPy is wrong by up to 2e-8 at 1e9 trials, the function
    itself by 1e-11.
    """
    if x == 1.0:
        return 0.0
    logarithm = special.betaln(a, b) - (a - 1) * math.log(x) - (b - 1) * math.log1p(-x)
    return excess * math.exp(logarithm)


def compute_risk(confidence: float) -> float:
    """Return delta = 1 - confidence; refuse what is not in (0, 1)."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: {confidence}; give a number between 0 and 1, such as 0.95")
    return 1 - confidence


def check_counts(histogram: Int[np.ndarray, " values"], largest: int) -> list[int]:
    """Return the histogram as Python integers, whose sums are exact; refuse what is no histogram of
    0 .. largest."""
    if largest < 1:
        raise ValueError(f"largest: {largest}; give the number of steps of a lap, at least one")
    if histogram.shape != (largest + 1,) or histogram.dtype.kind not in "iu":
        raise ValueError(
            f"histogram: shape {histogram.shape} of {histogram.dtype}; give integers for 0 to "
            "largest, such as np.bincount(counts, minlength=largest + 1)"
        )
    counts = histogram.tolist()
    if min(counts) < 0 or sum(counts) == 0:
        raise ValueError(
            f"histogram: least {min(counts)}, sum {sum(counts)}; give counts >= 0 of at least one "
            "lap"
        )
    return counts
