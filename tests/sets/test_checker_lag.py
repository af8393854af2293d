"""Laws of what the checker says of wheels that lag: its bounds hold robots that are followed step
by step, come near the worst of them, and are no wider than those that the project proves."""

import decimal
import itertools
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from late_robot import (
    LatePeriod,
    back,
    commit,
    drive,
    find_rest,
    follow_back,
    join,
    read_errors,
)
from tolerances import ROUNDING

from jaxtube.synthesis.proof_search import load_checker
from sets.robot.actuation import Actuation, step_travel
from sets.robot.committed import bound_commitment, bound_unknown
from sets.robot.late_ways import Driving, Ground, bound_unevenness
from sets.robot.latency import bound_committed_noise, bound_later_errors, bound_present_errors
from sets.robot.unknown_travel import bound_unknown_travel

intervals = load_checker("check_intervals.py")
motion_program = load_checker("check_motion.py")
lag_program = load_checker("check_lag.py")
losses_program = load_checker("check_losses.py")
pose_program = load_checker("check_pose.py")
travel_program = load_checker("check_travel.py")

T = 0.1
B = 0.5
SPEEDS = (0.9, 1.7)
YAW = 1.2
WHEELS = (0.6, 2.0)
MIDDLE = 1.36
SLIP = Fraction(1, 5)
REFERENCE = (1.3, 1.4)
"""Least and greatest speed of its wheels, m/s."""
DEFICIT = YAW - (REFERENCE[1] - REFERENCE[0]) / B
SAMPLES = 80
SAME = 1e-9
"""Share by which bounds in floats and in integers may differ."""

CASES = (
    # lag, delay, greatest d, least shares of the bounds (ahead, sideways, kick) that samples reach
    ((0.05, 0.05), (0.0, 0.0), 0.0, (0.3, 0.7, 0.0)),
    ((0.05, 0.05), (0.0, 0.0), 0.0256, (0.2, 0.5, 0.9)),
    ((0.1, 0.1), (0.3, 0.3), 0.0256, (0.15, 0.25, 0.9)),
    ((0.0, 0.0), (0.2, 0.2), 0.0256, (0.1, 0.1, 0.9)),
    ((0.05, 0.1), (0.0, 0.0), 0.06, (0.02, 0.1, 0.5)),
    ((0.0, 0.0), (0.02, 0.06), 0.03, (0.02, 0.05, 0.5)),
    ((0.04, 0.06), (0.08, 0.12), 0.03, (0.02, 0.05, 0.4)),
)


def fractions(values):
    return [Fraction(float(value)) for value in values]


def floats(values):
    return np.array([float(value) for value in values])


def make_certificate(lag, delay, error=0.0, sideslip=0.0, lever_arm=0.0):
    """Return what a certificate says of a robot whose wheels lag, with its band."""
    nominal = Actuation(lag, delay).nominal(T)
    room = Fraction(error) * (1 - SLIP)
    slips = [[SLIP - room, SLIP + room, SLIP, SLIP]]
    ends = fractions(REFERENCE)
    band = {"regions": [[*ends, *ends]], "u2": fractions((-DEFICIT, DEFICIT))}
    certificate = {
        "period": Fraction(T),
        "track": Fraction(B),
        "sideslip": Fraction(sideslip),
        "lever_arm": Fraction(lever_arm),
        "slips": {"right": slips, "left": slips},
        "bands": [band],
        "lateness": {
            "lag": fractions(lag),
            "delay": fractions(delay),
            "nominal": fractions(nominal),
            "lever": Fraction(MIDDLE * nominal.latency),
            "wheels": {"right": fractions(WHEELS), "left": fractions(WHEELS)},
            "speeds": fractions(SPEEDS),
        },
    }
    return certificate, band


def make_driving():
    """Return the same commands as the project has them."""
    none = np.full(2, np.inf)
    wheels = np.array([[end, end] for end in WHEELS])
    return Driving(wheels, np.array(SPEEDS), np.array([-YAW, YAW]), none, none)


