"""Laws of what the checker says of slips that are learnt: against drives in the world frame, and
against the bounds that the project proves of its observer."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

from jaxtube.synthesis.proof_search import load_checker
from sets.robot.slip_learning import Learning, bound_learnt_slips

learning = load_checker("check_learning.py")
intervals = load_checker("check_intervals.py")

PERIODS = 4
TRACK = 0.5
PERIOD = 0.1
SAME = 1e-9
"""Share by which proofs in floats and in rationals may differ."""


def make_certificate(seed):
    """Return the numbers of which slips are learnt, drawn around those of `certified_learning`."""
    random = np.random.default_rng(seed)

    def draw(middle):
        return Fraction(float(middle * random.uniform(0.8, 1.2)))

    least = draw(0.05)
    slips = [least, least + draw(0.2)] * 2
    slowest = draw(0.6)
    speeds = [slowest, slowest + draw(1.5)]
    region = [draw(1.0), draw(1.0) + Fraction(2, 5)]
    band = {
        "errors": [draw(0.14), draw(0.2), draw(0.27)],
        "u2": [-draw(0.8), draw(0.8)],
        "regions": [[*region, *region]],
    }
    return {
        "period": Fraction(PERIOD),
        "track": Fraction(TRACK),
        "noise": [draw(0.001), draw(0.001), draw(0.0003)],
        "slips": {"right": [slips], "left": [slips]},
        "bands": [band],
        "learning": {
            "change": draw(0.005),
            "periods": PERIODS,
            "speeds": {"right": speeds, "left": speeds},
        },
    }


@pytest.mark.parametrize("seed", range(8))
def test_losses_are_those_that_the_project_proves(seed):
    certificate = make_certificate(seed)
    band = certificate["bands"][0]
    low, high = map(float, band["regions"][0][:2])
    told = certificate["learning"]
    slips = certificate["slips"]["right"][0][:2]
    speeds = told["speeds"]["right"]
    # The project adds the noise of headings to half a turn twice, where once is enough.
    twice = 2 * float(certificate["noise"][2]) / PERIOD
    proved = bound_learnt_slips(
        Learning(
            slips=np.tile(np.array(slips, float)[:, None], 2),
            change=float(told["change"]),
            periods=PERIODS,
            errors=np.array(band["errors"], float),
            noise=np.array(certificate["noise"], float),
            speeds=np.tile(np.array(speeds, float)[:, None], 2),
            yaw_rate=(high - low) / TRACK + float(max(map(abs, band["u2"]))) - twice,
            reference_speed=high,
            dt=PERIOD,
            track_width=TRACK,
        )
    )
    noise = learning.bound_noise(certificate)
    found = learning.bound_wheel(told, noise, certificate["period"], slips, speeds)
    assert np.array(found, float) == pytest.approx(proved.wheel_errors[:, 0], rel=SAME)


@pytest.mark.parametrize("seed", range(5))
def test_the_reach_of_a_window_is_the_greatest_of_all_travels(seed):
    random = np.random.default_rng(seed)
    ways = [(0.05, 0.05 + random.uniform(0, 0.2)) for _ in range(PERIODS)]
    for noise in (0.001, 0.003, 0.01):
        wanted = max(
            (noise + 0.02 * sum((k + 1) * way for k, way in enumerate(rolled))) / sum(rolled)
            for rolled in itertools.product(*ways)
        )
        assert learning.find_reach(noise, 0.02, ways) == pytest.approx(wanted, rel=1e-12)


def drive(errors, reference, ground, slide):
    """Return the errors after a period, as (x + i y, heading), of a robot whose wheels travel
    `ground` and whose reference's `reference`, (right, left) in m, while it slides."""
    place, heading = errors

    def go(ways, sideways):
        turn = (ways[0] - ways[1]) / TRACK
        chord = np.sinc(turn / 2 / np.pi) * np.exp(0.5j * turn)
        return chord * ((ways[0] + ways[1]) / 2 + 1j * sideways), turn

    ahead, turned = go(reference, 0.0)
    moved, turn = go(ground, slide)
    after = (place + ahead * np.exp(1j * heading) - moved) * np.exp(-1j * turn)
    return after, heading + turned - turn


