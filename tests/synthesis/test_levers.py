"""Laws of the quantities that one factor scales: what changes, how it is rounded, and what no
scenario may have."""

import pytest

from jaxtube.scenario import ScenarioError, load, replace
from jaxtube.synthesis.levers import LIMITS, NOISE, RANGE, SLIP, SPEED, key_lever, list_levers
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import without_caps

INTERVALS = {
    "slip.right": [-0.054, 0.106],
    "slip.left": [0.0, 0.1],
    "slip.nominal_right": 0.026,
    "slip.nominal_left": 0.02,
}


@pytest.fixture
def scenario():
    return without_caps(load("certified"))


@pytest.mark.parametrize("lever", [SPEED, LIMITS, SLIP, NOISE, RANGE])
def test_a_factor_of_one_changes_nothing(scenario, lever):
    assert lever.scale(scenario, 1.0) == scenario


def test_the_box_of_wheel_speeds_goes_along_and_holds_the_path_at_any_factor(scenario):
    for factor in (1 / 3, 0.71234, 1.0101, 2.71828):
        scaled = SPEED.scale(scenario, factor).reference
        assert scaled.speed_mps == pytest.approx(1.36 * factor, rel=1e-3)
        assert scaled.wheel_speed_min_mps <= scaled.speed_mps * 0.9
        assert scaled.wheel_speed_max_mps >= scaled.speed_mps * 1.1
        assert scaled.wheel_speed_max_mps == pytest.approx(1.496 * factor, rel=1e-3)


def test_the_range_shrinks_to_the_wheel_speeds_of_the_path_and_holds_them(scenario):
    wide = {"reference.wheel_speed_min_mps": 0.5, "reference.wheel_speed_max_mps": 1.7}
    wheels = make_problem(scenario).reference.wheels
    slowest = wheels.min()
    fastest = wheels.max()
    for factor in (1e-3, 0.31, 0.7):
        scaled = RANGE.scale(replace(scenario, wide), factor).reference
        below = slowest - scaled.wheel_speed_min_mps
        above = scaled.wheel_speed_max_mps - fastest
        assert below == pytest.approx((slowest - 0.5) * factor, abs=1e-3) and below >= 0
        assert above == pytest.approx((1.7 - fastest) * factor, abs=1e-3) and above >= 0
        assert scaled.speed_mps == scenario.reference.speed_mps
    assert "range" in [lever.name for lever in list_levers(scenario)]
    as_narrow_as_may_be = {
        "reference.wheel_speed_min_mps": float(slowest),
        "reference.wheel_speed_max_mps": float(fastest),
    }
    path_alone = {"reference.certified_for": "path"}
    for alone in ({"reference.shape": "jumps"}, path_alone, as_narrow_as_may_be):
        assert "range" not in [lever.name for lever in list_levers(replace(scenario, alone))]


def test_rounding_is_to_what_is_harder_to_hold(scenario):
    limits = LIMITS.scale(scenario, 1 / 3).constraints
    assert limits.lateral_m == limits.longitudinal_m == 0.1
    assert limits.heading_deg == 6.666
    assert NOISE.scale(scenario, 1 / 3).noise.lateral_m == 0.0003334
    assert SLIP.scale(scenario, 2 / 3).slip.relative_error == 0.06667
    assert LIMITS.scale(scenario, 10).constraints.heading_deg == 89.0


def test_intervals_of_slip_widen_about_the_nominal_one(scenario):
    widened = SLIP.scale(replace(scenario, INTERVALS), 2.0).slip
    assert widened.right == pytest.approx((0.026 - 0.16, 0.026 + 0.16))
    assert widened.left == pytest.approx((-0.02, 0.18))
    assert widened.nominal == pytest.approx((0.026, 0.02))
    assert SLIP.measure(replace(scenario, INTERVALS)) == pytest.approx(0.08)


def test_of_a_measured_slip_the_error_scales_and_the_interval_stays(scenario):
    measured = replace(scenario, INTERVALS | {"slip.measurement_error_relative": 0.1})
    scaled = SLIP.scale(measured, 0.5).slip
    assert scaled.measurement_error_relative == 0.05
    assert scaled.measurement_error is None
    assert scaled.right == (-0.054, 0.106)


def test_what_a_scenario_has_none_of_is_no_lever(scenario):
    names = [lever.name for lever in list_levers(scenario)]
    assert "slip.sideslip" not in names
    assert {"speed", "slip", "noise", "constraints.lateral_m"} <= set(names)
    skidding = replace(scenario, {"slip.sideslip": 0.04})
    assert "slip.sideslip" in [lever.name for lever in list_levers(skidding)]
    constant = {"slip.right": [0.2, 0.2], "slip.left": [0.2, 0.2]}
    still = replace(scenario, constant)
    assert "slip" not in [lever.name for lever in list_levers(still)]
    assert key_lever("slip", "sideslip", easier=-1).scale(skidding, 0.5).slip.sideslip == 0.02


def test_lag_and_delay_scale_together(scenario):
    late = {"robot.wheel_lag_s": [0.02, 0.06], "robot.command_delay_s": [0.0, 0.01]}
    (lever,) = [each for each in list_levers(replace(scenario, late)) if "lag" in each.name]
    halved = lever.scale(replace(scenario, late), 0.5).robot
    assert halved.wheel_lag_s == (0.01, 0.03)
    assert halved.command_delay_s == (0.0, 0.005)
    assert lever.measure(replace(scenario, late)) == 0.06
    assert not any("lag" in each.name for each in list_levers(scenario))


def test_what_no_scenario_may_have_is_refused_in_one_line(scenario):
    with pytest.raises(ScenarioError, match=r"slip\.right") as refused:
        SLIP.scale(replace(scenario, INTERVALS), 20.0)
    assert "\n" not in str(refused.value)


def test_quantities_are_said_as_in_a_scenario_file(scenario):
    assert SPEED.say_measured(scenario) == "reference.speed_mps = 1.36"
    assert SLIP.say(replace(scenario, INTERVALS)) == (
        "slip.right = [-0.054, 0.106], slip.left = [0, 0.1]"
    )
