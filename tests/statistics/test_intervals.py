"""Laws of the confidence intervals, against closed forms, numbers of many digits and exact sums
over all outcomes."""

import math

import mpmath
import numpy as np
import pytest
import tolerances as tol
from scipy import stats

from jaxtube.statistics.intervals import mean_interval, share_interval

SHARE_BOUND = 1e-10
"""Relative; bounds of a share against roots in many digits."""
SHARE_COVERAGE = 1e-12
"""Exact sums of binomial probabilities."""
SUM_OF_LAPS = 1e-3
"""Relative; widths of 1e-12 around means of order one."""

CONFIDENCES = (0.5, 0.95, 1 - 1e-6)


def density(events: int, trials: int):
    """The beta density of which the integral from p to one is P(K <= events), K binomial(trials,
    p)."""
    a = mpmath.mpf(events + 1)
    b = mpmath.mpf(trials - events)
    constant = mpmath.loggamma(a + b) - mpmath.loggamma(a) - mpmath.loggamma(b)
    return lambda x: mpmath.exp(constant + (a - 1) * mpmath.log(x) + (b - 1) * mpmath.log1p(-x))


def tail(events: int, trials: int, share):
    """P(K <= events) in many digits: a short sum or, if that is long, the integral over twenty
    deviations."""
    if events <= 40:
        return mpmath.fsum(
            mpmath.binomial(trials, i) * share**i * mpmath.exp((trials - i) * mpmath.log1p(-share))
            for i in range(events + 1)
        )
    if trials - events <= 41:
        return 1 - tail(trials - events - 1, trials, 1 - share)
    mean = mpmath.mpf(events) / trials
    end = share + 20 * mpmath.sqrt(mean * (1 - mean) / trials)
    return mpmath.quad(density(events, trials), mpmath.linspace(share, min(1, end), 11))


def error_of_share(events: int, trials: int, share: float, probability) -> float:
    """Relative distance of `share` from the root of tail = probability close to it, by one Newton
    step."""
    exact = mpmath.mpf(share)
    slope = density(events, trials)(exact)
    return float(abs(tail(events, trials, exact) - probability) / (slope * exact))


def outcomes(trials: int) -> list[int]:
    few = {1, 2, 5, 17, trials // 10, trials // 2}
    return sorted(k for k in few | {trials - k for k in few} if 0 < k < trials)


@pytest.mark.parametrize("confidence", CONFIDENCES)
@pytest.mark.parametrize("trials", [2, 100, 10**5, 10**7, 10**9, 10**10, 10**12])
def test_the_bounds_of_the_share_are_the_roots_of_the_binomial_tails(trials, confidence):
    risk = mpmath.mpf(1 - confidence) / 2
    with mpmath.workdps(30):
        for events in outcomes(trials):
            low, high = share_interval(events, trials, confidence)
            assert low < events / trials < high
            assert error_of_share(events - 1, trials, low, 1 - risk) < SHARE_BOUND
            # A bound closer to one than floats are is one.
            if high < 1:
                assert error_of_share(events, trials, high, risk) < SHARE_BOUND
            else:
                assert tail(events, trials, 1 - mpmath.mpf(2) ** -54) > risk


@pytest.mark.parametrize("confidence", CONFIDENCES)
@pytest.mark.parametrize("trials", [1, 2, 1000, 10**6, 10**12])
def test_never_and_always_have_closed_forms(trials, confidence):
    with mpmath.workdps(40):
        root = mpmath.root(mpmath.mpf(1 - confidence) / 2, trials)
        zero, high = share_interval(0, trials, confidence)
        low, one = share_interval(trials, trials, confidence)
        assert zero == 0 and one == 1
        assert abs(high / (1 - root) - 1) < tol.ROUNDING
        assert abs(low / root - 1) < tol.ROUNDING


@pytest.mark.parametrize("trials", [1, 2, 3, 7, 30, 200])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_the_interval_of_the_share_covers_every_share_by_exact_sums(trials, confidence):
    bounds = np.array([share_interval(events, trials, confidence) for events in range(trials + 1)])
    missed_above, missed_below = missed(bounds, trials)
    half = (1 - confidence) / 2 + SHARE_COVERAGE
    assert missed_above.max() <= half
    assert missed_below.max() <= half


def missed(bounds, trials):
    """Return the probabilities, over all outcomes of binomial trials, that the true share lies
    below its interval, and above it; for shares beside every bound, where they are greatest."""
    shares = np.unique([np.nextafter(bounds, 0), bounds, np.nextafter(bounds, 1)])[:, None]
    probability = stats.binom.pmf(np.arange(trials + 1), trials, shares)
    above = bounds[:, 0] > shares
    below = bounds[:, 1] < shares
    return (probability * above).sum(axis=1), (probability * below).sum(axis=1)


@pytest.mark.parametrize("laps", [2, 3, 10, 60, 400])
@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.95])
def test_the_mean_interval_covers_by_exact_sums_where_a_lap_has_the_event_in_all_its_steps(
    laps, confidence
):
    outcomes = range(laps + 1)
    bounds = np.array([mean_interval(np.array([laps - k, k]), 1, confidence)[1:] for k in outcomes])
    missed_above, missed_below = missed(bounds, laps)
    assert (missed_above + missed_below).max() <= 1 - confidence + SHARE_COVERAGE