def find_travel(before, after, reference):
    """Return what the checker says that the right wheel travels, from two errors."""
    A = (reference[0] - reference[1]) / TRACK
    half = (before[1] - after[1] + A) / 2
    mean = (before[1] + after[1]) / 2
    chord = (reference[0] + reference[1]) / 2 * np.sinc(A / 2 / np.pi)
    r = half / np.sin(half)
    moved = before[0].real - after[0].real
    swayed = before[0].imag + after[0].imag
    s = half / np.tan(half) * moved + half * swayed + chord * r * np.cos(mean)
    return s + TRACK * half


def test_travels_follow_from_errors_in_the_world_frame():
    random = np.random.default_rng(0)
    for _ in range(50):
        before = (complex(*random.uniform(-0.2, 0.2, 2)), random.uniform(-0.3, 0.3))
        reference = random.uniform(0.05, 0.15, 2)
        ground = random.uniform(0.05, 0.2, 2)
        after = drive(before, reference, ground, random.uniform(-0.02, 0.02))
        assert find_travel(before, after, reference) == pytest.approx(ground[0], abs=1e-14)


@pytest.mark.parametrize("seed", range(4))
def test_noise_moves_no_travel_by_more_than_is_proved(seed):
    random = np.random.default_rng(seed)
    certificate = make_certificate(seed)
    noise = np.array(certificate["noise"], float)
    caps = np.array(certificate["bands"][0]["errors"], float) - noise
    proved = np.array(learning.bound_noise(certificate), float)
    low, high = np.array(certificate["bands"][0]["regions"][0][:2], float) * PERIOD
    worst = np.zeros(PERIODS)
    for _ in range(4000):
        x, y, heading = caps * random.choice([-1, 1, 0], 3)
        errors = [(complex(x, y), heading)]
        references = random.choice([low, high], (PERIODS, 2))
        for reference in references:
            ground = reference + random.uniform(-0.03, 0.03, 2)
            errors.append(drive(errors[-1], reference, ground, 0.0))
        measured = [
            (place + complex(*(noise[:2] * random.choice([-1, 1], 2))), th + noise[2] * sign)
            for (place, th), sign in zip(errors, random.choice([-1, 1], len(errors)), strict=True)
        ]
        missed = 0.0
        for count in range(PERIODS):
            inside = np.array([measured[count + 1][0].real, measured[count + 1][0].imag])
            if np.any(np.abs([*inside, measured[count + 1][1]]) > caps + noise):
                break
            of_true = find_travel(errors[count], errors[count + 1], references[count])
            of_measured = find_travel(measured[count], measured[count + 1], references[count])
            missed += of_measured - of_true
            worst[count] = max(worst[count], abs(missed))
    assert np.all(worst <= proved)
    assert np.all(worst > 0.3 * proved)


def test_the_derivatives_that_the_observer_counts_on_are_proved():
    learning.check_derivatives()
    h = np.linspace(0.01, 0.49, 49)
    step = 1e-4
    for index, function in enumerate((lambda h: h / np.tan(h), lambda h: h / np.sin(h))):
        curved = (function(h + step) - 2 * function(h) + function(h - step)) / step**2
        for at, expected in zip(h, curved, strict=True):
            low, high = learning.bend(intervals.scale(Fraction(at)))[index]
            assert low / intervals.ONE == pytest.approx(expected, abs=1e-6)
            assert 0 <= high - low < 1000


def test_a_robot_that_may_turn_too_far_or_stand_is_refused():
    certificate = make_certificate(0)
    certificate["bands"][0]["u2"] = [Fraction(-9), Fraction(9)]
    with pytest.raises(intervals.Refused, match="turn too far"):
        learning.bound_noise(certificate)