def draw_commands(generator, count):
    """Return commands (count, 2) at ends of what may be asked for, or within."""
    wheels = []
    while len(wheels) < count:
        speed = generator.choice(SPEEDS) if generator.random() < 0.7 else generator.uniform(*SPEEDS)
        turn = YAW * (generator.choice([-1, 1]) if generator.random() < 0.7 else generator.random())
        wheels.append(np.clip([speed + B * turn / 2, speed - B * turn / 2], *WHEELS))
    return np.array(wheels)


def draw_period(generator, actuation, error=0.0, sideslip=0.0):
    commands = draw_commands(generator, 9)
    return LatePeriod(
        T,
        B,
        actuation.nominal(T),
        commands,
        float(generator.choice(actuation.lag)),
        generator.choice(actuation.delay, len(commands)),
        generator.choice([-1.0, 1.0], 2) * error,
        sideslip * generator.choice([-1.0, 1.0]),
    )


def find_missing(time, lag):
    """Return e^(-time/lag) to sixty digits."""
    with decimal.localcontext() as context:
        context.prec = 60
        share = Fraction(time) / Fraction(lag)
        exact = -decimal.Decimal(share.numerator) / decimal.Decimal(share.denominator)
        return Fraction(exact.exp())


@pytest.mark.parametrize("time", [0.0, 1e-12, 0.01, 0.7, 1.0, 1.3, 5.0, 36.0, 60.0])
@pytest.mark.parametrize("lag", [1.0, 0.3])
def test_what_is_missing_of_a_step_is_enclosed_closely(time, lag):
    low, high = travel_program.decay(Fraction(time), Fraction(lag))
    missing = find_missing(time, lag)
    assert low <= missing * intervals.ONE <= high
    assert high - low <= 2**10
    least, most = travel_program.find_travel(Fraction(time), Fraction(lag))
    assert least <= Fraction(time) - Fraction(lag) * (1 - missing) <= most
    assert most - least <= Fraction(2**10, intervals.ONE)
    assert travel_program.decay(Fraction(time), Fraction(0)) == (0, 0)


@pytest.mark.parametrize("first", [-0.25, -0.2, 0.0, 0.03])
def test_what_has_been_missed_of_a_step_is_enclosed_at_every_time(first):
    lag = 0.07
    step = 0.1
    missed = travel_program.list_missed(*map(Fraction, (lag, first, step)), 30)
    assert len(missed) == 31
    for index, (low, high) in enumerate(missed):
        time = max(Fraction(first) + index * Fraction(step), Fraction(0))
        exact = Fraction(lag) * (1 - find_missing(time, lag)) * intervals.ONE
        assert low <= exact <= high and high - low <= 2**10


INTERVALS = (
    ((0.0184, 0.0221), (0.0, 0.0)),
    ((0.0, 0.03), (0.0, 0.0)),
    ((0.05, 0.05), (0.11, 0.16)),
    ((0.03, 0.12), (0.01, 0.05)),
)


@pytest.mark.parametrize(("lag", "delay"), INTERVALS)
def test_unknown_lag_and_delay_take_what_the_project_says(lag, delay):
    actuation = Actuation(lag, delay)
    nominal = actuation.nominal(T)
    bound = bound_unknown_travel(actuation, T, np.ones(1), np.ones(1))
    said = travel_program.bound_unknown(
        Fraction(T), fractions(lag), fractions(delay), fractions(nominal)
    )
    total, variation, uneven = floats(said)
    np.testing.assert_allclose([total, uneven], [bound.total[0], bound.unevenness[0]], rtol=SAME)
    assert variation <= bound.variation[0] * (1 + SAME)
    strays = travel_program.find_strays(Fraction(T), *fractions(nominal))
    np.testing.assert_allclose(floats(strays), bound_unevenness(nominal, T), rtol=SAME, atol=1e-15)


