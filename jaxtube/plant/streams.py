"""The streams of random numbers of one realisation, one a purpose."""

from enum import IntEnum


class Stream(IntEnum):
    """Number that the key of a realisation is folded with; a stream added later leaves the numbers
    of the others as they are."""

    TRUE_SLIP = 0
    MEASURED_SLIP = 1
    POSE_NOISE = 2
    DISTURBANCE = 3
    """Of the linear plant."""
    INITIAL_ERROR = 4
    INSTANT = 5
    """At which the slips of an imperfect robot change within a period."""
    SIDESLIP = 6
    LAG = 7
    """Of the wheels."""
    DELAY = 8
    """Of the commands."""
