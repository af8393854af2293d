"""Names of columns compared without their spelling, and the units they end with.

Source: new.
"""

from __future__ import annotations

import re

from jaxtube.recordings.usual_names import UNIT_SUFFIXES, WHOLE_NAMES, Role

LEAST_SUFFIX = 6
"""Letters of a usual name from which on a longer name may end with it: `/odom/pose_position_x`
holds a position, but not everything that ends with `_x` does."""


def normalise(name: str) -> str:
    """Return a name in lower case with single underscores between its words."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.strip().removeprefix("field."))
    return re.sub(r"[\W_]+", "_", words.lower()).strip("_")


def is_named(name: str, usual: str, role: Role) -> bool:
    """Say whether a name is a usual one, with or without a unit."""
    return name == usual or split_unit(name, role)[0] == usual


def ends_with(name: str, usual: str, role: Role) -> bool:
    """Say whether a name ends with a usual one that is long enough to tell something."""
    is_long = len(usual) >= LEAST_SUFFIX and "_" in usual and usual not in WHOLE_NAMES
    return is_long and f"_{split_unit(name, role)[0]}".endswith(f"_{usual}")


def split_unit(name: str, role: Role) -> tuple[str, str]:
    """Return a name without the unit it ends with, and that unit, "" where it has none."""
    endings = [
        (ending, unit)
        for unit, suffixes in UNIT_SUFFIXES[role.kind].items()
        for ending in suffixes
        if name.endswith(f"_{ending}")
    ]
    if not endings:
        return name, ""
    ending, unit = max(endings, key=lambda pair: len(pair[0]))
    return name[: -len(ending) - 1], unit


def assume_unit(role: Role) -> str:
    """Return the unit of a quantity that tells none."""
    return next(iter(UNIT_SUFFIXES[role.kind]), "")