@pytest.mark.parametrize(("lag", "delay"), INTERVALS)
def test_no_commands_lose_more_by_unknown_lag_and_delay(lag, delay):
    """Commands from 0 to 1 that are the worst for some lag, delay and time, and others."""
    actuation = Actuation(lag, delay)
    nominal = actuation.nominal(T)
    said = travel_program.bound_unknown(
        Fraction(T), fractions(lag), fractions(delay), fractions(nominal)
    )
    total, variation, uneven = floats(said)
    ages = T * np.arange(60)[:, None]
    shares = np.linspace(0, 1, 41)
    found = np.zeros(3)
    for true, late in itertools.product(np.linspace(*lag, 5), np.linspace(*delay, 3)):

        def roll(when, lag):
            return step_travel(ages + T * shares - when, lag) - step_travel(ages - when, lag)

        lost = roll(nominal.delay, nominal.lag) - roll(late, true)
        # Each share of a command is what its own step loses, less that of the next one.
        of_commands = np.diff(lost, axis=0, prepend=0.0)
        even = of_commands - of_commands[:, -1:] * shares
        rates = np.diff(of_commands, axis=1)
        found[0] = max(found[0], np.maximum(of_commands, 0).sum(axis=0).max())
        found[2] = max(found[2], np.maximum(even, 0).sum(axis=0).max())
        for worst in (*(rates > 0).T, of_commands[:, -1] > 0):
            found[1] = max(found[1], np.abs(worst @ rates).sum())
    assert np.all(found <= np.array([total, variation, uneven]) + ROUNDING)
    assert found[0] >= 0.5 * total and found[2] >= 0.2 * uneven


@pytest.mark.parametrize(("lag", "delay", "error", "reached"), CASES)
def test_what_lag_and_delay_do_holds_sampled_worst_cases(lag, delay, error, reached):
    certificate, band = make_certificate(lag, delay, error)
    late = lag_program.find_late(certificate, band)
    rest = floats(late.rest)
    lost = np.array([floats(ends) for ends in late.lost]).T / T
    taken = floats(late.taken) @ [1.0, B / 2] / T
    generator = np.random.default_rng(3)
    actuation = Actuation(lag, delay)
    found = np.zeros(3)
    for _ in range(SAMPLES):
        period = draw_period(generator, actuation, error)
        moved, speeds, kick = find_rest(period, float(certificate["lateness"]["lever"]))
        assert np.all(np.abs(moved) <= rest + ROUNDING)
        assert np.all(speeds >= lost[0] - taken - ROUNDING)
        assert np.all(speeds <= lost[1] + taken + ROUNDING)
        assert abs(kick) <= late.kick + ROUNDING
        found = np.maximum(found, [*np.abs(moved), abs(kick)])
    assert np.all(found >= reached * np.array([*rest, float(late.kick)]))


@pytest.mark.parametrize(("lag", "delay", "error", "reached"), CASES)
@pytest.mark.parametrize("slides", [False, True])
def test_bounds_are_no_wider_than_those_that_the_project_proves(lag, delay, error, reached, slides):
    sideslip = 0.05 * slides
    lever_arm = -0.03 * slides
    certificate, band = make_certificate(lag, delay, error, sideslip, lever_arm)
    late = lag_program.find_late(certificate, band)
    errors = error * np.array([[-1.0, -1.0], [1.0, 1.0]])
    ground = Ground(errors, None, sideslip, lever_arm)
    bound = bound_commitment(Actuation(lag, delay), T, B, make_driving(), ground, MIDDLE)
    most = [*bound.box + bound.slide, bound.kick, *T * bound.unknown]
    said = floats([*late.rest, late.kick, *late.taken])
    assert np.all(said <= np.array(most) * (1 + SAME))
    is_known = lag[0] == lag[1] and delay[0] == delay[1]
    assert np.all(said >= (0.95 if is_known else 0.7) * np.array(most))
    lost = np.array([floats(ends) for ends in late.lost]).T
    np.testing.assert_allclose(lost, T * bound.loss, rtol=SAME)


