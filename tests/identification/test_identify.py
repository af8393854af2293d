"""Laws of an identification: what is used for what, what is refused, and what its file says."""

import dataclasses
import tomllib

import numpy as np
import pytest
from scipy import stats
from simulated_robots import draw_windows, share_inside

from jaxtube.identification.findings import inspect_log
from jaxtube.identification.geometry import find_sideslip, find_slips
from jaxtube.identification.identify import Choices, identify_log, identify_windows
from jaxtube.identification.promise import make_promise
from jaxtube.identification.scenario_text import write_scenario
from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import Sensors, record
from jaxtube.identification.uncovered import find_uncovered
from jaxtube.identification.words import say_other_boxes, say_promise, say_sample
from jaxtube.scenario import ScenarioError
from jaxtube.scenario.validation import validate

TRUTH = Truth(effective_track=0.8, lever_arm=-0.1, slip=((0.0, 0.1), (0.05, 0.12)))
REPETITIONS = 6
CHANCE = 1e-4


def identify(commands=45, seed=0, truth=TRUTH, **choices):
    return identify_windows(draw_windows(truth, commands, seed), Choices(**choices))


@pytest.fixture(scope="module")
def identified():
    return identify()


def change(windows, **arrays):
    return dataclasses.replace(windows, **arrays)


def refuse(windows, **choices):
    with pytest.raises(ScenarioError) as refused:
        identify_windows(windows, Choices(**choices))
    line = str(refused.value)
    assert "\n" not in line
    return line


def test_every_third_command_fits_and_the_others_count(identified):
    command = identified.windows.command
    assert np.array_equal(identified.fits, command % 3 == 0)
    assert np.array_equal(identified.counts, command % 3 != 0)
    assert identified.promise == make_promise(30, 5)


def test_the_box_encloses_all_that_counts_and_nothing_else_decides_it(identified):
    used = identified.counts
    assert identified.box.holds(identified.slips[used], identified.sideslips[used]).all()
    windows = identified.windows
    other = windows.velocity.copy()
    fitted = np.flatnonzero(identified.fits)
    other[fitted] = other[fitted[::-1]]
    counted = windows.velocity[used]
    again = identify_windows(windows, Choices())
    assert again.box == identified.box
    assert np.array_equal(again.windows.velocity[used], counted)


def test_new_commands_lie_inside_as_often_as_is_promised():
    """On slips without noise a promise may fail once in twenty; `test_known_truth` repeats this for
    all kinds of boxes."""
    broken = 0
    shares = []
    for seed in range(REPETITIONS):
        found = identify(seed=seed)
        # Slips as the identified track sees them: what the promise is about.
        new = draw_windows(TRUTH, 1000, 10_000 + seed)
        seen = identify_new(found, new)
        shares.append(seen)
        broken += seen < found.promise.share
    print(f"promised {found.promise.share:.3f}, inside {np.mean(shares):.3f}")
    assert broken <= stats.binom.ppf(1 - CHANCE, REPETITIONS, 0.05)


def identify_new(found, new):
    """Return the share of new commands whose windows all lie in an identified box."""
    slips = find_slips(new.wheels, new.velocity, found.geometry.track)
    side = find_sideslip(new.velocity, found.geometry.lever_arm)
    inside = found.box.holds(slips, side)
    return float(np.mean(inside.reshape(-1, 2).all(axis=1)))


def test_fewer_sides_promise_more_of_a_wider_box(identified):
    alike = identify(box="alike")
    scaled = identify(box="scaled")
    assert identified.promise.share < alike.promise.share < scaled.promise.share
    for box in (alike.box, scaled.box):
        used = identified.counts
        assert box.widen(1e-12).holds(identified.slips[used], identified.sideslips[used]).all()


def test_a_margin_widens_the_file_and_not_the_promise(identified):
    wide = identify(margin=0.02)
    assert wide.promise == identified.promise
    assert wide.box == identified.box
    assert wide.widened_box.right[1] == pytest.approx(identified.box.right[1] + 0.02)
    assert "not promised" in write_scenario(wide, None, None)


# ------------------------------------------------------------------------------------------ words


def test_the_promise_comes_first_and_in_these_words():
    found = identify(commands=28, box="alike")
    assert found.promise.commands == 18
    share = int(100 * make_promise(18, 3).share)
    assert say_promise(found) == (
        f"holds for at least {share} % of new commands at 95 % confidence, from 18; "
        "95 % needs 124; 99 % needs 628"
    )
    assert "3 sides" in say_sample(found)
    assert "18 commands, each command counted once" in say_sample(found)
    assert "scaled" in say_other_boxes(found)
    assert say_other_boxes(identify(box="scaled")) == ""


