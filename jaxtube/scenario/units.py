"""Scenarios in other units: every length and every time larger by a factor, angles as they are.

    value <- value length^l time^t,    (l, t) the powers of metres and of seconds in its unit

A key carries its unit as the last word of its name. The few that do not are listed, and a key that
is neither is refused, so that none is forgotten. No mass and no force appears in the motion of a
rolling robot: one of another size, seen at another speed, leaves the same path in its own units.

Source: Buckingham 1914, Physical Review 4, "On physically similar systems".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from jaxtube.scenario.tree import Scenario, Table, weight_matrix


class Powers(NamedTuple):
    """Powers of metres and of seconds in a unit."""

    length: int
    time: int

    def per(self, other: Powers) -> Powers:
        """Return the powers of a quotient."""
        return Powers(self.length - other.length, self.time - other.time)


NONE = Powers(0, 0)
UNITS = {
    "m": Powers(1, 0),
    "mps": Powers(1, -1),
    "mps2": Powers(1, -2),
    "radps": Powers(0, -1),
    "s": Powers(0, 1),
    "per_s": Powers(0, -1),
    "deg": NONE,
}
"""By the last word of a key, or its last two."""
ERROR = (UNITS["m"], UNITS["m"], NONE)
INPUT = (UNITS["mps"], UNITS["radps"])
TRACKING_GAINS = (INPUT[0].per(ERROR[0]), INPUT[1].per(ERROR[1]), INPUT[1].per(ERROR[2]))
VERTEX_GAINS = tuple(to.per(of) for to in INPUT for of in ERROR)
WITHOUT_UNITS = frozenset(
    {
        "reference.jump_seed",
        "slip.right",
        "slip.left",
        "slip.nominal_right",
        "slip.nominal_left",
        "slip.measurement_error",
        "slip.measurement_error_relative",
        "slip.relative_error",
        "slip.sideslip",
        "controller.horizon",
        "controller.terminal_facets",
        "controller.restart",
        "controller.observer_gain",
        "tuning.tail_share",
        "tuning.tail_weight",
        "tuning.tube_weight",
        "tuning.margin",
    }
)
"""Keys of numbers that are the same in all units."""


def rescale(
    scenario: Scenario, length: float = 1.0, time: float = 1.0, digits: int | None = None
) -> Scenario:
    """Return the scenario with every length and time larger by a factor; what files hold stays as
    it is.

    Args:
        scenario: of any kind.
        length: factor of lengths, positive.
        time: factor of times, positive.
        digits: significant digits that are kept, all unless given.

    Raises:
        KeyError: for a key whose unit is not known.
    """
    return msgspec.convert(_Scale(length, time, digits).table(scenario, ""), Scenario)


def find_powers(key: str) -> Powers:
    """Return the powers of the unit of a key, `section.name`, whose numbers all have that one.

    Raises:
        KeyError: for a key whose unit is not known.
    """
    if key in WITHOUT_UNITS:
        return NONE
    name = key.rpartition(".")[2]
    unit = "per_s" if name.endswith("_per_s") else name.rpartition("_")[2]
    if unit not in UNITS:
        raise KeyError(f"{key}: no unit is known; list it in jaxtube.scenario.units")
    return UNITS[unit]


def round_significant(value: float, digits: int) -> float:
    """Return a number of so many significant digits."""
    return float(f"{value:.{digits - 1}e}")


class _Scale(NamedTuple):
    length: float
    time: float
    digits: int | None

    def table(self, table: Table, section: str) -> dict[str, Any]:
        """Return the keys of a table, and of those inside it, in other units."""
        values = {}
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if isinstance(value, Table):
                values[field.name] = self.table(value, field.name)
            else:
                values[field.name] = self.value(f"{section}.{field.name}", value)
        return values

    def value(self, key: str, value: Any) -> Any:
        """Return the value of a key in other units."""
        if value is None or isinstance(value, str):
            return value
        match key.rpartition(".")[2]:
            case "bands":
                return [self.table(band, key) for band in value]
            case "tracking_gains":
                return self.each(value, TRACKING_GAINS)
            case "vertex_gains":
                return [self.each(gain, VERTEX_GAINS) for gain in value]
            case "error_weight":
                return self.weight(value, ERROR)
            case "input_weight":
                return self.weight(value, INPUT)
        powers = find_powers(key)
        if powers == NONE:
            return value
        if isinstance(value, tuple):
            return self.each(value, [powers] * len(value))
        return self.number(value, powers)

    def each(self, values: Sequence[float], powers: Sequence[Powers]) -> list[float]:
        """Return numbers, each of a unit of its own; none where there are none."""
        return [self.number(value, its) for value, its in zip(values, powers, strict=False)]

    def weight(self, value: Any, powers: Sequence[Powers]) -> list:
        """Return a weight of squares of quantities of these units, as a list of rows where it is
        one."""
        matrix = weight_matrix(value).tolist()
        per_row = [[NONE.per(row).per(column) for column in powers] for row in powers]
        rows = [self.each(entries, its) for entries, its in zip(matrix, per_row, strict=True)]
        is_diagonal = not isinstance(value[0], tuple)
        return np.diag(rows).tolist() if is_diagonal else rows

    def number(self, value: float, powers: Powers) -> float:
        scaled = value * self.length**powers.length * self.time**powers.time
        return scaled if self.digits is None else round_significant(scaled, self.digits)