@pytest.mark.parametrize(("lag", "delay", "error", "reached"), CASES)
def test_losses_stray_from_even_ones_as_in_the_project(lag, delay, error, reached):
    certificate, band = make_certificate(lag, delay, error)
    commands = losses_program.read_commands(certificate, band)
    losses = losses_program.bound_losses(certificate, commands)
    actuation = Actuation(lag, delay)
    ground = Ground(error * np.array([[-1.0, -1.0], [1.0, 1.0]]))
    unknown = bound_unknown(actuation, T, B, make_driving(), ground)
    of_body = np.array([0.5, 1 / B])
    width = 2 * error * (WHEELS[1] - WHEELS[0])
    most, mean = bound_unevenness(actuation.nominal(T), T)
    for said, stray in ((losses.stray, most), (losses.mean_stray, mean)):
        expected = of_body * width * stray + unknown.unevenness
        np.testing.assert_allclose(floats(said), expected, rtol=SAME, atol=1e-15)
    slipped = floats(losses.slipped)
    np.testing.assert_allclose(slipped, T * error * 2 * SPEEDS[1] * of_body, rtol=SAME)
    for said, bound in ((losses.total, unknown.total), (losses.variation, unknown.variation)):
        taken = floats(said) - slipped
        # Slip takes its share of what is really driven, whatever was expected.
        assert np.all(taken <= bound * (1 + SAME) + 1e-15)
        assert np.all(taken >= 0.8 * bound)


@pytest.mark.parametrize("rate", [0.01, 0.3, 0.9])
def test_what_grows_with_itself_is_no_larger_than_is_said(rate):
    said = lag_program.grow(Fraction(2), Fraction(3), Fraction(rate))
    solution = 2 * np.exp(rate) + 3 * np.expm1(rate) / rate
    assert solution <= said <= 5 / (1 - rate) * (1 + SAME)
    with pytest.raises(intervals.Refused, match="radian"):
        lag_program.grow(Fraction(2), Fraction(3), Fraction(1))


def test_sideslip_moves_no_robot_further_than_is_proved():
    certificate, band = make_certificate((0.05, 0.05), (0.04, 0.04), 0.02, 0.05)
    rest = floats(lag_program.find_late(certificate, band).rest)
    generator = np.random.default_rng(3)
    actuation = Actuation((0.05, 0.05), (0.04, 0.04))
    found = np.zeros(2)
    for _ in range(SAMPLES):
        period = draw_period(generator, actuation, 0.02, 0.05)
        moved, _, _ = find_rest(period, float(certificate["lateness"]["lever"]))
        assert np.all(np.abs(moved) <= rest + ROUNDING)
        found = np.maximum(found, np.abs(moved))
    assert found[1] >= 0.5 * rest[1]


def test_slips_that_each_command_compensates_anew_are_bounded_as_in_the_project():
    """The true slip is one of two, and so is the one that is compensated."""
    lag = (0.05, 0.08)
    certificate, band = make_certificate(lag, (0.0, 0.03))
    near = [SLIP - Fraction(1, 50), SLIP + Fraction(1, 50)]
    certificate["slips"] = {wheel: [[*near, *near]] for wheel in ("right", "left")}
    late = lag_program.find_late(certificate, band)
    errors = [(true - seen) / (1 - seen) for true, seen in itertools.product(near, near)]
    errors = floats([min(errors), max(errors)])[:, None] * np.ones(2)
    ground = Ground(errors, errors)
    bound = bound_commitment(Actuation(lag, (0.0, 0.03)), T, B, make_driving(), ground, MIDDLE)
    said = floats([*late.rest, late.kick, *late.taken])
    most = np.array([*bound.box, bound.kick, *T * bound.unknown])
    assert np.all(said <= most * (1 + SAME))
    assert np.all(said >= 0.5 * most)
    once, _ = make_certificate(lag, (0.0, 0.03), np.abs(errors).max())
    for anew, of_one in zip(late.rest, lag_program.find_late(once, band).rest, strict=True):
        assert anew > 1.1 * of_one