def test_the_file_is_a_scenario_that_holds_what_was_identified(identified):
    text = write_scenario(identified, None, 0.5)
    scenario = validate(tomllib.loads(text), lambda key: "identified.toml")
    assert scenario.robot.track_width_m == 0.5
    assert scenario.robot.effective_track_m == pytest.approx(identified.geometry.track, abs=1e-4)
    assert scenario.robot.lever_arm_m == pytest.approx(identified.geometry.lever_arm, abs=1e-4)
    for side in ("right", "left"):
        least, greatest = getattr(identified.box, side)
        written = getattr(scenario.slip, side)
        assert written[0] <= least <= written[0] + 1.01e-4
        assert written[1] - 1.01e-4 <= greatest <= written[1]
    assert scenario.slip.sideslip >= identified.box.sideslip
    assert scenario.noise.frame == "world"
    assert scenario.disturbance.bound == "computed"
    assert scenario.controller.model == "exact_jacobian"
    assert scenario.controller.terminal == "T-A"
    assert scenario.robot.wheel_speed_max_mps <= identified.fastest_wheel
    assert scenario.robot.wheel_speed_min_mps >= identified.least_wheel
    assert say_promise(identified).split(";")[0] in " ".join(text.replace("#", "").split())


def test_every_key_of_the_file_has_a_source_above_it(identified):
    lines = write_scenario(identified, None, None).splitlines()
    for table in ("[robot]", "[slip]", "[noise]"):
        for key in lines[lines.index(table) + 1 :]:
            if key.startswith("["):
                break
            if "=" in key and not key.startswith(("#", "frame")):
                above = lines[lines.index(key) - 1]
                assert above.startswith("# ")


def test_turning_on_the_spot_is_told_and_not_counted(identified):
    windows = identified.windows
    wheels = windows.wheels.copy()
    velocity = windows.velocity.copy()
    wheels[:2] = [0.5, -0.5]
    velocity[:2] = [0.0, 1.0 / 1.1, 0.0]
    found = identify_windows(change(windows, wheels=wheels, velocity=velocity), Choices())
    uncovered = find_uncovered(found)
    assert not (found.fits | found.counts)[:2].any()
    assert uncovered.on_the_spot == 1
    assert uncovered.spot_track == pytest.approx((1.1, 1.1, 1.1))


# --------------------------------------------------------------------------------------- refusals


def test_too_few_commands_are_refused_with_how_many_it_takes():
    line = refuse(draw_windows(TRUTH, 8, 0))
    assert "commands = 8: of 8 steady ones drive both wheels forwards" in line
    assert "record 66 such commands for 80 %" in line


def test_straight_lines_are_refused():
    windows = draw_windows(TRUTH, 45, 0)
    wheels = np.repeat(windows.wheels.mean(axis=1, keepdims=True), 2, axis=1)
    assert "no track can be told from straight lines; drive curves" in refuse(
        change(windows, wheels=wheels)
    )


def test_a_robot_that_stands_is_refused():
    windows = draw_windows(TRUTH, 45, 0)
    assert "commands = 0" in refuse(change(windows, wheels=np.zeros_like(windows.wheels)))


def test_a_pose_that_is_lost_nearly_everywhere_is_refused():
    windows = draw_windows(TRUTH, 45, 0)
    lost = np.arange(90) >= 10
    assert "lost = 0.889: is the share of windows" in refuse(change(windows, lost=lost))


def test_a_robot_that_turns_by_something_else_is_refused():
    windows = draw_windows(TRUTH, 45, 0)
    velocity = windows.velocity.copy()
    velocity[:, 1] = np.random.default_rng(5).normal(0.0, 1.0, 90)
    line = refuse(change(windows, velocity=velocity))
    assert "wheels explain through an effective track" in line
    assert "record on firmer ground" in line


def test_a_slip_of_one_and_more_is_refused():
    windows = draw_windows(TRUTH, 45, 0)
    velocity = windows.velocity.copy()
    velocity[2:4] = [-0.2, 0.0, 0.0]
    assert "the ground runs against the wheel" in refuse(change(windows, velocity=velocity))


def test_a_truth_in_the_box_is_seen_there(identified):
    assert share_inside(TRUTH, identified.box.widen(0.5), 500, 1) == 1.0
    assert share_inside(TRUTH, identified.box.widen(-0.02), 500, 1) < 0.9


@pytest.mark.parametrize("noise_m", [0.005, 0.12])
def test_the_file_of_a_noisy_log_is_a_scenario_too(noise_m):
    sensors = Sensors(pose_noise=noise_m, heading_noise=0.02)
    findings = inspect_log(record(drive(TRUTH, 40, seed=9), sensors, seed=9).log, 4.0)
    found = identify_log(findings, Choices(box="scaled"))
    text = write_scenario(found, findings, None)
    scenario = validate(tomllib.loads(text), lambda key: "identified.toml")
    assert scenario.noise.longitudinal_m >= 2 * noise_m
    assert ("[constraints]" in text) == (noise_m > 0.05)
    assert scenario.constraints.lateral_m > 2 * scenario.noise.lateral_m