@pytest.mark.parametrize("laps", [2, 30, 8192, 10**9])
def test_few_laps_with_an_event_bound_its_steps_as_they_bound_the_laps(laps):
    """The share of steps is below that of laps: its bound is not looser."""
    for events in (0, 1, 2):
        histogram = np.zeros(301, int)
        histogram[0] = laps - events
        histogram[300] = events
        share_high = share_interval(events, laps)[1]
        if events == 0 or laps > 30:
            assert mean_interval(histogram, 300)[2] == share_high


def test_the_share_interval_is_monotone():
    bounds = np.array([share_interval(events, 50) for events in range(51)])
    assert (np.diff(bounds, axis=0) > 0).all()
    mirrored = 1 - bounds[::-1, ::-1]
    np.testing.assert_allclose(bounds, mirrored, atol=tol.ROUNDING)
    wider = [share_interval(3, 50, confidence) for confidence in (0.5, 0.9, 0.99, 0.9999)]
    assert (np.diff(wider, axis=0) * [-1, 1] > 0).all()
    narrower = np.array([share_interval(trials // 10, trials) for trials in (10, 100, 1000, 10**6)])
    assert (np.diff(narrower[:, 1] - narrower[:, 0]) < 0).all()


LAPS = {
    "never": lambda rng, shape: np.zeros(shape, int),
    "always": lambda rng, shape: np.full(shape, 40),
    "rare laps, all of their steps": lambda rng, shape: 40 * (rng.random(shape) < 0.05),
    "most laps, one step": lambda rng, shape: 1 * (rng.random(shape) < 0.9),
    "steps apart": lambda rng, shape: rng.binomial(40, 0.3, shape),
    "steps that depend on each other": lambda rng, shape: rng.binomial(
        40, rng.beta(0.3, 0.7, shape)
    ),
}
EXPECTATION = {
    "never": 0,
    "always": 1,
    "rare laps, all of their steps": 0.05,
    "most laps, one step": 0.9 / 40,
    "steps apart": 0.3,
    "steps that depend on each other": 0.3,
}


@pytest.mark.parametrize("laps", [2, 20, 200])
@pytest.mark.parametrize("kind", LAPS)
def test_the_mean_interval_covers_the_expectation(kind, laps):
    confidence = 0.8
    samples = LAPS[kind](np.random.default_rng(laps), (400, laps))
    found = [mean_interval(np.bincount(sample, minlength=41), 40, confidence) for sample in samples]
    mean, low, high = np.array(found).T
    np.testing.assert_allclose(mean, samples.mean(axis=1) / 40, rtol=tol.ROUNDING)
    assert ((low >= 0) & (low <= mean) & (mean <= high) & (high <= 1)).all()
    covered = ((low <= EXPECTATION[kind]) & (EXPECTATION[kind] <= high)).sum()
    assert stats.binom.cdf(covered, 400, confidence) > tol.LEAST_P_VALUE


def test_the_mean_interval_follows_its_formulas():
    histogram = np.array([70, 5, 0, 25])
    mean, low, high = mean_interval(histogram, 3, 0.9)
    shares = np.repeat(np.arange(4), histogram) / 3
    logarithm = math.log(80)
    width = math.sqrt(2 * shares.var(ddof=1) * logarithm / 100) + 7 * logarithm / (3 * 99)
    any_low, any_high = share_interval(30, 100, 0.95)
    assert mean == pytest.approx(shares.mean(), rel=tol.ROUNDING)
    assert low == pytest.approx(max(shares.mean() - width, any_low / 3), rel=tol.ROUNDING)
    assert high == pytest.approx(min(shares.mean() + width, any_high), rel=tol.ROUNDING)


def test_laps_without_an_event_bound_the_mean_as_they_bound_the_share_of_laps():
    histogram = np.zeros(301, int)
    histogram[0] = 10**9
    mean, low, high = mean_interval(histogram, 300, 0.8)
    assert mean == low == 0
    assert high == pytest.approx(share_interval(0, 10**9, 0.8)[1], rel=tol.ROUNDING)


def test_the_mean_interval_shrinks_with_laps_and_grows_with_confidence():
    histogram = np.array([6, 3, 1])
    widths = [np.diff(mean_interval(histogram * 10**k, 2)[1:])[0] for k in range(1, 9)]
    assert (np.diff(widths) < 0).all()
    assert widths[-1] < 1e-4
    wider = [mean_interval(histogram * 1000, 2, confidence)[1:] for confidence in (0.5, 0.9, 0.999)]
    assert (np.diff(wider, axis=0) * [-1, 1] > 0).all()


def test_sums_of_the_mean_interval_outgrow_machine_integers():
    histogram = np.zeros(1001, np.int64)
    histogram[[999, 1000]] = 2**61
    mean, low, high = mean_interval(histogram, 1000)
    assert mean == 1999 / 2000
    width = math.sqrt(2 * (0.5 / 1000) ** 2 * math.log(160) / 2**62)
    assert [mean - low, high - mean] == pytest.approx([width] * 2, rel=SUM_OF_LAPS)


def test_one_lap_says_nothing():
    assert mean_interval(np.array([0, 0, 1, 0]), 3) == (2 / 3, 0.0, 1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: share_interval(-1, 5), r"events: -1; give 0 to trials, here 5"),
        (lambda: share_interval(6, 5), r"events: 6; give"),
        (lambda: share_interval(0, 0), r"trials: 0; give at least one"),
        (lambda: share_interval(1, 5, 1.0), r"confidence: 1.0; give a number between 0 and 1"),
        (lambda: share_interval(1, 5, math.nan), r"confidence: nan; give"),
        (lambda: mean_interval(np.ones(3, int), 2, 95), r"confidence: 95; give"),
        (
            lambda: mean_interval(np.ones(3, int), 3),
            r"histogram: shape \(3,\) of int64; give .* minlength",
        ),
        (lambda: mean_interval(np.ones(3), 2), r"histogram: shape \(3,\) of float64; give"),
        (
            lambda: mean_interval(np.array([3, -1, 2]), 2),
            r"histogram: least -1, sum 4; give counts >= 0",
        ),
        (
            lambda: mean_interval(np.zeros(3, int), 2),
            r"histogram: least 0, sum 0; give .* at least one lap",
        ),
        (lambda: mean_interval(np.ones(1, int), 0), r"largest: 0; give the number of steps"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=f"^{message}") as refusal:
        call()
    assert "\n" not in str(refusal.value)