def test_slip_that_takes_from_both_wheels_turns_a_robot_by_no_more_than_one_of_them():
    certificate, band = make_certificate((0.05, 0.05), (0.0, 0.0))
    room = Fraction(1, 20)
    slips = [[SLIP, SLIP + room, SLIP, SLIP]]
    certificate["slips"] = {"right": slips, "left": slips}
    kick = lag_program.find_late(certificate, band).kick
    assert float(kick) == pytest.approx(float(room / (1 - SLIP)) * T / B * WHEELS[1], rel=SAME)


def test_older_commands_may_compensate_other_slips_than_the_present_one():
    """A slip that is measured closely, but moves far from one period to the next."""
    certificate, band = make_certificate((0.01, 0.02), (0.02, 0.03))
    ends = [SLIP - Fraction(1, 20), SLIP + Fraction(1, 20)]
    certificate["slips"] = {wheel: [[*ends, *ends]] for wheel in ("right", "left")}
    within = (Fraction(1, 100), Fraction(0))
    certificate["measured"] = {"right": within, "left": within}
    (shares, _) = losses_program.list_shares(certificate)
    assert shares.old[0] < shares.fresh[0] < 0 < shares.fresh[1] < shares.old[1]
    commands = losses_program.read_commands(certificate, band)
    (low, high), _ = losses_program.list_lost(certificate, commands)
    fastest = T * WHEELS[1]
    # How much of a period's travel is under its own command at least.
    own = step_travel(np.array(0.07), 0.02) / T
    expected = [own * float(a) + (1 - own) * float(b) for a, b in zip(*shares[:2], strict=True)]
    np.testing.assert_allclose([float(low), float(high)], fastest * np.array(expected), rtol=SAME)


def draw_past(generator, actuation):
    """Return a period, the motion still ahead of its robot, and that of the reference over the
    latency before: commands are its wheels less a deficit."""
    period = draw_period(generator, actuation)
    latency = actuation.nominal(T).latency
    wheels = generator.choice(REFERENCE, period.commands.shape)
    deficit = DEFICIT * generator.choice([-1, 1], len(wheels)) * B / 2
    mean = period.commands.mean(axis=1)
    turning = (wheels[:, 0] - wheels[:, 1]) / 2 - deficit
    asked = np.stack([mean + turning, mean - turning], axis=1)
    period = replace(period, commands=asked)
    return period, commit(period, now=True)[:2], follow_back(period, wheels, latency)


def read_pose(certificate, committed):
    commands = losses_program.read_commands(certificate, certificate["bands"][0])
    return (
        floats(pose_program.bound_now(certificate, committed, commands)),
        floats(pose_program.bound_later(certificate, committed, commands)),
    )


COMMITTED = np.array([0.15, 0.25, 0.27])
POSES = (
    ((0.05, 0.05), (0.0, 0.0), (0.8, 0.9, 0.9)),
    ((0.02, 0.02), (0.06, 0.06), (0.8, 0.9, 0.9)),
    ((0.04, 0.06), (0.01, 0.03), (0.7, 0.8, 0.9)),
)


