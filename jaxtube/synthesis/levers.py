"""What can be asked less of, or more: quantities of a scenario that one factor scales.

    speed    reference.speed_mps, and the box of the reference's wheel speeds along with it
    limits   all of [constraints]
    slip     what is not known of it: relative_error; or the errors of the measured slips; or the
             intervals of the true slips about the nominal ones
    noise    all of [noise]
    range    how far the box of the reference's wheel speeds goes beyond those of the path
    KEY      a single key

Scaled numbers are rounded as one would write them, to what is harder to hold.

Source: new.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from jaxtube.scenario.reading import replace
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.problem import make_problem

DIGITS = 4
"""Significant digits of scaled numbers."""
STEEPEST_DEG = 89.0
"""Heading limit at most."""
ERROR_KEYS = ("longitudinal_m", "lateral_m", "heading_deg")

Values = dict[str, Any]


@dataclass(frozen=True)
class Lever:
    """A quantity of a scenario.

    Attributes:
        name: as above.
        easier: the direction in which designs are easier to find, 1 for larger, -1 for smaller.
        label: of an axis.
        values: returns keys and values of a scenario's quantity times a factor; empty where it has
            none of it.
        measured: the key whose value stands for the quantity, the first one there is.
    """

    name: str
    easier: Literal[1, -1]
    label: str
    values: Callable[[Scenario, float], Values]
    measured: str = ""

    def scale(self, scenario: Scenario, factor: float) -> Scenario:
        """Return the scenario with the quantity times a positive factor.

        Raises:
            ScenarioError: where no scenario may have that.
        """
        return replace(scenario, self.values(scenario, factor))

    def measure(self, scenario: Scenario) -> float:
        """Return the quantity as one number: of an interval of slip its half width, of another one
        its upper end."""
        key, value = self._find_measured(scenario)
        if not isinstance(value, tuple):
            return float(value)
        return (value[1] - value[0]) / 2 if key.startswith("slip.") else value[1]

    def say(self, scenario: Scenario) -> str:
        """Return the quantity of a scenario as keys and values, as in a scenario file."""
        values = self.values(scenario, 1.0)
        return ", ".join(f"{key} = {_say_value(value)}" for key, value in values.items())

    def say_measured(self, scenario: Scenario) -> str:
        """Return the key that stands for the quantity, and its value."""
        key, value = self._find_measured(scenario)
        return f"{key} = {_say_value(value)}"

    def _find_measured(self, scenario: Scenario) -> tuple[str, Any]:
        values = self.values(scenario, 1.0)
        key = self.measured if self.measured in values else next(iter(values))
        return key, values[key]


def key_lever(section: str, *keys: str, easier: Literal[1, -1]) -> Lever:
    """Return the lever of keys of one section, named by the first one."""
    name = f"{section}.{keys[0]}"
    return Lever(name, easier, name, partial(_scale_keys, section, keys, -easier))


def list_levers(scenario: Scenario) -> list[Lever]:
    """Return the levers that a scenario has: speed, slip, noise, range, and single keys."""
    must_roll = scenario.robot.wheel_speed_min_mps > 0
    slowest = [key_lever("robot", "wheel_speed_min_mps", easier=-1)] if must_roll else []
    levers = [
        SPEED,
        SLIP,
        NOISE,
        RANGE,
        *(key_lever("constraints", key, easier=1) for key in ERROR_KEYS),
        key_lever("slip", "sideslip", easier=-1),
        key_lever("robot", "wheel_speed_max_mps", easier=1),
        *slowest,
        key_lever("robot", "wheel_lag_s", "command_delay_s", easier=-1),
    ]
    return [lever for lever in levers if lever.values(scenario, 1.0)]


def _scale_keys(
    section: str, keys: tuple[str, ...], direction: int, scenario: Scenario, factor: float
) -> Values:
    table = getattr(scenario, section)
    scaled = {}
    for key in keys:
        value = getattr(table, key)
        if isinstance(value, tuple) and any(value):
            scaled[f"{section}.{key}"] = tuple(_round(end * factor, direction) for end in value)
        elif value and not isinstance(value, tuple):
            scaled[f"{section}.{key}"] = _round(value * factor, direction)
    if "constraints.heading_deg" in scaled:
        scaled["constraints.heading_deg"] = min(scaled["constraints.heading_deg"], STEEPEST_DEG)
    return scaled


def _scale_speed(scenario: Scenario, factor: float) -> Values:
    """Return speed and box; the box still holds the path at the rounded speed."""
    reference = scenario.reference
    if reference.shape == "file":
        return {}
    speed = _round(reference.speed_mps * factor, 0)
    exact = speed / reference.speed_mps
    return {
        "reference.speed_mps": speed,
        "reference.wheel_speed_min_mps": _round(reference.wheel_speed_min_mps * exact, -1),
        "reference.wheel_speed_max_mps": _round(reference.wheel_speed_max_mps * exact, 1),
    }


def _scale_range(scenario: Scenario, factor: float) -> Values:
    """Return the box, its distance from the wheel speeds of the path scaled; nothing where the box
    makes the path or is no wider, or the path alone is certified."""
    reference = scenario.reference
    if reference.shape == "jumps" or reference.certified_for == "path":
        return {}
    wheels = make_problem(scenario).reference.wheels
    slowest = float(wheels.min())
    fastest = float(wheels.max())
    below = (slowest - reference.wheel_speed_min_mps) * factor
    above = (reference.wheel_speed_max_mps - fastest) * factor
    if below == above == 0:
        return {}
    return {
        "reference.wheel_speed_min_mps": _round(slowest - below, -1),
        "reference.wheel_speed_max_mps": _round(fastest + above, 1),
    }


def _scale_slip(scenario: Scenario, factor: float) -> Values:
    slip = scenario.slip
    if slip.is_measured:
        names = ("measurement_error_relative", "measurement_error")
        return _scale_keys("slip", names, 1, scenario, factor)
    if slip.right is None or slip.left is None:
        return _scale_keys("slip", ("relative_error",), 1, scenario, factor)
    if not any(low < high for low, high in (slip.right, slip.left)):
        return {}
    right, left = slip.nominal
    return {
        "slip.right": _scale_interval(slip.right, right, factor),
        "slip.left": _scale_interval(slip.left, left, factor),
    }


def _scale_interval(
    interval: tuple[float, float], nominal: float, factor: float
) -> tuple[float, float]:
    """Return an interval that is wider about the nominal slip by a factor, rounded outwards."""
    low, high = interval
    below = _round((nominal - low) * factor, 1)
    above = _round((high - nominal) * factor, 1)
    return round(nominal - below, 9), round(nominal + above, 9)


SPEED = Lever("speed", -1, "reference speed [m/s]", _scale_speed)
SLIP = Lever("slip", -1, "slip error [–]", _scale_slip)
LIMITS = Lever(
    "limits",
    1,
    "limits, by the lateral one [m]",
    partial(_scale_keys, "constraints", ERROR_KEYS, -1),
    "constraints.lateral_m",
)
NOISE = Lever(
    "noise",
    -1,
    "noise, by the lateral one [m]",
    partial(_scale_keys, "noise", ERROR_KEYS, 1),
    "noise.lateral_m",
)
RANGE = Lever(
    "range",
    -1,
    "greatest reference wheel speed [m/s]",
    _scale_range,
    "reference.wheel_speed_max_mps",
)
FITTED = {lever.name: lever for lever in (SPEED, LIMITS, SLIP)}
"""What `fit` searches the border of."""


def _round(value: float, direction: int) -> float:
    """Return a number of a few significant digits: the nearest one, or that above or below."""
    if value == 0:
        return 0.0
    digits = DIGITS - 1 - math.floor(math.log10(abs(value)))
    nearest = round(value, digits)
    if (value - nearest) * direction > 1e-9 * abs(value):
        nearest = round(nearest + direction * 10.0**-digits, digits)
    return nearest


def _say_value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{entry:.{DIGITS}g}' for entry in value)}]"
    return f"{value:.{DIGITS}g}"
