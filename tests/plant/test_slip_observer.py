"""Laws of learnt slips: their intervals hold the truth whatever noise and ground do within their
bounds, are as narrow as they can be there, and admit that they know nothing where bounds were not
kept."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import slip_drives as drives

from jaxtube.plant.slip_observer import SlipObserver

PERIODS = 5


@pytest.fixture(scope="module")
def observer():
    return make_observer()


def make_observer(noise=drives.NOISE, change=drives.CHANGE, periods=PERIODS):
    return SlipObserver(
        jnp.asarray(drives.LEAST),
        jnp.asarray(drives.GREATEST),
        change,
        jnp.asarray(noise),
        drives.TRACK,
        drives.DT,
        periods,
    )


@jax.jit
def learn(observer, measured, wheels, reference):
    """Return what is known of the slips of every period and after the last one, time first."""
    first = observer.update(
        observer.initial(measured[0]), measured[0], jnp.zeros_like(wheels[0]), reference[0]
    )

    def period(known, told):
        following = observer.update(known, *told)
        return following, report(following)

    _, after = jax.lax.scan(period, first, (measured[1:], wheels, reference))
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), report(first), after)


def report(known):
    return known.lower, known.upper, known.contradicted


def observe(observer, drive):
    told = learn(observer, *map(jnp.asarray, (drive.measured, drive.wheels, drive.reference)))
    return jax.tree.map(np.asarray, told)


def test_intervals_hold_true_slips_under_extreme_noise_and_changes(observer):
    drive = drives.draw_drive(np.random.default_rng(1), 60, 4000)
    lower, upper, contradicted = observe(observer, drive)
    assert not contradicted.any()
    assert np.all(lower[:-1] <= drive.slips)
    assert np.all(drive.slips <= upper[:-1])
    # And say something: within two periods of one seven eighths of the first width are gone.
    assert np.quantile(upper[3:] - lower[3:], 0.99) < 0.05


def test_wheels_that_stand_turn_back_or_spin_the_robot_prove_nothing_wrong(observer):
    random = np.random.default_rng(2)
    slips = drives.draw_slips(random, 60, 3000)
    wheels = random.choice([-2.0, -0.01, 0.0, 1e-7, 0.3, 2.5], (60, 3000, 2))
    reference = random.uniform(-1.5, 1.5, (60, 2))
    start = random.uniform(-1, 1, (3000, 3))
    drive = drives.drive(slips, wheels, reference, start, drives.draw_noise(random, 61, 3000))
    lower, upper, contradicted = observe(observer, drive)
    assert not contradicted.any()
    assert np.all((lower[:-1] <= slips) & (slips <= upper[:-1]))


def test_a_search_for_the_worst_noise_and_ground_comes_close_to_an_end_and_not_past_it(observer):
    random = np.random.default_rng(3)
    periods = 8
    robots = 2000
    reference = np.full((periods, 2), 1.36)
    wheels = np.repeat(random.uniform(1.5, 1.8, (periods, 1, 2)), robots, axis=1)
    best = None
    best_share = -np.inf
    for spread in np.geomspace(1.0, 0.05, 40):
        genes = random.uniform(-1, 1, (periods + 1, robots, 7))
        if best is not None:
            # Most numbers stay what they were in the best attack, the others go astray.
            astray = random.random(genes.shape) < 0.2
            genes = np.where(astray, np.clip(best + 3 * spread * genes, -1, 1), best)
        slips = np.empty((periods, robots, 2))
        # Far from the ends of [least, greatest], which would be ends of the intervals.
        slips[0] = 0.125 + 0.05 * genes[0, :, 3:5]
        for k in range(1, periods):
            slips[k] = slips[k - 1] + drives.CHANGE * genes[k, :, 5:]
        noise = drives.NOISE * np.sign(genes[..., :3])
        drive = drives.drive(slips, wheels, reference, np.zeros((robots, 3)), noise)
        lower, upper, contradicted = observe(observer, drive)
        assert not contradicted.any()
        centre = (upper + lower)[:-1] / 2
        shares = np.abs(slips - centre) / (upper - lower)[:-1] * 2
        of_robot = shares[2:].max(axis=(0, 2))
        assert of_robot.max() <= 1 + 1e-9
        if of_robot.max() > best_share:
            best_share = of_robot.max()
            best = genes[:, of_robot.argmax()][:, None]
    assert best_share > 0.97


def test_straight_drives_leave_the_intervals_that_rational_arithmetic_finds():
    random = np.random.default_rng(4)
    noise = np.array([2**-10, 0.0, 0.0])
    change = 2.0**-8
    slips = drives.draw_slips(random, 9, 6, change)
    slips = np.repeat(np.clip(slips[..., :1], 0.0, 0.25), 2, axis=2)
    wheels = np.repeat(random.uniform(0.8, 2.0, (9, 6, 1)), 2, axis=2)
    reference = np.full((9, 2), 1.25)
    told = np.zeros((10, 6, 3))
    told[..., 0] = noise[0] * random.choice([-1.0, 1.0], (10, 6))
    drive = drives.drive(slips, wheels, reference, np.zeros((6, 3)), told)
    lower, upper, _ = observe(make_observer(noise, change, periods=4), drive)
    for robot in range(6):
        ends = find_exact_intervals(drive, robot, noise[0], change, periods=4)
        np.testing.assert_allclose(lower[:, robot, 0], [float(a) for a, _ in ends], atol=3e-9)
        np.testing.assert_allclose(upper[:, robot, 0], [float(b) for _, b in ends], atol=3e-9)


def find_exact_intervals(drive, robot, noise, change, periods):
    """Return the intervals of the right wheel of a robot that goes straight, as fractions."""
    least = Fraction(float(drives.LEAST[0]))
    greatest = Fraction(float(drives.GREATEST[0]))
    change = Fraction(change)
    T = Fraction(drives.DT)
    ahead = [Fraction(float(x)) for x in drive.measured[:, robot, 0]]
    ways = [
        before - after + T * Fraction(float(reference))
        for before, after, reference in zip(ahead, ahead[1:], drive.reference[:, 0], strict=False)
    ]
    rolled = [T * Fraction(float(speed)) for speed in drive.wheels[:, robot, 0]]
    ends = [(least, greatest)]
    for k in range(1, len(ahead)):
        lower = max(ends[-1][0] - change, least)
        upper = min(ends[-1][1] + change, greatest)
        for size in range(1, min(k, periods) + 1):
            window = range(k - size, k)
            total = sum(rolled[j] for j in window)
            mean = 1 - sum(ways[j] for j in window) / total
            drift = sum(change * (k - j) * rolled[j] for j in window)
            reach = (2 * Fraction(noise) + drift) / total
            lower = max(lower, mean - reach)
            upper = min(upper, mean + reach)
        ends.append((lower, upper))
    return ends


def test_what_no_noise_hides_is_known_but_for_the_change_to_come():
    drive = drives.draw_drive(np.random.default_rng(5), 20, 50)
    quiet = drives.drive(
        drive.slips, drive.wheels, drive.reference, np.zeros((50, 3)), np.zeros((21, 50, 3))
    )
    lower, upper, contradicted = observe(make_observer(np.zeros(3)), quiet)
    assert not contradicted.any()
    assert np.all(upper[1:] - lower[1:] <= 2 * drives.CHANGE + 1e-8)


def test_slips_that_jump_are_contradicted_and_learnt_again(observer):
    random = np.random.default_rng(6)
    slips = np.full((30, 200, 2), 0.02)
    slips[15:] = 0.24
    reference = np.full((30, 2), 1.36)
    wheels = np.full((30, 200, 2), 1.6)
    start = np.zeros((200, 3))
    drive = drives.drive(slips, wheels, reference, start, drives.draw_noise(random, 31, 200))
    lower, upper, contradicted = observe(observer, drive)
    assert not contradicted[:16].any()
    assert contradicted[16].all()
    np.testing.assert_array_equal(lower[16], np.broadcast_to(drives.LEAST, (200, 2)))
    np.testing.assert_array_equal(upper[16], np.broadcast_to(drives.GREATEST, (200, 2)))
    assert not contradicted[17:].any()
    assert np.all((lower[16:-1] <= slips[16:]) & (slips[16:] <= upper[16:-1]))
    assert np.all(upper[20:] - lower[20:] < 0.05)


def test_measurements_that_are_no_numbers_prove_nothing(observer):
    drive = drives.draw_drive(np.random.default_rng(7), 20, 40)
    drive.measured[8, :20] = np.nan
    drive.measured[12, 20:, 0] = np.inf
    lower, upper, _ = observe(observer, drive)
    assert np.all(np.isfinite(lower) & np.isfinite(upper))
    assert np.all((lower[:-1] <= drive.slips) & (drive.slips <= upper[:-1]))


@pytest.mark.slow
def test_more_periods_never_widen_an_interval(observer):
    drive = drives.draw_drive(np.random.default_rng(8), 30, 100)
    widths = []
    for other in (make_observer(periods=1), make_observer(periods=3), observer):
        lower, upper, _ = observe(other, drive)
        widths.append(upper - lower)
    assert np.all(widths[1] <= widths[0] + 1e-12)
    assert np.all(widths[2] <= widths[1] + 1e-12)