@pytest.mark.parametrize(("lag", "delay", "reached"), POSES)
def test_the_pose_itself_is_no_further_off_than_is_proved(lag, delay, reached):
    certificate, _ = make_certificate(lag, delay, 0.02)
    now, later = read_pose(certificate, fractions(COMMITTED))
    generator = np.random.default_rng(5)
    actuation = Actuation(lag, delay)
    latency = actuation.nominal(T).latency
    found = np.zeros((2, 3))
    for _ in range(SAMPLES):
        period, ahead, behind = draw_past(generator, actuation)
        period = replace(period, losses=0.02 * generator.choice([-1, 1], 2))
        driven = drive(period, latency)
        for corner in itertools.product((-1, 1), repeat=3):
            x, y, heading = COMMITTED * corner
            reference = join(ahead, (x + 1j * y, heading))
            found[0] = np.maximum(found[0], np.abs(read_errors(join(reference, back(behind)))))
            found[1] = np.maximum(found[1], np.abs(read_errors(join(back(driven), reference))))
    assert np.all(found[0] <= now + ROUNDING) and np.all(found[1] <= later + ROUNDING)
    assert np.all(found[0] >= reached * now)
    assert np.all(found[1] >= 0.6 * later)


@pytest.mark.parametrize(("lag", "delay", "reached"), POSES)
def test_errors_of_the_pose_are_those_that_the_project_proves(lag, delay, reached):
    certificate, _ = make_certificate(lag, delay, 0.02, 0.03, -0.02)
    now, later = read_pose(certificate, fractions(COMMITTED))
    actuation = Actuation(lag, delay)
    schedules = np.array([[[REFERENCE[0]] * 2, [REFERENCE[1]] * 2]])
    ground = Ground(0.02 * np.array([[-1.0, -1.0], [1.0, 1.0]]), None, 0.03, -0.02)
    nominal = actuation.nominal(T)
    driving = make_driving()
    expected = bound_present_errors(COMMITTED, nominal, T, B, driving, schedules)
    np.testing.assert_allclose(now, expected, rtol=SAME)
    expected = bound_later_errors(COMMITTED, actuation, T, B, driving, ground)
    assert np.all(later <= expected * (1 + SAME))
    assert np.all(later >= 0.9 * expected)
    poses = floats(pose_program.bound_poses(certificate, fractions(COMMITTED)))
    np.testing.assert_array_equal(poses, np.maximum(now, later))


def test_a_body_that_slides_is_further_off_later_by_as_much_as_in_the_project():
    still, _ = make_certificate((0.05, 0.05), (0.0, 0.0), 0.02)
    sliding, _ = make_certificate((0.05, 0.05), (0.0, 0.0), 0.02, 0.03, -0.02)
    _, without = read_pose(still, fractions(COMMITTED))
    _, later = read_pose(sliding, fractions(COMMITTED))
    actuation = Actuation((0.05, 0.05), (0.0, 0.0))
    errors = 0.02 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    expected = [
        bound_later_errors(COMMITTED, actuation, T, B, make_driving(), ground)[1]
        for ground in (Ground(errors), Ground(errors, None, 0.03, -0.02))
    ]
    assert later[1] - without[1] == pytest.approx(expected[1] - expected[0], rel=0.01)


def test_unknown_lag_may_leave_the_pose_further_off_later_than_now():
    certificate, _ = make_certificate((0.04, 0.06), (0.01, 0.03), 0.02, 0.03, -0.02)
    now, later = read_pose(certificate, fractions(COMMITTED))
    assert np.any(later > now) and np.any(now > later)
    poses = pose_program.bound_poses(certificate, fractions(COMMITTED))
    np.testing.assert_array_equal(floats(poses), np.maximum(now, later))


def turn_round(ends):
    """Return a range of the opposite of what is in another."""
    return [-end for end in ends[::-1]]


def describe(certificate):
    """Return all that is bounded of a robot whose wheels lag."""
    (band,) = certificate["bands"]
    late = lag_program.find_late(certificate, band)
    poses = np.concatenate(read_pose(certificate, fractions(COMMITTED)))
    noise = pose_program.commit_noise(certificate, fractions((0.001, 0.002, 0.003)))
    return [*late.rest, late.kick, *late.taken, *poses, *noise]


