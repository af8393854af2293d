"""What the value of an option has to be, and what is said of another one."""

import math
import os
import re
from collections.abc import Callable
from typing import Any, NamedTuple

SEED_LIMIT = 2**63
REALISATIONS_LIMIT = 2**53
LAPS_LIMIT = 2**64


class Rule(NamedTuple):
    """What the value of an option has to be; `words` say what is wrong with another one, and the
    cure."""

    is_kept: Callable[[Any], bool]
    words: str


def at_least(least: int) -> Rule:
    """Return the rule of a count."""
    return Rule(lambda value: value >= least, f"is out of range; give a whole number from {least}")


def _is_count_of_laps(value: float) -> bool:
    return 1 <= value <= REALISATIONS_LIMIT and value == math.floor(value)


def _is_lap(value: int | None) -> bool:
    return value is None or 0 <= value < LAPS_LIMIT


LAPS = Rule(_is_count_of_laps, "is no whole number from 1 to 2^53 (9.0e15); give one, such as 1000")
LAP = Rule(_is_lap, "is out of range; give a lap's number, from 0 to below 2^64")
SEED = Rule(
    lambda value: 0 <= value < SEED_LIMIT,
    "is out of range; give a whole number from 0 to 2^63 - 1",
)
RATE = Rule(
    lambda value: 0 < value < math.inf, "is out of range; give a positive number, such as 0.1"
)
DURATION = Rule(
    lambda value: 0 < value < math.inf, "is out of range; give a positive number, such as 60"
)
POSITIVE_OR_NONE = Rule(
    lambda value: value is None or 0 < value < math.inf,
    "is out of range; give a positive number, or leave it out",
)
WINDOW = Rule(lambda value: 0.2 <= value <= 60, "is out of range; give seconds, such as 2")
MARGIN = Rule(lambda value: 0 <= value < 1, "is out of range; give a slip from 0 on, such as 0.01")
LOG_FILE = Rule(bool, "is missing; name the file of a log, or of a table of windows")
PATH_FILE = Rule(bool, "is missing; name the file of a path")
SCENARIO = Rule(bool, "is missing; name a scenario, such as the identified.toml of `identify`")
RUN = Rule(bool, "is missing; name the folder of a run")
STYLE = Rule(bool, "is missing; name a style of matplotlib, or a file that ends in .mplstyle")
HORIZONS = Rule(
    lambda value: all(re.fullmatch("[1-9][0-9]?", word) for word in value.split(",")),
    "holds no horizons; give whole numbers from 1 to 99 with commas between, such as 5,10,20",
)
SHARE = Rule(
    lambda value: value is None or 0 < value < 1,
    "is out of range; give a share between 0 and 1, such as 0.77",
)
FOLDER = Rule(lambda value: not os.path.isfile(value), "is a file; name a folder")
