"""What the options of a command say about the file of a log."""

from __future__ import annotations

from jaxtube.experiments.options import LogOptions
from jaxtube.recordings.hints import Hints, parse_pairs


def make_hints(options: LogOptions) -> Hints:
    """Return the hints for reading a log.

    Raises:
        ValueError: in one line, for an option that is no list of pairs.
    """
    return Hints(
        columns=parse_pairs("--columns", options.columns),
        units=parse_pairs("--units", options.units),
        topics=parse_pairs("--topics", options.topics),
        wheel_radius_m=options.wheel_radius,
        ticks_per_revolution=options.ticks,
        pose_file=options.pose_file or None,
    )