def make_uneven():
    """Return a certificate of a robot that turns left and whose wheels are not alike."""
    certificate, band = make_certificate((0.04, 0.06), (0.03, 0.05), 0.02, 0.01, 0.02)
    band["regions"] = [fractions((1.4, 1.3))]
    band["u2"] = fractions((-1.1, 0.3))
    certificate["lateness"]["wheels"]["right"] = fractions((0.8, 2.1))
    certificate["slips"]["right"] = [fractions((0.1, 0.22, 0.2, 0.2))]
    return certificate, band


def test_the_mirror_image_of_a_robot_is_moved_as_far():
    certificate, _ = make_uneven()
    mirrored, band = make_uneven()
    band["regions"] = [region[::-1] for region in band["regions"]]
    band["u2"] = turn_round(band["u2"])
    for name, table in (("wheels", mirrored["lateness"]), ("slips", mirrored)):
        table[name] = {"right": table[name]["left"], "left": table[name]["right"]}
    assert describe(mirrored) == describe(certificate)


def test_a_robot_that_drives_backwards_is_moved_as_far():
    certificate, _ = make_uneven()
    backwards, band = make_uneven()
    late = backwards["lateness"]
    # Its left is the other one's right; it turns to the same side.
    band["regions"] = [turn_round(region) for region in band["regions"]]
    late["wheels"] = {
        "right": turn_round(late["wheels"]["left"]),
        "left": turn_round(late["wheels"]["right"]),
    }
    backwards["slips"] = {
        "right": backwards["slips"]["left"],
        "left": backwards["slips"]["right"],
    }
    late["speeds"] = turn_round(late["speeds"])
    late["lever"] = -late["lever"]
    assert describe(backwards) == describe(certificate)


def test_noise_of_the_committed_pose_holds_what_noise_of_the_pose_makes_of_it():
    certificate, _ = make_certificate((0.05, 0.05), (0.04, 0.04))
    noise = np.array([0.01, 0.02, 0.03])
    made = floats(pose_program.commit_noise(certificate, fractions(noise)))
    expected = bound_committed_noise(noise, 0.09, REFERENCE[1], YAW)
    np.testing.assert_allclose(made, expected, rtol=SAME)
    generator = np.random.default_rng(2)
    found = np.zeros(3)
    for _ in range(SAMPLES):
        _, ahead, behind = draw_past(generator, Actuation((0.05, 0.05), (0.04, 0.04)))
        x, y, heading = generator.uniform(-1, 1, 3) * COMMITTED
        for corner in itertools.product((-1, 1), repeat=3):
            n_x, n_y, n_th = noise * corner
            errors = [(x + 1j * y, heading), (x + n_x + 1j * (y + n_y), heading + n_th)]
            exact, measured = (
                read_errors(join(join(back(ahead), error), behind)) for error in errors
            )
            found = np.maximum(found, np.abs(measured - exact))
    assert np.all(found <= made + ROUNDING)
    assert np.all(found >= 0.8 * made)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lag": [Fraction(3, 50), Fraction(1, 20)]}, "no interval"),
        ({"nominal": [Fraction(1, 5), Fraction(0)]}, "no interval"),
        ({"delay": [Fraction(-1, 5), Fraction(0)]}, "no interval"),
        ({"delay": [Fraction(0), Fraction(1, 5)]}, "overtake"),
        ({"speeds": [Fraction(2), Fraction(1)]}, "crossed"),
        ({"noise": [Fraction(-1, 1000), Fraction(0), Fraction(0)]}, "negative"),
        ({"noise": [Fraction(1, 100), Fraction(0), Fraction(0)]}, "measured worse"),
        ({"other": Fraction(1)}, "not described"),
        ({"wheels": {"right": [Fraction(1), Fraction(2)]}}, "not described"),
    ],
)
def test_lag_and_delay_that_say_nothing_are_refused(change, said):
    certificate, band = make_certificate((0.05, 0.05), (0.0, 0.0))
    certificate["lateness"] |= {"noise": [Fraction(1, 1000)] * 3}
    certificate["noise"] = [Fraction(1, 500)] * 3
    band["cells"] = {}
    pose_program.check_lateness(certificate)
    certificate["lateness"] |= change
    with pytest.raises(intervals.Refused, match=said):
        pose_program.check_lateness(certificate)


