"""Laws of units: no key is forgotten, what is changed back is what it was, weights and gains have
the units of what they multiply."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from jaxtube.scenario import load, names, replace, to_toml
from jaxtube.scenario.tree import BandTable, RobotTable, Scenario, Table
from jaxtube.scenario.units import (
    INPUT,
    NONE,
    UNITS,
    WITHOUT_UNITS,
    find_powers,
    rescale,
    round_significant,
)

OF_SEVERAL_UNITS = {"error_weight", "input_weight", "tracking_gains", "vertex_gains", "bands"}
LENGTH = 2.5
TIME = 0.4


class OtherRobot(RobotTable, frozen=True):
    """A robot with a key that was added and has no unit."""

    wheel_width: float = 0.1


def numbers(table: type[Table], section: str) -> Iterator[str]:
    """Yield the keys of a table whose values hold numbers."""
    for field in msgspec.structs.fields(table):
        if isinstance(field.type, type) and issubclass(field.type, Table):
            yield from numbers(field.type, field.name)
        elif any(word in str(field.type) for word in ("float", "int", "bool")):
            yield f"{section}.{field.name}"


def test_every_number_of_a_scenario_has_a_unit_or_is_listed_as_one_without():
    keys = {*numbers(Scenario, ""), *numbers(BandTable, "bands")}
    assert len(keys) > 50
    for key in keys:
        if key.rpartition(".")[2] not in OF_SEVERAL_UNITS:
            find_powers(key)
    assert keys >= WITHOUT_UNITS


def test_a_key_that_is_new_is_scaled_by_its_unit_or_refused():
    assert find_powers("controller.look_ahead_m") == UNITS["m"]
    with pytest.raises(KeyError, match=r"robot\.wheel_width"):
        rescale(Scenario(robot=OtherRobot()), LENGTH)


@pytest.mark.parametrize("name", names())
def test_a_change_of_units_and_back_changes_nothing(name):
    scenario = load(name)
    there = rescale(scenario, LENGTH, TIME)
    back = rescale(there, 1 / LENGTH, 1 / TIME, digits=12)
    assert there != scenario
    assert rescale(scenario) == scenario
    assert to_toml(back) == to_toml(rescale(scenario, digits=12))


def test_quantities_scale_by_the_units_in_their_names():
    scenario = load("certified_wide")
    scaled = rescale(scenario, LENGTH, TIME)
    speed = LENGTH / TIME
    assert scaled.reference.radius_m == pytest.approx(LENGTH * scenario.reference.radius_m)
    assert scaled.controller.dt_s == pytest.approx(TIME * scenario.controller.dt_s)
    assert scaled.constraints.heading_deg == scenario.constraints.heading_deg
    assert scaled.slip == scenario.slip
    for band, own in zip(scaled.operating.bands, scenario.operating.bands, strict=True):
        assert band.below_mps == pytest.approx(speed * own.below_mps)
        assert band.yaw_rate_deficit_radps == pytest.approx(own.yaw_rate_deficit_radps / TIME)
        expected = np.array(own.tracking_gains) / TIME / [1.0, LENGTH, 1.0]
        np.testing.assert_allclose(band.tracking_gains, expected)
    limit = replace(scenario, {"operating.bands": [], "robot.wheel_acceleration_max_mps2": 2.0})
    faster = rescale(limit, LENGTH, TIME).robot.wheel_acceleration_max_mps2
    assert faster == pytest.approx(2.0 * LENGTH / TIME**2)


def test_the_cost_of_an_error_and_an_input_is_the_same_in_all_units():
    full = [[2.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 1.0]]
    scenario = replace(load("certified"), {"controller.error_weight": full})
    scaled = rescale(scenario, LENGTH, TIME)
    error = np.array([0.1, -0.2, 0.3])
    inputs = np.array([0.4, 0.5])
    moved = error * [LENGTH, LENGTH, 1.0]
    after = moved @ np.array(scaled.controller.error_weight) @ moved
    assert after == pytest.approx(error @ np.array(full) @ error)
    before = inputs @ np.diag(scenario.controller.input_weight) @ inputs
    moved = inputs * [LENGTH**unit.length * TIME**unit.time for unit in INPUT]
    after = moved @ np.diag(scaled.controller.input_weight) @ moved
    assert after == pytest.approx(before)


def test_numbers_are_rounded_to_significant_digits():
    assert round_significant(123.456, 2) == 120.0
    assert round_significant(-0.00123456, 4) == -0.001235
    assert round_significant(0.0, 3) == 0.0
    assert UNITS["deg"] == NONE


def test_a_change_a_second_is_the_same_a_period_in_all_units():
    scenario = load("certified_learning")
    slower = rescale(scenario, time=4.0)
    assert slower.slip.change_per_s == pytest.approx(scenario.slip.change_per_s / 4)
    before = scenario.slip.change_per_s * scenario.controller.dt_s
    assert slower.slip.change_per_s * slower.controller.dt_s == pytest.approx(before)