@pytest.mark.parametrize(
    "change",
    [{"learning": {}}, {"bands": [{"cells": {}}, {"cells": {}}]}, {"bands": [{}]}],
)
def test_lag_beside_what_it_is_not_proved_with_is_unchecked(change):
    certificate, band = make_certificate((0.05, 0.05), (0.0, 0.0))
    certificate["lateness"]["noise"] = [Fraction(0)] * 3
    band["cells"] = {}
    with pytest.raises(intervals.Refused, match="UNCHECKED"):
        pose_program.check_lateness(certificate | change)


def test_sideslip_is_no_less_than_none():
    certificate, band = make_certificate((0.05, 0.05), (0.0, 0.0), sideslip=-0.01)
    certificate["lateness"]["noise"] = [Fraction(0)] * 3
    band["cells"] = {}
    with pytest.raises(intervals.Refused, match="sideslip"):
        pose_program.check_lateness(certificate)


def test_a_robot_that_may_turn_too_far_within_its_latency_is_refused():
    certificate, band = make_certificate((0.3, 0.3), (0.5, 0.5), 0.02)
    with pytest.raises(intervals.Refused, match="1 rad"):
        lag_program.find_late(certificate, band)


POINT = (0.4, 0.1, -0.2, 0.05, 0.6, 1.3, 1.4, 0.02, -0.01, 0.0, 0.001, -0.001, 0.002)
"""Of the variables of a motion, without sideslip."""
PIECE = (Fraction(1, 10), Fraction(0), None, None)


def move(output, variables):
    """Return a motion at a point."""
    cell = [intervals.scale(Fraction(value)) for value in variables]
    robot = (Fraction(T), Fraction(B), Fraction(0), Fraction(1, 20), Fraction(1))
    (low, high) = motion_program.note_motion(output, cell, robot, PIECE).follow(cell)[-1]
    assert high - low < 2**12
    return (low + high) / 2 / intervals.ONE


@pytest.mark.parametrize("output", ["x", "y", "y of the model", "kick", "right", "left"])
def test_ways_lost_move_a_robot_as_the_shares_that_they_are(output):
    *rest, d_r, d_l, zeta, n_x, n_y, n_th = POINT
    ways = [move(wheel, POINT) * d for wheel, d in (("right", d_r), ("left", d_l))]
    late = move(output, [*rest, *ways, zeta, n_x, n_y, n_th, 0.0, 0.0, 0.0])
    assert late == pytest.approx(move(output, POINT), abs=1e-14)
    way, turn = 0.003, 0.02
    of_wheels = [ways[0] + way + B / 2 * turn, ways[1] + way - B / 2 * turn]
    expected = move(output, [*rest, *of_wheels, zeta, n_x, n_y, n_th, 0.0, 0.0, 0.0])
    taken = [*rest, *ways, zeta, n_x, n_y, n_th, way, turn, 0.0]
    assert move(output, taken) == pytest.approx(expected, abs=1e-14)
    # A kick moves the committed pose sideways by its lever more.
    further = move(output, [*taken[:-1], 0.07]) - move(output, taken)
    kick = move("kick", taken)
    assert further == pytest.approx(0.07 * kick if output[0] == "y" else 0.0, abs=1e-14)


def test_the_way_of_a_body_is_the_mean_of_those_of_its_wheels():
    ways = [move(wheel, POINT) for wheel in ("right", "left")]
    assert move("way", POINT) == pytest.approx(sum(ways) / 2, abs=1e-14)
